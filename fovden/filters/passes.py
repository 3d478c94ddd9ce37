"""The state that à-trous passes hand on, and one pass from one state to the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor

from fovden.checks import require
from fovden.filters.nearest import nearest_sampled
from fovden.filters.taps import Border, Sigmas, blend_taps

__all__ = ["MaskAt", "PassOptions", "RadianceGuide", "State", "UnsampledGuide", "advance", "begin", "paste"]

MaskAt = Literal["neighbor", "center"]
RadianceGuide = Literal["current", "input"]
UnsampledGuide = Literal["drop", "literal", "nearest"]


class State(NamedTuple):
    """What one pass leaves for the next.

    Attributes:
        image: Radiance so far, shape (v, 3, h, w).
        mask: Weight of each pixel as a tap, shape (v, 1, h, w).
        known: Whether the pixel has a value of its own, bool, shape (v, 1, h, w).
        first: The first value of each pixel: its input, or what it was first filled with.
    """

    image: Tensor
    mask: Tensor
    known: Tensor
    first: Tensor


@dataclass(frozen=True)
class PassOptions:
    """Readings of the weights; :class:`fovden.filters.NonHomogeneousAtrous` describes each."""

    mask_at: MaskAt = "neighbor"
    guide: RadianceGuide = "current"
    unsampled_guide: UnsampledGuide = "drop"
    fill: bool = False
    border: Border = "skip"

    def __post_init__(self) -> None:
        readings = {"mask_at": MaskAt, "guide": RadianceGuide, "unsampled_guide": UnsampledGuide, "border": Border}
        for name, literal in readings.items():
            require_choice(name, getattr(self, name), literal)


def require_choice(name: str, value: object, literal: object) -> None:
    """Raises a ``ValueError`` unless the value is one of those of a ``Literal`` type.

    Example:
        >>> require_choice("border", "clamp", Border)
    """
    choices = get_args(literal)
    require(value in choices, name, repr(value), f"one of {', '.join(map(repr, choices))}")


def begin(radiance: Tensor, mask: Tensor | None) -> State:
    """Returns the state before the first pass: what is sampled is known."""
    mask = torch.ones_like(radiance[:, :1]) if mask is None else mask.to(radiance.dtype).expand_as(radiance[:, :1])
    return State(radiance, mask, mask > 0, radiance)


def paste(region: Tensor, new: State, old: State) -> State:
    """Returns the new state inside the region and the old one elsewhere."""
    return State(*(torch.where(region, inside, outside) for inside, outside in zip(new, old, strict=True)))


def advance(
    state: State,
    normal: Tensor,
    position: Tensor,
    *,
    step: int,
    sigmas: Sigmas,
    region: Tensor | None = None,
    options: PassOptions,
) -> State:
    """Returns the state after one pass over a region; outside of it nothing changes."""
    image, mask, known, first = state
    guide = first if options.guide == "input" else image
    centre = guide
    dropped: Tensor | None = known
    if options.unsampled_guide == "literal":
        dropped = None
    elif options.unsampled_guide == "nearest":
        dropped = None
        index = nearest_sampled(mask).expand_as(guide).flatten(2)
        centre = torch.where(known, guide, guide.flatten(2).gather(2, index).view_as(guide))
    if options.mask_at == "center":
        region = mask > 0 if region is None else region & (mask > 0)
    blend = blend_taps(
        image,
        normal,
        position,
        mask=mask if options.mask_at == "neighbor" else None,
        step=step,
        sigmas=sigmas,
        region=region,
        known=dropped,
        guide=None if guide is image else guide,
        centre=None if centre is guide else centre,
        border=options.border,
    )
    first = torch.where(blend.filled & ~known, blend.image, first) if options.guide == "input" else first
    if options.fill:
        mask = torch.where(blend.filled, 1, mask)
    return State(blend.image, mask, known | blend.filled, first)
