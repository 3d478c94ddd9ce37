"""Round forms: what a lathe turns, and balls, discs and rings.

Each function returns patches in a local frame: y up, the front towards +z.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch
from fovden.tracer.procedural.primitives import bridge, lathe, tube

__all__ = ["ball", "bent", "disc", "torus", "turned"]


def ball(radius: float, rings: int, segments: int, start: float = -1.0) -> Patch:
    """Returns a ball about the origin, or its part above a height of ``start`` radii.

    Example:
        >>> ball(0.5, 4, 6).triangle_count
        36
    """
    angle = np.linspace(np.arcsin(start), np.pi / 2, rings + 1)
    profile = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile[-1, 0] = 0.0
    if start == -1.0:
        profile[0, 0] = 0.0
    return lathe(profile, segments)


def disc(radius: float, height: float, segments: int) -> Patch:
    """Returns a flat disc that faces up, without a vertex in its middle; it fits the end of a :func:`turned` thing.

    Example:
        >>> disc(0.5, 1.0, 8).triangle_count
        6
    """
    angle = np.linspace(0, 2 * np.pi, segments + 1)[:-1] - np.pi / 2
    rim = np.stack([radius * np.sin(angle), np.full(segments, height), radius * np.cos(angle)], axis=1)
    half = segments // 2
    return bridge(rim[: half + 1], rim[half + 1 :][::-1])


def torus(radius: float, thickness: float, around: int, across: int) -> Patch:
    """Returns a ring about the y axis, ``thickness`` being the radius of its round section.

    Example:
        >>> torus(0.2, 0.01, 12, 4).triangle_count
        96
    """
    angle = np.linspace(0, 2 * np.pi, around + 1)
    angle[-1] = 0.0
    return tube(radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1), thickness, across)


def turned(profile: ArrayLike, detail: Detail, segments: int = 20) -> Patch:
    """Returns turned wood, metal or clay: a surface of revolution through a smoothed profile.

    The profile's points are the corners that a turner would mark; between them runs a cubic curve, as fine as the
    detail has it. Its slopes are the mean of those on both sides, held so small that neither radius nor height leaves
    the range of the two corners (Fritsch and Carlson, "Monotone piecewise cubic interpolation", 1980): a rim would
    fold over otherwise.

    Args:
        profile: Radius and height (r, y) in metres from bottom to top, shape (n, 2).
        detail: Fineness: three rows between two points and ``segments`` around at fineness 1.
        segments: Segments around.

    Returns:
        The patch, smooth.

    Example:
        >>> turned([(0.02, 0.0), (0.04, 0.1), (0.02, 0.3)], Detail()).triangle_count
        160
    """
    detail = detail.at_most(3.0)  # the rows of a rim would become slivers beyond
    points = np.asarray(profile, dtype=float)
    steps = np.diff(points, axis=0)
    before, after = steps[[0, *range(len(steps))]], steps[[*range(len(steps)), -1]]
    least = 3 * np.minimum(np.abs(before), np.abs(after))
    slopes = np.where(before * after > 0, np.clip((before + after) / 2, -least, least), 0.0)
    rows = detail.segments(3)
    s = np.arange(rows)[:, None] / rows
    curve = [
        (1 + 2 * s) * (1 - s) ** 2 * a + s**2 * (3 - 2 * s) * b + s * (1 - s) ** 2 * start - s**2 * (1 - s) * end
        for a, b, start, end in zip(points, points[1:], slopes, slopes[1:], strict=False)
    ]
    line = np.concatenate([*curve, points[-1:]])
    return lathe(bent(line), detail.segments(segments, least=4))


def bent(points: ArrayLike) -> Array:
    """Returns a polyline without the points at which it runs straight on, to within a fiftieth of a radian.

    Args:
        points: Positions, shape (n, d).

    Returns:
        The first point, those at which the line bends, and the last, shape (m, d).

    Example:
        >>> bent([(0, 0), (1, 0), (2, 0), (2, 1)]).tolist()
        [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]
    """
    line = np.asarray(points, dtype=float)
    keep = [0]
    for i in range(1, len(line) - 1):
        before, after = line[i] - line[keep[-1]], line[i + 1] - line[i]
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        if np.linalg.norm(after - before) > 0.02:
            keep.append(i)
    return line[[*keep, len(line) - 1]]
