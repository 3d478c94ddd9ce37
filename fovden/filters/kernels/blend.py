"""One pass of the à-trous filter, forwards: the weighted mean of 5 x 5 taps, for sixteen pixels of a row at a time.

A row of taps is added to 256 pixels before the next one is looked at, so that what a row holds is read along, while it
is near. See :mod:`fovden.filters.kernels.weigh` for the formulas.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.columns import aligned
from fovden.filters.kernels.lanes import WIDTH, have_label, in_row, masked_load, masked_store, number_at
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
from fovden.filters.kernels.weigh import WORD, ZERO, add_kept, add_kept_beside, add_taps, weigh_beside
from fovden.jit import Int, inlined, kernel, vectorised
from fovden.simd import FLOATS, I64, Lanes, advanced, load, pointer_to, prefetch, stack_floats, stack_words, store

BLOCKS = 16  # blocks that a row of taps is added to before the next row
SUMS = 4 * WIDTH  # of a block: weighted red, green and blue, and weights
SCALES = 3 * WIDTH  # of a block: of radiance, normal and position
ALL_SUMS, ALL_SCALES = BLOCKS * SUMS, BLOCKS * SCALES

LOG2_E = np.float32(1.4426950408889634)
SMALLEST_TOTAL = np.float32(1e-20)
ONE = np.float32(1.0)

NORMAL, POSITION, MASK, CHANNELS = 3, 6, 9, 10  # of rows; radiance comes first

BYTES = types.CPointer(types.uint8)
YES = types.boolean


class Passes(NamedTuple):
    """What the passes of a stack are, an entry for each.

    Attributes:
        labels: The label of the pixels that it works on, (p).
        inverse: Inverse squared widths of radiance, normal and position, (p, 3).
        taps: log2 of the kernel, (p, 25).
    """

    labels: Any
    inverse: Any
    taps: Any


class Guides(NamedTuple):
    """What the passes of a stack look at and do not change: arrays of shape (v, c, h, w).

    Attributes:
        normal: Normals, of three channels.
        position: Positions, of three.
        labels: Labels, bytes, of one.
        factors: Factors of the inverse squared widths, of three; none where they are 1.
    """

    normal: Any
    position: Any
    labels: Any
    factors: Any


class View(NamedTuple):
    """Pointers to a view's part of such arrays, and its size."""

    image: Any
    mask: Any
    known: Any
    normal: Any
    position: Any
    labels: Any
    factors: Any
    has_factors: bool
    height: Int
    width: Int
    plane: Int


@inlined
def view_of(number: Int, image: Any, mask: Any, known: Any, guides: Guides) -> View:
    """A view's pointers."""
    height, width = image.shape[2], image.shape[3]
    plane = height * width
    return View(
        advanced(pointer_to(image), image.shape[1] * number * plane),
        advanced(pointer_to(mask), number * plane),
        advanced(pointer_to(known), number * plane),
        advanced(pointer_to(guides.normal), 3 * number * plane),
        advanced(pointer_to(guides.position), 3 * number * plane),
        advanced(pointer_to(guides.labels), number * plane),
        advanced(pointer_to(guides.factors), 3 * number * plane),
        guides.factors.shape[0] > 0,
        height,
        width,
        plane,
    )


# The two operations on a block of sixteen pixels from column x on, at ``at`` in their view's planes.


