"""Reflectance images made in code: stone, plaster, marble, wood, cloth, terracotta and leaf.

Each function returns a uint8 image with the sRGB curve, shape (h, w, 3), top row first, that repeats without a seam.
Colours are given as sRGB values in [0, 1]. The variation is drawn by the generator that is passed in.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from fovden.tracer.procedural.patch import Array

__all__ = ["ashlar", "cloth", "inlay", "leaf", "marble", "noise", "plaster", "terracotta", "wood"]

Colour = tuple[float, float, float]


def noise(rng: np.random.Generator, size: int, slope: float = 1.5, stretch: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Returns seamless fractal noise of mean 0 and standard deviation 1.

    White noise whose spectrum is multiplied by f^-slope, where f is the frequency in cycles per image.

    Args:
        rng: Source of randomness.
        size: Height and width in pixels.
        slope: Steepness: 1 is rough, 2 is cloudy.
        stretch: Factors on the vertical and horizontal frequency: a large one shortens features along that axis less
            than it suppresses variation there, which makes grain along the other axis.

    Returns:
        Values, shape (size, size).

    Example:
        >>> round(float(noise(np.random.default_rng(0), 32).std()), 6)
        1.0
    """
    vertical = np.fft.fftfreq(size)[:, None] * size * stretch[0]
    horizontal = np.fft.rfftfreq(size)[None, :] * size * stretch[1]
    frequency = np.hypot(vertical, horizontal)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * frequency**-slope
    values: Array = np.fft.irfft2(spectrum, s=(size, size))
    values /= values.std()
    return values


def marble(rng: np.random.Generator, ground: Colour, vein: Colour, size: int = 256) -> Tensor:
    """Returns stone with veins: the level line of one noise, its strength varied by another.

    Example:
        >>> marble(np.random.default_rng(0), (0.8, 0.8, 0.7), (0.4, 0.4, 0.4), size=16).shape
        torch.Size([16, 16, 3])
    """
    strength = np.exp(-((noise(rng, size, 1.8) / 0.07) ** 2)) * _sigmoid(2 * noise(rng, size, 2.0))
    strength += 0.35 * np.exp(-((noise(rng, size, 1.6) / 0.05) ** 2))
    tone = 1 + 0.045 * noise(rng, size, 1.4)
    return _image(_mix(ground, vein, np.clip(strength, 0, 1)) * tone[..., None])


def plaster(rng: np.random.Generator, ground: Colour, stain: Colour, size: int = 256) -> Tensor:
    """Returns plaster with soft stains.

    Example:
        >>> plaster(np.random.default_rng(0), (0.85, 0.8, 0.7), (0.7, 0.6, 0.5), size=16).dtype
        torch.uint8
    """
    strength = 0.8 * _sigmoid(2.5 * (noise(rng, size, 1.7) - 0.8))
    tone = 1 + 0.02 * noise(rng, size, 0.6)
    return _image(_mix(ground, stain, strength) * tone[..., None])


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
    joint = np.minimum(_distance_to_integer(y) * size / rows, _distance_to_integer(x) * size / columns)
    return _image(np.where((joint < size / 170)[..., None], np.asarray(mortar), stone))


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
    return _image(colour * (1 + 0.05 * noise(rng, size, 1.2))[..., None])


def wood(rng: np.random.Generator, light: Colour, dark: Colour, size: int = 256) -> Tensor:
    """Returns planks with grain along the vertical.

    Example:
        >>> wood(np.random.default_rng(0), (0.5, 0.35, 0.2), (0.3, 0.2, 0.1), size=16).shape
        torch.Size([16, 16, 3])
    """
    planks = 4
    position = (np.arange(size) + 0.5) / size * planks
    grain = noise(rng, size, 1.3, stretch=(12.0, 1.0)) * 0.9 + noise(rng, size, 0.7, stretch=(6.0, 1.0)) * 0.4
    tone = 0.6 * rng.standard_normal(planks)[position.astype(int)]
    colour = _mix(light, dark, _sigmoid(1.4 * grain + tone))
    gap = _distance_to_integer(position) * size / planks < size / 200
    return _image(np.where(gap[None, :, None], 0.45 * np.asarray(dark), colour))


def cloth(rng: np.random.Generator, ground: Colour, figure: Colour, size: int = 256) -> Tensor:
    """Returns woven cloth with a damask of pointed ovals and blossoms in two colours.

    Example:
        >>> cloth(np.random.default_rng(0), (0.6, 0.1, 0.1), (0.8, 0.6, 0.3), size=16).shape
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
    return _image(colour * (0.96 + 0.08 * weave + 0.03 * noise(rng, size, 0.8))[..., None])


def terracotta(rng: np.random.Generator, ground: Colour, size: int = 128) -> Tensor:
    """Returns fired clay with a mottled tone.

    Example:
        >>> terracotta(np.random.default_rng(0), (0.7, 0.4, 0.3), size=16).shape
        torch.Size([16, 16, 3])
    """
    return _image(np.asarray(ground) * (1 + 0.09 * noise(rng, size, 1.1))[..., None])


def leaf(rng: np.random.Generator, ground: Colour, vein: Colour, size: int = 64) -> Tensor:
    """Returns a leaf's skin: a light midrib at the image's middle column and side veins that rise from it.

    Example:
        >>> leaf(np.random.default_rng(0), (0.3, 0.5, 0.2), (0.5, 0.6, 0.3), size=16).shape
        torch.Size([16, 16, 3])
    """
    position = (np.arange(size) + 0.5) / size
    y, x = np.meshgrid(position, np.abs(position - 0.5), indexing="ij")
    side = _distance_to_integer(5 * (y + 0.8 * x)) < 0.09
    colour = np.where(((x < 0.035) | side)[..., None], np.asarray(vein), np.asarray(ground))
    return _image(colour * (1 + 0.06 * noise(rng, size, 0.9))[..., None])


def _image(colour: Array) -> Tensor:
    return torch.from_numpy(np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8))


def _mix(first: Colour, second: Colour, share: Array) -> Array:
    mixed: Array = np.asarray(first) + share[..., None] * (np.asarray(second) - np.asarray(first))
    return mixed


def _sigmoid(value: Array) -> Array:
    return 1 / (1 + np.exp(-value))


def _distance_to_integer(value: Array) -> Array:
    distance: Array = np.abs(value - np.round(value))
    return distance
