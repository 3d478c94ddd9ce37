"""What is wrong with a scene, a camera or a sample map is said in one clear error; what is merely odd works."""

import dataclasses
import math

import pytest
import torch
from builders import rounded, scene_of, soup, sphere

from fovden.camera import Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.foveation import SampleMap
from fovden.tracer import (
    EnvironmentLight,
    Integrator,
    Material,
    Materials,
    PointLight,
    Scene,
    accumulate_reference,
    trace_frame,
    trace_gbuffer,
)

CAMERA = StereoCamera.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), fov_y_deg=50, resolution=(8, 10))
LIGHT = PointLight((1.0, 1.0, 3.0), 5.0)


def ball(**attributes):
    vertices, faces = sphere(1)
    return scene_of((rounded(vertices), faces), **{"lights": (LIGHT,)} | attributes)


def changed(**fields):
    vertices, faces = soup(4)
    parts = {"vertices": vertices, "faces": faces, "material_ids": torch.zeros(4, dtype=torch.int32)} | fields
    return Scene(materials=Materials.of([Material("grey", (0.5, 0.5, 0.5))]), **parts)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["vertices", "normals", "uv"])
def test_numbers_of_a_scene_must_be_finite(name, bad):
    values = torch.zeros(12, 2 if name == "uv" else 3)
    values[7, 1] = bad
    with pytest.raises(ValueError, match=rf"{name}: expected finite values, got {bad} at index \(7, 1\)"):
        changed(**{name: values})


def test_a_scene_needs_triangles():
    with pytest.raises(ValueError, match="faces: expected at least one triangle"):
        changed(faces=torch.zeros(0, 3, dtype=torch.int32), material_ids=torch.zeros(0, dtype=torch.int32))


@pytest.mark.parametrize("bad", [-1, 12])
def test_faces_must_be_in_range(bad):
    faces = soup(4)[1].clone()
    faces[2, 1] = bad
    with pytest.raises(ValueError, match=rf"faces: expected indices from 0 to 11, got .*{bad}"):
        changed(faces=faces)
    with pytest.raises(ValueError, match="faces: expected an integer type"):
        changed(faces=soup(4)[1].float())


@pytest.mark.parametrize("bad", [-1, 1])
def test_materials_must_be_in_range(bad):
    with pytest.raises(ValueError, match="material_ids: expected indices from 0 to 0"):
        changed(material_ids=torch.tensor([0, 0, bad, 0]))


def test_shapes_of_a_scene_are_named():
    with pytest.raises(ShapeError, match="vertices"):
        changed(vertices=torch.zeros(12, 2))
    with pytest.raises(ShapeError, match="material_ids"):
        changed(material_ids=torch.zeros(5, dtype=torch.int32))
    with pytest.raises(ShapeError, match=r"uv: expected shape \(n=12, 2\), got \(3, 2\)"):
        changed(uv=torch.zeros(3, 2))


def test_without_light_rays_and_gbuffer_work_and_paths_say_why_not():
    scene = ball(lights=())
    assert trace_gbuffer(scene, CAMERA).hit.any()
    assert scene.intersect(torch.tensor([[0.0, 0, 3]]), torch.tensor([[0.0, 0, -1]])).prim[0] >= 0
    with pytest.raises(ValueError, match="at least one light or emissive material"):
        trace_frame(scene, CAMERA, 1)
    with pytest.raises(ValueError, match="at least one light or emissive material"):
        accumulate_reference(scene, CAMERA, spp=1, progress=None)


def test_two_environments_are_one_too_many():
    with pytest.raises(ValueError, match="at most one environment light"):
        trace_frame(ball(lights=(EnvironmentLight(1), EnvironmentLight(2))), CAMERA, 1)


def mapped(height, width, views=2):
    counts = torch.ones(views, 1, height, width, dtype=torch.int32)
    return SampleMap.from_counts(counts, Gaze(torch.zeros(views, 2)))


@pytest.mark.parametrize("shape", [(9, 10, 2), (10, 8, 2), (8, 10, 3)])
def test_a_sample_map_must_fit_the_camera(shape):
    with pytest.raises(ValueError, match=r"samples: expected a sample map for 2 views of 8 x 10 pixels"):
        trace_frame(ball(), CAMERA, mapped(*shape))


