"""The screen's own grid as a warp, and coarser ones of the same shape: what every raster is compared with."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require_shapes
from fovden.warps._checks import gaze_of
from fovden.warps._resample import divided
from fovden.warps.base import Prefilter, Warp

__all__ = ["ScreenWarp"]


@dataclass(frozen=True, eq=False)
class ScreenWarp(Warp):
    """Cells in even rows and columns: pixels, or fewer and larger cells, as when a whole image is rendered smaller.

    Neighbours are clamped at the image's edges. On the way to the screen cells are interpolated bilinearly, and
    averaged where they are smaller than pixels; with the screen's resolution nothing is done at all.

    Attributes:
        gaze: Where each eye looks; it changes nothing here.
        screen: Height and width of the screen in pixels.
        resolution: Height and width in cells.

    Differentiable: nothing depends on the gaze.

    Example:
        >>> warp = ScreenWarp(Gaze(torch.zeros(2, 2)), (4, 6), (2, 3))
        >>> warp.heights, warp.cells_per_pixel, bool(warp.valid.all())
        (tensor([2, 2, 2]), 0.25, True)
        >>> warp.to_screen(torch.tensor([[0.0, 4.0, 8.0], [0.0, 4.0, 8.0]]).expand(2, 1, 2, 3))[0, 0, 0]
        tensor([0., 1., 3., 5., 7., 8.])
    """

    @classmethod
    def for_camera(
        cls, camera: Camera | StereoCamera, gaze: Gaze | None = None, *, resolution: tuple[int, int] | None = None
    ) -> ScreenWarp:
        """Returns the warp of a camera's own raster, or a coarser one; without a gaze its centre.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 6))
            >>> ScreenWarp.for_camera(camera).resolution
            (4, 6)
        """
        screen = camera.views.resolution
        return cls(gaze_of(camera, gaze), screen, screen if resolution is None else resolution)

    @property
    def name(self) -> str:
        """``"screen"``."""
        return "screen"

    @property
    def heights(self) -> Tensor:
        """The raster's height for each column, int64, shape (w,)."""
        return torch.full((self.resolution[1],), self.resolution[0], device=self.gaze.pixels.device)

    def cell_to_screen(self, cells: Tensor) -> Tensor:
        """Returns the coordinates times the size of a cell.

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (2, 2)).cell_to_screen(torch.ones(1, 1, 2))
            tensor([[[3., 2.]]])
        """
        require_shapes("v n 2", {"v": self.view_count}, cells=cells)
        return (cells.double() * self._size(cells)).to(cells.dtype)

    def screen_to_cell(self, points: Tensor) -> Tensor:
        """Returns the coordinates over the size of a cell.

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (2, 2)).screen_to_cell(torch.tensor([[[3.0, 2.0]]]))
            tensor([[[1., 1.]]])
        """
        require_shapes("v n 2", {"v": self.view_count}, points=points)
        return (points.double() / self._size(points)).to(points.dtype)

    def jacobian(self, cells: Tensor) -> Tensor:
        """Returns diagonal matrices with the size of a cell, shape (v, n, 2, 2).

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (2, 2)).jacobian(torch.ones(1, 1, 2))[0, 0]
            tensor([[3., 0.],
                    [0., 2.]])
        """
        require_shapes("v n 2", {"v": self.view_count}, cells=cells)
        return self._size(cells).diag().to(cells.dtype).expand(*cells.shape[:2], 2, 2)

    def density(self, points: Tensor) -> Tensor:
        """Returns the same for every point, shape (v, n).

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (2, 3)).density(torch.ones(1, 2, 2))
            tensor([[0.2500, 0.2500]])
        """
        require_shapes("v n 2", {"v": self.view_count}, points=points)
        return torch.full_like(points[..., 0], self.cells_per_pixel)

    def neighbour(self, cells: Tensor, dx: int, dy: int) -> Tensor:
        """Returns the cells some columns and rows away, clamped at the edges.

        Example:
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).neighbour(torch.tensor([0, 1]), -1, 1)
            tensor([0, 2])
        """
        height, width = self.resolution
        x, y = (cells + torch.tensor([dx, dy], device=cells.device)).unbind(-1)
        return torch.stack([x.clamp(0, width - 1), y.clamp(0, height - 1)], dim=-1)

    def to_screen(self, image: Tensor, mask: Tensor | None = None, *, prefilter: Prefilter = "area") -> Tensor:  # noqa: ARG002
        """Returns the image interpolated; with a mask the mean weighted by it, 0 where it is nothing.

        The prefilter is that of the interpolation, whatever is asked for.

        Example:
            >>> image = torch.rand(1, 3, 4, 6)
            >>> torch.equal(ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).to_screen(image), image)
            True
        """
        self._require_image(image, mask)
        if mask is None:
            return self._interpolated(image)
        mask = mask.to(image)
        return divided(self._interpolated(torch.cat([image * mask, mask.expand_as(image[:, :1])], dim=1)))

    def _interpolated(self, image: Tensor) -> Tensor:
        if self.resolution == self.screen:
            return image
        smaller = any(cells > pixels for cells, pixels in zip(self.resolution, self.screen, strict=True))
        return interpolate(image, self.screen, mode="bilinear", antialias=smaller)

    def _size(self, like: Tensor) -> Tensor:
        """Width and height of a cell in pixels, float64."""
        sizes = [self.screen[axis] / self.resolution[axis] for axis in (1, 0)]
        return torch.tensor(sizes, dtype=torch.float64, device=like.device)
