"""A stack of à-trous passes on compiled kernels, forwards and backwards: float32, on the CPU.

The kernels take tensors as they are; a thread copies for itself the rows that it looks at. A pass works on runs of
blocks of sixteen pixels that hold a label, so it costs what it covers. Passes of one level, on different labels, read
the same image. What the way back needs goes on tape while a pass writes: the sums of the pixels' weights, and their old
values, which the pass before has written there where all passes work on the whole image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fovden.filters._arrays import array_of, copied, copy_to, with_scratch, zeros
from fovden.filters.kernels.back import Gradients, prepare_runs, reduce_runs, scale_runs
from fovden.filters.kernels.blend import Guides, Passes
from fovden.filters.kernels.blend_rows import blend_runs, scratch_for
from fovden.filters.kernels.columns import Columns
from fovden.filters.kernels.gather_rows import gather_runs, scratch_to_gather
from fovden.filters.kernels.lanes import WIDTH
from fovden.filters.kernels.polar import blend_columns
from fovden.filters.kernels.polar_back import gather_columns
from fovden.filters.kernels.rows import in_order
from fovden.filters.kernels.runs import copy_runs, mark_blocks, runs_of, runs_of_rows, spread
from fovden.filters.kernels.shares import Shares
from fovden.filters.taps import B3_SPLINE
from fovden.memory import zeros_on_large_pages
from fovden.parallel import run

__all__ = ["Blended", "Inputs", "Returned", "blend_stack", "return_gradients"]

TILE = 32
"""Rows that a thread takes at a time, of some ten microseconds each. The first two find nothing kept for them."""

COLUMNS_TILE = 4
"""Columns on the way back: those at the borders of a polar raster have been read by many."""


@dataclass(frozen=True)
class Inputs:
    """What a stack of passes reads.

    Attributes:
        radiance: Radiance, shape (v, 3, h, w).
        normal: Normals, the same shape.
        position: Positions, the same shape.
        mask: Weight of each pixel as a tap, shape (v, 1, h, w).
        known: Which pixels have a value of their own, bool, shape (v, 1, h, w); ``None`` means whose mask is above 0.
        region: Labels from 0 to 30, bytes, shape (v, 1, h, w); ``None`` means 0.
        inverse: Inverse squared widths of radiance, normal and position in each pass, shape (p, 3).
        factors: What these are multiplied by at each pixel, shape (v, 3, h, w); ``None`` means 1.
        kernels: Kernel of each pass, positive, shape (p, 5, 5); ``None`` means the B3 spline.
        steps: Distance between the taps of each pass.
        labels: Label of the pixels that each pass works on.
        levels: Number of each pass's level; neighbours of one level read the same image.
        fill: Whether a filled pixel counts as a tap, with weight 1, from the next level on.

    Example:
        >>> flat, row = torch.zeros(1, 3, 4, 4), torch.ones(1, 3)
        >>> Inputs(flat, flat, flat, torch.ones(1, 1, 4, 4), None, None, row, None, None, (1,), (0,), (0,), False).fill
        False
    """

    radiance: Tensor
    normal: Tensor
    position: Tensor
    mask: Tensor
    known: Tensor | None
    region: Tensor | None
    inverse: Tensor
    factors: Tensor | None
    kernels: Tensor | None
    steps: Sequence[int]
    labels: Sequence[int]
    levels: Sequence[int]
    fill: bool

    def arrays(self) -> tuple[Passes, Guides]:
        """Returns the kernels' view of them.

        Example:
            >>> flat, row, mask = torch.zeros(1, 3, 4, 4), torch.ones(1, 3), torch.ones(1, 1, 4, 4)
            >>> inputs = Inputs(flat, flat, flat, mask, None, None, row, None, None, (1,), (0,), (0,), False)
            >>> passes, _ = inputs.arrays()
            >>> bool(passes.taps[0, 12] == np.log2(np.float32(9 / 64)))
            True
        """
        count, plane = len(self.steps), self.mask
        spline = np.outer(B3_SPLINE, B3_SPLINE).astype(np.float32).reshape(1, 25)
        kernels = np.tile(spline, (count, 1)) if self.kernels is None else array_of(self.kernels).reshape(count, 25)
        labels = np.zeros(plane.shape, np.uint8) if self.region is None else array_of(self.region)
        factors = plane.new_empty(0, 3, 1, 1) if self.factors is None else self.factors
        return (
            Passes(
                np.asarray(self.labels, np.int64),
                array_of(self.inverse),
                np.log2(kernels).astype(np.float32),
            ),
            Guides(array_of(self.normal), array_of(self.position), labels, array_of(factors)),
        )


class Blended(NamedTuple):
    """The outcome of a stack.

    Attributes:
        image: Radiance, shape (v, 3, h, w).
        known: Which pixels have a value now, bool, shape (v, 1, h, w).
        mask: Weight of each pixel as a tap now, shape (v, 1, h, w).
        tape: What :func:`return_gradients` needs, shape (levels, v, 4 or 5, h, w); of no levels if not wanted. Of each
            level, the radiance before, unless that is the input, the sums of weights and, where it is filled, the mask.
    """

    image: Tensor
    known: Tensor
    mask: Tensor
    tape: Tensor


class Returned(NamedTuple):
    """Gradients, in the order of :class:`Inputs`; ``None`` where there is no such input, or it was not wanted."""

    radiance: Tensor
    normal: Tensor | None
    position: Tensor | None
    mask: Tensor | None
    inverse: Tensor
    factors: Tensor | None
    kernels: Tensor | None


def blend_stack(inputs: Inputs, *, save: bool = False, columns: Columns | None = None) -> Blended:
    """Runs the passes.

    Args:
        inputs: What they read.
        save: Whether to keep what the way back needs.
        columns: The columns of a polar raster, which has its images transposed
            (:mod:`fovden.filters.fused_polar`); ``None`` for the screen.

    Returns:
        The outcome.

    Example:
        >>> flat, row, mask = torch.zeros(1, 3, 4, 4), torch.ones(1, 3), torch.ones(1, 1, 4, 4)
        >>> two = Inputs(flat + 2, flat, flat, mask, None, None, row, None, None, (2, 1), (0, 0), (0, 1), False)
        >>> blend_stack(two).image.mean()
        tensor(2.)
    """
    passes, guides = inputs.arrays()
    image, mask = inputs.radiance.contiguous(), inputs.mask.contiguous()
    known = np.array(array_of(mask) > 0 if inputs.known is None else inputs.known.numpy(), np.float32, order="C")
    levels = list(_levels(inputs, columns))
    channels = 5 if inputs.fill else 4
    tape = zeros_on_large_pages(len(levels) if save else 0, len(image), channels, *image.shape[2:])
    nothing = np.empty((0, channels, *image.shape[2:]), np.float32)
    rows, width = image.shape[2:]
    spare: Tensor | None = None
    is_kept = True  # the image: it is not ours to write to, and need not be kept otherwise
    for number, level in enumerate(levels):
        ahead = levels[number + 1] if number + 1 < len(levels) else None
        on_tape = save and level.is_whole and ahead is not None and ahead.is_whole
        if on_tape:  # what the next level reads is what the way back needs of it
            after = tape[number + 1]
        elif spare is not None:
            after = spare
        else:
            after = torch.empty_like(inputs.radiance, memory_format=torch.contiguous_format)
            if not level.is_whole:
                copy_to(after, image)
        next_mask = torch.from_numpy(copied(mask)) if inputs.fill else mask
        if save and inputs.fill:
            tape[number, :, 4:] = mask
        runs = in_order(level.runs, level.step, rows) if columns is None else level.runs
        arguments = (
            runs, level.step, passes, guides, array_of(image), array_of(mask), known, array_of(after),
            array_of(next_mask), inputs.fill, array_of(tape[number]) if save else nothing,
            save and not (level.is_whole and is_kept),
        )  # fmt: skip
        if columns is None:
            scratch = scratch_for(-(-width // WIDTH), level.step)
            run(with_scratch(blend_runs, scratch), len(runs), arguments, tile=runs_of_rows(TILE, runs))
        else:
            run(blend_columns, len(runs), (columns.beside(level.step), *arguments), tile=TILE)
        spare = None if is_kept else image
        image, mask, is_kept = after, next_mask, on_tape
        if spare is not None and ahead is not None and ahead.chosen is not level.chosen:
            run(copy_runs, len(level.runs), (level.runs, array_of(image), array_of(spare)), tile=TILE)
    return Blended(image if levels else image.clone(), torch.from_numpy(known > 0), mask, tape)


def return_gradients(
    inputs: Inputs,
    blended: Blended,
    gradient: Tensor,
    mask_gradient: Tensor | None = None,
    *,
    everything: bool = True,
    columns: Columns | None = None,
) -> Returned:
    """Returns the gradients of all inputs, from those of the outcome; view by view, so that little memory is needed.

    Args:
        inputs: What the passes have read.
        blended: Their outcome, with its tape.
        gradient: Gradient of the image, shape (v, 3, h, w).
        mask_gradient: Gradient of the mask, shape (v, 1, h, w), where passes fill it; ``None`` for 0.
        everything: Whether those of normal, position and mask are wanted.
        columns: As in :func:`blend_stack`.

    Returns:
        The gradients.

    Example:
        >>> flat, row, mask = torch.zeros(1, 3, 4, 4), torch.ones(1, 3), torch.ones(1, 1, 4, 4)
        >>> one = Inputs(flat + 2, flat, flat, mask, None, None, row, None, None, (1,), (0,), (0,), False)
        >>> round(return_gradients(one, blend_stack(one, save=True), flat + 1).radiance.sum().item(), 4)
        48.0
    """
    light = inputs.radiance.new_empty(1, 4, *inputs.radiance.shape[2:])
    planes = [light.new_empty(1, 3, *light.shape[2:]) for _ in range(2)]  # most often nobody writes there
    scratch = Shares(light, planes[0], differ=False)
    radiance = torch.from_numpy(copied(gradient))
    mask = zeros(inputs.mask.shape) if mask_gradient is None else torch.from_numpy(copied(mask_gradient))
    normal, position = (zeros(radiance.shape if everything else (len(radiance), 0, 1, 1)) for _ in range(2))
    factors = None if inputs.factors is None else zeros(radiance.shape)
    widths, taps = np.zeros((len(inputs.steps), 3)), np.zeros((len(inputs.steps), 25))
    for view in range(len(radiance)):
        part = slice(view, view + 1)
        sums = Gradients(radiance[part], planes[1], normal[part], position[part], mask[part])
        own = _view_of(inputs, part)
        own_factors = None if factors is None else factors[part]
        image, tape = blended.image[part], blended.tape[:, part]
        _walk_back(own, image, tape, scratch, sums, own_factors, widths, taps, everything, columns)
    kernels = None
    if inputs.kernels is not None:
        kernels = torch.from_numpy(taps).view(-1, 5, 5).div(inputs.kernels).to(inputs.kernels.dtype)
    return Returned(
        radiance,
        normal if everything else None,
        position if everything else None,
        mask if everything else None,
        torch.from_numpy(widths).to(inputs.inverse.dtype),
        factors,
        kernels,
    )


def _walk_back(
    inputs: Inputs,
    image: Tensor,
    tape: Tensor,
    scratch: Shares,
    sums: Gradients,
    factors: Tensor | None,
    widths: NDArray[np.float64],
    taps: NDArray[np.float64],
    everything: bool,
    columns: Columns | None,
) -> None:
    """Adds the gradients of one view, whose radiance after all passes is ``image``."""
    passes, guides = inputs.arrays()
    light, gradients = array_of(scratch.light), Gradients(*map(array_of, sums))
    no_factors = np.empty((0, 3, 1, 1), np.float32)
    levels = list(_levels(inputs, columns))
    is_ours = False  # the image: to be written to
    for number in reversed(range(len(levels))):
        level, own = levels[number], array_of(tape[number])
        last = number + 1 == len(levels)
        if not level.is_whole and (last or levels[number + 1].chosen is not level.chosen):
            array_of(scratch.light).fill(0)
        if not level.is_whole and not is_ours:
            image, is_ours = torch.from_numpy(copied(image[:, :3])), True
        runs, unknown = level.runs, np.zeros(len(level.runs), np.bool_)
        fills = inputs.fill and everything
        run(
            prepare_runs,
            len(runs),
            (
                runs, passes, guides, array_of(image), gradients.image, gradients.mask, fills, own, not level.is_whole,
                light, unknown,
            ),
            tile=TILE,
        )  # fmt: skip
        if level.is_whole:
            image, is_ours = tape[number] if number > 0 else inputs.radiance, False
        several = inputs.factors is not None or inputs.kernels is not None or len(level.members) > 1
        differ = several or bool(unknown.any())  # widths, or kernels are wanted, which costs as much
        if differ:
            if not level.is_whole:
                array_of(scratch.scales).fill(0)
            run(scale_runs, len(runs), (runs, passes, guides, own, array_of(scratch.scales)), tile=TILE)
        mask = tape[number, :, 4:].contiguous() if inputs.fill else inputs.mask
        shares = Shares(light, array_of(scratch.scales), differ)
        arguments = passes, guides, array_of(image), array_of(mask), shares, everything, gradients
        run_widths, run_taps = _gather(level, columns, image.shape[2], arguments)
        if differ:
            differing = np.zeros((len(runs), 3))
            arrays = gradients.widths, no_factors if factors is None else array_of(factors)
            run(reduce_runs, len(runs), (runs, passes, guides, own, *arrays, differing), tile=TILE)
            np.add.at(widths, runs[:, 3], differing)
            taps[level.members[0]] += run_taps.sum(0)
        else:
            widths[level.members[0]] += run_widths.sum(0)


def _gather(
    level: _Level, columns: Columns | None, rows: int, arguments: tuple[Any, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gathers the gradients of a level, and returns the sums for widths and taps, in parts."""
    number = level.members[0]
    if columns is None:
        reached = in_order(runs_of(spread(level.chosen, level.step, rows), number), level.step, rows)
        sums = np.zeros((len(reached), 3)), np.zeros((len(reached), 25))
        scratch = scratch_to_gather(level.chosen.shape[1], level.step)
        tile, gather = runs_of_rows(TILE, reached), with_scratch(gather_runs, scratch)
        run(gather, len(reached), (reached, level.step, *arguments, *sums), tile=tile)
        return sums
    pairs, offsets = columns.pairs(level.step, np.asarray(level.chosen.any(1)))
    count = len(offsets) - 1
    sums = np.zeros((count, 3)), np.zeros((count, 25))
    run(
        gather_columns,
        count,
        (columns.heights, pairs, offsets, number, level.step, *arguments, *sums),
        tile=COLUMNS_TILE,
    )
    return sums


