"""FLIP: the difference that a viewer sees when one image alternates with another on the same screen.

Two pipelines judge each pixel. The colour pipeline blurs away what the eye cannot resolve at the given distance, and
measures the difference of what is left in a perceptually uniform space. The feature pipeline looks for edges and points
that are in one image only, to which the eye is more sensitive than their colours tell. Their results, both in [0, 1],
become one error in [0, 1]: 0 for equal pixels.

The metric for low dynamic range is here, :func:`flip`; :mod:`fovden.metrics.flip_hdr` applies it to radiance.

Source of everything, by the titles of its sections: Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom, Fairchild,
"FLIP: a difference evaluator for alternating images", Proceedings of the ACM on Computer Graphics and Interactive
Techniques 3(2) (High Performance Graphics), 2020. Every filter there is a product of a horizontal and a vertical one or
a sum of two such products, and is computed as such.
"""

from __future__ import annotations

import math
from functools import cache, reduce

import torch
from torch import Tensor
from torch.nn.functional import pad

from fovden.checks import require, require_finite, require_integer, require_number, require_shapes
from fovden.color import srgb_to_linear
from fovden.metrics.image import weighted_mean

__all__ = ["PIXELS_PER_DEGREE", "flip", "flip_map", "linear_flip_map", "monitor_pixels_per_degree"]


def monitor_pixels_per_degree(distance: float = 0.7, width: float = 0.7, pixels: int = 3840) -> float:
    """Returns the pixels per degree of visual angle at the centre of a monitor.

    A headset's lenses put its display elsewhere, and its own value is
    :attr:`fovden.foveation.Display.pixels_per_degree`: about 8 to 20 where a monitor has 67. FLIP judges what that
    viewer sees. The same image has a larger error on a headset, whose coarser pixels let the eye blur less of it away.

    Args:
        distance: From the eye to the monitor in metres, above 0.
        width: Width of the monitor in metres, above 0.
        pixels: Pixels across that width, at least 1.

    Returns:
        ``distance * pixels / width * pi / 180``.

    Raises:
        ValueError: If an argument is out of range.

    Source: the viewer whom FLIP's authors assume, 0.70 m from a 4K monitor 0.70 m wide, which are the defaults.

    Example:
        >>> round(monitor_pixels_per_degree(), 4)
        67.0206
    """
    require_number("distance", distance, above=0)
    require_number("width", width, above=0)
    return distance * require_integer("pixels", pixels, minimum=1) / width * math.pi / 180


PIXELS_PER_DEGREE = monitor_pixels_per_degree()
"""Pixels per degree of the paper's viewer at a 4K monitor: 67.02."""

# From linear Rec. 709 to CIE XYZ under D65 (IEC 61966-2-1), in the fractions that keep white at (1, 1, 1) / (X, Y, Z).
TO_XYZ = torch.tensor(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ],
    dtype=torch.float64,
)
TO_WHITE_RELATIVE = TO_XYZ / TO_XYZ.sum(dim=1, keepdim=True)  # X/Xn, Y/Yn, Z/Zn
# The linear opponent space YCxCz ("Spatial filtering"): achromatic, red-green, blue-yellow. The factors 116, 500, 200
# and the shift by 16 of its definition are left out: the filters, which are linear and sum to 1, would not change them.
TO_OPPONENT = torch.tensor([[0.0, 1, 0], [1, -1, 0], [0, 1, -1]], dtype=torch.float64) @ TO_WHITE_RELATIVE

SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
"""Contrast sensitivity in space, for each opponent channel the terms (a, b) of a sum of Gaussians in x degrees,
a sqrt(pi / b) exp(-pi^2 x^2 / b) ("Spatial filtering", table 1, after Johnson and Fairchild 2001)."""

RADIUS = 3.0
"""Half the width of a filter in standard deviations of its widest Gaussian ("Spatial filtering", "Feature detection").
"""

FEATURE_WIDTH = 0.082
"""Width in degrees of the edges and points that the eye detects best ("Feature detection")."""

COLOR_EXPONENT = 0.7
"""q_c: compresses large differences of colour ("Error redistribution")."""

KNEE_INPUT, KNEE_OUTPUT = 0.4, 0.95
"""p_c and p_t: differences up to 0.4 of the largest one fill the range up to 0.95 ("Error redistribution")."""

FEATURE_EXPONENT = 0.5
"""q_f: raises small differences of features ("Feature metric")."""

BLOCK = 64
"""Rows filtered by one matrix product; ours, for speed alone."""


