"""Walks the acceleration structure once for sixteen camera rays: four by four pixels, one origin.

The inverse directions of a tile lie in an interval for each axis. A box that no direction of these intervals meets is
met by none of the rays, so that eight boxes, and then the boxes of a block's eight triangles, are tested for all rays
at once; each triangle that remains is tested against sixteen rays at once, by the arithmetic of ``triangles``. The
answers are those of single rays, to the bit.

For the error bounds see ``boxes``: a bound is met at (b - o) times an inverse, whose roundings are all relative.

Rays that differ in a direction's sign or in its largest component make no tile; ``streams`` traces them. It also traces
those with a component that is zero or nearly so.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.jit import Float, Int, inlined, kernel, vectorised
from fovden.simd import (
    F32,
    FLOATS,
    I32,
    I64,
    Lanes,
    advanced,
    bits_of,
    load,
    load_int32,
    maximum,
    minimum,
    pointer_to,
    splat,
    stack_floats,
    stack_int32,
    stack_words,
    store,
    store_int32,
    trailing_zeros,
)
from fovden.tracer.kernels.boxes import integer, number
from fovden.tracer.kernels.layout import (
    BLOCK_SIZE,
    CHILDREN,
    CUTOUT,
    NODE_SIZE,
    PRIMITIVES,
    STACK_SIZE,
    UPPER,
    WIDTH,
)
from fovden.tracer.kernels.rays import INFINITY, MISS, SLACK, ZERO, is_traceable
from fovden.tracer.kernels.splits import MARGIN
from fovden.tracer.kernels.streams import FIRST, Hits, Rays, put_ray, walk
from fovden.tracer.kernels.surface import GeometryArrays, geometry_pointers
from fovden.tracer.kernels.traversal import Accelerator, child_of, is_solid, key_of
from fovden.tracer.kernels.vectors import Vector

SIDE, RAYS = 4, 16
THREE_OF_ALL = 3 * RAYS
DIRECTIONS = 0  # rows of sixteen: x, y, z
SHEARS = 3 * RAYS  # x, y, z
T, U, V, PRIM = 6 * RAYS, 7 * RAYS, 8 * RAYS, 9 * RAYS
FOUND = 10 * RAYS  # t, u, v of the triangle that is being tested
LEAST, GREATEST, CENTRE, PERMUTED, LIMIT = 13 * RAYS, 13 * RAYS + 3, 13 * RAYS + 6, 13 * RAYS + 9, 13 * RAYS + 12
NEAR_ROWS, VERTEX_ROWS = 13 * RAYS + 13, 13 * RAYS + 16  # int32
TILE_SIZE = 15 * RAYS
NONE = np.int32(2**31 - 1)  # triangle of a ray that has met none: higher than any
FAINT, LARGEST = np.float32(2.0**-60), np.float32(np.finfo(np.float32).max)


def _span(builder: Any, tile: Any, axis: int, near: Lanes, far: Lanes) -> tuple[Lanes, Lanes]:
    """The least distance at which any ray of a tile meets the near bounds of an axis, the greatest for the far ones."""
    least, greatest = number(builder, tile, LEAST + axis), number(builder, tile, GREATEST + axis)
    return minimum(near * least, near * greatest), maximum(far * least, far * greatest) * float(SLACK)


def _reduced(builder: Any, lanes: Lanes, choose: Any) -> Any:
    """The least or greatest of sixteen numbers."""
    width = RAYS
    while width > 1:
        width //= 2
        halves = []
        for first in (0, width):
            order = ir.Constant(ir.VectorType(I32, width), list(range(first, first + width)))
            halves.append(Lanes(builder, builder.shuffle_vector(lanes.value, lanes.value, order)))
        lanes = choose(*halves)
    return builder.extract_element(lanes.value, ir.Constant(I32, 0))


@intrinsic
def hit_boxes_tile(context: Any, nodes: Any, base: Any, tile: Any, distances: Any) -> Any:
    """Mask of the boxes of the node at ``base`` that rays of a tile may meet; writes all least entry distances."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        nodes, base, tile, distances = arguments
        node = builder.gep(nodes, [base])
        entry, leave = splat(builder, ir.Constant(F32, 0.0), WIDTH), number(builder, tile, LIMIT)
        for axis in range(3):
            row = integer(builder, tile, NEAR_ROWS + axis)
            other = builder.sub(ir.Constant(I64, UPPER + 2 * WIDTH * axis), row)
            origin = number(builder, tile, CENTRE + axis)
            near, far = (load(builder, node, place, WIDTH) - origin for place in (row, other))
            near, far = _span(builder, tile, axis, near, far)
            entry, leave = maximum(near, entry), minimum(far, leave)
        store(builder, entry, distances)
        return (entry <= leave).bits()

    return types.int32(FLOATS, types.int64, FLOATS, FLOATS), generate


