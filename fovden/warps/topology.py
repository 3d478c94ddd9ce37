"""Which cells of a polar raster are neighbours: all that a filter needs to know of a warp."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from fovden.checks import require, require_integer, require_shapes

__all__ = ["Topology"]


@dataclass(frozen=True, eq=False)
class Topology:
    """The neighbourhoods of a polar raster: rows go around a circle, and columns may have fewer rows than others.

    From cell (i, j) it is dx columns and dy rows to the column i' = i + dx, clamped at the rim and at the gaze, or with
    ``rotate`` continued beyond the gaze on the other side, half a turn away; and there to the row that holds the angle
    of the centre of row j + dy:

        j' = floor((j + 1/2 + dy) h_i' / h_i  [+ h_i' / 2 beyond the gaze]) mod h_i'

    It is exact in integers. Gaze, screen and law of distances do not matter: rasters of all gazes share one topology.

    Attributes:
        heights: Number of rows of each column, int64, shape (w,), each from 1 to ``rows``.
        rows: Height h of the rectangle that images in cells have.
        rotate: Whether the column on the other side of the gaze lies before column 0; otherwise column 0 itself.
        seen: Which cells are looked at in a frame, bool, shape (v, 1, h, w): what is made of others does not matter.
            ``None`` means all.

    Raises:
        ShapeError: If ``heights`` has not one axis, or ``seen`` is of another raster.
        ValueError: If a height is out of range.

    Source: Koskela et al., "Foveated real-time path tracing in visual-polar space", 2019: wrap in angle, clamp in
    distance, steps at a constant angle.

    Example:
        >>> topology = Topology(torch.tensor([2, 4, 4]), rows=4)
        >>> topology.exists[0, 0].int()
        tensor([[1, 1, 1],
                [1, 1, 1],
                [0, 1, 1],
                [0, 1, 1]], dtype=torch.int32)
    """

    heights: Tensor
    rows: int
    rotate: bool = False
    seen: Tensor | None = None

    def __post_init__(self) -> None:
        require_shapes("w", heights=self.heights)
        if self.seen is not None:
            self.require(seen=self.seen)
        require_integer("rows", self.rows, minimum=1)
        if not torch.compiler.is_compiling():
            require(not self.heights.is_floating_point(), "heights", self.heights.dtype, "an integer type")
            lowest, highest = int(self.heights.min()), int(self.heights.max())
            within = lowest >= 1 and highest <= self.rows
            require(within, "heights", f"{lowest} to {highest}", f"heights from 1 to {self.rows}")

    @property
    def columns(self) -> int:
        """Number of columns w."""
        return len(self.heights)

    @cached_property
    def exists(self) -> Tensor:
        """Whether a place of the rectangle is a cell, which it is above its column's height: bool, (1, 1, h, w)."""
        with torch.inference_mode(False):  # kept for later calls, whose mode may be another
            rows = torch.arange(self.rows, device=self.heights.device)
            return (rows[:, None] < self.heights)[None, None]

    @cached_property
    def active(self) -> Tensor:
        """Whether a place is a cell that is looked at, and so worth a filter's work: bool, shape (v or 1, 1, h, w).

        Example:
            >>> seen = torch.tensor([[True, False], [True, True]])[None, None]
            >>> Topology(torch.tensor([1, 2]), rows=2, seen=seen).active[0, 0]
            tensor([[ True, False],
                    [False,  True]])
        """
        with torch.inference_mode(False):
            return self.exists if self.seen is None else self.exists & self.seen

    def neighbour(self, cells: Tensor, dx: int, dy: int) -> Tensor:
        """Returns the cells that lie some columns and rows away.

        Args:
            cells: Columns i and rows j of cells, integers, shape (..., 2).
            dx: Columns to go.
            dy: Rows of column i to go.

        Returns:
            Columns and rows, always of cells that exist, int64, the same shape.

        Raises:
            ValueError: If the coordinates are not integers.

        Example:
            >>> Topology(torch.tensor([2, 4, 4]), rows=4).neighbour(torch.tensor([[0, 1], [1, 3]]), 1, 1)
            tensor([[1, 1],
                    [2, 0]])
        """
        integers = not cells.is_floating_point() and cells.dtype != torch.bool
        require(integers and cells.shape[-1:] == (2,), "cells", (cells.dtype, tuple(cells.shape)), "integers (..., 2)")
        x, y = cells.long().unbind(-1)
        column, turned = self.column(x + dx)
        return torch.stack([column, _row(y + dy, self.heights[x], self.heights[column], turned)], dim=-1)

    def column(self, column: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the columns that stand for some, which may lie beyond a border, and half turns to go there.

        Args:
            column: Numbers of columns, int64, any shape.

        Returns:
            Numbers from 0 to w - 1, and 0 or 1, int64, both of the same shape.

        Example:
            >>> Topology(torch.tensor([4, 4]), rows=4, rotate=True).column(torch.tensor([-2, 0, 2]))
            (tensor([1, 0, 1]), tensor([1, 0, 0]))
        """
        turned = (column < 0).long() if self.rotate else torch.zeros_like(column)
        inside = torch.where(turned > 0, -1 - column, column)
        return inside.clamp(0, self.columns - 1), turned

    def reads(self, dx: int, start: int, stop: int, *, margin: int = 0) -> Tensor:
        """Returns which cells lie dx columns away from a strip of columns, for all rows and some beyond.

        What lies dy rows further is the same, read dy rows further down: five of these hold the 25 taps of a filter.

        Args:
            dx: Columns to go.
            start: First column of the strip.
            stop: Column after the last one.
            margin: Rows before row 0 and after row h - 1.

        Returns:
            Row-major numbers of cells, int64, shape (h + 2 margin, stop - start).

        Example:
            >>> Topology(torch.tensor([2, 4]), rows=4).reads(1, 0, 2)
            tensor([[3, 1],
                    [7, 3],
                    [3, 5],
                    [7, 7]])
        """
        x = torch.arange(start, stop, device=self.heights.device)
        y = torch.arange(-margin, self.rows + margin, device=self.heights.device)[:, None]
        column, turned = self.column(x + dx)
        return _row(y, self.heights[x], self.heights[column], turned) * self.columns + column

    def shifted(self, image: Tensor, dx: int, dy: int) -> Tensor:
        """Returns in every cell the value of its neighbour.

        Args:
            image: Values of cells, shape (v, c, h, w).
            dx: Columns to go.
            dy: Rows to go.

        Returns:
            The neighbours' values, the same shape. A place that is no cell holds what a cell in its place would read.

        Raises:
            ShapeError: If the image does not fit.

        Differentiable: in ``image``.

        Example:
            >>> image = torch.arange(8).reshape(1, 1, 4, 2)
            >>> Topology(torch.tensor([2, 4]), rows=4).shifted(image, 1, 0)[0, 0]
            tensor([[3, 1],
                    [7, 3],
                    [3, 5],
                    [7, 7]])
        """
        self.require(image=image)
        margin = abs(dy)
        index = self.reads(dx, 0, self.columns, margin=margin)
        return take(image, index[margin + dy : margin + dy + self.rows])

    def expand(self, image: Tensor) -> Tensor:
        """Returns an image whose columns all have h rows: each is stretched by its nearest cell at the same angle.

        Args:
            image: Values of cells, shape (v, c, h, w).

        Returns:
            Values of a raster of the same rectangle without cuts, the same shape.

        Raises:
            ShapeError: If the image does not fit.

        Differentiable: in ``image``.

        Example:
            >>> image = torch.arange(8).reshape(1, 1, 4, 2)
            >>> Topology(torch.tensor([2, 4]), rows=4).expand(image)[0, 0, :, 0]
            tensor([0, 0, 2, 2])
        """
        self.require(image=image)
        places = torch.arange(self.rows * self.columns, device=self.heights.device)
        return take(image, self.nearest(places).view(self.rows, -1))

    def nearest(self, places: Tensor) -> Tensor:
        """Returns which cell's value :meth:`expand` puts in some places.

        Args:
            places: Row-major numbers of places of the rectangle, int64, any shape.

        Returns:
            Row-major numbers of cells, the same shape.

        Example:
            >>> Topology(torch.tensor([2, 4]), rows=4).nearest(torch.tensor([2, 4]))
            tensor([0, 2])
        """
        column = places % self.columns
        row = torch.div(places, self.columns, rounding_mode="floor")
        return _row(row, self.rows, self.heights[column], 0) * self.columns + column

    def collapse(self, image: Tensor) -> Tensor:
        """Returns what cells read of an expanded image at their centres: the inverse of :meth:`expand`.

        Args:
            image: Values of an expanded image, shape (v, c, h, w).

        Returns:
            Values of cells, the same shape. Places that are no cells repeat their column.

        Raises:
            ShapeError: If the image does not fit.

        Differentiable: in ``image``.

        Example:
            >>> image = torch.rand(1, 1, 4, 2)
            >>> topology = Topology(torch.tensor([2, 4]), rows=4)
            >>> torch.equal(topology.collapse(topology.expand(image))[..., :2, :], image[..., :2, :])
            True
        """
        self.require(image=image)
        x = torch.arange(self.columns, device=self.heights.device)
        y = torch.arange(self.rows, device=self.heights.device)[:, None]
        return take(image, _row(y, self.heights, self.rows, 0) * self.columns + x)

    def pad(self, image: Tensor, margin: int) -> Tensor:
        """Returns an expanded image with some columns and rows more on each side, as neighbours continue it.

        Args:
            image: Values of an expanded image, shape (v, c, h, w).
            margin: Columns and rows to add on each side, at least 0.

        Returns:
            The image, shape (v, c, h + 2 margin, w + 2 margin).

        Raises:
            ShapeError: If the image does not fit.

        Differentiable: in ``image``.

        Example:
            >>> image = torch.arange(8).reshape(1, 1, 4, 2)
            >>> Topology(torch.tensor([2, 4]), rows=4, rotate=True).pad(image, 1)[0, 0]
            tensor([[2, 6, 7, 7],
                    [4, 0, 1, 1],
                    [6, 2, 3, 3],
                    [0, 4, 5, 5],
                    [2, 6, 7, 7],
                    [4, 0, 1, 1]])
        """
        self.require(image=image)
        x = torch.arange(-margin, self.columns + margin, device=self.heights.device)
        y = torch.arange(-margin, self.rows + margin, device=self.heights.device)[:, None]
        column, turned = self.column(x)
        return take(image, _row(y, self.rows, self.rows, turned) * self.columns + column)

    def require(self, **images: Tensor) -> None:
        """Raises unless images have the raster's height and width.

        Args:
            **images: Images by the name of the argument, each of shape (v, c, h, w).

        Raises:
            ShapeError: If one does not.

        Example:
            >>> Topology(torch.tensor([2, 4]), rows=4).require(radiance=torch.zeros(1, 3, 4, 3))
            Traceback (most recent call last):
            ...
            fovden.checks.ShapeError: radiance: expected shape (*, *, h=4, w=2), got (1, 3, 4, 3)
        """
        require_shapes("* * h w", {"h": self.rows, "w": self.columns}, **images)


def _row(y: Tensor, before: Tensor | int, after: Tensor | int, turned: Tensor | int) -> Tensor:
    """The row of a column of height ``after`` at the angle of row y of one of height ``before``, half turns added."""
    return torch.div((2 * y + 1) * after + turned * before * after, 2 * before, rounding_mode="floor") % after


def take(image: Tensor, index: Tensor) -> Tensor:
    """The values of an image of shape (v, c, h, w) at row-major places, with the shape (v, c, *index.shape)."""
    flat = image.flatten(2)
    # The derivative of a gather adds row by row in the order of the places, for any number of threads.
    return flat.gather(2, index.flatten().expand(*flat.shape[:2], -1)).view(*flat.shape[:2], *index.shape)
