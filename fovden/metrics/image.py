"""Errors and similarities of still images, one number per view.

Two kinds, for two encodings. Display metrics (:func:`psnr`, :func:`ssim`, and :func:`rmse` where the paper's is meant)
take what a display shows: images from :func:`fovden.color.display`, in [0, peak]. HDR metrics (:func:`relative_mse`,
:func:`smape`, :func:`mse` and :func:`rmse` again) take linear radiance. No metric converts anything: a value means
something only beside its encoding and, for a display metric, its exposure and peak.

Every metric takes an optional weight map: the mean over pixels becomes sum(weight * error) / sum(weight), in each view.
A 0/1 map picks a region, such as a foveation layer. Where the weights of a view sum to 0 its value is NaN: there is no
pixel to judge.
"""

from __future__ import annotations

import torch
from torch import Tensor

from fovden.checks import ShapeError, require, require_finite, require_number, require_shapes

__all__ = ["mse", "psnr", "relative_mse", "rmse", "rmse_map", "smape", "ssim", "ssim_map", "weighted_mean"]

WINDOW = 11
"""Taps of SSIM's Gaussian window along one axis, at sigma = 1.5 (Wang et al. 2004, section III.C)."""

MARGIN = WINDOW // 2
"""Pixels at each edge of an image at which SSIM's window does not fit."""

RELATIVE_EPS = 0.01
"""Added to the squared reference in the relative error (Rousselle, Knaus, Zwicker 2011)."""

SMAPE_EPS = 0.01
"""Added to SMAPE's denominator (Vogels et al. 2018)."""


def weighted_mean(values: Tensor, weight: Tensor | None = None) -> Tensor:
    """Returns the mean of each view over channels and pixels.

    Args:
        values: Any map, shape (v, c, h, w).
        weight: Weights of the pixels, finite and at least 0, shape (v, 1, h, w), or (1, 1, h, w) for all views;
            ``None`` means equal ones.

    Returns:
        ``sum(weight * values) / sum(weight)`` with ``values`` averaged over channels, shape (v); NaN in a view whose
        weights sum to 0.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a weight is negative or not finite.

    Differentiable: in both.

    Example:
        >>> weighted_mean(torch.tensor([[[[1.0, 2.0, 9.0]]]]), torch.tensor([[[[1.0, 3.0, 0.0]]]]))
        tensor([1.7500])
    """
    sizes = require_shapes("v c h w", values=values)
    values = values.mean(dim=1, keepdim=True)
    if weight is None:
        return values.mean(dim=(1, 2, 3))
    require_shapes("s 1 h w", {"h": sizes["h"], "w": sizes["w"]}, weight=weight)
    if weight.shape[0] not in (1, sizes["v"]):
        raise ShapeError(f"weight: expected 1 or {sizes['v']} views, got {weight.shape[0]}")
    weight = require_finite("weight", weight.to(values.dtype), minimum=0)
    return (weight * values).sum(dim=(1, 2, 3)) / weight.sum(dim=(1, 2, 3))


def mse(image: Tensor, reference: Tensor, weight: Tensor | None = None, *, noise: Tensor | None = None) -> Tensor:
    """Returns the mean squared error of each view.

    A reference with noise of its own, independent of the image's, adds the variance of that noise to the error on
    average: E[(image - reference)^2] = (image - truth)^2 + noise. Where the variance is known it is subtracted.

    Args:
        image: Image to judge, shape (v, c, h, w).
        reference: What it should be, the same shape and encoding.
        weight: Weight map; see :func:`weighted_mean`.
        noise: Variance of the reference's values, the same shape: ``Reference.variance`` for linear radiance.

    Returns:
        Mean of (image - reference)^2 - noise, shape (v); below 0 by chance where the image is as good as the reference.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite or a variance or weight is negative.

    Differentiable: in ``image``, ``reference`` and ``weight``.

    Example:
        >>> mse(torch.full((1, 1, 2, 2), 0.5), torch.zeros(1, 1, 2, 2), noise=torch.full((1, 1, 2, 2), 0.05))
        tensor([0.2000])
    """
    _require_images(image, reference, noise)
    squared = (image - reference).square()
    return weighted_mean(squared if noise is None else squared - noise, weight)


