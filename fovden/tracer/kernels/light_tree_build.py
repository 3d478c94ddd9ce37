"""Builds the tree over lights from the top down: sets are cut so that lights lie close together and face alike.

The cost of a side is its power times the area of its box times the measure of the directions that it shines into, and
long boxes are not to be cut along their short sides (surface area orientation heuristic: Conty Estevez and Kulla 2018,
section 4.4). Candidates are the limits of BINS equal intervals along each axis. Departure: where a cut is weighed, a
side's cone is taken from the length of its mean direction R, of a cap that has the same: cos = 2 R - 1; the nodes' own
cones are bounds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.tracer.kernels.light_tree import AXIS, CHILD, COSINE, PARENT, POWER, RADIUS, ROOT, SINE

BINS = 12
"""As in pbrt 4."""
SUMS = 10  # of an interval: power, weighted direction (3), lower and upper corner
MARGIN = 4e-7
"""What a cone's cosine and, relatively, a sphere's radius are widened by: a few roundings to float32."""
SLENDER = 1.0 / 64.0
"""Share of the squared diagonal that counts as area, so that lights in a row are cut in the middle, not one by one."""


@inlined
def shining(cosine: Float) -> Float:
    """Solid angle that lights of a cone of normals shine into, weighted by the cosine: the paper's M_Omega.

    The closed form of its section 4.4 for theta_e = pi / 2.
    """
    theta, sine = math.acos(cosine), math.sqrt(max(0.0, 1.0 - cosine * cosine))
    reach = min(theta + math.pi / 2, math.pi)
    edge = 2 * reach * sine - math.cos(theta - 2 * reach) - 2 * theta * sine + cosine
    return 2 * math.pi * (1 - cosine) + math.pi / 2 * edge


@inlined
def cost(sums: Any) -> Float:
    """Power times area times directions of one side of a cut; zero for none and for a single point."""
    power = sums[0]
    if not power > 0.0:
        return 0.0
    x, y, z = sums[7] - sums[4], sums[8] - sums[5], sums[9] - sums[6]
    resultant = math.sqrt(sums[1] * sums[1] + sums[2] * sums[2] + sums[3] * sums[3]) / power
    area = x * y + y * z + z * x + SLENDER * (x * x + y * y + z * z)
    return power * area * shining(min(1.0, max(-1.0, 2 * resultant - 1)))


@inlined
def clear(sums: Any) -> None:
    """Sums of nothing."""
    for k in range(4):
        sums[k] = 0.0
    for k in range(3):
        sums[4 + k], sums[7 + k] = np.inf, -np.inf


@inlined
def include(sums: Any, other: Any) -> None:
    """Adds other sums."""
    for k in range(4):
        sums[k] += other[k]
    for k in range(3):
        sums[4 + k], sums[7 + k] = min(sums[4 + k], other[4 + k]), max(sums[7 + k], other[7 + k])


@kernel
def best_cut(lights: Any, order: Any, first: Int, last: Int, whole: Any, bins: Any, sides: Any) -> tuple[Int, Float]:
    """Axis and place of the cheapest cut of some lights by their boxes' middles; axis -1 where all lie together."""
    best, axis, place = np.inf, -1, 0.0
    extent = max(whole[7] - whole[4], max(whole[8] - whole[5], whole[9] - whole[6]))
    for a in range(3):
        low, high = np.inf, -np.inf
        for i in range(first, last):
            middle = lights[order[i], 4 + a] + lights[order[i], 7 + a]
            low, high = min(low, middle), max(high, middle)
        if not high > low:
            continue
        for b in range(BINS):
            clear(bins[b])
        for i in range(first, last):
            light = lights[order[i]]
            b = int(BINS * ((light[4 + a] + light[7 + a] - low) / (high - low)))
            include(bins[min(b, BINS - 1)], light)
        clear(sides[BINS])
        for b in range(BINS - 1, 0, -1):
            sides[b] = sides[b + 1]
            include(sides[b], bins[b])
        clear(sides[0])
        elongation = extent / max(whole[7 + a] - whole[4 + a], 1e-300)
        for b in range(1, BINS):
            include(sides[0], bins[b - 1])
            total = elongation * (cost(sides[0]) + cost(sides[b]))
            if total < best and sides[0, 0] > 0.0 and sides[b, 0] > 0.0:
                best, axis, place = total, a, low + (high - low) * b / BINS
    return axis, place


