"""What the writers of scene files share: a scene's triangles by material, normals for corners without, images."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image
from torch import Tensor

from fovden.checks import require
from fovden.io.images import save_image
from fovden.tracer.formats.scene_file import Floats, Integers
from fovden.tracer.lights import DirectionalLight, EnvironmentLight, PointLight
from fovden.tracer.materials import MODELS, Materials

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene

__all__ = [
    "Surfaces",
    "environment_entry",
    "gather_surfaces",
    "metals",
    "png_bytes",
    "roughnesses",
    "save_environment",
    "shortest",
    "split_lights",
    "with_alpha",
]

Singles = npt.NDArray[np.float32]


class Surfaces(NamedTuple):
    """A scene's triangles, material by material.

    Attributes:
        vertices: Positions: those of the scene in their order, then the rows that were added, shape (n, 3).
        normals: Shading normals, zero where there is none, shape (n, 3).
        uv: Texture coordinates, shape (n, 2).
        faces: Vertex numbers of the triangles, shape (m, 3).
        runs: Material number, and the rows of ``faces`` that have it, in the order of the materials' first triangles.
        mapped: Of each material whether its texture coordinates say anything.
    """

    vertices: Singles
    normals: Singles
    uv: Singles
    faces: Integers
    runs: tuple[tuple[int, slice], ...]
    mapped: tuple[bool, ...]


def gather_surfaces(scene: Scene, *, every_normal: bool) -> Surfaces:
    """Returns the triangles of a scene, sorted by material and otherwise in their order.

    A corner without a normal, a row of zeros, stands for the triangle's own normal. Where a file cannot say so, the
    corner gets a vertex of its own with that normal (of a triangle without area: straight up, which no ray sees).
    Texture coordinates say something where the material has an image, or any of them is not zero.

    Args:
        scene: The scene.
        every_normal: Whether all corners need a normal; otherwise only those of triangles with both kinds do.

    Returns:
        The triangles.

    Example:
        >>> from fovden.tracer import make_scene
        >>> surfaces = gather_surfaces(make_scene("cornell_box"), every_normal=True)
        >>> surfaces.runs[:2], len(surfaces.vertices) - 70
        (((0, slice(0, 32, None)), (2, slice(32, 34, None))), 114)
    """
    vertices, normals, uv = (x.detach().cpu().numpy() for x in (scene.vertices, scene.normals, scene.uv))
    ids = scene.material_ids.cpu().numpy()
    used, first = np.unique(ids, return_index=True)
    used = used[np.argsort(first)]
    rank = np.zeros(len(scene.materials.names), np.int64)
    rank[used] = np.arange(len(used))
    faces = scene.faces.cpu().numpy()[np.argsort(rank[ids], kind="stable")].astype(np.int64)

    bare = ~np.any(normals != 0, axis=1)[faces]
    if not every_normal:
        bare &= ~bare.all(axis=1, keepdims=True)
    owners = np.nonzero(bare)[0]
    own = _own_normals(vertices[faces[owners]].astype(np.float64))
    copied = faces[bare]
    faces[bare] = len(vertices) + np.arange(len(copied))

    ends = np.cumsum(np.bincount(rank[ids])).tolist()
    starts = [0, *ends[:-1]]
    runs = tuple((int(i), slice(a, b)) for i, a, b in zip(used, starts, ends, strict=True))
    uv = np.concatenate([uv, uv[copied]])
    tables = scene.materials
    mapped = ((tables.texture >= 0) | (tables.surface >= 0) | (tables.opacity >= 0)).tolist()
    for material, rows in runs:
        mapped[material] = mapped[material] or bool(uv[faces[rows]].any())
    normals, vertices = np.concatenate([normals, own]), np.concatenate([vertices, vertices[copied]])
    return Surfaces(vertices, normals, uv, faces, runs, tuple(mapped))


def _own_normals(corners: Floats) -> Singles:
    """Unit normals of triangles, shape (k, 3, 3) to (k, 3)."""
    edges = corners[:, 1:] - corners[:, :1]
    edges /= np.maximum(np.abs(edges).max(axis=(1, 2), keepdims=True, initial=0), np.finfo(np.float64).tiny)
    normals = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    up: Floats = np.array([0.0, 1.0, 0.0])
    return np.where(length > 0, normals / np.where(length > 0, length, 1), up).astype(np.float32)


def png_bytes(image: Tensor) -> bytes:
    """Returns an image as the bytes of a PNG file, its values as they are.

    Args:
        image: Colours with the sRGB curve, with or without alpha, or grey, uint8, shape (h, w, 3), (h, w, 4) or (h, w),
            top row first.

    Returns:
        The file's content.

    Example:
        >>> import torch
        >>> png_bytes(torch.zeros(2, 2, 3, dtype=torch.uint8))[1:4]
        b'PNG'
    """
    stream = io.BytesIO()
    Image.fromarray(image.cpu().contiguous().numpy()).save(stream, format="PNG")
    return stream.getvalue()


def with_alpha(texture: Tensor | None, opacity: Tensor) -> Tensor:
    """Returns colours and opacity in one image, uint8, shape (h, w, 4); white without a texture.

    Args:
        texture: Colours, uint8, shape (h, w, 3).
        opacity: Opacity, uint8, shape (h, w); resampled where its size is another than the texture's, with a warning.

    Returns:
        The image, of the texture's size where there is one.

    Example:
        >>> import torch
        >>> with_alpha(None, torch.tensor([[7]], dtype=torch.uint8))
        tensor([[[255, 255, 255,   7]]], dtype=torch.uint8)
    """
    if texture is None:
        texture = torch.full((*opacity.shape, 3), 255, dtype=torch.uint8)
    if texture.shape[:2] != opacity.shape:
        height, width = texture.shape[:2]
        message = f"an opacity image of {tuple(opacity.shape)} texels is resampled to those of its colours"
        warnings.warn(f"{message}, {(height, width)}", stacklevel=4)
        alpha = Image.fromarray(opacity.cpu().contiguous().numpy()).resize((width, height), Image.Resampling.BILINEAR)
        opacity = torch.from_numpy(np.array(alpha))
    return torch.cat([texture.cpu(), opacity.cpu()[..., None]], dim=2)


def metals(materials: Materials) -> Tensor:
    """Returns the metallic factors as formats of metallic-roughness have them: 1 for microfacets of a metal alone.

    Example:
        >>> from fovden.tracer import Material
        >>> metals(Materials.of([Material("tin", (1, 1, 1), model="ggx"), Material("lime", (1, 1, 1))]))
        tensor([1., 0.])
    """
    lone = [MODELS.index("ggx"), MODELS.index("ggx_separable")]
    mixed = torch.where(materials.model == MODELS.index("metallic_roughness"), materials.metallic, 0.0)
    return torch.where(torch.isin(materials.model, torch.tensor(lone)), 1.0, mixed)


def roughnesses(materials: Materials) -> Tensor:
    """Returns the roughness factors as formats of metallic-roughness have them: 1 for diffuse surfaces.

    Example:
        >>> from fovden.tracer import Material
        >>> roughnesses(Materials.of([Material("tin", (1, 1, 1), model="ggx", roughness=0.5)]))
        tensor([0.5000])
    """
    diffuse = [MODELS.index("lambert"), MODELS.index("oren_nayar")]
    return torch.where(torch.isin(materials.model, torch.tensor(diffuse)), 1.0, materials.roughness.detach())


def shortest(values: Tensor) -> list[float]:
    """Returns single-precision numbers as the doubles with the fewest digits that round to them.

    Example:
        >>> import torch
        >>> torch.tensor([0.1]).tolist(), shortest(torch.tensor([0.1]))
        ([0.10000000149011612], [0.1])
    """
    return [float(str(value)) for value in values.detach().cpu().numpy().astype(np.float32)]


def split_lights(scene: Scene) -> tuple[list[PointLight | DirectionalLight], EnvironmentLight | None]:
    """Returns the lights that stand somewhere or come from somewhere, and the one from all around, if any.

    Raises:
        ValueError: If there are two environments.

    Example:
        >>> from fovden.tracer import make_scene
        >>> split_lights(make_scene("cornell_box"))
        ([], None)
    """
    around = [light for light in scene.lights if isinstance(light, EnvironmentLight)]
    require(len(around) <= 1, "lights", f"{len(around)} environment lights", "at most one environment light")
    rest = [light for light in scene.lights if not isinstance(light, EnvironmentLight)]
    return rest, around[0] if around else None


def environment_entry(path: Path, light: EnvironmentLight) -> dict[str, Any]:
    """Returns an environment light as JSON can hold it.

    Args:
        path: The scene's file.
        light: The light.

    Returns:
        ``radiance``; or ``file``, the name of the image that :func:`save_environment` writes.

    Example:
        >>> environment_entry(Path("a.glb"), EnvironmentLight((1, 2, 3)))
        {'radiance': [1.0, 2.0, 3.0]}
    """
    if isinstance(light.radiance, Tensor):
        return {"file": _environment_file(path).name}
    assert isinstance(light.radiance, tuple)  # made so by the light
    return {"radiance": list(light.radiance)}


def save_environment(path: Path, light: EnvironmentLight | None) -> list[Path]:
    """Writes the image of an environment light, if it has one, to an OpenEXR file beside the scene's.

    Args:
        path: The scene's file.
        light: The light, or ``None``.

    Returns:
        The file, in the layout of :class:`fovden.tracer.EnvironmentLight`; none for a constant light.

    Example:
        >>> import tempfile, torch
        >>> path = Path(tempfile.mkdtemp()) / "a.glb"
        >>> [file.name for file in save_environment(path, EnvironmentLight(torch.ones(3, 4, 8)))]
        ['a_environment.exr']
    """
    if light is None or not isinstance(light.radiance, Tensor):
        return []
    file = _environment_file(path)
    save_image(file, light.radiance.detach().cpu().float()[None])
    return [file]


def _environment_file(path: Path) -> Path:
    return path.with_name(f"{path.stem}_environment.exr")
