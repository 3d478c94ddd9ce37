"""Walks the acceleration structure for single rays: the closest hit, and whether there is any.

Children are visited nearest first. The stack holds keys (entry distance above child code), so one eight-byte move
pushes a child and one integer comparison tells whether it can still matter when it is popped.

Of hits at the same distance the triangle of the lowest number counts: the answer is a matter of ray and triangles
alone, and not of the order in which anything is visited.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import advanced, bits_of, load_int32, store_int32, trailing_zeros
from fovden.tracer.kernels.boxes import hit_boxes
from fovden.tracer.kernels.layout import (
    BLOCK_SIZE,
    CHILDREN,
    CUTOUT,
    HIT_PRIM,
    HIT_U,
    HIT_V,
    LIMIT,
    NODE_SIZE,
    PRIMITIVES,
    RAY_SIZE,
    SCALE,
    WIDTH,
)
from fovden.tracer.kernels.rays import INFINITY, MISS, ZERO, is_traceable, prepare
from fovden.tracer.kernels.surface import Geometry, is_opaque
from fovden.tracer.kernels.triangles import hit_triangles

LOWER_HALF = np.int64(0xFFFFFFFF)


class Accelerator(NamedTuple):
    """Pointers to the nodes, the leaf blocks, and what tells whether a triangle has a hole; and whether to ask it."""

    nodes: Any
    blocks: Any
    geometry: Geometry
    holes: bool


class Scratch(NamedTuple):
    """A thread's working memory: the stack, and SCRATCH_SIZE numbers for a ray and what a node or block answers.

    The kernel that loops over items allocates it, on its own stack: an inlined function's ends with the function.
    """

    stack: Any
    numbers: Any


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
    """Writes the nearest of a block's hits to the ray; returns whether the ray became shorter."""
    shorter = False
    while mask != 0:
        lane = np.int64(trailing_zeros(mask))
        mask &= mask - 1
        number = np.int64(load_int32(accelerator.blocks, base + PRIMITIVES + lane))
        prim, best = number & ~np.int64(CUTOUT), np.int64(load_int32(ray, HIT_PRIM))
        if results[lane] < ray[LIMIT] or (results[lane] == ray[LIMIT] and (best < 0 or prim < best)):
            u, v = results[WIDTH + lane], results[2 * WIDTH + lane]
            if number == prim or is_solid(accelerator, number, u, v):
                shorter = shorter or results[lane] < ray[LIMIT]
                ray[LIMIT], ray[HIT_U], ray[HIT_V] = results[lane], u, v
                store_int32(ray, HIT_PRIM, np.int32(prim))
    return shorter


@inlined
def any_solid(accelerator: Accelerator, base: Int, mask: Int, results: Any) -> bool:
    """Whether any of a block's hits is not in a hole."""
    while mask != 0:
        lane = np.int64(trailing_zeros(mask))
        mask &= mask - 1
        number = np.int64(load_int32(accelerator.blocks, base + PRIMITIVES + lane))
        if number < CUTOUT or is_solid(accelerator, number, results[WIDTH + lane], results[2 * WIDTH + lane]):
            return True
    return False


@inlined
def found(ray: Any) -> tuple[Float, Float, Float, Int]:
    """What a ray has met: t, u, v and the triangle."""
    prim = load_int32(ray, HIT_PRIM)
    if prim < 0:
        return INFINITY, ZERO, ZERO, MISS
    return ray[LIMIT] * ray[SCALE], ray[HIT_U], ray[HIT_V], prim


@kernel
def closest(
    accelerator: Accelerator,
    scratch: Scratch,
    ox: Float,
    oy: Float,
    oz: Float,
    dx: Float,
    dy: Float,
    dz: Float,
    t_max: Float,
) -> tuple[Float, Float, Float, Int]:
    """Returns t, u, v and the triangle of the first hit in (0, t_max); (inf, 0, 0, -1) is a miss."""
    if not is_traceable(ox, oy, oz, dx, dy, dz):
        return INFINITY, ZERO, ZERO, MISS
    nodes, stack, ray, results = accelerator.nodes, scratch.stack, scratch.numbers, advanced(scratch.numbers, RAY_SIZE)
    prepare(ray, ox, oy, oz, dx, dy, dz, t_max)
    top = 0
    code = np.int64(0)
    while True:
        if code >= 0:
            base = code * NODE_SIZE
            mask = hit_boxes(nodes, base, ray, results)
            if mask != 0:
                base += CHILDREN
                lane = np.int64(trailing_zeros(mask))
                mask &= mask - 1
                code = np.int64(load_int32(nodes, base + lane))
                if mask == 0:
                    continue
                nearest, bottom = key_of(results, lane, code), top
                while mask != 0:
                    lane = np.int64(trailing_zeros(mask))
                    mask &= mask - 1
                    key = key_of(results, lane, load_int32(nodes, base + lane))
                    farther = max(nearest, key)
                    nearest = min(nearest, key)
                    place = top
                    while place > bottom and stack[place - 1] < farther:
                        stack[place] = stack[place - 1]
                        place -= 1
                    stack[place] = farther
                    top += 1
                code = child_of(nearest)
                continue
        else:
            base = ~code * BLOCK_SIZE
            mask = hit_triangles(accelerator.blocks, base, ray, results)
            if mask != 0:
                keep_nearest(accelerator, base, mask, results, ray)
        beyond = (np.int64(bits_of(ray[LIMIT])) + 1) << 32
        near = False
        while top > 0 and not near:
            top -= 1
            near = stack[top] < beyond
        if not near:
            return found(ray)
        code = child_of(stack[top])


@kernel
def is_occluded(
    accelerator: Accelerator,
    scratch: Scratch,
    ox: Float,
    oy: Float,
    oz: Float,
    dx: Float,
    dy: Float,
    dz: Float,
    t_max: Float,
) -> bool:
    """Returns whether any triangle lies on the ray in (0, t_max). The likeliest children for their cost come first."""
    if not is_traceable(ox, oy, oz, dx, dy, dz):
        return False
    nodes, stack, ray, results = accelerator.nodes, scratch.stack, scratch.numbers, advanced(scratch.numbers, RAY_SIZE)
    prepare(ray, ox, oy, oz, dx, dy, dz, t_max)
    top = 0
    code = np.int64(0)
    while True:
        if code >= 0:
            base = code * NODE_SIZE
            mask = hit_boxes(nodes, base, ray, results)
            if mask != 0:
                base += CHILDREN
                code = np.int64(load_int32(nodes, base + np.int64(trailing_zeros(mask))))
                mask &= mask - 1
                while mask != 0:
                    stack[top] = code
                    top += 1
                    code = np.int64(load_int32(nodes, base + np.int64(trailing_zeros(mask))))
                    mask &= mask - 1
                continue
        else:
            base = ~code * BLOCK_SIZE
            mask = hit_triangles(accelerator.blocks, base, ray, results)
            if mask != 0 and any_solid(accelerator, base, mask, results):
                return True
        if top == 0:
            return False
        top -= 1
        code = stack[top]
