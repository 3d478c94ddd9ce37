"""The sky as an image: sampled where it is bright, with densities that are those of the samples, and less noise."""

import math

import numba
import numpy as np
import pytest
import torch
from scipy import ndimage
from shapes import matt, pixels, rectangle, scene_of, view
from significance import assert_counts, assert_mean, assert_same_mean, sidak
from test_lights import sky_irradiance, sky_radiance

from fovden.tracer import EnvironmentLight, Integrator, PointLight, trace_frame
from fovden.tracer import sky as sky_module
from fovden.tracer.arrays import light_table
from fovden.tracer.kernels.illumination import (
    light_pointers,
    patches_density,
    sample_patches,
    sample_sky,
    sky_density,
)
from fovden.tracer.kernels.surface import Surface
from fovden.tracer.kernels.vectors import Vector
from fovden.tracer.sky import sky_arrays

FLOOR = rectangle((-4, 0, -4), (0, 0, 8), (8, 0, 0))
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def sunny(height=12, width=20):
    """A sky with a small sun that sends four fifths of the light, above darker ground; shape (3, h, w)."""
    random = np.random.default_rng(3)
    image = random.uniform(0.2, 0.6, (3, height, width))
    image[:, height // 2 :] *= 0.3
    image[:, 3, 5] = (3.0 * height * width / 4) * np.array([1.0, 0.9, 0.7])
    return image


IMAGES = {
    "sunny": sunny(),
    "noise": np.random.default_rng(4).random((3, 7, 9)) ** 4,
    "pole": np.pad(np.full((3, 1, 8), 5.0), ((0, 0), (0, 7), (0, 0)), constant_values=0.01),
    "one texel": np.pad(np.ones((3, 1, 1)), ((0, 0), (5, 2), (0, 15))),
}


@pytest.fixture(params=IMAGES)
def image(request):
    return IMAGES[request.param]


def table_of(image, lights=()):
    light = EnvironmentLight(torch.from_numpy(image).float())
    return light_table(scene_of([(FLOOR, matt(1))], [*lights, light]))


# The distribution


def sphere_grid(height, width):
    """Directions in the middle of cells of equal steps, and their solid angles."""
    theta, phi = (np.arange(height) + 0.5) / height * math.pi, ((np.arange(width) + 0.5) / width - 0.5) * 2 * math.pi
    t, p = (grid.ravel() for grid in np.meshgrid(theta, phi, indexing="ij"))
    directions = np.stack([np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)], 1)
    edges = np.cos(np.arange(height + 1) / height * math.pi)
    return directions.astype(np.float32), np.repeat((edges[:-1] - edges[1:]) * 2 * math.pi / width, width)


def excess_at(image, directions):
    """What exceeds the mean luminance of the sphere, between the middles of columns and rows; in double precision.

    Linear in the azimuth and, between two rows, in the cosine of the polar angle.
    """
    height, width = image.shape[1:]
    light = np.einsum("chw,c->hw", image, LUMINANCE)
    edges = np.cos(np.arange(height + 1) / height * math.pi)
    above = np.maximum(0, light - (light.mean(1) * (edges[:-1] - edges[1:]) / 2).sum())
    x, y, z = directions.astype(np.float64).T
    column = (np.arctan2(x, -z) / (2 * math.pi) + 0.5) * width - 0.5
    middles = np.cos((np.arange(height) + 0.5) / height * math.pi)
    row = np.interp(-y, -middles, np.arange(height))
    padded = np.pad(above, ((0, 0), (1, 1)), mode="wrap")
    return ndimage.map_coordinates(padded, [row, column + 1], order=1, mode="nearest")


def density_of(image):
    """Density per steradian of the patches, as a function of directions: normalised by quadrature."""
    directions, solid = sphere_grid(60 * image.shape[1], 30 * image.shape[2])
    total = excess_at(image, directions.astype(np.float64)) @ solid
    return lambda at: excess_at(image, at) / total


