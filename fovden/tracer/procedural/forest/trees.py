"""Broad-leaved trees: trunks with roots and furrowed bark, and limbs that fork."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest.bulk import lattices, tubes
from fovden.tracer.procedural.forest.ground import Terrain
from fovden.tracer.procedural.forest.plan import CORRIDOR, HEADROOM, Mask, distance_to_trail
from fovden.tracer.procedural.patch import Array, Indices, Patch, join

__all__ = ["Kind", "Limbs", "Tree", "broadleaf", "offshoots", "shrub", "trunk"]

LEAF_REACH = 0.35
"""How far leaves may stick out from the limb that they grow on, metres."""

FINEST = (0.16, 0.3, 0.45)
"""Fineness from which branches, boughs and twigs are made."""

THINNEST = 0.003
"""Least radius of a limb at its foot, metres."""

SPRIGS = 2.0
"""Fineness from which twigs bear sprigs: as many leaves as there are then would crowd on the twigs alone."""

CURVE = 12
"""Segments by which a limb's course is known; the surface has as many as the fineness asks for."""


@dataclass(frozen=True)
class Limbs:
    """Limbs of the same order: trunks, branches or twigs.

    Attributes:
        paths: Points along each, metres, shape (k, n, 3).
        radii: Radii there, metres, shape (k, n).

    Example:
        >>> limbs = Limbs(np.array([[[0.0, 0, 0], [0, 4, 0]]]), np.array([[0.2, 0.0]]))
        >>> place, radius, _ = limbs.at(np.array([0]), np.array([0.5]))
        >>> place.tolist(), radius.tolist()
        ([[0.0, 2.0, 0.0]], [0.1])
    """

    paths: Array
    radii: Array

    def at(self, limb: Indices, share: Array) -> tuple[Array, Array, Array]:
        """Returns places (m, 3), radii (m) and unit directions (m, 3) at shares of the limbs' lengths.

        Args:
            limb: Numbers of the limbs, shape (m).
            share: Shares of their points, in [0, 1], shape (m).

        Example:
            >>> limbs = Limbs(np.array([[[0.0, 0, 0], [0, 4, 0]]]), np.array([[0.2, 0.0]]))
            >>> limbs.at(np.array([0]), np.array([0.5]))[2].tolist()
            [[0.0, 1.0, 0.0]]
        """
        last = self.paths.shape[1] - 2
        lower = np.clip((share * (last + 1)).astype(int), 0, last)
        within = share * (last + 1) - lower
        start, end = self.paths[limb, lower], self.paths[limb, lower + 1]
        place = start + within[:, None] * (end - start)
        radius = (1 - within) * self.radii[limb, lower] + within * self.radii[limb, lower + 1]
        return place, radius, (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)

    def resampled(self, steps: int) -> Limbs:
        """Returns the limbs with another number of segments; between points they follow a cubic curve.

        Example:
            >>> limbs = Limbs(np.array([[[0.0, 0, 0], [0, 1, 0], [1, 2, 0]]]), np.array([[0.2, 0.1, 0.0]]))
            >>> limbs.resampled(4).paths[0, ::2].tolist()
            [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 2.0, 0.0]]
        """
        count = self.paths.shape[1] - 1
        share = np.linspace(0, 1, steps + 1)
        lower = np.minimum((share * count).astype(int), count - 1)
        s = (share * count - lower)[:, None]
        slope = np.gradient(self.paths, axis=1)
        paths = (1 + 2 * s) * (1 - s) ** 2 * self.paths[:, lower] + s**2 * (3 - 2 * s) * self.paths[:, lower + 1]
        paths += s * (1 - s) ** 2 * slope[:, lower] - s**2 * (1 - s) * slope[:, lower + 1]
        return Limbs(paths, self.radii[:, :1] * _taper(share))

    def chosen(self, which: Mask) -> Limbs:
        """Returns some of the limbs.

        Example:
            >>> limbs = Limbs(np.zeros((3, 2, 3)), np.zeros((3, 2)))
            >>> len(limbs.chosen(np.array([True, False, True])).paths)
            2
        """
        return Limbs(self.paths[which], self.radii[which])


