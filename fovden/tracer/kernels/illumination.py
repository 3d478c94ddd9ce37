"""Picks a light, and a point or direction of it, for a shadow ray.

The sky as an image is sampled in two ways at once. What exceeds the mean luminance is sampled where it is: a patch
between four texels' middles by running sums, then a place in it by the bilinear function of its corners. The rest,
which comes from everywhere, is sampled by the cosine about the normal. A direction's density is that of both together,
so that the two weigh each other (balance heuristic, one sample), and no direction that lights a surface is without a
chance. Source of the subtracted mean: O. Karlik et al., "MIS compensation: optimizing sampling techniques in
multiple importance sampling", ACM Transactions on Graphics 38(6), 2019. A constant sky has nothing above its mean.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import pointer_to
from fovden.tracer.kernels.light_tree import LARGEST, chance_of, descend
from fovden.tracer.kernels.surface import Geometry, Surface, corners_of, origin_above, three
from fovden.tracer.kernels.vectors import Vector, added, cosine_direction, cross, dot, luminance, scaled

POINT, DIRECTIONAL, TRIANGLE, ENVIRONMENT = 0, 1, 2, 3

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
PI, INFINITY = np.float32(math.pi), np.float32(np.inf)
BEFORE_LIGHT = np.float32(1.0 - 1e-4)
"""A shadow ray ends this fraction of the way to its light, so that an emitter does not shadow itself."""
SMALLEST = np.float32(1e-30)
"""Keeps 0 / 0 from being NaN."""
GRAZING = np.float32(1e-6)
"""Cosines below this carry no light; it keeps the division by a cosine finite."""


class SkyArrays(NamedTuple):
    """Where the surroundings are brighter than on average.

    A patch lies between the middles of two neighbouring columns of texels, around the sphere, and of two rows; the
    first row of patches begins at the upper pole, where the image continues as its first row is, the last ends at the
    lower one.
    """

    rows: Any  # (h + 1): running sum of the rows' chances
    columns: Any  # (h + 1, w): running sum of the chances of a row's patches
    cosines: Any  # (h + 2): vertical component of the directions between rows of patches
    mean: Float  # luminance that counts as nothing
    scale: Float  # from what exceeds it to density per steradian
    share: Float  # chance of sampling a patch, not the cosine


class Sky(NamedTuple):
    """Pointers to the same."""

    rows: Any
    columns: Any
    cosines: Any
    mean: Float
    scale: Float
    share: Float


class LightTable(NamedTuple):
    """The lights of a scene as arrays, one row a light."""

    kind: Any  # (n)
    vector: Any  # (n, 3): position, or direction of travel
    colour: Any  # (n, 3): intensity, irradiance or radiance
    prim: Any  # (n): triangle, or -1
    pmf: Any  # (n): chance of being chosen; in the tree, of choosing the tree
    cdf: Any  # (n): running sum of the chances; with a tree, of those outside it where it was not chosen
    tree: Any  # (2 k, NODE): k lights, see ``light_tree``
    leaf: Any  # (n): node of each light in the tree, or 0
    tree_share: Float  # chance of choosing the tree; 0 without one
    environment: Any  # (h, w, 3): radiance of the surroundings, (0, 0, 3) without
    sky: SkyArrays
    first_emitter: Int  # row of the first triangle; the others follow in the order of their emitter numbers
    sky_row: Int  # row of the environment, or -1


class Lights(NamedTuple):
    """Pointers to the same, and the sizes."""

    kind: Any
    vector: Any
    colour: Any
    prim: Any
    pmf: Any
    cdf: Any
    size: Int
    tree: Any
    leaf: Any
    tree_share: Float
    environment: Any
    height: Int
    width: Int
    sky: Sky
    first_emitter: Int
    sky_row: Int


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
        pointer_to(table.tree),
        pointer_to(table.leaf),
        table.tree_share,
        pointer_to(table.environment),
        table.environment.shape[0],
        table.environment.shape[1],
        Sky(
            pointer_to(table.sky.rows),
            pointer_to(table.sky.columns),
            pointer_to(table.sky.cosines),
            table.sky.mean,
            table.sky.scale,
            table.sky.share,
        ),
        table.first_emitter,
        table.sky_row,
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
def first_above(sums: Any, first: Int, size: Int, xi: Float) -> Int:
    """First of some running sums that exceeds the random number, counted from ``first``; else the last."""
    low, high = np.int64(0), np.int64(size - 1)
    while low < high:
        middle = (low + high) // 2
        if xi < sums[first + middle]:
            high = middle
        else:
            low = middle + 1
    return low


@inlined
def choose_light(lights: Lights, xi: Float) -> Int:
    """First light whose running sum exceeds the random number."""
    return first_above(lights.cdf, np.int64(0), lights.size, xi)


@inlined
def pick_light(lights: Lights, surface: Surface, xi: Float) -> tuple[Int, Float]:
    """Chooses a light for a surface: its row, and its chance."""
    if lights.tree_share > ZERO:
        if xi < lights.tree_share:
            light, chance = descend(lights.tree, surface.position, surface.normal, xi / lights.tree_share)
            return light, chance * lights.tree_share
        xi = min(LARGEST, (xi - lights.tree_share) / (ONE - lights.tree_share))
    light = choose_light(lights, xi)
    return light, lights.pmf[light]


@inlined
def light_chance(lights: Lights, surface: Surface, light: Int) -> Float:
    """Chance with which :func:`pick_light` chooses a light."""
    chance = lights.pmf[light]
    if lights.tree_share > ZERO and lights.leaf[light] > 0:
        chance *= chance_of(lights.tree, np.int64(lights.leaf[light]), surface.position, surface.normal)
    return chance


@inlined
def excess(lights: Lights, row: Int, column: Int) -> Float:
    """Luminance of a texel above the mean; rows end at the poles, columns go around."""
    k = min(max(row, 0), lights.height - 1) * lights.width + (column % lights.width)
    return max(ZERO, luminance(three(lights.environment, np.int64(3) * k)) - lights.sky.mean)


@inlined
def corners_of_patch(lights: Lights, row: Int, column: Int) -> tuple[Float, Float, Float, Float]:
    """Luminance above the mean at a patch's corners: upper left and right, lower left and right."""
    return (
        excess(lights, row - 1, column),
        excess(lights, row - 1, column + 1),
        excess(lights, row, column),
        excess(lights, row, column + 1),
    )


