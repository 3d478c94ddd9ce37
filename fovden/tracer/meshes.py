"""Scenes from files: Wavefront OBJ, glTF 2.0 and PLY."""

from __future__ import annotations

import fnmatch
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt
import torch

from fovden.camera import StereoCamera
from fovden.checks import require
from fovden.tracer.formats.gltf import gltf_parts, read_gltf_header
from fovden.tracer.formats.obj import read_obj
from fovden.tracer.formats.scene_file import DEFAULT_ALBEDO, Floats, Integers, SceneFileError, SceneParts, fans
from fovden.tracer.lights import Light
from fovden.tracer.materials import MODELS, Material, Materials, Model
from fovden.tracer.scene import Scene

__all__ = ["SceneFileError", "load_scene"]


def load_scene(
    path: str | os.PathLike[str],
    *,
    lights: Sequence[Light] = (),
    camera: StereoCamera | None = None,
    skip_materials: Sequence[str] = (),
    name: str | None = None,
    model: Model | None = None,
) -> Scene:
    r"""Returns the scene of an OBJ, glTF, GLB or PLY file.

    Every triangle of the file is kept, those of zero area too, in the file's order. Lengths are taken as metres and
    y as up. What each format gives:

    - OBJ: reflectance ``Kd`` times ``map_Kd``, emission ``Ke``, cut-outs ``map_d``, roughness ``Pr`` and metallic
      ``Pm`` with their images, and without these Lambert's surfaces; :func:`fovden.tracer.formats.obj.read_obj` says
      how the scene's vertices follow from the file's, and :class:`fovden.tracer.formats.mtl.MtlMaterial` what is
      ignored.
    - glTF and GLB: base colour, metallic, roughness, emission, cut-outs by alpha, point and directional lights, the
      first camera and further views; :func:`fovden.tracer.formats.gltf.gltf_parts` says how they are translated.
    - PLY: positions, normals and polygons, which become fans around their first corner; one material, grey with
      ``DEFAULT_ALBEDO``. Colours and images are ignored. Polygons of a binary file must all have as many corners.

    Glass is not read as such but as an opaque surface, hence ``skip_materials``.

    Args:
        path: The file; its name's end says the format.
        lights: Lights in addition to those of the file.
        camera: The scene's default view; ``None`` for that of the file, if it has one.
        skip_materials: Patterns of names of materials whose faces are left out, such as ``["*glass*"]``; ``*``
            stands for anything, and upper and lower case count as equal.
        name: The scene's name; ``None`` for the file's name without its ending.
        model: How all materials reflect, whatever the file says, such as ``"lambert"``; ``None`` for what it says.

    Returns:
        The scene. ``scene.materials`` has the materials that are left, in the order of their first face.

    Raises:
        FileNotFoundError: If the file, a material library or an image is not there.
        SceneFileError: If a file's content cannot be used, or there is no face (left).
        ValueError: If ``model`` is unknown.

    Warns:
        UserWarning: Where something that shows is left out, such as a spot light or the place of an image.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = Path(folder, "square.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4")
        ...     scene = load_scene(Path(folder, "square.obj"))
        >>> scene.name, scene.faces
        ('square', tensor([[0, 1, 2],
            [0, 2, 3]], dtype=torch.int32))
    """
    path = Path(path)
    readers = {".obj": read_obj, ".gltf": _read_gltf, ".glb": _read_gltf, ".ply": _read_ply}
    if path.suffix.lower() not in readers:
        raise SceneFileError(f"{path}: expected a file that ends in {', '.join(readers)}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    require(model is None or model in MODELS, "model", model, f"one of {', '.join(MODELS)}")
    patterns = [skip_materials] if isinstance(skip_materials, str) else list(skip_materials)
    with _one_clear_error(path):
        parts = readers[path.suffix.lower()](path)
        _require_sound(path, parts)
        skipped = [
            any(fnmatch.fnmatchcase(material.lower(), pattern.lower()) for pattern in patterns)
            for material in parts.names
        ]
        kept = ~np.array(skipped, dtype=bool)[parts.material_ids]
        if not kept.any():
            reason = f"skip_materials={patterns} leaves no face" if len(kept) else "the file has no faces"
            raise SceneFileError(f"{path}: the scene is empty: {reason}")
        faces, material_ids = parts.faces[kept], parts.material_ids[kept]
        values, first, ids = np.unique(material_ids, return_index=True, return_inverse=True)
        order = np.argsort(first)
        materials = [parts.material(int(index)) for index in values[order]]
        ids = np.argsort(order)[ids]
        materials = [material if model is None else replace(material, model=model) for material in materials]
        _require_reflectance(path, materials)
        given: dict[str, Any] = {
            "normals": None if parts.normals is None else torch.from_numpy(_unit(parts.normals)),
            "uv": _texture_coordinates(path, parts, faces, ids, materials),
        }
        return Scene(
            vertices=torch.from_numpy(parts.vertices.astype(np.float32)),
            faces=torch.from_numpy(faces.astype(np.int32)),
            material_ids=torch.from_numpy(ids.astype(np.int32)),
            materials=Materials.of(materials),
            **{name: value for name, value in given.items() if value is not None},
            lights=(*parts.lights, *lights),
            camera=camera if camera is not None else parts.camera,
            views=parts.views,
            name=path.stem if name is None else name,
        )


@contextmanager
def _one_clear_error(path: Path) -> Iterator[None]:
    """Turns what a parser throws at a file that makes no sense (KeyError, AssertionError, ...) into one kind."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is found and named later
            yield
    except (SceneFileError, OSError):
        raise
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise SceneFileError(f"{path}: the file is damaged, or not of the kind that its name says ({what})") from error


def _require_sound(path: Path, parts: SceneParts) -> None:
    """Refuses numbers that are not finite in single precision, and indices of vertices that do not exist."""
    with np.errstate(over="ignore"):
        single = parts.vertices.astype(np.float32)
    broken = np.any(~np.isfinite(single), axis=1)
    if broken.any():
        index = int(np.argmax(broken))
        raise SceneFileError(
            f"{path}: vertex {index + 1} of {len(single)} is not finite: {tuple(parts.vertices[index].tolist())}"
        )
    if parts.normals is not None and not np.isfinite(parts.normals).all():
        raise SceneFileError(f"{path}: a normal is not finite")
    if parts.uv is not None and np.isinf(parts.uv).any():
        raise SceneFileError(f"{path}: a texture coordinate is not finite")
    if len(parts.faces) and (parts.faces.min() < 0 or parts.faces.max() >= len(single)):
        low, high = parts.faces.min(), parts.faces.max()
        raise SceneFileError(f"{path}: the faces refer to vertices {low} to {high}, but there are {len(single)}")


def _require_reflectance(path: Path, materials: Sequence[Material]) -> None:
    for material in materials:
        if not all(0 <= value <= 1 for value in material.albedo):
            raise SceneFileError(
                f"{path}: material '{material.name}': expected reflectances from 0 to 1, got {material.albedo}"
            )
        if not (0 <= material.roughness <= 1 and 0 <= material.metallic <= 1):
            numbers = f"{material.roughness} and {material.metallic}"
            expected = "expected roughness and metallic from 0 to 1"
            raise SceneFileError(f"{path}: material '{material.name}': {expected}, got {numbers}")
        if not all(0 <= value < np.inf for value in material.emission):
            raise SceneFileError(
                f"{path}: material '{material.name}': expected radiances of at least 0, got {material.emission}"
            )


def _unit(normals: Floats) -> npt.NDArray[np.float32]:
    """Normals of length one; zero stays zero."""
    largest = np.abs(normals).max(axis=1, keepdims=True, initial=0)
    scaled = normals / np.where(largest > 0, largest, 1)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    return (scaled / np.where(length > 0, length, 1)).astype(np.float32)


def _texture_coordinates(
    path: Path, parts: SceneParts, faces: Integers, ids: Integers, materials: Sequence[Material]
) -> torch.Tensor | None:
    """Texture coordinates with 0 where there are none; a warning for each material that would need them."""
    without = np.ones(len(parts.vertices), dtype=bool) if parts.uv is None else np.any(np.isnan(parts.uv), axis=1)
    bare = np.any(without[faces], axis=1)
    for i, material in enumerate(materials):
        mapped = any(image is not None for image in (material.texture, material.surface, material.opacity))
        count = int((bare & (ids == i)).sum()) if mapped else 0
        if count:
            message = f"{count} faces of the textured material '{material.name}' have no texture coordinates"
            warnings.warn(f"{path}: {message}; they show the image's lower left corner", stacklevel=3)
    if parts.uv is None:
        return None
    return torch.from_numpy(np.where(without[:, None], 0, parts.uv).astype(np.float32))


class _Neighbours:
    """The files that a glTF file names, for trimesh: percent signs decoded, and a message when one is missing."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __getitem__(self, uri: str) -> bytes:
        file = self.path.parent / unquote(uri)
        if not file.is_file():
            raise FileNotFoundError(f"{self.path}: the file '{uri}' is not there ({file})")
        return file.read_bytes()


def _read_gltf(path: Path) -> SceneParts:
    import trimesh  # noqa: PLC0415 (takes a second)

    header = read_gltf_header(path)
    load = trimesh.exchange.gltf.load_gltf if path.suffix.lower() == ".gltf" else trimesh.exchange.gltf.load_glb
    with path.open("rb") as file:
        loaded = load(file, resolver=_Neighbours(path), process=False)
    return gltf_parts(path, header, list(loaded["geometry"].values()))


def _read_ply(path: Path) -> SceneParts:
    """The parts of a PLY file, from the rows that trimesh decodes.

    Its finished mesh is not used: it lists triangles before quads, whatever their order in the file, and does not
    notice rows that are missing.
    """
    import trimesh  # noqa: PLC0415 (takes a second)

    with path.open("rb") as file:
        elements = trimesh.exchange.ply.load_ply(file, skip_materials=True)["metadata"]["_ply_raw"]
    vertices, normals = _ply_columns(path, elements, "xyz"), _ply_columns(path, elements, ("nx", "ny", "nz"))
    if vertices is None:
        raise SceneFileError(f"{path}: the file has no vertices")
    sizes, corners = _ply_polygons(path, elements)
    if (sizes < 3).any():
        raise SceneFileError(f"{path}: face {int(np.argmax(sizes < 3)) + 1} has fewer than 3 corners")
    faces = corners[fans(sizes)[0]]
    return SceneParts(
        vertices=vertices,
        faces=faces,
        material_ids=np.zeros(len(faces), np.int64),
        names=("default",),
        material=lambda _: Material("default", DEFAULT_ALBEDO),
        normals=normals,
    )


def _ply_columns(path: Path, elements: Mapping[str, Any], names: Sequence[str]) -> Floats | None:
    """Scalar properties of the vertices side by side; ``None`` if the file does not have them."""
    vertex = elements.get("vertex", {"length": 0, "properties": {}})
    if vertex["length"] == 0 or not set(names) <= set(vertex["properties"]):
        return None
    columns = np.stack([np.asarray(vertex["data"][name]).reshape(-1) for name in names], axis=1)
    if columns.shape[0] != vertex["length"] or columns.dtype == object:
        raise SceneFileError(f"{path}: expected {vertex['length']} complete vertices, got {columns.shape[0]}")
    return columns.astype(np.float64)


def _ply_polygons(path: Path, elements: Mapping[str, Any]) -> tuple[Integers, Integers]:
    """The number of corners of each polygon, and all corners in a row."""
    face = elements.get("face", {"length": 0})
    if face["length"] == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    key = next((name for name in ("vertex_indices", "vertex_index") if name in face["properties"]), None)
    if key is None:
        raise SceneFileError(f"{path}: the faces have no list named vertex_indices")
    rows: Any = face["data"][key] if face["data"] is not None else []
    if len(rows) != face["length"]:
        raise SceneFileError(f"{path}: expected {face['length']} faces, got {len(rows)}")
    if isinstance(face["data"], np.ndarray):  # binary: the lists with their declared sizes
        sizes, corners = rows["f0"].astype(np.int64), rows["f1"].reshape(len(rows), -1)
        if (sizes != corners.shape[1]).any():
            raise SceneFileError(f"{path}: polygons of different sizes in a binary file are not supported")
        return sizes, corners.astype(np.int64).reshape(-1)
    declared = _ply_declared_sizes(path, elements, key)
    sizes = np.array([len(row) for row in rows], dtype=np.int64)
    if (sizes != declared).any():
        index = int(np.argmax(sizes != declared))
        raise SceneFileError(f"{path}: face {index + 1} announces {declared[index]} corners and has {sizes[index]}")
    return sizes, np.concatenate([np.asarray(row, dtype=np.int64) for row in rows])


def _ply_declared_sizes(path: Path, elements: Mapping[str, Any], key: str) -> Integers:
    """The sizes that stand before the lists of a text file, which trimesh does not hand over."""
    names = list(elements)
    before = sum(elements[name]["length"] for name in names[: names.index("face")])
    properties = list(elements["face"]["properties"])
    if any("$LIST" in elements["face"]["properties"][name] for name in properties[: properties.index(key)]):
        raise SceneFileError(f"{path}: a list before {key} is not supported")
    column = properties.index(key)
    lines = path.read_bytes().split(b"end_header", 1)[1].decode("utf-8").splitlines()[1:]
    rows = lines[before : before + elements["face"]["length"]]
    return np.array([int(row.split()[column]) for row in rows], dtype=np.int64)
