"""The state that à-trous passes hand on, the passes, and how they are composed of torch operations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor

from fovden.checks import require
from fovden.filters.nearest import nearest_sampled
from fovden.filters.taps import Border, Sigmas, blend_taps
from fovden.foveation import Topology

__all__ = [
    "GuideCurve",
    "MaskAt",
    "Pass",
    "PassOptions",
    "RadianceGuide",
    "State",
    "UnsampledGuide",
    "advance",
    "begin",
    "compose",
    "holes_of",
    "paste",
    "scale_widths",
]

MaskAt = Literal["neighbor", "center"]
"""Which pixel's mask counts in a weight: the tap's or the pixel's own."""

RadianceGuide = Literal["current", "input"]
"""Whose differences of radiance are weighed: those of the image so far or of the noisy one."""

GuideCurve = Literal["linear", "log"]
"""What is compared of radiance c: c itself, or log(1 + c)."""

UnsampledGuide = Literal["drop", "literal", "nearest"]
"""What a pixel without a value compares with its taps: nothing, its 0, or the nearest sampled pixel's radiance."""


class State(NamedTuple):
    """What one pass leaves for the next.

    Attributes:
        image: Radiance so far, shape (v, 3, h, w).
        mask: Weight of each pixel as a tap, shape (v, 1, h, w).
        known: Whether the pixel has a value of its own, bool, shape (v, 1, h, w); ``None`` where its mask is above 0.
        first: The first value of each pixel: its input, or what it was first filled with.

    Example:
        >>> State(torch.ones(1, 3, 2, 2), torch.eye(2)[None, None], None, torch.ones(1, 3, 2, 2)).has_value().sum()
        tensor(2)
    """

    image: Tensor
    mask: Tensor
    known: Tensor | None
    first: Tensor

    def has_value(self) -> Tensor:
        """Returns ``known``, also where it goes without saying.

        Example:
            >>> begin(torch.ones(1, 3, 2, 2), None).has_value().all()
            tensor(True)
        """
        return self.mask > 0 if self.known is None else self.known


class Pass(NamedTuple):
    """One pass of a stack.

    Attributes:
        step: Distance between neighbouring taps in pixels, at least 1.
        sigmas: Widths of the edge-stopping functions: numbers or scalar tensors.
        label: Label of the pixels of the region that it works on, from 0 to 30.
        level: Number of its level. Neighbours in the stack that have one level read the same image, as one pass does.
        kernel: Positive weights, shape (5, 5); ``None`` means the B3 spline.

    Example:
        >>> Pass(2, Sigmas(1.0, 0.1, 0.5)).label
        0
    """

    step: int
    sigmas: Sigmas
    label: int = 0
    level: int = 0
    kernel: Tensor | None = None


@dataclass(frozen=True)
class PassOptions:
    """Readings of the weights; :class:`fovden.filters.NonHomogeneousAtrous` describes each.

    Example:
        >>> PassOptions(border="clamp").guide
        'current'
    """

    mask_at: MaskAt = "neighbor"
    guide: RadianceGuide = "current"
    unsampled_guide: UnsampledGuide = "drop"
    fill: bool = False
    border: Border = "skip"
    guide_curve: GuideCurve = "linear"

    def __post_init__(self) -> None:
        readings = {"mask_at": MaskAt, "guide": RadianceGuide, "unsampled_guide": UnsampledGuide, "border": Border}
        for name, literal in {**readings, "guide_curve": GuideCurve}.items():
            require_choice(name, getattr(self, name), literal)


def require_choice(name: str, value: object, literal: object) -> None:
    """Raises a ``ValueError`` unless the value is one of those of a ``Literal`` type.

    Example:
        >>> require_choice("border", "clamp", Border)
    """
    choices = get_args(literal)
    require(value in choices, name, repr(value), f"one of {', '.join(map(repr, choices))}")


def begin(radiance: Tensor, mask: Tensor | None, topology: Topology | None = None) -> State:
    """Returns the state before the first pass: what is sampled is known.

    Places of a polar raster that are no cells are black, weigh nothing and are not known, whatever they held.

    Args:
        radiance: The noisy radiance, shape (v, 3, h, w).
        mask: Weight of each pixel as a tap, shape (v or 1, 1, h, w); ``None`` means 1.
        topology: The polar raster; ``None`` means the screen.

    Returns:
        The state.

    Raises:
        ShapeError: If the image does not fit the topology.

    Example:
        >>> begin(torch.ones(1, 3, 2, 2), torch.eye(2)[None, None]).has_value().sum()
        tensor(2)
    """
    mask = torch.ones_like(radiance[:, :1]) if mask is None else mask.to(radiance.dtype).expand_as(radiance[:, :1])
    if topology is not None:
        topology.require(radiance=radiance)
        radiance, mask = torch.where(topology.exists, radiance, 0), torch.where(topology.exists, mask, 0)
    return State(radiance, mask, None, radiance)


def holes_of(state: State, topology: Topology | None = None) -> Tensor:
    """Returns which pixels, or cells, have no value yet: bool, shape (v, 1, h, w).

    Args:
        state: The state after the last pass.
        topology: The polar raster; ``None`` means the screen.

    Example:
        >>> holes_of(begin(torch.ones(1, 3, 2, 2), torch.eye(2)[None, None]))[0, 0]
        tensor([[False,  True],
                [ True, False]])
    """
    holes = ~state.has_value()
    return holes if topology is None else holes & topology.active


