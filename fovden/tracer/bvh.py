"""The bounding volume hierarchy: built once per geometry, asked for the closest hit of a ray or for any hit.

Eight children a node and eight triangles a leaf, so that one vector operation tests them all; see
:mod:`fovden.tracer.kernels.layout` for how it lies in memory. No ray slips between triangles that share an edge or a
vertex (:mod:`fovden.tracer.kernels.triangles`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from fovden import parallel
from fovden.checks import require, require_shapes
from fovden.memory import on_large_pages
from fovden.tracer.kernels import build, refit, traversal
from fovden.tracer.kernels.layout import BLOCK_SIZE, NODE_SIZE, WIDTH

__all__ = ["Bvh", "Hits", "Tree", "build_bvh", "build_tree", "intersect", "occluded", "refit_bvh"]

RAYS_PER_TILE = 4096
TRIANGLES_PER_TILE = 1 << 16
DEARER = 1.1  # times the expected cost of rays: from there on a tree is built anew for triangles that have moved


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
    return _packed(build_tree(vertices, faces), vertices, faces)


class Tree(NamedTuple):
    """Which triangles lie together, apart from where they are: what is kept to fit a structure to moved triangles.

    NumPy arrays; see ``fovden/tracer/kernels/build.py`` for all but the number of leaf blocks.
    """

    node_boxes: Any
    left: Any
    first: Any
    count: Any
    order: Any
    children_of: Any
    parents: Any
    blocks: int


def build_tree(vertices: Tensor, faces: Tensor) -> Tree:
    """Returns the tree of a triangle mesh: what takes most of the time of :func:`fovden.tracer.build_bvh`.

    Args:
        vertices: Positions, float32, finite, shape (n, 3).
        faces: Vertex numbers, int32, shape (m, 3), m >= 1.

    Returns:
        The tree.

    Example:
        >>> vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> build_tree(vertices, torch.tensor([[0, 1, 2]])).order
        array([0], dtype=int32)
    """
    boxes = _triangle_boxes(vertices, faces)
    order = torch.arange(len(boxes), dtype=torch.int32).numpy()
    node_boxes = torch.empty(2 * len(boxes), 6).numpy()
    left, first, count = (torch.zeros(2 * len(boxes), dtype=torch.int32).numpy() for _ in range(3))
    used = build.build_binary(boxes, order, node_boxes, left, first, count)
    node_boxes, left, first, count = (each[:used].copy() for each in (node_boxes, left, first, count))
    children_of = torch.empty(used, WIDTH, dtype=torch.int32).numpy()
    parents = torch.empty(used, dtype=torch.int64).numpy()
    wide, blocks = build.collapse(node_boxes, left, count, children_of, parents)
    return Tree(node_boxes, left, first, count, order, children_of[:wide].copy(), parents[:wide].copy(), blocks)


def refit_bvh(tree: Tree, vertices: Tensor, faces: Tensor) -> Bvh:
    """Returns the acceleration structure of triangles that have moved since their tree was built.

    The tree stays and its boxes are fitted to the triangles anew, unless that makes rays dearer: where the surface area
    heuristic of the whole tree rises by more than a tenth, the tree is built anew. Hits are the same either way.

    Args:
        tree: The tree of the same triangles in other places.
        vertices: Positions, float32, finite, shape (n, 3).
        faces: Vertex numbers, int32, shape (m, 3).

    Returns:
        The structure: a function of the arguments, to the bit.

    Source: Lauterbach et al., "RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs" (2006), which builds
    anew where a measure of the tree's quality falls; the measure is ours.

    Example:
        >>> vertices, faces = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]])
        >>> moved = refit_bvh(build_tree(vertices, faces), vertices + 5, faces)
        >>> intersect(moved, torch.tensor([[5.25, 5.25, 0.0]]), torch.tensor([[0.0, 0.0, 1.0]])).t
        tensor([5.])
    """
    used = len(tree.node_boxes)
    node_boxes = torch.empty(used, 6).numpy()
    boxes = _triangle_boxes(vertices, faces)
    refit.refit(boxes, tree.order, node_boxes, tree.left, tree.first, tree.count, used)
    before, after = (refit.cost_of(each, tree.count, used) for each in (tree.node_boxes, node_boxes))
    if not after <= DEARER * before:
        return build_bvh(vertices, faces)
    return _packed(tree._replace(node_boxes=node_boxes), vertices, faces)


def _triangle_boxes(vertices: Tensor, faces: Tensor) -> Any:
    """The triangles' bounds, shape (m, 6)."""
    boxes = torch.empty(len(faces), 6).numpy()
    arguments = (*_mesh_arrays(vertices, faces), boxes)
    parallel.run(build.triangle_boxes, len(boxes), arguments, tile=TRIANGLES_PER_TILE)
    return boxes


