"""Checks of what warps are made from."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_finite, require_number, require_shapes

if TYPE_CHECKING:
    from fovden.warps.base import Warp


def require_parameter(name: str, value: float | Tensor, *, above: float, maximum: float = math.inf) -> None:
    """Raises unless a value is a number or a scalar tensor within bounds."""
    if isinstance(value, Tensor):
        require_shapes("", **{name: value})
        require(value.is_floating_point(), name, value.dtype, "a floating type")
        require_finite(name, value)
        if torch.compiler.is_compiling():
            return
        value = value.item()
    require_number(name, value, above=above, maximum=maximum)


def gaze_of(camera: Camera | StereoCamera, gaze: Gaze | None) -> Gaze:
    """The gaze, or the centre, with as many views as the camera has."""
    gaze = Gaze.center(camera).to(camera.views.origin.device) if gaze is None else gaze
    require_shapes("v 2", {"v": camera.views.view_count}, **{"gaze.pixels": gaze.pixels})
    return gaze


def require_camera(warp: Warp, camera: Camera | StereoCamera) -> None:
    """Raises unless a warp is for the views and the screen of a camera."""
    views = camera.views
    require_shapes("v 2", {"v": views.view_count}, **{"warp.gaze.pixels": warp.gaze.pixels})
    require(views.resolution == warp.screen, "camera.resolution", views.resolution, f"the screen's, {warp.screen}")
