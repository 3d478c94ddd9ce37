"""Builds a binary tree over boxes by the surface area heuristic; ``collapse`` makes nodes of eight children of it.

The heuristic is evaluated in 16 bins of the centroids along each axis (Wald, "On fast construction of SAH-based
bounding volume hierarchies", 2007). It counts leaf blocks of eight triangles, not triangles, because a block costs
the same however full it is; the blocks come out about 90 % full.

The upper nodes are built one after the other; what hangs below them, the subtrees, by all threads. Each subtree has a
range of the nodes' numbers to itself, so that the result does not depend on who built it. Numbers of that range that it
does not need are holes: neither ``left`` nor ``count`` is set. A child's number is greater than its parent's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.tracer.kernels.layout import MAX_BINARY_DEPTH, WIDTH

BINS = 16
TRAVERSAL_COST = np.float32(1.0)  # of a node relative to a leaf block; 0.5 and 2 made no difference above the noise
ZERO, HUGE = np.float32(0.0), np.float32(3.0e38)
NO_AXIS = -1
SUBTREES = 128  # at least so many where there are boxes enough
SMALLEST_SUBTREE = 4096  # boxes
UPPER_NODES = 4 * SUBTREES * MAX_BINARY_DEPTH
STACK_ROWS = 2 * (MAX_BINARY_DEPTH + 64)


@inlined
def blocks_for(count: Int) -> Int:
    """Leaf blocks that hold this many triangles."""
    return (count + WIDTH - 1) // WIDTH


@inlined
def half_area(box: Any) -> Float:
    """Half the surface area of a box (lower x, y, z, upper x, y, z)."""
    dx, dy, dz = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return dx * dy + dy * dz + dz * dx


@inlined
def widest(box: Any) -> Float:
    """Largest extent of a box."""
    return max(max(box[3] - box[0], box[4] - box[1]), box[5] - box[2])


@inlined
def make_empty(box: Any) -> None:
    """Makes a box that any union replaces."""
    for axis in range(3):
        box[axis], box[3 + axis] = HUGE, -HUGE


@inlined
def include(box: Any, other: Any) -> None:
    """Enlarges a box to the union with another."""
    for axis in range(3):
        box[axis] = min(box[axis], other[axis])
        box[3 + axis] = max(box[3 + axis], other[3 + axis])


@inlined
def centroid(box: Any, axis: Int) -> Float:
    """Middle of a box along an axis; halved first, since the sum of huge bounds overflows."""
    return np.float32(0.5) * box[axis] + np.float32(0.5) * box[3 + axis]


@inlined
def bin_of(box: Any, axis: Int, lowest: Float, scale: Float) -> Int:
    """Bin of a box's centroid; 0 where bounds so huge that they overflow leave no number."""
    place = (centroid(box, axis) - lowest) * scale
    if not ZERO < place < np.float32(BINS):
        return 0
    return min(int(place), BINS - 1)


@inlined
def bin_scale(span: Any, axis: Int) -> Float:
    """Bins per metre along an axis of the centroids' box; 0 where they coincide."""
    extent = span[3 + axis] - span[axis]
    return np.float32(BINS * 0.9999) / extent if extent > ZERO else ZERO


@kernel
def triangle_boxes(start: Int, stop: Int, vertices: Any, faces: Any, boxes: Any) -> None:
    """Writes the bounding boxes of the triangles start .. stop - 1."""
    for i in range(start, stop):
        for axis in range(3):
            a, b, c = vertices[faces[i, 0], axis], vertices[faces[i, 1], axis], vertices[faces[i, 2], axis]
            boxes[i, axis] = min(min(a, b), c)
            boxes[i, 3 + axis] = max(max(a, b), c)


@kernel
def best_split(boxes: Any, start: Int, stop: Int, span: Any, counts: Any, bins: Any, right: Any) -> Any:
    """Returns cost, axis and last bin of the left side of the cheapest split; the axis is -1 where there is none.

    The cost is half the area times the blocks, summed over both sides. ``counts`` (3, 16), ``bins`` (3, 16, 6) and
    ``right`` (16) are working memory.
    """
    for axis in range(3):
        for b in range(BINS):
            counts[axis, b] = 0
            make_empty(bins[axis, b])
    sx, sy, sz = bin_scale(span, np.int64(0)), bin_scale(span, np.int64(1)), bin_scale(span, np.int64(2))
    for i in range(start, stop):
        box = boxes[i]
        for axis, scale in ((0, sx), (1, sy), (2, sz)):
            b = bin_of(box, axis, span[axis], scale)
            counts[axis, b] += 1
            include(bins[axis, b], box)
    best_cost, best_axis, best_bin = HUGE, NO_AXIS, 0
    side = np.empty(6, np.float32)
    for axis in range(3):
        if bin_scale(span, axis) == ZERO:
            continue
        make_empty(side)
        count = 0
        for b in range(BINS - 1, 0, -1):
            include(side, bins[axis, b])
            count += counts[axis, b]
            right[b] = half_area(side) * np.float32(blocks_for(count)) if count > 0 else ZERO
        make_empty(side)
        count = 0
        for b in range(BINS - 1):
            include(side, bins[axis, b])
            count += counts[axis, b]
            if 0 < count < stop - start:
                cost = half_area(side) * np.float32(blocks_for(count)) + right[b + 1]
                if cost < best_cost:
                    best_cost, best_axis, best_bin = cost, axis, b
    return best_cost, best_axis, best_bin


