"""Picks a light, and a point or direction of it, for a shadow ray."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import pointer_to
from fovden.tracer.kernels.surface import (
    Geometry,
    Surface,
    Vector,
    added,
    corners_of,
    cosine_direction,
    cross,
    dot,
    origin_above,
    row,
    scaled,
)

POINT, DIRECTIONAL, TRIANGLE, ENVIRONMENT = 0, 1, 2, 3

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
PI, INFINITY = np.float32(math.pi), np.float32(np.inf)
BEFORE_LIGHT = np.float32(1.0 - 1e-4)
"""A shadow ray ends this fraction of the way to its light, so that an emitter does not shadow itself."""
GRAZING = np.float32(1e-6)
"""Cosines below this carry no light; it keeps the division by a cosine finite."""


class LightTable(NamedTuple):
    """The lights of a scene as arrays, one row a light."""

    kind: Any  # (n)
    vector: Any  # (n, 3): position, or direction of travel
    colour: Any  # (n, 3): intensity, irradiance or radiance
    prim: Any  # (n): triangle, or -1
    pmf: Any  # (n): chance of being chosen
    cdf: Any  # (n): running sum of the chances
    environment: Any  # (h, w, 3): radiance of the surroundings, (0, 0, 3) without


class Lights(NamedTuple):
    """Pointers to the same, and the sizes."""

    kind: Any
    vector: Any
    colour: Any
    prim: Any
    pmf: Any
    cdf: Any
    size: Int
    environment: Any
    height: int
    width: int


@inlined
def light_pointers(table: LightTable) -> Lights:
    """Where a scene's light table begins."""
    return Lights(
        pointer_to(table.kind),
        pointer_to(table.vector),
        pointer_to(table.colour),
        pointer_to(table.prim),
        pointer_to(table.pmf),
        pointer_to(table.cdf),
        len(table.cdf),
        pointer_to(table.environment),
        table.environment.shape[0],
        table.environment.shape[1],
    )


class LightSample(NamedTuple):
    """A unit direction towards light, how far it is clear if not shadowed, and incident radiance / density."""

    direction: Vector
    distance: Float
    radiance: Vector


@kernel
def environment_radiance(lights: Lights, direction: Vector) -> Vector:
    """Radiance that arrives from a direction of the surroundings, bilinear, around in azimuth, clamped at the poles."""
    height, width = lights.height, lights.width
    if height == 0:
        return Vector(ZERO, ZERO, ZERO)
    turn = np.float32(math.atan2(direction.x, -direction.z)) / (np.float32(2.0) * PI)
    tilt = np.float32(math.acos(min(ONE, max(-ONE, direction.y)))) / PI
    x, y = (turn + HALF) * np.float32(width) - HALF, tilt * np.float32(height) - HALF
    x0, y0 = int(math.floor(x)), int(math.floor(y))
    fx, fy = np.float32(x - np.float32(x0)), np.float32(y - np.float32(y0))
    red, green, blue = ZERO, ZERO, ZERO
    for dy in range(2):
        for dx in range(2):
            texel = row(lights.environment, min(max(y0 + dy, 0), height - 1) * width + (x0 + dx + width) % width)
            weight = (fx if dx else ONE - fx) * (fy if dy else ONE - fy)
            red, green, blue = red + weight * texel.x, green + weight * texel.y, blue + weight * texel.z
    return Vector(red, green, blue)


@inlined
def choose_light(lights: Lights, xi: Float) -> Int:
    """First light whose running sum exceeds the random number."""
    low, high = 0, lights.size - 1
    while low < high:
        middle = (low + high) // 2
        if xi < lights.cdf[middle]:
            high = middle
        else:
            low = middle + 1
    return low


@kernel
def sample_light(
    lights: Lights, geometry: Geometry, surface: Surface, xi_0: Float, xi_1: Float, xi_2: Float
) -> LightSample:
    """Chooses one light by its chance and one way to it; the radiance is zero where none arrives.

    The reflected light is albedo / pi * cosine * radiance, if nothing lies on the way. A triangle is sampled by area,
    the environment by the cosine about the normal.
    """
    light = choose_light(lights, xi_0)
    kind, weight = lights.kind[light], ONE / lights.pmf[light]
    colour = scaled(row(lights.colour, light), weight)
    origin = origin_above(surface)
    nothing = LightSample(Vector(ZERO, ZERO, ZERO), ZERO, Vector(ZERO, ZERO, ZERO))
    if kind == DIRECTIONAL:
        return LightSample(scaled(row(lights.vector, light), -ONE), INFINITY, colour)
    if kind == ENVIRONMENT:
        direction = cosine_direction(surface.normal, xi_1, xi_2)
        cosine = dot(direction, surface.normal)
        if cosine < GRAZING:
            return nothing
        radiance = scaled(environment_radiance(lights, direction), weight * PI / cosine)
        return LightSample(direction, INFINITY, radiance)
    target, area_normal = row(lights.vector, light), Vector(ZERO, ZERO, ZERO)
    if kind == TRIANGLE:
        prim = lights.prim[light]
        a, b, c = corners_of(geometry, prim)
        va = row(geometry.vertices, a)
        edge_1 = added(row(geometry.vertices, b), va, -ONE)
        edge_2 = added(row(geometry.vertices, c), va, -ONE)
        root = np.float32(math.sqrt(xi_1))
        target = added(added(va, edge_1, root * (ONE - xi_2)), edge_2, root * xi_2)
        area_normal = scaled(cross(edge_1, edge_2), HALF)
    towards = added(target, origin, -ONE)
    distance = np.float32(math.sqrt(dot(towards, towards)))
    if not distance > ZERO:
        return nothing
    direction = scaled(towards, ONE / distance)
    falloff = ONE / (distance * distance)
    if kind == TRIANGLE:
        falloff *= max(ZERO, -dot(direction, area_normal))
    return LightSample(direction, distance * BEFORE_LIGHT, scaled(colour, falloff))
