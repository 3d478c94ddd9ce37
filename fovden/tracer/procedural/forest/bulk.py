"""Many alike surfaces at once: lattices, tubes, and copies turned any way, each made in one go by NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.patch import Array, Indices, Patch, smoothed

__all__ = ["lattices", "scattered", "tubes"]

NARROWEST = 6e-4
"""Least width of a tube's facets before its end, metres."""


def lattices(points: Array, uv: Array, *, pinched: bool = False) -> Patch:
    """Returns the smooth surfaces through many grids of points of the same size.

    With columns to the right and rows upward the visible side faces the viewer.

    Args:
        points: Positions in metres, shape (k, rows, columns, 3).
        uv: Texture coordinates in metres, shape (k, rows, columns, 2).
        pinched: Whether each grid's last row is a single point, so that its cells are triangles.

    Returns:
        The k surfaces as one patch.

    Example:
        >>> x, y = np.meshgrid(np.arange(3.0), np.arange(2.0))
        >>> cloth = np.stack([x, y, 0.1 * x * y], axis=-1)
        >>> lattices(np.stack([cloth, cloth + 5]), np.zeros((2, 2, 3, 2))).triangle_count
        8
    """
    count, rows, columns = points.shape[:3]
    vertices = points.reshape(-1, 3)
    faces = _lattice_faces(count, rows, columns, pinched=pinched)
    patch = Patch(vertices, faces, uv.reshape(-1, 2), np.zeros_like(vertices))
    return smoothed(_without_loose_vertices(patch) if pinched else patch)


def tubes(paths: Array, radii: Array, sides: int) -> Patch:
    """Returns round tubes along many polylines, each closed by a point at its end.

    The cross-sections are carried along without twist, as by :func:`fovden.tracer.procedural.primitives.tube`. Where
    a tube is thick enough for a seam to show, its texture coordinates go around by a whole number of metres.

    Args:
        paths: Positions in metres, shape (k, n, 3).
        radii: Radii in metres, shape (k, n); the last of each is taken as 0.
        sides: Number of segments around; fewer where the thinnest tube would have facets below 0.6 mm at its end.

    Returns:
        The k tubes as one patch, smooth.

    Example:
        >>> straight = np.zeros((5, 3, 3))
        >>> straight[:, :, 1] = [0.0, 1.0, 2.0]
        >>> tubes(straight, np.full((5, 3), 0.1), sides=6).triangle_count
        90
    """
    count, rows = paths.shape[:2]
    sides = min(sides, max(3, int(2 * np.pi * radii[:, -2].min() / NARROWEST)))
    radii = radii * (np.arange(rows) < rows - 1)
    tangent = np.gradient(paths, axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    side = np.zeros_like(paths)
    helper = np.eye(3)[np.argmin(np.abs(tangent[:, 0]), axis=1)]
    for i in range(rows):
        helper = helper - tangent[:, i] * (helper * tangent[:, i]).sum(axis=1, keepdims=True)
        helper /= np.linalg.norm(helper, axis=1, keepdims=True)
        side[:, i] = helper
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    angle[-1] = 0.0
    other = np.cross(tangent, side)
    around = np.cos(angle)[:, None] * side[:, :, None] + np.sin(angle)[:, None] * other[:, :, None]
    points = paths[:, :, None] + radii[:, :, None, None] * around
    girth = 2 * np.pi * radii.max(axis=1)
    girth = np.where(girth > 0.5, np.maximum(np.round(girth), 1.0), girth)
    length = np.linalg.norm(np.diff(paths, axis=1), axis=2).cumsum(axis=1)
    v = np.concatenate([np.zeros((count, 1)), length], axis=1)
    u = girth[:, None] * np.linspace(0, 1, sides + 1)
    uv = np.stack(np.broadcast_arrays(u[:, None, :], v[:, :, None]), axis=-1)
    faces = _lattice_faces(count, rows, sides + 1, pinched=True)
    patch = Patch(points.reshape(-1, 3), faces, uv.reshape(-1, 2), around.reshape(-1, 3))
    return _without_loose_vertices(patch)


def scattered(
    patch: Patch,
    offsets: Array,
    turns: ArrayLike = 0.0,
    tilts: ArrayLike = 0.0,
    rolls: ArrayLike = 0.0,
    scales: ArrayLike = 1.0,
) -> Patch:
    """Returns one copy for each offset, turned any way: rolled about its front, tilted, turned, scaled and shifted.

    Texture coordinates stay as they are, so that every copy shows the whole of its texture.

    Args:
        patch: What is copied.
        offsets: Where the local origin goes, metres, shape (k, 3).
        turns: Angles about y in radians, shape (k) or one number: the front (+z) turns towards +x.
        tilts: Angles by which the front is lifted above the horizon, radians.
        rolls: Angles about the front, radians.
        scales: Sizes.

    Returns:
        The k copies as one patch.

    Example:
        >>> from fovden.tracer.procedural.primitives import quad
        >>> plate = quad((0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0))
        >>> scattered(plate, np.zeros((1, 3)), tilts=np.pi / 2).vertices[1].round(9).tolist()
        [0.0, 1.0, 0.0]
    """
    count = len(offsets)
    turn, tilt, roll, scale = (np.broadcast_to(np.asarray(a, float), (count,)) for a in (turns, tilts, rolls, scales))
    front = np.stack([np.cos(tilt) * np.sin(turn), np.sin(tilt), np.cos(tilt) * np.cos(turn)], axis=1)
    right = np.stack([np.cos(turn), np.zeros(count), -np.sin(turn)], axis=1)
    up = np.cross(front, right)
    cosine, sine = np.cos(roll)[:, None], np.sin(roll)[:, None]
    rotation = np.stack([cosine * right + sine * up, cosine * up - sine * right, front], axis=2)
    vertices = np.einsum("kij,nj->kni", rotation, patch.vertices) * scale[:, None, None] + offsets[:, None]
    normals = np.einsum("kij,nj->kni", rotation, patch.normals)
    faces = patch.faces + np.arange(count)[:, None, None] * len(patch.vertices)
    uv = np.tile(patch.uv, (count, 1))
    return Patch(vertices.reshape(-1, 3), faces.reshape(-1, 3), uv, normals.reshape(-1, 3))


def _lattice_faces(count: int, rows: int, columns: int, *, pinched: bool) -> Indices:
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    first, second = np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)
    if pinched:
        second = second[:-1]
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    numbers: Indices = (faces + np.arange(count)[:, None, None] * rows * columns).reshape(-1, 3)
    return numbers


def _without_loose_vertices(patch: Patch) -> Patch:
    """The patch without the vertices that no triangle has."""
    used = np.zeros(len(patch.vertices), dtype=bool)
    used[patch.faces] = True
    number = np.cumsum(used) - 1
    return Patch(patch.vertices[used], number[patch.faces], patch.uv[used], patch.normals[used])