def test_a_patch_is_sampled_as_often_as_there_is_light_above_the_mean(image):
    arrays = sky_arrays(torch.from_numpy(image).float().permute(1, 2, 0))
    directions, solid = sphere_grid(60 * image.shape[1], 30 * image.shape[2])
    light, above = sky_radiance(image, directions) @ LUMINANCE @ solid, excess_at(image, directions) @ solid
    assert arrays.share == pytest.approx(min(0.75, above / light), rel=0.03)  # interpolated in different ways
    assert arrays.rows[-1] == 1
    assert (arrays.columns[:, -1] == 1).all()
    assert (np.diff(arrays.columns, axis=1) >= 0).all()
    row = np.searchsorted(-arrays.cosines[1:-1].astype(np.float64), -directions[:, 1].astype(np.float64))
    chances = np.bincount(row, excess_at(image, directions) * solid, image.shape[1] + 1) / above
    np.testing.assert_allclose(np.diff(arrays.rows, prepend=0), chances, atol=0.01)


@numba.njit
def draw_patches(table, numbers, directions, densities, found):
    lights = light_pointers(table)
    for i in range(len(numbers)):
        direction, densities[i] = sample_patches(lights, numbers[i, 0], numbers[i, 1])
        directions[i, 0], directions[i, 1], directions[i, 2] = direction.x, direction.y, direction.z
        found[i] = patches_density(lights, direction)


def cell_of(directions, height, width):
    """Row and column of directions, in double precision."""
    x, y, z = directions.astype(np.float64).T
    row = np.arccos(np.clip(y, -1, 1)) / math.pi * height
    column = (np.arctan2(x, -z) / (2 * math.pi) + 0.5) * width
    return row.astype(int).clip(0, height - 1), column.astype(int).clip(0, width - 1)


def test_directions_follow_the_distribution(image):
    """Chi-square over texels cut in 2 x 2, against quadrature of the twin's density."""
    height, width = 2 * image.shape[1], 2 * image.shape[2]
    count = 400_000
    numbers = np.random.default_rng(5).random((count, 2), dtype=np.float32)
    directions = np.empty((count, 3), np.float32)
    densities, found = np.empty(count, np.float32), np.empty(count, np.float32)
    draw_patches(table_of(image), numbers, directions, densities, found)
    assert np.abs(np.linalg.norm(directions.astype(np.float64), axis=1) - 1).max() < 1e-6
    # A direction is known to some 2^-22 of a turn, that is to 2^-17 of a column, and near the poles less.
    np.testing.assert_allclose(found, densities, atol=1e-3 * densities.max())
    density = density_of(image)
    np.testing.assert_allclose(densities, density(directions), atol=1e-3 * densities.max())
    grid, solid = sphere_grid(20 * height, 20 * width)
    cell = np.ravel_multi_index(cell_of(grid, height, width), (height, width))
    chances = np.bincount(cell, density(grid.astype(np.float64)) * solid, height * width)
    counts = np.bincount(
        np.ravel_multi_index(cell_of(directions, height, width), (height, width)), minlength=len(chances)
    )
    likely = chances * count > 30
    assert counts[chances == 0].sum() == 0
    assert_counts(counts[likely], chances[likely] / chances[likely].sum(), sidak(len(IMAGES)))


@numba.njit
def surface_with(normal):
    n = Vector(normal[0], normal[1], normal[2])
    return Surface(n, n, n, n, np.float32(0.0), 0, np.float32(1.0), np.float32(0.0))


@numba.njit
def densities_at(table, normal, directions, out):
    lights, surface = light_pointers(table), surface_with(normal)
    for i in range(len(directions)):
        out[i] = sky_density(lights, surface, Vector(directions[i, 0], directions[i, 1], directions[i, 2]))


@numba.njit
def draw_sky(table, normal, numbers, directions, densities):
    lights, surface = light_pointers(table), surface_with(normal)
    row = lights.sky_row
    for i in range(len(numbers)):
        s = sample_sky(lights, surface, row, lights.pmf[row], numbers[i, 0], numbers[i, 1])
        directions[i, 0], directions[i, 1], directions[i, 2] = s.direction.x, s.direction.y, s.direction.z
        densities[i] = s.density


