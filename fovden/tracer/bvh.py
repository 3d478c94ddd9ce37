"""The bounding volume hierarchy: built once per geometry, asked for the closest hit of a ray or for any hit.

Eight children a node and eight triangles a leaf, so that one vector operation tests them all; see
:mod:`fovden.tracer.kernels.layout` for how it lies in memory. No ray slips between triangles that share an edge or a
vertex (:mod:`fovden.tracer.kernels.triangles`).
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from fovden import parallel
from fovden.checks import require, require_shapes
from fovden.memory import zeros_on_large_pages
from fovden.tracer.kernels import build, collapse, refit, splits, streams
from fovden.tracer.kernels.build import SMALLEST_SUBTREE, STACK_ROWS, SUBTREES, UPPER_NODES, BinaryTree
from fovden.tracer.kernels.layout import BLOCK_SIZE, CUTOUT, NODE_SIZE, WIDTH
from fovden.tracer.kernels.surface import FINISH, LINKS, RECORD, GeometryArrays
from fovden.tracer.lockstep import closest_hits, decoded

__all__ = ["Backend", "Bvh", "Hits", "Tree", "build_bvh", "build_tree", "intersect", "occluded", "refit_bvh"]

Backend = Literal["kernels", "torch"]
"""Who traces: compiled code on the CPU, or tensor operations on the rays' device (:mod:`fovden.tracer.lockstep`), a
hundred times slower, with the same result to the bit."""

RAYS_PER_TILE = 4096
TRIANGLES_PER_TILE = 1 << 16
NODES_PER_TILE = 1 << 12
BOXES_PER_CALL = 1 << 22  # of the upper nodes, between two of which a Ctrl-C arrives: some tenths of a second
DEARER = 1.1  # times the expected cost of rays: from there on a tree is built anew for triangles that have moved
CUTS = 0.2
"""Pieces of large triangles that are added to the boxes of a mesh, in parts of the triangles. Of 0.1 to 1 it gave the
fewest nodes and leaves a ray for its memory."""


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


def build_bvh(vertices: Tensor, faces: Tensor, cutouts: Tensor | None = None) -> Bvh:
    """Returns the acceleration structure of a triangle mesh.

    Args:
        vertices: Positions, float32, finite, shape (n, 3).
        faces: Vertex numbers, int32, shape (m, 3), 1 <= m < 2^30. Triangles of zero area are kept and never hit.
        cutouts: Which triangles may have holes, booleans of shape (m); ``None`` for none.

    Returns:
        The structure. It does not depend on the number of threads.

    Raises:
        ShapeError: If a shape differs.
        ValueError: If there is no triangle.

    Source: binned surface area heuristic of Wald 2007; see ``fovden/tracer/kernels/build.py``, and ``splits.py`` and
    ``collapse.py`` beside it.

    Example:
        >>> vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> build_bvh(vertices, torch.tensor([[0, 1, 2]])).blocks.shape
        torch.Size([1, 80])
    """
    return _packed(build_tree(vertices, faces), vertices, faces, cutouts)


class Tree(NamedTuple):
    """Which triangles lie together, apart from where they are: what is kept to fit a structure to moved triangles.

    The binary tree of ``fovden/tracer/kernels/build.py``; for each node of eight children those and their codes, see
    ``collapse.py`` beside it; the number of leaf blocks; and the vertices for which it was built.
    """

    binary: Any
    children: Any
    codes: Any
    blocks: int
    vertices: Tensor


def build_tree(vertices: Tensor, faces: Tensor) -> Tree:
    """Returns the tree of a triangle mesh: what takes most of the time of :func:`fovden.tracer.build_bvh`.

    Args:
        vertices: Positions, float32, finite, shape (n, 3).
        faces: Vertex numbers, int32, shape (m, 3), 1 <= m < 2^30.

    Returns:
        The tree.

    Raises:
        ShapeError: If a shape differs.
        ValueError: If there is no triangle.

    Example:
        >>> vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> build_tree(vertices, torch.tensor([[0, 1, 2]])).blocks
        1
    """
    require_shapes("n 3", vertices=vertices)
    count = require_shapes("m 3", faces=faces)["m"]
    require(0 < count < CUTOUT, "faces", tuple(faces.shape), "at least one triangle, and less than 2^30")
    corners, triangles = _mesh_arrays(vertices, faces)
    tree = _binary_tree(*_pieces(corners, triangles))
    node_count = len(tree.count)
    costs, shares = np.empty((node_count, WIDTH), np.float32), np.empty((node_count, WIDTH), np.int8)
    areas = np.empty(node_count)
    collapse.least_costs(tree, costs, shares)
    collapse.surfaces(tree, corners, triangles, areas)
    most = int((tree.left > 0).sum()) + 1
    children, codes = np.empty((most, WIDTH), np.int32), np.empty((most, WIDTH), np.int32)
    wide, blocks = collapse.collapse(tree, costs, shares, areas, children, codes)
    return Tree(tree, children[:wide], codes[:wide], blocks, vertices.detach())


def refit_bvh(tree: Tree, vertices: Tensor, faces: Tensor, cutouts: Tensor | None = None) -> Bvh:
    """Returns the acceleration structure of triangles that have moved since their tree was built.

    The tree stays and its boxes are fitted to the triangles anew, unless that makes rays dearer: where the surface area
    heuristic of the whole tree rises by more than a tenth, the tree is built anew. Hits are the same either way.

    Args:
        tree: The tree of the same triangles in other places.
        vertices: Positions, float32, finite, shape (n, 3).
        faces: Vertex numbers, int32, shape (m, 3).
        cutouts: Which triangles may have holes, booleans of shape (m); ``None`` for none.

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
    boxes = np.empty((len(faces), 6), np.float32)
    parallel.run(build.triangle_boxes, len(boxes), (*_mesh_arrays(vertices, faces), boxes), tile=TRIANGLES_PER_TILE)
    moved = (vertices.detach() != tree.vertices).any(1)[faces.long()].any(1).numpy()
    before, node_boxes = tree.binary.node_boxes, np.empty_like(tree.binary.node_boxes)
    fitted = tree.binary._replace(node_boxes=node_boxes)
    refit.refit(fitted, boxes, moved)
    if not refit.cost_of(fitted, node_boxes) <= DEARER * refit.cost_of(fitted, before):
        return build_bvh(vertices, faces, cutouts)
    return _packed(tree._replace(binary=fitted), vertices, faces, cutouts)


