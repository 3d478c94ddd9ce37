"""What a ray finds at a hit: position, normals, how the surface reflects, what it emits, whether it has a hole there.

A triangle's corners, normals, texture coordinates and material lie together in one record of two cache lines: by way of
vertex numbers they would lie in some ten lines all over memory, and shading would wait for each.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import load_int32, pointer_to, prefetch
from fovden.tracer.kernels.vectors import Vector, added, cross, dot, largest_component, normalised, product, scaled

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
OFFSET = np.float32(2.0**-19)
"""How far a new ray starts above its surface, relative to the coordinates involved: 32 units in the last place, where
interpolating the position and shearing the triangle's vertices each cost a handful."""

RECORD = 32
"""Float32 numbers of a triangle: three corners, from NORMALS three normals (zeros where the file has none), from UV
three texture coordinates, then two int32: MATERIAL, and EMITTER, its number among the triangles that emit, or -1."""
NORMALS, UV, MATERIAL, EMITTER = 9, 18, 24, 25

FINISH = 12
"""Float32 numbers of a material: albedo, from EMISSION the emitted radiance, then ROUGHNESS, METALLIC, CUTOFF."""
EMISSION, ROUGHNESS, METALLIC, CUTOFF = 3, 6, 7, 8

LINKS = 4
"""Int32 numbers of a material: MODEL, and the images of TEXTURE, FACTORS and OPACITY, -1 for none."""
MODEL, TEXTURE, FACTORS, OPACITY = 0, 1, 2, 3

BYTE, GREEN_BITS, BLUE_BITS = np.uint32(255), np.uint32(8), np.uint32(16)
INVERSE_BYTE = np.float32(1.0 / 255.0)


class GeometryArrays(NamedTuple):
    """The arrays of a scene that shading reads."""

    triangles: Any  # (m, RECORD)
    finishes: Any  # (k, FINISH)
    links: Any  # (k, LINKS), int32
    texels: Any  # (all texels), uint32: red or first channel in the lowest byte
    images: Any  # (t, 3): first texel, height, width
    srgb: Any  # (256), the sRGB curve's linear values


class Geometry(NamedTuple):
    """Pointers to the same: an array is seven words to pass on, and counts its references atomically."""

    triangles: Any
    finishes: Any
    links: Any
    texels: Any
    images: Any
    srgb: Any


@inlined
def geometry_pointers(arrays: GeometryArrays) -> Geometry:
    """Where a scene's arrays begin."""
    return Geometry(
        pointer_to(arrays.triangles),
        pointer_to(arrays.finishes),
        pointer_to(arrays.links),
        pointer_to(arrays.texels),
        pointer_to(arrays.images),
        pointer_to(arrays.srgb),
    )


class Surface(NamedTuple):
    """A point on a surface, seen from one side: both normals point to that side."""

    position: Vector
    normal: Vector
    geometric: Vector
    offset: Float  # metres above the geometric plane at which a new ray starts
    material: Int
    s: Float  # texture coordinates, 0 without a texture
    t: Float
    model: Int  # index into ``materials.MODELS``
    roughness: Float
    metallic: Float


class Place(NamedTuple):
    """A point of a texture between four texels: their numbers, and the weights of the second column and row."""

    upper_left: Int
    upper_right: Int
    lower_left: Int
    lower_right: Int
    x: Float
    y: Float


@inlined
def three(numbers: Any, start: Int) -> Vector:
    """Three numbers that lie side by side."""
    return Vector(numbers[start], numbers[start + 1], numbers[start + 2])


@inlined
def corners_of(geometry: Geometry, prim: Int) -> tuple[Vector, Vector, Vector]:
    """A triangle's first corner, and the edges from there to the second and the third."""
    k = np.int64(RECORD) * prim
    first = three(geometry.triangles, k)
    return (
        first,
        added(three(geometry.triangles, k + 3), first, -ONE),
        added(three(geometry.triangles, k + 6), first, -ONE),
    )


