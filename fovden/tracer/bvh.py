"""The bounding volume hierarchy: built once per geometry, asked for the closest hit of a ray or for any hit.

Eight children a node and eight triangles a leaf, so that one vector operation tests them all; see
:mod:`fovden.tracer.kernels.layout` for how it lies in memory. No ray slips between triangles that share an edge or a
vertex (:mod:`fovden.tracer.kernels.triangles`).
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor

from fovden import parallel
from fovden.checks import require, require_shapes
from fovden.memory import on_large_pages
from fovden.tracer.kernels import build, traversal
from fovden.tracer.kernels.layout import BLOCK_SIZE, NODE_SIZE, WIDTH
from fovden.tracer.lockstep import closest_hits, decoded

__all__ = ["Backend", "Bvh", "Hits", "build_bvh", "intersect", "occluded"]

Backend = Literal["kernels", "torch"]
"""Who traces: compiled code on the CPU, or tensor operations on the rays' device (:mod:`fovden.tracer.lockstep`), a
hundred times slower, with the same result to the bit."""

RAYS_PER_TILE = 4096
TRIANGLES_PER_TILE = 1 << 16


class Bvh(NamedTuple):
    """An acceleration structure: ``nodes`` of shape (k, 64) and leaf ``blocks`` of shape (b, 80), float32."""

    nodes: Tensor
    blocks: Tensor


class Hits(NamedTuple):
    """Where rays meet triangles, all of shape (n).

    ``t`` is the distance in units of the direction's length, infinite for a miss; ``u`` and ``v`` are the barycentric
    weights of the triangle's second and third vertex; ``prim`` is the triangle's number, int32, -1 for a miss.
    """

    t: Tensor
    u: Tensor
    v: Tensor
    prim: Tensor


def build_bvh(vertices: Tensor, faces: Tensor) -> Bvh:
    """Returns the acceleration structure of a triangle mesh.

    Args:
        vertices: Positions, float32, finite, shape (n, 3).
        faces: Vertex numbers, int32, shape (m, 3), m >= 1. Triangles of zero area are kept and never hit.

    Returns:
        The structure.

    Raises:
        ShapeError: If a shape differs.
        ValueError: If there is no triangle.

    Source: binned surface area heuristic of Wald 2007; see ``fovden/tracer/kernels/build.py``.

    Example:
        >>> vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> build_bvh(vertices, torch.tensor([[0, 1, 2]])).blocks.shape
        torch.Size([1, 80])
    """
    require_shapes("n 3", vertices=vertices)
    count = require_shapes("m 3", faces=faces)["m"]
    require(count > 0, "faces", tuple(faces.shape), "at least one triangle")
    corners = vertices.detach().to(torch.float32).contiguous().numpy()
    triangles = faces.to(torch.int32).contiguous().numpy()
    boxes = torch.empty(count, 6).numpy()
    parallel.run(build.triangle_boxes, count, (corners, triangles, boxes), tile=TRIANGLES_PER_TILE)
    order = torch.arange(count, dtype=torch.int32).numpy()
    node_boxes = torch.empty(2 * count, 6).numpy()
    left, first, size = (torch.zeros(2 * count, dtype=torch.int32).numpy() for _ in range(3))
    used = build.build_binary(boxes, order, node_boxes, left, first, size)
    children_of = torch.empty(used, WIDTH, dtype=torch.int32).numpy()
    parents = torch.empty(used, dtype=torch.int64).numpy()
    wide, leaves = build.collapse(node_boxes, left, size, children_of, parents)
    nodes, blocks = torch.zeros(wide, NODE_SIZE), torch.empty(leaves, BLOCK_SIZE)
    arrays = (nodes.numpy(), nodes.view(torch.int32).numpy(), blocks.numpy(), blocks.view(torch.int32).numpy())
    build.pack(node_boxes, first, size, order, children_of, parents, corners, triangles, *arrays)
    return Bvh(on_large_pages(nodes), on_large_pages(blocks))


def intersect(
    bvh: Bvh, origins: Tensor, directions: Tensor, t_max: Tensor | None = None, *, backend: Backend = "kernels"
) -> Hits:
    """Returns the closest hit of each ray with 0 < t < t_max.

    Args:
        bvh: The structure.
        origins: Starting points, shape (n, 3).
        directions: Directions of any length but zero, shape (n, 3).
        t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.
        backend: See :data:`fovden.tracer.bvh.Backend`.

    Returns:
        The hits, on the rays' device. Rays with a zero or non-finite direction or a non-finite origin miss.

    Raises:
        ShapeError: If a shape differs.
        ValueError: If the backend is unknown.

    Differentiable: no; :meth:`fovden.tracer.Scene.intersect` is.

    Example:
        >>> bvh = build_bvh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
        >>> intersect(bvh, torch.tensor([[0.25, 0.25, 2.0]]), torch.tensor([[0.0, 0.0, -1.0]]))
        Hits(t=tensor([2.]), u=tensor([0.2500]), v=tensor([0.2500]), prim=tensor([0], dtype=torch.int32))
    """
    count, rays = _prepare(origins, directions, t_max, backend)
    if backend == "torch":
        return Hits(*closest_hits(decoded(*(part.to(origins.device) for part in bvh)), *rays))
    t, u, v = (torch.empty(count) for _ in range(3))
    hits = Hits(t, u, v, torch.empty(count, dtype=torch.int32))
    arrays = (tensor.numpy() for tensor in (*bvh, *rays, *hits))
    parallel.run(traversal.closest_hits, count, tuple(arrays), tile=RAYS_PER_TILE)
    return Hits(*(field.to(origins.device) for field in hits))


def occluded(
    bvh: Bvh, origins: Tensor, directions: Tensor, t_max: Tensor | None = None, *, backend: Backend = "kernels"
) -> Tensor:
    """Returns whether any triangle lies on each ray with 0 < t < t_max.

    Args:
        bvh: The structure.
        origins: Starting points, shape (n, 3).
        directions: Directions of any length but zero, shape (n, 3).
        t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.
        backend: See :data:`fovden.tracer.bvh.Backend`.

    Returns:
        Booleans of shape (n), on the rays' device.

    Raises:
        ShapeError: If a shape differs.
        ValueError: If the backend is unknown.

    Differentiable: no.

    Example:
        >>> bvh = build_bvh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
        >>> rays = torch.tensor([[0.25, 0.25, 2.0]]), torch.tensor([[0.0, 0.0, -1.0]])
        >>> occluded(bvh, *rays), occluded(bvh, *rays, t_max=torch.tensor([1.0]))
        (tensor([True]), tensor([False]))
    """
    count, rays = _prepare(origins, directions, t_max, backend)
    if backend == "torch":
        structure = decoded(*(part.to(origins.device) for part in bvh))
        return closest_hits(structure, *rays, any_hit=True)[3] >= 0
    blocked = torch.empty(count, dtype=torch.bool)
    arrays = (tensor.numpy() for tensor in (*bvh, *rays, blocked))
    parallel.run(traversal.any_hits, count, tuple(arrays), tile=RAYS_PER_TILE)
    return blocked.to(origins.device)


def _prepare(
    origins: Tensor, directions: Tensor, t_max: Tensor | None, backend: Backend
) -> tuple[int, tuple[Tensor, Tensor, Tensor]]:
    """The number of rays, and the rays as the backend reads them."""
    require(backend in get_args(Backend), "backend", backend, " or ".join(map(repr, get_args(Backend))))
    sizes = require_shapes("n 3", origins=origins, directions=directions)
    if t_max is None:
        t_max = torch.full((sizes["n"],), torch.inf)
    require_shapes("n", sizes, t_max=t_max)
    device = torch.device("cpu") if backend == "kernels" else origins.device
    start, along, end = (
        tensor.detach().to(device, torch.float32).contiguous() for tensor in (origins, directions, t_max)
    )
    return sizes["n"], (start, along, end)
