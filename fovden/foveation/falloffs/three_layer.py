"""The three circular layers of the paper on non-homogeneous denoising (2023).

Paper and table of that work contradict each other in places; every reading has an option here, and its default is the
reading that explains the most of what is printed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze
from fovden.checks import require, require_number
from fovden.foveation.display import eccentricity_pixels
from fovden.foveation.falloff import RateMap

__all__ = ["ThreeLayer"]

Ramp = Literal["ramp_radius", "ramp_area", "flat", "table_spp"]
RampEnd = Literal["p", "1-p"]
Boundary = Literal["exact", "integer"]


@dataclass(frozen=True)
class ThreeLayer:
    """The three circular layers of non-homogeneous denoising: all pixels, a falling share of them, a constant share.

    With r the distance of the pixel's centre from the gaze in pixels, the probability of selecting a pixel is

        P(r) = 1                                       r <= r0          layer 0
             = 1 - (1 - p) (r - r0) / (r1 - r0)        r0 < r <= r1     layer 1
             = 1 - p                                   r > r1           layer 2

    The paper does not state the radii's rule; its Table 1 obeys r0 = floor(sqrt(w h / 50)) and r1 = 2 r0 at both of its
    resolutions (144 and 288, 265 and 530), which puts 6.28, 18.85 and 74.87 % of an eye into the layers.

    Readings of the paper, each with its default and its option:

    - Shape of the middle layer, ``ramp``. The text has "probability p" with "linear decay"; the table's 4, 3 and 2
      samples mean rates of 1, 3/4 and 1/2. ``"ramp_radius"`` is the formula above: its plain average over the radius is
      3/4, over the area 13/18 (for r1 = 2 r0 and p = 1/2). ``"ramp_area"`` is linear in r^2, so that the average over
      the area is 3/4 and the table's totals come out. ``"flat"`` is p everywhere: the text of the sampling section
      taken literally. ``"table_spp"`` has no mask: every pixel of a layer gets the same number of samples, with rates
      1, the mean of 1 and the ramp's end, and 1 - p: 4, 3 and 2 out of 4.
    - Value of the ramp at r1, ``ramp_end``. ``"p"`` is literal, and p >= 1/2 is required, so that the outer layer does
      not get more; ``"1-p"`` joins the outer layer without a step, for any p. Both agree at p = 1/2.
    - Pixels on a boundary, ``boundary``. ``"exact"`` compares r itself; ``"integer"`` compares floor(r), so that the
      rings begin at r0 + 1 and r1 + 1.

    How many samples a selected pixel gets, whether frames and eyes share a mask, and where the random numbers come from
    are arguments of :func:`fovden.foveation.sample_map`.

    Attributes:
        r0: Radius of the inner layer in pixels, or ``None`` for the rule above.
        r1: Outer radius of the middle layer in pixels, at least r0, or ``None`` for 2 r0.
        p: Share p, in [0, 1].
        ramp: Shape of the middle layer.
        ramp_end: Rate at r1.
        boundary: How pixels on a boundary are sorted.

    Raises:
        ValueError: If a value is out of range.

    Source: the 2023 paper on non-homogeneous denoising, sections 3.2 and 4.1 and Table 1.

    Example:
        >>> from fovden.camera import FHD, QUEST2
        >>> ThreeLayer().radii(FHD), ThreeLayer().radii(QUEST2)
        ((144.0, 288.0), (265.0, 530.0))
        >>> ThreeLayer(r0=10, r1=20).rate(torch.tensor([0.0, 10.0, 15.0, 20.0, 30.0]), FHD)
        tensor([1.0000, 1.0000, 0.7500, 0.5000, 0.5000])
    """

    r0: float | None = None
    r1: float | None = None
    p: float = 0.5
    ramp: Ramp = "ramp_radius"
    ramp_end: RampEnd = "p"
    boundary: Boundary = "exact"

    def __post_init__(self) -> None:
        for name, choices in (("ramp", Ramp), ("ramp_end", RampEnd), ("boundary", Boundary)):
            names = get_args(choices)
            require(getattr(self, name) in names, f"ThreeLayer.{name}", repr(getattr(self, name)), f"one of {names}")
        if self.r0 is not None:
            require_number("ThreeLayer.r0", self.r0, minimum=0)
        if self.r1 is not None:
            require_number("ThreeLayer.r1", self.r1, minimum=self.r0 or 0.0)
        lowest = 0.5 if self.ramp_end == "p" else 0.0
        require_number("ThreeLayer.p", self.p, minimum=lowest, maximum=1)

    def radii(self, resolution: tuple[int, int]) -> tuple[float, float]:
        """Returns r0 and r1 in pixels for an image of the given height and width.

        Raises:
            ValueError: If the given r1 is smaller than the r0 of the rule.

        Example:
            >>> ThreeLayer(r0=100).radii((1080, 960))
            (100.0, 200.0)
        """
        height, width = resolution
        # 1e-9: for 960 x 1080 the root is 144 exactly, and must not fall to 143 where it is computed as 143.99...
        r0 = float(math.floor(math.sqrt(width * height / 50) + 1e-9)) if self.r0 is None else float(self.r0)
        r1 = 2 * r0 if self.r1 is None else float(self.r1)
        require(r1 >= r0, "ThreeLayer.r1", r1, f"at least r0, which is {r0:g} at {width} x {height}")
        return r0, r1

    def layer(self, distance: Tensor, resolution: tuple[int, int]) -> Tensor:
        """Returns the layer at distances from the gaze.

        Args:
            distance: Distances in pixels, any shape.
            resolution: Height and width of the image.

        Returns:
            0, 1 or 2, int32, the same shape.

        Example:
            >>> ThreeLayer(r0=10, r1=20).layer(torch.tensor([10.0, 10.5, 20.5]), (1080, 960))
            tensor([0, 1, 2], dtype=torch.int32)
        """
        r0, r1 = self.radii(resolution)
        distance = self._sorted_by(distance)
        return (distance > r0).to(torch.int32) + (distance > r1).to(torch.int32)

    def rate(self, distance: Tensor, resolution: tuple[int, int]) -> Tensor:
        """Returns the rate at distances from the gaze.

        Args:
            distance: Distances in pixels, floating, any shape.
            resolution: Height and width of the image.

        Returns:
            Rate in [0, 1], the same shape.

        Differentiable: in ``distance``, within the ramp.

        Example:
            >>> ThreeLayer(r0=10, r1=20, ramp="flat", p=0.6).rate(torch.tensor([5.0, 15.0, 25.0]), (1080, 960))
            tensor([1.0000, 0.6000, 0.4000])
        """
        r0, r1 = self.radii(resolution)
        layer = self.layer(distance, resolution)
        distance = self._sorted_by(distance)
        end = self.p if self.ramp_end == "p" else 1 - self.p
        if self.ramp == "flat":
            middle = torch.full_like(distance, self.p)
        elif self.ramp == "table_spp":
            middle = torch.full_like(distance, (1 + end) / 2)
        else:
            power = 1 if self.ramp == "ramp_radius" else 2
            span = max(r1**power - r0**power, torch.finfo(distance.dtype).tiny)  # an empty ring has no pixel to ramp
            middle = 1 - (1 - end) * ((distance**power - r0**power) / span).clamp(0, 1)
        outer = torch.where(layer == 1, middle, torch.full_like(distance, 1 - self.p))
        return torch.where(layer == 0, torch.ones_like(distance), outer)

    def __call__(self, camera: Camera, gaze: Gaze, /) -> RateMap:
        """Returns rate and layer of every pixel of every view; see :class:`Falloff`."""
        resolution = camera.views.resolution
        distance = eccentricity_pixels(gaze, resolution)
        return RateMap(
            rate=self.rate(distance, resolution),
            layer=self.layer(distance, resolution),
            radii=self.radii(resolution),
            selects=self.ramp != "table_spp",
        )

    def _sorted_by(self, distance: Tensor) -> Tensor:
        return distance.floor() if self.boundary == "integer" else distance
