"""glTF 2.0: what trimesh rounds, drops or leaves in metadata is read from the JSON here.

trimesh (5.2.0) decodes the meshes; but it rounds base colour factors to eight bits, ignores the strength of emission
and lights, forgets images that are missing, takes a camera's local transform for its place in the world, and reads
sparse accessors as zeros. So materials, lights, cameras and the tree of nodes are read here, and meshes that trimesh
would read wrongly are refused.
"""

from __future__ import annotations

import json
import math
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fovden.camera import StereoCamera
from fovden.io.images import load_image
from fovden.tracer.formats.gltf_materials import materials_of, placing
from fovden.tracer.formats.gltf_nodes import camera_of, extras_of, light_of
from fovden.tracer.formats.scene_file import Floats, Integers, SceneFileError, SceneParts
from fovden.tracer.lights import EnvironmentLight, Light

__all__ = ["gltf_parts", "read_gltf_header"]

_TRIANGLES, _STRIP, _FAN, _FLOAT = 4, 5, 6, 5126
_SUPPORTED = {"KHR_lights_punctual", "KHR_texture_transform", "EXT_texture_webp"}

Json = dict[str, Any]


def read_gltf_header(path: Path) -> Json:
    """Returns the JSON of a ``.gltf`` or ``.glb`` file.

    Args:
        path: The file.

    Returns:
        The parsed JSON object.

    Raises:
        SceneFileError: If the file is cut off, is not glTF 2, or requires an extension that is not supported.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = Path(folder, "empty.gltf").write_text('{"asset": {"version": "2.0"}}')
        ...     read_gltf_header(Path(folder, "empty.gltf"))
        {'asset': {'version': '2.0'}}
    """
    data = path.read_bytes()
    if data[:4] == b"glTF" or path.suffix.lower() == ".glb":
        if len(data) < 20 or data[:4] != b"glTF" or data[16:20] != b"JSON":
            raise SceneFileError(f"{path}: not a GLB file, or cut off inside its header")
        version, total, length = struct.unpack("<III", data[4:16])
        if version != 2 or total > len(data) or 20 + length > total:
            raise SceneFileError(
                f"{path}: expected GLB version 2 with {total} bytes, got version {version} with {len(data)} bytes"
            )
        data = data[20 : 20 + length]
    try:
        header = json.loads(data)
        major = header["asset"]["version"].split(".")[0]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise SceneFileError(f"{path}: not a complete glTF file ({type(error).__name__}: {error})") from error
    if major != "2":
        raise SceneFileError(f"{path}: expected glTF version 2, got {header['asset']['version']}")
    required = header.get("extensionsRequired", [])
    unsupported = [name for name in required if name not in _SUPPORTED and not name.startswith("KHR_materials_")]
    if unsupported:
        raise SceneFileError(f"{path}: the file requires extensions that are not supported: {', '.join(unsupported)}")
    return dict(header)


