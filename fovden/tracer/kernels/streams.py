"""Walks the acceleration structure for many rays, a few of them in turn.

A processor that walks for one ray mostly waits: for the node that the last one named, for memory, and for branches that
it guessed wrong. Here SLOTS rays take turns, a step each: a node, or a leaf block. Every step asks for the memory of
the ray's next one, which the other rays' steps give time to arrive. Which children a ray meets, and how many, is no
branch: they go onto its stack by permutations, nearest or likeliest on top, and once a hit has made the ray shorter,
what lies beyond is taken off at once, so that the top of the stack is always the next step.

Where any hit will do, rays that follow each other are often stopped by the same triangles. Before a ray takes a turn,
it meets the leaf block that stopped the last one of its kind: rays whose directions have the same signs and the same
largest component. It then mostly needs no turn. After a ray of a kind that nothing stopped, no block is asked for the
next; and none is any more where too few of them stop a ray.

The answer for a ray does not depend on the others, nor on its place among them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import advanced, load_int32, pointer_to, prefetch, stack_floats, stack_int32, stack_words, store_int32
from fovden.tracer.kernels.boxes import drop_far, push_likeliest, push_nearest
from fovden.tracer.kernels.layout import (
    BLOCK_SIZE,
    HIT_PRIM,
    LIMIT,
    NODE_SIZE,
    OCTANT,
    RAY_SIZE,
    RESULTS_SIZE,
    STACK_SIZE,
    VERTEX_ROWS,
    WIDTH,
)
from fovden.tracer.kernels.rays import MISS, ZERO, is_traceable, prepare
from fovden.tracer.kernels.surface import RECORD, GeometryArrays, geometry_pointers
from fovden.tracer.kernels.traversal import Accelerator, found, is_any_solid, keep_nearest
from fovden.tracer.kernels.triangles import hit_triangles
from fovden.tracer.kernels.vectors import Vector, write_three

SLOTS = 4
LINE = 16  # float32 numbers of a cache line
ALL_RAYS, ALL_STACKS, ALL_RESULTS, ALL_WORDS = SLOTS * RAY_SIZE, SLOTS * STACK_SIZE, SLOTS * RESULTS_SIZE, 3 * SLOTS
FIRST: Any = np.bool_(False)  # which hit ``walk`` is asked for; Numba would compile it twice for two literals
ANY: Any = np.bool_(True)
DONE = -(1 << 40)  # in place of a child code
TOP, CODE, ITEM = 0, SLOTS, 2 * SLOTS  # of a slot's numbers in Slots.words
TRUST = 3 * WIDTH  # in Slots.blockers, after a leaf block for every kind of rays (its child code; 0 for none)
BLOCKERS = TRUST + 1
MOST_TRUST, EARNED = 32, 3  # asking is worth its cost where a quarter of the blocks that are asked stop the ray
RAYS_AT_ONCE = 4096
SOME = np.int32(0)  # in place of a triangle, where any will do


class Slots(NamedTuple):
    """The rays that take turns: what they are, their stacks (see ``boxes``), and three numbers of each.

    And for all of them the blocks that stopped the last rays, see :func:`is_blocked`.
    """

    rays: Any
    distances: Any
    stacks: Any
    results: Any
    words: Any
    blockers: Any


class Rays(NamedTuple):
    """Pointers to origins (n, 3), directions (n, 3) and limits (n)."""

    origins: Any
    directions: Any
    t_max: Any


class Hits(NamedTuple):
    """Pointers to what rays meet: t, u, v (n), and the triangle, int32 (n), or SOME for any."""

    t: Any
    u: Any
    v: Any
    prim: Any


@inlined
def put_ray(rays: Rays, k: Int, origin: Vector, direction: Vector, t_max: Float) -> None:
    """Writes a ray."""
    write_three(rays.origins, 3 * k, origin)
    write_three(rays.directions, 3 * k, direction)
    rays.t_max[k] = t_max


@inlined
def start_ray(rays: Rays, item: Int, slots: Slots, slot: Int) -> None:
    """Puts a ray into a slot; one that cannot be traced becomes so short that it misses everything."""
    k = 3 * item
    ox, oy, oz = rays.origins[k], rays.origins[k + 1], rays.origins[k + 2]
    dx, dy, dz = rays.directions[k], rays.directions[k + 1], rays.directions[k + 2]
    slots.words[ITEM + slot], slots.words[TOP + slot], slots.words[CODE + slot] = item, 0, 0
    t_max = rays.t_max[item] if is_traceable(ox, oy, oz, dx, dy, dz) else ZERO
    prepare(advanced(slots.rays, RAY_SIZE * slot), ox, oy, oz, dx, dy, dz, t_max)


@inlined
def move_slot(slots: Slots, source: Int, target: Int) -> None:
    """Copies the ray of a slot to another."""
    for k in range(RAY_SIZE):
        store_int32(slots.rays, RAY_SIZE * target + k, load_int32(slots.rays, RAY_SIZE * source + k))
    for k in range(slots.words[TOP + source]):
        store_int32(slots.distances, STACK_SIZE * target + k, load_int32(slots.distances, STACK_SIZE * source + k))
        store_int32(slots.stacks, STACK_SIZE * target + k, load_int32(slots.stacks, STACK_SIZE * source + k))
    for field in (TOP, CODE, ITEM):
        slots.words[field + target] = slots.words[field + source]


@inlined
def kind_of(slots: Slots, slot: Int) -> Int:
    """The kind of a slot's ray: the signs of its direction, and which of its components is the largest."""
    ray = RAY_SIZE * slot
    return np.int64(load_int32(slots.rays, ray + OCTANT) + load_int32(slots.rays, ray + VERTEX_ROWS))


