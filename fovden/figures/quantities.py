"""What the figures of a comparison show: display values, errors, numbers and names."""

from __future__ import annotations

import torch
from torch import Tensor

from fovden import color
from fovden.comparison import METHODS, SavedComparison
from fovden.metrics import rmse_map

ERROR_SHARE = 0.995  # share of each denoised image's pixels that the error scale covers


def display_of(saved: SavedComparison, name: str) -> Tensor:
    """A method's image, or the reference's, as a display shows it, shape (v, 3, h, w)."""
    return color.display(saved.reference.mean if name == "Reference" else saved.images[name], saved.exposure)


def error_of(saved: SavedComparison, name: str) -> Tensor:
    """A method's error map, shape (v, 1, h, w)."""
    return rmse_map(display_of(saved, name), display_of(saved, "Reference"))


def error_limit(saved: SavedComparison) -> float:
    """One error scale for all methods: it covers nearly all pixels of the denoised images."""
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
    """A number of a method: of one view, or the mean of them for ``None``; NaN where there is none."""
    key = (method, metric, region)
    rows = [row for row in saved.measurements if (row.method, row.metric, row.region) == key]
    found = [row.value for row in rows if view is None or row.view == view]
    return sum(found) / len(found) if found else float("nan")


def eye_name(saved: SavedComparison, view: int) -> str:
    """What a view is called."""
    return ("left eye", "right eye")[view] if saved.foveated.view_count == 2 else f"view {view}"


def describe(saved: SavedComparison) -> str:
    """What is seen: scene, size and exposure."""
    height, width = saved.foveated.resolution
    return f"{saved.scene}, {width} x {height} pixels per eye, exposure {saved.exposure:.3g}, sRGB"


def aspect_of(saved: SavedComparison) -> float:
    """Height of a view divided by its width."""
    height, width = saved.foveated.resolution
    return height / width
