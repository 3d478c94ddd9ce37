"""One pass of the à-trous filter, backwards, over the runs of a view: what comes before and after the gathering.

See :mod:`fovden.filters.kernels.gather` for the formulas.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.errors import RequireLiteralValue
from numba.extending import intrinsic

from fovden.filters.kernels.blend import (
    BYTES,
    CHANNELS,
    LOG2_E,
    MASK,
    NORMAL,
    ONE,
    POSITION,
    SMALLEST_TOTAL,
    WORD,
    YES,
    Guides,
    Passes,
    View,
    ask_for,
    copy_pixels,
    view_of,
)
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
from fovden.filters.kernels.lanes import WIDTH, have_label, in_row, masked_load, masked_store
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
    copy_row,
    extent_of,
    floats_for,
    is_new,
    reach_of,
    rows_for,
    slot_of,
)
from fovden.filters.kernels.shares import MASK as MASK_SUM
from fovden.filters.kernels.shares import NORMAL as NORMAL_SUM
from fovden.filters.kernels.shares import POSITION as POSITION_SUM
from fovden.filters.kernels.shares import SUMS, WIDTHS, Read, Shares
from fovden.filters.kernels.weigh import ZERO
from fovden.jit import Int, inlined, kernel, vectorised
from fovden.simd import (
    FLOATS,
    I32,
    I64,
    Lanes,
    advanced,
    fused,
    load,
    maximum,
    pointer_to,
    prefetch,
    splat,
    stack_floats,
    stack_words,
)

BLOCKS = 16  # blocks that a row of taps is gathered from before the next row
BLOCK_SUMS = SUMS + WIDTHS
ALL_SUMS, TAP_SUMS = BLOCKS * BLOCK_SUMS, 25 * WIDTH
LIGHT, SCALES = CHANNELS, CHANNELS + 4  # of rows, after those on the way forth
TWICE_LN_2 = np.float32(2 * 0.6931471805599453)


class Gradients(NamedTuple):
    """Gradients, arrays of shape (1, c, h, w).

    Attributes:
        image: Of the image, of 3 channels.
        widths: Of the inverse squared widths as the pixels have them, of 3.
        normal: Of normals, of 3.
        position: Of positions, of 3.
        mask: Of the mask, of 1.
    """

    image: Any
    widths: Any
    normal: Any
    position: Any
    mask: Any


@intrinsic
def add_block_vector(
    context: Any, sums: Any, factor: Any, channels: Any, plane: Any, at: Any, x: Any, width: Any, out: Any, adds: Any
) -> Any:
    """Writes a block's sums of some channels, times a factor, to an array, or adds them to what is there."""
    if not isinstance(channels, types.IntegerLiteral):
        raise RequireLiteralValue("channels")
    number = channels.literal_value

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        sums, factor, _, plane, at, x, width, out, adds = arguments
        mask, factor = in_row(builder, x, width), splat(builder, factor, WIDTH)
        there = builder.select(adds, mask, ir.Constant(mask.type, [0] * WIDTH))
        for k in range(number):
            place = builder.add(at, builder.mul(plane, ir.Constant(I64, k)))
            value = fused(load(builder, sums, k * WIDTH, WIDTH), factor, masked_load(builder, out, place, there))
            masked_store(builder, value, out, place, mask)
        return target.get_dummy_value()

    return types.none(FLOATS, types.float32, channels, WORD, WORD, WORD, WORD, FLOATS, YES), generate


@inlined
def add_block_plain(
    sums: Any, factor: Any, channels: Int, plane: Int, at: Int, x: Int, width: Int, out: Any, adds: bool
) -> None:
    """:data:`add_block_vector`, one pixel after the other."""
    for k in range(channels):
        for lane in range(min(WIDTH, width - x)):
            value = sums[k * WIDTH + lane] * factor
            out[at + lane + k * plane] = out[at + lane + k * plane] + value if adds else value


