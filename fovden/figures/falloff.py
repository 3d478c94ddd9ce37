"""A learned falloff beside the paper's, and the way that it took over the loss."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fovden.figures.style import FAINT, GRID, INK, PRINT_WIDTH, SMALL, MethodStyle, drawing, method_style, save_figure
from fovden.results import Measurement, read_metrics

__all__ = ["draw_falloff", "losses_by_radii", "path_of_radii"]

STYLES = {
    "paper": MethodStyle("#000000", "*", "\u2605"),
    "uniform": MethodStyle("#4d4d4d", "X", "\u2716"),
    "differences": MethodStyle("#0072b2", "o", "\u25cf"),
    "differences, layers kept": MethodStyle("#56b4e9", "s", "\u25a0"),
    "relaxed, layers kept": MethodStyle("#d55e00", "^", "\u25b2"),
    "profile, layers kept": MethodStyle("#009e73", "D", "\u25c6"),
}
GRIDS = {"grid": "layers move along", "grid, layers kept": "layers kept"}


def losses_by_radii(measurements: Sequence[Measurement], scene: str, grid: str) -> dict[tuple[float, float], float]:
    """Returns the losses of a grid over radii.

    Args:
        measurements: Rows with the metric ``"loss"`` and the region ``"r0 width"``.
        scene: Name of the scene.
        grid: Name of the grid, the rows' method.

    Returns:
        Loss by (r0, r1 - r0), in units of the paper's r0.

    Example:
        >>> losses_by_radii([Measurement("box", 0, "", "grid", "0.5 1", "loss", 0.25)], "box", "grid")
        {(0.5, 1.0): 0.25}
    """
    rows = [row for row in measurements if (row.scene, row.method, row.metric) == (scene, grid, "loss")]
    return {(float(row.region.split()[0]), float(row.region.split()[1])): row.value for row in rows}


def path_of_radii(measurements: Sequence[Measurement], scene: str, method: str) -> list[tuple[float, float]]:
    """Returns the radii of each step of a method that learns.

    Args:
        measurements: Rows with the metrics ``"r0"`` and ``"width"`` and the region ``"path"``, by the frame's number.
        scene: Name of the scene.
        method: Name of the method.

    Returns:
        (r0, r1 - r0) in units of the paper's r0, the start first and what it ended with last.

    Example:
        >>> rows = [Measurement("box", 0, "", "relaxed", "path", metric, 1.0) for metric in ("r0", "width")]
        >>> path_of_radii(rows, "box", "relaxed")
        [(1.0, 1.0)]
    """
    rows = [row for row in measurements if (row.scene, row.method, row.region) == (scene, method, "path")]
    found = {(row.metric, row.frame): row.value for row in rows}
    return [(value, found["width", frame]) for (metric, frame), value in sorted(found.items()) if metric == "r0"]


def draw_falloff(folder: str | os.PathLike[str]) -> Path:
    """Draws ``falloff.png`` into a folder that ``experiments/learn_falloff.py`` wrote, from its numbers.

    One row for each scene: rates by eccentricity, and the loss over both radii with the ways that were taken, with
    layers that move along and with layers that are kept.

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
        ...     for degrees, rate in ((0.0, 1.0), (20.0, 0.5)):
        ...         row = Measurement("box", 0, "", "paper", f"{degrees} deg", "rate", rate)
        ...         run.measurements.append(row)
        ...     for r0 in (0.5, 1.0):
        ...         for width in (0.5, 1.0):
        ...             run.measurements.append(Measurement("box", 0, "", "grid", f"{r0} {width}", "loss", r0 + width))
        >>> draw_falloff(run.folder).name
        'falloff.png'
    """
    measurements = read_metrics(folder)
    scenes = list(dict.fromkeys(row.scene for row in measurements if row.metric == "rate"))
    grids = [name for name in GRIDS if any(row.method == name for row in measurements)]
    path = Path(folder) / "falloff.png"
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 2.4 * len(scenes) + 0.35), layout="constrained")
        widths = [1.35, *(1.0 for _ in grids)]
        rows = figure.subplots(len(scenes), 1 + len(grids), squeeze=False, width_ratios=widths)
        for panels, scene in zip(rows, scenes, strict=True):
            _draw_rates(panels[0], measurements, scene)
            for panel, grid in zip(panels[1:], grids, strict=True):
                _draw_losses(panel, measurements, scene, grid)
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=SMALL)
        save_figure(figure, path, 1.0)
    return path


def _draw_rates(panel: Any, measurements: Sequence[Measurement], scene: str) -> None:
    rates = [row for row in measurements if (row.scene, row.metric) == (scene, "rate")]
    for method in dict.fromkeys(row.method for row in rates):
        own = [(float(row.region.removesuffix(" deg")), row.value) for row in rates if row.method == method]
        style = STYLES.get(method) or method_style(method)
        dashes = {"linestyle": "--"} if method in ("paper", "uniform") else {}
        options = {"color": style.colour, "marker": style.marker, "markersize": 3.5, "linewidth": 1}
        panel.plot(*zip(*own, strict=True), label=method, markevery=max(1, len(own) // 8), **options, **dashes)
    panel.set_ylim(-0.03, 1.05)
    panel.grid(color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    panel.set_title(f"{scene}: rate", loc="left")
    panel.set_xlabel("eccentricity, degrees")
    panel.set_ylabel("share of pixels that are sampled")


def _draw_losses(panel: Any, measurements: Sequence[Measurement], scene: str, grid: str) -> None:
    losses = losses_by_radii(measurements, scene, grid)
    radii, widths = (sorted(set(values)) for values in zip(*losses, strict=True))
    surface = np.array([[losses[r0, width] for r0 in radii] for width in widths])
    levels = 8 if np.ptp(surface) > 0 else None
    colours = panel.contourf(radii, widths, surface, levels=levels, cmap="Greys", alpha=0.7)
    best = min(losses, key=lambda place: losses[place])
    panel.plot(*best, marker="+", markersize=8, color=INK, linestyle="", clip_on=False)
    for method, style in STYLES.items():
        kept = method.endswith("layers kept")
        way = path_of_radii(measurements, scene, method)
        if way and kept == grid.endswith("layers kept"):
            xs, ys = zip(*way, strict=True)
            panel.plot(xs, ys, color=style.colour, linewidth=0.8)
            panel.plot(xs[-1], ys[-1], color=style.colour, marker=style.marker, markersize=5, linestyle="")
    start = STYLES["paper"]
    panel.plot(1, 1, color=start.colour, marker=start.marker, markersize=6, linestyle="")
    panel.set_xscale("log", base=2)
    panel.set_yscale("log", base=2)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter("{x:g}")
    panel.set_title(f"loss, {GRIDS[grid]}", loc="left")
    panel.set_xlabel("r0, in the paper's")
    panel.set_ylabel("r1 - r0, in the paper's r0")
    bar = panel.figure.colorbar(colours, ax=panel, shrink=0.9)
    bar.ax.tick_params(labelsize=SMALL, length=2)
    bar.outline.set_edgecolor(FAINT)
