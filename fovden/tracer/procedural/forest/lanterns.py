"""Lanterns: of iron with six bars, of stone on a pedestal, and the crooks and stumps that carry them.

All are open on their sides, without glass. Each function returns patches in a local frame with the foot at the origin;
a point light goes into the middle of each lantern.
"""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import grid, lathe, tube

__all__ = [
    "CROOK_REACH",
    "CROOK_RISE",
    "FLAME",
    "IRON_HEIGHT",
    "STONE_FLAME",
    "cord",
    "crook",
    "far_lantern",
    "iron_lantern",
    "stone_lantern",
    "stump",
]

FLAME, IRON_HEIGHT = 0.145, 0.37
"""Height of the light in an iron lantern, and of the lantern's top, metres."""

STONE_FLAME = 0.80
"""Height of the light in a stone lantern, metres."""

CROOK_REACH, CROOK_RISE = 0.30, 1.52
"""How far a crook's end reaches out from its foot, and how high it is, metres."""

SIDES = 6


def iron_lantern(*, hanging: bool) -> tuple[Patch, Patch]:
    """Returns an iron lantern, 0.37 m tall, and the candle in it.

    Args:
        hanging: Whether its underside shows.

    Returns:
        Iron and wax.

    Example:
        >>> iron, wax = iron_lantern(hanging=True)
        >>> iron.triangle_count, wax.triangle_count
        (132, 15)
    """
    pieces = [
        np.array([(0.088, 0.0), (0.088, 0.018), (0.072, 0.034), (0.0, 0.030)]),
        np.array([(0.0, 0.262), (0.104, 0.250)]),
        np.array([(0.104, 0.250), (0.108, 0.262), (0.048, 0.320), (0.020, 0.332), (0.022, 0.352), (0.0, IRON_HEIGHT)]),
    ]
    if hanging:
        pieces.append(np.array([(0.0, -0.02), (0.088, 0.0)]))
    turned = [lathe(piece, SIDES, faceted=True) for piece in pieces]
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    bar = lathe([(0.0055, 0.031), (0.0055, 0.254)], 3, faceted=True)
    feet = 0.066 * np.stack([np.sin(angle), np.zeros(SIDES), np.cos(angle)], axis=1)
    wax = lathe([(0.017, 0.030), (0.015, 0.078), (0.0, 0.074)], 5, faceted=True)
    return join([*turned, bar.placed(feet, turns=angle)]), wax


def far_lantern() -> Patch:
    """Returns a lantern as it is seen from far away: the underside and the slopes of its roof.

    Example:
        >>> far_lantern().triangle_count
        6
    """
    return lathe([(0.0, 0.255), (0.108, 0.262), (0.0, IRON_HEIGHT)], 3, faceted=True)


def stone_lantern() -> Patch:
    """Returns a stone lantern, 1.22 m tall: a hexagonal pedestal, four posts around the light, a roof and a knob.

    Example:
        >>> stone_lantern().triangle_count
        230
    """
    pieces = [
        [(0.21, -0.05), (0.20, 0.06)],
        [(0.20, 0.06), (0.13, 0.085)],
        [(0.13, 0.085), (0.088, 0.17), (0.082, 0.33), (0.088, 0.50), (0.15, 0.58)],
        [(0.15, 0.58), (0.16, 0.60), (0.16, 0.64), (0.15, 0.65), (0.0, 0.645)],
        [(0.0, 0.965), (0.225, 0.95)],
        [(0.225, 0.95), (0.235, 0.978), (0.14, 1.045), (0.065, 1.09)],
        [(0.065, 1.09), (0.05, 1.115), (0.065, 1.145), (0.055, 1.18), (0.0, 1.215)],
    ]
    turned = [lathe(piece, SIDES, faceted=True) for piece in pieces]
    post = lathe([(0.022, 0.646), (0.020, 0.957)], 4, faceted=True, turn=np.pi / 4)
    corner = 0.088 * np.array([(x, 0.0, z) for x, z in ((-1, 1), (1, 1), (1, -1), (-1, -1))])
    return join([*turned, post.placed(corner)])


def crook() -> Patch:
    """Returns a shepherd's crook of iron that holds a lantern: a rod that bends over towards +z and ends in a hook.

    Example:
        >>> round(float(crook().vertices[:, 1].max()), 2)
        1.73
    """
    angle = np.linspace(0, np.pi, 9)
    half = CROOK_REACH / 2
    arch = np.stack([0 * angle, CROOK_RISE + 0.2 * np.sin(angle), half - half * np.cos(angle)], axis=1)
    return tube(np.concatenate([[(0.0, -0.05, 0.0)], arch]), np.linspace(0.013, 0.008, 10), 5)


def cord(start: Array, end: Array) -> Patch:
    """Returns a cord between two points, thin and three-sided.

    Example:
        >>> cord(np.array([0.0, 3.0, 0.0]), np.array([0.0, 2.0, 0.0])).triangle_count
        6
    """
    return tube(np.stack([start, end]), 0.005, 3)


def stump(rng: np.random.Generator, radius: float, height: float, columns: int) -> tuple[Patch, Patch]:
    """Returns a tree stump with swelling roots, and its sawn top.

    Args:
        rng: Source of its outline.
        radius: At the top, metres.
        height: Metres; its lowest ring lies 0.12 m deeper, to meet uneven ground.
        columns: Segments around.

    Returns:
        Bark and end grain.

    Example:
        >>> bark, top = stump(np.random.default_rng(0), 0.25, 0.4, 16)
        >>> bark.triangle_count, top.triangle_count
        (128, 16)
    """
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    angle[-1] = 0.0
    phase = rng.uniform(0, 2 * np.pi, 3)
    share = np.array([-0.12 / height, 0.14, 0.4, 0.75, 1.0])[:, None]
    wave = 1 + 0.05 * np.sin(2 * angle + phase[0]) + 0.04 * np.sin(7 * angle + phase[1])
    flare = 0.9 * np.exp(-3.2 * np.maximum(share, 0)) * (0.5 + 0.4 * np.sin(5 * angle + phase[2]))
    r = radius * (wave + flare)
    points = np.stack([r * np.sin(angle), np.broadcast_to(height * share, r.shape), r * np.cos(angle)], axis=-1)
    uv = np.stack(np.broadcast_arrays(np.linspace(0, round(max(1.0, 6.3 * radius)), columns + 1), height * share), -1)
    rim = points[-1]
    fan = np.concatenate([rim[:-1], [[0.0, height + 0.006, 0.0]]])
    faces = np.stack([np.arange(columns), (np.arange(columns) + 1) % columns, np.full(columns, columns)], axis=1)
    grain = 0.5 + 0.48 / radius * fan[:, [0, 2]] / 1.15
    return grid(points, smooth=True, uv=uv), Patch(fan, faces, grain, np.zeros_like(fan))
