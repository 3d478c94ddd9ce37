"""FLIP and HDR-FLIP against the authors' evaluator, and their behaviour where it has none."""

import math

import numpy as np
import pytest
import torch

from fovden import colormap
from fovden.checks import ShapeError
from fovden.metrics import (
    PIXELS_PER_DEGREE,
    flip,
    flip_map,
    hdr_flip,
    hdr_flip_map,
    monitor_pixels_per_degree,
    weighted_mean,
)
from fovden.metrics.flip_hdr import TONE_CURVES, exposure_range, tone_map

AGREEMENT = 1e-4
BOTH = pytest.mark.parametrize("metric", [flip, hdr_flip])


@pytest.fixture(autouse=True)
def one_thread():
    """On images as small as these, threads only wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def authors(
    image: torch.Tensor, reference: torch.Tensor, dynamic_range: str, **parameters
) -> tuple[torch.Tensor, list]:
    """Maps and the parameters that were used, by the authors' evaluator, view by view."""
    evaluator = pytest.importorskip("flip_evaluator", reason="FLIP's evaluator is not installed")
    maps, used = [], []
    for test, truth in zip(image, reference, strict=True):
        pixels = [tensor.permute(1, 2, 0).contiguous().float().numpy() for tensor in (truth, test)]
        found, mean, options = evaluator.evaluate(*pixels, dynamic_range, applyMagma=False, parameters=parameters)
        assert mean == pytest.approx(float(found.mean()), abs=2e-5)
        maps.append(torch.from_numpy(found[..., 0].copy()))
        used.append(options)
    return torch.stack(maps)[:, None], used


def assert_agreement(found: torch.Tensor, expected: torch.Tensor) -> None:
    assert found.shape == expected.shape
    assert float(expected.max()) > 0.005  # there is something to see
    assert float((found - expected).abs().max()) < AGREEMENT
    assert float((weighted_mean(found) - weighted_mean(expected)).abs().max()) < AGREEMENT


def noise(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def astronaut() -> torch.Tensor:
    from skimage import data

    return torch.from_numpy(data.astronaut()[60:260, 120:341]).permute(2, 0, 1)[None] / 255


def radiance(seed: int, *size: int, spread: float = 2.0) -> tuple[torch.Tensor, torch.Tensor]:
    """A noisy rendering and its reference with a log-normal range of brightness."""
    generator = torch.Generator().manual_seed(seed)
    reference = torch.exp(spread * torch.randn(2, 3, *size, generator=generator))
    return reference * torch.exp(0.3 * torch.randn(2, 3, *size, generator=generator)), reference


@pytest.mark.parametrize("ppd", [2.0, 8.378, 20.0, PIXELS_PER_DEGREE, 120.0])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (1, 9), (64, 64), (67, 129)])
def test_random_images_agree_with_the_evaluator(size, ppd):
    image, reference = noise(1, 2, 3, *size), noise(2, 2, 3, *size)
    expected, _ = authors(image, reference, "LDR", ppd=ppd)
    assert_agreement(flip_map(image, reference, pixels_per_degree=ppd), expected)


@pytest.mark.parametrize("ppd", [8.378, PIXELS_PER_DEGREE])
@pytest.mark.parametrize("change", ["noise", "shift", "darker", "blocks", "tint"])
def test_photographs_agree_with_the_evaluator(change, ppd):
    reference = astronaut()
    image = {
        "noise": lambda: reference + 0.05 * (noise(3, *reference.shape) - 0.5),
        "shift": lambda: reference.roll(1, dims=3),
        "darker": lambda: 0.9 * reference,
        "blocks": lambda: reference[..., ::4, ::4].repeat_interleave(4, 2).repeat_interleave(4, 3)[..., :200, :221],
        "tint": lambda: reference * torch.tensor([1.0, 0.97, 0.9]).reshape(3, 1, 1),
    }[change]().clamp(0, 1)
    expected, _ = authors(image, reference, "LDR", ppd=ppd)
    assert_agreement(flip_map(image, reference, pixels_per_degree=ppd), expected)


@pytest.mark.parametrize(("image", "reference"), [(0.0, 1.0), (0.3, 0.9), (0.5, 0.51), (0.02, 0.0)])
def test_constant_images_agree_with_the_evaluator(image, reference):
    pair = torch.full((1, 3, 20, 30), image), torch.full((1, 3, 20, 30), reference)
    assert_agreement(flip_map(*pair), authors(*pair, "LDR")[0])


