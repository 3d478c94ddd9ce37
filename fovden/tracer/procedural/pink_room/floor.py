"""The floor: herringbone parquet with bevelled joints in a border of long boards, and skirting around it."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.pink_room.forms import kept
from fovden.tracer.procedural.pink_room.plan import HALF_X, HALF_Z, RUG, RUG_HALF
from fovden.tracer.procedural.primitives import quad

__all__ = ["parquet"]

WIDTH, RATIO = 0.085, 6
"""Width of a block of parquet in metres, and its length in widths."""

BORDER = 0.17
"""Width of the border of long boards, metres."""

JOINT, DEPTH = 0.0022, 0.002
"""Width and depth of the bevel along a block's edges, metres."""

SMALLEST = 6e-4
"""Offcuts of a smaller area are not laid, square metres."""


def parquet(rng: np.random.Generator, detail: Detail) -> tuple[Patch, Patch]:
    """Returns the parquet, its top at y = 0, and the ground that shows in its joints.

    The blocks at (i + n j, i - n j) and, turned by a quarter, at (i + n j + n, i - n j + 1 - n), n times as long as
    they are wide, fill the plane: each cell (x, y) belongs to the block of x - y modulo 2 n. The pattern is turned by
    45 degrees and cut by the border. Blocks and bevels that lie under the rug entirely are left out.

    Args:
        rng: Where each block is cut from the wood.
        detail: Below a third of the fineness the floor is a single board with the grain of wood.

    Returns:
        Blocks and ground.

    Example:
        >>> blocks, ground = parquet(np.random.default_rng(0), Detail())
        >>> 6000 < blocks.triangle_count < 12000, ground.triangle_count
        (True, 2)
    """
    x, z = HALF_X, HALF_Z
    if not detail.shows(0.33):
        return quad((-x, 0, z), (x, 0, z), (x, 0, -z), (-x, 0, -z)), _flat_ground(-0.02)
    pieces = [_block(rng, outline, along) for outline, along in (*_herringbone(), *_border())]
    blocks = join(pieces)
    under = np.abs(blocks.vertices[:, [0, 2]] - np.array(RUG)[[0, 2]]) < np.asarray(RUG_HALF) - 0.004
    return kept(blocks, ~under.all(axis=1)[blocks.faces].all(axis=1)), _flat_ground(-0.006)


def _flat_ground(y: float) -> Patch:
    x, z = HALF_X, HALF_Z
    return quad((-x, y, z), (x, y, z), (x, y, -z), (-x, y, -z))


def _herringbone() -> list[tuple[Array, Array]]:
    """Outlines (x, z) of the blocks within the border, and the directions of their grain."""
    n, reach = RATIO, int(2 * HALF_X / WIDTH)
    turn = np.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])
    inner = np.array([HALF_X - BORDER, HALF_Z - BORDER])
    covered = np.asarray(RUG_HALF) - 0.03
    blocks = []
    for j in range(-reach // n, reach // n + 1):
        for i in range(-reach, reach + 1):
            for lying in (True, False):
                start = (i + n * j, i - n * j) if lying else (i + n * j + n, i - n * j + 1 - n)
                size = (n, 1) if lying else (1, n)
                corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * size + start
                outline = WIDTH * corners @ turn.T
                if (outline.min(axis=0) > inner).any() or (outline.max(axis=0) < -inner).any():
                    continue
                if (np.abs(outline - np.array(RUG)[[0, 2]]) < covered).all():
                    continue
                outline = _clipped(outline, inner)
                if len(outline) >= 3 and _area(outline) > SMALLEST:
                    blocks.append((outline, turn @ np.array([1.0, 0.0] if lying else [0.0, 1.0])))
    return blocks


def _border() -> list[tuple[Array, Array]]:
    """Outlines of two rings of long boards with mitred corners, and the directions of their grain."""
    boards = []
    for k in (0, 1):
        outer, inner = (np.array([HALF_X, HALF_Z]) - BORDER * (k + end) / 2 for end in (0, 1))
        signs = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
        for side in range(4):
            one, other = signs[side], signs[(side + 1) % 4]
            outline = np.array([one * outer, other * outer, other * inner, one * inner])
            boards.append((outline[:, [0, 1]] * [1, -1], (other - one) / 2 * np.array([1, -1])))
    return [(outline[::-1] if _signed(outline) < 0 else outline, along) for outline, along in boards]


def _clipped(outline: Array, half: Array) -> Array:
    """The part of a convex polygon within a rectangle, by Sutherland and Hodgman's cuts."""
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            inside = half[axis] - sign * outline[:, axis]
            points = []
            for i in range(len(outline)):
                a, b, after = outline[i], outline[(i + 1) % len(outline)], inside[(i + 1) % len(outline)]
                if inside[i] >= 0:
                    points.append(a)
                if (inside[i] > 0) != (after > 0) and inside[i] * after < 0:
                    points.append(a + inside[i] / (inside[i] - after) * (b - a))
            if len(points) < 3:
                return np.empty((0, 2))
            outline = np.array(points)
    return outline


def _signed(outline: Array) -> float:
    x, z = outline.T
    return float(x @ np.roll(z, -1) - z @ np.roll(x, -1)) / 2


def _area(outline: Array) -> float:
    return abs(_signed(outline))


def _block(rng: np.random.Generator, outline: Array, along: Array) -> Patch:
    """One block: a top and a bevel along each edge; its texture is cut from anywhere in the wood."""
    if _signed(outline) > 0:
        outline = outline[::-1]  # seen from above, where z runs down
    edge = np.roll(outline, -1, axis=0) - outline
    length = np.linalg.norm(edge, axis=1, keepdims=True)
    inward = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length
    before = np.roll(inward, 1, axis=0)
    top = outline + JOINT * (inward + before) / (1 + (inward * before).sum(axis=1, keepdims=True))
    n = len(outline)
    vertices = np.zeros((2 * n, 3))
    vertices[:n, [0, 2]], vertices[n:, [0, 2]] = outline, top
    vertices[:n, 1] = -DEPTH
    i = np.arange(n)
    j = (i + 1) % n
    bevel = np.stack([np.stack([i, j, n + j], axis=1), np.stack([i, n + j, n + i], axis=1)], axis=1).reshape(-1, 3)
    fan = n + np.stack([np.zeros(n - 2, dtype=int), i[1:-1], i[2:]], axis=1)
    across = np.array([-along[1], along[0]])
    plan = vertices[:, [0, 2]]
    uv = np.stack([plan @ across, plan @ along], axis=1) + rng.uniform(0, 2, 2)
    # Bevels and top are flat parts of their own: no vertex is shared between them.
    faces = np.concatenate([bevel, fan])
    return Patch(vertices, faces, uv, np.zeros_like(vertices))
