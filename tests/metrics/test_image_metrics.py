"""Image metrics against scikit-image, closed forms and cropping."""

import math

import numpy as np
import pytest
import torch
from skimage import metrics as skimage_metrics

from fovden.checks import ShapeError
from fovden.metrics import mse, psnr, relative_mse, rmse, rmse_map, smape, ssim, ssim_map, weighted_mean

ALL = {"mse": mse, "rmse": rmse, "relative_mse": relative_mse, "smape": smape, "psnr": psnr, "ssim": ssim}


def pair(seed: int = 0, shape: tuple[int, ...] = (2, 3, 24, 31)) -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth picture in [0, 1] and a noisy version of it, float64."""
    generator = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(torch.linspace(0, 3, shape[2]), torch.linspace(0, 4, shape[3]), indexing="ij")
    phase = torch.rand(shape[0], shape[1], 1, 1, generator=generator) * 6
    clean = (0.5 + 0.4 * torch.sin(2 * x + y + phase)).double()
    noisy = (clean + 0.1 * torch.randn(shape, generator=generator).double()).clamp(0, 1)
    return noisy, clean


def numpy_views(*tensors: torch.Tensor):
    return zip(*(tensor.permute(0, 2, 3, 1).numpy() for tensor in tensors), strict=True)


@pytest.mark.parametrize("peak", [1.0, 255.0])
def test_psnr_equals_scikit_image(peak):
    noisy, clean = (peak * image for image in pair())
    expected = [skimage_metrics.peak_signal_noise_ratio(b, a, data_range=peak) for a, b in numpy_views(noisy, clean)]
    np.testing.assert_allclose(psnr(noisy, clean, peak=peak).numpy(), expected, rtol=1e-12)


def test_mse_and_rmse_equal_scikit_image():
    noisy, clean = pair()
    expected = [skimage_metrics.mean_squared_error(a, b) for a, b in numpy_views(noisy, clean)]
    np.testing.assert_allclose(mse(noisy, clean).numpy(), expected, rtol=1e-12)
    np.testing.assert_allclose(rmse(noisy, clean).numpy(), np.sqrt(expected), rtol=1e-12)


@pytest.mark.parametrize(("channels", "peak"), [(3, 1.0), (1, 1.0), (3, 255.0)])
def test_ssim_equals_scikit_image(channels, peak):
    noisy, clean = (peak * image for image in pair(shape=(2, channels, 24, 31)))
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "channel_axis": -1}
    for view, (a, b) in enumerate(numpy_views(noisy, clean)):
        mean, full = skimage_metrics.structural_similarity(a, b, data_range=peak, full=True, **options)
        assert float(ssim(noisy, clean, peak=peak)[view]) == pytest.approx(mean, abs=1e-10)
        inner = full.mean(-1)[5:-5, 5:-5]
        np.testing.assert_allclose(ssim_map(noisy, clean, peak=peak)[view, 0].numpy(), inner, atol=1e-10)


def test_ssim_in_float32_is_good_to_four_digits():
    noisy, clean = pair(shape=(1, 3, 64, 64))
    # Variances come from E[x^2] - E[x]^2, which carries some 1e-7; over the constant K2^2 = 9e-4 that is 1e-4.
    single = ssim(noisy.float(), clean.float())
    torch.testing.assert_close(single.double(), ssim(noisy, clean), rtol=0, atol=1e-4)


def test_closed_forms_of_constant_images():
    image, reference = torch.full((2, 3, 12, 12), 0.7).double(), torch.full((2, 3, 12, 12), 0.4).double()
    assert rmse(image, reference).tolist() == pytest.approx([0.3, 0.3])
    assert relative_mse(image, reference).tolist() == pytest.approx([0.09 / (0.16 + 0.01)] * 2)
    assert smape(image, reference).tolist() == pytest.approx([0.3 / (1.1 + 0.01)] * 2)
    assert psnr(image, reference).tolist() == pytest.approx([-20 * math.log10(0.3)] * 2)
    # Without structure only the term of the means is left.
    means = (2 * 0.7 * 0.4 + 1e-4) / (0.49 + 0.16 + 1e-4)
    assert ssim(image, reference).tolist() == pytest.approx([means, means])


def test_equal_images():
    _, clean = pair()
    for name, best in {"mse": 0, "rmse": 0, "relative_mse": 0, "smape": 0, "psnr": math.inf, "ssim": 1}.items():
        assert ALL[name](clean, clean).tolist() == pytest.approx([best, best], abs=1e-12), name
    black = torch.zeros(1, 3, 16, 16)
    assert float(ssim(black, black)) == 1
    assert float(smape(black, black)) == 0


@pytest.mark.parametrize("name", ALL)
def test_views_are_judged_one_by_one(name):
    noisy, clean = pair()
    together = ALL[name](noisy, clean)
    assert together.shape == (2,)
    for view in range(2):
        alone = ALL[name](noisy[view : view + 1], clean[view : view + 1])
        torch.testing.assert_close(together[view : view + 1], alone)


@pytest.mark.parametrize("name", ALL)
def test_weights_of_a_region_equal_cropping(name):
    noisy, clean = pair()
    rows, columns = slice(7, 15), slice(6, 21)
    weight = torch.zeros(1, 1, 24, 31)
    weight[..., rows, columns] = 3.0  # the scale of the weights does not matter
    if name == "ssim":  # the windows reach five pixels beyond the region
        rows, columns = slice(2, 20), slice(1, 26)
    expected = ALL[name](noisy[..., rows, columns], clean[..., rows, columns])
    torch.testing.assert_close(ALL[name](noisy, clean, weight), expected)


@pytest.mark.parametrize("name", ALL)
def test_equal_weights_change_nothing(name):
    noisy, clean = pair()
    torch.testing.assert_close(ALL[name](noisy, clean, torch.full((2, 1, 24, 31), 0.3)), ALL[name](noisy, clean))


def test_weighted_mean_equals_the_slow_loop():
    values, _ = pair(1, (2, 3, 4, 5))
    weight = torch.rand(2, 1, 4, 5, generator=torch.Generator().manual_seed(0)).double()
    for view in range(2):
        above = below = 0.0
        for y in range(4):
            for x in range(5):
                above += float(weight[view, 0, y, x]) * float(values[view, :, y, x].mean())
                below += float(weight[view, 0, y, x])
        assert float(weighted_mean(values, weight)[view]) == pytest.approx(above / below, rel=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_a_view_without_weight_has_no_value(name):
    noisy, clean = pair()
    weight = torch.zeros(2, 1, 24, 31)
    weight[1] = 1
    value = ALL[name](noisy, clean, weight)
    assert value[0].isnan()
    torch.testing.assert_close(value[1], ALL[name](noisy, clean)[1])


def test_noise_of_the_reference_is_subtracted():
    """With r = t + n: E[(x - r)^2 - s^2] = (x - t)^2, and each term's variance is 4 (x - t)^2 s^2 + 2 s^4."""
    generator = torch.Generator().manual_seed(3)
    shape = (1, 3, 200, 200)
    truth = 1 + torch.rand(shape, generator=generator, dtype=torch.float64)
    image = truth + 0.05 * torch.randn(shape, generator=generator).sign()
    deviation = 0.01 + 0.05 * torch.rand(shape, generator=generator, dtype=torch.float64)
    reference = truth + deviation * torch.randn(shape, generator=generator, dtype=torch.float64)
    variance = deviation**2
    sigma = float((4 * 0.05**2 * variance + 2 * variance**2).sum().sqrt()) / truth.numel()
    corrected = float(mse(image, reference, noise=variance))
    assert abs(corrected - 0.05**2) < 4 * sigma
    assert float(mse(image, reference)) - 0.05**2 > 50 * sigma
    assert float(rmse(image, reference, noise=variance)) == pytest.approx(math.sqrt(corrected))
    expected = (0.05**2 / (truth**2 + 0.01)).mean()
    # The noise left in the denominator adds 6 s^4 / r^4 to the error, here 0.5 % of it; chance adds 0.5 % (one sigma).
    assert float(relative_mse(image, reference, noise=variance)) == pytest.approx(float(expected), rel=0.03)
    assert float(relative_mse(image, reference)) > 1.3 * float(expected)


