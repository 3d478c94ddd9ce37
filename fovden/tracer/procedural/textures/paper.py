"""Paper and what is printed on it: wallpaper, the spines of books, the edges of their pages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.patch import Array
from fovden.tracer.procedural.textures.fields import Colour, image, noise

__all__ = ["SPINE_COLUMNS", "SPINE_ROWS", "book_spines", "page_edges", "wallpaper"]

SPINE_COLUMNS, SPINE_ROWS = 16, 4
"""Spines side by side and above each other in the image of :func:`book_spines`."""


def wallpaper(
    rng: np.random.Generator,
    ground: Colour,
    stripe: Colour,
    petal: Colour,
    heart: Colour,
    leaf: Colour,
    size: int = 512,
) -> Tensor:
    """Returns wallpaper: roses on winding stems with leaves, over broad stripes; every other stem is shifted by half.

    Args:
        rng: Source of the paper's tone.
        ground: Colour of the paper.
        stripe: Colour of the stripes, close to the ground's.
        petal: Colour of the outer petals.
        heart: Colour of the inner ones.
        leaf: Colour of stems and leaves.
        size: Height and width in pixels.

    Returns:
        The image.

    Example:
        >>> pale, rose, red, green = (0.9, 0.8, 0.8), (0.8, 0.5, 0.6), (0.6, 0.2, 0.3), (0.5, 0.6, 0.4)
        >>> wallpaper(np.random.default_rng(0), pale, pale, rose, red, green, size=32).shape
        torch.Size([32, 32, 3])
    """
    position = (np.arange(size) + 0.5) / size
    y, x = np.meshgrid(position[::-1], position, indexing="ij")
    colour = np.where((np.abs(2 * x % 1 - 0.5) < 0.25)[..., None], np.asarray(stripe), np.asarray(ground))
    for column in (0, 1):
        middle = 0.25 + 0.5 * column + 0.035 * np.sin(2 * np.pi * (y + 0.5 * column))
        colour[np.abs(x - middle) < 0.0045] = leaf
        for k in range(6):
            at = (k + 0.5) / 6 + 0.5 * column
            side = 1 if k % 2 else -1
            stem = 0.25 + 0.5 * column + 0.035 * np.sin(2 * np.pi * (at + 0.5 * column))
            u, v = _wrapped(x - stem) * side, _wrapped(y - at)
            along, across = 0.8 * u + 0.6 * v, -0.6 * u + 0.8 * v
            blade = (np.abs(across) < 0.55 * along * (1 - along / 0.075)) & (along > 0) & (along < 0.075)
            colour[blade & (np.abs(across) > 0.0025)] = leaf
        for k, radius in ((0, 0.078), (1, 0.05)):
            at = 0.25 + 0.5 * column + 0.5 * k
            stem = 0.25 + 0.5 * column + 0.035 * np.sin(2 * np.pi * (at + 0.5 * column))
            _rose(colour, _wrapped(x - stem), _wrapped(y - at), radius, petal, heart)
    return image(colour * (1 + 0.015 * noise(rng, size, 0.5))[..., None])


def _wrapped(distance: Array) -> Array:
    wrapped: Array = distance - np.round(distance)
    return wrapped


def _rose(colour: Array, u: Array, v: Array, radius: float, petal: Colour, heart: Colour) -> None:
    """Paints a rose of three whorls of petals, each darker than the one around it, with light rims."""
    distance, angle = np.hypot(u, v) / radius, np.arctan2(v, u)
    pale = 0.5 + 0.5 * np.asarray(petal)
    for whorl, (reach, count) in enumerate(((1.0, 5), (0.7, 5), (0.42, 3))):
        rim = reach * (0.86 + 0.14 * np.abs(np.cos(count / 2 * angle + 0.7 * whorl)))
        share = whorl / 2
        colour[distance < rim] = pale
        colour[distance < rim - 0.07] = (1 - share) * np.asarray(petal) + share * np.asarray(heart)
    colour[distance < 0.12] = pale


def book_spines(rng: np.random.Generator, cloths: Sequence[Colour], gilt: Colour, cell: int = 48) -> Tensor:
    """Returns spines of books, a grid of :data:`SPINE_COLUMNS` by :data:`SPINE_ROWS`: labels, lines and lettering.

    Args:
        rng: Chooses each spine's binding.
        cloths: Colours of the bindings.
        gilt: Colour of lines and letters.
        cell: Width of a spine in pixels; it is four times as tall.

    Returns:
        The image.

    Example:
        >>> book_spines(np.random.default_rng(0), [(0.6, 0.2, 0.3)], (0.8, 0.7, 0.4), cell=8).shape
        torch.Size([128, 128, 3])
    """
    tall = 4 * cell
    picture = np.empty((SPINE_ROWS * tall, SPINE_COLUMNS * cell, 3))
    x = np.broadcast_to((np.arange(cell) + 0.5) / cell, (tall, cell))
    y = np.broadcast_to(((np.arange(tall) + 0.5) / tall)[:, None], (tall, cell))
    for row, column in np.ndindex(SPINE_ROWS, SPINE_COLUMNS):
        cloth = np.asarray(cloths[int(rng.integers(len(cloths)))])
        spine = np.broadcast_to(cloth, (tall, cell, 3)).copy()
        ink = np.asarray(gilt if cloth.mean() < 0.66 else (0.36, 0.16, 0.17))
        for at in rng.choice([0.06, 0.1, 0.22, 0.45, 0.7, 0.84, 0.9, 0.94], rng.integers(2, 7), replace=False):
            spine[np.abs(y - at) < 0.009] = ink
        if rng.random() < 0.55:
            other = np.asarray(cloths[int(rng.integers(len(cloths)))])
            spine[(y > 0.14) & (y < 0.40) & (np.abs(x - 0.5) < 0.46)] = 0.6 * other + 0.1
            ink = np.asarray(gilt)
        centre, reach = (0.27, 0.10) if rng.random() < 0.6 else (0.42, 0.24)
        letters = rng.random(28) < 0.72
        along = (y - centre) / reach
        glyph = letters[np.clip((along * 14 + 14).astype(int), 0, 27)]
        wiggle = np.abs(x - 0.5) < (0.1 + 0.1 * rng.random(28))[np.clip((along * 14 + 14).astype(int), 0, 27)]
        spine[(np.abs(along) < 1) & glyph & wiggle] = ink
        spine[(np.hypot(x - 0.5, 4 * (y - 0.79)) < 0.2) & (np.hypot(x - 0.5, 4 * (y - 0.79)) > 0.1)] = ink
        picture[row * tall : (row + 1) * tall, column * cell : (column + 1) * cell] = spine
    return image(picture * (1 + 0.04 * noise(rng, 4 * tall, 0.8)[:, : SPINE_COLUMNS * cell])[..., None])


def page_edges(rng: np.random.Generator, paper: Colour, size: int = 128) -> Tensor:
    """Returns the edge of a closed book: thin lines along the vertical, between the pages.

    Example:
        >>> page_edges(np.random.default_rng(0), (0.9, 0.87, 0.78), size=16).shape
        torch.Size([16, 16, 3])
    """
    lines = 1 + 0.09 * rng.standard_normal(size)
    return image(np.asarray(paper) * (lines[None, :] + 0.02 * noise(rng, size, 0.8))[..., None])
