"""Leaves and grass: small separate things that take exactly the triangles that are left."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fovden.tracer.procedural.forest.ground import Discs, Terrain
from fovden.tracer.procedural.forest.leaves import LEAF_TRIANGLES, fallen_leaves, leaves_on
from fovden.tracer.procedural.forest.plan import distance_to_trail, generator
from fovden.tracer.procedural.forest.trees import Limbs, Tree
from fovden.tracer.procedural.forest.undergrowth import BLADE_TRIANGLES, blades
from fovden.tracer.procedural.forest.wood import Wood
from fovden.tracer.procedural.patch import Array, Patch

__all__ = ["grow_foliage"]

NEAR, FAR, SHRUBS, FALLEN = 0.48, 0.17, 0.12, 0.05
"""Shares of the triangles for the leaves of the near trees, of the far ones, of the shrubs, and for fallen ones; the
rest is grass."""

DRAWN = 60_500
"""Triangles of foliage for which sizes are right; with more or fewer, sizes change so that leaves cover as much."""


def grow_foliage(seed: int, ground: Terrain, wood: Wood, taken: Discs, triangles: int) -> Iterator[tuple[str, Patch]]:
    """Yields leaves on trees and shrubs, fallen leaves, and grass, of exactly so many triangles.

    Args:
        seed: Of the scene.
        ground: The terrain.
        wood: The trees.
        taken: Circles that nothing grows in.
        triangles: Their number.

    Yields:
        Pairs of a surface's name and a patch.

    Example:
        >>> from fovden.tracer.procedural.detail import Detail
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> from fovden.tracer.procedural.forest.wood import plant_wood
        >>> ground, nothing = terrain(0, Detail(0.2)), Discs(np.zeros((0, 2)), np.zeros(0))
        >>> parts = grow_foliage(0, ground, plant_wood(0, ground, ground, Detail(0.1)), nothing, 12_345)
        >>> sum(patch.triangle_count for _, patch in parts)
        12345
    """
    growth = float(np.clip((DRAWN / max(triangles, 1)) ** 0.5, 0.1, 3.0))
    left = triangles
    for name, trees, share, size, surface in (
        ("near leaves", wood.near, NEAR, 0.26, "oak leaf"),
        ("far leaves", wood.far, FAR, 0.42, "ash leaf"),
        ("shrub leaves", wood.shrubs, SHRUBS, 0.2, "oak leaf"),
    ):
        count = int(share * triangles) // LEAF_TRIANGLES
        rng = generator(seed, name)
        for part, (limbs, number) in enumerate(_bearers(trees, count)):
            if number:
                patch = leaves_on(rng, limbs, np.arange(number) * len(limbs.paths) // number, growth * size)
                yield surface if part == 0 else "ash leaf", patch
                left -= patch.triangle_count
    count = int(FALLEN * triangles) // LEAF_TRIANGLES
    rng = generator(seed, "fallen leaves")
    places = _fields(rng, count, taken, clumps=0, aside=0.0)
    yield "dead leaf", fallen_leaves(rng, ground, places, 0.11 * growth**0.8)
    left -= LEAF_TRIANGLES * count
    rng = generator(seed, "grass")
    count, single = divmod(left, BLADE_TRIANGLES)
    places = _fields(rng, count + single, taken, clumps=170, aside=0.34)
    if count:
        yield "grass", blades(rng, ground, places[:count], 0.26 * growth**0.8)
    if single:
        yield "grass", blades(rng, ground, places[count:], 0.16, single=True)


def _bearers(trees: tuple[Tree, ...], leaves: int) -> Iterator[tuple[Limbs, int]]:
    """Twigs and the number of leaves on them: those of two trees in three, then those of the third."""
    for rest in (False, True):
        chosen = [tree.limbs[-1] for i, tree in enumerate(trees) if (i % 3 == 2) == rest]
        limbs = Limbs(np.concatenate([one.paths for one in chosen]), np.concatenate([one.radii for one in chosen]))
        third = leaves // 3
        yield limbs, third if rest else leaves - third


def _fields(rng: np.random.Generator, count: int, taken: Discs, clumps: int, aside: float) -> Array:
    """Places (x, z) in the clearing and between the first trees, off the trail's stones; in clumps if asked."""
    found = np.zeros((0, 2))
    outer = 8.5 if clumps else 10.5
    heart = rng.uniform(-outer, outer, (max(clumps, 1), 2))
    while len(found) < count:
        number = 2 * (count - len(found)) + 64
        places = rng.uniform(-outer, outer, (number, 2))
        if clumps:
            places = heart[rng.integers(clumps, size=number)] + rng.normal(0, 0.11, (number, 2))
        keep = (np.hypot(*places.T) < outer) & ~taken.contain(places, margin=0.04)
        keep &= distance_to_trail(places) > aside
        found = np.concatenate([found, places[keep]])
    return found[:count]
