"""What a ray finds at a hit: position, normals, reflectance, emitted radiance."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import pointer_to

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
TINY = np.float32(1e-30)
OFFSET = np.float32(2.0**-19)
"""How far a new ray starts above its surface, relative to the coordinates involved: 32 units in the last place, where
interpolating the position and shearing the triangle's vertices each cost a handful."""


class GeometryArrays(NamedTuple):
    """The arrays of a scene that shading reads."""

    vertices: Any  # (n, 3)
    faces: Any  # (m, 3)
    normals: Any  # (n, 3), zero rows where the file has none
    uv: Any  # (n, 2)
    material_ids: Any  # (m)
    albedo: Any  # (k, 3)
    emission: Any  # (k, 3)
    texture: Any  # (k), -1 for none
    texels: Any  # (all texels, 3), uint8
    texture_first: Any  # (t), first texel
    texture_height: Any  # (t)
    texture_width: Any  # (t)
    srgb: Any  # (256), the sRGB curve's linear values


class Geometry(NamedTuple):
    """Pointers to the same: an array is seven words to pass on, and counts its references atomically."""

    vertices: Any
    faces: Any
    normals: Any
    uv: Any
    material_ids: Any
    albedo: Any
    emission: Any
    texture: Any
    texels: Any
    texture_first: Any
    texture_height: Any
    texture_width: Any
    srgb: Any


@inlined
def geometry_pointers(arrays: GeometryArrays) -> Geometry:
    """Where a scene's arrays begin."""
    return Geometry(
        pointer_to(arrays.vertices),
        pointer_to(arrays.faces),
        pointer_to(arrays.normals),
        pointer_to(arrays.uv),
        pointer_to(arrays.material_ids),
        pointer_to(arrays.albedo),
        pointer_to(arrays.emission),
        pointer_to(arrays.texture),
        pointer_to(arrays.texels),
        pointer_to(arrays.texture_first),
        pointer_to(arrays.texture_height),
        pointer_to(arrays.texture_width),
        pointer_to(arrays.srgb),
    )


class Vector(NamedTuple):
    """Three numbers: a point, a direction or a colour."""

    x: Float
    y: Float
    z: Float


class Surface(NamedTuple):
    """A point on a surface, seen from one side: both normals point to that side."""

    position: Vector
    normal: Vector
    geometric: Vector
    albedo: Vector
    offset: Float  # metres above the geometric plane at which a new ray starts


