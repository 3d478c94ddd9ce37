"""The laws by which the visual-polar raster lays out distances: a closed form from acuity, and polynomials."""

from __future__ import annotations

import math

import torch
from torch import Tensor

# Acuity by eccentricity e in degrees is min(1, PEAK / (SLOPE e + 1)^2), constant up to CENTRE (Reddy 1997).
PEAK, SLOPE, CENTRE = 7.49, 0.3, 5.79
GAIN = PEAK / (SLOPE * CENTRE) ** 2
U_CENTRE = SLOPE * CENTRE + 1
NEWTON_STEPS = 8  # from the starts below, 6 reach the rounding of float64 for any eccentricity up to 180 degrees

# Distance over reach as a polynomial in t, fitted to the closed form at 40.28 degrees on [0.24, 1], lowest power first;
# a line through 0 below. Largest errors 7.2e-4 and 1.0e-4 of the reach.
POLYNOMIALS = {
    "poly3": (0.00575637, 0.56965757, -0.10516690, 0.52975297),
    "poly4": (0.02059007, 0.44245267, 0.25866570, 0.10838522, 0.16990635),
}
JOIN = 0.24


def acuity_integral(degrees: Tensor) -> Tensor:
    """g(e): the column at an eccentricity over that where the centre ends."""
    outer = degrees > CENTRE
    u = SLOPE * torch.where(outer, degrees, CENTRE) + 1
    grown = 1 + GAIN * (u.log() + 1 / u - math.log(U_CENTRE) - 1 / U_CENTRE)
    return torch.where(outer, grown, degrees / CENTRE)


def acuity_integral_slope(degrees: Tensor) -> Tensor:
    """g'(e), per degree."""
    outer = degrees > CENTRE
    e = torch.where(outer, degrees, CENTRE)
    return torch.where(outer, GAIN * SLOPE**2 * e / (SLOPE * e + 1) ** 2, 1 / CENTRE)


def acuity_integral_inverse(value: Tensor) -> Tensor:
    """The e with g(e) = value, by Newton's method; differentiable, since its last step is.

    With C = ln u + 1/u the root lies right of exp(C - 1/u_c), and the left side is concave for u > 2: steps from there
    never overshoot.
    """
    outer = value.detach() > 1
    target = (torch.where(outer, value, 1.0) - 1) / GAIN + math.log(U_CENTRE) + 1 / U_CENTRE
    with torch.no_grad():
        u = torch.exp(target - 1 / U_CENTRE).clamp(min=U_CENTRE)
        for _ in range(NEWTON_STEPS - 1):
            u = u - (u.log() + 1 / u - target) * u**2 / (u - 1)
    u = u - (u.log() + 1 / u - target) * u**2 / (u - 1)
    return torch.where(outer, (u - 1) / SLOPE, value * CENTRE)


def polynomial(coefficients: tuple[float, ...], t: Tensor) -> Tensor:
    """The polynomial from the join on, a line below, lowest power first."""
    join = sum(c * JOIN**k for k, c in enumerate(coefficients))
    total = torch.zeros_like(t)
    for c in reversed(coefficients):
        total = total * t + c
    return torch.where(t < JOIN, t * (join / JOIN), total)


def polynomial_slope(coefficients: tuple[float, ...], t: Tensor) -> Tensor:
    """Its derivative."""
    join = sum(c * JOIN**k for k, c in enumerate(coefficients))
    total = torch.zeros_like(t)
    for k in range(len(coefficients) - 1, 0, -1):
        total = total * t + k * coefficients[k]
    return torch.where(t < JOIN, join / JOIN, total)


def polynomial_inverse(coefficients: tuple[float, ...], y: Tensor) -> Tensor:
    """The t at which the polynomial is y, by Newton's method from t = y; both laws rise, and bend little."""
    join = sum(c * JOIN**k for k, c in enumerate(coefficients))
    outer = y.detach() > join
    target = torch.where(outer, y, 1.0)

    def step(t: Tensor) -> Tensor:
        t = t.clamp(min=JOIN)
        return t - (polynomial(coefficients, t) - target) / polynomial_slope(coefficients, t)

    with torch.no_grad():
        t = target
        for _ in range(NEWTON_STEPS - 1):
            t = step(t)
    return torch.where(outer, step(t), y * (JOIN / join))
