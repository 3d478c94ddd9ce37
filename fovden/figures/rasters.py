"""The rasters themselves: cells drawn over the screen, whole and around the gaze."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fovden.figures.style import FAINT, INK, PRINT_WIDTH, SMALL, drawing, save_figure
from fovden.foveation import Warp

__all__ = ["draw_rasters"]

CLOSE_UP = 0.12  # width of the lower row over the screen's
POINTS = 9  # along the arc of a cell, which at the gaze may be a third of a circle
LINE = "#0072b2"  # Okabe and Ito's blue


def draw_rasters(warps: Mapping[str, Warp], path: str | os.PathLike[str]) -> Path:
    """Draws the borders of all cells of the first view over the screen, and larger around the gaze.

    One column for each warp. Coarse rasters are best: at full size the cells are smaller than what is printed.

    Args:
        warps: Warps by the titles of their columns; all for screens of one size.
        path: The PNG file to write.

    Returns:
        The file.

    Raises:
        ValueError: If there is no warp.

    Example:
        >>> import tempfile
        >>> from fovden import Gaze
        >>> from fovden.foveation import LogPolarWarp
        >>> warp = LogPolarWarp(Gaze(torch.tensor([[40.0, 20.0]])), (48, 64), (18, 12), alpha=2.0)
        >>> draw_rasters({"log-polar": warp}, Path(tempfile.mkdtemp()) / "rasters.png").name
        'rasters.png'
    """
    if not warps:
        raise ValueError("warps: expected at least one, got none")
    path = Path(path)
    height, width = next(iter(warps.values())).screen
    with drawing():
        panel_width = PRINT_WIDTH / len(warps)
        figure = Figure(figsize=(PRINT_WIDTH, 2 * panel_width * height / width + 0.4), layout="constrained")
        rows = figure.subplots(2, len(warps), squeeze=False)
        for panel, close_up, (title, warp) in zip(*rows, warps.items(), strict=True):
            lines = _borders(warp)
            x, y = warp.gaze.pixels[0].tolist()
            reach_x, reach_y = CLOSE_UP * warp.screen[1] / 2, CLOSE_UP * warp.screen[0] / 2
            _draw(panel, lines, (0, warp.screen[1]), (0, warp.screen[0]), 0.15)
            _draw(close_up, lines, (x - reach_x, x + reach_x), (y - reach_y, y + reach_y), 0.4)
            frame: dict[str, Any] = {"fill": False, "edgecolor": INK, "linewidth": 0.6}
            panel.add_patch(Rectangle((x - reach_x, y - reach_y), 2 * reach_x, 2 * reach_y, **frame))
            panel.set_title(title, loc="left")
            cells = f"{warp.cell_count} cells, {int(warp.valid[0].sum())} on the screen"
            panel.set_xlabel(cells, color=FAINT, fontsize=SMALL)
            close_up.set_xlabel(f"{2 * reach_x:.3g} x {2 * reach_y:.3g} pixels", color=FAINT, fontsize=SMALL)
        save_figure(figure, path, 1.0)
    return path


def _draw(panel: Any, lines: list[Any], x: tuple[float, float], y: tuple[float, float], linewidth: float) -> None:
    panel.add_collection(LineCollection(lines, colors=LINE, linewidths=linewidth))
    panel.set_xlim(*x)
    panel.set_ylim(y[1], y[0])  # y points down
    panel.set_aspect("equal")
    panel.set_xticks([])
    panel.set_yticks([])


def _borders(warp: Warp) -> list[Any]:
    """The outlines of all cells of the first view, as the warp itself maps them."""
    rows, columns = (each.double() for each in warp.exists[0, 0].nonzero().unbind(1))
    inner = 1e-9  # a corner belongs to the column on its left side only just within it
    # Around a cell: out along one angle, then along the rim to the next; the other sides are its neighbours'.
    along = torch.linspace(0, 1, POINTS, dtype=torch.float64)
    x = torch.cat([torch.full((1,), inner, dtype=torch.float64), torch.full((POINTS,), 1 - inner, dtype=torch.float64)])
    y = torch.cat([torch.zeros(1, dtype=torch.float64), along])
    cells = torch.stack([columns[:, None] + x, rows[:, None] + y], dim=-1).reshape(1, -1, 2)
    cells = cells.expand(warp.view_count, -1, 2)
    points = warp.cell_to_screen(cells)[0].reshape(len(rows), -1, 2)
    return list(np.asarray(points.detach().cpu()))
