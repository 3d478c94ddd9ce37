"""Rows of an image that lie ``step`` apart, as a thread has them before it: the five that the taps of a row stand in.

A thread works through rows in this order, so that each is copied once and looked at five times. Here it begins and ends
with places without weight, as many as taps reach: no tap has to ask where the image ends. And channels begin in
different sets of a cache, whatever the image's width.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fovden.filters.kernels.columns import copy_floats
from fovden.filters.kernels.lanes import WIDTH
from fovden.jit import Int, inlined
from fovden.simd import advanced, stack_words

SLOTS = 5


class Rows(NamedTuple):
    """Rows before a thread: pointers and numbers, since a tuple of arrays would be counted at every call.

    Attributes:
        floats: Slots for five rows, channel by channel; float32, aligned to 64 bytes.
        channels: Number of channels.
        apart: Distance of channels.
        left: Which pixel of a row is at the first place of a channel: before the image, less than 0.
        step: Distance of rows in the image.
        held: Which row each slot has, counted through all views, int64, (5); -1 for none.
    """

    floats: Any
    channels: Int
    apart: Int
    left: Int
    step: Int
    held: Any


def in_order(runs: NDArray[np.int32], step: int, rows: int) -> NDArray[np.int32]:
    """Sorts runs by pass and view, and then so that rows follow each other that lie a step apart.

    Args:
        runs: Row, counted through all views, first block, end of the blocks and number of the pass, (n, 4).
        step: Distance between taps.
        rows: Rows of a view.

    Returns:
        The runs.
    """
    view, row = np.divmod(runs[:, 0], rows)
    return runs[np.lexsort((runs[:, 1], row, row % step, view, runs[:, 3]))]


def floats_for(blocks: int, step: int, channels: int) -> int:
    """How many numbers :func:`rows_for` takes at most, for rows of some blocks."""
    lines = blocks + 2 * -(-2 * step // WIDTH) + 1
    return (SLOTS * channels * lines + 1) * WIDTH


@inlined
def reach_of(step: Int) -> Int:
    """How many blocks taps reach."""
    return -(-2 * step // WIDTH)


@inlined
def extent_of(runs: Any, start: Int, stop: Int) -> Any:
    """The first block and the end of the blocks of some runs, taken together."""
    first, end = np.int64(runs[start, 1]), np.int64(runs[start, 2])
    for run in range(start + 1, stop):
        first, end = min(first, np.int64(runs[run, 1])), max(end, np.int64(runs[run, 2]))
    return first, end


@inlined
def rows_for(floats: Any, channels: Int, first: Int, end: Int, step: Int) -> Rows:
    """Room for the rows of runs between two blocks, and for what taps reach beside them."""
    reach, held = reach_of(step), stack_words(SLOTS)
    lines = end - first + 2 * reach
    lines |= 1  # a power of two, and all channels would begin in one set of a cache
    for slot in range(SLOTS):
        held[slot] = np.int64(-1)
    return Rows(floats, channels, lines * WIDTH, (first - reach) * WIDTH, step, held)


@inlined
def slot_of(rows: Rows, row: Int) -> Int:
    """Where the first channel of a row begins."""
    return row // rows.step % SLOTS * rows.channels * rows.apart


@inlined
def is_new(rows: Rows, row: Int, name: Int) -> bool:
    """Whether a row has to be copied first: it is not there under the name by which all views' rows are told apart."""
    slot = row // rows.step % SLOTS
    if rows.held[slot] == name:
        return False
    rows.held[slot] = name
    return True


@inlined
def copy_row(source: Any, plane: Int, channels: Int, row: Int, width: Int, rows: Rows, channel: Int) -> None:
    """Copies a row of some channels of a view to those from ``channel`` on; what lies beside the image becomes 0."""
    before: Int = max(-rows.left, 0)
    end: Int = min(width - rows.left, rows.apart)
    for k in range(channels):
        out = advanced(rows.floats, slot_of(rows, row) + (channel + k) * rows.apart)
        for x in range(before):
            out[x] = np.float32(0)
        begin = k * plane + row * width + rows.left + before
        copy_floats(advanced(source, begin), advanced(out, before), end - before)
        for x in range(end, rows.apart):
            out[x] = np.float32(0)
