"""What happens at one surface of a path: light that is sampled there, and light that the bounce from there runs into.

At a surface one shadow ray goes to a light. A bounce may find the same light; then both count, weighted by the balance
heuristic: each by its share of the two densities (Veach and Guibas, "Optimally combining sampling techniques", 1995).
After the last bounce there is no further one, so light sampling stands alone there. Points and directions of light,
which no bounce can find, are sampled alone everywhere. Nothing is counted twice, and nothing is left out.

A path can be taped: what its value is made of, with the albedos apart from the numbers that do not depend on them.

:mod:`fovden.tracer.kernels.wavefront` leads paths from surface to surface.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined
from fovden.simd import pointer_to
from fovden.tracer.kernels.bsdf import Bounce, evaluate
from fovden.tracer.kernels.illumination import (
    Lights,
    LightTable,
    emitter_density,
    environment_radiance,
    light_pointers,
    sample_light,
    sky_density,
)
from fovden.tracer.kernels.surface import Geometry, GeometryArrays, Surface, emitted, emitter_of, geometry_pointers
from fovden.tracer.kernels.traversal import Accelerator
from fovden.tracer.kernels.vectors import Vector, dot, scaled, write_three

ZERO, ONE = np.float32(0.0), np.float32(1.0)
BLACK = Vector(ZERO, ZERO, ZERO)

TAPE = 16
"""Numbers of a vertex on tape: PRIM, then its barycentric u and v; LIGHT, the row of the light that was sampled, and of
its share the part without albedo, WHITE, and per albedo, COLOURED; the same two of the bounce's weight; MET, the row
of the light that the bounce met, and MET_SCALE; and two directions, TO_LIGHT and TO_BOUNCE. A row is -1 for none."""
PRIM, LIGHT, WHITE, COLOURED, BOUNCE_WHITE, BOUNCE_COLOURED, MET, MET_SCALE = 0, 3, 4, 5, 6, 7, 8, 9
TO_LIGHT, TO_BOUNCE = 10, 13


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
    """Where to write what a vertex is made of, or all of them, TAPE numbers each, and whether to."""

    numbers: Any
    runs: bool


class Hit(NamedTuple):
    """A ray's first hit; ``prim`` is -1 for a miss."""

    t: Float
    u: Float
    v: Float
    prim: Int


class Lamp(NamedTuple):
    """Light that a surface reflects if nothing lies on the way: colour * (white + albedo * coloured)."""

    direction: Vector
    distance: Float
    colour: Vector
    white: Float
    coloured: Float
    row: Int
    shines: bool
    is_fixed: bool  # whether the way is the same whenever this surface chooses this light


@inlined
def open_world(nodes: Any, blocks: Any, geometry: GeometryArrays, lights: LightTable) -> World:
    """Pointers to all of a scene's arrays."""
    pointers = geometry_pointers(geometry)
    return World(Accelerator(pointer_to(nodes), pointer_to(blocks), pointers, True), pointers, light_pointers(lights))


@inlined
def coloured(albedo: Vector, white: Float, share: Float) -> Vector:
    """White + albedo * share: a reflectance by its two numbers."""
    return Vector(white + albedo.x * share, white + albedo.y * share, white + albedo.z * share)


@inlined
def sampled_light(world: World, surface: Surface, viewer: Vector, xi: Vector, alone: bool) -> Lamp:
    """One randomly chosen light: its share of all the light that the surface reflects.

    Where a bounce could find the light too and light sampling is not ``alone``, it is weighted accordingly.
    """
    light = sample_light(world.lights, world.geometry, surface, xi.x, xi.y, xi.z)
    reflection = evaluate(surface, viewer, light.direction)
    scale = light.scale * dot(light.direction, surface.normal)
    if light.density > ZERO and not alone:
        scale *= light.density / (light.density + reflection.density)
    # The geometric normal guards against light that would pass through the back of the surface.
    shines = scale > ZERO and dot(light.direction, surface.geometric) > ZERO
    white, share = scale * reflection.white, scale * reflection.coloured
    return Lamp(light.direction, light.distance, light.colour, white, share, light.row, shines, light.density == ZERO)


@inlined
def met_light(world: World, surface: Surface, hit: Hit, direction: Vector, density: Float, tape: Tape) -> Vector:
    """Radiance of what a bounce ran into, weighted against light sampling; zero where that does not shine."""
    colour, row, other = BLACK, np.int64(-1), ZERO
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
        tape.numbers[MET], tape.numbers[MET_SCALE] = np.float32(row), scale
    return scaled(colour, scale)


@inlined
def tape_vertex(tape: Tape, hit: Hit) -> None:
    """Writes where a vertex is, and that nothing is known of its light yet."""
    for i in range(TAPE):
        tape.numbers[i] = ZERO
    write_three(tape.numbers, PRIM, Vector(np.float32(hit.prim), hit.u, hit.v))
    tape.numbers[LIGHT], tape.numbers[MET] = -ONE, -ONE


@inlined
def tape_light(tape: Tape, row: Int, white: Float, share: Float, direction: Vector) -> None:
    """Writes which light was sampled at a vertex, its share, and where it is."""
    tape.numbers[LIGHT] = np.float32(row)
    tape.numbers[WHITE], tape.numbers[COLOURED] = white, share
    write_three(tape.numbers, TO_LIGHT, direction)


@inlined
def tape_bounce(tape: Tape, white: Float, share: Float, bounce: Bounce) -> None:
    """Writes the weight of a bounce, and where it goes."""
    tape.numbers[BOUNCE_WHITE], tape.numbers[BOUNCE_COLOURED] = white, share
    write_three(tape.numbers, TO_BOUNCE, bounce.direction)
