"""The ground: an undulating terrain, the flat stones of the trail, and boulders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest.bulk import lattices
from fovden.tracer.procedural.forest.plan import (
    APPROACH,
    PLINTH,
    RIM,
    Mask,
    distance_to_trail,
    generator,
    smoothstep,
    trail_points,
)
from fovden.tracer.procedural.patch import Array, Patch
from fovden.tracer.procedural.primitives import grid

__all__ = ["Discs", "Terrain", "domes", "terrain", "trail_stones"]

WAVES = ((6.1, 0.10), (3.7, 0.06), (2.1, 0.035), (1.15, 0.018), (0.62, 0.007))
"""Lengths and heights, in metres, of the waves that the ground is made of; three directions each."""


@dataclass(frozen=True)
class Discs:
    """Circles on the ground that something stands on.

    Attributes:
        centres: Points (x, z), shape (n, 2).
        radii: Metres, shape (n).

    Example:
        >>> discs = Discs(np.array([[0.0, 0.0]]), np.array([2.0]))
        >>> discs.contain(np.array([[1.0, 1.0], [3.0, 0.0]])).tolist()
        [True, False]
    """

    centres: Array
    radii: Array

    def contain(self, places: Array, margin: float = 0.0) -> Mask:
        """Returns which places (x, z), shape (k, 2), lie within ``margin`` metres of any circle's inside.

        Example:
            >>> Discs(np.zeros((1, 2)), np.ones(1)).contain(np.array([[1.5, 0.0]]), margin=1.0).tolist()
            [True]
        """
        inside = np.zeros(len(places), dtype=bool)
        for centre, radius in zip(self.centres, self.radii, strict=True):
            inside |= ((places - centre) ** 2).sum(axis=1) < max(radius + margin, 0.0) ** 2
        return inside


@dataclass(frozen=True)
class Terrain:
    """The ground as a grid of heights, finer towards the middle.

    Attributes:
        knots: The grid's coordinates, the same for x and -z, shape (n), rising.
        heights: Heights at z = -knots (rows) and x = knots (columns), metres, shape (n, n).

    Example:
        >>> ground = Terrain(np.array([-1.0, 1.0]), np.array([[0.0, 0.0], [0.0, 2.0]]))
        >>> ground.height(np.array([[1.0, -1.0], [0.0, 0.0]])).tolist()
        [2.0, 1.0]
    """

    knots: Array
    heights: Array

    def height(self, places: Array) -> Array:
        """Returns the height of the triangles above places.

        Args:
            places: Points (x, z), shape (..., 2).

        Returns:
            Metres, shape (...).

        Example:
            >>> terrain(0, Detail(0.2)).height(np.zeros((3, 4, 2))).shape
            (3, 4)
        """
        last = len(self.knots) - 2
        column = np.clip(np.searchsorted(self.knots, places[..., 0], side="right") - 1, 0, last)
        row = np.clip(np.searchsorted(self.knots, -places[..., 1], side="right") - 1, 0, last)
        step = np.diff(self.knots)
        u = (places[..., 0] - self.knots[column]) / step[column]
        v = (-places[..., 1] - self.knots[row]) / step[row]
        a, b = self.heights[row, column], self.heights[row, column + 1]
        c, d = self.heights[row + 1, column + 1], self.heights[row + 1, column]
        height: Array = np.where(v <= u, a + u * (b - a) + v * (c - b), a + v * (d - a) + u * (c - d))
        return height

    def on(self, places: Array, above: float = 0.0) -> Array:
        """Returns places (x, z) as points on the ground, or ``above`` it, shape (..., 3).

        Example:
            >>> terrain(0, Detail(0.2)).on(np.zeros((4, 2)), above=1.0).shape
            (4, 3)
        """
        return np.stack([places[..., 0], self.height(places) + above, places[..., 1]], axis=-1)

    def patch(self, covered: Discs) -> Patch:
        """Returns the surface, without the triangles that lie wholly under something.

        Example:
            >>> ground = terrain(0, Detail(0.2))
            >>> whole = ground.patch(Discs(np.zeros((0, 2)), np.zeros(0)))
            >>> whole.triangle_count > ground.patch(Discs(np.zeros((1, 2)), np.full(1, 5.0))).triangle_count
            True
        """
        x, z = np.meshgrid(self.knots, -self.knots)
        places = np.stack([x, z], axis=-1)
        whole = grid(self.on(places), smooth=True, uv=places * [1.0, -1.0])
        hidden = np.zeros(len(whole.faces), dtype=bool)
        for i in range(len(covered.radii)):
            one = Discs(covered.centres[i : i + 1], covered.radii[i : i + 1])
            hidden |= one.contain(whole.vertices[:, [0, 2]])[whole.faces].all(axis=1)
        faces = whole.faces[~hidden]
        used, numbers = np.unique(faces, return_inverse=True)
        return Patch(whole.vertices[used], numbers.reshape(-1, 3), whole.uv[used], whole.normals[used])


def terrain(seed: int, detail: Detail) -> Terrain:
    """Returns the ground: waves of several lengths, a hollow along the trail, and a rise towards the wood.

    The grid's steps grow from the middle outwards, x = R (0.36 u + 0.64 u^3), by a factor of six.

    Example:
        >>> ground = terrain(0, Detail())
        >>> bool(ground.height(np.array([[0.0, 20.0]]))[0] > ground.height(np.array([[0.0, 5.0]]))[0] + 2)
        True
    """
    u = np.linspace(-1, 1, detail.segments(92, least=6) + 1)
    knots = RIM * (0.36 * u + 0.64 * u**3)
    x, z = np.meshgrid(knots, -knots)
    places = np.stack([x, z], axis=-1)
    radius = np.hypot(x, z)
    trodden = np.exp(-((distance_to_trail(places) / 0.55) ** 2))
    rng = generator(seed, "terrain")
    height = np.zeros_like(x)
    for length, amplitude in WAVES:
        for _ in range(3):
            heading, phase = rng.uniform(0, 2 * np.pi, 2)
            wave = (x * np.cos(heading) + z * np.sin(heading)) * 2 * np.pi / (length * rng.uniform(0.8, 1.25))
            height += amplitude / np.sqrt(1.5) * np.sin(wave + phase)
    level = 0.12 + 0.88 * smoothstep(radius, PLINTH - 0.3, PLINTH + 2.0)
    rise = 3.4 * smoothstep(radius, 6.0, RIM) + 5.0 * smoothstep(radius, 12.5, 24.0)
    return Terrain(knots, height * level * (1 - 0.5 * trodden) - 0.05 * trodden + rise)


def domes(
    rng: np.random.Generator,
    ground: Terrain,
    places: Array,
    radii: Array,
    heights: Array,
    size: tuple[int, int],
    block: float = 0.6,
    rough: float = 0.07,
) -> Patch:
    """Returns stones that rest on the ground: domes with an irregular outline and bumps, open below.

    A stone's profile is the superellipse r = cos^b t, y = sin^b t. Its lowest ring follows the ground, 2 cm below it.

    Args:
        rng: Source of the outlines and the bumps.
        ground: What they rest on.
        places: Points (x, z), shape (k, 2).
        radii: Mean radii in metres, shape (k).
        heights: Metres, shape (k).
        size: Segments up and around.
        block: The exponent b: 1 is a ball, smaller is blockier.
        rough: Height of the bumps as a share of the radius.

    Returns:
        The stones, smooth.

    Example:
        >>> ground = terrain(0, Detail(0.2))
        >>> one = np.ones(2)
        >>> domes(np.random.default_rng(0), ground, np.array([[3.0, 3.0], [6.0, 0.0]]), one, one, (4, 8)).triangle_count
        112
    """
    count, (rows, columns) = len(places), size
    t = np.linspace(0, np.pi / 2, rows + 1)
    out, up = np.cos(t) ** block, np.sin(t) ** block
    out[-1] = 0.0
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    angle[-1] = 0.0
    phase = rng.uniform(0, 2 * np.pi, (count, 3, 1))
    outline = np.ones((count, columns + 1))
    for i, (lobes, depth) in enumerate(((2, 0.17), (3, 0.09), (5, 0.05))):
        outline += depth * np.sin(lobes * angle + phase[:, i])
    ball = np.stack(
        np.broadcast_arrays(out[:, None] * np.sin(angle), up[:, None], out[:, None] * np.cos(angle)), axis=-1
    )
    wave, shift = 2.6 * rng.standard_normal((count, 6, 3)), rng.uniform(0, 2 * np.pi, (count, 6))
    bumps = np.sin(np.einsum("rcj,kwj->krcw", ball, wave) + shift[:, None, None]).sum(axis=-1)
    grown = 1 + rough / 1.7 * bumps
    x = places[:, 0, None, None] + radii[:, None, None] * outline[:, None] * ball[..., 0] * grown
    z = places[:, 1, None, None] + radii[:, None, None] * outline[:, None] * ball[..., 2] * grown
    lift = heights[:, None, None] * up[:, None] * grown
    points = ground.on(np.stack([x, z], axis=-1), above=-0.02) + np.stack([0 * lift, lift, 0 * lift], axis=-1)
    around = np.maximum(np.round(2 * np.pi * radii), 1.0)[:, None, None] * np.linspace(0, 1, columns + 1)
    along = (radii + heights)[:, None, None] * np.linspace(0, 1, rows + 1)[:, None]
    uv = np.stack(np.broadcast_arrays(around, along), axis=-1) + rng.random((count, 1, 1, 2))
    return lattices(points, uv, pinched=True)


def trail_stones(seed: int, ground: Terrain, detail: Detail) -> tuple[Patch, Discs]:
    """Returns the trail's flat stones, and the circles that they cover.

    Example:
        >>> stones, covered = trail_stones(0, terrain(0, Detail()), Detail())
        >>> bool(distance_to_trail(covered.centres)[:-5].max() < 0.3)
        True
    """
    rng = generator(seed, "trail stones")
    middle = trail_points(0.62)
    heading = np.gradient(middle, axis=0)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    aside = np.stack([-heading[:, 1], heading[:, 0]], axis=1) * rng.uniform(-0.16, 0.16, (len(middle), 1))
    radii = rng.uniform(0.20, 0.29, len(middle))
    shown = slice(0, len(middle), max(1, round(0.35 / detail.fineness)))
    places = np.concatenate([(middle + aside)[shown], APPROACH])
    radii = np.concatenate([radii[shown], np.linspace(0.24, 0.28, len(APPROACH))])
    size = (detail.segments(4), detail.segments(13, least=4))
    heights = rng.uniform(0.05, 0.08, len(places))
    return domes(rng, ground, places, radii, heights, size, block=0.35, rough=0.03), Discs(places, 0.75 * radii)
