"""Spruces: slender trunks with whorls of drooping, toothed branches. They close the wood behind the clearing."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest.bulk import scattered
from fovden.tracer.procedural.forest.ground import Terrain
from fovden.tracer.procedural.forest.trees import trunk
from fovden.tracer.procedural.patch import Array, Patch, join

__all__ = ["bough", "spruces"]

AROUND = 8
"""Branches in a whorl."""


def bough(teeth: int) -> Patch:
    """Returns a spruce branch of length 1 along +z, drooping: a ridge with a row of teeth on either side.

    Texture coordinates run along each tooth, so that the needles' comb points outward.

    Args:
        teeth: Number on each side.

    Returns:
        The flat-shaded patch of 2 * teeth triangles.

    Example:
        >>> bough(4).triangle_count
        8
    """
    t = np.linspace(0, 1, teeth + 1)
    ridge = np.stack([np.zeros_like(t), 0.10 * t - 0.30 * t**2, t], axis=1)
    middle = (t[:-1] + t[1:]) / 2
    wide = 0.36 * (1 - middle) ** 0.8 + 0.05
    corners = []
    for side in (-1.0, 1.0):
        ahead = middle + 0.16 * (1 - 0.4 * middle) + 0.3 / (2 * teeth + 4)
        tip = np.stack([side * wide, 0.10 * middle - 0.30 * middle**2 - 0.22 * wide - 0.03, ahead], axis=1)
        pair = (ridge[:-1], ridge[1:]) if side < 0 else (ridge[1:], ridge[:-1])
        corners.append(np.stack([*pair, tip], axis=1)[:, ::-1])
    vertices = np.concatenate(corners).reshape(-1, 3)
    uv = np.stack([0.9 * vertices[:, 2], 0.9 * np.abs(vertices[:, 0])], axis=1)
    return Patch(vertices, np.arange(len(vertices)).reshape(-1, 3), uv, np.zeros_like(vertices))


def spruces(
    rng: np.random.Generator, ground: Terrain, feet: Array, heights: Array, detail: Detail
) -> tuple[Patch, Patch]:
    """Returns spruces: their trunks, and their boughs.

    Args:
        rng: Source of their irregularity.
        ground: What their trunks' lowest rings follow.
        feet: Where their axes begin, metres, shape (k, 3).
        heights: Metres, shape (k).
        detail: Fineness.

    Returns:
        Bark and needles.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> ground = terrain(0, Detail(0.2))
        >>> bark, green = spruces(np.random.default_rng(0), ground, np.full((1, 3), 9.0), np.array([9.0]), Detail())
        >>> green.triangle_count
        960
    """
    whorls, rows, columns = detail.segments(10, least=2), detail.segments(4, least=1), detail.segments(7, least=3)
    template = bough(detail.segments(6))
    stems, roots, turns, tilts, scales = [], [], [], [], []
    share = (np.arange(whorls) + 0.5) / whorls
    for foot, height in zip(feet, heights, strict=True):
        bark, axis = trunk(rng, ground, foot, float(height), 0.017 * float(height), rows, columns)
        stems.append(bark)
        at = 0.13 + 0.85 * share
        level = np.repeat(at, AROUND) + rng.normal(0, 0.2 / whorls, whorls * AROUND) * 0.85
        level = np.clip(level, 0.1, 0.985)
        way = axis.paths[0, :, 1] - axis.paths[0, 0, 1]
        root = np.stack([np.interp(level * height, way, axis.paths[0, :, i]) for i in range(3)], axis=1)
        turn = np.tile(np.arange(AROUND) * 2 * np.pi / AROUND, whorls) + np.repeat(rng.uniform(0, 6.3, whorls), AROUND)
        length = height * (0.06 + 0.235 * (1 - level) ** 0.85) * rng.uniform(0.8, 1.15, len(level))
        roots.append(root)
        turns.append(turn + rng.normal(0, 0.1, len(level)))
        tilts.append(0.35 * level - 0.12 + rng.normal(0, 0.08, len(level)))
        scales.append(length)
    root, turn, tilt, scale = (np.concatenate(values) for values in (roots, turns, tilts, scales))
    green = scattered(template, root, turn, tilt, scales=scale)
    return join(stems), green
