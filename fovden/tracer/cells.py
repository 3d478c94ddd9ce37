"""Where the rays of cells pass the screen, as the kernels read it."""

from __future__ import annotations

import torch
from torch import Tensor

from fovden.camera import Camera, StereoCamera
from fovden.warps import Warp
from fovden.warps._checks import require_camera

__all__ = ["cell_points", "require_raster"]


def cell_points(warp: Warp | None, jitter: tuple[float, float] = (0.0, 0.0)) -> Tensor:
    """Returns the raster coordinates through which the rays of cells pass, for the kernels.

    Args:
        warp: The raster; ``None`` for the camera's own grid, which kernels know by themselves.
        jitter: Shift (x, y) within the cell.

    Returns:
        Coordinates (x, y) in pixels of the screen, NaN where there is no cell, float32, shape (v, h, w, 2); empty
        without a warp.

    Raises:
        ValueError: If the jitter leaves the cell.

    Example:
        >>> from fovden.camera import Gaze
        >>> from fovden.warps import ScreenWarp
        >>> cell_points(ScreenWarp(Gaze(torch.zeros(1, 2)), (1, 2), (1, 2)))[0, 0]
        tensor([[0.5000, 0.5000],
                [1.5000, 0.5000]])
    """
    if warp is None:
        return torch.zeros(0, 0, 0, 2)
    points = warp.positions(jitter).detach().float().reshape(-1, *warp.resolution, 2)
    return torch.where(warp.exists[0, 0, :, :, None], points, torch.nan).cpu().contiguous()


def require_raster(camera: Camera | StereoCamera, warp: Warp | None) -> tuple[int, int]:
    """Returns the height and width of a frame's images: the raster's, or without one the camera's.

    Args:
        camera: The views.
        warp: The raster.

    Raises:
        ShapeError: If camera and raster differ in the number of views.
        ValueError: If the raster is for a screen of another size.

    Example:
        >>> from fovden.camera import StereoCamera
        >>> from fovden.warps import LogPolarWarp
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(180, 90))
        >>> require_raster(camera, None), require_raster(camera, LogPolarWarp.for_camera(camera))
        ((180, 90), (100, 50))
    """
    if warp is None:
        return camera.views.resolution
    require_camera(warp, camera)
    return warp.resolution
