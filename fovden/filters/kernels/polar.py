"""One pass of the à-trous filter on a polar raster, forwards and backwards; images are transposed.

See :mod:`fovden.filters.kernels.columns` for the strips, :mod:`fovden.filters.kernels.blend` and
:mod:`fovden.filters.kernels.gather` for what is done with them: the same, with a strip for a row of taps.

On the way back a column gathers, as a row of pixels does on the screen. Where it and another have one height and are
each other's taps, both directions are gathered at once. Elsewhere they are not symmetric: what a column has read is
gathered beside a strip of the other, which hands nothing back; and what the other has read of it is gathered for its
own strip, in the other's rows, and then added up in its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.filters.kernels.back import TAP_SUMS, WIDTH_SUMS, Gradients, hand_back
from fovden.filters.kernels.blend import (
    ALL_SCALES,
    ALL_SUMS,
    BLOCKS,
    SCALES,
    SUMS,
    ZERO,
    Guides,
    Passes,
    View,
    add_taps,
    finish_block,
    scale_block,
    view_of,
)
from fovden.filters.kernels.columns import (
    BACK,
    FORTH,
    Beside,
    aligned,
    clear_strip,
    find_rows,
    read_strip,
)
from fovden.filters.kernels.gather import GATHERED, NORMAL, WIDTHS, Shares, gather_taps
from fovden.filters.kernels.gather import SUMS as GATHER_SUMS
from fovden.filters.kernels.lanes import WIDTH
from fovden.jit import Int, inlined, kernel
from fovden.simd import advanced, pointer_to, stack_floats

# Channels of strips: radiance, normal and position, the mask; on the way back light and scales.
GUIDED, READ, LIGHT, SCALED, GATHERS = 9, 10, 10, 14, 17


@inlined
def room_for(channels: Int, places: Int, step: Int) -> Any:
    """An array of two strips of some channels, the places of one, and at which of them the second one's row 0 is.

    Row 0 begins a cache line, and channels are never a multiple of 4 KiB apart: all would meet in one set of a cache.
    """
    around = -(-2 * step // WIDTH) * WIDTH
    longest = (-(-places // WIDTH) * WIDTH + 2 * around) | WIDTH
    return aligned(np.empty(channels * 2 * longest + WIDTH, np.float32)), longest, around


@inlined
def inner_blocks(first: Int, blocks: Int, height: Int, step: Int) -> Any:
    """Of the blocks from row ``first`` on, the first and the end of those whose taps do not go around."""
    begin = -(-max(0, 2 * step - first) // WIDTH)
    end = (height - 2 * step - first) // WIDTH
    return min(begin, blocks), max(min(begin, blocks), min(end, blocks))


@inlined
def part_of(view: View, strips: Any, apart: Int, direct: bool) -> View:
    """The view itself, or strips as one."""
    return View(
        view.image if direct else strips,
        view.mask if direct else advanced(strips, GUIDED * apart),
        view.known,
        view.normal if direct else advanced(strips, 3 * apart),
        view.position if direct else advanced(strips, 6 * apart),
        view.labels,
        view.factors,
        False,
        view.height,
        view.width,
        view.plane if direct else apart,
    )


@inlined
def read_guides(view: View, column: Int, rows: Any, count: Int, height: Int, agrees: bool, out: Any,
                out_plane: Int) -> None:  # fmt: skip
    """Reads a strip's radiance, normal, position and mask."""
    plane, at = view.plane, column * view.width
    for g in range(3):
        guide = advanced((view.image, view.normal, view.position)[g], at)
        read_strip(guide, plane, 3, rows, count, height, agrees, advanced(out, 3 * g * out_plane), out_plane)
    mask = advanced(view.mask, at)
    read_strip(mask, plane, 1, rows, count, height, agrees, advanced(out, GUIDED * out_plane), out_plane)


