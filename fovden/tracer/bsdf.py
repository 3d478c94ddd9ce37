r"""How surfaces reflect, in PyTorch: the formulas of the compiled kernels, differentiable, in any precision.

Three functions, as in every renderer, and what they mean by their names:

- :func:`evaluate` returns f(viewer, light) in 1/sr, **without the cosine**. Mitsuba's ``eval`` includes it.
- :func:`density` is per **solid angle** of the direction to the light (Mitsuba's ``pdf``).
- :func:`sample` draws that direction; its ``weight`` is f * cosine / density, **with the cosine**.

Directions are unit vectors that point away from the surface. Only the side of the normal reflects: with light below its
horizon, f and the density are 0. A viewer below is mirrored to above it, because that is where interpolated normals
leave viewers at the rims of curved things, which would be black otherwise. Of all models f is the same with viewer and
light exchanged, affine in the albedo, and reflects at most what arrives; density and choice do not depend on the
albedo. With n the normal, v the viewer, l the light, h = normalise(v + l), w = (1 - v.h)^5, and rho the albedo:

``"lambert"``
    f = rho / pi, sampled by the cosine.

``"oren_nayar"``
    f = rho / pi * (A + B max(0, l.v - l_n v_n) / max(l_n, v_n)) / max(1, A + B / 2), where A = 1 - s^2 / (2 (s^2 +
    0.33)), B = 0.45 s^2 / (s^2 + 0.09), and s is the roughness, in radians: the qualitative model of Oren and Nayar,
    "Generalization of Lambert's reflectance model" (SIGGRAPH 1994), sampled by the cosine. The last divisor is ours: to
    a grazing viewer the model shows A + B / 2 of a white sky, which for s < 0.33 is up to 1.5 % too much.

``"ggx"``
    f = D G2 / (4 l_n v_n) * (rho + (1 - rho) w): Walter et al. (2007), of width alpha = max(0.001, roughness^2), with
    Smith's masking and shadowing correlated by height (Heitz 2014) and Schlick's Fresnel term (1994). Sampled by the
    facets that the viewer sees (Heitz 2018, Dupuy and Benyoub 2023). What light loses by being reflected twice between
    facets is lost.

``"metallic_roughness"``
    Appendix B of glTF 2.0: metallic * metal + (1 - metallic) * dielectric, the metal as in ``"ggx"``, the dielectric
    f = D G2 / (4 l_n v_n) * (0.04 + 0.96 w) + rho / pi * min(1 - C(v), 1 - C(l)), where C is what the coat (the first
    term) reflects in all. glTF's own sketch has 1 - (0.04 + 0.96 w) for the minimum; that reflects up to 1.84 times
    what arrives at a grazing viewer. Ours is how its extension ``KHR_materials_sheen`` lets light through a layer.
    Sampled by facets or by the cosine at random, with the density of both together.

``"ggx_separable"``
    As ``"ggx"``, with G2 = G1(v) G1(l): Mitsuba's ``roughconductor``, for comparisons with it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from fovden.checks import require
from fovden.tracer.kernels import bsdf as kernels
from fovden.tracer.kernels import coat, microfacet
from fovden.tracer.materials import MODELS, Model

__all__ = ["Bounce", "density", "evaluate", "sample"]

_FACETS = ("ggx", "ggx_separable")
_COAT = float(coat.COAT)


class Bounce(NamedTuple):
    """Random directions to light.

    Attributes:
        direction: Unit vectors, shape (..., 3); where ``density`` is 0 they may point below the horizon.
        weight: f * cosine / density, shape (..., 3); 0 where the density is.
        density: Per steradian, shape (...).

    Example:
        >>> Bounce(torch.zeros(1, 3), torch.ones(1, 3), torch.ones(1)).weight
        tensor([[1., 1., 1.]])
    """

    direction: Tensor
    weight: Tensor
    density: Tensor


def evaluate(
    model: Model,
    albedo: Tensor,
    normal: Tensor,
    viewer: Tensor,
    light: Tensor,
    *,
    roughness: float | Tensor = 1.0,
    metallic: float | Tensor = 0.0,
) -> Tensor:
    """Returns the share of irradiance that becomes radiance towards the viewer, per channel; without the cosine.

    Args:
        model: One of :data:`fovden.tracer.materials.MODELS`.
        albedo: Reflectance in [0, 1], shape (..., 3).
        normal: Unit vectors, shape (..., 3).
        viewer: Unit vectors from the surface to the viewer, shape (..., 3).
        light: Unit vectors from the surface to the light, shape (..., 3).
        roughness: In [0, 1], a number or shape (...); see :class:`fovden.tracer.Material`.
        metallic: In [0, 1], a number or shape (...).

    Returns:
        f in 1/sr, shape (..., 3); shapes broadcast.

    Raises:
        ValueError: If the model is unknown.

    Differentiable: in everything but the model, where neither direction grazes.

    Example:
        >>> up = torch.tensor([0.0, 0.0, 1.0])
        >>> math.pi * evaluate("lambert", torch.tensor([0.2, 0.5, 0.9]), up, up, up)
        tensor([0.2000, 0.5000, 0.9000])
    """
    white, coloured, _ = _reflection(model, normal, viewer, light, roughness, metallic)
    return white[..., None] + albedo * coloured[..., None]


def density(
    model: Model,
    normal: Tensor,
    viewer: Tensor,
    light: Tensor,
    *,
    roughness: float | Tensor = 1.0,
    metallic: float | Tensor = 0.0,
) -> Tensor:
    """Returns the probability density per steradian with which :func:`sample` chooses a direction to the light.

    Over the sphere it integrates to at most one: what is missing are mirrored directions below the horizon.

    Args:
        model: As of :func:`evaluate`, as are the others.
        normal: Unit vectors, shape (..., 3).
        viewer: Unit vectors, shape (..., 3).
        light: Unit vectors, shape (..., 3).
        roughness: In [0, 1], a number or shape (...).
        metallic: In [0, 1], a number or shape (...).

    Returns:
        The density, shape (...); shapes broadcast.

    Raises:
        ValueError: If the model is unknown.

    Differentiable: as :func:`evaluate`.

    Example:
        >>> up = torch.tensor([0.0, 0.0, 1.0])
        >>> math.pi * density("lambert", up, up, up)
        tensor(1.)
    """
    return _reflection(model, normal, viewer, light, roughness, metallic)[2]


def sample(
    model: Model,
    albedo: Tensor,
    normal: Tensor,
    viewer: Tensor,
    xi: Tensor,
    *,
    roughness: float | Tensor = 1.0,
    metallic: float | Tensor = 0.0,
) -> Bounce:
    """Returns random directions to light with their weights and densities.

    Args:
        model: As of :func:`evaluate`, as are the others.
        albedo: Reflectance in [0, 1], shape (..., 3).
        normal: Unit vectors, shape (..., 3).
        viewer: Unit vectors, shape (..., 3).
        xi: Random numbers in [0, 1), shape (..., 3): the first chooses between facets and base, where there are both.
        roughness: In [0, 1], a number or shape (...).
        metallic: In [0, 1], a number or shape (...).

    Returns:
        The directions.

    Raises:
        ValueError: If the model is unknown.

    Differentiable: yes, the directions in the random numbers, too.

    Example:
        >>> up, white = torch.tensor([0.0, 0.0, 1.0]), torch.ones(3)
        >>> sample("ggx", white, up, up, torch.tensor([0.0, 0.25, 1e-4]), roughness=0.5).weight
        tensor([1.0000, 1.0000, 1.0000])
    """
    require(model in MODELS, "model", model, f"one of {', '.join(MODELS)}")
    s, t = _tangents(normal)
    seen = torch.stack([_dot(s, viewer), _dot(t, viewer), _dot(normal, viewer).abs()], -1)
    roughness, metallic = (torch.as_tensor(x, dtype=seen.dtype) for x in (roughness, metallic))
    radius, angle = xi[..., 1].sqrt(), 2 * math.pi * xi[..., 2]
    local = torch.stack([radius * angle.cos(), radius * angle.sin(), (1 - xi[..., 1]).clamp(min=0).sqrt()], -1)
    if model in _FACETS:
        local = _sample_facets(seen, _width(roughness), xi)
    elif model == "metallic_roughness":
        mirrors = xi[..., 0] < _coat_chance(metallic, _reflected_by_coat(roughness, seen[..., 2]))
        local = torch.where(mirrors[..., None], _sample_facets(seen, _width(roughness), xi), local)
    light = local[..., :1] * s + local[..., 1:2] * t + local[..., 2:] * normal
    white, coloured, chance = _reflection(model, normal, viewer, light, roughness, metallic)
    scale = torch.where(chance > 0, local[..., 2] / torch.where(chance > 0, chance, 1), 0)
    return Bounce(light, scale[..., None] * (white[..., None] + albedo * coloured[..., None]), chance)


def _reflection(
    model: Model, normal: Tensor, viewer: Tensor, light: Tensor, roughness: float | Tensor, metallic: float | Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The value's two numbers and the density, 0 below the horizon."""
    require(model in MODELS, "model", model, f"one of {', '.join(MODELS)}")
    normal, viewer, light = torch.broadcast_tensors(normal, viewer, light)  # type: ignore[no-untyped-call]
    roughness, metallic = (torch.as_tensor(x, dtype=normal.dtype) for x in (roughness, metallic))
    towards = _dot(normal, viewer)
    viewer = viewer - (towards - towards.abs())[..., None] * normal
    cos_v, cosine = towards.abs(), _dot(normal, light)
    above = cosine > 0
    cos_l = torch.where(above, cosine, 1)
    diffuse = torch.ones_like(cos_l) / math.pi
    if model == "lambert":
        white, coloured, chance = 0 * diffuse, diffuse, cos_l / math.pi
    elif model == "oren_nayar":
        square = roughness * roughness
        a, b = 1 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
        across = (_dot(viewer, light) - cos_v * cosine).clamp(min=0)
        steepest = torch.maximum(cos_v, cos_l).clamp(min=float(kernels.GRAZING))
        share = (a + b * across / steepest) / (a + 0.5 * b).clamp(min=1)
        white, coloured, chance = 0 * diffuse, share / math.pi, cos_l / math.pi
    else:
        value, chance, fresnel = _facets(normal, viewer, light, cos_v, cos_l, _width(roughness), model)
        white, coloured = value * fresnel, value * (1 - fresnel)
        if model == "metallic_roughness":
            seen, arriving = _reflected_by_coat(roughness, cos_v), _reflected_by_coat(roughness, cos_l)
            mirrors = _coat_chance(metallic, seen)
            white = metallic * white + (1 - metallic) * value * (_COAT + (1 - _COAT) * fresnel)
            coloured = metallic * coloured + (1 - metallic) * (1 - torch.maximum(seen, arriving)) / math.pi
            chance = mirrors * chance + (1 - mirrors) * cos_l / math.pi
    return torch.where(above, white, 0), torch.where(above, coloured, 0), torch.where(above, chance, 0)


