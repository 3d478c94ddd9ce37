"""How the columns of a polar raster lie beside each other, and the strips that make them agree.

Here an image is transposed, (v, c, w, p): columns of the raster, which are distances, are rows of memory, and angles
run along them. A column has as many cells as its height says; the rest, up to p, is never read.

A *strip* is a column as another one sees it that has n rows: row j of the strip is the row of the column that holds the
angle of the other's row j. Strips wrap, and go on before row 0 and after row n - 1 as far as taps reach. So the taps of
a row of cells are shifted strips, whatever the heights.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from fovden.filters.kernels.lanes import WIDTH, copy_floats
from fovden.jit import Int, inlined, kernel, vectorised
from fovden.simd import I32, I64, advanced, pointer_to

BOTH, FORTH, BACK = 0, 1, 2


class Columns(NamedTuple):
    """The columns of a raster.

    Attributes:
        heights: Number of rows of each, int64, (w).
        rotates: Whether what lies before column 0 is the column on the other side, half a turn away.
    """

    heights: NDArray[np.int64]
    rotates: bool

    def beside(self, step: int) -> Beside:
        """The columns that taps stand in."""
        width = len(self.heights)
        column = np.arange(width) + step * np.arange(-2, 3)[:, None]
        turned = (column < 0) & self.rotates
        inside = np.where(turned, -1 - column, column)
        return Beside(self.heights, np.clip(inside, 0, width - 1), turned.astype(np.int64))

    def pairs(self, step: int, active: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of columns of which one has read the other, for :func:`gather_columns`.

        Where two columns of one height are each other's taps, one pair serves both directions. Elsewhere a column has a
        pair for what it has read, and another for what has been read of it.

        Args:
            step: Distance between taps.
            active: Which columns have filtered anything, (w).

        Returns:
            The pairs (column, other, turned, number of the tap, kind), sorted by column, those in which the column
            itself is read last, (n, 5); and where those of each column begin that has any, and end.
        """
        beside = self.beside(step)
        tap, own = np.indices(beside.column.shape)
        other, turned = beside.column, beside.turned
        alike = (own + (tap - 2) * step == other) & (self.heights[own] == self.heights[other])
        there = [own, other, turned, tap, np.where(alike, BOTH, FORTH)]
        back = [other, own, turned, 4 - tap, np.full_like(tap, BACK)]
        read = active[own] | (alike & active[other])
        found = np.concatenate(
            [np.stack(there, -1)[read], np.stack(back, -1)[active[own] & ~alike]]  # C order: tap by tap
        )
        found = found[np.lexsort((found[:, 4] == BACK, found[:, 0]))]
        first = np.flatnonzero(np.diff(found[:, 0], prepend=-1))
        return found, np.append(first, len(found))


class Beside(NamedTuple):
    """Where the taps of one distance stand.

    Attributes:
        heights: Number of rows of each column, (w).
        column: The column of each of the five taps, (5, w).
        turned: 1 where that is half a turn away, (5, w).
    """

    heights: Any
    column: Any
    turned: Any


