"""Visual acuity against eccentricity: how fine a detail the eye resolves, as a share of what it resolves at the gaze.

An acuity is any callable that takes eccentricities in degrees and returns relative acuity M(e) in (0, 1]. Falloffs take
it as a density, metrics as a weight. Each model here also knows the integral of e M(e) from 0 to e: how much of a disc
around the gaze lies within e when it is sampled as densely as the eye sees. Its values at two eccentricities give the
share of samples between them, and its inverse a raster that is as dense as M.

Formulas take a density from acuity in two ways: as M itself, or as M squared, since a patch that needs half the lines
in each direction needs a quarter of the samples. ``power`` chooses.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, Protocol, get_args, runtime_checkable

import torch
from torch import Tensor

from fovden.checks import require, require_number, require_scalar

__all__ = ["Acuity", "LinearMarAcuity", "ReddyAcuity", "TableAcuity"]

Power = Literal[1, 2]

REDDY_SCALE = 7.49
"""Reddy's factor: 449.4 cycles per degree over the 60 of full acuity."""
REDDY_SLOPE = 0.3
"""Reddy's slope, in 1 / degree."""
REDDY_LIMIT = 5.79
"""Eccentricity in degrees up to which Reddy's term is one."""


@runtime_checkable
class Acuity(Protocol):
    """A model of relative acuity.

    Example:
        >>> isinstance(ReddyAcuity(), Acuity)
        True
    """

    def __call__(self, eccentricity: Tensor, /) -> Tensor:
        """Returns relative acuity M(e) in (0, 1] at eccentricities in degrees of at least 0, of any shape."""
        ...

    def integral(self, eccentricity: Tensor, /) -> Tensor:
        """Returns the integral of ``e M(e)`` from 0 to eccentricities in degrees, in square degrees.

        Example:
            >>> ReddyAcuity().integral(torch.tensor(4.0))  # full acuity: e^2 / 2
            tensor(8.)
        """
        ...


@dataclass(frozen=True)
class ReddyAcuity:
    """Reddy's eccentricity term at zero velocity.

        M(e) = 1                        e <= 5.79
             = 7.49 / (0.3 e + 1)^2     e >  5.79

    times 60 cycles per degree. The joint is continuous to 2e-4. With ``power=2`` the value is the square of that.

    Attributes:
        power: 1 or 2: M or its square.

    Raises:
        ValueError: If ``power`` is neither.

    Differentiable: in the eccentricity.

    Source: M. Reddy, "Perceptually modulated level of detail for virtual environments", 1997. That it is the acuity of
    the visual-polar space (Koskela et al. 2019) is a reconstruction: the printed formula could not be read.

    Example:
        >>> ReddyAcuity()(torch.tensor([0.0, 5.0, 10.0, 30.0]))
        tensor([1.0000, 1.0000, 0.4681, 0.0749])
        >>> ReddyAcuity(power=2)(torch.tensor([0.0, 5.0, 10.0, 30.0]))
        tensor([1.0000, 1.0000, 0.2191, 0.0056])
    """

    power: Power = 1

    def __post_init__(self) -> None:
        _require_power("ReddyAcuity.power", self.power)

    def __call__(self, eccentricity: Tensor, /) -> Tensor:
        """Returns M(e) at eccentricities in degrees; see :class:`Acuity`."""
        outside = REDDY_SCALE / (REDDY_SLOPE * eccentricity + 1).square()
        return torch.where(eccentricity <= REDDY_LIMIT, torch.ones_like(outside), outside) ** self.power

    def integral(self, eccentricity: Tensor, /) -> Tensor:
        """Returns the integral of ``e M(e)`` in closed form.

        With u = 0.3 e + 1 the antiderivative outside of the fovea is ``7.49 / 0.09 (ln u + 1 / u)``, and for the square
        ``7.49^2 / 0.09 (1 / (3 u^3) - 1 / (2 u^2))``.

        Differentiable: in the eccentricity.

        The example gives the fovea's share of the columns of a visual-polar raster.

        Example:
            >>> inside, all_of_it = ReddyAcuity().integral(torch.tensor([5.79, 40.28], dtype=torch.float64)).tolist()
            >>> round(inside, 3), round(2 * inside / (all_of_it + inside), 3)
            (16.762, 0.24)
        """
        # The outer branch starts at the joint, so that its derivative is finite everywhere.
        u = REDDY_SLOPE * eccentricity.clamp(min=REDDY_LIMIT) + 1
        joint = torch.as_tensor(REDDY_SLOPE * REDDY_LIMIT + 1, dtype=u.dtype, device=u.device)
        outside = self._antiderivative(u) - self._antiderivative(joint) + REDDY_LIMIT**2 / 2
        return torch.where(eccentricity <= REDDY_LIMIT, eccentricity.square() / 2, outside)

    def _antiderivative(self, u: Tensor) -> Tensor:
        scale = REDDY_SCALE**self.power / REDDY_SLOPE**2
        if self.power == 1:
            return scale * (u.log() + 1 / u)
        return scale * (1 / (3 * u**3) - 1 / (2 * u**2))


