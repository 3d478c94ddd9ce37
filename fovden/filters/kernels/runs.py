"""Which blocks of sixteen pixels a pass works on: runs of them in each row of the image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fovden.filters.kernels.lanes import WIDTH, copy_floats
from fovden.jit import Int, kernel
from fovden.simd import advanced, pointer_to


@kernel
def mark_blocks(start: Int, stop: Int, labels: Any, marks: Any) -> None:
    """Sets bit l of a block's mark if one of its pixels has the label l; ``labels`` is (rows, w), of less than 32."""
    width = labels.shape[1]
    for row in range(start, stop):
        for block in range(marks.shape[1]):
            mark = np.int32(0)
            for x in range(block * WIDTH, min(block * WIDTH + WIDTH, width)):
                mark |= np.int32(1) << np.int32(labels[row, x])
            marks[row, block] = mark


def runs_of(chosen: NDArray[np.bool_], number: int) -> NDArray[np.int32]:
    """Rows (row, first block, end of the blocks, number) of the chosen blocks, shape (rows, blocks)."""
    apart = chosen.shape[1] + 1  # a place that is not chosen ends each row
    padded = np.zeros(len(chosen) * apart + 1, np.bool_)
    padded[1:].reshape(-1, apart)[:, :-1] = chosen
    change = np.flatnonzero(padded[1:] != padded[:-1])
    row, first = np.divmod(change[::2], apart)
    return np.stack([row, first, change[1::2] - row * apart, np.full_like(row, number)], axis=1).astype(np.int32)


def spread(chosen: NDArray[np.bool_], step: int, rows: int) -> NDArray[np.bool_]:
    """The blocks that have one of the chosen as a tap; views have ``rows`` rows each."""
    if chosen.all():
        return chosen
    views = chosen.reshape(-1, rows, chosen.shape[1])
    reach = -(-2 * step // WIDTH)
    wide = views.copy()
    for shift in range(1, min(reach, views.shape[2] - 1) + 1):
        wide[:, :, shift:] |= views[:, :, :-shift]
        wide[:, :, :-shift] |= views[:, :, shift:]
    tall = wide.copy()
    for shift in (step, 2 * step):
        if shift < rows:
            tall[:, shift:] |= wide[:, :-shift]
            tall[:, :-shift] |= wide[:, shift:]
    return tall.reshape(chosen.shape)


@kernel
def copy_runs(start: Int, stop: Int, runs: Any, source: Any, target: Any) -> None:
    """Copies the blocks of the runs start .. stop - 1 from one image to another, both float32, (v, c, h, w)."""
    channels, height, width = source.shape[1], source.shape[2], source.shape[3]
    for run in range(start, stop):
        view, y = np.int64(runs[run, 0]) // height, np.int64(runs[run, 0]) % height
        left, right = np.int64(runs[run, 1]) * WIDTH, min(np.int64(runs[run, 2]) * WIDTH, width)
        for channel in range(channels):
            at = ((view * channels + channel) * height + y) * width + left
            copy_floats(advanced(pointer_to(source), at), advanced(pointer_to(target), at), right - left)
