"""The learnable widths of the edge-stopping functions, and how they change from pass to pass.

A pass multiplies

    exp(-|c_p - c_q|^2 / sigma_radiance^2),
    exp(-|n_p - n_q|^2 / (step sigma_normal)^2) and
    exp(-|x_p - x_q|^2 / sigma_position^2).

Each pass removes noise, so the next one may tell smaller differences of illumination apart: sigma_radiance shrinks, the
widths of the geometry stay. Passes may also have widths of their own, to be learned apart from each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor, nn

from fovden.checks import require, require_integer, require_number
from fovden.filters.taps import Sigmas

__all__ = ["SIGMA_NORMAL", "SIGMA_POSITION", "SIGMA_RADIANCE", "EdgeStopping", "Schedule", "SigmaBy"]

# Neither Dammertz et al. nor the non-homogeneous denoiser's paper gives values. Ours come from halving and doubling
# each in turn, for the least error of the displayed NH3LD image, with four samples in each selected pixel. Optima:
# 16, 0.04, 0.013 on the Cornell box (2 x 480 x 540, reference of 256 samples) and 16, 0.15, 0.05 on the atrium
# (2 x 320 x 360, 64 samples); the minimum is flat in the first. Other scenes and sample counts deserve their own fit.
SIGMA_RADIANCE = 8.0
"""Default width of the radiance in the first pass, in units of the view's mean sampled luminance."""

SIGMA_NORMAL = 0.1
"""Default width of the unit normals at step 1; it grows with the step."""

SIGMA_POSITION = 0.03
"""Default width of the position, in units of the view's median hit depth."""

Schedule = Literal["halve_sigma", "halve_phi", "constant"]
"""How the width of radiance shrinks from pass to pass."""

SigmaBy = Literal["pass", "scale"]
"""What it shrinks with: the number of the pass, or the rank of its step."""

FACTORS: dict[str, float] = {"halve_sigma": 0.5, "halve_phi": math.sqrt(0.5), "constant": 1.0}


