"""Light that bounces find and light that is sampled: nothing twice, nothing left out, for any number of bounces."""

import time

import numpy as np
import pytest
import torch
from shapes import box, matt, pixels, rectangle, scene_of, seen_points, sphere, view
from significance import assert_mean, assert_same_mean
from test_physics import polygon_form_factor

from fovden.tracer import EnvironmentLight, Integrator, PointLight, trace_frame

ALBEDO = np.array([0.7, 0.5, 0.2])
UP = np.array([0.0, 1.0, 0.0])


def batches(scene, camera, spp, seeds=20, **setting):
    """Independent frames by part, shape (2 seeds, h w, 3)."""
    frames = [trace_frame(scene, camera, spp, seed=seed, integrator=Integrator(**setting)) for seed in range(seeds)]
    return {
        name: np.concatenate([pixels(getattr(frame, name)) for frame in frames])
        for name in ("direct", "indirect", "radiance")
    }


# A bounce finds what a shadow ray could have found


def under_a_lamp(height):
    """A floor under a square lamp that faces down, and what it reflects by Lambert's formula."""
    corners = [(-1, height, -1), (1, height, -1), (1, height, 1), (-1, height, 1)]
    lamp = rectangle(corners[0], (2, 0, 0), (0, 0, 2))
    floor = rectangle((-4, 0, -4), (0, 0, 8), (8, 0, 0))
    emission = np.array([4.0, 2.0, 1.0])
    camera = view((0.3, 0.6 * height, 0.4 + 2 * height), (0.3, 0, 0.4), size=4, fov=12)
    points = seen_points(camera, (0, 0, 0), UP)
    expected = ALBEDO * emission * polygon_form_factor(points, UP, corners)[:, None]
    return scene_of([(floor, matt(ALBEDO)), (lamp, matt(0, emission))]), camera, expected


@pytest.mark.parametrize("lights", ["uniform", "power", "tree"])
@pytest.mark.parametrize("height", [0.05, 1.0])
def test_a_lamp_lights_a_floor_alike_with_and_without_bounces(height, lights):
    """Where the lamp is near, samples of its area are a bad guess, with a density that varies as 1 / distance^2."""
    scene, camera, expected = under_a_lamp(height)
    alone, both = (batches(scene, camera, 128, bounces=n, lights=lights)["direct"] for n in (0, 1))
    assert_mean(both, expected)
    np.testing.assert_allclose(both.mean((0, 1)), expected.mean(0), rtol=0.01)
    if height == 1.0:  # nearer, light sampling alone has too long a tail for the z-test
        assert_mean(alone, expected)
        assert_same_mean(alone, both)
    assert both.var(0).mean() < alone.var(0).mean()


def test_bounces_into_a_lamp_are_no_noise_where_the_lamp_is_all_that_is_seen():
    """Within an emitting sphere of radiance L, a bounce alone would give albedo * L each time."""
    room = scene_of([(sphere(3, inwards=True), matt(ALBEDO, 1.0))])
    parts = batches(room, view((0.1, 0.2, 0.3), (1, 0, 0), fov=70), 16, bounces=1)
    assert_mean(parts["direct"].mean(1), ALBEDO)
    assert parts["direct"].std(0).mean() < 0.5 * ALBEDO.mean() / np.sqrt(16)


# Any number of bounces


@pytest.mark.parametrize("lights", ["uniform", "tree"])
@pytest.mark.parametrize(("bounces", "roulette"), [(0, None), (1, None), (3, None), (3, 1), (6, 2)])
def test_each_bounce_adds_a_term_of_the_geometric_series(bounces, roulette, lights):
    """Inside walls of radiance L: albedo L, then albedo^2 L, and so on."""
    emission = np.array([1.0, 2.0, 4.0])
    room = scene_of([(sphere(3, inwards=True), matt(ALBEDO, emission))])
    setting = {"bounces": bounces, "roulette": roulette, "lights": lights}
    parts = batches(room, view((0.1, 0.2, 0.3), (1, 0, 0), fov=70), 16, **setting)
    indirect = sum(ALBEDO**n * emission for n in range(2, bounces + 2)) if bounces else np.zeros(3)
    assert_mean(parts["direct"].mean(1), ALBEDO * emission)
    assert_mean(parts["indirect"].mean(1), indirect)
    np.testing.assert_allclose(parts["indirect"].mean((0, 1)), indirect, rtol=0.01)


def white_room():
    """A room of dark and light walls with a lamp, where paths may go on for long."""
    room = box((-2, -1.5, -2), (2, 1.5, 2), inwards=True)
    crate = box((-1, -1.5, -1), (0, -0.5, 0))
    scene = scene_of([(room, matt((0.9, 0.8, 0.6))), (crate, matt(0.2))], [PointLight((0.5, 1.0, 0.5), 5)])
    return scene, view((1.5, 0.3, 1.5), (0, -0.5, 0), size=8, fov=70)


def test_roulette_changes_no_mean():
    scene, camera = white_room()
    plain, ended = (batches(scene, camera, 16, bounces=12, roulette=roulette) for roulette in (None, 1))
    assert_same_mean(ended["radiance"], plain["radiance"])
    assert np.array_equal(ended["direct"], plain["direct"])
    np.testing.assert_allclose(ended["radiance"].mean(), plain["radiance"].mean(), rtol=0.01)
    assert (ended["indirect"] != plain["indirect"]).mean() > 0.9


def test_roulette_takes_less_time():
    """Two bounces in three are dropped here; a quarter of the time is left for whatever else the machine does."""
    scene, camera = white_room()
    seconds = {}
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for roulette in (None, 1):
            setting = Integrator(bounces=40, roulette=roulette)
            runs = []
            for _ in range(3):
                start = time.thread_time()
                trace_frame(scene, camera, 64, integrator=setting)
                runs.append(time.thread_time() - start)
            seconds[roulette] = min(runs)
    finally:
        torch.set_num_threads(before)
    assert seconds[1] < 0.75 * seconds[None]


@pytest.mark.parametrize("sampler", ["independent", "sobol"])
def test_a_convex_body_in_a_furnace_stays_exact_with_bounces(sampler):
    """Every sample: light and bounce densities are equal there, so that the two weights are halves."""
    sky = EnvironmentLight((1.0, 0.5, 2.0))
    scene = scene_of([(box((-1, -1, -1), (1, 1, 1)), matt(ALBEDO))], [sky])
    setting = Integrator(bounces=2, sampler=sampler)
    frame = trace_frame(scene, view((2, 3, 4), (0, 0, 0), size=16, fov=50), 4, integrator=setting)
    body = torch.tensor(ALBEDO).float() * torch.tensor([1.0, 0.5, 2.0])
    hit = frame.gbuffer.hit.expand(-1, 3, -1, -1)
    expected = torch.where(hit, body[None, :, None, None], 0)
    torch.testing.assert_close(frame.direct, expected.expand_as(hit), rtol=1e-5, atol=0)
    assert (frame.indirect == 0).all()