@intrinsic
def near_triangles(context: Any, blocks: Any, base: Any, tile: Any) -> Any:
    """Mask of the triangles of the block at ``base`` whose boxes rays of a tile may meet."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        blocks, base, tile = arguments
        block = builder.gep(blocks, [base])
        lower, upper = [], []
        for axis in range(3):
            a, b, c = (load(builder, block, (3 * corner + axis) * WIDTH, WIDTH) for corner in range(3))
            lower.append(minimum(minimum(a, b), c))
            upper.append(maximum(maximum(a, b), c))
        sizes = [high - low for low, high in zip(lower, upper, strict=True)]
        margin = maximum(maximum(sizes[0], sizes[1]), sizes[2]) * float(MARGIN)
        entry, leave = splat(builder, ir.Constant(F32, 0.0), WIDTH), number(builder, tile, LIMIT)
        for axis in range(3):
            origin = number(builder, tile, CENTRE + axis)
            below, above = lower[axis] - origin - margin, upper[axis] - origin + margin
            row = integer(builder, tile, NEAR_ROWS + axis)
            forward = builder.icmp_signed("<", row, ir.Constant(I64, UPPER))
            near = Lanes(builder, builder.select(forward, below.value, above.value))
            far = Lanes(builder, builder.select(forward, above.value, below.value))
            near, far = _span(builder, tile, axis, near, far)
            entry, leave = maximum(near, entry), minimum(far, leave)
        return (entry <= leave).bits()

    return types.int32(FLOATS, types.int64, FLOATS), generate


@intrinsic
def hit_tile(context: Any, blocks: Any, place: Any, prim: Any, tile: Any) -> Any:
    """Mask of a tile's rays for which one triangle is nearer than what they have met; writes FOUND where any.

    ``place`` is the triangle's first number in its block, ``prim`` its own.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        blocks, place, prim, tile = arguments
        corner = builder.gep(blocks, [place])
        shear_x, shear_y, shear_z = (load(builder, tile, SHEARS + RAYS * axis, RAYS) for axis in range(3))
        origin = [builder.load(builder.gep(tile, [ir.Constant(I64, PERMUTED + axis)])) for axis in range(3)]
        rows = [integer(builder, tile, VERTEX_ROWS + axis) for axis in range(3)]
        x, y, depth = [], [], []
        for vertex in range(3):
            start = builder.gep(corner, [ir.Constant(I64, 3 * WIDTH * vertex)])
            numbers = [builder.load(builder.gep(start, [row])) for row in rows]
            px, py, pz = (
                splat(builder, builder.fsub(value, o), RAYS) for value, o in zip(numbers, origin, strict=True)
            )
            x.append(px - shear_x * pz)
            y.append(py - shear_y * pz)
            depth.append(pz)
        u, v, w = x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]
        inside = (minimum(minimum(u, v), w) >= 0.0) | (maximum(maximum(u, v), w) <= 0.0)
        before = builder.block
        with builder.if_then(builder.icmp_unsigned("!=", inside.bits(), ir.Constant(I32, 0))):
            determinant = u + v + w
            t = (u * depth[0] + v * depth[1] + w * depth[2]) * shear_z / determinant
            best, own = load(builder, tile, T, RAYS), load(builder, tile, PRIM, RAYS, I32)
            lower = Lanes(builder, builder.icmp_signed("<", splat(builder, prim, RAYS).value, own.value))
            nearer = inside & (t > 0.0) & ((t < best) | ((t <= best) & lower))
            hits = nearer.bits()
            for row, values in enumerate((t, v / determinant, w / determinant)):
                store(builder, values, tile, FOUND + row * RAYS)
            after = builder.block
        mask = builder.phi(I32)
        mask.add_incoming(ir.Constant(I32, 0), before)
        mask.add_incoming(hits, after)
        return mask

    return types.int32(FLOATS, types.int64, types.int32, FLOATS), generate


