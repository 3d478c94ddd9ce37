"""One pass of the à-trous filter on the screen, forwards.

A row of taps is added to 256 pixels before the next one is looked at, so that what a row holds is read along, while it
is near. What pairs of pixels have in common is kept (:mod:`fovden.filters.kernels.pairs`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.filters.kernels.blend import (
    ALL_SCALES,
    ALL_SUMS,
    BLOCKS,
    CHANNELS,
    LOG2_E,
    MASK,
    NORMAL,
    ONE,
    POSITION,
    SCALES,
    SUMS,
    Guides,
    Passes,
    View,
    finish_block,
    scale_block,
    view_of,
)
from fovden.filters.kernels.columns import aligned
from fovden.filters.kernels.lanes import WIDTH, ZERO
from fovden.filters.kernels.pairs import (
    AFTER_NEXT,
    KEPT_ROWS,
    NEXT,
    Kept,
    begin_row,
    floats_to_keep,
    is_ready,
    kept_for,
    slot_in,
)
from fovden.filters.kernels.rows import (
    SLOTS,
    Rows,
    behind,
    copy_blocks,
    extent_of,
    floats_for,
    is_there,
    next_missing,
    reach_of,
    rows_for,
    slot_of,
)
from fovden.filters.kernels.weigh import add_kept, add_kept_beside, add_taps, weigh_beside
from fovden.jit import Int, inlined, kernel
from fovden.simd import advanced, pointer_to, prefetch, stack_floats, stack_words


@inlined
def is_symmetric(taps: Any) -> bool:
    """Whether a kernel is the same from either side."""
    symmetric = True
    for tap in range(12):
        symmetric = symmetric and taps[tap] == taps[24 - tap]
    return symmetric


@inlined
def are_shared(scales: Any, inverse: Any, count: Int) -> bool:
    """Whether so many pixels all have the pass's scale of radiance, and not 0 as those without a value of their own.

    The scales are asked, and not the values once more: another thread may have found one in the meantime.
    """
    shared = True
    for lane in range(count):
        shared = shared and scales[lane] == inverse[0] * -LOG2_E
    return shared


def scratch_for(blocks: int, step: int) -> int:
    """How many numbers a thread needs of its own for rows of some blocks."""
    return floats_for(blocks, step, CHANNELS) + floats_to_keep(blocks, step, 1)


@inlined
def copy_pixels(view: View, rows: Rows, y: Int, first: Int, end: Int) -> None:
    """Copies what some blocks of a row of taps are asked for."""
    copy_blocks(view.image, view.plane, 3, y, view.width, rows, 0, first, end)
    copy_blocks(view.normal, view.plane, 3, y, view.width, rows, NORMAL, first, end)
    copy_blocks(view.position, view.plane, 3, y, view.width, rows, POSITION, first, end)
    copy_blocks(view.mask, view.plane, 1, y, view.width, rows, MASK, first, end)


@inlined
def bring_pixels(view: View, rows: Rows, y: Int, name: Int, first: Int, end: Int) -> None:
    """Copies what taps of the blocks ``first`` to ``end`` find in a row, unless it is there."""
    reach = reach_of(rows.step)
    if is_there(rows, y, name, first - reach, end + reach):
        return
    block, stop = next_missing(rows, y, first - reach, end + reach)
    while block < stop:
        copy_pixels(view, rows, y, block, stop)
        block, stop = next_missing(rows, y, stop, end + reach)


@inlined
def ask_for(view: View, at: Int) -> None:
    """Has a block brought near that will be copied soon."""
    for k in range(3):
        prefetch(view.image, at + k * view.plane)
        prefetch(view.normal, at + k * view.plane)
        prefetch(view.position, at + k * view.plane)
    prefetch(view.mask, at)


@inlined
def begin_block(
    view: View, rows: Rows, kept: Kept, y: Int, block: Int, order: Int, own: Int, symmetric: bool, inverse: Any,
    taps: Any, scales: Any,
) -> bool:  # fmt: skip
    """Finds a block's scales; if all of its pixels have the same, keeps the powers of the taps beside them."""
    x = block * WIDTH
    at, soon = y * view.width + x, 3 * rows.step
    if y + soon < view.height:
        ask_for(view, at + soon * view.width)
    scale_block(inverse, view.known, view.factors, view.has_factors, view.plane, at, x, view.width, scales)
    shared = symmetric and not view.has_factors and are_shared(scales, inverse, min(WIDTH, view.width - x))
    if shared:
        base, apart = rows.floats, rows.apart
        lines = advanced(kept.floats, slot_in(kept, order) + x - rows.left)
        weigh_beside(
            base, advanced(base, NORMAL * apart), advanced(base, POSITION * apart), apart,
            own + x - rows.left, rows.step, advanced(taps, 10), scales, lines, apart,
        )  # fmt: skip
        kept.ready[order % KEPT_ROWS * kept.blocks + block] = ONE
    return shared


