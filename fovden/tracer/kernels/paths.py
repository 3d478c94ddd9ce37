"""Path tracing: one shadow ray at the first surface, one cosine-distributed bounce, one shadow ray there.

The light that a bounce ray runs into adds nothing: light sampling accounts for all of it, so nothing is counted twice.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.rng import Stream, philox
from fovden.simd import pointer_to, stack_floats, stack_words
from fovden.tracer.kernels.illumination import Lights, LightTable, environment_radiance, light_pointers, sample_light
from fovden.tracer.kernels.layout import RESULTS_SIZE, STACK_SIZE, WIDTH
from fovden.tracer.kernels.surface import (
    Geometry,
    GeometryArrays,
    Surface,
    Vector,
    added,
    cosine_direction,
    dot,
    emitted,
    geometry_pointers,
    normalised,
    origin_above,
    product,
    scaled,
    surface_at,
)
from fovden.tracer.kernels.traversal import Accelerator, Scratch, closest, is_occluded

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
INVERSE_PI, INFINITY = np.float32(1.0 / math.pi), np.float32(np.inf)
MISS = np.int32(-1)
RED, GREEN, BLUE = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)  # Rec. 709 luminance
JITTER = int(Stream.JITTER)


class Views(NamedTuple):
    """Centres of projection (v, 3), viewing axes (v, 3), matrices from (x, y, 1) in pixels to directions (v, 3, 3)."""

    origin: Any
    forward: Any
    pixel_to_world: Any


class World(NamedTuple):
    """All that a path meets."""

    accelerator: Accelerator
    geometry: Geometry
    lights: Lights


@inlined
def open_world(nodes: Any, blocks: Any, geometry: GeometryArrays, lights: LightTable) -> World:
    """Pointers to all of a scene's arrays."""
    accelerator = Accelerator(pointer_to(nodes), pointer_to(blocks))
    return World(accelerator, geometry_pointers(geometry), light_pointers(lights))


class Hit(NamedTuple):
    """A ray's first hit; ``prim`` is -1 for a miss."""

    t: Float
    u: Float
    v: Float
    prim: Int


@inlined
def view_ray(views: Views, view: Int, x: Float, y: Float) -> tuple[Vector, Vector]:
    """Origin and unit direction of the ray through raster coordinates."""
    matrix, origin = views.pixel_to_world[view], views.origin[view]
    direction = Vector(
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2],
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2],
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2],
    )
    return Vector(origin[0], origin[1], origin[2]), normalised(direction)


@inlined
def trace(world: World, scratch: Scratch, origin: Vector, direction: Vector) -> Hit:
    """The first hit."""
    o, d = origin, direction
    t, u, v, prim = closest(world.accelerator, scratch, o.x, o.y, o.z, d.x, d.y, d.z, INFINITY)
    return Hit(t, u, v, prim)


@inlined
def direct_light(world: World, scratch: Scratch, surface: Surface, xi_0: Float, xi_1: Float, xi_2: Float) -> Vector:
    """Light of one randomly chosen light that the surface reflects: an unbiased estimate of all of it."""
    sample = sample_light(world.lights, world.geometry, surface, xi_0, xi_1, xi_2)
    cosine = dot(sample.direction, surface.normal)
    lit = sample.radiance.x + sample.radiance.y + sample.radiance.z > ZERO
    # The geometric normal guards against light that would pass through the back of the surface.
    if lit and cosine > ZERO and dot(sample.direction, surface.geometric) > ZERO:
        o, d = origin_above(surface), sample.direction
        if not is_occluded(world.accelerator, scratch, o.x, o.y, o.z, d.x, d.y, d.z, sample.distance):
            return scaled(product(surface.albedo, sample.radiance), cosine * INVERSE_PI)
    return Vector(ZERO, ZERO, ZERO)


@kernel
def trace_path(
    world: World, scratch: Scratch, surface: Surface, seed: Int, stream: Int, pixel: Int, view: Int, sample: Int
) -> tuple[Vector, Vector]:
    """Direct and indirect light of one path that starts at a surface; uses random dimensions 0 to 7."""
    x0, x1, x2, x3 = philox(seed, stream, pixel, view, sample, 0)
    x4, x5, x6, x7 = philox(seed, stream, pixel, view, sample, 1)
    direct = direct_light(world, scratch, surface, x0, x1, x2)
    indirect = Vector(ZERO, ZERO, ZERO)
    bounce = cosine_direction(surface.normal, x3, x4)
    if dot(bounce, surface.geometric) > ZERO:
        hit = trace(world, scratch, origin_above(surface), bounce)
        if hit.prim >= 0:
            second = surface_at(world.geometry, hit.prim, hit.u, hit.v, bounce)
            # density cosine / pi and reflectance albedo / pi leave the albedo as the bounce's weight
            indirect = product(surface.albedo, direct_light(world, scratch, second, x5, x6, x7))
    return direct, indirect


