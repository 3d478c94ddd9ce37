"""Denoising in the cells of a raster that follows the eye, and from there to the screen.

A frame that is traced in a polar raster is denoised where it was traced: a step of the filter is then as long on the
screen as acuity there allows, and each pass costs cells, not pixels (Koskela et al., "Foveated real-time path tracing
in visual-polar space", 2019). Then come the way to the screen, a blur that hides the coarse cells of the rim, and, if
asked for, contrast that the periphery has lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, get_args

import torch
from torch import Tensor, nn

from fovden.checks import require, require_number
from fovden.filters.base import Denoised, Denoiser
from fovden.foveation import Gaze, PolarWarp, ScreenWarp, Warp
from fovden.frame import Frame
from fovden.warps.base import Prefilter

__all__ = ["CONTRAST_WIDTH", "WarpedDenoiser"]

CONTRAST_WIDTH = 2.0
"""Width of the mean that contrast is measured against, in default blurs: at the farthest corner the standard deviation
is then the height of a cell, where the default blur's is half of it."""


class WarpedDenoiser(Denoiser):
    """A denoiser that works in the cells of a raster, and shows its image on the screen.

    The frame comes in cells, as ``frame.warp`` lays them around its own gaze, one for each eye; one module serves any
    gaze and any size. With D the denoiser inside, S the way to the screen and G the blur that grows from the gaze
    outwards,

        image = G(S(D(frame)), blur),   and with contrast   image <- max(0, image + contrast (image - G(image, 2)))

    See :meth:`fovden.foveation.PolarWarp.to_screen` and :meth:`fovden.foveation.PolarWarp.blur`. Neither blur nor
    contrast changes anything near the gaze, where G is the identity. On :class:`fovden.foveation.ScreenWarp` there is
    neither, and where its cells are pixels the image is that of the denoiser inside. Every cell counts alike on the way
    to the screen: those without samples were filled by the denoiser, unless it was told to leave them black.

    What ``learn`` names becomes a parameter, stored as a logarithm: ``"blur"``, ``"contrast"``, and numbers of the
    warp, ``"alpha"`` of the log-polar and ``"e_max"`` of the visual-polar one. The derivative in the latter is that of
    where the light of cells is shown, with their light held. To follow the raster itself, trace each frame in
    :meth:`warp_at` of its gaze. Where columns are cut, ``e_max`` also sets their heights, and frames that were traced
    with other heights are refused.

    Args:
        inner: Any denoiser that can filter in the raster, as all of this package can; it becomes a part of this module.
        warp: The raster that frames must be in; its gaze and sizes do not matter.
        blur: Strength of the blur, at least 0; 1 is the warp's own, 0 none.
        contrast: How much of the difference to the local mean is added, at least 0; 0 is none.
        prefilter: What is averaged where several cells fall on a pixel.
        learn: What is learned. It must start above 0.

    Raises:
        TypeError: If ``inner`` is no denoiser or ``warp`` no warp.
        ValueError: If a number is out of range, ``learn`` names something else, or a number of the warp has a gradient
            without being named there.

    Differentiable: in what the denoiser inside is differentiable in, and in what is learned.

    Source: the order of filter, mapping and blur is that of Koskela et al. 2019. The contrast follows Patney et al.,
    "Towards foveated rendering for gaze-tracked virtual reality", 2016, who enlarge the difference of a pixel to the
    mean of a window, by the variance there. Their factor could not be read: here the window grows with eccentricity,
    and the factor is one number.

    Example:
        >>> from fovden.filters import Atrous
        >>> from fovden.foveation import LogPolarWarp
        >>> from fovden.frame import GBuffer
        >>> warp = LogPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (8, 8))
        >>> frame = Frame.from_radiance(torch.full((1, 3, 8, 8), 0.5), GBuffer.empty(1, (8, 8)))
        >>> image = WarpedDenoiser(Atrous((2, 1)), warp)(replace(frame, warp=warp)).image
        >>> image.shape, round(image.mean().item(), 4)
        (torch.Size([1, 3, 4, 6]), 0.5)
    """

    def __init__(
        self,
        inner: Denoiser,
        warp: Warp,
        *,
        blur: float = 1.0,
        contrast: float = 0.0,
        prefilter: Prefilter = "area",
        learn: Sequence[str] = (),
    ) -> None:
        super().__init__()
        if not isinstance(inner, Denoiser):
            raise TypeError(f"inner: expected a Denoiser, got {type(inner).__name__}")
        if not isinstance(warp, Warp):
            raise TypeError(f"warp: expected a Warp, got {type(warp).__name__}")
        choices = get_args(Prefilter)
        require(prefilter in choices, "prefilter", repr(prefilter), f"one of {choices}")
        self.inner = inner
        self.prefilter: Prefilter = prefilter
        self.learn = tuple(learn)
        strengths = {
            "blur": require_number("blur", blur, minimum=0),
            "contrast": require_number("contrast", contrast, minimum=0),
        }
        own = {}
        for name in (field.name for field in fields(warp) if _is_number(field.default)):
            given = getattr(warp, name)
            held = name in self.learn or not (isinstance(given, Tensor) and given.requires_grad)
            require(held, f"warp.{name}", given, f"a number, or {name!r} in learn")
            own[name] = _plain(given)
        for name in self.learn:
            require(name in strengths | own, "learn", repr(name), f"some of {tuple(strengths | own)}")
            value = math.log(require_number(name, (strengths | own)[name], above=0))
            self.register_parameter(f"log_{name}", nn.Parameter(torch.tensor(value)))
        numbers: dict[str, Any] = own
        self._warp = replace(warp, **numbers)
        self._of_warp = tuple(name for name in self.learn if name in own)
        self.raster = _describe(warp, self.learn)
        self.strengths = {name: strength for name, strength in strengths.items() if name not in self.learn}

    @property
    def blur(self) -> float | Tensor:
        """Strength of the blur: a number, or a scalar tensor where it is learned."""
        return self._number("blur")

    @property
    def contrast(self) -> float | Tensor:
        """How much of the difference to the local mean is added, the same way."""
        return self._number("contrast")

    def warp_at(self, gaze: Gaze) -> Warp:
        """Returns the raster around a gaze, with what has been learned of it: where to trace the next frame.

        Args:
            gaze: Where each eye looks.

        Returns:
            The warp. Numbers that are learned are tensors with a gradient.

        Example:
            >>> from fovden.filters import Atrous
            >>> from fovden.foveation import LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.tensor([[3.0, 2.0]])), (4, 6), (8, 8))
            >>> denoiser = WarpedDenoiser(Atrous(), warp, learn=["alpha"])
            >>> denoiser.warp_at(Gaze(torch.tensor([[1.0, 1.0]]))).alpha
            tensor(4., grad_fn=...)
        """
        return self._learned(replace(self._warp, gaze=gaze))

    def forward(self, frame: Frame, history: Any = None) -> Denoised:
        """Returns the denoised image of a frame in cells, on the screen.

        Args:
            frame: The noisy frame, in the raster of this module around any gaze.
            history: What the denoiser inside returned with the previous frame; the spatial ones return ``None``.

        Returns:
            The image, shape (v, 3, height, width) of the screen, and the history of the denoiser inside.

        Raises:
            ValueError: If the frame is in another raster, and as the denoiser inside does.

        Example:
            >>> from fovden.filters import Atrous
            >>> from fovden.foveation import ScreenWarp
            >>> from fovden.frame import GBuffer
            >>> frame = Frame.from_radiance(torch.rand(1, 3, 4, 4), GBuffer.empty(1, (4, 4)))
            >>> warp = ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 4), (4, 4))
            >>> torch.equal(WarpedDenoiser(Atrous(), warp)(frame).image, Atrous()(frame).image)
            True
        """
        warp = self._warp_of(frame)
        image, history = self.inner(frame, history)
        if warp is not None:
            image = warp.to_screen(image, prefilter=self.prefilter)
        if not isinstance(warp, PolarWarp):
            return Denoised(image, history)
        if isinstance(self.blur, Tensor) or self.blur > 0:
            image = warp.blur(image, self.blur)
        if isinstance(self.contrast, Tensor) or self.contrast > 0:
            image = (image + self.contrast * (image - warp.blur(image, CONTRAST_WIDTH))).clamp(min=0)
        return Denoised(image, history)

    def extra_repr(self) -> str:
        """Returns the raster and the options, for ``print``.

        Example:
            >>> from fovden.filters import Atrous
            >>> from fovden.foveation import LogPolarWarp
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (4, 6), (8, 8))
            >>> WarpedDenoiser(Atrous(), warp).extra_repr()[:53]
            "LogPolarWarp(fovea_border='clamp', alpha=4), blur=1, "
        """
        strengths = ", ".join(f"{name}={_plain(self._number(name)):.4g}" for name in ("blur", "contrast"))
        return f"{self.raster}, {strengths}, prefilter={self.prefilter!r}, learn={self.learn}"

    def _number(self, name: str) -> float | Tensor:
        return getattr(self, f"log_{name}").exp() if name in self.learn else self.strengths[name]

    def _learned(self, warp: Warp) -> Warp:
        """The warp with the numbers that have been learned."""
        learned: dict[str, Any] = {name: self._number(name) for name in self._of_warp}
        return replace(warp, **learned) if learned else warp

    def _warp_of(self, frame: Frame) -> Warp | None:
        """The frame's warp, if it is this module's, with the numbers that have been learned; ``None``: the screen."""
        found = frame.warp
        if found is None and isinstance(self._warp, ScreenWarp):
            return None
        raster = "the screen" if found is None else _describe(found, self.learn)
        require(raster == self.raster, "frame.warp", raster, self.raster)
        assert isinstance(found, Warp)
        warp = self._learned(found)
        same = torch.equal(warp.heights, found.heights)
        require(
            same, "frame.warp", "columns of other heights", "a raster traced with the numbers that have been learned"
        )
        return warp


def _is_number(default: object) -> bool:
    return isinstance(default, float)


def _plain(value: float | Tensor) -> float:
    return float(value.detach() if isinstance(value, Tensor) else value)


def _describe(warp: Warp, learned: Sequence[str]) -> str:
    """What a warp is apart from its gaze, its sizes and what is learned."""
    parts = []
    for field in fields(warp):
        value = getattr(warp, field.name)
        if field.name not in ("gaze", "screen", "resolution", *learned):
            parts.append(
                f"{field.name}={_plain(value):.6g}" if _is_number(field.default) else f"{field.name}={value!r}"
            )
    return f"{type(warp).__name__}({', '.join(parts)})"
