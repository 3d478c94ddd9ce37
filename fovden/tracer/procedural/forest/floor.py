"""What lies and grows on the clearing's floor: standing stones, boulders, a fallen log, ferns and mushrooms."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest.ground import Discs, Terrain, domes
from fovden.tracer.procedural.forest.plan import CORRIDOR, distance_to_trail, generator, spread_out
from fovden.tracer.procedural.forest.undergrowth import fern, mushroom
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import grid

__all__ = ["LOG", "fallen_log", "furnish_floor", "standing_stones"]

LOG = ((3.4, 1.6), (5.3, -1.5))
"""Ends (x, z) of the fallen log, metres."""

FERNS, BOULDERS, MUSHROOMS = 38, 26, 48
"""Numbers of them; mushrooms grow in groups of six."""


def standing_stones(seed: int, ground: Terrain, detail: Detail) -> tuple[Patch, Discs]:
    """Returns a broken ring of tall stones around the shrine, and the circles that they stand on.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> stones, stands = standing_stones(0, terrain(0, Detail(0.2)), Detail())
        >>> bool(stones.triangle_count > 1000), bool((distance_to_trail(stands.centres) > 1.1).all())
        (True, True)
    """
    rng = generator(seed, "standing stones")
    angle = 2 * np.pi * (np.arange(11) + 0.35) / 11
    places = 4.5 * np.stack([np.sin(angle), np.cos(angle)], axis=1) + rng.normal(0, 0.12, (11, 2))
    radii, heights = rng.uniform(0.26, 0.36, 11), rng.uniform(0.75, 1.55, 11)
    free = distance_to_trail(places) > 1.1
    places, radii, heights = places[free], radii[free], heights[free]
    size = (detail.segments(10, least=1), detail.segments(14, least=3))
    return domes(rng, ground, places, radii, heights, size, block=0.42, rough=0.09), Discs(places, 0.7 * radii)


def fallen_log(seed: int, ground: Terrain, detail: Detail) -> tuple[Patch, Patch]:
    """Returns a log that lies on the ground, its ends sawn: bark and end grain.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> bark, grain = fallen_log(0, terrain(0, Detail(0.2)), Detail())
        >>> bark.triangle_count, grain.triangle_count
        (880, 40)
    """
    rng = generator(seed, "log")
    columns, rows = detail.segments(20, least=4), detail.segments(22, least=2)
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    angle[-1] = 0.0
    share = np.linspace(0, 1, rows + 1)
    start, end = (np.array(place) for place in LOG)
    along = (end - start) / np.linalg.norm(end - start)
    middle = start + share[:, None] * (end - start)
    middle = middle + 0.06 * np.sin(3 * share)[:, None] * [-along[1], along[0]]
    phase = rng.uniform(0, 2 * np.pi, 4)
    radius = 0.31 - 0.07 * share[:, None]
    radius = radius * (1 + 0.05 * np.sin(3 * angle + 4 * share[:, None] + phase[0]))
    radius = radius * (1 + 0.05 * np.sin(8 * angle + 2.5 * np.sin(9 * share[:, None] + phase[1])))
    floor = np.polyval(np.polyfit(share, ground.height(middle), 2), share)
    centre = np.stack([middle[:, 0], floor + 0.24 - 0.05 * share, middle[:, 1]], axis=1)
    across = np.array([-along[1], 0.0, along[0]])
    around = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.array([0.0, 1.0, 0.0])
    points = centre[:, None] + radius[..., None] * around
    length = np.linalg.norm(end - start)
    uv = np.stack(np.broadcast_arrays(np.linspace(0, 2, columns + 1), length * share[:, None]), axis=-1)
    bark = grid(points, smooth=True, uv=uv)
    inward = np.cross(points[0, 1] - points[0, 0], points[1, 0] - points[0, 0]) @ around[0] < 0
    ends = []
    for row, facing in ((0, -1.0), (-1, 1.0)):
        rim = points[row, :-1]
        hub = centre[row] + facing * 0.01 * np.array([along[0], 0.0, along[1]])
        faces = np.stack([np.arange(columns), (np.arange(columns) + 1) % columns, np.full(columns, columns)], axis=1)
        offset = np.concatenate([rim, hub[None]]) - centre[row]
        plane = np.stack([offset @ across, offset[:, 1]], axis=1) / np.abs(radius[row]).max()
        face = Patch(offset + centre[row], faces, 0.5 + 0.46 * plane, np.zeros((columns + 1, 3)))
        normal = np.cross(rim[1] - rim[0], hub - rim[0]) @ [along[0], 0.0, along[1]]
        ends.append(face if normal * facing > 0 else face.reversed())
    return (bark.reversed() if inward else bark), join(ends)


def furnish_floor(
    seed: int, ground: Terrain, detail: Detail, taken: Discs
) -> tuple[list[tuple[str, Patch]], Discs, Discs]:
    """Returns stones, log, ferns and mushrooms, the circles that stones cover, and those that grass keeps out of.

    Args:
        seed: Of the scene.
        ground: The terrain.
        detail: Fineness.
        taken: Circles that something stands on already.

    Returns:
        Pairs of a surface's name and a patch; circles whose ground cannot be seen; circles that something stands on.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> nothing = Discs(np.zeros((0, 2)), np.zeros(0))
        >>> parts, hidden, stands = furnish_floor(0, terrain(0, Detail(0.2)), Detail(), nothing)
        >>> sorted({name for name, _ in parts})
        ['bark', 'boulder', 'end grain', 'fern', 'granite', 'mushroom stem', 'toadstool']
    """
    parts = []
    tall, tall_stands = standing_stones(seed, ground, detail)
    parts.append(("granite", tall))
    if detail.shows(0.12):
        parts += list(zip(("bark", "end grain"), fallen_log(seed, ground, detail), strict=True))
    share = np.linspace(0, 1, 6)[:, None]
    log = Discs(np.array(LOG[0]) * (1 - share) + np.array(LOG[1]) * share, np.full(6, 0.55))
    taken = _both(_both(taken, tall_stands), log)
    rng = generator(seed, "boulders")
    radii = rng.uniform(0.16, 0.62, BOULDERS)
    places = _free(rng, taken, 2.9, 11.0, CORRIDOR + 0.5, BOULDERS, margin=0.65)
    shown = min(BOULDERS, detail.count(4 * BOULDERS, least=3))
    places, radii = places[:shown], radii[:shown]
    size = (detail.segments(8, least=1), detail.segments(15, least=3))
    heights = radii * rng.uniform(0.7, 1.2, BOULDERS)[:shown]
    parts.append(("boulder", domes(rng, ground, places, radii, heights, size, block=0.62, rough=0.10)))
    boulders = Discs(places, 0.72 * radii)
    taken = _both(taken, boulders)
    if detail.shows(0.3):
        parts += _plants(seed, ground, detail, taken)
    return parts, _both(tall_stands, boulders), taken


def _plants(seed: int, ground: Terrain, detail: Detail, taken: Discs) -> Iterator[tuple[str, Patch]]:
    rng = generator(seed, "ferns")
    places = _free(rng, taken, 3.0, 10.5, CORRIDOR + 0.25, FERNS, margin=0.3)
    sizes = rng.uniform(0.6, 1.15, FERNS) * np.where(distance_to_trail(places) < 1.6, 0.65, 1.0)
    turns, kind = rng.uniform(0, 2 * np.pi, FERNS), np.arange(FERNS) % 5
    for i in range(5):
        chosen = kind == i
        feet = ground.on(places[chosen], above=-0.01)
        copies = fern(rng, detail).placed(feet, turns[chosen], sizes[chosen])
        yield "fern", Patch(copies.vertices, copies.faces, _unscaled(copies, sizes[chosen]), copies.normals)
    rng = generator(seed, "mushrooms")
    heart = np.repeat(_free(rng, taken, 2.6, 8.0, 0.75, MUSHROOMS // 6, margin=0.2), 6, axis=0)
    places = heart + rng.normal(0, 0.14, heart.shape)
    caps = [mushroom(detail, cap) for cap in (0.42, 0.55)]
    feet, sizes = ground.on(places), rng.uniform(0.07, 0.19, len(places))
    for i, (skin, stem) in enumerate(caps):
        which = np.arange(len(places)) % 2 == i
        copies = skin.placed(feet[which], rng.uniform(0, 6.3, int(which.sum())), sizes[which])
        yield "toadstool", Patch(copies.vertices, copies.faces, _unscaled(copies, sizes[which]), copies.normals)
        yield "mushroom stem", stem.placed(feet[which], 0.0, sizes[which])


def _unscaled(copies: Patch, sizes: Array) -> Array:
    """Texture coordinates of scaled copies as they were before: an image that fits the thing, whatever its size."""
    return copies.uv / np.repeat(sizes, len(copies.vertices) // len(sizes))[:, None]


def _free(
    rng: np.random.Generator, taken: Discs, inner: float, outer: float, aside: float, count: int, margin: float
) -> Array:
    """Places (x, z) in a ring, off the trail and off what is there, scattered but not crowded."""
    candidates = rng.uniform(-outer, outer, (3000, 2))
    reach = np.hypot(*candidates.T)
    free = (reach > inner) & (reach < outer) & (distance_to_trail(candidates) > aside)
    candidates = candidates[free & ~taken.contain(candidates, margin)][: 3 * count]
    chosen: Array = candidates[spread_out(rng, candidates, count)]
    return chosen


def _both(first: Discs, second: Discs) -> Discs:
    return Discs(np.concatenate([first.centres, second.centres]), np.concatenate([first.radii, second.radii]))
