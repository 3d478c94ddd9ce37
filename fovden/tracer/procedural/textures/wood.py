"""Wood, planed."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.textures.fields import Colour, distance_to_integer, image, mix, noise, sigmoid

__all__ = ["grain", "planks"]


def planks(rng: np.random.Generator, light: Colour, dark: Colour, size: int = 256) -> Tensor:
    """Returns planks with grain along the vertical.

    Example:
        >>> planks(np.random.default_rng(0), (0.5, 0.35, 0.2), (0.3, 0.2, 0.1), size=16).shape
        torch.Size([16, 16, 3])
    """
    count = 4
    position = (np.arange(size) + 0.5) / size * count
    grain = noise(rng, size, 1.3, stretch=(12.0, 1.0)) * 0.9 + noise(rng, size, 0.7, stretch=(6.0, 1.0)) * 0.4
    tone = 0.6 * rng.standard_normal(count)[position.astype(int)]
    colour = mix(light, dark, sigmoid(1.4 * grain + tone))
    gap = distance_to_integer(position) * size / count < size / 200
    return image(np.where(gap[None, :, None], 0.45 * np.asarray(dark), colour))


def grain(rng: np.random.Generator, light: Colour, dark: Colour, size: int = 512) -> Tensor:
    """Returns one wide board with grain along the vertical: bent year rings, fine pores and a slow change of tone.

    Example:
        >>> grain(np.random.default_rng(0), (0.5, 0.35, 0.2), (0.3, 0.2, 0.1), size=16).shape
        torch.Size([16, 16, 3])
    """
    bend = noise(rng, size, 2.0, stretch=(5.0, 1.0))
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (2.2 * bend + 6 * (np.arange(size) + 0.5) / size))
    pores = noise(rng, size, 0.6, stretch=(10.0, 1.0))
    share = sigmoid(3.2 * (rings**2 - 0.45) + 0.55 * pores)
    return image(mix(light, dark, share) * (1 + 0.05 * noise(rng, size, 1.8))[..., None])