@inlined
def background(world: World, hit: Hit, direction: Vector) -> Vector:
    """What a camera ray sees shine: the emitter that it hits, or the surroundings."""
    if hit.prim >= 0:
        return emitted(world.geometry, hit.prim, direction)
    return environment_radiance(world.lights, direction)


@inlined
def luminance(c: Vector) -> Float:
    """Rec. 709 luminance."""
    return RED * c.x + GREEN * c.y + BLUE * c.z


@inlined
def write(image: Any, view: Int, y: Int, x: Int, value: Vector) -> None:
    """Writes three channels of a pixel."""
    image[view, 0, y, x], image[view, 1, y, x], image[view, 2, y, x] = value.x, value.y, value.z


@kernel
def trace_primary(
    start: Int,
    stop: Int,
    nodes: Any,
    blocks: Any,
    geometry: GeometryArrays,
    lights: LightTable,
    views: Views,
    jitter_x: Float,
    jitter_y: Float,
    albedo: Any,
    normal: Any,
    position: Any,
    depth: Any,
    prim: Any,
    barycentric: Any,
    emission: Any,
) -> None:
    """Writes the G-buffer and the visible emission of the pixels start .. stop - 1, counted through all views."""
    scratch = Scratch(stack_words(STACK_SIZE), stack_words(WIDTH), stack_floats(RESULTS_SIZE))
    world = open_world(nodes, blocks, geometry, lights)
    height, width = prim.shape[2], prim.shape[3]
    for i in range(start, stop):
        view, y, x = i // (height * width), i // width % height, i % width
        origin, direction = view_ray(views, view, np.float32(x) + jitter_x, np.float32(y) + jitter_y)
        hit = trace(world, scratch, origin, direction)
        prim[view, 0, y, x] = hit.prim
        barycentric[view, 0, y, x], barycentric[view, 1, y, x] = hit.u, hit.v
        write(emission, view, y, x, background(world, hit, direction))
        zero = Vector(ZERO, ZERO, ZERO)
        if hit.prim >= 0:
            surface = surface_at(world.geometry, hit.prim, hit.u, hit.v, direction)
            write(albedo, view, y, x, surface.albedo)
            write(normal, view, y, x, surface.normal)
            write(position, view, y, x, surface.position)
            axis = views.forward[view]
            depth[view, 0, y, x] = hit.t * dot(direction, Vector(axis[0], axis[1], axis[2]))
        else:
            write(albedo, view, y, x, zero)
            write(normal, view, y, x, zero)
            write(position, view, y, x, zero)
            depth[view, 0, y, x] = ZERO


