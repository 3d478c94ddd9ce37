"""Lights: which one a path chooses, where the sky's light comes from, and how directions are drawn."""

import math

import numba
import numpy as np
import pytest
import torch
from scipy import ndimage
from shapes import matt, pixels, rectangle, scene_of, seen_points, view
from significance import LEVEL, assert_counts, assert_mean, sidak

from fovden.tracer import DirectionalLight, EnvironmentLight, Integrator, PointLight, trace_frame
from fovden.tracer.arrays import light_table
from fovden.tracer.kernels.illumination import DIRECTIONAL, ENVIRONMENT, POINT, TRIANGLE, choose_light, light_pointers
from fovden.tracer.kernels.vectors import Vector, cosine_direction

FLOOR = rectangle((-4, 0, -4), (0, 0, 8), (8, 0, 0))
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
LARGEST = np.float32(1 - 2**-24)
"""The largest random number."""


# The table


def test_the_table_lists_the_lights_then_the_emitting_triangles():
    lamp = rectangle((-1, 2, -1), (2, 0, 0), (0, 0, 2))
    sliver = torch.tensor([[[0.0, 1, 0], [1, 1, 0], [2, 1, 0]]], dtype=torch.float64)
    lights = [DirectionalLight((0, -2, 0), 3), PointLight((1, 2, 3), (4, 5, 6)), EnvironmentLight((7, 8, 9))]
    parts = [(lamp, matt(0, (1, 2, 3))), (FLOOR, matt(1)), (sliver, matt(0, 5)), (lamp, matt(0.5, (0, 0, 1)))]
    table = light_table(scene_of(parts, lights))
    assert table.kind.tolist() == [DIRECTIONAL, POINT, ENVIRONMENT] + 4 * [TRIANGLE]
    assert table.prim.tolist() == [-1, -1, -1, 0, 1, 5, 6], "a triangle without area emits nothing"
    assert table.vector[:2].tolist() == [[0, -1, 0], [1, 2, 3]]
    assert table.colour.tolist() == [[3] * 3, [4, 5, 6], [7, 8, 9], [1, 2, 3], [1, 2, 3], [0, 0, 1], [0, 0, 1]]
    assert table.pmf == pytest.approx(1 / 7)


def by_power(powers):
    """Chances half by power and half alike."""
    return 0.5 * powers / powers.sum() + 0.5 / len(powers)


def test_power_is_what_each_light_sends_into_the_scene():
    """Point 4 pi I; directional E and environment pi L, each over the disc of the bounding sphere; triangle pi A L."""
    lamp = rectangle((-1, 2, -1), (2, 0, 0), (0, 0, 3))
    lights = [PointLight((1, 2, 3), (4, 5, 6)), DirectionalLight((0, -2, 0), 3), EnvironmentLight((7, 8, 9))]
    table = light_table(scene_of([(FLOOR, matt(1)), (lamp, matt(0, (1, 2, 3)))], lights), "power")
    disc = math.pi * (8**2 + 2**2 + 8**2) / 4
    triangle = math.pi * 3 * LUMINANCE @ (1, 2, 3)
    point, sky = 4 * math.pi * LUMINANCE @ (4, 5, 6), math.pi * disc * LUMINANCE @ (7, 8, 9)
    powers = np.array([point, disc * 3, sky, triangle, triangle])
    np.testing.assert_allclose(table.pmf, by_power(powers), rtol=1e-6)


def test_the_power_of_a_sky_image_weighs_rows_by_their_solid_angle():
    image = torch.zeros(3, 2, 4)
    image[:, 0] = 2  # the upper half of the sphere
    table = light_table(scene_of([(FLOOR, matt(1))], [EnvironmentLight(image)]), "power")
    assert table.colour[0] == pytest.approx(1)
    image = torch.zeros(3, 180, 4)
    image[:, 0] = 1  # the cap of one degree around the zenith
    table = light_table(scene_of([(FLOOR, matt(1))], [EnvironmentLight(image)]), "power")
    assert table.colour[0] == pytest.approx((1 - math.cos(math.radians(1))) / 2, rel=1e-5)


