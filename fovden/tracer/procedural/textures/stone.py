"""Stone, dressed and veined, plaster and fired clay."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.textures.fields import Colour, distance_to_integer, image, mix, noise, sigmoid

__all__ = ["ashlar", "inlay", "marble", "plaster", "terracotta"]


def ashlar(
    rng: np.random.Generator, ground: Colour, mortar: Colour, rows: int = 4, columns: int = 2, size: int = 512
) -> Tensor:
    """Returns dressed stone blocks in courses, every other course shifted by half a block, with mortar joints.

    Example:
        >>> ashlar(np.random.default_rng(0), (0.7, 0.66, 0.56), (0.5, 0.47, 0.4), size=32).shape
        torch.Size([32, 32, 3])
    """
    y, x = np.meshgrid((np.arange(size) + 0.5) / size * rows, (np.arange(size) + 0.5) / size * columns, indexing="ij")
    course = np.floor(y).astype(int)
    x = x + 0.5 * (course % 2)
    block = np.floor(x).astype(int) % columns
    tone = 1 + 0.07 * rng.standard_normal((rows, columns))[course, block] + 0.04 * noise(rng, size, 1.0)
    warmth = 0.02 * rng.standard_normal((rows, columns))[course, block]
    stone = np.asarray(ground) * tone[..., None] + warmth[..., None] * np.array([1.0, 0.2, -1.0])
    joint = np.minimum(distance_to_integer(y) * size / rows, distance_to_integer(x) * size / columns)
    return image(np.where((joint < size / 170)[..., None], np.asarray(mortar), stone))


def inlay(rng: np.random.Generator, ground: Colour, figure: Colour, border: Colour, size: int = 256) -> Tensor:
    """Returns a marble slab with a border and a diamond set into it.

    Example:
        >>> inlay(np.random.default_rng(0), (0.8, 0.8, 0.7), (0.5, 0.2, 0.2), (0.3, 0.3, 0.3), size=16).shape
        torch.Size([16, 16, 3])
    """
    axis = np.abs((np.arange(size) + 0.5) / size * 2 - 1)
    y, x = np.meshgrid(axis, axis, indexing="ij")
    diamond, edge = x + y, np.maximum(x, y)
    colour = np.broadcast_to(np.asarray(ground), (size, size, 3))
    colour = np.where(((edge > 0.78) & (edge < 0.9))[..., None], np.asarray(border), colour)
    colour = np.where((diamond < 0.74)[..., None], np.asarray(border), colour)
    colour = np.where((diamond < 0.62)[..., None], np.asarray(figure), colour)
    colour = np.where((np.hypot(x, y) < 0.2)[..., None], np.asarray(ground), colour)
    return image(colour * (1 + 0.05 * noise(rng, size, 1.2))[..., None])


def marble(rng: np.random.Generator, ground: Colour, vein: Colour, size: int = 256) -> Tensor:
    """Returns stone with veins: the level line of one noise, its strength varied by another.

    Example:
        >>> marble(np.random.default_rng(0), (0.8, 0.8, 0.7), (0.4, 0.4, 0.4), size=16).shape
        torch.Size([16, 16, 3])
    """
    strength = np.exp(-((noise(rng, size, 1.8) / 0.07) ** 2)) * sigmoid(2 * noise(rng, size, 2.0))
    strength += 0.35 * np.exp(-((noise(rng, size, 1.6) / 0.05) ** 2))
    tone = 1 + 0.045 * noise(rng, size, 1.4)
    return image(mix(ground, vein, np.clip(strength, 0, 1)) * tone[..., None])


def plaster(rng: np.random.Generator, ground: Colour, stain: Colour, size: int = 256) -> Tensor:
    """Returns plaster with soft stains.

    Example:
        >>> plaster(np.random.default_rng(0), (0.85, 0.8, 0.7), (0.7, 0.6, 0.5), size=16).dtype
        torch.uint8
    """
    strength = 0.8 * sigmoid(2.5 * (noise(rng, size, 1.7) - 0.8))
    tone = 1 + 0.02 * noise(rng, size, 0.6)
    return image(mix(ground, stain, strength) * tone[..., None])


def terracotta(rng: np.random.Generator, ground: Colour, size: int = 128) -> Tensor:
    """Returns fired clay with a mottled tone.

    Example:
        >>> terracotta(np.random.default_rng(0), (0.7, 0.4, 0.3), size=16).shape
        torch.Size([16, 16, 3])
    """
    return image(np.asarray(ground) * (1 + 0.09 * noise(rng, size, 1.1))[..., None])
