"""glTF 2.0, written: geometry, materials, lights and cameras, in one file (GLB) or two (glTF and its buffer).

The writer is our own because trimesh's (5.2.0) rounds base colours to eight bits and drops lights and the strength of
emission.
"""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from fovden.checks import require
from fovden.io.files import FilePath, atomic_write
from fovden.tracer.formats.gltf_nodes import camera_entry, light_entry
from fovden.tracer.formats.surfaces import (
    Surfaces,
    environment_entry,
    gather_surfaces,
    metals,
    png_bytes,
    roughnesses,
    save_environment,
    shortest,
    split_lights,
    with_alpha,
)
from fovden.tracer.lights import DirectionalLight, PointLight
from fovden.tracer.materials import MODELS, Materials

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene

__all__ = ["write_gltf"]

# Codes of glTF 2.0: component types and buffer targets (5.1, 5.11), filters and wrapping of a sampler (5.26).
_FLOAT, _UNSIGNED, _VERTICES, _INDICES, _LINEAR, _REPEAT = 5126, 5125, 34962, 34963, 9729, 10497
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
_LARGEST = 2**32 - 1
"""Bytes of a GLB file: its header counts them in 32 bits."""

Json = dict[str, Any]


class _Picture(NamedTuple):
    """An image of the file: a texture with an opacity, or factors to roughness and metallic, by number; -1 for none."""

    texture: int
    opacity: int
    factors: int
    whole: bool  # whether the metal is whole, whatever the factors say


