"""Whether warps differ in more than their gaze, and several of them as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from fovden.camera import Gaze

if TYPE_CHECKING:  # a frame may hold a warp, but is imported without the kernels of one
    from fovden.warps import Warp


def alike(first: Warp | None, second: Warp | None) -> bool:
    """Whether two warps are of one class with the same parameters, whatever their gaze; or both are none."""
    if first is None or second is None:
        return first is second
    names = [field.name for field in fields(first) if field.name != "gaze"]
    return type(first) is type(second) and all(_equal(getattr(first, n), getattr(second, n)) for n in names)


def same(first: Warp | None, second: Warp | None) -> bool:
    """Whether two warps lay the same cells: alike, with the same gaze; or both are none."""
    if first is second:
        return True
    gazes = [warp.gaze.pixels for warp in (first, second) if warp is not None]
    return alike(first, second) and torch.equal(*gazes)


def stacked(warps: Sequence[Warp]) -> Warp | None:
    """A warp with the views of warps that are alike, in turn; ``None`` of no warps."""
    return replace(warps[0], gaze=Gaze(torch.cat([warp.gaze.pixels for warp in warps]))) if warps else None


def _equal(first: object, second: object) -> bool:
    if isinstance(first, Tensor) or isinstance(second, Tensor):
        return float(first) == float(second)  # type: ignore[arg-type]  # parameters are numbers or scalar tensors
    return first == second