def test_more_noise_than_error_leaves_no_rmse():
    clean = torch.ones(1, 3, 4, 4)
    assert float(rmse(clean, clean, noise=torch.ones_like(clean))) == 0
    assert float(mse(clean, clean, noise=torch.ones_like(clean))) == -1


@pytest.mark.parametrize("name", ALL)
def test_gradients(name):
    noisy, clean = pair(2, (1, 2, 12, 13))
    weight = torch.rand(1, 1, 12, 13, generator=torch.Generator().manual_seed(0)).double() + 0.1
    inputs = [noisy.requires_grad_(), clean.requires_grad_(), weight.requires_grad_()]
    assert torch.autograd.gradcheck(ALL[name], inputs, fast_mode=True)


def test_rmse_of_equal_images_has_a_finite_gradient():
    image = torch.ones(1, 3, 4, 4, requires_grad=True)
    rmse(image, torch.ones(1, 3, 4, 4)).sum().backward()
    assert torch.equal(image.grad, torch.zeros_like(image))


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_not_finite(name, bad):
    noisy, clean = pair()
    broken = clean.clone()
    broken[1, 2, 3, 4] = bad
    with pytest.raises(ValueError, match=r"image: expected finite values, got (nan|inf) at index \(1, 2, 3, 4\)"):
        ALL[name](broken, clean)
    with pytest.raises(ValueError, match="reference: expected finite values"):
        ALL[name](noisy, broken)


