"""Which cells a pixel reads, with what weights: for a run of pixels of one row at a time.

Of a pixel, all but the angle follows from its distance, through the law's table. Its footprint in distance is a span
of columns, that in angle an arc. Most arcs are no longer than a cell, and are read between two rows; then a pixel reads
two cells in each of a few columns, and loops over the pixels of a run become vector instructions. Other footprints are
boxes that are read cell by cell: boxes cover the screen about once, so that all of them together read about as many
cells as there are.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import pointer_to, stack_doubles, stack_floats, stack_int32
from fovden.warps.kernels.curves import TURN, Curve, Table, curve_of, floor_of, turn_of, value_at

RUN = 64
"""Pixels of a run."""

MOST = 4
"""Columns of a footprint that is not read as a box, at most."""

STEPS = 16
"""Parts of a pixel's distance by which footprints are sorted; divides evenly by two."""

NONE, ANGLE, AREA = 0, 1, 2
"""The prefilters."""


class Eye(NamedTuple):
    """One view of a warp.

    Attributes:
        x: Where it looks, in pixels.
        y: The same.
        table: Column coordinate at a distance from there.
        kinds: How pixels are read in each part of a distance, from the table's origin on, bytes: how many columns they
            read between two rows, or 0 for a box.
        heights: Number of rows of each column, int64.
        offsets: Number of cells before each column, and of all, int64.
        rotate: Whether the other side of the gaze lies before column 0.
        prefilter: What is averaged: NONE, ANGLE or AREA.
    """

    x: float
    y: float
    table: Table
    kinds: Any
    heights: Any
    offsets: Any
    rotate: bool
    prefilter: int


class View(NamedTuple):
    """An :class:`Eye` as kernels hand it on, with pointers for its arrays, and the columns that may be touched."""

    x: float
    y: float
    curve: Curve
    parts: int
    kinds: Any
    columns: int
    heights: Any
    offsets: Any
    rotate: bool
    prefilter: int
    first: int
    last: int


class Taps(NamedTuple):
    """A run of pixels, in memory on the stack: what is known of them, and the cells that they read.

    Attributes:
        distances: From the gaze.
        turns: Angles in turns.
        firsts: Where footprints begin, in columns.
        lasts: Where they end.
        kinds: How pixels are read, as in :class:`Eye`.
        ones: Cells in the upper of two rows, all pixels of the first column, then of the second, and so on.
        twos: Those in the lower row.
        above: Weights of the upper cells.
        below: Those of the lower ones.
    """

    distances: Any
    turns: Any
    firsts: Any
    lasts: Any
    kinds: Any
    ones: Any
    twos: Any
    above: Any
    below: Any


@inlined
def view_of(eye: Eye, first: Int, last: Int) -> View:
    """The pointers of an eye, which must outlive them; columns first .. last - 1 are touched and no others."""
    return View(
        eye.x, eye.y, curve_of(eye.table), len(eye.kinds), pointer_to(eye.kinds), len(eye.heights),
        pointer_to(eye.heights), pointer_to(eye.offsets), eye.rotate, eye.prefilter, first, last,
    )  # fmt: skip


@inlined
def taps_on_the_stack() -> Taps:
    """Memory for a run: RUN numbers each, and MOST times as many. Their sizes must be literals."""
    return Taps(
        stack_doubles(64), stack_doubles(64), stack_doubles(64), stack_doubles(64), stack_int32(64), stack_int32(256),
        stack_int32(256), stack_floats(256), stack_floats(256),
    )  # fmt: skip


@inlined
def column_of(view: View, column: Int) -> Int:
    """The column that stands for one beyond a border."""
    mirrored = -1 - column if view.rotate else 0
    column = mirrored if column < 0 else column
    return min(max(column, view.first), view.last - 1)


@inlined
def turned_by(view: View, column: Int) -> Float:
    """The turns to go to the column that stands for another."""
    return (0.5 if view.rotate else 0.0) if column < 0 else 0.0


