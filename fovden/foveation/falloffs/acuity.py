"""Falloffs that follow a model of the eye's acuity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from torch import Tensor

from fovden.camera import Camera, Gaze
from fovden.checks import require, require_number
from fovden.foveation.acuity import Acuity, ReddyAcuity
from fovden.foveation.display import eccentricity_degrees
from fovden.foveation.falloff import LAYER_RATES, RateMap, layer_of_rate, require_layer_rates

__all__ = ["AcuityFalloff"]


@dataclass(frozen=True)
class AcuityFalloff:
    """As many samples as the eye has acuity: the rate is ``max(minimum, M(e))`` with e in degrees.

    Any acuity can be put in: :class:`ReddyAcuity`, also squared, :class:`LinearMarAcuity`, :class:`TableAcuity`, or a
    callable of one's own from degrees to (0, 1]. Since M is one at the gaze, how many paths it takes in all is left to
    the budget: the argument ``mean_spp`` of :func:`fovden.foveation.sample_map`.

    A layer is a range of rates, by default down to 1/2, down to 1/8, and below: see
    :func:`fovden.foveation.layer_of_rate`.

    Attributes:
        acuity: Relative acuity M(e).
        minimum: Smallest rate, in [0, 1]; 0 follows the acuity everywhere.
        layer_rates: Rates in (0, 1] that fall, below which the next layer begins.

    Raises:
        ValueError: If a value is out of range, or at the call, if the acuity gives values outside of [0, 1].

    Differentiable: the rate, in the gaze, the camera's tensors, and whatever the acuity is differentiable in.

    Source: density in proportion to M is that of the visual-polar space (Koskela et al. 2019, as reconstructed); the
    layers are this library's.

    Example:
        >>> import torch
        >>> AcuityFalloff(minimum=0.1).rate(torch.tensor([0.0, 10.0, 30.0]))
        tensor([1.0000, 0.4681, 0.1000])
    """

    acuity: Acuity | Callable[[Tensor], Tensor] = field(default_factory=ReddyAcuity)
    minimum: float = 0.0
    layer_rates: tuple[float, ...] = LAYER_RATES

    def __post_init__(self) -> None:
        require(callable(self.acuity), "AcuityFalloff.acuity", self.acuity, "a callable from degrees to acuity")
        require_number("AcuityFalloff.minimum", self.minimum, minimum=0, maximum=1)
        rates = require_layer_rates("AcuityFalloff.layer_rates", self.layer_rates)
        object.__setattr__(self, "layer_rates", rates)

    def rate(self, eccentricity: Tensor) -> Tensor:
        """Returns the rate at eccentricities.

        Args:
            eccentricity: Angles from the gaze in degrees, floating, any shape.

        Returns:
            Rate in [minimum, 1], the same shape.

        Raises:
            ValueError: If the acuity gives values outside of [0, 1].

        Differentiable: in ``eccentricity``, and in what the acuity is.

        Example:
            >>> import torch
            >>> AcuityFalloff(ReddyAcuity(power=2)).rate(torch.tensor([5.0, 10.0]))
            tensor([1.0000, 0.2191])
        """
        acuity = self.acuity(eccentricity)
        within = bool(((acuity >= 0) & (acuity <= 1)).all())
        require(within, "AcuityFalloff.acuity", f"{acuity.min():g} to {acuity.max():g}", "acuities from 0 to 1")
        return acuity.clamp(min=self.minimum)

    def __call__(self, camera: Camera, gaze: Gaze, /) -> RateMap:
        """Returns rate and layer of every pixel of every view; see :class:`fovden.foveation.Falloff`."""
        rate = self.rate(eccentricity_degrees(gaze, camera))
        return RateMap(rate, layer_of_rate(rate, self.layer_rates))
