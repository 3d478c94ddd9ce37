"""The scene as the kernels read it: tensors' own memory, gathered into a few tuples of arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from torch import Tensor

from fovden.camera import Camera, StereoCamera
from fovden.checks import require
from fovden.color import luminance, srgb_to_linear
from fovden.memory import on_large_pages
from fovden.tracer.kernels import illumination
from fovden.tracer.kernels.illumination import LightTable
from fovden.tracer.kernels.paths import Views
from fovden.tracer.kernels.surface import GeometryArrays
from fovden.tracer.lights import DirectionalLight, EnvironmentLight, PointLight

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene

__all__ = ["LightChoice", "geometry_arrays", "light_table", "view_arrays"]

LightChoice = Literal["uniform", "power"]
"""How a path chooses one of the lights: all alike, as in the 2019 and 2023 papers, or by their power. The mean is the
same. By power it has less variance where lights differ and reach alike; more, where the strongest is mostly hidden."""

DEFENSIVE_SHARE = 0.5
"""Share of the choices by power that are made uniformly, so that a light's chance is never below half of the uniform
one (defensive mixture, Hesterberg 1995). Power alone starves the lamp of a court whose sun falls on few places."""


def geometry_arrays(scene: Scene) -> GeometryArrays:
    """Returns the triangles, materials and textures of a scene.

    Example:
        >>> from fovden.tracer import make_scene
        >>> geometry_arrays(make_scene("cornell_box")).srgb.shape
        (256,)
    """
    materials = scene.materials
    images = [image.reshape(-1, 3) for image in materials.textures]
    sizes = torch.tensor([tuple(image.shape[:2]) for image in materials.textures], dtype=torch.int64).reshape(-1, 2)
    first = torch.cumsum(sizes[:, 0] * sizes[:, 1], 0) - sizes[:, 0] * sizes[:, 1]
    texels = torch.cat(images) if images else torch.zeros(1, 3, dtype=torch.uint8)
    assert scene.normals is not None  # filled in by Scene, like uv
    assert scene.uv is not None
    return GeometryArrays(
        vertices=on_large_pages(scene.vertices.detach()).numpy(),
        faces=on_large_pages(scene.faces).numpy(),
        normals=on_large_pages(scene.normals.detach()).numpy(),
        uv=on_large_pages(scene.uv.detach()).numpy(),
        material_ids=scene.material_ids.numpy(),
        albedo=materials.albedo.detach().numpy(),
        emission=materials.emission.detach().numpy(),
        texture=materials.texture.numpy(),
        texels=on_large_pages(texels).numpy(),
        texture_first=first.numpy(),
        texture_height=sizes[:, 0].contiguous().numpy(),
        texture_width=sizes[:, 1].contiguous().numpy(),
        srgb=srgb_to_linear(torch.arange(256) / 255).numpy(),
    )


def light_table(scene: Scene, choice: LightChoice = "uniform") -> LightTable:
    """Returns the lights of a scene: those it lists, then its emissive triangles.

    Args:
        scene: The scene.
        choice: See :data:`LightChoice`. The power of a directional light or of the environment is what falls on the
            disc of the scene's bounding sphere.

    Returns:
        The table; empty where the scene has no light.

    Raises:
        ValueError: If ``choice`` is unknown, or the scene has two environments.

    Example:
        >>> from fovden.tracer import make_scene
        >>> light_table(make_scene("cornell_box")).kind
        array([2, 2], dtype=int32)
    """
    require(choice in ("uniform", "power"), "choice", choice, "'uniform' or 'power'")
    lower, upper = scene.vertices.detach().amin(0), scene.vertices.detach().amax(0)
    disc = math.pi * float((upper - lower).double().norm() / 2) ** 2
    kinds: list[int] = []
    vectors: list[tuple[float, float, float]] = []
    colours: list[object] = []
    scales: list[float] = []
    surroundings = torch.zeros(0, 0, 3)
    for light in scene.lights:
        if isinstance(light, PointLight):
            kinds.append(illumination.POINT)
            vectors.append(light.position)
            colours.append(light.intensity)
            scales.append(4 * math.pi)
        elif isinstance(light, DirectionalLight):
            kinds.append(illumination.DIRECTIONAL)
            vectors.append(light.direction)
            colours.append(light.irradiance)
            scales.append(disc)
        else:
            require(surroundings.numel() == 0, "lights", "two environment lights", "at most one environment light")
            surroundings = _environment_image(light)
            kinds.append(illumination.ENVIRONMENT)
            vectors.append((0.0, 0.0, 0.0))
            colours.append(_mean_over_sphere(surroundings))
            scales.append(math.pi * disc)
    emission = scene.materials.emission.detach()[scene.material_ids.long()]
    area = scene.triangle_areas
    prim = ((emission.amax(1) > 0) & (area > 0)).nonzero()[:, 0]
    listed = len(kinds)
    colour = torch.cat([torch.tensor(colours, dtype=torch.float32).reshape(-1, 3), emission[prim]])
    scale = torch.cat([torch.tensor(scales, dtype=torch.float64), math.pi * area[prim]])
    weight = torch.ones_like(scale)
    if choice == "power":
        weight = scale * luminance(colour.double()[None, :, :, None].transpose(1, 2))[0, 0, :, 0]
        weight = torch.where(weight.sum() > 0, weight, torch.ones_like(weight))
    pmf = weight / weight.sum()
    if choice == "power":
        pmf = (1 - DEFENSIVE_SHARE) * pmf + DEFENSIVE_SHARE / len(pmf)
    cdf = torch.cumsum(pmf, 0)
    return LightTable(
        kind=torch.cat([torch.tensor(kinds, dtype=torch.int32), torch.full((len(prim),), illumination.TRIANGLE)])
        .to(torch.int32)
        .numpy(),
        vector=torch.cat([torch.tensor(vectors).reshape(-1, 3), torch.zeros(len(prim), 3)]).numpy(),
        colour=colour.numpy(),
        prim=torch.cat([torch.full((listed,), -1), prim]).to(torch.int32).numpy(),
        pmf=pmf.float().numpy(),
        cdf=cdf.float().numpy(),
        environment=surroundings.numpy(),
    )


def view_arrays(camera: Camera | StereoCamera) -> Views:
    """Returns the views of a camera.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(2, 2))
        >>> view_arrays(camera).forward.shape
        (2, 3)
    """
    views = camera.views
    tensors = (views.origin, -views.rotation[:, :, 2], views.pixel_to_world)
    return Views(*(np.ascontiguousarray(tensor.detach().float().numpy()) for tensor in tensors))


def _environment_image(light: EnvironmentLight) -> Tensor:
    """Radiance by row and column, shape (h, w, 3); a constant sky is a single texel."""
    if isinstance(light.radiance, Tensor):
        return light.radiance.detach().float().permute(1, 2, 0).contiguous()
    return torch.tensor(light.radiance, dtype=torch.float32).expand(1, 1, 3).contiguous()


def _mean_over_sphere(image: Tensor) -> list[float]:
    """Mean radiance over all directions: rows weighted by the solid angle that they cover."""
    edges = torch.cos(torch.linspace(0, math.pi, image.shape[0] + 1, dtype=torch.float64))
    weight = (edges[:-1] - edges[1:]) / 2
    mean: list[float] = (image.double().mean(1) * weight[:, None]).sum(0).tolist()
    return mean
