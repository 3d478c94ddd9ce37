"""The meshes of the procedural scenes are sound, and the checks that say so find what is not."""

import numpy as np
import pytest
import soundness
from procedural_scenes import WHOLE_SCENES, built

from fovden.camera import StereoCamera
from fovden.tracer import Material, Scene
from fovden.tracer.procedural import SCENES
from fovden.tracer.procedural.mesh_builder import MeshBuilder, Surface
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.primitives import box, grid, lathe, quad

every_scene = pytest.mark.parametrize("name", SCENES)
whole_scene = pytest.mark.parametrize("name", WHOLE_SCENES)


@every_scene
def test_records_are_sound(name):
    soundness.check_records(built(name))
    soundness.check_materials_are_used(built(name))


@every_scene
def test_no_triangle_is_degenerate(name):
    soundness.check_not_degenerate(built(name))


@every_scene
def test_no_triangle_is_there_twice(name):
    soundness.check_nothing_is_there_twice(built(name))


@every_scene
def test_no_flat_part_is_split_needlessly(name):
    soundness.check_not_split_needlessly(built(name))


@whole_scene
def test_shading_normals_are_on_the_side_of_the_geometric_ones(name):
    soundness.check_shading_normals(built(name))


@whole_scene
def test_no_triangle_is_buried(name):
    soundness.check_nothing_is_buried(built(name))


@whole_scene
def test_triangles_face_the_side_that_can_be_seen(name):
    soundness.check_fronts_are_seen(built(name))


@whole_scene
def test_no_surface_lies_upon_another(name):
    soundness.check_nothing_lies_upon_another(built(name))


def test_needless_vertices_are_found():
    flat = np.stack([*np.meshgrid(np.arange(3.0), np.arange(3.0)), np.zeros((3, 3))], axis=-1)
    patch = grid(flat)
    found = soundness.needless_vertices(patch.vertices[patch.faces], np.zeros(len(patch.faces)))
    assert set(patch.faces[found].tolist()) == {1, 3, 4, 5, 7}, "all but the four corners"
    flat[1, 1, 2] = 0.2
    patch = grid(flat)
    found = soundness.needless_vertices(patch.vertices[patch.faces], np.zeros(len(patch.faces)))
    assert not found.any(), "a raised middle makes the others needed too"


def room_with(*patches: Patch) -> Scene:
    """A sound ball in a room of 8 m, and what is added to it."""
    builder = MeshBuilder({"stone": Surface(Material("stone", (0.5, 0.5, 0.5)))})
    angle = np.linspace(-np.pi / 2, np.pi / 2, 33)
    builder.add("stone", lathe(np.stack([np.cos(angle), np.sin(angle)], axis=1), 64).placed((0, 1.5, 0)))
    builder.add("stone", box((8, 8, 8)).reversed().placed((0, -4, 0)), *patches)
    camera = StereoCamera.look_at((0, 1.5, 3), (0, 1.5, 0), fov_y_deg=60)
    return builder.scene(name="room", camera=camera)


SPECK = quad((2, 0, 0), (2.0005, 0, 0), (2.0005, 0.0005, 0), (2, 0.0005, 0))
FLOOR_AGAIN = box((8, 8, 8), "-y").reversed().placed((0, -4, 0))
SPLIT_PLATE = grid(np.stack([*np.meshgrid([2.0, 2.5, 3.0], [0.0, 0.5, 1.0]), np.zeros((3, 3))], axis=-1))
BOX_IN_BOX = join([box((0.014, 0.014, 0.014)), box((0.01, 0.01, 0.01)).placed((0, 0.002, 0))]).placed((2, 0, 2))
INSIDE_OUT = box((1, 1, 1)).reversed().placed((3, -3, 0))
CARPET = quad((-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)).placed((0, -3.9998, 0))


@pytest.mark.parametrize(
    ("check", "fault"),
    [
        (soundness.check_not_degenerate, SPECK),
        (soundness.check_nothing_is_there_twice, FLOOR_AGAIN),
        (soundness.check_not_split_needlessly, SPLIT_PLATE),
        (soundness.check_nothing_is_buried, BOX_IN_BOX),
        (soundness.check_fronts_are_seen, INSIDE_OUT),
        (soundness.check_nothing_lies_upon_another, CARPET),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_checks_find_faults(check, fault):
    check(room_with())
    with pytest.raises(AssertionError):
        check(room_with(fault))
