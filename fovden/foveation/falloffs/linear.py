"""The linear falloff of Weier et al. (2016) and Koskela (2020)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze
from fovden.checks import require, require_scalar
from fovden.foveation.display import EccentricityUnit, eccentricity_degrees, eccentricity_pixels
from fovden.foveation.falloff import RateMap

__all__ = ["LinearFalloff"]

FOVEA_DEGREES = 10.0
"""Default r0 in degrees: the smallest of the radii that Weier et al. are said to have tested; not verified."""
PERIPHERY_RATE = 0.05
"""Default p_min: that of a public implementation of Weier's equation (ohseokkwon, samplingStep.cu)."""


@dataclass(frozen=True)
class LinearFalloff:
    """All samples within r0, a share that falls linearly with eccentricity to p_min at r1, and p_min beyond.

        P(e) = 1                                          e <= r0         layer 0
             = 1 - (1 - p_min) (e - r0) / (r1 - r0)       r0 < e <= r1    layer 1
             = p_min                                      e > r1          layer 2

    Koskela's fovea limit, periphery limit and periphery probability are r0, r1 and p_min. Layers are those of the
    formula, as in :class:`ThreeLayer`, which is this falloff in pixels with r1 = 2 r0 and p_min = 1/2.

    Attributes:
        r0: Radius of the fovea in ``unit``, at least 0; a number, or a tensor without axes. ``None`` means 10 degrees;
            in pixels it must be given.
        r1: Start of the periphery in ``unit``, at least r0; a number, or a tensor without axes. ``None`` means 2 r0, as
            in a public implementation.
        p_min: Rate in the periphery, in [0, 1]; a number, or a tensor without axes.
        unit: ``"degrees"`` between view rays, or ``"pixels"`` on the image plane. Curves of equal eccentricity in
            degrees are no circles on the image plane unless the gaze is on the optical axis, so that ``RateMap.radii``
            is empty in degrees.

    Raises:
        ValueError: If a value is out of range.

    Differentiable: the rate, in r0, r1 and p_min, and within the ramp in the gaze.

    Source: M. Weier et al., "Foveated real-time ray tracing for head-mounted displays", Computer Graphics Forum 35(7),
    2016; M. Koskela, "Foveated path tracing with fast reconstruction and efficient sample distribution", dissertation,
    Tampere University, 2020, equation 4.1.

    Example:
        >>> LinearFalloff().rate(torch.tensor([0.0, 10.0, 15.0, 20.0, 50.0]))
        tensor([1.0000, 1.0000, 0.5250, 0.0500, 0.0500])
    """

    r0: float | Tensor | None = None
    r1: float | Tensor | None = None
    p_min: float | Tensor = PERIPHERY_RATE
    unit: EccentricityUnit = "degrees"

    def __post_init__(self) -> None:
        units = get_args(EccentricityUnit)
        require(self.unit in units, "LinearFalloff.unit", repr(self.unit), f"one of {units}")
        given = self.r0 is not None or self.unit == "degrees"
        require(given, "LinearFalloff.r0", self.r0, "a radius, since there is no default in pixels")
        if self.r0 is not None:
            require_scalar("LinearFalloff.r0", self.r0, minimum=0)
        if self.r1 is not None:
            require_scalar("LinearFalloff.r1", self.r1, minimum=_value(self.radii[0]))
        require_scalar("LinearFalloff.p_min", self.p_min, minimum=0, maximum=1)

    @property
    def radii(self) -> tuple[float | Tensor, float | Tensor]:
        """r0 and r1 in ``unit``, with the defaults put in."""
        r0 = FOVEA_DEGREES if self.r0 is None else self.r0
        return r0, 2 * r0 if self.r1 is None else self.r1

    def rate(self, eccentricity: Tensor) -> Tensor:
        """Returns the rate at eccentricities.

        Args:
            eccentricity: Distances from the gaze in ``unit``, floating, any shape.

        Returns:
            Rate in [p_min, 1], the same shape.

        Differentiable: in ``eccentricity``, r0, r1 and p_min.

        Example:
            >>> LinearFalloff(100, 300, 0.2, unit="pixels").rate(torch.tensor([100.0, 200.0, 300.0]))
            tensor([1.0000, 0.6000, 0.2000])
        """
        r0, r1 = self.radii
        if _value(r1) > _value(r0):
            ramp = ((eccentricity - r0) / (r1 - r0)).clamp(0, 1)
        else:  # a step, which has no ramp
            ramp = (eccentricity > _value(r0)).to(eccentricity.dtype)
        rate: Tensor = 1 - (1 - self.p_min) * ramp
        return rate

    def layer(self, eccentricity: Tensor) -> Tensor:
        """Returns the layer at eccentricities.

        Args:
            eccentricity: Distances from the gaze in ``unit``, any shape.

        Returns:
            0, 1 or 2, int32, the same shape.

        Example:
            >>> LinearFalloff().layer(torch.tensor([10.0, 10.5, 20.5]))
            tensor([0, 1, 2], dtype=torch.int32)
        """
        r0, r1 = (_value(radius) for radius in self.radii)
        return (eccentricity > r0).to(torch.int32) + (eccentricity > r1).to(torch.int32)

    def __call__(self, camera: Camera, gaze: Gaze, /) -> RateMap:
        """Returns rate and layer of every pixel of every view; see :class:`fovden.foveation.Falloff`."""
        views = camera.views
        if self.unit == "degrees":
            eccentricity = eccentricity_degrees(gaze, views)
            return RateMap(self.rate(eccentricity), self.layer(eccentricity))
        eccentricity = eccentricity_pixels(gaze, views.resolution)
        radii = tuple(_value(radius) for radius in self.radii)
        return RateMap(self.rate(eccentricity), self.layer(eccentricity), radii)


def _value(number: float | Tensor) -> float:
    return float(number.detach()) if isinstance(number, Tensor) else float(number)