def gltf_parts(path: Path, header: Json, meshes: Sequence[Mapping[str, Any]]) -> SceneParts:
    """Returns the parts of a glTF scene, its tree of nodes flattened.

    Nodes are visited depth first in the file's order; each use of a mesh makes its own vertices and faces,
    primitive after primitive. A transform M takes normals by its inverse transpose; where it mirrors (det M < 0)
    the triangles' winding is turned round, so that the geometric normal keeps its side. V is flipped to have
    texture coordinate (0, 0) at the image's lower left, after ``KHR_texture_transform``.

    Base colour, metallic, roughness and their images become a ``"metallic_roughness"`` material, with holes where
    ``alphaMode`` says so, and the emissive factor times ``emissiveStrength`` the emitted radiance;
    :func:`fovden.tracer.formats.gltf_materials.materials_of` says more. A primitive without material has the default
    of glTF 2.0 (3.9.2). Normal maps, occlusion, vertex colours, skins and animations are ignored.
    :mod:`fovden.tracer.formats.gltf_nodes` says how lights and cameras are translated. The first perspective camera
    becomes the scene's own, further ones its other views by their nodes' names; only what
    :func:`fovden.tracer.formats.gltf_writer.write_gltf` wrote may say otherwise, and have an environment.

    Args:
        path: The file, for messages and for images beside it.
        header: The file's JSON.
        meshes: What trimesh made of each primitive of points, lines, triangles or strips, in the file's order.

    Returns:
        The parts.

    Raises:
        FileNotFoundError: If an image is not there (from ``material``).
        SceneFileError: If the file has what is not supported, or does not make sense.

    Warns:
        UserWarning: For spot lights, orthographic cameras, emissive textures, images that do not repeat, blending,
            and primitives of points or lines, all of which are left out.

    Example:
        >>> header = {"nodes": [{"mesh": 0, "scale": [2, 2, 2]}], "scenes": [{"nodes": [0]}], "accessors":
        ...           [{"bufferView": 0, "componentType": 5126}],
        ...           "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}
        >>> gltf_parts(Path("a.gltf"), header, [{"vertices": np.eye(3), "faces": [[0, 1, 2]]}]).vertices[0]
        array([2., 0., 0.])
    """
    surfaces = _surfaces(path, header, meshes)
    decoded: dict[int, Any] = {}
    chunks: list[tuple[Floats, Floats, Floats, Integers]] = []
    slots: list[int] = []
    lights: list[Light] = []
    cameras: list[tuple[Json, Json, Floats]] = []
    first = 0
    for node, world in _nodes(path, header):
        for surface, material in surfaces[node["mesh"]] if "mesh" in node else ():
            vertices, normals, uv, faces = _arrays(path, header, surface, material)
            chunks.append((*_transformed(world, vertices, normals), uv, _wound(world, faces) + first))
            slots.append(material)
            first += len(vertices)
            if material >= 0 and "visual" in surface:
                decoded[material] = surface["visual"].material
        extension = node.get("extensions", {}).get("KHR_lights_punctual")
        if extension is not None:
            light = header["extensions"]["KHR_lights_punctual"]["lights"][extension["light"]]
            lights.extend(light_of(path, light, world))
        if "camera" in node:
            cameras.append((node, header["cameras"][node["camera"]], world))
    camera, views = _views(path, cameras)
    materials = header.get("materials", [])
    if not chunks:
        raise SceneFileError(f"{path}: the scene is empty: no node has a mesh of triangles")
    return SceneParts(
        vertices=np.concatenate([chunk[0] for chunk in chunks]),
        faces=np.concatenate([chunk[3] for chunk in chunks]),
        material_ids=np.repeat(np.array(slots, np.int64) + 1, [len(chunk[3]) for chunk in chunks]),
        names=("default", *(str(material.get("name", f"material {i}")) for i, material in enumerate(materials))),
        material=materials_of(path, header, decoded),
        normals=np.concatenate([chunk[1] for chunk in chunks]),
        uv=np.concatenate([chunk[2] for chunk in chunks]),
        lights=(*lights, *_environment(path, header)),
        camera=camera,
        views=views,
    )


def _surfaces(
    path: Path, header: Json, meshes: Sequence[Mapping[str, Any]]
) -> list[list[tuple[Mapping[str, Any], int]]]:
    """For each mesh, its primitives of triangles with their materials (-1: none)."""
    rest = iter(meshes)
    found: list[list[tuple[Mapping[str, Any], int]]] = []
    for i, mesh in enumerate(header.get("meshes", [])):
        found.append([])
        for j, primitive in enumerate(mesh["primitives"]):
            mode = primitive.get("mode", _TRIANGLES)
            place = f"{path}: mesh {i}, primitive {j}"
            if mode == _FAN:
                raise SceneFileError(f"{place}: triangle fans are not supported")
            if mode not in (_TRIANGLES, _STRIP):
                warnings.warn(f"{place}: points and lines are left out", stacklevel=4)
            surface = next(rest) if mode in (0, 1, _TRIANGLES, _STRIP) else None
            if surface is not None and mode in (_TRIANGLES, _STRIP):
                _require_plain(place, header, primitive)
                found[-1].append(
                    (dict(surface) | {"names": set(primitive["attributes"])}, primitive.get("material", -1))
                )
    return found


def _require_plain(place: str, header: Json, primitive: Json) -> None:
    """Refuses accessors that trimesh would read as zeros, or without the scale of their integers."""
    attributes = primitive["attributes"]
    used = {name: attributes[name] for name in ("POSITION", "NORMAL", "TEXCOORD_0") if name in attributes}
    for name, index in {**used, **{key: primitive[key] for key in ("indices",) if key in primitive}}.items():
        accessor = header["accessors"][index]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise SceneFileError(f"{place}: {name} is sparse or compressed, which is not supported")
        if name != "indices" and accessor["componentType"] != _FLOAT:
            raise SceneFileError(f"{place}: {name} is quantised to integers, which is not supported")


