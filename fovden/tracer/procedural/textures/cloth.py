"""Cloth, woven."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.textures.fields import Colour, image, noise

__all__ = ["damask"]


def damask(rng: np.random.Generator, ground: Colour, figure: Colour, size: int = 256) -> Tensor:
    """Returns woven cloth with a damask of pointed ovals and blossoms in two colours.

    Example:
        >>> damask(np.random.default_rng(0), (0.6, 0.1, 0.1), (0.8, 0.6, 0.3), size=16).shape
        torch.Size([16, 16, 3])
    """
    position = (np.arange(size) + 0.5) / size
    y, x = np.meshgrid(position * 2 * np.pi, position * 2 * np.pi, indexing="ij")
    ogee = np.cos(x) + np.cos(y) * (0.75 + 0.25 * np.cos(2 * y))
    lattice = np.abs(ogee) < 0.16
    shifted = [np.hypot(np.sin((x - dx) / 2), np.sin((y - dy) / 2)) for dx, dy in ((0, 0), (np.pi, np.pi))]
    turned = [np.arctan2(np.sin(y - dy), np.sin(x - dx)) for dx, dy in ((0, 0), (np.pi, np.pi))]
    blossom = np.zeros_like(lattice)
    for distance, angle in zip(shifted, turned, strict=True):
        blossom |= (distance < 0.27 * (0.75 + 0.25 * np.cos(6 * angle))) & (distance > 0.07)
    colour = np.where((lattice | blossom)[..., None], np.asarray(figure), np.asarray(ground))
    weave = np.indices((size, size)).sum(axis=0) // 2 % 2
    return image(colour * (0.96 + 0.08 * weave + 0.03 * noise(rng, size, 0.8))[..., None])