@inlined
def is_blocked(accelerator: Accelerator, slots: Slots, slot: Int) -> bool:
    """Whether the leaf block that stopped the last ray of this kind, if it is to be asked, stops this one as well."""
    code, trust = slots.blockers[kind_of(slots, slot)], slots.blockers[TRUST]
    if code == 0 or trust == 0:
        return False
    base, results = ~code * BLOCK_SIZE, advanced(slots.results, RESULTS_SIZE * slot)
    mask = hit_triangles(accelerator.blocks, base, advanced(slots.rays, RAY_SIZE * slot), results)
    blocked = mask != 0 and is_any_solid(accelerator, base, mask, results)
    slots.blockers[TRUST] = min(trust + EARNED, MOST_TRUST) if blocked else trust - 1
    return blocked


@kernel
def refill(
    accelerator: Accelerator, rays: Rays, stop: Int, slots: Slots, item: Int, active: Int, any_hit: bool, hits: Hits
) -> tuple[Int, Int]:
    """Gives the slots that are done, and those not yet used, the next rays; the last slots move down if there are none.

    Returns the number of the next ray, and how many slots are in use.
    """
    slot = np.int64(0)
    while slot < active or (slot < SLOTS and item < stop):
        if slot < active and slots.words[CODE + slot] != DONE:
            slot += 1
        elif item < stop:
            start_ray(rays, item, slots, slot)
            if any_hit and is_blocked(accelerator, slots, slot):
                slots.words[CODE + slot] = DONE
                hits.prim[item] = SOME
            else:
                slot += 1
                active = max(active, slot)
            item += 1
        else:
            active -= 1
            if slot < active:
                move_slot(slots, active, slot)
    return item, active


@inlined
def shorten(slots: Slots, slot: Int) -> None:
    """Takes off a slot's stack what lies beyond its ray's limit."""
    k, limit = STACK_SIZE * slot, slots.rays[RAY_SIZE * slot + LIMIT]
    end, top, first = slots.words[TOP + slot], np.int64(0), np.int64(0)
    while first < end:
        top = drop_far(advanced(slots.distances, k), advanced(slots.stacks, k), first, top, end, limit)
        first += WIDTH
    slots.words[TOP + slot] = top


