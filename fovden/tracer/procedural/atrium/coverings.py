"""What covers the floors, the ceiling and the roof: slabs, coffers and tiles, each in a local frame with y up."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.primitives import bridge, grid, mitred, quad, ring_corners

__all__ = ["coffer", "paving", "roof_tiles"]


def coffer(half_x: float, half_z: float) -> Patch:
    """Returns one coffer of a ceiling: a stepped recess in a rectangle, seen from below, its lowest edge at y = 0.

    Example:
        >>> coffer(0.5, 0.5).triangle_count
        34
    """
    rib = [(0.0, 0.0), (-0.07, 0.03), (-0.09, 0.09), (-0.15, 0.09), (-0.17, 0.15)]
    sides = mitred(rib, ring_corners(half_x, half_z), closed=True, outward=True)
    x, z = half_x - 0.17, half_z - 0.17
    back = quad((-x, 0.15, -z), (x, 0.15, -z), (x, 0.15, z), (-x, 0.15, z))
    return join([sides.reversed(), back])


def paving(size: tuple[float, float], joint: float = 0.014, depth: float = 0.01) -> Patch:
    """Returns one floor slab with bevelled edges; neighbours meet at the bottom of the joint, y = 0.

    Args:
        size: Extents (x, z) with half a joint on each side, metres.
        joint: Half the width of a joint, metres.
        depth: Depth of a joint, metres: the height of the slab's top.

    Returns:
        The slab: a top and four bevels.

    Example:
        >>> paving((0.8, 0.8)).triangle_count
        10
    """
    x, z = size[0] / 2, size[1] / 2
    bevel = mitred([(0, 0), (-joint, depth)], ring_corners(x, z), closed=True)
    x, z = x - joint, z - joint
    return join([quad((-x, depth, z), (x, depth, z), (x, depth, -z), (-x, depth, -z)), bevel])


def roof_tiles(length: float, spacing: float, slope: float, course: float, detail: Detail = DRAWN) -> Patch:
    """Returns one line of half-round cover tiles that climbs a roof from z = 0 towards -z.

    Args:
        length: Horizontal length of the line, metres.
        spacing: Width of the line, metres.
        slope: Rise over run.
        course: Horizontal length of a tile that is seen, metres.
        detail: Fineness of a tile's half circle, five segments as drawn.

    Returns:
        The tiles, each resting on the one below it and closed at its lower end.

    Example:
        >>> roof_tiles(2.0, 0.3, 0.4, 1.0).triangle_count
        28
    """
    count = max(1, round(length / course))
    step = length / count
    angle = np.linspace(np.pi, 0, detail.segments(5, least=2) + 1)
    lift = 0.03
    pieces = []
    for i in range(count):
        ends = []
        for at, radius, up in ((i * step, 0.40 * spacing, lift), ((i + 1) * step, 0.36 * spacing, 0.0)):
            y = up * (1 if count > 1 else 0) + slope * at + radius * np.sin(angle)
            ends.append(np.stack([radius * np.cos(angle), y, np.full_like(angle, -at)], axis=1))
        pieces.append(grid(np.stack(ends), smooth=True))
        pieces.append(bridge([ends[0][0], ends[0][-1]], ends[0][1:-1]))
    return join(pieces)