@pytest.mark.parametrize("bad", [(2, 0, 0), (0, 8, 0), (0, 0, 10), (0, -1, 0), (-1, 0, 0)])
def test_coordinates_must_be_in_the_image(bad):
    samples = mapped(8, 10)
    coords = torch.cat([samples.coords, torch.tensor([bad], dtype=torch.int32)])
    with pytest.raises(
        ValueError, match=rf"samples\.coords: expected view, y and x .*, got \[\[{bad[0]}, {bad[1]}, {bad[2]}\]\]"
    ):
        trace_frame(ball(), CAMERA, dataclasses.replace(samples, coords=coords))


def test_a_mask_with_nothing_selected_gives_a_dark_frame_with_its_geometry():
    counts = torch.zeros(1, 1, 8, 10, dtype=torch.int32)
    scene = ball(lights=(LIGHT, EnvironmentLight(1)))
    frame = trace_frame(scene, CAMERA, SampleMap.from_counts(counts, Gaze.center(CAMERA)))
    assert not frame.radiance.any()
    assert not frame.luminance_squared.any()
    assert not frame.mask.any()
    assert torch.equal(frame.gbuffer.position, trace_gbuffer(scene, CAMERA).position)
    assert frame.gbuffer.hit.any()


@pytest.mark.parametrize(("samples", "error"), [(0, ValueError), (-1, ValueError), (1.5, TypeError), (True, TypeError)])
def test_numbers_of_samples_are_checked(samples, error):
    with pytest.raises(error, match="samples"):
        trace_frame(ball(), CAMERA, samples)
    with pytest.raises(error, match="spp"):
        accumulate_reference(ball(), CAMERA, spp=samples, progress=None)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seeds_are_checked(seed):
    with pytest.raises(ValueError, match="seed"):
        trace_frame(ball(), CAMERA, 1, seed=seed)
    with pytest.raises(ValueError, match="seed"):
        accumulate_reference(ball(), CAMERA, spp=1, seed=seed, progress=None)


@pytest.mark.parametrize("bad", [(math.nan, 0.0), (0.0, math.inf)])
def test_jitter_must_be_finite(bad):
    with pytest.raises(ValueError, match="jitter"):
        trace_gbuffer(ball(), CAMERA, jitter=bad)
    with pytest.raises(ValueError, match="jitter"):
        trace_frame(ball(), CAMERA, 1, jitter=bad)


def test_choices_of_lights_are_named():
    with pytest.raises(ValueError, match="uniform, power"):
        trace_frame(ball(), CAMERA, 1, integrator=Integrator(lights="nearest"))


def test_an_eye_on_a_surface_sees_something_finite():
    scene = ball()
    eye = tuple(scene.vertices[0].tolist())
    frame = trace_frame(
        scene, StereoCamera.look_at(eye, (0, 0, 0), fov_y_deg=50, resolution=(8, 8), eye_separation=0), 2
    )
    for image in (frame.radiance, frame.gbuffer.position, frame.gbuffer.normal, frame.gbuffer.depth):
        assert torch.isfinite(image).all()


def test_triangles_without_area_do_not_darken_a_frame():
    """Points and lines beside a surface: in the lists of triangles, but not in the picture, also when they emit."""
    vertices, faces = sphere(1)
    vertices = rounded(vertices)
    line = torch.tensor([[0, 1, 1], [2, 2, 2], [0, 0, 3]], dtype=torch.int32)
    plain = scene_of((vertices, faces), lights=(LIGHT,))
    materials = (Material("grey", (0.5, 0.5, 0.5)), Material("lamp", (0, 0, 0), (5, 5, 5)))
    ids = torch.cat([torch.zeros(len(faces)), torch.ones(3)]).int()
    mended = scene_of((vertices, torch.cat([faces, line])), *materials, material_ids=ids, lights=(LIGHT,))
    one, other = trace_frame(plain, CAMERA, 2), trace_frame(mended, CAMERA, 2)
    assert torch.equal(one.radiance, other.radiance)
    assert torch.isfinite(other.radiance).all()