@pytest.mark.parametrize("choice", ["uniform", "power"])
def test_the_running_sums_end_at_one_and_hold_every_chance(choice):
    count = 30_000
    generator = np.random.default_rng(0)
    corners = generator.normal(size=(count, 1, 3)) + generator.normal(size=(count, 3, 3)) * 10 ** -generator.uniform(
        0, 3, (count, 1, 1)
    )
    table = light_table(scene_of([(torch.from_numpy(corners), matt(0, 1))]), choice)
    assert len(table.cdf) == count
    assert table.cdf[-1] == 1, "a gap at the end would give its chance to a light of another chance"
    assert (np.diff(table.cdf) >= 0).all()
    widths = np.diff(table.cdf.astype(np.float64), prepend=0)
    assert np.abs(widths - table.pmf).max() <= 2**-23  # two roundings of numbers up to one


def test_a_scene_without_lights_has_an_empty_table():
    assert len(light_table(scene_of([(FLOOR, matt(1))])).kind) == 0


def test_bad_choices_are_refused():
    scene = scene_of([(FLOOR, matt(1))], [EnvironmentLight(1), EnvironmentLight(2)])
    with pytest.raises(ValueError, match="at most one environment"):
        light_table(scene)
    with pytest.raises(ValueError, match="uniform, power, tree"):
        light_table(scene, "random")
    with pytest.raises(ValueError, match="no light"):
        trace_frame(scene.with_lights([]), view((0, 1.5, 1.5), (0, 0, 0)), 1)


@numba.njit
def choose_all(table, numbers, out):
    lights = light_pointers(table)
    for i in range(len(numbers)):
        out[i] = choose_light(lights, numbers[i])


def chosen(cdf, numbers):
    table = light_table(scene_of([(FLOOR, matt(1))], [PointLight((0, 1, 0), 1)]))
    out = np.full(len(numbers), -1)
    choose_all(table._replace(cdf=np.array(cdf, dtype=np.float32)), np.array(numbers, dtype=np.float32), out)
    return out.tolist()


def test_a_light_is_chosen_where_the_random_number_falls():
    assert chosen([1], [0, 0.5, LARGEST]) == [0, 0, 0]
    assert chosen([0.25, 0.75, 1], [0, 0.2499, 0.25, 0.7499, 0.75, LARGEST]) == [0, 0, 1, 1, 2, 2]


def test_a_light_without_a_chance_is_never_chosen():
    assert chosen([0, 0, 0.5, 0.5, 1, 1, 1], [0, 0.4999, 0.5, LARGEST]) == [2, 2, 4, 4]


def test_numbers_beyond_the_last_sum_choose_the_last_light():
    assert chosen([0.5, 1 - 2**-23], [1 - 2**-23, LARGEST]) == [1, 1]


def test_the_search_is_the_obvious_one():
    generator = np.random.default_rng(1)
    for count in (1, 2, 3, 64, 1000):
        cdf = np.cumsum(generator.exponential(size=count)).astype(np.float32)
        cdf /= cdf[-1]
        numbers = generator.random(500, dtype=np.float32)
        assert chosen(cdf, numbers) == [next(i for i in range(count) if number < cdf[i]) for number in numbers]


# What the choice means for the picture

POINTS = [((0, 3, 0), 50.0), ((1, 2, 1), 1.0), ((-1, 2.5, 0.5), 0.3), ((0.5, 1.5, -1), 0.1)]


def contributions(camera):
    """Radiance of each of :data:`POINTS` on a white floor, shape (lights, h w)."""
    points = seen_points(camera, (0, 0, 0), (0, 1, 0))
    towards = np.array([position for position, _ in POINTS])[:, None] - points
    distance = np.linalg.norm(towards, axis=2)
    return np.array([intensity for _, intensity in POINTS])[:, None] * towards[..., 1] / distance**3 / math.pi


