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
from fovden.simd import advanced, stack_floats, stack_int32, stack_words
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
)
from fovden.tracer.kernels.streams import ANY, FIRST, Hits, Rays, put_ray, walk
from fovden.tracer.kernels.surface import Geometry, Surface, albedo_of, origin_above, surface_at, three
from fovden.tracer.kernels.vectors import Vector, added, dot, largest_component, product, scaled, write_three

START = np.int64(0)
ZERO, ONE, INFINITY = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
SURVIVAL = np.float32(0.95)
"""Greatest chance of a path to go on where it may end at random, as in Mitsuba 3: it also ends in white scenes."""

PATHS = 128
"""Paths of a batch. Their numbers should stay in the fastest cache."""

# Numbers of a path: where it is, what light still weighs there, what it has found, and what it waits for.
# (As int64: Numba compiles a function anew for every literal.)
POSITION, NORMAL, GEOMETRIC, VIEWER, ALBEDO, THROUGHPUT, DIRECT, INDIRECT, ASKED = (np.int64(3 * k) for k in range(9))
OFFSET, S, T, ROUGHNESS, METALLIC, DENSITY = 27, 28, 29, 30, 31, 32
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


@kernel
def put_surface(geometry: Geometry, path: Batch, hit: Hit, direction: Vector) -> None:
    """Writes where a path is: at the surface that a ray of this direction hit."""
    surface = surface_at(geometry, hit.prim, hit.u, hit.v, direction)
    numbers, words = path.numbers, path.words
    write_three(numbers, POSITION, surface.position)
    write_three(numbers, NORMAL, surface.normal)
    write_three(numbers, GEOMETRIC, surface.geometric)
    write_three(numbers, VIEWER, scaled(direction, -ONE))
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


@kernel
def put_path(world: World, batch: Batch, i: Int, hit: Hit, direction: Vector, pixel: Int, view: Int) -> None:
    """Begins the i-th path where a camera ray hit a surface; if it hit none there is no path, and no light is found."""
    path = path_of(batch, i)
    path.words[ORIGIN], path.words[PIXEL], path.words[VIEW] = np.int64(-1), pixel, view
    write_three(path.numbers, THROUGHPUT, Vector(ONE, ONE, ONE))
    write_three(path.numbers, DIRECT, BLACK)
    write_three(path.numbers, INDIRECT, BLACK)
    if hit.prim >= 0:
        path.words[ORIGIN] = i
        put_surface(world.geometry, path, hit, direction)


@inlined
def repeat_path(batch: Batch, i: Int) -> None:
    """Begins the i-th path where the one before it does, which has not gone on yet."""
    path, before = path_of(batch, i), path_of(batch, i - 1)
    for k in range(NUMBERS):
        path.numbers[k] = before.numbers[k]
    for k in range(WORDS):
        path.words[k] = before.words[k]


@inlined
def tape_of(path: Batch, tape: Tape, vertex: Int) -> Tape:
    """Where a vertex of a path is written down."""
    place = path.words[TAPED] + np.int64(TAPE) * vertex if tape.runs else START
    return Tape(advanced(tape.numbers, place), tape.runs)


@inlined
def gain(path: Batch, vertex: Int, light: Vector) -> None:
    """Adds what a path has found at a surface, or beyond it."""
    place = DIRECT if vertex == 0 else INDIRECT
    write_three(path.numbers, place, added(three(path.numbers, place), light, ONE))


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
        tape_light(tape, light.row, light.white, light.coloured, light.direction)
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
    goes_on = bool(bounce.density > ZERO and dot(bounce.direction, surface.geometric) > ZERO)
    throughput, albedo, survival = three(path.numbers, THROUGHPUT), three(path.numbers, ALBEDO), ONE
    if is_risky:
        weighted = product(throughput, coloured(albedo, bounce.white, bounce.coloured))
        survival = min(SURVIVAL, largest_component(weighted))
        goes_on = bool(goes_on and fate < survival)
    if goes_on:
        white, share = bounce.white / survival, bounce.coloured / survival
        write_three(path.numbers, THROUGHPUT, product(throughput, coloured(albedo, white, share)))
        path.numbers[DENSITY] = bounce.density
        put_ray(rays, k, origin_above(surface), bounce.direction, INFINITY)
        if tape.runs:
            tape_bounce(tape, white, share, bounce)
    return bool(goes_on)


