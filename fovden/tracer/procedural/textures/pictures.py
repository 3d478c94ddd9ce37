"""Paintings, and the meadow that a window looks out on."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.procedural.patch import Array
from fovden.tracer.procedural.textures.fields import Colour, image, mix, noise, sigmoid

__all__ = ["bouquet", "fruit", "landscape", "meadow"]


def _canvas(size: int) -> tuple[Array, Array]:
    """Coordinates across and up a picture, each from 0 to 1."""
    position = (np.arange(size) + 0.5) / size
    y, x = np.meshgrid(position[::-1], position, indexing="ij")
    return x, y


def _brushed(rng: np.random.Generator, colour: Array) -> Tensor:
    """The picture with strokes of a brush and the threads of its canvas."""
    size = len(colour)
    strokes = 0.05 * noise(rng, size, 1.0, stretch=(1.0, 3.0)) + 0.02 * noise(rng, size, 0.3)
    return image(colour * (1 + strokes)[..., None])


def landscape(rng: np.random.Generator, size: int = 256) -> Tensor:
    """Returns a painted evening: clouds over ranges of hills and a lake with the low sun's path on it.

    Example:
        >>> landscape(np.random.default_rng(0), size=16).shape
        torch.Size([16, 16, 3])
    """
    x, y = _canvas(size)
    colour = mix((0.97, 0.80, 0.66), (0.55, 0.62, 0.78), np.clip((y - 0.4) / 0.6, 0, 1))
    cloud = sigmoid(2.2 * (noise(rng, size, 1.6, stretch=(2.5, 1.0)) - 0.3))
    colour += (0.75 * cloud * np.clip((y - 0.4) * 3, 0, 1))[..., None] * (np.array([0.98, 0.84, 0.82]) - colour)
    sun = np.hypot(x - 0.62, y - 0.52)
    colour = np.where((sun < 0.06)[..., None], np.array([1.0, 0.93, 0.75]), colour)
    hills = ((0.50, (0.62, 0.52, 0.66)), (0.44, (0.50, 0.40, 0.54)), (0.37, (0.36, 0.32, 0.42)))
    for level, tint in hills:
        phase = 2 * np.pi * rng.random(3)
        ridge = level + 0.05 * np.sin(5 * x + phase[0]) + 0.03 * np.sin(13 * x + phase[1])
        ridge += 0.008 * np.sin(47 * x + phase[2])
        colour = np.where((y < ridge)[..., None], np.asarray(tint), colour)
    lake = y < 0.30 + 0.004 * np.sin(30 * x)
    water = mix((0.50, 0.46, 0.58), (0.86, 0.68, 0.62), np.clip(y / 0.3, 0, 1))
    path = np.exp(-(((x - 0.62) / (0.03 + 0.25 * (0.3 - y))) ** 2)) * (np.sin(160 * y + 9 * np.sin(20 * x)) > -0.2)
    water += (0.7 * path)[..., None] * (np.array([1.0, 0.9, 0.72]) - water)
    colour = np.where(lake[..., None], water, colour)
    bank = y < 0.12 + 0.09 * np.abs(x - 0.45) + 0.012 * np.sin(40 * x) * np.sin(11 * x)
    return _brushed(rng, np.where(bank[..., None], np.array([0.27, 0.27, 0.20]), colour))


def bouquet(rng: np.random.Generator, size: int = 256, blooms: int = 26) -> Tensor:
    """Returns a painted bunch of roses in a blue jar, on a dark ground.

    Example:
        >>> bouquet(np.random.default_rng(0), size=16).shape
        torch.Size([16, 16, 3])
    """
    x, y = _canvas(size)
    colour = mix((0.30, 0.22, 0.22), (0.46, 0.36, 0.33), np.clip(x + 0.25 * noise(rng, size, 1.7), 0, 1))
    colour = np.where((y < 0.16)[..., None], np.array([0.66, 0.50, 0.40]), colour)
    jar = np.abs(x - 0.5) < 0.10 + 0.055 * np.sin(np.clip((y - 0.08) / 0.26, 0, 1) * np.pi)
    shine = 0.6 + 0.8 * np.exp(-(((x - 0.45) / 0.05) ** 2))
    colour = np.where(
        (jar & (y > 0.08) & (y < 0.34))[..., None], np.array([0.35, 0.47, 0.60]) * shine[..., None], colour
    )
    for _ in range(60):
        u, v = x - 0.5 - 0.30 * rng.standard_normal(), y - 0.52 - 0.15 * rng.standard_normal()
        turn = np.pi * rng.random()
        along, across = np.cos(turn) * u + np.sin(turn) * v, -np.sin(turn) * u + np.cos(turn) * v
        blade = (along / 0.09) ** 2 + (across / 0.025) ** 2 < 1
        colour[blade] = np.array([0.30, 0.42, 0.26]) * (0.7 + 0.6 * rng.random())
    tints = np.array([(0.94, 0.74, 0.74), (0.88, 0.46, 0.52), (0.97, 0.89, 0.82), (0.72, 0.25, 0.34)])
    for _ in range(blooms):
        turn, far = 2 * np.pi * rng.random(), np.sqrt(rng.random())
        u, v = x - 0.5 - 0.30 * far * np.cos(turn), y - 0.60 - 0.25 * far * np.sin(turn)
        radius, tint = rng.uniform(0.05, 0.085), tints[rng.integers(len(tints))]
        distance, angle = np.hypot(u, v) / radius, np.arctan2(v, u)
        for k in range(4):
            rim = (1 - 0.24 * k) * (0.85 + 0.15 * np.cos(5 * angle + 2 * k))
            colour[distance < rim] = tint * (1.0 - 0.14 * k)
            colour[np.abs(distance - rim) < 0.05] = np.minimum(1.12 * tint, 1)
    return _brushed(rng, colour)


def fruit(rng: np.random.Generator, size: int = 256) -> Tensor:
    """Returns a painted plate of peaches and plums on a striped cloth.

    Example:
        >>> fruit(np.random.default_rng(0), size=16).shape
        torch.Size([16, 16, 3])
    """
    x, y = _canvas(size)
    colour = mix((0.78, 0.70, 0.62), (0.60, 0.56, 0.55), np.clip(1 - x + 0.2 * noise(rng, size, 1.6), 0, 1))
    cloth = np.where(
        (np.sin(52 * (x + 0.3 * y)) > 0.4)[..., None], np.array([0.80, 0.45, 0.47]), np.array([0.93, 0.88, 0.84])
    )
    colour = np.where((y < 0.36 + 0.03 * np.sin(9 * x))[..., None], cloth, colour)
    plate = ((x - 0.5) / 0.38) ** 2 + ((y - 0.32) / 0.13) ** 2
    colour = np.where((plate < 1)[..., None], np.array([0.95, 0.94, 0.92]), colour)
    colour = np.where(((plate < 0.9) & (plate > 0.78))[..., None], np.array([0.40, 0.48, 0.66]), colour)
    places = [(0.36, 0.40), (0.62, 0.41), (0.49, 0.36), (0.44, 0.52), (0.57, 0.53), (0.30, 0.32), (0.70, 0.33)]
    tints = np.array([(0.95, 0.66, 0.42), (0.45, 0.22, 0.38), (0.90, 0.50, 0.36), (0.93, 0.74, 0.45)])
    for i, (centre_x, centre_y) in enumerate(places):
        u, v = (x - centre_x) / 0.105, (y - centre_y) / 0.105
        height = np.sqrt(np.clip(1 - u**2 - v**2, 0, 1))
        light = np.clip(0.25 + 0.75 * (-0.45 * u + 0.5 * v + 0.74 * height), 0.2, 1)
        tint = tints[i % len(tints)] * light[..., None]
        colour = np.where((u**2 + v**2 < 1)[..., None], tint, colour)
    return _brushed(rng, colour)


def meadow(rng: np.random.Generator, grass: Colour, shade: Colour, flower: Colour, size: int = 512) -> Tensor:
    """Returns a flowering meadow from afar: tufts of grass, drifts of flowers.

    Example:
        >>> meadow(np.random.default_rng(0), (0.5, 0.6, 0.3), (0.3, 0.4, 0.2), (0.9, 0.8, 0.8), size=16).shape
        torch.Size([16, 16, 3])
    """
    colour = mix(grass, shade, sigmoid(1.6 * noise(rng, size, 1.1) + 0.8 * noise(rng, size, 0.5)))
    drift = (noise(rng, size, 1.5) > 0.3) & (noise(rng, size, 0.35) > 1.3)
    return image(np.where(drift[..., None], np.asarray(flower), colour))
