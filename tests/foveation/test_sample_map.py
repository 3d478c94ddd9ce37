"""Sample maps: slow loops, printed numbers, and the statistics of the draw."""

import math

import pytest
import torch
from scipy import stats

from fovden.camera import FHD, Camera, Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.foveation import RateMap, SampleMap, ThreeLayer, sample_map, uniform_map
from fovden.rng import Stream, philox

SMALL = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(20, 24))
FULL = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=FHD)
SOURCES = ("philox", "stratified", "blue_noise")


def constant(rate: float, selects: bool = True):
    """A falloff with one rate everywhere."""

    def falloff(camera, _):
        shape = (camera.view_count, 1, *camera.resolution)
        return RateMap(torch.full(shape, rate), torch.zeros(shape, dtype=torch.int32), (), selects)

    return falloff


def test_map_equals_the_slow_loop():
    gaze = Gaze(torch.tensor([[5.2, 16.9], [30.0, 3.0]]))
    found = sample_map(ThreeLayer(r0=4, r1=9), SMALL, gaze, spp=3, seed=11)
    counts, layers, coords, expected = [], [], [], 0.0
    for view, (gx, gy) in enumerate(gaze.pixels.tolist()):
        for y in range(20):
            for x in range(24):
                r = math.hypot(x + 0.5 - gx, y + 0.5 - gy)
                layer = 0 if r <= 4 else 1 if r <= 9 else 2
                p = (1, 1 - 0.5 * (r - 4) / 5, 0.5)[layer]
                chosen = philox(11, int(Stream.MASK), y * 24 + x, 0, 0, 0)[0] < p
                counts.append(3 * int(chosen))
                layers.append(layer)
                coords += [[view, y, x]] if chosen else []
                expected += 3 * p
    assert found.counts.flatten().tolist() == counts
    assert found.layer.flatten().tolist() == layers
    assert found.coords.tolist() == coords
    assert found.paths == sum(counts)
    assert found.expected == pytest.approx(expected, rel=1e-6)
    assert found.counts.dtype == found.coords.dtype == found.layer.dtype == torch.int32


def test_full_resolution_has_the_expected_budget():
    found = sample_map(ThreeLayer(), FULL)
    assert found.radii == (144, 288)
    assert found.counts.shape == (1, 1, *FHD)
    assert round(found.expected / 2 / 4) == 594_401
    # K is a sum of independent coins: its variance is sum P (1 - P); both eyes repeat it, with four paths each.
    rate = ThreeLayer()(FULL.views, Gaze.center(FULL)).rate[:1].double()
    sigma = 2 * 4 * float((rate * (1 - rate)).sum().sqrt())
    assert abs(found.paths - found.expected) < 4 * sigma
    assert found.paths == 4 * len(found.coords)
    assert found.mean_spp == found.paths / (2 * 1080 * 960)
    assert 1.70 < 4 / found.mean_spp < 1.78  # 1.744 times fewer paths than four everywhere


def test_table_spp_counts_are_four_three_two():
    found = sample_map(ThreeLayer(ramp="table_spp"), FULL, seed=5)
    assert torch.equal(found.counts, 4 - found.layer)
    assert found.paths == found.expected == 2 * (4 * 65_168 + 3 * 195_432 + 2 * 776_200)
    assert len(found.coords) == 2 * 1080 * 960


@pytest.mark.parametrize("source", SOURCES)
def test_actual_budget_is_near_the_expected_one(source):
    """Independent coins have the largest variance of the three sources."""
    camera = SMALL.at(resolution=(100, 120))
    for seed in range(5):
        found = sample_map(ThreeLayer(), camera, seed=seed, source=source)
        rate = ThreeLayer()(camera.views, Gaze.center(camera)).rate[:1].double()
        sigma = 2 * 4 * float((rate * (1 - rate)).sum().sqrt())
        assert abs(found.paths - found.expected) < 4 * sigma


def test_mask_is_uniform_within_every_ring():
    """Chi-square over rings of 24 pixels times 12 sectors around the gaze, at a level of 1e-4."""
    found = sample_map(ThreeLayer(), FULL, seed=1)
    rate, _, _, _ = ThreeLayer()(FULL.views, Gaze.center(FULL))
    y, x = torch.meshgrid(torch.arange(1080) + 0.5 - 540, torch.arange(960) + 0.5 - 480, indexing="ij")
    ring = (torch.hypot(x, y) / 24).long()
    sector = ((torch.atan2(y, x) + math.pi) / (2 * math.pi) * 12).long().clamp(max=11)
    cell = (ring * 12 + sector).flatten()
    p = rate[0].flatten().double()
    chosen = (found.counts > 0).flatten().double()
    expected = torch.bincount(cell, p)
    variance = torch.bincount(cell, p * (1 - p))
    drawn = torch.bincount(cell, chosen)
    assert torch.equal(drawn[variance == 0], expected[variance == 0])  # the inner layer is complete
    wide = variance > 50
    statistic = ((drawn - expected)[wide].square() / variance[wide]).sum()
    assert int(wide.sum()) > 200
    assert 1e-4 / 2 < stats.chi2.sf(float(statistic), int(wide.sum())) < 1 - 1e-4 / 2


