"""The front of time against error that a search found, and where the paper's filters lie."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from fovden.figures.style import FAINT, GRID, INK, PRINT_WIDTH, SMALL, drawing, method_style, save_figure
from fovden.results import Measurement, read_metrics
from fovden.tuning import Trial, pareto_front

__all__ = ["TRIED", "best_of", "draw_front", "trials_by"]

TRIED = ("search", "search, acuity", "random", "grid")
"""Methods whose rows are settings of three layers that were tried."""

PAPERS = ("Base", "NH2LD", "NH3LD")
ROOM = 2.0
"""How far the axis of times goes on to the left of the least, where labels of the front are written."""

ERRORS = {"error": "all pixels alike", "error_acuity": "weighted by acuity"}


def trials_by(
    measurements: Sequence[Measurement], methods: Sequence[str], *, error: str = "error", cost: str = "seconds"
) -> list[Trial]:
    """Returns what was tried, with the mean cost and the geometric mean of the error over the scenes.

    Args:
        measurements: Rows of ``experiments/search_levels.py``; their region is the setting: ``"3-4-5 1 2 0.5 4 0"``.
        methods: Which rows, by their method.
        error: Metric of the error.
        cost: Metric of the cost.

    Returns:
        One trial for each setting; that has ``"method"``, ``"choice"`` (the region), ``"levels"``, ``"r0"``, ``"r1"``,
        ``"p"``, ``"spp"`` and ``"wide"``.

    Example:
        >>> values = {("a", "error"): 0.01, ("b", "error"): 0.04, ("a", "seconds"): 1.0, ("b", "seconds"): 2.0}
        >>> rows = [Measurement(s, 0, "", "grid", "3-4-5 1 2 0.5 4 0", m, x) for (s, m), x in values.items()]
        >>> trial, = trials_by(rows, ["grid"])
        >>> trial.cost, round(trial.error, 6), trial.setting["levels"], trial.setting["spp"]
        (1.5, 0.02, '3-4-5', 4)
    """
    values: dict[tuple[str, str], dict[str, list[float]]] = {}
    for row in measurements:
        if row.method in methods and row.metric in (error, cost):
            values.setdefault((row.method, row.region), {}).setdefault(row.metric, []).append(row.value)
    found = []
    for number, ((method, choice), own) in enumerate(values.items()):
        levels, *numbers = choice.split()
        r0, r1, p, spp, wide = map(float, numbers)
        setting = {"method": method, "choice": choice, "levels": levels, "r0": r0, "r1": r1, "p": p, "spp": int(spp)}
        geometric = math.exp(sum(map(math.log, own[error])) / len(own[error]))
        found.append(Trial(number, {**setting, "wide": wide}, sum(own[cost]) / len(own[cost]), geometric))
    return found


def draw_front(folder: str | os.PathLike[str]) -> Path:
    """Draws ``front.png`` into a folder that ``experiments/search_levels.py`` wrote, from its numbers.

    One panel for each error: all settings that were tried, the front, the paper's filters, each with the widths that
    are best for it, and Base with 1, 2, ... samples per pixel. The last panel has the time of the passes alone, for
    all numbers of them at the paper's foveation, each with its best widths.

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
        ...     for passes in (1, 2, 3):
        ...         region = f"1-1-{passes} 1 2 0.5 4 0"
        ...         values = {"seconds": passes, "seconds_passes": passes, "error": 1 / passes, "error_acuity": 2.0}
        ...         run.measurements += [Measurement("a", 0, "", "grid", region, *each) for each in values.items()]
        >>> draw_front(run.folder).name
        'front.png'
    """
    measurements = read_metrics(folder)
    path = Path(folder) / "front.png"
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 2.75), layout="constrained")
        panels = figure.subplots(1, len(ERRORS) + 1)
        for panel, (error, title) in zip(panels, ERRORS.items(), strict=False):
            tried = trials_by(measurements, TRIED, error=error)
            papers = {name: trials_by(measurements, [name], error=error) for name in PAPERS}
            _draw_trials(panel, tried, papers, "{levels}, {spp} spp")
            panel.set_title(f"error, {title}", loc="left")
            panel.set_xlabel("time of a frame / s")
        grid = trials_by(measurements, ["grid"], cost="seconds_passes")
        papers = {name: trials_by(measurements, [name], cost="seconds_passes") for name in PAPERS[1:]}
        _draw_trials(panels[-1], best_of(grid, "levels"), papers, "{levels}")
        panels[-1].set_title("all passes, the paper's paths", loc="left")
        panels[-1].set_xlabel("time of the passes / s")
        panels[0].set_ylabel("error")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=SMALL)
        save_figure(figure, path, 1.0)
    return path


def best_of(trials: Sequence[Trial], name: str) -> list[Trial]:
    """Returns the trial of least error for each value of a setting.

    Example:
        >>> trials = [Trial(0, {"spp": 1}, 1.0, 3.0), Trial(1, {"spp": 1}, 1.0, 2.0), Trial(2, {"spp": 4}, 2.0, 1.0)]
        >>> [trial.number for trial in best_of(trials, "spp")]
        [1, 2]
    """
    found: dict[Any, Trial] = {}
    for trial in trials:
        value = trial.setting[name]
        if value not in found or trial.error < found[value].error:
            found[value] = trial
    return list(found.values())


def _draw_trials(panel: Any, tried: Sequence[Trial], papers: Mapping[str, Sequence[Trial]], words: str) -> None:
    front = pareto_front(tried)
    panel.plot(*_points(tried), ".", color=GRID, markersize=3, label="tried", zorder=1)
    line = {"color": INK, "linewidth": 0.9, "drawstyle": "steps-post", "marker": ".", "markersize": 4}
    panel.plot(*_points(front), **line, label="front", zorder=3)
    for name, trials in papers.items():
        style = method_style(name)
        best = best_of(trials, "spp")
        options = {"color": style.colour, "marker": style.marker, "markersize": 5, "linestyle": "", "zorder": 4}
        if len(best) > 1:
            fewer = [trial for trial in best if trial.setting["spp"] != 4]
            small = {**options, "markersize": 3, "zorder": 2}
            panel.plot(*_points(best), color=style.colour, linewidth=0.6, zorder=2)
            panel.plot(*_points(fewer), **small, label=f"{name}, other spp")
            best = [trial for trial in best if trial.setting["spp"] == 4]
        if best:
            panel.plot(*_points(best), **options, label=name)
    panel.set_xscale("log")
    panel.set_yscale("log")
    least = min((trial.error for trial in front), default=1.0)
    middle = sorted(trial.error for trial in tried)[len(tried) // 2]
    panel.set_ylim(least / 1.15, max(middle * 1.6, least * 2))
    shown = [trial.cost for trial in tried if trial.error <= panel.get_ylim()[1]]
    panel.set_xlim(min(shown) / ROOM, max(shown) * 1.15)
    _label(panel, front, words)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_minor_locator(LogLocator(subs=(2, 3, 4, 5, 6, 8)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    panel.tick_params(which="both", length=2)
    panel.tick_params(which="minor", labelsize=SMALL - 1.5)
    panel.grid(color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)


def _label(panel: Any, front: Sequence[Trial], words: str, count: int = 6) -> None:
    """Writes passes and samples beside some of the front, at even steps of its length in the panel."""
    places = [panel.transData.transform((trial.cost, trial.error)) for trial in front]
    last = None
    distance = panel.get_window_extent().height / count
    for trial, place in zip(front, places, strict=True):
        if trial.error > panel.get_ylim()[1] or (last is not None and math.dist(last, place) < distance):
            continue
        last = place
        text = words.format(levels=trial.setting["levels"].replace("-", " "), spp=trial.setting["spp"])
        beside = {"xytext": (-3, -2), "textcoords": "offset points", "ha": "right", "va": "top"}
        panel.annotate(text, (trial.cost, trial.error), **beside, fontsize=SMALL - 1, color=FAINT)


def _points(trials: Sequence[Trial]) -> tuple[list[float], list[float]]:
    return [trial.cost for trial in trials], [trial.error for trial in trials]