def rmse(image: Tensor, reference: Tensor, weight: Tensor | None = None, *, noise: Tensor | None = None) -> Tensor:
    """Returns the root of the mean squared error of each view.

    Args:
        image: Image to judge, shape (v, c, h, w).
        reference: What it should be, the same shape and encoding.
        weight: Weight map; see :func:`weighted_mean`.
        noise: Variance of the reference's values, to be subtracted before the root is taken; see :func:`mse`.

    Returns:
        ``sqrt(max(mse, 0))``, shape (v).

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite or a variance or weight is negative.

    Differentiable: in ``image``, ``reference`` and ``weight``, with gradient 0 where the error is 0.

    Example:
        >>> rmse(torch.full((1, 1, 2, 2), 0.5), torch.zeros(1, 1, 2, 2))
        tensor([0.5000])
    """
    squared = mse(image, reference, weight, noise=noise)
    # The root has an infinite slope at 0, so the branch not taken is kept away from it; NaN stays NaN.
    tiny = torch.finfo(squared.dtype).tiny
    return torch.where(squared <= 0, torch.zeros_like(squared), squared.clamp(min=tiny).sqrt())


def rmse_map(image: Tensor, reference: Tensor) -> Tensor:
    """Returns the root of the mean squared error over the channels of every pixel.

    Args:
        image: Image to judge, shape (v, c, h, w).
        reference: What it should be, the same shape and encoding.

    Returns:
        ``sqrt(mean over c of (image - reference)^2)``, shape (v, 1, h, w); NaN where a value is.

    Raises:
        ShapeError: If the shapes disagree.

    Differentiable: in both, where they differ.

    Example:
        >>> rmse_map(torch.zeros(1, 3, 1, 2), torch.ones(1, 3, 1, 2))
        tensor([[[[1., 1.]]]])
    """
    require_shapes("v c h w", image=image, reference=reference)
    return (image - reference).square().mean(1, keepdim=True).sqrt()


def relative_mse(
    image: Tensor, reference: Tensor, weight: Tensor | None = None, *, noise: Tensor | None = None
) -> Tensor:
    """Returns the mean squared error of each view relative to the reference's square.

    Mean of ((image - reference)^2 - noise) / (reference^2 + 0.01), so that bright and dark parts count alike. The
    reference's noise is removed from the numerator alone, which is enough where it is small beside the reference.

    Args:
        image: Linear radiance to judge, shape (v, c, h, w).
        reference: What it should be, the same shape.
        weight: Weight map; see :func:`weighted_mean`.
        noise: Variance of the reference's values, to be subtracted; see :func:`mse`.

    Returns:
        Relative error, shape (v).

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite or a variance or weight is negative.

    Differentiable: in ``image``, ``reference`` and ``weight``.
    Source: Rousselle, Knaus, Zwicker, "Adaptive sampling and reconstruction using greedy error minimization", SIGGRAPH
    Asia 2011; the constant 0.01 is theirs.

    Example:
        >>> relative_mse(torch.full((1, 1, 2, 2), 3.0), torch.full((1, 1, 2, 2), 2.0))
        tensor([0.2494])
    """
    _require_images(image, reference, noise)
    squared = (image - reference).square()
    squared = squared if noise is None else squared - noise
    return weighted_mean(squared / (reference.square() + RELATIVE_EPS), weight)


def smape(image: Tensor, reference: Tensor, weight: Tensor | None = None) -> Tensor:
    """Returns the symmetric mean absolute percentage error of each view, as a fraction from 0 to 1.

    Mean of ``|image - reference| / (|image| + |reference| + 0.01)``.

    Args:
        image: Linear radiance to judge, shape (v, c, h, w).
        reference: What it should be, the same shape.
        weight: Weight map; see :func:`weighted_mean`.

    Returns:
        Error in [0, 1), shape (v).

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite or a weight is negative.

    Differentiable: in ``image``, ``reference`` and ``weight``.
    Source: Vogels et al., "Denoising with kernel prediction and asymmetric loss functions", SIGGRAPH 2018; the constant
    0.01 is theirs.

    Example:
        >>> smape(torch.full((1, 1, 2, 2), 3.0), torch.full((1, 1, 2, 2), 1.0))
        tensor([0.4988])
    """
    _require_images(image, reference)
    return weighted_mean((image - reference).abs() / (image.abs() + reference.abs() + SMAPE_EPS), weight)


