"""Fills the pixels that no sampled tap has reached, from the nearest spacing of taps that has one.

How many steps that takes depends on the data, so a compiler cannot look into it: there it is an operator,
``fovden::fill_holes``, whose derivative runs it once more.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from torch import Tensor

from fovden.filters.taps import B3_SPLINE, SMALLEST_EXPONENT, SMALLEST_TOTAL, Sigma
from fovden.foveation import Topology

__all__ = ["fill_holes"]


def fill_holes(
    image: Tensor,
    holes: Tensor,
    mask: Tensor,
    normal: Tensor,
    position: Tensor,
    *,
    sigma_normal: Sigma,
    sigma_position: Sigma,
    label: Tensor | None = None,
    topology: Topology | None = None,
) -> Tensor:
    """Returns the image with its holes filled by the mean of sampled taps around them.

    A hole takes the mean of its 5 x 5 taps at step 1; if their weights sum to nothing, at step 2, then 4, and so on
    up to the image's size. Weights are those of :func:`fovden.filters.atrous_pass` without the radiance term. What is
    still a hole then goes through the same steps again with weights ``kernel * mask`` alone. A hole that was filled
    may be read by the larger steps that follow, so that none is left in a view that has any sample.

    In a polar raster taps are neighbours in its topology. What lies far from all samples there may not be reached at
    any step, since steps go at a constant angle from rows to rows of other heights; the last round is then run again.

    Args:
        image: Image, shape (v, c, h, w).
        holes: Which pixels to fill, bool, shape (v, 1, h, w).
        mask: Weight of each pixel as a tap, in [0, 1], shape (v, 1, h, w); that of holes counts as 0.
        normal: Unit normals, shape (v, 3, h, w).
        position: Positions, shape (v, 3, h, w).
        sigma_normal: Width of normals at step 1: a number, a scalar tensor, or one of shape (v, 1, h, w).
        sigma_position: Width of position, the same way.
        label: If given, shape (v, 1, h, w): a first round of steps reads taps with the pixel's own label only, with
            weights ``kernel * mask``.
        topology: The polar raster that the pixels are cells of; ``None`` means the screen. Only cells may be holes.

    Returns:
        The image; pixels that are no holes, and holes in a view without any sample, are as they were.

    Differentiable: in ``image``, ``mask``, the guides and the widths. Cost: 25 taps a step for each hole that is left.

    Example:
        >>> import torch
        >>> image = torch.zeros(1, 1, 8, 8).index_fill(3, torch.tensor(0), 2.0)
        >>> sampled = image > 0
        >>> flat = torch.zeros(1, 3, 8, 8)
        >>> fill_holes(image, ~sampled, sampled, flat, flat, sigma_normal=1.0, sigma_position=1.0).unique()
        tensor([2.])
    """
    if torch.compiler.is_compiling():
        widths = [torch.as_tensor(sigma, dtype=image.dtype) for sigma in (sigma_normal, sigma_position)]
        polar = (None, False) if topology is None else (topology.heights, topology.rotate)
        filled: Tensor = _fill_holes_operator(image, holes, mask, normal, position, *widths, label, *polar)
        return filled
    return _fill_holes(image, holes, mask, normal, position, sigma_normal, sigma_position, label, topology)


def _fill_holes(
    image: Tensor,
    holes: Tensor,
    mask: Tensor,
    normal: Tensor,
    position: Tensor,
    sigma_normal: Sigma,
    sigma_position: Sigma,
    label: Tensor | None,
    topology: Topology | None,
) -> Tensor:
    size, dtype = max(image.shape[-2:]), image.dtype
    steps = [2**k for k in range(size.bit_length()) if 2**k < size]
    view, _, y, x = holes.nonzero(as_tuple=True)
    if view.numel() == 0:
        return image
    readable = ~holes if topology is None else ~holes & topology.exists
    image, mask = image.clone(), mask.to(image.dtype).expand_as(holes) * readable
    reachable = (mask > 0).flatten(1).any(1)[view]
    view, y, x = view[reachable], y[reachable], x[reachable]

    rounds = ["geometry", "mask"] if label is None else ["label", "geometry", "mask"]
    for stage in rounds:
        left = view.numel()
        for step in steps:
            if view.numel() == 0:
                return image

            def read(tensor: Tensor, view: Tensor = view, y: Tensor = y, x: Tensor = x) -> Tensor:
                return tensor[view, :, y, x]

            def width(sigma: Sigma, read: Callable[[Tensor], Tensor] = read) -> Sigma:
                return read(sigma).to(dtype) if isinstance(sigma, Tensor) and sigma.dim() else sigma

            total = image.new_zeros(view.numel(), 1)
            weighted = image.new_zeros(view.numel(), image.shape[1])
            for i in range(5):
                for j in range(5):
                    ty, tx, inside = _step(image, y, x, (i - 2) * step, (j - 2) * step, topology)
                    at = view, ty, tx
                    weight = B3_SPLINE[i] * B3_SPLINE[j] * read(mask, *at) * inside[:, None]
                    if stage == "label" and label is not None:
                        weight = weight * (read(label) == read(label, *at))
                    if stage == "geometry":
                        turn = (read(normal) - read(normal, *at)).square().sum(1, keepdim=True)
                        gap = (read(position) - read(position, *at)).square().sum(1, keepdim=True)
                        exponent = turn / (step * width(sigma_normal)) ** 2 + gap / width(sigma_position) ** 2
                        weight = weight * exponent.neg().clamp(min=SMALLEST_EXPONENT).exp()
                    total = total + weight
                    weighted = weighted + weight * read(image, *at)
            found = (total > SMALLEST_TOTAL).squeeze(1)
            filled = view[found], slice(None), y[found], x[found]
            image[filled] = weighted[found] / total[found]
            mask[filled] = 1
            view, y, x = view[~found], y[~found], x[~found]
        if topology is not None and stage == "mask" and view.numel() < left:
            rounds.append("mask")
    return image


def _step(
    image: Tensor, y: Tensor, x: Tensor, dy: int, dx: int, topology: Topology | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Rows and columns of the taps of some pixels, and whether they count."""
    if topology is not None:
        tx, ty = topology.neighbour(torch.stack([x, y], dim=-1), dx, dy).unbind(-1)
        return ty, tx, torch.ones_like(tx, dtype=torch.bool)
    ty, tx = y + dy, x + dx
    inside = (ty >= 0) & (ty < image.shape[2]) & (tx >= 0) & (tx < image.shape[3])
    return ty.clamp(0, image.shape[2] - 1), tx.clamp(0, image.shape[3] - 1), inside


