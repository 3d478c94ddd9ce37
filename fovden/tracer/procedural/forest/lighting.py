"""Where the eighty lanterns are, and the point lights in them.

They stand and hang in six groups: on crooks and in stone lanterns along the trail, on the ground beside it, under the
shrine's roof, on cords from the branches around the clearing, and on stumps in the wood behind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fovden.tracer.lights import PointLight
from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest import lanterns, shrine
from fovden.tracer.procedural.forest.ground import Discs, Terrain
from fovden.tracer.procedural.forest.plan import (
    APPROACH,
    CLEARING,
    distance_to_trail,
    generator,
    spread_out,
    trail_points,
)
from fovden.tracer.procedural.forest.trees import Tree
from fovden.tracer.procedural.patch import Array, Patch, join

__all__ = ["LIGHTS", "Lighting"]

LIGHTS = 80
"""Point lights of the 2023 paper's Forest (Table 2)."""

CROOKS, LOW, STONE, EAVES, STUMPS, DEEP = 10, 9, 8, 5, 10, 15
HANGING = LIGHTS - CROOKS - LOW - STONE - EAVES - STUMPS - DEEP
"""Numbers of lanterns of each group: DEEP ones hang between the far trees, HANGING ones around the clearing."""

CANDLE, AMBER, MOON = (1.0, 0.60, 0.27), (1.0, 0.47, 0.15), (0.42, 0.68, 1.0)
"""Colours of the lights: a candle, an oil lamp, and a cool one."""

HUNG_SCALE = 1.25
"""Size of the lanterns that hang from branches."""


