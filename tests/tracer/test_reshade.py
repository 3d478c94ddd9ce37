"""Surface points shaded again: the frame's bits in the same scene; in a changed one what changed, and nothing else."""

import dataclasses
import math
from typing import get_args

import pytest
import torch
from builders import generator, lit_room, rounded, scene_of, sphere, uneven_samples

from fovden.camera import StereoCamera
from fovden.tracer import (
    EnvironmentLight,
    Integrator,
    Material,
    PointLight,
    Shading,
    SurfacePoints,
    reshade,
    surface_points,
    trace_frame,
)
from fovden.tracer.arrays import LightChoice
from fovden.tracer.integrator import Sampler

CAMERA = StereoCamera.look_at((0.2, 0.1, 1.8), (0.0, -0.2, 0.0), fov_y_deg=70, resolution=(24, 30))
INTEGRATORS = [Integrator(lights=lights, sampler=get_args(Sampler)[-1]) for lights in get_args(LightChoice)]
INTEGRATORS += [Integrator(), Integrator(bounces=3, lights="power", roulette=2), Integrator(bounces=0)]


@pytest.fixture(scope="module")
def scene():
    return lit_room()


@pytest.fixture(scope="module")
def samples():
    return uneven_samples(CAMERA)


def rows(frame, points):
    """The frame's light at the points' pixels."""
    view, y, x = points.coords.long().unbind(1)
    light = (getattr(frame, name)[view, :, y, x] for name in ("direct", "indirect", "emission"))
    return Shading(*light, frame.luminance_squared[view, 0, y, x])


