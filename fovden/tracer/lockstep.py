"""Walks the acceleration structure with tensor operations: all rays take their steps together, on any device.

The same tests in the same order as the compiled kernels, one tensor operation each, so that every number is rounded
where the kernels round it and the hits are equal to the bit. A hundred times slower and free of compiled code: the way
without Numba, and the kernels' oracle. Only ``decoded`` knows what a node and a leaf look like.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from fovden.tracer.kernels.boxes import FAR_SLACK
from fovden.tracer.kernels.layout import CHILDREN, PRIMITIVES, UPPER, WIDTH

__all__ = ["Decoded", "closest_hits", "decoded"]

RAYS_AT_ONCE = 1 << 15
"""Rays that walk together: ours, so that what a step touches stays within some tens of megabytes."""

FIRST_STACK = 32
"""Entries of each ray's stack to begin with; it is doubled where a ray needs more."""

SEEKING = -(1 << 40)
"""In place of a child's code: the ray takes its next one from its stack."""

LOW_HALF = 0xFFFFFFFF


class Decoded(NamedTuple):
    """An acceleration structure in plain numbers.

    ``lower`` and ``upper`` bounds of k nodes' eight children have the shape (k, 3, 8) and ``children`` (k, 8): a code
    >= 0 is a node, a negative one is the leaf ``~code``. The ``corners`` of b leaves' eight triangles have the shape
    (b, 3, 3, 8): vertex, axis, triangle; ``prims`` are their numbers, (b, 8).
    """

    lower: Tensor
    upper: Tensor
    children: Tensor
    corners: Tensor
    prims: Tensor


def decoded(nodes: Tensor, blocks: Tensor) -> Decoded:
    """Returns what the nodes and leaf blocks of a :class:`fovden.tracer.Bvh` hold, without copying the bounds.

    Args:
        nodes: The nodes, as :mod:`fovden.tracer.kernels.layout` describes them.
        blocks: The leaf blocks.

    Returns:
        The same in plain numbers.

    Example:
        >>> from fovden.tracer import make_scene
        >>> structure = decoded(*make_scene("cornell_box").bvh)
        >>> structure.corners.shape[1:], int(structure.prims.max())
        (torch.Size([3, 3, 8]), 37)
    """
    children = nodes.view(torch.int32)[:, CHILDREN : CHILDREN + WIDTH]
    prims = blocks.view(torch.int32)[:, PRIMITIVES : PRIMITIVES + WIDTH]
    return Decoded(
        nodes[:, :UPPER].reshape(-1, 3, WIDTH),
        nodes[:, UPPER:CHILDREN].reshape(-1, 3, WIDTH),
        children.to(torch.int64),
        blocks[:, :PRIMITIVES].reshape(-1, 3, 3, WIDTH),
        prims,
    )


