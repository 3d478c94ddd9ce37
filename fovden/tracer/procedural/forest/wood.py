"""Where the trees and shrubs stand: a ring around the clearing, more behind it, and spruces that close the view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest.ground import Discs, Terrain
from fovden.tracer.procedural.forest.plan import CLEARING, distance_to_trail, generator, spread_out
from fovden.tracer.procedural.forest.spruces import spruces
from fovden.tracer.procedural.forest.trees import Kind, Tree, broadleaf, shrub
from fovden.tracer.procedural.patch import Array, Patch, join

__all__ = ["Wood", "plant_wood"]

NEAR, FAR, SHRUBS, SPRUCES = 14, 18, 26, 26
"""Numbers of broad-leaved trees around the clearing and behind, of shrubs and of spruces."""

FAR_KIND = Kind(
    columns=10, rows=7, branches=7, sides=(4, 3, 0), steps=(4, 2, 1), forks=(4, 2), span=(0.25, 0.95), reach=0.36
)


@dataclass(frozen=True)
class Wood:
    """The trees and shrubs, without their leaves.

    Attributes:
        near: Trees around the clearing.
        far: Trees behind them.
        shrubs: Shrubs between the trees.
        spruce_bark: Trunks of the spruces.
        needles: Boughs of the spruces.
        trunks: Circles that the trunks stand on.
        spread: Circles that the spruces' boughs hang over.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> ground = terrain(0, Detail(0.2))
        >>> wood = plant_wood(0, ground, ground, Detail(0.1))
        >>> len(wood.near), wood.trunks.centres.shape
        (14, (58, 2))
    """

    near: tuple[Tree, ...]
    far: tuple[Tree, ...]
    shrubs: tuple[Tree, ...]
    spruce_bark: Patch
    needles: Patch
    trunks: Discs
    spread: Discs

    @property
    def bark(self) -> Patch:
        """Bark of all broad-leaved trees and shrubs.

        Example:
            >>> from fovden.tracer.procedural.forest.ground import terrain
            >>> ground = terrain(0, Detail(0.2))
            >>> plant_wood(0, ground, ground, Detail(0.1)).bark.triangle_count > 0
            True
        """
        return join([tree.bark for tree in (*self.near, *self.far, *self.shrubs)])


def plant_wood(seed: int, drawn: Terrain, ground: Terrain, detail: Detail) -> Wood:
    """Returns the wood. Where the trees stand and how they branch is the same for every fineness.

    Args:
        seed: Of the scene.
        drawn: The ground at fineness 1, on which the trees' axes begin.
        ground: The ground as it is made, which the trunks' lowest rings follow.
        detail: Fineness.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> ground = terrain(0, Detail(0.2))
        >>> wood = plant_wood(0, ground, ground, Detail(0.1))
        >>> bool(np.hypot(*wood.trunks.centres.T).min() > CLEARING)
        True
    """
    rng = generator(seed, "where trees stand")
    near = _places(rng, NEAR, CLEARING + 0.4, CLEARING + 2.2, 1.55, np.zeros((0, 2)))
    far = _places(rng, FAR, 9.6, 14.5, 1.5, near)
    firs = _places(rng, SPRUCES, 11.5, 18.5, 1.7, np.concatenate([near, far]))
    bushes = _places(rng, SHRUBS, 8.3, 15.0, 1.6, np.concatenate([near, far, firs]))
    trees = []
    for name, places, kind, height, thick in (
        ("near trees", near, Kind(), (9.5, 13.0), (0.27, 0.42)),
        ("far trees", far, FAR_KIND, (12.0, 16.0), (0.22, 0.32)),
    ):
        grow = generator(seed, name).spawn(len(places))
        trees.append(
            tuple(
                broadleaf(one, ground, foot, one.uniform(*height), one.uniform(*thick), kind, detail)
                for one, foot in zip(grow, drawn.on(places), strict=True)
            )
        )
    grow = generator(seed, "shrubs").spawn(SHRUBS)
    shrubs = tuple(
        shrub(one, foot, one.uniform(1.1, 2.0), detail) for one, foot in zip(grow, drawn.on(bushes), strict=True)
    )
    rng = generator(seed, "spruces")
    shown = min(SPRUCES, detail.count(6 * SPRUCES, least=5))
    spruce_bark, needles = spruces(
        rng, ground, drawn.on(firs[:shown]), rng.uniform(12.0, 18.0, SPRUCES)[:shown], detail
    )
    radii = np.concatenate([np.full(NEAR, 0.38), np.full(FAR, 0.27), np.full(SPRUCES, 0.2)])
    trunks = Discs(np.concatenate([near, far, firs]), radii)
    return Wood(trees[0], trees[1], shrubs, spruce_bark, needles, trunks, Discs(firs, np.full(SPRUCES, 3.2)))


def _places(rng: np.random.Generator, count: int, inner: float, outer: float, aside: float, taken: Array) -> Array:
    """Places (x, z) in a ring, away from the trail and spread out from each other and from what is there."""
    candidates = rng.uniform(-outer, outer, (2500, 2))
    reach = np.hypot(*candidates.T)
    free = (reach > inner) & (reach < outer) & (distance_to_trail(candidates) > aside)
    candidates = candidates[free][: 12 * count]
    chosen: Array = candidates[spread_out(rng, candidates, count, taken)]
    return chosen
