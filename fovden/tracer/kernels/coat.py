"""How much a coat with microfacets reflects in all, and so how much of the light reaches what lies under it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fovden.jit import Float, inlined
from fovden.tracer.kernels.microfacet import LEAST_WIDTH

ZERO, ONE = np.float32(0.0), np.float32(1.0)

COAT = np.float32(0.04)
"""What a dielectric coat reflects at normal incidence: glTF's, of refractive index 1.5."""

SIZE = 24
"""Entries of the table along each axis."""
MARGIN = 1.01
"""The table says more than the coat reflects by this factor, which is more than what straight lines between its entries
leave out (0.8 % at most): a coated surface never reflects more than arrives."""
LEAST = np.float32(math.sqrt(LEAST_WIDTH))
"""Roughness below which the width of the distribution stays what it is."""


def _reflected() -> Any:
    """Share of the light that the coat reflects, (SIZE, SIZE), dense where it changes fast.

    Row i has the roughness LEAST + (1 - LEAST) (i / last)^2, column j the cosine (j / last)^4 of the viewer. It is the
    integral of F G2 / G1 over the random numbers of ``sample_facets``, by Gauss and Legendre.
    """
    steps = np.linspace(0, 1, SIZE)
    width, cosine = np.meshgrid((LEAST + (1 - LEAST) * steps**2) ** 2, steps**4, indexing="ij")
    width, cosine = width[..., None, None], cosine[..., None, None]
    (x, weight_x), (y, weight_y) = (np.polynomial.legendre.leggauss(n) for n in (16, 32))
    angle, xi = (math.pi / 2 * (x + 1))[:, None], (y + 1) / 2
    sine = np.sqrt(1 - cosine**2)
    length = np.hypot(width * sine, cosine)
    v_x, v_z = width * sine / length, cosine / length
    z = (1 - xi) * (1 + v_z) - v_z
    radius = np.sqrt(np.maximum(0, 1 - z**2))
    half = np.stack(
        [
            width * (radius * np.cos(angle) + v_x),
            width * radius * np.sin(angle),
            np.broadcast_to(z + v_z, (SIZE, SIZE, 16, 32)),
        ]
    )
    half /= np.linalg.norm(half, axis=0)
    between = sine * half[0] + cosine * half[2]
    light = np.maximum(0, 2 * between * half[2] - cosine)
    seen = np.sqrt(light**2 + width**2 * (1 - light**2))
    masking = (cosine + length) * light / (seen * cosine + length * light)
    fresnel = COAT + (1 - COAT) * (1 - between) ** 5
    return np.einsum("ijkl,k,l->ij", fresnel * masking, weight_x, weight_y) / 4


REFLECTED = np.minimum(1, MARGIN * _reflected()).astype(np.float32)


@inlined
def reflected_by_coat(roughness: Float, cosine: Float) -> Float:
    """Share of the light from a direction, or to it, that the coat reflects: bilinear in the table."""
    last = np.float32(SIZE - 1)
    x = math.sqrt(max(ZERO, roughness - LEAST) / (ONE - LEAST)) * last
    y = math.sqrt(math.sqrt(min(ONE, cosine))) * last
    i, j = np.int64(min(x, last - ONE)), np.int64(min(y, last - ONE))
    dx, dy = x - np.float32(i), y - np.float32(j)
    lower = (ONE - dy) * REFLECTED[i, j] + dy * REFLECTED[i, j + 1]
    upper = (ONE - dy) * REFLECTED[i + 1, j] + dy * REFLECTED[i + 1, j + 1]
    return (ONE - dx) * lower + dx * upper
