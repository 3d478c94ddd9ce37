"""What two pixels that are each other's taps have in common, kept by the first of them for the second.

Where pixels share the widths of their pass, and its kernel is the same from either side, so is the power of two that
they weigh each other with, to the bit. A row keeps those of the taps behind it: two in the row itself and five in each
of the next two. Rows that come later read them there, shifted, for the taps before them, and take no power of their
own: twelve remain of the twenty-four around a pixel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.filters.kernels.lanes import WIDTH
from fovden.filters.kernels.rows import Rows, reach_of
from fovden.jit import Int, inlined
from fovden.simd import advanced, stack_words

NEXT, AFTER_NEXT, TAPS_BEHIND = 2, 7, 12
"""Lines of the taps in the next row, from left to right, and of those in the one after; first come those beside."""

KEPT_ROWS = 3  # the two before a row, and its own
SCRAP = 10 * WIDTH  # room for what nobody reads


class Kept(NamedTuple):
    """What rows have kept: pointers and numbers.

    Attributes:
        floats: Lines of three rows, each as long as a channel of :class:`Rows`; float32, aligned to 64 bytes.
        size: Length of a row's lines together.
        scrap: Room for two numbers of five taps that nobody reads.
        rows: Which rows these are, counted through all passes and views, int64, (3); -1 for none.
        ready: Above 0 for the blocks of theirs that have kept all, float32, (3, b).
        blocks: Number of blocks of a row of the image, b.
    """

    floats: Any
    size: Int
    scrap: Any
    rows: Any
    ready: Any
    blocks: Int


def line_of(i: int, beside: bool) -> int:
    """In which of their lines the tap i steps to the right has kept what it has in common with a pixel.

    In a row before, from where it is the other way round; or in the pixel's own, where the first line holds what is a
    step apart.
    """
    return abs(i) - 1 if beside else 2 - i


line_of_plain = inlined(line_of)


def floats_to_keep(blocks: int, step: int, numbers: int) -> int:
    """How many numbers :func:`kept_for` takes at most, for rows of some blocks."""
    lines = blocks + 2 * -(-2 * step // WIDTH) + 1
    return KEPT_ROWS * numbers * TAPS_BEHIND * lines * WIDTH + SCRAP + KEPT_ROWS * blocks


@inlined
def kept_for(floats: Any, numbers: Int, end: Int, rows: Rows, blocks: Int) -> Kept:
    """Room for some numbers of each tap of the blocks up to ``end``. What lies beside the image is 0."""
    apart, names = rows.apart, stack_words(KEPT_ROWS)
    size = numbers * TAPS_BEHIND * apart
    before, behind = reach_of(rows.step) * WIDTH, end * WIDTH - rows.left
    for line in range(0, KEPT_ROWS * size, apart):
        for k in range(before):
            floats[line + k] = np.float32(0)
        for k in range(behind, apart):
            floats[line + k] = np.float32(0)
    for slot in range(KEPT_ROWS):
        names[slot] = np.int64(-1)
    scrap = advanced(floats, KEPT_ROWS * size)
    return Kept(floats, size, scrap, names, advanced(scrap, SCRAP), blocks)


@inlined
def slot_in(kept: Kept, order: Int) -> Int:
    """Where the lines of a row begin, the ``order``-th of those that lie a step apart."""
    return order % KEPT_ROWS * kept.size


@inlined
def begin_row(kept: Kept, order: Int, name: Int) -> None:
    """Makes room for a row, unless it has some; ``name`` tells the rows of all passes and views apart."""
    slot = order % KEPT_ROWS
    if kept.rows[slot] != name:
        kept.rows[slot] = name
        for block in range(kept.blocks):
            kept.ready[slot * kept.blocks + block] = np.float32(0)


@inlined
def is_ready(kept: Kept, order: Int, name: Int, first: Int, last: Int) -> bool:
    """Whether the blocks first .. last of a row have kept all; outside the image is nothing to keep."""
    slot = order % KEPT_ROWS
    if order < 0 or kept.rows[slot] != name:
        return False
    for block in range(max(first, 0), min(last + 1, kept.blocks)):
        if kept.ready[slot * kept.blocks + block] == np.float32(0):
            return False
    return True
