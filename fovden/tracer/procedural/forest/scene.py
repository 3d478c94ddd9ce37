"""The forest: a clearing at night, lit by eighty lanterns.

A trail of flat stones winds from the wood past a small shrine and on between the trees. Broad-leaved trees stand around
the clearing, shrubs and more trees behind them, and spruces close the view. It has as many triangles and lights as the
2023 paper's Forest: 198,541, and 80 point lights (Table 2). Every triangle is detail that can be seen; leaves and grass
take what the rest leaves over, and single blades the last ones.

The world's origin is the middle of the clearing, where the shrine stands; y is up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fovden.camera import StereoCamera
from fovden.tracer.procedural.detail import Detail, fitted, require_detail
from fovden.tracer.procedural.forest.floor import furnish_floor
from fovden.tracer.procedural.forest.foliage import grow_foliage
from fovden.tracer.procedural.forest.ground import Discs, Terrain, terrain, trail_stones
from fovden.tracer.procedural.forest.lighting import Lighting
from fovden.tracer.procedural.forest.plan import APPROACH, PLINTH
from fovden.tracer.procedural.forest.shrine import shrine
from fovden.tracer.procedural.forest.surfaces import surfaces
from fovden.tracer.procedural.forest.wood import Wood, plant_wood
from fovden.tracer.procedural.mesh_builder import MeshBuilder
from fovden.tracer.procedural.patch import Patch
from fovden.tracer.scene import Scene
from fovden.tracer.trajectory import CameraPath, Keyframe

__all__ = ["TRIANGLES", "forest"]

TRIANGLES = 198_541
"""Triangles of the 2023 paper's Forest (Table 2)."""

SOLID = 0.68
"""Largest share of the triangles that all but leaves and grass may take."""

WALK = (
    (0, (2.75, 8.7), (0.0, 1.5, 0.0)),
    (150, (2.0, 6.9), (0.0, 1.5, 0.0)),
    (320, (1.0, 5.2), (-0.1, 1.5, 0.0)),
    (480, (-0.8, 3.85), (-0.1, 1.45, 0.0)),
    (620, (-2.6, 2.3), (-0.6, 1.45, -0.6)),
    (760, (-3.45, -0.2), (-1.6, 1.5, -3.6)),
    (880, (-3.2, -2.6), (-4.0, 1.6, -7.5)),
    (999, (-3.5, -4.9), (-6.2, 1.7, -10.5)),
)
"""Frames of the walk, where the eye is then (x, z), and what it looks at, metres above the ground's zero."""

EYE_HEIGHT = 1.65


def forest(*, seed: int = 0, detail: int | None = None) -> Scene:
    """Returns a clearing in a forest at night: 198,541 triangles, 80 point lights in lanterns.

    Lanterns hang from branches and from the shrine's roof, and stand along the trail and between the trees; three in
    four are warm, the others cool. There is no other light. The camera stands on the trail and looks at the shrine.

    Args:
        seed: For what is irregular: the ground, where and how everything grows, the textures. The shrine, the trail,
            and the numbers of triangles and lights are the same for every seed.
        detail: Number of triangles, from 10^3 to 10^7; ``None`` for 198,541.

    Returns:
        The scene, within 46 m by 46 m by 26 m.

    Source: numbers of triangles and lights from the 2023 paper, Table 2. Cost: under 4 s.

    Example:
        >>> scene = forest(detail=5_000)
        >>> scene.triangle_count, len(scene.lights), len(scene.path)
        (5000, 80, 1000)
    """
    triangles = require_detail(detail, TRIANGLES)
    drawn = terrain(seed, Detail())
    grown = fitted(
        lambda fineness: _grown(seed, drawn, fineness),
        lambda made: made.triangle_count,
        triangles,
        TRIANGLES,
        most=SOLID,
    )
    builder = MeshBuilder(surfaces(seed))
    for surface, patch in grown.parts:
        builder.add(surface, patch)
    for surface, patch in grow_foliage(seed, grown.ground, grown.wood, grown.taken, triangles - builder.triangle_count):
        builder.add(surface, patch)

    camera = _camera(drawn, (2.5, 8.1), (0.5, 1.2, 2.5))
    return builder.scene(
        name="forest",
        camera=camera,
        lights=tuple(grown.lighting.lights),
        views={
            "path": _camera(drawn, (-3.2, -2.4), (-4.3, 1.15, -7.0)),
            "shrine": _camera(drawn, (-3.3, 1.05), (0.0, 1.5, 0.0)),
        },
        path=_walk(camera, drawn),
    )


@dataclass(frozen=True)
class _Grown:
    """Everything but leaves and grass."""

    parts: list[tuple[str, Patch]]
    ground: Terrain
    wood: Wood
    lighting: Lighting
    taken: Discs

    @property
    def triangle_count(self) -> int:
        return sum(patch.triangle_count for _, patch in self.parts)


def _grown(seed: int, drawn: Terrain, detail: Detail) -> _Grown:
    ground = terrain(seed, detail)
    wood = plant_wood(seed, drawn, ground, detail)
    lighting = Lighting(seed, drawn, detail)
    parts = [("bark", wood.bark), ("spruce bark", wood.spruce_bark), ("needles", wood.needles), *shrine(detail)]
    for lanterns in (
        lighting.along_trail(),
        lighting.in_shrine(),
        lighting.on_branches(wood.near, wood.spread, deep=False),
        lighting.on_branches(wood.far, wood.spread, deep=True),
        lighting.in_wood(wood.trunks),
    ):
        parts += list(lanterns)
    plinth = Discs(np.zeros((1, 2)), np.array([PLINTH]))
    taken = _together(plinth, Discs(APPROACH, np.full(len(APPROACH), 0.4)), wood.trunks, lighting.stands)
    furnishings, stones, taken = furnish_floor(seed, ground, detail, taken)
    slabs, trodden = trail_stones(seed, ground, detail)
    parts += [*furnishings, ("trail stone", slabs)]
    hidden = _together(Discs(plinth.centres, plinth.radii - 0.25), stones, trodden)
    parts.append(("floor", ground.patch(hidden)))
    return _Grown(parts, ground, wood, lighting, _together(taken, trodden))


def _together(*discs: Discs) -> Discs:
    return Discs(np.concatenate([one.centres for one in discs]), np.concatenate([one.radii for one in discs]))


def _camera(ground: Terrain, place: tuple[float, float], target: tuple[float, float, float]) -> StereoCamera:
    x, y, z = ground.on(np.array(place), above=EYE_HEIGHT).tolist()
    return StereoCamera.look_at((x, y, z), target, fov_x_deg=75)


def _walk(camera: StereoCamera, ground: Terrain) -> CameraPath:
    keys = []
    for frame, place, target in WALK:
        x, y, z = ground.on(np.array(place), above=EYE_HEIGHT).tolist()
        keys.append(Keyframe(frame, (x, y, z), target))
    return CameraPath(camera, tuple(keys))
