"""Large pages for memory that is read all over.

Rays meet nodes, triangles and texels in no order, and with the usual pages of 4 KiB most of these reads also miss the
processor's table of pages. Linux gives pages of 2 MiB to memory that asks for them; PyTorch's does not ask. On a hall
of 262,267 triangles, incoherent rays became 10 to 20 % faster.
"""

from __future__ import annotations

import mmap

import numpy as np
import torch
from torch import Tensor

__all__ = ["on_large_pages"]

PAGE = 1 << 21
SMALLEST = 1 << 20  # bytes; below this the usual pages do


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
    size = tensor.numel() * tensor.element_size()
    if size < SMALLEST or not hasattr(mmap, "MADV_HUGEPAGE"):
        return tensor.detach().contiguous()
    region = mmap.mmap(-1, size + 2 * PAGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)  # shared ones get none
    try:
        region.madvise(mmap.MADV_HUGEPAGE)
    except OSError:  # a kernel built without them
        return tensor.detach().contiguous()
    buffer = np.frombuffer(region, np.uint8)
    start = -buffer.ctypes.data % PAGE
    copy = torch.from_numpy(buffer[start : start + size]).view(tensor.dtype).view(tensor.shape)
    return copy.copy_(tensor.detach())
