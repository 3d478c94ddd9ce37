"""Makes nodes of eight children of a binary tree, and writes them and the leaf blocks down.

Which binary nodes become children is chosen so that the surface area heuristic is smallest (Ylitie, Karras and Laine,
"Efficient incoherent ray traversal on GPUs through compressed wide BVHs", 2017): the least cost of representing a
subtree by a forest of at most i wide nodes and leaves follows from those of its two children. Opening the largest child
first, as in Wald, Benthin and Boulos, "Getting rid of packets" (2008), leaves half of the lanes empty.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.tracer.kernels.build import BinaryTree, half_area, widest
from fovden.tracer.kernels.layout import CHILDREN, CUTOUT, MAX_BINARY_DEPTH, ORDERS, PRIMITIVES, UPPER, WIDTH
from fovden.tracer.kernels.splits import MARGIN, UNIT

ZERO, ONE, HALF, INFINITY = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(np.inf)
SMALLEST = np.float32(1e-30)
LEAF_COST = ONE  # relative to a node


@kernel
def least_costs(tree: BinaryTree, costs: Any, shares: Any) -> None:
    """Writes for every binary node the least cost of a forest of at most i + 1 trees, and how it comes about.

    Args:
        tree: The binary tree.
        costs: Receives the costs, shape (n, 8).
        shares: Receives how many of the trees the first child gets, shape (n, 8): 0 if there is one tree fewer; for
            i = 0, of the eight children of the node itself.
    """
    for node in range(len(tree.count) - 1, -1, -1):
        left, area = tree.left[node], half_area(tree.node_boxes[node])
        if tree.count[node] > 0:
            for i in range(WIDTH):
                costs[node, i], shares[node, i] = area * LEAF_COST, 0
        elif left > 0:
            for i in range(1, WIDTH):
                costs[node, i] = np.inf
                for share in range(1, i + 1):
                    cost = costs[left, share - 1] + costs[left + 1, i - share]
                    if cost < costs[node, i] or share == 1:
                        costs[node, i], shares[node, i] = cost, share
            costs[node, 0], shares[node, 0] = area + costs[node, WIDTH - 1], shares[node, WIDTH - 1]
            for i in range(1, WIDTH):
                if costs[node, i - 1] <= costs[node, i]:
                    costs[node, i], shares[node, i] = costs[node, i - 1], 0


@kernel
def surfaces(tree: BinaryTree, vertices: Any, faces: Any, areas: Any) -> None:
    """Writes the area of the triangles below every binary node, shape (n)."""
    for node in range(len(tree.count) - 1, -1, -1):
        if tree.count[node] == 0:
            if tree.left[node] > 0:
                areas[node] = areas[tree.left[node]] + areas[tree.left[node] + 1]
            continue
        total = 0.0
        for i in range(tree.first[node], tree.first[node] + tree.count[node]):
            prim = tree.order[i]
            a, b, c = vertices[faces[prim, 0]], vertices[faces[prim, 1]], vertices[faces[prim, 2]]
            square = 0.0
            for axis in range(3):
                j, k = (axis + 1) % 3, (axis + 2) % 3
                part = np.float64(b[j] - a[j]) * (c[k] - a[k]) - np.float64(b[k] - a[k]) * (c[j] - a[j])
                square += part * part
            total += np.sqrt(square) / 2
        areas[node] = total


@inlined
def rank(tree: BinaryTree, costs: Any, areas: Any, node: Int) -> Float:
    """How likely a ray through the parent is to be stopped by a child, divided by what it costs to ask the child.

    The chance is that of meeting the box, which is as its area, times that of meeting a triangle there, at most 1: the
    triangles' area over half of the box's. The cost is that of the heuristic.
    """
    area = max(half_area(tree.node_boxes[node]), SMALLEST)
    return area * min(np.float32(areas[node]) / area, ONE) / max(costs[node, 0] / area, SMALLEST)


@kernel
def gather_children(tree: BinaryTree, costs: Any, shares: Any, areas: Any, root: Int, stack: Any, children: Any) -> Int:
    """Fills ``children`` with up to eight descendants that together cover a node, by rising rank; returns how many."""
    if tree.count[root] > 0:
        children[0] = root
        return 1
    used, top = 0, 2
    share = np.int64(shares[root, 0])
    stack[0, 0], stack[0, 1], stack[1, 0], stack[1, 1] = tree.left[root] + 1, WIDTH - share, tree.left[root], share
    while top > 0:
        top -= 1
        node, trees = stack[top, 0], stack[top, 1]
        while trees > 1 and shares[node, trees - 1] == 0:
            trees -= 1
        if trees > 1:
            share = np.int64(shares[node, trees - 1])
            stack[top, 0], stack[top, 1] = tree.left[node] + 1, trees - share
            stack[top + 1, 0], stack[top + 1, 1] = tree.left[node], share
            top += 2
            continue
        value, place = rank(tree, costs, areas, node), used
        while place > 0 and rank(tree, costs, areas, children[place - 1]) > value:
            children[place] = children[place - 1]
            place -= 1
        children[place] = node
        used += 1
    return used


@kernel
def collapse(tree: BinaryTree, costs: Any, shares: Any, areas: Any, children_of: Any, codes: Any) -> tuple[Int, Int]:
    """Lists the eight-wide nodes depth first; returns how many nodes and how many leaf blocks there are.

    Args:
        tree: The binary tree.
        costs: See :func:`least_costs`.
        shares: See :func:`least_costs`.
        areas: See :func:`surfaces`.
        children_of: Receives the binary nodes below each wide node, -1 for none, shape (n, 8).
        codes: Receives the child codes, shape (n, 8).
    """
    stack = np.empty((WIDTH * (MAX_BINARY_DEPTH + 64), 3), np.int64)
    small, children = np.empty((4 * WIDTH, 2), np.int64), np.empty(WIDTH, np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, -1, 0
    top, wide, blocks = 1, 0, 0
    while top > 0:
        top -= 1
        root, parent, place = stack[top, 0], stack[top, 1], stack[top, 2]
        if parent >= 0:
            codes[parent, place] = wide
        used = gather_children(tree, costs, shares, areas, root, small, children)
        for lane in range(WIDTH):
            children_of[wide, lane], codes[wide, lane] = -1, 0
        for lane in range(used - 1, -1, -1):
            children_of[wide, lane] = children[lane]
            if tree.count[children[lane]] == 0:
                stack[top, 0], stack[top, 1], stack[top, 2] = children[lane], wide, lane
                top += 1
            else:
                codes[wide, lane] = ~blocks
                blocks += 1
        wide += 1
    return wide, blocks


@inlined
def has_area(vertices: Any, faces: Any, prim: Int) -> bool:
    """Whether corners are not in a line; rounding would give one that is not axis-aligned an area for some rays."""
    a, b, c = vertices[faces[prim, 0]], vertices[faces[prim, 1]], vertices[faces[prim, 2]]
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        left = (np.float64(b[i]) - a[i]) * (np.float64(c[j]) - a[j])
        right = (np.float64(b[j]) - a[j]) * (np.float64(c[i]) - a[i])
        if left != right:
            return True
    return False


@inlined
def pack_orders(nodes: Any, numbers: Any, wide: Int, used: Int) -> None:
    """Writes the order of a node's children for each octant: by the middles of their boxes, the farthest first."""
    lanes, depths = np.empty(WIDTH, np.int64), np.empty(WIDTH, np.float32)
    for octant in range(WIDTH):
        for lane in range(WIDTH):
            depth = -INFINITY  # unused lanes come last
            if lane < used:
                depth = ZERO
                for axis in range(3):
                    middle = HALF * nodes[wide, axis * WIDTH + lane] + HALF * nodes[wide, UPPER + axis * WIDTH + lane]
                    depth += -middle if (octant >> axis) & 1 else middle
            place = lane
            while place > 0 and depths[place - 1] < depth:
                depths[place], lanes[place] = depths[place - 1], lanes[place - 1]
                place -= 1
            depths[place], lanes[place] = depth, lane
        packed = np.int64(0)
        for place in range(WIDTH):
            packed |= lanes[place] << (4 * place)
        numbers[wide, ORDERS + octant] = packed


