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
"""Random numbers are multiples of 1 / STEPS; running sums are rounded to such."""


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

    A direction's density is the bilinear interpolation of what exceeds the image's mean luminance, up to a factor:
    linear around the pole, and in the cosine of the polar angle between two rows, so that a patch's chance is exactly
    the mean of its corners times its solid angle. The share of such samples is that of the light above the mean in all
    light, at most three quarters.

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
    light = luminance(image.double().permute(2, 0, 1)[None])[0, 0]
    mean = float((light.sum(1) * solid_angles(height)).sum()) / max(width, 1)
    # Rows of patches begin at the upper pole, at the rows' middles, and end at the lower pole.
    edges = torch.cat([torch.zeros(1), (torch.arange(height) + 0.5) / max(height, 1), torch.ones(1)]).double()
    cosines = torch.cos(math.pi * edges)
    corners = (light - mean).clamp_min(0)
    corners = corners + corners.roll(-1, 1)  # of two columns
    corners = torch.cat([corners[:1], corners, corners[-1:]])
    patches = (corners[:-1] + corners[1:]) / 4 * (cosines[:-1] - cosines[1:])[:, None] * 2 * math.pi / max(width, 1)
    excess = float(patches.sum())
    share = min(GREATEST_SHARE, excess / (4 * math.pi * mean)) if mean > 0 else 0.0
    if share < LEAST_SHARE:
        patches, excess, share = torch.ones(1, 1, dtype=torch.float64), 1.0, 0.0
    sums = (_running_sums(patches.sum(1)), _running_sums(patches), cosines)
    return SkyArrays(*(array.float().numpy() for array in sums), *map(np.float32, (mean, 1 / excess, share)))


def _running_sums(weights: Tensor) -> Tensor:
    """Running sums along the last axis over their total, which end at one; rows without weight are even."""
    total = weights.sum(-1, keepdim=True)
    weights = torch.where(total > 0, weights, torch.ones_like(weights))
    sums = torch.cumsum(weights, -1)
    return torch.round(sums / sums[..., -1:] * STEPS) / STEPS
