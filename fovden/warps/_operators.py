"""Polar warps as operators of PyTorch: the way to the screen and its adjoint, and where cells lie.

They take tensors and the number of a warp: what kernels know of it is looked up when an operator runs, and made if it
is the first to ask. Numbers hold for one process. The operators are opaque to
``torch.compile``, which knows the shapes of what they return.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import numpy as np
import torch
from torch import Tensor

from fovden.warps._fused import geometries, place, to_cells, to_pixels

if TYPE_CHECKING:
    from fovden.warps.base import Prefilter
    from fovden.warps.polar import PolarWarp

_WARPS: WeakValueDictionary[int, PolarWarp] = WeakValueDictionary()
_NUMBERS = count(1)


class _Handle(np.ndarray[Any, Any]):
    """A number whose memory, and any tensor that has a share in it, keeps what operators find by it."""

    warp: PolarWarp


def number_of(warp: PolarWarp) -> Tensor:
    """Gives a warp the number by which operators find it, and returns it, as a tensor.

    They find a copy, which lives as long as the tensor's memory, also where a warp is gone before its backward pass.
    """
    known = object.__new__(type(warp))
    known.__dict__.update(vars(warp) | {"_kept": warp._kept})
    handle = np.array(next(_NUMBERS)).view(_Handle)
    handle.warp = _WARPS[int(handle)] = known
    with torch.inference_mode(False):
        return torch.from_numpy(handle)


def warp_of(number: Tensor) -> PolarWarp:
    """The warp of a number."""
    warp = _WARPS.get(int(number))
    if warp is None:
        raise RuntimeError(f"warp: expected the number of a warp that this process holds, got {int(number)}")
    return warp


def resampled(warp: PolarWarp, values: Tensor, prefilter: Prefilter, *, back: bool = False) -> Tensor:
    """Values of cells as values of pixels or, ``back``, the adjoint: float32, on the CPU, for a warp that is fixed."""
    arguments = values, warp.number, prefilter, list(warp.resolution if back else warp.screen), back
    if torch.compiler.is_compiling():
        return torch.ops.fovden.resample(*arguments)  # type: ignore[no-any-return]
    return _Resampled.apply(*arguments)  # type: ignore[no-any-return, no-untyped-call]


def _run_resample(values: Tensor, warp: Tensor, prefilter: Any, size: list[int], back: bool) -> Tensor:
    views = geometries(warp_of(warp), prefilter)
    return to_cells(views, values, size[0]) if back else to_pixels(views, values)


def _run_place(cells: Tensor, warp: Tensor) -> Tensor:
    return place(warp_of(warp), cells)


def _define(schema: str, run: Any, fake: Any) -> None:
    name = schema[: schema.index("(")]
    torch.library.define(name, schema[len(name) :])
    torch.library.impl(name, "CPU", run)
    torch.library.register_fake(name, fake)


_define(
    "fovden::resample(Tensor values, Tensor warp, str prefilter, SymInt[] size, bool back) -> Tensor",
    _run_resample,
    lambda values, _warp, _prefilter, size, _back: values.new_empty(*values.shape[:2], *size),
)
_define(
    "fovden::place_cells(Tensor cells, Tensor warp) -> Tensor",
    _run_place,
    lambda cells, _warp: cells.new_empty(cells.shape),
)


def _remember_sizes(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    del output
    values, number, ctx.prefilter, _, ctx.back = inputs
    ctx.save_for_backward(number)
    ctx.size = list(values.shape[2:])


def _return_values(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    rest = *ctx.saved_tensors, ctx.prefilter, ctx.size, not ctx.back
    return _Resampled.apply(gradient, *rest), None, None, None, None  # type: ignore[no-untyped-call]


class _Resampled(torch.autograd.Function):
    """The map and its derivative, which is the other map, also where ``torch.func`` takes it."""

    @staticmethod
    def forward(*arguments: Any) -> Any:
        """Calls the operator."""
        return torch.ops.fovden.resample(*arguments)

    setup_context = staticmethod(_remember_sizes)
    backward = staticmethod(_return_values)

    @staticmethod
    def vmap(info: Any, axes: Any, values: Tensor, *rest: Any) -> tuple[Tensor, int]:
        """Takes the images of a batch for channels."""
        moved = values.movedim(axes[0], 2)
        out = _Resampled.apply(moved.flatten(1, 2), *rest)  # type: ignore[no-untyped-call]
        return out.unflatten(1, (moved.shape[1], info.batch_size)), 2


torch.library.register_autograd("fovden::resample", _return_values, setup_context=_remember_sizes)


def _place_batch(info: Any, axes: Any, cells: Tensor, number: Tensor) -> tuple[Tensor, int]:
    """How the operator answers ``torch.func.vmap``: all cells of the batch in one call."""
    moved = cells.movedim(axes[0], 1)
    out = torch.ops.fovden.place_cells(moved.flatten(1, 2), number)
    return out.unflatten(1, (info.batch_size, moved.shape[2])), 1


torch.library.register_vmap("fovden::place_cells", _place_batch)
