"""The gathering of gradients for sixteen pixels at a time; :mod:`fovden.filters.kernels.gather` has the formulas."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.blend import CHANNELS, LOG2_E, MASK, NORMAL
from fovden.filters.kernels.lanes import WIDTH, WORD, exp2, line_at, number_at, read
from fovden.filters.kernels.pairs import line_of
from fovden.filters.kernels.shares import HALF_LOG2_E
from fovden.simd import FLOATS, I64, Lanes, fused, load, store


def _pull(builder: Any, light: list[Lanes], image: list[Lanes]) -> Lanes:
    """G . c - h."""
    total = light[3]
    for k in range(3):
        total = fused(light[k], image[k], total)
    return total


def _move(total: list[Lanes], moved: Lanes, light: list[Lanes], changes: list[Lanes], apart: list[list[Lanes]]) -> None:
    """Adds what a tap hands back of radiance and guides."""
    for g, change in enumerate(changes):
        for k in range(3):
            before = total[3 * g + k] if g > 0 else fused(moved, light[k], total[k])
            total[3 * g + k] = fused(change, apart[g][k], before)


def _differences(here: Any, there: Any) -> list[list[Lanes]]:
    return [[a - b for a, b in zip(own, its, strict=True)] for own, its in zip(here, there, strict=True)]


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
            count = CHANNELS if everything else NORMAL
            total = [load(builder, sums, k * WIDTH, WIDTH) for k in range(count)]
            width = [load(builder, widths, k * WIDTH, WIDTH) for k in range(3)]
            for number, i in enumerate(shifts):
                place = builder.add(tap, builder.mul(step, ir.Constant(I64, i)))
                there = [read(builder, guide, place, plane) for guide in guides]
                its_light = read(builder, light, place, plane, 4)
                d = _differences(here, there)
                squares = [fused(a[2], a[2], fused(a[1], a[1], a[0] * a[0])) for a in d]
                q = number_at(builder, taps, 2 + i)
                for g in range(3):
                    q = fused(squares[g], scale[g], q)
                power = exp2(q)
                back, back_light = power * own_weight, _pull(builder, its_light, here[0])
                forth = power * load(builder, weight, place, WIDTH, align=4)
                both = forth * _pull(builder, own_light, there[0]) + back * back_light
                store(builder, power, line_at(builder, kept, apart, number))
                store(builder, both, line_at(builder, kept, apart, len(shifts) + number))
                changes = [scale[g] * both for g in range(3 if everything else 1)]
                _move(total, back * float(HALF_LOG2_E), its_light, changes, d)
                for g in range(3):
                    width[g] = fused(both, squares[g], width[g])
                if everything:
                    total[MASK] = fused(power, back_light, total[MASK])
            for k in range(count):
                store(builder, total[k], sums, k * WIDTH)
            for k in range(3):
                store(builder, width[k], widths, k * WIDTH)
            return target.get_dummy_value()

        return types.none(*[FLOATS] * 5, *[WORD] * 4, *[FLOATS] * 5, WORD), generate

    return gather


def _gather_kept(shifts: tuple[int, ...], everything: bool) -> Any:
    """Makes the intrinsic that gathers from taps before a pixel, which have kept what the pair has in common."""

    @intrinsic
    def gather(
        context: Any, image: Any, normal: Any, position: Any, weight: Any, light: Any, plane: Any, at: Any, tap: Any,
        step: Any, inverse: Any, sums: Any, kept: Any, apart: Any,
    ) -> Any:  # fmt: skip
        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            image, normal, position, weight, light, plane, at, tap, step, inverse, sums, kept, apart = arguments
            guides = [image, normal, position][: 3 if everything else 1]
            here = [read(builder, guide, at, plane) for guide in guides]
            own_weight = load(builder, weight, at, WIDTH, align=4)
            scale = [number_at(builder, inverse, k) * -float(LOG2_E) for k in range(len(guides))]
            count = CHANNELS if everything else NORMAL
            total = [load(builder, sums, k * WIDTH, WIDTH) for k in range(count)]
            for i in shifts:
                shift = builder.mul(step, ir.Constant(I64, i))
                place, line = builder.add(tap, shift), line_of(i, beside=len(shifts) == 2)
                power = load(builder, line_at(builder, kept, apart, line), shift, WIDTH, align=4)
                both = load(builder, line_at(builder, kept, apart, len(shifts) + line), shift, WIDTH, align=4)
                d = _differences(here, [read(builder, guide, place, plane) for guide in guides])
                its_light = read(builder, light, place, plane, 4 if everything else 3)
                moved = power * own_weight * float(HALF_LOG2_E)
                _move(total, moved, its_light, [each * both for each in scale], d)
                if everything:
                    total[MASK] = fused(power, _pull(builder, its_light, here[0]), total[MASK])
            for k in range(count):
                store(builder, total[k], sums, k * WIDTH)
            return target.get_dummy_value()

        return types.none(*[FLOATS] * 5, *[WORD] * 4, *[FLOATS] * 3, WORD), generate

    return gather


@intrinsic
def gather_own_vector(
    context: Any, image: Any, weight: Any, light: Any, plane: Any, at: Any, taps: Any, sums: Any
) -> Any:
    """Gathers from the tap that a pixel is itself; ``taps`` are those of its row."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image, weight, light, plane, at, taps, sums = arguments
        power, own_light = exp2(number_at(builder, taps, 2)), read(builder, light, at, plane, 4)
        moved = power * load(builder, weight, at, WIDTH, align=4) * float(HALF_LOG2_E)
        for k in range(3):
            store(builder, fused(moved, own_light[k], load(builder, sums, k * WIDTH, WIDTH)), sums, k * WIDTH)
        pulled = _pull(builder, own_light, read(builder, image, at, plane))
        store(builder, fused(power, pulled, load(builder, sums, MASK * WIDTH, WIDTH)), sums, MASK * WIDTH)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 3, WORD, WORD, FLOATS, FLOATS), generate


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
        total = [load(builder, sums, k * WIDTH, WIDTH) for k in range(CHANNELS)]
        width = [load(builder, widths, k * WIDTH, WIDTH) for k in range(3)]
        for i in range(5):
            place = builder.add(tap, builder.mul(step, ir.Constant(I64, i - 2)))
            there = [read(builder, guide, place, plane) for guide in guides]
            its_light, its_scale = read(builder, light, place, plane, 4), read(builder, scales, place, plane)
            d = _differences(here, there)
            squares = [fused(a[2], a[2], fused(a[1], a[1], a[0] * a[0])) for a in d]
            q, q_back = number_at(builder, taps, i), number_at(builder, back, 4 - i)
            for g in range(3):
                q, q_back = fused(squares[g], own_scale[g], q), fused(squares[g], its_scale[g], q_back)
            power_back, back_light = exp2(q_back), _pull(builder, its_light, here[0])
            pulled = exp2(q) * load(builder, weight, place, WIDTH, align=4) * _pull(builder, own_light, there[0])
            back_ = power_back * own_weight
            pushed = back_ * back_light
            changes = [fused(its_scale[g], pushed, own_scale[g] * pulled) for g in range(3)]
            _move(total, back_ * float(HALF_LOG2_E), its_light, changes, d)
            for g in range(3):
                width[g] = fused(pulled, squares[g], width[g])
            total[MASK] = fused(power_back, back_light, total[MASK])
            store(builder, load(builder, tap_sums, i * WIDTH, WIDTH) + pulled, tap_sums, i * WIDTH)
        for k in range(CHANNELS):
            store(builder, total[k], sums, k * WIDTH)
        for k in range(3):
            store(builder, width[k], widths, k * WIDTH)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 6, *[WORD] * 4, *[FLOATS] * 5), generate


ROW, RIGHT, LEFT = (-2, -1, 0, 1, 2), (1, 2), (-2, -1)
gather_row_light, gather_row_all = (_gather_taps(ROW, everything) for everything in (False, True))
gather_beside_light, gather_beside_all = (_gather_taps(RIGHT, everything) for everything in (False, True))
gather_kept_light, gather_kept_all = (_gather_kept(ROW, everything) for everything in (False, True))
gather_left_light, gather_left_all = (_gather_kept(LEFT, everything) for everything in (False, True))