def closest_hits(
    structure: Decoded, origins: Tensor, directions: Tensor, t_max: Tensor, *, any_hit: bool = False
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns t, u, v and the triangle of each ray's first hit in (0, t_max), as the kernels do.

    Args:
        structure: The acceleration structure, on the rays' device.
        origins: Starting points, float32, shape (n, 3).
        directions: Directions, float32, shape (n, 3).
        t_max: Ends of the rays, float32, shape (n).
        any_hit: Whether a ray may stop at whatever it hits first, which need not be the closest.

    Returns:
        Four tensors of shape (n); (inf, 0, 0, -1) is a miss, also where a ray is zero or not finite.

    Differentiable: no. Cost: about a hundred times that of the kernels.

    Example:
        >>> from fovden.tracer import make_scene
        >>> structure = decoded(*make_scene("cornell_box").bvh)
        >>> ray = torch.tensor([[2.78, 1.0, -8.0]]), torch.tensor([[0.0, 0.0, 1.0]])
        >>> [round(float(x), 3) for x in closest_hits(structure, *ray, torch.tensor([torch.inf]))]
        [10.98, 0.418, 0.0, 26.0]
    """
    parts = []
    for start in range(0, max(1, len(origins)), RAYS_AT_ONCE):
        chosen = slice(start, start + RAYS_AT_ONCE)
        parts.append(_walk(structure, origins[chosen], directions[chosen], t_max[chosen], any_hit))
    t, u, v, prim = (torch.cat(part) for part in zip(*parts, strict=True))
    return t, u, v, prim


class _Rays(NamedTuple):
    """Rays prepared for boxes and triangles, every field with one row a ray; axes are in the order (x, y, main)."""

    origin: Tensor
    inverse: Tensor
    axes: Tensor  # numbers of the axes: the direction's largest component comes last
    sheared_origin: Tensor
    shear: Tensor  # direction / largest component along the first two axes, and 1 / largest component


def _prepared(origins: Tensor, directions: Tensor) -> _Rays:
    sizes = directions.abs()
    x_leads = (sizes[:, 0] >= sizes[:, 1]) & (sizes[:, 0] >= sizes[:, 2])
    main = torch.where(x_leads, 0, torch.where(sizes[:, 1] >= sizes[:, 2], 1, 2))
    axes = torch.stack([(main + 1) % 3, (main + 2) % 3, main], 1)
    along = directions.gather(1, axes)
    inverse = 1 / along[:, 2:]
    shear = torch.cat([along[:, :2] * inverse, inverse], 1)
    return _Rays(origins, 1 / directions, axes, origins.gather(1, axes), shear)


def _walk(
    structure: Decoded, origins: Tensor, directions: Tensor, t_max: Tensor, any_hit: bool
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """All rays from the root to the end of their stacks."""
    rays, count = _prepared(origins, directions), len(origins)
    best_t, best_u, best_v = t_max.clone(), torch.zeros_like(t_max), torch.zeros_like(t_max)
    best_prim = torch.full_like(t_max, -1, dtype=torch.int32)
    stack = torch.zeros(count, FIRST_STACK, dtype=torch.int64, device=origins.device)
    top, code = stack.new_zeros(count), stack.new_zeros(count)
    length = directions.abs().sum(1)
    live = ((length > 0) & (length + origins.abs().sum(1) < torch.inf)).nonzero()[:, 0]
    while len(live) > 0:
        at_node = live[code[live] >= 0]
        keys = _box_keys(structure, rays, at_node, code[at_node], best_t[at_node])
        keys = keys.sort(dim=1, descending=True).values  # the nearest hit is the last that is not negative
        number = (keys >= 0).sum(1)
        if int(top.max()) + WIDTH > stack.shape[1]:
            stack = torch.cat([stack, torch.zeros_like(stack)], 1)
        # Whole rows are written: what lies above the top of a stack has no meaning.
        places = top[at_node, None] + torch.arange(WIDTH, device=keys.device)
        stack[at_node[:, None], places] = keys
        nearest = keys.gather(1, (number - 1).clamp_min(0)[:, None])[:, 0]
        top[at_node] += (number - 1).clamp_min(0)

        at_leaf = live[(code[live] < 0) & (code[live] != SEEKING)]
        t, u, v, prim = _leaf_hits(structure, rays, at_leaf, ~code[at_leaf], best_t[at_leaf])
        closer = t < best_t[at_leaf]
        for best, found in ((best_t, t), (best_u, u), (best_v, v), (best_prim, prim)):
            best[at_leaf] = torch.where(closer, found, best[at_leaf])

        code[at_node] = torch.where(number > 0, _child(nearest), SEEKING)
        code[at_leaf] = SEEKING
        seeking = live[code[live] == SEEKING]
        ended = (top[seeking] == 0) | (any_hit & (best_prim[seeking] >= 0))
        top[seeking] -= 1
        key = stack[seeking, top[seeking].clamp_min(0)]
        limit = best_t[seeking].view(torch.int32).to(torch.int64) << 32
        code[seeking] = torch.where(key < limit, _child(key), SEEKING)
        top[seeking[ended]] = -1
        live = live[top[live] >= 0]
    return torch.where(best_prim >= 0, best_t, torch.inf), best_u, best_v, best_prim


def _child(key: Tensor) -> Tensor:
    """The child code in a key's lower half, its sign restored."""
    return key << 32 >> 32


def _box_keys(structure: Decoded, rays: _Rays, chosen: Tensor, node: Tensor, t_max: Tensor) -> Tensor:
    """For each child's box the entry distance's bits above the child code, or -1 where the ray misses the box."""
    origin, inverse = rays.origin[chosen, :, None], rays.inverse[chosen, :, None]
    lower, upper = structure.lower[node], structure.upper[node]
    first = (torch.where(inverse < 0, upper, lower) - origin) * inverse
    last = (torch.where(inverse < 0, lower, upper) - origin) * inverse
    entry, leave = torch.zeros_like(first[:, 0]), torch.full_like(first[:, 0], torch.inf)
    for axis in range(3):  # a bound that is NaN, 0 * infinity, is passed over
        entry = torch.where(first[:, axis] > entry, first[:, axis], entry)
        leave = torch.where(last[:, axis] < leave, last[:, axis], leave)
    leave = leave * FAR_SLACK
    leave = torch.where(leave < t_max[:, None], leave, t_max[:, None])
    key = (entry.view(torch.int32).to(torch.int64) << 32) | (structure.children[node] & LOW_HALF)
    return torch.where(entry <= leave, key, -1)


def _leaf_hits(
    structure: Decoded, rays: _Rays, chosen: Tensor, leaf: Tensor, t_max: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The closest hit within each ray's leaf; t is infinite without one."""
    axes = rays.axes[chosen, None, :, None].expand(-1, 3, -1, WIDTH)
    corners = structure.corners[leaf].gather(2, axes) - rays.sheared_origin[chosen, None, :, None]
    depth, shear = corners[:, :, 2], rays.shear[chosen, :, None]
    ax, bx, cx = (corners[:, :, 0] - shear[:, None, 0] * depth).unbind(1)
    ay, by, cy = (corners[:, :, 1] - shear[:, None, 1] * depth).unbind(1)
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    determinant = u + v + w
    t = (u * depth[:, 0] + v * depth[:, 1] + w * depth[:, 2]) * shear[:, 2] / determinant
    t = torch.where(inside & (t > 0) & (t < t_max[:, None]), t, torch.inf)
    lane = t.argmin(1, keepdim=True)  # the first of equals
    hits = (t, v / determinant, w / determinant, structure.prims[leaf])
    t, u, v, prim = (field.gather(1, lane)[:, 0] for field in hits)
    return t, u, v, prim
