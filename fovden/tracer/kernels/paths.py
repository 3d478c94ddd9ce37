"""Images from paths: what every pixel sees, the paths of listed pixels, and the running sums of references."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.rng import Stream
from fovden.simd import load_int32, pointer_to, stack_floats, stack_int32, stack_words
from fovden.tracer.kernels.bsdf import gbuffer_roughness
from fovden.tracer.kernels.draws import draw
from fovden.tracer.kernels.illumination import LightTable, environment_radiance
from fovden.tracer.kernels.path import BLACK, TAPE, Hit, Setting, Tape, World, open_world, tape_vertex
from fovden.tracer.kernels.streams import FIRST, Hits, Rays, put_ray, walk
from fovden.tracer.kernels.surface import GeometryArrays, albedo_of, emitted, surface_at, three
from fovden.tracer.kernels.tiles import (
    PRIM,
    RAYS,
    SIDE,
    TILE_SIZE,
    T,
    U,
    V,
    closest_tile,
    direction_of,
    put_direction,
)
from fovden.tracer.kernels.vectors import Vector, added, dot, luminance, normalised, scaled, write_three
from fovden.tracer.kernels.wavefront import (
    DIRECT,
    INDIRECT,
    NUMBERS_OF_ALL,
    PATHS,
    SAMPLE,
    TAPED,
    THREE_OF_ALL,
    WORDS_OF_ALL,
    Batch,
    path_of,
    put_path,
    repeat_path,
    tape_of,
    trace_paths,
)

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
INFINITY = np.float32(np.inf)
MISS = np.int64(-1)
JITTER = int(Stream.JITTER)


class Views(NamedTuple):
    """Centres of projection (v, 3), viewing axes (v, 3), matrices from (x, y, 1) in pixels to directions (v, 3, 3)."""

    origin: Any
    forward: Any
    pixel_to_world: Any


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
def listed_direction(
    views: Views, jitter_x: Float, jitter_y: Float, coordinates: Any, directions: Any, points: Any, i: Int
) -> Vector:
    """Unit direction in which listed pixel i is seen: along its camera ray, unless directions are given."""
    if directions.shape[0] > 0:
        return Vector(directions[i, 0], directions[i, 1], directions[i, 2])
    x, y = np.float32(coordinates[i, 2]) + jitter_x, np.float32(coordinates[i, 1]) + jitter_y
    if points.shape[0] > 0:
        x, y = points[i, 0], points[i, 1]
    return view_ray(views, np.int64(coordinates[i, 0]), x, y)[1]


@inlined
def background(world: World, hit: Hit, direction: Vector) -> Vector:
    """What a camera ray sees shine: the emitter that it hits, or the surroundings; a ray that is NaN sees neither."""
    if hit.prim >= 0:
        return emitted(world.geometry, hit.prim, direction)
    if np.isnan(direction.x):
        return BLACK
    return environment_radiance(world.lights, direction)


@inlined
def write(image: Any, view: Int, y: Int, x: Int, value: Vector) -> None:
    """Writes three channels of a pixel."""
    image[view, 0, y, x], image[view, 1, y, x], image[view, 2, y, x] = value.x, value.y, value.z


@inlined
def pixel_of(image: Any, view: Int, y: Int, x: Int) -> Vector:
    """Three channels of a pixel."""
    return Vector(image[view, 0, y, x], image[view, 1, y, x], image[view, 2, y, x])


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
    points: Any,
    albedo: Any,
    normal: Any,
    position: Any,
    depth: Any,
    roughness: Any,
    prim: Any,
    barycentric: Any,
    emission: Any,
) -> None:
    """Writes the G-buffer and the visible emission of the tiles start .. stop - 1.

    Tiles are four by four pixels, counted row by row through all views. ``points`` are the raster coordinates of their
    rays, (v, h, w, 2), empty for the camera's own grid. Where they are NaN nothing is seen, not even the surroundings.
    """
    tile, world = stack_floats(TILE_SIZE), open_world(nodes, blocks, geometry, lights)
    height, width = prim.shape[2], prim.shape[3]
    columns, rows = (width + SIDE - 1) // SIDE, (height + SIDE - 1) // SIDE
    for item in range(start, stop):
        view, top, left = item // (columns * rows), item // columns % rows * SIDE, item % columns * SIDE
        origin = views.origin[view]
        for i in range(RAYS):
            y, x = min(top + i // SIDE, height - 1), min(left + i % SIDE, width - 1)
            across, down = np.float32(x) + jitter_x, np.float32(y) + jitter_y
            if points.shape[0] > 0:
                across, down = points[view, y, x, 0], points[view, y, x, 1]
            _, direction = view_ray(views, view, across, down)
            put_direction(tile, i, direction)
        closest_tile(world.accelerator, tile, origin[0], origin[1], origin[2])
        for i in range(RAYS):
            y, x = top + i // SIDE, left + i % SIDE
            if y >= height or x >= width:
                continue
            direction = direction_of(tile, i)
            hit = Hit(tile[T + i], tile[U + i], tile[V + i], np.int64(load_int32(tile, PRIM + i)))
            prim[view, 0, y, x] = hit.prim
            barycentric[view, 0, y, x], barycentric[view, 1, y, x] = hit.u, hit.v
            write(emission, view, y, x, background(world, hit, direction))
            if hit.prim >= 0:
                surface = surface_at(world.geometry, hit.prim, hit.u, hit.v, direction)
                write(albedo, view, y, x, albedo_of(world.geometry, surface))
                write(normal, view, y, x, surface.normal)
                write(position, view, y, x, surface.position)
                axis = views.forward[view]
                depth[view, 0, y, x] = hit.t * dot(direction, Vector(axis[0], axis[1], axis[2]))
                roughness[view, 0, y, x] = gbuffer_roughness(surface)
            else:
                write(albedo, view, y, x, BLACK)
                write(normal, view, y, x, BLACK)
                write(position, view, y, x, BLACK)
                depth[view, 0, y, x], roughness[view, 0, y, x] = ZERO, ZERO


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
    places: Any,
    directions: Any,
    points: Any,
    counts: Any,
    width: Int,
    setting: Setting,
    direct: Any,
    indirect: Any,
    luminance_squared: Any,
    tape: Any,
    tape_first: Any,
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
        jitter_x: Shift of the frame plus half a pixel; for the camera's own grid.
        jitter_y: The same, downwards.
        prim: Triangle that each pixel sees, (v, 1, h, w).
        barycentric: Where on it, (v, 2, h, w).
        emission: Radiance that it emits, (v, 3, h, w).
        coordinates: View, y, x of the listed pixels, the address of their random numbers, (k, 3).
        places: View, y, x of where the images hold them, (k, 3); for images of whole views the same.
        directions: Unit directions in which they are seen, (k, 3); empty for their camera rays.
        points: Raster coordinates of their camera rays, (k, 2); empty for the camera's own grid.
        counts: Samples of each of them, (k).
        width: Width of a view's images.
        setting: How paths are made.
        direct: Receives the mean direct light; zero before, and left so where a pixel sees no surface.
        indirect: Receives the mean indirect light, likewise.
        luminance_squared: Receives the mean squared luminance, emission included.
        tape: Receives what the paths are made of, (all samples, bounces + 1, TAPE); empty where it does not matter.
        tape_first: First sample of each of the listed pixels on tape, (k).
    """
    world, items = open_world(nodes, blocks, geometry, lights), stack_words(PATHS)
    batch = Batch(stack_floats(NUMBERS_OF_ALL), stack_words(WORDS_OF_ALL))
    on_tape, per_path = Tape(pointer_to(tape), tape.shape[0] > 0), np.int64(TAPE) * (setting.bounces + 1)
    direct_sum, indirect_sum, square_sum = BLACK, BLACK, ZERO
    item, sample = np.int64(start), np.int64(0)
    while item < stop:
        count = np.int64(0)
        while item < stop and count < PATHS:
            view, y, x = np.int64(places[item, 0]), np.int64(places[item, 1]), np.int64(places[item, 2])
            hit = Hit(ZERO, barycentric[view, 0, y, x], barycentric[view, 1, y, x], np.int64(prim[view, 0, y, x]))
            if hit.prim < 0 or counts[item] == 0:
                shine = luminance(pixel_of(emission, view, y, x))
                luminance_squared[view, 0, y, x] = shine * shine if counts[item] > 0 else ZERO
                item += 1
                continue
            if sample == 0 or count == 0:
                direction = listed_direction(views, jitter_x, jitter_y, coordinates, directions, points, item)
                pixel = np.int64(coordinates[item, 1]) * width + np.int64(coordinates[item, 2])
                put_path(world, batch, count, hit, direction, pixel, np.int64(coordinates[item, 0]))
            else:
                repeat_path(batch, count)
            path, items[count] = path_of(batch, count), item
            path.words[SAMPLE] = sample
            if on_tape.runs:
                path.words[TAPED] = (tape_first[item] + sample) * per_path
                tape_vertex(tape_of(path, on_tape, np.int64(0)), hit)
            count, sample = count + 1, sample + 1
            if sample == counts[item]:
                item, sample = item + 1, np.int64(0)
        trace_paths(world, batch, count, setting, on_tape)
        for n in range(count):
            path, i = path_of(batch, n), items[n]
            view, y, x = np.int64(places[i, 0]), np.int64(places[i, 1]), np.int64(places[i, 2])
            first, second = three(path.numbers, DIRECT), three(path.numbers, INDIRECT)
            direct_sum, indirect_sum = added(direct_sum, first, ONE), added(indirect_sum, second, ONE)
            total = luminance(added(added(first, second, ONE), pixel_of(emission, view, y, x), ONE))
            square_sum += total * total
            if path.words[SAMPLE] == counts[i] - 1:
                share = ONE / np.float32(counts[i])
                write(direct, view, y, x, scaled(direct_sum, share))
                write(indirect, view, y, x, scaled(indirect_sum, share))
                luminance_squared[view, 0, y, x] = square_sum * share
                direct_sum, indirect_sum, square_sum = BLACK, BLACK, ZERO


