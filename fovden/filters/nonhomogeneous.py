"""Non-homogeneous denoising for foveated path tracing (Graphical Models 2023, doi 10.1016/j.gmod.2023.101184).

The image is cut into the layers of the foveation, and each layer is filtered with its own number of edge-avoiding
à-trous passes, few in the fovea and more outside, over the pixels that were sampled.

Departures from the paper: the paper states neither the numbers of passes nor the widths of the edge-stopping
functions, and leaves fourteen questions open; each has a default here, and an option where another reading is
plausible, listed in :class:`NonHomogeneousAtrous`. Widths are learnable, and by default relative to the view's own
units.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from itertools import chain, pairwise
from typing import Literal, TypedDict, Unpack

import torch
from torch import Tensor, nn

from fovden.checks import require, require_integer, require_shapes, require_tensor
from fovden.filters.edge_stopping import (
    SIGMA_NORMAL,
    SIGMA_POSITION,
    SIGMA_RADIANCE,
    EdgeStopping,
    Schedule,
    SigmaBy,
)
from fovden.filters.guided import GuidedDenoiser
from fovden.filters.holes import fill_holes as fill
from fovden.filters.operator import run_passes
from fovden.filters.passes import (
    GuideCurve,
    MaskAt,
    Pass,
    PassOptions,
    RadianceGuide,
    State,
    UnsampledGuide,
    begin,
    holes_of,
    paste,
    require_choice,
    scale_widths,
)
from fovden.filters.stack import TapKernel, hole_widths, plan_passes
from fovden.filters.taps import Border, Sigmas
from fovden.foveation import Topology

__all__ = ["LEVELS", "NonHomogeneousAtrous"]

LEVELS = (3, 4, 5)
"""Passes M, N, P of the inner, middle and outer layer. The paper asks for M < N < P and gives no values; its figure
shows three levels, and five is the usual number of the à-trous filter (Dammertz et al. 2010)."""

LayerOrder = Literal["sequential", "snapshot", "interleaved"]
MaskUpdate = Literal["static", "fill"]


class _Options(TypedDict, total=False):
    """The keywords of :class:`NonHomogeneousAtrous`, for its named constructors."""

    sigma_radiance: float | Sequence[float]
    sigma_normal: float | Sequence[float]
    sigma_position: float | Sequence[float]
    mask_at: MaskAt
    guide: RadianceGuide
    unsampled_guide: UnsampledGuide
    mask_update: MaskUpdate
    fill_holes: bool
    layers: LayerOrder
    border: Border
    seam: bool
    schedule: Schedule
    sigma_by: SigmaBy
    demodulate: bool
    relative: bool
    guide_curve: GuideCurve
    per_pass: bool
    learn_kernel: bool


class NonHomogeneousAtrous(GuidedDenoiser):
    """The non-homogeneous denoiser: each foveation layer with its own number of passes and its own widths.

    The paper's Algorithm 1, for layers from the innermost outwards and L the layer's number of passes:

        for step in 2^(L-1), ..., 2, 1:
            for each pixel p of the layer, and its taps q = p + step (i, j) with i, j in -2..2:
                weight(p, q) = h(i, j) b(q) w_rt(p, q) w_n(p, q) w_x(p, q)
            c(p) <- sum_q weight(p, q) c(q) / sum_q weight(p, q)

    with c the radiance, b the sampling mask, h the 5 x 5 B3 spline and the three edge-stopping functions of
    :func:`fovden.filters.atrous_pass`. Layers come from ``frame.layer``, 0 the innermost; where a frame has more
    layers than ``levels`` has entries, the last entry serves the rest. ``(3, 4, 5)`` is the paper's NH3LD, ``(3, 5)``
    its NH2LD (which leaves the sampling mask alone) and ``(5,)`` its Base.

    What the paper leaves open, by the numbers of the questions, with the default first:

    - F1, which pixel's mask counts, ``mask_at``: ``"neighbor"``, the prose's reading; ``"center"``, the formulas'
      literal one, leaves every unsampled pixel black (holes are not filled then), and lets sampled ones read black.
    - F2, which pixel is written: the centre one.
    - F3, in place or not: each pass reads the image that the one before left; other layers' pixels are copied.
    - F4, whose radiance w_rt compares, ``guide``: ``"current"``, the image so far, as in the à-trous shader;
      ``"input"``, the noisy image (an unsampled pixel takes the first value that it is filled with).
    - F5, w_rt of a pixel without a value, ``unsampled_guide``: ``"drop"``, 1 until it has one; ``"literal"``, its 0
      is compared, which favours dark taps; ``"nearest"``, the nearest sampled pixel's radiance stands in.
    - F6, whether a filled pixel may be read, ``mask_update``: ``"static"``, never; ``"fill"``, its mask becomes 1.
    - F7, whether it counts itself in later passes: with ``"static"`` it does not, with ``"fill"`` it does.
    - F8, weights that sum to nothing: the pixel keeps its value, and what is never reached is filled at the end
      (:func:`fovden.filters.fill_holes`: geometry alone, then the mask alone, each at the smallest step that has a
      tap); ``fill_holes=False`` leaves it 0.
    - F9, what a layer reads of the others, ``layers``: ``"sequential"``, inner layers filtered and outer ones raw;
      ``"snapshot"``, all others raw; ``"interleaved"``, level by level: all layers that have a step run it on the
      same image, the largest step first.
    - F10, taps outside the image, ``border``: ``"skip"``; ``"clamp"`` reads the nearest pixel of the edge. Polar
      rasters have borders of their own (:class:`fovden.foveation.Topology`).
    - F11, taps across the border between the eyes, ``seam``: ``False``, never; ``True`` filters each pair of views
      as one image, side by side, as the paper's single texture would.
    - F12, how the width of radiance shrinks, ``schedule`` and ``sigma_by``: halved with each pass
      (:class:`fovden.filters.EdgeStopping` has the others).
    - F13, ``demodulate``: ``False``, radiance is filtered as it is; ``True`` divides by the albedo first, which
      keeps textures sharp (recommended for quality).
    - F14, darkening: sums are divided by the sum of weight, mask and kernel, so that unsampled pixels do not darken.

    Args:
        levels: Number of passes of each layer, the innermost first. The paper's M < N < P; others warn.
        sigma_radiance: Initial width of radiance in the first pass, one for all layers or one for each.
        sigma_normal: Initial width of normals at step 1, the same way.
        sigma_position: Initial width of position, the same way.
        mask_at: F1.
        guide: F4.
        unsampled_guide: F5.
        mask_update: F6, F7.
        fill_holes: F8.
        layers: F9.
        border: F10.
        seam: F11.
        schedule: F12.
        sigma_by: F12.
        demodulate: F13.
        relative: Whether widths are in the view's own units of radiance and length, or literally in the frame's.
        guide_curve: What is compared of radiance c: ``"linear"``, c, or ``"log"``, log(1 + c), as for
            :class:`fovden.filters.Atrous`.
        per_pass: Whether each pass of each layer has three widths of its own.
        learn_kernel: Whether each pass of each layer has a kernel of its own, which is learned
            (:class:`fovden.filters.TapKernel`); with ``layers="interleaved"`` that is composed of torch operations.

    Raises:
        ValueError: If there is no level, one is below 1, a width is not positive, or an option is none of those
            listed.

    Differentiable: in the frame's light, albedo, normal and position, and in the widths. Cost: 25 taps in each pass
    for each block of sixteen pixels in a row that has one of the layer's; where the operator is composed of torch
    operations (:func:`fovden.filters.operator.run_passes`), for each pixel of the layer's bounding box.

    Source: the 2023 paper, sections 3.2 and 3.3 and Algorithm 1; weights from the shader of Dammertz et al. (2010);
    the widths' defaults are ours, see :mod:`fovden.filters.edge_stopping`.

    Example:
        >>> from fovden.frame import Frame, GBuffer
        >>> counts = (torch.arange(256) % 2).float().reshape(1, 1, 16, 16)
        >>> radiance = (counts * 0.5).expand(1, 3, 16, 16)
        >>> layer = (torch.arange(16) // 6).expand(1, 1, 16, 16)
        >>> frame = Frame.from_radiance(radiance, GBuffer.empty(1, (16, 16)), counts=counts, layer=layer)
        >>> denoiser = NonHomogeneousAtrous(levels=(1, 2, 3))
        >>> image = denoiser(frame).image
        >>> torch.allclose(image, torch.tensor(0.5)), len(list(denoiser.parameters()))
        (True, 9)
    """

    def __init__(
        self,
        levels: Sequence[int] = LEVELS,
        *,
        sigma_radiance: float | Sequence[float] = SIGMA_RADIANCE,
        sigma_normal: float | Sequence[float] = SIGMA_NORMAL,
        sigma_position: float | Sequence[float] = SIGMA_POSITION,
        mask_at: MaskAt = "neighbor",
        guide: RadianceGuide = "current",
        unsampled_guide: UnsampledGuide = "drop",
        mask_update: MaskUpdate = "static",
        fill_holes: bool = True,
        layers: LayerOrder = "sequential",
        border: Border = "skip",
        seam: bool = False,
        schedule: Schedule = "halve_sigma",
        sigma_by: SigmaBy = "pass",
        demodulate: bool = False,
        relative: bool = True,
        guide_curve: GuideCurve = "linear",
        per_pass: bool = False,
        learn_kernel: bool = False,
    ) -> None:
        super().__init__(relative=relative, demodulate=demodulate, seam=seam)
        require(len(levels) > 0, "levels", levels, "at least one layer")
        self.levels = tuple(require_integer("levels", level, minimum=1) for level in levels)
        if any(inner >= outer for inner, outer in pairwise(self.levels)):
            warnings.warn(f"levels: the paper has more passes in each further layer, got {self.levels}", stacklevel=2)
        require_choice("layers", layers, LayerOrder)
        require_choice("mask_update", mask_update, MaskUpdate)
        self.layers = layers
        self.fill_holes = fill_holes
        self.options = PassOptions(mask_at, guide, unsampled_guide, mask_update == "fill", border, guide_curve)
        widths = zip(
            self._per_layer("sigma_radiance", sigma_radiance),
            self._per_layer("sigma_normal", sigma_normal),
            self._per_layer("sigma_position", sigma_position),
            strict=True,
        )
        self.edge_stopping = nn.ModuleList(
            EdgeStopping(*sigmas, schedule=schedule, sigma_by=sigma_by, passes=level if per_pass else None)
            for sigmas, level in zip(widths, self.levels, strict=True)
        )
        kernels = nn.ModuleList(TapKernel(level) for level in self.levels) if learn_kernel else None
        self.register_module("kernel", kernels)
        self.per_pass = per_pass
        self.learn_kernel = learn_kernel

    kernel: nn.ModuleList | None

    @classmethod
    def base(cls, level: int = LEVELS[2], **options: Unpack[_Options]) -> NonHomogeneousAtrous:
        """Returns the paper's Base: one layer, P passes everywhere.

        Args:
            level: P.
            **options: Keywords of the class.

        Example:
            >>> NonHomogeneousAtrous.base().levels
            (5,)
        """
        return cls((level,), **options)

    @classmethod
    def nh2ld(
        cls, levels: tuple[int, int] = (LEVELS[0], LEVELS[2]), **options: Unpack[_Options]
    ) -> NonHomogeneousAtrous:
        """Returns the paper's NH2LD: M passes in the innermost layer, P in all others.

        Args:
            levels: M and P.
            **options: Keywords of the class.

        Example:
            >>> NonHomogeneousAtrous.nh2ld(demodulate=True).levels
            (3, 5)
        """
        return cls(levels, **options)

    @classmethod
    def nh3ld(cls, levels: tuple[int, int, int] = LEVELS, **options: Unpack[_Options]) -> NonHomogeneousAtrous:
        """Returns the paper's NH3LD: M, N and P passes in the inner, middle and outer layer.

        Args:
            levels: M, N and P.
            **options: Keywords of the class.

        Example:
            >>> NonHomogeneousAtrous.nh3ld().levels
            (3, 4, 5)
        """
        return cls(levels, **options)

    def filter(
        self,
        radiance: Tensor,
        normal: Tensor,
        position: Tensor,
        mask: Tensor | None = None,
        layer: Tensor | None = None,
        factors: Tensor | None = None,
        topology: Topology | None = None,
    ) -> Tensor:
        """Returns the filtered radiance of plain tensors; see :meth:`fovden.filters.GuidedDenoiser.filter`.

        ``factors``, shape (v, 3, h, w), positive, multiply the widths of radiance, normal and position at each pixel,
        in each pass and where holes are filled. Differentiable in them too. ``topology`` is the polar raster that the
        pixels are cells of; ``None`` means the screen.

        Raises:
            ValueError: If a layer is negative.

        Example:
            >>> flat = torch.zeros(1, 3, 4, 4)
            >>> NonHomogeneousAtrous((1,)).filter(flat + 2, flat, flat).mean()
            tensor(2., grad_fn=<MeanBackward0>)
        """
        c, n, x, b = radiance, normal, position, mask
        layer = self._layer_of(radiance, layer)
        if b is not None and (self.options.mask_at == "center" or self.options.unsampled_guide == "literal"):
            c = torch.where(b > 0, c, 0)  # these readings look at an unsampled pixel's own light, which is none
        if factors is not None:
            require_shapes("v 3 h w", radiance=radiance, factors=factors)
        stacks = [self._passes(index) for index in range(len(self.levels))]
        run = partial(
            run_passes, normal=n, position=x, region=layer, factors=factors, options=self.options, topology=topology
        )
        start = begin(c, b, topology)
        if self.layers == "snapshot":
            state = start
            for index, passes in enumerate(stacks):
                state = paste(layer == index, run(start, passes=passes), state)
        else:
            order = _in_turn if self.layers == "sequential" else _interleave
            state = run(start, passes=order(stacks))
        return self._fill(state, n, x, layer, stacks, factors, topology)

    def _passes(self, index: int) -> list[Pass]:
        """A layer's passes, in the order in which they run, each on a level of its own."""
        steps = [2**level for level in reversed(range(self.levels[index]))]
        edge_stopping, kernel = self.edge_stopping[index], None if self.kernel is None else self.kernel[index]
        assert isinstance(edge_stopping, EdgeStopping)
        assert kernel is None or isinstance(kernel, TapKernel)
        return plan_passes(steps, edge_stopping, kernel, index)

    def _fill(
        self,
        state: State,
        normal: Tensor,
        position: Tensor,
        layer: Tensor,
        stacks: Sequence[Sequence[Pass]],
        factors: Tensor | None,
        topology: Topology | None,
    ) -> Tensor:
        holes = holes_of(state, topology)
        if not torch.compiler.is_compiling() and not bool(holes.any()):
            return state.image
        image = torch.where(state.has_value(), state.image, 0)
        if self.options.mask_at == "center" or not self.fill_holes:
            return image
        by_layer = zip(*map(hole_widths, stacks), strict=True)
        layer = layer.long()
        widths = Sigmas(*(torch.stack([torch.as_tensor(width) for width in kind])[layer] for kind in by_layer))
        widths = scale_widths(widths, factors)
        return fill(
            image,
            holes,
            state.mask,
            normal,
            position,
            sigma_normal=widths.normal,
            sigma_position=widths.position,
            topology=topology,
        )

    def _layer_of(self, radiance: Tensor, layer: Tensor | None) -> Tensor:
        """The entry of ``levels`` that each pixel belongs to, shape (v, 1, h, w)."""
        plane = radiance[:, :1]
        if layer is None:
            return torch.zeros_like(plane, dtype=torch.uint8)
        views, _, height, width = plane.shape
        require_shapes("v 1 h w", {"h": height, "w": width}, layer=require_tensor("layer", layer))
        require(layer.shape[0] in (1, views), "layer", f"{layer.shape[0]} views", f"1 or {views} views")
        if not torch.compiler.is_compiling():  # values are looked at only where that does not break a graph
            require(bool((layer >= 0).all()), "layer", f"a least value of {int(layer.min())}", "values of at least 0")
        return layer.clamp(max=len(self.levels) - 1).to(torch.uint8).expand_as(plane)

    def _per_layer(self, name: str, widths: float | Sequence[float]) -> list[float]:
        values = list(widths) if isinstance(widths, Sequence) else [widths] * len(self.levels)
        require(len(values) == len(self.levels), name, values, f"one number, or one for each of {self.levels}")
        return values

    def extra_repr(self) -> str:
        """Returns the levels and the readings, for ``print``.

        Example:
            >>> NonHomogeneousAtrous((2, 3)).extra_repr()[:37]
            "levels=(2, 3), layers='sequential', m"
        """
        readings = {"layers": self.layers, **vars(self.options), "seam": self.seam, "fill_holes": self.fill_holes}
        units = {"demodulate": self.demodulate, "relative": self.relative}
        return ", ".join(f"{name}={value!r}" for name, value in {"levels": self.levels, **readings, **units}.items())


def _in_turn(stacks: Sequence[Sequence[Pass]]) -> list[Pass]:
    """The layers' passes one after the other, from the innermost layer outwards."""
    return [each._replace(level=level) for level, each in enumerate(chain.from_iterable(stacks))]


def _interleave(stacks: Sequence[Sequence[Pass]]) -> list[Pass]:
    """The layers' passes by their steps, the largest first; those of one step read the same image."""
    by_step = sorted(chain.from_iterable(stacks), key=lambda each: -each.step)
    return [each._replace(level=-each.step) for each in by_step]
