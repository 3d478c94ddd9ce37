"""How surfaces reflect: for two directions, for a random one, and how likely that one was.

Every model's value is affine in the albedo, f = white + albedo * coloured, with two numbers that are the same for all
channels: what a coat or a grazing angle reflects is white, the rest has the surface's colour. Neither the choice of
directions nor its density depends on the albedo.

Directions point away from the surface, towards the viewer and towards the light. A surface reflects on one side only,
that of its normals; it is made for the side from which it is seen. A viewer below the horizon of the shading normal,
which happens where a curved surface turns away, is mirrored to above it.

:mod:`fovden.tracer.bsdf` has the formulas in full, and the same once more in PyTorch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovden.jit import Float, inlined, kernel
from fovden.tracer.kernels.coat import COAT, reflected_by_coat
from fovden.tracer.kernels.microfacet import reflect_facets, sample_facets, width_of
from fovden.tracer.kernels.surface import Surface
from fovden.tracer.kernels.vectors import (
    Frame,
    Vector,
    cosine_direction,
    cosine_hemisphere,
    dot,
    frame_about,
    to_local,
    to_world,
)

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
INVERSE_PI = np.float32(1.0 / math.pi)

LAMBERT, OREN_NAYAR, GGX, METALLIC_ROUGHNESS, GGX_SEPARABLE = 0, 1, 2, 3, 4
"""Numbers of the models, as in ``materials.MODELS``."""

GRAZING = np.float32(1e-4)
"""Below this cosine to both sides Oren and Nayar's term, a ratio of small numbers there, no longer grows."""
LEAST_CHANCE = np.float32(0.125)
"""Of a coat to be sampled: ours. It reflects little, but lamps in it are what one sees."""


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


@inlined
def gbuffer_roughness(surface: Surface) -> Float:
    """Perceptual roughness: 1 for diffuse surfaces."""
    return surface.roughness if surface.model >= GGX else ONE


@inlined
def seen_from(frame: Frame, viewer: Vector) -> Vector:
    """The viewer's direction in the frame, mirrored to above the horizon."""
    local = to_local(frame, viewer)
    return Vector(local.x, local.y, abs(local.z))


@inlined
def retroreflected(roughness: Float, viewer: Vector, light: Vector) -> Float:
    """Oren and Nayar's qualitative model relative to a perfect diffuser, the roughness in radians."""
    square = roughness * roughness
    a = ONE - HALF * square / (square + np.float32(0.33))
    b = np.float32(0.45) * square / (square + np.float32(0.09))
    across = max(ZERO, viewer.x * light.x + viewer.y * light.y)
    most = max(ONE, a + HALF * b)  # what a grazing viewer would see of a white sky
    return (a + b * across / max(GRAZING, max(viewer.z, light.z))) / most


@inlined
def coat_chance(metallic: Float, coat: Float) -> Float:
    """Chance to sample the microfacets of metal and coat, not the base: their shares of the light, for mid-grey."""
    mirrored = metallic + (ONE - metallic) * coat
    return max(LEAST_CHANCE, mirrored / (mirrored + HALF * (ONE - metallic) * (ONE - coat)))


@inlined
def metallic_roughness(surface: Surface, viewer: Vector, light: Vector) -> Reflection:
    """A mixture of a metal and a coated diffuse surface; both have the same microfacets."""
    metallic, dielectric = surface.metallic, ONE - surface.metallic
    facets = reflect_facets(viewer, light, width_of(surface.roughness), surface.model == GGX_SEPARABLE)
    seen, arriving = reflected_by_coat(surface.roughness, viewer.z), reflected_by_coat(surface.roughness, light.z)
    coat = COAT + (ONE - COAT) * facets.white
    white = facets.value * (metallic * facets.white + dielectric * coat)
    base = dielectric * (ONE - max(seen, arriving)) * INVERSE_PI
    chance = coat_chance(metallic, seen)
    density = chance * facets.density + (ONE - chance) * light.z * INVERSE_PI
    return Reflection(white, facets.value * metallic * (ONE - facets.white) + base, density)


@kernel
def evaluate_local(surface: Surface, viewer: Vector, light: Vector) -> Reflection:
    """The same as :func:`evaluate`, of any model but Lambert's, in the frame of the shading normal."""
    if surface.model == OREN_NAYAR:
        return Reflection(ZERO, INVERSE_PI * retroreflected(surface.roughness, viewer, light), light.z * INVERSE_PI)
    if surface.model == METALLIC_ROUGHNESS:
        return metallic_roughness(surface, viewer, light)
    facets = reflect_facets(viewer, light, width_of(surface.roughness), surface.model == GGX_SEPARABLE)
    return Reflection(facets.value * facets.white, facets.value * (ONE - facets.white), facets.density)


@kernel
def sample_local(surface: Surface, viewer: Vector, xi_0: Float, xi_1: Float, xi_2: Float) -> Vector:
    """The direction of :func:`sample`, of any model but Lambert's, in the frame of the shading normal."""
    mirrors = surface.model in (GGX, GGX_SEPARABLE)
    if surface.model == METALLIC_ROUGHNESS:
        mirrors = xi_0 < coat_chance(surface.metallic, reflected_by_coat(surface.roughness, viewer.z))
    if mirrors:
        return sample_facets(viewer, width_of(surface.roughness), xi_1, xi_2)
    return cosine_hemisphere(xi_1, xi_2)


@kernel
def evaluate(surface: Surface, viewer: Vector, light: Vector) -> Reflection:
    """How light of one direction is reflected to the viewer; nothing below the horizon of the shading normal."""
    cosine = dot(surface.normal, light)
    if not cosine > ZERO:
        return Reflection(ZERO, ZERO, ZERO)
    if surface.model == LAMBERT:
        return Reflection(ZERO, INVERSE_PI, cosine * INVERSE_PI)
    frame = frame_about(surface.normal)
    local = to_local(frame, light)
    return evaluate_local(surface, seen_from(frame, viewer), Vector(local.x, local.y, cosine))


@kernel
def sample(surface: Surface, viewer: Vector, xi_0: Float, xi_1: Float, xi_2: Float) -> Bounce:
    """A random direction to light: ``xi_0`` chooses between the lobes of a model, the others a direction of it."""
    if surface.model == LAMBERT:
        light = cosine_direction(surface.normal, xi_1, xi_2)
        cosine = dot(surface.normal, light)
        if not cosine > ZERO:
            return Bounce(light, ZERO, ZERO, ZERO)
        return Bounce(light, ZERO, ONE, cosine * INVERSE_PI)
    frame = frame_about(surface.normal)
    seen = seen_from(frame, viewer)
    local = sample_local(surface, seen, xi_0, xi_1, xi_2)
    light = to_world(frame, local)
    if not local.z > ZERO:
        return Bounce(light, ZERO, ZERO, ZERO)
    reflection = evaluate_local(surface, seen, local)
    if not reflection.density > ZERO:
        return Bounce(light, ZERO, ZERO, ZERO)
    scale = local.z / reflection.density
    return Bounce(light, scale * reflection.white, scale * reflection.coloured, reflection.density)
