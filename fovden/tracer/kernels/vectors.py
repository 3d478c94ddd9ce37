"""Three numbers at a time, inside kernels: points, directions, colours, and the arithmetic that they share."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined

ZERO, ONE = np.float32(0.0), np.float32(1.0)
TINY = np.float32(1e-30)
RED, GREEN, BLUE = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)  # Rec. 709 luminance


class Vector(NamedTuple):
    """Three numbers: a point, a direction or a colour."""

    x: Float
    y: Float
    z: Float


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
def write_three(numbers: Any, start: Int, a: Vector) -> None:
    """Writes three numbers side by side."""
    numbers[start], numbers[start + 1], numbers[start + 2] = a.x, a.y, a.z


@inlined
def luminance(c: Vector) -> Float:
    """Rec. 709 luminance."""
    return RED * c.x + GREEN * c.y + BLUE * c.z


class Frame(NamedTuple):
    """Two unit vectors that form a right-handed frame with a third, the normal."""

    s: Vector
    t: Vector
    n: Vector


@inlined
def frame_about(normal: Vector) -> Frame:
    """A frame about a unit vector, without a branch: Duff et al., "Building an orthonormal basis, revisited" (2017)."""
    sign = np.float32(math.copysign(ONE, normal.z))
    a = -ONE / (sign + normal.z)
    b = normal.x * normal.y * a
    s = Vector(ONE + sign * normal.x * normal.x * a, sign * b, -sign * normal.x)
    return Frame(s, Vector(b, sign + normal.y * normal.y * a, -normal.y), normal)


@inlined
def to_world(frame: Frame, a: Vector) -> Vector:
    """A vector whose components along the frame's axes are given."""
    return added(added(scaled(frame.s, a.x), frame.t, a.y), frame.n, a.z)


@inlined
def to_local(frame: Frame, a: Vector) -> Vector:
    """A vector's components along the frame's axes."""
    return Vector(dot(frame.s, a), dot(frame.t, a), dot(frame.n, a))


@inlined
def cosine_hemisphere(xi_1: Float, xi_2: Float) -> Vector:
    """A direction about the third axis with density cosine / pi: Malley's method."""
    radius, angle = math.sqrt(xi_1), np.float32(2.0 * math.pi) * xi_2
    return Vector(radius * math.cos(angle), radius * math.sin(angle), math.sqrt(max(ZERO, ONE - xi_1)))


@inlined
def cosine_direction(normal: Vector, xi_1: Float, xi_2: Float) -> Vector:
    """A direction about a normal with density cosine / pi."""
    return to_world(frame_about(normal), cosine_hemisphere(xi_1, xi_2))