@inlined
def arc_of(prefilter: Int, distance: Float) -> Float:
    """The share of the circle that a pixel covers."""
    if prefilter == NONE:
        return 1.0 if distance == 0.0 else 0.0
    return 1.0 / max(TURN * distance, 1.0)


@inlined
def span_of(view: View, distance: Float, column: Float) -> Any:
    """Where a pixel's footprint begins and ends, in columns: at least one apart."""
    first, last = column - 0.5, column + 0.5
    if view.prefilter == AREA:
        inner = value_at(view.curve, abs(distance - 0.5))
        if distance < 0.5:
            inner = -inner if view.rotate else 0.0
        first = min(first, inner)
        last = max(last, min(value_at(view.curve, distance + 0.5), np.float64(view.columns)))
    return first, last


@kernel
def sort_distances(eye: Eye, columns: Any) -> None:
    """Finds the kinds of an eye, from the columns at all borders of the parts.

    Columns rise with the distance, so a part's borders, and those half a pixel further, speak for what lies between.
    """
    half, count = STEPS // 2, len(eye.kinds)
    view = view_of(eye, 0, len(eye.heights))
    for i in range(count):
        distance = eye.table.origin + i / STEPS
        inside = half <= i < count - half and distance >= 0.5  # so that all that is asked for is in the table
        first, last = columns[i] - 0.5, columns[i + 1] + 0.5
        kind = 2
        if eye.prefilter == AREA and inside:
            inner, outer = columns[i - half], columns[i + 1 + half]
            if columns[i + 1] - inner > 0.5 or outer - columns[i] > 0.5:
                # An interval of length n or less meets n + 1 columns or less.
                first, last = min(first, inner), max(last, outer)
                longest = max(outer - inner, max(outer - columns[i], columns[i + 1] - inner) + 0.5)
                kind = 1 - floor_of(-longest)
        tallest = np.int64(0)
        for column in range(floor_of(first), -floor_of(-last)):
            tallest = max(tallest, eye.heights[column_of(view, column)])
        short = arc_of(eye.prefilter, distance) * tallest <= 1.0
        eye.kinds[i] = kind if inside and short and kind <= MOST else 0


@inlined
def find_taps(view: View, x: Int, y: Int, taps: Taps) -> None:
    """Finds the cells of the pixels x .. x + RUN - 1 of a row; those beyond the screen read something, too."""
    dy = y + 0.5 - view.y
    for i in range(RUN):
        dx = x + i + 0.5 - view.x
        taps.distances[i] = np.sqrt(dx * dx + dy * dy)
        taps.turns[i] = turn_of(dx, dy)
    most = np.int32(0)
    for i in range(RUN):
        distance = taps.distances[i]
        column = value_at(view.curve, distance)
        kind = np.int32(view.kinds[min(max(np.int64((distance - view.curve.origin) * STEPS), 0), view.parts - 1)])
        first, last = column - 0.5, column + 0.5
        if kind != 2:
            first, last = span_of(view, distance, column)
        taps.firsts[i], taps.lasts[i], taps.kinds[i] = first, last, kind
        most = max(most, kind)
    for step in range(most):
        for i in range(RUN):
            first, last = taps.firsts[i], taps.lasts[i]
            side = floor_of(first) + step
            share = max(min(last, side + 1.0) - max(first, np.float64(side)), 0.0) / (last - first)
            inside = column_of(view, side)
            height, offset = view.heights[inside], view.offsets[inside]
            row_y = (taps.turns[i] + turned_by(view, side)) * height - 0.5
            row = floor_of(row_y)
            along = row_y - row
            row = row + height if row < 0 else row
            row = row - height if row >= height else row
            taps.ones[step * RUN + i] = offset + row
            taps.twos[step * RUN + i] = offset + (row + 1 if row + 1 < height else 0)
            taps.above[step * RUN + i] = share * (1.0 - along)
            taps.below[step * RUN + i] = share * along
