"""Picks a light, and a point or direction of it, for a shadow ray."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import pointer_to
from fovden.tracer.kernels.surface import Geometry, Surface, corners_of, origin_above, three
from fovden.tracer.kernels.vectors import Vector, added, cosine_direction, cross, dot, scaled

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
    first_emitter: Int  # row of the first triangle; the others follow in the order of their emitter numbers
    sky: Int  # row of the environment, or -1


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
    height: Int
    width: Int
    first_emitter: Int
    sky: Int


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
        table.first_emitter,
        table.sky,
    )


class LightSample(NamedTuple):
    """A unit direction towards light, how far it is clear if not shadowed, and what arrives: colour times scale."""

    direction: Vector
    distance: Float
    colour: Vector  # the light's radiance, intensity or irradiance
    scale: Float  # 1 / density; of a point or a direction what turns the colour into irradiance, over its chance
    density: Float  # per steradian; 0 for a point or a direction, which no bounce can find
    row: Int  # which light


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
            texel = three(
                lights.environment, np.int64(3) * (min(max(y0 + dy, 0), height - 1) * width + (x0 + dx + width) % width)
            )
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


@inlined
def sky_density(lights: Lights, surface: Surface, direction: Vector) -> Float:
    """Density per steradian with which :func:`sample_light` chooses a direction of the surroundings."""
    return lights.pmf[lights.sky] * max(ZERO, dot(surface.normal, direction)) / PI


@inlined
def emitter_density(
    lights: Lights, geometry: Geometry, surface: Surface, prim: Int, emitter: Int, direction: Vector, distance: Float
) -> Float:
    """Density per steradian with which :func:`sample_light` chooses the point of an emitter that a ray met."""
    _, edge_1, edge_2 = corners_of(geometry, prim)
    facing = -HALF * dot(cross(edge_1, edge_2), direction)  # area times cosine
    return lights.pmf[lights.first_emitter + emitter] * distance * distance / facing


@kernel
def sample_light(
    lights: Lights, geometry: Geometry, surface: Surface, xi_0: Float, xi_1: Float, xi_2: Float
) -> LightSample:
    """Chooses one light by its chance and one way to it; the scale is zero where no light arrives.

    The reflected light is f * cosine * colour * scale, if nothing lies on the way. A triangle is sampled by area, the
    environment by the cosine about the normal.
    """
    light = choose_light(lights, xi_0)
    kind, chance = lights.kind[light], lights.pmf[light]
    colour, place = three(lights.colour, np.int64(3) * light), three(lights.vector, np.int64(3) * light)
    nothing = LightSample(Vector(ZERO, ZERO, ZERO), ZERO, colour, ZERO, ZERO, light)
    if kind == DIRECTIONAL:
        return LightSample(scaled(place, -ONE), INFINITY, colour, ONE / chance, ZERO, light)
    if kind == ENVIRONMENT:
        direction = cosine_direction(surface.normal, xi_1, xi_2)
        density = sky_density(lights, surface, direction)
        if density < GRAZING * chance:
            return nothing
        return LightSample(direction, INFINITY, environment_radiance(lights, direction), ONE / density, density, light)
    area_normal = Vector(ZERO, ZERO, ZERO)
    if kind == TRIANGLE:
        first, edge_1, edge_2 = corners_of(geometry, lights.prim[light])
        root = np.float32(math.sqrt(xi_1))
        place = added(added(first, edge_1, root * (ONE - xi_2)), edge_2, root * xi_2)
        area_normal = scaled(cross(edge_1, edge_2), HALF)
    towards = added(place, origin_above(surface), -ONE)
    square = dot(towards, towards)
    distance = np.float32(math.sqrt(square))
    if not distance > ZERO:
        return nothing
    direction = scaled(towards, ONE / distance)
    if kind == POINT:
        return LightSample(direction, distance * BEFORE_LIGHT, colour, ONE / (square * chance), ZERO, light)
    facing = -dot(direction, area_normal)
    if not facing > ZERO:
        return nothing
    density = chance * square / facing
    return LightSample(direction, distance * BEFORE_LIGHT, colour, ONE / density, density, light)
