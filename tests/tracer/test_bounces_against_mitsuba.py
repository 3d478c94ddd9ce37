"""Emissive triangles, sky images and several bounces against Mitsuba's path tracer: see ``test_against_mitsuba``."""

import numpy as np
import pytest
import torch
from shapes import box, matt, pixels, rectangle, scene_of, sphere
from significance import assert_same_mean
from test_against_mitsuba import (
    BATCHES,
    SPP,
    block_means,
    camera_at,
    comparable,
    meters,
    mi,  # noqa: F401 - a fixture
    mitsuba,
    rendered_by_mitsuba,
)
from test_lights import sky_radiance
from test_sky_sampling import sunny

from fovden.tracer import EnvironmentLight, Integrator, trace_frame

DEPTHS = {0: 2, 1: 3, 4: 6}
"""Mitsuba's depth for a number of bounces."""


def lamp_room():
    """A room that is open to the front and above, with two lamps, one of them turned and near a ball."""
    floor, back = rectangle((-2, 0, -2), (0, 0, 4), (4, 0, 0)), rectangle((-2, 0, -2), (4, 0, 0), (0, 3, 0))
    parts = [
        (floor, matt((0.7, 0.6, 0.5))),
        (torch.cat([back, rectangle((-2, 0, 2), (0, 0, -4), (0, 3, 0))]), matt((0.5, 0.6, 0.7))),
        (sphere(2) * 0.6 + torch.tensor([0.7, 0.6, 0.3]), matt((0.8, 0.3, 0.2))),
        (box((-1.4, 0, -1.0), (-0.5, 1.1, -0.2)), matt((0.3, 0.5, 0.8))),
        (rectangle((-0.8, 2.9, -1.0), (1.6, 0, 0), (0, 0, 1.2)), matt(0.3, (9, 8, 6))),
        (rectangle((1.7, 0.3, -0.4), (0, 0, 0.9), (-0.3, 0.7, 0)), matt(0.3, (1, 4, 9))),
    ]
    return scene_of(parts), camera_at((1.2, 2.0, 4.0), (-0.2, 0.8, 0), 48)


def equirectangular(image):
    """An image of the surroundings as Mitsuba reads it: its first and last rows lie at the poles, and -z at its edge.

    What is linear between the middles of rows is so between twice as many rows.
    """
    height = image.shape[1]
    padded = np.pad(image, ((0, 0), (1, 1), (0, 0)), mode="edge")
    place = np.arange(2 * height + 1) / 2 + 0.5
    above = np.floor(place).astype(int)
    part = (place - above)[None, :, None]
    rows = (1 - part) * padded[:, above] + part * padded[:, np.minimum(above + 1, height + 1)]
    turned = np.roll(rows, image.shape[2] // 2, axis=2)
    return mitsuba.Bitmap(np.ascontiguousarray(turned.transpose(1, 2, 0)).astype(np.float32))


@pytest.fixture(scope="module", params=["lamps", "lamps and sunny sky"])
def case(request, mi, tmp_path_factory):  # noqa: F811
    """A scene, its camera, and Mitsuba's batches by depth."""
    scene, camera = lamp_room()
    sky = {}
    if "sky" in request.param:
        image = sunny()
        sky = {"sky": {"type": "envmap", "bitmap": equirectangular(image)}}
        assert_same_sky(sky["sky"], image)
        scene = scene.with_lights([EnvironmentLight(torch.from_numpy(image).float())])
    folder = tmp_path_factory.mktemp("meshes")
    theirs = rendered_by_mitsuba(mi, scene, meters(camera), folder, depths=DEPTHS.values(), emitters=sky)
    return scene, camera, theirs


def assert_same_sky(description, image):
    """Both read the image alike."""
    directions = np.random.default_rng(1).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    environment = mitsuba.load_dict({"type": "scene", "sky": description}).environment()
    for direction, radiance in zip(directions, sky_radiance(image, directions), strict=True):
        interaction = mitsuba.SurfaceInteraction3f()
        interaction.wi = mitsuba.Vector3f(*(-direction).tolist())
        np.testing.assert_allclose(np.array(environment.eval(interaction)), radiance, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("setting", [{}, {"lights": "tree", "sampler": "sobol"}], ids=["plain", "tree and sobol"])
@pytest.mark.parametrize("bounces", DEPTHS)
def test_any_number_of_bounces_gives_mitsubas_light(case, bounces, setting):
    scene, camera, theirs = case
    integrator = Integrator(bounces=bounces, roulette=3 if setting else None, **setting)
    frames = [trace_frame(scene, camera, 2 * SPP, seed=seed, integrator=integrator) for seed in range(BATCHES // 2)]
    mask = comparable(scene, camera)
    ours, theirs = np.concatenate([pixels(frame.radiance) for frame in frames]) * mask, theirs[DEPTHS[bounces]] * mask
    # Either side's mean is known to some 0.25 % under the sun.
    np.testing.assert_allclose(ours.mean((0, 1)), theirs.mean((0, 1)), rtol=0.01)
    assert_same_mean(ours.mean(1), theirs.mean(1))
    assert_same_mean(block_means(ours), block_means(theirs))
