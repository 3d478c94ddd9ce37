"""The gathering of gradients on the screen, row by row; :mod:`fovden.filters.kernels.gather` has the formulas."""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.filters.kernels.blend import ONE, Guides, Passes, View, view_of
from fovden.filters.kernels.blend_rows import ask_for, copy_pixels
from fovden.filters.kernels.columns import aligned
from fovden.filters.kernels.gather import (
    NUMBERS,
    gather_beside,
    gather_differing,
    gather_kept,
    gather_left,
    gather_own,
    gather_row,
)
from fovden.filters.kernels.hand_back import Gradients, gradients_of, hand_back
from fovden.filters.kernels.lanes import WIDTH, ZERO, opaque
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
from fovden.filters.kernels.shares import (
    ALL_CHANNELS,
    BLOCK_SUMS,
    LIGHT,
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
from fovden.simd import advanced, pointer_to, prefetch, stack_floats, stack_words

BLOCKS = 16  # blocks that a row of taps is gathered from before the next row
ALL_SUMS = BLOCKS * BLOCK_SUMS


def scratch_to_gather(blocks: int, step: int) -> int:
    """How many numbers a thread needs of its own for rows of some blocks."""
    return floats_for(blocks, step, ALL_CHANNELS) + floats_to_keep(blocks, step, NUMBERS)


@inlined
def gather_five(
    rows: Rows, kept: Kept, places: Any, j: Int, block: Int, order: Int, name: Int, differ: bool, everything: bool,
    inverse: Any, taps: Any, sums: Any, widths: Any, tap_sums: Any,
) -> None:  # fmt: skip
    """Gathers from the j-th of five rows of taps, at ``places``, with what it has kept for the block if it has.

    Of a pair, the pixel that comes first gathers for the widths of both.
    """
    read, apart, x, step = read_from(rows.floats, rows.apart), rows.apart, block * WIDTH - rows.left, rows.step
    at, tap, away, reach = places[2] + x, places[j] + x, j - 2, reach_of(step)
    row_taps, lines = advanced(taps, 5 * j), advanced(kept.floats, x)
    if differ:
        back, row_sums = advanced(taps, 20 - 5 * j), advanced(tap_sums, 5 * WIDTH * j)
        gather_differing(read, at, tap, step, row_taps, back, sums, advanced(sums, SUMS), row_sums)
    elif j == 2:
        gather_own(read, at, row_taps, sums)
        if is_ready(kept, order, name, block - reach, block):  # else nothing to the left has been read, or has read
            own = advanced(lines, slot_in(kept, order))
            gather_left(read, everything, at, step, sums, own, apart)
    elif j < 2 and is_ready(kept, order + away, name + away * step, block - reach, block + reach):
        its = advanced(lines, slot_in(kept, order + away) + NUMBERS * (AFTER_NEXT if j == 0 else NEXT) * apart)
        gather_kept(read, everything, at, tap, step, sums, its, apart)
    else:
        own, between, its_widths = kept.scrap, np.int64(WIDTH), stack_floats(WIDTHS)
        if j > 2:
            line = NUMBERS * (NEXT if j == 3 else AFTER_NEXT)
            own, between, its_widths = advanced(lines, slot_in(kept, order) + line * apart), apart, widths
        gather_row(read, everything, at, tap, step, inverse, row_taps, sums, its_widths, own, between)


@inlined
def bring_shares(view: View, shares: Shares, rows: Rows, y: Int, name: Int, first: Int, end: Int) -> None:
    """Copies what taps of the blocks ``first`` to ``end`` find in a row on the way back, unless it is there."""
    reach = reach_of(rows.step)
    if is_there(rows, y, name, first - reach, end + reach):
        return
    block, stop = next_missing(rows, y, first - reach, end + reach)
    while block < stop:
        copy_pixels(view, rows, y, block, stop)
        copy_blocks(shares.light, view.plane, 4, y, view.width, rows, LIGHT, block, stop)
        if shares.differ:
            copy_blocks(shares.scales, view.plane, 3, y, view.width, rows, SCALES, block, stop)
        block, stop = next_missing(rows, y, stop, end + reach)


@inlined
def begin_block(
    view: View, light: Any, rows: Rows, kept: Kept, y: Int, block: Int, order: Int, own: Int, differ: bool,
    everything: bool, inverse: Any, taps: Any, sums: Any, widths: Any, gradients: Gradients,
) -> None:  # fmt: skip
    """Gathers from the taps to the right of a block, which is kept for those to whose left it is.

    What the block's sums will be added to, and what will be copied soon, is brought near.
    """
    x, soon = block * WIDTH, y + 3 * rows.step
    here = y * view.width + x
    prefetch(view.mask, here)
    for k in range(3):
        prefetch(gradients.image, here + k * view.plane)
        if everything:
            prefetch(gradients.normal, here + k * view.plane)
            prefetch(gradients.position, here + k * view.plane)
    if everything:
        prefetch(gradients.mask, here)
    if soon < view.height:
        at = soon * view.width + x
        ask_for(view, at)
        for k in range(4):
            prefetch(light, at + k * view.plane)
    if not differ:
        read, lines = read_from(rows.floats, rows.apart), advanced(kept.floats, slot_in(kept, order) + x - rows.left)
        gather_beside(
            read, everything, own + x - rows.left, rows.step, inverse, advanced(taps, 10), sums, widths, lines,
            rows.apart,
        )  # fmt: skip
        kept.ready[order % KEPT_ROWS * kept.blocks + block] = ONE


@kernel
def gather_runs(
    start: Int,
    stop: Int,
    runs: Any,
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
    scratch: Any,
) -> None:
    """Gathers gradients in the blocks of the runs start .. stop - 1, which hold all that a pass has read.

    Args:
        start: First run.
        stop: End of the runs.
        runs: Row, counted through all views, first block, end of the blocks and number of the pass, (n, 4), of a
            single pass; in the order of :func:`fovden.filters.kernels.rows.in_order`.
        step: Distance between taps.
        passes: The passes.
        guides: What else was looked at.
        image: Radiance before the pass, (v, 3, h, w).
        mask: Weights of the taps, (v, 1, h, w).
        shares: What the pass's pixels hand back.
        everything: Whether the gradients of normal, position and mask are wanted too.
        gradients: Receives the gradients.
        width_sums: Where all pixels share their widths, receives each run's sums for these, float64, (n, 3).
        tap_sums: Where they do not, receives for each run and tap the sum of weight times its gradient, (n, 25).
        scratch: As many numbers as :func:`scratch_to_gather` says, which no other thread uses.
    """
    if start == stop:
        return
    all_sums, run_taps, run_widths = stack_floats(ALL_SUMS), stack_floats(TAP_SUMS), stack_floats(WIDTHS)
    places, differ = stack_words(SLOTS), shares.differ
    leftmost, rightmost = extent_of(runs, start, stop)
    channels: Int = ALL_CHANNELS if differ else SCALES
    floats = pointer_to(aligned(scratch))
    rows = rows_for(floats, channels, leftmost, rightmost, step)
    height, width = image.shape[2], image.shape[3]
    kept = kept_for(behind(rows), NUMBERS, rightmost, rows, -(-width // WIDTH))
    factors = stack_floats(3)
    for run in range(start, stop):
        row, first = np.int64(runs[run, 0]), np.int64(runs[run, 1])
        end, number = np.int64(runs[run, 2]), np.int64(runs[run, 3])
        which, y = row // height, row % height
        view, order = view_of(which, image, mask, mask, guides), y // step
        handed, own = handed_of(which, shares, view.plane), gradients_of(which, gradients, view.plane)
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        write_factors(differ, inverse, factors)
        for k in range(TAP_SUMS):
            run_taps[k] = ZERO
        for k in range(WIDTHS):
            run_widths[k] = ZERO
        begin_row(kept, order, row)
        for j in range(5):
            away = (j - 2) * step
            places[j] = slot_of(rows, y + away)
            if 0 <= y + away < height:
                bring_shares(view, handed, rows, y + away, row + away, first, end)
        for left in range(first, end, BLOCKS):
            count: Int = min(BLOCKS, end - left)
            for k in range(count * BLOCK_SUMS):
                all_sums[k] = ZERO
            for counter in range(count):
                block = opaque(counter)
                begin_block(
                    view, handed.light, rows, kept, y, left + block, order, places[2], differ, everything, inverse,
                    taps, advanced(all_sums, BLOCK_SUMS * block), run_widths, own,
                )  # fmt: skip
            for j in range(5):
                if not 0 <= y + (j - 2) * step < height:
                    continue
                for counter in range(count):
                    block = opaque(counter)
                    gather_five(
                        rows, kept, places, j, left + block, order, row, differ, everything, inverse, taps,
                        advanced(all_sums, BLOCK_SUMS * block), run_widths, run_taps,
                    )  # fmt: skip
            for block in range(count):
                x, sums = (left + block) * WIDTH, advanced(all_sums, BLOCK_SUMS * block)
                hand_back(sums, factors, differ, everything, view.mask, view.plane, y * width + x, x, width, own)
        for lane in range(WIDTH):
            if differ:
                for tap in range(25):
                    tap_sums[run, tap] += run_taps[tap * WIDTH + lane]
            else:
                for g in range(3):
                    width_sums[run, g] -= run_widths[g * WIDTH + lane]