def _mesh_arrays(vertices: Tensor, faces: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """The mesh as the kernels read it."""
    return vertices.detach().to(torch.float32).contiguous().numpy(), faces.to(torch.int32).contiguous().numpy()


def _packed(tree: Tree, vertices: Tensor, faces: Tensor, cutouts: Tensor | None) -> Bvh:
    """Nodes and leaf blocks as rays read them."""
    cutouts = torch.zeros(len(faces), dtype=torch.bool) if cutouts is None else cutouts
    require_shapes("m", {"m": len(faces)}, cutouts=cutouts)
    nodes, blocks = zeros_on_large_pages(len(tree.codes), NODE_SIZE), zeros_on_large_pages(tree.blocks, BLOCK_SIZE)
    mesh, holes = _mesh_arrays(vertices, faces), cutouts.to(torch.bool).contiguous().numpy()
    memory = [part for whole in (nodes, blocks) for part in (whole.numpy(), whole.view(torch.int32).numpy())]
    arguments = (tree.binary, tree.children, tree.codes, *mesh, holes, *memory)
    parallel.run(collapse.pack, len(tree.codes), arguments, tile=NODES_PER_TILE)
    return Bvh(nodes, blocks)


def _pieces(corners: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of the triangles and of the pieces of large ones, (k, 6), and whose they are, (k)."""
    count = len(triangles)
    boxes, priority = np.empty((count, 6), np.float32), np.empty(count, np.float32)
    parallel.run(build.triangle_boxes, count, (corners, triangles, boxes), tile=TRIANGLES_PER_TILE)
    parallel.run(splits.priorities, count, (corners, triangles, boxes, priority), tile=TRIANGLES_PER_TILE)
    cuts = _cuts(priority, int(CUTS * count))
    ends = np.cumsum(cuts + 1)
    pieces, owners = np.empty((ends[-1], 6), np.float32), np.empty(ends[-1], np.int32)
    parallel.run(splits.cut, count, (corners, triangles, boxes, ends, pieces, owners), tile=TRIANGLES_PER_TILE)
    return pieces, owners


def _cuts(priority: np.ndarray, total: int) -> np.ndarray:
    """How often to cut each triangle: in proportion to its priority, about ``total`` times in all and not more."""
    scale, low, high = np.float32(0.0), 0.0, splits.MOST_CUTS / max(float(priority.max()), 1e-30)
    cuts = np.zeros(len(priority), np.int64)
    for _ in range(12):  # a bisection: the sum rises with the scale
        scale = np.float32((low + high) / 2)
        tried = np.minimum(priority * scale, np.float32(splits.MOST_CUTS)).astype(np.int64)
        if tried.sum() <= total:
            cuts, low = tried, float(scale)
        else:
            high = float(scale)
    return cuts


def _binary_tree(pieces: np.ndarray, owners: np.ndarray) -> BinaryTree:
    """The binary tree over boxes, which it sorts."""
    count = len(pieces)
    size = UPPER_NODES + 2 * count
    left, first, length = (np.zeros(size, np.int32) for _ in range(3))
    tree = BinaryTree(pieces, owners, np.empty((size, 6), np.float32), left, first, length)
    stack, subtrees = np.zeros((STACK_ROWS, 4), np.int64), np.empty((UPPER_NODES, 4), np.int64)
    stack[0, 2] = count
    state = np.array([1, 1, 0])
    while state[0] > 0:
        build.build_upper(tree, stack, subtrees, state, max(count // SUBTREES, SMALLEST_SUBTREE), BOXES_PER_CALL)
    parallel.run(build.build_subtrees, int(state[2]), (tree, subtrees), tile=1)
    return tree


def _no_geometry() -> GeometryArrays:
    """What the kernels get in place of a scene's arrays where no triangle has a hole."""
    return GeometryArrays(
        np.zeros((1, RECORD), np.float32),
        np.zeros((1, FINISH), np.float32),
        np.zeros((1, LINKS), np.int32),
        np.zeros(1, np.uint32),
        np.zeros((1, 3), np.int64),
        np.zeros(1, np.float32),
    )


def intersect(
    bvh: Bvh,
    origins: Tensor,
    directions: Tensor,
    t_max: Tensor | None = None,
    geometry: tuple[Any, ...] | None = None,
    *,
    backend: Backend = "kernels",
) -> Hits:
    """Returns the closest hit of each ray with 0 < t < t_max.

    Args:
        bvh: The structure.
        origins: Starting points, shape (n, 3).
        directions: Directions of any length but zero, shape (n, 3).
        t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.
        geometry: Where the kernels look up holes, see ``fovden/tracer/arrays.py``; ``None`` takes all for solid.
        backend: See :data:`fovden.tracer.bvh.Backend`.

    Returns:
        The hits, on the rays' device. Of triangles at the same distance it is the one of the lowest number. Rays with a
        zero or non-finite direction or a non-finite origin miss.

    Raises:
        ShapeError: If a shape differs.
        ValueError: If the backend is unknown.

    Differentiable: no; :meth:`fovden.tracer.Scene.intersect` is.

    Example:
        >>> bvh = build_bvh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
        >>> intersect(bvh, torch.tensor([[0.25, 0.25, 2.0]]), torch.tensor([[0.0, 0.0, -1.0]]))
        Hits(t=tensor([2.]), u=tensor([0.2500]), v=tensor([0.2500]), prim=tensor([0], dtype=torch.int32))
    """
    rays = _prepare(origins, directions, t_max, backend)
    if backend == "torch":
        return Hits(*closest_hits(decoded(*(part.to(origins.device) for part in bvh)), *rays, geometry=geometry))
    count = len(rays[2])
    hits = Hits(torch.empty(count), torch.empty(count), torch.empty(count), torch.empty(count, dtype=torch.int32))
    arrays = (tensor.numpy() for tensor in (*rays, *hits))
    parallel.run(streams.closest_hits, count, (*_arrays(bvh, geometry), *arrays), tile=RAYS_PER_TILE)
    return Hits(*(field.to(origins.device) for field in hits))


def occluded(
    bvh: Bvh,
    origins: Tensor,
    directions: Tensor,
    t_max: Tensor | None = None,
    geometry: tuple[Any, ...] | None = None,
    *,
    backend: Backend = "kernels",
) -> Tensor:
    """Returns whether any triangle lies on each ray with 0 < t < t_max.

    Args:
        bvh: The structure.
        origins: Starting points, shape (n, 3).
        directions: Directions of any length but zero, shape (n, 3).
        t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.
        geometry: Where the kernels look up holes, see ``fovden/tracer/arrays.py``; ``None`` takes all for solid.
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
    rays = _prepare(origins, directions, t_max, backend)
    if backend == "torch":
        structure = decoded(*(part.to(origins.device) for part in bvh))
        return closest_hits(structure, *rays, any_hit=True, geometry=geometry)[3] >= 0
    hit = torch.empty(len(rays[2]), dtype=torch.bool)
    arrays = (tensor.numpy() for tensor in (*rays, hit))
    parallel.run(streams.any_hits, len(hit), (*_arrays(bvh, geometry), *arrays), tile=RAYS_PER_TILE)
    return hit.to(origins.device)


def _arrays(bvh: Bvh, geometry: tuple[Any, ...] | None) -> tuple[object, ...]:
    """Nodes, blocks, geometry, and whether to ask it for holes."""
    return bvh.nodes.numpy(), bvh.blocks.numpy(), geometry or _no_geometry(), geometry is not None


def _prepare(
    origins: Tensor, directions: Tensor, t_max: Tensor | None, backend: Backend
) -> tuple[Tensor, Tensor, Tensor]:
    """The rays as the backend reads them."""
    require(backend in get_args(Backend), "backend", backend, " or ".join(map(repr, get_args(Backend))))
    sizes = require_shapes("n 3", origins=origins, directions=directions)
    if t_max is None:
        t_max = torch.full((sizes["n"],), torch.inf)
    require_shapes("n", sizes, t_max=t_max)
    device = torch.device("cpu") if backend == "kernels" else origins.device
    start, along, end = (
        tensor.detach().to(device, torch.float32).contiguous() for tensor in (origins, directions, t_max)
    )
    return start, along, end
