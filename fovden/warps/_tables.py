"""Laws of distance as tables: cubic pieces, cut shorter until they are exact enough."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from fovden.warps.kernels.curves import Table

PARTS = 16  # of a piece that is not exact enough
SHORTEST = float(PARTS) ** -8  # 2e-10; there a kink does no harm
NODES = np.arange(7) / 6  # every other one fixes the cubic, the rest check it
THROUGH = np.linalg.inv(np.vander(NODES[::2], increasing=True))  # coefficients from values
CHECK = np.vander(NODES[1::2], 4, increasing=True)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keeps the caller's tensor operations on one thread: they are small, and waiting for others may take longer."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def tabulate(function: Callable[[Tensor], Tensor], first: float, last: float, tolerance: float) -> Table:
    """A function on [floor(first), ceil(last)] by cubics, each exact at four places, within the tolerance at three.

    Pieces are a unit long at most, and a sixteenth of one, a sixteenth of that, ... where the function bends: a kink
    ends up in a piece so short that it does not matter.
    """
    origin, end = np.floor(first), max(np.ceil(last), np.floor(first) + 1)
    begin, length = np.arange(origin, end), 1.0
    found = []
    while len(begin):
        x = begin[:, None] + length * NODES
        with _one_thread():
            y = function(torch.from_numpy(x.reshape(-1))).numpy().reshape(x.shape)
        cubic = y[:, ::2] @ THROUGH.T
        bad = np.abs(cubic @ CHECK.T - y[:, 1::2]).max(axis=1) > tolerance
        if length <= SHORTEST:
            bad[:] = False
        found.append(np.column_stack([begin, cubic / length ** np.arange(4)])[~bad])
        length /= PARTS
        begin = (begin[bad, None] + length * np.arange(PARTS)).reshape(-1)
    pieces = np.concatenate(found)
    pieces = pieces[np.argsort(pieces[:, 0])]
    starts = np.searchsorted(pieces[:, 0], np.arange(origin, end + 1)).astype(np.int32)
    return Table(float(origin), starts, pieces)
