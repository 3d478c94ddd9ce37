"""How surfaces reflect: against textbook formulas, against quadrature, and samples against their densities.

The formulas in PyTorch are compared with others in double precision, the compiled kernels with them, and their samples
with the integrals of their density over bins of the sphere.
"""

import itertools
import math

import numpy as np
import pytest
import torch
from bsdf_kernels import (
    angles,
    directions,
    evaluated,
    facets,
    oren_nayar,
    reflected_by_facets,
    sampled,
    tensors,
    unit,
)
from shapes import matt, rectangle, scene_of, view
from significance import assert_counts, sidak

from fovden.tracer import Material, trace_gbuffer
from fovden.tracer.bsdf import density, evaluate, sample
from fovden.tracer.kernels.coat import COAT, LEAST, REFLECTED, SIZE
from fovden.tracer.materials import MODELS

UP = np.array([0.0, 0.0, 1.0])
TILTED = unit(np.array([0.3, -0.8, -0.52]))
SINGLE = 2.0**-24
WHITE = torch.ones(3, dtype=torch.float64)
FACETS = ("ggx", "ggx_separable")


def above(values):
    """Directions mirrored to above the third axis' horizon, not quite grazing."""
    values = np.array(values)
    values[:, 2] = np.maximum(np.abs(values[:, 2]), 1e-3)
    return unit(values)


VIEWERS, LIGHTS = above(directions(500, 1)), above(directions(500, 2))
ROUGHNESS, METALLIC = np.random.default_rng(3).uniform(0.05, 1, 500), np.random.default_rng(4).uniform(0, 1, 500)


def value_of(model, viewer=VIEWERS, light=LIGHTS, albedo=WHITE, roughness=ROUGHNESS, metallic=METALLIC, normal=UP):
    """The red channel, float64."""
    normal, viewer, light, roughness, metallic = tensors(normal, viewer, light, roughness, metallic)
    return evaluate(model, albedo, normal, viewer, light, roughness=roughness, metallic=metallic)[..., 0].numpy()


# Formulas


def test_lambert_and_oren_nayar_have_the_textbooks_values():
    np.testing.assert_allclose(value_of("lambert"), np.full(500, 1 / np.pi), rtol=1e-15)
    np.testing.assert_allclose(value_of("oren_nayar"), oren_nayar(VIEWERS, LIGHTS, ROUGHNESS), rtol=1e-9)
    np.testing.assert_allclose(value_of("oren_nayar", roughness=0.0), 1 / np.pi, rtol=1e-15)


@pytest.mark.parametrize("model", FACETS)
@pytest.mark.parametrize("base", [0.0, 0.3, 1.0])
def test_microfacets_have_the_textbooks_values(model, base):
    expected = facets(VIEWERS, LIGHTS, ROUGHNESS**2, base, separable=model == "ggx_separable")
    np.testing.assert_allclose(value_of(model, albedo=base * WHITE), expected, rtol=1e-8)


def test_the_mixture_is_a_metal_and_a_coated_base_as_in_gltf():
    for metallic in (0.0, 0.4, 1.0):
        metal = facets(VIEWERS, LIGHTS, ROUGHNESS**2, 0.6)
        through = [
            1 - np.array([share_of_coat(v[2], r) for v, r in zip(w, ROUGHNESS, strict=True)]) for w in (VIEWERS, LIGHTS)
        ]
        dielectric = facets(VIEWERS, LIGHTS, ROUGHNESS**2, 0.04) + 0.6 / np.pi * np.minimum(*through)
        expected = metallic * metal + (1 - metallic) * dielectric
        np.testing.assert_allclose(
            value_of("metallic_roughness", albedo=0.6 * WHITE, metallic=metallic), expected, rtol=1e-6
        )


def share_of_coat(cosine, roughness):
    """The coat's table, looked up as its axes say."""
    x = math.sqrt((roughness - LEAST) / (1 - LEAST)) * (SIZE - 1)
    y = cosine**0.25 * (SIZE - 1)
    i, j = min(int(x), SIZE - 2), min(int(y), SIZE - 2)
    corners = REFLECTED[i : i + 2, j : j + 2].astype(np.float64)
    return np.array([1 - (x - i), x - i]) @ corners @ np.array([1 - (y - j), y - j])


