"""Colour: the sRGB curve against kornia, luminance and exposure against closed forms."""

import math

import kornia.color
import pytest
import torch

from fovden.checks import ShapeError
from fovden.color import demodulate, display, exposure, linear_to_srgb, luminance, modulate, srgb_to_linear


def image(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def test_luminance_of_the_primaries_and_of_white():
    primaries = torch.eye(3, dtype=torch.float64).reshape(3, 3, 1, 1)
    torch.testing.assert_close(luminance(primaries).flatten(), torch.tensor([0.2126, 0.7152, 0.0722]).double())
    assert luminance(torch.ones(1, 3, 1, 1, dtype=torch.float64)).item() == pytest.approx(1, abs=1e-15)


def test_luminance_refuses_other_shapes():
    with pytest.raises(ShapeError, match="rgb"):
        luminance(torch.zeros(1, 4, 2, 2))


def test_srgb_curve_equals_kornia():
    linear = image(0, 2, 3, 16, 16) ** 4  # many values on the straight part near black
    torch.testing.assert_close(linear_to_srgb(linear), kornia.color.linear_rgb_to_rgb(linear))
    torch.testing.assert_close(srgb_to_linear(linear), kornia.color.rgb_to_linear_rgb(linear))


def test_srgb_curve_round_trip_and_fixed_points():
    values = torch.linspace(-0.5, 4, 1001, dtype=torch.float64)
    # The standard's rounded constants leave a step of some 1e-8 where line and power meet.
    torch.testing.assert_close(srgb_to_linear(linear_to_srgb(values)), values, rtol=0, atol=1e-7)
    assert linear_to_srgb(torch.tensor([0.0, 1.0])).tolist() == pytest.approx([0, 1], abs=2.0**-23)


def test_srgb_curve_is_differentiable_everywhere_also_at_zero():
    values = torch.tensor([0.0, 1e-12, 0.002, 0.04, 0.5, 1.0, 3.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(linear_to_srgb, values, eps=1e-7)
    assert torch.autograd.gradcheck(srgb_to_linear, values, eps=1e-7)
    gradient = torch.autograd.grad(linear_to_srgb(values).sum(), values)[0]
    assert gradient[0].item() == pytest.approx(12.92)


def test_modulate_inverts_demodulate_also_where_the_albedo_is_zero():
    radiance, albedo = 10 * image(1, 2, 3, 8, 8), image(2, 2, 3, 8, 8)
    albedo[:, :, :2] = 0
    albedo[:, :, 2] = 5e-4
    # Division and multiplication each round once: 2^-24 apiece.
    torch.testing.assert_close(modulate(demodulate(radiance, albedo), albedo), radiance, rtol=2.0**-23, atol=0)


def test_demodulate_divides_by_the_albedo_above_the_floor():
    radiance = torch.full((1, 3, 1, 3), 0.5)
    albedo = torch.tensor([0.25, 1e-3, 0.0]).expand(1, 3, 1, 3)
    torch.testing.assert_close(demodulate(radiance, albedo)[0, 0, 0], torch.tensor([2.0, 500.0, 500.0]))
    torch.testing.assert_close(demodulate(radiance, albedo, eps=0.5)[0, 0, 0], torch.ones(3))


@pytest.mark.parametrize("eps", [0, -1, math.nan])
def test_demodulate_refuses_a_floor_that_is_not_positive(eps):
    with pytest.raises(ValueError, match="eps"):
        demodulate(torch.ones(1, 3, 1, 1), torch.ones(1, 3, 1, 1), eps)


def test_exposure_takes_the_log_average_to_the_key():
    radiance = 5 * image(3, 2, 3, 8, 8) + 0.01
    lum = luminance(radiance).double().flatten().tolist()
    log_average = math.exp(sum(map(math.log, lum)) / len(lum))  # over both eyes together
    assert exposure(radiance) == pytest.approx(0.18 / log_average, rel=1e-6)
    assert exposure(radiance, key=0.36) == pytest.approx(0.36 / log_average, rel=1e-6)


def test_exposure_follows_the_unit_of_radiance():
    radiance = image(4, 1, 3, 8, 8) + 0.01
    assert exposure(1e6 * radiance) == pytest.approx(1e-6 * exposure(radiance), rel=1e-5)


def test_exposure_leaves_black_pixels_out():
    radiance = image(5, 1, 3, 8, 8) + 0.1
    sky = torch.zeros(1, 3, 8, 8)
    almost = torch.full((1, 3, 8, 8), 1e-7)
    alone = exposure(radiance)
    assert exposure(torch.cat([radiance, sky], dim=2)) == pytest.approx(alone)
    assert exposure(torch.cat([radiance, almost], dim=2)) == pytest.approx(alone)


def test_exposure_of_an_image_that_is_black_all_over():
    assert exposure(torch.zeros(2, 3, 4, 4)) == 1.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_exposure_refuses_values_that_are_not_finite(bad):
    radiance = torch.ones(1, 3, 2, 2)
    radiance[0, 1, 1, 0] = bad
    with pytest.raises(ValueError, match=r"radiance.*index \(0, 1, 1, 0\)"):
        exposure(radiance)


def test_display_is_exposure_then_curve_then_clamp():
    radiance = torch.tensor([-1.0, 0.0, 0.09, 0.5, 80.0])
    shown = display(radiance, exposure=2.0)
    assert shown.tolist() == pytest.approx([0, 0, 1.055 * 0.18 ** (1 / 2.4) - 0.055, 1, 1], abs=1e-6)
    with pytest.raises(ValueError, match="exposure"):
        display(radiance, exposure=0)
