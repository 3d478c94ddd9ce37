"""What the spatial denoisers share: from a frame to light and guides in comparable units, and back to an image."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from fovden.checks import require, require_finite
from fovden.color import demodulate, luminance, modulate
from fovden.filters.base import Denoised, Denoiser
from fovden.filters.edge_stopping import SIGMA_NORMAL, SIGMA_POSITION
from fovden.filters.holes import fill_holes
from fovden.foveation import Topology
from fovden.frame import Frame

__all__ = ["MISS_DISTANCE", "GuidedDenoiser", "cells_alone", "length_unit", "radiance_unit", "topology_of"]

MISS_DISTANCE = 1e6
"""How far away a pixel that sees nothing is taken to lie, in median hit depths. Any width of position below a tenth of
it gives a tap across the border between surfaces and background the smallest weight there is, exp(-80)."""


def radiance_unit(radiance: Tensor, mask: Tensor) -> Tensor:
    """Returns each view's mean luminance over its sampled pixels, the unit of radiance of the relative filters.

    Args:
        radiance: Linear radiance, shape (v, 3, h, w).
        mask: Weight of each pixel in the mean, shape (v, 1, h, w).

    Returns:
        Units above 0, shape (v, 1, 1, 1), without gradient; 1 for a view that is black or has no sample.

    Example:
        >>> mask = torch.tensor([1.0, 0.0]).reshape(1, 1, 1, 2)
        >>> radiance_unit(4 * mask.expand(1, 3, 1, 2), mask).item()
        4.0
    """
    mask = mask.detach().to(radiance.dtype)
    total = (luminance(radiance.detach()) * mask).sum((1, 2, 3), keepdim=True)
    unit = total / mask.sum((1, 2, 3), keepdim=True).clamp(min=torch.finfo(radiance.dtype).tiny)
    return torch.where(unit > 0, unit, 1)


def length_unit(depth: Tensor, hit: Tensor) -> Tensor:
    """Returns each view's median depth over the pixels that see a surface, the unit of length of the relative filters.

    Args:
        depth: Distance along the viewing axis, shape (v, 1, h, w).
        hit: Whether the pixel sees a surface, bool, the same shape.

    Returns:
        Units above 0, shape (v, 1, 1, 1), without gradient; 1 for a view that sees nothing.

    Example:
        >>> depth = torch.tensor([2.0, 3.0, 5.0, 0.0]).reshape(1, 1, 2, 2)
        >>> length_unit(depth, depth > 0).item()
        3.0
    """
    median = torch.where(hit, depth.detach(), torch.nan).flatten(1).nanmedian(dim=1).values
    return torch.where(median > 0, median, 1)[:, None, None, None]


def topology_of(frame: Frame) -> Topology | None:
    """Returns which cells of a frame are neighbours; ``None`` for a frame on the screen.

    A cell beside the screen that has no sample is not seen: a filter would have to fill it, step by step from far away,
    and nobody would look at it.

    Args:
        frame: Any frame.

    Returns:
        The topology of its warp.

    Raises:
        ShapeError: If the frame has not the size of its raster.

    Example:
        >>> from fovden.frame import GBuffer
        >>> topology_of(Frame.from_radiance(torch.ones(1, 3, 4, 4), GBuffer.empty(1, (4, 4)))) is None
        True
    """
    topology: Topology | None = None if frame.warp is None else frame.warp.topology
    if topology is None or frame.warp is None:
        return None
    topology.require(**{"frame.direct": frame.direct})
    return topology if torch.compiler.is_compiling() else replace(topology, seen=frame.warp.read | (frame.mask > 0))


def cells_alone(frame: Frame) -> Frame:
    """Returns a frame in whose places that are no cells there is nothing: no light, no sample and no surface.

    Args:
        frame: Any frame.

    Returns:
        The frame, or the same one where all places are cells.

    Differentiable: in the frame's tensors.

    Example:
        >>> from fovden import Gaze
        >>> from fovden.foveation import VisualPolarWarp
        >>> from fovden.frame import GBuffer
        >>> warp = VisualPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (4, 8))
        >>> frame = replace(Frame.from_radiance(torch.ones(1, 3, 4, 8), GBuffer.empty(1, (4, 8))), warp=warp)
        >>> cells_alone(frame).mask[0, 0].int().sum(0), warp.heights
        (tensor([2, 4, 4, 4, 4, 4, 4, 4]), tensor([2, 4, 4, 4, 4, 4, 4, 4]))
    """
    topology = topology_of(frame)
    if topology is None or bool(topology.exists.all()):
        return frame

    def keep(tensor: Tensor, other: float = 0) -> Tensor:
        return torch.where(topology.exists, tensor, other)

    return replace(
        frame,
        direct=keep(frame.direct),
        indirect=keep(frame.indirect),
        emission=keep(frame.emission),
        counts=keep(frame.counts),
        luminance_squared=keep(frame.luminance_squared),
        layer=keep(frame.layer),
        weight=None if frame.weight is None else keep(frame.weight),
        gbuffer=replace(frame.gbuffer, prim=keep(frame.gbuffer.prim, -1)),
    )


class GuidedDenoiser(Denoiser):
    """A spatial denoiser that a G-buffer guides; a member of the family writes ``filter`` alone.

    The frame is brought into comparable units, filtered and brought back. With ``relative`` radiance is measured in
    the view's mean sampled luminance and position in its median hit depth, so that one set of widths serves every
    scene, exposure and unit of length. Both units are constants to the gradient.

    A pixel that sees no surface has neither normal nor position. It is put
    :data:`fovden.filters.guided.MISS_DISTANCE` away, at one point for all of them: background is filtered with
    background, and never with a surface, whatever the step.

    With ``demodulate`` light without emission is divided by the albedo, filtered, and multiplied again, so that
    textures survive; emission is added afterwards as it was. A pixel without samples has no emission of its own and
    takes the mean of sampled taps that see the same triangle, or else of those like it in geometry.

    A frame in the cells of a polar raster is filtered there: what pixels and their neighbours are to the filter, cells
    and theirs are (:class:`fovden.foveation.Topology`). Units are then means and medians over cells, of which there are
    more near the gaze. The image is in cells, and 0 where there is none, or one without a sample that no pixel of the
    screen reads (:class:`fovden.filters.WarpedDenoiser` has the way to the screen).

    Args:
        relative: Whether to use the view's own units; if not, widths are in the frame's radiance and metres.
        demodulate: Whether to filter illumination in place of radiance.
        seam: Whether each pair of views is filtered as one image, the left beside the right one.

    Example:
        >>> from fovden.frame import GBuffer
        >>> class Halve(GuidedDenoiser):
        ...     def filter(self, radiance, normal, position, mask=None, layer=None):
        ...         return radiance / 2
        >>> frame = Frame.from_radiance(torch.ones(2, 3, 4, 4), GBuffer.empty(2, (4, 4)))
        >>> Halve()(frame).image.mean()
        tensor(0.5000)
    """

    def __init__(self, *, relative: bool = True, demodulate: bool = False, seam: bool = False) -> None:
        super().__init__()
        self.relative = relative
        self.demodulate = demodulate
        self.seam = seam

    @abstractmethod
    def filter(
        self,
        radiance: Tensor,
        normal: Tensor,
        position: Tensor,
        mask: Tensor | None = None,
        layer: Tensor | None = None,
    ) -> Tensor:
        """Returns the filtered radiance of plain tensors, in whatever units they are.

        A member that can filter in polar rasters takes ``topology`` too, a keyword that is given for frames in one.

        Args:
            radiance: Radiance, shape (v, 3, h, w). Where the mask is 0 it matters to the mask's derivative alone.
            normal: Unit normals, shape (v, 3, h, w).
            position: Positions, shape (v, 3, h, w).
            mask: Weight of each pixel as a tap, in [0, 1], shape (v or 1, 1, h, w), bool or floating; ``None`` means 1.
            layer: Foveation layers, integers, shape (v or 1, 1, h, w); ``None`` means 0.

        Returns:
            The filtered radiance, the same shape.

        Example:
            >>> from fovden.filters import Atrous
            >>> flat = torch.zeros(1, 3, 4, 4)
            >>> Atrous().filter(flat + 2, flat, flat).mean()
            tensor(2., grad_fn=...)
        """

    def light(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """Returns what of a frame is filtered, in the filter's units, and these.

        Args:
            frame: The noisy frame.

        Returns:
            Radiance, or with ``demodulate`` irradiance but for a factor, shape (v, 3, h, w), and how much of the
            frame's radiance its unit is, shape (v, 1, 1, 1), without gradient.

        Differentiable: in the frame's light, and with ``demodulate`` in the albedo.

        Example:
            >>> from fovden.filters import Atrous
            >>> from fovden.frame import GBuffer
            >>> frame = Frame.from_radiance(torch.full((1, 3, 4, 4), 2.0), GBuffer.empty(1, (4, 4)))
            >>> light, unit = Atrous().light(frame)
            >>> round(light.mean().item(), 4), round(unit.item(), 4)
            (1.0, 2.0)
        """
        frame = cells_alone(frame)
        albedo = torch.where(frame.gbuffer.hit, frame.gbuffer.albedo, 1)
        light = demodulate(frame.direct + frame.indirect, albedo) if self.demodulate else frame.radiance
        unit = radiance_unit(light, frame.mask) if self.relative else torch.ones_like(light[:, :1, :1, :1])
        return light / unit, unit

    def forward(self, frame: Frame, history: Any = None, factors: Tensor | None = None) -> Denoised:
        """Returns the denoised image of a frame; there is no history.

        Args:
            frame: The noisy frame.
            history: Not used: the filter is spatial.
            factors: What the widths of radiance, normal and position are multiplied by at each pixel, positive,
                shape (v, 3, h, w), for a member whose ``filter`` takes them; ``None`` means 1.

        Returns:
            The image, in the frame's units, and ``None``.

        Raises:
            ValueError: If radiance is negative or not finite anywhere, a guide is not finite where a surface is
                seen, or ``seam`` asks for pairs of an odd number of views, or of rasters that are no screens.
            TypeError: If the frame is in a polar raster and ``filter`` takes no topology.

        Differentiable: in the frame's light, albedo, normal and position, in the parameters and the factors.

        Example:
            >>> from fovden.filters import Atrous
            >>> from fovden.frame import GBuffer
            >>> frame = Frame.from_radiance(torch.full((2, 3, 4, 4), 0.5), GBuffer.empty(2, (4, 4)))
            >>> Atrous()(frame).image.mean()
            tensor(0.5000, grad_fn=<MeanBackward0>)
        """
        del history
        frame, topology = cells_alone(frame), topology_of(frame)
        for part in ("direct", "indirect", "emission"):
            require_finite(f"frame.radiance ({part})", getattr(frame, part), minimum=0)
        hit, mask = frame.gbuffer.hit, frame.mask
        length = length_unit(frame.gbuffer.depth, hit).to(frame.direct.dtype)
        normal = require_finite("frame.gbuffer.normal", torch.where(hit, frame.gbuffer.normal, 0))
        position = torch.where(hit, frame.gbuffer.position / length, MISS_DISTANCE)
        require_finite("frame.gbuffer.position", position)

        light, unit = self.light(frame)
        guides = (normal, position if self.relative else position * length)
        inputs = [light, *guides, mask, frame.layer]
        extra: dict[str, Any] = {} if factors is None else {"factors": factors}
        if self.seam:
            require(topology is None, "seam", True, "False in a polar raster, whose eyes have no common border")
            inputs = [_join_views(tensor) for tensor in inputs]
            extra = {name: _join_views(tensor) for name, tensor in extra.items()}
        if topology is not None:
            extra["topology"] = topology
        filtered = self.filter(*inputs, **extra)
        image = (_part_views(filtered) if self.seam else filtered) * unit
        if self.demodulate:
            albedo = torch.where(hit, frame.gbuffer.albedo, 1)
            image = modulate(image, albedo) + _fill_emission(frame, normal, position, topology)
        return Denoised(image)


def _fill_emission(frame: Frame, normal: Tensor, position: Tensor, topology: Topology | None) -> Tensor:
    """The emission, also where no path was traced; positions are in median hit depths, as the widths are."""
    sampled = frame.mask > 0
    emission = torch.where(sampled, frame.emission, 0)
    if not bool(emission.any()):
        return emission
    return fill_holes(
        emission,
        ~sampled if topology is None else ~sampled & topology.active,
        frame.mask,
        normal,
        position,
        sigma_normal=SIGMA_NORMAL,
        sigma_position=SIGMA_POSITION,
        label=frame.gbuffer.prim,
        topology=topology,
    )


def _join_views(tensor: Tensor) -> Tensor:
    """(2n, c, h, w) to (n, c, h, 2w)."""
    views, channels, height, width = tensor.shape
    require(views % 2 == 0, "frame", f"{views} views", "an even number of views, since seam joins them in pairs")
    pairs = tensor.reshape(views // 2, 2, channels, height, width)
    return pairs.permute(0, 2, 3, 1, 4).reshape(views // 2, channels, height, 2 * width)


def _part_views(tensor: Tensor) -> Tensor:
    """(n, c, h, 2w) to (2n, c, h, w)."""
    pairs, channels, height, width = tensor.shape
    parts = tensor.reshape(pairs, channels, height, 2, width // 2).permute(0, 3, 1, 2, 4)
    return parts.reshape(2 * pairs, channels, height, width // 2)
