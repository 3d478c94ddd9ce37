"""The rows of the comparison."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from fovden.filters import Denoiser, NonHomogeneousAtrous

__all__ = ["METHODS", "Method", "file_name"]


class Method(NamedTuple):
    """One row of the comparison.

    Attributes:
        name: How it is called in tables and figures.
        frame: Which frame it works on: ``"full"`` (every pixel), ``"foveated"`` or ``"equal_paths"``.
        denoiser: Makes the denoiser, with the option ``demodulate``; ``None`` leaves the frame as it is.
        ignore_mask: Whether pixels without samples are taken for black ones.

    Example:
        >>> [method.name for method in METHODS if method.frame == "foveated"]
        ['Noisy, foveated', 'Mask ignored', 'NH2LD', 'NH3LD']
    """

    name: str
    frame: str
    denoiser: Callable[..., Denoiser] | None
    ignore_mask: bool = False


METHODS = (
    Method("Noisy, full", "full", None),
    Method("Noisy, foveated", "foveated", None),
    Method("Mask ignored", "foveated", NonHomogeneousAtrous.nh3ld, ignore_mask=True),
    Method("Base", "full", NonHomogeneousAtrous.base),
    Method("NH2LD", "foveated", NonHomogeneousAtrous.nh2ld),
    Method("NH3LD", "foveated", NonHomogeneousAtrous.nh3ld),
    Method("Base, equal paths", "equal_paths", NonHomogeneousAtrous.base),
)
"""The methods that are compared. "Mask ignored" is NH3LD told that every pixel was traced."""


def file_name(method: str) -> str:
    """Returns the name of a method's image file, without its ending.

    Example:
        >>> file_name("Base, equal paths")
        'base_equal_paths'
    """
    return "_".join(method.lower().replace(",", " ").split())