class Lighting:
    """Places lanterns and keeps their lights.

    Attributes:
        lights: The point lights so far.
        stands: Circles on the ground that lanterns stand on, for other things to keep away from.

    Example:
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> lighting = Lighting(0, terrain(0, Detail(0.2)), Detail())
        >>> surfaces = {name for name, _ in lighting.along_trail()}
        >>> sorted(surfaces), len(lighting.lights)
        (['granite', 'iron', 'wax'], 27)
    """

    def __init__(self, seed: int, ground: Terrain, detail: Detail) -> None:
        self.lights: list[PointLight] = []
        self._seed, self._ground, self._detail = seed, ground, detail
        self._stands: list[tuple[float, float, float]] = []

    @property
    def stands(self) -> Discs:
        """Circles on the ground that lanterns stand on.

        Example:
            >>> from fovden.tracer.procedural.forest.ground import terrain
            >>> len(Lighting(0, terrain(0, Detail(0.2)), Detail()).stands.radii)
            0
        """
        stands = np.array(self._stands).reshape(-1, 3)
        return Discs(stands[:, :2], stands[:, 2])

    def along_trail(self) -> Iterator[tuple[str, Patch]]:
        """Yields the lanterns along the trail: on crooks, on the ground, and stone ones that also guard the shrine.

        Example:
            >>> from fovden.tracer.procedural.forest.ground import terrain
            >>> lighting = Lighting(0, terrain(0, Detail(0.2)), Detail(0.05))
            >>> list(lighting.along_trail()), len(lighting.lights)
            ([], 27)
        """
        rng = generator(self._seed, "lanterns along the trail")
        middle = trail_points(0.1)
        heading = np.gradient(middle, axis=0)
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        right = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
        wanted = CROOKS + LOW + STONE - 4
        at = np.linspace(0.09, 0.86, wanted) * len(middle)
        number = at.astype(int)
        side = np.where(np.arange(wanted) % 2, 1.0, -1.0)
        order = np.arange(wanted)
        stone = order % 6 == 3
        crook = ~stone & (np.cumsum(~stone) % 2 == 1)
        aside = np.where(crook, 1.28, np.where(stone, 1.15, 0.82)) + rng.uniform(0, 0.1, wanted)
        near = np.linalg.norm(middle[number][:, None] - APPROACH, axis=2).min(axis=1) < 1.0
        near |= np.hypot(*middle[number].T) < 4.1
        side = np.where(near, -1.0, side)
        places = middle[number] + (side * aside)[:, None] * right[number]
        inward = -side[:, None] * right[number]
        turns = np.arctan2(inward[:, 0], inward[:, 1])
        self._stands += [(*place, 0.3) for place in places.tolist()]
        yield from self._crooks(places[crook], turns[crook])
        low = ~crook & ~stone
        yield from self._iron(self._ground.on(places[low]), turns[low], 1.15, 1.1, (CANDLE, AMBER), hanging=False)
        corners = 2.55 * np.stack(
            [np.sin(np.pi / 4 + np.pi / 2 * np.arange(4)), np.cos(np.pi / 4 + np.pi / 2 * np.arange(4))], axis=1
        )
        self._stands += [(*place, 0.4) for place in corners.tolist()]
        guards = np.concatenate([corners, places[stone]])
        feet = self._ground.on(guards)
        if self._detail.shows(0.3):
            yield "granite", lanterns.stone_lantern().placed(feet, rng.uniform(0, 2 * np.pi, len(feet)))
        self._light(np.add(feet, (0.0, lanterns.STONE_FLAME, 0.0)), 1.7, [MOON] * 4 + [CANDLE, MOON, AMBER, MOON])

    def in_shrine(self) -> Iterator[tuple[str, Patch]]:
        """Yields the lanterns under the shrine's roof: one at each corner and one in the middle of the front.

        Example:
            >>> from fovden.tracer.procedural.forest.ground import terrain
            >>> lighting = Lighting(0, terrain(0, Detail(0.2)), Detail())
            >>> len(list(lighting.in_shrine())), len(lighting.lights)
            (3, 5)
        """
        corner = shrine.ROOF_HALF - 0.22
        tops = np.array([(x, shrine.EAVES + 0.12, z) for x in (-corner, corner) for z in (-corner, corner)])
        tops = np.concatenate([tops, [(0.0, shrine.BEAM + 0.06, shrine.PILLAR)]])
        tops[-1, 2] += 0.02
        tops[-1, 1] = shrine.BEAM
        ends = tops - [0.0, 0.28, 0.0]
        ends[-1] = tops[-1] - [0.0, 0.12, 0.0]
        yield from self._hung(tops, ends, 1.0, 1.8, (AMBER, AMBER, AMBER, AMBER, CANDLE))

    def on_branches(self, trees: Sequence[Tree], avoided: Discs, *, deep: bool) -> Iterator[tuple[str, Patch]]:
        """Yields the lanterns that hang on cords from branches.

        Args:
            trees: The trees around the clearing, or those behind.
            avoided: Circles above which none hangs.
            deep: Whether it is the latter: those lanterns hang higher and are brighter, and light the wood.

        Example:
            >>> from fovden.tracer.procedural.forest.trees import Limbs
            >>> lighting = Lighting(0, Terrain(np.array([-9.0, 9.0]), np.zeros((2, 2))), Detail())
            >>> nowhere = Discs(np.zeros((0, 2)), np.zeros(0))
            >>> limb = Limbs(np.array([[[-6.0, 5.0, 0.0], [6.0, 5.0, 0.0]]] * 4), np.full((4, 2), 0.05))
            >>> hung = list(lighting.on_branches([Tree(None, (limb, limb))], nowhere, deep=False))
            >>> len(lighting.lights) == HANGING
            True
        """
        rng = generator(self._seed, "lanterns in the deep wood" if deep else "lanterns on branches")
        limbs = [tree.limbs[1] for tree in trees]
        everywhere = []
        for limb in limbs:
            count = len(limb.paths)
            share = np.tile(np.linspace(0.35, 0.8, 7), count)
            place, radius, _ = limb.at(np.repeat(np.arange(count), 7), share)
            everywhere.append(np.concatenate([place, radius[:, None]], axis=1))
        candidates = np.concatenate(everywhere)
        flat = candidates[:, [0, 2]]
        above = candidates[:, 1] - self._ground.height(flat)
        reach = np.hypot(*flat.T)
        lowest, highest, inner, outer = (4.5, 11.0, 9.0, 17.0) if deep else (3.3, 7.5, 2.6, 9.5)
        fits = (above > lowest) & (above < highest) & (reach > inner) & (reach < outer)
        fits &= (distance_to_trail(flat) > 0.9) & ~avoided.contain(flat)
        candidates, above = candidates[fits], above[fits]
        count = DEEP if deep else HANGING
        chosen = spread_out(rng, candidates[:, :3], count)
        tops = candidates[chosen, :3] - [0.0, 1.0, 0.0] * candidates[chosen, 3:]
        room = above[chosen] - 2.3
        drop = np.minimum(rng.uniform(0.3, 0.8, count) * room, 2.2 if deep else 3.2).astype(float)
        ends = tops - drop[:, None] * np.array([0.0, 1.0, 0.0])
        power, colours = (26.0, (CANDLE, AMBER, CANDLE, MOON)) if deep else (8.0, (CANDLE, AMBER, CANDLE, AMBER, MOON))
        yield from self._hung(tops, ends, HUNG_SCALE, power, colours)

    def in_wood(self, trunks: Discs) -> Iterator[tuple[str, Patch]]:
        """Yields the lanterns on stumps between the trees.

        Args:
            trunks: Where the trees stand.

        Example:
            >>> from fovden.tracer.procedural.forest.ground import terrain
            >>> lighting = Lighting(0, terrain(0, Detail(0.2)), Detail())
            >>> sorted({name for name, _ in lighting.in_wood(Discs(np.zeros((0, 2)), np.zeros(0)))})
            ['bark', 'end grain', 'iron', 'wax']
        """
        rng = generator(self._seed, "lanterns in the wood")
        places = rng.uniform(-14.5, 14.5, (1500, 2))
        reach = np.hypot(*places.T)
        free = (reach > CLEARING - 0.6) & (reach < 14.0) & (distance_to_trail(places) > 1.6)
        free &= ~trunks.contain(places, margin=0.7) & ~self.stands.contain(places, margin=0.6)
        places = places[free]
        places = places[spread_out(rng, places, STUMPS)]
        self._stands += [(*place, 0.5) for place in places.tolist()]
        heights, radii = rng.uniform(0.35, 0.8, STUMPS), rng.uniform(0.17, 0.26, STUMPS)
        feet = self._ground.on(places)
        if self._detail.shows(0.3):
            columns = self._detail.segments(18, least=6)
            made = [lanterns.stump(rng, *size, columns) for size in zip(radii, heights, strict=True)]
            for name, pieces in zip(("bark", "end grain"), zip(*made, strict=True), strict=True):
                yield name, join([piece.placed(foot) for piece, foot in zip(pieces, feet, strict=True)])
        tops = feet + np.stack([0 * heights, heights + 0.007, 0 * heights], axis=1)
        turns = rng.uniform(0, 2 * np.pi, STUMPS)
        yield from self._iron(tops, turns, 1.2, 8.0, (AMBER, CANDLE, AMBER, MOON), hanging=False)

    def _crooks(self, places: Array, turns: Array) -> Iterator[tuple[str, Patch]]:
        feet = self._ground.on(places)
        if self._detail.shows(0.3):
            yield "iron", lanterns.crook().placed(feet, turns)
        ends = feet + lanterns.CROOK_REACH * np.stack([np.sin(turns), 0 * turns, np.cos(turns)], axis=1)
        ends[:, 1] += lanterns.CROOK_RISE - lanterns.IRON_HEIGHT
        yield from self._iron(ends, turns, 1.0, 3.0, (CANDLE, AMBER, CANDLE), hanging=True)

    def _hung(
        self, tops: Array, ends: Array, scale: float, power: float, colours: Sequence[tuple[float, float, float]]
    ) -> Iterator[tuple[str, Patch]]:
        """Lanterns on cords from their upper ends to the lanterns' tops."""
        if self._detail.shows(0.3):
            yield "cord", join([lanterns.cord(top, end) for top, end in zip(tops, ends, strict=True)])
        feet = ends - [0.0, scale * lanterns.IRON_HEIGHT, 0.0]
        yield from self._iron(feet, 2.4 * np.arange(len(feet), dtype=np.float64), scale, power, colours, hanging=True)

    def _iron(
        self,
        feet: Array,
        turns: Array,
        scale: float,
        power: float,
        colours: Sequence[tuple[float, float, float]],
        *,
        hanging: bool,
    ) -> Iterator[tuple[str, Patch]]:
        if self._detail.shows(0.3):
            iron, wax = lanterns.iron_lantern(hanging=hanging)
            yield "iron", iron.placed(feet, turns, scale)
            yield "wax", wax.placed(feet, turns, scale)
        elif self._detail.shows(0.15):
            yield "iron", lanterns.far_lantern().placed(feet, turns, scale)
        flames = np.add(feet, (0.0, scale * lanterns.FLAME, 0.0))
        self._light(flames, power, [colours[i % len(colours)] for i in range(len(feet))])

    def _light(self, places: Array, power: float, colours: Sequence[tuple[float, float, float]]) -> None:
        for place, (red, green, blue) in zip(places.tolist(), colours, strict=True):
            self.lights.append(PointLight(tuple(place), (power * red, power * green, power * blue)))
