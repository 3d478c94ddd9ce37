"""Colour: luminance, the sRGB curve, exposure, and division by albedo.

Radiance is linear Rec. 709 RGB without an upper bound. What a display shows is one exposure, the sRGB curve and a clamp
to [0, 1], in that order: :func:`display`.
"""

from __future__ import annotations

import torch
from torch import Tensor

from fovden.checks import require_finite, require_number, require_shapes

__all__ = [
    "LUMINANCE",
    "demodulate",
    "display",
    "exposure",
    "linear_to_srgb",
    "luminance",
    "modulate",
    "srgb_to_linear",
]

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Luminance of the Rec. 709 primaries (ITU-R BT.709-6, section 3.2)."""

# The curve of sRGB (IEC 61966-2-1): a straight line through the origin, then a shifted power.
SLOPE, OFFSET, GAMMA = 12.92, 0.055, 2.4
LINEAR_KNEE, ENCODED_KNEE = 0.0031308, 0.04045

BLACK = 1e-4
"""Share of the mean luminance below which a pixel counts as black. Ours: at the exposures of :func:`exposure`, where a
typical mean is shown between 0.18 and 1, such a pixel lies below one 8-bit step (12.92e-4 < 1/255)."""


def luminance(rgb: Tensor) -> Tensor:
    """Returns the luminance of linear Rec. 709 colours.

    Args:
        rgb: Linear colours, shape (v, 3, h, w).

    Returns:
        0.2126 R + 0.7152 G + 0.0722 B, shape (v, 1, h, w).

    Raises:
        ShapeError: If ``rgb`` has another shape.

    Differentiable: in ``rgb``. Source: ITU-R BT.709-6, section 3.2.

    Example:
        >>> luminance(torch.tensor([1.0, 0.5, 0.0]).reshape(1, 3, 1, 1)).item()
        0.570...
    """
    require_shapes("v 3 h w", rgb=rgb)
    return LUMINANCE[0] * rgb[:, 0:1] + LUMINANCE[1] * rgb[:, 1:2] + LUMINANCE[2] * rgb[:, 2:3]


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Returns values encoded with the sRGB curve.

    12.92 x up to x = 0.0031308, 1.055 x^(1/2.4) - 0.055 beyond. The line goes on below 0 and the power beyond 1, so
    nothing is clamped.

    Args:
        linear: Linear values of any shape; 1 is the display's white.

    Returns:
        Encoded values, the same shape.

    Differentiable: in ``linear``, also at 0. Source: IEC 61966-2-1.

    Example:
        >>> linear_to_srgb(torch.tensor([0.0, 0.18, 1.0]))
        tensor([0.0000, 0.4614, 1.0000])
    """
    # The branch not taken is kept away from 0, where its slope is infinite and would turn the gradient into NaN.
    power = (1 + OFFSET) * linear.clamp(min=LINEAR_KNEE) ** (1 / GAMMA) - OFFSET
    return torch.where(linear <= LINEAR_KNEE, SLOPE * linear, power)


def srgb_to_linear(encoded: Tensor) -> Tensor:
    """Returns linear values of sRGB-encoded ones: the inverse of :func:`linear_to_srgb`.

    Args:
        encoded: Encoded values of any shape; 1 is the display's white.

    Returns:
        Linear values, the same shape.

    Differentiable: in ``encoded``. Source: IEC 61966-2-1.

    Example:
        >>> srgb_to_linear(torch.tensor([0.0, 0.5, 1.0]))
        tensor([0.0000, 0.2140, 1.0000])
    """
    power = ((encoded.clamp(min=ENCODED_KNEE) + OFFSET) / (1 + OFFSET)) ** GAMMA
    return torch.where(encoded <= ENCODED_KNEE, encoded / SLOPE, power)