@pytest.mark.parametrize("lights", ["uniform", "power"])
def test_mean_and_variance_are_those_of_the_choice(lights):
    """With lights of radiance c_i chosen with chance p_i a sample is c_i / p_i: its mean is sum c_i, whatever the
    chances, and its mean square sum c_i^2 / p_i."""
    scene = scene_of([(FLOOR, matt(1))], [PointLight(*light) for light in POINTS])
    camera = view((0, 1.5, 1.5), (0, 0, 0), size=4)
    intensities = np.array([intensity for _, intensity in POINTS])
    chances = by_power(intensities) if lights == "power" else np.full(4, 0.25)
    expected = contributions(camera)
    frames = [trace_frame(scene, camera, 256, seed=seed, integrator=Integrator(lights=lights)) for seed in range(32)]
    direct = np.concatenate([pixels(frame.direct) for frame in frames])
    squares = np.concatenate([pixels(frame.luminance_squared) for frame in frames])
    assert direct.mean() == pytest.approx(expected.sum(0).mean(), rel=0.01)
    assert_mean(direct[..., 0], expected.sum(0))
    assert_mean(squares[..., 0], (expected**2 / chances[:, None]).sum(0))


def test_choosing_by_power_has_less_variance_where_lights_differ():
    scene = scene_of([(FLOOR, matt(1))], [PointLight(*light) for light in POINTS])
    camera = view((0, 1.5, 1.5), (0, 0, 0), size=16)
    spread = {}
    for lights in ("uniform", "power"):
        frame = trace_frame(scene, camera, 1024, integrator=Integrator(lights=lights))
        mean = (frame.radiance * torch.from_numpy(LUMINANCE).float().reshape(1, 3, 1, 1)).sum(1, keepdim=True)
        spread[lights] = (frame.luminance_squared - mean**2).mean()
    assert spread["power"] < 0.2 * spread["uniform"]


@pytest.mark.parametrize("lights", ["uniform", "power", "tree"])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_dark_lights_change_nothing(lights, place):
    sources = [PointLight((0, 3, 0), 5), PointLight((1, 2, 1), 2)]
    dark = [PointLight((0, 1, 0), 0), DirectionalLight((0, -1, 0), 0), EnvironmentLight(0)]
    camera = view((0, 1.5, 1.5), (0, 0, 0), size=4)
    sources[place:place] = dark
    scene = scene_of([(FLOOR, matt(1))], sources)
    frames = [trace_frame(scene, camera, 128, seed=seed, integrator=Integrator(lights=lights)) for seed in range(16)]
    direct = np.concatenate([pixels(frame.direct)[..., 0] for frame in frames])
    assert np.isfinite(direct).all()
    points = seen_points(camera, (0, 0, 0), (0, 1, 0))
    expected = 0
    for position, intensity in (((0, 3, 0), 5), ((1, 2, 1), 2)):
        towards = np.array(position) - points
        expected = expected + intensity * towards[:, 1] / np.linalg.norm(towards, axis=1) ** 3 / math.pi
    assert_mean(direct.mean(1), expected.mean())


@pytest.mark.parametrize("lights", ["uniform", "power", "tree"])
def test_a_scene_of_dark_lights_is_black(lights):
    scene = scene_of([(FLOOR, matt(1))], [PointLight((0, 1, 0), 0), EnvironmentLight(0)])
    frame = trace_frame(scene, view((0, 1.5, 1.5), (0, 0, 0)), 8, integrator=Integrator(lights=lights))
    assert (frame.radiance == 0).all()
    assert (frame.luminance_squared == 0).all()


# The sky as an image


def sky_radiance(image, directions):
    """Radiance of an equirectangular image: bilinear, around in azimuth, clamped at the poles. Shape (n, 3)."""
    height, width = image.shape[1:]
    padded = np.pad(np.pad(image, ((0, 0), (0, 0), (1, 1)), mode="wrap"), ((0, 0), (1, 1), (0, 0)), mode="edge")
    x, y, z = directions.T
    column = (np.arctan2(x, -z) / (2 * math.pi) + 0.5) * width + 0.5  # the pad shifts by one, the centres by a half
    row = np.arccos(np.clip(y, -1, 1)) / math.pi * height + 0.5
    return np.stack([ndimage.map_coordinates(channel, [row, column], order=1) for channel in padded], 1)


def seen(image, direction):
    """What a camera sees of the sky in one direction."""
    triangle = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=torch.float64)
    eye = np.array([50.0, 60.0, 70.0])  # the triangle is out of the way
    up = (0, 0, 1) if direction[1] else (0, 1, 0)
    camera = view(tuple(eye), tuple(eye + direction), size=1, fov=1e-3, up=up)
    frame = trace_frame(scene_of([(triangle, matt(1))], [EnvironmentLight(image)]), camera, 1)
    assert not frame.gbuffer.hit.any()
    return frame.emission[0, :, 0, 0].tolist()


