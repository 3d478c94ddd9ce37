"""Skins of plants."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.textures.fields import Colour, distance_to_integer, image, noise

__all__ = ["leaf"]


def leaf(rng: np.random.Generator, ground: Colour, vein: Colour, size: int = 64) -> Tensor:
    """Returns a leaf's skin: a light midrib at the image's middle column and side veins that rise from it.

    Example:
        >>> leaf(np.random.default_rng(0), (0.3, 0.5, 0.2), (0.5, 0.6, 0.3), size=16).shape
        torch.Size([16, 16, 3])
    """
    position = (np.arange(size) + 0.5) / size
    y, x = np.meshgrid(position, np.abs(position - 0.5), indexing="ij")
    side = distance_to_integer(5 * (y + 0.8 * x)) < 0.09
    colour = np.where(((x < 0.035) | side)[..., None], np.asarray(vein), np.asarray(ground))
    return image(colour * (1 + 0.06 * noise(rng, size, 0.9))[..., None])
