"""A ray on its way: what boxes and triangles want to know of it, and what it has met so far, in two cache lines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fovden.jit import Float, Int, inlined, kernel, vectorised
from fovden.simd import F32, FLOATS, I32, I64, Lanes, bits_of, maximum, minimum, splat, store_int32
from fovden.tracer.kernels.layout import (
    FAR,
    FAR_AT,
    HIT_PRIM,
    LIMIT,
    NEAR,
    NEAR_AT,
    NEAR_ROWS,
    OCTANT,
    ORIGIN,
    SCALE,
    SHEAR,
    UPPER,
    VERTEX_ROWS,
    WIDTH,
)

ZERO, ONE = np.float32(0.0), np.float32(1.0)
INFINITY = np.float32(np.inf)
MISS = np.int32(-1)
SLACK = np.float32(1.0 + 2.0**-19)  # see ``boxes``
SMALLEST = np.float32(2.0**-40)  # of the largest component: what smaller ones count as, for boxes
GREATEST = np.float32(np.finfo(np.float32).max)
FOUR = 4  # three axes, and a lane that is not used
SHORT, LENGTHENED, LONG, SHORTENED = (np.float32(2.0**power) for power in (-60, 64, 60, -64))
ROUNDING = np.float32(2.0**-21)  # see ``boxes``


@inlined
def is_traceable(ox: Float, oy: Float, oz: Float, dx: Float, dy: Float, dz: Float) -> bool:
    """Whether origin and direction are finite and the direction is not zero; any other ray misses everything."""
    length = abs(dx) + abs(dy) + abs(dz)
    return bool(length > ZERO and length + abs(ox) + abs(oy) + abs(oz) < INFINITY)


@inlined
def bounded(number: Float) -> Float:
    """The number, or the greatest one of its sign if it is infinite: an unused lane's infinity must outweigh it."""
    return max(min(number, GREATEST), -GREATEST)


@inlined
def prepare_slab(ray: Any, axis: Int, origin: Float, direction: Float, smallest: Float) -> Int:
    """Writes what boxes want to know of one axis; returns 1 for a negative direction, else 0."""
    inverse = ONE / (math.copysign(smallest, direction) if abs(direction) < smallest else direction)
    at = -origin * inverse
    error = abs(at) * ROUNDING
    ray[NEAR + axis], ray[NEAR_AT + axis] = inverse, bounded(at - error)
    ray[FAR + axis], ray[FAR_AT + axis] = inverse * SLACK, bounded((at + error) * SLACK)
    negative = np.int32(1 if inverse < ZERO else 0)
    store_int32(ray, NEAR_ROWS + axis, np.int32(WIDTH * axis) + negative * np.int32(UPPER))
    return negative


@inlined
def prepare_axes_plain(ray: Any, ox: Float, oy: Float, oz: Float, dx: Float, dy: Float, dz: Float) -> Float:
    """:func:`prepare_axes_vector`, one axis after the other."""
    scale = ONE
    if max(max(abs(dx), abs(dy)), abs(dz)) < SHORT:
        scale = LENGTHENED
    elif max(max(abs(dx), abs(dy)), abs(dz)) > LONG:
        scale = SHORTENED
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    smallest = SMALLEST * max(max(ax, ay), az)
    octant = prepare_slab(ray, np.int64(0), ox, dx, smallest)
    octant += np.int32(2) * prepare_slab(ray, np.int64(1), oy, dy, smallest)
    octant += np.int32(4) * prepare_slab(ray, np.int64(2), oz, dz, smallest)
    store_int32(ray, OCTANT, octant)
    x, y, z = np.int32(0), np.int32(WIDTH), np.int32(2 * WIDTH)
    if ax >= ay and ax >= az:
        ox, oy, oz, dx, dy, dz, x, y, z = oy, oz, ox, dy, dz, dx, y, z, x
    elif ay >= az:
        ox, oy, oz, dx, dy, dz, x, y, z = oz, ox, oy, dz, dx, dy, z, x, y
    inverse = ONE / dz
    ray[ORIGIN], ray[ORIGIN + 1], ray[ORIGIN + 2] = ox, oy, oz
    ray[SHEAR], ray[SHEAR + 1], ray[SHEAR + 2] = dx * inverse, dy * inverse, inverse
    store_int32(ray, VERTEX_ROWS, x)
    store_int32(ray, VERTEX_ROWS + 1, y)
    store_int32(ray, VERTEX_ROWS + 2, z)
    return scale


def _chosen(tests: list[Lanes], values: list[Lanes]) -> Lanes:
    """The first of the values whose test is true, or the last; a test that is a scalar would become a branch."""
    chosen = values[-1]
    for test, value in zip(reversed(tests), reversed(values[:-1]), strict=True):
        chosen = test.select(value, chosen)
    return chosen


def _turned(lanes: Lanes, largest: list[Lanes]) -> Lanes:
    """Four lanes, of which the first three are turned so that the largest component comes third."""
    turns = []
    for axis in range(3):
        order = ir.Constant(ir.VectorType(I32, FOUR), [(axis + 1) % 3, (axis + 2) % 3, axis, 3])
        turns.append(Lanes(lanes.builder, lanes.builder.shuffle_vector(lanes.value, lanes.value, order)))
    return _chosen(largest, turns)


