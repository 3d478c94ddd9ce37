"""The atrium: a colonnaded court of two storeys, the scene that comes with the library.

A court of 25.6 m by 6.4 m, open to the sky, lies inside a gallery of one bay's width on all four sides. Bays are
squares of 3.2 m. The ground floor has round arches on Corinthian columns and groin vaults behind them; the upper floor
has a balustrade, slender columns under a straight entablature and a coffered ceiling. It is made in the spirit of the
courtyard scenes that the field has long measured itself on, and has as many triangles and lights as the 2023 paper's
Sponza: 262,267, one directional and one point light (Table 2). Every triangle is detail that can be seen; the ivy
takes what the stone leaves over, four triangles a leaf and single ones for its buds.

The world's origin is the middle of the court's floor; x runs along the court, y up.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from torch import Tensor

from fovden.camera import StereoCamera
from fovden.tracer.lights import DirectionalLight, PointLight
from fovden.tracer.materials import Material
from fovden.tracer.procedural.atrium import furnishings
from fovden.tracer.procedural.atrium.court import court
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
from fovden.tracer.procedural.mesh_builder import MeshBuilder, Surface
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.primitives import tube
from fovden.tracer.procedural.textures import cloth, plants, stone, wood
from fovden.tracer.scene import Scene

__all__ = ["TRIANGLES", "atrium"]

TRIANGLES = 262_267
"""Triangles of the 2023 paper's Sponza (Table 2)."""

CLOTHS = ("crimson cloth", "blue cloth", "green cloth", "ochre cloth")

CURTAINS = {0.0: (1, 3, 5), np.pi: (2, 4, 6), QUARTER: (), -QUARTER: ()}
"""Bays with curtains, by the turn of their side."""

BANNERS = {0.0: (2, 4, 6), np.pi: (1, 3, 5), QUARTER: (), -QUARTER: (0, 1)}
"""Bays with a cloth over the balustrade, by the turn of their side."""

STRANDS, CLUSTER = 96, 6
"""Strands of ivy, and how many of them grow side by side."""

STEM_POINTS = 7
"""Points along a strand."""


def atrium(*, seed: int = 0, detail: int | None = None) -> Scene:
    """Returns the atrium, the library's default scene: 262,267 triangles, a sun and one point light.

    The sun is the directional light; a point light above the fountain reaches the shaded galleries. The camera stands
    at one end of the court at eye height and looks along it.

    Args:
        seed: For what is irregular: the textures, the folds of the cloths and the growth of the plants. The
            architecture, the lights and the number of triangles are the same for every seed.
        detail: Number of triangles, from 10^3 to 10^7; ``None`` for 262,267.

    Returns:
        The scene, within 33 m by 12 m by 13 m, with textures and smooth normals where surfaces are curved.

    Source: numbers of triangles and lights from the 2023 paper, Table 2. Cost: under 3 s.

    Example:
        >>> scene = atrium()
        >>> scene.triangle_count, len(scene.lights)
        (262267, 2)
    """
    rng = np.random.default_rng(seed)
    builder = MeshBuilder(_surfaces(rng))
    for surface, patch in (*court(), *_drapery(rng), *_plants(rng)):
        builder.add(surface, patch)
    _grow_ivy(builder, rng)
    camera = StereoCamera.look_at((-11.9, 1.9, -0.55), (0.0, 2.75, 0.1), fov_x_deg=78)
    sun = DirectionalLight((0.15, -1.0, 0.25), (11.6, 11.0, 10.1))
    lamp = PointLight((-4.8, 4.3, -0.7), (50.0, 47.0, 42.0))
    return builder.scene(name="atrium", camera=camera, lights=(sun, lamp))


