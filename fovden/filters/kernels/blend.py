"""One pass of the à-trous filter, forwards: the weighted mean of 5 x 5 taps, for sixteen pixels of a row at a time.

What comes before and after the taps are added, on the screen (:mod:`fovden.filters.kernels.blend_rows`) and on a polar
raster (:mod:`fovden.filters.kernels.polar`). See :mod:`fovden.filters.kernels.weigh` for the formulas.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.lanes import WIDTH, WORD, ZERO, have_label, in_row, masked_load, masked_store, number_at
from fovden.jit import Int, inlined, vectorised
from fovden.simd import FLOATS, I64, Lanes, advanced, load, pointer_to, store

BLOCKS = 16  # blocks that a row of taps is added to before the next row
SUMS = 4 * WIDTH  # of a block: weighted red, green and blue, and weights
SCALES = 3 * WIDTH  # of a block: of radiance, normal and position
ALL_SUMS, ALL_SCALES = BLOCKS * SUMS, BLOCKS * SCALES

LOG2_E = np.float32(1.4426950408889634)
SMALLEST_TOTAL = np.float32(1e-20)
ONE = np.float32(1.0)

NORMAL, POSITION, MASK, CHANNELS = 3, 6, 9, 10  # the order of what taps are asked for; radiance comes first

BYTES = types.CPointer(types.uint8)
YES = types.boolean


class Passes(NamedTuple):
    """What the passes of a stack are, an entry for each.

    Attributes:
        labels: The label of the pixels that it works on, (p).
        inverse: Inverse squared widths of radiance, normal and position, (p, 3).
        taps: log2 of the kernel, (p, 25).
    """

    labels: Any
    inverse: Any
    taps: Any


class Guides(NamedTuple):
    """What the passes of a stack look at and do not change: arrays of shape (v, c, h, w).

    Attributes:
        normal: Normals, of three channels.
        position: Positions, of three.
        labels: Labels, bytes, of one.
        factors: Factors of the inverse squared widths, of three; none where they are 1.
    """

    normal: Any
    position: Any
    labels: Any
    factors: Any


class View(NamedTuple):
    """Pointers to a view's part of such arrays, and its size."""

    image: Any
    mask: Any
    known: Any
    normal: Any
    position: Any
    labels: Any
    factors: Any
    has_factors: bool
    height: Int
    width: Int
    plane: Int


@inlined
def view_of(number: Int, image: Any, mask: Any, known: Any, guides: Guides) -> View:
    """A view's pointers."""
    height, width = image.shape[2], image.shape[3]
    plane = height * width
    return View(
        advanced(pointer_to(image), 3 * number * plane),
        advanced(pointer_to(mask), number * plane),
        advanced(pointer_to(known), number * plane),
        advanced(pointer_to(guides.normal), 3 * number * plane),
        advanced(pointer_to(guides.position), 3 * number * plane),
        advanced(pointer_to(guides.labels), number * plane),
        advanced(pointer_to(guides.factors), 3 * number * plane),
        guides.factors.shape[0] > 0,
        height,
        width,
        plane,
    )


# The two operations on a block of sixteen pixels from column x on, at ``at`` in their view's planes.