class _Buffer:
    """The one buffer in the making: its pieces of bytes, and the views and accessors that point into them."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self.length = 0
        self.views: list[Json] = []
        self.accessors: list[Json] = []

    def view(self, data: bytes, **entries: int) -> int:
        """Appends bytes, filled up to a multiple of four; returns the number of their view."""
        self.views.append({"buffer": 0, "byteOffset": self.length, "byteLength": len(data), **entries})
        padding = bytes(-len(data) % 4)
        self.pieces += [data, padding]
        self.length += len(data) + len(padding)
        return len(self.views) - 1

    def accessor(self, array: npt.NDArray[Any], target: int, *, bounds: bool = False) -> int:
        """Appends an array of shape (n) or (n, k); returns the number of its accessor."""
        code = _FLOAT if array.dtype == np.float32 else _UNSIGNED
        kind = _TYPES[array.shape[1] if array.ndim == 2 else 1]
        view = self.view(array.tobytes(), target=target)
        entry = {"bufferView": view, "componentType": code, "count": len(array), "type": kind}
        if bounds:
            entry |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.accessors.append(entry)
        return len(self.accessors) - 1


def write_gltf(path: FilePath, scene: Scene) -> list[Path]:
    """Writes a scene to a GLB file, or to a glTF file and its buffer ``.bin``.

    One mesh with one primitive per material, in the order of the materials' first triangles; inside a primitive the
    triangles keep their order. A primitive has its own vertices: those of the scene that it uses, in their order. glTF
    wants normals of all of a primitive's vertices or of none, so corners whose normal is a row of zeros get vertices
    of their own with the triangle's normal. Texture coordinates are left out where a material's are all zero and it
    has no image; v points down in glTF, v' = 1 - v.

    A material is ``baseColorFactor`` (linear) times ``baseColorTexture`` (an embedded PNG with the sRGB curve, and with
    the opacity as its alpha where ``alphaMode`` is ``MASK``), and metallic and roughness with their image. Models that
    glTF does not have are noted in the material's extras, and what other programs read comes near them: a metal for
    microfacets, and for diffuse surfaces no metal and roughness 1, where glTF's dielectric still reflects 4 %, which
    programs that can should turn off. Surfaces are double-sided; emission leaves on both sides there, on that of the
    geometric normal here. Its radiance in W/(m^2 sr) is ``emissiveFactor`` times ``emissiveStrength``.

    :mod:`fovden.tracer.formats.gltf_nodes` says how cameras and lights are written: W/sr as candela, W/m^2 as lux, one
    to one. An environment light, constant or in an OpenEXR file beside this one, is named in the extras of the scene,
    which other programs ignore. The camera path is left out.

    Args:
        path: The file, named ``*.glb`` or ``*.gltf``; its folder must exist.
        scene: The scene.

    Returns:
        The files that were written, the one of ``path`` last.

    Raises:
        ValueError: If the name ends otherwise, the scene has two environments, or the file would exceed 4 GiB.
        OSError: If a file cannot be written; ``path`` is then as it was.

    Warns:
        UserWarning: If the scene has an environment light.

    Example:
        >>> import tempfile
        >>> from fovden.tracer import load_scene, make_scene
        >>> files = write_gltf(Path(tempfile.mkdtemp()) / "box.glb", make_scene("cornell_box"))
        >>> load_scene(files[0]).triangle_count
        38
    """
    path = Path(path)
    ending = path.suffix.lower()
    require(ending in (".glb", ".gltf"), "path", path, "a name that ends in .glb or .gltf")
    buffer = _Buffer()
    surfaces = gather_surfaces(scene, every_normal=True)
    header: Json = {"asset": {"version": "2.0", "generator": "fovden"}, "scene": 0}
    header |= {"scenes": [{"name": scene.name, "nodes": []}], "nodes": [{"name": scene.name, "mesh": 0}]}
    header["meshes"] = [{"name": scene.name, "primitives": _primitives(surfaces, buffer)}]
    pictures = _pictures(scene.materials, surfaces)
    header["materials"] = _materials(scene, surfaces, pictures)
    _add_textures(header, scene.materials, pictures, buffer)
    _add_cameras(header, scene)
    lights, environment = split_lights(scene)
    _add_lights(header, lights)
    if environment is not None:
        message = "glTF has no light from all around; the EnvironmentLight stands in the scene's extras alone"
        warnings.warn(f"{path}: {message}, which other programs ignore", stacklevel=3)
        header["scenes"][0]["extras"] = {"fovden": {"environment": environment_entry(path, environment)}}
    header["scenes"][0]["nodes"] = list(range(len(header["nodes"])))
    header |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": buffer.length}]}
    beside = [path.with_suffix(".bin")] if ending == ".gltf" else []
    with ExitStack() as stack:  # leaves in reverse: the file that names the others takes its place last
        main, *others = (stack.enter_context(atomic_write(file)) for file in [path, *beside])
        if others:
            header["buffers"][0]["uri"] = quote(beside[0].name)
            _write(others[0], buffer.pieces)
            _write(main, [json.dumps(header, ensure_ascii=False).encode()])
        else:
            _write(main, [*_glb_start(path, header, buffer.length), *buffer.pieces])
        files = save_environment(path, environment)
    return [*files, *beside, path]


def _write(path: Path, pieces: Sequence[bytes]) -> None:
    with path.open("wb") as file:
        file.writelines(pieces)


def _glb_start(path: Path, header: Json, length: int) -> list[bytes]:
    """What stands before the buffer in a GLB file (glTF 2.0, 4.4): header, chunk of JSON, head of the binary chunk."""
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + length
    require(total <= _LARGEST, str(path), f"{total} bytes", "a scene of at most 4 GiB (write a .gltf file instead)")
    start = struct.pack("<4sIIII", b"glTF", 2, total, len(text), 0x4E4F534A)
    return [start, text, struct.pack("<II", length, 0x004E4942)]


def _primitives(surfaces: Surfaces, buffer: _Buffer) -> list[Json]:
    primitives = []
    for place, (material, rows) in enumerate(surfaces.runs):
        used, indices = np.unique(surfaces.faces[rows].reshape(-1), return_inverse=True)
        positions, normals = surfaces.vertices[used], surfaces.normals[used].astype(np.float64)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        attributes = {
            "POSITION": buffer.accessor(positions, _VERTICES, bounds=True),
            "NORMAL": buffer.accessor(normals.astype(np.float32), _VERTICES),
        }
        if surfaces.mapped[material]:
            down = surfaces.uv[used].astype(np.float64) * [1, -1] + [0, 1]
            attributes["TEXCOORD_0"] = buffer.accessor(down.astype(np.float32), _VERTICES)
        index = buffer.accessor(indices.reshape(-1).astype(np.uint32), _INDICES)
        primitives.append({"attributes": attributes, "indices": index, "material": place})
    return primitives


def _materials(scene: Scene, surfaces: Surfaces, pictures: Sequence[_Picture]) -> list[Json]:
    """The materials that are used, in the order of the primitives."""
    tables = scene.materials
    metallic, roughness = shortest(metals(tables)), shortest(roughnesses(tables))
    entries = []
    for number, _ in surfaces.runs:
        surface: Json = {"baseColorFactor": [*shortest(tables.albedo[number]), 1.0]}
        surface |= {"metallicFactor": metallic[number], "roughnessFactor": roughness[number]}
        colour, factors = _pictures_of(tables, number)
        if colour is not None:
            surface["baseColorTexture"] = {"index": pictures.index(colour)}
        if factors is not None:
            surface["metallicRoughnessTexture"] = {"index": pictures.index(factors)}
        entry: Json = {"name": tables.names[number], "pbrMetallicRoughness": surface, "doubleSided": True}
        if tables.opacity[number] >= 0:
            entry |= {"alphaMode": "MASK", "alphaCutoff": shortest(tables.cutoff[number : number + 1])[0]}
        model = MODELS[int(tables.model[number])]
        if model != "metallic_roughness":
            own = {"metallic": tables.metallic[number : number + 1], "roughness": tables.roughness[number : number + 1]}
            entry["extras"] = {"fovden": {"model": model, **{name: shortest(x)[0] for name, x in own.items()}}}
        emission = shortest(tables.emission[number])
        strength = max(*emission, 1.0)
        if max(emission) > 0:
            entry["emissiveFactor"] = [value / strength for value in emission]
        if strength > 1:
            entry["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        entries.append(entry)
    return entries


def _pictures_of(tables: Materials, number: int) -> tuple[_Picture | None, _Picture | None]:
    """The pictures of a material: of its base colour with its opacity, and of the factors to roughness and metallic."""
    texture, opacity, factors = (int(table[number]) for table in (tables.texture, tables.opacity, tables.surface))
    whole = MODELS[int(tables.model[number])] != "metallic_roughness"
    colour = _Picture(texture, opacity, -1, False) if texture >= 0 or opacity >= 0 else None
    return colour, _Picture(-1, -1, factors, whole) if factors >= 0 else None


def _pictures(tables: Materials, surfaces: Surfaces) -> list[_Picture]:
    """The pictures of all materials that are used, in the order of the textures; textures that none uses come along."""
    found = [_Picture(i, -1, -1, False) for i in range(len(tables.textures)) if not bool(_cut(tables, i))]
    for number, _ in surfaces.runs:
        found += [picture for picture in _pictures_of(tables, number) if picture is not None and picture not in found]
    return found


def _cut(tables: Materials, texture: int) -> bool:
    """Whether a texture is only used together with an opacity."""
    users = tables.texture == texture
    return bool(users.any()) and bool((tables.opacity[users] >= 0).all())


def _drawn(tables: Materials, picture: _Picture) -> Tensor:
    """A picture's texels."""
    if picture.factors >= 0:
        rough, metal = tables.surfaces[picture.factors].unbind(2)
        full = torch.full_like(rough, 255)
        return torch.stack([full, rough, full if picture.whole else metal], 2)
    texture = tables.textures[picture.texture] if picture.texture >= 0 else None
    if picture.opacity >= 0:
        return with_alpha(texture, tables.opacities[picture.opacity])
    return tables.textures[picture.texture]