def _surfaces(rng: np.random.Generator) -> dict[str, Surface]:
    white = (1.0, 1.0, 1.0)

    def textured(name: str, image: Tensor, tile: float) -> Surface:
        return Surface(Material(name, white, texture=image), tile)

    gold = (0.80, 0.67, 0.40)
    grounds = [(0.58, 0.17, 0.16), (0.23, 0.33, 0.55), (0.26, 0.44, 0.28), (0.74, 0.53, 0.26)]
    figures = [gold, (0.72, 0.72, 0.66), gold, (0.55, 0.24, 0.16)]
    cloths = [
        textured(name, cloth.damask(rng, ground, figure), 0.5)
        for name, ground, figure in zip(CLOTHS, grounds, figures, strict=True)
    ]
    surfaces = [
        textured("ashlar", stone.ashlar(rng, (0.75, 0.69, 0.58), (0.57, 0.52, 0.44)), 1.6),
        textured("plaster", stone.plaster(rng, (0.85, 0.80, 0.70), (0.72, 0.62, 0.50)), 3.0),
        textured("trim", stone.marble(rng, (0.80, 0.75, 0.66), (0.68, 0.61, 0.52)), 1.3),
        textured("column marble", stone.marble(rng, (0.82, 0.78, 0.71), (0.58, 0.50, 0.45)), 1.1),
        textured("pale slab", stone.marble(rng, (0.79, 0.75, 0.67), (0.60, 0.55, 0.50)), 1.7),
        textured("dark slab", stone.marble(rng, (0.60, 0.48, 0.43), (0.76, 0.69, 0.62)), 1.9),
        textured("inlaid slab", stone.inlay(rng, (0.79, 0.75, 0.67), (0.62, 0.36, 0.28), (0.45, 0.47, 0.45)), 0.8),
        textured("oak", wood.planks(rng, (0.68, 0.54, 0.39), (0.53, 0.39, 0.27)), 0.8),
        textured("terracotta", stone.terracotta(rng, (0.75, 0.50, 0.38)), 0.6),
        textured("ivy", plants.leaf(rng, (0.40, 0.55, 0.26), (0.60, 0.68, 0.42)), 1.0),
        textured("agave", plants.leaf(rng, (0.50, 0.62, 0.44), (0.66, 0.72, 0.52)), 1.0),
        Surface(Material("stem", (0.22, 0.16, 0.09))),
        Surface(Material("earth", (0.20, 0.14, 0.10))),
        Surface(Material("bronze", (0.34, 0.25, 0.13))),
        Surface(Material("water", (0.25, 0.38, 0.38))),
        *cloths,
    ]
    return {surface.material.name: surface for surface in surfaces}


def _drapery(rng: np.random.Generator) -> Iterator[tuple[str, Patch]]:
    """Curtains in some of the arches, and cloths over the balustrade."""
    rod = tube([(-1.34, 0, 0), (1.34, 0, 0)], 0.018, 6)
    mirror = np.diag([-1.0, 1.0, 1.0])
    over_rail = [(-0.17, 5.80), (-0.17, 6.15), (-0.12, 6.205), (0.12, 6.205), (0.18, 6.13)]
    over_rail += [(0.34, 5.74), (0.60, 5.34), (0.625, 5.2), (0.625, 4.6), (0.625, 3.95)]
    colour = 0
    for turn in (*LONG_TURNS, *SHORT_TURNS):
        bays, distance = (LONG, HALF_Z) if turn in LONG_TURNS else (SHORT, HALF_X)
        x = bay_middles(bays)
        for i in CURTAINS[turn]:
            halves = [furnishings.curtain(rng, 1.22, 3.06, tie=1.3) for _ in range(2)]
            pair = join([halves[0], halves[1].transformed(mirror)]).placed((0, 0.04, 0))
            yield CLOTHS[colour % 4], pair.placed((x[i], 0, -distance)).placed(turns=turn)
            yield "bronze", rod.placed((x[i], 3.1, -distance)).placed(turns=turn)
            colour += 1
        for i in BANNERS[turn]:
            cloth = furnishings.banner(rng, 1.5, over_rail)
            yield CLOTHS[(colour + 2) % 4], cloth.placed((x[i], 0, -distance)).placed(turns=turn)
            colour += 1


