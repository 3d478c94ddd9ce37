"""Budgets of paths: against bisection and sorted lists, over seeds, sources, falloffs and gazes."""

import math
import re

import pytest
import torch
from scipy import stats

from fovden.camera import Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.foveation import (
    AcuityFalloff,
    GuenterLayers,
    HyperbolicFalloff,
    LinearFalloff,
    RateMap,
    ThreeLayer,
    mask_numbers,
    rates_at_budget,
    sample_map,
    select_exactly,
)

CAMERA = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(120, 104))
ASIDE = Gaze(torch.tensor([[20.0, 90.0], [-300.0, 40.0]]))  # one eye in a corner, the other outside of the image
PIXELS = 120 * 104
SOURCES = ("philox", "stratified", "blue_noise")
SPREAD = SOURCES[1:]
FALLOFFS = {
    "three layers": ThreeLayer(),
    "all of them, no mask": ThreeLayer(ramp="table_spp"),
    "linear": LinearFalloff(),
    "reddy": AcuityFalloff(),
    "hyperbolic": HyperbolicFalloff(display_mar=0.1),
    "guenter": GuenterLayers(slope=0.1),
}


def paths_by_view(samples):
    return samples.counts.expand(samples.view_count, -1, -1, -1).flatten(1).double().sum(1).tolist()


def bisected(rate, mean):
    """min(1, c rate) with the c that an interval halved 200 times leaves."""
    low, high = 0.0, 1 / min(each for each in rate if each > 0)
    for _ in range(200):
        middle = (low + high) / 2
        found = sum(min(1, middle * each) for each in rate) / len(rate)
        low, high = (middle, high) if found < mean else (low, middle)
    return [min(1, high * each) for each in rate]