@dataclass(frozen=True)
class LinearMarAcuity:
    """The hyperbola of a minimum angle of resolution (MAR) that grows linearly with eccentricity.

        M(e) = mar0 / (mar0 + slope e)

    With ``power=2`` the value is the square of that.

    Attributes:
        slope: Growth of the angle in degrees per cycle and degree, above 0; a number, or a tensor without axes. Guenter
            et al. found 0.022 to 0.0343 in three tests; the default is the finest.
        mar0: Angle at the gaze in degrees per cycle, above 0; a number, or a tensor without axes. 1/48 is theirs.
        power: 1 or 2: M or its square.

    Raises:
        ValueError: If a value is out of range.

    Differentiable: in the eccentricity, in ``slope`` and in ``mar0``.

    Source: B. Guenter et al., "Foveated 3D graphics", ACM TOG 31(6), 2012, section 3.

    Example:
        >>> LinearMarAcuity()(torch.tensor([0.0, 1.0, 10.0]))
        tensor([1.0000, 0.4864, 0.0865])
    """

    slope: float | Tensor = 0.022
    mar0: float | Tensor = 1 / 48
    power: Power = 1

    def __post_init__(self) -> None:
        require_scalar("LinearMarAcuity.slope", self.slope, above=0)
        require_scalar("LinearMarAcuity.mar0", self.mar0, above=0)
        _require_power("LinearMarAcuity.power", self.power)

    def __call__(self, eccentricity: Tensor, /) -> Tensor:
        """Returns M(e) at eccentricities in degrees; see :class:`Acuity`."""
        return (self.mar0 / (self.mar0 + self.slope * eccentricity)) ** self.power

    def integral(self, eccentricity: Tensor, /) -> Tensor:
        """Returns the integral of ``e M(e)`` in closed form.

        With a = mar0 / slope and x = e / a it is ``a^2 (x - ln(1 + x))``, and for the square
        ``a^2 (ln(1 + x) - x / (1 + x))``. Both are differences of nearly equal terms where x is small: in float32
        their error is about 1e-7 of ``a^2``.

        Differentiable: in the eccentricity, in ``slope`` and in ``mar0``.

        Example:
            >>> LinearMarAcuity().integral(torch.tensor([1.0, 10.0]))
            tensor([0.3006, 7.2749])
        """
        a = self.mar0 / self.slope
        x = eccentricity / a
        return a**2 * (x - torch.log1p(x) if self.power == 1 else torch.log1p(x) - x / (1 + x))


@dataclass(frozen=True)
class TableAcuity:
    """A measured acuity: values at eccentricities, straight lines between them, constant before and beyond.

    Attributes:
        eccentricities: Degrees of at least 0 that rise, two or more.
        values: Relative acuity at each of them, in (0, 1], not rising.

    Raises:
        ValueError: If the table is none of this.

    Differentiable: in the eccentricity.

    Example:
        >>> TableAcuity((2.0, 10.0, 40.0), (1.0, 0.4, 0.1))(torch.tensor([0.0, 6.0, 60.0]))
        tensor([1.0000, 0.7000, 0.1000])
    """

    eccentricities: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        names = "TableAcuity.eccentricities", "TableAcuity.values"
        places = tuple(require_number(names[0], each, minimum=0) for each in self.eccentricities)
        values = tuple(require_number(names[1], each, above=0, maximum=1) for each in self.values)
        require(len(places) > 1, names[0], places, "two or more eccentricities")
        require(all(a < b for a, b in pairwise(places)), names[0], places, "eccentricities that rise")
        require(len(values) == len(places), names[1], values, f"{len(places)} values, one for each eccentricity")
        require(all(a >= b for a, b in pairwise(values)), names[1], values, "values that do not rise")
        object.__setattr__(self, "eccentricities", places)
        object.__setattr__(self, "values", values)

    def __call__(self, eccentricity: Tensor, /) -> Tensor:
        """Returns M(e) at eccentricities in degrees; see :class:`Acuity`."""
        start, value, slope, _ = self._piece(eccentricity)
        return value + slope * (eccentricity - start)

    def integral(self, eccentricity: Tensor, /) -> Tensor:
        """Returns the integral of ``e M(e)``, a cubic in each piece.

        Differentiable: in the eccentricity.

        Example:
            >>> TableAcuity((0.0, 10.0), (1.0, 0.5)).integral(torch.tensor([0.0, 10.0, 20.0]))
            tensor([  0.0000,  33.3333, 108.3333])
        """
        start, value, slope, before = self._piece(eccentricity)
        length = eccentricity - start  # e M(e) = (start + t) (value + slope t) with t from 0 to length
        linear, quadratic, cubic = start * value, (value + start * slope) / 2, slope / 3
        return before + length * (linear + length * (quadratic + length * cubic))

    def _piece(self, eccentricity: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Start, value and slope of the piece that each eccentricity lies in, and the integral up to its start."""
        starts = [0.0, *self.eccentricities]
        values = [self.values[0], *self.values]
        slopes, before = [0.0], [0.0]
        for (a, b), (m, n) in zip(pairwise(starts), pairwise(values), strict=True):
            slopes[-1] = (n - m) / (b - a) if b > a else 0.0
            before.append(before[-1] + (b - a) * (a * (m + n) / 2 + (b - a) * (m + 2 * n) / 6))
            slopes.append(0.0)
        table = torch.tensor([starts, values, slopes, before], dtype=torch.float64, device=eccentricity.device)
        index = torch.searchsorted(table[0, 1:].contiguous(), eccentricity.detach().double(), right=True)
        start, value, slope, integral = table.to(eccentricity.dtype)[:, index]
        return start, value, slope, integral


def _require_power(name: str, power: int) -> None:
    require(not isinstance(power, bool) and power in get_args(Power), name, power, "1 or 2")
