"""Paths side by side: a batch of them is led from surface to surface in stages, and every stage works on all of them.

A path by itself waits: its rays for nodes, its surfaces for triangles and texels. For a batch there are four stages a
surface:

1. ``shade``: every path samples a light and a bounce, and leaves a shadow ray and a bounce ray behind;
2. all shadow rays are traced, a few of them in turn (``streams``), and what arrives is added to the paths' light;
3. so are all bounce rays, and the memory of the triangles that they hit is asked for;
4. ``arrive``: what shines there is added, and the paths that hit a surface are those that go on.

Paths that begin at the same surface share their shadow rays to points and directions of light.

What a path finds depends neither on its batch nor on its place there, and is added in the order of its surfaces.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import advanced, prefetch, stack_bytes, stack_floats, stack_int32, stack_words
from fovden.tracer.kernels.bsdf import sample
from fovden.tracer.kernels.draws import draw
from fovden.tracer.kernels.path import (
    BLACK,
    TAPE,
    Hit,
    Setting,
    Tape,
    World,
    coloured,
    met_light,
    sampled_light,
    tape_bounce,
    tape_light,
    tape_vertex,
    write_three,
)
from fovden.tracer.kernels.streams import LINE, Hits, Rays, walk_any, walk_closest
from fovden.tracer.kernels.surface import RECORD, Surface, albedo_of, origin_above, surface_at, three
from fovden.tracer.kernels.vectors import Vector, added, dot, largest_component, product, scaled

ZERO, ONE, INFINITY = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
SURVIVAL = np.float32(0.95)
"""Greatest chance of a path to go on where it may end at random, as in Mitsuba 3: it also ends in white scenes."""

PATHS = 128
"""Paths of a batch. Their numbers should stay in the fastest cache."""

# Numbers of a path: where it is, what light still weighs there, what it has found, and what it waits for.
POSITION, NORMAL, GEOMETRIC, OFFSET, S, T, ROUGHNESS, METALLIC = 0, 3, 6, 9, 10, 11, 12, 13
VIEWER, ALBEDO, THROUGHPUT, DIRECT, INDIRECT, ASKED, DENSITY = 14, 17, 20, 23, 26, 29, 32
NUMBERS = 33
# And words: the address of its random numbers, the first path of the batch that begins at the same surface (-1 where
# there is none), its place on tape, and its shadow ray (-1 for none).
MATERIAL, MODEL, PIXEL, VIEW, SAMPLE, ORIGIN, TAPED, SHADOW = 0, 1, 2, 3, 4, 5, 6, 7
WORDS = 8
NUMBERS_OF_ALL, WORDS_OF_ALL, THREE_OF_ALL = PATHS * NUMBERS, PATHS * WORDS, 3 * PATHS


class Batch(NamedTuple):
    """The paths; the kernel that loops over items allocates them, since an inlined function's stack ends with it."""

    numbers: Any  # NUMBERS_OF_ALL
    words: Any  # WORDS_OF_ALL


class Shadows(NamedTuple):
    """Shadow rays, and for whom: the origin and the light's row where paths may share them, -1 where not."""

    rays: Rays
    origins: Any
    rows: Any


@inlined
def path_of(batch: Batch, i: Int) -> Batch:
    """One of the paths."""
    return Batch(advanced(batch.numbers, NUMBERS * i), advanced(batch.words, WORDS * i))


@inlined
def put_surface(path: Batch, surface: Surface, viewer: Vector) -> None:
    """Writes where a path is, and from where that is seen."""
    numbers, words = path.numbers, path.words
    write_three(numbers, POSITION, surface.position)
    write_three(numbers, NORMAL, surface.normal)
    write_three(numbers, GEOMETRIC, surface.geometric)
    write_three(numbers, VIEWER, viewer)
    numbers[OFFSET], numbers[S], numbers[T] = surface.offset, surface.s, surface.t
    numbers[ROUGHNESS], numbers[METALLIC] = surface.roughness, surface.metallic
    words[MATERIAL], words[MODEL] = surface.material, surface.model


@inlined
def surface_of(path: Batch) -> Surface:
    """Where a path is."""
    numbers, words = path.numbers, path.words
    return Surface(
        three(numbers, POSITION),
        three(numbers, NORMAL),
        three(numbers, GEOMETRIC),
        numbers[OFFSET],
        words[MATERIAL],
        numbers[S],
        numbers[T],
        np.int32(words[MODEL]),
        numbers[ROUGHNESS],
        numbers[METALLIC],
    )


