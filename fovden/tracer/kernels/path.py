"""One path: light that is sampled at every surface, bounces between them, and light that a bounce runs into.

At a surface one shadow ray goes to a light. A bounce may find the same light; then both count, weighted by the balance
heuristic: each by its share of the two densities (Veach and Guibas, "Optimally combining sampling techniques", 1995).
After the last bounce there is no further one, so light sampling stands alone there. Points and directions of light,
which no bounce can find, are sampled alone everywhere. Nothing is counted twice, and nothing is left out.

A path can be taped: what its value is made of, with the albedos apart from the numbers that do not depend on them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import pointer_to
from fovden.tracer.kernels.bsdf import evaluate, sample
from fovden.tracer.kernels.draws import draw
from fovden.tracer.kernels.illumination import (
    Lights,
    LightSample,
    LightTable,
    emitter_density,
    environment_radiance,
    light_pointers,
    sample_light,
    sky_density,
)
from fovden.tracer.kernels.surface import (
    Geometry,
    GeometryArrays,
    Surface,
    albedo_of,
    emitted,
    emitter_of,
    geometry_pointers,
    origin_above,
    surface_at,
)
from fovden.tracer.kernels.traversal import Accelerator, Scratch, closest, is_occluded
from fovden.tracer.kernels.vectors import Vector, added, dot, largest_component, product, scaled

ZERO, ONE, INFINITY = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
SURVIVAL = np.float32(0.95)
"""Greatest chance of a path to go on where it may end at random, as in Mitsuba 3: it also ends in white scenes."""

TAPE = 16
"""Numbers of a vertex on tape: PRIM, then its barycentric u and v; LIGHT, the row of the light that was sampled, and of
its share the part without albedo, WHITE, and per albedo, COLOURED; the same two of the bounce's weight; MET, the row
of the light that the bounce met, and MET_SCALE; and two directions, TO_LIGHT and TO_BOUNCE. A row is -1 for none."""
PRIM, LIGHT, WHITE, COLOURED, BOUNCE_WHITE, BOUNCE_COLOURED, MET, MET_SCALE = 0, 3, 4, 5, 6, 7, 8, 9
TO_LIGHT, TO_BOUNCE = 10, 13

KNOWN, LIT = 0, 1
WORD = 64


class World(NamedTuple):
    """All that a path meets."""

    accelerator: Accelerator
    geometry: Geometry
    lights: Lights


class Setting(NamedTuple):
    """How paths are made."""

    seed: Int
    stream: Int
    sampler: Int  # see ``draws``
    bounces: Int
    roulette: Int  # number of the bounce from which a path may end at random


class Tape(NamedTuple):
    """Where to write what a path is made of, TAPE numbers a vertex, and whether to."""

    numbers: Any
    runs: bool


class Sight(NamedTuple):
    """Which points and directions of light the first surface sees: the same shadow rays for all paths from there."""

    words: Any  # KNOWN, the rows that have been asked for, and of these LIT, those that nothing shadows, a bit a row


class Hit(NamedTuple):
    """A ray's first hit; ``prim`` is -1 for a miss."""

    t: Float
    u: Float
    v: Float
    prim: Int


@inlined
def open_world(nodes: Any, blocks: Any, geometry: GeometryArrays, lights: LightTable) -> World:
    """Pointers to all of a scene's arrays."""
    pointers = geometry_pointers(geometry)
    return World(Accelerator(pointer_to(nodes), pointer_to(blocks), pointers, True), pointers, light_pointers(lights))


@inlined
def trace(world: World, scratch: Scratch, origin: Vector, direction: Vector) -> Hit:
    """The first hit."""
    o, d = origin, direction
    t, u, v, prim = closest(world.accelerator, scratch, o.x, o.y, o.z, d.x, d.y, d.z, INFINITY)
    return Hit(t, u, v, np.int64(prim))


@inlined
def coloured(albedo: Vector, white: Float, share: Float) -> Vector:
    """White + albedo * share: a reflectance by its two numbers."""
    return Vector(white + albedo.x * share, white + albedo.y * share, white + albedo.z * share)


class Found(NamedTuple):
    """Light that a surface reflects: colour * (white + albedo * coloured)."""

    colour: Vector
    white: Float
    coloured: Float


@inlined
def forget(sight: Sight) -> None:
    """To be called where paths begin at another surface."""
    sight.words[KNOWN], sight.words[LIT] = 0, 0


@inlined
def is_lit(world: World, scratch: Scratch, surface: Surface, light: LightSample, sight: Sight, is_first: bool) -> bool:
    """Whether nothing lies between a surface and its light."""
    bit = np.int64(0)
    if is_first and light.density == ZERO and light.row < WORD:
        bit = np.int64(1) << np.int64(light.row)
        if sight.words[KNOWN] & bit:
            return bool(sight.words[LIT] & bit)
    o, d = origin_above(surface), light.direction
    lit = not is_occluded(world.accelerator, scratch, o.x, o.y, o.z, d.x, d.y, d.z, light.distance)
    sight.words[KNOWN] |= bit
    if lit:
        sight.words[LIT] |= bit
    return lit


