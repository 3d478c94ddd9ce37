"""What the cards of frames, G-buffers and references say alike."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from fovden.camera import Camera
from fovden.preview import Picture, finite_exposure, show


def eyes(radiance: Tensor) -> list[Picture]:
    """Thumbnails of the first two views, both at one exposure."""
    exposure = finite_exposure(radiance)
    names = ("left eye", "right eye") if len(radiance) == 2 else ("view 0", "view 1")
    views = zip(names, radiance, strict=False)
    return [Picture(show(view[None], exposure), f"{name}, exposure {exposure:.3g}, sRGB") for name, view in views]


def type_of(tensor: Tensor) -> str:
    """Type and device."""
    return f"{str(tensor.dtype).removeprefix('torch.')} on {tensor.device}"


def place_of(camera: Camera | None) -> str:
    """Where the eyes are."""
    if camera is None:
        return "unknown"
    return "at " + ", ".join(f"({x:.3g}, {y:.3g}, {z:.3g})" for x, y, z in camera.origin.tolist()) + " m"


def share(condition: Tensor) -> str:
    """How much of an image a condition holds for, in per cent."""
    return f"{float(condition.double().mean()) if condition.numel() else 0:.1%}"


def not_finite(record: Any) -> dict[str, str]:
    """Numbers of values that are not finite, by the field's name; nothing where all are."""
    numbers = {}
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, Tensor) and value.is_floating_point():
            numbers[field.name] = int((~torch.isfinite(value)).sum())
    found = ", ".join(f"{number:,} in {name}" for name, number in numbers.items() if number)
    return {"not finite": f"{found} (cyan above)"} if found else {}