@inlined
def add_row(
    rows: Rows, kept: Kept, places: Any, j: Int, block: Int, order: Int, name: Int, shared: bool, taps: Any,
    scales: Any, sums: Any,
) -> None:  # fmt: skip
    """Adds the j-th of five rows of taps, at ``places``, to a block's sums, as it has been kept where it has been."""
    base, apart, x, step = rows.floats, rows.apart, block * WIDTH - rows.left, rows.step
    weights, tap, reach, away = advanced(base, MASK * apart), places[j] + x, reach_of(step), j - 2
    lines = advanced(kept.floats, x)
    if shared and j == 2 and is_ready(kept, order, name, block - reach, block):
        add_kept_beside(base, weights, apart, tap, step, taps, sums, advanced(lines, slot_in(kept, order)), apart)
    elif shared and j < 2 and is_ready(kept, order + away, name + away * step, block - reach, block + reach):
        its = advanced(lines, slot_in(kept, order + away) + (AFTER_NEXT if j == 0 else NEXT) * apart)
        add_kept(base, weights, apart, tap, step, taps, sums, its, apart)
    else:
        own, between = kept.scrap, np.int64(WIDTH)
        if j > 2:
            own, between = advanced(lines, slot_in(kept, order) + (NEXT if j == 3 else AFTER_NEXT) * apart), apart
        add_taps(
            base, advanced(base, NORMAL * apart), advanced(base, POSITION * apart), weights, apart, places[2] + x, tap,
            step, taps, scales, sums, own, between,
        )  # fmt: skip


@kernel
def blend_runs(
    start: Int,
    stop: Int,
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
    totals: Any,
    scratch: Any,
) -> None:
    """Filters the blocks of the runs start .. stop - 1.

    Args:
        start: First run.
        stop: End of the runs.
        runs: Row, counted through all views, first block, end of the blocks and number of the pass, (n, 4); in the
            order of :func:`fovden.filters.kernels.rows.in_order`, or little of what rows keep is of use.
        step: Distance between taps.
        passes: The passes.
        guides: What else is looked at.
        image: Radiance before the pass, (v, 3, h, w).
        mask: Weights of the taps, (v, 1, h, w).
        known: Above 0 where a pixel has a value of its own; becomes 1 where one is filled, (v, 1, h, w).
        out: Receives the radiance after the pass, (v, 3, h, w).
        next_mask: Receives 1 where a pixel is filled, if ``fills``, (v, 1, h, w).
        fills: Whether it does.
        totals: Receives the sums of weights, negative where a pixel had no value of its own, (v, 1, h, w); of no
            views if they are not needed.
        scratch: As many numbers as :func:`scratch_for` says, which no other thread uses.
    """
    if start == stop:
        return
    all_sums, all_scales = stack_floats(ALL_SUMS), stack_floats(ALL_SCALES)
    shared, places = stack_words(BLOCKS), stack_words(SLOTS)
    height, width = image.shape[2], image.shape[3]
    leftmost, rightmost = extent_of(runs, start, stop)
    floats = pointer_to(aligned(scratch))
    rows = rows_for(floats, CHANNELS, leftmost, rightmost, step)
    kept = kept_for(behind(rows), 1, rightmost, rows, -(-width // WIDTH))
    for run in range(start, stop):
        row, first = np.int64(runs[run, 0]), np.int64(runs[run, 1])
        end, number = np.int64(runs[run, 2]), np.int64(runs[run, 3])
        which, y, name = row // height, row % height, number * image.shape[0] * height + row
        view = view_of(which, image, mask, known, guides)
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        view_out = advanced(pointer_to(out), 3 * which * view.plane)
        view_next = advanced(pointer_to(next_mask), which * view.plane)
        view_totals = advanced(pointer_to(totals), which * view.plane)
        order, symmetric = y // step, is_symmetric(taps)
        begin_row(kept, order, name)
        for j in range(5):
            away = (j - 2) * step
            places[j] = slot_of(rows, y + away)
            if 0 <= y + away < height:
                bring_pixels(view, rows, y + away, row + away, first, end)
        for left in range(first, end, BLOCKS):
            count: Int = min(BLOCKS, end - left)
            for k in range(count * SUMS):
                all_sums[k] = ZERO
            for block in range(count):
                scales = advanced(all_scales, SCALES * block)
                shared[block] = np.int64(
                    begin_block(view, rows, kept, y, left + block, order, places[2], symmetric, inverse, taps, scales)
                )
            for j in range(5):
                if not 0 <= y + (j - 2) * step < height:
                    continue
                for block in range(count):
                    scales, sums = advanced(all_scales, SCALES * block), advanced(all_sums, SUMS * block)
                    add_row(
                        rows, kept, places, j, left + block, order, name, shared[block] > 0, advanced(taps, 5 * j),
                        scales, sums,
                    )  # fmt: skip
            for block in range(count):
                x = (left + block) * WIDTH
                finish_block(
                    advanced(all_sums, SUMS * block), view.image, view.known, view.labels, view.plane, y * width + x, x,
                    width, passes.labels[number], view_out, view_next, fills, view_totals, totals.shape[0] > 0,
                )  # fmt: skip
