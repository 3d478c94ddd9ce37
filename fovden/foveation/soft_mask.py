"""Masks that carry a gradient, so that the density of samples can be learned.

A pixel is sampled where its random number lies below its rate: b = 1 with probability rate, else 0. To learn rates
takes the derivative of an expected loss E[L(b)] in them. For one pixel among independent ones it is

    d E[L] / d rate = E[L | b = 1] - E[L | b = 0],

but one drawn mask has no derivative. The filter reads b as the weight of a tap, so that L exists between 0 and 1 as
well: a relaxed mask is nearly 0 or 1, moves smoothly with the rate, and its gradient is as any other.

How true that gradient is depends on the denoiser. Measured for the non-homogeneous one against finite differences
(``experiments/learn_falloff.py``): relaxed masks at a temperature of 0.1 have the right sign and are wrong by up to a
third; under a budget, where radii and p work against each other, what is left may be several times too large. With a
mask of 0 and 1 and the relaxed one's derivative (straight-through) the gradient is useless: a pixel whose sampled taps
all lie across edges has weights that sum to 1e-20, and the slope in the mask of its own is the inverse of that. No mask
knows that a layer's border moves, and with it the number of passes of a pixel.
:func:`fovden.foveation.add_differences` does.

Sources: Y. Bengio, N. Leonard, A. Courville, "Estimating or propagating gradients through stochastic neurons for
conditional computation", 2013; E. Jang, S. Gu, B. Poole, "Categorical reparameterization with Gumbel-softmax", ICLR
2017; C. Maddison, A. Mnih, Y. W. Teh, "The concrete distribution", ICLR 2017.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from fovden.camera import Gaze
from fovden.checks import require, require_finite, require_number, require_shapes
from fovden.frame import Frame

__all__ = ["relaxed_mask", "thinned"]

SMALLEST_CHANCE = 2.0**-24
"""Rates, and what they lack to 1, are taken to be no smaller: the distance between the random numbers of a mask."""


def relaxed_mask(rate: Tensor, numbers: Tensor, temperature: float, straight_through: bool = True) -> Tensor:
    """Returns a relaxed mask, or the mask ``numbers < rate`` with the relaxed one's derivative.

    The relaxed Bernoulli variable (binary concrete) of a uniform number u is

        sigmoid((log(rate / (1 - rate)) - log(u / (1 - u))) / temperature),

    above 1/2 exactly where u < rate, and nearer to 0 or 1 the lower the temperature. Its gradient is biased at any
    temperature, less and with more noise the lower it is. With ``straight_through`` the value is the mask that a sample
    map has, and the derivative that of the relaxed one: for losses that are nearly linear in each pixel's mask.

    Args:
        rate: Probability of each pixel, in [0, 1], shape (v, 1, h, w).
        numbers: Uniform random numbers in [0, 1), shape (v or 1, 1, h, w): :func:`fovden.foveation.mask_numbers`.
        temperature: Temperature, above 0; its authors use 1/2 to 2/3 for variables of two values; 0.1 is better
            for the filters here.
        straight_through: Whether the value is 0 or 1, and only the derivative relaxed.

    Returns:
        The mask, shape and type of ``rate``: in [0, 1], or 0 and 1.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If ``temperature`` is not above 0.

    Differentiable: in ``rate``; the derivative is 0 where the rate is 0 or 1.

    Source: Maddison et al. 2017, section 3 and appendix B; Jang et al. 2017, section 2.2, for the value of 0 or 1.

    Example:
        >>> rate, numbers = torch.full((1, 1, 1, 2), 0.5), torch.tensor([0.4, 0.6]).reshape(1, 1, 1, 2)
        >>> relaxed_mask(rate, numbers, 0.5, straight_through=False).flatten()
        tensor([0.6923, 0.3077])
        >>> relaxed_mask(rate, numbers, 0.5).flatten()
        tensor([1., 0.])
    """
    require_number("temperature", temperature, above=0)
    drawn = _drawn(rate, numbers)
    inside = rate.clamp(SMALLEST_CHANCE, 1 - SMALLEST_CHANCE)
    noise = (numbers.to(rate.dtype) + SMALLEST_CHANCE / 2).clamp(max=1 - SMALLEST_CHANCE).logit()
    soft = ((inside.logit() - noise) / temperature).sigmoid()
    certain = ((rate == 0) | (rate == 1)).detach()
    soft = torch.where(certain, rate.detach(), soft)
    return drawn + (soft - soft.detach()) if straight_through else soft


def thinned(frame: Frame, mask: Tensor, layer: Tensor | None = None, *, gaze: Gaze | None = None) -> Frame:
    """Returns a frame of which only the pixels of a mask count as sampled, with a derivative in the mask.

    Since a pixel's paths do not depend on other pixels, a frame that was traced everywhere holds every frame that is
    traced through a mask. A denoiser gives the same image for this frame as for the one that was traced through the
    mask, to rounding. The light of the other pixels stays, hidden beneath a weight of 0, since the mask's
    derivative needs it: how the image would change if the pixel were sampled.

    Args:
        frame: A frame with samples in every pixel where the mask may be above 0.
        mask: Weight of each pixel, in [0, 1], shape (v or 1, 1, h, w), as of :func:`relaxed_mask`.
        layer: Foveation layers, integers, shape (v or 1, 1, h, w); ``None`` means the frame's.
        gaze: Where each eye looks; ``None`` means the frame's.

    Returns:
        The frame, with ``weight`` as given, and ``counts`` and ``luminance_squared`` 0 where it is 0.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a weight is not in [0, 1], or above 0 where the frame has no sample.

    Differentiable: in ``mask``, by way of ``weight``. Denoisers see it in the weights of taps. They take as constants:
    which pixels have a value to compare with (a mask above 0), which are filled as holes, and the unit of radiance.

    Example:
        >>> from fovden.filters import Atrous
        >>> from fovden.frame import GBuffer
        >>> light = torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(0))
        >>> frame = Frame.from_radiance(light, GBuffer.empty(1, (8, 8)))
        >>> mask = (torch.arange(64).reshape(1, 1, 8, 8) % 2).float().requires_grad_()
        >>> image = Atrous((2, 1))(thinned(frame, mask)).image
        >>> traced = Frame.from_radiance(light * mask.detach(), frame.gbuffer, counts=mask.detach())
        >>> torch.allclose(image, Atrous((2, 1))(traced).image)
        True
        >>> int(torch.autograd.grad(image.sum(), mask)[0].count_nonzero())
        64
    """
    sizes = {"v": frame.view_count, "h": frame.resolution[0], "w": frame.resolution[1]}
    mask = mask.expand(sizes["v"], -1, -1, -1)
    require_shapes("v 1 h w", sizes, mask=mask)
    require_finite("mask", mask.detach(), minimum=0)
    require(bool((mask <= 1).all()), "mask", f"a weight of {float(mask.detach().max()):g}", "weights of at most 1")
    sampled = mask.detach() > 0
    lacking = int((sampled & (frame.counts == 0)).sum())
    require(lacking == 0, "mask", f"{lacking} pixels without any", "weights above 0 only where the frame has samples")
    return replace(
        frame,
        counts=frame.counts * sampled,
        luminance_squared=torch.where(sampled, frame.luminance_squared, 0),
        layer=frame.layer if layer is None else layer.expand_as(frame.layer),
        gaze=frame.gaze if gaze is None else gaze,
        weight=mask.to(frame.direct.dtype),
    )


def _drawn(rate: Tensor, numbers: Tensor) -> Tensor:
    sizes = require_shapes("v 1 h w", rate=rate)
    require_shapes("s 1 h w", {"h": sizes["h"], "w": sizes["w"]}, numbers=numbers)
    require(numbers.shape[0] in (1, sizes["v"]), "numbers", f"{numbers.shape[0]} views", f"1 or {sizes['v']} views")
    return (numbers < rate).to(rate.dtype)
