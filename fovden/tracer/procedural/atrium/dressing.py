"""What was brought into the atrium: curtains and cloths, vases with agaves, and ivy. All of it varies with the seed.

Parts come as pairs of a surface's name and a patch in the world.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fovden.tracer.procedural.atrium import furnishings
from fovden.tracer.procedural.atrium.plan import (
    BAY,
    HALF_WALL,
    HALF_X,
    HALF_Z,
    LONG,
    LONG_TURNS,
    QUARTER,
    SHORT,
    SHORT_TURNS,
    UPPER_FLOOR,
    bay_middles,
)
from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import tube

__all__ = ["CLOTHS", "Ivy", "drapery", "plants"]

CLOTHS = ("crimson cloth", "blue cloth", "green cloth", "ochre cloth")

CURTAINS = {0.0: (1, 3, 5), np.pi: (2, 4, 6), QUARTER: (), -QUARTER: ()}
"""Bays with curtains, by the turn of their side."""

BANNERS = {0.0: (2, 4, 6), np.pi: (1, 3, 5), QUARTER: (), -QUARTER: (0, 1)}
"""Bays with a cloth over the balustrade, by the turn of their side."""

CLUSTER = 6
"""How many strands of ivy grow side by side."""

FINEST = 2.0
"""Fineness above which blades, crowded at their root, and hanging cloths, almost flat, stay as they are."""

FINEST_VASE = 3.0
"""Fineness above which vases do: their triangles would be smaller than a grain of sand."""


def drapery(rng: np.random.Generator, detail: Detail = DRAWN) -> Iterator[tuple[str, Patch]]:
    """Returns curtains in some of the arches, and cloths over the balustrade.

    Args:
        rng: Source of the folds' irregularity.
        detail: Fineness; there are no cloths below 0.09.

    Returns:
        Pairs of a surface's name and a patch.

    Example:
        >>> len(list(drapery(np.random.default_rng(0))))
        20
    """
    rod = tube([(-1.34, 0, 0), (1.34, 0, 0)], 0.018, detail.segments(6, least=3))
    mirror = np.diag([-1.0, 1.0, 1.0])
    over_rail = [(-0.17, 5.80), (-0.17, 6.15), (-0.12, 6.205), (0.12, 6.205), (0.18, 6.13)]
    over_rail += [(0.34, 5.74), (0.60, 5.34), (0.625, 5.2), (0.625, 4.6), (0.625, 3.95)]
    colour = 0
    for turn in (*LONG_TURNS, *SHORT_TURNS):
        bays, distance = (LONG, HALF_Z) if turn in LONG_TURNS else (SHORT, HALF_X)
        x = bay_middles(bays)
        for i in CURTAINS[turn] if detail.shows(0.09) else ():
            halves = [furnishings.curtain(rng, 1.22, 3.06, tie=1.3, detail=detail) for _ in range(2)]
            pair = join([halves[0], halves[1].transformed(mirror)]).placed((0, 0.04, 0))
            yield CLOTHS[colour % 4], pair.placed((x[i], 0, -distance)).placed(turns=turn)
            yield "bronze", rod.placed((x[i], 3.1, -distance)).placed(turns=turn)
            colour += 1
        for i in BANNERS[turn] if detail.shows(0.09) else ():
            cloth = furnishings.banner(rng, 1.5, over_rail, detail=detail.at_most(FINEST))
            yield CLOTHS[(colour + 2) % 4], cloth.placed((x[i], 0, -distance)).placed(turns=turn)
            colour += 1


def plants(rng: np.random.Generator, detail: Detail = DRAWN) -> Iterator[tuple[str, Patch]]:
    """Returns the vases in the court, with agaves in them.

    Args:
        rng: Source of the plants' irregularity.
        detail: Fineness; there are none below 0.08.

    Returns:
        Pairs of a surface's name and a patch.

    Example:
        >>> [surface for surface, _ in plants(np.random.default_rng(0))][:3]
        ['terracotta', 'earth', 'agave']
    """
    if not detail.shows(0.08):
        return
    places = [(x, 0.0, side * 2.35) for x in (-2 * BAY, 0.0, 2 * BAY) for side in (-1, 1)]
    places += [(HALF_X - 1.0, 0.0, side * 2.25) for side in (-1, 1)]
    body, earth = furnishings.vase(detail.at_most(FINEST_VASE))
    turns = 0.4 * rng.standard_normal(len(places))
    yield "terracotta", body.placed(places, turns)
    yield "earth", earth.placed(places, turns)
    blades = min(detail.segments(26, least=6), 26)
    for place in places:
        yield "agave", furnishings.agave(rng, blades, detail=detail.at_most(FINEST)).placed((0, 0.85, 0)).placed(place)


@dataclass(frozen=True, eq=False)
class Ivy:
    """Strands of ivy that hang in clusters from the lip of the lower cornice.

    Attributes:
        strands: Points along each strand's stem, metres, shape (k, n, 3).
        turns: Directions that the strands face, radians, shape (k).
        lengths: Metres, shape (k).
        detail: Fineness.

    Example:
        >>> Ivy.grown(np.random.default_rng(0)).strands.shape
        (96, 7, 3)
    """

    strands: Array
    turns: Array
    lengths: Array
    detail: Detail = DRAWN

    @classmethod
    def grown(cls, rng: np.random.Generator, detail: Detail = DRAWN) -> Ivy:
        """Returns strands that grew at random: sixteen clusters as drawn.

        Example:
            >>> len(Ivy.grown(np.random.default_rng(0), Detail(2.0)).strands)
            192
        """
        clusters = detail.segments(16, least=3)
        count = CLUSTER * clusters
        turns = rng.choice([*LONG_TURNS, *LONG_TURNS, *LONG_TURNS, *SHORT_TURNS], clusters)
        turns = np.repeat(turns, CLUSTER)
        half = np.where(np.isin(turns, LONG_TURNS), HALF_X, HALF_Z) - 0.9
        distance = np.where(np.isin(turns, LONG_TURNS), HALF_Z, HALF_X)
        cluster = np.repeat(rng.uniform(-1, 1, clusters), CLUSTER) * half
        x = np.clip(cluster + 0.35 * rng.standard_normal(count), -half, half)
        length = 0.5 + 1.7 * rng.random(count) ** 1.5
        down = np.linspace(0, 1, detail.at_most(1.0).segments(6, least=2) + 1)
        swing = 0.06 * np.sin(3.0 * down + 2 * np.pi * rng.random((count, 1))) * down
        local_x = x[:, None] + swing
        local_y = UPPER_FLOOR + 0.02 - length[:, None] * down
        local_z = -distance[:, None] + HALF_WALL + 0.38 + 0.05 * rng.random((count, 1)) + 0.5 * swing
        cosine, sine = np.cos(turns)[:, None], np.sin(turns)[:, None]
        strands = np.stack([cosine * local_x + sine * local_z, local_y, -sine * local_x + cosine * local_z], axis=-1)
        return cls(strands, turns, length, detail)

    def stems(self) -> Iterator[tuple[str, Patch]]:
        """Returns the strands' stems; below a fineness of 0.15 there are only leaves.

        Example:
            >>> [patch.triangle_count for _, patch in Ivy.grown(np.random.default_rng(0)).stems()][:2]
            [36, 36]
        """
        if self.detail.shows(0.15):
            thickness = np.linspace(0.006, 0.002, self.strands.shape[1])
            for strand in self.strands:
                yield "stem", tube(strand, thickness, 3)

    def foliage(self, rng: np.random.Generator, triangles: int) -> Iterator[tuple[str, Patch]]:
        """Returns exactly so many triangles of leaves, spread over the strands, and of buds.

        Leaves grow on alternating sides, all the larger the coarser they are. What does not make a leaf becomes buds
        of one triangle at the ends of the first strands.

        Example:
            >>> rng = np.random.default_rng(0)
            >>> sum(patch.triangle_count for _, patch in Ivy.grown(rng).foliage(rng, 997))
            997
        """
        last = self.strands.shape[1] - 1
        leaves, buds = divmod(triangles, furnishings.ivy_leaf_triangles(self.detail))
        place = (np.arange(leaves) + 0.5) / max(leaves, 1) * self.lengths.sum()
        ends = np.cumsum(self.lengths)
        strand = np.minimum(np.searchsorted(ends, place), len(self.strands) - 1)
        share = (place - (ends - self.lengths)[strand]) / self.lengths[strand] * last
        lower = np.clip(share.astype(int), 0, last - 1)
        within = (share - lower)[:, None]
        roots = (1 - within) * self.strands[strand, lower] + within * self.strands[strand, lower + 1]
        facing = self.turns[strand] + np.where(np.arange(leaves) % 2, 0.9, -0.9) + 0.5 * rng.standard_normal(leaves)
        roots += 0.03 * np.stack([np.sin(facing), 0.3 * rng.standard_normal(leaves), np.cos(facing)], axis=1)
        tilts = -0.5 + 0.35 * rng.standard_normal(leaves)
        sizes = (0.115 - 0.05 * share / last) * (0.75 + 0.5 * rng.random(leaves))
        sizes *= min(max(self.detail.fineness, 0.1), 1.0) ** -0.5
        if leaves:
            yield "ivy", furnishings.ivy_leaves(roots, facing, tilts, sizes, self.detail)
        for i in range(buds):
            yield "ivy", furnishings.ivy_bud(self.strands[i, -1], self.turns[i], 0.05)
