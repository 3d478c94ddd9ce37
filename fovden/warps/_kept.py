"""What a warp finds once and keeps, and where kernels serve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from fovden.camera import Gaze

if TYPE_CHECKING:
    from fovden.warps.polar import PolarWarp


def is_fixed(warp: PolarWarp) -> bool:
    """Whether no gradient is wanted of the gaze, or of what else is a tensor."""
    return not any(isinstance(each, Tensor) and each.requires_grad for each in (warp.gaze.pixels, *vars(warp).values()))


def is_compiled(warp: PolarWarp, values: Tensor) -> bool:
    """Whether kernels serve: for float32 on the CPU, and a warp that is fixed."""
    devices = {values.device.type, warp.gaze.pixels.device.type}
    return devices == {"cpu"} and values.dtype == torch.float32 and is_fixed(warp)


def for_each_view(warp: PolarWarp, name: str, make: Callable[[PolarWarp], Any]) -> list[Any]:
    """What is made of each view, as a warp of its own; kept under a name if the warp is fixed."""
    views = (replace(warp, gaze=Gaze(pixels[None])) for pixels in warp.gaze.pixels)
    if not is_fixed(warp):
        return [make(view) for view in views]
    if name not in warp._kept:
        with torch.inference_mode(False), torch.no_grad():  # kept for later calls, whose mode may be another
            warp._kept[name] = [make(view) for view in views]
    return warp._kept[name]
