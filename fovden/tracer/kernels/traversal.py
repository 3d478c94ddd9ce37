"""What walks through the acceleration structure share: its arrays, keys of children, and which of a block's hits count.

Of hits at the same distance the triangle of the lowest number counts: the answer is a matter of ray and triangles
alone, and not of the order in which anything is visited.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import load_int32, store_int32, trailing_zeros
from fovden.tracer.kernels.layout import CUTOUT, HIT_PRIM, HIT_U, HIT_V, LIMIT, PRIMITIVES, SCALE, WIDTH
from fovden.tracer.kernels.rays import INFINITY, MISS, ZERO
from fovden.tracer.kernels.surface import Geometry, is_opaque

LOWER_HALF = np.int64(0xFFFFFFFF)


class Accelerator(NamedTuple):
    """Pointers to the nodes, the leaf blocks, and what tells whether a triangle has a hole; and whether to ask it."""

    nodes: Any
    blocks: Any
    geometry: Geometry
    holes: bool


@inlined
def key_of(distances: Any, lane: Int, code: Int) -> Int:
    """The key of a child: its distance above its code. Distances are not negative, so keys compare as they do."""
    return (np.int64(load_int32(distances, lane)) << 32) | (np.int64(code) & LOWER_HALF)


@inlined
def child_of(key: Int) -> Int:
    """The child code in a key's lower half, its sign restored."""
    return np.int64(np.int32(key & LOWER_HALF))


@kernel
def is_solid(accelerator: Accelerator, number: Int, u: Float, v: Float) -> bool:
    """Whether a triangle with holes has none where the ray meets it."""
    return not accelerator.holes or is_opaque(accelerator.geometry, number & ~np.int64(CUTOUT), u, v)


@inlined
def keep_nearest(accelerator: Accelerator, base: Int, mask: Int, results: Any, ray: Any) -> bool:
    """Writes the nearest of a block's hits to the ray, which becomes that short; returns whether there is any."""
    any_kept = False
    while mask != 0:
        lane = np.int64(trailing_zeros(mask))
        mask &= mask - 1
        number = np.int64(load_int32(accelerator.blocks, base + PRIMITIVES + lane))
        prim, best = number & ~np.int64(CUTOUT), np.int64(load_int32(ray, HIT_PRIM))
        if results[lane] < ray[LIMIT] or (results[lane] == ray[LIMIT] and (best < 0 or prim < best)):
            u, v = results[WIDTH + lane], results[2 * WIDTH + lane]
            if number == prim or is_solid(accelerator, number, u, v):
                any_kept = True
                ray[LIMIT], ray[HIT_U], ray[HIT_V] = results[lane], u, v
                store_int32(ray, HIT_PRIM, np.int32(prim))
    return any_kept


@inlined
def is_any_solid(accelerator: Accelerator, base: Int, mask: Int, results: Any) -> bool:
    """Whether any of a block's hits has no hole there."""
    if not accelerator.holes:
        return True
    while mask != 0:
        lane = np.int64(trailing_zeros(mask))
        mask &= mask - 1
        number = np.int64(load_int32(accelerator.blocks, base + PRIMITIVES + lane))
        solid = number & np.int64(CUTOUT) == 0
        if solid or is_solid(accelerator, number, results[WIDTH + lane], results[2 * WIDTH + lane]):
            return True
    return False


@inlined
def found(ray: Any) -> tuple[Float, Float, Float, Int]:
    """What a ray has met: t, u, v and the triangle."""
    prim = load_int32(ray, HIT_PRIM)
    if prim < 0:
        return INFINITY, ZERO, ZERO, MISS
    return ray[LIMIT] * ray[SCALE], ray[HIT_U], ray[HIT_V], prim
