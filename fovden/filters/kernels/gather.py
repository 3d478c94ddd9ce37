"""One pass of the à-trous filter, backwards: from the gradient of what a pass wrote to those of all that it read.

With g the gradient of the pass's image, W the sum of a pixel's weights, G = g / W and h = G . image, the weight w(x, y)
of the tap y of a pixel x has the gradient P = G(x) . c(y) - h(x), and that of the pixel x as a tap of y has R, the same
the other way round. Then, with the squared differences e of each feature and their inverse squared widths s,

    dc(x) = sum w(y, x) G(y) - 2 (c(x) - c(y)) (s(x) w(x, y) P + s(y) w(y, x) R)       and so for the other features,
    ds(x) = -sum w(x, y) P e,        dmask(x) = sum w(y, x) R / mask(x).

Every pixel gathers from its taps, in either direction at once, and writes to its own place alone: no two threads meet,
and the result does not depend on how many there are.

Where all pixels of a pass share their widths, and its kernel is the B3 spline, which is the same from either side, one
power serves both directions, and with T = w(x, y) P + w(y, x) R so does s T: the same for both pixels of a pair. The
first of them keeps power and T for the second, which spares it the most of its taps, and gathers -T e for both.

Pixels are read by their places, as in :mod:`fovden.filters.kernels.weigh`.
"""

from __future__ import annotations

from typing import Any

from fovden.filters.kernels.gather_lanes import (
    gather_beside_all,
    gather_beside_light,
    gather_differing_vector,
    gather_kept_all,
    gather_kept_light,
    gather_left_all,
    gather_left_light,
    gather_own_vector,
    gather_row_all,
    gather_row_light,
)
from fovden.filters.kernels.gather_plain import (
    gather_differing_plain,
    gather_kept_plain,
    gather_own_plain,
    gather_plain,
)
from fovden.filters.kernels.shares import Read
from fovden.jit import Int, inlined, vectorised

NUMBERS = 2  # that a pair keeps: its power, and T
VECTORS = vectorised()


@inlined
def gather_row(
    read: Read, everything: bool, at: Int, tap: Int, step: Int, inverse: Any, taps: Any, sums: Any, widths: Any,
    kept: Any, apart: Int,
) -> None:  # fmt: skip
    """Adds what a row of five taps, the middle one at ``tap``, hands back to the sums of the block at ``at``.

    Args:
        read: What the pass has read.
        everything: Whether the sums of normal, position and mask are wanted too.
        at: Place of the block.
        tap: Place of the middle tap.
        step: Distance between taps.
        inverse: The inverse squared widths.
        taps: log2 of the row's kernel.
        sums: The block's sums.
        widths: Receives T e, of both pixels of each pair.
        kept: Receives the powers, and then T, ``apart`` from each other.
        apart: Distance there.
    """
    image, normal, position, weight, light, _, plane = read
    if not VECTORS:
        gather_plain(read, everything, at, tap, step, inverse, taps, sums, widths, kept, apart, 5)
    elif everything:
        gather_row_all(
            image, normal, position, weight, light, plane, at, tap, step, inverse, taps, sums, widths, kept, apart
        )
    else:
        gather_row_light(
            image, normal, position, weight, light, plane, at, tap, step, inverse, taps, sums, widths, kept, apart
        )


@inlined
def gather_beside(
    read: Read, everything: bool, at: Int, step: Int, inverse: Any, taps: Any, sums: Any, widths: Any, kept: Any,
    apart: Int,
) -> None:  # fmt: skip
    """The same for the two taps to the right."""
    image, normal, position, weight, light, _, plane = read
    if not VECTORS:
        gather_plain(read, everything, at, at, step, inverse, taps, sums, widths, kept, apart, 2)
    elif everything:
        gather_beside_all(
            image, normal, position, weight, light, plane, at, at, step, inverse, taps, sums, widths, kept, apart
        )
    else:
        gather_beside_light(
            image, normal, position, weight, light, plane, at, at, step, inverse, taps, sums, widths, kept, apart
        )


@inlined
def gather_kept(read: Read, everything: bool, at: Int, tap: Int, step: Int, sums: Any, kept: Any, apart: Int) -> None:
    """The same for a row of five taps before the block, which have kept powers and T; widths have got theirs then."""
    image, normal, position, _, light, _, plane = read
    if not VECTORS:
        gather_kept_plain(read, everything, at, tap, step, sums, kept, apart, 5)
    elif everything:
        gather_kept_all(image, normal, position, light, plane, at, tap, step, sums, kept, apart)
    else:
        gather_kept_light(image, normal, position, light, plane, at, tap, step, sums, kept, apart)


@inlined
def gather_left(read: Read, everything: bool, at: Int, step: Int, sums: Any, kept: Any, apart: Int) -> None:
    """The same for the two taps to the left."""
    image, normal, position, _, light, _, plane = read
    if not VECTORS:
        gather_kept_plain(read, everything, at, at, step, sums, kept, apart, 2)
    elif everything:
        gather_left_all(image, normal, position, light, plane, at, at, step, sums, kept, apart)
    else:
        gather_left_light(image, normal, position, light, plane, at, at, step, sums, kept, apart)


@inlined
def gather_own(read: Read, at: Int, taps: Any, sums: Any) -> None:
    """The same for the tap that a pixel is itself; ``taps`` are those of its row."""
    if VECTORS:
        gather_own_vector(read.image, read.light, read.plane, at, taps, sums)
    else:
        gather_own_plain(read, at, taps, sums)


@inlined
def gather_differing(
    read: Read, at: Int, tap: Int, step: Int, taps: Any, back: Any, sums: Any, widths: Any, tap_sums: Any
) -> None:
    """The same for a row of five taps where pixels have scales of their own, or the kernel is not symmetric.

    Args:
        read: What the pass has read.
        at: Place of the block.
        tap: Place of the middle tap.
        step: Distance between taps.
        taps: log2 of the row's kernel.
        back: And of the row on the other side.
        sums: The block's sums.
        widths: Receives w(x, y) P e, which is the pixel's own.
        tap_sums: Receives the sums of w(x, y) P for each tap.
    """
    if VECTORS:
        gather_differing_vector(
            read.image, read.normal, read.position, read.weight, read.light, read.scales, read.plane, at, tap, step,
            taps, back, sums, widths, tap_sums,
        )  # fmt: skip
    else:
        gather_differing_plain(read, at, tap, step, taps, back, sums, widths, tap_sums)
