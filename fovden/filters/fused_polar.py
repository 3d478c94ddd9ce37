"""A stack of à-trous passes on a polar raster, on compiled kernels, forwards and backwards: float32, on the CPU.

Columns of the raster are distances from the gaze, and end at heights of their own; rows are angles, and go around. The
tap (dx, dy) of cell (i, j) stands in column i' = i + dx, clamped at the rim, and at the gaze either clamped or, on the
other side of it, -1 - i'. Its row holds the same angle as row j + dy of column i,

    j' = floor((j + 1/2 + dy + turned h_i / 2) h_i' / h_i) mod h_i',

where turned is 1 on the other side (the rule of :meth:`fovden.foveation.PolarWarp.neighbour`). All taps exist.

Images are transposed once for all passes, so that angles run along memory. Then a column is to a filter what a row of
pixels is, and :mod:`fovden.filters.fused` works on it: a column of the same height as it lies, and another one as a
strip of it that is made for the column that looks. What lies below a column's height is never read and comes out as 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from fovden.checks import require, require_shapes
from fovden.filters.fused import Blended, Inputs, Returned, blend_stack, return_gradients
from fovden.filters.kernels.columns import Columns, transpose
from fovden.filters.kernels.lanes import WIDTH
from fovden.parallel import run

__all__ = ["blend_polar_stack", "places_of", "return_polar_gradients"]

NOWHERE = 31
"""The label of what is no cell; no pass has it."""

TILE = 4
"""Bands of sixteen rows or columns that a thread transposes at a time, of some tens of microseconds each."""


def blend_polar_stack(inputs: Inputs, heights: Tensor, rotate: bool, *, save: bool = False) -> Blended:
    """Runs the passes on a polar raster.

    Args:
        inputs: What they read, images of shape (v, c, h, w) with a column for each distance.
        heights: Number of cells of each column, from 1 to h, int64, shape (w,).
        rotate: Whether what lies before column 0 is the column on the other side of the gaze, instead of column 0.
        save: Whether to keep what the way back needs.

    Returns:
        The outcome, 0 below the columns' heights; the last two dimensions of ``images`` and ``totals`` are w and p, of
        :func:`places_of`.

    Raises:
        ShapeError: If there is not one height for each column.
        ValueError: If a height is out of range.

    Example:
        >>> flat, row, mask = torch.zeros(1, 3, 4, 3), torch.ones(1, 3), torch.ones(1, 1, 4, 3)
        >>> two = Inputs(flat + 2, flat, flat, mask, None, None, row, None, None, (2, 1), (0, 0), (0, 1), False)
        >>> blend_polar_stack(two, torch.tensor([1, 3, 4]), rotate=False).image[0, 0]
        tensor([[2., 2., 2.],
                [0., 2., 2.],
                [0., 2., 2.],
                [0., 0., 2.]])
    """
    columns = _columns(inputs, heights, rotate)
    blended = blend_stack(_transposed(inputs, columns), save=save, columns=columns)
    height = inputs.mask.shape[2]
    return Blended(
        _back(blended.image, columns, height),
        _back(blended.known.view(torch.uint8), columns, height).view(torch.bool),
        _back(blended.mask, columns, height) if inputs.fill else inputs.mask,
        blended.images,
        blended.totals,
    )


def return_polar_gradients(
    inputs: Inputs,
    heights: Tensor,
    rotate: bool,
    blended: Blended,
    gradient: Tensor,
    mask_gradient: Tensor | None = None,
    *,
    everything: bool = True,
) -> Returned:
    """Returns the gradients of all inputs, from those of the outcome, on a polar raster.

    Args:
        inputs: What the passes have read.
        heights: As in :func:`blend_polar_stack`.
        rotate: As there.
        blended: Their outcome, with what was saved of it.
        gradient: Gradient of the image, shape (v, 3, h, w).
        mask_gradient: Gradient of the mask, shape (v, 1, h, w), where passes fill it; ``None`` for 0.
        everything: Whether those of normal, position and mask are wanted.

    Returns:
        The gradients, 0 below the columns' heights.

    Raises:
        ShapeError: If there is not one height for each column.
        ValueError: If a height is out of range.

    Example:
        >>> flat, row, mask = torch.zeros(1, 3, 4, 3), torch.ones(1, 3), torch.ones(1, 1, 4, 3)
        >>> one = Inputs(flat + 2, flat, flat, mask, None, None, row, None, None, (1,), (0,), (0,), False)
        >>> heights = torch.tensor([1, 3, 4])
        >>> blended = blend_polar_stack(one, heights, rotate=False, save=True)
        >>> round(return_polar_gradients(one, heights, False, blended, flat + 1).radiance.sum().item(), 4)
        24.0
    """
    columns = _columns(inputs, heights, rotate)
    returned = return_gradients(
        _transposed(inputs, columns),
        blended._replace(image=_forth(blended.image, columns)),
        _forth(gradient, columns),
        None if mask_gradient is None else _forth(mask_gradient, columns),
        everything=everything,
        columns=columns,
    )
    names = "radiance", "normal", "position", "mask", "factors"
    planes = {name: getattr(returned, name) for name in names}
    height = inputs.mask.shape[2]
    turned = {name: _back(plane, columns, height) for name, plane in planes.items() if plane is not None}
    if returned.kernels is not None:
        turned["kernels"] = returned.kernels.transpose(1, 2).contiguous()
    return returned._replace(**turned)


def places_of(height: int) -> int:
    """Returns how many places a column of a raster has in memory: whole blocks, so that each begins a cache line.

    Args:
        height: Rows of the raster.

    Returns:
        The height, rounded up to a multiple of 16.

    Example:
        >>> places_of(900)
        912
    """
    return -(-height // WIDTH) * WIDTH


def _columns(inputs: Inputs, heights: Tensor, rotate: bool) -> Columns:
    height, width = inputs.mask.shape[2:]
    require_shapes("w", {"w": width}, heights=heights)
    least, most = int(heights.min()), int(heights.max())
    require(least >= 1 and most <= height, "heights", f"{least} to {most}", f"1 to {height}, the raster's height")
    return Columns(np.array(heights.detach().numpy(), np.int64), rotate)


def _transposed(inputs: Inputs, columns: Columns) -> Inputs:
    """The inputs with columns as rows of memory; what is no cell has a label of its own."""
    views, _, height, _ = inputs.mask.shape
    exists = np.arange(places_of(height)) < columns.heights[:, None]
    labels = np.zeros((views, 1, *exists.shape), np.uint8)
    if inputs.region is not None:
        labels = _forth(inputs.region, columns).numpy()
    labels[..., ~exists] = NOWHERE
    return replace(
        inputs,
        radiance=_forth(inputs.radiance, columns),
        normal=_forth(inputs.normal, columns),
        position=_forth(inputs.position, columns),
        mask=_forth(inputs.mask, columns),
        known=None if inputs.known is None else _forth(inputs.known, columns),
        region=torch.from_numpy(labels),
        factors=None if inputs.factors is None else _forth(inputs.factors, columns),
        kernels=None if inputs.kernels is None else inputs.kernels.transpose(1, 2),
    )


def _forth(image: Tensor, columns: Columns) -> Tensor:
    """An image, (v, c, h, w), as (v, c, w, p); flags and labels stay bytes."""
    source = image.detach().contiguous()
    if source.dtype == torch.bool:
        source = source.view(torch.uint8)
    return _transpose(source, columns, (image.shape[3], places_of(image.shape[2])), back=False)


def _back(image: Tensor, columns: Columns, height: int) -> Tensor:
    """And back."""
    return _transpose(image, columns, (height, image.shape[2]), back=True)


def _transpose(source: Tensor, columns: Columns, size: tuple[int, int], *, back: bool) -> Tensor:
    planes = source.numpy().reshape(-1, *source.shape[2:])
    target = np.empty((len(planes), *size), planes.dtype)
    run(transpose, len(planes) * -(-size[0] // WIDTH), (planes, columns.heights, back, target), tile=TILE)
    return torch.from_numpy(target).view(*source.shape[:2], *size)
