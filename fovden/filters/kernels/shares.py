"""What a pass hands back on the way back, and where the sums of it are.

Derivatives of powers of two leave out 2 ln 2 until the end; what comes by another way is divided by it before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.filters.kernels.lanes import WIDTH
from fovden.jit import Int

IMAGE, NORMAL, POSITION, MASK, GATHERED = 0, 3, 6, 9, 10  # sums of a block
SUMS, WIDTHS = GATHERED * WIDTH, 3 * WIDTH  # and those of the widths, which come after

LOG2_E = np.float32(1.4426950408889634)
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
