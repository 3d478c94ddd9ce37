"""Ways to place paths beside each other: error against time, and what fewer cells lose of converged light."""

from __future__ import annotations

import os
import statistics
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from fovden.figures.style import GRID, METHOD_STYLES, PRINT_WIDTH, SMALL, drawing, save_figure
from fovden.results import Measurement, read_metrics

__all__ = ["curves_of_ways", "draw_foveations"]


def curves_of_ways(
    measurements: Sequence[Measurement], scene: str, region: str, unit: str
) -> dict[str, list[tuple[float, float]]]:
    """Returns points of cost and RMSE for each way to place paths, the mean over the views of a scene.

    Args:
        measurements: Rows of ``experiments/compare_foveation.py``, named "Log-polar, tuned, 0.4 paths" in the sweep of
            budgets, and "Log-polar, converged, 0.4 cells".
        scene: The scene.
        region: ``"whole"`` or ``"acuity"``.
        unit: ``"paths"``, whose cost is seconds; or ``"cells"``, whose cost is cells per pixel.

    Returns:
        Points by the name of the way, in order of paths or cells. Fewer paths may cost more, where they leave holes
        that take long to fill.

    Example:
        >>> names = "Log-polar, converged, 0.4 cells", "Log-polar, converged, 0.2 cells"
        >>> rows = [Measurement("box", 0, "", name, "acuity", "rmse", 0.5) for name in names]
        >>> curves_of_ways(rows, "box", "acuity", "cells")
        {'Log-polar': [(0.2, 0.5), (0.4, 0.5)]}
    """
    values: dict[tuple[str, float], dict[str, list[float]]] = {}
    for row in measurements:
        if row.scene != scene or not row.method.endswith(f" {unit}") or row.region not in (region, "whole"):
            continue
        way, _, amount = row.method.rsplit(", ", 2)
        if (row.metric, row.region) in (("rmse", region), ("seconds", "whole")):
            own = values.setdefault((way, float(amount.split()[0])), {})
            own.setdefault(row.metric, []).append(row.value)
    curves: dict[str, list[tuple[float, float]]] = {}
    for (way, share), own in sorted(values.items(), key=lambda item: item[0][1]):
        cost = statistics.fmean(own["seconds"]) if unit == "paths" else share
        curves.setdefault(way, []).append((cost, statistics.fmean(own["rmse"])))
    return curves


def draw_foveations(folder: str | os.PathLike[str]) -> Path:
    """Draws ``foveations.png`` into a folder that ``experiments/compare_foveation.py`` wrote, from its numbers.

    One column for each scene. Above, RMSE against the time of a frame over budgets of paths, weighted by acuity; below,
    that of converged light that is seen through fewer cells, without noise or filter.

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
        ...     for name in ("Linear, tuned, 0.4 paths", "Linear, converged, 0.4 cells"):
        ...         for region, metric in (("acuity", "rmse"), ("whole", "rmse"), ("whole", "seconds")):
        ...             run.measurements.append(Measurement("box", 0, "", name, region, metric, 0.5))
        >>> draw_foveations(run.folder).name
        'foveations.png'
    """
    measurements = read_metrics(folder)
    scenes = list(dict.fromkeys(row.scene for row in measurements))
    path = Path(folder) / "foveations.png"
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 4.4), layout="constrained")
        panels = figure.subplots(2, len(scenes), squeeze=False)
        for column, scene in enumerate(scenes):
            _draw_curves(panels[0][column], curves_of_ways(measurements, scene, "acuity", "paths"))
            panels[0][column].set_title(scene.replace("_", " "), loc="left")
            panels[0][column].set_xlabel("processor time of a frame / s")
            _draw_curves(panels[1][column], curves_of_ways(measurements, scene, "acuity", "cells"))
            panels[1][column].set_xlabel("cells or sampled pixels for a pixel")
        panels[0][0].set_ylabel("RMSE by acuity, filtered")
        panels[1][0].set_ylabel("RMSE by acuity, converged light")
        handles, labels = panels[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=SMALL)
        save_figure(figure, path, 1.0)
    return path


def _draw_curves(panel: Any, curves: dict[str, list[tuple[float, float]]]) -> None:
    for (way, points), style in zip(curves.items(), cycle(METHOD_STYLES.values()), strict=False):
        panel.plot(
            *zip(*points, strict=True), color=style.colour, marker=style.marker, markersize=3, linewidth=0.7, label=way
        )
    panel.grid(color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