def _nodes(path: Path, header: Json) -> Iterator[tuple[Json, Floats]]:
    """The nodes of the scene, depth first in the file's order, with their transforms to the world."""
    nodes = header.get("nodes", [])
    if "scenes" in header:
        roots = header["scenes"][header.get("scene", 0)].get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    stack = [(root, np.eye(4)) for root in reversed(roots)]
    seen: set[int] = set()
    while stack:
        index, parent = stack.pop()
        if index in seen:
            raise SceneFileError(f"{path}: node {index} is reached twice; nodes must form a tree")
        seen.add(index)
        node = nodes[index]
        world = parent @ _local(node)
        if not np.isfinite(world).all():
            raise SceneFileError(f"{path}: the transform of node {index} is not finite")
        yield node, world
        stack.extend((child, world) for child in reversed(node.get("children", [])))


def _local(node: Json) -> Floats:
    """A node's own transform: its matrix (columns first in the file), or translation * rotation * scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), dtype=np.float64)
    square = x * x + y * y + z * z + w * w
    s = 2 / square if square > 0 else 0.0
    rotation = np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", [1, 1, 1]), dtype=np.float64).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", [0, 0, 0]), dtype=np.float64).reshape(3)
    return matrix


def _arrays(
    path: Path, header: Json, surface: Mapping[str, Any], material: int
) -> tuple[Floats, Floats, Floats, Integers]:
    """A primitive's positions, normals (zero: none), texture coordinates (NaN: none) and faces."""
    vertices = np.asarray(surface["vertices"], dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(surface["faces"]).astype(np.int64).reshape(-1, 3)
    normals = np.zeros_like(vertices)
    uv = np.full((len(vertices), 2), np.nan)
    if "NORMAL" in surface["names"]:
        normals = np.asarray(surface["vertex_normals"], dtype=np.float64)
    if "TEXCOORD_0" in surface["names"] and material >= 0:
        uv = _placed(np.asarray(surface["visual"].uv, dtype=np.float64), placing(header, material))
    if normals.shape != vertices.shape or uv.shape != (len(vertices), 2):
        raise SceneFileError(f"{path}: a primitive's attributes differ in length")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise SceneFileError(f"{path}: a primitive of {len(vertices)} vertices has the index {faces.max()}")
    return vertices, normals, uv, faces


def _placed(uv: Floats, info: Json) -> Floats:
    """Texture coordinates under ``KHR_texture_transform``, whose v points down: v' = 1 - v before and after.

    The rotation is counter-clockwise as seen on the image, as the extension's text and example have it (and the
    Khronos sample viewer); its GLSL excerpt turns the other way.
    """
    transform = info.get("extensions", {}).get("KHR_texture_transform")
    if transform is None:
        return uv
    angle = transform.get("rotation", 0.0)
    c, s = math.cos(angle), math.sin(angle)
    down = np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1) * transform.get("scale", [1, 1])
    down = down @ np.array([[c, -s], [s, c]]) + transform.get("offset", [0, 0])
    return np.stack([down[:, 0], 1 - down[:, 1]], axis=1)


def _transformed(world: Floats, vertices: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Positions under the transform, normals under its inverse transpose up to their length."""
    linear = world[:3, :3]
    a, b, c = linear
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])  # det(M) * inverse(M)^T
    sign = -1.0 if np.linalg.det(linear) < 0 else 1.0
    return vertices @ linear.T + world[:3, 3], sign * normals @ cofactors.T


def _wound(world: Floats, faces: Integers) -> Integers:
    return faces[:, ::-1] if np.linalg.det(world[:3, :3]) < 0 else faces


def _views(
    path: Path, cameras: Sequence[tuple[Json, Json, Floats]]
) -> tuple[StereoCamera | None, dict[str, StereoCamera]]:
    """The scene's own camera, and the others by name; a number is added to a name that is taken."""
    own: StereoCamera | None = None
    views: dict[str, StereoCamera] = {}
    for number, (node, entry, world) in enumerate(cameras):
        camera = camera_of(path, entry, world)
        if camera is None:
            continue
        if own is None and extras_of(entry).get("default", True):
            own = camera
        else:
            name = str(node.get("name", entry.get("name", f"camera {number}")))
            views[name if name not in views else f"{name} {number}"] = camera
    return own, views


def _environment(path: Path, header: Json) -> Iterator[EnvironmentLight]:
    """The environment light that :func:`fovden.tracer.formats.gltf_writer.write_gltf` put into the scene's extras."""
    scenes = header.get("scenes", [])
    found = extras_of(scenes[header.get("scene", 0)]).get("environment") if scenes else None
    if found is not None and "radiance" in found:
        yield EnvironmentLight(tuple(found["radiance"]))
    elif found is not None:
        yield EnvironmentLight(load_image(path.parent / found["file"])[0])
