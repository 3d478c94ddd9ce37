"""Rasters of the size that a budget of paths allows."""

from __future__ import annotations

import math
from dataclasses import replace

from fovden.checks import require, require_number
from fovden.warps.base import Warp

__all__ = ["warp_at_budget"]

STEPS = 12
"""Most sizes that are tried; counts are smooth in the size, so that three or four do."""

NEAR = 50
"""Widths are looked for this part of the width apart: after the first steps, one of them is enough nearly always."""


def warp_at_budget(warp: Warp, mean_spp: float) -> Warp:
    """Returns a raster with as many cells to trace as a budget of paths per pixel of the screen, one path in each.

    How many cells a raster has on the screen depends on where the eye looks: of a polar one around the centre an eighth
    lies beside the screen, and around a corner three quarters. Both sides are scaled alike until the cells that are
    read (:attr:`Warp.read`), in the mean over the views, come to the budget; then the width alone, to about a column.

    Args:
        warp: The raster, whose shape is kept.
        mean_spp: Paths per pixel of the screen, above 0.

    Returns:
        The raster with another resolution.

    Raises:
        ValueError: If the budget is not above 0, or is less than a cell.

    Source: Koskela et al. 2019 keep the raster's size, so that the budget shrinks as the gaze moves aside; that is the
    warp as it is.

    Example:
        >>> import torch
        >>> from fovden.camera import Gaze
        >>> from fovden.foveation import VisualPolarWarp
        >>> warp = VisualPolarWarp(Gaze(torch.tensor([[60.0, 40.0]])), (96, 128), (60, 80))
        >>> sized = warp_at_budget(warp, 0.4)
        >>> sized.resolution, int(sized.read.sum()), round(0.4 * 96 * 128)
        ((72, 95), 4927, 4915)
    """
    require_number("mean_spp", mean_spp, above=0)
    target = mean_spp * math.prod(warp.screen)
    require(target >= 1, "mean_spp", mean_spp, f"at least {1 / math.prod(warp.screen):g}, one cell")
    counts: dict[tuple[int, int], float] = {}

    def count(size: tuple[int, int]) -> float:
        if size not in counts:
            counts[size] = int(replace(warp, resolution=size).read.sum()) / warp.view_count
        return counts[size]

    rows, columns = warp.resolution
    scale = 1.0
    size = warp.resolution
    for _ in range(STEPS):
        scale *= math.sqrt(target / count(size))
        size = max(1, round(rows * scale)), max(1, round(columns * scale))
        if size in counts:
            break
    height, width = size
    low, high = width, width
    while low > 1 and count((height, low)) > target:
        low = max(1, low - 1 - width // NEAR)
    while count((height, high)) < target:
        high += 1 + width // NEAR
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if count((height, middle)) <= target else (low, middle)
    best = min(counts, key=lambda each: abs(counts[each] - target))
    return replace(warp, resolution=best)
