"""What fitting gains: scores of filters by hand and fitted, a panel for each metric and a column for each scene."""

from __future__ import annotations

import os
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from fovden.figures.style import FAINT, GRID, INK, METHOD_STYLES, PRINT_WIDTH, SMALL, drawing, save_figure
from fovden.metrics import METRICS
from fovden.results import Measurement, read_metrics

__all__ = ["draw_fitted", "scores_of_fits"]

PANELS = ("rmse", "psnr", "ssim", "flip")
WHAT: dict[str, dict[str, str]] = {
    "by hand": {"fillstyle": "none"},
    "sigmas": {"fillstyle": "left"},
    "passes": {"fillstyle": "full"},
    "predicted": {"fillstyle": "full", "markeredgecolor": INK},
}
"""What is learned, and its mark."""

SPREAD = 0.8  # of a scene's column that its marks take


def scores_of_fits(
    measurements: Sequence[Measurement], region: str = "whole"
) -> dict[tuple[str, str, str], list[float]]:
    """Returns scores by scene, method and metric: one for each seed, or for each scene that others' widths are from.

    Args:
        measurements: Rows whose methods are named "Base, by hand" or "Base, sigmas of SCENE, seed N". Where the scene
            is another than the row's, the method becomes "Base, sigmas of others".
        region: Which region's scores.

    Returns:
        Scores, each the mean over the test poses.

    Example:
        >>> rows = [Measurement("atrium", pose, "", "Base, by hand", "whole", "rmse", 0.5) for pose in range(2)]
        >>> scores_of_fits(rows)
        {('atrium', 'Base, by hand', 'rmse'): [0.5]}
    """
    values: dict[tuple[str, str, str], dict[str, list[float]]] = {}
    for row in measurements:
        if not row.scene or row.region != region:
            continue
        method, _, seed = row.method.partition(", seed ")
        kind, _, source = method.rpartition(" of ")
        if kind:
            method, seed = (kind, seed) if source == row.scene else (f"{kind} of others", source)
        values.setdefault((row.scene, method, row.metric), {}).setdefault(seed, []).append(row.value)
    return {key: [statistics.fmean(each) for each in by_seed.values()] for key, by_seed in values.items()}


def draw_fitted(folder: str | os.PathLike[str]) -> Path:
    """Draws ``fitted.png`` into a folder that ``experiments/tune_sigmas.py`` wrote, from its numbers.

    A mark is the mean over the seeds, its bar reaches from the least to the greatest of them. The line is Base by hand.

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
        ...     for method in ("Base, by hand", "NH3LD, passes of atrium, seed 0"):
        ...         run.measurements.append(Measurement("atrium", 0, "", method, "whole", "rmse", 0.5))
        >>> draw_fitted(run.folder).name
        'fitted.png'
    """
    found = scores_of_fits(read_metrics(folder))
    path = Path(folder) / "fitted.png"
    metrics = [name for name in PANELS if any(key[2] == name for key in found)]
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 2.7), layout="constrained")
        panels = figure.subplots(1, len(metrics), squeeze=False)[0]
        for panel, metric in zip(panels, metrics, strict=True):
            _draw_metric(panel, found, metric)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=SMALL)
        save_figure(figure, path, 1.0)
    return path


def _draw_metric(panel: Any, found: dict[tuple[str, str, str], list[float]], metric: str) -> None:
    scenes = list(dict.fromkeys(key[0] for key in found))
    methods = [
        (name, what)
        for name in ("Base", "NH3LD")
        for what in WHAT
        if any(key[1:] == (f"{name}, {what}", metric) for key in found)
    ]
    for number, (name, what) in enumerate(methods):
        style = METHOD_STYLES[name]
        shift = SPREAD * ((number + 0.5) / len(methods) - 0.5)
        values = [found.get((scene, f"{name}, {what}", metric), []) for scene in scenes]
        places = [place + shift for place, each in enumerate(values) if each]
        means = [statistics.fmean(each) for each in values if each]
        bars = [
            [mean - min(each) for mean, each in zip(means, filter(None, values), strict=True)],
            [max(each) - mean for mean, each in zip(means, filter(None, values), strict=True)],
        ]
        panel.errorbar(
            places, means, yerr=bars, color=style.colour, marker=style.marker, markersize=4,
            markerfacecoloralt="white", linestyle="", linewidth=0.8, label=f"{name}, {what}", **WHAT[what],
        )  # fmt: skip
    for place, scene in enumerate(scenes):
        for value in found.get((scene, "Base, by hand", metric), []):
            panel.plot([place - 0.5, place + 0.5], [value, value], color=FAINT, linewidth=0.6, zorder=0)
    panel.set_xticks(range(len(scenes)), [scene.replace("_", " ") for scene in scenes], rotation=30, fontsize=SMALL)
    panel.set_xlim(-0.5, len(scenes) - 0.5)
    panel.set_title(f"{METRICS[metric].title}, {METRICS[metric].better} is better", loc="left")
    panel.grid(axis="y", color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