def _plants(rng: np.random.Generator) -> Iterator[tuple[str, Patch]]:
    """Vases with agaves in the court."""
    places = [(x, 0.0, side * 2.35) for x in (-2 * BAY, 0.0, 2 * BAY) for side in (-1, 1)]
    places += [(HALF_X - 1.0, 0.0, side * 2.25) for side in (-1, 1)]
    body, earth = furnishings.vase()
    turns = 0.4 * rng.standard_normal(len(places))
    yield "terracotta", body.placed(places, turns)
    yield "earth", earth.placed(places, turns)
    for place in places:
        yield "agave", furnishings.agave(rng).placed((0, 0.85, 0)).placed(place)


def _grow_ivy(builder: MeshBuilder, rng: np.random.Generator) -> None:
    """Hangs ivy from the lower cornice and spends exactly the triangles that are left on its leaves and buds.

    Strands hang in clusters from the cornice's lip, each a stem with leaves on alternating sides. What does not make
    a leaf of four triangles becomes buds of one, at the ends of the first strands.
    """
    turns = rng.choice([*LONG_TURNS, *LONG_TURNS, *LONG_TURNS, *SHORT_TURNS], STRANDS // CLUSTER)
    turns = np.repeat(turns, CLUSTER)
    half = np.where(np.isin(turns, LONG_TURNS), HALF_X, HALF_Z) - 0.9
    distance = np.where(np.isin(turns, LONG_TURNS), HALF_Z, HALF_X)
    cluster = np.repeat(rng.uniform(-1, 1, STRANDS // CLUSTER), CLUSTER) * half
    x = np.clip(cluster + 0.35 * rng.standard_normal(STRANDS), -half, half)
    length = 0.5 + 1.7 * rng.random(STRANDS) ** 1.5
    down = np.linspace(0, 1, STEM_POINTS)
    swing = 0.06 * np.sin(3.0 * down + 2 * np.pi * rng.random((STRANDS, 1))) * down
    local_x = x[:, None] + swing
    local_y = UPPER_FLOOR + 0.02 - length[:, None] * down
    local_z = -distance[:, None] + HALF_WALL + 0.38 + 0.05 * rng.random((STRANDS, 1)) + 0.5 * swing
    cosine, sine = np.cos(turns)[:, None], np.sin(turns)[:, None]
    stems = np.stack([cosine * local_x + sine * local_z, local_y, -sine * local_x + cosine * local_z], axis=-1)
    thickness = np.linspace(0.006, 0.002, STEM_POINTS)
    builder.add("stem", *(tube(stem, thickness, 3) for stem in stems))

    left_over = TRIANGLES - builder.triangle_count
    leaves, buds = divmod(left_over, furnishings.LEAF_TRIANGLES)
    place = (np.arange(leaves) + 0.5) / leaves * length.sum()
    ends = np.cumsum(length)
    strand = np.minimum(np.searchsorted(ends, place), STRANDS - 1)
    share = (place - (ends - length)[strand]) / length[strand] * (STEM_POINTS - 1)
    lower = np.clip(share.astype(int), 0, STEM_POINTS - 2)
    within = (share - lower)[:, None]
    roots = (1 - within) * stems[strand, lower] + within * stems[strand, lower + 1]
    facing = turns[strand] + np.where(np.arange(leaves) % 2, 0.9, -0.9) + 0.5 * rng.standard_normal(leaves)
    roots += 0.03 * np.stack([np.sin(facing), 0.3 * rng.standard_normal(leaves), np.cos(facing)], axis=1)
    tilts = -0.5 + 0.35 * rng.standard_normal(leaves)
    sizes = (0.115 - 0.05 * share / (STEM_POINTS - 1)) * (0.75 + 0.5 * rng.random(leaves))
    builder.add("ivy", furnishings.ivy_leaves(roots, facing, tilts, sizes))
    builder.add("ivy", *(furnishings.ivy_bud(stems[i, -1], turns[i], 0.05) for i in range(buds)))
