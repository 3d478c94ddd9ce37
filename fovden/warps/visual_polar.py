"""The visual-polar raster: as many cells on each part of the screen as the eye resolves there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_integer, require_number
from fovden.warps._checks import gaze_of, require_parameter
from fovden.warps._laws import (
    CENTRE,
    JOIN,
    POLYNOMIALS,
    acuity_integral,
    acuity_integral_inverse,
    acuity_integral_slope,
    polynomial,
    polynomial_inverse,
    polynomial_slope,
)
from fovden.warps.polar import FoveaBorder, PolarWarp

__all__ = ["VisualPolarWarp"]

Law = Literal["exact", "poly3", "poly4"]
Cut = Literal["smooth", "stair", "none"]
Metric = Literal["plane", "angle"]

NOMINAL = 40.28  # degrees; the triangle is then 12.00 % of the raster, as reported


@dataclass(frozen=True, eq=False)
class VisualPolarWarp(PolarWarp):
    """The polar raster whose density on the screen follows the eye's acuity.

    Acuity at eccentricity e is M(e) = min(1, 7.49 / (0.3 e + 1)^2), constant up to e_c = 5.79 degrees. A raster with
    as many rows in every column has the density (dt/dd) / d on the screen; it is proportional to M where dt/dd is
    proportional to d M(d). That gives, with u = 0.3 e + 1,

        g(e) = e / e_c                                                    e <= e_c
             = 1 + K (ln u + 1/u - ln u_c - 1/u_c),  K = 7.49 / (0.09 e_c^2)     e > e_c
        t = g(e) / g(e_max),   e = e_max d / reach

    In the centre t is linear in d, and columns get shorter in proportion, so that density is constant: a triangle of
    q / 2 = 1 / (2 g(e_max)) of the raster is cut away. The curve is stretched so that its end lies at the screen's
    farthest corner, wherever the gaze is: the number of cells stays, and the centre grows as the gaze moves aside.

    Readings of the source, whose formulas could not be read, each with its default and its option:

    - Acuity: Reddy's, as above, the one that gives what is reported of the paper (a logarithm and a division). Its two
      pieces meet within 1.6e-4.
    - ``e_max``: 40.28 degrees, for which the triangle is the 12.00 % that is reported.
    - ``law``: the closed form, or polynomials in place of the fitted ones that the source uses. Each is inverted as it
      is, so that the way to the raster and back always closes.
    - ``metric``: the eccentricity of a distance d on the image plane. ``"plane"``: proportional to d. ``"angle"``: by
      its tangent, as seen with the gaze straight ahead.
    - ``cut``: ``"smooth"``, each column as high as its share; ``"stair"``, in steps of ``block`` columns and multiples
      of ``block`` rows, for filters that work in blocks; ``"none"``.

    Attributes:
        gaze: Where each eye looks, in pixels; anywhere, also outside the image.
        screen: Height and width of the screen in pixels.
        resolution: Height and width of the raster: rows (angles) and columns (distances).
        fovea_border: What lies before column 0; see :class:`PolarWarp`.
        e_max: Eccentricity of the farthest corner in degrees, above 5.79 and at most 180 (89.9 for ``"angle"``), a
            number or a scalar tensor.
        law: How distances are laid out. The polynomials hold for the default ``e_max`` alone.
        cut: How the columns of the centre are shortened.
        metric: What eccentricity means on the image plane.
        block: Columns and rows of a step of the stair.

    Raises:
        ValueError: If a value is out of range.

    Differentiable: every map in ``gaze`` and ``e_max``; heights are whole numbers, and have no derivative.

    Source: Koskela et al., "Foveated real-time path tracing in visual-polar space", 2019; acuity: Reddy, "Perceptually
    modulated level of detail for virtual environments", 1997. The closed form, the join and the polynomials are ours.

    Example:
        >>> warp = VisualPolarWarp(Gaze(torch.tensor([[640.0, 720.0]])), screen=(1440, 1280), resolution=(900, 800))
        >>> warp.cells_per_pixel, warp.cell_count, round(warp.removed, 4)
        (0.390625, 633696, 0.12)
        >>> warp.density(torch.tensor([[[640.0, 820.0], [1280.0, 1440.0]]]))  # in the centre, and in a corner
        tensor([[1.4344, 0.0628]])
    """

    e_max: float | Tensor = NOMINAL
    law: Law = "exact"
    cut: Cut = "smooth"
    metric: Metric = "plane"
    block: int = 32

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, choices in (("law", Law), ("cut", Cut), ("metric", Metric)):
            names = get_args(choices)
            require(getattr(self, name) in names, name, repr(getattr(self, name)), f"one of {names}")
        highest = 180.0 if self.metric == "plane" else 89.9
        require_parameter("e_max", self.e_max, above=CENTRE, maximum=highest)
        fitted = self.law == "exact" or (not isinstance(self.e_max, Tensor) and self.e_max == NOMINAL)
        require(fitted, "e_max", self.e_max, f"{NOMINAL}, for which {self.law!r} was fitted")
        require_integer("block", self.block, minimum=1)

    @classmethod
    def for_camera(
        cls,
        camera: Camera | StereoCamera,
        gaze: Gaze | None = None,
        *,
        scale: float = 0.625,
        e_max: float | Tensor = NOMINAL,
        law: Law = "exact",
        cut: Cut = "smooth",
        metric: Metric = "plane",
        fovea_border: FoveaBorder = "clamp",
    ) -> VisualPolarWarp:
        """Returns the raster for a camera, smaller than its screen by a factor in both directions.

        Args:
            camera: The views.
            gaze: Where each eye looks; ``None`` means the centre.
            scale: Raster over screen in each direction, above 0. 0.625 takes 800 x 900 cells for 1280 x 1440 pixels,
                the "61 % less" that is reported.
            e_max: Eccentricity of the farthest corner in degrees.
            law: How distances are laid out.
            cut: How the columns of the centre are shortened.
            metric: What eccentricity means on the image plane.
            fovea_border: What lies before column 0.

        Returns:
            The warp.

        Raises:
            ShapeError: If gaze and camera differ in the number of views.
            ValueError: If a value is out of range.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(1440, 1280))
            >>> VisualPolarWarp.for_camera(camera).resolution
            (900, 800)
        """
        require_number("scale", scale, above=0)
        height, width = camera.views.resolution
        resolution = (max(1, round(height * scale)), max(1, round(width * scale)))
        return cls(gaze_of(camera, gaze), (height, width), resolution, fovea_border, e_max, law, cut, metric)

    @property
    def name(self) -> str:
        """``"visual-polar"``."""
        return "visual-polar"

    @property
    def centre_fraction(self) -> float:
        """The q = 1 / g(e_max): the share of the columns that lie within the centre."""
        return JOIN if self.law != "exact" else 1 / float(acuity_integral(self._e_max(None).detach()))

    @property
    def removed(self) -> float:
        """Share of the raster that the triangle in the centre takes, q / 2; 0 without a cut."""
        return 0.0 if self.cut == "none" else self.centre_fraction / 2

    @property
    def blur_start(self) -> Tensor:
        """Distance at which the centre ends, shape (v,)."""
        join = JOIN if self.law != "exact" else 1 / acuity_integral(self._e_max(self.reach))  # which has a gradient
        return self.to_distance((join * torch.ones_like(self.reach))[:, None])[:, 0]

    @cached_property
    def heights(self) -> Tensor:
        """Number of rows of each column, int64, shape (w,)."""
        rows, columns = self.resolution
        q = self.centre_fraction
        column = torch.arange(columns, dtype=torch.float64)
        if self.cut == "none":
            heights = torch.full_like(column, rows)
        elif self.cut == "smooth":
            heights = torch.ceil(rows * (column + 0.5) / columns / q)
        else:
            right = (torch.floor(column / self.block) + 1) * self.block / columns
            heights = self.block * torch.ceil(rows * (right / q).clamp(max=1) / self.block)
        return heights.clamp(1, rows).long().to(self.gaze.pixels.device)

    def to_distance(self, fraction: Tensor) -> Tensor:
        """Returns the distance from the gaze in pixels at a fraction of the raster's width.

        Example:
            >>> warp = VisualPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.to_distance(torch.tensor([[0.0, 0.24, 1.0]]).double())
            tensor([[ 0.0000,  7.1871, 50.0000]], dtype=torch.float64)
        """
        e_max = self._e_max(fraction)
        if self.law == "exact":
            degrees = acuity_integral_inverse(fraction * acuity_integral(e_max))
        else:
            degrees = e_max * polynomial(POLYNOMIALS[self.law], fraction)
        if self.metric == "plane":
            return self.reach[:, None] * degrees / e_max
        return self.reach[:, None] * torch.tan(torch.deg2rad(degrees)) / torch.tan(torch.deg2rad(e_max))

    def to_fraction(self, distance: Tensor) -> Tensor:
        """Returns the fraction of the raster's width at a distance from the gaze.

        Example:
            >>> warp = VisualPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.to_fraction(torch.tensor([[0.0, 25.0, 50.0]]).double())
            tensor([[0.0000, 0.6700, 1.0000]], dtype=torch.float64)
        """
        e_max = self._e_max(distance)
        normalised = distance / self.reach[:, None]
        if self.metric == "plane":
            degrees = normalised * e_max
        else:
            degrees = torch.rad2deg(torch.atan(normalised * torch.tan(torch.deg2rad(e_max))))
        if self.law == "exact":
            return acuity_integral(degrees) / acuity_integral(e_max)
        return polynomial_inverse(POLYNOMIALS[self.law], degrees / e_max)

    def stretch(self, fraction: Tensor) -> Tensor:
        """Returns the derivative of :meth:`to_distance`, pixels per unit of the fraction.

        Example:
            >>> warp = VisualPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.stretch(torch.tensor([[0.1, 1.0]]).double())
            tensor([[29.9462, 98.3853]], dtype=torch.float64)
        """
        e_max = self._e_max(fraction)
        if self.law == "exact":
            total = acuity_integral(e_max)
            degrees = acuity_integral_inverse(fraction * total)
            rate = total / acuity_integral_slope(degrees)
        else:
            degrees = e_max * polynomial(POLYNOMIALS[self.law], fraction)
            rate = e_max * polynomial_slope(POLYNOMIALS[self.law], fraction)
        if self.metric == "plane":
            return self.reach[:, None] * rate / e_max
        tangent = torch.tan(torch.deg2rad(degrees))
        return self.reach[:, None] * math.radians(1) * rate * (1 + tangent**2) / torch.tan(torch.deg2rad(e_max))

    def _e_max(self, like: Tensor | None) -> Tensor:
        return torch.as_tensor(self.e_max, dtype=torch.float64, device=None if like is None else like.device)