@intrinsic
def scale_block_vector(
    context: Any, inverse: Any, known: Any, factors: Any, has_factors: Any, plane: Any, at: Any, x: Any, width: Any,
    scales: Any,
) -> Any:  # fmt: skip
    """Writes the block's scales; that of radiance is 0 where a pixel has no value of its own to compare."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        inverse, known, factors, has_factors, plane, at, x, width, scales = arguments
        mask = in_row(builder, x, width)
        for feature in range(3):
            scale = number_at(builder, inverse, feature) * -float(LOG2_E)
            if feature == 0:
                has_value = masked_load(builder, known, at, mask) > 0.0
                scale = has_value.select(scale, Lanes(builder, ir.Constant(scale.value.type, [0.0] * WIDTH)))
            store(builder, scale, scales, feature * WIDTH)
            with builder.if_then(has_factors):
                place = builder.add(at, builder.mul(plane, ir.Constant(I64, feature)))
                store(builder, scale * masked_load(builder, factors, place, mask), scales, feature * WIDTH)
        return target.get_dummy_value()

    return types.none(FLOATS, FLOATS, FLOATS, YES, WORD, WORD, WORD, WORD, FLOATS), generate


@inlined
def scale_block_plain(
    inverse: Any, known: Any, factors: Any, has_factors: bool, plane: Int, at: Int, x: Int, width: Int, scales: Any
) -> None:
    """:data:`scale_block_vector`, one pixel after the other."""
    for lane in range(min(WIDTH, width - x)):
        for feature in range(3):
            scale = inverse[feature] * -LOG2_E
            if feature == 0 and not known[at + lane] > ZERO:
                scale = ZERO
            if has_factors:
                scale *= factors[at + lane + feature * plane]
            scales[feature * WIDTH + lane] = scale


@intrinsic
def finish_block_vector(
    context: Any, sums: Any, image: Any, known: Any, labels: Any, plane: Any, at: Any, x: Any, width: Any, label: Any,
    out: Any, next_mask: Any, fills: Any, tape: Any, tapes: Any, keeps: Any,
) -> Any:  # fmt: skip
    """Writes the block's means where it has the label, and the image's own values where nothing weighs.

    On tape go, if it ``tapes``, the sum of weights, negative where a pixel had no value of its own, and, if it ``keeps``
    them, the image's own values.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (sums, image, known, labels, plane, at, x, width, label, out, next_mask, fills, tape, tapes,
         keeps) = arguments  # fmt: skip
        mask = in_row(builder, x, width)
        inside = have_label(builder, labels, at, label, mask)
        places = [builder.add(at, builder.mul(plane, ir.Constant(I64, k))) for k in range(4)]
        total = load(builder, sums, 3 * WIDTH, WIDTH)
        one = Lanes(builder, ir.Constant(total.value.type, [1.0] * WIDTH))
        filled = total > float(SMALLEST_TOTAL)
        share = one / filled.select(total, one)
        own = [masked_load(builder, image, places[k], mask) for k in range(3)]
        has_value = masked_load(builder, known, at, mask) > 0.0
        for k in range(3):
            mean = load(builder, sums, k * WIDTH, WIDTH) * share
            masked_store(builder, filled.select(mean, own[k]), out, places[k], inside)
        with builder.if_then(keeps):
            for k in range(3):
                masked_store(builder, own[k], tape, places[k], inside)
        with builder.if_then(tapes):
            masked_store(builder, has_value.select(total, total * -1.0), tape, places[3], inside)
        inside = builder.and_(inside, filled.value)
        masked_store(builder, one, known, at, inside)
        with builder.if_then(fills):
            masked_store(builder, one, next_mask, at, inside)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 3, BYTES, *[WORD] * 5, FLOATS, FLOATS, YES, FLOATS, YES, YES), generate


@inlined
def finish_block_plain(
    sums: Any, image: Any, known: Any, labels: Any, plane: Int, at: Int, x: Int, width: Int, label: Int, out: Any,
    next_mask: Any, fills: bool, tape: Any, tapes: bool, keeps: bool,
) -> None:  # fmt: skip
    """:data:`finish_block_vector`, one pixel after the other."""
    for lane in range(min(WIDTH, width - x)):
        here, total = at + lane, sums[3 * WIDTH + lane]
        if np.int64(labels[here]) != label:
            continue
        filled = total > SMALLEST_TOTAL
        if keeps:
            for k in range(3):
                tape[here + k * plane] = image[here + k * plane]
        if tapes:
            tape[here + 3 * plane] = total if known[here] > ZERO else -total
        for k in range(3):
            out[here + k * plane] = sums[k * WIDTH + lane] / total if filled else image[here + k * plane]
        if filled:
            known[here] = ONE
            if fills:
                next_mask[here] = ONE


scale_block = scale_block_vector if vectorised() else scale_block_plain
finish_block = finish_block_vector if vectorised() else finish_block_plain


@inlined
def is_symmetric(taps: Any) -> bool:
    """Whether a kernel is the same from either side."""
    for tap in range(12):
        if taps[tap] != taps[24 - tap]:
            return False
    return True


@inlined
def have_values(view: View, at: Int, x: Int) -> bool:
    """Whether all of the block's pixels have a value of their own, and so the same scale of radiance."""
    for place in range(at, at + min(WIDTH, view.width - x)):
        if not view.known[place] > ZERO:
            return False
    return True