def test_the_coats_table_is_what_microfacets_reflect():
    """Quadrature over their normals; the table says 1 % more, lines between entries up to 1 % of everything less."""
    random = np.random.default_rng(8)
    for roughness, cosine in zip(random.uniform(LEAST, 1, 40), random.uniform(0.02, 1, 40) ** 2, strict=True):
        exact = reflected_by_facets(cosine, roughness**2, float(COAT))
        assert -2e-4 < share_of_coat(cosine, roughness) - exact < 0.02
    for i, j in [(0, 5), (4, 9), (12, 20), (23, 3), (23, 23)]:
        alpha = (LEAST + (1 - LEAST) * (i / (SIZE - 1)) ** 2) ** 2
        exact = reflected_by_facets((j / (SIZE - 1)) ** 4, alpha, float(COAT))
        assert REFLECTED[i, j] == pytest.approx(1.01 * exact, rel=2e-3)


@pytest.mark.parametrize("model", MODELS)
def test_viewer_and_light_can_be_exchanged(model):
    np.testing.assert_allclose(value_of(model), value_of(model, LIGHTS, VIEWERS), rtol=1e-9)
    there, back = (
        evaluated(model, UP, a, b, ROUGHNESS, METALLIC)[:, :2] for a, b in ((VIEWERS, LIGHTS), (LIGHTS, VIEWERS))
    )
    np.testing.assert_allclose(there, back, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_values_are_affine_in_the_albedo(model):
    black, grey, white = (value_of(model, albedo=x * WHITE) for x in (0.0, 0.25, 1.0))
    np.testing.assert_allclose(grey, black + 0.25 * (white - black), rtol=1e-12)
    assert (black >= 0).all()


@pytest.mark.parametrize("model", MODELS)
def test_nothing_is_reflected_below_the_horizon_and_viewers_there_are_mirrored(model):
    below = LIGHTS * [1, 1, -1]
    assert (value_of(model, light=below) == 0).all()
    assert (evaluated(model, UP, VIEWERS, below, ROUGHNESS, METALLIC) == 0).all()
    np.testing.assert_allclose(value_of(model, VIEWERS * [1, 1, -1]), value_of(model), rtol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_gradients(model):
    normal, viewer, light = (x[:6].clone().requires_grad_() for x in tensors(np.tile(UP, (6, 1)), VIEWERS, LIGHTS))
    albedo = torch.rand(6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)).requires_grad_()
    numbers = [x[:6].clone().requires_grad_() for x in tensors(np.linspace(0.2, 0.9, 6), METALLIC)]

    def both(albedo, normal, viewer, light, roughness, metallic):
        given = {"roughness": roughness, "metallic": metallic}
        return evaluate(model, albedo, normal, viewer, light, **given), density(model, normal, viewer, light, **given)

    assert torch.autograd.gradcheck(both, (albedo, normal, viewer, light, *numbers))


def test_an_unknown_model_is_refused():
    for function in (evaluate, sample):
        with pytest.raises(ValueError, match=r"model: expected one of lambert, .*, got velvet"):
            function("velvet", WHITE, WHITE, WHITE, WHITE)


# Energy


@pytest.mark.parametrize("model", MODELS)
def test_no_more_is_reflected_than_arrives(model):
    """The mean weight of white over a grid of random numbers: quadrature of the white furnace.

    Metals alone reflect all that is not lost between facets; smooth ones all but everything.
    """
    x, weight = np.polynomial.legendre.leggauss(64)
    xi_1, xi_2 = np.meshgrid((x + 1) / 2, (x + 1) / 2, indexing="ij")
    weights = torch.from_numpy(np.outer(weight, weight)[..., None] / 4)
    lobes = (1e-9, 1 - 1e-9) if model == "metallic_roughness" else (0.5,)
    for roughness, cosine, metallic in itertools.product(
        (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0),
        (1e-3, 0.01, 0.05, 0.1, 0.3, 0.6, 1.0),
        (0.0, 0.5, 1.0) if model == "metallic_roughness" else (0.0,),
    ):
        viewer = torch.tensor([math.sqrt(1 - cosine**2), 0, cosine], dtype=torch.float64)
        normal, given = torch.from_numpy(UP), {"roughness": roughness, "metallic": metallic}
        parts = []
        for xi_0 in lobes:
            xi = torch.from_numpy(np.stack([np.full_like(xi_1, xi_0), xi_1, xi_2], -1))
            parts.append((sample(model, WHITE, normal, viewer, xi, **given).weight * weights).sum((0, 1))[0].item())
        chance = chance_of_facets(roughness, metallic, normal, viewer) if len(parts) > 1 else 1.0
        reflected = chance * parts[0] + (1 - chance) * parts[-1]
        assert reflected < 1 + 2e-4  # what the quadrature itself is off, where only some directions are above
        if model in FACETS and roughness <= 0.1 and cosine >= 0.3:
            assert reflected > 0.99


def chance_of_facets(roughness, metallic, normal, viewer):
    """How often facets are sampled, from the densities of the mixture and of its two parts."""
    light = torch.nn.functional.normalize(torch.tensor([0.1, 0.4, 0.8], dtype=torch.float64), dim=0)
    given = {"roughness": roughness}
    both = density("metallic_roughness", normal, viewer, light, metallic=metallic, **given)
    mirrored, diffuse = (density(model, normal, viewer, light, **given) for model in ("ggx", "lambert"))
    return ((both - diffuse) / (mirrored - diffuse)).item()


# Kernels


@pytest.mark.parametrize("model", MODELS)
def test_kernels_evaluate_the_same_formulas(model):
    normal, viewer, light = directions(5000, 5), directions(5000, 6), directions(5000, 7)
    normal, viewer, light = (unit(x).astype(np.float32).astype(np.float64) for x in (normal, viewer, light))
    random = np.random.default_rng(9)
    roughness, metallic = random.uniform(0, 1, (2, 5000)).astype(np.float32).astype(np.float64)
    ours = evaluated(model, normal, viewer, light, roughness, metallic)
    given = {"roughness": torch.from_numpy(roughness), "metallic": torch.from_numpy(metallic)}
    vectors = tensors(normal, viewer, light)
    white = evaluate(model, 0 * WHITE, *vectors, **given)[:, 0]
    both = evaluate(model, WHITE, *vectors, **given)[:, 0]
    expected = torch.stack([white, both - white, density(model, *vectors, **given)], 1).numpy()
    assert (expected[:, 2] > 0).mean() == pytest.approx(0.5, abs=0.03)
    # Cosines are sums of products of numbers up to 1: off by some units of 2^-24, which matters where they are small.
    cosine = np.minimum(*(np.abs((normal * x).sum(1, keepdims=True)) for x in (viewer, light)))
    off = np.abs(ours - expected) / (expected + 0.01)
    assert (off < 30 * SINGLE / np.minimum(cosine, 0.3)).all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.4, 1.0])
