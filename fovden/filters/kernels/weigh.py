"""The taps of sixteen pixels of a row, five at a time: weighed, or with powers of two that a pair has kept.

With q the squared differences of radiance, normal and position between a pixel and its tap, each times its *scale*,
which is minus its inverse squared width times log2(e), a tap weighs 2^(q + log2 k) times its mask: one power for all
three edge-stopping functions and the kernel.

Pixels are read by their places in channels that begin at ``image``, ``normal``, ``position`` and ``weight`` and lie
``plane`` apart. The places around them, as far as taps reach, must be there to be read.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.lanes import WIDTH, WORD, ZERO, exp2, exp2_all, exp2_plain, line_at, number_at, read
from fovden.filters.kernels.pairs import line_of, line_of_plain
from fovden.jit import Int, inlined, vectorised
from fovden.simd import FLOATS, I64, Lanes, fused, load, store


def _exponent(here: Any, there: Any, scale: Any, tap: Lanes) -> Lanes:
    """Of a tap; ``tap`` is log2 of its kernel."""
    q = tap
    for feature in range(3):
        d = [a - b for a, b in zip(here[feature], there[feature], strict=True)]
        q = fused(fused(d[2], d[2], fused(d[1], d[1], d[0] * d[0])), scale[feature], q)
    return q


def _add(total: list[Lanes], power: Lanes, weight: Lanes, image: list[Lanes]) -> list[Lanes]:
    w = power * weight
    return [*(fused(w, image[k], total[k]) for k in range(3)), total[3] + w]


@intrinsic
def add_taps_vector(
    context: Any, image: Any, normal: Any, position: Any, weight: Any, plane: Any, at: Any, tap: Any, step: Any,
    taps: Any, scales: Any, sums: Any, kept: Any, apart: Any,
) -> Any:  # fmt: skip
    """Adds a row of five taps, the middle one at ``tap``, to the sums of the block at ``at``.

    Their powers go to ``kept``, ``apart`` from each other.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image, normal, position, weight, plane, at, tap, step, taps, scales, sums, kept, apart = arguments
        guides = image, normal, position
        here = [read(builder, guide, at, plane) for guide in guides]
        scale = [load(builder, scales, feature * WIDTH, WIDTH) for feature in range(3)]
        total = [load(builder, sums, k * WIDTH, WIDTH) for k in range(4)]
        places = [builder.add(tap, builder.mul(step, ir.Constant(I64, i - 2))) for i in range(5)]
        there = [[read(builder, guide, place, plane) for guide in guides] for place in places]
        powers = exp2_all([_exponent(here, there[i], scale, number_at(builder, taps, i)) for i in range(5)])
        for i in range(5):
            store(builder, powers[i], line_at(builder, kept, apart, i))
            total = _add(total, powers[i], load(builder, weight, places[i], WIDTH, align=4), there[i][0])
        for k in range(4):
            store(builder, total[k], sums, k * WIDTH)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 4, *[WORD] * 4, *[FLOATS] * 4, WORD), generate


@inlined
def add_taps_plain(
    image: Any, normal: Any, position: Any, weight: Any, plane: Int, at: Int, tap: Int, step: Int, taps: Any,
    scales: Any, sums: Any, kept: Any, apart: Int,
) -> None:  # fmt: skip
    """:data:`add_taps_vector`, one pixel after the other."""
    for lane in range(WIDTH):
        for i in range(5):
            here, there = at + lane, tap + lane + (i - 2) * step
            power = power_plain(image, normal, position, plane, here, there, scales, lane, taps[i])
            kept[i * apart + lane] = power
            add_pixel(image, weight, plane, there, power, sums, lane)


@inlined
def power_plain(
    image: Any, normal: Any, position: Any, plane: Int, here: Int, there: Int, scales: Any, lane: Int, tap: Any
) -> Any:
    """The power of a tap, of one pixel."""
    radiance, turn, gap = ZERO, ZERO, ZERO
    for k in range(3):
        a, b = here + k * plane, there + k * plane
        radiance += (image[a] - image[b]) * (image[a] - image[b])
        turn += (normal[a] - normal[b]) * (normal[a] - normal[b])
        gap += (position[a] - position[b]) * (position[a] - position[b])
    q = radiance * scales[lane] + turn * scales[WIDTH + lane] + gap * scales[2 * WIDTH + lane]
    return exp2_plain(q + tap)


