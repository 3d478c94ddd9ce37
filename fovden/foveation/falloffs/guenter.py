"""The falloffs of Guenter et al. (2012): three layers whose sizes are the cheapest ones, and the hyperbola beneath.

The minimum angle of resolution (MAR) grows with eccentricity, and the display has a finest angle of its own:

    mar(e) = mar0 + slope e           the eye, degrees per cycle
    display_mar = atan(2 / n)         the display, two pixels to a cycle, n pixels per unit of tangent

Where the eye resolves less than the display shows, one sample serves ``s = mar(e) / display_mar`` pixels in each
direction, hence ``1 / s^2`` samples per pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from fovden.camera import Camera, Gaze, pixel_centres
from fovden.checks import require, require_number, require_scalar, require_shapes
from fovden.foveation.display import Display, eccentricity_degrees
from fovden.foveation.falloff import LAYER_RATES, RateMap, layer_of_rate, require_layer_rates

__all__ = ["GuenterLayers", "HyperbolicFalloff", "LayerSizes"]

MAR_SLOPE = 0.022
"""Default slope: the finest, and so the most cautious, of the three that Guenter et al. found (0.022, 0.0275, 0.0343),
in degrees per cycle and degree."""
MAR_AT_GAZE = 1 / 48
"""Finest angle at the gaze in degrees per cycle (Guenter et al. 2012)."""

GRID, ZOOMS = 129, 5
"""Points along each axis of the search, and how often it is repeated around the best one: from 90 to 1e-7 degrees."""

Shape = Literal["square", "circle"]


class LayerSizes(NamedTuple):
    """Sizes of the three layers on a display.

    Attributes:
        eccentricities: Limits of the inner and the middle layer in degrees.
        strides: Pixels per sample in one direction, s_1 = 1, s_2 and s_3.
        samples: Samples of each layer. Layers overlap: each is complete, beneath the ones inside of it.
        factor: Pixels of the display over the sum of the samples.
    """

    eccentricities: tuple[float, float]
    strides: tuple[float, float, float]
    samples: tuple[float, float, float]
    factor: float


@dataclass(frozen=True)
class HyperbolicFalloff:
    """As many samples as the eye resolves on this display: acuity is a hyperbola, and the density its square.

        P(e) = min(1, (display_mar / (mar0 + slope e))^2)

    It is the limit of :class:`GuenterLayers` for ever more layers. The coarser the display, the larger the region of
    full rate. A layer is a range of rates, by default down to 1/2, down to 1/8, and below: see
    :func:`fovden.foveation.layer_of_rate`.

    Attributes:
        slope: Growth of the angle in degrees per cycle and degree, at least 0; a number, or a tensor without axes.
        mar0: Angle at the gaze in degrees per cycle, above 0; a number, or a tensor without axes.
        display_mar: Finest angle of the display in degrees per cycle, above 0, or ``None`` for that on the
            camera's optical axis.
        layer_rates: Rates in (0, 1] that fall, below which the next layer begins.

    Raises:
        ValueError: If a value is out of range.

    Differentiable: the rate, in ``slope``, ``mar0``, ``display_mar``, the gaze and the camera's tensors.

    Source: B. Guenter, M. Finch, S. Drucker, D. Tan, J. Snyder, "Foveated 3D graphics", ACM TOG 31(6), 2012, section 3;
    its formulas as they are quoted, not verified in print.

    Example:
        >>> HyperbolicFalloff().rate(torch.tensor([0.0, 2.0, 10.0, 40.0]), display_mar=0.0515)
        tensor([1.0000, 0.6310, 0.0457, 0.0033])
    """

    slope: float | Tensor = MAR_SLOPE
    mar0: float | Tensor = MAR_AT_GAZE
    display_mar: float | Tensor | None = None
    layer_rates: tuple[float, ...] = LAYER_RATES

    def __post_init__(self) -> None:
        require_scalar("HyperbolicFalloff.slope", self.slope, minimum=0)
        require_scalar("HyperbolicFalloff.mar0", self.mar0, above=0)
        if self.display_mar is not None:
            require_scalar("HyperbolicFalloff.display_mar", self.display_mar, above=0)
        rates = require_layer_rates("HyperbolicFalloff.layer_rates", self.layer_rates)
        object.__setattr__(self, "layer_rates", rates)

    def rate(self, eccentricity: Tensor, display_mar: float | Tensor) -> Tensor:
        """Returns the rate at eccentricities.

        Args:
            eccentricity: Angles from the gaze in degrees, floating, any shape.
            display_mar: Finest angle of the display in degrees per cycle; broadcasts.

        Returns:
            Rate in (0, 1].

        Differentiable: in all that it depends on.

        Example:
            >>> HyperbolicFalloff(slope=0.1, mar0=0.1).rate(torch.tensor([0.0, 1.0]), display_mar=0.1)
            tensor([1.0000, 0.2500])
        """
        rate: Tensor = (display_mar / (self.mar0 + self.slope * eccentricity)).square()
        return rate.clamp(max=1)

    def __call__(self, camera: Camera, gaze: Gaze, /) -> RateMap:
        """Returns rate and layer of every pixel of every view; see :class:`fovden.foveation.Falloff`."""
        views = camera.views
        finest = self.display_mar
        if finest is None:
            finest = _display_mar(_pixels_per_tangent(views)[:, 0]).reshape(-1, 1, 1, 1)
        rate = self.rate(eccentricity_degrees(gaze, views), finest)
        return RateMap(rate, layer_of_rate(rate, self.layer_rates))


@dataclass(frozen=True)
class GuenterLayers:
    """Three nested layers, each sampled as coarsely as the eye allows at its inner limit, of the cheapest sizes.

    With limits e_1 < e_2 and the strides

        s_1 = 1,    s_2 = max(1, mar(e_1) / display_mar),    s_3 = max(1, mar(e_2) / display_mar)

    on a display of w x h pixels, n of them per unit of tangent, layers 1 and 2 are squares of ``2 n tan(e_i)`` pixels
    around the gaze, layer 3 is the whole display, and the limits are those that minimise

        (2 n tan e_1)^2 + (2 n tan e_2 / s_2)^2 + w h / s_3^2.

    As a falloff, the rate is ``1 / s_i^2`` in layer i, where the innermost one that a pixel lies in counts. It has no
    overlaps, no blending and no history from frame to frame, which are the source's; so it takes fewer paths than the
    formula counts.

    Attributes:
        slope: Growth of the angle in degrees per cycle and degree, above 0.
        mar0: Angle at the gaze in degrees per cycle, above 0.
        shape: ``"square"``: squares on the image plane of ``2 n tan(e_i)`` pixels, as in the source. ``"circle"``:
            pixels up to e_i degrees from the gaze.

    Raises:
        ValueError: If a value is out of range.

    The cost is flat around its minimum: the limits that are quoted for three slopes, (3.80, 8.59), (3.35, 8.07) and
    (2.96, 7.62) degrees, come from a coarse search, and lie up to 0.04 degrees from those found here, at costs that
    are the same to 3e-5.

    Cost: the search takes some ten milliseconds for each geometry, once.

    Source: Guenter et al. 2012, section 4; its formulas as they are quoted, not verified in print.

    Example:
        >>> desktop = Display.from_size((1080, 1920), width=0.509, distance=0.59)
        >>> sizes = GuenterLayers(slope=0.022).sizes(desktop)
        >>> [round(degrees, 2) for degrees in sizes.eccentricities], [round(stride, 2) for stride in sizes.strides]
        ([3.81, 8.62], [1.0, 2.03, 4.09])
        >>> round(sizes.factor, 1)
        6.4
    """

    slope: float = MAR_SLOPE
    mar0: float = MAR_AT_GAZE
    shape: Shape = "square"

    def __post_init__(self) -> None:
        require_number("GuenterLayers.slope", self.slope, above=0)
        require_number("GuenterLayers.mar0", self.mar0, above=0)
        shapes = get_args(Shape)
        require(self.shape in shapes, "GuenterLayers.shape", repr(self.shape), f"one of {shapes}")

    def sizes(self, display: Display) -> LayerSizes:
        """Returns the cheapest sizes of the layers on a display.

        Args:
            display: Pixels and field of view.

        Returns:
            Limits, strides and samples. On a display so coarse that the eye resolves all of it, all strides are 1.

        Example:
            >>> sizes = GuenterLayers().sizes(Display.quest2())
            >>> [round(degrees, 1) for degrees in sizes.eccentricities], round(sizes.factor, 1)
            ([12.8, 27.2], 7.5)
        """
        return _cheapest(display.resolution, display.pixels_per_tangent, self.slope, self.mar0)

    def __call__(self, camera: Camera, gaze: Gaze, /) -> RateMap:
        """Returns rate and layer of every pixel of every view; see :class:`fovden.foveation.Falloff`."""
        views = camera.views
        require_shapes("v 2", {"v": views.view_count}, **{"gaze.pixels": gaze.pixels})
        density = _pixels_per_tangent(views).detach()
        sizes = [_cheapest(views.resolution, n, self.slope, self.mar0) for n in density[:, 0].tolist()]
        limits = density.new_tensor([each.eccentricities for each in sizes]).T.reshape(2, -1, 1, 1, 1)
        if self.shape == "circle":
            place = eccentricity_degrees(gaze, views).detach()
        else:
            limits = torch.tan(torch.deg2rad(limits))
            offsets = (pixel_centres(views.resolution).to(density) - gaze.pixels.detach().to(density)[:, None]).abs()
            place = (offsets / density[:, None]).amax(dim=-1).reshape(-1, 1, *views.resolution)
        layer = (place > limits).sum(dim=0)
        rates = density.new_tensor([[stride**-2 for stride in each.strides] for each in sizes])
        rate = rates.gather(1, layer.flatten(1)).reshape(layer.shape)
        return RateMap(rate, layer.to(torch.int32))


def _pixels_per_tangent(camera: Camera) -> Tensor:
    """Pixels per unit of tangent along x and y, shape (v, 2)."""
    height, width = camera.resolution
    left, right, bottom, top = camera.bounds.unbind(1)
    return torch.stack([width / (right - left), height / (top - bottom)], dim=1)


def _display_mar(pixels_per_tangent: Tensor) -> Tensor:
    return torch.rad2deg(torch.atan(2 / pixels_per_tangent))


@lru_cache(maxsize=64)
def _cheapest(resolution: tuple[int, int], density: float, slope: float, mar0: float) -> LayerSizes:
    height, width = resolution
    display_mar = math.degrees(math.atan(2 / density))

    def mar_ratio(degrees: Any) -> Any:
        return np.maximum(1, (mar0 + slope * degrees) / display_mar)

    def samples(e_1: Any, e_2: Any) -> list[Any]:
        side_1, side_2 = (2 * density * np.tan(np.radians(degrees)) for degrees in (e_1, e_2))
        return [side_1**2, (side_2 / mar_ratio(e_1)) ** 2, width * height / mar_ratio(e_2) ** 2]

    farthest = math.degrees(math.atan(math.hypot(width, height) / 2 / density))
    middle, reach = np.full(2, farthest / 2), farthest / 2
    for _ in range(ZOOMS):
        axes = [np.clip(np.linspace(each - reach, each + reach, GRID), 0, farthest) for each in middle]
        e_1, e_2 = np.meshgrid(*axes, indexing="ij")
        cost = np.where(e_1 <= e_2, sum(samples(e_1, e_2)), np.inf)
        best = np.unravel_index(cost.argmin(), cost.shape)
        middle, reach = np.array([e_1[best], e_2[best]]), reach * 4 / (GRID - 1)
    inner, outer = (float(degrees) for degrees in middle)
    first, second, third = (float(each) for each in samples(inner, outer))
    strides = (1.0, float(mar_ratio(inner)), float(mar_ratio(outer)))
    factor = width * height / (first + second + third)
    return LayerSizes((inner, outer), strides, (first, second, third), factor)