@inlined
def put_path(path: Batch, surface: Surface, viewer: Vector, origin: Int, pixel: Int, view: Int, number: Int) -> None:
    """Begins a path at a surface, or, where the origin is -1, nowhere: then it finds nothing."""
    put_surface(path, surface, viewer)
    write_three(path.numbers, THROUGHPUT, Vector(ONE, ONE, ONE))
    write_three(path.numbers, DIRECT, BLACK)
    write_three(path.numbers, INDIRECT, BLACK)
    path.words[ORIGIN], path.words[PIXEL], path.words[VIEW], path.words[SAMPLE] = origin, pixel, view, number


@inlined
def tape_of(path: Batch, tape: Tape, vertex: Int) -> Tape:
    """Where a vertex of a path is written down."""
    place = path.words[TAPED] + np.int64(TAPE) * vertex if tape.runs else np.int64(0)
    return Tape(advanced(tape.numbers, place), tape.runs)


@inlined
def gain(path: Batch, vertex: Int, light: Vector) -> None:
    """Adds what a path has found at a surface, or beyond it."""
    place = DIRECT if vertex == 0 else INDIRECT
    write_three(path.numbers, place, added(three(path.numbers, place), light, ONE))


@inlined
def put_ray(rays: Rays, k: Int, origin: Vector, direction: Vector, t_max: Float) -> None:
    """Writes a ray."""
    write_three(rays.origins, 3 * k, origin)
    write_three(rays.directions, 3 * k, direction)
    rays.t_max[k] = t_max


@inlined
def ask_for_light(
    world: World, path: Batch, surface: Surface, xi: Vector, vertex: Int, alone: bool, tape: Tape, shadows: Shadows,
    asked: Int,
) -> Int:  # fmt: skip
    """Samples a light, and writes a shadow ray unless there is one already; returns the number of shadow rays."""
    light = sampled_light(world, surface, three(path.numbers, VIEWER), xi, alone)
    path.words[SHADOW] = -1
    if not light.shines:
        return asked
    reflected = product(light.colour, coloured(three(path.numbers, ALBEDO), light.white, light.coloured))
    write_three(path.numbers, ASKED, product(three(path.numbers, THROUGHPUT), reflected))
    if tape.runs:
        tape_light(tape, np.int64(0), light.row, light.white, light.coloured, light.direction)
    row = np.int64(light.row) if light.is_fixed and vertex == 0 else np.int64(-1)
    k = asked - 1
    while k >= 0 and row >= 0 and shadows.rows[k] != row:
        k = k - 1 if shadows.origins[k] == path.words[ORIGIN] else np.int64(-1)
    if k < 0 or row < 0 or shadows.origins[k] != path.words[ORIGIN]:
        k = asked
        put_ray(shadows.rays, k, origin_above(surface), light.direction, light.distance)
        shadows.origins[k], shadows.rows[k] = path.words[ORIGIN], row
    path.words[SHADOW] = k
    return max(asked, k + 1)


@inlined
def leave(
    path: Batch, surface: Surface, xi: Vector, fate: Float, is_risky: bool, tape: Tape, rays: Rays, k: Int
) -> bool:
    """Samples a bounce, and writes its ray as the k-th; returns whether there is one. Risky ones may end at random."""
    bounce = sample(surface, three(path.numbers, VIEWER), xi.x, xi.y, xi.z)
    goes_on = bounce.density > ZERO and dot(bounce.direction, surface.geometric) > ZERO
    throughput, albedo, survival = three(path.numbers, THROUGHPUT), three(path.numbers, ALBEDO), ONE
    if is_risky:
        weighted = product(throughput, coloured(albedo, bounce.white, bounce.coloured))
        survival = min(SURVIVAL, largest_component(weighted))
        goes_on = goes_on and fate < survival
    if goes_on:
        white, share = bounce.white / survival, bounce.coloured / survival
        write_three(path.numbers, THROUGHPUT, product(throughput, coloured(albedo, white, share)))
        path.numbers[DENSITY] = bounce.density
        put_ray(rays, k, origin_above(surface), bounce.direction, INFINITY)
        if tape.runs:
            tape_bounce(tape, np.int64(0), white, share, bounce)
    return bool(goes_on)


