"""Cuts large triangles into pieces, each with a box of its own, before a tree is built over the boxes.

The box of a long triangle that is not aligned to an axis is mostly empty, and overlaps everything. Its pieces' boxes
are not. Every piece stands for the whole triangle, whose hits are what they were; a triangle may thus be in several
leaves. How many pieces a triangle gets follows Karras and Aila, "Fast parallel construction of high-quality bounding
volume hierarchies" (2013): in proportion to the cube root of the area that its box has more than the thinnest boxes
around it would.

Departures: pieces are cut at the middle of their longest side rather than at planes that all triangles share.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.tracer.kernels.build import half_area, widest

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
MARGIN = np.float32(2.0**-21)  # of a box's extent: what ``boxes`` needs to find all that ``triangles`` hits
UNIT = np.float32(2.0**-23)  # a coordinate times this is one to two units in its last place
MOST_CUTS = 60
CORNERS = 12  # a triangle cut by six planes has nine at most


@kernel
def priorities(start: Int, stop: Int, vertices: Any, faces: Any, boxes: Any, priority: Any) -> None:
    """Writes how much the triangles start .. stop - 1 deserve to be cut; 0 for those without area."""
    for i in range(start, stop):
        a, b, c = vertices[faces[i, 0]], vertices[faces[i, 1]], vertices[faces[i, 2]]
        projected = ZERO
        for axis in range(3):
            j, k = (axis + 1) % 3, (axis + 2) % 3
            projected += abs((b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j])) * HALF
        excess = half_area(boxes[i]) - projected
        priority[i] = ZERO
        if projected > ZERO and ZERO < excess < np.inf:
            priority[i] = excess ** np.float32(1.0 / 3.0)


@kernel
def clip(polygon: Any, count: Int, source: Int, axis: Int, side: Float, plane: Float) -> Int:
    """Cuts off what lies below a plane (above, if ``side`` is -1), from one polygon to the other; returns its size."""
    used = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        above, next_above = side * (polygon[source, i, axis] - plane), side * (polygon[source, j, axis] - plane)
        if above >= 0.0:
            for k in range(3):
                polygon[1 - source, used, k] = polygon[source, i, k]
            used += 1
        if (above < 0.0) != (next_above < 0.0):
            share = above / (above - next_above)
            for k in range(3):
                start = polygon[source, i, k]
                polygon[1 - source, used, k] = start + share * (polygon[source, j, k] - start)
            polygon[1 - source, used, axis] = plane
            used += 1
    return used


@inlined
def copy_box(boxes: Any, i: Int, other: Any, j: Int) -> None:
    """Writes one row of six numbers. Numba takes seconds to compile assignments of whole rows."""
    for k in range(6):
        boxes[i, k] = other[j, k]


@kernel
def box_within(corners: Any, bounds: Any, polygon: Any, boxes: Any, row: Int) -> bool:
    """Writes the box of the part of a triangle within bounds to a row, rounded outwards; returns if there is any."""
    count, source = np.int64(3), np.int64(0)  # a literal would compile ``clip`` anew
    for corner in range(3):
        for axis in range(3):
            polygon[0, corner, axis] = corners[corner, axis]
    for axis in range(3):
        count = clip(polygon, count, source, axis, 1.0, np.float64(bounds[0, axis]))
        count = clip(polygon, count, 1 - source, axis, -1.0, np.float64(bounds[0, 3 + axis]))
    if count == 0:
        return False
    for axis in range(3):
        lower, upper = polygon[source, 0, axis], polygon[source, 0, axis]
        for i in range(1, count):
            lower, upper = min(lower, polygon[source, i, axis]), max(upper, polygon[source, i, axis])
        low, high = np.float32(lower), np.float32(upper)
        boxes[row, axis] = low - abs(low) * UNIT if low > lower else low
        boxes[row, 3 + axis] = high + abs(high) * UNIT if high < upper else high
    return True


@kernel
def cut(start: Int, stop: Int, vertices: Any, faces: Any, boxes: Any, ends: Any, pieces: Any, owners: Any) -> None:
    """Writes the pieces' boxes of the triangles start .. stop - 1, and the triangle of each.

    Args:
        start: First triangle.
        stop: End of the triangles.
        vertices: Positions, (n, 3).
        faces: Vertex numbers, (m, 3).
        boxes: The triangles' bounds, (m, 6).
        ends: End of each triangle's pieces in the list of all, (m).
        pieces: Receives the pieces' bounds, by MARGIN of the triangle's extent larger where it was cut.
        owners: Receives the triangles.
    """
    polygon, corners = np.empty((2, CORNERS, 3)), np.empty((3, 3))
    stack, cuts, bounds = (
        np.empty((MOST_CUTS + 2, 6), np.float32),
        np.empty(MOST_CUTS + 2, np.int64),
        np.empty((1, 6), np.float32),
    )
    for i in range(start, stop):
        used = ends[i - 1] if i > 0 else 0
        if ends[i] == used + 1:
            copy_box(pieces, used, boxes, i)
            owners[used] = i
            continue
        for corner in range(3):
            for axis in range(3):
                corners[corner, axis] = vertices[faces[i, corner], axis]
        margin = MARGIN * widest(boxes[i])
        copy_box(stack, 0, boxes, i)
        cuts[0], top = ends[i] - used - 1, 1
        while top > 0:
            top -= 1
            rest = cuts[top]
            if rest == 0:
                for axis in range(3):
                    pieces[used, axis], pieces[used, 3 + axis] = (
                        stack[top, axis] - margin,
                        stack[top, 3 + axis] + margin,
                    )
                owners[used] = i
                used += 1
                continue
            copy_box(bounds, 0, stack, top)
            axis = 0
            for other in (1, 2):
                if bounds[0, 3 + other] - bounds[0, other] > bounds[0, 3 + axis] - bounds[0, axis]:
                    axis = other
            lower, upper = bounds[0, axis], bounds[0, 3 + axis]
            middle, first = HALF * lower + HALF * upper, top
            bounds[0, 3 + axis] = middle
            if box_within(corners, bounds, polygon, stack, top):
                top += 1
            bounds[0, axis], bounds[0, 3 + axis] = middle, upper
            if box_within(corners, bounds, polygon, stack, top):
                top += 1
            if top == first + 2:
                left, right = widest(stack[first]), widest(stack[first + 1])
                cuts[first] = int(np.float32(rest - 1) * (left / (left + right)) + HALF) if left + right > ZERO else 0
                cuts[first + 1] = rest - 1 - cuts[first]
            else:  # all of it lies on one side, or rounding has left nothing
                if top == first:
                    bounds[0, axis] = lower
                    copy_box(stack, first, bounds, 0)
                    top += 1
                cuts[first] = rest - 1
        while used < ends[i]:  # fewer pieces than were foreseen
            copy_box(pieces, used, pieces, used - 1)
            owners[used] = i
            used += 1
