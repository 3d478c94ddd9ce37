"""One pass of the à-trous filter, backwards, over runs: what comes before and after the gathering.

See :mod:`fovden.filters.kernels.gather` for the formulas.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

from fovden.filters.kernels.blend import BYTES, LOG2_E, SMALLEST_TOTAL, YES, Guides, Passes
from fovden.filters.kernels.lanes import WIDTH, WORD, ZERO, have_label, in_row, masked_load, masked_store
from fovden.jit import Int, inlined, kernel, vectorised
from fovden.simd import FLOATS, I32, I64, Lanes, advanced, maximum, pointer_to


@intrinsic
def prepare_block_vector(
    context: Any, image: Any, gradient: Any, mask_gradient: Any, fills: Any, totals: Any, labels: Any, plane: Any,
    at: Any, x: Any, width: Any, label: Any, light: Any,
) -> Any:  # fmt: skip
    """Writes G and -h of a block; returns whether a filled pixel of it had no value of its own."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image, gradient, mask_gradient, fills, totals, labels, plane, at, x, width, label, light = arguments
        inside = have_label(builder, labels, at, label, in_row(builder, x, width))
        places = [builder.add(at, builder.mul(plane, ir.Constant(I64, k))) for k in range(4)]
        total = masked_load(builder, totals, at, inside)
        zero = Lanes(builder, ir.Constant(total.value.type, [0.0] * WIDTH))
        unknown = total < 0.0
        total = maximum(total, zero - total)
        filled = total > float(SMALLEST_TOTAL)
        one = Lanes(builder, ir.Constant(total.value.type, [1.0] * WIDTH))
        share = filled.select(one / filled.select(total, one), zero)
        changed = builder.and_(inside, filled.value)
        reference = zero
        for k in range(3):
            divided = masked_load(builder, gradient, places[k], inside) * share
            reference = reference - divided * masked_load(builder, image, places[k], inside)
            masked_store(builder, divided, light, places[k], inside)
            masked_store(builder, zero, gradient, places[k], changed)
        masked_store(builder, reference, light, places[3], inside)
        with builder.if_then(fills):
            masked_store(builder, zero, mask_gradient, at, changed)
        return builder.icmp_unsigned("!=", (unknown & filled).bits(), ir.Constant(I32, 0))

    return YES(FLOATS, FLOATS, FLOATS, YES, FLOATS, BYTES, *[WORD] * 5, FLOATS), generate


@inlined
def prepare_block_plain(
    image: Any, gradient: Any, mask_gradient: Any, fills: bool, totals: Any, labels: Any, plane: Int, at: Int, x: Int,
    width: Int, label: Int, light: Any,
) -> bool:  # fmt: skip
    """:data:`prepare_block_vector`, one pixel after the other."""
    unknown = False
    for here in range(at, at + min(WIDTH, width - x)):
        if np.int64(labels[here]) != label:
            continue
        total, reference = abs(totals[here]), ZERO
        filled = total > SMALLEST_TOTAL
        for k in range(3):
            place = here + k * plane
            divided = gradient[place] / total if filled else ZERO
            light[place] = divided
            reference += divided * image[place]
            if filled:
                gradient[place] = ZERO
        light[here + 3 * plane] = -reference
        if fills and filled:
            mask_gradient[here] = ZERO
        unknown = unknown or (filled and totals[here] < ZERO)
    return unknown


prepare_block = prepare_block_vector if vectorised() else prepare_block_plain


