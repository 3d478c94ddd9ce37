"""What the figures of a comparison show: display values, errors, numbers and names."""

from __future__ import annotations

import torch
from torch import Tensor

from fovden import color
from fovden.comparison import METHODS, SavedComparison
from fovden.metrics import rmse_map

__all__ = [
    "ERROR_SHARE",
    "aspect_of",
    "describe",
    "display_of",
    "error_limit",
    "error_of",
    "eye_name",
    "value_of",
]

ERROR_SHARE = 0.995
"""Share of each denoised image's pixels that the error scale covers."""


def display_of(saved: SavedComparison, name: str) -> Tensor:
    """A method's image, or the reference's, as a display shows it, shape (v, 3, h, w).

    Example:
        >>> from fovden.frame import Reference
        >>> white = Reference(torch.ones(1, 3, 4, 4), torch.zeros(1, 3, 4, 4), count=1)
        >>> images = {"Base": torch.zeros(1, 3, 4, 4)}
        >>> saved = SavedComparison("box", images, white, {}, 1.0, (), [], {}, {})
        >>> [round(float(display_of(saved, name).mean()), 3) for name in ("Base", "Reference")]
        [0.0, 1.0]
    """
    return color.display(saved.reference.mean if name == "Reference" else saved.images[name], saved.exposure)


def error_of(saved: SavedComparison, name: str) -> Tensor:
    """A method's error map, shape (v, 1, h, w).

    Example:
        >>> from fovden.frame import Reference
        >>> white = Reference(torch.ones(1, 3, 4, 4), torch.zeros(1, 3, 4, 4), count=1)
        >>> images = {"Base": torch.zeros(1, 3, 4, 4)}
        >>> error = error_of(SavedComparison("box", images, white, {}, 1.0, (), [], {}, {}), "Base")
        >>> tuple(error.shape), round(float(error.mean()), 3)
        ((1, 1, 4, 4), 1.0)
    """
    return rmse_map(display_of(saved, name), display_of(saved, "Reference"))


def error_limit(saved: SavedComparison) -> float:
    """One error scale for all methods: it covers nearly all pixels of the denoised images.

    Inputs, and what comes of ignoring the mask, are left out: their errors would make the others' invisible.

    Example:
        >>> from fovden.frame import Reference
        >>> white = Reference(torch.ones(1, 3, 4, 4), torch.zeros(1, 3, 4, 4), count=1)
        >>> images = {method.name: 0.5 * white.mean for method in METHODS} | {"Noisy, full": 0 * white.mean}
        >>> round(error_limit(SavedComparison("box", images, white, {}, 1.0, (), [], {}, {})), 3)
        0.265
    """
    limits = [1e-3]
    for method in METHODS:
        if method.denoiser is not None and not method.ignore_mask:
            errors = error_of(saved, method.name).flatten()
            errors = errors[torch.isfinite(errors)].sort().values
            if len(errors):
                limits.append(float(errors[int(ERROR_SHARE * (len(errors) - 1))]))
    return max(limits)


def value_of(
    saved: SavedComparison, method: str, metric: str, *, view: int | None = None, region: str = "whole"
) -> float:
    """A number of a method: of one view, or the mean of them for ``None``; NaN where there is none.

    Example:
        >>> from fovden.frame import Reference
        >>> from fovden.results import Measurement
        >>> rows = [Measurement("box", 0, view, "Base", "whole", "ssim", 0.5 + 0.25 * view) for view in (0, 1)]
        >>> black = Reference(torch.zeros(2, 3, 4, 4), torch.zeros(2, 3, 4, 4), count=1)
        >>> saved = SavedComparison("box", {}, black, {}, 1.0, (), rows, {}, {})
        >>> value_of(saved, "Base", "ssim"), value_of(saved, "Base", "ssim", view=1), value_of(saved, "Base", "psnr")
        (0.625, 0.75, nan)
    """
    key = (method, metric, region)
    rows = [row for row in saved.measurements if (row.method, row.metric, row.region) == key]
    found = [row.value for row in rows if view is None or row.view == view]
    return sum(found) / len(found) if found else float("nan")


def eye_name(saved: SavedComparison, view: int) -> str:
    """What a view is called.

    Example:
        >>> from fovden.frame import Frame, GBuffer, Reference
        >>> black = Reference(torch.zeros(2, 3, 4, 4), torch.zeros(2, 3, 4, 4), count=1)
        >>> frames = {"foveated": Frame.from_radiance(black.mean, GBuffer.empty(2, (4, 4)))}
        >>> eye_name(SavedComparison("box", {}, black, frames, 1.0, (), [], {}, {}), 1)
        'right eye'
    """
    return ("left eye", "right eye")[view] if saved.foveated.view_count == 2 else f"view {view}"


def describe(saved: SavedComparison) -> str:
    """What is seen: scene, size and exposure.

    Example:
        >>> from fovden.frame import Frame, GBuffer, Reference
        >>> black = Reference(torch.zeros(2, 3, 4, 6), torch.zeros(2, 3, 4, 6), count=1)
        >>> frames = {"foveated": Frame.from_radiance(black.mean, GBuffer.empty(2, (4, 6)))}
        >>> describe(SavedComparison("box", {}, black, frames, 1.5, (), [], {}, {}))
        'box, 6 x 4 pixels per eye, exposure 1.5, sRGB'
    """
    height, width = saved.foveated.resolution
    return f"{saved.scene}, {width} x {height} pixels per eye, exposure {saved.exposure:.3g}, sRGB"


def aspect_of(saved: SavedComparison) -> float:
    """Height of a view divided by its width.

    Example:
        >>> from fovden.frame import Frame, GBuffer, Reference
        >>> black = Reference(torch.zeros(1, 3, 4, 8), torch.zeros(1, 3, 4, 8), count=1)
        >>> frames = {"foveated": Frame.from_radiance(black.mean, GBuffer.empty(1, (4, 8)))}
        >>> aspect_of(SavedComparison("box", {}, black, frames, 1.0, (), [], {}, {}))
        0.5
    """
    height, width = saved.foveated.resolution
    return height / width
