"""Wood, planed."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.textures.fields import Colour, distance_to_integer, image, mix, noise, sigmoid

__all__ = ["planks"]


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
