"""From cells to pixels and, with the same weights, back: a linear map and its adjoint.

Cells are packed column by column and four channels together, so that an arc is one run of memory. On the way back
threads work on rings around the gaze. A ring's pixels write to cells of few columns, into memory of the ring's own; the
sums over rings are taken in their order. Neither depends on the number of threads.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import advanced, pointer_to, stack_floats
from fovden.warps.kernels.curves import floor_of, sides_of
from fovden.warps.kernels.footprints import (
    RUN,
    Eye,
    Taps,
    View,
    arc_of,
    column_of,
    find_taps,
    taps_on_the_stack,
    turned_by,
    view_of,
)
from fovden.warps.kernels.lanes import LANES, add_to_cell, with_cell, with_cell_exactly

BLOCK = 16
"""Columns that are packed at a time: a cache line of a row."""


class Rings(NamedTuple):
    """A partition of pixels by their distance from the gaze.

    Attributes:
        distances: Where rings begin, and the last one ends, float64, shape (n + 1,).
        columns: First column that a ring's pixels read, and the one after the last, int64, shape (n, 2).
        places: Number of cells in the columns of the rings before, and of all, int64, shape (n + 1,).
    """

    distances: Any
    columns: Any
    places: Any


@kernel
def pack_columns(start: Int, stop: Int, eye: Eye, image: Any, packed: Any) -> None:
    """Packs blocks of columns of one view's image (c, h, w) into (groups, cells, 4)."""
    channels, _, width = image.shape
    for block in range(start, stop):
        first, last = block * BLOCK, min(block * BLOCK + BLOCK, width)
        tallest = np.int64(0)
        for column in range(first, last):
            tallest = max(tallest, eye.heights[column])
        for group in range(packed.shape[0]):
            for row in range(tallest):
                for column in range(first, last):
                    if row < eye.heights[column]:
                        cell = eye.offsets[column] + row
                        for lane in range(LANES):
                            channel = group * LANES + lane
                            packed[group, cell, lane] = image[channel, row, column] if channel < channels else 0.0


@inlined
def box_of(view: View, taps: Taps, i: Int, side: Int, arc: Float) -> Any:
    """What a footprint has of a column.

    That is its first cell, the end of the column's cells and their number; then the first row, and where the arc begins
    and ends, in rows that go on around the circle; and the weight of a whole cell.
    """
    inside = column_of(view, side)
    height, offset = view.heights[inside], view.offsets[inside]
    length = max(arc * height, 1.0)
    begin = (taps.turns[i] + turned_by(view, side)) * height - 0.5 * length
    first, last = taps.firsts[i], taps.lasts[i]
    share = (min(last, side + 1.0) - max(first, np.float64(side))) / ((last - first) * length)
    row = floor_of(begin)
    wrapped = row + height if row < 0 else (row - height if row >= height else row)
    return offset + wrapped, offset + height, height, row, begin, begin + length, share


@inlined
def read_box(view: View, cells: Any, taps: Taps, i: Int) -> Any:
    """The mean over a footprint, in float64: there may be many cells."""
    arc = arc_of(view.prefilter, taps.distances[i])
    sums = (0.0, 0.0, 0.0, 0.0)
    for side in range(floor_of(taps.firsts[i]), -floor_of(-taps.lasts[i])):
        cell, bottom, height, row, begin, end, share = box_of(view, taps, i, side, arc)
        while row < end:
            weight = share * (min(end, row + 1.0) - max(begin, np.float64(row)))
            sums = with_cell_exactly(cells, cell, weight, sums)
            row, cell = row + 1, cell + 1
            cell = cell if cell < bottom else cell - height
    return np.float32(sums[0]), np.float32(sums[1]), np.float32(sums[2]), np.float32(sums[3])


@inlined
def add_box(view: View, cells: Any, taps: Taps, i: Int, values: Any) -> None:
    """Adds to the cells of a footprint what :func:`read_box` takes of them."""
    arc = arc_of(view.prefilter, taps.distances[i])
    for side in range(floor_of(taps.firsts[i]), -floor_of(-taps.lasts[i])):
        cell, bottom, height, row, begin, end, share = box_of(view, taps, i, side, arc)
        while row < end:
            weight = np.float32(share * (min(end, row + 1.0) - max(begin, np.float64(row))))
            add_to_cell(cells, cell, weight, values)
            row, cell = row + 1, cell + 1
            cell = cell if cell < bottom else cell - height