class EdgeStopping(nn.Module):
    """Three widths, stored as logarithms, and the schedule of the one for radiance.

    Pass k filters with ``factor^k sigma_radiance``. The factor is 1/2 for ``"halve_sigma"``, which is the wording of
    Dammertz et al. (2010), sqrt(1/2) for ``"halve_phi"``, which is what public shaders do to phi = sigma^2, and 1 for
    ``"constant"``. With ``sigma_by="pass"`` k counts the passes in the order in which they run; with ``"scale"`` it
    is the rank of the pass's step among the steps, the smallest first. The two agree where steps increase.

    With ``passes`` each pass has three widths of its own, which start equal: pass k filters with
    ``factor^k sigma_radiance[k]``, ``sigma_normal[k]`` and ``sigma_position[k]``, the passes in the order in which they
    run. What is learned is then the departure from the schedule.

    The papers give no values for the widths; the defaults were found by a search on two scenes.

    Args:
        sigma_radiance: Width of radiance in pass 0, positive, in the units of the radiance filtered.
        sigma_normal: Width of unit normals at step 1, positive.
        sigma_position: Width of position, positive, in the units of the position.
        schedule: How the width of radiance shrinks.
        sigma_by: What k counts in the power of the factor.
        passes: Number of passes that have widths of their own; ``None`` means that all share one triple.

    Raises:
        ValueError: If ``passes`` is below 1, a width is not positive, or an option is not one of those listed.

    Example:
        >>> edges = EdgeStopping(sigma_radiance=2.0)
        >>> [round(sigmas.radiance.item(), 3) for sigmas in edges.passes((4, 2, 1))]
        [2.0, 1.0, 0.5]
        >>> edges
        EdgeStopping(sigma_radiance=2, sigma_normal=0.1, sigma_position=0.03, schedule='halve_sigma', sigma_by='pass')
        >>> EdgeStopping(passes=3).log_sigma_normal.shape
        torch.Size([3])
    """

    def __init__(
        self,
        sigma_radiance: float = SIGMA_RADIANCE,
        sigma_normal: float = SIGMA_NORMAL,
        sigma_position: float = SIGMA_POSITION,
        *,
        schedule: Schedule = "halve_sigma",
        sigma_by: SigmaBy = "pass",
        passes: int | None = None,
    ) -> None:
        super().__init__()
        require(schedule in FACTORS, "schedule", repr(schedule), f"one of {', '.join(FACTORS)}")
        require(sigma_by in ("pass", "scale"), "sigma_by", repr(sigma_by), "pass or scale")
        sigmas = {"radiance": sigma_radiance, "normal": sigma_normal, "position": sigma_position}
        for name, sigma in sigmas.items():
            logarithm = math.log(require_number(f"sigma_{name}", sigma, above=0))
            shape = () if passes is None else (require_integer("passes", passes, minimum=1),)
            self.register_parameter(f"log_sigma_{name}", nn.Parameter(torch.full(shape, logarithm)))
        self.schedule = schedule
        self.sigma_by = sigma_by

    log_sigma_radiance: nn.Parameter
    log_sigma_normal: nn.Parameter
    log_sigma_position: nn.Parameter

    @property
    def sigma_radiance(self) -> Tensor:
        """Width of radiance before it shrinks, a scalar tensor, or one of shape (passes,)."""
        return self.log_sigma_radiance.exp()

    @property
    def sigma_normal(self) -> Tensor:
        """Width of unit normals at step 1, the same way."""
        return self.log_sigma_normal.exp()

    @property
    def sigma_position(self) -> Tensor:
        """Width of position, the same way."""
        return self.log_sigma_position.exp()

    @property
    def pass_count(self) -> int | None:
        """Number of passes that have widths of their own; ``None`` where all share one triple."""
        return len(self.log_sigma_radiance) if self.log_sigma_radiance.dim() else None

    def passes(self, steps: Sequence[int]) -> list[Sigmas]:
        """Returns the widths of each pass.

        Args:
            steps: The steps in the order in which they run, each at least 1.

        Returns:
            One entry per step.

        Raises:
            ValueError: If a step is below 1, or passes have widths of their own and there are more or fewer steps.

        Differentiable: in the logarithms.

        Example:
            >>> edges = EdgeStopping(1.0, sigma_by="scale")
            >>> [sigmas.radiance.item() for sigmas in edges.passes((4, 2, 1))]
            [0.25, 0.5, 1.0]
        """
        ladder = sorted({require_integer("steps", step, minimum=1) for step in steps})
        ranks = range(len(steps)) if self.sigma_by == "pass" else [ladder.index(step) for step in steps]
        factor = FACTORS[self.schedule]
        own = self.pass_count
        require(own in (None, len(steps)), "steps", tuple(steps), f"{own} steps, as many as there are widths")
        radiance, normal, position = (
            [logarithm.exp()] * len(steps) if own is None else [each.exp() for each in logarithm.unbind()]
            for logarithm in (self.log_sigma_radiance, self.log_sigma_normal, self.log_sigma_position)
        )
        return [Sigmas(factor**k * c, n, x) for k, c, n, x in zip(ranks, radiance, normal, position, strict=True)]

    def extra_repr(self) -> str:
        """Returns the widths and options, for ``print``.

        Example:
            >>> EdgeStopping(0.5).extra_repr()[:18]
            'sigma_radiance=0.5'
        """
        widths = []
        for name in ("sigma_radiance", "sigma_normal", "sigma_position"):
            numbers = [f"{float(width):.4g}" for width in getattr(self, name).detach().reshape(-1)]
            widths.append(f"{name}={numbers[0] if self.pass_count is None else '(' + ', '.join(numbers) + ')'}")
        return ", ".join([*widths, f"schedule={self.schedule!r}", f"sigma_by={self.sigma_by!r}"])