@intrinsic
def transpose_block_vector(context: Any, source: Any, pitch: Any, target: Any, target_pitch: Any) -> Any:
    """Transposes sixteen rows of sixteen places."""
    element = source.dtype

    def generate(backend: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, pitch, target, target_pitch = arguments
        kind = ir.VectorType(backend.get_data_type(element), WIDTH)

        def place(pointer: Any, distance: Any, row: int) -> Any:
            offset = builder.mul(distance, ir.Constant(I64, row))
            return builder.bitcast(builder.gep(pointer, [offset]), kind.as_pointer())

        rows = [builder.load(place(source, pitch, row), align=1) for row in range(WIDTH)]
        for apart in (1, 2, 4, 8):  # swaps the corners of squares of twice that size
            upper = [j + WIDTH - apart if j & apart else j for j in range(WIDTH)]
            lower = [j + WIDTH if j & apart else j + apart for j in range(WIDTH)]
            masks = [ir.Constant(ir.VectorType(I32, WIDTH), each) for each in (upper, lower)]
            for row in range(WIDTH):
                if not row & apart:
                    pair = rows[row], rows[row + apart]
                    rows[row], rows[row + apart] = (builder.shuffle_vector(*pair, mask) for mask in masks)
        for row in range(WIDTH):
            builder.store(rows[row], place(target, target_pitch, row), align=1)
        return backend.get_dummy_value()

    return types.none(source, types.int64, target, types.int64), generate


@inlined
def transpose_block_plain(source: Any, pitch: Int, target: Any, target_pitch: Int) -> None:
    """:data:`transpose_block_vector`, one place after the other."""
    for row in range(WIDTH):
        for place in range(WIDTH):
            target[row * target_pitch + place] = source[place * pitch + row]


transpose_block = transpose_block_vector if vectorised() else transpose_block_plain


@kernel
def transpose(start: Int, stop: Int, source: Any, heights: Any, back: bool, target: Any) -> None:
    """Transposes planes, (n, h, w) to (n, w, p) or ``back``: bands of sixteen rows of the target, of all planes.

    What lies below the columns' heights becomes 0.
    """
    rows, places = target.shape[1], target.shape[2]
    pitch, bands = source.shape[2], -(-rows // WIDTH)
    for item in range(start, stop):
        n, top = item // bands, item % bands * WIDTH
        height = min(WIDTH, rows - top)
        begin = advanced(pointer_to(source), n * source.shape[1] * pitch + top)
        out = advanced(pointer_to(target), (n * rows + top) * places)
        for left in range(0, places, WIDTH):
            right = min(left + WIDTH, places)
            first, end, bottom = (left, right, top + height) if back else (top, top + height, right)
            shortest = bottom
            for column in range(first, end):
                shortest = min(shortest, heights[column])
            if height == WIDTH and left + WIDTH == right and shortest == bottom:
                transpose_block(advanced(begin, left * pitch), pitch, advanced(out, left), places)
                continue
            for r in range(height):
                for k in range(left, right):
                    exists = top + r < heights[k] if back else k < heights[top + r]
                    out[r * places + k] = begin[k * pitch + r] if exists else target.dtype.type(0)


@inlined
def find_rows(first: Int, count: Int, own: Int, other: Int, turned: Int, rows: Any) -> None:
    """Writes which rows of a column of ``other`` rows hold the angles of rows first, first + 1, ... of one of ``own``.

    Row j' = floor(((2 j + 1) + turned own) other / (2 own)) mod other, by adding: a division for each would cost more.
    """
    numerator = (2 * (first % own) + 1 + turned * own) * other
    row, rest = numerator // (2 * own) % other, numerator % (2 * own)
    whole, part = other // own, 2 * (other % own)
    for k in range(count):
        rows[k] = row
        row += whole
        rest += part
        if rest >= 2 * own:
            rest -= 2 * own
            row += 1
        if row >= other:
            row -= other


@inlined
def read_strip(source: Any, plane: Int, channels: Int, rows: Any, count: Int, height: Int, agrees: bool, out: Any,
               out_plane: Int) -> None:  # fmt: skip
    """Reads the rows of a column, of some channels.

    Args:
        source: The column in the first channel.
        plane: Distance of channels there.
        channels: Their number.
        rows: Which rows, as of :func:`find_rows`; the first is enough where the heights agree.
        count: How many.
        height: Rows of the column.
        agrees: Whether as many as those of whoever sees it: then they follow each other.
        out: Receives them.
        out_plane: Distance of channels there.
    """
    for k in range(channels):
        base, to = k * plane, k * out_plane
        if agrees:
            done, row = np.int64(0), rows[0]
            while done < count:
                length = min(count - done, height - row)
                copy_floats(advanced(source, base + row), advanced(out, to + done), length)
                done, row = done + length, np.int64(0)
        else:
            for place in range(count):
                out[to + place] = source[base + rows[place]]


@inlined
def clear_strip(channels: Int, count: Int, out: Any, out_plane: Int) -> None:
    """Writes zeros instead."""
    for k in range(channels):
        for place in range(count):
            out[k * out_plane + place] = np.float32(0)


@inlined
def aligned(floats: Any) -> Any:
    """What of an array begins at a cache line; up to fifteen numbers are left out."""
    return floats[(-np.int64(floats.ctypes.data) % 64) // 4 :]