@kernel
def see_listed(
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
    coordinates: Any,
    places: Any,
    directions: Any,
    points: Any,
    emission: Any,
) -> None:
    """Writes what the triangles of the listed pixels start .. stop - 1 emit; arguments as of :func:`trace_listed`."""
    world = open_world(nodes, blocks, geometry, lights)
    for i in range(start, stop):
        view, y, x = np.int64(places[i, 0]), np.int64(places[i, 1]), np.int64(places[i, 2])
        direction = listed_direction(views, jitter_x, jitter_y, coordinates, directions, points, i)
        hit = Hit(ZERO, ZERO, ZERO, np.int64(prim[view, 0, y, x]))
        write(emission, view, y, x, background(world, hit, direction))


@inlined
def add_sample(total: Any, squares: Any, view: Int, y: Int, x: Int, light: Vector, own: Vector) -> None:
    """Adds a sample of a pixel to its sums."""
    value = added(light, own, ONE)
    total[view, 0, y, x] += value.x
    total[view, 1, y, x] += value.y
    total[view, 2, y, x] += value.z
    squares[view, 0, y, x] += np.float64(value.x) * value.x
    squares[view, 1, y, x] += np.float64(value.y) * value.y
    squares[view, 2, y, x] += np.float64(value.z) * value.z


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
    setting: Setting,
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
        setting: How paths are made.
        total: Sums of the samples' radiance, float64, (v, 3, h, w).
        squares: Sums of its squares, float64, (v, 3, h, w).
    """
    world = open_world(nodes, blocks, geometry, lights)
    items, samples, lines = stack_words(PATHS), stack_words(PATHS), stack_words(PATHS)
    batch = Batch(stack_floats(NUMBERS_OF_ALL), stack_words(WORDS_OF_ALL))
    owns, tape = stack_floats(THREE_OF_ALL), Tape(batch.numbers, False)
    rays = Rays(stack_floats(THREE_OF_ALL), stack_floats(THREE_OF_ALL), stack_floats(PATHS))
    hits = Hits(stack_floats(PATHS), stack_floats(PATHS), stack_floats(PATHS), stack_int32(PATHS))
    height, width = np.int64(total.shape[2]), np.int64(total.shape[3])
    item, sample = np.int64(start), np.int64(first_sample)
    while item < stop:
        count, seen = np.int64(0), np.int64(0)
        while item < stop and count < PATHS:
            view, y, x = item // (height * width), item // width % height, item % width
            if jittered or sample == first_sample or count == 0:
                shift_x, shift_y = HALF, HALF
                if jittered:
                    shift_x, shift_y, _, _ = draw(setting.sampler, setting.seed, JITTER, y * width + x, view, sample, 0)
                eye, direction = view_ray(views, view, np.float32(x) + shift_x, np.float32(y) + shift_y)
                put_ray(rays, seen, eye, direction, INFINITY)
                seen += 1
            items[count], samples[count], lines[count] = item, sample, seen - 1
            count, sample = count + 1, sample + 1
            if sample == last_sample:
                item, sample = item + 1, np.int64(first_sample)
        walk(world.accelerator, rays, np.int64(0), seen, FIRST, hits)
        for n in range(count):
            i, k = items[n], lines[n]
            if n == 0 or k != lines[n - 1]:
                direction = three(rays.directions, 3 * k)
                hit = Hit(hits.t[k], hits.u[k], hits.v[k], np.int64(hits.prim[k]))
                own = background(world, hit, direction)
                put_path(world, batch, n, hit, direction, i % (height * width), i // (height * width))
            else:
                repeat_path(batch, n)
            path_of(batch, n).words[SAMPLE] = samples[n]
            write_three(owns, 3 * n, own)
        trace_paths(world, batch, count, setting, tape)
        for n in range(count):
            path, i = path_of(batch, n), items[n]
            light = added(three(path.numbers, DIRECT), three(path.numbers, INDIRECT), ONE)
            add_sample(total, squares, i // (height * width), i // width % height, i % width, light, three(owns, 3 * n))
