"""A ray on its way: what boxes and triangles want to know of it, and what it has met so far, in two cache lines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import bits_of, store_int32
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
    ray[SCALE] = scale
    limit_to(ray, t_max / scale)
    store_int32(ray, HIT_PRIM, MISS)


@inlined
def limit_to(ray: Any, t_max: Float) -> None:
    """Sets the greatest distance that is less than ``t_max``; no distance is where that is not positive or NaN."""
    ray[LIMIT] = -ONE
    if t_max > ZERO:
        store_int32(ray, LIMIT, bits_of(t_max) - np.int32(1))
