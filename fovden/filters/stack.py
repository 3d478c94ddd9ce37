"""How steps, widths and kernels that are learned become the passes of a stack."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from fovden.checks import require_integer
from fovden.filters.edge_stopping import EdgeStopping
from fovden.filters.passes import Pass
from fovden.filters.taps import B3_SPLINE, Sigmas

__all__ = ["TapKernel", "hole_widths", "plan_passes"]


class TapKernel(nn.Module):
    """The 5 x 5 weights of each pass's taps, learned: positive, and of sum 1 in each pass.

    They are stored as logits and go through a softmax over the 25 taps. They start as the B3 spline, to rounding.
    Nothing ties the taps to each other: a kernel may become lopsided.

    Args:
        passes: Number of passes, at least 1.

    Raises:
        ValueError: If ``passes`` is below 1.

    Example:
        >>> kernel = TapKernel(2)
        >>> kernel().shape, round(kernel()[0, 2, 2].item() * 64, 4)
        (torch.Size([2, 5, 5]), 9.0)
        >>> bool(torch.allclose(kernel().sum((1, 2)), torch.ones(2)))
        True
    """

    def __init__(self, passes: int) -> None:
        super().__init__()
        spline = torch.tensor(B3_SPLINE)
        logits = (spline[:, None] * spline).log()
        self.log_kernel = nn.Parameter(logits.repeat(require_integer("passes", passes, minimum=1), 1, 1))

    def forward(self) -> Tensor:
        """Returns the weights, shape (passes, 5, 5), rows first.

        Differentiable: in the logits.

        Example:
            >>> kernel = TapKernel(1)
            >>> _ = nn.init.zeros_(kernel.log_kernel)
            >>> round(kernel()[0, 0, 0].item(), 4)
            0.04
        """
        # Not softmax(), whose derivative differs in its last bits with the number of threads (PyTorch 2.13, CPU).
        return (self.log_kernel - self.log_kernel.logsumexp((1, 2), keepdim=True)).exp()

    def extra_repr(self) -> str:
        """Returns the number of passes, for ``print``.

        Example:
            >>> TapKernel(3)
            TapKernel(passes=3)
        """
        return f"passes={len(self.log_kernel)}"


def plan_passes(
    steps: Sequence[int], edge_stopping: EdgeStopping, kernel: TapKernel | None = None, label: int = 0
) -> list[Pass]:
    """Returns a stack's passes, each on a level of its own.

    Args:
        steps: Distances between taps in pixels, in the order in which the passes run.
        edge_stopping: The widths.
        kernel: The weights of the taps; ``None`` means the B3 spline.
        label: Label of the pixels that they work on.

    Returns:
        One pass for each step.

    Example:
        >>> [(each.step, each.level) for each in plan_passes((4, 2, 1), EdgeStopping())]
        [(4, 0), (2, 1), (1, 2)]
    """
    kernels = [None] * len(steps) if kernel is None else kernel().unbind()
    widths = edge_stopping.passes(steps)
    parts = enumerate(zip(steps, widths, kernels, strict=True))
    return [Pass(step, sigmas, label, level, taps) for level, (step, sigmas, taps) in parts]


def hole_widths(passes: Sequence[Pass]) -> Sigmas:
    """Returns the widths with which holes are filled: those of the pass with the smallest step.

    Filling begins at step 1, so that pass has looked at the same neighbours.

    Args:
        passes: A stack's passes, at least one.

    Returns:
        Its widths.

    Example:
        >>> hole_widths([Pass(2, Sigmas(1.0, 0.1, 0.5)), Pass(1, Sigmas(0.5, 0.2, 0.5))]).normal
        0.2
    """
    least = min(each.step for each in passes)
    return next(each.sigmas for each in passes if each.step == least)
