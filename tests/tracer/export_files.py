"""Exported files as other programs see them, read with json, struct, Pillow and trimesh: never with our own readers."""

import json
import struct
from typing import NamedTuple

import numpy as np
import trimesh
from PIL import Image


class Part(NamedTuple):
    """Triangles of one material, either all with shading normals or all without."""

    name: str
    vertices: np.ndarray  # (m, 3, 3)
    normals: np.ndarray | None  # (m, 3, 3)
    uv: np.ndarray | None  # (m, 3, 2); (0, 0) is the image's lower left corner
    albedo: list
    emission: list
    image: Image.Image | None


def glb_chunks(path):
    """The JSON and the binary chunk of a GLB file, after its layout has been checked (glTF 2.0, 4.4)."""
    data = path.read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sIIII", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), 0x4E4F534A)
    assert length % 4 == 0
    size, kind = struct.unpack_from("<II", data, 20 + length)
    assert (kind, size % 4, 28 + length + size) == (0x004E4942, 0, total)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def glb_parts(path):
    """Geometry and images through trimesh; factors, which it rounds to eight bits, from the JSON."""
    header, _ = glb_chunks(path)
    loaded = trimesh.load_scene(path, process=False)
    primitives = header["meshes"][0]["primitives"]
    assert len(primitives) == len(loaded.geometry)
    parts = []
    for primitive, mesh in zip(primitives, loaded.geometry.values(), strict=True):
        material = header["materials"][primitive["material"]]
        surface = material["pbrMetallicRoughness"]
        assert (surface["metallicFactor"], surface["roughnessFactor"], material["doubleSided"]) == (0, 1, True)
        strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)
        mapped = "TEXCOORD_0" in primitive["attributes"]
        parts.append(
            Part(
                material["name"],
                np.asarray(mesh.vertices)[mesh.faces],
                np.asarray(mesh.vertex_normals)[mesh.faces],
                np.asarray(mesh.visual.uv)[mesh.faces] if mapped else None,
                surface["baseColorFactor"][:3],
                [strength * value for value in material.get("emissiveFactor", [0, 0, 0])],
                mesh.visual.material.baseColorTexture if "baseColorTexture" in surface else None,
            )
        )
    return parts


def mtl_materials(path):
    """Statements by material and keyword."""
    materials = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        key, _, text = line.partition(" ")
        if key == "newmtl":
            current = materials[text] = {}
        elif key:
            current[key] = text
    return materials


def obj_parts(path):
    """A reader of just what the writer says it writes."""
    lines = path.read_text(encoding="utf-8").splitlines()
    library = next(line for line in lines if line.startswith("mtllib ")).removeprefix("mtllib ")
    materials = mtl_materials(path.parent / library)
    tables = {}
    for key, width in (("v", 3), ("vt", 2), ("vn", 3)):
        rows = " ".join([line[len(key) :] for line in lines if line.startswith(key + " ")])
        tables[key] = np.array(rows.split(), dtype=np.float64).reshape(-1, width)
    groups = {}
    for line in lines:
        if line.startswith("usemtl "):
            name = line.removeprefix("usemtl ")
            assert name not in [known[0] for known in groups], "one run per material"
        elif line.startswith("f "):
            first = line[2 : line.index(" ", 2)]
            groups.setdefault((name, first.count("/"), "//" in first), []).append(line[2:])
    parts = []
    for (name, slashes, adjacent), faces in groups.items():
        mapped, smooth = slashes > 0 and not adjacent, slashes == 2
        numbers = np.array(" ".join(faces).replace("//", "/").replace("/", " ").split(), dtype=np.int64) - 1
        numbers = numbers.reshape(len(faces), 3, 1 + mapped + smooth)
        image = materials[name].get("map_Kd")
        parts.append(
            Part(
                name,
                tables["v"][numbers[..., 0]],
                tables["vn"][numbers[..., -1]] if smooth else None,
                tables["vt"][numbers[..., 1]] if mapped else None,
                [float(x) for x in materials[name]["Kd"].split()],
                [float(x) for x in materials[name].get("Ke", "0 0 0").split()],
                picture(path.parent / image) if image else None,
            )
        )
    return parts


def picture(path):
    with Image.open(path) as image:
        return image.convert("RGB")


def areas(triangles):
    """Areas of triangles, shape (m, 3, 3)."""
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
