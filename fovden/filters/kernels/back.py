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
    LOG2_E,
    MASK,
    NORMAL,
    ONE,
    POSITION,
    SMALLEST_TOTAL,
    YES,
    Guides,
    Passes,
)
from fovden.filters.kernels.lanes import WIDTH, WORD, ZERO, have_label, in_row, masked_load, masked_store
from fovden.filters.kernels.shares import SUMS
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
    splat,
)

TAP_SUMS = 25 * WIDTH
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
        place = advanced(sums, NORMAL * WIDTH)
        add_block(place, TWICE_LN_2, 3, plane, at, x, width, pointer_to(gradients.normal), True)
        place = advanced(sums, POSITION * WIDTH)
        add_block(place, TWICE_LN_2, 3, plane, at, x, width, pointer_to(gradients.position), True)
        place = advanced(sums, MASK * WIDTH)
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
