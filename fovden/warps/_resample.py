"""From cells to pixels: which cells a pixel reads and with what weight, as a linear map with an exact adjoint.

Where no more than a cell falls on a pixel, the pixel reads four cells. Elsewhere it reads the box of its footprint:
every column that the footprint touches, weighted by the overlap, and in each column the mean over an arc. An arc's mean
is a difference of two running sums around the circle, so that its cost does not depend on its length; sums run in
float64, where cells that differ by a factor of 10^8 leave each other alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from fovden.camera import pixel_centres
from fovden.warps._kept import for_each_view

if TYPE_CHECKING:
    from fovden.warps.base import Prefilter
    from fovden.warps.polar import PolarWarp

TURN = 2 * torch.pi


class Footprints(NamedTuple):
    """What pixels cover in the raster, float64, each of shape (n,)."""

    column: Tensor  # column coordinate of the centre
    first: Tensor  # column coordinates where the footprint begins and ends, a column apart or more
    last: Tensor
    angle: Tensor  # of the centre, in turns
    arc: Tensor  # share of the circle, at most 1

    def select(self, index: Tensor) -> Footprints:
        """Those of some pixels."""
        return Footprints(*(each[index] for each in self))


class Arcs(NamedTuple):
    """Boxes over columns' arcs: one for each column that a pixel's footprint touches."""

    pixel: Tensor  # which of the pixels it belongs to, int64
    column: Tensor  # int64
    begin: Tensor  # row coordinates in the column's own height, float64
    end: Tensor
    weight: Tensor  # share of the column in the footprint


class Resampling(NamedTuple):
    """The map from the cells of one view to its pixels."""

    resolution: tuple[int, int]
    heights: Tensor
    near: Tensor  # pixels that read four cells
    cells: Tensor  # (4, near) row-major numbers of cells
    weights: Tensor  # (4, near)
    wide: Tensor  # pixels that read arcs
    arcs: Arcs


def composed(warp: PolarWarp, image: Tensor, prefilter: Prefilter) -> Tensor:
    """Values of pixels, (v, c, height, width), from values of cells: on any device, and in any floating type."""
    plans = for_each_view(warp, f"plan {prefilter}", lambda view: resampling(view, prefilter))
    out = torch.stack([resample(plan, each) for plan, each in zip(plans, image, strict=True)])
    return out.reshape(*out.shape[:2], *warp.screen)


def divided(image: Tensor) -> Tensor:
    """All channels but the last, divided by it; 0 where it is."""
    total = image[:, -1:]
    counts = total > torch.finfo(image.dtype).tiny
    return torch.where(counts, image[:, :-1] / torch.where(counts, total, 1.0), 0.0)


def resampling(warp: PolarWarp, prefilter: Prefilter) -> Resampling:
    """The map of a warp with one view."""
    found = footprints(warp, prefilter)
    column = (found.column - 0.5).detach().floor().long()
    sides = [warp.topology.column(column), warp.topology.column(column + 1)]
    tallest = torch.maximum(*(warp.heights[inside] for inside, _ in sides))
    # A footprint within one column's width and one cell's height is the box of one cell: bilinear interpolation.
    narrow = (found.first >= found.column - 0.5) & (found.last <= found.column + 0.5) & (found.arc * tallest <= 1)
    near, wide = (narrow.nonzero().squeeze(1), (~narrow).nonzero().squeeze(1))
    kept = found.select(near)
    across = kept.column - 0.5 - column[near]
    cells, weights = [], []
    for share, (inside, turned) in zip((1 - across, across), sides, strict=True):
        height = warp.heights[inside[near]]
        y = (kept.angle + 0.5 * turned[near]) * height - 0.5
        row = y.detach().floor().long()
        for each, weight in ((row, 1 - (y - row)), (row + 1, y - row)):
            cells.append((each % height) * warp.resolution[1] + inside[near])
            weights.append(share * weight)
    arcs = find_arcs(warp, found.select(wide))
    return Resampling(warp.resolution, warp.heights, near, torch.stack(cells).int(), torch.stack(weights), wide, arcs)


def footprints(warp: PolarWarp, prefilter: Prefilter) -> Footprints:
    """The footprints of the pixels of a warp with one view, in row-major order."""
    distance, angle = (each[0] for each in warp.polar(pixel_centres(warp.screen).to(warp.gaze.pixels)[None]))

    def columns(at: Tensor) -> Tensor:
        return warp.to_fraction(at[None])[0] * warp.resolution[1]

    column = columns(distance)
    first, last = column - 0.5, column + 0.5
    if prefilter == "area":
        inner = columns((distance - 0.5).abs())
        beyond = distance < 0.5  # the pixel reaches over the gaze, to where the raster has its other side
        inner = torch.where(beyond, -inner if warp.fovea_border == "rotate" else 0.0, inner)
        first = torch.minimum(first, inner)
        last = torch.maximum(last, columns(distance + 0.5).clamp(max=warp.resolution[1]))
    arc = (distance == 0).to(distance) if prefilter == "none" else 1 / (TURN * distance).clamp(min=1)
    return Footprints(column, first, last, angle / TURN, arc)


def find_arcs(warp: PolarWarp, found: Footprints) -> Arcs:
    """The arcs of footprints, pixel by pixel."""
    start = found.first.detach().floor().long()
    count = found.last.detach().ceil().long() - start
    pixel = torch.repeat_interleave(count)
    place = torch.arange(len(pixel), device=pixel.device) - (count.cumsum(0) - count)[pixel]
    column = start[pixel] + place
    first, last = found.first[pixel], found.last[pixel]
    weight = (torch.minimum(last, column + 1.0) - torch.maximum(first, column.double())) / (last - first)
    inside, turned = warp.topology.column(column)
    height = warp.heights[inside]
    middle = (found.angle[pixel] + 0.5 * turned) * height
    half = (found.arc[pixel] * height).clamp(min=1) / 2
    return Arcs(pixel, inside, middle - half, middle + half, weight)


def resample(plan: Resampling, image: Tensor) -> Tensor:
    """Values of pixels, shape (c, n), from values of one view's cells, shape (c, h, w)."""
    channels = image.shape[0]
    table = image.reshape(channels, -1).T.contiguous()
    out = table.new_zeros(len(plan.near) + len(plan.wide), channels)
    near = table.new_zeros(())
    for cells, weights in zip(plan.cells, plan.weights.to(image.dtype), strict=True):
        near = near + table.index_select(0, cells) * weights[:, None]
    out = out.index_copy(0, plan.near, near) if len(plan.near) else out
    if len(plan.wide) == 0:
        return out.T
    values = arc_means(plan, image) * plan.arcs.weight[:, None]
    sums = values.new_zeros(len(plan.wide), channels).index_add(0, plan.arcs.pixel, values)
    return out.index_copy(0, plan.wide, sums.to(image.dtype)).T


def arc_means(plan: Resampling, image: Tensor) -> Tensor:
    """Means over arcs, float64, shape (arcs, c): cells are constant, and the circle closes."""
    arcs, channels = plan.arcs, image.shape[0]
    width = int(arcs.column.max()) + 1
    sums = torch.nn.functional.pad(image[..., :width].double().cumsum(dim=1), (0, 0, 1, 0))
    table = sums.reshape(channels, -1).T.contiguous()
    height = plan.heights[arcs.column]

    def running(y: Tensor) -> Tensor:
        turns = torch.div(y.detach(), height, rounding_mode="floor")
        within = y - turns * height
        row = within.detach().floor().long().clamp(max=height - 1)
        low, high = (table.index_select(0, each * width + arcs.column) for each in (row, row + 1))
        whole = table.index_select(0, height * width + arcs.column)
        return turns[:, None] * whole + low + (within - row)[:, None] * (high - low)

    return (running(arcs.end) - running(arcs.begin)) / (arcs.end - arcs.begin)[:, None]