@torch.library.custom_op("fovden::fill_holes", mutates_args=())
def _fill_holes_operator(
    image: Tensor,
    holes: Tensor,
    mask: Tensor,
    normal: Tensor,
    position: Tensor,
    sigma_normal: Tensor,
    sigma_position: Tensor,
    label: Tensor | None,
    heights: Tensor | None,
    rotate: bool,
) -> Tensor:
    topology = None if heights is None else Topology(heights, image.shape[2], rotate)
    return _fill_holes(image, holes, mask, normal, position, sigma_normal, sigma_position, label, topology).clone()


@_fill_holes_operator.register_fake
def _(image: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(image)


@torch.library.custom_op("fovden::fill_holes_backward", mutates_args=())
def _fill_holes_backward(
    gradient: Tensor,
    image: Tensor,
    holes: Tensor,
    mask: Tensor,
    normal: Tensor,
    position: Tensor,
    sigma_normal: Tensor,
    sigma_position: Tensor,
    label: Tensor | None,
    heights: Tensor | None,
    rotate: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    sigmas = sigma_normal, sigma_position
    topology = None if heights is None else Topology(heights, image.shape[2], rotate)

    def differentiate() -> tuple[Tensor, ...]:
        tensors = image, mask, normal, position, *sigmas
        leaves = [each.detach().to(image.dtype).requires_grad_() for each in tensors]
        colour, weight, n, x, *widths = leaves
        filled = _fill_holes(colour, holes, weight, n, x, widths[0], widths[1], label, topology)
        return torch.autograd.grad(filled, leaves, gradient, materialize_grads=True)

    # Inside an operator PyTorch records nothing for a derivative; in another thread it does.
    with ThreadPoolExecutor(1) as executor:
        returned = [each.contiguous() for each in executor.submit(differentiate).result()]
    return tuple(returned)  # type: ignore[return-value]


@_fill_holes_backward.register_fake
def _(_: Tensor, image: Tensor, __: Tensor, *others: Any) -> tuple[Tensor, ...]:
    return tuple(image.new_empty(each.shape) for each in (image, *others[:5]))


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    del output
    *tensors, ctx.rotate = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    image, *others = _fill_holes_backward(gradient, *ctx.saved_tensors, ctx.rotate)
    return image, None, *others, None, None, None


_fill_holes_operator.register_autograd(_backward, setup_context=_remember)
