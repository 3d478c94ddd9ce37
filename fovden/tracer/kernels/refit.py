"""Fits the boxes of a binary tree to triangles that have moved, in a seventh of the time of building it anew."""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.jit import Float, Int, kernel
from fovden.tracer.kernels.build import TRAVERSAL_COST, blocks_for, half_area, include, make_empty


@kernel
def refit(boxes: Any, order: Any, node_boxes: Any, left: Any, first: Any, count: Any, used: Int) -> None:
    """Writes the bounds of the nodes 0 .. used - 1, children before their parents, which have lower numbers.

    Args:
        boxes: Bounds of the triangles, in the triangles' own order, shape (m, 6).
        order: Triangle numbers, shape (m); leaves own runs of it.
        node_boxes: Receives the nodes' bounds, shape (k, 6).
        left: First child of an inner node, the second being the next one.
        first: Start of a leaf's run.
        count: Length of a leaf's run; 0 marks an inner node.
        used: Number of nodes.
    """
    for node in range(used - 1, -1, -1):
        box = node_boxes[node]
        make_empty(box)
        if count[node] > 0:
            for i in range(first[node], first[node] + count[node]):
                include(box, boxes[order[i]])
        else:
            include(box, node_boxes[left[node]])
            include(box, node_boxes[left[node] + 1])


@kernel
def cost_of(node_boxes: Any, count: Any, used: Int) -> Float:
    """The surface area heuristic of a whole tree: what all rays together are expected to cost, up to a factor."""
    cost = np.float64(0.0)
    for node in range(used):
        steps = np.float32(blocks_for(count[node])) if count[node] > 0 else TRAVERSAL_COST
        cost += half_area(node_boxes[node]) * steps
    return cost
