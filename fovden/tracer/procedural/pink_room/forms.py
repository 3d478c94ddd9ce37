"""Soft and bent forms: many small sheets at once, cushions, pipings, cloth along a path.

Each function returns patches in a local frame: y up, the front towards +z.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, face_normals, join
from fovden.tracer.procedural.pink_room.turning import bent
from fovden.tracer.procedural.primitives import arc_lengths, grid, tube

__all__ = [
    "cushion",
    "draped",
    "kept",
    "pillow",
    "pillow_edge",
    "rounded_rectangle",
    "sheets",
    "strands",
    "stretched",
    "without_slivers",
]


def sheets(points: Array, uv: Array) -> Patch:
    """Returns many smooth sheets of the same number of points at once, two triangles for each cell.

    Normals come from central differences along rows and columns, so no cell may vanish; a sheet whose first and last
    column are the same is shaded without a seam.

    Args:
        points: Positions in metres, shape (sheets, rows, columns, 3).
        uv: Texture coordinates in metres, broadcast to shape (sheets, rows, columns, 2).

    Returns:
        The patch; with columns to the right and rows upward the visible side faces the viewer.

    Example:
        >>> x, y = np.meshgrid(np.arange(4.0), np.arange(3.0))
        >>> flat = np.stack([x, y, 0 * x], axis=-1)
        >>> patch = sheets(np.stack([flat, flat + 5]), flat[..., :2])
        >>> patch.triangle_count, patch.normals[0].tolist()
        (24, [0.0, 0.0, 1.0])
    """
    count, rows, columns = points.shape[:3]
    right, up = np.gradient(points, axis=2), np.gradient(points, axis=1)
    if columns > 2:
        closed = np.abs(points[:, :, 0] - points[:, :, -1]).max(axis=(1, 2)) < 1e-9
        seam = (points[:, :, 1] - points[:, :, -2]) / 2
        for end in (0, -1):
            right[:, :, end] = np.where(closed[:, None, None], seam, right[:, :, end])
    normals = np.cross(right, up)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2).reshape(-1, 3)
    faces = faces + (rows * columns * np.arange(count))[:, None, None]
    uv = np.broadcast_to(uv, (count, rows, columns, 2))
    return Patch(points.reshape(-1, 3), faces.reshape(-1, 3), uv.reshape(-1, 2), normals.reshape(-1, 3))


def kept(patch: Patch, faces: NDArray[np.bool_]) -> Patch:
    """Returns some of a patch's triangles, with their normals as they were: what is hidden is left out.

    Args:
        patch: The patch.
        faces: Whether to keep each triangle, shape (m).

    Returns:
        The smaller patch.

    Example:
        >>> whole = pillow((0.4, 0.4, 0.15), 8)
        >>> kept(whole, whole.vertices[whole.faces][:, :, 1].max(axis=1) > 0).triangle_count
        128
    """
    used, number = np.unique(patch.faces[faces], return_inverse=True)
    return Patch(patch.vertices[used], number.reshape(-1, 3), patch.uv[used], patch.normals[used])


def strands(lines: Array, outward: Array, radius: ArrayLike, segments: int) -> Patch:
    """Returns yarn along lines on a surface: the half of each round strand that shows.

    Args:
        lines: Middles of the strands, metres, shape (strands, points, 3).
        outward: Unit vectors away from the surface, broadcast to the shape of ``lines``.
        radius: Metres, shape (points) or one number.
        segments: Segments across.

    Returns:
        The patch, open towards the surface.

    Example:
        >>> line = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, 0.2]]])
        >>> strands(line, np.array([0.0, 1.0, 0.0]), 0.01, 4).triangle_count
        16
    """
    along = np.gradient(lines, axis=1)
    side = np.cross(along, np.broadcast_to(outward, lines.shape))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    away = np.cross(side, along)
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    angle = np.linspace(-0.4 * np.pi, 0.4 * np.pi, segments + 1)[:, None]
    width = np.broadcast_to(np.asarray(radius, dtype=float), (lines.shape[1],))[None, :, None, None]
    points = lines[:, :, None] + width * (-np.sin(angle) * side[:, :, None] + np.cos(angle) * away[:, :, None])
    uv = np.stack(np.broadcast_arrays(0.02 * angle[:, 0], 0.05 * np.arange(lines.shape[1])[:, None]), axis=-1)
    patch = sheets(points, uv)
    return patch if (face_normals(patch.vertices, patch.faces[:1]) @ away[0, 0]).item() > 0 else patch.reversed()


def without_slivers(patch: Patch) -> Patch:
    """Returns a patch without triangles that are too small or too flat to be seen.

    Example:
        >>> without_slivers(pillow((0.4, 0.4, 0.15), 8)).triangle_count
        256
    """
    doubled = np.linalg.norm(face_normals(patch.vertices, patch.faces), axis=1)
    corners = patch.vertices[patch.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return kept(patch, (doubled > 2.5e-6) & (doubled > 1.5e-4 * longest))


def stretched(patch: Patch, scales: ArrayLike) -> Patch:
    """Returns a patch stretched along the axes, its normals those of the stretched surface.

    Example:
        >>> from fovden.tracer.procedural.pink_room.turning import ball
        >>> stretched(ball(1.0, 8, 8), (1.0, 2.0, 1.0)).vertices[:, 1].max().round(3)
        np.float64(2.0)
    """
    factor = np.asarray(scales, dtype=float)
    normals = patch.normals / factor
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    return replace(patch, vertices=patch.vertices * factor, normals=normals)


def pillow(size: tuple[float, float, float], segments: int) -> Patch:
    """Returns a scatter cushion that stands upright: two bulging sides whose edges bow in between pointed corners.

    Args:
        size: Width, height and thickness in metres.
        segments: Cells in each direction.

    Returns:
        The patch about the origin, smooth, without its piping.

    Example:
        >>> pillow((0.4, 0.4, 0.15), 8).triangle_count
        256
    """
    t = np.linspace(-1, 1, segments + 1)
    t = 0.55 * t + 0.45 * np.sin(np.pi / 2 * t)
    v, u = np.meshgrid(t, t, indexing="ij")
    x = size[0] / 2 * u * (1 - 0.09 * (1 - v**2) * np.abs(u))
    y = size[1] / 2 * v * (1 - 0.09 * (1 - u**2) * np.abs(v))
    z = size[2] / 2 * (np.clip((1 - u**4) * (1 - v**4), 0, 1)) ** 0.55 * (1 - 0.12 * u**2 * v**2)
    z += 0.004 * np.sin(9 * u + 2 * v) * np.sin(7 * v) * (1 - u**2) * (1 - v**2)
    front = grid(np.stack([x, y, z], axis=-1), smooth=True, uv=np.stack([x, y], axis=-1))
    back = grid(np.stack([-x, y, -z], axis=-1), smooth=True, uv=np.stack([-x, y], axis=-1))
    return join([front, back])


def pillow_edge(size: tuple[float, float, float], segments: int) -> Array:
    """Returns the closed edge of :func:`pillow`, where its piping runs, shape (n, 3).

    Example:
        >>> pillow_edge((0.4, 0.4, 0.15), 4).shape
        (17, 3)
    """
    t = np.linspace(-1, 1, segments + 1)[:-1]
    one = np.ones_like(t)
    u, v = np.concatenate([t, one, -t, -one]), np.concatenate([-one, t, one, -t])
    x = size[0] / 2 * u * (1 - 0.09 * (1 - v**2) * np.abs(u))
    y = size[1] / 2 * v * (1 - 0.09 * (1 - u**2) * np.abs(v))
    edge = np.stack([x, y, 0 * x], axis=1)
    return np.concatenate([edge, edge[:1]])


def rounded_rectangle(width: float, depth: float, radius: float, segments: int, corner: int) -> Array:
    """Returns a closed outline (x, z), counter-clockwise seen from above, shape (n, 2).

    Args:
        width: Along x, metres.
        depth: Along z, metres.
        radius: Of the corners, metres.
        segments: Segments along each side.
        corner: Segments around each corner.

    Returns:
        The points, the first one again at the end.

    Example:
        >>> rounded_rectangle(2.0, 1.0, 0.1, 1, 2).shape
        (13, 2)
    """
    angle = np.linspace(0, np.pi / 2, corner + 1)
    points = []
    for i, (sx, sz) in enumerate(((-1, 1), (1, 1), (1, -1), (-1, -1))):
        turn = angle + np.pi * (1 + i / 2)
        centre = np.array([sx * (width / 2 - radius), sz * (depth / 2 - radius)])
        points.append(centre + radius * np.stack([np.cos(turn), -np.sin(turn)], axis=1))
    outline = []
    for i in range(4):
        share = np.linspace(0, 1, segments + 1)[1:-1, None]
        outline += [points[i], points[i][-1] + share * (points[(i + 1) % 4][0] - points[i][-1])]
    whole = np.concatenate(outline)
    return np.concatenate([whole, whole[:1]])


def cushion(width: float, depth: float, height: float, detail: Detail) -> tuple[Patch, Patch]:
    """Returns a seat cushion with bulging sides and a crowned top, and its piping; it has no bottom.

    Args:
        width: Along x, metres.
        depth: Along z, metres.
        height: Of the seam under the crown, metres.
        detail: Fineness.

    Returns:
        The cushion with its foot at y = 0, and the piping around its top.

    Example:
        >>> cloth, piping = cushion(0.6, 0.6, 0.14, Detail())
        >>> cloth.vertices[:, 1].max() > 0.14
        np.True_
    """
    detail = detail.at_most(1.5)  # towards the middle of its top, finer cells would hardly bend
    straight = detail.segments(12) if detail.shows(0.25) else 1
    outline = rounded_rectangle(width, depth, 0.05, straight, detail.segments(4))
    direction = np.gradient(outline, axis=0)
    direction[[0, -1]] = outline[1] - outline[-2]
    outward = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    share = np.linspace(0, 1, detail.segments(6) + 1)
    wrinkle = 0.003 * np.sin(np.arange(len(outline)) * 1.9)[None, :] * np.sin(np.pi * share)[:, None]
    out = 0.010 * np.sin(np.pi * share)[:, None] + wrinkle
    out[:, -1] = out[:, 0]
    plan = outline[None] + out[..., None] * outward[None]
    side = np.stack([plan[..., 0], np.broadcast_to(height * share[:, None], out.shape), plan[..., 1]], axis=-1)
    inward = 1 - np.linspace(0, 1, detail.segments(14, least=2) + 1)[:, None]
    x, z = inward * outline[:, 0], inward * outline[:, 1]
    u, w = 2 * x / width, 2 * z / depth
    rise = 0.055 * np.clip((1 - u**4) * (1 - w**4), 0, 1) ** 0.6
    rise += 0.004 * np.sin(11 * x + 3) * np.sin(9 * z + 1) * (1 - inward**2)
    rise[0] = 0.0
    top = np.stack([x, height + rise, z], axis=-1)
    seam = np.stack([outline[:, 0], np.full(len(outline), height), outline[:, 1]], axis=1)
    flat = np.stack([x, -z], axis=-1)
    cloth = join([grid(side, smooth=True), grid(top, smooth=True, uv=flat)])
    return cloth, tube(bent(seam), 0.006, detail.segments(6, least=3))


def draped(
    path: ArrayLike,
    width: float,
    rows: int,
    columns: int,
    lift: Array | None = None,
    spread: Array | None = None,
) -> Patch:
    """Returns cloth laid along a path and extended along x, lifted off the path by given amounts.

    Args:
        path: Points (z, y) in metres from the hidden end over the edge and down, shape (n, 2).
        width: Along x, metres.
        rows: Points along the path.
        columns: Points across.
        lift: Distance from the path, metres, shape (rows, columns); none by default.
        spread: Shift along x, metres, shape (rows, columns); none by default.

    Returns:
        The patch, smooth, its visible side to the right of the path: upward, then the front.

    Example:
        >>> draped([(0, 1), (0.2, 1), (0.3, 0.2)], 1.4, 5, 4).triangle_count
        24
    """
    line = np.asarray(path, dtype=float)
    length = arc_lengths(line)
    s = np.linspace(0, length[-1], rows)
    z, y = (np.interp(s, length, line[:, axis]) for axis in range(2))
    kernel = np.array([0.25, 0.5, 0.25])
    for _ in range(max(1, rows // 24)):
        z[1:-1], y[1:-1] = np.convolve(z, kernel, "valid"), np.convolve(y, kernel, "valid")
    away = np.stack([-np.gradient(y), np.gradient(z)], axis=1)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    x = np.broadcast_to(np.linspace(-width / 2, width / 2, columns), (rows, columns))
    off = np.zeros((rows, columns)) if lift is None else lift
    shift = np.zeros((rows, columns)) if spread is None else spread
    points = np.stack([x + shift, y[:, None] + away[:, 1:] * off, z[:, None] + away[:, :1] * off], axis=-1)
    uv = np.stack(np.broadcast_arrays(x, -s[:, None]), axis=-1)
    return grid(points[::-1], smooth=True, uv=uv[::-1])
