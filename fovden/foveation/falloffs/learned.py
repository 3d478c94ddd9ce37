"""Falloffs whose rates are learned, under a budget of paths that is held exactly.

Both are modules and falloffs at once: ``sample_map`` takes them as they are, and the rates of their ``RateMap`` have
derivatives in their parameters. Lengths are in units of ``sqrt(w h / 50)`` pixels, the rule of the 2023 paper's inner
radius, so that what was learned at one resolution serves at another of the same field of view.

The budget is the mean rate over all pixels of all views. It is not a penalty: one number of the falloff is solved for
it, for every camera and gaze, and the derivative follows it (implicit function theorem). A step of an optimiser changes
where the paths go, never how many there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_number
from fovden.foveation.display import eccentricity_pixels
from fovden.foveation.falloff import RateMap
from fovden.foveation.falloffs.three_layer import ThreeLayer

__all__ = ["LearnedProfile", "LearnedThreeLayer"]

STEPS, TOLERANCE = 100, 1e-14
"""Steps of Newton's method at most, and the change of a root below which they end; about eight are needed."""


class LearnedThreeLayer(nn.Module):
    """The paper's three layers with radii, and share or budget, that are learned.

    With r the distance from the gaze in pixels, the rate is continuous, that of ``ThreeLayer(ramp_end="1-p")``:

        rate = 1 - p t,    t = clamp((r - r0) / (r1 - r0), 0, 1),

    and at the paper's p = 1/2 is also its literal reading. Stored are log(r0), log(r1 - r0) and logit(p), lengths in
    units of ``sqrt(w h / 50)`` pixels; the defaults are the paper's values, before it rounds r0 down.

    With a budget p is no parameter but ``(1 - budget) / mean(t)``, which makes the mean rate the budget. Where circles
    are so wide that not even p = 1, no path outside, pays for them, both shrink by one factor until it does.

    A layer is a label, and has no derivative: the gradient knows what more or fewer paths do to the image, not what a
    change of a pixel's number of filter passes does. ``layers`` keeps the labels of another falloff while rates are
    learned; without it they move with the circles.

    Args:
        r0: Inner radius at the start, above 0, in units.
        width: r1 - r0 at the start, above 0, in units.
        p: Share p at the start, in (0, 1); without a budget only.
        budget: Mean rate to be held, in (0, 1), or ``None`` to learn p.
        layers: The falloff whose layers are kept, or ``None`` for those of the learned radii.

    Raises:
        ValueError: If a number is out of range, or p and a budget are given.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(270, 240)).views
        >>> gaze = Gaze.center(camera)
        >>> falloff = LearnedThreeLayer(budget=0.5)
        >>> rate = falloff(camera, gaze).rate
        >>> round(rate.mean(dtype=torch.float64).item(), 6), rate.requires_grad
        (0.5, True)
        >>> paper = falloff.frozen(camera, gaze)
        >>> round(paper.r0, 3), round(paper.r1, 3), round(paper.p, 3)
        (36.0, 72.0, 0.586)
    """

    def __init__(
        self,
        r0: float = 1.0,
        width: float = 1.0,
        p: float | None = None,
        *,
        budget: float | None = None,
        layers: ThreeLayer | None = None,
    ) -> None:
        super().__init__()
        require(p is None or budget is None, "p", p, "None where a budget is given, from which p follows")
        self.log_r0 = nn.Parameter(torch.tensor(math.log(require_number("r0", r0, above=0))))
        self.log_width = nn.Parameter(torch.tensor(math.log(require_number("width", width, above=0))))
        self.budget = None if budget is None else _require_share("budget", budget)
        share = _require_share("p", 0.5 if p is None else p)
        logit = nn.Parameter(torch.tensor(math.log(share / (1 - share)))) if budget is None else None
        self.logit_p = logit
        self.layers = layers

    def values(self, camera: Camera | StereoCamera, gaze: Gaze) -> tuple[Tensor, Tensor, Tensor]:
        """Returns r0 and r1 in pixels, and p, for a camera and a gaze.

        Returns:
            Three scalars, float64.

        Differentiable: in the parameters.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(270, 240))
            >>> r0, r1, p = LearnedThreeLayer().values(camera, Gaze.center(camera))
            >>> r0.item(), r1.item(), p.item()
            (36.0, 72.0, 0.5)
        """
        resolution = camera.views.resolution
        return self._solved(eccentricity_pixels(gaze, resolution).double(), resolution)

    def frozen(self, camera: Camera | StereoCamera, gaze: Gaze | None = None) -> ThreeLayer:
        """Returns the falloff as it is for a camera and a gaze, without gradient, with layers of its own radii.

        Args:
            camera: The views.
            gaze: Where each eye looks; ``None`` means the centre.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(270, 240))
            >>> LearnedThreeLayer().frozen(camera)
            ThreeLayer(r0=36.0, r1=72.0, p=0.5, ramp='ramp_radius', ramp_end='1-p', boundary='exact')
        """
        gaze = Gaze.center(camera) if gaze is None else gaze
        r0, r1, p = (value.item() for value in self.values(camera, gaze))
        return ThreeLayer(r0, max(r0, r1), min(p, 1.0), ramp_end="1-p")

    def forward(self, camera: Camera, gaze: Gaze) -> RateMap:
        """Returns rate and layer of every pixel of every view; see :class:`fovden.foveation.Falloff`.

        Differentiable: the rate, in the parameters.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(27, 24)).views
            >>> LearnedThreeLayer()(camera, Gaze.center(camera)).rate.shape
            torch.Size([2, 1, 27, 24])
        """
        resolution = camera.views.resolution
        distance = eccentricity_pixels(gaze, resolution)
        r0, r1, p = self._solved(distance.double(), resolution)
        rate = (1 - p * _ramp(distance.double(), r0, r1)).clamp(0, 1).to(distance.dtype)
        own = ThreeLayer(r0.item(), max(r0.item(), r1.item()), ramp_end="1-p")
        layers = own if self.layers is None else self.layers
        return RateMap(rate, layers.layer(distance, resolution), layers.radii(resolution))

    def _solved(self, distance: Tensor, resolution: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
        unit = _unit(resolution)
        r0 = unit * self.log_r0.double().exp()
        r1 = r0 + unit * self.log_width.double().exp()
        if self.budget is None:
            assert self.logit_p is not None
            return r0, r1, self.logit_p.double().sigmoid()
        mean = _ramp(distance, r0, r1).mean()
        if mean.item() < 1 - self.budget:
            lacking = 1 - self.budget

            def excess(scale: Tensor) -> Tensor:
                return lacking - _ramp(distance, scale * r0, scale * r1).mean()

            scale = _solve(excess, 0.0, 1.0, r0)
            r0, r1 = scale * r0, scale * r1
            mean = _ramp(distance, r0, r1).mean()
        return r0, r1, (1 - self.budget) / mean


class LearnedProfile(nn.Module):
    """A falloff of any falling shape: straight pieces between knots, under a budget.

    At the knots, which lie at given distances from the gaze, the rate is ``sigmoid(shift - drop)``, where ``drop``
    grows from knot to knot by the exponentials of the parameters; between knots it is linear, and beyond the last one
    constant. ``shift`` is solved for so that the mean rate is the budget, for every camera and gaze.

    Args:
        start: The falloff whose shape and budget it starts with, near enough: rates are kept between 0.01 and 0.99.
        budget: Mean rate to be held, in (0, 1).
        knots: Distances in units of ``sqrt(w h / 50)`` pixels, rising, two or more.
        layers: The falloff whose layers are kept.

    Raises:
        ValueError: If the budget is out of range or the knots are not rising.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(270, 240)).views
        >>> rate = LearnedProfile(budget=0.4)(camera, Gaze.center(camera)).rate
        >>> round(rate.mean(dtype=torch.float64).item(), 6), bool(rate[0, 0, 135, 120:].diff().max() <= 0)
        (0.4, True)
    """

    knots: Tensor

    def __init__(
        self,
        start: ThreeLayer | None = None,
        *,
        budget: float,
        knots: Sequence[float] = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0),
        layers: ThreeLayer | None = None,
    ) -> None:
        super().__init__()
        self.budget = _require_share("budget", budget)
        places = [require_number("knots", knot, minimum=0) for knot in knots]
        rising = len(places) > 1 and all(a < b for a, b in pairwise(places))
        require(rising, "knots", places, "two or more distances that rise")
        start, size = start or ThreeLayer(), (1 << 12, 1 << 12)
        self.register_buffer("knots", torch.tensor(places, dtype=torch.float64))
        rate = start.rate(self.knots * _unit(size), size).clamp(0.01, 0.99)
        steps = -rate.logit().diff()
        self.log_drops = nn.Parameter(steps.clamp(min=0.01).log().float())
        self.layers = layers or ThreeLayer()

    def forward(self, camera: Camera, gaze: Gaze) -> RateMap:
        """Returns rate and layer of every pixel of every view; see :class:`fovden.foveation.Falloff`.

        Differentiable: the rate, in the parameters.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(27, 24)).views
            >>> LearnedProfile(budget=0.4)(camera, Gaze.center(camera)).rate.shape
            torch.Size([2, 1, 27, 24])
        """
        resolution = camera.views.resolution
        distance = eccentricity_pixels(gaze, resolution)
        place = distance.double() / _unit(resolution)
        drops = torch.cat([self.log_drops.new_zeros(1), self.log_drops.exp().cumsum(0)]).double()
        right = torch.searchsorted(self.knots, place).clamp(1, len(self.knots) - 1)
        left = self.knots[right - 1]
        part = ((place - left) / (self.knots[right] - left)).clamp(0, 1)

        def rate_of(shift: Tensor) -> Tensor:
            rates = (shift - drops).sigmoid()
            return torch.lerp(rates[right - 1], rates[right], part)

        # At -40 every rate is below 1e-17, and at 40 above the largest drop every rate is 1 to rounding.
        highest = 40.0 + drops[-1].item()
        shift = _solve(lambda shift: rate_of(shift).mean() - self.budget, -40.0, highest, drops)
        rate = rate_of(shift).to(distance.dtype)
        return RateMap(rate, self.layers.layer(distance, resolution), self.layers.radii(resolution))


