"""A stack of à-trous passes on compiled kernels, forwards and backwards: float32, on the CPU.

The kernels take tensors as they are; a thread copies for itself the rows that it looks at. A pass works on runs of
blocks of sixteen pixels that hold a label, so it costs what it covers. Passes of one level, on different labels, read
the same image. What the way back needs is written once: the image after each level, which the next one reads, and the
sums of the pixels' weights.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fovden.filters._arrays import array_of, copied, copy_to, with_scratch, zeros
from fovden.filters.kernels.back import prepare_runs, reduce_runs, scale_runs
from fovden.filters.kernels.blend import Guides, Passes
from fovden.filters.kernels.blend_rows import blend_runs, scratch_for
from fovden.filters.kernels.columns import Columns
from fovden.filters.kernels.gather_rows import gather_runs, scratch_to_gather
from fovden.filters.kernels.hand_back import Gradients
from fovden.filters.kernels.lanes import WIDTH
from fovden.filters.kernels.polar import blend_columns
from fovden.filters.kernels.polar_back import gather_columns
from fovden.filters.kernels.rows import in_order
from fovden.filters.kernels.runs import copy_runs, mark_blocks, runs_of, spread
from fovden.filters.kernels.shares import Shares
from fovden.filters.taps import B3_SPLINE
from fovden.memory import reused
from fovden.parallel import run

__all__ = ["Blended", "Inputs", "Returned", "blend_stack", "return_gradients"]

TILE, LEAST = 256, 8
"""Runs that a thread takes at a time, most often of a row each, which takes some ten microseconds: at first, since two
rows find nothing kept for them, and at the end, since the others wait."""

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
        known: Which pixels have a value of their own, bool, shape (v, 1, h, w), or numbers, of which 1 is such a value
            and 1/2 one that is compared as if it were; ``None`` means whose mask is above 0.
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
    """The outcome of a stack, and what :func:`return_gradients` needs of it.

    Attributes:
        image: Radiance, shape (v, 3, h, w).
        known: Which pixels have a value now, bool, shape (v, 1, h, w).
        mask: Weight of each pixel as a tap now, shape (v, 1, h, w).
        images: Radiance between the levels, shape (levels - 1, v, 3, h, w); of none if it is not wanted.
        totals: Of each level the sums of weights, negative where a pixel had no value of its own, and where it is
            filled the mask before, shape (levels, 1 or 2, v, 1, h, w); of none if they are not wanted.
    """

    image: Tensor
    known: Tensor
    mask: Tensor
    images: Tensor
    totals: Tensor


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
    image, mask, shape = inputs.radiance.contiguous(), inputs.mask.contiguous(), inputs.radiance.shape
    known = array_of(reused(*mask.shape))
    known[:] = array_of(mask) > 0 if inputs.known is None else inputs.known.numpy()
    levels = list(_levels(inputs, columns))
    images = reused(len(levels) - 1 if save and levels else 0, *shape)
    totals = reused(len(levels) if save else 0, 2 if inputs.fill else 1, *mask.shape)
    places, spare = _places(images, shape), None
    for number, level in enumerate(levels):
        ahead = levels[number + 1] if number + 1 < len(levels) else None
        after = next(places) if spare is None else spare
        if not level.is_whole and after is not spare:
            copy_to(after, image)
        next_mask = torch.from_numpy(copied(mask)) if inputs.fill else mask
        if save and not level.is_whole:
            array_of(totals[number, 0]).fill(0)
        if save and inputs.fill:
            array_of(totals[number, 1])[:] = array_of(mask)
        runs = in_order(level.runs, level.step, shape[2]) if columns is None else level.runs
        arguments = (
            runs, level.step, passes, guides, array_of(image), array_of(mask), known, array_of(after),
            array_of(next_mask), inputs.fill, array_of(totals[number, 0] if save else totals.view(0, 1, *shape[2:])),
        )  # fmt: skip
        if columns is None:
            scratch = scratch_for(-(-shape[3] // WIDTH), level.step)
            _run(with_scratch(blend_runs, scratch), runs, arguments)
        else:
            _run(blend_columns, runs, (columns.beside(level.step), *arguments))
        spare = None if save or number == 0 else image  # the first is not ours to write to
        image, mask = after, next_mask
        if spare is not None and ahead is not None and ahead.chosen is not level.chosen:
            _run(copy_runs, level.runs, (level.runs, array_of(image), array_of(spare)))
    return Blended(image if levels else image.clone(), torch.from_numpy(known == 1), mask, images, totals)


def _places(images: Tensor, shape: Sequence[int]) -> Iterator[Tensor]:
    """Where the levels write to: what is saved first, and then new images."""
    yield from images
    while True:
        yield reused(*shape)


def return_gradients(
    inputs: Inputs,
    blended: Blended,
    gradient: Tensor,
    mask_gradient: Tensor | None = None,
    *,
    everything: bool = True,
    columns: Columns | None = None,
) -> Returned:
    """Returns the gradients of all inputs, from those of the outcome.

    Args:
        inputs: What the passes have read.
        blended: Their outcome, with what was saved of it.
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
    views, _, height, width = inputs.radiance.shape
    light, scales, own_widths = (reused(views, channels, height, width) for channels in (4, 3, 3))
    radiance = torch.from_numpy(copied(gradient))
    mask = zeros(inputs.mask.shape) if mask_gradient is None else torch.from_numpy(copied(mask_gradient))
    normal, position = (zeros(radiance.shape if everything else (views, 0, 1, 1)) for _ in range(2))
    factors = None if inputs.factors is None else zeros(radiance.shape)
    shares = Shares(array_of(light), array_of(scales), differ=False)
    gradients = Gradients(*map(array_of, (radiance, own_widths, normal, position, mask)))
    widths, taps = _walk_back(inputs, blended, shares, gradients, factors, everything, columns)
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
    blended: Blended,
    shares: Shares,
    gradients: Gradients,
    factors: Tensor | None,
    everything: bool,
    columns: Columns | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Adds the gradients of images, and returns those of widths and kernels."""
    passes, guides = inputs.arrays()
    count, levels = len(inputs.steps), list(_levels(inputs, columns))
    widths, taps = np.zeros((count, 3)), np.zeros((count, 25))
    image, fills = blended.image, inputs.fill and everything
    own_factors = np.empty((0, 3, 1, 1), np.float32) if factors is None else array_of(factors)
    for number in reversed(range(len(levels))):
        level, totals = levels[number], array_of(blended.totals[number, 0])
        last = number + 1 == len(levels)
        if not level.is_whole and (last or levels[number + 1].chosen is not level.chosen):
            shares.light.fill(0)
        runs, unknown = level.runs, np.zeros(len(level.runs), np.bool_)
        arrays = array_of(image), gradients.image, gradients.mask, fills, totals, shares.light, unknown
        _run(prepare_runs, runs, (runs, passes, guides, *arrays))
        image = blended.images[number - 1] if number > 0 else inputs.radiance
        several = inputs.factors is not None or inputs.kernels is not None or len(level.members) > 1
        differ = several or bool(unknown.any())  # widths, or kernels are wanted, which costs as much
        if differ:
            if not level.is_whole:
                shares.scales.fill(0)
            _run(scale_runs, runs, (runs, passes, guides, totals, shares.scales))
        mask = blended.totals[number, 1] if inputs.fill else inputs.mask
        shares = shares._replace(differ=differ)
        arguments = passes, guides, array_of(image), array_of(mask), shares, everything, gradients
        run_widths, run_taps = _gather(level, columns, image.shape[2], arguments)
        if differ:
            differing = np.zeros((len(runs), 3))
            _run(reduce_runs, runs, (runs, passes, guides, totals, gradients.widths, own_factors, differing))
            np.add.at(widths, runs[:, 3], differing)
            taps[level.members[0]] += run_taps.sum(0)
        else:
            widths[level.members[0]] += run_widths.sum(0)
    return widths, taps


def _gather(
    level: _Level, columns: Columns | None, rows: int, arguments: tuple[Any, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gathers the gradients of a level, and returns the sums for widths and taps, in parts."""
    number, blocks = level.members[0], level.chosen.shape[1]
    if columns is None:
        reached = in_order(runs_of(spread(level.chosen, level.step, rows), number), level.step, rows)
        sums = np.zeros((len(reached), 3)), np.zeros((len(reached), 25))
        gather = with_scratch(gather_runs, scratch_to_gather(blocks, level.step))
        _run(gather, reached, (reached, level.step, *arguments, *sums))
        return sums
    pairs, offsets = columns.pairs(level.step, np.asarray(level.chosen.reshape(-1, rows, blocks).any((0, 2))))
    count = len(level.chosen) // rows * (len(offsets) - 1)
    sums = np.zeros((count, 3)), np.zeros((count, 25))
    run(
        gather_columns,
        count,
        (columns.heights, pairs, offsets, number, level.step, *arguments, *sums),
        tile=COLUMNS_TILE,
    )
    return sums


def _run(kernel: Callable[..., object], runs: NDArray[np.int32], arguments: Sequence[Any]) -> None:
    """Calls a kernel on runs."""
    run(kernel, len(runs), arguments, tile=TILE, least=LEAST)


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
    for _, group in groupby(range(len(inputs.steps)), lambda number: inputs.levels[number]):
        members = list(group)
        labels_ = tuple(inputs.labels[number] for number in members)
        if labels_ not in found:
            own = [marks & (1 << label) != 0 for label in labels_]
            found[labels_] = np.logical_or.reduce(own), [runs_of(blocks, 0) for blocks in own]
        chosen, own_runs = found[labels_]
        runs = np.concatenate([np.add(each, [0, 0, 0, number]) for each, number in zip(own_runs, members, strict=True)])
        is_whole = columns is None and len(members) == 1 and bool((marks == 1 << labels_[0]).all())
        step = inputs.steps[members[0]]
        if columns is None:
            step = min(step, max(height, width))  # further away is nothing, either, and threads make room for it
        yield _Level(step, members, chosen, runs.astype(np.int32), is_whole)
