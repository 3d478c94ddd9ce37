"""``fovden::atrous``: a stack of à-trous passes as one PyTorch operator with its own derivative.

In float32 on the CPU it runs on compiled kernels: :mod:`fovden.filters.fused` on the screen, and on a polar raster,
whose columns have heights, :mod:`fovden.filters.fused_polar`. :func:`run_passes` calls it, and otherwise composes the
same of torch operations (:func:`fovden.filters.passes.compose`): on other devices, in float64, and for the readings of
the weights that are there to be studied. A second derivative is that of the composed form.

The operator is opaque to ``torch.compile`` and ``torch.export``, which know the shapes of what it returns.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import torch
from torch import Tensor

from fovden.checks import require
from fovden.filters.fused import Blended, Inputs, Returned, blend_stack, return_gradients
from fovden.filters.fused_polar import NOWHERE, blend_polar_stack, places_of, return_polar_gradients
from fovden.filters.passes import Pass, PassOptions, State, compose
from fovden.filters.taps import Sigmas
from fovden.foveation import Topology

__all__ = ["run_passes"]

TENSORS = ("radiance", "normal", "position", "mask", "known", "region", "inverse", "factors", "kernels", "heights")
GRADIENTS = Returned._fields


@torch.library.custom_op("fovden::atrous", mutates_args=(), device_types="cpu")
def _atrous(
    radiance: Tensor,
    normal: Tensor,
    position: Tensor,
    mask: Tensor,
    known: Tensor | None,
    region: Tensor | None,
    inverse: Tensor,
    factors: Tensor | None,
    kernels: Tensor | None,
    heights: Tensor | None,
    steps: Sequence[int],
    labels: Sequence[int],
    levels: Sequence[int],
    fill: bool,
    rotate: bool,
    save: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    tensors = radiance, normal, position, mask, known, region, inverse, factors, kernels
    inputs = Inputs(*tensors, steps, labels, levels, fill)
    if heights is None:
        blended = blend_stack(inputs, save=save)
    else:
        blended = blend_polar_stack(inputs, heights, rotate, save=save)
    return blended if fill else blended._replace(mask=mask.new_empty(0))  # what is returned must not be an argument


@_atrous.register_fake
def _(*arguments: Any) -> tuple[Tensor, ...]:
    radiance, mask, heights, levels, fill, save = (arguments[place] for place in (0, 3, 9, 12, 13, 15))
    views, _, height, width = radiance.shape
    image, known = radiance.new_empty(radiance.shape), mask.new_empty(mask.shape, dtype=torch.bool)
    after = mask.new_empty(mask.shape if fill else 0)
    size = (height, width) if heights is None else (width, places_of(height))
    count = len(list(groupby(levels))) if save else 0  # of neighbours, as the kernels take them
    images = radiance.new_empty(max(count - 1, 0), views, 3, *size)
    return image, known, after, images, radiance.new_empty(count, 2 if fill else 1, views, 1, *size)


@torch.library.custom_op("fovden::atrous_backward", mutates_args=(), device_types="cpu")
def _atrous_backward(
    gradient: Tensor,
    mask_gradient: Tensor | None,
    image: Tensor,
    images: Tensor,
    totals: Tensor,
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
    heights: Tensor | None,
    steps: Sequence[int],
    labels: Sequence[int],
    levels: Sequence[int],
    fill: bool,
    rotate: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    tensors = radiance, normal, position, mask, known, region, inverse, factors, kernels
    inputs, blended = Inputs(*tensors, steps, labels, levels, fill), Blended(image, mask, mask, images, totals)
    seeds = gradient, mask_gradient
    if heights is None:
        returned = return_gradients(inputs, blended, *seeds, everything=everything)
    else:
        returned = return_polar_gradients(inputs, heights, rotate, blended, *seeds, everything=everything)
    outputs = [radiance.new_empty(0) if each is None else each for each in returned]
    return tuple(outputs)  # type: ignore[return-value]


@_atrous_backward.register_fake
def _(*arguments: Any) -> tuple[Tensor, ...]:
    everything = arguments[5]
    radiance, normal, position, mask, _, _, inverse, factors, kernels = arguments[6:15]
    guides = (normal, position, mask) if everything else (None, None, None)
    wanted = radiance, *guides, inverse, factors, kernels
    return tuple(radiance.new_empty(0 if each is None else each.shape) for each in wanted)


def _remember(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    ctx.save_for_backward(*inputs[: len(TENSORS)], output[0], *output[3:])
    ctx.numbers = inputs[len(TENSORS) : -1]
    ctx.mark_non_differentiable(output[1], *output[3:])
    ctx.set_materialize_grads(False)  # what was saved would get zeros of its own size


def _backward(ctx: Any, gradient: Tensor | None, _: Any, mask_gradient: Tensor | None, *__: Any) -> tuple[Any, ...]:
    *tensors, image, images, totals = ctx.saved_tensors
    require(len(totals) > 0, "save", False, "True where gradients are wanted")
    gradient = torch.zeros_like(image) if gradient is None else gradient
    everything = any(ctx.needs_input_grad[1:4])
    fill = ctx.numbers[3]
    returned = _StackBackward.apply(  # type: ignore[no-untyped-call]
        gradient, mask_gradient if fill else None, image, images, totals, everything, *tensors, *ctx.numbers
    )
    gradients = dict(zip(GRADIENTS, returned, strict=True))
    wanted = [
        gradients[name] if needed and name in gradients else None
        for name, needed in zip(TENSORS, ctx.needs_input_grad[: len(TENSORS)], strict=True)
    ]
    return (*wanted, *[None] * (len(ctx.numbers) + 1))


class _Stack(torch.autograd.Function):
    """The operator and its derivative, also where ``torch.func`` takes it, which an operator alone does not serve."""

    @staticmethod
    def forward(*arguments: Any) -> Any:
        """Calls the operator."""
        return _atrous(*arguments)

    setup_context = staticmethod(_remember)
    backward = staticmethod(_backward)


_atrous.register_autograd(_backward, setup_context=_remember)


def _remember_backward(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    ctx.save_for_backward(*inputs[:2], *inputs[6 : 6 + len(TENSORS)])
    ctx.numbers = inputs[6 + len(TENSORS) :]
    ctx.sizes = [each.numel() for each in output]


def _backward_twice(ctx: Any, *returned: Tensor) -> tuple[Any, ...]:
    gradient, mask_gradient, *tensors = ctx.saved_tensors
    with torch.enable_grad():
        seeds = [None if each is None else each.detach().requires_grad_() for each in (gradient, mask_gradient)]
        named = dict(zip(TENSORS, tensors, strict=True))
        for name in GRADIENTS:
            if named[name] is not None:
                named[name] = named[name].detach().requires_grad_()
        outcome = _compose(named, *ctx.numbers)
        outputs = [(outcome.image, seeds[0])] + ([] if seeds[1] is None else [(outcome.mask, seeds[1])])
        names = [name for name, size in zip(GRADIENTS, ctx.sizes, strict=True) if size and named[name] is not None]
        first = torch.autograd.grad(
            [output for output, _ in outputs],
            [named[name] for name in names],
            [seed for _, seed in outputs],
            create_graph=True,
            materialize_grads=True,
        )
        cotangents = dict(zip(GRADIENTS, returned, strict=True))
        leaves = [
            *(seed for seed in seeds if seed is not None),
            *(named[name] for name in GRADIENTS if named[name] is not None),
        ]
        second = iter(
            torch.autograd.grad(
                first,
                leaves,
                [cotangents[name] for name in names],
                create_graph=torch.is_grad_enabled(),
                allow_unused=True,
            )
        )
    seeded = [None if seed is None else next(second) for seed in seeds]
    found = {name: next(second) for name in GRADIENTS if named[name] is not None}
    return (*seeded, None, None, None, None, *(found.get(name) for name in TENSORS), *[None] * len(ctx.numbers))


class _StackBackward(torch.autograd.Function):
    """The derivative and its own."""

    @staticmethod
    def forward(*arguments: Any) -> Any:
        """Calls the operator."""
        return _atrous_backward(*arguments)

    setup_context = staticmethod(_remember_backward)
    backward = staticmethod(_backward_twice)


_atrous_backward.register_autograd(_backward_twice, setup_context=_remember_backward)


def _compose(
    tensors: dict[str, Any],
    steps: Sequence[int],
    labels: Sequence[int],
    levels: Sequence[int],
    fill: bool,
    rotate: bool,
) -> State:
    """The operator's arguments, composed of torch operations."""
    widths, kernels = tensors["inverse"] ** -0.5, tensors["kernels"]
    passes = [
        Pass(step, Sigmas(own[0], own[1] / step, own[2]), label, level, None if kernels is None else kernels[number])
        for number, (own, step, label, level) in enumerate(zip(widths.unbind(), steps, labels, levels, strict=True))
    ]
    factors, heights = tensors["factors"], tensors["heights"]
    known = None if tensors["known"] is None else tensors["known"] > 0
    state = State(tensors["radiance"], tensors["mask"], known, tensors["radiance"])
    topology = None if heights is None else Topology(heights, tensors["mask"].shape[2], rotate)
    outcome = compose(
        state, tensors["normal"], tensors["position"], passes, region=tensors["region"],
        factors=None if factors is None else factors**-0.5, options=PassOptions(fill=fill), topology=topology,
    )  # fmt: skip
    if topology is None:
        return outcome
    image, mask = (torch.where(topology.exists, each, 0) for each in (outcome.image, outcome.mask))
    return outcome._replace(image=image, mask=mask)  # what is no cell comes out of the kernels as 0