def test_neighbours_are_independent():
    found = sample_map(constant(0.5), SMALL.at(resolution=(500, 500)), seed=2)
    chosen = 2.0 * (found.counts[0, 0] > 0) - 1
    for dy, dx in ((0, 1), (1, 0), (1, 1)):
        product = chosen[dy:, dx:] * chosen[: 500 - dy, : 500 - dx]
        # Products of independent fair signs: mean 0, variance 1 / n; four standard deviations.
        assert abs(float(product.mean())) < 4 / math.sqrt(product.numel())


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("rate", [0.3, 0.75])
def test_every_pixel_is_selected_with_its_rate(source, rate):
    """Over seeds each pixel is a coin: chi-square over pixels, at a level of 1e-4 for all six cases together."""
    camera = SMALL.at(resolution=(5, 7))
    seeds = 400
    drawn = sum((sample_map(constant(rate), camera, seed=s, source=source).counts > 0).double() for s in range(seeds))
    per_pixel = (drawn - seeds * rate).square() / (seeds * rate * (1 - rate))
    # Pixels of a block exclude each other in the stratified source and in blue noise, which makes their joint statistic
    # no chi-square; every single pixel's is one.
    level = 1 - (1 - 1e-4) ** (1 / (6 * 35))
    assert float(per_pixel.max()) < stats.chi2.isf(level, 1)
    assert float(per_pixel.max()) > 1  # a draw that ignores the seed would be 0 or huge


def test_stratified_blocks_hold_their_share_exactly():
    for rate, share in ((0.25, 1), (0.5, 2), (0.75, 3)):
        found = sample_map(constant(rate), SMALL, source="stratified", seed=3)
        blocks = torch.nn.functional.avg_pool2d(found.mask, 2) * 4
        assert (blocks == share).all()
    odd = sample_map(constant(0.5), SMALL.at(resolution=(21, 23)), source="stratified")
    assert odd.resolution == (21, 23)


def test_blue_noise_is_spread_more_evenly_than_chance():
    camera = SMALL.at(resolution=(256, 256))
    variance = {}
    for source in SOURCES:
        found = sample_map(constant(0.5), camera, source=source)
        variance[source] = float((torch.nn.functional.avg_pool2d(found.mask, 8) * 64).var())
    # 64 independent fair coins have variance 16; its estimate from 1024 blocks is good to 16 sqrt(2 / 1023) = 0.7.
    assert abs(variance["philox"] - 16) < 4 * 0.7
    assert variance["blue_noise"] < 16 / 4


@pytest.mark.parametrize("source", SOURCES)
def test_same_seed_same_map_other_seed_other_map(source):
    def draw(**changes):
        return sample_map(ThreeLayer(), SMALL, source=source, **changes).counts

    assert torch.equal(draw(seed=7), draw(seed=7))
    assert not torch.equal(draw(seed=7), draw(seed=8))
    assert not torch.equal(draw(seed=7), draw(seed=7, index=1))
    eyes = draw(seed=7, per_eye=True)
    assert eyes.shape[0] == 2
    assert torch.equal(eyes[:1], draw(seed=7))
    assert not torch.equal(eyes[0], eyes[1])


def test_global_random_state_is_neither_read_nor_written():
    torch.manual_seed(0)
    before = torch.get_rng_state()
    first = sample_map(ThreeLayer(), SMALL, source="blue_noise").counts
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(1)
    assert torch.equal(sample_map(ThreeLayer(), SMALL, source="blue_noise").counts, first)


def test_eyes_that_look_at_the_same_pixel_share_their_counts():
    found = sample_map(ThreeLayer(), SMALL, Gaze(torch.tensor([[3.0, 4.0], [3.0, 4.0]])))
    assert found.counts.shape[0] == found.layer.shape[0] == 1
    left, right = (found.coords[found.coords[:, 0] == view, 1:] for view in (0, 1))
    assert torch.equal(left, right)
    assert found.paths == 2 * int(found.counts.sum())
    assert found.view_count == 2


def test_one_view_alone():
    views = SMALL.views
    left = Camera(views.origin[:1], views.rotation[:1], views.bounds[:1], views.resolution)
    found = sample_map(ThreeLayer(), left)
    assert found.view_count == 1
    assert (found.coords[:, 0] == 0).all()
    assert found.paths == int(found.counts.sum())


@pytest.mark.parametrize("where", [(-50.0, -50.0), (1e6, 0.0), (0.0, 0.0), (24.0, 20.0), (12.3, 7.7)])
def test_gaze_anywhere(where):
    found = sample_map(ThreeLayer(), SMALL, Gaze(torch.tensor([where, where])))
    assert found.coords.shape[0] == 2 * int((found.counts > 0).sum())
    inside = 0 <= where[0] <= 24 and 0 <= where[1] <= 20
    assert bool((found.layer == 0).any()) == inside
    if not inside:
        assert (found.layer == 2).all()


