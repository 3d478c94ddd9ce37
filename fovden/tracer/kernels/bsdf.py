"""How surfaces reflect: for two directions, for a random one, and how likely that one was.

Every model's value is affine in the albedo, f = white + albedo * coloured, with two numbers that are the same for all
channels: what a coat or a grazing angle reflects is white, the rest has the surface's colour.

Directions point away from the surface, towards the viewer and towards the light. A surface reflects on one side only,
that of its normals; it is made for the side from which it is seen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovden.jit import Float, kernel
from fovden.tracer.kernels.surface import Surface
from fovden.tracer.kernels.vectors import Vector, cosine_direction, dot

ZERO, ONE = np.float32(0.0), np.float32(1.0)
INVERSE_PI = np.float32(1.0 / math.pi)

LAMBERT, OREN_NAYAR, GGX, METALLIC_ROUGHNESS = 0, 1, 2, 3


class Reflection(NamedTuple):
    """What a surface does to light from one direction to another."""

    white: Float  # 1/sr, without the cosine: f = white + albedo * coloured
    coloured: Float
    density: Float  # per steradian: of ``sample`` choosing the direction to the light


class Bounce(NamedTuple):
    """A random direction to light. The weight f * cosine / density is white + albedo * coloured."""

    direction: Vector
    white: Float
    coloured: Float
    density: Float  # per steradian; 0 where the sample failed, and its weight is 0 too


@kernel
def evaluate(surface: Surface, viewer: Vector, light: Vector) -> Reflection:
    """How light of one direction is reflected to the viewer; nothing below the horizon of the shading normal."""
    cosine = dot(surface.normal, light)
    if not cosine > ZERO:
        return Reflection(ZERO, ZERO, ZERO)
    return Reflection(ZERO, INVERSE_PI, cosine * INVERSE_PI)


@kernel
def sample(surface: Surface, viewer: Vector, xi_0: Float, xi_1: Float, xi_2: Float) -> Bounce:
    """A random direction to light: ``xi_0`` chooses between the lobes of a model, the others a direction of it."""
    light = cosine_direction(surface.normal, xi_1, xi_2)
    cosine = dot(surface.normal, light)
    if not cosine > ZERO:
        return Bounce(light, ZERO, ZERO, ZERO)
    return Bounce(light, ZERO, ONE, cosine * INVERSE_PI)
