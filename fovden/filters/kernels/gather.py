"""One pass of the à-trous filter, backwards: from the gradient of what a pass wrote to those of all that it read.

With g the gradient of the pass's image, W the sum of a pixel's weights, G = g / W and h = G . image, the weight w(x, y)
of the tap y of a pixel x has the gradient P = G(x) . c(y) - h(x), and that of the pixel x as a tap of y has R, the same
the other way round. Then, with the squared differences e of each feature and their inverse squared widths s,

    dc(x) = sum w(y, x) G(y) - 2 (c(x) - c(y)) (s(x) w(x, y) P + s(y) w(y, x) R)       and so for the other features,
    ds(x) = -sum w(x, y) P e,        dmask(x) = sum w(y, x) R / mask(x).

Every pixel gathers from its taps, in either direction at once, and writes to its own place alone: no two threads meet,
and the result does not depend on how many there are. Where all pixels of a pass share their widths, one power serves
both directions.
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
    ONE,
    SMALLEST_TOTAL,
    WORD,
    YES,
    ZERO,
    Guides,
    Passes,
    View,
    view_of,
)
from fovden.filters.kernels.lanes import WIDTH, exp2, exp2_plain, have_label, in_row, masked_load, masked_store
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
    stack_floats,
    store,
)

BLOCKS = 8  # blocks that a row of taps is gathered from before the next row
IMAGE, WIDTHS, NORMAL, POSITION, MASK, GATHERED = 0, 3, 6, 9, 12, 13  # sums of a block
SUMS = GATHERED * WIDTH
ALL_SUMS, TAP_SUMS, WIDTH_SUMS = BLOCKS * SUMS, 25 * WIDTH, 3 * WIDTH
LN_2 = np.float32(0.6931471805599453)
# Derivatives of powers of two leave out 2 ln 2 until the end; what comes by another way is divided by it before.
HALF_LOG2_E, TWICE_LN_2 = np.float32(0.5) * LOG2_E, np.float32(2.0) * LN_2


class Shares(NamedTuple):
    """What a pass's pixels hand back, arrays of shape (1, c, h, w), 0 where the pass did not work.

    Attributes:
        light: G and -h, of four channels.
        scales: Minus log2(e) times the pixel's own inverse squared widths, of three; read only where they differ.
        differ: Whether they do.
    """

    light: Any
    scales: Any
    differ: bool


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


def _gather_taps(everything: bool, differ: bool) -> Any:
    """Makes the intrinsic that gathers from a row of five taps; see :func:`gather_taps_plain`."""

    @intrinsic
    def gather(
        context: Any, image: Any, normal: Any, position: Any, weight: Any, light: Any, scales: Any, plane: Any, at: Any,
        tap: Any, x: Any, width: Any, step: Any, inverse: Any, taps: Any, back: Any, ratios: Any, sums: Any,
        tap_sums: Any,
    ) -> Any:  # fmt: skip
        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            (image, normal, position, weight, light, scales, plane, at, tap, x, width, step, inverse, taps, back,
             ratios, sums, tap_sums) = arguments  # fmt: skip
            planes = [builder.mul(plane, ir.Constant(I64, k)) for k in range(4)]

            def read(pointer: Any, place: Any, mask: Any, channels: int = 3) -> Any:
                return [masked_load(builder, pointer, builder.add(place, planes[k]), mask) for k in range(channels)]

            def number(pointer: Any, index: int) -> Any:
                return splat(builder, builder.load(builder.gep(pointer, [ir.Constant(I64, index)])), WIDTH)

            own = in_row(builder, x, width)
            here = [read(pointer, at, own) for pointer in (image, normal, position)]
            own_light, own_weight = read(light, at, own, 4), masked_load(builder, weight, at, own)
            own_scale = read(scales, at, own) if differ else [number(inverse, k) * -float(LOG2_E) for k in range(3)]
            count = GATHERED if everything else NORMAL
            total = [load(builder, sums, k * WIDTH, WIDTH) for k in range(count)]
            for i in range(5):
                shift = builder.mul(step, ir.Constant(I64, i - 2))
                place, mask = builder.add(tap, shift), in_row(builder, builder.add(x, shift), width)
                there = [read(pointer, place, mask) for pointer in (image, normal, position)]
                its_light = read(light, place, mask, 4)
                apart = [[a - b for a, b in zip(here[g], there[g], strict=True)] for g in range(3)]
                squares = [fused(d[2], d[2], fused(d[1], d[1], d[0] * d[0])) for d in apart]
                q = number(taps, i)
                for g in range(3):
                    q = fused(squares[g], own_scale[g], q)
                power = exp2(q)
                if differ:
                    its_scale = read(scales, place, mask)
                    q = number(back, 4 - i)
                    for g in range(3):
                        q = fused(squares[g], its_scale[g], q)
                    power_back = exp2(q)
                else:
                    its_scale, power_back = own_scale, power * number(ratios, i)
                forth, back_ = power * masked_load(builder, weight, place, mask), power_back * own_weight
                light_forth, light_back = own_light[3], its_light[3]
                for k in range(3):
                    light_forth = fused(own_light[k], there[0][k], light_forth)
                    light_back = fused(its_light[k], here[0][k], light_back)
                pulled, pushed = forth * light_forth, back_ * light_back
                moved = back_ * float(HALF_LOG2_E)
                for g in range(3 if everything else 1):
                    if differ:
                        change = fused(its_scale[g], pushed, own_scale[g] * pulled)
                    else:
                        change = own_scale[g] * (pulled + pushed)
                    first = (IMAGE, NORMAL, POSITION)[g]
                    for k in range(3):
                        before = fused(moved, its_light[k], total[first + k]) if g == 0 else total[first + k]
                        total[first + k] = fused(change, apart[g][k], before)
                for g in range(3):
                    total[WIDTHS + g] = fused(pulled, squares[g], total[WIDTHS + g])
                if everything:
                    total[MASK] = fused(power_back, light_back, total[MASK])
                if differ:
                    store(builder, load(builder, tap_sums, i * WIDTH, WIDTH) + pulled, tap_sums, i * WIDTH)
            for k in range(count):
                store(builder, total[k], sums, k * WIDTH)
            return target.get_dummy_value()

        floats = [FLOATS] * 6
        return types.none(*floats, *[WORD] * 6, *floats), generate

    return gather


gather_light_vector = _gather_taps(everything=False, differ=False)
gather_all_vector = _gather_taps(everything=True, differ=False)
gather_differing_vector = _gather_taps(everything=True, differ=True)


@inlined
def gather_taps_plain(
    view: View, light: Any, scales: Any, differ: bool, at: Int, tap: Int, x: Int, step: Int, inverse: Any, taps: Any,
    back: Any, sums: Any, tap_sums: Any,
) -> None:  # fmt: skip
    """Adds what a row of five taps hands back to a block's sums, one pixel after the other.

    The formulas of the module's docstring, but for a factor of 2 ln 2 that :func:`finish_block` adds.
    """
    scale, its_scale, q, q_back = np.empty(3, np.float32), np.empty(3, np.float32), ZERO, ZERO
    squares, plane = np.empty(3, np.float32), view.plane
    for lane in range(min(WIDTH, view.width - x)):
        for i in range(5):
            column = x + lane + (i - 2) * step
            if column < 0 or column >= view.width:
                continue
            a, b = at + lane, tap + lane + (i - 2) * step
            q, q_back = taps[i], back[4 - i]
            for g in range(3):
                feature = (view.image, view.normal, view.position)[g]
                squares[g] = ZERO
                for k in range(3):
                    d = feature[a + k * plane] - feature[b + k * plane]
                    squares[g] += d * d
                scale[g] = scales[a + g * plane] if differ else -LOG2_E * inverse[g]
                its_scale[g] = scales[b + g * plane] if differ else scale[g]
                q += squares[g] * scale[g]
                q_back += squares[g] * its_scale[g]
            power_back = exp2_plain(q_back)
            forth, back_ = exp2_plain(q) * view.mask[b], power_back * view.mask[a]
            light_forth, light_back = light[a + 3 * plane], light[b + 3 * plane]
            for k in range(3):
                light_forth += light[a + k * plane] * view.image[b + k * plane]
                light_back += light[b + k * plane] * view.image[a + k * plane]
            pulled, pushed = forth * light_forth, back_ * light_back
            for g in range(3):
                feature = (view.image, view.normal, view.position)[g]
                change = scale[g] * pulled + its_scale[g] * pushed
                first = (IMAGE, NORMAL, POSITION)[g]
                for k in range(3):
                    d = feature[a + k * plane] - feature[b + k * plane]
                    sums[(first + k) * WIDTH + lane] += change * d
                sums[(WIDTHS + g) * WIDTH + lane] += pulled * squares[g]
            for k in range(3):
                sums[(IMAGE + k) * WIDTH + lane] += back_ * HALF_LOG2_E * light[b + k * plane]
            sums[MASK * WIDTH + lane] += power_back * light_back
            tap_sums[i * WIDTH + lane] += pulled


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
VECTORS = vectorised()


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
) -> None:
    """Gathers gradients in the blocks of the runs start .. stop - 1, which hold all that a pass has read.

    Args:
        start: First run.
        stop: End of the runs.
        runs: Row, first block, end of the blocks and number of the pass, (n, 4), of a single view.
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
    """
    all_sums, run_taps, run_widths = stack_floats(ALL_SUMS), stack_floats(TAP_SUMS), stack_floats(WIDTH_SUMS)
    for run in range(start, stop):
        y, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        first, end = np.int64(runs[run, 1]), np.int64(runs[run, 2])
        view = view_of(0, image, mask, mask, guides)
        width, plane = view.width, view.plane
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        ratios = advanced(pointer_to(passes.ratios), 25 * number)
        for k in range(TAP_SUMS):
            run_taps[k] = ZERO
        for k in range(WIDTH_SUMS):
            run_widths[k] = ZERO
        for left in range(first, end, BLOCKS):
            count: Int = min(BLOCKS, end - left)
            for k in range(count * SUMS):
                all_sums[k] = ZERO
            for j in range(5):
                v = y + (j - 2) * step
                if v < 0 or v >= view.height:
                    continue
                row_taps, back, row_ratios = advanced(taps, 5 * j), advanced(taps, 20 - 5 * j), advanced(ratios, 5 * j)
                row_sums = advanced(run_taps, 5 * WIDTH * j)
                for block in range(count):
                    x, sums = (left + block) * WIDTH, advanced(all_sums, SUMS * block)
                    gather_taps(
                        view, shares, everything, y * width + x, v * width + x, x, step, inverse, row_taps, back,
                        row_ratios, sums, row_sums,
                    )  # fmt: skip
            for block in range(count):
                x, sums = (left + block) * WIDTH, advanced(all_sums, SUMS * block)
                hand_back(sums, shares.differ, everything, plane, y * width + x, x, width, gradients)
                for k in range(WIDTH_SUMS):
                    run_widths[k] += sums[WIDTHS * WIDTH + k]
        for lane in range(WIDTH):
            if shares.differ:
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
        place = advanced(sums, WIDTHS * WIDTH)
        add_block(place, -ONE, 3, plane, at, x, width, pointer_to(gradients.widths), False)
    if everything:
        place = advanced(sums, NORMAL * WIDTH)
        add_block(place, TWICE_LN_2, 3, plane, at, x, width, pointer_to(gradients.normal), True)
        place = advanced(sums, POSITION * WIDTH)
        add_block(place, TWICE_LN_2, 3, plane, at, x, width, pointer_to(gradients.position), True)
        place = advanced(sums, MASK * WIDTH)
        add_block(place, ONE, 1, plane, at, x, width, pointer_to(gradients.mask), True)


@inlined
def gather_taps(
    view: View, shares: Shares, everything: bool, at: Int, tap: Int, x: Int, step: Int, inverse: Any, taps: Any,
    back: Any, ratios: Any, sums: Any, tap_sums: Any,
) -> None:  # fmt: skip
    """Adds what a row of five taps hands back to a block's sums, in the cheapest way that serves."""
    light, scales = pointer_to(shares.light), pointer_to(shares.scales)
    if not VECTORS:
        gather_taps_plain(view, light, scales, shares.differ, at, tap, x, step, inverse, taps, back, sums, tap_sums)
    elif shares.differ:
        gather_differing_vector(
            view.image, view.normal, view.position, view.mask, light, scales, view.plane, at, tap, x, view.width, step,
            inverse, taps, back, ratios, sums, tap_sums,
        )  # fmt: skip
    elif everything:
        gather_all_vector(
            view.image, view.normal, view.position, view.mask, light, scales, view.plane, at, tap, x, view.width, step,
            inverse, taps, back, ratios, sums, tap_sums,
        )  # fmt: skip
    else:
        gather_light_vector(
            view.image, view.normal, view.position, view.mask, light, scales, view.plane, at, tap, x, view.width, step,
            inverse, taps, back, ratios, sums, tap_sums,
        )  # fmt: skip


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
