"""Widths that a small network predicts at each pixel, with the fused filter underneath.

One triple of widths serves a whole layer, so it is a compromise: too wide at a contact shadow, too narrow in an even
corner. Here a network looks at the guides and at the noise around a pixel and says by how much each width should be
wider or narrower there. What it may do is bounded, and the image stays a weighted mean of the samples: it invents
nothing, which a network that predicts colour might. The idea is that of Kalantari, Bako and Sen ("A machine learning
approach for filtering Monte Carlo noise", SIGGRAPH 2015), whose network predicts the widths of a cross-bilateral filter
from features of the pixel. Departures: convolutions over a few features in place of many made by hand, and factors of
widths, which are learned too, in place of widths.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, conv2d

from fovden.checks import require_integer
from fovden.color import luminance
from fovden.filters.atrous import Atrous
from fovden.filters.base import Denoised, Denoiser
from fovden.filters.guided import cells_alone, length_unit, topology_of
from fovden.filters.nonhomogeneous import NonHomogeneousAtrous
from fovden.foveation import Topology
from fovden.frame import Frame

__all__ = ["LARGEST_LOG_FACTOR", "PredictedSigmas", "local_features"]

LARGEST_LOG_FACTOR = 3.0
"""Factors lie between exp(-3) and exp(3), 1/20 and 20: past these a width is as good as nothing or endless."""

FEATURES = 14
"""Channels of :func:`local_features`."""

WINDOW = 7
"""Side of the window of the light's statistics, in pixels. Where a quarter is sampled, it holds twelve samples."""

DARK = 1 / 64
"""Added to a luminance before its logarithm: six stops below the view's mean, where relative units are used."""

SMALLEST_SHARE = 1e-6
"""Added to the part of a window that is sampled: far below one of its 49 pixels, and enough to divide by."""

SMALLEST_VARIANCE = 1e-6
"""Added to a variance before its root, whose derivative would have no end at 0."""