@inlined
def dot(a: Vector, b: Vector) -> Float:
    """Inner product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@inlined
def scaled(a: Vector, s: Float) -> Vector:
    """The vector times a number."""
    return Vector(a.x * s, a.y * s, a.z * s)


@inlined
def added(a: Vector, b: Vector, s: Float) -> Vector:
    """A + s b."""
    return Vector(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z)


@inlined
def product(a: Vector, b: Vector) -> Vector:
    """The components multiplied."""
    return Vector(a.x * b.x, a.y * b.y, a.z * b.z)


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@inlined
def normalised(a: Vector) -> Vector:
    """The vector at length one; zero stays zero. Scaled first, so that no square under- or overflows."""
    largest = max(abs(a.x), max(abs(a.y), abs(a.z)))
    if largest < TINY:
        return Vector(ZERO, ZERO, ZERO)
    b = scaled(a, ONE / largest)
    return scaled(b, ONE / math.sqrt(dot(b, b)))


@inlined
def largest_component(a: Vector) -> Float:
    """Largest absolute component."""
    return max(abs(a.x), max(abs(a.y), abs(a.z)))


@inlined
def row(pointer: Any, i: Int) -> Vector:
    """Row of an (n, 3) array."""
    k = np.int64(3) * i
    return Vector(pointer[k], pointer[k + 1], pointer[k + 2])


@inlined
def corners_of(geometry: Geometry, prim: Int) -> tuple[Int, Int, Int]:
    """The vertex numbers of a triangle."""
    k = np.int64(3) * prim
    return geometry.faces[k], geometry.faces[k + 1], geometry.faces[k + 2]


@inlined
def wrap(i: Int, size: Int) -> Int:
    """Index modulo size, also for negative ones: a repeating image."""
    i = i % size
    return i + size if i < 0 else i


@kernel
def texture_colour(geometry: Geometry, texture: Int, u: Float, v: Float) -> Vector:
    """Linear colour of a repeating image, bilinear between decoded texels; (0, 0) is the lower left corner."""
    height, width = geometry.texture_height[texture], geometry.texture_width[texture]
    first = geometry.texture_first[texture]
    x = (u - np.float32(math.floor(u))) * np.float32(width) - HALF
    y = (ONE - (v - np.float32(math.floor(v)))) * np.float32(height) - HALF
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - np.float32(x0), y - np.float32(y0)
    red, green, blue = ZERO, ZERO, ZERO
    for dy in range(2):
        for dx in range(2):
            texel = 3 * (first + wrap(y0 + dy, height) * width + wrap(x0 + dx, width))
            weight = (fx if dx else ONE - fx) * (fy if dy else ONE - fy)
            red += weight * geometry.srgb[geometry.texels[texel]]
            green += weight * geometry.srgb[geometry.texels[texel + 1]]
            blue += weight * geometry.srgb[geometry.texels[texel + 2]]
    return Vector(red, green, blue)


@kernel
def surface_at(geometry: Geometry, prim: Int, u: Float, v: Float, direction: Vector) -> Surface:
    """The surface that a ray of this direction finds at barycentric coordinates (u, v) of a triangle."""
    a, b, c = corners_of(geometry, prim)
    w = ONE - u - v
    va, vb, vc = row(geometry.vertices, a), row(geometry.vertices, b), row(geometry.vertices, c)
    edge_1, edge_2 = added(vb, va, -ONE), added(vc, va, -ONE)
    position = added(added(scaled(va, w), vb, u), vc, v)
    geometric = normalised(cross(edge_1, edge_2))
    if dot(geometric, direction) > ZERO:
        geometric = scaled(geometric, -ONE)
    interpolated = added(
        added(scaled(row(geometry.normals, a), w), row(geometry.normals, b), u), row(geometry.normals, c), v
    )
    normal = normalised(interpolated)
    side = dot(normal, geometric)
    if side == ZERO:
        normal = geometric
    elif side < ZERO:
        normal = scaled(normal, -ONE)
    material = geometry.material_ids[prim]
    albedo = row(geometry.albedo, material)
    texture = geometry.texture[material]
    if texture >= 0:
        uv, i, j, k = geometry.uv, np.int64(2) * a, np.int64(2) * b, np.int64(2) * c
        s = w * uv[i] + u * uv[j] + v * uv[k]
        t = w * uv[i + 1] + u * uv[j + 1] + v * uv[k + 1]
        albedo = product(albedo, texture_colour(geometry, texture, s, t))
    reach = largest_component(position) + max(largest_component(edge_1), largest_component(edge_2))
    return Surface(position, normal, geometric, albedo, reach * OFFSET)


@kernel
def emitted(geometry: Geometry, prim: Int, direction: Vector) -> Vector:
    """Radiance that a triangle emits against a ray of this direction: only on the side of its normal."""
    a, b, c = corners_of(geometry, prim)
    va = row(geometry.vertices, a)
    normal = cross(added(row(geometry.vertices, b), va, -ONE), added(row(geometry.vertices, c), va, -ONE))
    if dot(normal, direction) < ZERO:
        return row(geometry.emission, geometry.material_ids[prim])
    return Vector(ZERO, ZERO, ZERO)


@inlined
def origin_above(surface: Surface) -> Vector:
    """Where a new ray starts."""
    return added(surface.position, surface.geometric, surface.offset)


@inlined
def cosine_direction(normal: Vector, xi_1: Float, xi_2: Float) -> Vector:
    """A direction about a normal with density cosine / pi: Malley's method, on the frame of Duff et al., JCGT 2017."""
    radius, angle = math.sqrt(xi_1), np.float32(2.0 * math.pi) * xi_2
    x, y, z = radius * math.cos(angle), radius * math.sin(angle), math.sqrt(max(ZERO, ONE - xi_1))
    sign = np.float32(math.copysign(ONE, normal.z))
    a = -ONE / (sign + normal.z)
    b = normal.x * normal.y * a
    return Vector(
        x * (ONE + sign * normal.x * normal.x * a) + y * b + z * normal.x,
        x * sign * b + y * (sign + normal.y * normal.y * a) + z * normal.y,
        -x * sign * normal.x - y * normal.y + z * normal.z,
    )