def run_passes(
    state: State,
    normal: Tensor,
    position: Tensor,
    passes: Sequence[Pass],
    *,
    region: Tensor | None = None,
    factors: Tensor | None = None,
    options: PassOptions,
    topology: Topology | None = None,
) -> State:
    """Returns the state after a stack of passes: fused where that is possible, composed of torch operations elsewhere.

    Fused are float32 tensors on the CPU with three channels of radiance, with the taps outside the image left out and
    the image so far as a guide, as it is, which are the defaults. Kernels, where there are any, must belong to all
    passes, each of which must have a level of its own.

    Args:
        state: The state before.
        normal: Unit normals, shape (v, 3, h, w).
        position: Positions, shape (v, 3, h, w).
        passes: The passes.
        region: Labels from 0 to 30, integers, shape (v or 1, 1, h, w); ``None`` means 0 everywhere.
        factors: What the widths of radiance, normal and position are multiplied by at each pixel, positive,
            shape (v, 3, h, w); ``None`` means 1.
        options: Readings of the weights.
        topology: The polar raster that the pixels are cells of; ``None`` means the screen.

    Returns:
        The state after.

    Differentiable: in image, mask, guides, widths, kernels and factors, twice.
    Fused, five passes over two views of 960 x 1080 pixels keep 141 MB for the way back, or 182 MB where they fill
    the mask, and nothing where no gradient is wanted.

    Example:
        >>> from fovden.filters.passes import begin
        >>> flat = torch.zeros(1, 3, 4, 4)
        >>> half = begin(flat + 2, torch.tensor([1.0, 0.0, 1.0, 0.0]).expand(1, 1, 4, 4))
        >>> stack = [Pass(2, Sigmas(1.0, 1.0, 1.0), level=0), Pass(1, Sigmas(1.0, 1.0, 1.0), level=1)]
        >>> run_passes(half, flat, flat, stack, options=PassOptions()).image.mean()
        tensor(2.)
    """
    if not passes:
        return state
    if not _can_fuse(state, passes, options):
        return compose(
            state, normal, position, passes, region=region, factors=factors, options=options, topology=topology
        )
    image, mask, known, first = state
    dtype = image.dtype
    if region is not None:
        region = region.to(torch.uint8).expand_as(mask)
    if topology is not None and topology.seen is not None:
        region = torch.where(topology.active, 0 if region is None else region, NOWHERE).to(torch.uint8)
    taps = mask
    if options.mask_at == "center":
        inside = torch.zeros_like(mask, dtype=torch.uint8) if region is None else region
        region, taps = torch.where(mask > 0, inside, NOWHERE), torch.ones_like(mask)
        known = state.has_value()
    widths = [
        torch.stack([torch.as_tensor(sigma, dtype=dtype) for sigma in (s.radiance, step * s.normal, s.position)])
        for step, s, *_ in passes
    ]
    taps_of = [each.kernel.to(dtype) for each in passes if each.kernel is not None]
    kernels = torch.stack(taps_of) if taps_of else None
    inverse = torch.stack(widths) ** -2
    factors = None if factors is None else factors.to(dtype).expand_as(image) ** -2
    wanted = (image, normal, position, taps, inverse, factors, kernels)
    save = torch.is_grad_enabled() and any(each is not None and each.requires_grad for each in wanted)
    arguments = (
        image,
        normal.to(dtype),
        position.to(dtype),
        taps,
        (1 + state.has_value().to(dtype)) / 2 if options.unsampled_guide == "literal" else known,
        region,
        inverse,
        factors,
        kernels,
        None if topology is None else topology.heights,
        [each.step for each in passes],
        [each.label for each in passes],
        [each.level for each in passes],
        options.fill,
        topology is not None and topology.rotate,
        save,
    )
    call = _atrous if torch.compiler.is_compiling() else _Stack.apply
    after, filled, next_mask, *_ = call(*arguments)  # type: ignore[no-untyped-call]
    return State(after, next_mask if options.fill else mask, filled, first)


def _can_fuse(state: State, passes: Sequence[Pass], options: PassOptions) -> bool:
    image = state.image
    kernels = [each.kernel is not None for each in passes]
    joined = len({each.level for each in passes}) < len(passes)
    return (
        image.device.type == "cpu"
        and image.dtype == torch.float32
        and image.shape[1] == 3
        and options.guide == "current"
        and options.unsampled_guide != "nearest"
        and options.border == "skip"
        and options.guide_curve == "linear"
        and (not any(kernels) or (all(kernels) and not joined))
        and all(0 <= each.label < NOWHERE for each in passes)
    )
