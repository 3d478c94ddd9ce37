"""What lies on the ground: the forest's floor, and stone with moss on it."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.patch import Array
from fovden.tracer.procedural.textures.fields import Colour, image, mix, noise, sigmoid

__all__ = ["forest_floor", "mossy_stone"]


def forest_floor(
    rng: np.random.Generator, soil: Colour, moss: Colour, litter: tuple[Colour, ...], size: int = 1024
) -> Tensor:
    """Returns the floor of a forest: soil, cushions of moss, and leaf litter strewn over both.

    Args:
        rng: Source of randomness.
        soil: Colour of the bare ground.
        moss: Colour of the moss.
        litter: Colours of the dead leaves.
        size: Height and width in pixels.

    Returns:
        The image; a leaf is about 1/45 of it long.

    Example:
        >>> forest_floor(np.random.default_rng(0), (0.2, 0.15, 0.1), (0.3, 0.4, 0.2), ((0.5, 0.3, 0.2),), size=16).shape
        torch.Size([16, 16, 3])
    """
    earth = np.asarray(soil) * (1 + 0.22 * noise(rng, size, 1.0) + 0.10 * noise(rng, size, 0.4))[..., None]
    cushion = np.asarray(moss) * (1 + 0.20 * noise(rng, size, 0.9) + 0.12 * noise(rng, size, 0.3))[..., None]
    covered = sigmoid(7 * (noise(rng, size, 1.6) + 0.35 * noise(rng, size, 0.8) + 0.05))
    colour = earth + covered[..., None] * (cushion - earth)
    bare = noise(rng, size, 1.5)
    for _ in range(1500):
        _strew_leaf(rng, colour, np.asarray(litter[rng.integers(len(litter))]), bare)
    return image(colour)


def _strew_leaf(rng: np.random.Generator, colour: Array, tone: Array, chance: Array) -> None:
    """Paints one dead leaf, an oval with a midrib, into the image; fewer where the chance is low."""
    size = len(colour)
    row, column = rng.integers(size, size=2)
    turn, shade = rng.uniform(0, 2 * np.pi), rng.uniform(0.6, 1.25)
    half = size * rng.uniform(0.008, 0.014)
    if chance[row, column] < rng.normal(-0.2, 0.8):
        return
    reach = int(np.ceil(half))
    offset = np.arange(-reach, reach + 1)
    y, x = np.meshgrid(offset, offset, indexing="ij")
    along = (x * np.cos(turn) + y * np.sin(turn)) / half
    across = (y * np.cos(turn) - x * np.sin(turn)) / half
    inside = np.abs(across) < 0.45 * np.clip(1 - along**2, 0, 1)
    rows, columns = (row + y[inside]) % size, (column + x[inside]) % size
    rib = np.where(np.abs(across[inside]) < 0.06, 0.7, 1.0)
    colour[rows, columns] = tone * shade * rib[:, None]


def mossy_stone(
    rng: np.random.Generator, ground: Colour, fleck: Colour, moss: Colour, cover: float = 0.5, size: int = 512
) -> Tensor:
    """Returns rough stone, speckled and cracked, with lichen and moss on part of it.

    Args:
        rng: Source of randomness.
        ground: Colour of the stone.
        fleck: Colour of its lighter grains and of the lichen.
        moss: Colour of the moss.
        cover: About the share that moss covers.
        size: Height and width in pixels.

    Returns:
        The image.

    Example:
        >>> mossy_stone(np.random.default_rng(0), (0.5, 0.5, 0.5), (0.7, 0.7, 0.7), (0.3, 0.4, 0.2), size=16).shape
        torch.Size([16, 16, 3])
    """
    stone = mix(ground, fleck, sigmoid(4 * (noise(rng, size, 0.5) - 1.1)))
    lichen = sigmoid(14 * (noise(rng, size, 1.3) - 1.35))
    stone = stone + 0.7 * lichen[..., None] * (np.asarray(fleck) - stone)
    crack = 0.6 * np.exp(-((noise(rng, size, 1.7) / 0.035) ** 2))
    stone = stone * (1 + 0.10 * noise(rng, size, 1.2) - crack)[..., None]
    field = noise(rng, size, 1.7) + 0.4 * noise(rng, size, 0.8)
    covered = sigmoid(8 * (field - np.quantile(field, 1 - cover)))
    cushion = np.asarray(moss) * (1 + 0.2 * noise(rng, size, 0.7))[..., None]
    return image(stone + covered[..., None] * (cushion - stone))
