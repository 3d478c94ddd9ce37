"""The scene as the kernels read it: tensors' own memory, gathered into a few tuples of arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, get_args

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
from fovden.tracer.kernels.surface import CUTOFF, EMITTER, FINISH, MATERIAL, NORMALS, RECORD, UV, GeometryArrays
from fovden.tracer.light_tree import build_light_tree
from fovden.tracer.lights import DirectionalLight, EnvironmentLight, PointLight
from fovden.tracer.sky import sky_arrays, solid_angles

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene

__all__ = [
    "LightChoice",
    "areas_of",
    "emissive_triangles",
    "geometry_arrays",
    "light_table",
    "view_arrays",
]

LightChoice = Literal["uniform", "power", "tree"]
"""How a path chooses one of the lights: all alike, as in the 2019 and 2023 papers, by their power, or by what they can
bring to the surface, with a tree over them. The mean is the same. By power it has less variance where lights differ and
reach alike; more, where the strongest is mostly hidden. The tree is for many lights, of which each reaches little."""

DEFENSIVE_SHARE = 0.5
"""Share of the choices by power that are made uniformly, so that a light's chance is never below half of the uniform
one (defensive mixture, Hesterberg 1995). Power alone starves the lamp of a court whose sun falls on few places."""


def emissive_triangles(scene: Scene) -> Tensor:
    """Returns the numbers of the triangles that shine: of emissive material, and with an area.

    Example:
        >>> from fovden.tracer import make_scene
        >>> len(emissive_triangles(make_scene("cornell_box")))
        2
    """
    shines = scene.materials.emission.detach().amax(1) > 0
    if not bool(shines.any()):
        return torch.zeros(0, dtype=torch.int64)
    return (shines[scene.material_ids.long()] & (scene.triangle_areas > 0)).nonzero()[:, 0]


def geometry_arrays(scene: Scene, alike: GeometryArrays | None = None, changed: Tensor | None = None) -> GeometryArrays:
    """Returns the triangles, materials and textures of a scene.

    Args:
        scene: The scene.
        alike: Those of a scene that differs in the places of vertices alone, to share what does not depend on them;
            ``None`` for none.
        changed: Numbers of the triangles in which it differs.

    Returns:
        The arrays.

    Example:
        >>> from fovden.tracer import make_scene
        >>> geometry_arrays(make_scene("cornell_box")).srgb.shape
        (256,)
    """
    if alike is not None:
        before = torch.from_numpy(alike.triangles)
        triangles = on_large_pages(before)
        triangles = triangles.clone() if triangles.data_ptr() == before.data_ptr() else triangles
        _write_triangles(triangles, scene, changed)
        return alike._replace(triangles=triangles.numpy())
    triangles = torch.zeros(scene.triangle_count, RECORD)
    _write_triangles(triangles, scene)
    materials = scene.materials
    images = [*map(_packed, materials.textures), *map(_packed, materials.surfaces), *map(_packed, materials.opacities)]
    sizes = torch.tensor([tuple(image.shape) for image in images], dtype=torch.int64).reshape(-1, 2)
    count = sizes[:, 0] * sizes[:, 1]
    links = [materials.texture, _moved(materials.surface, len(materials.textures))]
    links.append(_moved(materials.opacity, len(materials.textures) + len(materials.surfaces)))
    finishes = torch.zeros(len(materials.names), FINISH)
    columns = (materials.albedo, materials.emission, materials.roughness, materials.metallic, materials.cutoff)
    finishes[:, : CUTOFF + 1] = torch.cat([column.detach().reshape(len(finishes), -1) for column in columns], 1)
    return GeometryArrays(
        triangles=on_large_pages(triangles).numpy(),
        finishes=finishes.numpy(),
        links=torch.stack([materials.model, *links], 1).to(torch.int32).contiguous().numpy(),
        texels=on_large_pages(torch.cat([image.flatten() for image in images] or [torch.zeros(1, dtype=torch.int32)]))
        .numpy()
        .view(np.uint32),
        images=torch.stack([torch.cumsum(count, 0) - count, *sizes.unbind(1)], 1).numpy(),
        srgb=srgb_to_linear(torch.arange(256) / 255).numpy(),
    )


def areas_of(vertices: Tensor, faces: Tensor) -> Tensor:
    """Returns the areas of triangles in square metres, float64, shape (m).

    Args:
        vertices: Positions in metres, shape (n, 3).
        faces: Vertex numbers, shape (m, 3).

    Example:
        >>> areas_of(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
        tensor([0.5000], dtype=torch.float64)
    """
    corners = vertices.detach().double()[faces.long()]
    edges = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas: Tensor = torch.linalg.vector_norm(edges, dim=1) / 2
    return areas


def _write_triangles(records: Tensor, scene: Scene, changed: Tensor | None = None) -> None:
    """Writes all triangles, or those that changed, as :mod:`fovden.tracer.kernels.surface` reads them, (m, 32)."""
    chosen = slice(None) if changed is None else changed
    faces = scene.faces[chosen].long()
    part = records if changed is None else torch.zeros(len(faces), RECORD)
    for start, values in ((0, scene.vertices), (NORMALS, scene.normals), (UV, scene.uv)):
        width = values.shape[1]
        for corner in range(3):
            first = start + corner * width
            part[:, first : first + width] = values.detach()[faces[:, corner]]
    if changed is not None:
        records[changed] = part
    numbers = records.view(torch.int32)
    numbers[:, MATERIAL], numbers[:, EMITTER] = scene.material_ids, -1
    emissive = emissive_triangles(scene)
    numbers[emissive, EMITTER] = torch.arange(len(emissive), dtype=torch.int32)


def _packed(image: Tensor) -> Tensor:
    """A uint8 image with its channels in one int32 per texel, the first in the lowest byte, shape (h, w)."""
    channels = image.to(torch.int32).reshape(*image.shape[:2], -1).unbind(2)
    return sum((channel << 8 * i for i, channel in enumerate(channels)), torch.zeros_like(channels[0]))


def _moved(index: Tensor, count: int) -> Tensor:
    """Indices into a list that follows another of ``count`` entries; -1 stays."""
    return torch.where(index >= 0, index + count, index)


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
    require(choice in get_args(LightChoice), "choice", choice, f"one of {', '.join(get_args(LightChoice))}")
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
    prim = emissive_triangles(scene)
    emission = scene.materials.emission.detach()[scene.material_ids[prim].long()]
    listed = len(kinds)
    colour = torch.cat([torch.tensor(colours, dtype=torch.float32).reshape(-1, 3), emission])
    scale = torch.cat([torch.tensor(scales, dtype=torch.float64), math.pi * scene.triangle_areas[prim]])
    kind = torch.cat([torch.tensor(kinds, dtype=torch.int32), torch.full((len(prim),), illumination.TRIANGLE)]).int()
    vector = torch.cat([torch.tensor(vectors).reshape(-1, 3), torch.zeros(len(prim), 3)])
    shine = luminance(colour.double()[None, :, :, None].transpose(1, 2))[0, 0, :, 0]
    pmf = torch.full_like(scale, 1 / max(len(scale), 1))
    nodes, leaf, share = torch.zeros(0, 0), torch.zeros(len(scale), dtype=torch.int32), 0.0
    if choice == "power" and bool((scale * shine).sum() > 0):
        power = scale * shine
        pmf = (1 - DEFENSIVE_SHARE) * power / power.sum() + DEFENSIVE_SHARE * pmf
    elif choice == "tree":
        outside = (kind == illumination.DIRECTIONAL) | (kind == illumination.ENVIRONMENT)
        corners = vector.double()[:, None].repeat(1, 3, 1)
        corners[listed:] = scene.vertices.detach().double()[scene.faces[prim].long()]
        intensity = shine * torch.where(kind == illumination.TRIANGLE, scale / math.pi, 1.0)
        nodes, leaf = build_light_tree(corners, intensity * ~outside)
        if len(nodes):
            share = 1 / (1 + int(outside.sum()))
            pmf = share * ((leaf > 0) | outside).double()
    by_sums = pmf * (leaf == 0)
    cdf = torch.cumsum(by_sums / by_sums.sum().clamp_min(1e-300), 0)
    return LightTable(
        kind=kind.numpy(),
        vector=vector.numpy(),
        colour=colour.numpy(),
        prim=torch.cat([torch.full((listed,), -1), prim]).to(torch.int32).numpy(),
        pmf=pmf.float().numpy(),
        cdf=cdf.float().numpy(),
        tree=nodes.numpy(),
        leaf=leaf.numpy(),
        tree_share=np.float32(share),
        environment=surroundings.numpy(),
        sky=sky_arrays(surroundings),
        first_emitter=listed,
        sky_row=kinds.index(illumination.ENVIRONMENT) if surroundings.numel() else -1,
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
    mean: list[float] = (image.double().mean(1) * solid_angles(image.shape[0])[:, None]).sum(0).tolist()
    return mean
