"""Polar warps on compiled kernels: float32, on the CPU. What a new gaze needs takes a millisecond or a few."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from fovden.parallel import run
from fovden.warps._kept import for_each_view
from fovden.warps._tables import tabulate
from fovden.warps.kernels.curves import Table, place_cells, values_at
from fovden.warps.kernels.footprints import STEPS, Eye, sort_distances
from fovden.warps.kernels.lanes import LANES
from fovden.warps.kernels.resample import (
    BLOCK,
    Rings,
    add_rings,
    gather_rows,
    pack_columns,
    scatter_rings,
)

if TYPE_CHECKING:
    from fovden.warps.base import Prefilter
    from fovden.warps.polar import PolarWarp

PREFILTERS = ("none", "angle", "area")
TOLERANCE = 1e-7  # of a column, in the tables of laws
RING_COUNT = 32


class Geometry(NamedTuple):
    """What kernels know of one view of a warp, and the height and width of the screen."""

    eye: Eye
    rings: Rings
    screen: tuple[int, int]


def geometries(warp: PolarWarp, prefilter: Prefilter) -> list[Geometry]:
    """The geometry of each view of a warp."""
    return for_each_view(warp, prefilter, lambda view: geometry(view, prefilter))


def geometry(warp: PolarWarp, prefilter: Prefilter) -> Geometry:
    """The geometry of a warp with one view."""
    (x, y), (height, width) = warp.gaze.pixels[0].double().tolist(), warp.screen
    nearest = math.hypot(max(-x, x - width, 0.0), max(-y, y - height, 0.0))
    reach, columns = float(warp.reach), warp.resolution[1]

    def column(distance: Tensor) -> Tensor:
        return warp.to_fraction(distance[None])[0] * columns

    table = tabulate(column, max(nearest - 0.5, 0.0), reach + 0.5, TOLERANCE)
    count = STEPS * (len(table.starts) - 1)
    borders = _evaluated(table, table.origin + np.arange(count + 1) / STEPS)
    heights = np.ascontiguousarray(warp.heights.numpy())
    offsets = np.concatenate([[0], np.cumsum(heights)])
    kinds = np.zeros(count, np.uint8)
    eye = Eye(x, y, table, kinds, heights, offsets, warp.fovea_border == "rotate", PREFILTERS.index(prefilter))
    sort_distances(eye, borders)
    return Geometry(eye, _rings(eye, max(nearest - 1, 0.0), reach + 1), warp.screen)


def _rings(eye: Eye, nearest: float, farthest: float) -> Rings:
    """Rings of equal area, and the columns that their pixels can read."""
    distances = np.sqrt(np.linspace(nearest**2, farthest**2, RING_COUNT + 1))
    found, width = _evaluated(eye.table, np.stack([distances - 0.5, distances + 0.5])), len(eye.heights)
    # A pixel reads what lies half a pixel or half a column beside it; one column more is for rounding.
    first = np.floor(found[0, :-1] - 0.5).astype(np.int64) - 1
    last = np.ceil(found[1, 1:] + 0.5).astype(np.int64) + 1
    first = np.where(distances[:-1] <= 1, 0, first).clip(0, width - 1)
    last = last.clip(first + 1, width)
    places = np.concatenate([[0], np.cumsum(eye.offsets[last] - eye.offsets[first])])
    return Rings(distances, np.stack([first, last], axis=1), places)


def _evaluated(table: Table, x: Any) -> Any:
    values = np.empty(x.size)
    values_at(table, x.reshape(-1), values)
    return values.reshape(x.shape)


def to_pixels(views: list[Geometry], image: Tensor) -> Tensor:
    """Values of pixels, (v, c, height, width), from values of cells, (v, c, h, w)."""
    source = image.detach().contiguous().numpy()
    screen = np.empty((*source.shape[:2], *views[0].screen), np.float32)
    for (eye, _, (height, _)), cells, pixels in zip(views, source, screen, strict=True):
        packed = np.empty((-(-len(cells) // LANES), eye.offsets[-1], LANES), np.float32)
        run(pack_columns, -(-len(eye.heights) // BLOCK), (eye, cells, packed), tile=4)
        run(gather_rows, height, (eye, packed, pixels), tile=16)
    return torch.from_numpy(screen)


def to_cells(views: list[Geometry], screen: Tensor, rows: int) -> Tensor:
    """The adjoint: values of cells, (v, c, h, w), from values of pixels."""
    source = screen.detach().contiguous().numpy()
    image = np.empty((*source.shape[:2], rows, len(views[0].eye.heights)), np.float32)
    for (eye, rings, _), pixels, cells in zip(views, source, image, strict=True):
        sums = np.empty((-(-len(cells) // LANES), rings.places[-1], LANES), np.float32)
        run(scatter_rings, len(rings.columns), (eye, rings, pixels, sums), tile=1)
        run(add_rings, -(-len(eye.heights) // BLOCK), (eye, rings, sums, cells), tile=4)
    return torch.from_numpy(image)


def place(warp: PolarWarp, cells: Tensor) -> Tensor:
    """Points on the screen of cell coordinates, float32, (v, n, 2)."""
    source = cells.detach().contiguous().numpy()
    width, gazes = warp.resolution[1], warp.gaze.pixels.double().numpy()
    heights, points = warp.heights.numpy(), np.empty_like(source)
    tables = for_each_view(warp, "distances", distance_table)
    for table, gaze, own, found in zip(tables, gazes, source, points, strict=True):
        run(place_cells, len(own), (table, gaze, heights, own, found), tile=16384)
    beyond = (source[..., 0] < 0) | (source[..., 0] > width)
    if beyond.any():
        points[beyond] = warp._points(cells)[torch.from_numpy(beyond)].numpy()
    return torch.from_numpy(points)


def distance_table(warp: PolarWarp) -> Table:
    """Distances in pixels by the column coordinate, for a warp with one view."""
    width = warp.resolution[1]
    return tabulate(lambda x: warp.to_distance(x[None] / width)[0], 0, width, TOLERANCE)