@kernel
def prepare_runs(
    start: Int,
    stop: Int,
    runs: Any,
    passes: Passes,
    guides: Guides,
    image: Any,
    gradient: Any,
    mask_gradient: Any,
    fills: bool,
    totals: Any,
    light: Any,
    unknown: Any,
) -> None:
    """Divides the gradients of the pixels of the runs start .. stop - 1 by the sums of their weights.

    What a filled pixel was before the pass counts no more: its gradient becomes 0. The other pixels keep theirs.

    Args:
        start: First run.
        stop: End of the runs.
        runs: As in :func:`fovden.filters.kernels.blend_rows.blend_runs`, in any order.
        passes: The passes.
        guides: What else was looked at.
        image: Radiance after the pass, (v, 3, h, w).
        gradient: Gradient of that radiance, (v, 3, h, w).
        mask_gradient: Gradient of the mask after the pass, and then before it, (v, 1, h, w).
        fills: Whether the mask of a filled pixel became 1.
        totals: Sums of weights, as the pass has written them, (v, 1, h, w).
        light: Receives G and -h, (v, 4, h, w).
        unknown: Receives whether one of a run's pixels had no value of its own, (n).
    """
    height, width = image.shape[2], image.shape[3]
    plane = height * width
    for run in range(start, stop):
        row, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        view, y = row // height, row % height
        its_image = advanced(pointer_to(image), 3 * view * plane)
        its_gradient = advanced(pointer_to(gradient), 3 * view * plane)
        its_mask_gradient = advanced(pointer_to(mask_gradient), view * plane)
        its_totals = advanced(pointer_to(totals), view * plane)
        labels = advanced(pointer_to(guides.labels), view * plane)
        its_light = advanced(pointer_to(light), 4 * view * plane)
        for block in range(np.int64(runs[run, 1]), np.int64(runs[run, 2])):
            x = block * WIDTH
            found = prepare_block(
                its_image, its_gradient, its_mask_gradient, fills, its_totals, labels, plane, y * width + x, x, width,
                passes.labels[number], its_light,
            )  # fmt: skip
            unknown[run] = unknown[run] or found


@kernel
def scale_runs(start: Int, stop: Int, runs: Any, passes: Passes, guides: Guides, totals: Any, scales: Any) -> None:
    """Writes what the pixels of the runs start .. stop - 1 had for scales; arguments as of :func:`prepare_runs`."""
    height, width, mapped = totals.shape[2], totals.shape[3], guides.factors.shape[0] > 0
    for run in range(start, stop):
        row, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        v, y = row // height, row % height
        for x in range(np.int64(runs[run, 1]) * WIDTH, min(np.int64(runs[run, 2]) * WIDTH, width)):
            if np.int64(guides.labels[v, 0, y, x]) != passes.labels[number]:
                continue
            for g in range(3):
                scale = -LOG2_E * passes.inverse[number, g]
                if mapped:
                    scale *= guides.factors[v, g, y, x]
                scales[v, g, y, x] = scale if g > 0 or totals[v, 0, y, x] > ZERO else ZERO


@kernel
def reduce_runs(
    start: Int, stop: Int, runs: Any, passes: Passes, guides: Guides, totals: Any, widths: Any, factors: Any, sums: Any
) -> None:
    """Sums the gradients of inverse squared widths that differ, in the runs start .. stop - 1.

    Args:
        start: First run.
        stop: End of the runs.
        runs: As in :func:`prepare_runs`.
        passes: The passes.
        guides: What else was looked at.
        totals: Sums of weights.
        widths: Gradients of the inverse squared widths as the pixels have them, (v, 3, h, w).
        factors: Receives what of them is the factors', (v, 3, h, w); of no views if there are none.
        sums: Receives the sums of the passes' own, float64, (n, 3).
    """
    height, width, mapped = totals.shape[2], totals.shape[3], factors.shape[0] > 0
    for run in range(start, stop):
        row, number = np.int64(runs[run, 0]), np.int64(runs[run, 3])
        v, y = row // height, row % height
        for g in range(3):
            total = 0.0
            for x in range(np.int64(runs[run, 1]) * WIDTH, min(np.int64(runs[run, 2]) * WIDTH, width)):
                if np.int64(guides.labels[v, 0, y, x]) != passes.labels[number]:
                    continue
                if g == 0 and totals[v, 0, y, x] <= ZERO:
                    continue
                share = widths[v, g, y, x]
                if mapped:
                    factors[v, g, y, x] += share * passes.inverse[number, g]
                    share *= guides.factors[v, g, y, x]
                total += share
            sums[run, g] = total