@intrinsic
def keep_found(context: Any, tile: Any, mask: Any, prim: Any) -> Any:
    """Makes FOUND what the rays of a mask have met; returns the greatest distance of all rays."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        tile, mask, prim = arguments
        bits = builder.trunc(mask, ir.IntType(RAYS))
        chosen = Lanes(builder, builder.bitcast(bits, ir.VectorType(ir.IntType(1), RAYS)))
        for row, place in enumerate((T, U, V)):
            merged = chosen.select(load(builder, tile, FOUND + RAYS * row, RAYS), load(builder, tile, place, RAYS))
            store(builder, merged, tile, place)
        merged = chosen.select(splat(builder, prim, RAYS), load(builder, tile, PRIM, RAYS, I32))
        pointer = builder.bitcast(tile, I32.as_pointer())
        store(builder, merged, pointer, PRIM)
        return _reduced(builder, load(builder, tile, T, RAYS), maximum)

    return types.float32(FLOATS, types.int32, types.int32), generate


@inlined
def put_direction(tile: Any, ray: Int, direction: Vector) -> None:
    """Writes a ray's direction to a tile."""
    tile[ray], tile[RAYS + ray], tile[2 * RAYS + ray] = direction.x, direction.y, direction.z


@inlined
def direction_of(tile: Any, ray: Int) -> Vector:
    """The direction of a tile's ray."""
    return Vector(tile[ray], tile[RAYS + ray], tile[2 * RAYS + ray])


@intrinsic
def measure_directions(context: Any, tile: Any) -> Any:
    """Writes the least and greatest inverse of each component; returns whether none is tiny, huge or NaN."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (tile,) = arguments
        one = splat(builder, ir.Constant(F32, 1.0), RAYS)
        usable = one > 0.0
        for axis in range(3):
            inverse = one / load(builder, tile, DIRECTIONS + RAYS * axis, RAYS)
            square = inverse * inverse
            within = (square > float(FAINT)) & (square < 1.0 / float(FAINT))
            usable = usable & within
            for place, choose in ((LEAST, minimum), (GREATEST, maximum)):
                pointer = builder.gep(tile, [ir.Constant(I64, place + axis)])
                builder.store(_reduced(builder, inverse, choose), pointer)
        return builder.icmp_unsigned("==", usable.bits(), ir.Constant(I32, (1 << RAYS) - 1))

    return types.boolean(FLOATS), generate


@intrinsic
def shear_directions(context: Any, tile: Any, x: Any, y: Any, z: Any) -> Any:
    """Writes shears for the axes at rows x, y, z, and that nothing is met; returns whether z is largest in all."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        tile, *rows = arguments
        dx, dy, dz = (load(builder, tile, row, RAYS) for row in rows)
        zero = splat(builder, ir.Constant(F32, 0.0), RAYS)
        inverse = splat(builder, ir.Constant(F32, 1.0), RAYS) / dz
        for row, values in enumerate((dx * inverse, dy * inverse, inverse)):
            store(builder, values, tile, SHEARS + RAYS * row)
        for place, value in ((T, float(LARGEST)), (U, 0.0), (V, 0.0)):
            store(builder, splat(builder, ir.Constant(F32, value), RAYS), tile, place)
        nothing = splat(builder, ir.Constant(I32, int(NONE)), RAYS)
        store(builder, nothing, builder.bitcast(tile, I32.as_pointer()), PRIM)
        ax, ay, az = (maximum(d, zero - d) for d in (dx, dy, dz))
        return builder.icmp_unsigned("==", ((az > ax) & (az > ay)).bits(), ir.Constant(I32, (1 << RAYS) - 1))

    return types.boolean(FLOATS, types.int64, types.int64, types.int64), generate


@inlined
def prepare_tile(tile: Any, ox: Float, oy: Float, oz: Float) -> bool:
    """Prepares the rays of DIRECTIONS from an origin; returns whether they make a tile."""
    dx, dy, dz = tile[DIRECTIONS], tile[DIRECTIONS + RAYS], tile[DIRECTIONS + 2 * RAYS]
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    main = np.int64(0) if ax >= ay and ax >= az else (np.int64(1) if ay >= az else np.int64(2))
    if not measure_directions(tile):
        return False
    for axis in range(3):
        if tile[LEAST + axis] < ZERO < tile[GREATEST + axis]:
            return False
        tile[CENTRE + axis] = ox if axis == 0 else (oy if axis == 1 else oz)
        store_int32(tile, NEAR_ROWS + axis, np.int32(WIDTH * axis + (UPPER if tile[LEAST + axis] < ZERO else 0)))
        turned = (main + 1 + axis) % 3
        tile[PERMUTED + axis] = ox if turned == 0 else (oy if turned == 1 else oz)
        store_int32(tile, VERTEX_ROWS + axis, np.int32(WIDTH * turned))
    tile[LIMIT] = LARGEST
    alike = shear_directions(tile, RAYS * ((main + 1) % 3), RAYS * ((main + 2) % 3), RAYS * main)
    return alike and is_traceable(ox, oy, oz, dx, dy, dz)


