"""The procedural scenes, built once for all tests, and what their meshes are measured with."""

from functools import cache

import numpy as np

from fovden.tracer import Scene
from fovden.tracer.procedural import make_scene


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
