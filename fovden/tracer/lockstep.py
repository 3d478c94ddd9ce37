"""Walks the acceleration structure with tensor operations: all rays take their steps together, on any device.

A hundred times slower than the kernels: for devices that they do not reach, and their oracle. A triangle is tested by
the same operations in the same order, each rounded by itself, and of hits at the same distance the triangle of the
lowest number counts. So hits are equal to the bit, in whatever order nodes are visited. Only ``decoded`` knows what a
node and a leaf look like.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from fovden.tracer.kernels import rays as bounds
from fovden.tracer.kernels.layout import CHILDREN, CUTOUT, PRIMITIVES, UPPER, WIDTH
from fovden.tracer.kernels.surface import CUTOFF, FINISH, LINKS, MATERIAL, OPACITY, RECORD, UV, GeometryArrays

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
    (b, 3, 3, 8): vertex, axis, triangle; ``prims`` are their numbers and ``holes`` whether they may have any, (b, 8).
    """

    lower: Tensor
    upper: Tensor
    children: Tensor
    corners: Tensor
    prims: Tensor
    holes: Tensor


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
        prims & ~CUTOUT,
        (prims >= CUTOUT),
    )


def closest_hits(
    structure: Decoded,
    origins: Tensor,
    directions: Tensor,
    t_max: Tensor,
    *,
    any_hit: bool = False,
    geometry: tuple[Any, ...] | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns t, u, v and the triangle of each ray's first hit in (0, t_max), as the kernels do.

    Args:
        structure: The acceleration structure, on the rays' device.
        origins: Starting points, float32, shape (n, 3).
        directions: Directions, float32, shape (n, 3).
        t_max: Ends of the rays, float32, shape (n).
        any_hit: Whether a ray may stop at whatever it hits first, which need not be the closest.
        geometry: Where to look up holes; ``None`` takes all triangles for solid.

    Returns:
        Four tensors of shape (n); (inf, 0, 0, -1) is a miss, also where a ray is zero or not finite.

    Differentiable: no. Cost: about a hundred times that of the kernels.

    Example:
        >>> from fovden.tracer import make_scene
        >>> structure = decoded(*make_scene("cornell_box").bvh)
        >>> ray = torch.tensor([[2.78, 1.0, -8.0]]), torch.tensor([[0.0, 0.0, 1.0]])
        >>> [round(float(x), 3) for x in closest_hits(structure, *ray, torch.tensor([torch.inf]))]
        [9.103, 0.075, 0.531, 25.0]
    """
    holes = None if geometry is None else _Holes.of(GeometryArrays(*geometry), origins.device)
    parts = []
    for start in range(0, max(1, len(origins)), RAYS_AT_ONCE):
        chosen = slice(start, start + RAYS_AT_ONCE)
        parts.append(_walk(structure, holes, origins[chosen], directions[chosen], t_max[chosen], any_hit))
    t, u, v, prim = (torch.cat(part) for part in zip(*parts, strict=True))
    return t, u, v, prim


class _Holes(NamedTuple):
    """What tells whether a triangle is there, on the rays' device."""

    triangles: Tensor
    finishes: Tensor
    links: Tensor
    texels: Tensor
    images: Tensor

    @classmethod
    def of(cls, arrays: GeometryArrays, device: torch.device) -> _Holes:
        texels = torch.from_numpy(arrays.texels.view("int32")) & 0xFF
        others = (arrays.triangles, arrays.finishes, arrays.links)
        parts = (*map(torch.from_numpy, others), texels, torch.from_numpy(arrays.images))
        return cls(*(part.to(device) for part in parts))


class _Rays(NamedTuple):
    """Rays prepared for boxes and triangles as :func:`fovden.tracer.kernels.rays.prepare` does, a row for each.

    Axes of triangles are in the order (x, y, main).
    """

    near: Tensor  # a bound that is the first of its axis is met at bound * near + near_at
    near_at: Tensor
    far: Tensor
    far_at: Tensor
    axes: Tensor  # numbers of the axes: the direction's largest component comes last
    origin: Tensor  # along these
    shear: Tensor  # direction / largest component along the first two axes, and 1 / largest component


def _prepared(origins: Tensor, directions: Tensor) -> _Rays:
    sizes = directions.abs()
    x_leads = (sizes[:, 0] >= sizes[:, 1]) & (sizes[:, 0] >= sizes[:, 2])
    main = torch.where(x_leads, 0, torch.where(sizes[:, 1] >= sizes[:, 2], 1, 2))
    axes = torch.stack([(main + 1) % 3, (main + 2) % 3, main], 1)
    along = directions.gather(1, axes)
    inverse = 1 / along[:, 2:]
    shear = torch.cat([along[:, :2] * inverse, inverse], 1)
    smallest = float(bounds.SMALLEST) * sizes.amax(1, keepdim=True)
    near = 1 / torch.where(sizes < smallest, torch.copysign(smallest, directions), directions)
    at, greatest, slack = -origins * near, float(bounds.GREATEST), float(bounds.SLACK)
    error = at.abs() * float(bounds.ROUNDING)
    near_at, far_at = ((part).clamp(-greatest, greatest) for part in (at - error, (at + error) * slack))
    return _Rays(near, near_at, near * slack, far_at, axes, origins.gather(1, axes), shear)


def _walk(
    structure: Decoded, holes: _Holes | None, origins: Tensor, directions: Tensor, t_max: Tensor, any_hit: bool
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """All rays from the root to the end of their stacks."""
    length, largest, count = directions.abs().sum(1), directions.abs().amax(1), len(origins)
    live = ((length > 0) & (length + origins.abs().sum(1) < torch.inf)).nonzero()[:, 0]
    long = torch.where(largest > float(bounds.LONG), float(bounds.SHORTENED), 1.0)
    scale = torch.where(largest < float(bounds.SHORT), float(bounds.LENGTHENED), long)
    rays, end = _prepared(origins, directions * scale[:, None]), t_max / scale
    # The greatest number below the end; no distance is within it where the end is not positive or no number.
    best_t = torch.where(end > 0, (end.view(torch.int32) - 1).view(torch.float32), -1.0)
    best_u, best_v = torch.zeros_like(t_max), torch.zeros_like(t_max)
    best_prim = torch.full_like(t_max, -1, dtype=torch.int32)
    stack = torch.zeros(count, FIRST_STACK, dtype=torch.int64, device=origins.device)
    top, code = stack.new_zeros(count), stack.new_zeros(count)
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
        t, u, v, prim = _leaf_hits(structure, holes, rays, at_leaf, ~code[at_leaf], best_t[at_leaf])
        known, limit = best_prim[at_leaf], best_t[at_leaf]
        closer = (t < limit) | ((t == limit) & ((known < 0) | (prim < known)))
        for best, found in ((best_t, t), (best_u, u), (best_v, v), (best_prim, prim)):
            best[at_leaf] = torch.where(closer, found, best[at_leaf])

        code[at_node] = torch.where(number > 0, _child(nearest), SEEKING)
        code[at_leaf] = SEEKING
        seeking = live[code[live] == SEEKING]
        ended = (top[seeking] == 0) | (any_hit & (best_prim[seeking] >= 0))
        top[seeking] -= 1
        key = stack[seeking, top[seeking].clamp_min(0)]
        beyond = best_t[seeking].view(torch.int32).to(torch.int64) + 1 << 32
        code[seeking] = torch.where(key < beyond, _child(key), SEEKING)
        top[seeking[ended]] = -1
        live = live[top[live] >= 0]
    return torch.where(best_prim >= 0, best_t * scale, torch.inf), best_u, best_v, best_prim


def _child(key: Tensor) -> Tensor:
    """The child code in a key's lower half, its sign restored."""
    return key << 32 >> 32


def _box_keys(structure: Decoded, rays: _Rays, chosen: Tensor, node: Tensor, limit: Tensor) -> Tensor:
    """For each child's box the entry distance's bits above the child code, or -1 where the ray misses the box."""
    near, near_at, far, far_at = (part[chosen, :, None] for part in rays[:4])
    lower, upper = structure.lower[node], structure.upper[node]
    first = torch.where(near < 0, upper, lower) * near + near_at
    last = torch.where(near < 0, lower, upper) * far + far_at
    entry, leave = torch.zeros_like(first[:, 0]), limit[:, None].expand(-1, WIDTH)
    for axis in range(3):  # a bound that is NaN, infinity - infinity, is passed over
        entry = torch.where(first[:, axis] > entry, first[:, axis], entry)
        leave = torch.where(last[:, axis] < leave, last[:, axis], leave)
    key = (entry.view(torch.int32).to(torch.int64) << 32) | (structure.children[node] & LOW_HALF)
    return torch.where(entry <= leave, key, -1)


def _leaf_hits(
    structure: Decoded, holes: _Holes | None, rays: _Rays, chosen: Tensor, leaf: Tensor, limit: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The closest hit within each ray's leaf, of equals the one of the lowest number; t is infinite without one."""
    axes = rays.axes[chosen, None, :, None].expand(-1, 3, -1, WIDTH)
    corners = structure.corners[leaf].gather(2, axes) - rays.origin[chosen, None, :, None]
    depth, shear = corners[:, :, 2], rays.shear[chosen, :, None]
    ax, bx, cx = (corners[:, :, 0] - shear[:, None, 0] * depth).unbind(1)
    ay, by, cy = (corners[:, :, 1] - shear[:, None, 1] * depth).unbind(1)
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    determinant = u + v + w
    t = (u * depth[:, 0] + v * depth[:, 1] + w * depth[:, 2]) * shear[:, 2] / determinant
    hit, prim = inside & (t > 0) & (t <= limit[:, None]), structure.prims[leaf]
    u, v = v / determinant, w / determinant
    if holes is not None:
        asked = hit & structure.holes[leaf]
        hit[asked] = _opaque(holes, prim[asked].long(), u[asked], v[asked])
    t = torch.where(hit, t, torch.inf)
    nearest = t == t.amin(1, keepdim=True)
    lane = torch.where(nearest, prim, torch.iinfo(prim.dtype).max).argmin(1, keepdim=True)
    t, u, v, prim = (field.gather(1, lane)[:, 0] for field in (t, u, v, prim))
    return t, u, v, prim


def _opaque(holes: _Holes, prim: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Whether triangles are there, with the roundings of :func:`fovden.tracer.kernels.surface.is_opaque`."""
    triangle, one = holes.triangles.reshape(-1, RECORD)[prim], 1 - u - v
    material = triangle.view(torch.int32)[:, MATERIAL].long()
    image = holes.links.reshape(-1, LINKS)[material, OPACITY].long()
    s, t = (one * triangle[:, k] + u * triangle[:, k + 2] + v * triangle[:, k + 4] for k in (UV, UV + 1))
    first, height, width = holes.images[image].unbind(1)
    x, y = (s - s.floor()) * width - 0.5, (1 - (t - t.floor())) * height - 0.5
    column, row = x.floor(), y.floor()
    x, y, column, row = x - column, y - row, column.long(), row.long()
    rows = []
    for down in range(2):
        begin = first + (row + down) % height * width
        left, right = (holes.texels[begin + (column + along) % width].float() for along in range(2))
        rows.append((1 - x) * left + x * right)
    opacity = torch.tensor(1 / 255) * ((1 - y) * rows[0] + y * rows[1])
    return opacity >= holes.finishes.reshape(-1, FINISH)[material, CUTOFF]