@pytest.mark.parametrize("name", ALL)
def test_shapes_and_weights_that_do_not_fit(name):
    noisy, clean = pair()
    with pytest.raises(ShapeError, match="reference"):
        ALL[name](noisy, clean[:1])
    with pytest.raises(ShapeError, match="weight"):
        ALL[name](noisy, clean, torch.ones(3, 1, 24, 31))
    with pytest.raises(ShapeError, match="weight"):
        ALL[name](noisy, clean, torch.ones(1, 1, 23, 31))
    with pytest.raises(ValueError, match="weight"):
        ALL[name](noisy, clean, torch.full((1, 1, 24, 31), -1.0))


def test_noise_that_is_none():
    noisy, clean = pair()
    with pytest.raises(ValueError, match="noise"):
        mse(noisy, clean, noise=torch.full_like(clean, -1))
    with pytest.raises(ShapeError, match="noise"):
        mse(noisy, clean, noise=clean[:, :1])


@pytest.mark.parametrize("metric", [psnr, ssim])
def test_peak_that_is_none(metric):
    with pytest.raises(ValueError, match="peak"):
        metric(*pair(), peak=0)


def test_image_smaller_than_the_window_of_ssim():
    with pytest.raises(ValueError, match="image: expected at least 11 x 11 pixels for SSIM, got 10 x 31"):
        ssim(*pair(shape=(1, 3, 10, 31)))


def test_rmse_map_averages_to_rmse():
    generator = torch.Generator().manual_seed(0)
    image, reference = (torch.rand(2, 3, 5, 7, generator=generator) for _ in range(2))
    found = rmse_map(image, reference)
    expected = np.sqrt(((image.numpy().astype(np.float64) - reference.numpy()) ** 2).sum(1, keepdims=True) / 3)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)
    assert torch.allclose(found.square().mean((1, 2, 3)).sqrt(), rmse(image, reference))
    image[1, 0, 2, 3] = torch.nan
    assert rmse_map(image, reference).isnan().nonzero().tolist() == [[1, 0, 2, 3]]
