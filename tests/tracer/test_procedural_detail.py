"""Scenes with another number of triangles: met exactly, and as sound as the scenes at their own."""

import time

import pytest
import soundness
import torch
from procedural_scenes import FACTS, WHOLE_SCENES, built

from fovden.tracer import Scene
from fovden.tracer.procedural import make_scene

COUNTS = (1_000, 20_000, 300_000)

SEEN_THROUGH = 20_000
"""Greatest number of triangles with which the checks that shoot rays run every time; see the slow test for more."""


def check(scene: Scene, *, with_rays: bool) -> None:
    soundness.check_records(scene)
    soundness.check_shading_normals(scene, least=0.98)  # folds of few triangles are sharp
    # At 10^7 triangles are about forty times as small as drawn, and still ten times the rounding of float32 high.
    soundness.check_not_degenerate(scene, least_area=2e-8, least_height=2e-5)
    soundness.check_nothing_is_there_twice(scene)
    if with_rays:
        soundness.check_not_split_needlessly(scene)
        # Hollows, the inside of foliage and where things touch take the more triangles the finer they are: a large one
        # under the foot of a chair sees past it, and of a hundred small ones in its place some lie wholly beneath.
        # Small ones in a fold see out through a slit, which takes more rays to find: of 10^5 of the room at 10^7, 134
        # look buried to 12 rays and 41 to 200.
        soundness.check_nothing_is_buried(scene, near=0.999, far=0.97, rays=200)
        soundness.check_fronts_are_seen(scene, count=30_000)
        soundness.check_nothing_lies_upon_another(scene, count=100_000)


@pytest.mark.parametrize("triangles", COUNTS)
@pytest.mark.parametrize("name", WHOLE_SCENES)
def test_detail_is_met_and_sound(name, triangles):
    scene = make_scene(name, detail=triangles)
    assert scene.triangle_count == triangles
    check(scene, with_rays=triangles <= SEEN_THROUGH)
    own = built(name)
    assert scene.lights == own.lights
    assert (scene.camera, dict(scene.views), scene.path) == (own.camera, dict(own.views), own.path)
    size, own_size = (s.vertices.max(dim=0).values - s.vertices.min(dim=0).values for s in (scene, own))
    assert torch.allclose(size, own_size, rtol=0.25), "the same place at every detail"


@pytest.mark.parametrize("triangles", [1_237, 50_003])
@pytest.mark.parametrize("name", WHOLE_SCENES)
def test_any_number_is_met_for_another_seed(name, triangles):
    assert make_scene(name, seed=3, detail=triangles).triangle_count == triangles


@pytest.mark.parametrize("name", WHOLE_SCENES)
def test_its_own_number_is_the_scene_as_drawn(name):
    own, asked = built(name), make_scene(name, detail=FACTS[name].triangles)
    assert torch.equal(own.vertices, asked.vertices)
    assert torch.equal(own.faces, asked.faces)


@pytest.mark.parametrize("name", WHOLE_SCENES)
def test_numbers_that_no_scene_can_have_are_refused(name):
    for wrong in (999, 10_000_001, -5):
        with pytest.raises(ValueError, match="detail"):
            make_scene(name, detail=wrong)
    with pytest.raises(TypeError, match="detail"):
        make_scene(name, detail=2000.5)


@pytest.mark.slow
@pytest.mark.parametrize("triangles", [300_000, 10_000_000])
@pytest.mark.parametrize("name", WHOLE_SCENES)
def test_finer_scenes_are_sound_throughout(name, triangles):
    start = time.process_time()
    scene = make_scene(name, detail=triangles)
    assert time.process_time() - start < 240
    assert scene.triangle_count == triangles
    check(scene, with_rays=True)
