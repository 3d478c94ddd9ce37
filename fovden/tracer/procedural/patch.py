"""Pieces of surface, the material of meshes made in code.

A :class:`Patch` is a triangle mesh in float64 with texture coordinates in metres, in a local frame (y up, the front
towards +z). :meth:`Patch.placed` copies it into the world. Triangles run counter-clockwise seen from the visible side.
A zero normal stands for the triangle's own one, so flat parts carry zeros and curved parts carry smooth normals;
creases are edges between patches. How patches are made is the matter of
:mod:`fovden.tracer.procedural.primitives`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["WELD", "Array", "Indices", "Patch", "face_normals", "join", "smoothed"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

WELD = 1e-6
"""Vertices closer than this many metres count as one where normals are averaged; far below any detail made here."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A piece of surface.

    Attributes:
        vertices: Positions in metres, shape (n, 3).
        faces: Vertex numbers, counter-clockwise seen from the visible side, shape (m, 3).
        uv: Texture coordinates in metres, shape (n, 2).
        normals: Unit shading normals, or zeros for the triangle's own, shape (n, 3).

    Example:
        >>> from fovden.tracer.procedural.primitives import quad
        >>> quad((0, 0, 0), (1, 0, 0), (1, 2, 0), (0, 2, 0)).area
        2.0
    """

    vertices: Array
    faces: Indices
    uv: Array
    normals: Array

    @property
    def triangle_count(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    @property
    def area(self) -> float:
        """Total area in square metres."""
        return float(np.linalg.norm(face_normals(self.vertices, self.faces), axis=1).sum() / 2)

    def placed(self, offsets: ArrayLike = (0.0, 0.0, 0.0), turns: ArrayLike = 0.0, scales: ArrayLike = 1.0) -> Patch:
        """Returns one copy for each offset, scaled, turned about the y axis and then shifted.

        Args:
            offsets: Where the local origin goes, shape (k, 3) or (3).
            turns: Angles in radians, shape (k) or one number: the front (+z) turns towards +x.
            scales: Sizes, shape (k) or one number.

        Returns:
            The k copies as one patch.

        Example:
            >>> from fovden.tracer.procedural.primitives import quad
            >>> wall = quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))
            >>> wall.placed([(0, 0, 0), (5, 0, 0)]).triangle_count
            4
        """
        shift = np.atleast_2d(np.asarray(offsets, dtype=float))
        angle = np.atleast_1d(np.asarray(turns, dtype=float))
        scale = np.atleast_1d(np.asarray(scales, dtype=float))
        count = max(len(shift), len(angle), len(scale))
        cosine, sine = np.cos(angle), np.sin(angle)
        zero, one = np.zeros_like(angle), np.ones_like(angle)
        rotation = np.stack([cosine, zero, sine, zero, one, zero, -sine, zero, cosine], axis=1).reshape(-1, 3, 3)
        rotation = np.broadcast_to(rotation, (count, 3, 3))
        shift, scale = np.broadcast_to(shift, (count, 3)), np.broadcast_to(scale, (count,))
        vertices = np.einsum("kij,nj->kni", rotation, self.vertices) * scale[:, None, None] + shift[:, None]
        normals = np.einsum("kij,nj->kni", rotation, self.normals)
        faces = self.faces + np.arange(count)[:, None, None] * len(self.vertices)
        uv = np.broadcast_to(self.uv, (count, *self.uv.shape)) * scale[:, None, None]
        return Patch(vertices.reshape(-1, 3), faces.reshape(-1, 3), uv.reshape(-1, 2), normals.reshape(-1, 3))

    def transformed(self, matrix: ArrayLike) -> Patch:
        """Returns the patch under a rotation or reflection; a reflection also reverses the triangles.

        Args:
            matrix: Orthogonal matrix that multiplies column vectors, shape (3, 3).

        Returns:
            The patch, its visible side still the visible side.

        Example:
            >>> from fovden.tracer.procedural.primitives import quad
            >>> quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)).transformed(np.diag([-1, 1, 1])).vertices[1].tolist()
            [-1.0, 0.0, 0.0]
        """
        matrix = np.asarray(matrix, dtype=float)
        faces = self.faces if np.linalg.det(matrix) > 0 else self.faces[:, ::-1]
        return replace(self, vertices=self.vertices @ matrix.T, normals=self.normals @ matrix.T, faces=faces)

    def standing(self) -> Patch:
        """Returns the patch with its up direction turned to the front: what lay on the floor hangs on a wall.

        Example:
            >>> from fovden.tracer.procedural.primitives import quad
            >>> quad((0, 0, 0), (1, 0, 0), (1, 0, -1), (0, 0, -1)).standing().vertices[2].tolist()
            [1.0, 1.0, 0.0]
        """
        return self.transformed([[1, 0, 0], [0, 0, -1], [0, 1, 0]])

    def reversed(self) -> Patch:
        """Returns the patch seen from its other side.

        Example:
            >>> from fovden.tracer.procedural.primitives import quad
            >>> quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)).reversed().faces[0].tolist()
            [2, 1, 0]
        """
        return replace(self, faces=self.faces[:, ::-1], normals=-self.normals)


def join(patches: Sequence[Patch]) -> Patch:
    """Returns all patches as one, their order and their vertices kept.

    Example:
        >>> from fovden.tracer.procedural.primitives import quad
        >>> wall = quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))
        >>> join([wall, wall.placed((2, 0, 0))]).faces.max()
        np.int64(7)
    """
    starts = np.cumsum([0, *(len(patch.vertices) for patch in patches)])
    return Patch(
        vertices=np.concatenate([patch.vertices for patch in patches]),
        faces=np.concatenate([patch.faces + start for patch, start in zip(patches, starts[:-1], strict=True)]),
        uv=np.concatenate([patch.uv for patch in patches]),
        normals=np.concatenate([patch.normals for patch in patches]),
    )


def smoothed(patch: Patch) -> Patch:
    """Returns the patch with smooth normals: means over the triangles that meet in a point, weighted by their angles.

    Angles make the mean independent of how quadrilaterals are split. Vertices in the same place count as one, so closed
    seams and poles shade without a line.

    Source: Thuermer and Wuethrich, "Computing vertex normals from polygonal facets" (1998).

    Example:
        >>> from fovden.tracer.procedural.primitives import grid
        >>> roof = grid(np.array([[[0, 0, 1], [1, 0, 1]], [[0, 1, 0], [1, 1, 0]], [[0, 0, -1], [1, 0, -1.0]]]))
        >>> smoothed(roof).normals[2].round(9).tolist()
        [0.0, 1.0, 0.0]
    """
    keys = np.round(patch.vertices / WELD).astype(np.int64) + 0
    _, point = np.unique(keys, axis=0, return_inverse=True)
    point = point.reshape(-1)
    normals = face_normals(patch.vertices, patch.faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = patch.vertices[patch.faces]
    one, other = np.roll(triangles, -1, axis=1) - triangles, np.roll(triangles, 1, axis=1) - triangles
    angle = np.arctan2(np.linalg.norm(np.cross(one, other), axis=2), (one * other).sum(axis=2))
    weighted = (normals[:, None] * angle[..., None]).reshape(-1, 3)
    corner = point[patch.faces].reshape(-1)
    total = np.stack([np.bincount(corner, weighted[:, axis], point.max() + 1) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return replace(patch, normals=unit[point])


def face_normals(vertices: Array, faces: Indices) -> Array:
    """Returns the triangles' normals, twice their area long, shape (m, 3).

    Example:
        >>> face_normals(np.eye(3), np.array([[0, 1, 2]])).tolist()
        [[1.0, 1.0, 1.0]]
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals: Array = np.cross(b - a, c - a)
    return normals