@intrinsic
def prepare_axes_vector(context: Any, ray: Any, ox: Any, oy: Any, oz: Any, dx: Any, dy: Any, dz: Any) -> Any:
    """:func:`prepare_axes_plain`, all axes at once."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        ray, *numbers = arguments
        floats = ir.VectorType(F32, FOUR)

        def constant(number: Any) -> Lanes:
            return splat(builder, ir.Constant(F32, float(number)), FOUR)

        def gathered(values: list[Any]) -> Lanes:
            vector = ir.Constant(floats, ir.Undefined)
            for place, value in enumerate([*values, values[-1]]):
                vector = builder.insert_element(vector, value, ir.Constant(I32, place))
            return Lanes(builder, vector)

        def integers(values: list[int], last: int) -> Lanes:
            return Lanes(builder, ir.Constant(ir.VectorType(I32, FOUR), [*values, last]))

        def call(name: str, *lanes: Lanes) -> Lanes:
            kind = ir.FunctionType(floats, [floats] * len(lanes))
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{FOUR}f32")
            return Lanes(builder, builder.call(function, [each.value for each in lanes]))

        def write(lanes: Lanes, place: int) -> None:
            pointer = builder.bitcast(builder.gep(ray, [ir.Constant(I64, place)]), lanes.value.type.as_pointer())
            builder.store(lanes.value, pointer, align=4)

        one, axes = constant(1.0), range(3)
        origin, direction = gathered(numbers[:3]), gathered(numbers[3:])
        sizes = call("fabs", direction)
        x, y, z = (splat(builder, builder.extract_element(sizes.value, ir.Constant(I32, i)), FOUR) for i in axes)
        largest = [(y <= x) & (z <= x), z <= y]
        length = _chosen(largest, [x, y, z])
        extremes = [length < float(SHORT), length > float(LONG)]
        scale = _chosen(extremes, [constant(LENGTHENED), constant(SHORTENED), one])
        direction = direction * scale
        smallest = length * scale * float(SMALLEST)
        inverse = one / (call("fabs", direction) < smallest).select(call("copysign", smallest, direction), direction)
        at = origin * -1.0 * inverse
        error = call("fabs", at) * float(ROUNDING)
        bounds = [inverse, at - error, inverse * float(SLACK), (at + error) * float(SLACK)]
        for k in (1, 3):
            bounds[k] = maximum(constant(-GREATEST), minimum(constant(GREATEST), bounds[k]))
        # Of four numbers that are written the last is unused, or what it stands for is written here or later.
        for lanes, place in zip(bounds, (NEAR, NEAR_AT, FAR, FAR_AT), strict=True):
            write(lanes, place)
        write(_turned(origin, largest), ORIGIN)
        turned, third = _turned(direction, largest), ir.Constant(I32, 2)
        inverse_of_third = one / splat(builder, builder.extract_element(turned.value, third), FOUR)
        turned.value = builder.insert_element(turned.value, ir.Constant(F32, 1.0), third)
        write(turned * inverse_of_third, SHEAR)
        negative = inverse < 0.0
        near = negative.select(integers([UPPER + WIDTH * i for i in axes], 0), integers([WIDTH * i for i in axes], 0))
        octant = builder.and_(negative.bits(), ir.Constant(I32, 7))
        near.value = builder.insert_element(near.value, octant, ir.Constant(I32, OCTANT - NEAR_ROWS))
        write(near, NEAR_ROWS)
        rows = [integers([(axis + i) % 3 * WIDTH for i in (1, 2, 3)], int(MISS)) for axis in axes]
        write(_chosen(largest, rows), VERTEX_ROWS)
        return builder.extract_element(scale.value, ir.Constant(I32, 0))

    return types.float32(FLOATS, *[types.float32] * 6), generate


prepare_axes = prepare_axes_vector if vectorised() else prepare_axes_plain


@kernel
def prepare(ray: Any, ox: Float, oy: Float, oz: Float, dx: Float, dy: Float, dz: Float, t_max: Float) -> None:
    """Writes a ray that has met nothing yet.

    Args:
        ray: Receives for boxes (:mod:`fovden.tracer.kernels.boxes`) NEAR and NEAR_AT, with which a bound b of an axis
            is met at b * near + near_at if it is the first of its pair, FAR and FAR_AT for the second, NEAR_ROWS, the
            rows of the first ones, and OCTANT, the signs of the direction as ``layout`` counts them; for triangles
            (:mod:`fovden.tracer.kernels.triangles`) ORIGIN along the permuted axes, SHEAR, and VERTEX_ROWS, where these
            axes' coordinates lie; LIMIT, the greatest distance that counts, and HIT_PRIM, none; and SCALE, by which
            the direction was multiplied to keep its inverse away from the ends of float32, and distances divided.
        ox: Origin.
        oy: Origin.
        oz: Origin.
        dx: Direction.
        dy: Direction.
        dz: Direction.
        t_max: Only less distant hits count.
    """
    scale = prepare_axes(ray, ox, oy, oz, dx, dy, dz)
    ray[SCALE] = scale
    limit_to(ray, t_max / scale)
    store_int32(ray, HIT_PRIM, MISS)


@inlined
def limit_to(ray: Any, t_max: Float) -> None:
    """Sets the greatest distance that is less than ``t_max``; no distance is where that is not positive or NaN."""
    ray[LIMIT] = -ONE
    if t_max > ZERO:
        store_int32(ray, LIMIT, bits_of(t_max) - np.int32(1))
