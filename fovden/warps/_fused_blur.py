"""The blur as an operator of PyTorch on compiled kernels: float32, on the CPU, with an exact adjoint in the image."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fovden.parallel import run
from fovden.warps.kernels.blur import Levels, blur_rows, return_rows

TILE = 24  # rows; on the way back those within a kernel's reach are weighed anew for each tile


def blurred(image: Tensor, gaze: Tensor, bounds: Tensor, steps: int) -> Tensor:
    """The blur between ``steps`` + 1 levels, with start, stop and sigma of each view as rows of float64 bounds."""
    arguments = image, gaze, bounds, steps, False
    if torch.compiler.is_compiling():
        return torch.ops.fovden.eccentricity_blur(*arguments)  # type: ignore[no-any-return]
    return _Blurred.apply(*arguments)  # type: ignore[no-any-return, no-untyped-call]


def _run(image: Tensor, gaze: Tensor, bounds: Tensor, steps: int, back: bool) -> Tensor:
    source = image.detach().contiguous().numpy()
    outcome, size = np.empty_like(source), source.shape[2:]
    largest = [float(bounds[2].max()) * step / steps for step in range(steps + 1)]
    radii = [0, *(max(1, math.ceil(3 * sigma)) for sigma in largest[1:])]
    for view, ((x, y), (start, stop, sigma)) in enumerate(zip(gaze.double().tolist(), bounds.T.tolist(), strict=True)):
        levels = _levels(x, y, start, steps / (stop - start), sigma, radii, size)
        run(return_rows if back else blur_rows, size[0], (levels, source[view], outcome[view]), tile=TILE)
    return torch.from_numpy(outcome)


def _levels(
    x: float, y: float, start: float, slope: float, sigma: float, radii: list[int], size: tuple[int, ...]
) -> Levels:
    count = len(radii) - 1
    reach = [[min(radius, length - 1) for length in size] for radius in radii]
    taps = np.zeros((count + 1, max(map(max, reach)) + 1), np.float32)
    norms = [np.ones((count + 1, length), np.float32) for length in size]
    for level, radius in enumerate(radii):
        width = max(sigma * level / count, 1e-3)  # narrower than this is no blur at all in any precision
        taps[level] = np.exp(-(np.arange(taps.shape[1]) ** 2) / (2 * width**2))
        for norm, length in zip(norms, size, strict=True):
            kernel = taps[level, : min(radius, length - 1) + 1].astype(np.float64)
            sums = np.convolve(np.ones(length), np.concatenate([kernel[:0:-1], kernel]))
            norm[level] = 1 / sums[len(kernel) - 1 :][:length]
    return Levels(x, y, start, slope, count, np.array(reach), taps, *norms)


torch.library.define(
    "fovden::eccentricity_blur", "(Tensor image, Tensor gaze, Tensor bounds, int steps, bool back) -> Tensor"
)
torch.library.impl("fovden::eccentricity_blur", "CPU", _run)
torch.library.register_fake("fovden::eccentricity_blur", lambda image, *_: image.new_empty(image.shape))


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    del output
    _, *tensors, ctx.steps, ctx.back = inputs
    ctx.save_for_backward(*tensors)


def _return(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    back = _Blurred.apply(gradient, *ctx.saved_tensors, ctx.steps, not ctx.back)  # type: ignore[no-untyped-call]
    return back, None, None, None, None


class _Blurred(torch.autograd.Function):
    """The operator and its derivative, which is its adjoint, also where ``torch.func`` takes it."""

    @staticmethod
    def forward(*arguments: Any) -> Any:
        """Calls the operator."""
        return torch.ops.fovden.eccentricity_blur(*arguments)

    setup_context = staticmethod(_remember)
    backward = staticmethod(_return)

    @staticmethod
    def vmap(info: Any, axes: Any, image: Tensor, *rest: Any) -> tuple[Tensor, int]:
        """Takes the images of a batch for channels."""
        moved = image.movedim(axes[0], 2)
        out = _Blurred.apply(moved.flatten(1, 2), *rest)  # type: ignore[no-untyped-call]
        return out.unflatten(1, (moved.shape[1], info.batch_size)), 2


torch.library.register_autograd("fovden::eccentricity_blur", _return, setup_context=_remember)
