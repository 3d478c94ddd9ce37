"""Functions of one variable inside kernels: laws as tables, angles as polynomials."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import pointer_to

TURN = 2 * np.pi
ATAN_DEGREE, SINE_DEGREE = 13, 6
"""Of the polynomials below in the square of their argument: errors under 1e-12 turns, and under 1e-13."""


def _fitted(function: Any, degree: int, end: float) -> tuple[float, ...]:
    """Coefficients, lowest power first, of the polynomial through Chebyshev's points of [0, end]."""
    found = np.polynomial.Chebyshev.interpolate(function, degree, domain=[0, end])
    return tuple(map(float, found.convert(kind=np.polynomial.Polynomial).coef))


ATAN = _fitted(lambda w: np.arctan(np.sqrt(w)) / np.sqrt(w) / TURN, ATAN_DEGREE, 1.0)
SINE = _fitted(lambda w: np.sinc(2 * np.sqrt(w)) * TURN, SINE_DEGREE, 1 / 64)
COSINE = _fitted(lambda w: np.cos(TURN * np.sqrt(w)), SINE_DEGREE, 1 / 64)


class Table(NamedTuple):
    """A function of one variable by cubic pieces, which are shorter where it bends.

    Attributes:
        origin: Where it begins, a whole number.
        starts: Number of the first piece of each unit from there on, and the number of pieces, int32, shape (n + 1,).
        pieces: Where a piece begins, and the coefficients of the powers of the distance from there, shape (m, 5).
    """

    origin: float
    starts: Any
    pieces: Any


class Curve(NamedTuple):
    """A table as kernels hand it on: pointers, which are not counted as references to arrays are.

    Attributes:
        origin: Where it begins.
        units: Number of units.
        starts: Pointer to the numbers of pieces.
        pieces: Pointer to the pieces.
    """

    origin: float
    units: int
    starts: Any
    pieces: Any


@inlined
def curve_of(table: Table) -> Curve:
    """The pointers of a table, which must outlive them."""
    return Curve(table.origin, len(table.starts) - 1, pointer_to(table.starts), pointer_to(table.pieces))


@inlined
def value_at(curve: Curve, x: Float) -> Float:
    """The function's value; beyond the ends that at the ends."""
    from_origin = min(max(x - curve.origin, 0.0), np.float64(curve.units))
    unit: Int = min(np.int64(from_origin), curve.units - 1)
    low, high = np.int64(curve.starts[unit]), np.int64(curve.starts[unit + 1])
    while high - low > 1:
        middle = (low + high) >> 1
        if x < curve.pieces[5 * middle]:
            high = middle
        else:
            low = middle
    s = from_origin + (curve.origin - curve.pieces[5 * low])
    third = curve.pieces[5 * low + 4] * s + curve.pieces[5 * low + 3]
    return (third * s + curve.pieces[5 * low + 2]) * s + curve.pieces[5 * low + 1]


@kernel
def values_at(table: Table, x: Any, values: Any) -> None:
    """The function's values at many places."""
    curve = curve_of(table)
    for i in range(len(x)):
        values[i] = value_at(curve, x[i])


@inlined
def floor_of(x: Float) -> Int:
    """The largest integer up to a number."""
    whole = np.int64(x)
    return whole - 1 if x < whole else whole


@inlined
def sides_of(at: Float, dy: Float, inner: Float, outer: Float, width: Int) -> Any:
    """Where a row ``dy`` below the gaze lies in a ring around it.

    That is from the first to before the second number left of the gaze, and from the third to before the fourth right
    of it. Both parts are a pixel wider than need be, and have no pixel in common.
    """
    if abs(dy) > outer:
        return np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    far, near = np.sqrt(outer * outer - dy * dy), np.sqrt(max(inner * inner - dy * dy, 0.0))
    left, middle = max(floor_of(at - far) - 1, 0), min(floor_of(at - near) + 2, width)
    beyond, right = max(floor_of(at + near) - 1, middle, 0), min(floor_of(at + far) + 2, width)
    return left, middle, beyond, right


@inlined
def turn_of(x: Float, y: Float) -> Float:
    """The angle of a vector from the x axis towards the y axis, in turns from 0 to 1; 0 for no vector."""
    across, along = abs(x), abs(y)
    longer = max(across, along)
    z = min(across, along) / (longer if longer > 0.0 else 1.0)
    w = z * z
    total = ATAN[13]
    total = total * w + ATAN[12]
    total = total * w + ATAN[11]
    total = total * w + ATAN[10]
    total = total * w + ATAN[9]
    total = total * w + ATAN[8]
    total = total * w + ATAN[7]
    total = total * w + ATAN[6]
    total = total * w + ATAN[5]
    total = total * w + ATAN[4]
    total = total * w + ATAN[3]
    total = total * w + ATAN[2]
    total = total * w + ATAN[1]
    turn = (total * w + ATAN[0]) * z
    turn = 0.25 - turn if along > across else turn
    turn = 0.5 - turn if x < 0.0 else turn
    return 1.0 - turn if y < 0.0 else turn


@inlined
def direction_of(turn: Float) -> Any:
    """Cosine and sine of an angle in turns."""
    eighth = np.floor(4.0 * turn + 0.5)
    u = turn - 0.25 * eighth
    w = u * u
    sine, cosine = SINE[6], COSINE[6]
    for k in (5, 4, 3, 2, 1, 0):
        sine, cosine = sine * w + SINE[k], cosine * w + COSINE[k]
    sine *= u
    quarter = np.int64(eighth) & 3
    if quarter & 1:
        sine, cosine = cosine, -sine
    if quarter & 2:
        sine, cosine = -sine, -cosine
    return cosine, sine


@kernel
def place_cells(start: Int, stop: Int, table: Table, gaze: Any, heights: Any, cells: Any, points: Any) -> None:
    """Points on the screen of the cell coordinates start .. stop - 1 of one view."""
    curve = curve_of(table)
    for i in range(start, stop):
        x = np.float64(cells[i, 0])
        distance = value_at(curve, x)
        height = heights[min(max(np.int64(np.floor(x)), 0), len(heights) - 1)]
        cosine, sine = direction_of(np.float64(cells[i, 1]) / height)
        points[i, 0] = gaze[0] + distance * cosine
        points[i, 1] = gaze[1] + distance * sine