@inlined
def material_of(geometry: Geometry, prim: Int) -> Int:
    """The number of a triangle's material."""
    return np.int64(load_int32(geometry.triangles, np.int64(RECORD) * prim + MATERIAL))


@inlined
def emitter_of(geometry: Geometry, prim: Int) -> Int:
    """A triangle's number among those that emit, -1 for others."""
    return np.int64(load_int32(geometry.triangles, np.int64(RECORD) * prim + EMITTER))


@inlined
def interpolated(geometry: Geometry, prim: Int, start: Int, u: Float, v: Float) -> Vector:
    """Vectors of the three corners, interpolated."""
    k, w = np.int64(RECORD) * prim + start, ONE - u - v
    a, b, c = three(geometry.triangles, k), three(geometry.triangles, k + 3), three(geometry.triangles, k + 6)
    return added(added(scaled(a, w), b, u), c, v)


@inlined
def texture_coordinates(geometry: Geometry, prim: Int, u: Float, v: Float) -> tuple[Float, Float]:
    """Texture coordinates at barycentric coordinates (u, v) of a triangle."""
    numbers, k, w = geometry.triangles, np.int64(RECORD) * prim + UV, ONE - u - v
    s = w * numbers[k] + u * numbers[k + 2] + v * numbers[k + 4]
    t = w * numbers[k + 1] + u * numbers[k + 3] + v * numbers[k + 5]
    return s, t


@inlined
def whole_below(x: Float) -> Int:
    """The greatest integer that is not above x, without the call of a library that ``math.floor`` is."""
    i = np.int64(x)
    return i - 1 if np.float32(i) > x else i


@inlined
def place_in(geometry: Geometry, image: Int, s: Float, t: Float) -> Place:
    """Where texture coordinates lie in a repeating image; (0, 0) is its lower left corner."""
    k = np.int64(3) * image
    first, height, width = geometry.images[k], geometry.images[k + 1], geometry.images[k + 2]
    x = (s - np.float32(whole_below(s))) * np.float32(width) - HALF
    y = (ONE - (t - np.float32(whole_below(t)))) * np.float32(height) - HALF
    column, row = whole_below(x), whole_below(y)  # from -1 to size - 1
    left, right = column if column >= 0 else width - 1, column + 1 if column + 1 < width else 0
    upper = first + (row if row >= 0 else height - 1) * width
    lower = first + (row + 1 if row + 1 < height else 0) * width
    dx, dy = x - np.float32(column), y - np.float32(row)
    return Place(upper + left, upper + right, lower + left, lower + right, dx, dy)


@inlined
def mixed(place: Place, upper_left: Float, upper_right: Float, lower_left: Float, lower_right: Float) -> Float:
    """Bilinear mean of the values at four texels."""
    upper = (ONE - place.x) * upper_left + place.x * upper_right
    lower = (ONE - place.x) * lower_left + place.x * lower_right
    return (ONE - place.y) * upper + place.y * lower


@inlined
def channel(geometry: Geometry, place: Place, bits: Int) -> Float:
    """A linear channel in [0, 1] of an image, bilinear; ``bits`` is where the channel lies in a texel."""
    texels = geometry.texels
    return INVERSE_BYTE * mixed(
        place,
        np.float32((texels[place.upper_left] >> bits) & BYTE),
        np.float32((texels[place.upper_right] >> bits) & BYTE),
        np.float32((texels[place.lower_left] >> bits) & BYTE),
        np.float32((texels[place.lower_right] >> bits) & BYTE),
    )


@inlined
def decoded(geometry: Geometry, texel: Int) -> Vector:
    """The linear colour of a texel."""
    packed, srgb = geometry.texels[texel], geometry.srgb
    return Vector(srgb[packed & BYTE], srgb[(packed >> GREEN_BITS) & BYTE], srgb[(packed >> BLUE_BITS) & BYTE])