def local_features(frame: Frame, light: Tensor) -> Tensor:
    """Returns what the network sees of each pixel.

    Normal (3 channels), log depth in the view's median hit depths, albedo (3), whether there is a surface, the inverse
    of the number of the layer, log(1 + samples); the log luminance l = log(light + 1/64) of a sampled pixel; mean and
    standard deviation of l over the sampled pixels of a window of 7 x 7, and which part of it is sampled. Whatever a
    pixel does not have is 0.

    In a polar raster a pixel is a cell. Columns with fewer rows are first stretched to all of them, each by its nearest
    cell at the same angle, so that windows are rectangles; they go around the circle, and read the outermost column
    again beyond the rim, and the first one, or the other side, beyond the gaze.

    Args:
        frame: The noisy frame.
        light: Its light in the units of the filter, not negative, shape (v, 3, h, w).

    Returns:
        Shape (v, 14, h, w), the type of ``light``, finite; in a polar raster, of its stretched columns.

    Differentiable: in the light, the mask and the G-buffer.

    Example:
        >>> from fovden.frame import GBuffer
        >>> frame = Frame.from_radiance(torch.ones(2, 3, 8, 8), GBuffer.empty(2, (8, 8)))
        >>> features = local_features(frame, frame.radiance)
        >>> features.shape, features[0, -3:, 4, 4]
        (torch.Size([2, 14, 8, 8]), tensor([0.0155, 0.0010, 1.0000]))
    """
    frame, topology = cells_alone(frame), topology_of(frame)
    g, hit, mask = frame.gbuffer, frame.gbuffer.hit, frame.mask
    depth = torch.where(hit, g.depth / length_unit(g.depth, hit), 1).clamp(min=torch.finfo(torch.float32).tiny).log()
    logarithm = (luminance(light) + DARK).log()

    def stretch(plane: Tensor) -> Tensor:
        return plane if topology is None else topology.expand(plane)

    def around(plane: Tensor) -> Tensor:
        """The mean over the window, of which what lies outside the screen counts as not sampled."""
        if topology is not None:
            return avg_pool2d(topology.pad(plane, WINDOW // 2), WINDOW, stride=1)
        return avg_pool2d(plane, WINDOW, stride=1, padding=WINDOW // 2)

    level, mask, square = (stretch(plane) for plane in (mask * logarithm, mask, mask * logarithm.square()))
    share = around(mask)
    mean = around(level) / (share + SMALLEST_SHARE)
    square = around(square) / (share + SMALLEST_SHARE)
    deviation = ((square - mean.square()).clamp(min=0) + SMALLEST_VARIANCE).sqrt()
    own = [
        torch.where(hit, g.normal, 0),
        depth,
        torch.where(hit, g.albedo, 0),
        hit,
        1 / (1 + frame.layer),
        frame.counts.log1p(),
    ]
    planes = [stretch(torch.cat([plane.to(light.dtype) for plane in own], 1)), level, mean, deviation, share]
    return torch.cat([plane.to(light.dtype) for plane in planes], 1)


class PredictedSigmas(Denoiser):
    """A filter of the à-trous family whose widths a network of three 3 x 3 convolutions scales at each pixel.

    The network reads :func:`fovden.filters.predicted.local_features` and returns z, three channels; the widths of
    radiance, normal and position are multiplied by

        exp(3 tanh(z / 3)),

    which lies between 1/20 and 20, in every pass and where holes are filled. Its last layer starts at 0, so that the
    denoiser starts as the one inside, to rounding. With 16 channels it has 4787 weights, which are learned together
    with the inner denoiser's parameters. Its weights are drawn from a seed; the global random state is left alone.

    The network sees the units of the filter inside: with ``relative`` exposure and the unit of length do not matter.
    It never reads across views, also where ``seam`` joins them for the filter. Pixels outside the screen are 0 to it. A
    polar raster, whose features have no seam, is continued in each layer as the features are.

    Args:
        inner: The filter; it becomes a part of this module.
        channels: Channels between the convolutions, at least 1.
        seed: Seed of the first weights.

    Raises:
        TypeError: If ``inner`` is no filter that takes factors.
        ValueError: If ``channels`` is below 1.

    Differentiable: in the weights, in the inner denoiser's parameters, and in what that is differentiable in. Cost:
    a multiply-add for each weight and pixel, twice that on the way back, and the features and layers in memory.

    The image does not depend on the number of threads; derivatives in the weights do, in their last bits, since those
    of PyTorch's convolutions do.

    Source: the idea is that of Kalantari, Bako and Sen (2015); the network and its numbers are ours.

    Example:
        >>> from fovden.frame import GBuffer
        >>> frame = Frame.from_radiance(torch.rand(1, 3, 8, 8), GBuffer.empty(1, (8, 8)))
        >>> denoiser = PredictedSigmas(Atrous((2, 1)))
        >>> torch.allclose(denoiser(frame).image, Atrous((2, 1))(frame).image)
        True
        >>> sum(weight.numel() for weight in denoiser.network.parameters())
        4787
    """

    def __init__(self, inner: Atrous | NonHomogeneousAtrous, channels: int = 16, *, seed: int = 0) -> None:
        super().__init__()
        if not isinstance(inner, Atrous | NonHomogeneousAtrous):
            raise TypeError(f"inner: expected Atrous or NonHomogeneousAtrous, got {type(inner).__name__}")
        self.inner = inner
        self.channels = require_integer("channels", channels, minimum=1)
        self.network = _network((FEATURES, channels, channels, 3), require_integer("seed", seed, minimum=0))

    def predict(self, frame: Frame) -> Tensor:
        """Returns what the widths of radiance, normal and position are multiplied by at each pixel.

        Args:
            frame: The noisy frame.

        Returns:
            Factors from 1/20 to 20, shape (v, 3, h, w), the type of the frame's light.

        Example:
            >>> from fovden.frame import GBuffer
            >>> frame = Frame.from_radiance(torch.ones(1, 3, 4, 4), GBuffer.empty(1, (4, 4)))
            >>> PredictedSigmas(Atrous()).predict(frame).unique()
            tensor([1.], grad_fn=...)
        """
        light, _ = self.inner.light(frame)
        features = local_features(frame, light)
        topology = topology_of(frame)
        raw = _convolve(self.network, features.to(next(self.network.parameters()).dtype), topology).to(light.dtype)
        raw = raw if topology is None else topology.collapse(raw)
        return (LARGEST_LOG_FACTOR * (raw / LARGEST_LOG_FACTOR).tanh()).exp()

    def forward(self, frame: Frame, history: Any = None) -> Denoised:
        """Returns the inner denoiser's image of a frame, with the predicted widths; there is no history.

        Args:
            frame: The noisy frame.
            history: Not used: the filter is spatial.

        Returns:
            The image, in the frame's units, and ``None``.

        Raises:
            ValueError: As the inner denoiser does.

        Example:
            >>> from fovden.frame import GBuffer
            >>> frame = Frame.from_radiance(torch.full((2, 3, 4, 4), 0.5), GBuffer.empty(2, (4, 4)))
            >>> PredictedSigmas(NonHomogeneousAtrous.nh3ld())(frame).image.mean()
            tensor(0.5000, grad_fn=<MeanBackward0>)
        """
        return self.inner(frame, history, factors=self.predict(frame))

    def extra_repr(self) -> str:
        """Returns the number of channels, for ``print``.

        Example:
            >>> PredictedSigmas(Atrous(), 8).extra_repr()
            'channels=8'
        """
        return f"channels={self.channels}"


def _convolve(network: nn.Sequential, features: Tensor, topology: Topology | None) -> Tensor:
    """The network's output; in a polar raster, of stretched columns, without its padding by 0."""
    if topology is None:
        out: Tensor = network(features)
        return out
    for layer in network:
        if isinstance(layer, nn.Conv2d):
            features = conv2d(topology.pad(features, 1), layer.weight, layer.bias)
        else:
            features = layer(features)
    return features


def _network(channels: tuple[int, ...], seed: int) -> nn.Sequential:
    """3 x 3 convolutions with rectifiers between them; the last gives 0."""
    generator = torch.Generator().manual_seed(seed)
    layers: list[nn.Module] = []
    for number, (before, after) in enumerate(pairwise(channels), start=2):
        layer = nn.Conv2d(before, after, 3, padding=1, device="meta").to_empty(device="cpu")  # draws nothing
        if number < len(channels):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu", generator=generator)
        else:
            nn.init.zeros_(layer.weight)
        nn.init.zeros_(layer.get_parameter("bias"))
        layers += [layer, nn.ReLU()]
    return nn.Sequential(*layers[:-1])