def flip(
    image: Tensor, reference: Tensor, weight: Tensor | None = None, *, pixels_per_degree: float = PIXELS_PER_DEGREE
) -> Tensor:
    """Returns the mean FLIP error of each view; lower is better.

    Args:
        image: Display-encoded image to judge, in [0, 1], shape (v, 3, h, w); see :func:`fovden.color.display`.
        reference: What it should be, the same shape and encoding.
        weight: Weight map; see :func:`fovden.metrics.weighted_mean`. The errors are those of the whole image, whose
            filters reach beyond the border of a region.
        pixels_per_degree: Pixels per degree of visual angle, at least 1; see :func:`monitor_pixels_per_degree`.

    Returns:
        Error in [0, 1], shape (v); 0 for equal images.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not in [0, 1], a weight is negative or ``pixels_per_degree`` is below 1.

    Differentiable: in both images and ``weight``; see :func:`flip_map`. Source: as for the module.

    Example:
        >>> flip(torch.zeros(1, 3, 4, 4), torch.ones(1, 3, 4, 4))
        tensor([0.9674])
    """
    return weighted_mean(flip_map(image, reference, pixels_per_degree=pixels_per_degree), weight)


def flip_map(image: Tensor, reference: Tensor, *, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Tensor:
    """Returns the FLIP error of every pixel. It is symmetric in its two images.

    Args:
        image: Display-encoded image to judge, in [0, 1], shape (v, 3, h, w).
        reference: What it should be, the same shape and encoding.
        pixels_per_degree: Pixels per degree of visual angle, at least 1; see :func:`monitor_pixels_per_degree`.

    Returns:
        Error in [0, 1], shape (v, 1, h, w); :func:`fovden.colormap.apply` gives it its usual colours.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is not in [0, 1] or ``pixels_per_degree`` is below 1.

    Differentiable: in both images. Its slope has no bound where they are nearly equal, and is 0 where they are.
    Source: as for the module.

    Example:
        >>> grey = torch.full((1, 3, 1, 3), 0.5)
        >>> flip_map(grey, grey + torch.tensor([0.0, 0.0, 0.1]), pixels_per_degree=8)
        tensor([[[[0.0000, 0.0000, 0.4009]]]])
    """
    require_shapes("v 3 h w", image=image, reference=reference)
    for name, values in (("image", image), ("reference", reference)):
        require_finite(name, values, minimum=0)
        largest = values.max().item() if values.numel() else 0.0
        require(largest <= 1, name, largest, "display-encoded values of at most 1")
    return linear_flip_map(srgb_to_linear(image), srgb_to_linear(reference), pixels_per_degree)


def linear_flip_map(image: Tensor, reference: Tensor, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Tensor:
    """Returns the FLIP error of every pixel of two images of a display's linear light.

    Args:
        image: Linear image to judge, in [0, 1] where 1 is the display's white, shape (v, 3, h, w); not checked.
        reference: What it should be, the same shape and encoding.
        pixels_per_degree: As for :func:`flip_map`.

    Returns:
        Error in [0, 1], shape (v, 1, h, w).

    Raises:
        ValueError: If ``pixels_per_degree`` is below 1.

    Differentiable: as :func:`flip_map`. Source: as for the module.

    Example:
        >>> linear_flip_map(torch.zeros(1, 3, 1, 1), torch.ones(1, 3, 1, 1)).item()
        0.967...
    """
    require_number("pixels_per_degree", pixels_per_degree, minimum=1)
    # One image after the other, never side by side in one tensor: equal images take equal steps and differ by 0.
    opponents = [_mix(TO_OPPONENT, linear) for linear in (image, reference)]
    colors = [_seen_colors(opponent, pixels_per_degree) for opponent in opponents]
    features = [_features(opponent[:, 0], pixels_per_degree) for opponent in opponents]
    return _power(_color_difference(*colors), 1 - _feature_difference(*features))[:, None]  # "Final difference"


def _seen_colors(opponent: Tensor, pixels_per_degree: float) -> Tensor:
    """What is left of an image's colours at a distance, in a uniform space, (v, 3, h, w)."""
    kernels = _sensitivity_kernels(opponent, pixels_per_degree)
    seen = [
        reduce(torch.add, (_filter(channel, kernel, kernel) for kernel in terms))
        for channel, terms in zip(opponent.unbind(1), kernels, strict=True)
    ]
    # Sharp contrasts of colour can leave the display's gamut when filtered, hence the clamp.
    return _adjusted_lab(_mix(torch.linalg.inv(TO_OPPONENT), torch.stack(seen, dim=1)).clamp(0, 1))


def _color_difference(first: Tensor, second: Tensor) -> Tensor:
    """Differences of colours, in [0, 1], (v, h, w) ("Error redistribution")."""
    difference = _power(_hyab(first, second), COLOR_EXPONENT)
    largest = _largest_difference()
    knee = KNEE_INPUT * largest
    below = difference * (KNEE_OUTPUT / knee)
    above = KNEE_OUTPUT + (difference - knee) * ((1 - KNEE_OUTPUT) / (largest - knee))
    return torch.where(difference < knee, below, above)


def _features(luminance: Tensor, pixels_per_degree: float) -> tuple[Tensor, Tensor]:
    """Strengths of edges and points, (v, h, w) each ("Feature detection")."""
    smooth, *derivatives = _feature_kernels(luminance, pixels_per_degree)
    edge, point = (
        _power(_filter(luminance, smooth, kernel).square() + _filter(luminance, kernel, smooth).square(), 0.5)
        for kernel in derivatives
    )
    return edge, point


def _feature_difference(first: tuple[Tensor, Tensor], second: tuple[Tensor, Tensor]) -> Tensor:
    """Differences of features, in [0, 1], (v, h, w) ("Feature metric")."""
    edge, point = ((one - other).abs() for one, other in zip(first, second, strict=True))
    return _power(torch.maximum(edge, point) / math.sqrt(2), FEATURE_EXPONENT)


def _mix(matrix: Tensor, image: Tensor) -> Tensor:
    """A matrix times the colour of every pixel."""
    return torch.einsum("ij,njhw->nihw", matrix.to(image), image)


def _adjusted_lab(linear: Tensor) -> Tensor:
    """CIE L*a*b* with Hunt's effect: colours grow more vivid with lightness ("Perceptually uniform color space")."""
    ratio = _mix(TO_WHITE_RELATIVE, linear)
    delta = 6 / 29  # CIE 15:2004, section 8.2.1
    root = torch.where(ratio > delta**3, ratio.clamp(min=delta**3) ** (1 / 3), ratio / (3 * delta**2) + 4 / 29)
    x, y, z = root.unbind(1)
    lightness = 116 * y - 16
    return torch.stack([lightness, 5 * lightness * (x - y), 2 * lightness * (y - z)], dim=1)


def _hyab(first: Tensor, second: Tensor) -> Tensor:
    """City-block distance of lightness from colour, Euclidean within colour ("Color metric")."""
    difference = first - second
    return difference[:, 0].abs() + _power(difference[:, 1:].square().sum(dim=1), 0.5)


@cache
def _largest_difference() -> float:
    """The difference between the display's green and blue, the largest of all its colours ("Error redistribution")."""
    green, blue = _adjusted_lab(torch.eye(3, dtype=torch.float64)[1:, :, None, None]).chunk(2)
    return math.pow(_hyab(green, blue).item(), COLOR_EXPONENT)


def _sensitivity_kernels(like: Tensor, pixels_per_degree: float) -> list[list[Tensor]]:
    """For each channel the kernels whose products k(x) k(y), added, are its filter, which sums to 1."""
    widest = max(b for terms in SENSITIVITY for _, b in terms)
    radius = math.ceil(RADIUS * math.sqrt(widest / (2 * math.pi**2)) * pixels_per_degree)
    squared = (torch.arange(-radius, radius + 1, dtype=torch.float64) / pixels_per_degree) ** 2
    kernels = []
    for terms in SENSITIVITY:
        roots = [math.sqrt(a * math.sqrt(math.pi / b)) * torch.exp(-(math.pi**2) * squared / b) for a, b in terms]
        total = math.sqrt(sum(float(root.sum()) ** 2 for root in roots))
        kernels.append([(root / total).to(like) for root in roots])
    return kernels


def _feature_kernels(like: Tensor, pixels_per_degree: float) -> tuple[Tensor, Tensor, Tensor]:
    """A Gaussian and its first and second derivatives, whose positive parts sum to 1, negative ones to -1."""
    deviation = FEATURE_WIDTH / 2 * pixels_per_degree
    radius = math.ceil(RADIUS * deviation)
    x = torch.arange(-radius, radius + 1, dtype=torch.float64)
    smooth = torch.exp(-(x**2) / (2 * deviation**2))
    derivatives = -x * smooth, (x**2 / deviation**2 - 1) * smooth
    edge, point = (
        positive.clamp(min=0) / positive.clamp(min=0).sum() + positive.clamp(max=0) / -positive.clamp(max=0).sum()
        for positive in derivatives
    )
    return (smooth / smooth.sum()).to(like), edge.to(like), point.to(like)


def _filter(image: Tensor, down: Tensor, across: Tensor) -> Tensor:
    """Filters images, (n, h, w), with one kernel along the columns and one along the rows."""
    return _filter_columns(_filter_columns(image, down).mT, across).mT


def _filter_columns(image: Tensor, kernel: Tensor) -> Tensor:
    """Filters every column, the border's pixels repeated beyond it.

    A block of rows depends on itself and its margins through a banded matrix: one product for all columns, several
    times faster than the sum of shifted images.
    """
    height, margin = image.shape[1], len(kernel) // 2
    block = min(BLOCK, height)
    count = -(-height // block)
    padded = pad(image, (0, 0, margin, margin + count * block - height), mode="replicate")
    tap = torch.arange(block + 2 * margin, device=image.device) - torch.arange(block, device=image.device)[:, None]
    band = torch.where((tap >= 0) & (tap < len(kernel)), kernel[tap.clamp(0, len(kernel) - 1)], 0)
    blocks = padded.unfold(1, block + 2 * margin, block).mT
    return (band @ blocks).flatten(1, 2)[:, :height]


def _power(base: Tensor, exponent: float | Tensor) -> Tensor:
    """``base ** exponent`` of values of at least 0; 0 at 0, and there with gradient 0 instead of an infinite one."""
    positive = base > 0
    return torch.where(positive, torch.where(positive, base, 1) ** exponent, 0)
