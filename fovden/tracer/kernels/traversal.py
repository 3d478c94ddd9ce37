"""Walks the acceleration structure for single rays: the closest hit, and whether there is any.

Children are visited nearest first. The stack holds keys (entry distance above child code), so one eight-byte move
pushes a child and one integer comparison tells whether it can still matter when it is popped.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import bits_of, load_int32, pointer_to, stack_floats, stack_words, trailing_zeros
from fovden.tracer.kernels.boxes import hit_boxes, slab_ray
from fovden.tracer.kernels.layout import BLOCK_SIZE, NODE_SIZE, PRIMITIVES, RESULTS_SIZE, STACK_SIZE, WIDTH
from fovden.tracer.kernels.triangles import any_triangle, hit_triangles, sheared_ray

ZERO, INFINITY = np.float32(0.0), np.float32(np.inf)
MISS = np.int32(-1)


class Accelerator(NamedTuple):
    """Pointers to the nodes and the leaf blocks."""

    nodes: Any
    blocks: Any


class Scratch(NamedTuple):
    """A thread's working memory: the stack, eight keys, and eight results of t, u, v.

    The kernel that loops over items allocates it, on its own stack: an inlined function's ends with the function.
    """

    stack: Any
    keys: Any
    results: Any


@inlined
def is_traceable(ox: Float, oy: Float, oz: Float, dx: Float, dy: Float, dz: Float) -> bool:
    """Whether origin and direction are finite and the direction is not zero; any other ray misses everything."""
    length = abs(dx) + abs(dy) + abs(dz)
    return bool(length > ZERO and length + abs(ox) + abs(oy) + abs(oz) < INFINITY)


@inlined
def child_of(key: Int) -> Int:
    """The child code in a key's lower half, its sign restored."""
    return np.int64(np.int32(key & np.int64(0xFFFFFFFF)))


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
    best_t, best_u, best_v, best_prim = t_max, ZERO, ZERO, MISS
    if not is_traceable(ox, oy, oz, dx, dy, dz):
        return INFINITY, ZERO, ZERO, MISS
    slabs = slab_ray(ox, oy, oz, dx, dy, dz)
    sheared = sheared_ray(ox, oy, oz, dx, dy, dz)
    stack, keys, results = scratch
    top = 0
    code = np.int64(0)
    while True:
        if code >= 0:
            mask = hit_boxes(accelerator.nodes, code * NODE_SIZE, slabs, best_t, keys)
            if mask != 0:
                nearest = keys[trailing_zeros(mask)]
                mask &= mask - 1
                bottom = top
                while mask != 0:
                    key = keys[trailing_zeros(mask)]
                    mask &= mask - 1
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
            mask = hit_triangles(accelerator.blocks, base, sheared, best_t, results)
            while mask != 0:
                lane = np.int64(trailing_zeros(mask))
                mask &= mask - 1
                if results[lane] < best_t:
                    best_t, best_u, best_v = results[lane], results[WIDTH + lane], results[2 * WIDTH + lane]
                    best_prim = load_int32(accelerator.blocks, base + PRIMITIVES + lane)
        limit = np.int64(bits_of(best_t)) << 32
        found = False
        while top > 0 and not found:
            top -= 1
            found = stack[top] < limit
        if not found:
            break
        code = child_of(stack[top])
    if best_prim < 0:
        return INFINITY, ZERO, ZERO, MISS
    return best_t, best_u, best_v, best_prim


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
    """Returns whether any triangle lies on the ray in (0, t_max). Children come in the order of their area."""
    if not is_traceable(ox, oy, oz, dx, dy, dz):
        return False
    slabs = slab_ray(ox, oy, oz, dx, dy, dz)
    sheared = sheared_ray(ox, oy, oz, dx, dy, dz)
    stack, keys, results = scratch
    top = 0
    code = np.int64(0)
    while True:
        if code >= 0:
            mask = hit_boxes(accelerator.nodes, code * NODE_SIZE, slabs, t_max, keys)
            if mask != 0:
                code = child_of(keys[trailing_zeros(mask)])
                mask &= mask - 1
                while mask != 0:
                    stack[top] = code
                    top += 1
                    code = child_of(keys[trailing_zeros(mask)])
                    mask &= mask - 1
                continue
        elif any_triangle(accelerator.blocks, ~code * BLOCK_SIZE, sheared, t_max, results) != 0:
            return True
        if top == 0:
            return False
        top -= 1
        code = stack[top]


@kernel
def closest_hits(
    start: Int,
    stop: Int,
    nodes: Any,
    blocks: Any,
    origins: Any,
    directions: Any,
    t_max: Any,
    t: Any,
    u: Any,
    v: Any,
    prim: Any,
) -> None:
    """Writes the first hit of each of the rays start .. stop - 1."""
    accelerator = Accelerator(pointer_to(nodes), pointer_to(blocks))
    scratch = Scratch(stack_words(STACK_SIZE), stack_words(WIDTH), stack_floats(RESULTS_SIZE))
    for i in range(start, stop):
        ox, oy, oz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        t[i], u[i], v[i], prim[i] = closest(accelerator, scratch, ox, oy, oz, dx, dy, dz, t_max[i])


@kernel
def any_hits(
    start: Int, stop: Int, nodes: Any, blocks: Any, origins: Any, directions: Any, t_max: Any, occluded: Any
) -> None:
    """Writes whether anything lies on each of the rays start .. stop - 1."""
    accelerator = Accelerator(pointer_to(nodes), pointer_to(blocks))
    scratch = Scratch(stack_words(STACK_SIZE), stack_words(WIDTH), stack_floats(RESULTS_SIZE))
    for i in range(start, stop):
        ox, oy, oz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        occluded[i] = is_occluded(accelerator, scratch, ox, oy, oz, dx, dy, dz, t_max[i])