@pytest.mark.parametrize("mean", [1e-4, 0.03, 0.2, 0.5, 0.8])
@pytest.mark.parametrize("name", ["spread", "steps", "zeros"])
def test_rates_equal_bisection(mean, name):
    uniform = torch.rand(2, 1, 6, 7, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    rate = {"spread": uniform**6, "steps": (4 * uniform).ceil() / 4, "zeros": (uniform - 0.1).clamp(min=0)}[name]
    found = rates_at_budget(rate, mean)
    for view in range(2):
        expected = bisected(rate[view].flatten().tolist(), mean)
        assert found[view].flatten().tolist() == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert float(found[view].mean()) == pytest.approx(mean, rel=1e-12)


def test_everything_and_single_precision():
    rate = torch.rand(1, 1, 50, 60, generator=torch.Generator().manual_seed(0)) + 1e-6
    assert (rates_at_budget(rate, 1.0) == 1).all()
    assert rates_at_budget(rate, 0.3).dtype == torch.float32
    half = torch.tensor([0.0, 0.2, 0.0, 0.9]).reshape(1, 1, 2, 2)
    assert torch.equal(rates_at_budget(half, 0.5), (half > 0).float())


def test_derivatives_keep_the_budget():
    rate = torch.rand(2, 1, 3, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda rate: rates_at_budget(rate, 0.6), rate)
    assert (rates_at_budget(rate, 0.6) == 1).any()
    (slope,) = torch.autograd.grad(rates_at_budget(rate, 0.6).sum(), rate)
    assert slope.abs().max() < 1e-12


def test_exact_masks_are_the_first_of_a_sorted_list():
    generator = torch.Generator().manual_seed(5)
    numbers, rate = torch.rand(1, 1, 8, 9, generator=generator), torch.rand(3, 1, 8, 9, generator=generator) ** 2
    rate[0, 0, :2] = 1
    rate[1, 0, 3:] = 0
    found = select_exactly(numbers, rate)
    for view in range(3):
        pairs = list(zip(numbers.flatten().tolist(), rate[view].flatten().tolist(), strict=True))
        odds = [math.inf if r == 0 else u / (1 - u) * (1 - r) / r for u, r in pairs]
        count = round(sum(r for _, r in pairs))
        first = set(sorted(range(72), key=odds.__getitem__)[:count])
        assert found[view].flatten().tolist() == [pixel in first for pixel in range(72)]
    assert found[0, 0, :2].all()
    assert not found[1, 0, 3:].any()


def test_ties_do_not_break_the_count():
    for count in range(17):
        found = select_exactly(torch.full((1, 1, 4, 4), 0.5), torch.full((1, 1, 4, 4), count / 16))
        assert int(found.sum()) == count


@pytest.mark.parametrize("source", SOURCES)
def test_exact_masks_keep_the_rates(source):
    """Over seeds each pixel is a coin of its own rate: chi-square by pixel at a level of 1e-4 for all of them."""
    y, x = torch.meshgrid(torch.arange(20.0), torch.arange(24.0), indexing="ij")
    rate = (1 / (1 + 0.02 * ((y - 6) ** 2 + (x - 8) ** 2)))[None, None].double()
    seeds = 250
    drawn = sum(select_exactly(mask_numbers((20, 24), seed, source=source), rate).double() for seed in range(seeds))
    # Pareto sampling approaches its rates with one over the number of pixels, far below the error of 250 draws.
    variance = seeds * rate * (1 - rate)
    wide = variance > 5
    per_pixel = ((drawn - seeds * rate).square() / variance)[wide]
    level = 1 - (1 - 1e-4) ** (1 / per_pixel.numel())
    assert per_pixel.max() < stats.chi2.isf(level, 1)
    assert 0.8 < per_pixel.mean() < 1.2  # its standard deviation is about sqrt(2 / 440) = 0.07


@pytest.mark.parametrize("gaze", [None, ASIDE], ids=["centre", "aside"])
@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("name", FALLOFFS)
def test_maps_meet_the_budget_in_each_eye(name, source, gaze):
    for seed, (spp, mean_spp) in enumerate([(1, 0.25), (4, 0.4), (4, 2.6), (2, 2.0)]):
        samples = sample_map(FALLOFFS[name], CAMERA, gaze, spp, seed, mean_spp=mean_spp, source=source)
        wanted = mean_spp * PIXELS
        assert samples.expected == pytest.approx(2 * wanted, rel=1e-6)
        assert samples.paths == sum(paths_by_view(samples))
        assert samples.counts.max() <= spp
        if source == "philox":
            rates = rates_at_budget(FALLOFFS[name](CAMERA.views, gaze or Gaze.center(CAMERA)).rate, mean_spp / spp)
            share = rates if name != "all of them, no mask" else (spp * rates) % 1
            unit = spp if name != "all of them, no mask" else 1
            sigma = unit * (share * (1 - share)).double().flatten(1).sum(1).sqrt()
            errors = [abs(found - wanted) for found in paths_by_view(samples)]
            assert all(error <= 4 * float(s) + 1e-2 for error, s in zip(errors, sigma, strict=True))
        else:  # half a pixel's paths, which is less than a thousandth here but for the smallest budget
            assert all(abs(found - wanted) <= spp / 2 + 1e-2 for found in paths_by_view(samples))
            assert all(abs(found / wanted - 1) < 1e-3 for found in paths_by_view(samples))


@pytest.mark.parametrize("source", SOURCES)
def test_local_densities_follow_the_rates(source):
    """Chi-square over blocks of 8 x 8 pixels: independent draws vary as much as coins do, the others less."""
    falloff, mean_spp = AcuityFalloff(), 0.25
    rate = rates_at_budget(falloff(CAMERA.views, ASIDE).rate, mean_spp)[:1].double()
    statistics = []
    pooled = torch.zeros(15, 13, dtype=torch.float64)
    for seed in range(12):
        mask = sample_map(falloff, CAMERA, ASIDE, 1, seed, mean_spp=mean_spp, source=source).mask[:1].double()
        excess = 64 * torch.nn.functional.avg_pool2d(mask - rate, 8)[0, 0]
        pooled += excess
        variance = 64 * torch.nn.functional.avg_pool2d(rate * (1 - rate), 8)[0, 0]
        assert not excess[variance == 0].any()
        statistics.append(float((excess.square() / variance)[variance > 3].sum()))
    cells = int((variance > 3).sum())
    assert cells > 60
    chance = stats.chi2.sf(sum(statistics), 12 * cells)
    if source == "philox":
        assert 1e-4 / 2 < chance < 1 - 1e-4 / 2
    else:
        assert sum(statistics) < 12 * cells / 3
    # Nor does anything add up over seeds: the same, block by block.
    assert (pooled.square() / (12 * variance))[variance > 3].max() < stats.chi2.isf(1e-4 / cells, 1)


def test_stratified_blocks_hold_different_parts_of_the_interval():
    numbers = mask_numbers((128, 192), seed=4, source="stratified")[0, 0]
    for size in (2, 4, 8, 16, 32, 64):
        blocks = numbers.unfold(0, size, size).unfold(1, size, size).reshape(-1, size * size)
        parts = (blocks.double() * size * size).long().sort(dim=1).values
        assert torch.equal(parts, torch.arange(size * size).expand_as(parts))
    assert len(numbers.unique()) > 0.99 * numbers.numel()


def test_layers_and_circles_stay_where_they_are():
    plain, scaled = (sample_map(ThreeLayer(), CAMERA, ASIDE, mean_spp=mean) for mean in (None, 0.3))
    assert torch.equal(plain.layer, scaled.layer)
    assert plain.radii == scaled.radii


@pytest.mark.parametrize("source", SPREAD)
def test_masks_are_frozen_or_of_each_frame_and_each_eye(source):
    def draw(**changes):
        return sample_map(LinearFalloff(), CAMERA, mean_spp=0.5, source=source, **changes)

    assert draw().counts.shape[0] == 1
    assert torch.equal(draw().counts, draw(index=0).counts)
    assert not torch.equal(draw().counts, draw(index=1).counts)
    eyes = draw(per_eye=True)
    assert not torch.equal(eyes.counts[0], eyes.counts[1])
    assert len(set(paths_by_view(eyes))) == 1


def test_tiny_blue_noise_rates_are_met_on_average():
    """A rate below the tile's 1 / 4096 selects its share nevertheless."""
    rate, seeds = 1e-4, 40
    drawn = sum(int((mask_numbers((256, 256), seed, source="blue_noise") < rate).sum()) for seed in range(seeds))
    mean = rate * seeds * 256 * 256
    assert abs(drawn - mean) < 4 * math.sqrt(mean)


def half_black(camera, _):
    rate = (torch.arange(camera.resolution[1]) % 2).expand(camera.view_count, 1, *camera.resolution).float()
    return RateMap(rate, torch.zeros_like(rate, dtype=torch.int32))


@pytest.mark.parametrize(
    ("falloff", "arguments", "error", "message"),
    [
        (ThreeLayer(), {"mean_spp": 0}, ValueError, "mean_spp: expected a finite number, above 0 and at most 4, got 0"),
        (ThreeLayer(), {"mean_spp": 4.1}, ValueError, "mean_spp"),
        (ThreeLayer(), {"mean_spp": math.nan}, ValueError, "mean_spp"),
        (ThreeLayer(), {"mean_spp": "1"}, TypeError, "mean_spp"),
        (
            half_black,
            {"mean_spp": 3},
            ValueError,
            "mean: expected at most 0.5, the share of pixels with a rate above 0",
        ),
        (ThreeLayer(), {"mean_spp": 1, "gaze": Gaze(torch.zeros(1, 2))}, ShapeError, "gaze.pixels"),
    ],
)
def test_budgets_that_cannot_be(falloff, arguments, error, message):
    with pytest.raises(error, match=re.escape(message)):
        sample_map(falloff, CAMERA, **arguments)


def test_bad_rates_and_numbers():
    with pytest.raises(ValueError, match="rate: expected finite values of at least 0, got nan at index"):
        rates_at_budget(torch.full((1, 1, 2, 2), math.nan), 0.5)
    with pytest.raises(ShapeError, match="rate"):
        rates_at_budget(torch.ones(2, 2), 0.5)
    with pytest.raises(ShapeError, match="numbers"):
        select_exactly(torch.rand(1, 1, 2, 3), torch.rand(1, 1, 2, 2))
    with pytest.raises(ValueError, match="numbers: expected 1 or 3 views, got 2 views"):
        select_exactly(torch.rand(2, 1, 2, 2), torch.rand(3, 1, 2, 2))