@kernel
def gather_rows(start: Int, stop: Int, eye: Eye, packed: Any, screen: Any) -> None:
    """Reads the pixels of rows start .. stop - 1 of one view, (c, height, width)."""
    view, taps, read = view_of(eye, 0, len(eye.heights)), taps_on_the_stack(), stack_floats(256)
    channels, _, width = screen.shape
    zero = np.float32(0.0)
    for y in range(start, stop):
        for x in range(0, width, RUN):
            count = min(RUN, width - x)
            find_taps(view, x, y, taps)
            for group in range(packed.shape[0]):
                cells = advanced(pointer_to(packed), group * packed.shape[1] * LANES)
                for i in range(count):
                    if taps.kinds[i] == 0:
                        sums = read_box(view, cells, taps, i)
                    else:
                        sums = (zero, zero, zero, zero)
                        for k in range(i, taps.kinds[i] * RUN, RUN):
                            sums = with_cell(cells, np.int64(taps.ones[k]), taps.above[k], sums)
                            sums = with_cell(cells, np.int64(taps.twos[k]), taps.below[k], sums)
                    read[i], read[RUN + i], read[2 * RUN + i], read[3 * RUN + i] = sums
                for lane in range(min(LANES, channels - group * LANES)):
                    for i in range(count):
                        screen[group * LANES + lane, y, x + i] = read[lane * RUN + i]


@inlined
def scatter_run(
    view: View, taps: Taps, inner: Float, outer: Float, screen: Any, cells: Any, group: Int, y: Int, x: Int, end: Int
) -> None:
    """Adds the pixels of a run that lie in a ring to its cells."""
    channels = screen.shape[0]
    zero = np.float32(0.0)
    first = group * LANES
    for i in range(min(RUN, end - x)):
        if inner <= taps.distances[i] < outer:
            values = (
                screen[first, y, x + i],
                screen[first + 1, y, x + i] if first + 1 < channels else zero,
                screen[first + 2, y, x + i] if first + 2 < channels else zero,
                screen[first + 3, y, x + i] if first + 3 < channels else zero,
            )
            if taps.kinds[i] == 0:
                add_box(view, cells, taps, i, values)
            else:
                for k in range(i, taps.kinds[i] * RUN, RUN):
                    add_to_cell(cells, np.int64(taps.ones[k]), taps.above[k], values)
                    add_to_cell(cells, np.int64(taps.twos[k]), taps.below[k], values)


@kernel
def scatter_rings(start: Int, stop: Int, eye: Eye, rings: Rings, screen: Any, sums: Any) -> None:
    """Adds the pixels of rings start .. stop - 1 of one view, (c, height, width), to their cells, (groups, n, 4)."""
    taps = taps_on_the_stack()
    _, height, width = screen.shape
    for ring in range(start, stop):
        sums[:, rings.places[ring] : rings.places[ring + 1]] = 0.0
        inner, outer = rings.distances[ring], rings.distances[ring + 1]
        view = view_of(eye, rings.columns[ring, 0], rings.columns[ring, 1])
        place = rings.places[ring] - eye.offsets[rings.columns[ring, 0]]
        for y in range(height):
            dy = y + 0.5 - eye.y
            left, middle, beyond, right = sides_of(eye.x, dy, inner, outer, width)
            for side in range(2):
                first, end = (left, middle) if side == 0 else (beyond, right)
                for x in range(first, end, RUN):
                    find_taps(view, x, y, taps)
                    for group in range(sums.shape[0]):
                        cells = advanced(pointer_to(sums), (group * sums.shape[1] + place) * LANES)
                        scatter_run(view, taps, inner, outer, screen, cells, group, y, x, end)


@kernel
def add_rings(start: Int, stop: Int, eye: Eye, rings: Rings, sums: Any, image: Any) -> None:
    """Adds up the rings of blocks of columns, into one view's image (c, h, w); 0 where there is no cell."""
    channels, height, width = image.shape
    count = len(rings.columns)
    first_ring, last_ring = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64)
    for block in range(start, stop):
        first, last = block * BLOCK, min(block * BLOCK + BLOCK, width)
        for column in range(first, last):
            begin = np.int64(0)
            while begin < count and rings.columns[begin, 1] <= column:
                begin += 1
            end = begin
            while end < count and rings.columns[end, 0] <= column:
                end += 1
            first_ring[column - first], last_ring[column - first] = begin, end
        for channel in range(channels):
            group, lane = channel // LANES, channel % LANES
            for row in range(height):
                for column in range(first, last):
                    total = np.float32(0.0)
                    if row < eye.heights[column]:
                        for ring in range(first_ring[column - first], last_ring[column - first]):
                            place = rings.places[ring] + eye.offsets[column] - eye.offsets[rings.columns[ring, 0]]
                            total += sums[group, place + row, lane]
                    image[channel, row, column] = total