def same_bits(one, other):
    return all(torch.equal(a.view(torch.int32), b.view(torch.int32)) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_the_same_scene_gives_the_same_bits(scene, samples, integrator):
    frame = trace_frame(scene, CAMERA, samples, seed=5, jitter=(0.3, -0.2), integrator=integrator)
    for part in (frame.direct, frame.emission, frame.luminance_squared):
        assert float((part > 0).float().mean()) > 0.005  # there is something to get wrong
    points = surface_points(frame)
    assert len(points) == len(samples.coords)
    light = reshade(scene, points, integrator=integrator)
    assert same_bits(light, rows(frame, points))
    for name, values in zip(("direct", "indirect", "emission"), light, strict=False):
        assert torch.equal(points.image(values), getattr(frame, name))
    # Another seed would give another picture.
    assert not same_bits(reshade(scene, dataclasses.replace(points, seed=6), integrator=integrator), light)


def test_some_points_in_any_order_on_any_number_of_threads(scene, samples, threads, monkeypatch):
    monkeypatch.setattr("fovden.tracer.shading.PIXELS_PER_TILE", 50)
    frame = trace_frame(scene, CAMERA, samples, seed=5)
    # One pixel of each stratum of 3 x 3, as adaptive SVGF takes them, shuffled, and one of them twice.
    strata = torch.cartesian_prod(torch.arange(2), torch.arange(8), torch.arange(10))
    within = torch.randint(0, 3, (len(strata), 2), generator=generator(8))
    coords = strata * torch.tensor([1, 3, 3]) + torch.nn.functional.pad(within, (1, 0))
    coords = coords[torch.randperm(len(coords), generator=generator(9))]
    points = surface_points(frame, torch.cat([coords, coords[:1]]))
    assert bool((points.counts == 0).any())
    expected = rows(frame, points)
    for count in (1, 2):
        threads(count)
        assert same_bits(reshade(scene, points), expected)
    chosen = points.counts > 1
    assert same_bits(reshade(scene, points[chosen]), (part[chosen] for part in expected))
    assert all(len(part) == 0 for part in reshade(scene, points[:0]))


def test_stereo_differs_by_eye(scene):
    frame = trace_frame(scene, CAMERA, 1, seed=5)
    points = surface_points(frame)
    left = points[points.coords[:, 0] == 0]
    other = dataclasses.replace(left, coords=left.coords + torch.tensor([1, 0, 0], dtype=torch.int32))
    assert not torch.equal(reshade(scene, left).direct, reshade(scene, other).direct)


def test_light_that_changes_is_all_that_changes(scene):
    frame = trace_frame(scene, CAMERA, 2, seed=5)
    points = surface_points(frame)
    point, sun, sky = scene.lights
    brighter = [dataclasses.replace(point, intensity=6.0), dataclasses.replace(sun, irradiance=1.0)]
    brighter = scene.with_lights([*brighter, EnvironmentLight(2 * sky.radiance)])
    materials = dataclasses.replace(brighter.materials, emission=2 * brighter.materials.emission)
    light, before = reshade(dataclasses.replace(brighter, materials=materials), points), rows(frame, points)
    doubled = Shading(*(2 * part for part in before[:3]), 4 * before.luminance_squared)  # powers of two are exact
    assert same_bits(light, doubled)
    # A light that goes out is missing where it shone, and nowhere else.
    dark = reshade(scene.with_lights([dataclasses.replace(point, intensity=0.0), sun, sky]), points)
    lost = before.radiance - dark.radiance
    assert bool((lost >= 0).all())
    assert 0.05 < float((lost.amax(1) > 0).float().mean()) < 0.95


def test_points_move_with_their_triangles():
    """A ball that has moved, against the light of a point by hand."""
    vertices, faces = sphere(2)
    lamp = PointLight((1.0, 2.0, 3.0), (3.0, 2.0, 1.0))
    before = scene_of((rounded(vertices), faces), Material("chalk", (0.9, 0.8, 0.7)), lights=[lamp])
    camera = StereoCamera.look_at((0, 0, 3), (0, 0, 0), fov_y_deg=50, resolution=(16, 20))
    frame = trace_frame(before, camera, 3, seed=2, integrator=Integrator(bounces=0))
    points = surface_points(frame)
    shift, angle = (0.3, -0.2, 0.1), 0.4
    turn = torch.tensor([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    turned = vertices @ turn.double().T
    after = dataclasses.replace(before, vertices=rounded(turned, offset=shift))
    hit = points.prim >= 0
    assert 0.2 < float(hit.float().mean()) < 0.8
    # A rotation and a shift take each point along; the old place is in the G-buffer.
    old = rows_of(frame.gbuffer.position, points)[hit]
    new = old @ turn.T + torch.tensor(shift)
    assert torch.allclose(points.positions(after)[hit], new, atol=1e-5)
    assert not points.positions(after)[~hit].any()
    # The ball is convex: what faces the lamp is lit, by albedo / pi * intensity * cosine / distance^2.
    corners = after.vertices.double()[after.faces.long()][points.prim[hit].long()]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1)
    towards = torch.tensor(lamp.position, dtype=torch.float64) - new
    cosine = (towards * normal).sum(1) / towards.norm(dim=1)
    factor = torch.tensor([0.9 * 3, 0.8 * 2, 0.7], dtype=torch.float64) / math.pi
    expected = factor * (cosine / towards.square().sum(1))[:, None]
    for watched in (None, camera):  # from where a Lambertian surface is seen makes no difference, if from outside
        light = reshade(after, points, integrator=Integrator(bounces=0), camera=watched)
        outward = ((points.directions(after, None if watched is None else watched.views)[hit] * normal).sum(1)) < -0.05
        chosen = (cosine.abs() > 0.05) & outward
        assert int(chosen.sum()) > 50
        assert torch.allclose(light.direct[hit][chosen].double(), expected.clamp_min(0)[chosen], rtol=1e-4, atol=1e-7)
        assert not light.direct[~hit].any()


def rows_of(image, points):
    view, y, x = points.coords.long().unbind(1)
    return image[view, :, y, x]


def test_a_camera_that_looks_from_the_same_place_sees_the_same(scene):
    frame = trace_frame(scene, CAMERA, 2, seed=5)
    points = surface_points(frame)
    light, again = reshade(scene, points), reshade(scene, points, camera=CAMERA)
    # Directions by way of the points' positions are off by units in the last place.
    for one, other in zip(light, again, strict=True):
        assert torch.allclose(one, other, rtol=1e-3, atol=1e-4)


def test_bad_input(scene):
    frame = trace_frame(scene, CAMERA, 1)
    points = surface_points(frame)
    with pytest.raises(ValueError, match=r"frame.camera: expected the camera that saw the frame, got None"):
        surface_points(dataclasses.replace(frame, camera=None))
    with pytest.raises(
        ValueError, match=r"coords: expected view, y and x from 0 to below \[2, 24, 30\], got \[\[0, 24"
    ):
        surface_points(frame, torch.tensor([[0, 24, 0]]))
    with pytest.raises(ValueError, match=r"coords: expected shape \(n, 3\)"):
        surface_points(frame, torch.tensor([0, 1, 2]))
    few = scene_of((torch.eye(3), torch.tensor([[0, 1, 2]])), lights=[PointLight((0, 0, 0), 1)])
    with pytest.raises(ValueError, match=r"points.prim: expected triangles of a scene with 1, got \d+"):
        reshade(few, points)
    with pytest.raises(ValueError, match=r"no light"):
        reshade(scene_of((scene.vertices, scene.faces)), points)
    with pytest.raises(ValueError, match=r"counts: expected shape"):
        SurfacePoints(points.coords, points.counts[:1], points.prim, points.barycentric, points.camera)