def paste(region: Tensor, new: State, old: State) -> State:
    """Returns the new state inside the region and the old one elsewhere.

    Args:
        region: Where the new state counts, bool, shape (v or 1, 1, h, w).
        new: The state inside.
        old: The state outside.

    Returns:
        The state.

    Example:
        >>> one, two = begin(torch.ones(1, 3, 1, 2), None), begin(torch.full((1, 3, 1, 2), 2.0), None)
        >>> paste(torch.tensor([[[[True, False]]]]), two, one).image[0, 0]
        tensor([[2., 1.]])
    """
    inside, outside = ((each.image, each.mask, each.has_value(), each.first) for each in (new, old))
    return State(*(torch.where(region, a, b) for a, b in zip(inside, outside, strict=True)))


def scale_widths(sigmas: Sigmas, factors: Tensor | None) -> Sigmas:
    """Returns the widths multiplied by their factors at each pixel.

    Args:
        sigmas: Widths of radiance, normal and position.
        factors: What they are multiplied by, shape (v, 3, h, w); ``None`` means 1.

    Returns:
        The widths, each of shape (v, 1, h, w) if there are factors.

    Example:
        >>> scale_widths(Sigmas(1.0, 0.5, 2.0), torch.full((1, 3, 1, 1), 4.0)).normal.item()
        2.0
    """
    if factors is None:
        return sigmas
    return Sigmas(*(sigma * factor for sigma, factor in zip(sigmas, torch.tensor_split(factors, 3, 1), strict=True)))


def compose(
    state: State,
    normal: Tensor,
    position: Tensor,
    passes: Sequence[Pass],
    *,
    region: Tensor | None = None,
    factors: Tensor | None = None,
    options: PassOptions,
    topology: Topology | None = None,
) -> State:
    """Returns the state after a stack of passes, by torch operations: for any device and precision, and slowly.

    Args:
        state: The state before.
        normal: Unit normals, shape (v, 3, h, w).
        position: Positions, shape (v, 3, h, w).
        passes: The passes.
        region: Labels, integers, shape (v or 1, 1, h, w); ``None`` means 0 everywhere.
        factors: What the widths of radiance, normal and position are multiplied by at each pixel, shape (v, 3, h, w).
        options: Readings of the weights.
        topology: The polar raster that the pixels are cells of; ``None`` means the screen. What is not a cell is
            neither read nor written, and a cell that is not seen is not written.

    Returns:
        The state after.

    Example:
        >>> flat = torch.zeros(1, 3, 4, 4)
        >>> half = begin(flat + 2, torch.tensor([1.0, 0.0, 1.0, 0.0]).expand(1, 1, 4, 4))
        >>> stack = [Pass(2, Sigmas(1.0, 1.0, 1.0), level=0), Pass(1, Sigmas(1.0, 1.0, 1.0), level=1)]
        >>> compose(half, flat, flat, stack, options=PassOptions()).image.mean()
        tensor(2.)
    """
    before, level = state, passes[0].level if passes else 0
    for each in passes:
        if each.level != level:
            before, level = state, each.level
        sigmas = scale_widths(each.sigmas, factors)
        own = None if region is None else region == each.label
        new = advance(
            before, normal, position, step=each.step, sigmas=sigmas, region=own, kernel=each.kernel, options=options,
            topology=topology,
        )  # fmt: skip
        state = new if own is None else paste(own, new, state)
    return state


def advance(
    state: State,
    normal: Tensor,
    position: Tensor,
    *,
    step: int,
    sigmas: Sigmas,
    region: Tensor | None = None,
    kernel: Tensor | None = None,
    options: PassOptions,
    topology: Topology | None = None,
) -> State:
    """Returns the state after one pass over a region; outside of it nothing changes.

    Args:
        state: The state before.
        normal: Unit normals, shape (v, 3, h, w).
        position: Positions, shape (v, 3, h, w).
        step: Distance between neighbouring taps in pixels.
        sigmas: Widths of the edge-stopping functions.
        region: Where to filter, bool, shape (v or 1, 1, h, w); ``None`` means everywhere.
        kernel: Positive weights, shape (5, 5); ``None`` means the B3 spline.
        options: Readings of the weights.
        topology: The polar raster; ``None`` means the screen.

    Returns:
        The state after.

    Example:
        >>> flat = torch.zeros(1, 3, 4, 4)
        >>> half = begin(flat + 2, torch.tensor([1.0, 0.0, 1.0, 0.0]).expand(1, 1, 4, 4))
        >>> advance(half, flat, flat, step=1, sigmas=Sigmas(1.0, 1.0, 1.0), options=PassOptions()).known.all()
        tensor(True)
    """
    image, mask, _, first = state
    known = state.has_value()
    guide = first if options.guide == "input" else image
    if options.guide_curve == "log":
        guide = guide.log1p()
    centre = guide
    dropped: Tensor | None = known
    if options.unsampled_guide == "literal":
        dropped = None
    elif options.unsampled_guide == "nearest":
        dropped = None
        index = nearest_sampled(mask, topology).expand_as(guide).flatten(2)
        centre = torch.where(known, guide, guide.flatten(2).gather(2, index).view_as(guide))
    if topology is not None:
        region = topology.active if region is None else region & topology.active
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
        kernel=kernel,
        guide=None if guide is image else guide,
        centre=None if centre is guide else centre,
        border=options.border,
        topology=topology,
    )
    first = torch.where(blend.filled & ~known, blend.image, first) if options.guide == "input" else first
    if options.fill:
        mask = torch.where(blend.filled, 1, mask)
    return State(blend.image, mask, known | blend.filled, first)