def psnr(image: Tensor, reference: Tensor, weight: Tensor | None = None, *, peak: float = 1.0) -> Tensor:
    """Returns the peak signal-to-noise ratio of each view in decibels.

    10 log10(peak^2 / mse), the mean taken over all channels together.

    Args:
        image: Display-encoded image to judge, shape (v, c, h, w).
        reference: What it should be, the same shape and encoding.
        weight: Weight map; see :func:`weighted_mean`.
        peak: Largest value that the encoding can have, above 0.

    Returns:
        Decibels, shape (v); infinite for equal images.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite, a weight is negative or ``peak`` is not above 0.

    Differentiable: in ``image``, ``reference`` and ``weight``, where they differ.

    Example:
        >>> psnr(torch.full((1, 1, 2, 2), 0.1), torch.zeros(1, 1, 2, 2))
        tensor([20.])
    """
    require_number("peak", peak, above=0)
    return 10 * torch.log10(peak**2 / mse(image, reference, weight))


def ssim_map(image: Tensor, reference: Tensor, *, peak: float = 1.0) -> Tensor:
    """Returns the structural similarity of two images at every pixel whose window lies inside them.

    Args:
        image: Display-encoded image to judge, shape (v, c, h, w), h and w at least 11.
        reference: What it should be, the same shape and encoding.
        peak: Largest value that the encoding can have, above 0.

    Returns:
        Similarity in [-1, 1], mean over the channels, shape (v, 1, h - 10, w - 10): five pixels fewer at each edge.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite, ``peak`` is not above 0 or the image is smaller than the window.

    Differentiable: in both images. Source: as for :func:`ssim`.

    Example:
        >>> ssim_map(torch.full((1, 3, 12, 16), 0.5), torch.full((1, 3, 12, 16), 0.5)).shape
        torch.Size([1, 1, 2, 6])
    """
    from kornia.metrics import ssim as kornia_ssim  # noqa: PLC0415  (slow to import)

    _require_images(image, reference)
    require_number("peak", peak, above=0)
    size = tuple(image.shape[2:])
    require(min(size) >= WINDOW, "image", f"{size[0]} x {size[1]}", f"at least {WINDOW} x {WINDOW} pixels for SSIM")
    # eps=0: kornia would add it to a denominator that the constants of SSIM already keep above 0.
    similarity: Tensor = kornia_ssim(image, reference, WINDOW, max_val=float(peak), eps=0.0, padding="valid")
    return similarity.mean(dim=1, keepdim=True)


def ssim(image: Tensor, reference: Tensor, weight: Tensor | None = None, *, peak: float = 1.0) -> Tensor:
    """Returns the mean structural similarity of each view.

    The variant: Gaussian window of 11 x 11 taps at sigma 1.5, K1 = 0.01, K2 = 0.03, population covariances, each colour
    channel by itself and then averaged, no padding (five pixels at each edge have no value). scikit-image gives the
    same with ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False``.

    With weights, the similarity is computed on the whole image, and averaged with the weights of the windows' centres.
    A window on the border of a region therefore sees pixels of both sides, and nothing is cut or filled at the border,
    which would count as structure.

    Args:
        image: Display-encoded image to judge, shape (v, c, h, w), h and w at least 11.
        reference: What it should be, the same shape and encoding.
        weight: Weight map; see :func:`weighted_mean`. Its five outer pixels have no effect.
        peak: Largest value that the encoding can have, above 0.

    Returns:
        Similarity in [-1, 1], shape (v); 1 for equal images.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite, a weight is negative, ``peak`` is not above 0 or the image is smaller than
            the window.

    Differentiable: in ``image``, ``reference`` and ``weight``.
    Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to structural similarity",
    IEEE Transactions on Image Processing 13(4), 2004, section III; computed by kornia.

    Example:
        >>> ramp = torch.linspace(0, 1, 16).expand(1, 1, 16, 16)
        >>> ssim(ramp, ramp), ssim(ramp, 1 - ramp) < 0
        (tensor([1.]), tensor([True]))
    """
    if weight is not None:
        sizes = require_shapes("v c h w", image=image)
        require_shapes("s 1 h w", {"h": sizes["h"], "w": sizes["w"]}, weight=weight)
        weight = weight[..., MARGIN:-MARGIN, MARGIN:-MARGIN]
    return weighted_mean(ssim_map(image, reference, peak=peak), weight)


def _require_images(image: Tensor, reference: Tensor, noise: Tensor | None = None) -> None:
    sizes = require_shapes("v c h w", image=image, reference=reference)
    require_finite("image", image)
    require_finite("reference", reference)
    if noise is not None:
        require_shapes("v c h w", sizes, noise=noise)
        require_finite("noise", noise, minimum=0)
