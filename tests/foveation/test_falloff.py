"""The three-layer falloff against the printed numbers of the 2023 paper and integrals in closed form."""

import math

import pytest
import torch

from fovden.camera import FHD, QUEST2, Gaze, StereoCamera
from fovden.foveation import ThreeLayer, eccentricity_pixels

RAMPS = ("ramp_radius", "ramp_area", "flat", "table_spp")


@pytest.mark.parametrize(("resolution", "radii"), [(FHD, (144, 288)), (QUEST2, (265, 530)), ((8, 8), (1, 2))])
def test_hidden_rule_gives_the_papers_radii(resolution, radii):
    assert ThreeLayer().radii(resolution) == radii


@pytest.mark.parametrize(
    ("resolution", "areas"),
    [(FHD, (65144.07, 195432.20, 776223.74)), (QUEST2, (220618.34, 661855.03, 2634966.62))],
)
def test_table_samples_are_area_times_four_three_two(resolution, areas):
    """Table 1: areas from the radii, per eye, rounded, and 2,399,320 and 8,137,971 samples in all."""
    height, width = resolution
    falloff = ThreeLayer(ramp="table_spp")
    r0, r1 = falloff.radii(resolution)
    found = (math.pi * r0**2, math.pi * (r1**2 - r0**2), height * width - math.pi * r1**2)
    assert found == pytest.approx(areas, abs=0.006)
    rates = falloff.rate(torch.tensor([r0 / 2, 1.5 * r0, 3 * r0]), resolution)
    assert (4 * rates).tolist() == [4, 3, 2]
    total = sum(float(rate) * 4 * round(area) for rate, area in zip(rates, found, strict=True))
    assert total == (2_399_320 if resolution == FHD else 8_137_971)


def test_pixels_per_layer():
    distance = eccentricity_pixels(Gaze(torch.tensor([[480.0, 540.0]])), FHD)
    counts = torch.bincount(ThreeLayer().layer(distance, FHD).flatten(), minlength=3)
    assert counts.tolist() == [65_168, 195_432, 776_200]


@pytest.mark.parametrize(
    ("ramp", "mean"), [("ramp_radius", 13 / 18), ("ramp_area", 3 / 4), ("flat", 1 / 2), ("table_spp", 3 / 4)]
)
def test_mean_rate_over_the_area_of_the_middle_layer(ramp, mean):
    r = 100 + (torch.arange(100_000, dtype=torch.float64) + 0.5) * 1e-3  # midpoints between r0 = 100 and r1 = 200
    rate = ThreeLayer(r0=100, r1=200, ramp=ramp).rate(r, FHD)
    assert float((rate * r).sum() / r.sum()) == pytest.approx(mean, abs=1e-9)


def test_mean_rate_over_the_radius_of_the_middle_layer_is_the_tables():
    r = 100 + (torch.arange(1000, dtype=torch.float64) + 0.5) * 0.1
    assert float(ThreeLayer(r0=100, r1=200).rate(r, FHD).mean()) == pytest.approx(3 / 4, abs=1e-12)


@pytest.mark.parametrize("ramp", RAMPS)
@pytest.mark.parametrize(("p", "end"), [(0.5, "p"), (0.8, "p"), (0.5, "1-p"), (0.8, "1-p"), (0.3, "1-p"), (1.0, "p")])
def test_rate_is_one_at_the_gaze_and_within_zero_and_one(ramp, p, end):
    falloff = ThreeLayer(r0=10, r1=25, p=p, ramp=ramp, ramp_end=end)
    rate = falloff.rate(torch.linspace(0, 60, 6001), FHD)
    assert (rate[:1001] == 1).all()
    assert (rate[2502:] == torch.tensor(1 - p)).all()
    assert ((rate >= 0) & (rate <= 1)).all()
    if not (ramp == "flat" and p < 0.5):
        assert (rate.diff() <= 1e-6).all()  # never more samples farther out


def test_end_of_the_ramp():
    at_r1 = torch.tensor([25.0, 25.001])
    assert ThreeLayer(10, 25, p=0.8).rate(at_r1, FHD).tolist() == pytest.approx([0.8, 0.2])
    assert ThreeLayer(10, 25, p=0.8, ramp_end="1-p").rate(at_r1, FHD).tolist() == pytest.approx([0.2, 0.2])
    middle = torch.tensor([15.0])
    assert float(ThreeLayer(10, 25, p=0.8, ramp="table_spp").rate(middle, FHD)) == pytest.approx(0.9)
    assert float(ThreeLayer(10, 25, p=0.8, ramp="table_spp", ramp_end="1-p").rate(middle, FHD)) == pytest.approx(0.6)


def test_pixels_on_a_boundary():
    r = torch.tensor([10.0, 10.5, 11.0, 25.0, 25.5, 26.0])
    assert ThreeLayer(10, 25).layer(r, FHD).tolist() == [0, 1, 1, 1, 2, 2]
    assert ThreeLayer(10, 25, boundary="integer").layer(r, FHD).tolist() == [0, 0, 1, 1, 1, 2]
    assert ThreeLayer(10, 25, boundary="integer").rate(r, FHD)[1] == 1


def test_falloff_of_a_camera():
    camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(30, 40)).views
    gaze = Gaze(torch.tensor([[20.0, 15.0], [100.0, 15.0]]))
    falloff = ThreeLayer(r0=5, r1=12)
    rate, layer, radii, selects = falloff(camera, gaze)
    distance = eccentricity_pixels(gaze, (30, 40))
    assert torch.equal(rate, falloff.rate(distance, (30, 40)))
    assert torch.equal(layer, falloff.layer(distance, (30, 40)))
    assert (radii, selects) == ((5, 12), True)
    assert layer.dtype == torch.int32
    assert (layer[1] == 2).all()
    assert not ThreeLayer(ramp="table_spp")(camera, gaze).selects


def test_image_too_small_for_the_rule_has_an_outer_layer_only():
    falloff = ThreeLayer()
    assert falloff.radii((4, 4)) == (0, 0)
    assert torch.equal(falloff.rate(torch.tensor([0.0, 0.5, 3.0]), (4, 4)), torch.tensor([1, 0.5, 0.5]))


def test_rate_is_differentiable():
    r = torch.tensor([5.0, 12.0, 20.0, 40.0], dtype=torch.float64, requires_grad=True)
    for ramp in RAMPS:
        assert torch.autograd.gradcheck(lambda x, ramp=ramp: ThreeLayer(10, 25, ramp=ramp).rate(x, FHD), r)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"p": 0.4}, "ThreeLayer.p"),
        ({"p": 1.1}, "ThreeLayer.p"),
        ({"p": -0.1, "ramp_end": "1-p"}, "ThreeLayer.p"),
        ({"p": math.nan}, "ThreeLayer.p"),
        ({"r0": -1}, "ThreeLayer.r0"),
        ({"r0": 10, "r1": 9}, "ThreeLayer.r1"),
        ({"ramp": "linear"}, "ThreeLayer.ramp"),
        ({"ramp_end": "0"}, "ThreeLayer.ramp_end"),
        ({"boundary": "round"}, "ThreeLayer.boundary"),
    ],
)
def test_falloffs_that_cannot_be(arguments, name):
    with pytest.raises(ValueError, match=name):
        ThreeLayer(**arguments)


def test_outer_radius_below_the_rules_inner_one():
    with pytest.raises(ValueError, match="r1: expected at least r0, which is 144 at 960 x 1080, got 100"):
        ThreeLayer(r1=100).radii(FHD)
