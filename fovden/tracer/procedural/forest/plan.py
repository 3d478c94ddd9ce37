"""The forest's plan: measures in metres, where the trail runs, and a random generator for each part.

The world's origin is the middle of the clearing, where the shrine stands; y is up. The trail comes from the wood at +z,
passes the shrine on its left side and leaves between the trees at -z.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fovden.tracer.procedural.patch import Array, Indices

__all__ = [
    "APPROACH",
    "CLEARING",
    "CORRIDOR",
    "HEADROOM",
    "PLINTH",
    "RIM",
    "TRAIL",
    "Mask",
    "distance_to_trail",
    "generator",
    "smoothstep",
    "spread_out",
    "trail_points",
]

Mask = NDArray[np.bool_]

CLEARING = 6.4
"""Radius that no tree stands in."""

RIM = 21.0
"""Half the width of the terrain."""

PLINTH = 1.9
"""Radius of the shrine's lowest step."""

CORRIDOR, HEADROOM = 0.85, 2.75
"""Half the width and the height of the space above the trail that is kept free of branches, leaves and lanterns."""

TRAIL = np.array(
    [
        (5.6, 15.0),
        (4.7, 12.4),
        (3.3, 10.0),
        (2.3, 7.6),
        (1.3, 5.4),
        (-0.7, 3.8),
        (-2.7, 2.3),
        (-3.5, -0.4),
        (-3.1, -3.2),
        (-4.0, -6.2),
        (-6.2, -9.0),
        (-7.6, -12.0),
        (-8.0, -15.0),
    ]
)
"""Points (x, z) that the trail passes."""

APPROACH = np.array([(0.95, 4.62), (0.70, 4.04), (0.42, 3.47), (0.25, 2.86), (0.04, 2.26)])
"""Points (x, z) of the stones that lead from the trail to the shrine."""


def generator(seed: int, part: str) -> np.random.Generator:
    """Returns the random generator of one part of the scene, so that no part depends on how another is made.

    Example:
        >>> generator(0, "ferns").random() == generator(0, "ferns").random() != generator(0, "grass").random()
        True
    """
    return np.random.default_rng([seed, *part.encode()])


def smoothstep(value: Array | float, start: float, end: float) -> Array:
    """Returns a smooth step from 0 at ``start`` to 1 at ``end``.

    Example:
        >>> float(smoothstep(np.array(1.5), 1.0, 2.0))
        0.5
    """
    share = np.clip((np.asarray(value, dtype=float) - start) / (end - start), 0, 1)
    step: Array = share * share * (3 - 2 * share)
    return step


def trail_points(spacing: float) -> Array:
    """Returns points (x, z) on the trail, evenly spaced, shape (n, 2).

    Cubic Hermite curves through :data:`TRAIL`, with Catmull and Rom's slopes.

    Example:
        >>> points = trail_points(0.5)
        >>> steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        >>> bool(abs(steps - 0.5).max() < 0.02)
        True
    """
    slope = np.gradient(TRAIL, axis=0)
    s = np.linspace(0, 1, 64, endpoint=False)[:, None, None]
    start, end, leave, arrive = TRAIL[:-1], TRAIL[1:], slope[:-1], slope[1:]
    curve = (1 + 2 * s) * (1 - s) ** 2 * start + s**2 * (3 - 2 * s) * end
    curve = curve + s * (1 - s) ** 2 * leave - s**2 * (1 - s) * arrive
    dense = np.concatenate([curve.transpose(1, 0, 2).reshape(-1, 2), TRAIL[-1:]])
    length = np.concatenate([[0.0], np.linalg.norm(np.diff(dense, axis=0), axis=1).cumsum()])
    at = np.arange(0.0, length[-1], spacing)
    return np.stack([np.interp(at, length, dense[:, axis]) for axis in range(2)], axis=1)


_TRAIL_DENSE = trail_points(0.25)


def distance_to_trail(places: Array) -> Array:
    """Returns the horizontal distance of places from the trail's middle, metres.

    Args:
        places: Points (x, z), shape (..., 2).

    Returns:
        Distances, shape (...), to the nearest of points 0.25 m apart.

    Example:
        >>> bool(distance_to_trail(TRAIL).max() < 0.16)
        True
    """
    flat = places.reshape(-1, 2)
    nearest = np.full(len(flat), np.inf)
    for point in _TRAIL_DENSE:
        np.minimum(nearest, ((flat - point) ** 2).sum(axis=1), out=nearest)
    distance: Array = np.sqrt(nearest).reshape(places.shape[:-1])
    return distance


def spread_out(rng: np.random.Generator, candidates: Array, count: int, taken: Array | None = None) -> Indices:
    """Returns the numbers of candidates that lie far apart: each next one is farthest from all before.

    Args:
        rng: Chooses the first where nothing is taken yet.
        candidates: Places, shape (n, d).
        count: How many are wanted, at most n.
        taken: Places to keep away from, shape (m, d).

    Returns:
        Row numbers, shape (count).

    Example:
        >>> row = np.array([[0.0], [1.0], [2.0], [10.0]])
        >>> sorted(spread_out(np.random.default_rng(0), row, 2, taken=np.array([[0.0]])).tolist())
        [2, 3]
    """
    chosen = np.zeros(count, dtype=np.int64)
    distance = np.full(len(candidates), np.inf)
    for place in [] if taken is None else taken:
        distance = np.minimum(distance, np.linalg.norm(candidates - place, axis=1))
    for i in range(count):
        first = i == 0 and (taken is None or len(taken) == 0)
        chosen[i] = rng.integers(len(candidates)) if first else np.argmax(distance)
        distance = np.minimum(distance, np.linalg.norm(candidates - candidates[chosen[i]], axis=1))
    return chosen