@intrinsic
def weigh_beside_vector(
    context: Any, image: Any, normal: Any, position: Any, plane: Any, at: Any, step: Any, taps: Any, scales: Any,
    kept: Any, apart: Any,
) -> Any:  # fmt: skip
    """Keeps the powers of the taps one step and two to the right, the last of the five ``taps``."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image, normal, position, plane, at, step, taps, scales, kept, apart = arguments
        guides = image, normal, position
        here = [read(builder, guide, at, plane) for guide in guides]
        scale = [load(builder, scales, feature * WIDTH, WIDTH) for feature in range(3)]
        exponents = []
        for i in (1, 2):
            place = builder.add(at, builder.mul(step, ir.Constant(I64, i)))
            there = [read(builder, guide, place, plane) for guide in guides]
            exponents.append(_exponent(here, there, scale, number_at(builder, taps, 2 + i)))
        for i, power in enumerate(exp2_all(exponents)):
            store(builder, power, line_at(builder, kept, apart, i))
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 3, *[WORD] * 3, *[FLOATS] * 3, WORD), generate


@inlined
def weigh_beside_plain(
    image: Any, normal: Any, position: Any, plane: Int, at: Int, step: Int, taps: Any, scales: Any, kept: Any,
    apart: Int,
) -> None:  # fmt: skip
    """:data:`weigh_beside_vector`, one pixel after the other."""
    for i in (1, 2):
        for lane in range(WIDTH):
            here, there = at + lane, at + lane + i * step
            kept[(i - 1) * apart + lane] = power_plain(
                image, normal, position, plane, here, there, scales, lane, taps[2 + i]
            )


def _add_kept(beside: bool) -> Any:
    @intrinsic
    def add_kept(
        context: Any, image: Any, weight: Any, plane: Any, tap: Any, step: Any, taps: Any, sums: Any, kept: Any,
        apart: Any,
    ) -> Any:  # fmt: skip
        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            image, weight, plane, tap, step, taps, sums, kept, apart = arguments
            total = [load(builder, sums, k * WIDTH, WIDTH) for k in range(4)]
            for i in (-2, -1, 0, 1, 2):
                shift = builder.mul(step, ir.Constant(I64, i))
                place = builder.add(tap, shift)
                if beside and i == 0:
                    power = exp2(number_at(builder, taps, 2))
                else:
                    own = beside and i > 0  # what the block has kept itself, and not the one that the tap stands in
                    line = line_at(builder, kept, apart, line_of(i, beside))
                    power = load(builder, line, ir.Constant(I64, 0) if own else shift, WIDTH, align=4)
                weight_ = load(builder, weight, place, WIDTH, align=4)
                total = _add(total, power, weight_, read(builder, image, place, plane))
            for k in range(4):
                store(builder, total[k], sums, k * WIDTH)
            return target.get_dummy_value()

        return types.none(FLOATS, FLOATS, *[WORD] * 3, *[FLOATS] * 3, WORD), generate

    return add_kept


add_kept_vector, add_kept_beside_vector = _add_kept(beside=False), _add_kept(beside=True)
"""Add a row of five taps, the middle one at ``tap``, with the powers that a row before has kept, or the row itself."""


@inlined
def add_kept_plain(
    image: Any, weight: Any, plane: Int, tap: Int, step: Int, taps: Any, sums: Any, kept: Any, apart: Int
) -> None:
    """:data:`add_kept_vector`, one pixel after the other."""
    for i in range(-2, 3):
        for lane in range(WIDTH):
            power = kept[line_of_plain(i, False) * apart + i * step + lane]
            add_pixel(image, weight, plane, tap + i * step + lane, power, sums, lane)


@inlined
def add_kept_beside_plain(
    image: Any, weight: Any, plane: Int, tap: Int, step: Int, taps: Any, sums: Any, kept: Any, apart: Int
) -> None:
    """:data:`add_kept_beside_vector`, one pixel after the other."""
    for i in range(-2, 3):
        for lane in range(WIDTH):
            power = exp2_plain(taps[2])
            if i != 0:
                power = kept[line_of_plain(i, True) * apart + min(i, 0) * step + lane]
            add_pixel(image, weight, plane, tap + i * step + lane, power, sums, lane)


@inlined
def add_pixel(image: Any, weight: Any, plane: Int, there: Int, power: Any, sums: Any, lane: Int) -> None:
    """Adds a tap with its power, of one pixel."""
    w = power * weight[there]
    for k in range(3):
        sums[k * WIDTH + lane] += w * image[there + k * plane]
    sums[3 * WIDTH + lane] += w


add_taps = add_taps_vector if vectorised() else add_taps_plain
weigh_beside = weigh_beside_vector if vectorised() else weigh_beside_plain
add_kept = add_kept_vector if vectorised() else add_kept_plain
add_kept_beside = add_kept_beside_vector if vectorised() else add_kept_beside_plain