def test_weights_are_value_times_cosine_over_density(model, roughness):
    xi = np.random.default_rng(12).random((4000, 3)).astype(np.float32)
    viewer = unit(TILTED + 0.9 * directions(4000, 13)).astype(np.float32)
    light, found = sampled(model, TILTED, viewer, xi, roughness, 0.3)
    failed = found[:, 2] == 0
    assert (found[failed] == 0).all()
    assert failed.mean() < 0.5
    cosine = (light * TILTED).sum(1)
    again = evaluated(model, TILTED, viewer, light, roughness, 0.3)
    kept = ~failed & (cosine > 0.01)
    # A rounded direction is off by 2^-24; relative to the lobe's width, 0.001 at least, that changes its density.
    np.testing.assert_allclose(found[kept, 2], again[kept, 2], rtol=2e-3 if roughness < 0.1 else 1e-4)
    weight = again[kept, :2] * cosine[kept, None] / again[kept, 2:]
    np.testing.assert_allclose(found[kept, :2], weight, rtol=1e-3, atol=2e-5)


def test_no_roughness_is_the_least_roughness():
    xi = np.random.default_rng(14).random((100, 3)).astype(np.float32)
    for model in (*FACETS, "metallic_roughness"):
        smooth, least = (sampled(model, UP, VIEWERS[0], xi, r, 0.5) for r in (0.0, float(LEAST) - 1e-4))
        np.testing.assert_array_equal(smooth[0], least[0])
        np.testing.assert_array_equal(smooth[1], least[1])