def demodulate(radiance: Tensor, albedo: Tensor, eps: float = 1e-3) -> Tensor:
    """Returns the illumination: radiance divided by the albedo, so that a filter need not preserve textures.

    ``radiance / max(albedo, eps)``, per channel.

    Args:
        radiance: Linear radiance, shape (v, 3, h, w), without the emission of what the pixel shows.
        albedo: Diffuse reflectance in [0, 1], the same shape.
        eps: Smallest divisor, above 0. The default is Falcor's (SVGF pass).

    Returns:
        Illumination, the same shape; :func:`modulate` with the same albedo undoes it.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If ``eps`` is not above 0.

    Differentiable: in ``radiance`` and ``albedo``.

    Example:
        >>> demodulate(torch.full((1, 3, 1, 1), 0.2), torch.full((1, 3, 1, 1), 0.5))[0, 0]
        tensor([[0.4000]])
    """
    require_shapes("v 3 h w", radiance=radiance, albedo=albedo)
    return radiance / albedo.clamp(min=require_number("eps", eps, above=0))


def modulate(illumination: Tensor, albedo: Tensor, eps: float = 1e-3) -> Tensor:
    """Returns radiance: illumination times ``max(albedo, eps)``, the inverse of :func:`demodulate`.

    Args:
        illumination: What :func:`demodulate` returned, filtered or not, shape (v, 3, h, w).
        albedo: The same albedo.
        eps: The same smallest divisor.

    Returns:
        Linear radiance, the same shape.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If ``eps`` is not above 0.

    Differentiable: in ``illumination`` and ``albedo``.

    Example:
        >>> radiance, albedo = torch.full((1, 3, 1, 1), 0.2), torch.zeros(1, 3, 1, 1)
        >>> modulate(demodulate(radiance, albedo), albedo)[0, 0]
        tensor([[0.2000]])
    """
    require_shapes("v 3 h w", illumination=illumination, albedo=albedo)
    return illumination * albedo.clamp(min=require_number("eps", eps, above=0))


def exposure(radiance: Tensor, key: float = 0.18) -> float:
    """Returns the scale that takes the log-average luminance of an image to ``key``.

    ``key / exp(mean(log L))`` over the pixels of all views together, so that both eyes share one exposure. Pixels with
    less than 1e-4 of the mean luminance count as black and are left out. An image that is black all over gets 1.

    Args:
        radiance: Linear radiance, finite, shape (v, 3, h, w); the reference of a scene, where one exists.
        key: Luminance that the log-average becomes, above 0; 0.18 is the middle grey of photography.

    Returns:
        The scale.

    Raises:
        ValueError: If ``radiance`` is not finite or ``key`` is not above 0.

    Source: Reinhard, Stark, Shirley, Ferwerda, "Photographic tone reproduction for digital images", SIGGRAPH 2002,
    equations 1 and 2, with the 1/N inside the exponential, where the authors' later text has it. Departs from it for
    black pixels: the paper adds a small constant to every luminance, by which a patch of lightless sky, at the
    logarithm of that constant, would govern the whole picture's exposure.

    Example:
        >>> round(exposure(torch.full((2, 3, 4, 4), 9.0)), 6)
        0.02
    """
    require_number("key", key, above=0)
    lum = luminance(require_finite("radiance", radiance)).double()
    lit = lum[(lum > BLACK * lum.mean()) & (lum > 0)]
    if lit.numel() == 0:
        return 1.0
    return key / float(lit.log().mean().exp())


def display(radiance: Tensor, exposure: float) -> Tensor:
    """Returns what a display shows: exposed, sRGB-encoded and clamped to [0, 1].

    Args:
        radiance: Linear radiance of any shape.
        exposure: Scale from radiance to the display's linear range, above 0; see :func:`exposure`.

    Returns:
        Encoded values in [0, 1], the same shape.

    Raises:
        ValueError: If ``exposure`` is not above 0.

    Differentiable: in ``radiance``, with gradient 0 where clamped.

    Example:
        >>> display(torch.tensor([0.0, 9.0, 100.0]), exposure=0.02)
        tensor([0.0000, 0.4614, 1.0000])
    """
    return linear_to_srgb(radiance * require_number("exposure", exposure, above=0)).clamp(0, 1)
