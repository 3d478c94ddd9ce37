"""One pass of the à-trous filter, forwards: the weighted mean of 5 x 5 taps, for sixteen pixels of a row at a time.

With q the squared differences of radiance, normal and position between a pixel and its tap, each times its *scale*,
which is minus its inverse squared width times log2(e), a tap weighs 2^(q + log2 k) times its mask: one power for all
three edge-stopping functions and the kernel. A row of taps is added to 256 pixels before the next one is looked at, so
that what a row holds is read along, while it is near.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.lanes import (
    WIDTH,
    exp2,
    exp2_plain,
    have_label,
    in_row,
    masked_load,
    masked_store,
)
from fovden.jit import Int, inlined, kernel, vectorised
from fovden.simd import FLOATS, I64, Lanes, advanced, fused, load, pointer_to, splat, stack_floats, store

BLOCKS = 16  # blocks that a row of taps is added to before the next row
SUMS = 4 * WIDTH  # of a block: weighted red, green and blue, and weights
SCALES = 3 * WIDTH  # of a block: of radiance, normal and position
ALL_SUMS, ALL_SCALES = BLOCKS * SUMS, BLOCKS * SCALES

LOG2_E = np.float32(1.4426950408889634)
SMALLEST_TOTAL = np.float32(1e-20)
ZERO, ONE = np.float32(0.0), np.float32(1.0)

BYTES = types.CPointer(types.uint8)
WORD, YES = types.int64, types.boolean


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
        advanced(pointer_to(image), 3 * number * plane),
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


# The three operations on a block of sixteen pixels from column x on, at ``at`` in their view's planes.


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
            number = builder.load(builder.gep(inverse, [ir.Constant(I64, feature)]))
            scale = splat(builder, number, WIDTH) * -float(LOG2_E)
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
def add_taps_vector(
    context: Any, image: Any, normal: Any, position: Any, weight: Any, plane: Any, at: Any, tap: Any, x: Any,
    width: Any, step: Any, taps: Any, scales: Any, sums: Any,
) -> Any:  # fmt: skip
    """Adds a row of five taps, the middle one at ``tap``, to the block's sums."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image, normal, position, weight, plane, at, tap, x, width, step, taps, scales, sums = arguments
        planes, guides = [builder.mul(plane, ir.Constant(I64, k)) for k in range(3)], (image, normal, position)
        mask = in_row(builder, x, width)
        here = [[masked_load(builder, guide, builder.add(at, k), mask) for k in planes] for guide in guides]
        scale = [load(builder, scales, feature * WIDTH, WIDTH) for feature in range(3)]
        total = [load(builder, sums, k * WIDTH, WIDTH) for k in range(4)]
        for i in range(5):
            shift = builder.mul(step, ir.Constant(I64, i - 2))
            place, mask = builder.add(tap, shift), in_row(builder, builder.add(x, shift), width)
            there = [[masked_load(builder, guide, builder.add(place, k), mask) for k in planes] for guide in guides]
            q = splat(builder, builder.load(builder.gep(taps, [ir.Constant(I64, i)])), WIDTH)
            for feature in range(3):
                d = [a - b for a, b in zip(here[feature], there[feature], strict=True)]
                q = fused(fused(d[2], d[2], fused(d[1], d[1], d[0] * d[0])), scale[feature], q)
            w = exp2(q) * masked_load(builder, weight, place, mask)
            total = [*(fused(w, there[0][k], total[k]) for k in range(3)), total[3] + w]
        for k in range(4):
            store(builder, total[k], sums, k * WIDTH)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 4, *[WORD] * 6, *[FLOATS] * 3), generate


@inlined
def add_taps_plain(
    image: Any, normal: Any, position: Any, weight: Any, plane: Int, at: Int, tap: Int, x: Int, width: Int, step: Int,
    taps: Any, scales: Any, sums: Any,
) -> None:  # fmt: skip
    """:data:`add_taps_vector`, one pixel after the other."""
    for lane in range(min(WIDTH, width - x)):
        for i in range(5):
            column = x + lane + (i - 2) * step
            if column < 0 or column >= width:
                continue
            here, there = at + lane, tap + lane + (i - 2) * step
            radiance, turn, gap = ZERO, ZERO, ZERO
            for k in range(3):
                a, b = here + k * plane, there + k * plane
                radiance += (image[a] - image[b]) * (image[a] - image[b])
                turn += (normal[a] - normal[b]) * (normal[a] - normal[b])
                gap += (position[a] - position[b]) * (position[a] - position[b])
            q = radiance * scales[lane] + turn * scales[WIDTH + lane] + gap * scales[2 * WIDTH + lane]
            w = exp2_plain(q + taps[i]) * weight[there]
            for k in range(3):
                sums[k * WIDTH + lane] += w * image[there + k * plane]
            sums[3 * WIDTH + lane] += w


