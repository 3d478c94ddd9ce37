"""Polar warps as operators of PyTorch: the way to the screen and its adjoint, and where cells lie.

They take tensors and the number of a warp: what kernels know of it is looked up when an operator runs, and made if it is
the first to ask. Numbers hold for one process; a warp's is given back with it. The operators are opaque to
``torch.compile``, which knows the shapes of what they return.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import torch
from torch import Tensor

from fovden.foveation.warps._fused import place, to_cells, to_pixels

if TYPE_CHECKING:
    from fovden.foveation.warps.base import Prefilter
    from fovden.foveation.warps.polar import PolarWarp

_WARPS: WeakValueDictionary[int, PolarWarp] = WeakValueDictionary()
_NUMBERS = count(1)


def number_of(warp: PolarWarp) -> int:
    """Gives a warp the number by which operators find it, and returns it."""
    number = next(_NUMBERS)
    _WARPS[number] = warp
    return number


def warp_of(number: int) -> PolarWarp:
    """The warp of a number."""
    warp = _WARPS.get(number)
    if warp is None:
        raise RuntimeError(f"warp: expected the number of a warp that this process holds, got {number}")
    return warp


def resampled(warp: PolarWarp, values: Tensor, prefilter: Prefilter, *, back: bool = False) -> Tensor:
    """Values of cells as values of pixels or, ``back``, the adjoint: float32, on the CPU, for a warp that is fixed."""
    arguments = values, warp.number, prefilter, list(warp.resolution if back else warp.screen), back
    if torch.compiler.is_compiling():
        return torch.ops.fovden.resample(*arguments)  # type: ignore[no-any-return]
    return _Resampled.apply(*arguments)  # type: ignore[no-any-return, no-untyped-call]


def placed(warp: PolarWarp, cells: Tensor) -> Tensor:
    """Points on the screen of cell coordinates: float32, on the CPU, for a warp that is fixed."""
    if torch.compiler.is_compiling():
        return torch.ops.fovden.place_cells(cells, warp.number)  # type: ignore[no-any-return]
    return _Placed.apply(cells, warp.number)  # type: ignore[no-any-return, no-untyped-call]


def _run_resample(values: Tensor, warp: int, prefilter: Any, size: list[int], back: bool) -> Tensor:
    views = warp_of(warp)._geometries(prefilter)
    return to_cells(views, values, size[0]) if back else to_pixels(views, values)


def _run_place(cells: Tensor, warp: int) -> Tensor:
    return place(warp_of(warp), cells)


def _define(schema: str, run: Any, fake: Any) -> None:
    name = schema[: schema.index("(")]
    torch.library.define(name, schema[len(name) :])
    torch.library.impl(name, "CPU", run)
    torch.library.register_fake(name, fake)


_define(
    "fovden::resample(Tensor values, int warp, str prefilter, SymInt[] size, bool back) -> Tensor",
    _run_resample,
    lambda values, _warp, _prefilter, size, _back: values.new_empty(*values.shape[:2], *size),
)
_define("fovden::place_cells(Tensor cells, int warp) -> Tensor", _run_place, lambda cells, _warp: cells.new_empty(cells.shape))


def _remember_sizes(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    del output
    values, *ctx.names, _, ctx.back = inputs
    ctx.size = list(values.shape[2:])


def _return_values(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    call = torch.ops.fovden.resample if torch.compiler.is_compiling() else _Resampled.apply
    return call(gradient, *ctx.names, ctx.size, not ctx.back), None, None, None, None


def _remember_cells(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    del output
    ctx.save_for_backward(inputs[0])
    ctx.number = inputs[1]


def _return_cells(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
    (cells,) = ctx.saved_tensors
    slopes = warp_of(ctx.number).jacobian(cells)
    return (slopes * gradient[..., None]).sum(-2), None


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


class _Placed(torch.autograd.Function):
    """The points and their derivative, likewise."""

    @staticmethod
    def forward(*arguments: Any) -> Any:
        """Calls the operator."""
        return torch.ops.fovden.place_cells(*arguments)

    setup_context = staticmethod(_remember_cells)
    backward = staticmethod(_return_cells)

    @staticmethod
    def vmap(info: Any, axes: Any, cells: Tensor, number: int) -> tuple[Tensor, int]:
        """Takes the cells of a batch for more cells."""
        moved = cells.movedim(axes[0], 1)
        out = _Placed.apply(moved.flatten(1, 2), number)  # type: ignore[no-untyped-call]
        return out.unflatten(1, (info.batch_size, moved.shape[2])), 1


torch.library.register_autograd("fovden::resample", _return_values, setup_context=_remember_sizes)
torch.library.register_autograd("fovden::place_cells", _return_cells, setup_context=_remember_cells)