@inlined
def arrive(world: World, path: Batch, hit: Hit, direction: Vector, vertex: Int, tape: Tape) -> bool:
    """Adds the light that the bounce from a vertex met; returns whether it met a surface, at which the path then is."""
    here = tape_of(path, tape, vertex)
    met = met_light(world, surface_of(path), hit, direction, path.numbers[DENSITY], here, np.int64(0))
    gain(path, vertex, product(three(path.numbers, THROUGHPUT), met))
    if hit.prim < 0:
        return False
    put_surface(path, surface_at(world.geometry, hit.prim, hit.u, hit.v, direction), scaled(direction, -ONE))
    if tape.runs:
        tape_vertex(tape_of(path, tape, vertex + 1), np.int64(0), hit)
    return True


@kernel
def trace_paths(world: World, batch: Batch, count: Int, setting: Setting, tape: Tape) -> None:
    """Leads paths from the surfaces where they begin through their bounces, and writes DIRECT and INDIRECT light.

    Vertex k draws the random numbers of block 2 k for its light, the fourth for Russian roulette, and those of block
    2 k + 1 for its bounce.

    Args:
        world: The scene.
        batch: The paths, see :func:`put_path`; on tape they have their first vertex.
        count: Number of paths, at most PATHS.
        setting: How paths are made.
        tape: Where to write what the paths are made of.
    """
    alive, away, occluded = stack_words(PATHS), stack_words(PATHS), stack_bytes(PATHS)
    rays = Rays(stack_floats(THREE_OF_ALL), stack_floats(THREE_OF_ALL), stack_floats(PATHS))
    hits = Hits(stack_floats(PATHS), stack_floats(PATHS), stack_floats(PATHS), stack_int32(PATHS))
    shadow_rays = Rays(stack_floats(THREE_OF_ALL), stack_floats(THREE_OF_ALL), stack_floats(PATHS))
    shadows = Shadows(shadow_rays, stack_words(PATHS), stack_words(PATHS))
    living = np.int64(0)
    for i in range(count):
        if batch.words[WORDS * i + ORIGIN] >= 0:
            alive[living] = i
            living += 1
    for vertex in range(setting.bounces + 1):
        is_last, is_risky = vertex == setting.bounces, vertex + 1 >= setting.roulette
        asked, leaving = np.int64(0), np.int64(0)
        for n in range(living):
            path = path_of(batch, alive[n])
            words, here, surface = path.words, tape_of(path, tape, vertex), surface_of(path)
            if vertex > 0 or words[ORIGIN] == alive[n]:
                albedo = albedo_of(world.geometry, surface)
            else:
                albedo = three(batch.numbers, NUMBERS * words[ORIGIN] + ALBEDO)
            write_three(path.numbers, ALBEDO, albedo)
            pixel, view, number = words[PIXEL], words[VIEW], words[SAMPLE]
            x, y, z, fate = draw(setting.sampler, setting.seed, setting.stream, pixel, view, number, 2 * vertex)
            asked = ask_for_light(world, path, surface, Vector(x, y, z), vertex, is_last, here, shadows, asked)
            if not is_last:
                x, y, z, _ = draw(setting.sampler, setting.seed, setting.stream, pixel, view, number, 2 * vertex + 1)
                if leave(path, surface, Vector(x, y, z), fate, is_risky, here, rays, leaving):
                    away[leaving] = alive[n]
                    leaving += 1
        walk_any(world.accelerator, shadow_rays, np.int64(0), asked, occluded)
        for n in range(living):
            path = path_of(batch, alive[n])
            k = path.words[SHADOW]
            if k >= 0 and occluded[k] == 0:
                gain(path, vertex, three(path.numbers, ASKED))
            elif k >= 0 and tape.runs:
                here = tape_of(path, tape, vertex)
                tape_light(here, np.int64(0), np.int64(-1), ZERO, ZERO, BLACK)
        walk_closest(world.accelerator, rays, np.int64(0), leaving, hits)
        for n in range(leaving):
            prefetch(world.geometry.triangles, RECORD * np.int64(hits.prim[n]))
            prefetch(world.geometry.triangles, RECORD * np.int64(hits.prim[n]) + LINE)
        living = np.int64(0)
        for n in range(leaving):
            path, hit = path_of(batch, away[n]), Hit(hits.t[n], hits.u[n], hits.v[n], np.int64(hits.prim[n]))
            if arrive(world, path, hit, three(rays.directions, 3 * n), vertex, tape):
                alive[living] = away[n]
                living += 1
