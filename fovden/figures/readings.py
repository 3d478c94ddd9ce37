"""What other readings of the paper change in the error, scene by scene, with widths kept and with widths fitted."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from fovden.figures.style import FAINT, GRID, INK, PRINT_WIDTH, SMALL, drawing, save_figure
from fovden.results import Measurement, read_metrics

__all__ = ["changes_by_scene", "draw_readings", "names_of_readings"]

MARKS = (("o", "#0072b2"), ("s", "#d55e00"), ("^", "#009e73"), ("D", "#cc79a7"), ("v", "#56b4e9"))
RELATIVE = ("rmse", "flip")


def names_of_readings(measurements: Sequence[Measurement], light: str) -> dict[str, list[str]]:
    """Returns the readings of one kind of light, and how the widths of each were found.

    Args:
        measurements: Rows whose method is "light, reading, widths".
        light: ``"literal"`` or ``"demodulated"``.

    Returns:
        ``"fitted"``, ``"fitted on"`` and ``"kept"``, as far as they are there, by reading.

    Example:
        >>> row = Measurement("box", 0, "", "literal, F11 seam=True, kept", "whole", "rmse", 0.25)
        >>> names_of_readings([row], "literal")
        {'F11 seam=True': ['kept']}
    """
    found: dict[str, list[str]] = {}
    for method in dict.fromkeys(row.method for row in measurements):
        own, reading, widths = method.split(", ")
        if own == light:
            found.setdefault(reading, []).append(widths)
    return found


def changes_by_scene(
    measurements: Sequence[Measurement], method: str, metric: str = "rmse", region: str = "whole"
) -> dict[str, float]:
    """Returns how far the scores of a reading are from those of the default, on the same frames.

    Args:
        measurements: Rows whose method is "light, reading, widths".
        method: One of these.
        metric: Name of the metric.
        region: Name of the region.

    Returns:
        By scene the relative change, (x - d) / d, of RMSE and FLIP, and the difference x - d of other metrics, with d
        the score of the default of the same light.

    Example:
        >>> names = ("literal, default, fitted", "literal, F11 seam=True, kept")
        >>> rows = [Measurement("box", 0, "", name, "whole", "rmse", value) for name, value in zip(names, (0.25, 0.5))]
        >>> changes_by_scene(rows, "literal, F11 seam=True, kept")
        {'box': 1.0}
    """
    default = f"{method.split(', ', maxsplit=1)[0]}, default, fitted"
    values = {
        (row.method, row.scene): row.value
        for row in measurements
        if row.scene and row.method in (method, default) and (row.metric, row.region) == (metric, region)
    }
    scenes = [scene for own, scene in values if own == method]
    scale = {scene: values[default, scene] if metric in RELATIVE else 1.0 for scene in scenes}
    return {scene: (values[method, scene] - values[default, scene]) / scale[scene] for scene in scenes}


def draw_readings(folder: str | os.PathLike[str]) -> Path:
    """Draws ``readings.png`` into a folder that ``experiments/paper_readings.py`` wrote, from its numbers.

    One panel for each kind of light, one line for each reading, one mark for each scene: the change of RMSE from the
    default, hollow with the default's widths and filled with widths of the reading's own. The grey band is what the
    default itself changes when its fit goes on. The axis is linear up to 1 % and logarithmic beyond.

    Args:
        folder: The folder, with ``metrics.csv``.

    Returns:
        The file.

    Raises:
        FileNotFoundError: If the folder holds no finished run.
        ValueError: If its table is damaged.

    Example:
        >>> import tempfile
        >>> from fovden.results import Run
        >>> with Run(tempfile.mkdtemp(), {}) as run:
        ...     for name, value in (("default, fitted", 0.25), ("F11 seam=True, kept", 0.26)):
        ...         run.measurements.append(Measurement("box", 0, "", f"literal, {name}", "whole", "rmse", value))
        >>> draw_readings(run.folder).name
        'readings.png'
    """
    measurements = read_metrics(folder)
    lights = list(dict.fromkeys(row.method.split(", ")[0] for row in measurements))
    readings = [name for name in names_of_readings(measurements, lights[0]) if name != "default"]
    scenes = list(dict.fromkeys(row.scene for row in measurements if row.scene))
    path = Path(folder) / "readings.png"
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 0.22 * len(readings) + 1.1), layout="constrained")
        panels = figure.subplots(1, len(lights), squeeze=False, sharey=True, sharex=True)[0]
        for panel, light in zip(panels, lights, strict=True):
            _draw_light(panel, measurements, light, readings, scenes)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize=SMALL)
        save_figure(figure, path, 1.0)
    return path


def _draw_light(
    panel: Any, measurements: Sequence[Measurement], light: str, readings: Sequence[str], scenes: Sequence[str]
) -> None:
    names = names_of_readings(measurements, light)
    if "fitted on" in names.get("default", []):
        again = changes_by_scene(measurements, f"{light}, default, fitted on")
        half = 100 * max(map(abs, again.values()))
        panel.axvspan(-half, half, color=GRID, alpha=0.6, linewidth=0)
    panel.axvline(0, color=FAINT, linewidth=0.6)
    for line, reading in enumerate(readings):
        for widths in names.get(reading, []):
            changes = changes_by_scene(measurements, f"{light}, {reading}, {widths}")
            for place, (scene, change) in enumerate(changes.items()):
                marker, colour = MARKS[scenes.index(scene) % len(MARKS)]
                face = "none" if widths == "kept" else colour
                lift = (place - (len(changes) - 1) / 2) * 0.16
                panel.plot(
                    100 * change, line + lift, marker, markersize=3.8, color=colour, markerfacecolor=face,
                    markeredgewidth=0.8, clip_on=False,
                )  # fmt: skip
    for scene, (marker, colour) in zip(scenes, MARKS * len(scenes), strict=False):
        panel.plot([], [], marker, markersize=3.8, color=colour, label=scene)
    panel.plot([], [], "o", markersize=3.8, color=INK, markerfacecolor="none", label="the default's widths")
    panel.plot([], [], "o", markersize=3.8, color=INK, label="widths of its own")
    panel.set_xscale("symlog", linthresh=1.0)
    panel.xaxis.set_major_formatter("{x:g}")
    panel.set_yticks(range(len(readings)), readings)
    panel.set_ylim(len(readings) - 0.5, -0.5)
    panel.grid(axis="x", color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    panel.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        panel.spines[side].set_visible(False)
    panel.set_title(light, loc="left")
    panel.set_xlabel("change of RMSE, %")
