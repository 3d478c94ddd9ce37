"""Arrays between kernels, which are filled and copied by NumPy or by kernels, and not by torch.

Torch wakes threads for that which stay awake for some milliseconds, and take the cores from the kernels that follow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fovden.filters.kernels.lanes import WIDTH
from fovden.filters.kernels.runs import copy_runs
from fovden.parallel import run

__all__ = ["array_of", "copied", "copy_to", "with_scratch", "zeros"]

TILE = 32  # rows of an image that a thread copies at a time


def array_of(tensor: Tensor) -> Any:
    """Returns a tensor's numbers, where they are if they lie side by side.

    Example:
        >>> array_of(torch.ones(2)).sum()
        np.float32(2.0)
    """
    return tensor.detach().contiguous().numpy()


def copied(tensor: Tensor) -> NDArray[np.float32]:
    """Returns a copy.

    Example:
        >>> copied(torch.ones(2).expand(3, 2)).shape
        (3, 2)
    """
    return np.array(tensor.detach().numpy(), np.float32, order="C")


def zeros(shape: Sequence[int]) -> Tensor:
    """Returns zeros.

    Example:
        >>> zeros((2, 3)).sum()
        tensor(0.)
    """
    return torch.from_numpy(np.zeros(tuple(shape), np.float32))


def copy_to(target: Tensor, image: Tensor) -> None:
    """Copies an image, shape (v, c, h, w), on all threads.

    Example:
        >>> target = zeros((1, 3, 2, 2))
        >>> copy_to(target, torch.ones(1, 3, 2, 2))
        >>> target.sum()
        tensor(12.)
    """
    views, _, rows, width = target.shape
    runs = np.zeros((views * rows, 4), np.int32)
    runs[:, 0], runs[:, 2] = np.arange(len(runs)), -(-width // WIDTH)
    run(copy_runs, len(runs), (runs, array_of(image), array_of(target)), tile=TILE)


def with_scratch(kernel: Callable[..., object], count: int) -> Callable[..., None]:
    """Returns a kernel that is given room for some numbers, which no other thread uses, for a last argument.

    Example:
        >>> with_scratch(lambda start, stop, scratch: print(len(scratch)), 5)(0, 1)
        5
    """

    def call(start: int, stop: int, *arguments: Any) -> None:
        kernel(start, stop, *arguments, np.empty(count, np.float32))

    return call