def _add_textures(header: Json, tables: Materials, pictures: Sequence[_Picture], buffer: _Buffer) -> None:
    if not pictures:
        return
    views = [buffer.view(png_bytes(_drawn(tables, picture))) for picture in pictures]
    header["images"] = [{"bufferView": view, "mimeType": "image/png"} for view in views]
    header["samplers"] = [{"magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": _REPEAT, "wrapT": _REPEAT}]
    header["textures"] = [{"sampler": 0, "source": i} for i in range(len(pictures))]


def _add_cameras(header: Json, scene: Scene) -> None:
    named = [("camera", scene.camera, True)] if scene.camera is not None else []
    named += [(name, view, False) for name, view in scene.views.items()]
    for number, (name, camera, default) in enumerate(named):
        entry, node = camera_entry(camera, name, default=default)
        header.setdefault("cameras", []).append(entry)
        header["nodes"].append({**node, "camera": number})


def _add_lights(header: Json, lights: Sequence[PointLight | DirectionalLight]) -> None:
    """Adds the lights, and the list of the extensions that are used."""
    entries = []
    for number, light in enumerate(lights):
        name = f"{'point' if isinstance(light, PointLight) else 'directional'} light {number}"
        entry, node = light_entry(light, name)
        entries.append(entry)
        header["nodes"].append({**node, "extensions": {"KHR_lights_punctual": {"light": number}}})
    used = {"KHR_materials_emissive_strength" for material in header["materials"] if "extensions" in material}
    if entries:
        header["extensions"] = {"KHR_lights_punctual": {"lights": entries}}
        used.add("KHR_lights_punctual")
    if used:
        header["extensionsUsed"] = sorted(used)
