"""Budgets of paths: rates that are scaled to a mean, and masks with exactly as many pixels as their rates add up to.

Neither is a matter of chance. The multiplier of the rates is solved for exactly, and a mask from numbers that are
spread evenly is corrected by one factor that all rates share.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from fovden.checks import require, require_finite, require_number, require_shapes

__all__ = ["rates_at_budget", "select_exactly"]


def rates_at_budget(rate: Tensor, mean: float) -> Tensor:
    """Returns rates of a given mean in every view: ``min(1, c rate)``, with the c of each view that gives the mean.

    The mean of ``min(1, c rate)`` grows with c in straight pieces. Each step solves the piece that it is in, which
    leaves c at or below the solution, and counts anew which pixels are full; where none is added, c is exact.

    Args:
        rate: Rates of at least 0, shape (v, 1, h, w).
        mean: Mean rate of each view, in (0, 1].

    Returns:
        The scaled rates, in [0, 1], shape and type of ``rate``.

    Raises:
        ShapeError: If the shape differs.
        ValueError: If a number is out of range, or fewer pixels than the mean asks for have a rate above 0.

    Differentiable: in ``rate``, the multiplier with it: whatever the rates do, their mean stays.

    Cost: about ten passes over the pixels.

    Example:
        >>> rates_at_budget(torch.tensor([1.0, 0.5, 0.25, 0.25]).reshape(1, 1, 1, 4), 0.75).flatten()
        tensor([1.0000, 1.0000, 0.5000, 0.5000])
        >>> rates_at_budget(torch.tensor([1.0, 0.5, 0.25, 0.25]).reshape(1, 1, 1, 4), 0.25).flatten()
        tensor([0.5000, 0.2500, 0.1250, 0.1250])
    """
    require_shapes("v 1 h w", rate=rate)
    require_number("mean", mean, above=0, maximum=1)
    require_finite("rate", rate, minimum=0)
    return torch.stack([_scaled(each, mean) for each in rate.double()]).to(rate.dtype)


def select_exactly(numbers: Tensor, rate: Tensor) -> Tensor:
    """Returns a mask of as many pixels in every view as their rates add up to, to the nearest whole number.

    Plain selection takes the pixels with U < rate, so that their number varies. Here the odds ``rate / (1 - rate)`` of
    all pixels are multiplied by one factor t for each view, the one that makes the number right:

        selected where U / (1 - U) < t rate / (1 - rate).

    A rate of 1 stays certain and a rate of 0 impossible. For independent numbers this is Rosén's Pareto sampling, whose
    probabilities approach the rates as the number grows; the more evenly numbers are spread, the nearer t is to 1.

    Args:
        numbers: Random numbers in [0, 1), shape (v or 1, 1, h, w): :func:`fovden.foveation.mask_numbers`.
        rate: Rates in [0, 1], shape (v, 1, h, w).

    Returns:
        The mask, bool, shape (v, 1, h, w), where v is the larger of both.

    Raises:
        ShapeError: If the shapes do not fit.

    Source: B. Rosén, "On sampling with probability proportional to size", Journal of Statistical Planning and Inference
    62, 1997.

    Example:
        >>> numbers = torch.tensor([0.1, 0.6, 0.7, 0.9]).reshape(1, 1, 1, 4)
        >>> rate = torch.tensor([0.0, 0.5, 0.5, 1.0]).reshape(1, 1, 1, 4)
        >>> (numbers < rate).flatten().tolist(), select_exactly(numbers, rate).flatten().tolist()
        ([False, False, False, True], [False, True, False, True])
    """
    sizes = require_shapes("v 1 h w", rate=rate)
    require_shapes("s 1 h w", {name: sizes[name] for name in "hw"}, numbers=numbers)
    fits = sizes["v"] == 1 or numbers.shape[0] in (1, sizes["v"])
    require(fits, "numbers", f"{numbers.shape[0]} views", f"1 or {sizes['v']} views")
    views = max(sizes["v"], numbers.shape[0])
    draws, chances = (each.detach().double().expand(views, -1, -1, -1) for each in (numbers, rate))
    return torch.stack([_nearest(*view) for view in zip(draws, chances, strict=True)])


def _scaled(rate: Tensor, mean: float) -> Tensor:
    """One view's rates in float64, scaled to a mean."""
    wanted, values = mean * rate.numel(), rate.detach()
    possible = int((values > 0).sum())
    # Single precision may lose one part in 10^7 of a mean that asks for every pixel there is.
    enough = wanted <= possible * (1 + 1e-6)
    require(
        enough, "mean", f"{mean:g}", f"at most {possible / rate.numel():g}, the share of pixels with a rate above 0"
    )
    full = torch.zeros_like(values, dtype=torch.bool)
    while True:
        count = int(full.sum())
        if count >= possible:
            return (values > 0).to(rate.dtype)
        factor = (wanted - count) / rate.masked_fill(full, 0).sum()
        full = full | (values * factor.detach() >= 1)
        if int(full.sum()) == count:
            return (rate * factor).clamp(max=1)


def _nearest(numbers: Tensor, rate: Tensor) -> Tensor:
    """One view's mask of as many pixels as the rates add up to."""
    count = math.floor(float(rate.sum()) + 0.5)
    if count == 0:
        return torch.zeros_like(rate, dtype=torch.bool)
    ratio = torch.where(rate > 0, numbers * (1 - rate) / (rate * (1 - numbers)), math.inf)
    limit = ratio.flatten().kthvalue(count).values
    chosen = ratio < limit
    ties = ratio.eq(limit).nonzero()[: count - int(chosen.sum())]
    chosen[tuple(ties.T)] = True
    return chosen
