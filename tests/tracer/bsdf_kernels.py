"""The kernels' BSDFs called over arrays, and textbook formulas by angles, for the tests of materials."""

import numpy as np
import torch

from fovden.jit import kernel
from fovden.tracer.kernels.bsdf import evaluate, sample
from fovden.tracer.kernels.surface import Surface
from fovden.tracer.kernels.vectors import Vector
from fovden.tracer.materials import MODELS

ZERO, NOWHERE = np.float32(0), np.int64(0)


@kernel
def surface_of(normal, model, roughness, metallic):
    return Surface(normal, normal, normal, ZERO, NOWHERE, ZERO, ZERO, model, roughness, metallic)


@kernel
def evaluate_all(model, roughness, metallic, normal, viewer, light, found):
    for i in range(len(light)):
        n = Vector(normal[i, 0], normal[i, 1], normal[i, 2])
        v = Vector(viewer[i, 0], viewer[i, 1], viewer[i, 2])
        value = evaluate(
            surface_of(n, model, roughness[i], metallic[i]), v, Vector(light[i, 0], light[i, 1], light[i, 2])
        )
        found[i, 0], found[i, 1], found[i, 2] = value.white, value.coloured, value.density


@kernel
def sample_all(model, roughness, metallic, normal, viewer, xi, found):
    for i in range(len(xi)):
        n = Vector(normal[i, 0], normal[i, 1], normal[i, 2])
        v = Vector(viewer[i, 0], viewer[i, 1], viewer[i, 2])
        value = sample(surface_of(n, model, roughness[i], metallic[i]), v, xi[i, 0], xi[i, 1], xi[i, 2])
        found[i, 0], found[i, 1], found[i, 2] = value.direction.x, value.direction.y, value.direction.z
        found[i, 3], found[i, 4], found[i, 5] = value.white, value.coloured, value.density


def rows(values, count, width):
    """Values as float32 rows; ``width`` 0 for single numbers."""
    shape = (count, width) if width else (count,)
    return np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype=np.float32), shape))


def call(function, model, roughness, metallic, normal, viewer, last, columns):
    count = len(last)
    found = np.zeros((count, columns), np.float32)
    numbers = rows(roughness, count, 0), rows(metallic, count, 0)
    vectors = rows(normal, count, 3), rows(viewer, count, 3), rows(last, count, 3)
    function(np.int32(MODELS.index(model)), *numbers, *vectors, found)
    return found.astype(np.float64)


def evaluated(model, normal, viewer, light, roughness=1.0, metallic=0.0):
    """White, coloured and density, float64, shape (n, 3), of the compiled kernels."""
    return call(evaluate_all, model, roughness, metallic, normal, viewer, light, 3)


def sampled(model, normal, viewer, xi, roughness=1.0, metallic=0.0):
    """Directions (n, 3), and white, coloured and density (n, 3), float64, of the compiled kernels."""
    found = call(sample_all, model, roughness, metallic, normal, viewer, xi, 6)
    return found[:, :3], found[:, 3:]


def unit(values):
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def directions(count, seed):
    """Random unit vectors, float64."""
    return unit(np.random.default_rng(seed).standard_normal((count, 3)))


def tensors(*arrays):
    return [torch.as_tensor(array, dtype=torch.float64) for array in arrays]


# Textbook formulas, in angles about the third axis.


def angles(directions):
    """Polar and azimuthal angle."""
    return np.arccos(np.clip(directions[..., 2], -1, 1)), np.arctan2(directions[..., 1], directions[..., 0])


def walter(half, alpha):
    """D of Walter et al. (2007), equation 33."""
    theta, _ = angles(half)
    return alpha**2 / (np.pi * np.cos(theta) ** 4 * (alpha**2 + np.tan(theta) ** 2) ** 2)


def smith(direction, alpha):
    """Lambda of Heitz (2014), equation 72."""
    theta, _ = angles(direction)
    return (np.sqrt(1 + (alpha * np.tan(theta)) ** 2) - 1) / 2


def fresnel(base, cosine):
    return base + (1 - base) * (1 - cosine) ** 5


def facets(viewer, light, alpha, base, separable=False):
    """D F G / (4 cos cos) of light and viewer above the third axis' horizon."""
    half = unit(viewer + light)
    a, b = smith(viewer, alpha), smith(light, alpha)
    masking = 1 / ((1 + a) * (1 + b)) if separable else 1 / (1 + a + b)
    reflected = fresnel(base, (viewer * half).sum(-1))
    return walter(half, alpha) * reflected * masking / (4 * viewer[..., 2] * light[..., 2])


def oren_nayar(viewer, light, sigma):
    """The qualitative model of white, Oren and Nayar (1994), equation 30; ours divides what would exceed one."""
    (theta_v, phi_v), (theta_l, phi_l) = angles(viewer), angles(light)
    a, b = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33), 0.45 * sigma**2 / (sigma**2 + 0.09)
    high, low = np.maximum(theta_v, theta_l), np.minimum(theta_v, theta_l)
    value = a + b * np.maximum(0, np.cos(phi_l - phi_v)) * np.sin(high) * np.tan(low)
    return value / np.maximum(1, a + b / 2) / np.pi


def reflected_by_facets(cosine, alpha, base, count=400):
    """Share of the light that facets reflect in all, over their normals by Walter's inversion of D cos: quadrature."""
    x, weight = np.polynomial.legendre.leggauss(count)
    xi = (x[:, None] + 1) / 2
    angle = np.pi * (np.arange(count) + 0.5) / count
    z = np.sqrt((1 - xi) / (1 + (alpha**2 - 1) * xi))
    sine = np.sqrt(1 - z**2)
    half = np.stack(np.broadcast_arrays(sine * np.cos(angle), sine * np.sin(angle), z), -1)
    viewer = np.array([np.sqrt(1 - cosine**2), 0, cosine])
    between = half @ viewer
    light = 2 * between[..., None] * half - viewer
    seen = (between > 0) & (light[..., 2] > 0)
    light[~seen] = [0, 0, 1]
    masking = 1 / (1 + smith(viewer, alpha) + smith(light, alpha))
    values = fresnel(base, between) * masking * between / (cosine * half[..., 2])
    return (np.where(seen, values, 0).mean(1) * weight).sum() / 2
