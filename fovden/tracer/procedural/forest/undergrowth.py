"""What grows on the forest's floor: ferns, grass and mushrooms."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest.bulk import scattered
from fovden.tracer.procedural.forest.ground import Terrain
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import grid, lathe

__all__ = ["BLADE_TRIANGLES", "blades", "fern", "mushroom"]

BLADE_TRIANGLES = 3
"""Triangles of a blade of grass: its lower half and its tip."""


def fern(rng: np.random.Generator, detail: Detail) -> Patch:
    """Returns a fern about 0.7 m tall and 1.3 m across, its foot at the origin.

    Fronds arch outward from the middle. A frond is a narrow strip, the rachis, with pairs of leaflets that grow
    shorter towards the tip; each leaflet is folded along its midrib.

    Example:
        >>> fern(np.random.default_rng(0), Detail()).triangle_count
        352
    """
    fronds, pairs = detail.at_most(1.5).segments(8, least=4), detail.segments(9, least=3)
    pieces = []
    for i in range(fronds):
        length, lift = rng.uniform(0.62, 0.95), rng.uniform(0.75, 1.15)
        turn = 2 * np.pi * (i + rng.uniform(-0.25, 0.25)) / fronds
        pieces.append(_frond(pairs, length, lift).placed(turns=turn))
    return join(pieces)


def _frond(pairs: int, length: float, lift: float) -> Patch:
    """A frond in the plane of y and +z."""
    t = np.linspace(0, 1, pairs // 2 + 1)

    def spine(s: Array) -> Array:
        reach, rise = length * (0.92 * s + 0.05 * s**2), length * lift * (s - 0.78 * s**2 - 0.14 * s**3)
        return np.stack([np.zeros_like(s), rise, reach + 0.03], axis=-1)

    width = 0.007 * (1 - 0.75 * t)
    line = spine(t)
    edge = np.stack([width, np.zeros_like(t), np.zeros_like(t)], axis=1)
    rachis = grid(np.stack([line - edge, line + edge], axis=1), smooth=True, uv=np.full((len(t), 2, 2), 0.5))
    at = 0.16 + 0.82 * (np.arange(pairs) + 0.5) / pairs
    root, ahead = spine(at), spine(at + 0.01) - spine(at - 0.01)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    long = 0.34 * length * np.sin(np.pi * (0.08 + 0.86 * at**0.9)) ** 0.85 + 0.012
    wide = np.minimum(0.42 * length / pairs, 0.4 * long)
    up = np.cross(ahead, [1.0, 0.0, 0.0])
    pieces = [rachis]
    for side in (-1.0, 1.0):
        out = side * np.array([1.0, 0.0, 0.0]) + 0.35 * ahead - 0.12 * up
        tip = root + long[:, None] * out
        middle = root + 0.42 * long[:, None] * out + 0.03 * long[:, None] * up
        fore, rear = middle + wide[:, None] * ahead, middle - wide[:, None] * ahead
        outline = np.stack([root, rear - 0.2 * wide[:, None] * up, tip, fore - 0.2 * wide[:, None] * up], axis=1)
        vertices = outline.reshape(-1, 3)
        first = np.array([[0, 1, 2], [0, 2, 3]])
        faces = (first if side > 0 else first[:, ::-1]) + 4 * np.arange(pairs)[:, None, None]
        uv = np.tile([(0.5, 0.0), (0.1, 0.4), (0.5, 1.0), (0.9, 0.4)], (pairs, 1))
        pieces.append(Patch(vertices, faces.reshape(-1, 3), uv, np.zeros_like(vertices)))
    return join(pieces)


def blades(rng: np.random.Generator, ground: Terrain, places: Array, height: float, *, single: bool = False) -> Patch:
    """Returns blades of grass that lean and bend over, three triangles each, or young ones of a single triangle.

    Args:
        rng: Source of their sizes and bends.
        ground: What they grow on.
        places: Feet (x, z), shape (k, 2).
        height: Mean height, metres.
        single: Whether a blade is one triangle.

    Returns:
        The k blades.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> blades(np.random.default_rng(0), terrain(0, Detail(0.2)), np.ones((4, 2)), 0.2).triangle_count
        12
    """
    if single:
        vertices = np.array([(-0.03, 0.0, 0.0), (0.03, 0.0, 0.0), (0.0, 1.0, 0.25)])
        blade = Patch(vertices, np.array([[0, 1, 2]]), np.array([(0.3, 0), (0.7, 0), (0.5, 1)]), np.zeros((3, 3)))
    else:
        vertices = np.array(
            [(-0.028, 0.0, 0.0), (0.028, 0.0, 0.0), (-0.024, 0.58, 0.09), (0.024, 0.58, 0.09), (0.0, 0.95, 0.36)]
        )
        faces = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 4]])
        uv = np.array([(0.3, 0.0), (0.7, 0.0), (0.3, 0.6), (0.7, 0.6), (0.5, 1.0)])
        blade = Patch(vertices, faces, uv, np.zeros((5, 3)))
    count = len(places)
    return scattered(
        blade,
        ground.on(places) - [0.0, 0.006, 0.0],
        turns=rng.uniform(0, 2 * np.pi, count),
        tilts=rng.normal(-0.1, 0.22, count),
        scales=height * rng.uniform(0.55, 1.4, count),
    )


def mushroom(detail: Detail, cap: float = 0.5) -> tuple[Patch, Patch]:
    """Returns a mushroom of height 1, its foot at the origin: the cap's skin, and the stem with the gills.

    Args:
        detail: Fineness.
        cap: Radius of the cap.

    Returns:
        Cap and stem.

    Example:
        >>> skin, stem = mushroom(Detail())
        >>> float(skin.vertices[:, 1].max())
        1.0
    """
    around, rows = detail.segments(9, least=4), detail.segments(4, least=2)
    t = np.linspace(0.0, np.pi / 2, rows + 1)
    dome = np.stack([cap * np.cos(t) ** 0.8, 0.62 + 0.38 * np.sin(t) ** 1.2], axis=1)
    dome[-1] = (0.0, 1.0)
    skin = lathe(dome, around)
    skin = Patch(skin.vertices, skin.faces, 0.5 + 0.45 / cap * skin.vertices[:, [0, 2]], skin.normals)
    gills = lathe([(0.13, 0.66), (cap, 0.62)], around)
    height = np.linspace(0, 1, detail.segments(3) + 1)
    stalk = lathe(
        np.stack([0.13 + 0.07 * (1 - height) ** 2, -0.03 + 0.69 * height], axis=1), detail.segments(7, least=3)
    )
    return skin, join([stalk, gills])
