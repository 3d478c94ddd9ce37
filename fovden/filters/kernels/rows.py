"""Rows of an image that lie ``step`` apart, as a thread has them before it: the five that the taps of a row stand in.

A thread works through rows in this order, so that each is copied once and looked at five times, and of each the blocks
that its runs reach. Here it begins and ends with places without weight, as many as taps reach: no tap has to ask where
the image ends. And channels begin in different sets of a cache, whatever the image's width.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fovden.filters.kernels.lanes import WIDTH, copy_floats
from fovden.jit import Int, inlined
from fovden.simd import advanced, stack_words

SLOTS = 5
HELD = 3 * SLOTS


class Rows(NamedTuple):
    """Rows before a thread: pointers and numbers, since a tuple of arrays would be counted at every call.

    Attributes:
        floats: Slots for five rows, channel by channel; float32, aligned to 64 bytes.
        channels: Number of channels.
        apart: Distance of channels.
        left: Which pixel of a row is at the first place of a channel: before the image, less than 0.
        step: Distance of rows in the image.
        held: Which row each slot has, counted through all views, -1 for none, and the first block and the end of those
            that were asked for last, int64, (3, 5).
        there: Above 0 for the blocks that each slot has of its row, float32, (5, apart / 16).
    """

    floats: Any
    channels: Int
    apart: Int
    left: Int
    step: Int
    held: Any
    there: Any


def in_order(runs: NDArray[np.int32], step: int, rows: int) -> NDArray[np.int32]:
    """Sorts runs by pass and view, and then so that rows follow each other that lie a step apart.

    Where a row has several runs, as beside the hole of a ring, the first ones of all rows come before the second ones:
    what a thread looks at is near each other.

    Args:
        runs: Row, counted through all views, first block, end of the blocks and number of the pass, (n, 4); those of
            a row follow each other, from left to right.
        step: Distance between taps.
        rows: Rows of a view.

    Returns:
        The runs.
    """
    view, row = np.divmod(runs[:, 0], rows)
    begins = np.diff(runs[:, [0, 3]], axis=0, prepend=-1).any(1)
    places = np.arange(len(runs))
    which = places - np.maximum.accumulate(np.where(begins, places, 0))  # of the runs of its row
    return runs[np.lexsort((row, row % step, which, view, runs[:, 3]))]


def floats_for(blocks: int, step: int, channels: int) -> int:
    """How many numbers :func:`rows_for` takes at most, for rows of some blocks."""
    lines = blocks + 2 * -(-2 * step // WIDTH) + 1
    return ((SLOTS * channels + 1) * lines + 1) * WIDTH


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
    reach, held = reach_of(step), stack_words(HELD)
    lines = end - first + 2 * reach
    lines |= 1  # a power of two, and all channels would begin in one set of a cache
    for slot in range(SLOTS):
        held[slot] = np.int64(-1)
    apart = lines * WIDTH
    return Rows(advanced(floats, apart), channels, apart, (first - reach) * WIDTH, step, held, floats)


@inlined
def behind(rows: Rows) -> Any:
    """What follows in memory."""
    return advanced(rows.floats, SLOTS * rows.channels * rows.apart)


@inlined
def slot_of(rows: Rows, row: Int) -> Int:
    """Where the first channel of a row begins."""
    return row // rows.step % SLOTS * rows.channels * rows.apart


@inlined
def is_there(rows: Rows, row: Int, name: Int, first: Int, end: Int) -> bool:
    """Whether a row's blocks have been asked for, by the name that all views' rows are told apart by; they are now."""
    slot, lines = row // rows.step % SLOTS, rows.apart // WIDTH
    if rows.held[slot] != name:
        rows.held[slot] = name
        for block in range(slot * lines, (slot + 1) * lines):
            rows.there[block] = np.float32(0)
    elif rows.held[SLOTS + slot] <= first and end <= rows.held[2 * SLOTS + slot]:
        return True
    rows.held[SLOTS + slot], rows.held[2 * SLOTS + slot] = first, end
    return False


@inlined
def next_missing(rows: Rows, row: Int, block: Int, end: Int) -> Any:
    """The next blocks of a row that are not there, first and end, from one on; they are marked as if they were."""
    begin = row // rows.step % SLOTS * (rows.apart // WIDTH) - rows.left // WIDTH
    while block < end and rows.there[begin + block] > np.float32(0):
        block += 1
    stop = block
    while stop < end and not rows.there[begin + stop] > np.float32(0):
        rows.there[begin + stop] = np.float32(1)
        stop += 1
    return block, stop


@inlined
def copy_blocks(
    source: Any, plane: Int, channels: Int, row: Int, width: Int, rows: Rows, channel: Int, first: Int, end: Int
) -> None:
    """Copies blocks of a row, of some channels of a view to those from ``channel`` on; 0 is what lies beside."""
    left, right = first * WIDTH, end * WIDTH
    begin, stop = min(max(left, 0), right), max(min(right, width), left)
    for k in range(channels):
        out = advanced(rows.floats, slot_of(rows, row) + (channel + k) * rows.apart - rows.left)
        for x in range(left, begin):
            out[x] = np.float32(0)
        copy_floats(advanced(source, k * plane + row * width + begin), advanced(out, begin), max(stop - begin, 0))
        for x in range(max(begin, stop), right):
            out[x] = np.float32(0)
