"""The gathering of gradients for sixteen pixels at a time; :mod:`fovden.filters.kernels.gather` has the formulas."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.blend import CHANNELS, LOG2_E, MASK, NORMAL
from fovden.filters.kernels.lanes import WIDTH, WORD, exp2, exp2_all, line_at, number_at, read
from fovden.filters.kernels.pairs import line_of
from fovden.filters.kernels.shares import MOVED
from fovden.simd import FLOATS, I64, Lanes, fused, load, store


def _pull(light: list[Lanes], image: list[Lanes]) -> Lanes:
    """G . c - h."""
    total = light[3]
    for k in range(3):
        total = fused(light[k], image[k], total)
    return total


def _sums(builder: Any, sums: Any, everything: bool) -> dict[int, Lanes]:
    """A block's sums, by their places."""
    channels = [*range(CHANNELS if everything else NORMAL), *range(MOVED, MOVED + 3)]
    return {k: load(builder, sums, k * WIDTH, WIDTH) for k in channels}


def _add(total: dict[int, Lanes], power: Lanes, light: list[Lanes], changes: list[Lanes], apart: Any) -> None:
    """Adds what a tap hands back of radiance and guides."""
    for k in range(3):
        total[MOVED + k] = fused(power, light[k], total[MOVED + k])
    for g, change in enumerate(changes):
        for k in range(3):
            total[3 * g + k] = fused(change, apart[g][k], total[3 * g + k])


def _differences(here: Any, there: Any) -> list[list[Lanes]]:
    return [[a - b for a, b in zip(own, its, strict=True)] for own, its in zip(here, there, strict=True)]


def _squares(d: list[list[Lanes]]) -> list[Lanes]:
    """The squared differences of each feature."""
    return [fused(a[2], a[2], fused(a[1], a[1], a[0] * a[0])) for a in d]


def _sum(log: Lanes, squares: list[Lanes], scale: list[Lanes]) -> Lanes:
    """log2 of a tap's weight, but for its mask."""
    for square, each in zip(squares, scale, strict=True):
        log = fused(square, each, log)
    return log


def _gather_taps(shifts: tuple[int, ...], everything: bool) -> Any:
    """Makes the intrinsic that gathers from taps of a row; see :func:`gather_plain`."""

    @intrinsic
    def gather(
        context: Any, image: Any, normal: Any, position: Any, weight: Any, light: Any, plane: Any, at: Any, tap: Any,
        step: Any, inverse: Any, taps: Any, sums: Any, widths: Any, kept: Any, apart: Any,
    ) -> Any:  # fmt: skip
        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            (image, normal, position, weight, light, plane, at, tap, step, inverse, taps, sums, widths, kept,
             apart) = arguments  # fmt: skip
            guides = image, normal, position
            here = [read(builder, guide, at, plane) for guide in guides]
            own_light, own_weight = read(builder, light, at, plane, 4), load(builder, weight, at, WIDTH, align=4)
            scale = [number_at(builder, inverse, k) * -float(LOG2_E) for k in range(3)]
            total = _sums(builder, sums, everything)
            width = [load(builder, widths, k * WIDTH, WIDTH) for k in range(3)]
            places = [builder.add(tap, builder.mul(step, ir.Constant(I64, i))) for i in shifts]
            there = [[read(builder, guide, place, plane) for guide in guides] for place in places]
            d = [_differences(here, each) for each in there]
            squares = [_squares(each) for each in d]
            logs = [number_at(builder, taps, 2 + i) for i in shifts]
            powers = exp2_all([_sum(log, each, scale) for log, each in zip(logs, squares, strict=True)])
            for number, (place, power) in enumerate(zip(places, powers, strict=True)):
                its_light = read(builder, light, place, plane, 4)
                forth = power * load(builder, weight, place, WIDTH, align=4)
                back_light = _pull(its_light, here[0])
                back = power * own_weight * back_light
                both = forth * _pull(own_light, there[number][0]) + back  # not fused: the same from either side
                store(builder, power, line_at(builder, kept, apart, number))
                store(builder, both, line_at(builder, kept, apart, len(shifts) + number))
                _add(total, power, its_light, [both] * (3 if everything else 1), d[number])
                width = [fused(both, square, each) for square, each in zip(squares[number], width, strict=True)]
                if everything:
                    total[MASK] = fused(power, back_light, total[MASK])
            for k, each in total.items():
                store(builder, each, sums, k * WIDTH)
            for k in range(3):
                store(builder, width[k], widths, k * WIDTH)
            return target.get_dummy_value()

        return types.none(*[FLOATS] * 5, *[WORD] * 4, *[FLOATS] * 5, WORD), generate

    return gather