@intrinsic
def prepare_block_vector(
    context: Any, image: Any, gradient: Any, mask_gradient: Any, fills: Any, tape: Any, restores: Any, labels: Any,
    plane: Any, at: Any, x: Any, width: Any, label: Any, light: Any,
) -> Any:  # fmt: skip
    """Writes G and -h of a block; returns whether a filled pixel of it had no value of its own."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (image, gradient, mask_gradient, fills, tape, restores, labels, plane, at, x, width, label,
         light) = arguments  # fmt: skip
        inside = have_label(builder, labels, at, label, in_row(builder, x, width))
        places = [builder.add(at, builder.mul(plane, ir.Constant(I64, k))) for k in range(4)]
        total = masked_load(builder, tape, places[3], inside)
        zero = Lanes(builder, ir.Constant(total.value.type, [0.0] * WIDTH))
        unknown = total < 0.0
        total = maximum(total, zero - total)
        filled = total > float(SMALLEST_TOTAL)
        one = Lanes(builder, ir.Constant(total.value.type, [1.0] * WIDTH))
        share = filled.select(one / filled.select(total, one), zero)
        changed = builder.and_(inside, filled.value)
        reference = zero
        for k in range(3):
            divided = masked_load(builder, gradient, places[k], inside) * share
            reference = reference - divided * masked_load(builder, image, places[k], inside)
            masked_store(builder, divided, light, places[k], inside)
            masked_store(builder, zero, gradient, places[k], changed)
        masked_store(builder, reference, light, places[3], inside)
        with builder.if_then(fills):
            masked_store(builder, zero, mask_gradient, at, changed)
        with builder.if_then(restores):
            for k in range(3):
                masked_store(builder, masked_load(builder, tape, places[k], inside), image, places[k], inside)
        return builder.icmp_unsigned("!=", (unknown & filled).bits(), ir.Constant(I32, 0))

    return YES(FLOATS, FLOATS, FLOATS, YES, FLOATS, YES, BYTES, WORD, WORD, WORD, WORD, WORD, FLOATS), generate


@inlined
def prepare_block_plain(
    image: Any, gradient: Any, mask_gradient: Any, fills: bool, tape: Any, restores: bool, labels: Any, plane: Int,
    at: Int, x: Int, width: Int, label: Int, light: Any,
) -> bool:  # fmt: skip
    """:data:`prepare_block_vector`, one pixel after the other."""
    unknown = False
    for here in range(at, at + min(WIDTH, width - x)):
        if np.int64(labels[here]) != label:
            continue
        total, reference = abs(tape[here + 3 * plane]), ZERO
        filled = total > SMALLEST_TOTAL
        for k in range(3):
            place = here + k * plane
            divided = gradient[place] / total if filled else ZERO
            light[place] = divided
            reference += divided * image[place]
            if filled:
                gradient[place] = ZERO
            if restores:
                image[place] = tape[place]
        light[here + 3 * plane] = -reference
        if fills and filled:
            mask_gradient[here] = ZERO
        unknown = unknown or (filled and tape[here + 3 * plane] < ZERO)
    return unknown


add_block = add_block_vector if vectorised() else add_block_plain
prepare_block = prepare_block_vector if vectorised() else prepare_block_plain


@kernel
def prepare_runs(
    start: Int,
    stop: Int,
    runs: Any,
    passes: Passes,
    guides: Guides,
    image: Any,
    gradient: Any,
    mask_gradient: Any,
    fills: bool,
    tape: Any,
    restores: bool,
    light: Any,
    unknown: Any,
) -> None:
    """Divides the gradients of the pixels of the runs start .. stop - 1 by the sums of their weights.

    What a filled pixel was before the pass counts no more: its gradient becomes 0. The other pixels keep theirs.

    Args:
        start: First run.
        stop: End of the runs.
        runs: As in :func:`fovden.filters.kernels.blend.blend_runs`, of a single view.
        passes: The passes.
        guides: What else was looked at, of that view.
        image: Its radiance after the pass, (1, 3 or more, h, w).
        gradient: Gradient of that radiance, (1, 3, h, w).
        mask_gradient: Gradient of the mask after the pass, and then before it, (1, 1, h, w).
        fills: Whether the mask of a filled pixel became 1.
        tape: What the pass has written, (1, 4 or more, h, w).
        restores: Whether to take the image to before the pass.
        light: Receives G and -h, (1, 4, h, w).
        unknown: Receives whether one of a run's pixels had no value of its own, (n).
    """
    height, width = image.shape[2], image.shape[3]
    for run in range(start, stop):
        y, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        for block in range(np.int64(runs[run, 1]), np.int64(runs[run, 2])):
            x = block * WIDTH
            found = prepare_block(
                pointer_to(image), pointer_to(gradient), pointer_to(mask_gradient), fills, pointer_to(tape), restores,
                pointer_to(guides.labels), height * width, y * width + x, x, width, passes.labels[number],
                pointer_to(light),
            )  # fmt: skip
            unknown[run] = unknown[run] or found


@kernel
def scale_runs(start: Int, stop: Int, runs: Any, passes: Passes, guides: Guides, tape: Any, scales: Any) -> None:
    """Writes what the pixels of the runs start .. stop - 1 had for scales; arguments as of :func:`prepare_runs`."""
    width, mapped = tape.shape[3], guides.factors.shape[0] > 0
    for run in range(start, stop):
        y, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        for x in range(np.int64(runs[run, 1]) * WIDTH, min(np.int64(runs[run, 2]) * WIDTH, width)):
            if np.int64(guides.labels[0, 0, y, x]) != passes.labels[number]:
                continue
            for g in range(3):
                scale = -LOG2_E * passes.inverse[number, g]
                if mapped:
                    scale *= guides.factors[0, g, y, x]
                scales[0, g, y, x] = scale if g > 0 or tape[0, 3, y, x] > ZERO else ZERO


def scratch_to_gather(blocks: int, step: int) -> int:
    """How many numbers a thread needs of its own for rows of some blocks."""
    return floats_for(blocks, step, SCALES + 3) + floats_to_keep(blocks, step, NUMBERS)


@inlined
def read_from(rows: Rows) -> Read:
    """The channels of the rows before a thread."""
    base, apart = rows.floats, rows.apart
    return Read(
        base, advanced(base, NORMAL * apart), advanced(base, POSITION * apart), advanced(base, MASK * apart),
        advanced(base, LIGHT * apart), advanced(base, SCALES * apart), apart,
    )  # fmt: skip


@inlined
def gather_five(
    rows: Rows, kept: Kept, places: Any, j: Int, block: Int, order: Int, y: Int, differ: bool, everything: bool,
    inverse: Any, taps: Any, sums: Any, tap_sums: Any,
) -> None:  # fmt: skip
    """Gathers from the j-th of five rows of taps, at ``places``, with what it has kept for the block if it has."""
    read, apart, x, step = read_from(rows), rows.apart, block * WIDTH - rows.left, rows.step
    at, tap, away, reach = places[2] + x, places[j] + x, j - 2, reach_of(step)
    row_taps, widths, lines = advanced(taps, 5 * j), advanced(sums, SUMS), advanced(kept.floats, x)
    if differ:
        back, row_sums = advanced(taps, 20 - 5 * j), advanced(tap_sums, 5 * WIDTH * j)
        gather_differing(read, at, tap, step, row_taps, back, sums, widths, row_sums)
    elif j == 2:
        own = advanced(lines, slot_in(kept, order))
        gather_own(read, at, row_taps, sums)
        if is_ready(kept, order, y, block - reach, block):
            gather_left(read, everything, at, step, inverse, sums, own, apart)
        else:
            scrap = stack_floats(WIDTHS)
            gather_beside(read, everything, at, -step, inverse, row_taps, sums, scrap, kept.scrap, WIDTH)
    elif j < 2 and is_ready(kept, order + away, y + away * step, block - reach, block + reach):
        its = advanced(lines, slot_in(kept, order + away) + NUMBERS * (AFTER_NEXT if j == 0 else NEXT) * apart)
        gather_kept(read, everything, at, tap, step, inverse, sums, its, apart)
    else:
        own, between, its_widths = kept.scrap, np.int64(WIDTH), stack_floats(WIDTHS)
        if j > 2:
            line = NUMBERS * (NEXT if j == 3 else AFTER_NEXT)
            own, between, its_widths = advanced(lines, slot_in(kept, order) + line * apart), apart, widths
        gather_row(read, everything, at, tap, step, inverse, row_taps, sums, its_widths, own, between)


@inlined
def copy_shares(view: View, shares: Shares, rows: Rows, y: Int) -> None:
    """Copies what a row of taps is asked for on the way back."""
    copy_pixels(view, rows, y)
    copy_row(pointer_to(shares.light), view.plane, 4, y, view.width, rows, LIGHT)
    if shares.differ:
        copy_row(pointer_to(shares.scales), view.plane, 3, y, view.width, rows, SCALES)


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
        runs: Row, first block, end of the blocks and number of the pass, (n, 4), of a single view and pass; in the
            order of :func:`fovden.filters.kernels.rows.in_order`.
        step: Distance between taps.
        passes: The passes.
        guides: What else was looked at, of that view.
        image: Its radiance before the pass, (1, 3 or more, h, w).
        mask: Weights of the taps, (1, 1, h, w).
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
    channels: Int = SCALES + 3 if differ else SCALES
    floats = pointer_to(aligned(scratch))
    rows = rows_for(floats, channels, leftmost, rightmost, step)
    blocks = -(-image.shape[3] // WIDTH)
    kept = kept_for(advanced(floats, SLOTS * channels * rows.apart), NUMBERS, rightmost, rows, blocks)
    view, light = view_of(0, image, mask, mask, guides), pointer_to(shares.light)
    for run in range(start, stop):
        y, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        first, end, order = np.int64(runs[run, 1]), np.int64(runs[run, 2]), y // step
        width, plane = view.width, view.plane
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        for k in range(TAP_SUMS):
            run_taps[k] = ZERO
        for k in range(WIDTHS):
            run_widths[k] = ZERO
        begin_row(kept, order, y)
        for j in range(5):
            v = y + (j - 2) * step
            places[j] = slot_of(rows, v)
            if 0 <= v < view.height and is_new(rows, v, v):
                copy_shares(view, shares, rows, v)
        for left in range(first, end, BLOCKS):
            count: Int = min(BLOCKS, end - left)
            for k in range(count * BLOCK_SUMS):
                all_sums[k] = ZERO
            for block in range(count):
                x, sums = (left + block) * WIDTH, advanced(all_sums, BLOCK_SUMS * block)
                if y + 3 * step < view.height:
                    soon = (y + 3 * step) * width + x
                    ask_for(view, soon)
                    for k in range(4):
                        prefetch(light, soon + k * plane)
                if not differ:
                    lines = advanced(kept.floats, slot_in(kept, order) + x - rows.left)
                    gather_beside(
                        read_from(rows), everything, places[2] + x - rows.left, step, inverse, advanced(taps, 10), sums,
                        advanced(sums, SUMS), lines, rows.apart,
                    )  # fmt: skip
                    kept.ready[order % KEPT_ROWS * kept.blocks + left + block] = ONE
            for j in range(5):
                if not 0 <= y + (j - 2) * step < view.height:
                    continue
                for block in range(count):
                    gather_five(
                        rows, kept, places, j, left + block, order, y, differ, everything, inverse, taps,
                        advanced(all_sums, BLOCK_SUMS * block), run_taps,
                    )  # fmt: skip
            for block in range(count):
                x, sums = (left + block) * WIDTH, advanced(all_sums, BLOCK_SUMS * block)
                hand_back(sums, differ, everything, plane, y * width + x, x, width, gradients)
                for k in range(WIDTHS):
                    run_widths[k] += sums[SUMS + k]
        for lane in range(WIDTH):
            if differ:
                for tap in range(25):
                    tap_sums[run, tap] += run_taps[tap * WIDTH + lane]
            else:
                for g in range(3):
                    width_sums[run, g] -= run_widths[g * WIDTH + lane]


@inlined
def hand_back(
    sums: Any, differ: bool, everything: bool, plane: Int, at: Int, x: Int, width: Int, gradients: Gradients
) -> None:
    """Writes a block's sums to where they belong."""
    add_block(sums, TWICE_LN_2, 3, plane, at, x, width, pointer_to(gradients.image), True)
    if differ:
        place = advanced(sums, SUMS)
        add_block(place, -ONE, 3, plane, at, x, width, pointer_to(gradients.widths), False)
    if everything:
        place = advanced(sums, NORMAL_SUM * WIDTH)
        add_block(place, TWICE_LN_2, 3, plane, at, x, width, pointer_to(gradients.normal), True)
        place = advanced(sums, POSITION_SUM * WIDTH)
        add_block(place, TWICE_LN_2, 3, plane, at, x, width, pointer_to(gradients.position), True)
        place = advanced(sums, MASK_SUM * WIDTH)
        add_block(place, ONE, 1, plane, at, x, width, pointer_to(gradients.mask), True)


