"""What polar rasters have in common: columns are distances from the gaze, rows are angles around it."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import torch
from torch import Tensor

from fovden.checks import require, require_number, require_shapes
from fovden.warps._kept import is_compiled
from fovden.warps._operators import number_of, resampled
from fovden.warps._resample import composed, divided
from fovden.warps.base import Prefilter, Warp
from fovden.warps.blur import eccentricity_blur
from fovden.warps.topology import Topology

__all__ = ["PolarWarp"]

FoveaBorder = Literal["clamp", "rotate"]
TURN = 2 * math.pi


@dataclass(frozen=True, eq=False)
class PolarWarp(Warp):
    """A raster in polar coordinates around the gaze, with a free law for distances.

    With t = x / w for a column coordinate x, and h the height of the column that x lies in, a cell coordinate is at

        r = to_distance(t),   theta = 2 pi y / h,   point = gaze + r (cos theta, sin theta)

    A subclass gives three functions of one variable: :meth:`to_distance`, its inverse :meth:`to_fraction` and its
    derivative :meth:`stretch`; and the columns' heights where they are not all alike.

    Resampling to the screen is bilinear: both columns beside a pixel are read with their own heights, around the circle
    in angle. Where several cells fall on a pixel, ``prefilter`` says what is averaged. A pixel's footprint is 1 / (2 pi
    d) of the circle at distance d, and the columns from d - 1/2 to d + 1/2.

    - ``"area"``: the box of the footprint in both directions, never less than a cell. The box of one cell is bilinear
      interpolation, so that there is no step where the prefilter begins.
    - ``"angle"``: in angle alone, as the source of the visual-polar raster has it, which assumes that a pixel is never
      wider than a column.
    - ``"none"``: bilinear interpolation everywhere.

    At d = 0, where an angle means nothing, the footprint is the whole circle of the first column, in each of the three.

    Attributes:
        gaze: Where each eye looks, in pixels; anywhere, also outside the image.
        screen: Height and width of the screen in pixels.
        resolution: Height and width of the raster: rows (angles) and columns (distances).
        fovea_border: What lies before column 0. ``"clamp"``: column 0 itself; ``"rotate"``: the column on the other
            side of the gaze, half a turn away.

    Raises:
        ValueError: If a value is out of range.

    In float32 on the CPU, and where no gradient is wanted of the warp itself, points and images are mapped by compiled
    kernels, for which a new gaze costs next to nothing. Elsewhere the same is made of torch operations.

    Source: Koskela et al. 2019, "Foveated real-time path tracing in visual-polar space", as far as it is known; the
    footprint is that of Williams, "Pyramidal parametrics", 1983, as a box instead of a pyramid of averages.

    Example:
        >>> from fovden.foveation import Gaze, VisualPolarWarp
        >>> warp = VisualPolarWarp(Gaze(torch.tensor([[320.0, 240.0]])), (480, 640), (300, 400))
        >>> isinstance(warp, PolarWarp), warp.reach
        (True, tensor([400.], dtype=torch.float64))
    """

    fovea_border: FoveaBorder = "clamp"

    def __post_init__(self) -> None:
        super().__post_init__()
        names = get_args(FoveaBorder)
        require(self.fovea_border in names, "fovea_border", repr(self.fovea_border), f"one of {names}")
        self.number  # noqa: B018  not to be given while a function is compiled

    @abstractmethod
    def to_distance(self, fraction: Tensor) -> Tensor:
        """Returns the distance from the gaze at a fraction of the raster's width.

        Args:
            fraction: t, 0 at the inner and 1 at the outer border of the raster, float64, shape (v, n).

        Returns:
            Distance in pixels, the same shape.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.to_distance(torch.tensor([[0.0, 1.0]]).double())
            tensor([[ 1.0000, 50.0000]], dtype=torch.float64)
        """

    @abstractmethod
    def to_fraction(self, distance: Tensor) -> Tensor:
        """Returns the fraction of the raster's width at a distance; the inverse of :meth:`to_distance`.

        Args:
            distance: Distance from the gaze in pixels, float64, shape (v, n).

        Returns:
            t, the same shape; above 1 beyond the screen's farthest corner.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.to_fraction(torch.tensor([[1.0, 50.0]]).double())
            tensor([[0., 1.]], dtype=torch.float64)
        """

    @abstractmethod
    def stretch(self, fraction: Tensor) -> Tensor:
        """Returns the derivative of :meth:`to_distance`: pixels per unit of the fraction.

        Args:
            fraction: t, float64, shape (v, n).

        Returns:
            d r / d t in pixels, the same shape.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8), alpha=1.0)
            >>> warp.stretch(torch.tensor([[1.0]]).double())  # 50 ln 50
            tensor([[195.6012]], dtype=torch.float64)
        """

    @property
    @abstractmethod
    def blur_start(self) -> Tensor:
        """Distance from the gaze in pixels at which :meth:`blur` begins, shape (v,)."""

    @property
    def heights(self) -> Tensor:
        """Number of rows of each column, int64, shape (w,): all of them, unless a subclass cuts."""
        return torch.full((self.resolution[1],), self.resolution[0], device=self.gaze.pixels.device)

    @cached_property
    def topology(self) -> Topology:
        """Which cells are neighbours of which."""
        return Topology(self.heights, self.resolution[0], rotate=self.fovea_border == "rotate")

    @property
    def reach(self) -> Tensor:
        """Distance from the gaze to the screen's farthest corner in pixels, float64, shape (v,)."""
        height, width = self.screen
        corners = self.gaze.pixels.new_tensor([[0, 0], [width, 0], [0, height], [width, height]]).double()
        distance: Tensor = torch.linalg.vector_norm(corners - self.gaze.pixels.double()[:, None], dim=-1)
        return distance.amax(dim=1)

    def polar(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Returns distance and angle of points on the screen, seen from the gaze.

        Args:
            points: Coordinates (x, y) in pixels, shape (v, n, 2).

        Returns:
            Distances in pixels and angles in [0, 2 pi], clockwise on the screen from its x axis, float64, both of shape
            (v, n). At the gaze itself the angle is 0, and both have a derivative of 0.

        Raises:
            ShapeError: If points and gaze differ in the number of views.

        Differentiable: in ``points`` and the gaze.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.polar(torch.tensor([[[0.0, 2.0]]]))
            (tensor([[2.]], dtype=torch.float64), tensor([[1.5708]], dtype=torch.float64))
        """
        require_shapes("v n 2", {"v": self.view_count}, points=points)
        x, y = (points.double() - self.gaze.pixels.double()[:, None]).unbind(-1)
        at_gaze = (x == 0) & (y == 0)  # where neither function has a derivative
        x, y = torch.where(at_gaze, 1.0, x), torch.where(at_gaze, 0.0, y)
        distance = torch.where(at_gaze, 0.0, torch.hypot(x, y))
        return distance, torch.remainder(torch.atan2(y, x), TURN)

    def cell_to_screen(self, cells: Tensor) -> Tensor:
        """Returns where cell coordinates lie on the screen.

        Rows count in the column's own height, and wrap. Differentiable in ``cells``, the gaze, and the law's parameters
        where they are tensors. Arguments and errors: see :class:`Warp`, as in the following.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.cell_to_screen(torch.tensor([[[8.0, 1.0]]]))
            tensor([[[35.3553, 35.3553]]])
        """
        require_shapes("v n 2", {"v": self.view_count}, cells=cells)
        if is_compiled(self, cells) and not (cells.requires_grad or torch.compiler.is_compiling()):
            return torch.ops.fovden.place_cells(cells, self.number)  # type: ignore[no-any-return]
        return self._points(cells)

    def positions(self, jitter: tuple[float, float] = (0.0, 0.0)) -> Tensor:
        """Returns where every place of the rectangle lies on the screen; see :meth:`Warp.positions`.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (4, 2), alpha=1.0)
            >>> warp.positions((-0.5, -0.5))[0, 1]
            tensor([7.0711, 0.0000])
        """
        shift = self._shift(jitter).double()
        rows, columns = (torch.arange(size).to(shift) + 0.5 for size in self.resolution)
        distance = self.to_distance(((columns + shift[0]) / self.resolution[1]).expand(self.view_count, -1))
        angle = (rows + shift[1])[:, None] * TURN / self.heights
        offset = torch.stack([angle.cos(), angle.sin()], dim=-1) * distance[:, None, :, None]
        return (self.gaze.pixels.double()[:, None] + offset.flatten(1, 2)).to(self.gaze.pixels.dtype)

    def screen_to_cell(self, points: Tensor) -> Tensor:
        """Returns the cell coordinates of points on the screen, rows in the height of the column that x lies in.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.screen_to_cell(torch.tensor([[[30.0, 30.0]]]))
            tensor([[[7.9147, 1.0000]]])
        """
        distance, angle = self.polar(points)
        x = (self.to_fraction(distance) * self.resolution[1]).to(points.dtype)
        y = angle * self._height_at(x) / TURN  # after rounding, which may have moved x into the next column
        return torch.stack([x, y.to(points.dtype)], dim=-1)

    def jacobian(self, cells: Tensor) -> Tensor:
        """Returns the derivatives of screen coordinates in cell coordinates, in pixels per cell, differentiable.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8), alpha=1.0)
            >>> warp.jacobian(torch.tensor([[[8.0, 0.0]]]))[0, 0]
            tensor([[24.4501, -0.0000],
                    [ 0.0000, 39.2699]])
        """
        distance, angle, height = self._place(cells)
        across = self.stretch(cells[..., 0].double() / self.resolution[1]) / self.resolution[1]
        along = distance * TURN / height
        cos, sin = angle.cos(), angle.sin()
        rows = [torch.stack([across * cos, -along * sin], dim=-1), torch.stack([across * sin, along * cos], dim=-1)]
        return torch.stack(rows, dim=-2).to(cells.dtype)

    def density(self, points: Tensor) -> Tensor:
        """Returns how many cells fall on a pixel at points on the screen: w h / (2 pi r dr/dt).

        Here h is the height of the column there. It is 0 where no column reaches, infinite at the gaze, differentiable.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8), alpha=1.0)
            >>> warp.density(torch.tensor([[[30.0, 40.0]]]))  # 64 / (2 pi 50 * 50 ln 50)
            tensor([[0.0010]])
        """
        distance, _ = self.polar(points)
        fraction = self.to_fraction(distance)
        width = self.resolution[1]
        cells = self._height_at(fraction * width) * width / (TURN * distance * self.stretch(fraction))
        within = (fraction <= 1) & (distance >= self.to_distance(torch.zeros_like(fraction)))
        return torch.where(within, cells, 0.0).to(points.dtype)

    def neighbour(self, cells: Tensor, dx: int, dy: int) -> Tensor:
        """Returns the cells that lie some columns and rows away, at a constant angle where heights differ.

        Column i' = i + dx is clamped at the rim, and at the gaze either clamped or continued on the other side
        (``fovea_border``). The row is the one that holds the angle of the centre of row j + dy, around the circle:

            j' = floor((j + 1/2 + dy) h_i' / h_i) mod h_i'

        Args:
            cells: Columns i and rows j of cells, integers, shape (..., 2).
            dx: Columns to go, less than the raster's width either way.
            dy: Rows of column i to go.

        Returns:
            Columns and rows, always of cells that exist, int64, the same shape.

        Raises:
            ValueError: If the coordinates are not integers.

        Source: Koskela et al. 2019: wrap in angle, clamp in distance. The rows' rule is exact in integers here.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8), fovea_border="rotate")
            >>> warp.neighbour(torch.tensor([[0, 1], [0, 7]]), -1, 1)
            tensor([[0, 6],
                    [0, 4]])
        """
        return self.topology.neighbour(cells, dx, dy)

    def to_screen(self, image: Tensor, mask: Tensor | None = None, *, prefilter: Prefilter = "area") -> Tensor:
        """Returns an image in cells as one in pixels; see the class for the interpolation.

        Args:
            image: Values of cells, shape (v, c, h, w) of the raster. What is not a cell is not read.
            mask: How much each cell counts, in [0, 1], shape (v, 1, h, w) or (1, 1, h, w): the result is then the mean
                weighted by it. ``None`` means all alike, also those outside the screen.
            prefilter: What is averaged where several cells fall on a pixel.

        Returns:
            Values of pixels, shape (v, c, height, width) of the screen; 0 where no cell counts.

        Raises:
            ShapeError: If image or mask do not fit the raster.
            ValueError: If the prefilter is none of those.

        Differentiable: in ``image`` and ``mask``, with the exact adjoint, and in gaze and parameters almost everywhere.

        Cost: four reads per pixel and channel, more where cells are smaller; as torch operations, seconds for a gaze.

        Example:
            >>> from fovden.foveation import Gaze, LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (8, 8))
            >>> warp.to_screen(torch.full((1, 1, 8, 8), 0.25)).unique()
            tensor([0.2500])
        """
        self._require_image(image, mask)
        names = get_args(Prefilter)
        require(prefilter in names, "prefilter", repr(prefilter), f"one of {names}")
        weighted = image if mask is None else torch.cat([image * mask, mask.expand_as(image[:, :1]).to(image)], dim=1)
        out = (resampled if is_compiled(self, weighted) else composed)(self, weighted, prefilter)
        return out if mask is None else divided(out)

    def blur(self, image: Tensor, strength: float | Tensor = 1.0) -> Tensor:
        """Returns an image on the screen, blurred the more the farther from the gaze, to hide the cells of the rim.

        The Gaussian's standard deviation is 0 up to :attr:`blur_start`, then grows in proportion to the distance, up to
        ``strength`` times half the height of an outermost cell, pi reach / h pixels, at the farthest corner.

        Args:
            image: Values of pixels, shape (v, c, height, width) of the screen.
            strength: Multiple of the default, at least 0, a number or a scalar tensor.

        Returns:
            The blurred image, the same shape.

        Raises:
            ShapeError: If the image does not fit the screen.
            ValueError: If the strength is negative.

        Differentiable: in ``image``, ``strength``, gaze and parameters.

        Source: Koskela et al. 2019, in words; the constants are ours. See :func:`eccentricity_blur`.

        Example:
            >>> from fovden.foveation import Gaze, VisualPolarWarp
            >>> warp = VisualPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (4, 8))
            >>> warp.blur(torch.full((1, 1, 4, 6), 0.25)).unique()
            tensor([0.2500])
        """
        if not isinstance(strength, Tensor):
            require_number("strength", strength, minimum=0)
        sizes = {"v": self.view_count, "height": self.screen[0], "width": self.screen[1]}
        require_shapes("v c height width", sizes, image=image)
        largest = strength * math.pi * self.reach / self.resolution[0]
        start = self.blur_start
        stop = torch.where(self.reach > start, self.reach, start + 1)  # a screen of a pixel or two ends before
        return eccentricity_blur(image, self.gaze, start=start, stop=stop, sigma=largest)

    @cached_property
    def read(self) -> Tensor:
        """Whether :meth:`to_screen` reads a cell at all, as :attr:`Warp.read`: the adjoint of ones says so."""
        with torch.inference_mode(False):
            ones = self.gaze.pixels.new_ones(self.view_count, 1, *self.screen, dtype=torch.float32)
            return resampled(self, ones, "area", back=True) > 0 if is_compiled(self, ones) else super().read

    def _points(self, cells: Tensor) -> Tensor:
        distance, angle, _ = self._place(cells)
        offset = distance[..., None] * torch.stack([angle.cos(), angle.sin()], dim=-1)
        return (self.gaze.pixels.double()[:, None] + offset).to(cells.dtype)

    def _place(self, cells: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Distance, angle, and the column's height, of cell coordinates."""
        require_shapes("v n 2", {"v": self.view_count}, cells=cells)
        x, y = cells.double().unbind(-1)
        height = self._height_at(cells[..., 0])
        return self.to_distance(x / self.resolution[1]), y * TURN / height, height

    def _height_at(self, x: Tensor) -> Tensor:
        return self.heights[x.detach().floor().long().clamp(0, self.resolution[1] - 1)]

    @cached_property
    def number(self) -> Tensor:
        """How operators find the warp within this process; a tensor, since code is compiled for every other number."""
        return number_of(self)

    @cached_property
    def _kept(self) -> dict[str, list[Any]]:
        return {}