@kernel
def blend_columns(
    start: Int,
    stop: Int,
    beside: Beside,
    runs: Any,
    step: Int,
    passes: Passes,
    guides: Guides,
    image: Any,
    mask: Any,
    known: Any,
    out: Any,
    next_mask: Any,
    fills: bool,
    tape: Any,
) -> None:
    """Filters the blocks of the runs start .. stop - 1, which are parts of columns.

    Args:
        start: First run.
        stop: End of the runs.
        beside: Where the taps stand.
        runs: Column, counted through all views, first block, end of the blocks and number of the pass, (n, 4).
        step: Distance between taps.
        passes: The passes; their kernels are transposed, too.
        guides: What else is looked at.
        image: As in :func:`fovden.filters.kernels.blend.blend_runs`, transposed, like what follows.
        mask: As there.
        known: As there.
        out: As there.
        next_mask: As there.
        fills: As there.
        tape: As there.
    """
    strips, longest, around = room_for(READ, BLOCKS * WIDTH, step)
    rows, tapes = np.empty(longest, np.int64), tape.shape[0] > 0
    here, there, apart = pointer_to(strips), advanced(pointer_to(strips), longest + around), 2 * longest
    all_sums, all_scales = stack_floats(ALL_SUMS), stack_floats(ALL_SCALES)
    for run in range(start, stop):
        which, column = np.int64(runs[run, 0]) // image.shape[2], np.int64(runs[run, 0]) % image.shape[2]
        number, view = np.int64(runs[run, 3]), view_of(which, image, mask, known, guides)
        height, plane = beside.heights[column], view.plane
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        view_out = advanced(pointer_to(out), 3 * which * plane)
        view_next = advanced(pointer_to(next_mask), which * plane)
        view_tape = advanced(pointer_to(tape), tape.shape[1] * which * plane)
        for left in range(np.int64(runs[run, 1]), np.int64(runs[run, 2]), BLOCKS):
            first, blocks = left * WIDTH, min(BLOCKS, np.int64(runs[run, 2]) - left)
            at, length = column * view.width + first, np.int64(0)
            for k in range(blocks * SUMS):
                all_sums[k] = ZERO
            for block in range(blocks):
                x, scales = block * WIDTH, advanced(all_scales, SCALES * block)
                scale_block(
                    inverse, view.known, view.factors, view.has_factors, plane, at + x, first + x, height, scales
                )  # fmt: skip
            is_here = False
            for tap in range(5):
                other, turned = beside.column[tap, column], beside.turned[tap, column]
                its_height = beside.heights[other]
                agrees = its_height == height
                inner, end = inner_blocks(first, blocks, height, step) if agrees and turned == 0 else (blocks, blocks)
                for part in range(3):
                    begin, stop_ = (0, inner, end)[part], (inner, end, blocks)[part]
                    direct = part == 1
                    if begin == stop_:
                        continue
                    if not direct:
                        top = begin * WIDTH
                        if not is_here:
                            rows[0] = first + top
                            count = (stop_ - begin) * WIDTH
                            read_guides(view, column, rows, count, view.width, True, advanced(here, top), apart)
                            is_here = count == blocks * WIDTH
                        length = min(stop_ * WIDTH, height - first) - top + 4 * step
                        find_rows(first + top - 2 * step, 1 if agrees else length, height, its_height, turned, rows)
                        read_guides(
                            view, other, rows, length, its_height, agrees, advanced(there, top - 2 * step), apart
                        )
                    strip = part_of(view, here, apart, direct)
                    for block in range(begin, stop_):
                        x = block * WIDTH
                        own = at + x if direct else x
                        its = other * view.width + first + x if direct else longest + around + x
                        place = first + x if direct else x - begin * WIDTH + 2 * step
                        add_taps(
                            strip.image, strip.normal, strip.position, strip.mask, strip.plane, own, its, place,
                            height if direct else length, step, advanced(taps, 5 * tap),
                            advanced(all_scales, SCALES * block), advanced(all_sums, SUMS * block),
                        )  # fmt: skip
            for block in range(blocks):
                x = block * WIDTH
                finish_block(
                    advanced(all_sums, SUMS * block), view.image, view.known, view.labels, plane, at + x, first + x,
                    height, passes.labels[number], view_out, view_next, fills, view_tape, tapes,
                )  # fmt: skip


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
        start: First column, counted among those that have pairs.
        stop: End of the columns.
        heights: Number of rows of each column of the raster, (w).
        pairs: As of :meth:`fovden.filters.kernels.columns.Columns.pairs`.
        offsets: Where the pairs of each column begin, and end.
        number: Number of the pass.
        step: Distance between taps.
        passes: As in :func:`fovden.filters.kernels.back.gather_runs`, like what follows.
        guides: As there.
        image: As there.
        mask: As there.
        shares: As there.
        everything: As there.
        gradients: As there.
        width_sums: As there, for each column.
        tap_sums: As there, for each column.
    """
    strips, longest, around = room_for(GATHERS, image.shape[3], step)
    rows = np.empty(longest, np.int64)
    floats = aligned(np.empty(2 * image.shape[3] // WIDTH * GATHER_SUMS + WIDTH, np.float32))
    own_sums, its_sums = pointer_to(floats), advanced(pointer_to(floats), image.shape[3] // WIDTH * GATHER_SUMS)
    run_taps, run_widths = stack_floats(TAP_SUMS), stack_floats(WIDTH_SUMS)
    here, there, apart = pointer_to(strips), advanced(pointer_to(strips), longest + around), 2 * longest
    strip_shares = Shares(strips[LIGHT * apart :], strips[SCALED * apart :], shares.differ)
    inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
    view = view_of(0, image, mask, mask, guides)
    plane, width = view.plane, view.width
    strip_view = View(
        here, advanced(here, GUIDED * apart), here, advanced(here, 3 * apart), advanced(here, 6 * apart), view.labels,
        here, False, 1, longest, apart,
    )  # fmt: skip
    for item in range(start, stop):
        column = pairs[offsets[item], 0]
        height = heights[column]
        blocks = -(-height // WIDTH)
        for k in range(blocks * GATHER_SUMS):
            own_sums[k] = ZERO
        for k in range(TAP_SUMS):
            run_taps[k] = ZERO
        for k in range(WIDTH_SUMS):
            run_widths[k] = ZERO
        is_here = False
        for pair in range(offsets[item], offsets[item + 1]):
            other, turned, tap, kind = pairs[pair, 1], pairs[pair, 2], pairs[pair, 3], pairs[pair, 4]
            frame = heights[other] if kind == BACK else height
            count, length = -(-frame // WIDTH), frame + 4 * step
            agrees = heights[other] == frame
            wanted = 1 if agrees else length
            find_rows(-2 * step, wanted, frame, heights[other], turned if kind == FORTH else 0, rows)
            begin = advanced(there, -2 * step)
            read_all(view, shares, other, rows, length, heights[other], agrees, kind != FORTH, begin, apart)
            if kind == BACK or not is_here:
                find_rows(0, count * WIDTH, frame, height, turned if kind == BACK else 0, rows)
                read_all(view, shares, column, rows, count * WIDTH, height, frame == height, kind != BACK, here, apart)
                clear_strip(4, count * WIDTH - frame, advanced(here, LIGHT * apart + frame), apart)  # beyond the end
                is_here = kind != BACK
            if kind == BACK:
                for k in range(count * GATHER_SUMS):
                    its_sums[k] = ZERO
            frame_sums = its_sums if kind == BACK else own_sums
            for block in range(count):
                x = block * WIDTH
                gather_taps(
                    with_width(strip_view, length), strip_shares, everything, x, longest + around + x, 2 * step + x,
                    step, inverse, advanced(taps, 5 * tap), advanced(taps, 20 - 5 * tap),
                    advanced(frame_sums, GATHER_SUMS * block), advanced(run_taps, 5 * WIDTH * tap),
                )  # fmt: skip
            if kind == BACK:
                fold(its_sums, rows, frame, everything, own_sums)
        for block in range(blocks):
            x, sums = block * WIDTH, advanced(own_sums, GATHER_SUMS * block)
            hand_back(sums, shares.differ, everything, plane, column * width + x, x, height, gradients)
            for k in range(WIDTH_SUMS):
                run_widths[k] += sums[WIDTHS * WIDTH + k]
        for lane in range(WIDTH):
            if shares.differ:
                for tap in range(25):
                    tap_sums[item, tap] += run_taps[tap * WIDTH + lane]
            else:
                for g in range(3):
                    width_sums[item, g] -= run_widths[g * WIDTH + lane]


@inlined
def with_width(view: View, width: Int) -> View:
    """A view of rows of another length."""
    return View(
        view.image, view.mask, view.known, view.normal, view.position, view.labels, view.factors, view.has_factors,
        view.height, width, view.plane,
    )  # fmt: skip


@inlined
def read_all(view: View, shares: Shares, column: Int, rows: Any, count: Int, height: Int, agrees: bool, shines: bool,
             out: Any, out_plane: Int) -> None:  # fmt: skip
    """Reads a strip with what its pixels hand back, which is nothing unless it ``shines``."""
    read_guides(view, column, rows, count, height, agrees, out, out_plane)
    at = column * view.width
    if shines:
        light = advanced(pointer_to(shares.light), at)
        read_strip(light, view.plane, 4, rows, count, height, agrees, advanced(out, LIGHT * out_plane), out_plane)
    else:
        clear_strip(4, count, advanced(out, LIGHT * out_plane), out_plane)
    if shares.differ:
        scales = advanced(pointer_to(shares.scales), at)
        read_strip(scales, view.plane, 3, rows, count, height, agrees, advanced(out, SCALED * out_plane), out_plane)


@inlined
def fold(sums: Any, rows: Any, count: Int, everything: bool, own_sums: Any) -> None:
    """Adds the sums of a strip's rows to those of the column's rows that they are."""
    for j in range(count):
        row = rows[j]
        source, target = j // WIDTH * GATHER_SUMS + j % WIDTH, row // WIDTH * GATHER_SUMS + row % WIDTH
        for k in range(3):
            own_sums[target + k * WIDTH] += sums[source + k * WIDTH]
        if everything:
            for k in range(NORMAL, GATHERED):
                own_sums[target + k * WIDTH] += sums[source + k * WIDTH]
