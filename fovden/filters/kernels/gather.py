"""One pass of the à-trous filter, backwards: from the gradient of what a pass wrote to those of all that it read.

With g the gradient of the pass's image, W the sum of a pixel's weights, G = g / W and h = G . image, the weight w(x, y)
of the tap y of a pixel x has the gradient P = G(x) . c(y) - h(x), and that of the pixel x as a tap of y has R, the same
the other way round. Then, with the squared differences e of each feature and their inverse squared widths s,

    dc(x) = sum w(y, x) G(y) - 2 (c(x) - c(y)) (s(x) w(x, y) P + s(y) w(y, x) R)       and so for the other features,
    ds(x) = -sum w(x, y) P e,        dmask(x) = sum w(y, x) R / mask(x).

Every pixel gathers from its taps, in either direction at once, and writes to its own place alone: no two threads meet,
and the result does not depend on how many there are. Where all pixels of a pass share their widths, and its kernel is
the B3 spline, which is the same from either side, one power serves both directions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.blend import (
    LOG2_E,
    WORD,
    ZERO,
    View,
)
from fovden.filters.kernels.lanes import WIDTH, exp2, exp2_plain, in_row, masked_load
from fovden.jit import Int, inlined, vectorised
from fovden.simd import (
    FLOATS,
    I64,
    fused,
    load,
    pointer_to,
    splat,
    stack_floats,
    store,
)

IMAGE, WIDTHS, NORMAL, POSITION, MASK, GATHERED = 0, 3, 6, 9, 12, 13  # sums of a block
SUMS = GATHERED * WIDTH
# Derivatives of powers of two leave out 2 ln 2 until the end; what comes by another way is divided by it before.
HALF_LOG2_E = np.float32(0.5) * LOG2_E
VECTORS = vectorised()


class Shares(NamedTuple):
    """What a pass's pixels hand back, arrays of shape (1, c, h, w), 0 where the pass did not work.

    Attributes:
        light: G and -h, of four channels.
        scales: Minus log2(e) times the pixel's own inverse squared widths, of three; read only where they differ.
        differ: Whether they do, or the kernel may: then its gradient is summed, too.
    """

    light: Any
    scales: Any
    differ: bool


def _gather_taps(everything: bool, differ: bool) -> Any:
    """Makes the intrinsic that gathers from a row of five taps; see :func:`gather_taps_plain`."""

    @intrinsic
    def gather(
        context: Any, image: Any, normal: Any, position: Any, weight: Any, light: Any, scales: Any, plane: Any, at: Any,
        tap: Any, x: Any, width: Any, step: Any, inverse: Any, taps: Any, back: Any, sums: Any,
        tap_sums: Any,
    ) -> Any:  # fmt: skip
        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            (image, normal, position, weight, light, scales, plane, at, tap, x, width, step, inverse, taps, back, sums,
             tap_sums) = arguments  # fmt: skip
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
                    its_scale, power_back = own_scale, power
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

        return types.none(*[FLOATS] * 6, *[WORD] * 6, *[FLOATS] * 5), generate

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

    The formulas of the module's docstring, but for a factor of 2 ln 2, which comes when they are handed back.
    """
    scale, its_scale, squares = stack_floats(3), stack_floats(3), stack_floats(3)
    plane = view.plane
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


@inlined
def gather_taps(
    view: View, shares: Shares, everything: bool, at: Int, tap: Int, x: Int, step: Int, inverse: Any, taps: Any,
    back: Any, sums: Any, tap_sums: Any,
) -> None:  # fmt: skip
    """Adds what a row of five taps hands back to a block's sums, in the cheapest way that serves."""
    light, scales = pointer_to(shares.light), pointer_to(shares.scales)
    if not VECTORS:
        gather_taps_plain(view, light, scales, shares.differ, at, tap, x, step, inverse, taps, back, sums, tap_sums)
    elif shares.differ:
        gather_differing_vector(
            view.image, view.normal, view.position, view.mask, light, scales, view.plane, at, tap, x, view.width, step,
            inverse, taps, back, sums, tap_sums,
        )  # fmt: skip
    elif everything:
        gather_all_vector(
            view.image, view.normal, view.position, view.mask, light, scales, view.plane, at, tap, x, view.width, step,
            inverse, taps, back, sums, tap_sums,
        )  # fmt: skip
    else:
        gather_light_vector(
            view.image, view.normal, view.position, view.mask, light, scales, view.plane, at, tap, x, view.width, step,
            inverse, taps, back, sums, tap_sums,
        )  # fmt: skip
