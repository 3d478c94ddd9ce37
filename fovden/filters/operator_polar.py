"""``fovden::atrous_polar``: a stack of à-trous passes on a polar raster as one PyTorch operator with its derivative.

In float32 on the CPU, on compiled kernels (:mod:`fovden.filters.fused_polar`), as ``fovden::atrous`` is for the screen.
The operator is opaque to ``torch.compile`` and ``torch.export``, which know the shapes of what it returns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from fovden.checks import require
from fovden.filters.fused import Blended, Inputs, Returned
from fovden.filters.fused_polar import blend_polar_stack, places_of, return_polar_gradients

__all__ = ["atrous_polar"]

TENSORS = tuple(field.name for field in fields(Inputs))[:9]


@torch.library.custom_op("fovden::atrous_polar", mutates_args=(), device_types="cpu")
def _atrous_polar(
    radiance: Tensor,
    normal: Tensor,
    position: Tensor,
    mask: Tensor,
    known: Tensor | None,
    region: Tensor | None,
    inverse: Tensor,
    factors: Tensor | None,
    kernels: Tensor | None,
    steps: Sequence[int],
    labels: Sequence[int],
    levels: Sequence[int],
    fill: bool,
    heights: Tensor,
    rotate: bool,
    save: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    tensors = radiance, normal, position, mask, known, region, inverse, factors, kernels
    blended = blend_polar_stack(Inputs(*tensors, steps, labels, levels, fill), heights, rotate, save=save)
    return blended if fill else blended._replace(mask=mask.new_empty(0))  # what is returned must not be an argument


@_atrous_polar.register_fake
def _(*arguments: Any) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    radiance, mask, levels, fill, save = (arguments[place] for place in (0, 3, 11, 12, 15))
    views, _, height, width = radiance.shape
    image, known = radiance.new_empty(radiance.shape), mask.new_empty(mask.shape, dtype=torch.bool)
    after = mask.new_empty(mask.shape if fill else 0)
    tape = radiance.new_empty(len(set(levels)) if save else 0, views, 5 if fill else 4, width, places_of(height))
    return image, known, after, tape


@torch.library.custom_op("fovden::atrous_polar_backward", mutates_args=(), device_types="cpu")
def _atrous_polar_backward(
    gradient: Tensor,
    mask_gradient: Tensor | None,
    image: Tensor,
    tape: Tensor,
    everything: bool,
    radiance: Tensor,
    normal: Tensor,
    position: Tensor,
    mask: Tensor,
    known: Tensor | None,
    region: Tensor | None,
    inverse: Tensor,
    factors: Tensor | None,
    kernels: Tensor | None,
    steps: Sequence[int],
    labels: Sequence[int],
    levels: Sequence[int],
    fill: bool,
    heights: Tensor,
    rotate: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    tensors = radiance, normal, position, mask, known, region, inverse, factors, kernels
    inputs, blended = Inputs(*tensors, steps, labels, levels, fill), Blended(image, mask, mask, tape)
    returned = return_polar_gradients(
        inputs, heights, rotate, blended, gradient, mask_gradient, everything=everything
    )  # fmt: skip
    outputs = [radiance.new_empty(0) if each is None else each for each in returned]
    return tuple(outputs)  # type: ignore[return-value]


@_atrous_polar_backward.register_fake
def _(*arguments: Any) -> tuple[Tensor, ...]:
    everything = arguments[4]
    radiance, normal, position, mask, _, _, inverse, factors, kernels = arguments[5:14]
    guides = (normal, position, mask) if everything else (None, None, None)
    wanted = radiance, *guides, inverse, factors, kernels
    return tuple(radiance.new_empty(0 if each is None else each.shape) for each in wanted)


def _remember(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    ctx.save_for_backward(*inputs[:9], inputs[13], output[0], output[3])
    ctx.numbers, ctx.rotate = inputs[9:13], inputs[14]
    ctx.mark_non_differentiable(output[1], output[3])
    ctx.set_materialize_grads(False)  # the tape would get zeros of its own size


def _backward(ctx: Any, gradient: Tensor | None, _: Any, mask_gradient: Tensor | None, __: Any) -> tuple[Any, ...]:
    *tensors, heights, image, tape = ctx.saved_tensors
    require(len(tape) > 0, "save", False, "True where gradients are wanted")
    gradient = torch.zeros_like(image) if gradient is None else gradient
    everything = any(ctx.needs_input_grad[1:4])
    fill = ctx.numbers[3]
    returned = _StackBackward.apply(  # type: ignore[no-untyped-call]
        gradient, mask_gradient if fill else None, image, tape, everything, *tensors, *ctx.numbers, heights, ctx.rotate
    )
    gradients = dict(zip(Returned._fields, returned, strict=True))
    wanted = [
        gradients[name] if needed and name in gradients else None
        for name, needed in zip(TENSORS, ctx.needs_input_grad[: len(TENSORS)], strict=True)
    ]
    return (*wanted, *[None] * 7)


class _Stack(torch.autograd.Function):
    """The operator and its derivative, also where ``torch.func`` takes it, which an operator alone does not serve."""

    @staticmethod
    def forward(*arguments: Any) -> Any:
        """Calls the operator."""
        return _atrous_polar(*arguments)

    setup_context = staticmethod(_remember)
    backward = staticmethod(_backward)


def _remember_nothing(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    pass


def _refuse(ctx: Any, *returned: Tensor) -> Any:
    raise NotImplementedError(
        "fovden::atrous_polar has no second derivative; in float64 the passes are composed, with one"
    )


class _StackBackward(torch.autograd.Function):
    """The derivative, which has none of its own."""

    @staticmethod
    def forward(*arguments: Any) -> Any:
        """Calls the operator."""
        return _atrous_polar_backward(*arguments)

    setup_context = staticmethod(_remember_nothing)
    backward = staticmethod(_refuse)


_atrous_polar.register_autograd(_backward, setup_context=_remember)
_atrous_polar_backward.register_autograd(_refuse, setup_context=_remember_nothing)


def atrous_polar(
    radiance: Tensor,
    normal: Tensor,
    position: Tensor,
    mask: Tensor,
    known: Tensor | None,
    region: Tensor | None,
    inverse: Tensor,
    factors: Tensor | None,
    kernels: Tensor | None,
    steps: Sequence[int],
    labels: Sequence[int],
    levels: Sequence[int],
    fill: bool,
    heights: Tensor,
    rotate: bool,
    save: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns what a stack of à-trous passes makes of images on a polar raster.

    Args:
        radiance: Radiance, shape (v, 3, h, w), a column for each distance from the gaze.
        normal: Normals, the same shape.
        position: Positions, the same shape.
        mask: Weight of each cell as a tap, in [0, 1], shape (v, 1, h, w).
        known: Which cells have a value of their own, bool, shape (v, 1, h, w); ``None`` means all.
        region: Labels from 0 to 30, bytes, shape (v, 1, h, w); ``None`` means 0.
        inverse: Inverse squared widths of radiance, normal (times the step) and position in each pass, shape (p, 3).
        factors: What these are multiplied by at each cell, shape (v, 3, h, w); ``None`` means 1.
        kernels: Kernel of each pass, rows (angles) first, positive, shape (p, 5, 5); ``None`` means the B3 spline.
        steps: Distance between the taps of each pass, in columns and in rows.
        labels: Label of the cells that each pass works on.
        levels: Number of each pass's level; neighbours of one level read the same image.
        fill: Whether a filled cell counts as a tap, with weight 1, from the next level on.
        heights: Number of cells of each column, from 1 to h, int64, shape (w,).
        rotate: Whether what lies before column 0 is the column on the other side of the gaze, instead of column 0.
        save: Whether to keep what the derivative needs; must be true where one is wanted.

    Returns:
        Radiance, shape (v, 3, h, w); which cells have a value now, bool, (v, 1, h, w); the mask now, the same shape, or
        of no elements unless passes fill it; and what was kept. The first three are 0 below the columns' heights, where
        nothing is ever read.

    Raises:
        ShapeError: If there is not one height for each column.
        ValueError: If a height is out of range.
        NotImplementedError: Where a second derivative is asked for.

    Differentiable: in all that is real: images, mask, inverse squared widths, factors and kernels; once.

    Cost: about one and a half times that of as many pixels of the screen.

    Example:
        >>> flat, mask, row = torch.zeros(1, 3, 4, 3), torch.ones(1, 1, 4, 3), torch.ones(1, 3)
        >>> numbers, heights = ((1,), (0,), (0,), False), torch.tensor([1, 3, 4])
        >>> image, *_ = atrous_polar(
        ...     flat + 2, flat, flat, mask, None, None, row, None, None, *numbers, heights, False, False
        ... )
        >>> image[0, 0]
        tensor([[2., 2., 2.],
                [0., 2., 2.],
                [0., 2., 2.],
                [0., 0., 2.]])
    """
    call = _atrous_polar if torch.compiler.is_compiling() else _Stack.apply
    found: tuple[Tensor, Tensor, Tensor, Tensor] = call(  # type: ignore[no-untyped-call]
        radiance, normal, position, mask, known, region, inverse, factors, kernels, steps, labels, levels, fill,
        heights, rotate, save,
    )  # fmt: skip
    return found