@inlined
def meet_block(accelerator: Accelerator, base: Int, tile: Any) -> None:
    """Tests a block's triangles against a tile's rays."""
    mask = near_triangles(accelerator.blocks, base, tile)
    while mask != 0:
        lane = np.int64(trailing_zeros(mask))
        mask &= mask - 1
        number = load_int32(accelerator.blocks, base + PRIMITIVES + lane)
        prim = number & ~np.int32(CUTOUT)
        hits = hit_tile(accelerator.blocks, base + lane, prim, tile)
        if hits != 0 and number != prim and number >= 0:
            rays = hits
            while rays != 0:
                ray = np.int64(trailing_zeros(rays))
                rays &= rays - 1
                if not is_solid(accelerator, np.int64(number), tile[FOUND + RAYS + ray], tile[FOUND + 2 * RAYS + ray]):
                    hits &= ~np.int32(np.int64(1) << ray)
        if hits != 0:
            tile[LIMIT] = keep_found(tile, hits, prim)


@kernel
def closest_tile(accelerator: Accelerator, tile: Any, ox: Float, oy: Float, oz: Float) -> None:
    """Finds the first hits of sixteen rays from one origin.

    Args:
        accelerator: The structure.
        tile: TILE_SIZE numbers with the directions in DIRECTIONS, rows of x, y and z. Receives T, U, V and, as int32,
            PRIM: infinity, 0, 0, -1 for a miss.
        ox: Origin.
        oy: Origin.
        oz: Origin.
    """
    if not (VECTORS and prepare_tile(tile, ox, oy, oz)):
        rays = Rays(stack_floats(THREE_OF_ALL), stack_floats(THREE_OF_ALL), stack_floats(RAYS))
        hits = Hits(advanced(tile, T), advanced(tile, U), advanced(tile, V), stack_int32(RAYS))
        for i in range(RAYS):
            put_ray(rays, i, Vector(ox, oy, oz), direction_of(tile, i), INFINITY)
        walk(accelerator, rays, np.int64(0), np.int64(RAYS), FIRST, hits)
        for i in range(RAYS):
            store_int32(tile, PRIM + i, hits.prim[i])
        return
    nodes, stack, distances = accelerator.nodes, stack_words(STACK_SIZE), stack_floats(WIDTH)
    top = 0
    code = np.int64(0)
    while True:
        if code < 0:
            meet_block(accelerator, ~code * BLOCK_SIZE, tile)
        else:
            base = code * NODE_SIZE
            mask, bottom = hit_boxes_tile(nodes, base, tile, distances), top
            while mask != 0:
                lane = np.int64(trailing_zeros(mask))
                mask &= mask - 1
                key, place = key_of(distances, lane, load_int32(nodes, base + CHILDREN + lane)), top
                while place > bottom and stack[place - 1] < key:
                    stack[place] = stack[place - 1]
                    place -= 1
                stack[place] = key
                top += 1
        beyond = (np.int64(bits_of(tile[LIMIT])) + 1) << 32
        near = False
        while top > 0 and not near:
            top -= 1
            near = stack[top] < beyond
        if not near:
            break
        code = child_of(stack[top])
    for i in range(RAYS):
        if load_int32(tile, PRIM + i) == NONE:
            tile[T + i] = INFINITY
            store_int32(tile, PRIM + i, MISS)


VECTORS = vectorised()


@kernel
def closest_pixels(
    start: Int,
    stop: Int,
    nodes: Any,
    blocks: Any,
    geometry: GeometryArrays,
    holes: bool,
    origin: Any,
    directions: Any,
    t: Any,
    u: Any,
    v: Any,
    prim: Any,
) -> None:
    """Writes the first hits of the tiles start .. stop - 1, counted row by row, of an image.

    ``origin`` has shape (3), ``directions`` (h, w, 3), and what is written (h, w).
    """
    accelerator = Accelerator(pointer_to(nodes), pointer_to(blocks), geometry_pointers(geometry), holes)
    tile = stack_floats(TILE_SIZE)
    height, width = prim.shape
    across = (width + SIDE - 1) // SIDE
    for item in range(start, stop):
        top, left = item // across * SIDE, item % across * SIDE
        for i in range(RAYS):
            y, x = min(top + i // SIDE, height - 1), min(left + i % SIDE, width - 1)
            put_direction(tile, i, Vector(directions[y, x, 0], directions[y, x, 1], directions[y, x, 2]))
        closest_tile(accelerator, tile, origin[0], origin[1], origin[2])
        for i in range(RAYS):
            y, x = top + i // SIDE, left + i % SIDE
            if y < height and x < width:
                t[y, x], u[y, x], v[y, x] = tile[T + i], tile[U + i], tile[V + i]
                prim[y, x] = load_int32(tile, PRIM + i)