@pytest.mark.parametrize("others", [0, 2])
def test_the_density_integrates_to_the_chance_of_the_sky(image, others):
    height, width = image.shape[1:]
    directions, solid = sphere_grid(50 * height, 50 * width)
    normal = np.array([0.36, 0.8, 0.48], dtype=np.float32)
    out = np.empty(len(directions), np.float32)
    densities_at(table_of(image, [PointLight((0, 1, 0), 1)] * others), normal, directions, out)
    assert out.astype(np.float64) @ solid == pytest.approx(1 / (1 + others), rel=1e-3)


def test_samples_follow_the_density_of_both_ways_together(image):
    """Chi-square over cells of the sphere; what is below the surface's horizon is drawn but of no use."""
    normal, count = np.array([0.36, -0.48, 0.8], dtype=np.float32), 400_000
    table = table_of(image)
    height, width = image.shape[1:]
    grid, solid = sphere_grid(20 * height, 20 * width)
    density = np.empty(len(grid), np.float32)
    densities_at(table, normal, grid, density)
    cell = np.ravel_multi_index(cell_of(grid, height, width), (height, width))
    above = grid @ normal > 0
    chances = np.bincount(cell[above], (density * solid)[above], height * width)
    numbers = np.random.default_rng(6).random((count, 2), dtype=np.float32)
    directions, drawn = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    draw_sky(table, normal, numbers, directions, drawn)
    useful = drawn > 0
    assert (directions[useful] @ normal > 0).all()
    counts = np.bincount(
        np.ravel_multi_index(cell_of(directions[useful], height, width), (height, width)), minlength=height * width
    )
    # Cells that the horizon or the sun's edge crosses are integrated to a few parts in a thousand only.
    inside = np.bincount(cell, above, height * width) == 400
    likely = inside & (chances * count > 100)
    expected = np.append(chances[likely], 1 - chances[likely].sum())
    assert_counts(np.append(counts[likely], count - counts[likely].sum()), expected, sidak(len(IMAGES)))


def test_an_even_sky_is_sampled_by_the_cosine_alone():
    for radiance in (torch.full((3, 6, 8), 0.7), torch.zeros(3, 4, 4), torch.ones(3, 1, 1)):
        assert sky_arrays(radiance.permute(1, 2, 0)).share == 0
    assert light_table(scene_of([(FLOOR, matt(1))], [EnvironmentLight(2)])).sky.share == 0


# Pictures


def lit(image, spp, seeds, *, bounces=0, normal=(0, 1, 0), lights=()):
    """Batches of the direct light on a white square under a sky, shape (2 seeds, 3)."""
    n = np.array(normal)
    first = np.eye(3)[(np.argmax(np.abs(n)) + 1) % 3]
    square = rectangle(tuple(-first - np.cross(n, first)), tuple(2 * first), tuple(2 * np.cross(n, first)))
    scene = scene_of([(square, matt(1))], [EnvironmentLight(torch.from_numpy(image).float()), *lights])
    camera = view(tuple(2.0 * n), (0, 0, 0), size=8, fov=30, up=tuple(first))
    setting = Integrator(bounces=bounces)
    frames = [trace_frame(scene, camera, spp, seed=seed, integrator=setting) for seed in range(seeds)]
    return np.concatenate([pixels(frame.direct).mean(1) for frame in frames])


@pytest.mark.parametrize("bounces", [0, 1])
@pytest.mark.parametrize("normal", [(0, 1, 0), (-1, 0, 0), (0, -1, 0)])
def test_a_sunny_sky_gives_its_irradiance_with_and_without_bounces(normal, bounces):
    expected = sky_irradiance(IMAGES["sunny"], normal, rows=960) / math.pi
    batches = lit(IMAGES["sunny"], 64, 32, bounces=bounces, normal=normal)
    np.testing.assert_allclose(batches.mean(0), expected, rtol=0.02)
    # The midpoint rule is off by some (pi / 960 / texel)^2 where the sun's interpolation bends; a tenth of the noise.
    assert_mean(batches, expected)


def test_less_noise_than_by_the_cosine_under_a_sun_and_the_same_mean(monkeypatch):
    ours = lit(IMAGES["sunny"], 16, 40)
    monkeypatch.setattr(sky_module, "GREATEST_SHARE", 0.0)
    theirs = lit(IMAGES["sunny"], 16, 40)
    assert_same_mean(ours, theirs)
    assert ours.var(0).mean() < 0.1 * theirs.var(0).mean()
