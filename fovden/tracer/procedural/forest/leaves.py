"""Leaves: small bent patches on the twigs and on the ground."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.forest.bulk import scattered
from fovden.tracer.procedural.forest.ground import Terrain
from fovden.tracer.procedural.forest.trees import Limbs
from fovden.tracer.procedural.patch import Array, Indices, Patch

__all__ = ["LEAF_TRIANGLES", "fallen_leaves", "leaf", "leaves_on"]

LEAF_TRIANGLES = 2
"""Triangles of a leaf: its halves, folded along the midrib."""


def leaf() -> Patch:
    """Returns a leaf of length 1 along +z, its halves folded upward along the midrib, its tip hanging.

    The halves hold the outline of :func:`fovden.tracer.procedural.textures.plants.leaf_outline`, which is cut out.

    Example:
        >>> leaf().triangle_count
        2
    """
    vertices = np.array([(0.0, 0.0, 0.0), (-0.5, 0.147, 0.46), (0.5, 0.147, 0.42), (0.0, -0.08, 1.0)])
    uv = np.array([(0.5, 0.0), (0.0, 0.46), (1.0, 0.42), (0.5, 1.0)])
    return Patch(vertices, np.array([[0, 3, 1], [0, 2, 3]]), uv, np.zeros((4, 3)))


def leaves_on(rng: np.random.Generator, limbs: Limbs, owner: Indices, size: float) -> Patch:
    """Returns leaves that grow on limbs, pointing outward and down.

    Args:
        rng: Source of where and how they grow.
        limbs: What they grow on.
        owner: Number of the limb of each leaf, shape (m).
        size: Mean length, metres.

    Returns:
        The m leaves.

    Example:
        >>> twig = Limbs(np.array([[[0.0, 0, 0], [0, 1, 0]]]), np.array([[0.01, 0.0]]))
        >>> leaves_on(np.random.default_rng(0), twig, np.zeros(5, dtype=int), 0.1).triangle_count
        10
    """
    count = len(owner)
    place, radius, along = limbs.at(owner, rng.uniform(0.12, 1.0, count))
    aside = rng.standard_normal((count, 3))
    heading = 0.55 * along + 0.75 * aside / np.linalg.norm(aside, axis=1, keepdims=True) - [0.0, 0.18, 0.0]
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    place = place + (radius + 0.012)[:, None] * heading
    return scattered(
        leaf(),
        place,
        turns=np.arctan2(heading[:, 0], heading[:, 2]),
        tilts=np.arcsin(heading[:, 1]),
        rolls=rng.normal(0, 0.6, count),
        scales=size * rng.uniform(0.7, 1.3, count),
    )


def fallen_leaves(rng: np.random.Generator, ground: Terrain, places: Array, size: float) -> Patch:
    """Returns leaves that lie on the ground, their edges curled up.

    Example:
        >>> from fovden.tracer.procedural.detail import Detail
        >>> from fovden.tracer.procedural.forest.ground import terrain
        >>> fallen_leaves(np.random.default_rng(0), terrain(0, Detail(0.2)), np.ones((3, 2)), 0.1).triangle_count
        6
    """
    count = len(places)
    return scattered(
        leaf(),
        ground.on(places, above=0.016),
        turns=rng.uniform(0, 2 * np.pi, count),
        tilts=rng.normal(0.10, 0.06, count),
        rolls=rng.normal(0, 0.16, count),
        scales=size * rng.uniform(0.7, 1.3, count),
    )