def _view_of(inputs: Inputs, part: slice) -> Inputs:
    """The inputs of one view."""
    names = ("radiance", "normal", "position", "mask", "known", "region", "factors")
    tensors = {name: getattr(inputs, name) for name in names}
    return replace(inputs, **{name: tensor[part] for name, tensor in tensors.items() if tensor is not None})


class _Level(NamedTuple):
    """Passes that read the same image: their step, their numbers, their blocks, and these as runs."""

    step: int
    members: list[int]
    chosen: NDArray[np.bool_]
    runs: NDArray[np.int32]
    is_whole: bool


def _levels(inputs: Inputs, columns: Columns | None) -> Iterator[_Level]:
    """The passes, level by level; levels that work on the same labels share the array of their blocks."""
    views, _, height, width = inputs.radiance.shape
    marks = np.ones((views * height, -(-width // WIDTH)), np.int32)
    if inputs.region is not None:
        labels = array_of(inputs.region).reshape(-1, width)
        run(mark_blocks, len(labels), (labels, marks), tile=64)
    found: dict[tuple[int, ...], Any] = {}
    unlabelled = inputs.region is None if columns is None else columns.whole
    for _, group in groupby(range(len(inputs.steps)), lambda number: inputs.levels[number]):
        members = list(group)
        labels_ = tuple(inputs.labels[number] for number in members)
        if labels_ not in found:
            own = [marks & (1 << label) != 0 for label in labels_]
            found[labels_] = np.logical_or.reduce(own), [runs_of(blocks, 0) for blocks in own]
        chosen, own_runs = found[labels_]
        runs = np.concatenate([np.add(each, [0, 0, 0, number]) for each, number in zip(own_runs, members, strict=True)])
        is_whole = unlabelled and labels_ == (0,)
        step = inputs.steps[members[0]]
        if columns is None:
            step = min(step, max(height, width))  # further away is nothing, either, and threads make room for it
        yield _Level(step, members, chosen, runs.astype(np.int32), is_whole)