@inlined
def next_step(accelerator: Accelerator, slots: Slots, slot: Int) -> bool:
    """Takes a slot's next child from its stack and asks for its memory; returns whether there is none."""
    top = slots.words[TOP + slot] - 1
    if top < 0:
        slots.words[CODE + slot] = DONE
        return True
    code = np.int64(load_int32(slots.stacks, STACK_SIZE * slot + top))
    slots.words[TOP + slot], slots.words[CODE + slot] = top, code
    if code >= 0:
        for line in range(NODE_SIZE // LINE):
            prefetch(accelerator.nodes, code * NODE_SIZE + line * LINE)
    else:
        for line in range(BLOCK_SIZE // LINE):
            prefetch(accelerator.blocks, ~code * BLOCK_SIZE + line * LINE)
    return False


@inlined
def step(accelerator: Accelerator, slots: Slots, slot: Int, any_hit: bool) -> None:
    """A slot's step: puts the children of a node that its ray meets on its stack, or meets the triangles of a block."""
    code, ray, k = slots.words[CODE + slot], advanced(slots.rays, RAY_SIZE * slot), STACK_SIZE * slot
    if code >= 0:
        nodes, base, top = accelerator.nodes, code * NODE_SIZE, slots.words[TOP + slot]
        distances, stack = advanced(slots.distances, k), advanced(slots.stacks, k)
        if any_hit:
            slots.words[TOP + slot] = push_likeliest(nodes, base, ray, stack, top)
        else:
            slots.words[TOP + slot] = push_nearest(nodes, base, ray, distances, stack, top)
        return
    base, results = ~code * BLOCK_SIZE, advanced(slots.results, RESULTS_SIZE * slot)
    mask = hit_triangles(accelerator.blocks, base, ray, results)
    if mask == 0:
        return
    if any_hit:
        if is_any_solid(accelerator, base, mask, results):
            store_int32(ray, HIT_PRIM, SOME)
            slots.words[TOP + slot] = 0
            slots.blockers[kind_of(slots, slot)] = code
    elif keep_nearest(accelerator, base, mask, results, ray):
        shorten(slots, slot)


@inlined
def answer(accelerator: Accelerator, slots: Slots, slot: Int, any_hit: bool, hits: Hits) -> None:
    """Writes what a slot's ray has met, and asks for the record of a triangle that is the first."""
    k, ray = slots.words[ITEM + slot], advanced(slots.rays, RAY_SIZE * slot)
    if any_hit:
        hits.prim[k] = load_int32(ray, HIT_PRIM)
        if hits.prim[k] == MISS:
            slots.blockers[kind_of(slots, slot)] = 0
    else:
        t, u, v, prim = found(ray)
        hits.t[k], hits.u[k], hits.v[k], hits.prim[k] = t, u, v, prim
        prefetch(accelerator.geometry.triangles, RECORD * np.int64(prim))
        prefetch(accelerator.geometry.triangles, RECORD * np.int64(prim) + LINE)


@inlined
def walk_in_turn(accelerator: Accelerator, rays: Rays, start: Int, stop: Int, any_hit: bool, hits: Hits) -> None:
    """Writes the first hit of each of the rays start .. stop - 1; or only whether there is any, as SOME or MISS."""
    slots = Slots(
        stack_floats(ALL_RAYS),
        stack_floats(ALL_STACKS),
        stack_floats(ALL_STACKS),
        stack_floats(ALL_RESULTS),
        stack_words(ALL_WORDS),
        stack_words(BLOCKERS),
    )
    for kind in range(TRUST):
        slots.blockers[kind] = 0
    slots.blockers[TRUST] = MOST_TRUST
    item, active = refill(accelerator, rays, stop, slots, start, np.int64(0), any_hit, hits)
    while active > 0:
        ended = False
        while not ended:
            for slot in range(active):
                step(accelerator, slots, slot, any_hit)
            for slot in range(active):
                if next_step(accelerator, slots, slot):
                    answer(accelerator, slots, slot, any_hit, hits)
                    ended = True
        item, active = refill(accelerator, rays, stop, slots, item, active, any_hit, hits)


@kernel
def walk(accelerator: Accelerator, rays: Rays, start: Int, stop: Int, any_hit: bool, hits: Hits) -> None:
    """:func:`walk_in_turn` for kernels that ask for both: compiled once, which is what takes long."""
    walk_in_turn(accelerator, rays, start, stop, any_hit, hits)


@kernel
def closest_hits(
    start: Int,
    stop: Int,
    nodes: Any,
    blocks: Any,
    geometry: GeometryArrays,
    holes: bool,
    origins: Any,
    directions: Any,
    t_max: Any,
    t: Any,
    u: Any,
    v: Any,
    prim: Any,
) -> None:
    """Writes the first hit of each of the rays start .. stop - 1 of arrays."""
    accelerator = Accelerator(pointer_to(nodes), pointer_to(blocks), geometry_pointers(geometry), holes)
    rays = Rays(pointer_to(origins), pointer_to(directions), pointer_to(t_max))
    hits = Hits(pointer_to(t), pointer_to(u), pointer_to(v), pointer_to(prim))
    walk_in_turn(accelerator, rays, start, stop, False, hits)


@kernel
def any_hits(
    start: Int,
    stop: Int,
    nodes: Any,
    blocks: Any,
    geometry: GeometryArrays,
    holes: bool,
    origins: Any,
    directions: Any,
    t_max: Any,
    hit: Any,
) -> None:
    """Writes whether each of the rays start .. stop - 1 of arrays hits anything."""
    accelerator = Accelerator(pointer_to(nodes), pointer_to(blocks), geometry_pointers(geometry), holes)
    nothing, prim = stack_floats(1), stack_int32(RAYS_AT_ONCE)
    for first in range(start, stop, RAYS_AT_ONCE):
        rays = Rays(
            advanced(pointer_to(origins), 3 * first),
            advanced(pointer_to(directions), 3 * first),
            advanced(pointer_to(t_max), first),
        )
        count = min(stop - first, RAYS_AT_ONCE)
        walk_in_turn(accelerator, rays, np.int64(0), count, True, Hits(nothing, nothing, nothing, prim))
        for k in range(count):
            hit[first + k] = prim[k] >= 0
