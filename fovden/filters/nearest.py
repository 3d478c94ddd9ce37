"""Where the nearest sampled pixel lies."""

from __future__ import annotations

import torch
from torch import Tensor

from fovden.checks import require_shapes
from fovden.foveation import Topology

__all__ = ["nearest_sampled"]


def nearest_sampled(mask: Tensor, topology: Topology | None = None) -> Tensor:
    """Returns, for each pixel, the index of the sampled pixel at the least Euclidean distance.

    Exact: the nearest one of each column first, then the least of x^2 + y^2 over the columns, outwards, until no
    farther column can win. Of several at the same distance the one in the nearest column is taken, then the left
    one, then the upper one.

    In a polar raster the distance is that in columns and rows of the raster with its short columns stretched, around
    the circle, but not across the gaze.

    Args:
        mask: Non-zero where sampled, shape (v, 1, h, w).
        topology: The polar raster that the pixels are cells of; ``None`` means the screen.

    Returns:
        Indices y w + x, int64, shape (v, 1, h, w); a pixel's own in a view without any sample.

    Not differentiable. Cost: about twice the greatest distance in passes over the image.

    Example:
        >>> nearest_sampled(torch.tensor([[[[1, 0, 0, 1]]]]))
        tensor([[[[0, 0, 3, 3]]]])
    """
    require_shapes("v 1 h w", mask=mask)
    if topology is not None:
        turns = torch.cat([topology.expand(mask)] * 3, dim=-2)  # the circle once more on either side
        found = nearest_sampled(turns)[..., topology.rows : 2 * topology.rows, :] % (topology.rows * topology.columns)
        return topology.collapse(topology.nearest(found))
    height, width = mask.shape[-2:]
    sampled = mask != 0
    far = 2 * (height + width)
    y = torch.arange(height, device=mask.device)[:, None].expand_as(mask)
    x = torch.arange(width, device=mask.device).expand_as(mask)
    above = torch.where(sampled, y, -far).cummax(dim=-2).values
    below = torch.where(sampled, y, height + far).flip(-2).cummin(dim=-2).values.flip(-2)
    row = torch.where(y - above <= below - y, above, below)
    column_distance = (row - y) ** 2

    best, index = column_distance.clone(), row * width + x
    for dx in range(1, width):
        if int(best.max()) <= dx**2:
            break
        for source, target in (
            ((..., slice(None, -dx)), (..., slice(dx, None))),
            ((..., slice(dx, None)), (..., slice(None, -dx))),
        ):
            distance = column_distance[source] + dx**2
            closer = distance < best[target]
            best[target] = torch.where(closer, distance, best[target])
            index[target] = torch.where(closer, row[source] * width + x[source], index[target])
    empty = ~sampled.flatten(1).any(1)[:, None, None, None]
    return torch.where(empty, y * width + x, index)
