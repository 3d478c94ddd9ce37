"""Work divided among processes that ``torchrun`` has started; without it there is one process, and nothing to do.

Ranks exchange sums, never means: then the result does not depend, but for rounding, on how the work was divided.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, distributed

__all__ = ["add_over_ranks", "joined", "rank", "world_size"]


def world_size() -> int:
    """Returns the number of processes of the group; 1 where there is none.

    Example:
        >>> world_size()
        1
    """
    return distributed.get_world_size() if _is_joined() else 1


def rank() -> int:
    """Returns the number of this process in the group; 0 where there is none.

    Example:
        >>> rank()
        0
    """
    return distributed.get_rank() if _is_joined() else 0


def add_over_ranks(tensors: Iterable[Tensor]) -> None:
    """Replaces each tensor by its sum over all ranks, in one message per type.

    Every rank must call this with tensors of the same types and shapes in the same order.

    Args:
        tensors: The tensors, changed in place.

    Example:
        >>> total = torch.tensor([1.0, 2.0])
        >>> add_over_ranks([total])
        >>> total
        tensor([1., 2.])
    """
    if world_size() == 1:
        return
    by_type: dict[torch.dtype, list[Tensor]] = {}
    for tensor in tensors:
        by_type.setdefault(tensor.dtype, []).append(tensor)
    for group in by_type.values():
        flat = torch.cat([tensor.detach().reshape(-1) for tensor in group])
        distributed.all_reduce(flat)
        parts = torch.split(flat, [tensor.numel() for tensor in group])
        for tensor, part in zip(group, parts, strict=True):
            tensor.detach().copy_(part.view_as(tensor))


@contextmanager
def joined() -> Iterator[None]:
    """Joins the group of processes that ``torchrun`` has started, and leaves it at the end.

    Does nothing in a process that ``torchrun`` has not started, or that has joined a group already. The processes
    talk through gloo, which needs no accelerator.

    Example:
        >>> with joined():
        ...     world_size()
        1
    """
    if "TORCHELASTIC_RUN_ID" not in os.environ or _is_joined():
        yield
        return
    distributed.init_process_group("gloo")
    try:
        yield
    finally:
        distributed.destroy_process_group()


def _is_joined() -> bool:
    return distributed.is_available() and distributed.is_initialized()
