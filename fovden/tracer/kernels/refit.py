"""Fits the boxes of a binary tree to triangles that have moved, in a fraction of the time of building it anew."""

from __future__ import annotations

from typing import Any

import numpy as np

from fovden.jit import Float, kernel
from fovden.tracer.kernels.build import TRAVERSAL_COST, BinaryTree, blocks_for, half_area, include, make_empty


@kernel
def refit(tree: BinaryTree, boxes: Any, moved: Any) -> None:
    """Writes the bounds of all nodes, children before their parents, which have lower numbers.

    Args:
        tree: The tree; receives the nodes' bounds.
        boxes: Bounds of the triangles, in the triangles' own order, shape (m, 6).
        moved: Which triangles are elsewhere than when the tree was built, shape (m). Of the others, those that were cut
            into pieces keep the pieces' bounds, which are smaller.
    """
    for node in range(len(tree.count) - 1, -1, -1):
        box = tree.node_boxes[node]
        make_empty(box)
        if tree.count[node] > 0:
            for i in range(tree.first[node], tree.first[node] + tree.count[node]):
                prim = tree.order[i]
                include(box, boxes[prim] if moved[prim] else tree.boxes[i])
        elif tree.left[node] > 0:
            include(box, tree.node_boxes[tree.left[node]])
            include(box, tree.node_boxes[tree.left[node] + 1])


@kernel
def cost_of(tree: BinaryTree, node_boxes: Any) -> Float:
    """The surface area heuristic of a whole tree: what all rays together are expected to cost, up to a factor."""
    cost = np.float64(0.0)
    for node in range(len(tree.count)):
        if tree.count[node] > 0:
            cost += half_area(node_boxes[node]) * np.float32(blocks_for(tree.count[node]))
        elif tree.left[node] > 0:
            cost += half_area(node_boxes[node]) * TRAVERSAL_COST
    return cost
