"""A rough mirror of microfacets whose slopes have the GGX distribution, in the frame of its normal.

Walter et al., "Microfacet models for refraction through rough surfaces" (EGSR 2007), with masking and shadowing by
Smith, correlated by height (Heitz, "Understanding the masking-shadowing function", JCGT 3(2), 2014). Directions have
their components along the frame's axes, the third along the normal and not negative.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovden.jit import Float, inlined, kernel
from fovden.tracer.kernels.vectors import Vector, added, dot, normalised, scaled

ZERO, ONE, HALF, TWO = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(2.0)
PI = np.float32(math.pi)

LEAST_WIDTH = np.float32(1e-3)
"""Smallest width of the distribution, of roughness 0.032: Falcor takes anything narrower for a perfect mirror. Below
it, directions in single precision no longer tell one facet from its neighbours."""


class Facets(NamedTuple):
    """What microfacets do to light of one direction."""

    value: Float  # 1/sr: reflected by perfect mirrors, without the cosine
    density: Float  # per steradian: of ``sample_facets``
    white: Float  # share that Schlick's Fresnel term reflects where the surface reflects nothing at normal incidence


@inlined
def width_of(roughness: Float) -> Float:
    """The distribution's width alpha: the square of the roughness (Burley 2012, and glTF)."""
    return max(LEAST_WIDTH, roughness * roughness)


@inlined
def schlick(cosine: Float) -> Float:
    """(1 - cosine)^5: F = F0 + (1 - F0) of it."""
    x = ONE - min(ONE, cosine)
    return x * x * x * x * x


@inlined
def stretched(a: Vector, width: Float) -> Float:
    """Sqrt(z^2 + width^2 (x^2 + y^2)): the cosine times 1 + 2 Lambda."""
    return math.sqrt(a.z * a.z + width * width * (a.x * a.x + a.y * a.y))


@inlined
def distribution(h: Vector, width: Float) -> Float:
    """Density of facets with the normal h, per steradian and area of the surface."""
    square = width * width
    spread = h.x * h.x + h.y * h.y + square * h.z * h.z
    return square / (PI * spread * spread)


@kernel
def reflect_facets(viewer: Vector, light: Vector, width: Float, separable: bool) -> Facets:
    """How microfacets reflect light of one direction to the viewer.

    The value is D G2 / (4 l_z v_z). With G1(w) = 2 w_z / (w_z + S(w)), S as in :func:`stretched`, cosines cancel.

    Args:
        viewer: Unit direction.
        light: Unit direction.
        width: Of the distribution.
        separable: Whether masking and shadowing are taken for independent, as Mitsuba does.
    """
    half = normalised(added(viewer, light, ONE))
    cosine = dot(viewer, half)
    facets = distribution(half, width)
    from_viewer, from_light = stretched(viewer, width), stretched(light, width)
    density = facets * HALF / (viewer.z + from_viewer)
    if separable:
        value = facets / ((viewer.z + from_viewer) * (light.z + from_light))
    else:
        value = facets * HALF / (light.z * from_viewer + viewer.z * from_light)
    return Facets(value, density, schlick(cosine))


@kernel
def sample_facets(viewer: Vector, width: Float, xi_1: Float, xi_2: Float) -> Vector:
    """A random direction to light, mirrored by a facet that the viewer sees; it may lie below the horizon.

    Stretched to a hemisphere, the facets that are seen mirror the viewer to all directions of a spherical cap alike:
    Dupuy and Benyoub, "Sampling visible GGX normals with spherical caps" (HPG 2023).
    """
    v = normalised(Vector(width * viewer.x, width * viewer.y, viewer.z))
    angle, z = TWO * PI * xi_1, (ONE - xi_2) * (ONE + v.z) - v.z
    radius = math.sqrt(max(ZERO, ONE - z * z))
    cap = Vector(radius * math.cos(angle) + v.x, radius * math.sin(angle) + v.y, z + v.z)
    half = normalised(Vector(width * cap.x, width * cap.y, max(ZERO, cap.z)))
    return added(scaled(half, TWO * dot(viewer, half)), viewer, -ONE)
