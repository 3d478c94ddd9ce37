"""The screen's own grid as a warp: what every raster is compared with."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_shapes
from fovden.warps._checks import gaze_of
from fovden.warps.base import Prefilter, Warp

__all__ = ["ScreenWarp"]


@dataclass(frozen=True, eq=False)
class ScreenWarp(Warp):
    """Cells that are the pixels themselves; neighbours are clamped at the image's edges.

    Attributes:
        gaze: Where each eye looks; it changes nothing here.
        screen: Height and width of the screen in pixels.
        resolution: The same.

    Raises:
        ValueError: If the two resolutions differ.

    Example:
        >>> warp = ScreenWarp(Gaze(torch.zeros(2, 2)), (4, 6), (4, 6))
        >>> warp.heights, warp.cells_per_pixel, bool(warp.valid.all())
        (tensor([4, 4, 4, 4, 4, 4]), 1.0, True)
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.resolution == self.screen, "resolution", self.resolution, f"the screen's, {self.screen}")

    @classmethod
    def for_camera(cls, camera: Camera | StereoCamera, gaze: Gaze | None = None) -> ScreenWarp:
        """Returns the warp of a camera's own raster; without a gaze its centre.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 6))
            >>> ScreenWarp.for_camera(camera).resolution
            (4, 6)
        """
        return cls(gaze_of(camera, gaze), camera.views.resolution, camera.views.resolution)

    @property
    def name(self) -> str:
        """``"screen"``."""
        return "screen"

    @property
    def heights(self) -> Tensor:
        """The screen's height for each column, int64, shape (w,)."""
        return torch.full((self.screen[1],), self.screen[0], device=self.gaze.pixels.device)

    def cell_to_screen(self, cells: Tensor) -> Tensor:
        """Returns the coordinates as they are.

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).cell_to_screen(torch.ones(1, 1, 2))
            tensor([[[1., 1.]]])
        """
        require_shapes("v n 2", {"v": self.view_count}, cells=cells)
        return cells

    def screen_to_cell(self, points: Tensor) -> Tensor:
        """Returns the coordinates as they are.

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).screen_to_cell(torch.ones(1, 1, 2))
            tensor([[[1., 1.]]])
        """
        require_shapes("v n 2", {"v": self.view_count}, points=points)
        return points

    def jacobian(self, cells: Tensor) -> Tensor:
        """Returns identity matrices, shape (v, n, 2, 2).

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).jacobian(torch.ones(1, 3, 2)).shape
            torch.Size([1, 3, 2, 2])
        """
        require_shapes("v n 2", {"v": self.view_count}, cells=cells)
        return torch.eye(2).to(cells).expand(*cells.shape[:2], 2, 2)

    def density(self, points: Tensor) -> Tensor:
        """Returns 1 for every point, shape (v, n).

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).density(torch.ones(1, 2, 2))
            tensor([[1., 1.]])
        """
        require_shapes("v n 2", {"v": self.view_count}, points=points)
        return torch.ones_like(points[..., 0])

    def neighbour(self, cells: Tensor, dx: int, dy: int) -> Tensor:
        """Returns the pixels some columns and rows away, clamped at the edges.

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).neighbour(torch.tensor([0, 1]), -1, 1)
            tensor([0, 2])
        """
        height, width = self.screen
        x, y = (cells + torch.tensor([dx, dy], device=cells.device)).unbind(-1)
        return torch.stack([x.clamp(0, width - 1), y.clamp(0, height - 1)], dim=-1)

    def to_screen(self, image: Tensor, mask: Tensor | None = None, *, prefilter: Prefilter = "area") -> Tensor:  # noqa: ARG002
        """Returns the image as it is; 0 where a mask is.

        Example:
            >>> image = torch.rand(1, 3, 4, 6)
            >>> torch.equal(ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).to_screen(image), image)
            True
        """
        self._require_image(image, mask)
        return image if mask is None else torch.where(mask > 0, image, torch.zeros_like(image))
