"""One pass of the à-trous filter on a polar raster, backwards: the gathering; images are transposed.

See :mod:`fovden.filters.kernels.gather` for the formulas. A column gathers, as a row of pixels does on the screen.
Where it and another have one height and are each other's taps, both directions are gathered at once. Elsewhere they are
not symmetric: what a column has read is gathered beside a strip of the other, which hands nothing back; and what the
other has read of it is gathered for its own strip, in the other's rows, and then added up in its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.filters.kernels.blend import CHANNELS, MASK, NORMAL, Guides, Passes, View, view_of
from fovden.filters.kernels.columns import BACK, FORTH, aligned, clear_strip, find_rows, read_strip
from fovden.filters.kernels.gather import gather_differing, gather_row
from fovden.filters.kernels.hand_back import Gradients, gradients_of, hand_back
from fovden.filters.kernels.lanes import WIDTH, ZERO, opaque
from fovden.filters.kernels.pairs import SCRAP
from fovden.filters.kernels.polar import Desk, desk_for, read_guides
from fovden.filters.kernels.shares import (
    ALL_CHANNELS,
    BLOCK_SUMS,
    LIGHT,
    MOVED,
    SCALES,
    SUMS,
    TAP_SUMS,
    WIDTHS,
    Shares,
    handed_of,
    read_from,
    write_factors,
)
from fovden.jit import Int, inlined, kernel
from fovden.simd import advanced, pointer_to, stack_floats

HALF = np.float32(0.5)


@inlined
def read_pair(
    view: View, shares: Shares, desk: Desk, heights: Any, step: Int, column: Int, other: Int, turned: Int, kind: Int,
    is_here: bool,
) -> None:  # fmt: skip
    """Reads the strips of a column and of another one; then ``desk.rows`` has the column's rows, if it has been read.

    Both have the rows of the one that looks: of the other where that has read the column, of the column itself
    elsewhere, and then it need not be read again.
    """
    height, its_height = heights[column], heights[other]
    frame = its_height if kind == BACK else height
    count = -(-frame // WIDTH) * WIDTH  # whole blocks: what lies beyond the end goes around
    length = count + 4 * step
    agrees = its_height == frame
    find_rows(-2 * step, 1 if agrees else length, frame, its_height, turned if kind == FORTH else 0, desk.rows)
    read_all(view, shares, other, length, its_height, agrees, kind != FORTH, desk, desk.there - 2 * step)
    if not is_here:
        find_rows(0, count, frame, height, turned if kind == BACK else 0, desk.rows)
        read_all(view, shares, column, count, height, frame == height, kind != BACK, desk, 0)
        end = advanced(pointer_to(desk.strips), MASK * desk.apart + frame)
        clear_strip(5, count - frame, end, desk.apart)  # beyond the end, nothing weighs or hands anything back


@inlined
def read_all(
    view: View, shares: Shares, column: Int, count: Int, height: Int, agrees: bool, shines: bool, desk: Desk, place: Int
) -> None:
    """Reads a strip with what its cells hand back, pointers to its view's, which is nothing unless it ``shines``."""
    read_guides(view, column, desk.rows, count, height, agrees, desk, place)
    at, apart, out = column * view.width, desk.apart, advanced(pointer_to(desk.strips), place)
    light = advanced(out, LIGHT * apart)
    if shines:
        read_strip(advanced(shares.light, at), view.plane, 4, desk.rows, count, height, agrees, light, apart)
    else:
        clear_strip(4, count, light, apart)
    if shares.differ:
        scales = advanced(out, SCALES * apart)
        read_strip(advanced(shares.scales, at), view.plane, 3, desk.rows, count, height, agrees, scales, apart)


@inlined
def fold(sums: Any, rows: Any, count: Int, everything: bool, own_sums: Any) -> None:
    """Adds the sums of a strip's rows to those of the column's rows that they are."""
    for j in range(count):
        row = rows[j]
        source, target = j // WIDTH * BLOCK_SUMS + j % WIDTH, row // WIDTH * BLOCK_SUMS + row % WIDTH
        for k in range(3):
            own_sums[target + k * WIDTH] += sums[source + k * WIDTH]
            own_sums[target + (MOVED + k) * WIDTH] += sums[source + (MOVED + k) * WIDTH]
            own_sums[target + SUMS + k * WIDTH] += sums[source + SUMS + k * WIDTH]
        if everything:
            for k in range(NORMAL, CHANNELS):
                own_sums[target + k * WIDTH] += sums[source + k * WIDTH]


