"""The course of a fit: losses above, the widths that were learned below."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from fovden.figures.style import FAINT, GRID, OTHER_COLOURS, PRINT_WIDTH, SMALL, drawing, save_figure
from fovden.tuning import Record, read_history

__all__ = ["draw_history"]

SIGMA = "sigma_"
PER_ROW = 3
MOST_LINES = 7  # as many as there are colours


def draw_history(folder: str | os.PathLike[str]) -> Path:
    """Draws ``history.png`` into the folder of a fit, from its table alone.

    Losses of training batches are dots, those of the frames held out a line; a mark shows the step whose parameters
    were kept. Below, each kind of parameter has a panel, with a line for each layer.

    Args:
        folder: The folder, with ``history.csv``; see :func:`fovden.tuning.fit`.

    Returns:
        The file.

    Raises:
        FileNotFoundError: If there is no table.
        ValueError: If it is damaged, or has no steps.

    Example:
        >>> import tempfile
        >>> from fovden.tuning.history import write_history
        >>> folder = tempfile.mkdtemp()
        >>> parameters = {"sigma_normal": 1.0}
        >>> write_history(folder, [Record(step, 0.5**step, math.nan, step, parameters) for step in (0, 1)])
        >>> draw_history(folder).name
        'history.png'
    """
    history = read_history(folder)
    if len(history) < 2:
        raise ValueError(f"{folder}: expected the history of at least one step, got {len(history)} records")
    groups = _groups(history)
    rows = -(-len(groups) // PER_ROW)
    path = Path(folder) / "history.png"
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 2.2 + 1.7 * rows), layout="constrained")
        grid = figure.add_gridspec(1 + rows, PER_ROW, height_ratios=[1.3, *(1 for _ in range(rows))])
        best = _draw_losses(figure.add_subplot(grid[0, :]), history)
        for number, (kind, names) in enumerate(groups.items()):
            panel = figure.add_subplot(grid[1 + number // PER_ROW, number % PER_ROW])
            _draw_parameters(panel, history, kind, names, best)
        save_figure(figure, path, 1.0)
    return path


def _groups(history: Sequence[Record]) -> dict[str, list[str]]:
    """Names of parameters by their kind: the last word of the name, without index."""
    groups: dict[str, list[str]] = {}
    for name in history[0].parameters:
        groups.setdefault(name.rsplit(".", 1)[-1].split("[")[0], []).append(name)
    return groups


def _draw_losses(panel: Any, history: Sequence[Record]) -> Record:
    """Draws the losses and returns the record that was kept."""
    made = [record for record in history if not math.isnan(record.loss)]
    judged = [record for record in history if not math.isnan(record.held_out_loss)]
    panel.plot([r.step for r in made], [r.loss for r in made], ".", color=FAINT, markersize=2, label="training batch")
    best = min(judged, key=lambda record: record.held_out_loss) if judged else history[-1]
    if judged:
        steps, losses = [r.step for r in judged], [r.held_out_loss for r in judged]
        panel.plot(steps, losses, color=OTHER_COLOURS[-2], linewidth=1.2, label="held out")
        gain = 1 - best.held_out_loss / judged[0].held_out_loss
        label = f"kept: step {best.step}, {gain:.1%} below the start"
        panel.plot([best.step], [best.held_out_loss], "o", color=OTHER_COLOURS[-2], markersize=4, label=label)
    panel.set_xlabel("step")
    panel.set_ylabel("loss")
    _clean(panel)
    panel.legend(frameon=False, fontsize=SMALL, loc="upper right")
    return best


def _draw_parameters(panel: Any, history: Sequence[Record], kind: str, names: Sequence[str], best: Record) -> None:
    steps = [record.step for record in history]
    for number, name in enumerate(names[:MOST_LINES]):
        label = name.removesuffix(kind).rstrip(".").replace("edge_stopping.", "layer ") or None
        values = [record.parameters[name] for record in history]
        panel.plot(steps, values, color=OTHER_COLOURS[number], linewidth=1, label=label)
    panel.axvline(best.step, color=FAINT, linewidth=0.6, linestyle=":")
    if all(record.parameters[name] > 0 for record in history for name in names):
        panel.set_yscale("log", base=2)
        panel.yaxis.set_major_locator(LogLocator(base=2, subs=(1.0,)))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
        panel.yaxis.set_minor_formatter(NullFormatter())
    panel.set_title(kind.replace("_", " "), loc="left")
    panel.set_xlabel("step")
    _clean(panel)
    if len(names) > 1:
        panel.legend(frameon=False, fontsize=SMALL)


def _clean(panel: Any) -> None:
    panel.grid(color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    panel.tick_params(which="both", length=2)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