def test_primary_colours_agree_with_the_evaluator():
    colors = torch.cartesian_prod(*[torch.tensor([0.0, 1.0])] * 3)
    image, reference = torch.meshgrid(torch.arange(8), torch.arange(8), indexing="ij")
    pair = [colors[index].permute(2, 0, 1)[None].repeat_interleave(5, 2).repeat_interleave(5, 3)
            for index in (image, reference)]  # fmt: skip
    expected, _ = authors(*pair, "LDR", ppd=12.0)
    assert_agreement(flip_map(*pair, pixels_per_degree=12.0), expected)
    assert float(expected.max()) > 0.99


def test_double_precision_agrees_with_the_evaluator():
    image, reference = noise(1, 1, 3, 40, 50).double(), noise(2, 1, 3, 40, 50).double()
    found = flip_map(image, reference)
    assert found.dtype == torch.float64
    assert_agreement(found.float(), authors(image, reference, "LDR")[0])


@pytest.mark.parametrize("tone_mapper", TONE_CURVES)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (33, 75)])
def test_radiance_agrees_with_the_evaluator(tone_mapper, size):
    image, reference = radiance(4, *size)
    expected, used = authors(image, reference, "HDR", tonemapper=tone_mapper)
    assert_agreement(hdr_flip_map(image, reference, tone_mapper=tone_mapper), expected)
    start, stop = exposure_range(reference, tone_mapper)
    assert start == pytest.approx([options["startExposure"] for options in used], abs=1e-5)
    assert stop == pytest.approx([options["stopExposure"] for options in used], abs=1e-5)


def test_a_wide_range_agrees_with_the_evaluator():
    image, reference = radiance(5, 24, 31, spread=6.0)
    image, reference = image[:1], reference[:1]
    expected, used = authors(image, reference, "HDR", ppd=15.0)
    assert used[0]["numExposures"] > 20
    assert_agreement(hdr_flip_map(image, reference, pixels_per_degree=15.0), expected)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (
            {"start_exposure": -1.0, "stop_exposure": 2.5, "exposure_count": 3},
            {"startExposure": -1.0, "stopExposure": 2.5, "numExposures": 3},
        ),
        ({"start_exposure": -4.0}, {"startExposure": -4.0}),
        ({"stop_exposure": 3.0}, {"stopExposure": 3.0}),
        ({"exposure_count": 2}, {"numExposures": 2}),
    ],
)
def test_chosen_exposures_agree_with_the_evaluator(ours, theirs):
    image, reference = radiance(6, 30, 26)
    assert_agreement(hdr_flip_map(image, reference, **ours), authors(image, reference, "HDR", **theirs)[0])


def test_a_narrow_range_agrees_with_the_evaluator():
    image, reference = radiance(8, 20, 21, spread=0.2)
    expected, used = authors(image, reference, "HDR")
    assert [options["numExposures"] for options in used] == [2, 2]
    assert used[0]["stopExposure"] - used[0]["startExposure"] > 0.3
    assert_agreement(hdr_flip_map(image, reference), expected)


def test_constant_radiance_and_dark_parts_agree_with_the_evaluator():
    pair = torch.full((1, 3, 5, 6), 0.5), torch.full((1, 3, 5, 6), 2.0)
    assert_agreement(hdr_flip_map(*pair), authors(*pair, "HDR")[0])
    image, reference = radiance(7, 30, 26)
    reference[..., ::3] = 0  # a third of the pixels is black
    assert_agreement(hdr_flip_map(image, reference), authors(image, reference, "HDR")[0])