@inlined
def arrive(world: World, path: Batch, hit: Hit, direction: Vector, vertex: Int, tape: Tape) -> bool:
    """Adds the light that the bounce from a vertex met; returns whether it met a surface, at which the path then is."""
    here = tape_of(path, tape, vertex)
    met = met_light(world, surface_of(path), hit, direction, path.numbers[DENSITY], here)
    gain(path, vertex, product(three(path.numbers, THROUGHPUT), met))
    if hit.prim < 0:
        return False
    put_surface(world.geometry, path, hit, direction)
    if tape.runs:
        tape_vertex(tape_of(path, tape, vertex + 1), hit)
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
    alive, away = stack_words(PATHS), stack_words(PATHS)
    rays = Rays(stack_floats(THREE_OF_ALL), stack_floats(THREE_OF_ALL), stack_floats(PATHS))
    hits = Hits(stack_floats(PATHS), stack_floats(PATHS), stack_floats(PATHS), stack_int32(PATHS))
    shadow_rays = Rays(stack_floats(THREE_OF_ALL), stack_floats(THREE_OF_ALL), stack_floats(PATHS))
    shadows = Shadows(shadow_rays, stack_words(PATHS), stack_words(PATHS))
    living = START
    for i in range(count):
        if batch.words[WORDS * i + ORIGIN] >= 0:
            alive[living] = i
            living += 1
    for vertex in range(setting.bounces + 1):
        is_last, is_risky = vertex == setting.bounces, vertex + 1 >= setting.roulette
        asked, leaving = START, START
        for n in range(living):
            path = path_of(batch, alive[n])
            origin = path.words[ORIGIN]
            if vertex > 0 or origin == alive[n]:
                albedo = albedo_of(world.geometry, surface_of(path))
            else:
                albedo = three(batch.numbers, NUMBERS * origin + ALBEDO)
            write_three(path.numbers, ALBEDO, albedo)
        for n in range(living):
            path = path_of(batch, alive[n])
            words, here, surface = path.words, tape_of(path, tape, vertex), surface_of(path)
            pixel, view, number = words[PIXEL], words[VIEW], words[SAMPLE]
            x, y, z, fate = draw(setting.sampler, setting.seed, setting.stream, pixel, view, number, 2 * vertex)
            asked = ask_for_light(world, path, surface, Vector(x, y, z), vertex, is_last, here, shadows, asked)
            if not is_last:
                x, y, z, _ = draw(setting.sampler, setting.seed, setting.stream, pixel, view, number, 2 * vertex + 1)
                if leave(path, surface, Vector(x, y, z), fate, is_risky, here, rays, leaving):
                    away[leaving] = alive[n]
                    leaving += 1
        walk(world.accelerator, shadow_rays, START, asked, ANY, hits)
        for n in range(living):
            path = path_of(batch, alive[n])
            k = path.words[SHADOW]
            if k >= 0 and hits.prim[k] < 0:
                gain(path, vertex, three(path.numbers, ASKED))
            elif k >= 0 and tape.runs:
                here = tape_of(path, tape, vertex)
                tape_light(here, np.int64(-1), ZERO, ZERO, BLACK)
        walk(world.accelerator, rays, START, leaving, FIRST, hits)
        living = START
        for n in range(leaving):
            path, hit = path_of(batch, away[n]), Hit(hits.t[n], hits.u[n], hits.v[n], np.int64(hits.prim[n]))
            if arrive(world, path, hit, three(rays.directions, 3 * n), vertex, tape):
                alive[living] = away[n]
                living += 1