@intrinsic
def finish_block_vector(
    context: Any, sums: Any, image: Any, known: Any, labels: Any, plane: Any, at: Any, x: Any, width: Any, label: Any,
    out: Any, next_mask: Any, fills: Any, tape: Any, tapes: Any,
) -> Any:  # fmt: skip
    """Writes the block's means where it has the label, and the image's own values where nothing weighs.

    On tape go the image's own values and the sum of weights, negative where a pixel had no value of its own.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        sums, image, known, labels, plane, at, x, width, label, out, next_mask, fills, tape, tapes = arguments
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
        with builder.if_then(tapes):
            for k in range(3):
                masked_store(builder, own[k], tape, places[k], inside)
            masked_store(builder, has_value.select(total, total * -1.0), tape, places[3], inside)
        inside = builder.and_(inside, filled.value)
        masked_store(builder, one, known, at, inside)
        with builder.if_then(fills):
            masked_store(builder, one, next_mask, at, inside)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 3, BYTES, *[WORD] * 5, FLOATS, FLOATS, YES, FLOATS, YES), generate


@inlined
def finish_block_plain(
    sums: Any, image: Any, known: Any, labels: Any, plane: Int, at: Int, x: Int, width: Int, label: Int, out: Any,
    next_mask: Any, fills: bool, tape: Any, tapes: bool,
) -> None:  # fmt: skip
    """:data:`finish_block_vector`, one pixel after the other."""
    for lane in range(min(WIDTH, width - x)):
        here, total = at + lane, sums[3 * WIDTH + lane]
        if np.int64(labels[here]) != label:
            continue
        filled = total > SMALLEST_TOTAL
        if tapes:
            for k in range(3):
                tape[here + k * plane] = image[here + k * plane]
            tape[here + 3 * plane] = total if known[here] > ZERO else -total
        for k in range(3):
            out[here + k * plane] = sums[k * WIDTH + lane] / total if filled else image[here + k * plane]
        if filled:
            known[here] = ONE
            if fills:
                next_mask[here] = ONE


scale_block = scale_block_vector if vectorised() else scale_block_plain
add_taps = add_taps_vector if vectorised() else add_taps_plain
finish_block = finish_block_vector if vectorised() else finish_block_plain


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
) -> None:
    """Filters the blocks of the runs start .. stop - 1.

    Args:
        start: First run.
        stop: End of the runs.
        runs: Row, counted through all views, first block, end of the blocks and number of the pass, (n, 4).
        step: Distance between taps.
        passes: The passes.
        guides: What else is looked at.
        image: Radiance before the pass, (v, 3, h, w).
        mask: Weights of the taps, (v, 1, h, w).
        known: Above 0 where a pixel has a value of its own; becomes 1 where one is filled, (v, 1, h, w).
        out: Receives the radiance after the pass, (v, 3, h, w).
        next_mask: Receives 1 where a pixel is filled, if ``fills``, (v, 1, h, w).
        fills: Whether it does.
        tape: Receives what the way back needs, (v, 4 or more, h, w); of no views if it is not needed.
    """
    all_sums, all_scales = stack_floats(ALL_SUMS), stack_floats(ALL_SCALES)
    tapes = tape.shape[0] > 0
    for run in range(start, stop):
        row, first = np.int64(runs[run, 0]), np.int64(runs[run, 1])
        end, number = np.int64(runs[run, 2]), np.int64(runs[run, 3])
        which, y = row // image.shape[2], row % image.shape[2]
        view = view_of(which, image, mask, known, guides)
        height, width, plane = view.height, view.width, view.plane
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        view_out = advanced(pointer_to(out), 3 * which * plane)
        view_next = advanced(pointer_to(next_mask), which * plane)
        view_tape = advanced(pointer_to(tape), tape.shape[1] * which * plane)
        for left in range(first, end, BLOCKS):
            count: Int = min(BLOCKS, end - left)
            for k in range(count * SUMS):
                all_sums[k] = ZERO
            for block in range(count):
                x, scales = (left + block) * WIDTH, advanced(all_scales, SCALES * block)
                at = y * width + x
                scale_block(inverse, view.known, view.factors, view.has_factors, plane, at, x, width, scales)
            for j in range(5):
                v = y + (j - 2) * step
                if v < 0 or v >= height:
                    continue
                for block in range(count):
                    x, scales = (left + block) * WIDTH, advanced(all_scales, SCALES * block)
                    add_taps(
                        view.image, view.normal, view.position, view.mask, plane, y * width + x, v * width + x, x,
                        width, step, advanced(taps, 5 * j), scales, advanced(all_sums, SUMS * block),
                    )  # fmt: skip
            for block in range(count):
                x = (left + block) * WIDTH
                finish_block(
                    advanced(all_sums, SUMS * block), view.image, view.known, view.labels, plane, y * width + x, x,
                    width, passes.labels[number], view_out, view_next, fills, view_tape, tapes,
                )  # fmt: skip