@kernel
def partition(boxes: Any, order: Any, start: Int, stop: Int, axis: Int, last: Int, span: Any) -> Int:
    """Moves the triangles whose bin is at most ``last`` to the front, boxes along with them; returns the border."""
    scale = bin_scale(span, axis)
    i, j = start, stop - 1
    while i <= j:
        if bin_of(boxes[i], axis, span[axis], scale) <= last:
            i += 1
        else:
            order[i], order[j] = order[j], order[i]
            for k in range(6):
                boxes[i, k], boxes[j, k] = boxes[j, k], boxes[i, k]
            j -= 1
    return i


class BinaryTree(NamedTuple):
    """A binary tree as it grows; node 0 is the root.

    ``boxes`` (m, 6) are sorted along with ``order`` (m), so that leaves own runs of them; of a node there are its
    bounds ``node_boxes`` (n, 6), the first child ``left`` (n) of an inner node, the second being the next, and the
    start ``first`` (n) and length ``count`` (n) of a leaf's run, the length 0 marking an inner node. The upper nodes
    have numbers below UPPER_NODES; the subtree over the boxes from i on has those from UPPER_NODES + 2 i on.
    """

    boxes: Any
    order: Any
    node_boxes: Any
    left: Any
    first: Any
    count: Any


class Bins(NamedTuple):
    """Working memory of :func:`split_node`."""

    counts: Any
    boxes: Any
    right: Any
    span: Any
    middle: Any


@inlined
def new_bins() -> Bins:
    """Makes working memory."""
    return Bins(
        np.empty((3, BINS), np.int32),
        np.empty((3, BINS, 6), np.float32),
        np.empty(BINS, np.float32),
        np.empty(6, np.float32),
        np.empty(6, np.float32),
    )


@kernel
def split_node(tree: BinaryTree, bins: Bins, node: Int, start: Int, stop: Int, depth: Int) -> Int:
    """Writes a node's box; returns where to split its boxes start .. stop - 1, or -1 if it is made a leaf."""
    box, span, middle_box = tree.node_boxes[node], bins.span, bins.middle
    make_empty(box)
    make_empty(span)
    for i in range(start, stop):
        include(box, tree.boxes[i])
        for axis in range(3):
            middle_box[axis] = middle_box[3 + axis] = centroid(tree.boxes[i], axis)
        include(span, middle_box)
    size = stop - start
    cost, axis, last = HUGE, NO_AXIS, 0
    if size > 1 and depth < MAX_BINARY_DEPTH:
        cost, axis, last = best_split(tree.boxes, start, stop, span, bins.counts, bins.boxes, bins.right)
    whole = half_area(box)
    if size <= WIDTH and cost + whole * TRAVERSAL_COST >= whole * np.float32(blocks_for(size)):
        tree.first[node], tree.count[node] = start, size
        return -1
    if axis == NO_AXIS:
        return (start + stop) // 2
    return partition(tree.boxes, tree.order, start, stop, axis, last, span)


@inlined
def put(stack: Any, row: Int, node: Int, start: Int, stop: Int, depth: Int) -> None:
    """Writes a row of work; Numba takes seconds to compile assignments of whole rows."""
    stack[row, 0], stack[row, 1], stack[row, 2], stack[row, 3] = node, start, stop, depth


@kernel
def build_upper(tree: BinaryTree, stack: Any, subtrees: Any, state: Any, largest: Int, budget: Int) -> None:
    """Builds upper nodes until ``budget`` boxes have been looked at, or nothing is left to do.

    Args:
        tree: The tree.
        stack: Rows of node, start, stop, depth that are still to do, shape (STACK_ROWS, 4).
        subtrees: Receives the same rows of the nodes that hang below, shape (UPPER_NODES, 4).
        state: Length of the stack, number of nodes, number of subtrees.
        largest: Boxes that a subtree may have.
        budget: After how much work to return, so that a Ctrl-C arrives.
    """
    bins = new_bins()
    while state[0] > 0 and budget > 0:
        state[0] -= 1
        row = state[0]
        node, start, stop, depth = stack[row, 0], stack[row, 1], stack[row, 2], stack[row, 3]
        if stop - start <= largest or state[1] + 2 > UPPER_NODES:
            put(subtrees, state[2], node, start, stop, depth)
            state[2] += 1
            continue
        budget -= stop - start
        middle = split_node(tree, bins, node, start, stop, depth)
        used = state[1]
        tree.left[node], tree.count[node] = used, 0
        put(stack, row, used + 1, middle, stop, depth + 1)
        put(stack, row + 1, used, start, middle, depth + 1)
        state[0] += 2
        state[1] += 2


@kernel
def build_subtrees(begin: Int, end: Int, tree: BinaryTree, subtrees: Any) -> None:
    """Builds the subtrees begin .. end - 1."""
    bins = new_bins()
    stack = np.empty((STACK_ROWS, 4), np.int64)
    for subtree in range(begin, end):
        put(stack, 0, subtrees[subtree, 0], subtrees[subtree, 1], subtrees[subtree, 2], subtrees[subtree, 3])
        used, top = UPPER_NODES + 2 * stack[0, 1], 1
        while top > 0:
            top -= 1
            node, start, stop, depth = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
            middle = split_node(tree, bins, node, start, stop, depth)
            if middle < 0:
                continue
            tree.left[node], tree.count[node] = used, 0
            put(stack, top, used + 1, middle, stop, depth + 1)
            put(stack, top + 1, used, start, middle, depth + 1)
            top += 2
            used += 2
