"""What a falloff is: it says how many samples a pixel gets, from how far it lies from the gaze.

A falloff is any function of a camera and a gaze that returns a :class:`RateMap`. Those of the field are in
:mod:`fovden.foveation.falloffs`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze
from fovden.checks import require, require_number

__all__ = ["LAYER_RATES", "Falloff", "RateMap", "layer_of_rate", "require_layer_rates"]

LAYER_RATES = (0.5, 0.125)
"""Rates below which a pixel of a continuous falloff belongs to layer 1 and to layer 2.

The distance between samples is ``1 / sqrt(rate)`` pixels, and a pass of an à-trous filter doubles its reach, so that a
quarter of the rate asks for one more pass. Layer k is where ``4^-k`` is the nearest power: the borders are
``4^-(k + 1/2)``.
"""


class RateMap(NamedTuple):
    """What a falloff says about every pixel.

    Attributes:
        rate: Share of the full sampling that a pixel gets, in [0, 1], shape (v, 1, h, w).
        layer: Layer that the pixel belongs to, int32, 0 is the innermost, shape (v, 1, h, w).
        radii: Radii of the layers' circles around the gaze in pixels, from the inside out; empty without circles.
        selects: What the rate means. True: the probability with which a pixel is selected, and then gets all of its
            samples. False: the share of the samples that every pixel gets.

    Example:
        >>> RateMap(rate=torch.ones(1, 1, 2, 2), layer=torch.zeros(1, 1, 2, 2, dtype=torch.int32)).selects
        True
    """

    rate: Tensor
    layer: Tensor
    radii: tuple[float, ...] = ()
    selects: bool = True


class Falloff(Protocol):
    """A function of camera and gaze that says how densely each pixel is sampled.

    Example:
        >>> from fovden.camera import StereoCamera
        >>> def left_half(camera: Camera, gaze: Gaze) -> RateMap:
        ...     x = torch.arange(camera.resolution[1]).expand(camera.view_count, 1, *camera.resolution)
        ...     outside = 2 * x >= camera.resolution[1]
        ...     return RateMap(rate=1 - 0.5 * outside, layer=outside.int())
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(1, 4)).views
        >>> left_half(camera, Gaze.center(camera)).rate[0]
        tensor([[[1.0000, 1.0000, 0.5000, 0.5000]]])
    """

    def __call__(self, camera: Camera, gaze: Gaze, /) -> RateMap:
        """Returns rate and layer of every pixel of every view."""
        ...


def layer_of_rate(rate: Tensor, thresholds: Sequence[float] = LAYER_RATES) -> Tensor:
    """Returns the layer that a rate belongs to: the number of thresholds that it lies below.

    Denoisers read layers to choose their number of passes, and metrics to report errors by region. A falloff without
    layers of its own takes them from its rate, before any scaling to a budget: layers stay where they are when a
    budget changes.

    Args:
        rate: Rates, any shape.
        thresholds: Rates that fall.

    Returns:
        Layers, int32, the shape of ``rate``.

    Example:
        >>> layer_of_rate(torch.tensor([1.0, 0.5, 0.3, 0.1]))
        tensor([0, 0, 1, 2], dtype=torch.int32)
    """
    layer = torch.zeros(rate.shape, dtype=torch.int32, device=rate.device)
    for threshold in thresholds:
        layer += (rate.detach() < threshold).to(torch.int32)
    return layer


def require_layer_rates(name: str, thresholds: Sequence[float]) -> tuple[float, ...]:
    """Returns thresholds of :func:`layer_of_rate` if they lie in (0, 1] and fall.

    Args:
        name: Name of the argument.
        thresholds: The thresholds; none at all make one layer.

    Raises:
        ValueError: If they do not.

    Example:
        >>> require_layer_rates("layer_rates", [0.5, 0.25])
        (0.5, 0.25)
    """
    rates = tuple(require_number(name, rate, above=0, maximum=1) for rate in thresholds)
    require(list(rates) == sorted(set(rates), reverse=True), name, rates, "rates that fall")
    return rates