def test_the_sky_is_where_its_documentation_says():
    image = torch.zeros(3, 4, 8)
    image[0, 0] = 1  # the top row is red,
    image[1, :, 3:5] = 1  # the middle columns green,
    image[2, 1:3, 5:7] = 1  # those a quarter of the width to the right of it blue at half height
    assert seen(image, (0, 1, 0))[0] == pytest.approx(1)
    assert seen(image, (0, -1, 0))[0] == pytest.approx(0)
    assert seen(image, (0, 0, -1)) == pytest.approx([0, 1, 0], abs=1e-4)
    assert seen(image, (1, 0, 0)) == pytest.approx([0, 0, 1], abs=1e-4)
    assert seen(image, (0, 0, 1)) == pytest.approx([0, 0, 0], abs=1e-4)
    assert seen(image, (-1, 0, 0)) == pytest.approx([0, 0, 0], abs=1e-4)


@pytest.mark.parametrize("target", [(0, 0, -1), (0, 0, 1), (1, 1, 0), (0.1, 1, 0), (-0.1, -1, 0.1)])
def test_the_sky_behind_everything_is_interpolated(target):
    image = np.random.default_rng(4).random((3, 6, 11))
    triangle = torch.tensor([[[0.0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]]], dtype=torch.float64)
    eye = (50.0, 60.0, 70.0)
    camera = view(eye, tuple(e + t for e, t in zip(eye, target, strict=True)), size=32, fov=110)
    scene = scene_of([(triangle, matt(1))], [EnvironmentLight(torch.from_numpy(image).float())])
    frame = trace_frame(scene, camera, 1)
    directions = camera.views.to(torch.float64).rays().directions[0].numpy()
    # A direction is known to 2^-23, a turn about the pole to 2^-23 / 0.01 there, times texels of the width.
    np.testing.assert_allclose(pixels(frame.emission)[0], sky_radiance(image, directions), atol=5e-5)


def sky_irradiance(image, normal, rows=240):
    """Integral of radiance times cosine by the midpoint rule."""
    theta = (np.arange(rows) + 0.5) / rows * math.pi
    phi = (np.arange(2 * rows) + 0.5) / rows * math.pi
    theta, phi = (grid.ravel() for grid in np.meshgrid(theta, phi, indexing="ij"))
    directions = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], 1)
    weights = np.sin(theta) * (math.pi / rows) ** 2 * np.maximum(0, directions @ np.asarray(normal, dtype=float))
    return weights @ sky_radiance(image, directions)


def lit_by_sky(image, axis, side, seeds=16):
    """Batches of the radiance of a white square that faces along an axis, shape (2 seeds, 3); and its normal."""
    normal, first, second = np.eye(3)[axis] * side, np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3] * side
    square = rectangle(tuple(-first - second), tuple(2 * first), tuple(2 * second))
    scene = scene_of([(square, matt(1))], [EnvironmentLight(torch.from_numpy(image).float())])
    camera = view(tuple(2 * normal), (0, 0, 0), size=8, fov=30, up=tuple(first))
    frames = [trace_frame(scene, camera, 32, seed=seed) for seed in range(seeds)]
    assert (frames[0].gbuffer.normal[0, :, 0, 0].numpy() == normal).all()
    return np.concatenate([pixels(frame.direct).mean(1) for frame in frames]), normal


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_sky_image_lights_every_side_with_its_own_irradiance(axis, side):
    image = np.random.default_rng(5).random((3, 6, 10)) ** 3
    radiance, normal = lit_by_sky(image, axis, side)
    expected = sky_irradiance(image, normal) / math.pi
    assert_mean(radiance, expected)
    np.testing.assert_allclose(radiance.mean(0), expected, rtol=0.02)


