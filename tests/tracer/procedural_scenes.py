"""The procedural scenes, built once for all tests, and what a test must know of each that it cannot see in the mesh.

A new scene needs one entry in ``FACTS``; every check in ``test_procedural_soundness``, ``test_procedural_views`` and
``test_procedural_detail`` then holds it to the same standard as the others.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from fovden.tracer import DirectionalLight, PointLight, Scene
from fovden.tracer.procedural import SCENES, make_scene

Starts = Callable[[np.random.Generator, int], np.ndarray]


@dataclass(frozen=True)
class SceneFacts:
    """What a scene's author knows of it.

    Attributes:
        triangles: Its own number of triangles.
        lights: Its number of lights of each kind.
        sheets: Materials of thin things that are seen from both sides: cloth, leaves, blades of grass. All others
            must show their fronts.
        volume: Draws at most as many points of free space as asked for, shape (k, 3); ``None`` where the cameras and
            the path see everything. Points inside solids would see backs, so keep clear of them.
        open_above: Height above which undersides are bare, as those of eaves, metres.
    """

    triangles: int = 0
    lights: Mapping[type, int] = field(default_factory=dict)
    sheets: frozenset[str] = frozenset()
    volume: Starts | None = None
    open_above: float = np.inf


def _atrium_volume(rng: np.random.Generator, count: int) -> np.ndarray:
    """Court and galleries, clear of columns, pilasters, walls, ceilings and the fountain."""
    points = rng.uniform((-15.3, 0.3, -5.9), (15.3, 8.5, 5.9), (count, 3))
    x, y, z = np.abs(points).T
    clear_of_columns = (np.abs(z - 3.2) > 0.7) & (np.abs(x - 12.8) > 0.7)
    clear_of_vaults = (y < 3.2) | (y > 5.5) | ((z < 2.0) & (x < 12.0))
    return points[clear_of_columns & clear_of_vaults & (np.hypot(x, z) > 1.5)]


def _pink_room_volume(rng: np.random.Generator, count: int) -> np.ndarray:
    """Between the furniture's tops and the chandelier, clear of walls, bookcase, curtains, plant and lamps."""
    return rng.uniform((-1.9, 1.3, -1.7), (2.7, 1.9, 2.4), (count, 3))


FACTS = {
    "atrium": SceneFacts(
        triangles=262_267,
        lights={DirectionalLight: 1, PointLight: 1},
        sheets=frozenset({"crimson cloth", "blue cloth", "green cloth", "ochre cloth", "ivy", "agave", "stem"}),
        volume=_atrium_volume,
        open_above=9.8,
    ),
    "pink_room": SceneFacts(
        triangles=786_056,
        lights={DirectionalLight: 1, PointLight: 2},
        sheets=frozenset(
            {"curtain", "valance", "tablecloth", "quilt", "shade", "wool", "pink wool", "carpet", "leaf", "stem"}
            | {"petal", "red petal", "white petal", "willow"}
        ),
        volume=_pink_room_volume,
    ),
    "forest": SceneFacts(
        triangles=198_541,
        lights={PointLight: 80},
        sheets=frozenset({"oak leaf", "ash leaf", "dead leaf", "needles", "fern", "grass"}),
    ),
}

WHOLE_SCENES = [name for name in SCENES if name in FACTS]
"""Scenes that exist and are held to what FACTS says; the Cornell box is a chart, not a place to walk through."""


def facts(scene: Scene) -> SceneFacts:
    """What is known of the scene; nothing of those that tests make themselves."""
    return FACTS.get(scene.name, SceneFacts())


@cache
def built(name: str) -> Scene:
    return make_scene(name)


def atrium() -> Scene:
    return built("atrium")


def cornell_box() -> Scene:
    return built("cornell_box")


def corners(scene: Scene) -> np.ndarray:
    """Positions of the triangles' corners in float64, shape (m, 3, 3)."""
    return scene.vertices.numpy().astype(np.float64)[scene.faces.numpy()]


def face_normals(triangles: np.ndarray) -> np.ndarray:
    """Normals of the triangles, twice their area long."""
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def unit_normals(triangles: np.ndarray) -> np.ndarray:
    normals = face_normals(triangles)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def camera_eyes(scene: Scene) -> np.ndarray:
    """Both eyes of the default camera and of every other view, shape (k, 3)."""
    cameras = [scene.view(), *scene.views.values()]
    return np.concatenate([camera.views.origin.numpy() for camera in cameras]).astype(np.float64)


def path_eyes(scene: Scene, step: int = 10) -> np.ndarray:
    """Both eyes of every ``step``-th frame of the path, shape (k, 3)."""
    if scene.path is None:
        return np.zeros((0, 3))
    cameras = [scene.path[frame] for frame in range(0, len(scene.path), step)]
    return np.concatenate([camera.views.origin.numpy() for camera in cameras]).astype(np.float64)


def starts(scene: Scene, rng: np.random.Generator, count: int) -> np.ndarray:
    """Places in free space: around the eyes by up to 3 cm in each direction, half of them in the scene's volume."""
    eyes = np.concatenate([camera_eyes(scene), path_eyes(scene)])
    volume = facts(scene).volume
    inside = np.zeros((0, 3)) if volume is None else volume(rng, count // 2)
    around = eyes[rng.integers(len(eyes), size=count - len(inside))]
    return np.concatenate([inside, around + rng.uniform(-0.03, 0.03, around.shape)])


def directions_all_around(rng: np.random.Generator, count: int) -> np.ndarray:
    directions = rng.standard_normal((count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def is_sheet(scene: Scene, prim: np.ndarray) -> np.ndarray:
    """Whether triangles may be seen from behind."""
    known = facts(scene)
    names = np.array(scene.materials.names)[scene.material_ids.numpy()[prim]]
    height = scene.vertices.numpy()[scene.faces.numpy()[prim]].mean(axis=1)[:, 1]
    return np.isin(names, sorted(known.sheets)) | (height > known.open_above)
