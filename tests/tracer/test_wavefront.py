"""Paths in batches: what one finds does not depend on the others, also where it shares a shadow ray with them."""

import pytest
import torch
from builders import generator, lit_room

from fovden.camera import Gaze, StereoCamera
from fovden.foveation import SampleMap
from fovden.tracer import Integrator, accumulate_reference, record_paths, reshade, surface_points, trace_frame
from fovden.tracer.kernels.path import LIGHT
from fovden.tracer.kernels.wavefront import PATHS

CAMERA = StereoCamera.look_at((0.2, 0.1, 1.8), (0.0, -0.2, 0.0), fov_y_deg=70, resolution=(5, 4))
INTEGRATORS = [Integrator(), Integrator(bounces=3, sampler="sobol", roulette=1), Integrator(bounces=0, lights="tree")]


@pytest.fixture(scope="module")
def scene():
    return lit_room()


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_pixel_is_the_same_alone(scene, integrator):
    """Some pixels fill more than a batch, most share one, some have no samples; alone, each begins one."""
    counts = torch.randint(0, 40, (2, 1, 5, 4), generator=generator(1), dtype=torch.int32)
    counts[0, 0, 1, 1], counts[1, 0, 2, 3], counts[1, 0, 3, 0] = 2 * PATHS + 3, PATHS, 0
    frame = trace_frame(scene, CAMERA, SampleMap.from_counts(counts, Gaze.center(CAMERA)), integrator=integrator)
    for view, _, y, x in (counts > 0).nonzero().tolist():
        light = reshade(scene, surface_points(frame, torch.tensor([[view, y, x]])), integrator=integrator)
        assert torch.equal(light.direct[0], frame.direct[view, :, y, x])
        assert torch.equal(light.indirect[0], frame.indirect[view, :, y, x])
        assert torch.equal(light.luminance_squared[0], frame.luminance_squared[view, 0, y, x])
    assert not frame.radiance[(counts == 0).expand(-1, 3, -1, -1)].any()


@pytest.mark.parametrize("jitter", [False, True])
def test_a_reference_is_the_same_in_parts(scene, jitter, tmp_path):
    """The parts' samples fall on other batches than those of the whole."""
    path = tmp_path / "part.safetensors"
    options = {"jitter": jitter, "integrator": INTEGRATORS[1], "progress": None}
    for spp in (1, 8, PATHS, 2 * PATHS + 5):
        part = accumulate_reference(scene, CAMERA, spp=spp, checkpoint=path, **options)
    whole = accumulate_reference(scene, CAMERA, spp=2 * PATHS + 5, **options)
    assert torch.equal(part.mean, whole.mean)
    assert torch.equal(part.variance, whole.variance)


def test_shared_shadow_rays_find_what_rays_of_their_own_do(scene):
    """Of the point and the sun a pixel's paths have met those that nothing hides from it, and no other."""
    frame = trace_frame(scene, CAMERA, 2 * PATHS)
    points = surface_points(frame)
    points = surface_points(frame, points.coords[points.prim >= 0])
    met = record_paths(scene, points, integrator=Integrator(bounces=0)).numbers[:, 0, LIGHT].reshape(len(points), -1)
    view, y, x = points.coords.long().unbind(1)
    position, normal = (getattr(frame.gbuffer, name)[view, :, y, x] for name in ("position", "normal"))
    origins = position + 1e-4 * normal
    lamp, sun = scene.lights[:2]
    to_lamp = torch.tensor(lamp.position) - origins
    to_sun = -torch.tensor(sun.direction).expand_as(origins)
    hidden, seen = 0, 0
    for row, direction, end in ((0, to_lamp, 1.0), (1, to_sun, torch.inf)):
        dark = scene.occluded(origins, direction, torch.full((len(points),), end))
        lit = ~dark & ((normal * direction).sum(1) > 0)
        # 256 paths choose among a dozen lights or fewer: all miss one with a chance of (11 / 12)^256 = 2e-10.
        assert torch.equal((met == row).any(1), lit)
        hidden, seen = hidden + int((~lit).sum()), seen + int(lit.sum())
    assert hidden > 5
    assert seen > 5
