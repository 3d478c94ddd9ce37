"""The random numbers of a mask: a pixel is selected where its number is below its rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import torch
from torch import Tensor

from fovden.checks import require
from fovden.foveation.blue_noise import TILE, blue_noise_tile
from fovden.rng import Stream, uniform

__all__ = ["Source", "mask_numbers"]

Source = Literal["philox", "stratified", "blue_noise"]
"""Where the numbers come from; see :func:`fovden.foveation.mask_numbers`."""

LEVELS = 6
"""Levels of the stratified source, from blocks of 2 x 2 to blocks of 64 x 64 pixels."""

FINE = 2.0**12
"""Steps within each of the 4096 parts of a block or a tile: 24 bits in all, which float32 holds exactly."""


def mask_numbers(
    resolution: tuple[int, int], seed: int = 0, *, index: int = 0, views: int = 1, source: Source = "philox"
) -> Tensor:
    """Returns the random numbers of a mask.

    Without a stated budget :func:`fovden.foveation.sample_map` selects the pixels whose number is below their rate.

    Args:
        resolution: Height and width in pixels.
        seed: Seed of the mask, from 0 to 2^32 - 1.
        index: Number of the frame, where each frame is to have a mask of its own.
        views: 1 for a mask that all views share, or the number of views for one in each.
        source: Where the numbers come from. ``"philox"``: independent. ``"stratified"``: the four pixels of a 2 x 2
            block lie in different quarters of [0, 1), the sixteen of a 4 x 4 block in different sixteenths, and so on
            up to 64 x 64, for blocks that start at multiples of their size. ``"blue_noise"``: ranks of a
            void-and-cluster tile of 64 x 64 pixels, repeated and shifted at random.

    Returns:
        Numbers in [0, 1), each of them uniform, float32, shape (views, 1, h, w).

    Raises:
        ValueError: If a number is out of range or the source is none of those.

    Example:
        >>> from fovden.camera import Gaze, StereoCamera
        >>> from fovden.foveation import ThreeLayer, sample_map
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(30, 20))
        >>> rate = ThreeLayer()(camera.views, Gaze.center(camera)).rate
        >>> torch.equal(mask_numbers((30, 20), 7) < rate[:1], sample_map(ThreeLayer(), camera, seed=7).mask > 0)
        True
    """
    names = get_args(Source)
    require(source in names, "source", repr(source), f"one of {names}")
    height, width = resolution
    view = torch.arange(views)[:, None, None, None]

    def draw(rows: int, columns: int, dimension: int) -> Tensor:
        pixel = torch.arange(rows * columns).reshape(1, 1, rows, columns)
        return uniform(seed, Stream.MASK, pixel, view=view, sample=index, dimension=dimension)

    if source == "philox":
        return draw(height, width, 0)
    if source == "stratified":
        return _stratified(height, width, views, draw)
    shift = torch.stack([draw(1, 1, dimension) for dimension in (0, 1)]) * TILE
    y = (torch.arange(height)[:, None] + shift[0].long()) % TILE
    x = (torch.arange(width) + shift[1].long()) % TILE
    return (blue_noise_tile()[y, x] + (FINE * draw(height, width, 2)).floor() / FINE) / TILE**2


def _stratified(height: int, width: int, views: int, draw: Callable[[int, int, int], Tensor]) -> Tensor:
    """Numbers whose first digits in base 4 differ in each 2 x 2 block, the first two in each 4 x 4 block, and so on."""
    size = 2**LEVELS
    rows, columns = -(-height // size) * size, -(-width // size) * size
    number: Tensor = (FINE * draw(rows, columns, LEVELS)).floor() / FINE / 4.0**LEVELS
    for level in range(LEVELS):
        y, x = rows >> level, columns >> level
        keys = draw(y, x, level).reshape(views, y // 2, 2, x // 2, 2).transpose(2, 3).reshape(views, y // 2, x // 2, 4)
        # The rank of a child's key among the four of its block is a random order of the quarters.
        rank = keys.argsort(dim=-1).argsort(dim=-1)
        digit = rank.reshape(views, y // 2, x // 2, 2, 2).transpose(2, 3).reshape(views, 1, y, x)
        spread = digit.repeat_interleave(2**level, dim=2).repeat_interleave(2**level, dim=3)
        number += spread / 4.0 ** (level + 1)
    return number[..., :height, :width]
