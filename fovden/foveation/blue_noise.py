"""A tile of blue noise: the numbers 0 .. n^2 - 1 so placed that those below any threshold are spread evenly.

Void-and-cluster (Ulichney, "The void-and-cluster method for dither array generation", Human Vision, Visual Processing,
and Digital Display IV, SPIE 1913, 1993): points are ranked one after the other by where a Gaussian blur of the points
placed so far, wrapped around the tile's edges, is highest (the tightest cluster) or lowest (the largest void).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

__all__ = ["TILE", "blue_noise_tile"]

TILE = 64
"""Edge of the tile in pixels: large enough for its repetition not to be seen, as is usual for dither arrays."""

SIGMA = 1.5
"""Standard deviation of the blur in pixels (Ulichney 1993)."""

START = 0.1
"""Share of points in the first pattern; below one half, else free (Ulichney 1993)."""


@cache
def blue_noise_tile() -> Tensor:
    """Returns the ranks 0 .. 64^2 - 1 of a blue-noise tile, always the same one, int64, shape (64, 64).

    Cost: a third of a second at the first call.

    Example:
        >>> tile = blue_noise_tile()
        >>> torch.equal(tile.flatten().sort().values, torch.arange(64 * 64))
        True
    """
    size = TILE * TILE
    ring = np.minimum(np.arange(TILE), TILE - np.arange(TILE))
    blur = np.exp(-(ring[:, None] ** 2 + ring**2) / (2 * SIGMA**2))
    # Four copies side by side: the blur of a point anywhere is a window of them, wrapped around the edges.
    copies = np.tile(blur, (2, 2))
    points = np.zeros(size, dtype=bool)
    density = np.zeros((TILE, TILE))

    def change(pixel: int, present: bool) -> None:
        points[pixel] = present
        y, x = divmod(pixel, TILE)
        window = copies[TILE - y : 2 * TILE - y, TILE - x : 2 * TILE - x]
        np.add(density, window if present else -window, out=density)

    def tightest_cluster() -> int:
        return int(np.where(points, density.ravel(), -np.inf).argmax())

    def largest_void() -> int:
        return int(np.where(points, np.inf, density.ravel()).argmin())

    first = np.random.default_rng(0).permutation(size)[: int(START * size)]
    for pixel in first:
        change(int(pixel), True)
    while True:  # move points from the tightest cluster to the largest void until that changes nothing
        cluster = tightest_cluster()
        change(cluster, False)
        void = largest_void()
        change(void, True)
        if void == cluster:
            break
    ranks = np.empty(size, dtype=np.int64)
    start, start_density = points.copy(), density.copy()
    for rank in reversed(range(len(first))):
        cluster = tightest_cluster()
        change(cluster, False)
        ranks[cluster] = rank
    points[:], density[:] = start, start_density
    for rank in range(len(first), size):
        void = largest_void()
        change(void, True)
        ranks[void] = rank
    return torch.from_numpy(ranks.reshape(TILE, TILE))