@inlined
def sampled_light(
    world: World,
    scratch: Scratch,
    surface: Surface,
    viewer: Vector,
    xi: Vector,
    alone: bool,
    sight: Sight,
    tape: Tape,
    first: Int,
) -> Found:
    """Light of one randomly chosen light that the surface reflects: its share of all the light there.

    Where a bounce could find the light too and light sampling is not ``alone``, it is weighted accordingly.
    """
    light = sample_light(world.lights, world.geometry, surface, xi.x, xi.y, xi.z)
    reflection = evaluate(surface, viewer, light.direction)
    scale = light.scale * dot(light.direction, surface.normal)
    if light.density > ZERO and not alone:
        scale *= light.density / (light.density + reflection.density)
    # The geometric normal guards against light that would pass through the back of the surface.
    arrives = scale > ZERO and dot(light.direction, surface.geometric) > ZERO
    if arrives and is_lit(world, scratch, surface, light, sight, first == 0):
        white, share = scale * reflection.white, scale * reflection.coloured
        if tape.runs:
            tape.numbers[first + LIGHT] = np.float32(light.row)
            tape.numbers[first + WHITE], tape.numbers[first + COLOURED] = white, share
            write_three(tape.numbers, first + TO_LIGHT, light.direction)
        return Found(light.colour, white, share)
    return Found(light.colour, ZERO, ZERO)


@inlined
def met_light(
    world: World, surface: Surface, hit: Hit, direction: Vector, density: Float, tape: Tape, first: Int
) -> Vector:
    """Radiance of what a bounce ran into, weighted against light sampling; zero where that does not shine."""
    colour, row, other = Vector(ZERO, ZERO, ZERO), np.int64(-1), ZERO
    if hit.prim < 0:
        row = np.int64(world.lights.sky_row)
        if row >= 0:
            colour = environment_radiance(world.lights, direction)
            other = sky_density(world.lights, surface, direction)
    else:
        emitter = emitter_of(world.geometry, hit.prim)
        if emitter >= 0:
            colour = emitted(world.geometry, hit.prim, direction)
            if colour.x + colour.y + colour.z > ZERO:
                row = world.lights.first_emitter + emitter
                other = emitter_density(world.lights, world.geometry, surface, hit.prim, emitter, direction, hit.t)
    if row < 0:
        return colour
    scale = density / (density + other)
    if tape.runs:
        tape.numbers[first + MET], tape.numbers[first + MET_SCALE] = np.float32(row), scale
    return scaled(colour, scale)


@inlined
def write_three(numbers: Any, start: Int, a: Vector) -> None:
    """Writes three numbers side by side."""
    numbers[start], numbers[start + 1], numbers[start + 2] = a.x, a.y, a.z


@inlined
def begin_vertex(tape: Tape, first: Int, hit: Hit) -> None:
    """Writes where a vertex is, and that nothing is known of its light yet."""
    for i in range(TAPE):
        tape.numbers[first + i] = ZERO
    write_three(tape.numbers, first + PRIM, Vector(np.float32(hit.prim), hit.u, hit.v))
    tape.numbers[first + LIGHT], tape.numbers[first + MET] = -ONE, -ONE


@kernel
def trace_path(
    world: World,
    scratch: Scratch,
    sight: Sight,
    start: Hit,
    surface: Surface,
    albedo: Vector,
    viewer: Vector,
    setting: Setting,
    pixel: Int,
    view: Int,
    number: Int,
    tape: Tape,
) -> tuple[Vector, Vector]:
    """Direct and indirect light of one path from a surface to the viewer.

    Vertex k draws the random numbers of block 2 k for its light, the fourth for Russian roulette, and those of block
    2 k + 1 for its bounce.

    Args:
        world: The scene.
        scratch: The thread's working memory.
        sight: What is known of the light at the first surface.
        start: The hit of the first surface.
        surface: The first surface.
        albedo: Its albedo.
        viewer: Unit direction from there to the viewer.
        setting: How paths are made.
        pixel: Address of the random numbers, as are the next two.
        view: View.
        number: Sample.
        tape: Where to write what the path is made of.
    """
    direct, indirect = Vector(ZERO, ZERO, ZERO), Vector(ZERO, ZERO, ZERO)
    throughput, hit = Vector(ONE, ONE, ONE), start
    seed, stream, sampler = setting.seed, setting.stream, setting.sampler
    for vertex in range(setting.bounces + 1):
        first, is_last = np.int64(TAPE) * vertex, vertex == setting.bounces
        if tape.runs:
            begin_vertex(tape, first, hit)
        x, y, z, fate = draw(sampler, seed, stream, pixel, view, number, 2 * vertex)
        light = sampled_light(world, scratch, surface, viewer, Vector(x, y, z), is_last, sight, tape, first)
        if vertex > 0:
            albedo = albedo_of(world.geometry, surface)
        reflected = product(light.colour, coloured(albedo, light.white, light.coloured))
        found, goes_on = product(throughput, reflected), False
        if not is_last:
            x, y, z, _ = draw(sampler, seed, stream, pixel, view, number, 2 * vertex + 1)
            bounce = sample(surface, viewer, x, y, z)
            goes_on = bounce.density > ZERO and dot(bounce.direction, surface.geometric) > ZERO
            survival = ONE
            if vertex + 1 >= setting.roulette:
                weighted = product(throughput, coloured(albedo, bounce.white, bounce.coloured))
                survival = min(SURVIVAL, largest_component(weighted))
                goes_on = goes_on and fate < survival
            if goes_on:
                white, share = bounce.white / survival, bounce.coloured / survival
                throughput = product(throughput, coloured(albedo, white, share))
                hit = trace(world, scratch, origin_above(surface), bounce.direction)
                if tape.runs:
                    tape.numbers[first + BOUNCE_WHITE], tape.numbers[first + BOUNCE_COLOURED] = white, share
                    write_three(tape.numbers, first + TO_BOUNCE, bounce.direction)
                met = met_light(world, surface, hit, bounce.direction, bounce.density, tape, first)
                found = added(found, product(throughput, met), ONE)
                if hit.prim >= 0:
                    viewer = scaled(bounce.direction, -ONE)
                    surface = surface_at(world.geometry, hit.prim, hit.u, hit.v, bounce.direction)
        if vertex == 0:
            direct = found
        else:
            indirect = added(indirect, found, ONE)
        if not goes_on or hit.prim < 0:
            break
    return direct, indirect