@kernel
def gather_columns(
    start: Int,
    stop: Int,
    heights: Any,
    pairs: Any,
    offsets: Any,
    number: Int,
    step: Int,
    passes: Passes,
    guides: Guides,
    image: Any,
    mask: Any,
    shares: Shares,
    everything: bool,
    gradients: Gradients,
    width_sums: Any,
    tap_sums: Any,
) -> None:
    """Gathers gradients in columns, of those of their pairs.

    Args:
        start: First column, counted among those that have pairs, through all views.
        stop: End of the columns.
        heights: Number of rows of each column of the raster, (w).
        pairs: As of :meth:`fovden.filters.kernels.columns.Columns.pairs`.
        offsets: Where the pairs of each column begin, and end.
        number: Number of the pass.
        step: Distance between taps.
        passes: As in :func:`fovden.filters.kernels.gather_rows.gather_runs`, like what follows.
        guides: As there.
        image: As there.
        mask: As there.
        shares: As there.
        everything: As there.
        gradients: As there.
        width_sums: As there, for each column.
        tap_sums: As there, for each column.
    """
    desk = desk_for(ALL_CHANNELS, image.shape[3], step)
    room = image.shape[3] // WIDTH * BLOCK_SUMS
    floats = aligned(np.empty(2 * room + WIDTH, np.float32))
    run_taps, run_widths = stack_floats(TAP_SUMS), stack_floats(WIDTHS)
    scrap = stack_floats(SCRAP)
    inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
    factors, count = stack_floats(3), len(offsets) - 1
    write_factors(shares.differ, inverse, factors)
    for item in range(start, stop):
        which, among = item // count, item % count
        view = view_of(which, image, mask, mask, guides)
        handed, its = handed_of(which, shares, view.plane), gradients_of(which, gradients, view.plane)
        first, end = offsets[among], offsets[among + 1]
        column = pairs[first, 0]
        height, at = heights[column], column * view.width
        for k in range(room):
            floats[k] = ZERO
        for k in range(TAP_SUMS):
            run_taps[k] = ZERO
        for k in range(WIDTHS):
            run_widths[k] = ZERO
        for pair in range(first, end):
            other, turned, tap, kind = pairs[pair, 1], pairs[pair, 2], pairs[pair, 3], pairs[pair, 4]
            own = kind != BACK  # these come first
            read_pair(view, handed, desk, heights, step, column, other, turned, kind, own and pair > first)
            frame = height if own else heights[other]
            sums = advanced(pointer_to(floats), 0 if own else room)
            if not own:
                for k in range(-(-frame // WIDTH) * BLOCK_SUMS):
                    sums[k] = ZERO
            read = read_from(pointer_to(desk.strips), desk.apart)
            row_taps, back = advanced(taps, 5 * tap), advanced(taps, 20 - 5 * tap)
            for counter in range(-(-frame // WIDTH)):
                block = opaque(counter)
                x, place = block * WIDTH, advanced(sums, BLOCK_SUMS * block)
                widths = advanced(place, SUMS)
                if shares.differ:
                    tap_place = advanced(run_taps, 5 * WIDTH * tap)
                    gather_differing(read, x, desk.there + x, step, row_taps, back, place, widths, tap_place)
                else:
                    gather_row(
                        read, everything, x, desk.there + x, step, inverse, row_taps, place, widths, scrap, WIDTH
                    )
            if not own:
                fold(sums, desk.rows, frame, everything, pointer_to(floats))
        for block in range(-(-height // WIDTH)):
            x, sums = block * WIDTH, advanced(pointer_to(floats), BLOCK_SUMS * block)
            hand_back(sums, factors, shares.differ, everything, view.mask, view.plane, at + x, x, height, its)
            for k in range(WIDTHS):
                run_widths[k] += sums[SUMS + k]
        for lane in range(WIDTH):
            if shares.differ:
                for tap in range(25):
                    tap_sums[item, tap] += run_taps[tap * WIDTH + lane]
            else:
                for g in range(3):
                    width_sums[item, g] -= HALF * run_widths[g * WIDTH + lane]  # each pair came twice
