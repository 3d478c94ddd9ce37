"""What every warp owes: cells to screen and back, density, neighbours, rays, and resampling."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, Self

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from fovden.camera import Camera, Gaze, Rays, StereoCamera, pixel_centres
from fovden.checks import require, require_integer, require_number, require_shapes
from fovden.warps._checks import require_camera
from fovden.warps.topology import Topology

__all__ = ["Warp"]

Prefilter = Literal["area", "angle", "none"]


@dataclass(frozen=True, eq=False)
class Warp(ABC):
    """A raster of cells laid over the screen: where samples go, not how many.

    Cells are counted as pixels are: x is the column, y the row, and cell (i, j) covers x from i to i + 1 and y from j
    to j + 1, with its centre at (i + 0.5, j + 0.5). Column i has ``heights[i]`` rows of its own; what the rectangle
    holds below them is no cell. All functions take and return points of shape (v, n, 2), work in float64 inside, and
    return the floating type that they were given.

    A subclass says where cells lie (:meth:`cell_to_screen`, :meth:`screen_to_cell` and the rest that is abstract);
    rays, masks and the way from the screen follow from it. It is geometry alone: tracer and filters both use it.

    Attributes:
        gaze: Where each eye looks, in pixels; anywhere, also outside the image. Its length is the number of views.
        screen: Height and width of the screen in pixels.
        resolution: Height and width of the raster in cells: rows, and columns.

    Raises:
        ValueError: If a size is below 1.

    Example:
        >>> from fovden.foveation import LogPolarWarp
        >>> warp = LogPolarWarp(Gaze(torch.tensor([[32.0, 24.0]])), screen=(48, 64), resolution=(27, 36))
        >>> isinstance(warp, Warp), warp.view_count, warp.cell_count, warp.cells_per_pixel
        (True, 1, 972, 0.31640625)
    """

    gaze: Gaze
    screen: tuple[int, int]
    resolution: tuple[int, int]

    def __post_init__(self) -> None:
        for name in ("screen", "resolution"):
            size = getattr(self, name)
            require(len(size) == 2, name, size, "a height and a width")
            require_integer(f"{name}[0] (height)", size[0], minimum=1)
            require_integer(f"{name}[1] (width)", size[1], minimum=1)
            object.__setattr__(self, name, (int(size[0]), int(size[1])))

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the raster, as :attr:`fovden.Frame.raster` holds it."""

    @property
    @abstractmethod
    def heights(self) -> Tensor:
        """Number of rows of each column, int64, shape (w,), each from 1 to the raster's height."""

    @abstractmethod
    def cell_to_screen(self, cells: Tensor) -> Tensor:
        """Returns where cell coordinates lie on the screen.

        Args:
            cells: Coordinates (x, y) in cells, shape (v, n, 2). Rows count in the column's own height.

        Returns:
            Coordinates (x, y) in pixels, the same shape; also outside the screen.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).cell_to_screen(torch.tensor([[[0.5, 1.5]]]))
            tensor([[[0.5000, 1.5000]]])
        """

    @abstractmethod
    def screen_to_cell(self, points: Tensor) -> Tensor:
        """Returns the cell coordinates of points on the screen: the inverse of :meth:`cell_to_screen`.

        Args:
            points: Coordinates (x, y) in pixels, shape (v, n, 2).

        Returns:
            Coordinates (x, y) in cells, the same shape; y in the height of the column that x lies in.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).screen_to_cell(torch.tensor([[[0.5, 1.5]]]))
            tensor([[[0.5000, 1.5000]]])
        """

    @abstractmethod
    def jacobian(self, cells: Tensor) -> Tensor:
        """Returns the derivatives of screen coordinates in cell coordinates, in pixels per cell.

        Args:
            cells: Coordinates (x, y) in cells, shape (v, n, 2).

        Returns:
            Matrices with rows (screen x, screen y) and columns (cell x, cell y), shape (v, n, 2, 2).

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).jacobian(torch.ones(1, 1, 2))[0, 0]
            tensor([[1., 0.],
                    [0., 1.]])
        """

    @abstractmethod
    def density(self, points: Tensor) -> Tensor:
        """Returns how many cells fall on a pixel at points on the screen, in closed form.

        Args:
            points: Coordinates (x, y) in pixels, shape (v, n, 2).

        Returns:
            Cells per pixel, shape (v, n).

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).density(torch.ones(1, 1, 2))
            tensor([[1.]])
        """

    @abstractmethod
    def neighbour(self, cells: Tensor, dx: int, dy: int) -> Tensor:
        """Returns the cells that lie some columns and rows away, which is how filters step.

        Args:
            cells: Columns and rows of cells, integers, shape (..., 2).
            dx: Columns to go.
            dy: Rows to go.

        Returns:
            Columns and rows, always of cells that exist, int64, the same shape.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).neighbour(torch.tensor([4, 1]), 3, 1)
            tensor([5, 2])
        """

    @abstractmethod
    def to_screen(self, image: Tensor, mask: Tensor | None = None, *, prefilter: Prefilter = "area") -> Tensor:
        """Returns an image in cells as one in pixels.

        Args:
            image: Values of cells, shape (v, c, h, w) of the raster.
            mask: How much each cell counts, in [0, 1], shape (v, 1, h, w) or (1, 1, h, w); ``None`` means all alike.
            prefilter: What is averaged where several cells fall on a pixel; see the subclass.

        Returns:
            Values of pixels, shape (v, c, height, width) of the screen; 0 where no cell counts.

        Raises:
            ShapeError: If image or mask do not fit the raster.

        Differentiable: in ``image`` and ``mask``, with the exact adjoint, and in the warp's tensors.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).to_screen(torch.ones(1, 3, 4, 6)).shape
            torch.Size([1, 3, 4, 6])
        """

    @property
    def topology(self) -> Topology | None:
        """Which cells are neighbours of which; ``None`` where the raster is a grid as the screen's."""
        return None

    @property
    def view_count(self) -> int:
        """Number of views v."""
        return int(self.gaze.pixels.shape[0])

    @property
    def cell_count(self) -> int:
        """Number of cells of one view, on the screen or not: the sum of the columns' heights."""
        return int(self.heights.sum())

    @property
    def cells_per_pixel(self) -> float:
        """Area of the raster's rectangle over that of the screen, which is what papers call the sampling rate."""
        return math.prod(self.resolution) / math.prod(self.screen)

    @cached_property
    def exists(self) -> Tensor:
        """Whether a place of the rectangle is a cell, which it is above its column's height: bool, (1, 1, h, w)."""
        with torch.inference_mode(False):  # kept for later calls, whose mode may be another
            rows = torch.arange(self.resolution[0], device=self.heights.device)
            return (rows[:, None] < self.heights)[None, None]

    @property
    def valid(self) -> Tensor:
        """Whether a place is a cell, and its centre on the screen: bool, shape (v, 1, h, w)."""
        points = self.positions().detach()
        inside = ((points >= 0) & (points < points.new_tensor(self.screen[::-1]))).all(-1)
        return inside.reshape(-1, 1, *self.resolution) & self.exists

    @cached_property
    def read(self) -> Tensor:
        """Whether :meth:`to_screen` reads a cell at all: bool, shape (v, 1, h, w).

        Pixels at the screen's edge lie between cells some of whose centres are outside. Tracing the cells that are
        read, and no others, leaves no dark rim. It is where the adjoint of ones is more than rounding.
        """
        with torch.inference_mode(False), torch.enable_grad():  # kept for later calls, whose mode may be another
            shape = (self.view_count, 1, *self.resolution)
            image = torch.zeros(shape, device=self.gaze.pixels.device, requires_grad=True)
            (found,) = torch.autograd.grad(self.to_screen(image).sum(), image)
            return found > 1e-9

    def __getstate__(self) -> dict[str, Any]:  # what is kept for later calls stays in its process
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def cells(self, offsets: Tensor | None = None) -> Tensor:
        """Returns a point in every place of the rectangle in row-major order, cell or not.

        Args:
            offsets: Position within the cell, in [0, 1), shape (v, h w, 2); ``None`` means the centre.

        Returns:
            Coordinates (x, y) in cells, in the floating type of the gaze, or of the offsets, shape (v, h w, 2).

        Raises:
            ShapeError: If the offsets do not fit.

        Differentiable: in ``offsets``.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (1, 2), (1, 2)).cells()
            tensor([[[0.5000, 0.5000],
                     [1.5000, 0.5000]]])
        """
        centres = pixel_centres(self.resolution).to(self.gaze.pixels if offsets is None else offsets)
        if offsets is None:
            return centres.expand(self.view_count, -1, 2)
        require_shapes("v n 2", {"v": self.view_count, "n": math.prod(self.resolution)}, offsets=offsets)
        return centres - 0.5 + offsets

    def positions(self, jitter: tuple[float, float] = (0.0, 0.0)) -> Tensor:
        """Returns where every place of the rectangle lies on the screen, in row-major order, cell or not.

        Args:
            jitter: Shift (x, y) from the centres in cells, each in [-0.5, 0.5), so that it stays within the cell.

        Returns:
            Coordinates (x, y) in pixels, in the floating type of the gaze, shape (v, h w, 2).

        Raises:
            ValueError: If the jitter is out of range.

        Differentiable: in the warp's tensors.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (1, 2), (1, 2)).positions((0.25, 0.0))
            tensor([[[0.7500, 0.5000],
                     [1.7500, 0.5000]]])
        """
        return self.cell_to_screen(self.cells() + self._shift(jitter))

    def cell_to_ray(self, camera: Camera | StereoCamera, cells: Tensor | None = None) -> Rays:
        """Returns the camera's rays through cells.

        Args:
            camera: The views, at the warp's screen resolution.
            cells: Coordinates (x, y) in cells, shape (v, n, 2), as :meth:`cells` gives them with jitter; ``None`` means
                every centre in row-major order.

        Returns:
            Rays with fields of shape (v, n, 3) and unit directions; also through points outside the screen.

        Raises:
            ShapeError: If camera and gaze differ in the number of views.
            ValueError: If the camera has another resolution.

        Differentiable: in ``cells``, the camera's tensors and the warp's.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 6)).views
            >>> warp = ScreenWarp.for_camera(camera)
            >>> torch.equal(warp.cell_to_ray(camera).directions, camera.rays().directions)
            True
        """
        require_camera(self, camera)
        views = camera.views
        points = self.positions() if cells is None else self.cell_to_screen(cells)
        return views.rays(points.to(views.origin.dtype))

    def transport(
        self, previous: Warp, motion: Tensor, *, jitter: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Tensor, Tensor]:
        """Returns where the surfaces that this frame's cells see lie in the previous frame's raster.

        For all cells ``previous_cell = previous.screen_to_cell(cell_to_screen(cell) + motion)``; motion is in pixels.
        The previous frame's value of cell (i, j) is that of (i + 0.5, j + 0.5) plus its own jitter.

        Args:
            previous: The raster of the previous frame, on the same screen; it may differ in anything else.
            motion: ``gbuffer.motion`` of this frame, in pixels, shape (v, 2, h, w).
            jitter: That of this frame.

        Returns:
            Cell coordinates (x, y), the shape of ``motion``; and whether they are of use: the place is a cell, and its
            point was on the previous screen, bool, shape (v, 1, h, w).

        Raises:
            ShapeError: If the motion does not fit, or the rasters differ in the number of views.
            ValueError: If the screens differ, or the jitter leaves the cell.

        Differentiable: in ``motion`` and both warps' tensors.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> warp = ScreenWarp(Gaze(torch.zeros(1, 2)), (1, 3), (1, 3))
            >>> motion = torch.tensor([1.0, 0.0]).reshape(1, 2, 1, 1).expand(1, 2, 1, 3)
            >>> cells, valid = warp.transport(warp, motion)
            >>> cells[0, 0], valid[0, 0]
            (tensor([[1.5000, 2.5000, 3.5000]]), tensor([[ True,  True, False]]))
        """
        sizes = {"v": self.view_count, "h": self.resolution[0], "w": self.resolution[1]}
        require_shapes("v 2 h w", sizes, motion=motion)
        require_shapes("v 2", sizes, **{"previous.gaze.pixels": previous.gaze.pixels})
        require(previous.screen == self.screen, "previous.screen", previous.screen, f"this one's, {self.screen}")
        before = self.positions(jitter).to(motion.dtype) + motion.flatten(2).mT
        inside = ((before >= 0) & (before <= before.new_tensor(self.screen[::-1]))).all(-1)
        inside = inside.reshape(-1, 1, *self.resolution)
        return previous.screen_to_cell(before).mT.reshape(motion.shape), inside & self.exists

    def from_screen(self, image: Tensor) -> Tensor:
        """Returns an image in pixels as one in cells, for tests and figures: frames are traced in cells instead.

        Values are bilinear at the cells' centres; outside the screen those of its edge.

        Args:
            image: Values of pixels, shape (v, c, height, width) of the screen.

        Returns:
            Values of cells, shape (v, c, h, w) of the raster; 0 where there is no cell.

        Raises:
            ShapeError: If the image does not fit the screen.

        Differentiable: in ``image`` and the warp's tensors.

        Example:
            >>> from fovden.foveation import LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (2, 3))
            >>> warp.from_screen(torch.ones(1, 1, 4, 6)).shape
            torch.Size([1, 1, 2, 3])
        """
        height, width = self.screen
        sizes = {"v": self.view_count, "height": height, "width": width}
        require_shapes("v c height width", sizes, image=image)
        grid = self.positions().double().reshape(-1, *self.resolution, 2) * 2 / image.new_tensor([width, height]) - 1
        found = grid_sample(image.double(), grid, padding_mode="border", align_corners=False)
        return found.to(image.dtype) * self.exists

    def to(self, *args: Any, **kwargs: Any) -> Self:
        """Returns the warp on another device or in another floating type, with the arguments of ``Tensor.to``.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6)).to(torch.float64).gaze.pixels.dtype
            torch.float64
        """
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        moved: dict[str, Any] = {
            name: each.to(*args, **kwargs) for name, each in own.items() if isinstance(each, Gaze | Tensor)
        }
        return replace(self, **moved)

    def _shift(self, jitter: tuple[float, float]) -> Tensor:
        within = all(-0.5 <= require_number("jitter", shift) < 0.5 for shift in jitter)
        require(within, "jitter", jitter, "shifts from -0.5 to below 0.5 cells")
        return self.gaze.pixels.new_tensor(jitter)

    def _require_image(self, image: Tensor, mask: Tensor | None) -> None:
        sizes = {"v": self.view_count, "h": self.resolution[0], "w": self.resolution[1]}
        require_shapes("v c h w", sizes, image=image)
        if mask is not None:
            sizes["v"] = mask.shape[0] if mask.ndim == 4 and mask.shape[0] == 1 else self.view_count
            require_shapes("v 1 h w", sizes, mask=mask)