@dataclass(frozen=True)
class Kind:
    """How a tree grows.

    Attributes:
        columns: Segments around the trunk.
        rows: Segments along it.
        branches: Number of branches on the trunk.
        sides: Segments around branches, boughs and twigs; with 0 they are not made and only bear leaves.
        steps: Segments along them.
        forks: Number of boughs on each branch, and of twigs on each bough.
        span: Shares of the trunk's height between which branches grow.
        reach: Length of the lowest branch as a share of the height.

    Example:
        >>> Kind().branches
        8
    """

    columns: int = 24
    rows: int = 22
    branches: int = 8
    sides: tuple[int, int, int] = (6, 3, 3)
    steps: tuple[int, int, int] = (6, 3, 1)
    forks: tuple[int, int] = (4, 3)
    span: tuple[float, float] = (0.34, 0.94)
    reach: float = 0.40


@dataclass(frozen=True)
class Tree:
    """A tree: its bark, and the limbs by order, the trunk first.

    Attributes:
        bark: Trunk and limbs.
        limbs: Trunk, branches, boughs, twigs, and sprigs if there are any; all of them, also those too fine to be made.

    Example:
        >>> Tree(Patch(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 2)), np.zeros((0, 3))), ()).limbs
        ()
    """

    bark: Patch
    limbs: tuple[Limbs, ...]


def trunk(
    rng: np.random.Generator, ground: Terrain, foot: Array, height: float, radius: float, rows: int, columns: int
) -> tuple[Patch, Limbs]:
    """Returns a trunk and its axis.

    The radius falls with the height and swells towards the roots, R (1 - s)^0.8 + R e^(-y / 0.35 m) times a wave
    around, and furrows that wander up the trunk cut into it. The lowest ring follows the ground, 4 cm below it.

    Args:
        rng: Source of its irregularity.
        ground: What its lowest ring follows.
        foot: Where its axis begins, metres, shape (3).
        height: Metres.
        radius: Above the roots, metres.
        rows: Segments along.
        columns: Segments around.

    Returns:
        The bark, and the axis as one limb, which does not depend on the segments.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> ground = terrain(0, Detail(0.2))
        >>> trunk(np.random.default_rng(0), ground, np.array([8.0, 0.2, 0.0]), 9.0, 0.3, 10, 12)[0].triangle_count
        228
    """
    lean, bend = rng.normal(0, 0.035, 2), rng.normal(0, 0.12, (2, 2))
    bend_phase, phase = rng.uniform(0, 2 * np.pi, (2, 2)), rng.uniform(0, 2 * np.pi, 8)
    roots, furrows = int(rng.integers(4, 7)), int(rng.integers(7, 10))
    share = np.linspace(0, 1, rows + 1) ** 1.35
    y = share * height

    def axis_at(share: Array) -> tuple[Array, Array]:
        waves = np.sin(np.array([2.1, 4.7]) * share[:, None, None] + bend_phase) - np.sin(bend_phase)
        place = foot[[0, 2]] + height * lean * share[:, None] + (bend * waves).sum(axis=2)
        return place, radius * (0.97 * (1 - share) ** 0.8 + 0.03) * (share < 1)

    axis, thick = axis_at(share)
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    angle[-1] = 0.0
    flare = np.exp(-y / 0.35)[:, None] * (
        0.55 + 0.42 * np.sin(roots * angle + phase[0]) + 0.2 * np.sin(2 * angle + phase[1])
    )
    wander = 0.8 * np.sin(1.1 * y + phase[2]) + 0.5 * np.sin(2.9 * y + phase[3])
    ridge = np.sin(furrows * angle + 1.6 * wander[:, None]) * np.sin(3.1 * y[:, None] + 2 * angle + phase[4])
    swell = 0.05 * np.sin(2 * angle + 1.3 * y[:, None] + phase[5]) + 0.03 * np.sin(
        3 * angle - 2.2 * y[:, None] + phase[6]
    )
    r = thick[:, None] * (1 + flare + 0.055 * ridge + swell)
    x, z = axis[:, :1] + r * np.sin(angle), axis[:, 1:] + r * np.cos(angle)
    low = np.exp(-y / 0.4)[:, None]
    level = low * ground.height(np.stack([x, z], axis=-1)) + (1 - low) * foot[1] - 0.04 * low
    points = np.stack([x, level + y[:, None], z], axis=-1)
    around = max(1.0, round(2 * np.pi * radius)) * np.linspace(0, 1, columns + 1)
    uv = np.stack(np.broadcast_arrays(around, y[:, None]), axis=-1) + rng.random(2)
    share = np.linspace(0, 1, 2 * CURVE + 1)
    axis, thick = axis_at(share)
    line = np.stack([axis[:, 0], foot[1] + height * share, axis[:, 1]], axis=1)
    return lattices(points[None], uv[None], pinched=True), Limbs(line[None], thick[None])


