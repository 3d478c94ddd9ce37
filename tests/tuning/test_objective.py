"""The terms are what they are called, by formulas written out here and by scikit-image."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity
from tuning_frames import clean_image, noisy_frame

from fovden import Frame, Gaze, GBuffer, color
from fovden.foveation import LogPolarWarp
from fovden.tuning import ImageError


def two_images():
    frame = noisy_frame(0, dtype=torch.float64)
    return frame.radiance + 0.05, clean_image().double(), frame


def encoded(linear):
    linear = np.clip(linear, 0, None)
    return np.clip(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055), 0, 1)


FORMULAS = {
    "smape": lambda x, y: np.mean(np.abs(x - y) / (x + y + 0.01)),
    "log_l1": lambda x, y: np.mean(np.abs(np.log(1 + x) - np.log(1 + y))),
    "l1": lambda x, y: np.mean(np.abs(encoded(x) - encoded(y))),
    "l2": lambda x, y: np.mean((encoded(x) - encoded(y)) ** 2),
}


@pytest.mark.parametrize("term", FORMULAS)
def test_a_term_is_its_formula_of_the_exposed_images(term):
    image, truth, frame = two_images()
    exposure = color.exposure(truth)
    expected = FORMULAS[term](exposure * image.numpy(), exposure * truth.numpy())
    assert float(ImageError({term: 2.0})(image, truth, frame)) == pytest.approx(2 * expected, rel=1e-9)
    assert float(ImageError({term: 1.0})(truth, truth, frame)) == 0


def test_ssim_is_that_of_scikit_image():
    image, truth, frame = two_images()
    shown = [color.display(each, color.exposure(truth))[0].numpy() for each in (image, truth)]
    _, similarity = structural_similarity(
        *shown, channel_axis=0, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    expected = 1 - similarity[:, 5:-5, 5:-5].mean()
    assert float(ImageError({"ssim": 1.0})(image, truth, frame)) == pytest.approx(expected, abs=1e-9)


def test_layers_weigh_as_they_are_told():
    image, truth, frame = two_images()
    exposure = color.exposure(truth)
    errors = ((image - truth) * exposure).abs() / ((image + truth) * exposure + 0.01)
    errors, layer = errors.mean(1).numpy(), frame.layer[:, 0].numpy()
    weights = np.array([4.0, 1.0, 0.0])[layer]
    value = float(ImageError(layer_weights=(4.0, 1.0, 0.0))(image, truth, frame))
    assert value == pytest.approx((errors * weights).sum() / weights.sum(), rel=1e-9)
    inner = float(ImageError(layer_weights=(0.0, 1.0))(image, truth, frame))  # the last serves the rest
    assert inner == pytest.approx(errors[layer > 0].mean(), rel=1e-9)


@pytest.mark.parametrize("term", [*FORMULAS, "ssim"])
def test_gradients_are_those_of_finite_differences(term):
    image, truth, frame = two_images()
    image = (image * 0.5).requires_grad_()  # below what the display clips
    error = ImageError({term: 1.0}, layer_weights=(2.0, 1.0, 1.0))
    (gradient,) = torch.autograd.grad(error(image, truth, frame), image)
    direction = torch.randn(image.shape, generator=torch.Generator().manual_seed(1), dtype=image.dtype)
    step = 1e-7
    with torch.no_grad():
        slope = (error(image + step * direction, truth, frame) - error(image - step * direction, truth, frame)) / (
            2 * step
        )
    assert float((gradient * direction).sum()) == pytest.approx(float(slope), rel=1e-4)


def test_exposure_makes_the_error_free_of_the_unit():
    image, truth, frame = two_images()
    error = ImageError({"smape": 1.0, "ssim": 0.5})
    assert float(error(1000 * image, 1000 * truth, frame)) == pytest.approx(float(error(image, truth, frame)), rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"terms": {"mse": 1.0}}, r"terms: expected one of smape, log_l1, l1, l2, ssim, got 'mse'"),
        ({"terms": {"l1": -1.0}}, r"terms\['l1'\]: "),
        ({"terms": {}}, r"terms: expected a positive weight"),
        ({"layer_weights": (0.0, 0.0)}, r"layer_weights: expected a positive weight"),
        ({"layer_weights": (1.0, -1.0)}, r"layer_weights: "),
    ],
)
def test_bad_weights_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        ImageError(**arguments)


def test_weights_of_layers_in_cells_are_those_of_the_pixels_that_read_them():
    """One layer right of the gaze and another left of it: beyond a cell's width from the border it is the pixel's."""
    image, truth, frame = two_images()
    height, width = frame.resolution
    gaze = Gaze(torch.tensor([[width / 2, height / 2]]).double().repeat(frame.view_count, 1))
    warp = LogPolarWarp(gaze, frame.resolution, (64, 40), alpha=2.0)
    layer = (warp.positions()[..., 0] < width / 2).int().reshape(-1, 1, 64, 40)
    cells = torch.zeros(frame.view_count, 3, 64, 40).double()
    warped = replace(Frame.from_radiance(cells, GBuffer.empty(frame.view_count, (64, 40)), layer=layer), warp=warp)
    right = torch.where(torch.arange(width) >= width / 2 + 3, image, truth)
    left = torch.where(torch.arange(width) < width / 2 - 3, image, truth)
    error = ImageError({"l1": 1.0}, layer_weights=(1.0, 0.0))
    assert float(error(right, truth, warped)) > 0
    assert float(error(left, truth, warped)) == 0