# Samples

SAMPLES = 200_000
BINS, NODES = (24, 48), 8
COSINES, GRAZING = (0.95, 0.4, 0.1), (0.95, 0.4, 0.03)
WIDE = [
    ("lambert", 1.0, 0.0),
    ("oren_nayar", 0.5, 0.0),
    *itertools.product(FACETS[:1], (0.5, 1.0), (0.0,)),
    *itertools.product(("metallic_roughness",), (0.5, 1.0), (0.0, 0.3, 1.0)),
]
NARROW = (0.0, 0.05, 0.15, 0.5)
TESTS = len(COSINES) * (len(WIDE) + len(NARROW))
"""Tests of samples against densities: all of them together fail by chance at the level of one."""


def viewer_at(cosine, turn=0.7):
    sine = math.sqrt(1 - cosine**2)
    return np.array([sine * math.cos(turn), sine * math.sin(turn), cosine])


def frame():
    """Two unit vectors across TILTED, and TILTED."""
    s = unit(np.cross(TILTED, [1.0, 0, 0]))
    return np.stack([s, np.cross(TILTED, s), TILTED])


def cells(count, low, high, nodes=NODES):
    """Gauss-Legendre nodes and weights inside each of ``count`` cells of [low, high], shape (count, nodes)."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    width = (high - low) / count
    return low + width * (np.arange(count)[:, None] + (x + 1) / 2), np.broadcast_to(weight / 2 * width, (count, nodes))


def assert_binned(counts, probabilities, level):
    """Chi-square over bins; those with fewer than 25 expected are counted together, with the samples that failed."""
    counts, expected = np.ravel(counts), SAMPLES * np.ravel(probabilities)
    assert probabilities.sum() < 1 + 1e-5
    few = expected < 25
    rest = SAMPLES - expected[~few].sum()
    many, chances = counts[~few], expected[~few] / SAMPLES
    if rest >= 25:
        many, chances = np.append(many, SAMPLES - many.sum()), np.append(chances, rest / SAMPLES)
    else:
        assert SAMPLES - many.sum() < rest + 10 * math.sqrt(rest + 1) + 10
        chances = chances / chances.sum()
    assert_counts(many, chances, level)


@pytest.mark.parametrize(("model", "roughness", "metallic"), WIDE)
@pytest.mark.parametrize("cosine", COSINES)
def test_samples_follow_their_density_over_the_sphere(model, roughness, metallic, cosine):
    """Bins of polar angle and azimuth about a tilted normal; the density is integrated in each."""
    axes = frame()
    xi = np.random.default_rng(20).random((SAMPLES, 3)).astype(np.float32)
    light, found = sampled(model, TILTED, viewer_at(cosine) @ axes, xi, roughness, metallic)
    theta, phi = angles((light @ axes.T)[found[:, 2] > 0])
    edges = np.linspace(0, np.pi / 2, BINS[0] + 1), np.linspace(-np.pi, np.pi, BINS[1] + 1)
    counts = np.histogram2d(theta, phi, bins=edges)[0]

    (t, weight_t), (p, weight_p) = cells(BINS[0], 0, np.pi / 2), cells(BINS[1], -np.pi, np.pi)
    t, p = t[:, :, None, None], p[None, None]
    nodes = np.stack(np.broadcast_arrays(np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)), -1)
    chance = density(model, *tensors(UP, viewer_at(cosine), nodes), roughness=roughness, metallic=metallic).numpy()
    probabilities = np.einsum("abcd,ab,cd->ac", chance * np.sin(t), weight_t, weight_p)
    assert_binned(counts, probabilities, sidak(TESTS))


@pytest.mark.parametrize("roughness", NARROW)
@pytest.mark.parametrize("cosine", GRAZING)
def test_samples_of_narrow_lobes_follow_their_density(roughness, cosine):
    """Bins of the mirroring facets' normals: of the random numbers by which Walter et al. would choose them."""
    axes, alpha = frame(), max(1e-3, roughness**2)
    viewer = viewer_at(cosine)
    xi = np.random.default_rng(21).random((SAMPLES, 3)).astype(np.float32)
    light, found = sampled("ggx", TILTED, viewer @ axes, xi, roughness)
    half = unit((light @ axes.T)[found[:, 2] > 0] + viewer)
    square = half[:, 0] ** 2 + half[:, 1] ** 2
    number = square / (square + alpha**2 * half[:, 2] ** 2)
    _, phi = angles(half)
    edges = np.linspace(0, 1, BINS[0] + 1), np.linspace(-np.pi, np.pi, BINS[1] + 1)
    counts = np.histogram2d(number, phi, bins=edges)[0]

    (u, weight_u), (p, weight_p) = cells(BINS[0], 0, 1, 24), cells(BINS[1], -np.pi, np.pi)
    u, p = u[:, :, None, None], p[None, None]
    tangent = alpha * np.sqrt(u / (1 - u))
    half = unit(np.stack(np.broadcast_arrays(tangent * np.cos(p), tangent * np.sin(p), 1), -1))
    between = half @ viewer
    light = 2 * between[..., None] * half - viewer
    chance = density("ggx", *tensors(UP, viewer, light), roughness=roughness).numpy()
    # Per normal, 4 v.h times that; per random number and azimuth, over D cos / (2 pi)
    facing = alpha**2 * half[..., 2] / (np.pi * (1 + (alpha**2 - 1) * half[..., 2] ** 2) ** 2)
    chance = np.where(between > 0, chance * 4 * between, 0) / facing / (2 * np.pi)
    assert_binned(counts, np.einsum("abcd,ab,cd->ac", chance, weight_u, weight_p), sidak(TESTS))


