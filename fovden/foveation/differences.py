"""Gradients from differences, for the few parameters of a falloff."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import torch
from torch import Tensor

from fovden.checks import require, require_number

__all__ = ["add_differences"]


def add_differences(parameters: Iterable[Tensor], loss: Callable[[], Tensor | float], step: float = 0.1) -> float:
    """Adds central differences of a loss to the gradients of some parameters, as ``backward`` would add derivatives.

    Each number of the parameters is moved by ``step`` to either side, and its gradient is
    ``(loss(+step) - loss(-step)) / (2 step)``. The loss is to be the same function of the parameters in every call: a
    mean over masks and frames of given seeds. With common random numbers the two sides differ in those pixels alone
    whose numbers lie between the two rates, so that a few frames suffice. On average it is the central difference of
    the expected loss, whatever the loss and the denoiser are: it sees also what has no derivative, such as the number
    of passes that a pixel gets.

    Args:
        parameters: The parameters; their values are the same afterwards.
        loss: The loss at their values.
        step: Width of the difference, above 0. A wide one has less noise: its variance falls as 1 / step.

    Returns:
        The mean of all losses that were computed.

    Raises:
        ValueError: If there is no parameter, or ``step`` is not above 0.

    Cost: two losses for each number.

    Source: common random numbers for differences of simulations, P. Glasserman, "Monte Carlo methods in financial
    engineering", 2004, section 7.1.

    Example:
        >>> x = torch.tensor([1.0, 2.0], requires_grad=True)
        >>> mean = add_differences([x], lambda: (x**2).sum(), step=0.5)
        >>> x.grad, mean
        (tensor([2., 4.]), 5.25)
    """
    require_number("step", step, above=0)
    losses = []
    with torch.no_grad():
        for parameter in parameters:
            before = parameter.clone()
            found = torch.zeros_like(before).flatten()
            for number in range(parameter.numel()):
                sides = []
                try:
                    for sign in (1, -1):
                        moved = before.flatten().clone()
                        moved[number] += sign * step
                        parameter.copy_(moved.view_as(before))
                        sides.append(float(loss()))
                finally:
                    parameter.copy_(before)
                found[number] = (sides[0] - sides[1]) / (2 * step)
                losses += sides
            found = found.view_as(before)
            parameter.grad = found if parameter.grad is None else parameter.grad + found
    require(len(losses) > 0, "parameters", "none", "at least one number to learn")
    return sum(losses) / len(losses)
