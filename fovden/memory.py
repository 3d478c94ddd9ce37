"""Memory on large pages, and memory that is used again.

Rays meet nodes, triangles and texels in no order, and with the usual pages of 4 KiB most of these reads also miss the
processor's table of pages. Linux gives pages of 2 MiB to memory that asks for them; PyTorch's does not ask. On a hall
of 262,267 triangles, incoherent rays became 10 to 20 % faster.

Pages that were given back to the system have to be cleared and handed out anew, and PyTorch gives back what is large.
For an image of two views of 960 x 1080 pixels that took 10 ms, half as long as a level of a filter takes to make it.
What :func:`reused` hands out is kept instead, and handed out again.
"""

from __future__ import annotations

import math
import mmap
import weakref
from contextlib import suppress
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["empty_cache", "on_large_pages", "reused", "zeros_on_large_pages"]

PAGE = 1 << 21
SMALLEST = 1 << 20  # bytes; below this the usual pages do
MOST_KEPT = 320 << 20  # bytes: five levels with gradients ask for 262 MiB, two views of 960 x 1080 pixels


def on_large_pages(tensor: Tensor) -> Tensor:
    """Returns the tensor's values in memory on pages of 2 MiB, if the system has them and they are worth it.

    Args:
        tensor: Any tensor on the CPU.

    Returns:
        A contiguous copy aligned to a page, or, where small or without such pages, ``tensor.contiguous()``.

    Example:
        >>> torch.equal(on_large_pages(torch.arange(4.0)), torch.arange(4.0))
        True
    """
    if not _worthwhile(tensor.numel() * tensor.element_size()):
        return tensor.detach().contiguous()
    return zeros_on_large_pages(*tensor.shape, dtype=tensor.dtype).copy_(tensor.detach())


def zeros_on_large_pages(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Returns a tensor of zeros in such memory, which is filled with them when it is first touched.

    Args:
        *shape: Its shape.
        dtype: Its type.

    Returns:
        The tensor; its first element is aligned to 64 bytes, a cache line.

    Example:
        >>> zeros_on_large_pages(2, 3).sum()
        tensor(0.)
    """
    size = math.prod(shape) * dtype.itemsize
    if _worthwhile(size):
        return _tensor_in(np.frombuffer(_region(size), np.uint8), PAGE, shape, dtype)
    return _tensor_in(np.zeros(size + 64, np.uint8), 64, shape, dtype)  # torch would wake its threads


def reused(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Returns a tensor of any values, as ``torch.empty``, in memory that has been used before if there is some.

    When nobody has the tensor any more, its memory is kept for the next that needs as much: up to 320 MiB in all, of
    which those go first that were kept longest. :func:`empty_cache` gives it back to the system.

    Args:
        *shape: Its shape.
        dtype: Its type.

    Returns:
        The tensor; its first element is aligned to 64 bytes, a cache line.

    Example:
        >>> reused(2, 3).shape
        torch.Size([2, 3])
    """
    size = math.prod(shape) * dtype.itemsize
    if not _worthwhile(size):
        return _tensor_in(np.empty(size + 64, np.uint8), 64, shape, dtype)
    region = _take(_rounded(size)) or _region(size)
    buffer = np.frombuffer(region, np.uint8)
    weakref.finalize(buffer, _keep, region).atexit = False
    return _tensor_in(buffer, PAGE, shape, dtype)


def empty_cache() -> None:
    """Gives the memory back to the system that is kept for :func:`reused`.

    Example:
        >>> empty_cache()
    """
    _KEPT.clear()


_KEPT: list[Any] = []
"""Regions that nobody uses. A tensor may go at any time, on any thread, even while one of the functions below looks
here: they take one region at a time, which may be gone, and never a copy of the list, during which it could change."""


def _take(length: int) -> Any:
    for place in reversed(range(len(_KEPT))):
        with suppress(IndexError, ValueError):  # another has taken it
            region = _KEPT[place]
            if len(region) == length:
                _KEPT.remove(region)
                return region
    return None


def _keep(region: Any) -> None:
    if len(region) > MOST_KEPT:
        return
    _KEPT.append(region)
    while _size() > MOST_KEPT:
        with suppress(IndexError):
            _KEPT.pop(0)


def _size() -> int:
    total = 0
    for place in range(len(_KEPT)):
        with suppress(IndexError):
            total += len(_KEPT[place])
    return total


def _region(size: int) -> Any:
    # Private: shared memory, Python's default, gets no large pages.
    region = mmap.mmap(-1, _rounded(size), flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    with suppress(OSError):  # a kernel built without them
        region.madvise(mmap.MADV_HUGEPAGE)
    return region


def _rounded(size: int) -> int:
    return (-(-size // PAGE) + 1) * PAGE  # one more than it takes, since regions begin anywhere


def _tensor_in(buffer: Any, alignment: int, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    start, size = -buffer.ctypes.data % alignment, math.prod(shape) * dtype.itemsize
    return torch.from_numpy(buffer[start : start + size]).view(dtype).view(shape)


def _worthwhile(size: int) -> bool:
    return size >= SMALLEST and hasattr(mmap, "MADV_HUGEPAGE")
