"""Skins of plants: leaves, needles, bark, wood cut across, and a mushroom's cap."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from fovden.tracer.procedural.textures.fields import Colour, distance_to_integer, image, mix, noise, sigmoid

__all__ = ["bark", "blade", "cap", "end_grain", "leaf", "leaf_outline", "needles"]


def bark(rng: np.random.Generator, ridge: Colour, furrow: Colour, moss: Colour, size: int = 512) -> Tensor:
    """Returns furrowed bark: plates between dark cracks that run up the trunk, and moss in patches.

    Example:
        >>> bark(np.random.default_rng(0), (0.5, 0.4, 0.3), (0.2, 0.15, 0.1), (0.3, 0.4, 0.2), size=16).shape
        torch.Size([16, 16, 3])
    """
    cracks = np.abs(noise(rng, size, 1.25, stretch=(3.2, 1.0)))
    across = np.abs(noise(rng, size, 1.3, stretch=(1.0, 2.2)))
    depth = sigmoid(9 * (0.30 - cracks)) + 0.55 * sigmoid(12 * (0.12 - across))
    grain = 1 + 0.13 * noise(rng, size, 0.8, stretch=(4.0, 1.0))
    wood = mix(ridge, furrow, np.clip(depth, 0, 1)) * grain[..., None]
    covered = sigmoid(5 * (noise(rng, size, 1.7) + 0.45 * noise(rng, size, 0.9) - 0.75)) * (
        1 - 0.5 * np.clip(depth, 0, 1)
    )
    green = np.asarray(moss) * (1 + 0.2 * noise(rng, size, 0.6))[..., None]
    return image(wood + covered[..., None] * (green - wood))


def blade(rng: np.random.Generator, foot: Colour, tip: Colour, size: int = 64) -> Tensor:
    """Returns a blade of grass: parallel veins, its colour changing from the foot to the tip.

    Example:
        >>> blade(np.random.default_rng(0), (0.2, 0.3, 0.1), (0.5, 0.6, 0.3), size=16).shape
        torch.Size([16, 16, 3])
    """
    share = 1 - (np.arange(size) + 0.5) / size
    stripes = 1 + 0.12 * np.cos(2 * np.pi * 12 * share)[None, :]
    colour = mix(foot, tip, np.broadcast_to(share[:, None], (size, size)))
    return image(colour * (stripes * (1 + 0.06 * noise(rng, size, 0.9)))[..., None])


def cap(rng: np.random.Generator, skin: Colour, spot: Colour, size: int = 128) -> Tensor:
    """Returns a mushroom's cap seen from above: pale warts on a coloured skin that darkens towards the middle.

    Example:
        >>> cap(np.random.default_rng(0), (0.7, 0.1, 0.1), (0.9, 0.85, 0.8), size=16).shape
        torch.Size([16, 16, 3])
    """
    position = (np.arange(size) + 0.5) / size - 0.5
    y, x = np.meshgrid(position, position, indexing="ij")
    spots = np.zeros((size, size), dtype=bool)
    for i in range(26):
        distance, angle = 0.47 * np.sqrt((i + 0.5) / 26), 2.39996 * i + rng.normal(0, 0.25)
        radius = rng.uniform(0.018, 0.042)
        spots |= np.hypot(x - distance * np.cos(angle), y - distance * np.sin(angle)) < radius
    shade = 0.8 + 0.5 * np.hypot(x, y) + 0.04 * noise(rng, size, 1.0)
    return image(np.where(spots[..., None], np.asarray(spot), np.asarray(skin) * shade[..., None]))


def end_grain(rng: np.random.Generator, light: Colour, dark: Colour, rim: Colour, size: int = 256) -> Tensor:
    """Returns wood sawn across: growth rings around the image's middle, cracks from the heart, bark at the rim.

    Example:
        >>> end_grain(np.random.default_rng(0), (0.7, 0.55, 0.35), (0.5, 0.35, 0.2), (0.2, 0.15, 0.1), size=16).shape
        torch.Size([16, 16, 3])
    """
    position = (np.arange(size) + 0.5) / size - 0.5
    y, x = np.meshgrid(position, position, indexing="ij")
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    wave = 0.008 * np.sin(2 * angle + 1.0) + 0.005 * np.sin(5 * angle) + 0.003 * noise(rng, size, 1.5)
    ring = 0.5 + 0.5 * np.cos(2 * np.pi * 17 * np.clip(radius + wave, 0, None) ** 0.9)
    colour = mix(light, dark, ring**3)
    crack = np.abs(np.sin(angle * 2.5 + 0.7 + 3 * radius)) * radius < 0.006
    colour = np.where(crack[..., None], 0.4 * np.asarray(dark), colour)
    outside = (radius + wave > 0.455)[..., None]
    return image(np.where(outside, np.asarray(rim), colour) * (1 + 0.05 * noise(rng, size, 0.9))[..., None])


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


def leaf_outline(lobes: float, depth: float, width: float = 0.31, size: int = 64) -> Tensor:
    """Returns the opacity of a leaf: half inside one half of its outline, which interpolates to a smooth edge at 0.5.

    The leaf grows from the image's lower edge to its upper. To either side of the midrib it is ``width sin(pi t)^0.9``
    wide, less where lobes or teeth, which point forward, are cut into it.

    Args:
        lobes: Number of lobes or teeth on a side.
        depth: How deep they are, as a share of the width.
        width: Half the greatest width, as a share of the image's.
        size: Pixels to a side.

    Returns:
        Opacity, uint8, shape (size, size).

    Example:
        >>> leaf_outline(4, 0.4, size=16).shape
        torch.Size([16, 16])
    """
    position = (np.arange(size) + 0.5) / size
    along, across = np.meshgrid(1 - position, np.abs(position - 0.5), indexing="ij")
    phase = np.mod(lobes * (along - 0.6 * across), 1.0)
    notch = np.maximum(0.0, 2 * np.abs(phase - 0.5)) ** 2.0
    edge = width * np.sin(np.pi * along) ** 0.9 * (1 - depth * notch)
    opacity = np.clip(0.5 + (edge - across) * size / 4, 0, 1)
    return torch.from_numpy(np.round(255 * opacity).astype(np.uint8))


def needles(rng: np.random.Generator, light: Colour, dark: Colour, size: int = 256) -> Tensor:
    """Returns a spruce branch's needles: a comb of light needles over dark, pointing up the image.

    Example:
        >>> needles(np.random.default_rng(0), (0.2, 0.35, 0.2), (0.05, 0.1, 0.06), size=16).shape
        torch.Size([16, 16, 3])
    """
    comb = noise(rng, size, 0.9, stretch=(9.0, 1.0)) + 0.7 * np.cos(2 * np.pi * 24 * np.arange(size) / size)[None, :]
    colour = mix(dark, light, sigmoid(2.2 * comb))
    return image(colour * (1 + 0.14 * noise(rng, size, 1.4))[..., None])