def offshoots(
    rng: np.random.Generator,
    parents: Limbs,
    each: int,
    *,
    span: tuple[float, float],
    lengths: Array,
    pitch: float,
    rise: float,
) -> Limbs:
    """Returns limbs that grow from others, spread around them by the golden angle.

    A limb starts on its parent's bark, heads off at an angle, bends upward or droops with the square of the way, and
    wavers. Its radius at the foot is 0.62 of the parent's there, at least 3 mm and at most
    3 mm more than 0.035 of its length; it falls to a point.

    Args:
        rng: Source of the irregularity.
        parents: What they grow from, k limbs.
        each: Number on each parent.
        span: Shares of the parent's length between which they grow.
        lengths: Metres, shape (k * each), parent by parent.
        pitch: Mean angle between the parent and the limb, radians.
        rise: How far the end is lifted, as a share of the length; negative droops.

    Returns:
        The k * each limbs, at CURVE + 1 points each.

    Example:
        >>> parent = Limbs(np.array([[[0.0, 0, 0], [0, 4, 0]]]), np.array([[0.2, 0.1]]))
        >>> rng = np.random.default_rng(0)
        >>> offshoots(rng, parent, 3, span=(0.5, 1), lengths=np.ones(3), pitch=1.0, rise=0.1).paths.shape
        (3, 13, 3)
    """
    count = len(parents.paths) * each
    parent = np.repeat(np.arange(len(parents.paths)), each)
    order = np.tile(np.arange(each), len(parents.paths))
    share = span[0] + (span[1] - span[0]) * (order + rng.uniform(0.1, 0.9, count)) / each
    azimuth = (
        2.39996 * order + np.repeat(rng.uniform(0, 2 * np.pi, len(parents.paths)), each) + rng.normal(0, 0.25, count)
    )
    angle = pitch + rng.normal(0, 0.13, count)
    waver, phase = 0.05 * rng.standard_normal((count, 2, 3)), rng.uniform(0, 2 * np.pi, (count, 2, 1))
    start, radius, along = parents.at(parent, share)
    side = np.cross(along, [0.31, 0.23, 0.92])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    outward = np.cos(azimuth)[:, None] * side + np.sin(azimuth)[:, None] * other
    heading = np.cos(angle)[:, None] * along + np.sin(angle)[:, None] * outward
    t = np.linspace(0, 1, CURVE + 1)[None, :, None]
    swing = np.sin(np.array([2.3, 5.1]) * t + phase[:, None, :, 0]) - np.sin(phase[:, None, :, 0])
    waves = np.einsum("kwj,knw->knj", waver, swing)
    way = heading[:, None] * t + rise * t**2 * np.array([0.0, 1.0, 0.0]) + waves * np.sqrt(t)
    paths = (start + 0.8 * radius[:, None] * outward)[:, None] + lengths[:, None, None] * way
    foot = np.clip(0.62 * radius, THINNEST, 0.035 * lengths + THINNEST)
    return Limbs(paths, foot[:, None] * _taper(t[..., 0]))


def _taper(share: Array) -> Array:
    taper: Array = (1 - share) ** 0.75
    return taper


