"""Rasters as JSON can hold them."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from fovden.camera import Gaze
from fovden.checks import require
from fovden.warps import LogPolarWarp, ScreenWarp, VisualPolarWarp, Warp

__all__ = ["warp_from_json", "warp_to_json"]

KINDS: dict[str, type[Warp]] = {kind.__name__: kind for kind in (LogPolarWarp, ScreenWarp, VisualPolarWarp)}


def warp_to_json(warp: Warp | None) -> dict[str, Any] | None:
    """Returns a warp as JSON can hold it, without gradients; ``None`` stays ``None``.

    Args:
        warp: The warp.

    Returns:
        The name of its class, and its attributes by name. A tensor becomes its values and the name of its type.

    Raises:
        ValueError: If it is of a class that is not this package's, which could not be read again.

    Example:
        >>> warp = LogPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (2, 3), alpha=2.0)
        >>> saved = warp_to_json(warp)
        >>> saved["class"], saved["gaze"], saved["resolution"], saved["alpha"]
        ('LogPolarWarp', {'dtype': 'float32', 'values': [[3.0, 2.0]]}, [2, 3], 2.0)
    """
    if warp is None:
        return None
    name = type(warp).__name__
    require(KINDS.get(name) is type(warp), "frame.warp", name, f"a raster that files can name: one of {sorted(KINDS)}")
    return {"class": name} | {field.name: _saved(getattr(warp, field.name)) for field in fields(warp)}


def warp_from_json(saved: dict[str, Any] | None) -> Warp | None:
    """Returns the warp that :func:`warp_to_json` was given, to the bit.

    Args:
        saved: What it returned.

    Returns:
        The warp.

    Raises:
        ValueError: If the class is unknown or a parameter out of range.

    Example:
        >>> warp = LogPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (2, 3), alpha=2.0)
        >>> again = warp_from_json(warp_to_json(warp))
        >>> again.name, again.screen, again.alpha, again.gaze.pixels
        ('log-polar', (4, 6), 2.0, tensor([[3., 2.]]))
    """
    if saved is None:
        return None
    name, values = saved["class"], {key: _loaded(value) for key, value in saved.items() if key != "class"}
    require(name in KINDS, "warp", repr(name), f"one of {sorted(KINDS)}")
    return KINDS[name](**{**values, "gaze": Gaze(values["gaze"])})


def _saved(value: Any) -> Any:
    if isinstance(value, Gaze):
        value = value.pixels
    if isinstance(value, Tensor):
        return {"dtype": str(value.dtype).removeprefix("torch."), "values": value.detach().tolist()}
    return list(value) if isinstance(value, tuple) else value


def _loaded(value: Any) -> Any:
    if isinstance(value, dict):
        return torch.tensor(value["values"], dtype=getattr(torch, value["dtype"]))
    return tuple(value) if isinstance(value, list) else value
