"""Where an image of the surroundings is sampled: in proportion to what exceeds its mean."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from fovden.color import luminance
from fovden.tracer.kernels.illumination import SkyArrays

__all__ = ["sky_arrays", "solid_angles"]

GREATEST_SHARE = 0.75
"""The rest goes to the cosine about the normal, whatever the image: a surface that the sun does not reach needs it."""
LEAST_SHARE = 0.01
"""Below this the image is even enough for the cosine alone."""
STEPS = 2.0**24
"""Random numbers are multiples of 1 / STEPS; running sums are rounded to such, and their differences are exact."""


def solid_angles(height: int) -> Tensor:
    """Returns the share of the sphere that each row of an equirectangular image covers, float64, shape (h).

    Example:
        >>> solid_angles(2)
        tensor([0.5000, 0.5000], dtype=torch.float64)
    """
    edges = torch.cos(torch.linspace(0, math.pi, height + 1, dtype=torch.float64))
    return (edges[:-1] - edges[1:]) / 2


def sky_arrays(image: Tensor) -> SkyArrays:
    """Returns how :mod:`fovden.tracer.kernels.illumination` samples the surroundings.

    A texel's chance is its solid angle times the luminance there above the image's mean, of the bilinear interpolation
    averaged over the texel: along each axis 1/8, 3/4 and 1/8 of three texels. So it covers all places that exceed the
    mean. The share of such samples is that of the light above the mean in all light, at most three quarters.

    Args:
        image: Radiance by row and column, shape (h, w, 3); empty without surroundings.

    Returns:
        The arrays; with share 0 where the image is even.

    Example:
        >>> image = torch.ones(4, 8, 3)
        >>> float(sky_arrays(image).share)
        0.0
        >>> image[1, 2] = 1000
        >>> float(sky_arrays(image).share)
        0.75
    """
    height, width = image.shape[:2]
    weight = solid_angles(height)[:, None].expand(height, width) / max(width, 1)
    light = luminance(image.double().permute(2, 0, 1)[None])[0, 0] if image.numel() else weight
    light = _averaged(_averaged(light, 0), 1)
    total = (light * weight).sum()
    excess = (light - total).clamp_min(0) * weight
    share = min(GREATEST_SHARE, float(excess.sum() / total)) if float(total) > 0 else 0.0
    if share < LEAST_SHARE:
        excess, share = weight[:1, :1], 0.0
    rows = _running_sums(excess.sum(1))
    columns = _running_sums(excess)
    chances = torch.diff(rows, prepend=torch.zeros(1, dtype=torch.float64))
    cosines = torch.cos(torch.linspace(0, math.pi, len(rows) + 1, dtype=torch.float64))
    # A row's chance over its solid angle, times the number of texels among which it is divided.
    scale = chances * columns.shape[1] / (2 * math.pi * (cosines[:-1] - cosines[1:]))
    return SkyArrays(_array(rows), _array(columns), _array(scale), _array(cosines), np.float32(share))


def _array(values: Tensor) -> np.ndarray:
    return values.float().contiguous().numpy()


def _averaged(image: Tensor, axis: int) -> Tensor:
    """Mean over each texel of what is interpolated along an axis: rows end at the poles, columns go around."""
    size = image.shape[axis]
    before, after = torch.arange(size) - 1, torch.arange(size) + 1
    if axis == 0:
        before, after = before.clamp_min(0), after.clamp_max(size - 1)
    else:
        after = after % max(size, 1)
    neighbours = image.index_select(axis, before % max(size, 1)) + image.index_select(axis, after)
    return 0.75 * image + 0.125 * neighbours


def _running_sums(weights: Tensor) -> Tensor:
    """Running sums along the last axis over their total, which end at one; rows without weight are even."""
    total = weights.sum(-1, keepdim=True)
    weights = torch.where(total > 0, weights, torch.ones_like(weights))
    sums = torch.cumsum(weights, -1)
    return torch.round(sums / sums[..., -1:] * STEPS) / STEPS