def test_one_bright_texel_lights_the_sides_that_face_it():
    """Around 101 degrees from -z towards +x, at the horizon and at most 34 degrees wide: +x and +z, never -x."""
    image = np.zeros((3, 8, 16))
    image[:, 3:5, 12] = 100
    sides = {(axis, side): lit_by_sky(image, axis, side)[0] for axis in range(3) for side in (1, -1)}
    means = {key: radiance.mean() for key, radiance in sides.items()}
    assert means[0, -1] == 0
    assert means[0, 1] > means[2, 1] > means[2, -1] > 0, "+x first, then +z, since it lies 11 degrees beyond +x"
    assert means[0, 1] > 2 * max(means[1, 1], means[1, -1])
    for (axis, side), radiance in sides.items():
        assert_mean(radiance[:, 0], sky_irradiance(image, np.eye(3)[axis] * side)[0] / math.pi)


# Directions


@numba.njit
def draw(normal, numbers, out):
    for i in range(len(numbers)):
        direction = cosine_direction(Vector(normal[0], normal[1], normal[2]), numbers[i, 0], numbers[i, 1])
        out[i, 0], out[i, 1], out[i, 2] = direction.x, direction.y, direction.z


NORMALS = [
    (0, 0, 1),
    (0, 0, -1),
    (0, 1, 0),
    (-1, 0, 0),
    (1e-4, -1e-4, -1),
    (0.3, 0.5, -1e-7),
    (0.6, -0.7, 0.4),
    (-1, -2, -3),
]


@pytest.mark.parametrize("normal", NORMALS)
def test_directions_about_a_normal_have_the_density_cosine_over_pi(normal):
    count = 100_000
    normal = (np.array(normal) / np.linalg.norm(normal)).astype(np.float32)
    out = np.empty((count, 3), dtype=np.float32)
    draw(normal, np.random.default_rng(6).random((count, 2), dtype=np.float32), out)
    assert np.abs(np.linalg.norm(out.astype(np.float64), axis=1) - 1).max() < 1e-6
    local, _ = np.linalg.qr(np.column_stack([normal, np.eye(3)[np.argmin(np.abs(normal))]]).astype(np.float64))
    x, y = out @ local[:, 1], out @ np.cross(normal, local[:, 1])
    cosine = out @ normal.astype(np.float64)
    assert cosine.min() > -1e-6
    # P(cosine < c) = c^2; the azimuth is uniform
    edges = np.linspace(0, 1, 9)
    counts, _, _ = np.histogram2d(np.clip(cosine, 0, 1), np.arctan2(y, x) / math.pi, [edges, np.linspace(-1, 1, 13)])
    chances = np.outer(np.diff(edges**2), np.full(12, 1 / 12))
    assert_counts(counts, chances, sidak(len(NORMALS), LEVEL))


def test_the_extreme_random_numbers_give_directions_on_the_hemisphere():
    numbers = np.array([(a, b) for a in (0, LARGEST) for b in (0, LARGEST)], dtype=np.float32)
    for normal in NORMALS:
        unit = (np.array(normal) / np.linalg.norm(normal)).astype(np.float32)
        out = np.empty((4, 3), dtype=np.float32)
        draw(unit, numbers, out)
        assert np.isfinite(out).all()
        np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(out[:2], np.stack([unit, unit]), atol=1e-6)


def test_a_strong_light_that_is_hidden_does_not_starve_a_weak_one():
    """Lamps of intensities 1 and 1000, the strong one behind a wall. A sample is c / p with chance p: its mean square
    is c^2 / p, with p just above 1/4 by power and 1/2 alike. By power alone p would be 1/1001."""
    wall = rectangle((-1, 1.9, -1), (2, 0, 0), (0, 0, 2))
    lamps = [PointLight((0, 1, 0), 1), PointLight((0, 2, 0), 1000)]
    scene = scene_of([(FLOOR, matt(1)), (wall, matt(0))], lamps)
    camera = view((0, 0.5, 1.0), (0, 0, 0), size=8)
    spread = {}
    for lights in ("uniform", "power"):
        frame = trace_frame(scene, camera, 1024, integrator=Integrator(lights=lights))
        mean = (frame.radiance * torch.from_numpy(LUMINANCE).float().reshape(1, 3, 1, 1)).sum(1, keepdim=True)
        spread[lights] = float((frame.luminance_squared - mean**2).mean())
    assert spread["power"] < 4 * spread["uniform"]
