"""Cloth, woven."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from fovden.tracer.procedural.textures.fields import Colour, image, noise

__all__ = ["carpet", "damask", "patchwork", "striped", "woven"]


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


def woven(
    rng: np.random.Generator, warp: Colour, weft: Colour, threads: int = 32, size: int = 256, slub: float = 0.05
) -> Tensor:
    """Returns plain weave: warp and weft threads that pass over and under each other, of uneven thickness.

    Args:
        rng: Source of the threads' unevenness.
        warp: Colour of the threads along the vertical.
        weft: Colour of those along the horizontal.
        threads: Threads in each direction.
        size: Height and width in pixels.
        slub: Standard deviation of the threads' tones.

    Returns:
        The image.

    Example:
        >>> woven(np.random.default_rng(0), (0.8, 0.6, 0.6), (0.9, 0.8, 0.8), threads=4, size=16).shape
        torch.Size([16, 16, 3])
    """
    position = (np.arange(size) + 0.5) / size * threads
    y, x = np.meshgrid(position, position, indexing="ij")
    over = (np.floor(x) + np.floor(y)) % 2 == 0
    colour = np.where(over[..., None], np.asarray(warp), np.asarray(weft))
    across = np.where(over, x, y) % 1 - 0.5
    tone = slub * rng.standard_normal((2, threads))
    tone = np.where(over, tone[0][x.astype(int)], tone[1][y.astype(int)]) + 0.03 * noise(rng, size, 1.2)
    return image(colour * (1 + tone - 0.5 * across**2)[..., None])


def striped(rng: np.random.Generator, ground: Colour, stripe: Colour, count: int = 4, size: int = 256) -> Tensor:
    """Returns ticking: pairs of wide and narrow stripes along the vertical.

    Example:
        >>> striped(np.random.default_rng(0), (0.9, 0.8, 0.8), (0.7, 0.3, 0.4), size=16).shape
        torch.Size([16, 16, 3])
    """
    across = (np.arange(size) + 0.5) / size * count % 1
    mark = (np.abs(across - 0.3) < 0.16) | (np.abs(np.abs(across - 0.3) - 0.23) < 0.025) | (np.abs(across - 0.8) < 0.04)
    colour = np.where(np.broadcast_to(mark, (size, size))[..., None], np.asarray(stripe), np.asarray(ground))
    weave = np.indices((size, size)).sum(axis=0) // 2 % 2
    return image(colour * (0.97 + 0.05 * weave + 0.03 * noise(rng, size, 0.9))[..., None])


def patchwork(rng: np.random.Generator, colours: Sequence[Colour], squares: int = 6, size: int = 512) -> Tensor:
    """Returns a quilt's top: squares of plain, dotted, striped and flowered cloth, with stitches along their seams.

    Args:
        rng: Chooses each square's cloth.
        colours: At least three colours; each square has two of them, and the first is that of the stitches.
        squares: Squares in each direction.
        size: Height and width in pixels.

    Returns:
        The image.

    Example:
        >>> white, rose, red = (0.9, 0.9, 0.9), (0.9, 0.7, 0.7), (0.6, 0.1, 0.2)
        >>> patchwork(np.random.default_rng(0), [white, rose, red], squares=2, size=32).shape
        torch.Size([32, 32, 3])
    """
    palette = np.asarray(colours)
    position = (np.arange(size) + 0.5) / size * squares
    y, x = np.meshgrid(position, position, indexing="ij")
    row, column = y.astype(int), x.astype(int)
    first = (row + 2 * column + rng.integers(0, 2, (squares, squares))[row, column]) % len(palette)
    second = (first + rng.integers(1, len(palette), (squares, squares))[row, column]) % len(palette)
    kind = rng.integers(0, 4, (squares, squares))[row, column]
    u, v = 5 * x % 1 - 0.5, 5 * y % 1 - 0.5
    flower = np.hypot(u, v) < 0.27 * (1 + 0.45 * np.cos(5 * np.arctan2(v, u)))
    marks = [np.zeros_like(flower), np.hypot(u, v) < 0.24, np.abs(u) < 0.2, flower]
    marked = np.choose(kind, marks)
    colour = np.where(marked[..., None], palette[second], palette[first])
    inside = np.minimum(np.abs(x % 1 - 0.5), np.abs(y % 1 - 0.5))
    seam = np.maximum(np.abs(x % 1 - 0.5), np.abs(y % 1 - 0.5))
    stitch = (np.abs(seam - 0.44) < 0.012) & (24 * inside % 1 < 0.6)
    colour = np.where(stitch[..., None], palette[0], colour)
    tone = np.where(seam > 0.485, 0.78, 1.0) + 0.03 * noise(rng, size, 0.9)
    return image(colour * tone[..., None])


def carpet(rng: np.random.Generator, field: Colour, border: Colour, light: Colour, dark: Colour) -> Tensor:
    """Returns a whole carpet: a medallion with petals in a field of small flowers, within striped and flowered borders.

    The image shows the carpet once; its long side is horizontal.

    Example:
        >>> pale, deep = (0.9, 0.8, 0.7), (0.3, 0.1, 0.2)
        >>> carpet(np.random.default_rng(0), (0.8, 0.5, 0.5), (0.6, 0.3, 0.4), pale, deep).shape
        torch.Size([384, 512, 3])
    """
    height, width = 384, 512
    y, x = np.meshgrid((np.arange(height) + 0.5) / height - 0.5, (np.arange(width) + 0.5) / width - 0.5, indexing="ij")
    x, y = x * 2.0, y * 1.5
    edge = np.minimum(1.0 - np.abs(x), 0.75 - np.abs(y))
    angle, distance = np.arctan2(y, x * 0.8), np.hypot(x * 0.8, y)
    colour = np.broadcast_to(np.asarray(field), (height, width, 3)).copy()

    def paint(where: NDArray[np.bool_], with_colour: Colour) -> None:
        colour[where] = with_colour

    def blossoms(step: float, reach: float, shift: float) -> NDArray[np.bool_]:
        u, v = (x / step + shift) % 1 - 0.5, (y / step + shift) % 1 - 0.5
        petals: NDArray[np.bool_] = np.hypot(u, v) < reach * (1 + 0.35 * np.cos(6 * np.arctan2(v, u)))
        return petals

    paint(blossoms(0.14, 0.17, 0.0), light)
    paint(blossoms(0.14, 0.06, 0.0), border)
    paint(blossoms(0.14, 0.09, 0.5), dark)
    lobes = 0.43 * (1 + 0.10 * np.cos(16 * angle))
    for share, tint in ((1.0, dark), (0.95, light), (0.83, border), (0.62, light), (0.55, field)):
        paint(distance < lobes * share, tint)
    paint(distance < 0.21 * (1 + 0.5 * np.cos(8 * angle)), dark)
    paint(distance < 0.17 * (1 + 0.5 * np.cos(8 * angle)), light)
    paint(distance < 0.06, border)
    corner = np.hypot(1.0 - np.abs(x), 0.75 - np.abs(y)) < 0.52 + 0.03 * np.cos(18 * np.arctan2(np.abs(y), np.abs(x)))
    paint(corner, border)
    paint(corner & blossoms(0.1, 0.2, 0.25), light)
    paint(edge < 0.27, dark)
    paint(edge < 0.255, light)
    paint(edge < 0.235, border)
    along = np.where(0.75 - np.abs(y) < 1.0 - np.abs(x), x, y) * 8
    wreath = np.hypot((along % 1 - 0.5) / 8, edge - 0.155)
    turn = np.arctan2(edge - 0.155, (along % 1 - 0.5) / 8)
    paint((edge < 0.235) & (wreath < 0.045 * (1 + 0.25 * np.cos(5 * turn))), light)
    paint((edge < 0.235) & (wreath < 0.018), dark)
    paint((edge < 0.235) & (np.abs(edge - 0.155 - 0.04 * np.sin(along * np.pi * 2)) < 0.006), dark)
    paint(edge < 0.075, light)
    paint(edge < 0.058, dark)
    paint(edge < 0.025, field)
    tone = 1 + 0.05 * noise(rng, width, 0.8)[:height]
    return image(colour * tone[..., None])
