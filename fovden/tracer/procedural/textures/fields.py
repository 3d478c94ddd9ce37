"""What textures are composed of: seamless noise, steps, distances, mixtures of colours."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from fovden.tracer.procedural.patch import Array

__all__ = ["Colour", "distance_to_integer", "image", "mix", "noise", "sigmoid"]

Colour = tuple[float, float, float]
"""An sRGB colour, each value in [0, 1]."""


def noise(rng: np.random.Generator, size: int, slope: float = 1.5, stretch: tuple[float, float] = (1.0, 1.0)) -> Array:
    """Returns seamless fractal noise of mean 0 and standard deviation 1.

    White noise whose spectrum is multiplied by f^-slope, where f is the frequency in cycles per image.

    Args:
        rng: Source of randomness.
        size: Height and width in pixels.
        slope: Steepness: 1 is rough, 2 is cloudy.
        stretch: Factors on the vertical and horizontal frequency: a large one shortens features along that axis less
            than it suppresses variation there, which makes grain along the other axis.

    Returns:
        Values, shape (size, size).

    Example:
        >>> round(float(noise(np.random.default_rng(0), 32).std()), 6)
        1.0
    """
    vertical = np.fft.fftfreq(size)[:, None] * size * stretch[0]
    horizontal = np.fft.rfftfreq(size)[None, :] * size * stretch[1]
    frequency = np.hypot(vertical, horizontal)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * frequency**-slope
    values: Array = np.fft.irfft2(spectrum, s=(size, size))
    values /= values.std()
    return values


def mix(first: Colour, second: Colour, share: Array) -> Array:
    """Returns colours between two, shape (h, w, 3).

    Args:
        first: Colour where the share is 0.
        second: Colour where it is 1.
        share: Values, shape (h, w).

    Example:
        >>> mix((0.0, 0.0, 0.0), (1.0, 0.5, 0.0), np.full((1, 1), 0.5)).tolist()
        [[[0.5, 0.25, 0.0]]]
    """
    mixed: Array = np.asarray(first) + share[..., None] * (np.asarray(second) - np.asarray(first))
    return mixed


def sigmoid(value: Array) -> Array:
    """Returns a soft step from 0 to 1 at 0.

    Example:
        >>> sigmoid(np.array([0.0])).tolist()
        [0.5]
    """
    return 1 / (1 + np.exp(-value))


def distance_to_integer(value: Array) -> Array:
    """Returns how far each value is from the nearest integer, in [0, 0.5]: the distance to the lines of a grid.

    Example:
        >>> distance_to_integer(np.array([0.25, 1.5])).tolist()
        [0.25, 0.5]
    """
    distance: Array = np.abs(value - np.round(value))
    return distance


def image(colour: Array) -> Tensor:
    """Returns colours in [0, 1], clipped to it, as a uint8 image, shape (h, w, 3).

    Example:
        >>> image(np.full((1, 1, 3), 0.5))
        tensor([[[128, 128, 128]]], dtype=torch.uint8)
    """
    return torch.from_numpy(np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8))
