"""What the readers of scene files share: the error they raise, the parts they hand over, and images as textures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image
from torch import Tensor

from fovden.camera import StereoCamera
from fovden.tracer.lights import Light
from fovden.tracer.materials import Material

__all__ = ["DEFAULT_ALBEDO", "SceneFileError", "SceneParts", "fans", "read_image", "read_texture", "texture_of"]

DEFAULT_ALBEDO = (0.5, 0.5, 0.5)
"""Reflectance of surfaces whose file gives none: the default of Mitsuba 3's ``diffuse`` BSDF."""

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


class SceneFileError(ValueError):
    """A scene file, or a file that it names, with content that cannot be used; the message says which and why."""


@dataclass(frozen=True, eq=False)
class SceneParts:
    """A scene as it stands in a file, before materials are left out and images are decoded.

    Attributes:
        vertices: Positions, shape (n, 3).
        faces: Vertex numbers of the triangles in the file's order, shape (m, 3).
        material_ids: Index into ``names`` of each triangle, shape (m).
        names: Names of the materials.
        material: Makes the material of an index; images are decoded only then.
        normals: Shading normals, zero where there is none, shape (n, 3).
        uv: Texture coordinates, NaN where there is none, shape (n, 2).
        lights: Lights of the file.
        camera: View of the file.
        views: Further views, by name.

    Example:
        >>> parts = SceneParts(np.eye(3), np.array([[0, 1, 2]]), np.array([0]), ("grey",),
        ...                    lambda _: Material("grey", DEFAULT_ALBEDO))
        >>> parts.material(0).albedo
        (0.5, 0.5, 0.5)
    """

    vertices: Floats
    faces: Integers
    material_ids: Integers
    names: tuple[str, ...]
    material: Callable[[int], Material]
    normals: Floats | None = None
    uv: Floats | None = None
    lights: tuple[Light, ...] = ()
    camera: StereoCamera | None = None
    views: Mapping[str, StereoCamera] = field(default_factory=dict)


def fans(sizes: Integers) -> tuple[Integers, Integers]:
    """Returns the triangles that fan out polygons around their first corners: exact for convex polygons.

    Args:
        sizes: Number of corners of each polygon, at least 3, shape (k).

    Returns:
        The triangles as numbers of corners, all polygons' corners counted through, shape (m, 3), polygon after
        polygon; and the polygon of each triangle, shape (m).

    Example:
        >>> fans(np.array([3, 4]))[0]
        array([[0, 1, 2],
               [3, 4, 5],
               [3, 5, 6]])
    """
    owners = np.repeat(np.arange(len(sizes)), sizes - 2)
    before = np.cumsum(sizes - 2) - (sizes - 2)
    step = np.arange(len(owners)) - before[owners]
    start = (np.cumsum(sizes) - sizes)[owners]
    return np.stack([start, start + step + 1, start + step + 2], axis=1), owners


def texture_of(image: Image.Image) -> Tensor:
    """Returns an image's stored colours, without any conversion between colour spaces.

    Grey images get three equal channels, palettes are looked up, alpha is dropped (not multiplied in), and 16-bit
    grey is rounded to 8 bits (v / 257, so that 65535 becomes 255).

    Args:
        image: The image.

    Returns:
        The colours, uint8, shape (h, w, 3), top row first.

    Raises:
        ValueError: If the pixels are floats, or integers beyond 16 bits.

    Example:
        >>> texture_of(Image.new("LA", (2, 1), (7, 0)))
        tensor([[[7, 7, 7],
                 [7, 7, 7]]], dtype=torch.uint8)
    """
    if image.mode == "F":
        raise ValueError("the pixels are floats, where 8 or 16 bits are expected")
    if image.mode.startswith("I"):
        grey = np.asarray(image).astype(np.int64)
        if grey.min() < 0 or grey.max() > 65535:
            raise ValueError("the pixels are integers beyond 16 bits")
        return torch.from_numpy(((grey + 128) // 257).astype(np.uint8))[..., None].repeat(1, 1, 3)
    if "transparency" in image.info:
        image = image.convert("RGBA")
    return torch.from_numpy(np.array(image.convert("RGB")))


def read_texture(file: Any) -> Tensor:
    """Returns an image file's stored colours; see :func:`texture_of`.

    Args:
        file: A path, or a binary file object.

    Returns:
        The colours, uint8, shape (h, w, 3), top row first.

    Raises:
        FileNotFoundError: If there is no such file.
        SceneFileError: If it cannot be decoded; the message names the file.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     Image.new("RGB", (4, 2), (255, 128, 0)).save(Path(folder, "orange.png"))
        ...     read_texture(Path(folder, "orange.png")).shape
        torch.Size([2, 4, 3])
    """
    return read_image(file, texture_of)


def read_image(file: Any, convert: Callable[[Image.Image], Tensor]) -> Tensor:
    """Returns what a function makes of an image file; errors are those of :func:`read_texture`.

    Args:
        file: A path, or a binary file object.
        convert: Makes a tensor of the opened image.

    Returns:
        The tensor.

    Raises:
        FileNotFoundError: If there is no such file.
        SceneFileError: If it cannot be decoded; the message names the file.

    Example:
        >>> import io
        >>> read_image(io.BytesIO(b"nothing"), texture_of)
        Traceback (most recent call last):
        ...
        fovden.tracer.formats.scene_file.SceneFileError: embedded image: this image cannot be decoded ...
    """
    name = file if isinstance(file, str | Path) else "embedded image"
    try:
        with Image.open(file) as image:
            return convert(image)
    except FileNotFoundError:
        raise
    except Exception as error:  # Pillow's decoders raise nearly everything
        raise SceneFileError(f"{name}: this image cannot be decoded ({error})") from error