def _unit(resolution: tuple[int, int]) -> float:
    """The 2023 paper's inner radius before it is rounded down, pixels."""
    return math.sqrt(resolution[0] * resolution[1] / 50)


def _ramp(distance: Tensor, r0: Tensor, r1: Tensor) -> Tensor:
    """From 0 at r0 to 1 at r1."""
    return ((distance - r0) / (r1 - r0)).clamp(0, 1)


def _solve(function: Callable[[Tensor], Tensor], low: float, high: float, like: Tensor) -> Tensor:
    """The root of a function that rises, with the derivative of the root in whatever the function depends on.

    Newton's method, kept in an interval that shrinks. The last step starts at the root: it moves the value by rounding
    alone, and its derivative, with the slope held fixed, is that of the implicit function theorem.
    """
    root, slope = (low + high) / 2, 1.0
    for _ in range(STEPS):
        with torch.enable_grad():
            here = like.new_tensor(root, dtype=torch.float64).requires_grad_()
            value = function(here)
            slope = torch.autograd.grad(value, here)[0].item()
        low, high = (root, high) if value.item() < 0 else (low, root)
        following = root - value.item() / slope if slope > 0 else high + 1
        following = following if low <= following <= high else (low + high) / 2
        close, root = abs(following - root) <= TOLERANCE * max(1.0, abs(root)), following
        if close:
            break
    at = like.new_tensor(root, dtype=torch.float64)
    return at - function(at) / slope


def _require_share(name: str, value: float) -> float:
    require_number(name, value, minimum=0, maximum=1)
    require(0 < value < 1, name, value, "a number between 0 and 1")
    return float(value)
