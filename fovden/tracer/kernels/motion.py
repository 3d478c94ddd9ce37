"""Where what each pixel shows was a frame before, in double precision: a float32 image of motion has no noise then."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.tracer.kernels.vectors import Vector, added, cross, dot

ZERO, ONE = np.float64(0.0), np.float64(1.0)
AHEAD = 2.0**-20  # of the distance: a point less deep than that lies beside the camera; no image is that wide


class Eyes(NamedTuple):
    """Views as :class:`fovden.camera.Camera` has them, float64, and the scene that they see."""

    origin: Any  # (v, 3)
    rotation: Any  # (v, 3, 3)
    bounds: Any  # (v, 4)
    vertices: Any  # (n, 3), float32


class Seen(NamedTuple):
    """A point from an eye: the way there, its place on the raster, whether it is ahead, and the side that is seen."""

    towards: Vector
    x: Float
    y: Float
    ahead: bool
    side: Float  # above zero where the geometric normal points away from the eye; 0 for the surroundings


@inlined
def away(eyes: Eyes, view: Int, x: Float, y: Float, height: Int, width: Int) -> Vector:
    """Direction, of any length, of the ray through raster coordinates."""
    left, right, bottom, top = eyes.bounds[view]
    along, upward = left + (right - left) * x / width, top - (top - bottom) * y / height
    turn = eyes.rotation[view]
    return Vector(
        turn[0, 0] * along + turn[0, 1] * upward - turn[0, 2],
        turn[1, 0] * along + turn[1, 1] * upward - turn[1, 2],
        turn[2, 0] * along + turn[2, 1] * upward - turn[2, 2],
    )


@inlined
def corner(eyes: Eyes, vertex: Int) -> Vector:
    """A vertex."""
    place = eyes.vertices[vertex]
    return Vector(np.float64(place[0]), np.float64(place[1]), np.float64(place[2]))


@inlined
def seen_from(
    eyes: Eyes, view: Int, faces: Any, prim: Int, u: Float, v: Float, sky: Vector, height: Int, width: Int
) -> Seen:
    """The point of a triangle, or the surroundings in a direction where there is none, as an eye sees it."""
    towards, side = sky, ZERO
    if prim >= 0:
        a = corner(eyes, faces[prim, 0])
        across, along = added(corner(eyes, faces[prim, 1]), a, -ONE), added(corner(eyes, faces[prim, 2]), a, -ONE)
        origin = eyes.origin[view]
        point = added(added(a, across, u), along, v)
        towards = Vector(point.x - origin[0], point.y - origin[1], point.z - origin[2])
        side = dot(cross(across, along), towards)
    turn = eyes.rotation[view]
    right = turn[0, 0] * towards.x + turn[1, 0] * towards.y + turn[2, 0] * towards.z
    upward = turn[0, 1] * towards.x + turn[1, 1] * towards.y + turn[2, 1] * towards.z
    depth = -(turn[0, 2] * towards.x + turn[1, 2] * towards.y + turn[2, 2] * towards.z)
    west, east, south, north = eyes.bounds[view]
    x = (right / depth - west) / (east - west) * width
    y = (north - upward / depth) / (north - south) * height
    return Seen(towards, x, y, depth > AHEAD * np.sqrt(dot(towards, towards)), side)


@kernel
def reproject(
    start: Int,
    stop: Int,
    prim: Any,
    barycentric: Any,
    faces: Any,
    now: Eyes,
    before: Eyes,
    jitter_x: Float,
    jitter_y: Float,
    points: Any,
    height: Int,
    width: Int,
    motion: Any,
    towards: Any,
    visible: Any,
) -> None:
    """Takes the pixels start .. stop - 1, counted through all views, back to the previous frame.

    Args:
        start: First pixel.
        stop: End of the pixels.
        prim: The triangles that they show, (v, 1, h, w).
        barycentric: Where on these, (v, 2, h, w).
        faces: Vertex numbers, (m, 3).
        now: Views and vertices of this frame.
        before: Those of the previous one.
        jitter_x: Shift of the rays to the right, in pixels.
        jitter_y: Shift of the rays downwards.
        points: Raster coordinates of the rays, (v, h, w, 2), NaN where there is none; empty for the camera's own grid.
        height: Height of the screen.
        width: Width of the screen.
        motion: Receives the way on the screen in pixels, (v, 2, h, w); to (-w, -h) for what was not ahead.
        towards: Receives the way from the previous eye to the point in metres, (v, h, w, 3).
        visible: Receives whether the point was inside the previous image and showed the same side, (v, h, w).
    """
    rows, columns = prim.shape[2], prim.shape[3]
    for i in range(start, stop):
        view, y, x = i // (rows * columns), i // columns % rows, i % columns
        triangle = np.int64(prim[view, 0, y, x])
        u, v = np.float64(barycentric[view, 0, y, x]), np.float64(barycentric[view, 1, y, x])
        across, down = x + 0.5 + jitter_x, y + 0.5 + jitter_y
        if points.shape[0] > 0:
            across, down = np.float64(points[view, y, x, 0]), np.float64(points[view, y, x, 1])
        sky = away(now, view, across, down, height, width)
        here = seen_from(now, view, faces, triangle, u, v, sky, height, width)
        there = seen_from(before, view, faces, triangle, u, v, sky, height, width)
        motion[view, 0, y, x] = (there.x if there.ahead else -width) - here.x
        motion[view, 1, y, x] = (there.y if there.ahead else -height) - here.y
        if np.isnan(across):
            motion[view, 0, y, x], motion[view, 1, y, x] = ZERO, ZERO
        way = there.towards
        towards[view, y, x, 0], towards[view, y, x, 1], towards[view, y, x, 2] = way.x, way.y, way.z
        inside = 0 <= there.x <= width and 0 <= there.y <= height
        visible[view, y, x] = there.ahead and inside and np.sign(there.side) == np.sign(here.side)
