"""What fitting makes small: how far an image is from its reference, as one number with a gradient."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from fovden import color, metrics
from fovden.checks import require, require_number
from fovden.frame import Frame

__all__ = ["TERMS", "ImageError", "Objective"]


class Objective(Protocol):
    """A function of an image, its reference and the noisy frame that gives one number, to be made small.

    Example:
        >>> def largest(image: Tensor, reference: Tensor, frame: Frame) -> Tensor:
        ...     return (image - reference).abs().max()
        >>> objective: Objective = largest
    """

    def __call__(self, image: Tensor, reference: Tensor, frame: Frame, /) -> Tensor:
        """Returns the number as a scalar tensor, differentiable in the image."""
        ...


Term = Callable[[Tensor, Tensor, Tensor | None], Tensor]


def _log_l1(image: Tensor, reference: Tensor, weight: Tensor | None) -> Tensor:
    return metrics.weighted_mean((image.log1p() - reference.log1p()).abs(), weight)


def _l1(image: Tensor, reference: Tensor, weight: Tensor | None) -> Tensor:
    return metrics.weighted_mean((_display(image) - _display(reference)).abs(), weight)


def _l2(image: Tensor, reference: Tensor, weight: Tensor | None) -> Tensor:
    return metrics.mse(_display(image), _display(reference), weight)


def _dissimilarity(image: Tensor, reference: Tensor, weight: Tensor | None) -> Tensor:
    return 1 - metrics.ssim(_display(image), _display(reference), weight)


def _display(exposed: Tensor) -> Tensor:
    return color.display(exposed, 1.0)


TERMS: Mapping[str, Term] = {
    "smape": metrics.smape,
    "log_l1": _log_l1,
    "l1": _l1,
    "l2": _l2,
    "ssim": _dissimilarity,
}
"""The terms by name: functions of the exposed image and reference and of a weight map that give a number per view."""


@dataclass(frozen=True)
class ImageError:
    """A weighted sum of errors, averaged over the views.

    Both images are multiplied by the exposure of the reference (:func:`fovden.color.exposure`) first, so that a term
    weighs the same in bright and in dark scenes. Terms, all 0 for equal images:

    - ``"smape"``: mean of |x - y| / (x + y + 0.01), as :func:`fovden.metrics.smape`.
    - ``"log_l1"``: mean of |log(1 + x) - log(1 + y)|.
    - ``"l1"``, ``"l2"``: mean absolute and mean squared difference of what a display shows. Where the image is brighter
      than the display can be, it has no gradient.
    - ``"ssim"``: 1 - SSIM of what a display shows. Images must be at least 11 pixels in height and width.

    Attributes:
        terms: Weight of each term.
        layer_weights: Weight of a pixel by its foveation layer, the innermost first; the last serves all further ones.
            ``None`` means that all pixels count alike. Of a frame in cells it is that of the cells that a pixel reads.

    Raises:
        ValueError: If a term is unknown or a weight is negative, or all of them are 0.

    Differentiable: in the image and in the reference.
    Source: the terms are common; SMAPE for denoising is from Vogels et al. (SIGGRAPH 2018), the mix of an absolute
    error and SSIM from Zhao, Gallo, Frosio, Kautz (IEEE Transactions on Computational Imaging 3(1), 2017).

    Example:
        >>> from fovden.frame import GBuffer
        >>> frame = Frame.from_radiance(torch.rand(1, 3, 16, 16), GBuffer.empty(1, (16, 16)))
        >>> error = ImageError({"l1": 0.8, "ssim": 0.2})
        >>> reference = torch.full((1, 3, 16, 16), 2.0)
        >>> error(reference, reference, frame).item(), error(reference / 2, reference, frame).item() > 0
        (0.0, True)
    """

    terms: Mapping[str, float] = field(default_factory=lambda: {"smape": 1.0})
    layer_weights: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", dict(self.terms))
        for name, weight in self.terms.items():
            require(name in TERMS, "terms", repr(name), f"one of {', '.join(TERMS)}")
            require_number(f"terms[{name!r}]", weight, minimum=0)
        require(sum(self.terms.values()) > 0, "terms", self.terms, "a positive weight")
        if self.layer_weights is not None:
            object.__setattr__(self, "layer_weights", tuple(self.layer_weights))
            for weight in self.layer_weights:
                require_number("layer_weights", weight, minimum=0)
            require(sum(self.layer_weights) > 0, "layer_weights", self.layer_weights, "a positive weight")

    def __call__(self, image: Tensor, reference: Tensor, frame: Frame, /) -> Tensor:
        """Returns the error of an image, a scalar tensor; see :class:`Objective`."""
        exposure = color.exposure(reference.detach())
        weight = None
        if self.layer_weights is not None:
            table = torch.tensor(self.layer_weights, dtype=image.dtype, device=image.device)
            weight = table[frame.layer.long().clamp(max=len(table) - 1)]
            if frame.warp is not None:  # the image is on the screen
                weight = frame.warp.to_screen(weight)
        exposed = image * exposure, reference * exposure
        errors = [share * TERMS[name](*exposed, weight).nanmean() for name, share in self.terms.items() if share > 0]
        return torch.stack(errors).sum()
