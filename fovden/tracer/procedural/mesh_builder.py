"""Meshes made in code: a few vectorised primitives, and a builder that gathers them into a scene.

A :class:`Patch` is a piece of surface in float64 with texture coordinates in metres. Primitives make patches in a local
frame (y up, the front towards +z), :meth:`Patch.placed` copies them into the world, and :class:`MeshBuilder` collects
them by material. Triangles run counter-clockwise seen from the visible side. A zero normal stands for the triangle's
own one, so flat parts carry zeros and curved parts carry smooth normals; creases are edges between patches.

Nothing is made that nobody can see: primitives leave out triangles without area, boxes name the sides they have, and
straight directions are never subdivided.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from fovden.camera import StereoCamera
from fovden.checks import require
from fovden.tracer.lights import Light
from fovden.tracer.materials import Material, Materials
from fovden.tracer.scene import Scene

__all__ = [
    "Array",
    "Indices",
    "MeshBuilder",
    "Patch",
    "Surface",
    "arc_lengths",
    "box",
    "bridge",
    "grid",
    "join",
    "lathe",
    "mitred",
    "quad",
    "ring_corners",
    "smoothed",
    "tube",
]

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
        return float(np.linalg.norm(_face_normals(self.vertices, self.faces), axis=1).sum() / 2)

    def placed(self, offsets: ArrayLike = (0.0, 0.0, 0.0), turns: ArrayLike = 0.0, scales: ArrayLike = 1.0) -> Patch:
        """Returns one copy for each offset, scaled, turned about the y axis and then shifted.

        Args:
            offsets: Where the local origin goes, shape (k, 3) or (3).
            turns: Angles in radians, shape (k) or one number: the front (+z) turns towards +x.
            scales: Sizes, shape (k) or one number.

        Returns:
            The k copies as one patch.

        Example:
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
            >>> quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)).transformed(np.diag([-1, 1, 1])).vertices[1].tolist()
            [-1.0, 0.0, 0.0]
        """
        matrix = np.asarray(matrix, dtype=float)
        faces = self.faces if np.linalg.det(matrix) > 0 else self.faces[:, ::-1]
        return replace(self, vertices=self.vertices @ matrix.T, normals=self.normals @ matrix.T, faces=faces)

    def standing(self) -> Patch:
        """Returns the patch with its up direction turned to the front: what lay on the floor hangs on a wall.

        Example:
            >>> quad((0, 0, 0), (1, 0, 0), (1, 0, -1), (0, 0, -1)).standing().vertices[2].tolist()
            [1.0, 1.0, 0.0]
        """
        return self.transformed([[1, 0, 0], [0, 0, -1], [0, 1, 0]])

    def reversed(self) -> Patch:
        """Returns the patch seen from its other side.

        Example:
            >>> quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)).reversed().faces[0].tolist()
            [2, 1, 0]
        """
        return replace(self, faces=self.faces[:, ::-1], normals=-self.normals)


@dataclass(frozen=True)
class Surface:
    """A material and the size of its image in the world.

    Attributes:
        material: The material.
        tile: Metres that one repetition of the material's texture spans in each direction.

    Example:
        >>> Surface(Material("plaster", (0.7, 0.7, 0.6)), 2.0).tile
        2.0
    """

    material: Material
    tile: float = 1.0


class MeshBuilder:
    """Collects patches and turns them into a scene.

    Attributes:
        surfaces: The surfaces by the names that :meth:`add` takes.

    Example:
        >>> builder = MeshBuilder({"wall": Surface(Material("plaster", (0.7, 0.7, 0.6)))})
        >>> builder.add("wall", quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)))
        >>> builder.triangle_count
        2
    """

    def __init__(self, surfaces: Mapping[str, Surface]) -> None:
        self.surfaces = dict(surfaces)
        self._patches: list[Patch] = []
        self._material_ids: list[int] = []

    @property
    def triangle_count(self) -> int:
        """Number of triangles so far."""
        return sum(patch.triangle_count for patch in self._patches)

    def add(self, surface: str, *patches: Patch) -> None:
        """Adds patches made of one of the surfaces.

        Raises:
            ValueError: If the builder has no surface of that name.

        Example:
            >>> builder = MeshBuilder({"wall": Surface(Material("plaster", (0.7, 0.7, 0.6)))})
            >>> builder.add("roof", quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)))
            Traceback (most recent call last):
            ...
            ValueError: surface: expected one of wall, got roof
        """
        require(surface in self.surfaces, "surface", surface, f"one of {', '.join(self.surfaces)}")
        tile = self.surfaces[surface].tile
        number = list(self.surfaces).index(surface)
        for patch in patches:
            self._patches.append(replace(patch, uv=patch.uv / tile))
            self._material_ids.append(number)

    def scene(self, *, name: str, camera: StereoCamera, lights: Sequence[Light] = ()) -> Scene:
        """Returns the scene of everything added, in the order in which it was added.

        Example:
            >>> builder = MeshBuilder({"wall": Surface(Material("plaster", (0.7, 0.7, 0.6)))})
            >>> builder.add("wall", quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)))
            >>> camera = StereoCamera.look_at((0, 0, 3), (0, 0, 0), fov_y_deg=45)
            >>> builder.scene(name="a wall", camera=camera).triangle_count
            2
        """
        mesh = join(self._patches)
        material_ids = np.repeat(self._material_ids, [patch.triangle_count for patch in self._patches])
        return Scene(
            vertices=torch.from_numpy(mesh.vertices.astype(np.float32)),
            faces=torch.from_numpy(mesh.faces.astype(np.int32)),
            material_ids=torch.from_numpy(material_ids.astype(np.int32)),
            materials=Materials.of([surface.material for surface in self.surfaces.values()]),
            normals=torch.from_numpy(mesh.normals.astype(np.float32)),
            uv=torch.from_numpy(mesh.uv.astype(np.float32)),
            lights=tuple(lights),
            camera=camera,
            name=name,
        )


def join(patches: Sequence[Patch]) -> Patch:
    """Returns all patches as one, their order and their vertices kept.

    Example:
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
    """Returns the patch with smooth normals: area-weighted means over the triangles that meet in a point.

    Vertices in the same place count as one, so closed seams and poles shade without a line.

    Example:
        >>> roof = grid(np.array([[[0, 0, 1], [1, 0, 1]], [[0, 1, 0], [1, 1, 0]], [[0, 0, -1], [1, 0, -1.0]]]))
        >>> smoothed(roof).normals[2].tolist()
        [0.0, 1.0, 0.0]
    """
    keys = np.round(patch.vertices / WELD).astype(np.int64) + 0
    _, point = np.unique(keys, axis=0, return_inverse=True)
    point = point.reshape(-1)
    weighted = np.repeat(_face_normals(patch.vertices, patch.faces), 3, axis=0)
    corner = point[patch.faces].reshape(-1)
    total = np.stack([np.bincount(corner, weighted[:, axis], point.max() + 1) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return replace(patch, normals=unit[point])


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


def _face_normals(vertices: Array, faces: Indices) -> Array:
    """Normals of the triangles, twice their area long."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals: Array = np.cross(b - a, c - a)
    return normals


def _flat(vertices: Array, faces: Indices) -> Patch:
    """A planar patch with texture coordinates in its plane: v upward on walls, -z on floors and ceilings."""
    normal = _face_normals(vertices, faces).sum(axis=0)
    normal /= np.linalg.norm(normal)
    up = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < 0.7 else np.array([0.0, 0.0, -1.0])
    right = np.cross(up, normal)
    right /= np.linalg.norm(right)
    uv = np.stack([vertices @ right, vertices @ np.cross(normal, right)], axis=1)
    return Patch(vertices, faces, uv, np.zeros_like(vertices))