@intrinsic
def scale_block_vector(
    context: Any, inverse: Any, known: Any, factors: Any, has_factors: Any, plane: Any, at: Any, x: Any, width: Any,
    scales: Any,
) -> Any:  # fmt: skip
    """Writes the block's scales; that of radiance is 0 where a pixel has no value of its own to compare."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        inverse, known, factors, has_factors, plane, at, x, width, scales = arguments
        mask = in_row(builder, x, width)
        for feature in range(3):
            scale = number_at(builder, inverse, feature) * -float(LOG2_E)
            if feature == 0:
                has_value = masked_load(builder, known, at, mask) > 0.0
                scale = has_value.select(scale, Lanes(builder, ir.Constant(scale.value.type, [0.0] * WIDTH)))
            store(builder, scale, scales, feature * WIDTH)
            with builder.if_then(has_factors):
                place = builder.add(at, builder.mul(plane, ir.Constant(I64, feature)))
                store(builder, scale * masked_load(builder, factors, place, mask), scales, feature * WIDTH)
        return target.get_dummy_value()

    return types.none(FLOATS, FLOATS, FLOATS, YES, WORD, WORD, WORD, WORD, FLOATS), generate


@inlined
def scale_block_plain(
    inverse: Any, known: Any, factors: Any, has_factors: bool, plane: Int, at: Int, x: Int, width: Int, scales: Any
) -> None:
    """:data:`scale_block_vector`, one pixel after the other."""
    for lane in range(min(WIDTH, width - x)):
        for feature in range(3):
            scale = inverse[feature] * -LOG2_E
            if feature == 0 and not known[at + lane] > ZERO:
                scale = ZERO
            if has_factors:
                scale *= factors[at + lane + feature * plane]
            scales[feature * WIDTH + lane] = scale


@intrinsic
def finish_block_vector(
    context: Any, sums: Any, image: Any, known: Any, labels: Any, plane: Any, at: Any, x: Any, width: Any, label: Any,
    out: Any, next_mask: Any, fills: Any, totals: Any, saves: Any,
) -> Any:  # fmt: skip
    """Writes the block's means where it has the label, and the image's own values where nothing weighs.

    If it ``saves`` them, ``totals`` receive the sums of weights, negative where a pixel had no value of its own.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        sums, image, known, labels, plane, at, x, width, label, out, next_mask, fills, totals, saves = arguments
        mask = in_row(builder, x, width)
        inside = have_label(builder, labels, at, label, mask)
        places = [builder.add(at, builder.mul(plane, ir.Constant(I64, k))) for k in range(3)]
        total = load(builder, sums, 3 * WIDTH, WIDTH)
        one = Lanes(builder, ir.Constant(total.value.type, [1.0] * WIDTH))
        filled = total > float(SMALLEST_TOTAL)
        share = one / filled.select(total, one)
        has_value = masked_load(builder, known, at, mask) > 0.0
        for k in range(3):
            mean, own = load(builder, sums, k * WIDTH, WIDTH) * share, masked_load(builder, image, places[k], mask)
            masked_store(builder, filled.select(mean, own), out, places[k], inside)
        with builder.if_then(saves):
            masked_store(builder, has_value.select(total, total * -1.0), totals, at, inside)
        inside = builder.and_(inside, filled.value)
        masked_store(builder, one, known, at, inside)
        with builder.if_then(fills):
            masked_store(builder, one, next_mask, at, inside)
        return target.get_dummy_value()

    return types.none(*[FLOATS] * 3, BYTES, *[WORD] * 5, FLOATS, FLOATS, YES, FLOATS, YES), generate


@inlined
def finish_block_plain(
    sums: Any, image: Any, known: Any, labels: Any, plane: Int, at: Int, x: Int, width: Int, label: Int, out: Any,
    next_mask: Any, fills: bool, totals: Any, saves: bool,
) -> None:  # fmt: skip
    """:data:`finish_block_vector`, one pixel after the other."""
    for lane in range(min(WIDTH, width - x)):
        here, total = at + lane, sums[3 * WIDTH + lane]
        if np.int64(labels[here]) != label:
            continue
        filled = total > SMALLEST_TOTAL
        if saves:
            totals[here] = total if known[here] > ZERO else -total
        for k in range(3):
            out[here + k * plane] = sums[k * WIDTH + lane] / total if filled else image[here + k * plane]
        if filled:
            known[here] = ONE
            if fills:
                next_mask[here] = ONE


scale_block = scale_block_vector if vectorised() else scale_block_plain
finish_block = finish_block_vector if vectorised() else finish_block_plain
