"""The atrium: a colonnaded court of two storeys, the scene that comes with the library.

A court of 25.6 m by 6.4 m, open to the sky, lies inside a gallery of one bay's width on all four sides. Bays are
squares of 3.2 m. The ground floor has round arches on Corinthian columns and groin vaults behind them; the upper floor
has a balustrade, slender columns under a straight entablature and a coffered ceiling. It is made in the spirit of the
courtyard scenes that the field has long measured itself on, and has as many triangles and lights as the 2023 paper's
Sponza: 262,267, one directional and one point light (Table 2). Every triangle is detail that can be seen; the ivy
takes what the stone leaves over, four triangles a leaf and single ones for its buds.

With another number of triangles it is the same place, coarser or finer. From ten million down, curves lose segments;
below some fineness flutes, carved leaves, dentils, coffers, slabs and mouldings go, then windows, vaults, balusters and
capitals, until a thousand triangles show piers, arches, floors, walls and ceilings with a little ivy.

The world's origin is the middle of the court's floor; x runs along the court, y up.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy

import numpy as np
from torch import Tensor

from fovden.tracer.lights import DirectionalLight, PointLight
from fovden.tracer.materials import Material
from fovden.tracer.procedural.atrium.court import court
from fovden.tracer.procedural.atrium.dressing import CLOTHS, Ivy, drapery, plants
from fovden.tracer.procedural.atrium.views import CAMERA, PATH, VIEWS
from fovden.tracer.procedural.detail import Detail, fitted, require_detail
from fovden.tracer.procedural.mesh_builder import MeshBuilder, Surface
from fovden.tracer.procedural.patch import Patch
from fovden.tracer.procedural.textures import cloth, stone, wood
from fovden.tracer.procedural.textures import plants as leaves
from fovden.tracer.scene import Scene

__all__ = ["TRIANGLES", "atrium"]

TRIANGLES = 262_267
"""Triangles of the 2023 paper's Sponza (Table 2)."""

DRESSING = 51_379
"""How many of them are not the architecture's; the ivy's leaves take what cloths, vases and stems leave over."""


def atrium(*, seed: int = 0, detail: int | None = None) -> Scene:
    """Returns the atrium, the library's default scene: 262,267 triangles, a sun and one point light.

    The sun is the directional light; a point light in the court reaches the shaded galleries. The camera stands at one
    end of the court at eye height and looks along it; other views are ``"gallery"`` and ``"balcony"``, and the path
    leads through court and galleries.

    Args:
        seed: For what is irregular: the textures, the folds of the cloths and the growth of the plants. The
            architecture, the lights and the number of triangles are the same for every seed.
        detail: Number of triangles, from 10^3 to 10^7, met exactly; ``None`` for 262,267. Textures, lights and views
            do not depend on it.

    Returns:
        The scene, within 33 m by 12 m by 13 m, with textures and smooth normals where surfaces are curved.

    Source: numbers of triangles and lights from the 2023 paper, Table 2. Cost: under 3 s; 15 s and 2.5 GB
    of memory for 10^7 triangles.

    Example:
        >>> scene = atrium()
        >>> scene.triangle_count, len(scene.lights)
        (262267, 2)
        >>> atrium(detail=1000).triangle_count, sorted(scene.views), len(scene.path)
        (1000, ['balcony', 'gallery'], 1000)
    """
    triangles = require_detail(detail, TRIANGLES)
    rng = np.random.default_rng(seed)
    builder = MeshBuilder(_surfaces(rng))
    architecture = fitted(lambda fineness: list(court(fineness)), _count, triangles, TRIANGLES, most=0.87)
    left = triangles - _count(architecture)
    dressing = fitted(lambda fineness: _Dressing(deepcopy(rng), fineness), _Dressing.count, left, DRESSING, most=0.73)
    for surface, patch in (*architecture, *dressing.parts, *dressing.leaves(left)):
        builder.add(surface, patch)
    sun = DirectionalLight((0.15, -1.0, 0.25), (11.6, 11.0, 10.1))
    lamp = PointLight((-4.8, 4.3, -0.7), (50.0, 47.0, 42.0))
    return builder.scene(name="atrium", camera=CAMERA, lights=(sun, lamp), views=VIEWS, path=PATH)


class _Dressing:
    """Cloths, plants and the stems of the ivy, and the state of chance in which its leaves grow."""

    def __init__(self, rng: np.random.Generator, detail: Detail) -> None:
        self.parts = [*drapery(rng, detail), *plants(rng, detail)]
        self.ivy = Ivy.grown(rng, detail)
        self.parts += self.ivy.stems()
        self.rng = rng

    def count(self) -> int:
        return _count(self.parts)

    def leaves(self, triangles: int) -> Iterator[tuple[str, Patch]]:
        """Leaves and buds that bring the dressing to so many triangles."""
        return self.ivy.foliage(self.rng, triangles - self.count())


def _count(parts: list[tuple[str, Patch]]) -> int:
    return sum(patch.triangle_count for _, patch in parts)


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
        textured("ivy", leaves.leaf(rng, (0.40, 0.55, 0.26), (0.60, 0.68, 0.42)), 1.0),
        textured("agave", leaves.leaf(rng, (0.50, 0.62, 0.44), (0.66, 0.72, 0.52)), 1.0),
        Surface(Material("stem", (0.22, 0.16, 0.09))),
        Surface(Material("earth", (0.20, 0.14, 0.10))),
        Surface(Material("bronze", (0.34, 0.25, 0.13))),
        Surface(Material("water", (0.25, 0.38, 0.38))),
        *cloths,
    ]
    return {surface.material.name: surface for surface in surfaces}