def test_samples_in_pytorch_are_those_of_the_kernels():
    xi = np.random.default_rng(30).random((2000, 3)).astype(np.float32)
    for model in MODELS:
        light, found = sampled(model, TILTED, VIEWERS[3], xi, 0.5, 0.4)
        normal, viewer, numbers = tensors(TILTED, VIEWERS[3], xi)
        bounce = sample(model, WHITE, normal, viewer, numbers, roughness=0.5, metallic=0.4)
        same = np.abs(light - bounce.direction.numpy()).max(1) < 1e-4
        assert same.mean() > 0.998  # a random number may lie on either side of the choice between lobes
        weight = bounce.weight[:, 0].numpy()
        np.testing.assert_allclose((found[:, 0] + found[:, 1])[same], weight[same], rtol=1e-3, atol=1e-4)


# Images


def test_the_gbuffer_has_the_perceptual_roughness():
    factors = torch.tensor([[[51, 255]]], dtype=torch.uint8)
    materials = [
        matt(0.5),
        Material("clay", (1, 1, 1), model="oren_nayar", roughness=0.3),
        Material("tin", (1, 1, 1), model="ggx", roughness=0.25),
        Material("lacquer", (1, 1, 1), model="metallic_roughness", roughness=0.5, surface=factors),
    ]
    for material, expected in zip(materials, (1, 1, 0.25, 0.1), strict=True):
        scene = scene_of([(rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0)), material)])
        roughness = trace_gbuffer(scene, view((0, 0, 1), (0, 0, 0), size=4)).roughness
        torch.testing.assert_close(roughness, torch.full_like(roughness, expected))