@inlined
def placed(sums: Any, first: Int, i: Int, xi: Float) -> Float:
    """Where a random number lies between the running sums before and at i, in [0, 1)."""
    before = sums[first + i - 1] if i > 0 else ZERO
    return min(LARGEST, max(ZERO, (xi - before) / (sums[first + i] - before)))


@inlined
def by_line(xi: Float, a: Float, b: Float) -> Float:
    """A number in [0, 1) with a density that goes linearly from a to b, up to a factor."""
    root = np.float32(math.sqrt(a * a + xi * (b * b - a * a)))
    return min(LARGEST, xi * (a + b) / max(a + root, SMALLEST))


@kernel
def sample_patches(lights: Lights, xi_1: Float, xi_2: Float) -> tuple[Vector, Float]:
    """A direction to the part of the surroundings above their mean, and its density per steradian."""
    sky, width = lights.sky, lights.width
    row = first_above(sky.rows, np.int64(0), lights.height + 1, xi_1)
    column = first_above(sky.columns, row * width, width, xi_2)
    a, b, c, d = corners_of_patch(lights, row, column)
    down = by_line(placed(sky.rows, np.int64(0), row, xi_1), a + b, c + d)
    left, right = a + down * (c - a), b + down * (d - b)
    across = by_line(placed(sky.columns, row * width, column, xi_2), left, right)
    y = sky.cosines[row] + down * (sky.cosines[row + 1] - sky.cosines[row])
    sine = np.float32(math.sqrt(max(ZERO, (ONE - y) * (ONE + y))))
    angle = np.float32(2.0) * PI * ((np.float32(column) + HALF + across) / np.float32(width) - HALF)
    direction = Vector(sine * np.float32(math.sin(angle)), y, -sine * np.float32(math.cos(angle)))
    return direction, sky.scale * (left + across * (right - left))


