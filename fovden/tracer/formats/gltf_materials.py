"""Materials of glTF 2.0: how they reflect, what they emit, and where they are cut out."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import torch
from PIL import Image
from torch import Tensor

from fovden.tracer.formats.gltf_nodes import extras_of
from fovden.tracer.formats.image_files import alpha_of, factors_of, visible
from fovden.tracer.formats.scene_file import SceneFileError, read_image, texture_of
from fovden.tracer.materials import CUTOFF, MODELS, Material

__all__ = ["materials_of", "placing"]

_REPEAT = 10497
_COLOUR, _FACTORS = "baseColorTexture", "metallicRoughnessTexture"

Json = dict[str, Any]


def placing(header: Json, material: int) -> Json:
    """Returns the texture info that places a material's images, empty if it has none: the base colour's if there is.

    Example:
        >>> placing({"materials": [{"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 3}}}]}, 0)
        {'index': 3}
    """
    surface = header["materials"][material].get("pbrMetallicRoughness", {})
    return dict(surface.get(_COLOUR, surface.get(_FACTORS, {})))


def materials_of(path: Path, header: Json, decoded: Mapping[int, Any]) -> Callable[[int], Material]:
    """Returns the function that makes the material of an index, 0 being the default; it decodes each image once.

    The model is ``"metallic_roughness"``, with factors exactly as written times their images, unless
    :func:`fovden.tracer.formats.gltf_writer.write_gltf` noted another. What is left out of a file has glTF's defaults:
    white metal of roughness 1, also without any material (3.9.2 there).

    Holes are where alpha (factor times image) is below ``alphaCutoff`` with ``alphaMode`` ``"MASK"``. ``"BLEND"`` is
    read as a mask at 0.5, with a warning: a pixel shows one surface here, with one depth and one normal, and this is
    where a picture is more surface than not. Alpha means nothing with ``"OPAQUE"``, the default.

    Args:
        path: The file, for messages and for images beside it.
        header: The file's JSON.
        decoded: What trimesh made of a material, by its number, for images inside the file.

    Returns:
        The function. It raises and warns as :func:`fovden.tracer.formats.gltf.gltf_parts` says.

    Example:
        >>> make = materials_of(Path("a.gltf"), {"materials": [{"name": "white", "pbrMetallicRoughness": {}}]}, {})
        >>> make(1).model, make(1).metallic
        ('metallic_roughness', 1.0)
    """
    owners: dict[int, tuple[int, str]] = {}

    @functools.cache
    def load(source: int, convert: Callable[[Image.Image], Tensor]) -> Tensor:
        uri = header["images"][source].get("uri", "")
        if uri and not uri.startswith("data:"):
            file = path.parent / unquote(uri)
            if not file.is_file():
                raise FileNotFoundError(f"{path}: image {source} ('{uri}') is not there ({file})")
            return read_image(file, convert)
        try:
            owner, key = owners[source]
            return convert(getattr(decoded[owner], key))
        except Exception as error:
            raise SceneFileError(f"{path}: the embedded image {source} cannot be decoded") from error

    def source_of(index: int, key: str) -> int | None:
        material = header["materials"][index]
        info = material.get("pbrMetallicRoughness", {}).get(key)
        if info is None:
            return None
        place = f"{path}: material '{material.get('name', index)}'"
        source = _source(header, place, info, placing(header, index))
        owners.setdefault(source, (index, key))
        return source

    def make(slot: int) -> Material:
        if slot == 0:
            return Material("default", (1.0, 1.0, 1.0), model="metallic_roughness", metallic=1.0)
        entry = header["materials"][slot - 1]
        name = str(entry.get("name", f"material {slot - 1}"))
        _warn_of_losses(f"{path}: material '{name}'", entry)
        surface, note = entry.get("pbrMetallicRoughness", {}), extras_of(entry)
        red, green, blue, alpha = map(float, surface.get("baseColorFactor", [1, 1, 1, 1]))
        extensions = entry.get("extensions", {})
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        r, g, b = (strength * float(x) for x in entry.get("emissiveFactor", [0, 0, 0]))
        model = note.get("model", "metallic_roughness")
        if model not in MODELS:
            raise SceneFileError(f"{path}: material '{name}': expected a model of {', '.join(MODELS)}, got {model!r}")
        colour, factors = source_of(slot - 1, _COLOUR), source_of(slot - 1, _FACTORS)
        opacity, cutoff = None, float(entry.get("alphaCutoff", CUTOFF))
        if entry.get("alphaMode", "OPAQUE") != "OPAQUE":
            cutoff = cutoff if entry["alphaMode"] == "MASK" else CUTOFF
            image = torch.full((1, 1), 255, dtype=torch.uint8) if colour is None else load(colour, alpha_of)
            opacity, cutoff = visible(image, cutoff, alpha)
        return Material(
            name,
            (red, green, blue),
            (r, g, b),
            None if colour is None else load(colour, texture_of),
            model=model,
            roughness=float(note.get("roughness", surface.get("roughnessFactor", 1.0))),
            metallic=float(note.get("metallic", surface.get("metallicFactor", 1.0))),
            surface=None if factors is None else load(factors, factors_of),
            opacity=opacity,
            cutoff=min(max(cutoff, 0.0), 1.0),
        )

    return make


def _source(header: Json, place: str, info: Json, placed: Json) -> int:
    """The number of the image that a texture info names; warnings and errors for what is not supported."""
    transform = info.get("extensions", {}).get("KHR_texture_transform", {})
    if transform.get("texCoord", info.get("texCoord", 0)) != 0:
        raise SceneFileError(f"{place}: only the first set of texture coordinates is supported")
    if transform != placed.get("extensions", {}).get("KHR_texture_transform", {}):
        warnings.warn(f"{place}: the image of its roughness is placed as that of its colour is", stacklevel=5)
    entry = header["textures"][info["index"]]
    sampler = header["samplers"][entry["sampler"]] if "sampler" in entry else {}
    if {sampler.get("wrapS", _REPEAT), sampler.get("wrapT", _REPEAT)} != {_REPEAT}:
        warnings.warn(f"{place}: the image does not repeat in the file, but does here", stacklevel=5)
    source = entry.get("extensions", {}).get("EXT_texture_webp", entry).get("source")
    if source is None:
        raise SceneFileError(f"{place}: texture {info['index']} has no image that can be read")
    return int(source)


def _warn_of_losses(place: str, entry: Json) -> None:
    if "emissiveTexture" in entry:
        warnings.warn(f"{place}: the emissive image is not used, only its factor is", stacklevel=4)
    for extension in ("KHR_materials_pbrSpecularGlossiness", "KHR_materials_unlit"):
        if extension in entry.get("extensions", {}):
            warnings.warn(f"{place}: {extension} is ignored", stacklevel=4)
    if entry.get("alphaMode") == "BLEND":
        message = "half transparent in the file, it has holes here where alpha is below 0.5"
        warnings.warn(f"{place}: {message}", stacklevel=4)