def _facets(
    normal: Tensor,
    viewer: Tensor,
    light: Tensor,
    cos_v: Tensor,
    cos_l: Tensor,
    width: Tensor,
    model: Model,
) -> tuple[Tensor, Tensor, Tensor]:
    """D G2 / (4 l_n v_n), the density of mirrored directions, and (1 - v.h)^5."""
    half = torch.nn.functional.normalize(viewer + light, dim=-1)
    cosine, across = _dot(normal, half), torch.linalg.cross(normal, half)
    facets = width**2 / (math.pi * (_dot(across, across) + (width * cosine) ** 2) ** 2)

    def stretched(z: Tensor) -> Tensor:
        return (z * z + width**2 * (1 - z * z).clamp(min=0)).sqrt()

    if model == "ggx_separable":
        value = facets / ((cos_v + stretched(cos_v)) * (cos_l + stretched(cos_l)))
    else:
        value = facets / (2 * (cos_l * stretched(cos_v) + cos_v * stretched(cos_l)))
    return value, facets / (2 * (cos_v + stretched(cos_v))), (1 - _dot(viewer, half).clamp(max=1)) ** 5


def _sample_facets(viewer: Tensor, width: Tensor, xi: Tensor) -> Tensor:
    """Directions mirrored by facets that the viewer sees, in the frame of the normal."""
    x, y, z = viewer.unbind(-1)
    v = torch.nn.functional.normalize(torch.stack([width * x, width * y, z], -1), dim=-1)
    angle, height = 2 * math.pi * xi[..., 1], (1 - xi[..., 2]) * (1 + v[..., 2]) - v[..., 2]
    radius = (1 - height**2).clamp(min=0).sqrt()
    cap = torch.stack([radius * angle.cos(), radius * angle.sin(), height], -1) + v
    half = torch.stack([width * cap[..., 0], width * cap[..., 1], cap[..., 2].clamp(min=0)], -1)
    half = torch.nn.functional.normalize(half, dim=-1)
    return 2 * _dot(viewer, half)[..., None] * half - viewer