def test_nothing_selected():
    far = Gaze(torch.full((2, 2), 1e5))
    for found in (sample_map(ThreeLayer(p=1.0), SMALL, far), uniform_map(SMALL, 0), sample_map(constant(0.0), SMALL)):
        assert found.coords.shape == (0, 3)
        assert found.coords.dtype == torch.int32
        assert found.paths == found.expected == 0
        assert not found.mask.any()


@pytest.mark.parametrize("source", SOURCES)
def test_full_rate_selects_every_pixel(source):
    found = sample_map(constant(1.0), SMALL, spp=2, source=source)
    assert (found.counts == 2).all()
    coords = torch.cartesian_prod(torch.arange(2), torch.arange(20), torch.arange(24))
    assert torch.equal(found.coords.long(), coords)


def test_uniform_map_has_the_mean_that_was_asked_for():
    camera = SMALL.at(resolution=(300, 400))
    found = uniform_map(camera, 2.3, seed=4)
    assert found.counts.unique().tolist() == [2, 3]
    n = 300 * 400
    # The number of threes is binomial (n, 0.3).
    assert abs(int((found.counts == 3).sum()) - 0.3 * n) < 4 * math.sqrt(n * 0.3 * 0.7)
    assert found.expected == pytest.approx(2.3 * 2 * n)
    assert (found.layer == 0).all()
    assert torch.equal(uniform_map(camera, 2.3, seed=4).counts, found.counts)
    assert not torch.equal(uniform_map(camera, 2.3, seed=5).counts, found.counts)
    assert uniform_map(camera, 2.3, per_eye=True).counts.shape[0] == 2
    assert (uniform_map(camera, 3).counts == 3).all()
    assert uniform_map(camera, 0.25).counts.unique().tolist() == [0, 1]


def test_rates_that_do_not_select_are_rounded_without_bias():
    camera = SMALL.at(resolution=(200, 200))
    found = sample_map(constant(0.4, selects=False), camera, spp=4)
    assert found.counts.unique().tolist() == [1, 2]
    # 1.6 samples each: the number of twos is binomial (n, 0.6).
    assert abs(int((found.counts == 2).sum()) - 0.6 * 40_000) < 4 * math.sqrt(40_000 * 0.6 * 0.4)


@pytest.mark.parametrize(
    ("arguments", "error", "name"),
    [
        ({"spp": 0}, ValueError, "spp"),
        ({"spp": 2.5}, TypeError, "spp"),
        ({"seed": -1}, ValueError, "seed"),
        ({"source": "sobol"}, ValueError, "source"),
        ({"index": -1}, ValueError, "sample"),
        ({"gaze": Gaze(torch.zeros(1, 2))}, ShapeError, "gaze"),
    ],
)
def test_arguments_out_of_range(arguments, error, name):
    with pytest.raises(error, match=name):
        sample_map(ThreeLayer(), SMALL, **arguments)


@pytest.mark.parametrize("rate", [1.5, -0.1, math.nan])
def test_falloff_with_rates_that_are_none(rate):
    with pytest.raises(ValueError, match=r"falloff\.rate"):
        sample_map(constant(rate), SMALL)


def test_falloff_of_another_size():
    def falloff(*_):
        return RateMap(torch.ones(1, 1, 20, 24), torch.zeros(1, 1, 20, 24, dtype=torch.int32))

    with pytest.raises(ShapeError, match=r"falloff\.rate"):
        sample_map(falloff, SMALL)


@pytest.mark.parametrize("mean", [-1, math.nan, math.inf])
def test_uniform_map_of_no_number(mean):
    with pytest.raises(ValueError, match="mean_spp"):
        uniform_map(SMALL, mean)


def test_counts_of_ones_own():
    counts = torch.tensor([[[[0, 1], [2, 0]]], [[[3, 0], [0, 0]]]])
    found = SampleMap.from_counts(counts, Gaze(torch.zeros(2, 2)))
    assert found.coords.tolist() == [[0, 0, 1], [0, 1, 0], [1, 0, 0]]
    assert (found.paths, found.expected, found.mean_spp) == (6, 6, 0.75)
    assert found.to("cpu", torch.float64).gaze.pixels.dtype == torch.float64
    assert found.to(torch.float16).counts.dtype == torch.int32
    with pytest.raises(ValueError, match="counts"):
        SampleMap.from_counts(-counts, Gaze(torch.zeros(2, 2)))
    with pytest.raises(ValueError, match="counts: expected an integer type"):
        SampleMap.from_counts(counts.float(), Gaze(torch.zeros(2, 2)))
    with pytest.raises(ValueError, match="counts"):
        SampleMap.from_counts(counts, Gaze(torch.zeros(3, 2)))
    with pytest.raises(ShapeError, match="layer"):
        SampleMap.from_counts(counts, Gaze(torch.zeros(2, 2)), layer=torch.zeros(1, 1, 2, 2, dtype=torch.int32))