@kernel
def pack(
    start: Int,
    stop: Int,
    tree: BinaryTree,
    children_of: Any,
    codes: Any,
    vertices: Any,
    faces: Any,
    cutouts: Any,
    nodes: Any,
    numbers: Any,
    blocks: Any,
    prims: Any,
) -> None:
    """Writes the nodes start .. stop - 1 and their leaf blocks as ``layout`` describes them.

    ``numbers`` and ``prims`` are the memory of ``nodes`` and ``blocks`` as int32.
    """
    for wide in range(start, stop):
        used = np.int64(0)
        for lane in range(WIDTH):
            child, code = children_of[wide, lane], codes[wide, lane]
            numbers[wide, CHILDREN + lane] = code
            if child < 0:
                for axis in range(3):
                    nodes[wide, axis * WIDTH + lane], nodes[wide, UPPER + axis * WIDTH + lane] = INFINITY, -INFINITY
                continue
            used += 1
            margin = MARGIN * widest(tree.node_boxes[child])
            for axis in range(3):
                lower, upper = tree.node_boxes[child, axis], tree.node_boxes[child, 3 + axis]
                nodes[wide, axis * WIDTH + lane] = lower - (margin + abs(lower) * UNIT)
                nodes[wide, UPPER + axis * WIDTH + lane] = upper + (margin + abs(upper) * UNIT)
            if code < 0:
                for i in range(WIDTH):
                    held = i < tree.count[child]
                    prim = np.int64(tree.order[tree.first[child] + i]) if held else np.int64(-1)
                    prims[~code, PRIMITIVES + i] = prim + CUTOUT if held and cutouts[prim] else prim
                    solid = held and has_area(vertices, faces, prim)
                    for corner in range(3):
                        for axis in range(3):
                            row = (3 * corner + axis) * WIDTH + i
                            blocks[~code, row] = vertices[faces[prim, corner], axis] if solid else ZERO
        pack_orders(nodes, numbers, wide, used)