def scratch_for(blocks: int, step: int) -> int:
    """How many numbers a thread needs of its own for rows of some blocks."""
    return floats_for(blocks, step, CHANNELS) + floats_to_keep(blocks, step, 1)


@inlined
def copy_pixels(view: View, rows: Rows, y: Int) -> None:
    """Copies what a row of taps is asked for."""
    copy_row(view.image, view.plane, 3, y, view.width, rows, 0)
    copy_row(view.normal, view.plane, 3, y, view.width, rows, NORMAL)
    copy_row(view.position, view.plane, 3, y, view.width, rows, POSITION)
    copy_row(view.mask, view.plane, 1, y, view.width, rows, MASK)


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
    view: View, rows: Rows, kept: Kept, y: Int, block: Int, order: Int, own: Int, symmetric: bool, inverse: Any, taps: Any,
    scales: Any,
) -> bool:  # fmt: skip
    """Finds a block's scales; if all of its pixels have the same, keeps the powers of the taps beside them."""
    x = block * WIDTH
    at, soon = y * view.width + x, 3 * rows.step
    if y + soon < view.height:
        ask_for(view, at + soon * view.width)
    scale_block(inverse, view.known, view.factors, view.has_factors, view.plane, at, x, view.width, scales)
    shared = symmetric and not view.has_factors and have_values(view, at, x)
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
    tape: Any,
    keeps: bool,
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
        image: Radiance before the pass, (v, 3 or more, h, w).
        mask: Weights of the taps, (v, 1, h, w).
        known: Above 0 where a pixel has a value of its own; becomes 1 where one is filled, (v, 1, h, w).
        out: Receives the radiance after the pass, (v, 3 or more, h, w).
        next_mask: Receives 1 where a pixel is filled, if ``fills``, (v, 1, h, w).
        fills: Whether it does.
        tape: Receives what the way back needs, (v, 4 or more, h, w); of no views if it is not needed.
        keeps: Whether that includes the radiance before the pass, which is not there otherwise.
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
    kept = kept_for(advanced(floats, SLOTS * CHANNELS * rows.apart), 1, rightmost, rows, -(-width // WIDTH))
    for run in range(start, stop):
        row, first = np.int64(runs[run, 0]), np.int64(runs[run, 1])
        end, number = np.int64(runs[run, 2]), np.int64(runs[run, 3])
        which, y, name = row // height, row % height, number * image.shape[0] * height + row
        view = view_of(which, image, mask, known, guides)
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        view_out = advanced(pointer_to(out), out.shape[1] * which * view.plane)
        view_next = advanced(pointer_to(next_mask), which * view.plane)
        view_tape = advanced(pointer_to(tape), tape.shape[1] * which * view.plane)
        order, symmetric = y // step, is_symmetric(taps)
        begin_row(kept, order, name)
        for j in range(5):
            away = (j - 2) * step
            places[j] = slot_of(rows, y + away)
            if 0 <= y + away < height and is_new(rows, y + away, row + away):
                copy_pixels(view, rows, y + away)
        for left in range(first, end, BLOCKS):
            count: Int = min(BLOCKS, end - left)
            for k in range(count * SUMS):
                all_sums[k] = ZERO
            for block in range(count):
                scales = advanced(all_scales, SCALES * block)
                shared[block] = np.int64(
                    begin_block(
                        view, rows, kept, y, left + block, order, places[2], symmetric, inverse, taps, scales
                    )
                )
            for j in range(5):
                if not 0 <= y + (j - 2) * step < height:
                    continue
                for block in range(count):
                    scales, sums = advanced(all_scales, SCALES * block), advanced(all_sums, SUMS * block)
                    add_row(
                        rows, kept, places, j, left + block, order, name, shared[block] > 0, advanced(taps, 5 * j), scales,
                        sums,
                    )  # fmt: skip
            for block in range(count):
                x = (left + block) * WIDTH
                finish_block(
                    advanced(all_sums, SUMS * block), view.image, view.known, view.labels, view.plane, y * width + x, x,
                    width, passes.labels[number], view_out, view_next, fills, view_tape, tape.shape[0] > 0, keeps,
                )  # fmt: skip