@kernel
def patches_density(lights: Lights, direction: Vector) -> Float:
    """Density per steradian with which :func:`sample_patches` chooses a direction."""
    sky = lights.sky
    turn = np.float32(math.atan2(direction.x, -direction.z)) / (np.float32(2.0) * PI)
    tilt = np.float32(math.acos(min(ONE, max(-ONE, direction.y)))) / PI
    x = (turn + HALF) * np.float32(lights.width) + np.float32(lights.width) - HALF  # once around, to be positive
    column = np.int64(x)
    row = min(np.int64(tilt * np.float32(lights.height) + HALF), lights.height)
    a, b, c, d = corners_of_patch(lights, row, column)
    down = (sky.cosines[row] - direction.y) / (sky.cosines[row] - sky.cosines[row + 1])
    down, across = min(ONE, max(ZERO, down)), x - np.float32(column)
    left, right = a + down * (c - a), b + down * (d - b)
    return sky.scale * (left + across * (right - left))


@inlined
def mixed_density(lights: Lights, surface: Surface, direction: Vector, patches: Float) -> Float:
    """Density per steradian of a direction to the surroundings, of both ways to sample them."""
    share = lights.sky.share
    return (ONE - share) * max(ZERO, dot(surface.normal, direction)) / PI + share * patches


@inlined
def sky_density(lights: Lights, surface: Surface, direction: Vector) -> Float:
    """Density per steradian with which :func:`sample_light` chooses a direction of the surroundings."""
    patches = patches_density(lights, direction) if lights.sky.share > ZERO else ZERO
    return light_chance(lights, surface, lights.sky_row) * mixed_density(lights, surface, direction, patches)


@kernel
def sample_sky(lights: Lights, surface: Surface, light: Int, chance: Float, xi_1: Float, xi_2: Float) -> LightSample:
    """One direction to the surroundings."""
    share, patches = lights.sky.share, ZERO
    if xi_1 < share:
        direction, patches = sample_patches(lights, min(LARGEST, xi_1 / share), xi_2)
    else:
        direction = cosine_direction(surface.normal, min(LARGEST, (xi_1 - share) / (ONE - share)), xi_2)
        if share > ZERO:
            patches = patches_density(lights, direction)
    density = chance * mixed_density(lights, surface, direction, patches)
    if dot(surface.normal, direction) < GRAZING or not density > ZERO:
        return LightSample(direction, ZERO, Vector(ZERO, ZERO, ZERO), ZERO, ZERO, light)
    return LightSample(direction, INFINITY, environment_radiance(lights, direction), ONE / density, density, light)


@inlined
def emitter_density(
    lights: Lights, geometry: Geometry, surface: Surface, prim: Int, emitter: Int, direction: Vector, distance: Float
) -> Float:
    """Density per steradian with which :func:`sample_light` chooses the point of an emitter that a ray met."""
    _, edge_1, edge_2 = corners_of(geometry, prim)
    facing = -HALF * dot(cross(edge_1, edge_2), direction)  # area times cosine
    return light_chance(lights, surface, lights.first_emitter + emitter) * distance * distance / facing


@inlined
def sample_light(
    lights: Lights, geometry: Geometry, surface: Surface, xi_0: Float, xi_1: Float, xi_2: Float
) -> LightSample:
    """Chooses one light by its chance and one way to it; the scale is zero where no light arrives.

    The reflected light is f * cosine * colour * scale, if nothing lies on the way. A triangle is sampled by area.
    """
    light, chance = pick_light(lights, surface, xi_0)
    kind = lights.kind[light]
    colour, place = three(lights.colour, np.int64(3) * light), three(lights.vector, np.int64(3) * light)
    nothing = LightSample(Vector(ZERO, ZERO, ZERO), ZERO, colour, ZERO, ZERO, light)
    if kind == DIRECTIONAL:
        return LightSample(scaled(place, -ONE), INFINITY, colour, ONE / chance, ZERO, light)
    if kind == ENVIRONMENT:
        return sample_sky(lights, surface, light, chance, xi_1, xi_2)
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