def _width(roughness: Tensor) -> Tensor:
    return (roughness * roughness).clamp(min=float(microfacet.LEAST_WIDTH))


def _coat_chance(metallic: Tensor, reflected: Tensor) -> Tensor:
    """Chance to sample facets: see :func:`fovden.tracer.kernels.bsdf.coat_chance`."""
    mirrored = metallic + (1 - metallic) * reflected
    share = mirrored / (mirrored + 0.5 * (1 - metallic) * (1 - reflected))
    return share.clamp(min=float(kernels.LEAST_CHANCE))


def _reflected_by_coat(roughness: Tensor, cosine: Tensor) -> Tensor:
    """What the coat reflects in all, bilinear in the kernels' table."""
    table = torch.from_numpy(coat.REFLECTED).to(cosine.dtype)
    last, least = coat.SIZE - 1, float(coat.LEAST)
    roughness, cosine = torch.broadcast_tensors(roughness, cosine)  # type: ignore[no-untyped-call]
    x = ((roughness - least).clamp(min=1e-12) / (1 - least)).sqrt() * last
    y = cosine.clamp(1e-12, 1).sqrt().sqrt() * last
    i, j = (p.detach().long().clamp(max=last - 1) for p in (x, y))
    dx, dy = x - i, y - j
    lower = (1 - dy) * table[i, j] + dy * table[i, j + 1]
    upper = (1 - dy) * table[i + 1, j] + dy * table[i + 1, j + 1]
    return (1 - dx) * lower + dx * upper


def _tangents(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors across the normal, those of :func:`fovden.tracer.kernels.vectors.frame_about`."""
    x, y, z = normal.unbind(-1)
    sign = torch.copysign(torch.ones_like(z), z)
    a = -1 / (sign + z)
    s = torch.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x], -1)
    return s, torch.stack([x * y * a, sign + y * y * a, -y], -1)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)
