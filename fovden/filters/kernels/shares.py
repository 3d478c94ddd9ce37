"""What a pass hands back on the way back, and where the sums of it are: in the order of the channels that it has read.

Derivatives of powers of two leave out 2 ln 2 until the end; what comes by another way is divided by it before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.filters.kernels.blend import CHANNELS, LOG2_E, MASK, NORMAL, POSITION
from fovden.filters.kernels.lanes import WIDTH
from fovden.jit import Int, inlined
from fovden.simd import advanced

SUMS, WIDTHS = CHANNELS * WIDTH, 3 * WIDTH  # of a block: of the channels, and of the widths, which come after
BLOCK_SUMS = SUMS + WIDTHS
LIGHT, SCALES, ALL_CHANNELS = CHANNELS, CHANNELS + 4, CHANNELS + 7  # after the channels of the way forth
HALF_LOG2_E = np.float32(0.5) * LOG2_E


class Shares(NamedTuple):
    """What a pass's pixels hand back, arrays of shape (1, c, h, w), 0 where the pass did not work.

    Attributes:
        light: G and -h, of four channels.
        scales: Minus log2(e) times the pixel's own inverse squared widths, of three; read only where they differ.
        differ: Whether they do, or the kernel may: then its gradient is summed, too.
    """

    light: Any
    scales: Any
    differ: bool


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