def _mesh_arrays(vertices: Tensor, faces: Tensor) -> tuple[Any, Any]:
    """The mesh as the kernels read it."""
    return vertices.detach().to(torch.float32).contiguous().numpy(), faces.to(torch.int32).contiguous().numpy()


def _packed(tree: Tree, vertices: Tensor, faces: Tensor) -> Bvh:
    """Nodes and leaf blocks as rays read them."""
    nodes, blocks = torch.zeros(len(tree.parents), NODE_SIZE), torch.empty(tree.blocks, BLOCK_SIZE)
    arrays = (nodes.numpy(), nodes.view(torch.int32).numpy(), blocks.numpy(), blocks.view(torch.int32).numpy())
    branches = (tree.node_boxes, tree.first, tree.count, tree.order, tree.children_of, tree.parents)
    build.pack(*branches, *_mesh_arrays(vertices, faces), *arrays)
    return Bvh(on_large_pages(nodes), on_large_pages(blocks))


def intersect(bvh: Bvh, origins: Tensor, directions: Tensor, t_max: Tensor | None = None) -> Hits:
    """Returns the closest hit of each ray with 0 < t < t_max.

    Args:
        bvh: The structure.
        origins: Starting points, shape (n, 3).
        directions: Directions of any length but zero, shape (n, 3).
        t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.

    Returns:
        The hits. Rays with a zero or non-finite direction or a non-finite origin miss.

    Raises:
        ShapeError: If a shape differs.

    Differentiable: no.

    Example:
        >>> bvh = build_bvh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
        >>> intersect(bvh, torch.tensor([[0.25, 0.25, 2.0]]), torch.tensor([[0.0, 0.0, -1.0]]))
        Hits(t=tensor([2.]), u=tensor([0.2500]), v=tensor([0.2500]), prim=tensor([0], dtype=torch.int32))
    """
    count, rays = _prepare(origins, directions, t_max)
    t, u, v = torch.empty(3, count)
    hits = Hits(t, u, v, torch.empty(count, dtype=torch.int32))
    arguments = (bvh.nodes.numpy(), bvh.blocks.numpy(), *rays, *(field.numpy() for field in hits))
    parallel.run(traversal.closest_hits, count, arguments, tile=RAYS_PER_TILE)
    return hits


def occluded(bvh: Bvh, origins: Tensor, directions: Tensor, t_max: Tensor | None = None) -> Tensor:
    """Returns whether any triangle lies on each ray with 0 < t < t_max.

    Args:
        bvh: The structure.
        origins: Starting points, shape (n, 3).
        directions: Directions of any length but zero, shape (n, 3).
        t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.

    Returns:
        Booleans of shape (n).

    Raises:
        ShapeError: If a shape differs.

    Differentiable: no.

    Example:
        >>> bvh = build_bvh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
        >>> rays = torch.tensor([[0.25, 0.25, 2.0]]), torch.tensor([[0.0, 0.0, -1.0]])
        >>> occluded(bvh, *rays), occluded(bvh, *rays, t_max=torch.tensor([1.0]))
        (tensor([True]), tensor([False]))
    """
    count, rays = _prepare(origins, directions, t_max)
    blocked = torch.empty(count, dtype=torch.bool)
    parallel.run(
        traversal.any_hits, count, (bvh.nodes.numpy(), bvh.blocks.numpy(), *rays, blocked.numpy()), tile=RAYS_PER_TILE
    )
    return blocked


def _prepare(origins: Tensor, directions: Tensor, t_max: Tensor | None) -> tuple[int, tuple[object, ...]]:
    """The number of rays and their arrays as the kernels read them."""
    sizes = require_shapes("n 3", origins=origins, directions=directions)
    if t_max is None:
        t_max = torch.full((sizes["n"],), torch.inf)
    require_shapes("n", sizes, t_max=t_max)
    tensors = (tensor.detach().to("cpu", torch.float32).contiguous() for tensor in (origins, directions, t_max))
    return sizes["n"], tuple(tensor.numpy() for tensor in tensors)
