"""What a pass hands back on the way back, and where the sums of it are: in the order of the channels that it has read.

What is the same for all taps of a pixel is left out of the sums, and multiplied when they are handed back: its weight
as a tap, and the scales of features where pixels share them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.filters.kernels.blend import CHANNELS, MASK, NORMAL, POSITION
from fovden.filters.kernels.lanes import WIDTH
from fovden.jit import Int, inlined
from fovden.simd import advanced, pointer_to

MOVED = CHANNELS
"""Where a block's sums are of the light that taps hand back by their averages; before come those by their weights."""

SUMS, WIDTHS = (MOVED + 3) * WIDTH, 3 * WIDTH  # of a block: all of these, and of the widths, which come after
BLOCK_SUMS = SUMS + WIDTHS
TAP_SUMS = 25 * WIDTH
TWICE_LN_2 = np.float32(2 * 0.6931471805599453)
LIGHT, SCALES, ALL_CHANNELS = CHANNELS, CHANNELS + 4, CHANNELS + 7  # after the channels of the way forth


class Shares(NamedTuple):
    """What a pass's pixels hand back, arrays of shape (v, c, h, w), 0 where the pass did not work.

    Attributes:
        light: G and -h, of four channels.
        scales: Minus log2(e) times the pixel's own inverse squared widths, of three; read only where they differ.
        differ: Whether they do, or the kernel may: then its gradient is summed, too.
    """

    light: Any
    scales: Any
    differ: bool


@inlined
def handed_of(number: Int, shares: Shares, plane: Int) -> Shares:
    """Pointers to those of a view."""
    light, scales = pointer_to(shares.light), pointer_to(shares.scales)
    return Shares(advanced(light, 4 * number * plane), advanced(scales, 3 * number * plane), shares.differ)


@inlined
def write_factors(differ: bool, inverse: Any, factors: Any) -> None:
    """Writes what a feature's sums have left out: their scale where pixels share it, and the derivative's 2 ln 2."""
    for g in range(3):
        factors[g] = TWICE_LN_2 if differ else np.float32(-2) * inverse[g]


class Read(NamedTuple):
    """Pointers to the first channels of what a pass has read and hands back; channels lie ``plane`` apart."""

    image: Any
    normal: Any
    position: Any
    weight: Any
    light: Any
    scales: Any
    plane: Int


@inlined
def read_from(base: Any, apart: Int) -> Read:
    """Channels that lie ``apart``, in their order."""
    return Read(
        base, advanced(base, NORMAL * apart), advanced(base, POSITION * apart), advanced(base, MASK * apart),
        advanced(base, LIGHT * apart), advanced(base, SCALES * apart), apart,
    )  # fmt: skip
