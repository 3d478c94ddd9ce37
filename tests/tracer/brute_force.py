"""The oracle for rays: every ray against every triangle, in float64, with bounds on what float32 may get wrong.

The tracer's arithmetic is float32, u = 2^-24. Its triangle test (Woop et al. 2013) looks along the ray: with o the
origin, z the axis of the direction's largest component, D = max |v - o| over a triangle's vertices v (largest
components) and L the length of its longest edge,

- a vertex's place beside the ray, x - o_x - s (z - o_z) with |s| <= 1, is off by 7 u D (two roundings for the first
  term, five for the second), and edges seen this way have a length of at most 2 L;
- an edge function is twice the area between ray and edge. Where a ray passes near the triangle it is a difference of
  products of numbers up to 2 L: off by 2 L 7 u D for either end and by 3 u (2 L)^2 for its own roundings. As L is at
  most 4 D, that is less than 64 u D L in all;
- divided by twice the area of the triangle seen along the ray, a = |n d| / |d_z|, n being the cross product of two
  edges, it is the error of a barycentric weight: ``margin`` = 64 u D L / a;
- depth is a weighted mean of the vertices' z - o_z, so t d_z is off by 3 L margin + 8 u D: ``slack`` of t.

A weight above ``margin`` is surely inside and one below ``-margin`` surely outside; between them either answer is
right. ``check`` allows exactly that, and no more.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from fovden.tracer import Hits

UNIT = 2.0**-24
PAIRS_AT_ONCE = 1 << 20


class Pairs(NamedTuple):
    """Every ray against every triangle, shape (rays, triangles)."""

    t: Tensor
    u: Tensor
    v: Tensor
    inside: Tensor  # surely on the triangle, wherever it lies along the line
    outside: Tensor  # surely beside it
    margin: Tensor  # error of u and v
    slack: Tensor  # error of t
    nearest: Tensor  # t of the vertex that is first along the ray's main axis: a bound for t, whatever the margin
    farthest: Tensor


def all_pairs(vertices: Tensor, faces: Tensor, origins: Tensor, directions: Tensor) -> Pairs:
    a, b, c = vertices.double()[faces.long()].unbind(1)
    o, d = origins.double()[:, None], directions.double()[:, None]
    edges = torch.stack([b - a, c - a, c - b])
    normal = torch.linalg.cross(edges[0], edges[1])
    longest = edges.norm(dim=2).amax(0)
    main = d.abs().amax(2)
    facing = (normal * d).sum(2)
    to_a = a - o
    t = (normal * to_a).sum(2) / facing
    moment = torch.linalg.cross(to_a, d.expand_as(to_a))
    u, v = (moment * edges[1]).sum(2) / facing, -(moment * edges[0]).sum(2) / facing
    corners = torch.stack([to_a, b - o, c - o])
    reach = corners.abs().amax((0, 3))
    margin = 64 * UNIT * reach * longest * main / facing.abs()
    slack = (3 * longest * margin + 8 * UNIT * reach) / main
    axis = d.abs().argmax(2)[None, :, :, None].expand(3, -1, len(faces), 1)
    depths = corners.gather(3, axis)[..., 0] / d.gather(2, axis[0, :, :1])[..., 0]
    smallest = torch.minimum(torch.minimum(u, v), 1 - u - v)
    flat = normal.norm(dim=1) <= 1e-14 * longest**2
    inside = (smallest > margin) & ~flat
    outside = (smallest < -margin) | flat
    return Pairs(t, u, v, inside, outside, margin, slack, depths.amin(0), depths.amax(0))


def check(
    mesh: tuple[Tensor, Tensor],
    origins: Tensor,
    directions: Tensor,
    hits: Hits,
    blocked: Tensor | None = None,
    t_max: Tensor | None = None,
) -> float:
    """Asserts that hits, and what is blocked, are right; returns the share of rays that left no room for judgement."""
    vertices, faces = mesh
    count = len(origins)
    t_max = torch.full((count,), torch.inf) if t_max is None else t_max
    clear = 0
    for rays in torch.arange(count).split(max(1, PAIRS_AT_ONCE // len(faces))):
        pairs = all_pairs(vertices, faces, origins[rays], directions[rays])
        limit = t_max[rays].double()[:, None]
        surely = pairs.inside & (pairs.t > pairs.slack) & (pairs.t < limit - pairs.slack)
        never = pairs.outside | (pairs.t < -pairs.slack) | (pairs.t > limit + pairs.slack)
        t, prim = hits.t[rays].double(), hits.prim[rays].long()
        hit = prim >= 0
        assert torch.equal(hit, torch.isfinite(t))
        assert not bool((surely.any(1) & ~hit).any()), "a hit was lost"
        assert bool((t[hit] > 0).all())
        assert bool((hits.t[rays] < t_max[rays])[hit].all())
        assert bool((hits.u[rays] == 0)[~hit].all())
        assert bool((hits.v[rays] == 0)[~hit].all())
        rows = torch.arange(len(rays))[hit]
        own = Pairs(*(field[rows, prim[hit]] for field in pairs))
        assert not bool(never[rows, prim[hit]].any()), "a triangle was hit that the ray misses"
        found = t[hit]
        rounding = 8 * UNIT * torch.maximum(own.nearest.abs(), own.farthest.abs())
        assert bool((found >= own.nearest - rounding).all())
        assert bool((found <= own.farthest + rounding).all())
        known = own.margin < 1  # seen edge-on, t may be that of any point of the triangle
        assert bool(((found - own.t).abs() <= own.slack)[known].all())
        assert bool(((hits.u[rays][hit] - own.u).abs() <= own.margin + 4 * UNIT)[known].all())
        assert bool(((hits.v[rays][hit] - own.v).abs() <= own.margin + 4 * UNIT)[known].all())
        own_slack = torch.where(known, own.slack, own.farthest - own.nearest)
        nearer = surely[rows] & (pairs.t[rows] + pairs.slack[rows] < (found - own_slack)[:, None])
        assert not bool(nearer.any()), "a nearer triangle was passed by"
        if blocked is not None:
            assert not bool((surely.any(1) & ~blocked[rays]).any()), "a blocked ray was let through"
            assert not bool((never.all(1) & blocked[rays]).any()), "a clear ray was stopped"
        clear += int((surely | never).all(1).sum())
    return clear / max(count, 1)