def test_error_colours_agree_with_the_evaluator():
    evaluator = pytest.importorskip("flip_evaluator", reason="FLIP's evaluator is not installed")
    image, reference = noise(1, 1, 3, 40, 50), noise(2, 1, 3, 40, 50)
    pixels = [tensor[0].permute(1, 2, 0).contiguous().numpy() for tensor in (reference, image)]
    expected = evaluator.evaluate(*pixels, "LDR", applyMagma=True)[0]
    error, _ = authors(image, reference, "LDR")
    found = colormap.apply(error)[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(found, expected, atol=1 / 255)  # ours are bytes


@pytest.mark.parametrize("middle", [1, 2])
def test_exposures_of_known_luminances(middle):
    """The curve of Reinhard is x / (1 + x), so 0.85 is shown at x = 0.85 / 0.15."""
    levels = torch.tensor([0.25, 4.0, 32.0] if middle == 1 else [0.25, 0.5, 4.0, 32.0])
    start, stop = exposure_range(levels.expand(1, 3, 1, -1), "reinhard")
    assert start[0] == pytest.approx(math.log2(0.85 / 0.15 / 32), abs=1e-6)
    assert stop[0] == pytest.approx(math.log2(0.85 / 0.15 / 4), abs=1e-6)


@pytest.mark.parametrize("tone_mapper", TONE_CURVES)
def test_the_first_exposure_shows_the_brightest_pixel_at_its_target(tone_mapper):
    grey = torch.tensor([0.01, 0.3, 7.0]).expand(1, 3, 1, 3)
    start, stop = exposure_range(grey, tone_mapper)
    assert float(tone_map(grey, start[0], tone_mapper)[0, 0, 0, 2]) == pytest.approx(0.85, abs=1e-5)
    assert float(tone_map(grey, stop[0], tone_mapper)[0, 0, 0, 1]) == pytest.approx(0.85, abs=1e-5)


def test_tone_curve_of_hable_is_his():
    """J. Hable's six constants, white at 11.2 and exposure 2."""

    def curve(x: float) -> float:
        a, b, c, d, e, f = 0.15, 0.5, 0.1, 0.2, 0.02, 0.3
        return (x * (a * x + c * b) + d * e) / (x * (a * x + b) + d * f) - e / f

    for x in (0.0, 0.1, 0.7, 2.0):
        shown = float(tone_map(torch.full((1, 3, 1, 1), x), 0.0, "hable")[0, 0, 0, 0])
        assert shown == pytest.approx(curve(2 * x) / curve(11.2), abs=1e-5)


@pytest.mark.parametrize("tone_mapper", TONE_CURVES)
def test_tone_curves_of_extreme_radiance(tone_mapper):
    extreme = torch.tensor([0.0, 1e-38, 1e20, 3e38]).expand(1, 3, 1, 4)
    for exposure in (-127.0, 0.0, 127.0):
        shown = tone_map(extreme, exposure, tone_mapper)
        assert torch.isfinite(shown).all()
        assert float(shown[..., 0].max()) == 0
    assert float(tone_map(extreme, 0.0, tone_mapper)[..., 2:].min()) == pytest.approx(1)


def test_a_reference_that_is_mostly_black_uses_the_median_of_the_rest():
    reference = torch.zeros(1, 3, 4, 4)
    reference[..., 0, :3] = torch.tensor([1.0, 2.0, 16.0])
    start, stop = exposure_range(reference)
    lit = exposure_range(reference[..., :1, :3])
    assert (start, stop) == lit
    assert stop[0] - start[0] == pytest.approx(3)
    assert torch.isfinite(hdr_flip_map(reference + 0.1, reference)).all()


def test_a_black_reference_is_looked_at_as_it_is():
    black = torch.zeros(1, 3, 6, 7)
    assert exposure_range(black) == ([0.0], [0.0])
    assert float(hdr_flip(black, black)) == 0
    image = torch.full_like(black, 0.3)
    expected = hdr_flip(image, black, start_exposure=0.0, stop_exposure=0.0)
    assert float(hdr_flip(image, black)) == float(expected) > 0.1
    both = torch.cat([black, torch.ones_like(black)])
    assert exposure_range(both)[0][0] == 0  # each view by itself


def test_pixels_per_degree_of_a_monitor():
    assert PIXELS_PER_DEGREE == monitor_pixels_per_degree() == pytest.approx(67.0206433)
    # A pixel of 0.2 mm seen from 0.5 m covers 0.2e-3 / 0.5 radians, at the centre.
    assert monitor_pixels_per_degree(0.5, 0.4, 2000) == pytest.approx(1 / math.degrees(0.2e-3 / 0.5))
    for arguments in ((0.0,), (0.7, -1.0), (0.7, 0.7, 0)):
        with pytest.raises(ValueError, match="expected"):
            monitor_pixels_per_degree(*arguments)


@BOTH
def test_equal_images_have_no_error(metric):
    for size in ((1, 1), (6, 7), (65, 130)):
        image = noise(8, 2, 3, *size)
        assert metric(image, image.clone()).tolist() == [0, 0]


def test_flip_is_symmetric():
    image, reference = noise(1, 1, 3, 30, 31), noise(2, 1, 3, 30, 31)
    torch.testing.assert_close(flip_map(image, reference), flip_map(reference, image), rtol=0, atol=1e-6)


@BOTH
def test_views_are_judged_one_by_one(metric):
    image, reference = noise(1, 2, 3, 24, 31), noise(2, 2, 3, 24, 31)
    reference[1] /= 4  # other exposures
    together = metric(image, reference)
    assert together.shape == (2,)
    alone = torch.cat([metric(image[view : view + 1], reference[view : view + 1]) for view in range(2)])
    torch.testing.assert_close(together, alone, rtol=0, atol=1e-5)


@BOTH
def test_weights_pick_pixels_of_the_map(metric):
    image, reference = noise(1, 2, 3, 24, 31), noise(2, 2, 3, 24, 31)
    error = {flip: flip_map, hdr_flip: hdr_flip_map}[metric](image, reference)
    weight = torch.zeros(1, 1, 24, 31)
    weight[..., 5:9, 20:] = 2.0
    expected = error[..., 5:9, 20:].mean(dim=(1, 2, 3))
    torch.testing.assert_close(metric(image, reference, weight), expected, rtol=1e-5, atol=1e-6)
    assert metric(image, reference, 0 * weight).isnan().all()


@BOTH
def test_gradients(metric):
    image, reference = (noise(seed, 1, 3, 3, 4).double() * 0.8 + 0.1 for seed in (1, 2))
    weight = noise(3, 1, 1, 3, 4).double() + 0.1
    inputs = [tensor.requires_grad_() for tensor in (image, reference, weight)]
    # At fixed exposures: those chosen from the reference do not follow it.
    fixed = {} if metric is flip else {"start_exposure": -2.0, "stop_exposure": 1.0}

    def at_20(*given):
        return metric(*given, pixels_per_degree=20.0, **fixed)

    assert torch.autograd.gradcheck(at_20, inputs, fast_mode=True)


@BOTH
@pytest.mark.parametrize("values", ["equal", "black", "white", "partly"])
def test_gradients_are_finite_where_slopes_are_not(metric, values):
    reference = {"black": torch.zeros, "white": torch.ones}.get(values, lambda *shape: noise(9, *shape))(1, 3, 20, 21)
    image = reference.clone()
    if values == "partly":
        image[..., :10] = 1 - image[..., :10]
    image.requires_grad_()
    metric(image, reference).sum().backward()
    assert torch.isfinite(image.grad).all()
    assert bool(image.grad.any()) == (values == "partly")


@BOTH
def test_shapes_and_values_that_do_not_fit(metric):
    image, reference = noise(1, 2, 3, 6, 7), noise(2, 2, 3, 6, 7)
    with pytest.raises(ShapeError, match="reference"):
        metric(image, reference[:1])
    with pytest.raises(ShapeError, match=r"image: expected shape \(v, 3, h, w\)"):
        metric(image[:, :1], reference[:, :1])
    with pytest.raises(ShapeError, match="weight"):
        metric(image, reference, torch.ones(1, 1, 6, 6))
    with pytest.raises(ValueError, match="weight"):
        metric(image, reference, torch.full((1, 1, 6, 7), -1.0))
    with pytest.raises(ValueError, match="pixels_per_degree: expected a finite number, at least 1"):
        metric(image, reference, pixels_per_degree=0.5)
    for bad in (math.nan, math.inf, -0.1):
        broken = image.clone()
        broken[1, 2, 3, 4] = bad
        with pytest.raises(ValueError, match=r"image: expected finite values.* at index \(1, 2, 3, 4\)"):
            metric(broken, reference)
        with pytest.raises(ValueError, match=r"reference: expected finite values"):
            metric(image, broken)


def test_linear_radiance_is_no_display_image():
    with pytest.raises(ValueError, match=r"image: expected display-encoded values of at most 1, got 3\.0"):
        flip(torch.full((1, 3, 4, 4), 3.0), torch.ones(1, 3, 4, 4))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"tone_mapper": "gamma"}, "tone_mapper: expected one of aces, hable, reinhard, got 'gamma'"),
        ({"start_exposure": 2.0, "stop_exposure": 1.0}, "stop_exposure: expected at least the start exposure, 2"),
        ({"start_exposure": math.nan}, "start_exposure"),
        ({"start_exposure": 500.0}, "start_exposure.*at most 127"),
        ({"stop_exposure": 500.0}, "stop_exposure.*at most 127"),
        ({"exposure_count": 1}, "exposure_count: expected an integer of at least 2"),
    ],
)
def test_options_that_are_none(option, message):
    with pytest.raises(ValueError, match=message):
        hdr_flip(torch.ones(1, 3, 4, 4), torch.ones(1, 3, 4, 4), **option)
