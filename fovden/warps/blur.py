"""Blur that grows with the distance from the gaze."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from fovden.camera import Gaze, pixel_centres
from fovden.checks import require, require_shapes
from fovden.warps._fused_blur import blurred

__all__ = ["eccentricity_blur"]

STEPS = 4  # blurred images that are blended


def eccentricity_blur(
    image: Tensor, gaze: Gaze, start: Tensor | float, stop: Tensor | float, sigma: Tensor | float
) -> Tensor:
    """Returns an image under a Gaussian whose width grows linearly with the distance from the gaze.

    The standard deviation at distance d is ``sigma * clamp((d - start) / (stop - start), 0, 1)`` pixels. It comes from
    four images, blurred by 1/4, 1/2, 3/4 and all of ``sigma``, and the image itself: each pixel is a blend of the two
    next to it, with the shares that give it exactly the variance that it should have. Near the edges weights are those
    of the pixels that exist, so that a constant stays what it is.

    Args:
        image: Any image, shape (v, c, h, w).
        gaze: Where each eye looks.
        start: Distance in pixels up to which nothing is blurred, a number or a tensor of shape (v,).
        stop: Distance in pixels from which the blur is ``sigma``, above ``start``.
        sigma: Largest standard deviation in pixels, at least 0.

    Returns:
        The blurred image, the same shape.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a number is out of range.

    Differentiable: in all arguments; the size of the kernels, three standard deviations, is not.

    Source: Koskela et al. 2019 in words: none in the central region, then a linear increase. The blend of few blurs is
    the usual approximation; shares by variance are ours.

    Example:
        >>> image = torch.zeros(1, 1, 1, 9)
        >>> image[..., 2] = image[..., 6] = 1
        >>> eccentricity_blur(image, Gaze(torch.tensor([[0.5, 0.5]])), start=3.0, stop=7.0, sigma=1.0)[0, 0, 0, :4]
        tensor([0., 0., 1., 0.])
    """
    require_shapes("v c h w", {"v": gaze.pixels.shape[0]}, image=image)
    bounds = [
        torch.as_tensor(each, dtype=torch.float64, device=image.device).reshape(-1, 1, 1, 1)
        for each in (start, stop, sigma)
    ]
    if not torch.compiler.is_compiling():
        require(bool((bounds[0] >= 0).all()), "start", start, "distances of at least 0")
        require(bool((bounds[1] > bounds[0]).all()), "stop", stop, f"distances above start, {start}")
        require(bool((bounds[2] >= 0).all()), "sigma", sigma, "standard deviations of at least 0")
    pixels = gaze.pixels
    fixed = not any(each.requires_grad for each in (pixels, *bounds))
    if fixed and {image.device.type, pixels.device.type} == {"cpu"} and image.dtype == torch.float32:
        return blurred(image, pixels, torch.stack([each.flatten().expand(len(pixels)) for each in bounds]), STEPS)
    return compose(image, gaze, *bounds)


def compose(image: Tensor, gaze: Gaze, first: Tensor, last: Tensor, largest: Tensor) -> Tensor:
    """The same of torch operations, for any floating type, device and gradient; bounds have shape (1 or v, 1, 1, 1)."""
    offsets = pixel_centres((image.shape[2], image.shape[3])).to(gaze.pixels) - gaze.pixels[:, None]
    distance = torch.linalg.vector_norm(offsets, dim=-1).reshape(-1, 1, *image.shape[2:]).double()
    # Position among the blurred images, whose variances go as (k / STEPS)^2.
    place = STEPS * ((distance - first) / (last - first)).clamp(0, 1)
    lower = place.detach().floor().clamp(max=STEPS - 1)
    share = (place**2 - lower**2) / (2 * lower + 1)
    out = image * torch.where(lower == 0, 1 - share, 0.0).to(image.dtype)
    for step in range(1, STEPS + 1):
        weight = torch.where(lower == step, 1 - share, 0.0) + torch.where(lower == step - 1, share, 0.0)
        out = out + gaussian(image, largest * step / STEPS) * weight.to(image.dtype)
    return out


def gaussian(image: Tensor, sigma: Tensor) -> Tensor:
    """Separable Gaussian over the pixels that exist; ``sigma`` has shape (1 or v, 1, 1, 1)."""
    views, channels = image.shape[:2]
    radius = max(1, math.ceil(3 * float(sigma.detach().max())))
    for axis in (2, 3):
        reach = min(radius, image.shape[axis] - 1)
        offsets = torch.arange(-reach, reach + 1, device=image.device).double()
        narrow = 2 * sigma.reshape(-1, 1).clamp(min=1e-3) ** 2  # narrower than this is no blur at all in any precision
        taps = torch.exp(-(offsets**2) / narrow).to(image.dtype).expand(views, -1)
        shape, padding = (
            ((-1, 1, 2 * reach + 1, 1), (reach, 0)) if axis == 2 else ((-1, 1, 1, 2 * reach + 1), (0, reach))
        )
        kernel = taps.repeat_interleave(channels, dim=0).reshape(shape)
        ones = image.new_ones(1, views * channels, *(image.shape[each] if each == axis else 1 for each in (2, 3)))
        flat = image.reshape(1, views * channels, *image.shape[2:])
        total, norm = (conv2d(each, kernel, padding=padding, groups=views * channels) for each in (flat, ones))
        image = (total / norm).reshape(image.shape)
    return image