@kernel
def trace_listed(
    start: Int,
    stop: Int,
    nodes: Any,
    blocks: Any,
    geometry: GeometryArrays,
    lights: LightTable,
    views: Views,
    jitter_x: Float,
    jitter_y: Float,
    prim: Any,
    barycentric: Any,
    emission: Any,
    coordinates: Any,
    counts: Any,
    seed: Int,
    stream: Int,
    direct: Any,
    indirect: Any,
    luminance_squared: Any,
) -> None:
    """Traces the paths of the listed pixels start .. stop - 1 and writes their means.

    Args:
        start: First of the listed pixels.
        stop: End of the listed pixels.
        nodes: The acceleration structure.
        blocks: Its leaves.
        geometry: Triangles and materials.
        lights: The lights.
        views: The camera.
        jitter_x: Shift of the frame plus half a pixel.
        jitter_y: The same, downwards.
        prim: Triangle that each pixel sees, (v, 1, h, w).
        barycentric: Where on it, (v, 2, h, w).
        emission: Radiance that it emits, (v, 3, h, w).
        coordinates: View, y, x of the listed pixels, (k, 3).
        counts: Samples of each of them, (k).
        seed: Seed.
        stream: Random stream.
        direct: Receives the mean direct light.
        indirect: Receives the mean indirect light.
        luminance_squared: Receives the mean squared luminance, emission included.
    """
    scratch = Scratch(stack_words(STACK_SIZE), stack_words(WIDTH), stack_floats(RESULTS_SIZE))
    world = open_world(nodes, blocks, geometry, lights)
    width = prim.shape[3]
    for i in range(start, stop):
        view, y, x = np.int64(coordinates[i, 0]), np.int64(coordinates[i, 1]), np.int64(coordinates[i, 2])
        own = Vector(emission[view, 0, y, x], emission[view, 1, y, x], emission[view, 2, y, x])
        direct_sum, indirect_sum, square_sum = Vector(ZERO, ZERO, ZERO), Vector(ZERO, ZERO, ZERO), ZERO
        samples = counts[i]
        if prim[view, 0, y, x] >= 0 and samples > 0:
            _, direction = view_ray(views, view, np.float32(x) + jitter_x, np.float32(y) + jitter_y)
            u, v = barycentric[view, 0, y, x], barycentric[view, 1, y, x]
            surface = surface_at(world.geometry, prim[view, 0, y, x], u, v, direction)
            for sample in range(samples):
                first, second = trace_path(world, scratch, surface, seed, stream, y * width + x, view, sample)
                direct_sum = added(direct_sum, first, ONE)
                indirect_sum = added(indirect_sum, second, ONE)
                total = luminance(added(added(first, second, ONE), own, ONE))
                square_sum += total * total
        else:
            square_sum = luminance(own) * luminance(own) * np.float32(samples)
        share = ONE / np.float32(max(samples, 1))
        write(direct, view, y, x, scaled(direct_sum, share))
        write(indirect, view, y, x, scaled(indirect_sum, share))
        luminance_squared[view, 0, y, x] = square_sum * share


@kernel
def accumulate_all(
    start: Int,
    stop: Int,
    nodes: Any,
    blocks: Any,
    geometry: GeometryArrays,
    lights: LightTable,
    views: Views,
    first_sample: Int,
    last_sample: Int,
    jittered: bool,
    seed: Int,
    stream: Int,
    total: Any,
    squares: Any,
) -> None:
    """Adds the samples first .. last - 1 of the pixels start .. stop - 1 to running sums.

    Every sample is added by itself, in order, in double precision: the sums do not depend on how the samples are
    divided into calls. With ``jittered`` each sample's camera ray passes through a random place of its pixel.

    Args:
        start: First pixel, counted through all views.
        stop: End of the pixels.
        nodes: The acceleration structure.
        blocks: Its leaves.
        geometry: Triangles and materials.
        lights: The lights.
        views: The camera.
        first_sample: First sample.
        last_sample: End of the samples.
        jittered: Whether rays are spread over the pixel.
        seed: Seed.
        stream: Random stream.
        total: Sums of the samples' radiance, float64, (v, 3, h, w).
        squares: Sums of its squares, float64, (v, 3, h, w).
    """
    scratch = Scratch(stack_words(STACK_SIZE), stack_words(WIDTH), stack_floats(RESULTS_SIZE))
    world = open_world(nodes, blocks, geometry, lights)
    height, width = total.shape[2], total.shape[3]
    for i in range(start, stop):
        view, y, x = i // (height * width), i // width % height, i % width
        origin, direction = view_ray(views, view, np.float32(x) + HALF, np.float32(y) + HALF)
        hit = Hit(INFINITY, ZERO, ZERO, MISS)
        surface = surface_at(world.geometry, 0, ZERO, ZERO, direction)
        own = Vector(ZERO, ZERO, ZERO)
        for sample in range(first_sample, last_sample):
            if jittered or sample == first_sample:
                if jittered:
                    shift_x, shift_y, _, _ = philox(seed, JITTER, y * width + x, view, sample, 0)
                    origin, direction = view_ray(views, view, np.float32(x) + shift_x, np.float32(y) + shift_y)
                hit = trace(world, scratch, origin, direction)
                own = background(world, hit, direction)
                if hit.prim >= 0:
                    surface = surface_at(world.geometry, hit.prim, hit.u, hit.v, direction)
            value = own
            if hit.prim >= 0:
                first, second = trace_path(world, scratch, surface, seed, stream, y * width + x, view, sample)
                value = added(added(first, second, ONE), own, ONE)
            total[view, 0, y, x] += value.x
            total[view, 1, y, x] += value.y
            total[view, 2, y, x] += value.z
            squares[view, 0, y, x] += np.float64(value.x) * value.x
            squares[view, 1, y, x] += np.float64(value.y) * value.y
            squares[view, 2, y, x] += np.float64(value.z) * value.z