def _gather_kept(shifts: tuple[int, ...], everything: bool) -> Any:
    """Makes the intrinsic that gathers from taps before a pixel, which have kept what the pair has in common."""

    @intrinsic
    def gather(
        context: Any, image: Any, normal: Any, position: Any, light: Any, plane: Any, at: Any, tap: Any, step: Any,
        sums: Any, kept: Any, apart: Any,
    ) -> Any:  # fmt: skip
        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            image, normal, position, light, plane, at, tap, step, sums, kept, apart = arguments
            guides = [image, normal, position][: 3 if everything else 1]
            here = [read(builder, guide, at, plane) for guide in guides]
            total = _sums(builder, sums, everything)
            for i in shifts:
                shift = builder.mul(step, ir.Constant(I64, i))
                place, line = builder.add(tap, shift), line_of(i, beside=len(shifts) == 2)
                power = load(builder, line_at(builder, kept, apart, line), shift, WIDTH, align=4)
                both = load(builder, line_at(builder, kept, apart, len(shifts) + line), shift, WIDTH, align=4)
                d = _differences(here, [read(builder, guide, place, plane) for guide in guides])
                its_light = read(builder, light, place, plane, 4 if everything else 3)
                _add(total, power, its_light, [both] * len(guides), d)
                if everything:
                    total[MASK] = fused(power, _pull(its_light, here[0]), total[MASK])
            for k, each in total.items():
                store(builder, each, sums, k * WIDTH)
            return target.get_dummy_value()

        return types.none(*[FLOATS] * 4, *[WORD] * 4, *[FLOATS] * 2, WORD), generate

    return gather


@intrinsic
def gather_own_vector(context: Any, image: Any, light: Any, plane: Any, at: Any, taps: Any, sums: Any) -> Any:
    """Gathers from the tap that a pixel is itself; ``taps`` are those of its row."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image, light, plane, at, taps, sums = arguments
        power, own_light = exp2(number_at(builder, taps, 2)), read(builder, light, at, plane, 4)
        total = _sums(builder, sums, everything=True)
        _add(total, power, own_light, [], [])
        total[MASK] = fused(power, _pull(own_light, read(builder, image, at, plane)), total[MASK])
        for k, each in total.items():
            store(builder, each, sums, k * WIDTH)
        return target.get_dummy_value()

    return types.none(FLOATS, FLOATS, WORD, WORD, FLOATS, FLOATS), generate


@intrinsic
def gather_differing_vector(
    context: Any, image: Any, normal: Any, position: Any, weight: Any, light: Any, scales: Any, plane: Any, at: Any,
    tap: Any, step: Any, taps: Any, back: Any, sums: Any, widths: Any, tap_sums: Any,
) -> Any:  # fmt: skip
    """Gathers from a row of five taps where widths or the kernel differ; see :func:`gather_differing_plain`."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (image, normal, position, weight, light, scales, plane, at, tap, step, taps, back, sums, widths,
         tap_sums) = arguments  # fmt: skip
        guides = image, normal, position
        here = [read(builder, guide, at, plane) for guide in guides]
        own_light, own_weight = read(builder, light, at, plane, 4), load(builder, weight, at, WIDTH, align=4)
        own_scale = read(builder, scales, at, plane)
        total = _sums(builder, sums, everything=True)
        width = [load(builder, widths, k * WIDTH, WIDTH) for k in range(3)]
        places = [builder.add(tap, builder.mul(step, ir.Constant(I64, i - 2))) for i in range(5)]
        there = [[read(builder, guide, place, plane) for guide in guides] for place in places]
        its_scale = [read(builder, scales, place, plane) for place in places]
        d = [_differences(here, each) for each in there]
        squares = [_squares(each) for each in d]
        forth = exp2_all([_sum(number_at(builder, taps, i), squares[i], own_scale) for i in range(5)])
        back_ = exp2_all([_sum(number_at(builder, back, 4 - i), squares[i], its_scale[i]) for i in range(5)])
        for i, place in enumerate(places):
            its_light = read(builder, light, place, plane, 4)
            back_light = _pull(its_light, here[0])
            pulled = forth[i] * load(builder, weight, place, WIDTH, align=4) * _pull(own_light, there[i][0])
            pushed = back_[i] * own_weight * back_light
            changes = [fused(its_scale[i][g], pushed, own_scale[g] * pulled) for g in range(3)]
            _add(total, back_[i], its_light, changes, d[i])
            width = [fused(pulled, square, each) for square, each in zip(squares[i], width, strict=True)]
            total[MASK] = fused(back_[i], back_light, total[MASK])
            store(builder, load(builder, tap_sums, i * WIDTH, WIDTH) + pulled, tap_sums, i * WIDTH)
        for k, each in total.items():
            store(builder, each, sums, k * WIDTH)
        for k in range(3):
            store(builder, width[k], widths, k * WIDTH)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 6, *[WORD] * 4, *[FLOATS] * 5), generate


ROW, RIGHT, LEFT = (-2, -1, 0, 1, 2), (1, 2), (-2, -1)
gather_row_light, gather_row_all = (_gather_taps(ROW, everything) for everything in (False, True))
gather_beside_light, gather_beside_all = (_gather_taps(RIGHT, everything) for everything in (False, True))
gather_kept_light, gather_kept_all = (_gather_kept(ROW, everything) for everything in (False, True))
gather_left_light, gather_left_all = (_gather_kept(LEFT, everything) for everything in (False, True))