@kernel
def write_bounds(tree: Any, lights: Any, cones: Any, order: Any, first: Int, last: Int, node: Int, whole: Any) -> None:
    """Writes sphere, cone and power of a node, and sums its lights."""
    clear(whole)
    widest = 0.0
    for i in range(first, last):
        include(whole, lights[order[i]])
        widest = max(widest, cones[order[i]])
    square = 0.0
    for k in range(3):
        middle = np.float32((whole[4 + k] + whole[7 + k]) / 2)
        tree[node, k] = middle
        half = max(whole[7 + k] - np.float64(middle), np.float64(middle) - whole[4 + k])
        square += half * half
    tree[node, RADIUS] = square * (1 + MARGIN) ** 2
    tree[node, POWER] = whole[0]
    length = math.sqrt(whole[1] * whole[1] + whole[2] * whole[2] + whole[3] * whole[3])
    cosine = -1.0
    if length > 1e-6 * whole[0] and widest < math.pi:
        x, y, z = whole[1] / length, whole[2] / length, whole[3] / length
        angle = 0.0
        for i in range(first, last):
            light = lights[order[i]]
            if light[0] > 0.0:
                own = (x * light[1] + y * light[2] + z * light[3]) / light[0]
                angle = max(angle, math.acos(min(1.0, max(-1.0, own))))
        cosine = max(-1.0, math.cos(angle) - MARGIN)
        tree[node, AXIS], tree[node, AXIS + 1], tree[node, AXIS + 2] = x, y, z
    else:
        tree[node, AXIS], tree[node, AXIS + 1], tree[node, AXIS + 2] = 0.0, 0.0, 1.0
    tree[node, COSINE], tree[node, SINE] = cosine, math.sqrt(max(0.0, 1.0 - cosine * cosine))


@kernel
def build(lights: Any, cones: Any, rows: Any, order: Any, stack: Any, tree: Any, codes: Any, leaves: Any) -> None:
    """Builds the tree.

    Args:
        lights: Power, direction times power, lower and upper corner of each light, float64, (n, SUMS); the powers are
            positive.
        cones: Half-angle about its direction in which each light faces: 0 for a triangle, pi for a point, (n).
        rows: What the tree is to call each light, (n).
        order: The numbers 0 .. n - 1; sorted into leaves on return.
        stack: Room for (first, last, node), int64, (n + 1, 3).
        tree: Receives the nodes, float32, (2 n, NODE); number 0 is unused.
        codes: The same memory as int32.
        leaves: Receives the node of each light, (n).
    """
    bins, sides, whole = np.empty((BINS, SUMS)), np.empty((BINS + 1, SUMS)), np.empty(SUMS)
    free, depth = 2, 1
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, len(order), ROOT
    while depth > 0:
        depth -= 1
        first, last, node = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        write_bounds(tree, lights, cones, order, first, last, node, whole)
        if last - first == 1:
            codes[node, CHILD], leaves[order[first]] = ~rows[order[first]], node
            continue
        axis, place = best_cut(lights, order, first, last, whole, bins, sides)
        middle = first
        if axis >= 0:
            end = last
            while middle < end:
                light = lights[order[middle]]
                if light[4 + axis] + light[7 + axis] < place:
                    middle += 1
                else:
                    end -= 1
                    order[middle], order[end] = order[end], order[middle]
        if middle in (first, last):
            middle = (first + last) // 2
        codes[node, CHILD] = free
        codes[free, PARENT] = codes[free + 1, PARENT] = node
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = middle, last, free + 1
        stack[depth + 1, 0], stack[depth + 1, 1], stack[depth + 1, 2] = first, middle, free
        free, depth = free + 2, depth + 2