@kernel
def reduce_runs(
    start: Int, stop: Int, runs: Any, passes: Passes, guides: Guides, tape: Any, widths: Any, factors: Any, sums: Any
) -> None:
    """Sums the gradients of inverse squared widths that differ, in the runs start .. stop - 1.

    Args:
        start: First run.
        stop: End of the runs.
        runs: As in :func:`prepare_runs`.
        passes: The passes.
        guides: What else was looked at.
        tape: What the pass has written.
        widths: Gradients of the inverse squared widths as the pixels have them, (1, 3, h, w).
        factors: Receives what of them is the factors', (1, 3, h, w); of no views if there are none.
        sums: Receives the sums of the passes' own, float64, (n, 3).
    """
    width, mapped = tape.shape[3], factors.shape[0] > 0
    for run in range(start, stop):
        y, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        for g in range(3):
            total = 0.0
            for x in range(np.int64(runs[run, 1]) * WIDTH, min(np.int64(runs[run, 2]) * WIDTH, width)):
                if np.int64(guides.labels[0, 0, y, x]) != passes.labels[number]:
                    continue
                if g == 0 and tape[0, 3, y, x] <= ZERO:
                    continue
                share = widths[0, g, y, x]
                if mapped:
                    factors[0, g, y, x] += share * passes.inverse[number, g]
                    share *= guides.factors[0, g, y, x]
                total += share
            sums[run, g] = total