def broadleaf(
    rng: np.random.Generator, ground: Terrain, foot: Array, height: float, radius: float, kind: Kind, detail: Detail
) -> Tree:
    """Returns a broad-leaved tree without its leaves: trunk, branches, boughs and twigs.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> rng, ground = np.random.default_rng(0), terrain(0, Detail(0.2))
        >>> tree = broadleaf(rng, ground, np.array([8.0, 0.2, 0.0]), 9.0, 0.3, Kind(), Detail(0.5))
        >>> [len(limbs.paths) for limbs in tree.limbs]
        [1, 8, 32, 96]
    """
    rows, columns = detail.segments(kind.rows), detail.segments(kind.columns, least=3)
    bark, axis = trunk(rng, ground, foot, height, radius, rows, columns)
    first, second = kind.forks
    share = np.linspace(0, 1, kind.branches)
    lengths = kind.reach * height * (1 - 0.62 * share) * rng.uniform(0.8, 1.15, kind.branches)
    branches = offshoots(rng, axis, kind.branches, span=kind.span, lengths=lengths, pitch=1.15, rise=0.22)
    lengths = np.repeat(lengths, first) * rng.uniform(0.32, 0.55, kind.branches * first)
    boughs = offshoots(rng, branches, first, span=(0.3, 0.95), lengths=lengths, pitch=0.85, rise=0.0)
    lengths = np.repeat(lengths, second) * rng.uniform(0.4, 0.7, kind.branches * first * second)
    twigs = offshoots(rng, boughs, second, span=(0.3, 1.0), lengths=lengths, pitch=0.8, rise=-0.12)
    return _tree(rng, bark, (axis, branches, boughs, twigs), kind.sides, kind.steps, detail)


def shrub(rng: np.random.Generator, foot: Array, height: float, detail: Detail) -> Tree:
    """Returns a shrub without its leaves: stems that fan out from the ground, and their twigs.

    Example:
        >>> one = shrub(np.random.default_rng(0), np.array([8.0, 0.0, 0.0]), 1.4, Detail())
        >>> [len(limbs.paths) for limbs in one.limbs]
        [1, 9, 36]
    """
    stub = Limbs(np.array([[foot, np.add(foot, (0.0, 0.12, 0.0))]]), np.array([[0.03, 0.02]]))
    lengths = height * rng.uniform(0.8, 1.2, 9)
    stems = offshoots(rng, stub, 9, span=(0.0, 1.0), lengths=lengths, pitch=0.75, rise=0.12)
    lengths = np.repeat(lengths, 4) * rng.uniform(0.3, 0.5, 36)
    twigs = offshoots(rng, stems, 4, span=(0.25, 1.0), lengths=lengths, pitch=0.8, rise=0.0)
    nothing = Patch(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 3)))
    return _tree(rng, nothing, (stub, stems, twigs), (3, 3), (3, 1), detail)


def _tree(
    rng: np.random.Generator,
    bark: Patch,
    limbs: tuple[Limbs, ...],
    sides: tuple[int, ...],
    steps: tuple[int, ...],
    detail: Detail,
) -> Tree:
    """The tree of a trunk's bark and of its limbs by order, without those that hang into the trail's free space.

    Where the fineness asks for them, sprigs are one order more.
    """
    kept = [limbs[0], *(order.chosen(_clear_of_trail(order, limbs[0].paths[0, 0, 1])) for order in limbs[1:])]
    pieces = [bark]
    for order, around, along, finest in zip(kept[1:], sides, steps, FINEST[-len(sides) :], strict=True):
        if around and detail.shows(finest) and len(order.paths):
            # A bend is shared among few segments: finer ones would lie in a line.
            made = order.resampled(detail.at_most(2.5).segments(along, least=min(along, 2)))
            pieces.append(tubes(made.paths, made.radii, detail.segments(around, least=3)))
    if detail.shows(SPRIGS):
        each, twigs = detail.segments(2), kept[-1]
        lengths = rng.uniform(0.15, 0.4, each * len(twigs.paths))
        sprigs = offshoots(rng, twigs, each, span=(0.15, 1.0), lengths=lengths, pitch=0.8, rise=0.0)
        kept.append(sprigs.chosen(_clear_of_trail(sprigs, limbs[0].paths[0, 0, 1])))
        if sides[-1] and len(kept[-1].paths):
            made = kept[-1].resampled(2)
            pieces.append(tubes(made.paths, made.radii, 3))
    return Tree(join(pieces), tuple(kept))


def _clear_of_trail(limbs: Limbs, floor: float) -> Mask:
    """Which limbs, with leaves on them, stay out of the free space above the trail."""
    places = limbs.paths[..., [0, 2]]
    high = limbs.paths[..., 1] - floor > HEADROOM + LEAF_REACH
    clear: Mask = np.all(high | (distance_to_trail(places) > CORRIDOR + LEAF_REACH), axis=1)
    return clear
