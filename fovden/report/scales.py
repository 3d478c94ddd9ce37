"""The colour scales of the error maps: one for all images, so that the same colour is the same error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from torch import Tensor

from fovden import color
from fovden.metrics import rmse_map
from fovden.metrics.image import RELATIVE_EPS

__all__ = ["error_scales"]

SHARE = 0.98
"""Share of its pixels that an image's own scale would cover; the scale is the median of the images' own."""

DECADES = 4
"""Decades of the logarithmic scale of the relative error."""


def error_scales(
    pictures: Mapping[str, Tensor], truth: Tensor, exposure: float, flip_at: float | None
) -> list[dict[str, Any]]:
    """Returns the error maps of a page and the ends of their colour scales.

    Args:
        pictures: Linear radiance by name, shape (v, 3, h, w) each; the reference is among them.
        truth: The reference.
        exposure: Scale from radiance to the display.
        flip_at: Pixels per degree of the page's FLIP maps; ``None`` if it has none.

    Returns:
        Mappings as the page's script reads them: name, title, label, end of the scale, largest value there can be,
        and the decades of a logarithmic scale, 0 for a linear one.

    Example:
        >>> import torch
        >>> truth = torch.ones(1, 3, 2, 2)
        >>> scales = error_scales({"dark": truth / 2, "Reference": truth}, truth, 1.0, None)
        >>> [(scale["name"], scale["end"]) for scale in scales]
        [('display', 0.3), ('relative', 1.0)]
    """
    images = [image for image in pictures.values() if image is not truth]
    shown = color.display(truth, exposure)

    def display(image: Tensor) -> Tensor:
        return rmse_map(color.display(image, exposure), shown)

    def relative(image: Tensor) -> Tensor:
        return ((image - truth).square() / (truth.square() + RELATIVE_EPS)).mean(1)

    def scale(name: str, title: str, label: str, end: float, most: float, decades: int = 0) -> dict[str, Any]:
        return {"name": name, "title": title, "label": label, "end": end, "most": most, "decades": decades}

    scales = [
        scale(
            "display",
            "RMSE",
            "RMS over R, G, B of the difference of display values",
            min(1.0, _round_up(_typical_end(display, images), (1, 1.5, 2, 3, 4, 5, 6, 8))),
            1.0,
        ),
        scale(
            "relative",
            "Relative error",
            f"(image - reference)^2 / (reference^2 + {RELATIVE_EPS:g}), mean of R, G, B; logarithmic",
            _round_up(_typical_end(relative, images), (1,)),
            1e300,
            DECADES,
        ),
    ]
    if flip_at is not None:
        label = f"FLIP at {flip_at:.3g} pixels per degree and exposure {exposure:.3g}"
        scales.insert(1, scale("flip", "FLIP", label, 1.0, 1.0))
    return scales


def _typical_end(error: Callable[[Tensor], Tensor], images: Iterable[Tensor]) -> float:
    """The median over the images of the error that nearly all pixels stay below."""
    ends = []
    for image in images:
        values = error(image).flatten()
        values = values[values.isfinite()]
        if len(values):
            ends.append(float(values.kthvalue(1 + int(SHARE * (len(values) - 1))).values))
    return sorted(ends)[len(ends) // 2] if ends else 1.0


def _round_up(value: float, leading: Sequence[float]) -> float:
    """The next number of one given digit and zeros; at least 0.001."""
    value = max(value, 1e-3)
    power = 10.0 ** math.floor(math.log10(value))
    end = next(digit * power for digit in (*leading, 10) if digit * power >= value * (1 - 1e-9))
    return float(f"{end:.3g}")
