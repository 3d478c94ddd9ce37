"""Builds the acceleration structure: a binary tree by the surface area heuristic, collapsed to eight children.

The heuristic is evaluated in 16 bins of the centroids along each axis (Wald, "On fast construction of SAH-based
bounding volume hierarchies", 2007). It counts leaf blocks of eight triangles, not triangles, because a block costs
the same however full it is; the blocks come out about 90 % full. The collapse opens the child of largest area until a
node has eight (Wald, Benthin and Boulos, "Getting rid of packets", 2008), and stores children by falling area, so
that rays that only ask for any hit meet the likely occluders first.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.tracer.kernels.layout import CHILDREN, MAX_BINARY_DEPTH, PRIMITIVES, UPPER, WIDTH

BINS = 16
TRAVERSAL_COST = np.float32(1.0)  # of a node relative to a leaf block; 0.5 and 2 made no difference above the noise
ZERO, HUGE = np.float32(0.0), np.float32(3.0e38)
NO_AXIS = -1
MARGIN = np.float32(2.0**-21)  # of a box's extent: what ``boxes`` needs to find all that ``triangles`` hits
UNIT = np.float32(2.0**-23)  # a coordinate times this is one to two units in its last place


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
    """Bin of a box's centroid."""
    return min(int((centroid(box, axis) - lowest) * scale), BINS - 1)


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
    sx, sy, sz = bin_scale(span, 0), bin_scale(span, 1), bin_scale(span, 2)
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


@kernel
def build_binary(boxes: Any, order: Any, node_boxes: Any, left: Any, first: Any, count: Any) -> Int:
    """Builds the binary tree and returns its number of nodes; node 0 is the root.

    Args:
        boxes: Bounds of the triangles, shape (m, 6); permuted along with ``order``.
        order: Triangle numbers, shape (m); leaves own runs of it.
        node_boxes: Receives the nodes' bounds, shape (2 m, 6).
        left: Receives the first child of an inner node, the second being the next one, shape (2 m).
        first: Receives the start of a leaf's run.
        count: Receives the length of a leaf's run; 0 marks an inner node.
    """
    counts = np.empty((3, BINS), np.int32)
    bins = np.empty((3, BINS, 6), np.float32)
    right = np.empty(BINS, np.float32)
    span, middle_box = np.empty(6, np.float32), np.empty(6, np.float32)
    stack = np.empty((2 * (MAX_BINARY_DEPTH + 64), 4), np.int64)
    stack[0] = (0, 0, len(order), 0)
    top, used = 1, 1
    while top > 0:
        top -= 1
        node, start, stop, depth = stack[top]
        box = node_boxes[node]
        make_empty(box)
        make_empty(span)
        for i in range(start, stop):
            include(box, boxes[i])
            for axis in range(3):
                middle_box[axis] = middle_box[3 + axis] = centroid(boxes[i], axis)
            include(span, middle_box)
        size = stop - start
        cost, axis, last = HUGE, NO_AXIS, 0
        if size > 1 and depth < MAX_BINARY_DEPTH:
            cost, axis, last = best_split(boxes, start, stop, span, counts, bins, right)
        whole = half_area(box)
        if size <= WIDTH and cost + whole * TRAVERSAL_COST >= whole * np.float32(blocks_for(size)):
            first[node], count[node] = start, size
            continue
        middle = (start + stop) // 2 if axis == NO_AXIS else partition(boxes, order, start, stop, axis, last, span)
        left[node], count[node] = used, 0
        stack[top] = (used + 1, middle, stop, depth + 1)
        stack[top + 1] = (used, start, middle, depth + 1)
        top += 2
        used += 2
    return used


@kernel
def gather_children(root: Int, node_boxes: Any, left: Any, count: Any, children: Any) -> Int:
    """Fills ``children`` with up to eight descendants that together cover a node, by falling area; returns how many."""
    if count[root] > 0:
        children[0] = root
        return 1
    children[0], children[1] = left[root], left[root] + 1
    used = 2
    while used < WIDTH:
        widest, area = -1, np.float32(-1.0)
        for i in range(used):
            if count[children[i]] == 0 and half_area(node_boxes[children[i]]) > area:
                widest, area = i, half_area(node_boxes[children[i]])
        if widest < 0:
            break
        opened = left[children[widest]]
        children[widest], children[used] = opened, opened + 1
        used += 1
    for i in range(1, used):
        child = children[i]
        area = half_area(node_boxes[child])
        j = i
        while j > 0 and half_area(node_boxes[children[j - 1]]) < area:
            children[j] = children[j - 1]
            j -= 1
        children[j] = child
    return used


@kernel
def collapse(node_boxes: Any, left: Any, count: Any, children_of: Any, parents: Any) -> tuple[Int, Int]:
    """Lists the eight-wide nodes depth first; returns how many nodes and how many leaf blocks there are.

    Args:
        node_boxes: Bounds of the binary nodes.
        left: First children of the binary nodes.
        count: Triangles of the binary leaves, 0 for inner nodes.
        children_of: Receives the binary nodes below each wide node, -1 for none, shape (n, 8).
        parents: Receives where the wide node hangs: 8 * wide parent + lane, or -1 for the root, shape (n).
    """
    stack = np.empty((WIDTH * (MAX_BINARY_DEPTH + 64), 2), np.int64)
    stack[0] = (0, -1)
    top, wide, blocks = 1, 0, 0
    children = np.empty(WIDTH, np.int64)
    while top > 0:
        top -= 1
        root, parents[wide] = stack[top]
        used = gather_children(root, node_boxes, left, count, children)
        for lane in range(WIDTH):
            children_of[wide, lane] = children[lane] if lane < used else -1
        for lane in range(used - 1, -1, -1):
            if count[children[lane]] == 0:
                stack[top] = (children[lane], WIDTH * wide + lane)
                top += 1
            else:
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


@kernel
def pack(
    node_boxes: Any,
    first: Any,
    count: Any,
    order: Any,
    children_of: Any,
    parents: Any,
    vertices: Any,
    faces: Any,
    nodes: Any,
    codes: Any,
    blocks: Any,
    prims: Any,
) -> None:
    """Writes nodes and leaf blocks as ``layout`` describes them; ``codes`` and ``prims`` are their int32 views."""
    block = 0
    for wide in range(len(nodes)):
        if parents[wide] >= 0:
            codes[parents[wide] // WIDTH, CHILDREN + parents[wide] % WIDTH] = wide
        for lane in range(WIDTH):
            child = children_of[wide, lane]
            margin = MARGIN * widest(node_boxes[child])
            for axis in range(3):
                lower, upper = node_boxes[child, axis], node_boxes[child, 3 + axis]
                lower -= margin + abs(lower) * UNIT
                upper += margin + abs(upper) * UNIT
                nodes[wide, axis * WIDTH + lane] = lower if child >= 0 else HUGE
                nodes[wide, UPPER + axis * WIDTH + lane] = upper if child >= 0 else -HUGE
            codes[wide, CHILDREN + lane] = 0
            if child >= 0 and count[child] > 0:
                codes[wide, CHILDREN + lane] = ~block
                for i in range(WIDTH):
                    used = i < count[child]
                    prim = order[first[child] + i] if used else -1
                    prims[block, PRIMITIVES + i] = prim
                    solid = used and has_area(vertices, faces, prim)
                    for corner in range(3):
                        for axis in range(3):
                            row = (3 * corner + axis) * WIDTH + i
                            blocks[block, row] = vertices[faces[prim, corner], axis] if solid else ZERO
                block += 1