@kernel
def texture_colour(geometry: Geometry, image: Int, s: Float, t: Float) -> Vector:
    """Linear colour of an image, bilinear between decoded texels."""
    place = place_in(geometry, image, s, t)
    a, b = decoded(geometry, place.upper_left), decoded(geometry, place.upper_right)
    c, d = decoded(geometry, place.lower_left), decoded(geometry, place.lower_right)
    return Vector(mixed(place, a.x, b.x, c.x, d.x), mixed(place, a.y, b.y, c.y, d.y), mixed(place, a.z, b.z, c.z, d.z))


@kernel
def is_opaque(geometry: Geometry, prim: Int, u: Float, v: Float) -> bool:
    """Whether a triangle is there at barycentric coordinates (u, v): its opacity is not below the cutoff."""
    material = material_of(geometry, prim)
    image = geometry.links[np.int64(LINKS) * material + OPACITY]
    if image < 0:
        return True
    s, t = texture_coordinates(geometry, prim, u, v)
    opacity = channel(geometry, place_in(geometry, image, s, t), np.uint32(0))
    return bool(opacity >= geometry.finishes[np.int64(FINISH) * material + CUTOFF])


@kernel
def surface_at(geometry: Geometry, prim: Int, u: Float, v: Float, direction: Vector) -> Surface:
    """The surface that a ray of this direction finds at barycentric coordinates (u, v) of a triangle."""
    position = interpolated(geometry, prim, 0, u, v)
    _, edge_1, edge_2 = corners_of(geometry, prim)
    geometric = normalised(cross(edge_1, edge_2))
    if dot(geometric, direction) > ZERO:
        geometric = scaled(geometric, -ONE)
    normal = normalised(interpolated(geometry, prim, NORMALS, u, v))
    side = dot(normal, geometric)
    if side == ZERO:
        normal = geometric
    elif side < ZERO:
        normal = scaled(normal, -ONE)
    material = material_of(geometry, prim)
    finish, link = np.int64(FINISH) * material, np.int64(LINKS) * material
    roughness, metallic = geometry.finishes[finish + ROUGHNESS], geometry.finishes[finish + METALLIC]
    texture, factors = geometry.links[link + TEXTURE], geometry.links[link + FACTORS]
    s, t = ZERO, ZERO
    if texture >= 0 or factors >= 0:
        s, t = texture_coordinates(geometry, prim, u, v)
        if texture >= 0:
            place = place_in(geometry, texture, s, t)
            prefetch(geometry.texels, place.upper_left)
            prefetch(geometry.texels, place.lower_left)
        if factors >= 0:
            place = place_in(geometry, factors, s, t)
            roughness *= channel(geometry, place, np.uint32(0))
            metallic *= channel(geometry, place, GREEN_BITS)
    reach = largest_component(position) + max(largest_component(edge_1), largest_component(edge_2))
    model = geometry.links[link + MODEL]
    return Surface(position, normal, geometric, reach * OFFSET, material, s, t, model, roughness, metallic)


@kernel
def albedo_of(geometry: Geometry, surface: Surface) -> Vector:
    """What part of the light a surface reflects.

    :func:`surface_at` only asks for the texels: they are slow to come, and a path has other things to do first.
    """
    albedo = three(geometry.finishes, np.int64(FINISH) * surface.material)
    texture = geometry.links[np.int64(LINKS) * surface.material + TEXTURE]
    if texture >= 0:
        return product(albedo, texture_colour(geometry, texture, surface.s, surface.t))
    return albedo


@kernel
def emitted(geometry: Geometry, prim: Int, direction: Vector) -> Vector:
    """Radiance that a triangle emits against a ray of this direction: only on the side of its normal."""
    if emitter_of(geometry, prim) >= 0:
        _, edge_1, edge_2 = corners_of(geometry, prim)
        if dot(cross(edge_1, edge_2), direction) < ZERO:
            return three(geometry.finishes, np.int64(FINISH) * material_of(geometry, prim) + EMISSION)
    return Vector(ZERO, ZERO, ZERO)


@inlined
def origin_above(surface: Surface) -> Vector:
    """Where a new ray starts."""
    return added(surface.position, surface.geometric, surface.offset)
