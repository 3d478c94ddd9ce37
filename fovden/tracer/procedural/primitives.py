"""Vectorised primitives that make patches: grids, strips, mouldings, surfaces of revolution, boxes and tubes.

Nothing is made that nobody can see: primitives leave out triangles without area, boxes name the sides they have, and
straight directions are never subdivided.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.patch import WELD, Array, Indices, Patch, face_normals, join, smoothed

__all__ = ["arc_lengths", "box", "bridge", "grid", "lathe", "mitred", "quad", "ring_corners", "tube"]


def arc_lengths(points: ArrayLike) -> Array:
    """Returns the distance travelled along a polyline at each of its points, in metres.

    Args:
        points: Positions, shape (n, d).

    Returns:
        Lengths from the first point, shape (n).

    Example:
        >>> arc_lengths([(0, 0), (3, 4), (3, 5)]).tolist()
        [0.0, 5.0, 6.0]
    """
    steps = np.linalg.norm(np.diff(np.asarray(points, dtype=float), axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def grid(points: Array, *, smooth: bool = False, uv: Array | None = None) -> Patch:
    """Returns the surface through a grid of points: two triangles for each cell, none where a cell side vanishes.

    With columns to the right and rows upward the visible side faces the viewer.

    Args:
        points: Positions in metres, shape (rows, columns, 3).
        smooth: Whether normals are averaged over the patch.
        uv: Texture coordinates in metres, shape (rows, columns, 2); ``None`` takes lengths along the middle row and
            the middle column.

    Returns:
        The patch, its vertices in row-major order, those without a triangle left out.

    Example:
        >>> x, y = np.meshgrid(np.arange(4.0), np.arange(3.0))
        >>> grid(np.stack([x, y, 0 * x], axis=-1)).triangle_count
        12
    """
    rows, columns = points.shape[:2]
    if uv is None:
        u, v = arc_lengths(points[rows // 2]), arc_lengths(points[:, columns // 2])
        uv = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2).reshape(-1, 3)
    vertices = points.reshape(-1, 3).astype(float)
    corners = vertices[faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    used, kept = np.unique(faces[sides.min(axis=1) > WELD], return_inverse=True)
    patch = Patch(vertices[used], kept.reshape(-1, 3), uv.reshape(-1, 2)[used], np.zeros((len(used), 3)))
    return smoothed(patch) if smooth else patch


def quad(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> Patch:
    """Returns a flat quadrilateral, corners counter-clockwise seen from its visible side.

    Example:
        >>> quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)).faces.tolist()
        [[0, 1, 2], [0, 2, 3]]
    """
    corners = np.array([a, b, c, d], dtype=float)
    return _flat(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def bridge(lower: ArrayLike, upper: ArrayLike) -> Patch:
    """Returns the flat strip between two polylines, which may have different numbers of points.

    Triangles step along whichever line lags behind in relative length, so (n - 1) + (m - 1) of them suffice. A line of
    one point gives a fan. With both lines running to the right and ``upper`` above, the visible side faces the viewer.

    Args:
        lower: Positions in one plane, shape (n, 3).
        upper: Positions in the same plane, shape (m, 3).

    Returns:
        The flat patch, its texture coordinates in its own plane.

    Example:
        >>> bridge([(0, 0, 0), (2, 0, 0)], [(0, 1, 0), (1, 1, 0), (2, 1, 0)]).triangle_count
        3
    """
    first, second = np.atleast_2d(np.asarray(lower, float)), np.atleast_2d(np.asarray(upper, float))
    middles = []
    for line in (first, second):
        length = arc_lengths(line)
        length = length / max(length[-1], WELD)
        middles.append((length[1:] + length[:-1]) / 2)
    along_first = np.repeat([True, False], [len(first) - 1, len(second) - 1])
    along_first = along_first[np.argsort(np.concatenate(middles), kind="stable")]
    i = np.cumsum(along_first) - along_first
    j = np.cumsum(~along_first) - ~along_first + len(first)
    faces = np.stack([i, np.where(along_first, i + 1, j + 1), j], axis=1)
    return _flat(np.concatenate([first, second]), faces)


def lathe(profile: ArrayLike, segments: int, *, faceted: bool = False, turn: float = 0.0) -> Patch:
    """Returns a surface of revolution about the y axis.

    Args:
        profile: Radius and height (r, y) in metres from bottom to top, shape (n, 2); the visible side is outside. A
            radius of 0 closes the surface.
        segments: Number of segments around.
        faceted: Whether the segments are flat faces, as of a prism; otherwise normals are smooth.
        turn: Angle in radians at which the first segment starts, 0 being the front.

    Returns:
        The patch, smooth along the profile too; join several for creases.

    Example:
        >>> cylinder = lathe([(1, 0), (1, 2)], 64)
        >>> round(cylinder.area, 2)
        12.56
    """
    radius, height = np.asarray(profile, dtype=float).T
    angle = np.linspace(0, 2 * np.pi, segments + 1) + turn
    angle[-1] = angle[0]
    around = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
    points = radius[:, None, None] * around + height[:, None, None] * np.array([0.0, 1.0, 0.0])
    u = np.linspace(0, 2 * np.pi * radius.max(), segments + 1)
    uv = np.stack(np.broadcast_arrays(u, arc_lengths(profile)[:, None]), axis=-1)
    if not faceted:
        return grid(points, smooth=True, uv=uv)
    sides = [grid(points[:, i : i + 2], uv=uv[:, i : i + 2]) for i in range(segments)]
    return join(sides)


def mitred(
    profile: ArrayLike, corners: ArrayLike, *, closed: bool = False, smooth: bool = False, outward: bool = True
) -> Patch:
    """Returns a moulding: a profile drawn along a horizontal path of straight pieces with mitred corners.

    Args:
        profile: Offset from the path and height (o, y) in metres from bottom to top, shape (n, 2).
        corners: The path (x, z), shape (m, 2). Walking along it, the visible side is on the right hand:
            counter-clockwise seen from above goes around the outside of a block.
        closed: Whether the path returns to its first corner.
        smooth: Whether normals are averaged along the profile.
        outward: ``False`` walks the path backwards, which shows the moulding's side to the path's inside.

    Returns:
        One strip of quadrilaterals for each straight piece.

    Example:
        >>> mitred([(0, 0), (0, 1)], [(-1, 1), (1, 1), (1, -1), (-1, -1)], closed=True).area
        8.0
    """
    section = np.asarray(profile, dtype=float)
    path = np.asarray(corners, dtype=float)
    path = path if outward else path[::-1]
    if closed:
        path = np.concatenate([path, path[:1]])
    direction = np.diff(path, axis=0)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    before = np.concatenate([normal[-1:] if closed else normal[:1], normal])
    after = np.concatenate([normal, normal[:1] if closed else normal[-1:]])
    mitre = (before + after) / (1 + (before * after).sum(axis=1, keepdims=True))
    plan = path + section[:, None, :1] * mitre
    points = np.insert(plan, 1, np.broadcast_to(section[:, 1:], plan.shape[:2]), axis=2)
    along = np.einsum("rmk,mk->rm", plan[:, :-1] - path[0], direction)
    rise = arc_lengths(section)
    strips = []
    for i in range(len(direction)):
        end = along[:, i] + np.linalg.norm(plan[:, i + 1] - plan[:, i], axis=1)
        u = np.stack([along[:, i], end], axis=1)
        uv = np.stack([u, np.broadcast_to(rise[:, None], u.shape)], axis=-1)
        strips.append(grid(points[:, i : i + 2], smooth=smooth, uv=uv))
    return join(strips)


def ring_corners(half_x: float, half_z: float) -> list[tuple[float, float]]:
    """Returns the corners (x, z) of a rectangle about the origin, in the order that :func:`mitred` takes for outside.

    Example:
        >>> ring_corners(2, 1)
        [(-2, 1), (2, 1), (2, -1), (-2, -1)]
    """
    return [(-half_x, half_z), (half_x, half_z), (half_x, -half_z), (-half_x, -half_z)]


def box(size: ArrayLike, sides: str = "-x +x -y +y -z +z") -> Patch:
    """Returns the named sides of a box whose bottom's centre is the origin.

    Args:
        size: Extents (x, y, z) in metres.
        sides: Which sides exist, separated by spaces.

    Returns:
        Two triangles for each side, facing outward.

    Example:
        >>> box((1, 2, 3), "+y -z +z").area
        7.0
    """
    x, y, z = (float(value) for value in np.asarray(size, dtype=float))
    x, z = x / 2, z / 2
    corners: dict[str, list[tuple[float, float, float]]] = {
        "-x": [(-x, 0, -z), (-x, 0, z), (-x, y, z), (-x, y, -z)],
        "+x": [(x, 0, z), (x, 0, -z), (x, y, -z), (x, y, z)],
        "-y": [(-x, 0, -z), (x, 0, -z), (x, 0, z), (-x, 0, z)],
        "+y": [(-x, y, z), (x, y, z), (x, y, -z), (-x, y, -z)],
        "-z": [(x, 0, -z), (-x, 0, -z), (-x, y, -z), (x, y, -z)],
        "+z": [(-x, 0, z), (x, 0, z), (x, y, z), (-x, y, z)],
    }
    return join([quad(*corners[side]) for side in sides.split()])


def tube(path: ArrayLike, radius: ArrayLike, segments: int) -> Patch:
    """Returns a round tube along a polyline, open at both ends; a radius of 0 closes an end.

    The cross-section is carried along without twist: each frame is the last one turned by the smallest rotation.

    Args:
        path: Positions in metres, shape (n, 3).
        radius: Radii in metres, shape (n) or one number.
        segments: Number of segments around.

    Returns:
        The patch, smooth.

    Example:
        >>> round(tube([(0, 0, 0), (0, 0, 3)], 0.5, 64).area, 2)
        9.42
    """
    line = np.asarray(path, dtype=float)
    width = np.broadcast_to(np.asarray(radius, dtype=float), (len(line),))
    tangent = np.gradient(line, axis=0)
    if np.allclose(line[0], line[-1]):
        tangent[[0, -1]] = line[1] - line[-2]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.zeros_like(line)
    helper = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for i in range(len(line)):
        helper = helper - tangent[i] * (helper @ tangent[i])
        helper /= np.linalg.norm(helper)
        side[i] = helper
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    angle[-1] = 0.0
    other = np.cross(tangent, side)
    around = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    points = line[:, None] + width[:, None, None] * around
    u = np.linspace(0, 2 * np.pi * width.max(), segments + 1)
    uv = np.stack(np.broadcast_arrays(u, arc_lengths(line)[:, None]), axis=-1)
    return grid(points, smooth=True, uv=uv)


def _flat(vertices: Array, faces: Indices) -> Patch:
    """A planar patch with texture coordinates in its plane: v upward on walls, -z on floors and ceilings."""
    normal = face_normals(vertices, faces).sum(axis=0)
    normal /= np.linalg.norm(normal)
    up = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < 0.7 else np.array([0.0, 0.0, -1.0])
    right = np.cross(up, normal)
    right /= np.linalg.norm(right)
    uv = np.stack([vertices @ right, vertices @ np.cross(normal, right)], axis=1)
    return Patch(vertices, faces, uv, np.zeros_like(vertices))
