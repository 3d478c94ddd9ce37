"""The pink room: a furnished sitting room in the afternoon sun.

The room measures 6.0 m by 5.2 m by 3.0 m. The sun comes in through the window of the left wall and falls on floor, rug
and table; the lamp beside the sofa and the chandelier each have a point light in a shade that is open at top and
bottom. It has as many triangles and lights as the 2023 paper's Pink Room (Table 2): 786,056, one directional and two
point lights. Every triangle is detail that can be seen; the rug's pile takes what the rest leaves over.

The world's origin is the middle of the floor; x runs along the back wall, y up.
"""

from __future__ import annotations

import numpy as np

from fovden.camera import StereoCamera
from fovden.tracer.lights import DirectionalLight, PointLight
from fovden.tracer.procedural.detail import Detail, fitted, require_detail
from fovden.tracer.procedural.mesh_builder import MeshBuilder
from fovden.tracer.procedural.patch import Patch
from fovden.tracer.procedural.pink_room import wool
from fovden.tracer.procedural.pink_room.furnishing import furnish
from fovden.tracer.procedural.pink_room.plan import CHANDELIER_LIGHT, LAMP_LIGHT
from fovden.tracer.procedural.pink_room.surfaces import surfaces
from fovden.tracer.scene import Scene
from fovden.tracer.trajectory import CameraPath, Keyframe

__all__ = ["TRIANGLES", "pink_room"]

TRIANGLES = 786_056
"""Triangles of the 2023 paper's Pink Room (Table 2)."""

KEYFRAMES = (
    Keyframe(0, (2.30, 1.55, 2.10), (-0.7, 0.85, -1.0)),
    Keyframe(140, (1.30, 1.50, 1.75), (-1.0, 0.90, -1.6)),
    Keyframe(290, (0.10, 1.45, 1.60), (-1.9, 0.95, -0.6)),
    Keyframe(430, (-0.60, 1.45, 0.95), (-2.6, 1.20, -0.9)),
    Keyframe(560, (0.10, 1.45, 0.30), (-1.4, 0.95, -2.5)),
    Keyframe(680, (0.95, 1.45, -0.35), (0.6, 1.00, -2.4)),
    Keyframe(790, (1.45, 1.45, -0.55), (1.9, 1.15, -2.6)),
    Keyframe(900, (1.55, 1.50, 0.20), (2.6, 0.75, -1.6)),
    Keyframe(999, (1.35, 1.55, 1.00), (0.2, 0.95, -2.2)),
)
"""A slow walk: from the corner past armchair and window to the sofa, the lamp and the books, and back."""


def pink_room(*, seed: int = 0, detail: int | None = None) -> Scene:
    """Returns a furnished sitting room: 786,056 triangles, a sun and two point lights.

    Args:
        seed: For what is irregular: the textures, folds, books, flowers and the rug's pile. Walls, furniture and lights
            are the same for every seed, and so is the number of triangles.
        detail: Number of triangles, from 10^3 to 10^7; ``None`` for 786,056.

    Returns:
        The scene, with textures, smooth normals where surfaces are curved, views ``"sofa"`` and ``"window"`` and a path
        of 1000 frames.

    Source: numbers of triangles and lights from the 2023 paper, Table 2.

    Example:
        >>> scene = pink_room(detail=5000)
        >>> scene.triangle_count, len(scene.lights), len(scene.path)
        (5000, 3, 1000)
    """
    triangles = require_detail(detail, TRIANGLES)
    made = surfaces(np.random.default_rng(seed))

    def furnished(fineness: Detail) -> list[tuple[str, Patch]]:
        return list(furnish(np.random.default_rng([seed, 1]), fineness))

    pieces = fitted(furnished, _triangle_count, triangles, TRIANGLES)
    pieces.append(("carpet", wool.rug(np.random.default_rng([seed, 2]), triangles - _triangle_count(pieces))))
    used = {surface for surface, _ in pieces}
    builder = MeshBuilder({name: surface for name, surface in made.items() if name in used})
    for surface, patch in pieces:
        builder.add(surface, patch)
    camera = StereoCamera.look_at((2.35, 1.55, 2.15), (-0.72, 0.74, -1.0), fov_x_deg=75)
    views = {
        "sofa": StereoCamera.look_at((0.9, 1.25, 0.6), (-1.1, 0.75, -2.4), fov_x_deg=70),
        "window": StereoCamera.look_at((0.4, 1.45, 1.0), (-3.0, 1.35, -0.6), fov_x_deg=70),
    }
    sun = DirectionalLight((0.80, -0.62, 0.20), (32.0, 28.0, 22.5))
    lights = (sun, PointLight(LAMP_LIGHT, (4.2, 3.5, 2.6)), PointLight(CHANDELIER_LIGHT, (9.0, 8.1, 6.8)))
    path = CameraPath(camera, KEYFRAMES)
    return builder.scene(name="pink_room", camera=camera, lights=lights, views=views, path=path)


def _triangle_count(pieces: list[tuple[str, Patch]]) -> int:
    return sum(patch.triangle_count for _, patch in pieces)
