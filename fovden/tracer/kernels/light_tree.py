"""A tree over the lights that have a place: chooses one by how much it can bring to a point, and says how likely.

A node bounds its lights by a sphere, a cone about the directions in which they face, and the sum of their powers. Its
importance to a surface is power / distance^2 times the largest cosines that the bounds allow, at the lights and at the
surface. From the root down one of two children is chosen by importance; the random number is stretched and used again.

Source: A. Conty Estevez and C. Kulla, "Importance sampling of many lights with adaptive tree splitting", Proceedings of
the ACM on Computer Graphics 1(2), 2018, with the importance of M. Pharr, W. Jakob and G. Humphreys, "Physically based
rendering", 4th edition, section 12.6.3. Departures: each child keeps a thousandth, so that no light is without a
chance, be it for rounding or because a very near lamp, which may be hidden, outweighs it; within its sphere a node's
distance counts as the radius.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import load_int32
from fovden.tracer.kernels.surface import three
from fovden.tracer.kernels.vectors import Vector, added, dot, scaled

NODE = 16
"""Float32 numbers of a node, a cache line: the sphere's centre and its RADIUS squared, the cone's AXIS and half-angle
as COSINE and SINE, the POWER, then two int32: CHILD, the first of two neighbours, or ~row of a light, and PARENT."""
RADIUS, AXIS, COSINE, SINE, POWER, CHILD, PARENT = 3, 4, 7, 8, 9, 10, 11
ROOT = 1
"""The root; children are pairs of an even and the next number, so that siblings differ in the last bit."""

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
LEAST = np.float32(2.0**-10)
"""The least chance of a child where its parent was chosen: over 20 levels it costs at most 2 % of the samples."""
TINY = np.float32(1e-30)
"""The least squared distance, m^2; powers are shares of at most 1, so that importance stays finite."""
LARGEST = np.float32(1.0 - 2.0**-24)
"""The largest random number."""


@inlined
def reduced(cosine_a: Float, sine_a: Float, cosine_b: Float, sine_b: Float) -> tuple[Float, Float]:
    """Cosine and sine of max(0, a - b), for angles from 0 to pi."""
    if cosine_a > cosine_b:
        return ONE, ZERO
    return cosine_a * cosine_b + sine_a * sine_b, max(ZERO, sine_a * cosine_b - cosine_a * sine_b)


@inlined
def sine_of(cosine: Float) -> Float:
    """The sine of an angle from 0 to pi."""
    return np.float32(math.sqrt(max(ZERO, ONE - cosine * cosine)))


@inlined
def importance(tree: Any, node: Int, position: Vector, normal: Vector) -> Float:
    """How much a node's lights may bring to a surface, up to a factor."""
    k = np.int64(NODE) * node
    towards = added(three(tree, k), position, -ONE)
    square, radius = dot(towards, towards), tree[k + RADIUS]
    if square <= radius:
        return tree[k + POWER] / max(radius, TINY)
    direction = scaled(towards, ONE / np.float32(math.sqrt(square)))
    spread = radius / square  # squared sine of the angle that the sphere subtends
    cosine_s, sine_s = np.float32(math.sqrt(ONE - spread)), np.float32(math.sqrt(spread))
    at_light = -dot(three(tree, k + AXIS), direction)
    cosine, sine = reduced(at_light, sine_of(at_light), tree[k + COSINE], tree[k + SINE])
    cosine, _ = reduced(cosine, sine, cosine_s, sine_s)
    at_surface = dot(normal, direction)
    other, _ = reduced(at_surface, sine_of(at_surface), cosine_s, sine_s)
    return tree[k + POWER] / max(square, TINY) * max(cosine, ZERO) * max(other, ZERO)


@inlined
def share_of_even(tree: Any, even: Int, position: Vector, normal: Vector) -> Float:
    """Chance of the even one of two siblings to be chosen where their parent was."""
    first, second = importance(tree, even, position, normal), importance(tree, even + 1, position, normal)
    total = first + second
    return min(ONE - LEAST, max(LEAST, first / total)) if total > ZERO else HALF


@kernel
def descend(tree: Any, position: Vector, normal: Vector, xi: Float) -> tuple[Int, Float]:
    """Chooses a light: the row it has in the table, and its chance."""
    node, chance = np.int64(ROOT), ONE
    while True:
        child = np.int64(load_int32(tree, np.int64(NODE) * node + CHILD))
        if child < 0:
            return ~child, chance
        share = share_of_even(tree, child, position, normal)
        if xi < share:
            node, xi, chance = child, xi / share, chance * share
        else:
            node, xi, chance = child + 1, (xi - share) / (ONE - share), chance * (ONE - share)
        xi = min(xi, LARGEST)


@kernel
def chance_of(tree: Any, leaf: Int, position: Vector, normal: Vector) -> Float:
    """Chance with which :func:`descend` chooses the light of a leaf: from there up to the root."""
    node, chance = np.int64(leaf), ONE
    while node != ROOT:
        share = share_of_even(tree, node & ~np.int64(1), position, normal)
        chance *= ONE - share if node & 1 else share
        node = np.int64(load_int32(tree, np.int64(NODE) * node + PARENT))
    return chance
