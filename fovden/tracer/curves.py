"""Curves through keyframes: numbers that move smoothly or jump, and rotations.

A keyframe is a value at a frame. A value that is *held* stays until the next keyframe and jumps there, which ends a
curve and begins another: glTF calls it STEP, USD held interpolation. Every curve keeps its last value afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from fovden.checks import require, require_integer

__all__ = ["interpolate", "interpolate_rotations", "require_frames", "rotation_matrix"]

Array = npt.NDArray[np.float64]


def require_frames(name: str, frames: Sequence[int], *, at_least: int = 1) -> None:
    """Raises an error unless the frames of keyframes begin with 0 and rise.

    Args:
        name: The argument's name.
        frames: Number of each keyframe's frame.
        at_least: How many keyframes there must be.

    Raises:
        TypeError: If a number is not an integer.
        ValueError: If there are too few, or they do not begin with 0 and rise.

    Example:
        >>> require_frames("keyframes", [0, 4, 2])
        Traceback (most recent call last):
        ...
        ValueError: keyframes: expected numbers of frames that begin with 0 and rise, got [0, 4, 2]
    """
    wanted = {1: "at least one keyframe", 2: "at least two keyframes"}[at_least]
    require(len(frames) >= at_least, name, len(frames), wanted)
    for frame in frames:
        require_integer(f"{name}' frame", frame, minimum=0)
    rising = frames[0] == 0 and all(a < b for a, b in pairwise(frames))
    require(rising, name, list(frames), "numbers of frames that begin with 0 and rise")


def interpolate(frames: Sequence[int], values: npt.ArrayLike, held: Sequence[bool], frame: int) -> Array:
    """Returns the value in a frame of a cubic Hermite curve through keyframes.

    The velocity at an inner keyframe is the slope from the one before to the one after it (Catmull and Rom's choice,
    for unequal distances in time), at the ends that of the first and of the last piece; so value and velocity are
    continuous, and a curve starts and ends in motion.

    Args:
        frames: Number of each keyframe's frame, from 0 and rising, k of them.
        values: Their values, shape (k, ...).
        held: Whether each value stays until the next keyframe.
        frame: The frame, at least 0.

    Returns:
        The value, float64, of the shape of one keyframe's.

    Source: Catmull and Rom, "A class of local interpolating splines" (1974).

    Example:
        >>> interpolate([0, 10, 20], [0.0, 1.0, 5.0], [False, False, False], 5)
        array(0.3125)
        >>> interpolate([0, 10, 20], [0.0, 1.0, 5.0], [True, False, False], 5)
        array(0.)
    """
    value = np.asarray(values, dtype=np.float64)
    i, first, last = _curve(frames, held, frame)
    if first == last:
        return np.asarray(value[i])
    time = np.asarray(frames, dtype=np.float64)

    def velocity(key: int) -> Array:
        before, after = max(key - 1, first), min(key + 1, last)
        slope: Array = (value[after] - value[before]) / (time[after] - time[before])
        return slope

    span = time[i + 1] - time[i]
    s = (frame - time[i]) / span
    return np.asarray(
        (1 + 2 * s) * (1 - s) ** 2 * value[i]
        + s**2 * (3 - 2 * s) * value[i + 1]
        + span * (s * (1 - s) ** 2 * velocity(i) - s**2 * (1 - s) * velocity(i + 1))
    )


def interpolate_rotations(frames: Sequence[int], rotations: npt.ArrayLike, held: Sequence[bool], frame: int) -> Array:
    """Returns the rotation in a frame of a Hermite curve through keyframes, with continuous angular velocity.

    Between keyframes a and b, with angular velocities w_a and w_b in the turning body's own axes, times a third of the
    frames between them,

        q(s) = q_a exp(w_a b_1(s)) exp(d b_2(s)) exp(w_b b_3(s)),    d = log(exp(-w_a) q_a^-1 q_b exp(-w_b))
        b_1 = 1 - (1 - s)^3,   b_2 = 3 s^2 - 2 s^3,   b_3 = s^3

    which for vectors and sums would be the curve of :func:`interpolate`; about a single axis it is. The velocity at an
    inner keyframe is the turn from the one before to this one and from this one to the next, over the frames that they
    take. Two keyframes give a turn at constant speed (slerp). Between neighbours the shorter way is taken, so a full
    turn needs three keyframes or more after its first.

    Args:
        frames: Number of each keyframe's frame, from 0 and rising, k of them.
        rotations: Unit quaternions (x, y, z, w), shape (k, 4).
        held: Whether each rotation stays until the next keyframe.
        frame: The frame, at least 0.

    Returns:
        A unit quaternion (x, y, z, w), float64.

    Source: the Hermite quaternion curve of Kim, Kim and Shin, "A general construction scheme for unit quaternion
    curves with simple high order derivatives" (1995); the velocities are ours.

    Example:
        >>> quarter = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
        >>> interpolate_rotations([0, 90], [(0, 0, 0, 1), quarter], [False, False], 30).round(4)  # 30 degrees about z
        array([0.    , 0.    , 0.2588, 0.9659])
    """
    rotation = np.asarray(rotations, dtype=np.float64)
    i, first, last = _curve(frames, held, frame)
    if first == last or frame == frames[i]:
        return np.asarray(rotation[i])

    def turn(a: int, b: int) -> Array:
        return _log(_times(_inverse(rotation[a]), rotation[b]))

    def velocity(key: int) -> Array:
        before, after = max(key - 1, first), min(key + 1, last)
        total = sum((turn(a, b) for a, b in pairwise(range(before, after + 1))), np.zeros(3))
        slope: Array = total / (frames[after] - frames[before])
        return slope

    span = frames[i + 1] - frames[i]
    s = (frame - frames[i]) / span
    start, end = velocity(i) * span / 3, velocity(i + 1) * span / 3
    between = _times(_inverse(rotation[i]), rotation[i + 1])
    middle = _log(_times(_times(_exp(-start), between), _exp(-end)))
    curve = _times(rotation[i], _exp(start * (1 - (1 - s) ** 3)))
    curve = _times(_times(curve, _exp(middle * s**2 * (3 - 2 * s))), _exp(end * s**3))
    return np.asarray(curve / np.linalg.norm(curve))


def rotation_matrix(rotation: npt.ArrayLike) -> Array:
    """Returns the matrix of a unit quaternion (x, y, z, w), shape (3, 3), for columns: rotated = matrix @ vector.

    Example:
        >>> rotation_matrix((0, 0, 0.5**0.5, 0.5**0.5)).round(6) @ (1, 0, 0)
        array([0., 1., 0.])
    """
    x, y, z, w = np.asarray(rotation, dtype=np.float64).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _curve(frames: Sequence[int], held: Sequence[bool], frame: int) -> tuple[int, int, int]:
    """The keyframe at or before a frame, and the first and last one of the smooth curve on which the frame lies.

    All three are the same where the value rests.
    """
    i = int(np.searchsorted(np.asarray(frames), frame, side="right")) - 1
    end = len(frames) - 1
    if i == end or held[i]:
        return i, i, i
    first, last = i, i + 1
    while first > 0 and not held[first - 1]:
        first -= 1
    while last < end and not held[last]:
        last += 1
    return i, first, last


def _times(a: Array, b: Array) -> Array:
    """The product of two quaternions: the rotation b, then a."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - float(a[:3] @ b[:3]))


def _inverse(rotation: Array) -> Array:
    return np.append(-rotation[:3], rotation[3])


def _exp(turn: Array) -> Array:
    """The rotation about an axis by the axis' length in radians."""
    angle = float(np.linalg.norm(turn))
    return np.append(turn / 2 * np.sinc(angle / (2 * np.pi)), np.cos(angle / 2))


def _log(rotation: Array) -> Array:
    """Axis times angle in radians, of at most half a turn."""
    rotation = rotation if rotation[3] >= 0 else -rotation
    sine = float(np.linalg.norm(rotation[:3]))
    angle = 2 * float(np.arctan2(sine, rotation[3]))
    axis: Array = rotation[:3] * (angle / sine if sine > 0 else 2.0)
    return axis
