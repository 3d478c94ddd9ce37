"""The last of a pass backwards: a block's sums become gradients, where these belong."""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.filters.kernels.blend import MASK, YES
from fovden.filters.kernels.lanes import WIDTH, WORD, in_row, masked_load, masked_store, number_at
from fovden.filters.kernels.shares import MOVED, SUMS
from fovden.jit import Int, inlined, vectorised
from fovden.simd import FLOATS, I64, Lanes, advanced, fused, load, pointer_to


class Gradients(NamedTuple):
    """Gradients, arrays of shape (v, c, h, w).

    Attributes:
        image: Of the image, of 3 channels.
        widths: Of the inverse squared widths as the pixels have them, of 3.
        normal: Of normals, of 3; of none if they are not wanted.
        position: Of positions, likewise.
        mask: Of the mask, of 1; left alone if it is not wanted.
    """

    image: Any
    widths: Any
    normal: Any
    position: Any
    mask: Any


@inlined
def gradients_of(number: Int, gradients: Gradients, plane: Int) -> Gradients:
    """Pointers to those of a view."""
    return Gradients(
        advanced(pointer_to(gradients.image), 3 * number * plane),
        advanced(pointer_to(gradients.widths), 3 * number * plane),
        advanced(pointer_to(gradients.normal), 3 * number * plane),
        advanced(pointer_to(gradients.position), 3 * number * plane),
        advanced(pointer_to(gradients.mask), number * plane),
    )


@intrinsic
def hand_back_vector(
    context: Any, sums: Any, factors: Any, differ: Any, everything: Any, weight: Any, plane: Any, at: Any,
    x: Any, width: Any, to_image: Any, to_widths: Any, to_normal: Any, to_position: Any, to_mask: Any,
) -> Any:  # fmt: skip
    """Adds a block's sums to its gradients; see :func:`hand_back`."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (sums, factors, differ, everything, weight, plane, at, x, width, to_image, to_widths, to_normal,
         to_position, to_mask) = arguments  # fmt: skip
        inside = in_row(builder, x, width)
        places = [builder.add(at, builder.mul(plane, ir.Constant(I64, k))) for k in range(3)]
        own_weight = masked_load(builder, weight, at, inside)
        moved = [load(builder, sums, (MOVED + k) * WIDTH, WIDTH) for k in range(3)]

        def add(out: Any, feature: int, others: list[Lanes] | None) -> None:
            factor = number_at(builder, factors, feature)
            for k in range(3):
                total = masked_load(builder, out, places[k], inside)
                if others is not None:
                    total = fused(others[k], own_weight, total)
                change = load(builder, sums, (3 * feature + k) * WIDTH, WIDTH)
                masked_store(builder, fused(change, factor, total), out, places[k], inside)

        add(to_image, 0, moved)
        with builder.if_then(everything):
            add(to_normal, 1, None)
            add(to_position, 2, None)
            total = masked_load(builder, to_mask, at, inside) + load(builder, sums, MASK * WIDTH, WIDTH)
            masked_store(builder, total, to_mask, at, inside)
        with builder.if_then(differ):
            for k in range(3):
                change = load(builder, sums, SUMS + k * WIDTH, WIDTH) * -1.0
                masked_store(builder, change, to_widths, places[k], inside)
        return target.get_dummy_value()

    return types.none(FLOATS, FLOATS, YES, YES, FLOATS, *[WORD] * 4, *[FLOATS] * 5), generate


@inlined
def hand_back_plain(
    sums: Any, factors: Any, differ: bool, everything: bool, weight: Any, plane: Int, at: Int, x: Int,
    width: Int, to_image: Any, to_widths: Any, to_normal: Any, to_position: Any, to_mask: Any,
) -> None:  # fmt: skip
    """:data:`hand_back_vector`, one pixel after the other."""
    for lane in range(min(WIDTH, width - x)):
        here = at + lane
        for k in range(3):
            place, moved = here + k * plane, sums[(MOVED + k) * WIDTH + lane]
            to_image[place] += moved * weight[here] + sums[k * WIDTH + lane] * factors[0]
            if everything:
                to_normal[place] += sums[(3 + k) * WIDTH + lane] * factors[1]
                to_position[place] += sums[(6 + k) * WIDTH + lane] * factors[2]
            if differ:
                to_widths[place] = -sums[SUMS + k * WIDTH + lane]
        if everything:
            to_mask[here] += sums[MASK * WIDTH + lane]


hand_back_block = hand_back_vector if vectorised() else hand_back_plain


@inlined
def hand_back(
    sums: Any, factors: Any, differ: bool, everything: bool, weight: Any, plane: Int, at: Int, x: Int,
    width: Int, gradients: Gradients,
) -> None:  # fmt: skip
    """Adds a block's sums to its gradients.

    Args:
        sums: The sums.
        factors: What those of features are multiplied by, three.
        differ: Whether the widths have gradients of their own; these are written.
        everything: Whether normal, position and mask have gradients.
        weight: The view's mask.
        plane: Distance of channels, in all of these.
        at: Place of the block.
        x: Column of its first pixel.
        width: Number of columns.
        gradients: Pointers to the view's, as of :func:`gradients_of`.
    """
    hand_back_block(
        sums, factors, differ, everything, weight, plane, at, x, width, gradients.image, gradients.widths,
        gradients.normal, gradients.position, gradients.mask,
    )  # fmt: skip
