"""One pass of the à-trous filter on a polar raster, forwards; images are transposed.

What is done is what :mod:`fovden.filters.kernels.blend` does. Where a tap's column has the height of the cells' own, it
is read as it lies, but for the blocks at the ends, whose taps go around; else a strip is made of it
(:mod:`fovden.filters.kernels.columns`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.filters.kernels.blend import (
    ALL_SCALES,
    ALL_SUMS,
    BLOCKS,
    CHANNELS,
    MASK,
    SCALES,
    SUMS,
    Guides,
    Passes,
    View,
    finish_block,
    scale_block,
    view_of,
)
from fovden.filters.kernels.columns import Beside, aligned, find_rows, read_strip
from fovden.filters.kernels.lanes import WIDTH, ZERO, opaque
from fovden.filters.kernels.pairs import SCRAP
from fovden.filters.kernels.weigh import add_taps
from fovden.jit import Int, inlined, kernel
from fovden.simd import advanced, pointer_to, stack_floats


class Desk(NamedTuple):
    """Where a thread makes strips: two of them, of cells and of what they look at, with channels in between.

    The arrays are kept here, and pointers to them only made where they are used, or Numba would free them before.

    Attributes:
        strips: Cells first, then what they look at, channel by channel.
        apart: Distance of channels.
        there: Where row 0 of what they look at is.
        rows: Room for its rows' numbers.
    """

    strips: Any
    apart: Int
    there: Int
    rows: Any


@inlined
def desk_for(channels: Int, places: Int, step: Int) -> Desk:
    """A desk for strips of some places.

    Row 0 begins a cache line, and channels are never a multiple of 4 KiB apart: all would meet in one set of a cache.
    """
    around = -(-2 * step // WIDTH) * WIDTH
    longest = (-(-places // WIDTH) * WIDTH + 2 * around) | WIDTH
    strips = aligned(np.empty(channels * 2 * longest + WIDTH, np.float32))
    return Desk(strips, 2 * longest, longest + around, np.empty(longest, np.int64))


@inlined
def read_guides(
    view: View, column: Int, rows: Any, count: Int, height: Int, agrees: bool, desk: Desk, place: Int
) -> None:
    """Reads radiance, normal, position and mask of a strip to a place of the desk; see ``read_strip``."""
    plane, at, apart = view.plane, column * view.width, desk.apart
    out = advanced(pointer_to(desk.strips), place)
    for g in range(3):
        guide = advanced((view.image, view.normal, view.position)[g], at)
        read_strip(guide, plane, 3, rows, count, height, agrees, advanced(out, 3 * g * apart), apart)
    mask = advanced(view.mask, at)
    read_strip(mask, plane, 1, rows, count, height, agrees, advanced(out, MASK * apart), apart)


@inlined
def on_desk(desk: Desk, view: View) -> View:
    """The strips in place of a view's channels."""
    strips, apart = pointer_to(desk.strips), desk.apart
    return View(
        strips, advanced(strips, MASK * apart), view.known, advanced(strips, 3 * apart), advanced(strips, 6 * apart),
        view.labels, view.factors, view.has_factors, view.height, view.width, apart,
    )  # fmt: skip


