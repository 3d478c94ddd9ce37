"""The tree with which a path chooses among many lights by what they bring to a surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from fovden.memory import on_large_pages
from fovden.tracer.kernels import light_tree_build
from fovden.tracer.kernels.light_tree import NODE

__all__ = ["LightTree", "build_light_tree"]

LEAST_POWER = 1e-12
"""Least share of all power that a light counts with, so that float32 holds its importance."""


class LightTree(NamedTuple):
    """Nodes as :mod:`fovden.tracer.kernels.light_tree` reads them, and the node of each light.

    Attributes:
        nodes: Float32, shape (2 k, 16), where k lights have power; number 0 is unused, the root is 1.
        leaves: Node of each light, int32, shape (n); 0 for lights without power, which are left out.

    Example:
        >>> build_light_tree(torch.zeros(1, 1, 3), torch.ones(1)).leaves
        tensor([1], dtype=torch.int32)
    """

    nodes: Tensor
    leaves: Tensor


def build_light_tree(corners: Tensor, power: Tensor) -> LightTree:
    """Returns a tree over points or triangles that shine.

    Args:
        corners: Positions, shape (n, 3, 3) for triangles, shape (n, 1, 3) for points; for a mixture a point is a
            triangle whose corners coincide. A triangle shines on the side from which its corners run counter-clockwise,
            a point in all directions.
        power: Radiant intensity perpendicular to it: that of a point, radiance times area of a triangle, shape (n), at
            least 0.

    Returns:
        The tree; its nodes are empty if no light has power.

    Differentiable: no. Cost: some microseconds a light; 64 bytes a node. Source: see the kernels.

    Example:
        >>> tree = build_light_tree(torch.rand(100, 1, 3), torch.ones(100))
        >>> tree.nodes.shape, len(tree.leaves.unique())
        (torch.Size([200, 16]), 100)
    """
    corners, power = corners.detach().double(), power.detach().double()
    corners = corners.expand(-1, 3, 3)
    shining = (power > 0).nonzero()[:, 0]
    leaves = torch.zeros(len(power), dtype=torch.int32)
    count = len(shining)
    if count == 0:
        return LightTree(torch.zeros(0, NODE), leaves)
    corners, share = corners[shining], power[shining] / power[shining].sum()
    share = share.clamp_min(LEAST_POWER)
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_point = (corners == corners[:, :1]).all(2).all(1)
    normals = torch.nn.functional.normalize(normals, dim=1, eps=0.0).nan_to_num(0.0)
    lights = torch.cat([share[:, None], share[:, None] * normals, corners.amin(1), corners.amax(1)], 1)
    cones = torch.where(is_point | (normals == 0).all(1), torch.pi, 0.0).double()
    nodes = np.zeros((2 * count, NODE), np.float32)
    found, stack = np.zeros(count, np.int64), np.zeros((count + 1, 3), np.int64)
    tables = (lights.numpy(), cones.numpy(), shining.numpy(), np.arange(count))
    light_tree_build.build(*tables, stack, nodes, nodes.view(np.int32), found)
    leaves[shining] = torch.from_numpy(found).int()
    return LightTree(on_large_pages(torch.from_numpy(nodes)), leaves)