@inlined
def inner_blocks(first: Int, blocks: Int, height: Int, step: Int) -> Any:
    """Of the blocks from row ``first`` on, the first and the end of those whose taps do not go around."""
    begin: Int = min(blocks, -(-max(0, 2 * step - first) // WIDTH))
    end: Int = min(blocks, (height - 2 * step - first) // WIDTH)
    return begin, max(begin, end)


@inlined
def add_column(
    view: View, desk: Desk, beside: Beside, tap: Int, column: Int, first: Int, blocks: Int, step: Int, taps: Any,
    all_scales: Any, all_sums: Any, scrap: Any,
) -> None:  # fmt: skip
    """Adds the five taps that stand in one column to some blocks, from row ``first`` on."""
    other, turned, height = beside.column[tap, column], beside.turned[tap, column], beside.heights[column]
    its_height = beside.heights[other]
    agrees = its_height == height
    inner, end = inner_blocks(first, blocks, height, step) if agrees and turned == 0 else (blocks, blocks)
    for part in range(3):
        start, stop = (0, inner, end)[part], (inner, end, blocks)[part]
        if start == stop:
            continue
        top, lies = start * WIDTH, part == 1
        length = min(stop * WIDTH, height - first) - top + 4 * step
        if not lies:
            desk.rows[0] = first + top
            read_guides(view, column, desk.rows, (stop - start) * WIDTH, view.width, True, desk, top)
            find_rows(first + top - 2 * step, 1 if agrees else length, height, its_height, turned, desk.rows)
            place = desk.there + top - 2 * step
            read_guides(view, other, desk.rows, length, its_height, agrees, desk, place)
        seen = view if lies else on_desk(desk, view)
        own, its = (column * view.width + first, other * view.width + first) if lies else (np.int64(0), desk.there)
        for counter in range(start, stop):
            block = opaque(counter)
            x = block * WIDTH
            add_taps(
                seen.image, seen.normal, seen.position, seen.mask, seen.plane, own + x, its + x, step,
                advanced(taps, 5 * tap), advanced(all_scales, SCALES * block), advanced(all_sums, SUMS * block),
                scrap, WIDTH,
            )  # fmt: skip


@kernel
def blend_columns(
    start: Int,
    stop: Int,
    beside: Beside,
    runs: Any,
    step: Int,
    passes: Passes,
    guides: Guides,
    image: Any,
    mask: Any,
    known: Any,
    out: Any,
    next_mask: Any,
    fills: bool,
    totals: Any,
) -> None:
    """Filters the blocks of the runs start .. stop - 1, which are parts of columns.

    Args:
        start: First run.
        stop: End of the runs.
        beside: Where the taps stand.
        runs: Column, counted through all views, first block, end of the blocks and number of the pass, (n, 4).
        step: Distance between taps.
        passes: The passes; their kernels are transposed, too.
        guides: What else is looked at.
        image: As in :func:`fovden.filters.kernels.blend_rows.blend_runs`, transposed, like what follows.
        mask: As there.
        known: As there.
        out: As there.
        next_mask: As there.
        fills: As there.
        totals: As there.
    """
    desk = desk_for(CHANNELS, BLOCKS * WIDTH, step)
    all_sums, all_scales, scrap = stack_floats(ALL_SUMS), stack_floats(ALL_SCALES), stack_floats(SCRAP)
    saves = totals.shape[0] > 0
    for run in range(start, stop):
        which, column = np.int64(runs[run, 0]) // image.shape[2], np.int64(runs[run, 0]) % image.shape[2]
        number, end = np.int64(runs[run, 3]), np.int64(runs[run, 2])
        view, height = view_of(which, image, mask, known, guides), beside.heights[column]
        plane = view.plane
        inverse, taps = advanced(pointer_to(passes.inverse), 3 * number), advanced(pointer_to(passes.taps), 25 * number)
        view_out = advanced(pointer_to(out), 3 * which * plane)
        view_next = advanced(pointer_to(next_mask), which * plane)
        view_totals = advanced(pointer_to(totals), which * plane)
        for left in range(np.int64(runs[run, 1]), end, BLOCKS):
            blocks: Int = min(BLOCKS, end - left)
            first = left * WIDTH
            at = column * view.width + first
            for k in range(blocks * SUMS):
                all_sums[k] = ZERO
            for block in range(blocks):
                x, scales = block * WIDTH, advanced(all_scales, SCALES * block)
                scale_block(
                    inverse, view.known, view.factors, view.has_factors, plane, at + x, first + x, height, scales
                )  # fmt: skip
            for tap in range(5):
                add_column(view, desk, beside, tap, column, first, blocks, step, taps, all_scales, all_sums, scrap)
            for block in range(blocks):
                x = block * WIDTH
                finish_block(
                    advanced(all_sums, SUMS * block), view.image, view.known, view.labels, plane, at + x, first + x,
                    height, passes.labels[number], view_out, view_next, fills, view_totals, saves,
                )  # fmt: skip
