"""Exported glTF files by the rules of the format, and as trimesh sees them."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from export_files import areas, glb_chunks
from test_export import CAMERA, LIGHTS, VIEWS, order, used_materials, varied

from fovden.tracer.formats.gltf_writer import _glb_start

NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
FORMATS = {5126: "<f4", 5125: "<u4"}


@pytest.fixture(scope="module")
def scene():
    return varied()


@pytest.fixture(scope="module")
def path(scene, tmp_path_factory):
    return scene.export(tmp_path_factory.mktemp("out") / "varied.glb")[0]


@pytest.fixture(scope="module")
def file(path):
    """The JSON, and a function that reads an accessor."""
    header, data = glb_chunks(path)

    def read(number):
        accessor = header["accessors"][number]
        view = header["bufferViews"][accessor["bufferView"]]
        raw = data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(raw, FORMATS[accessor["componentType"]]).reshape(-1, NUMBERS[accessor["type"]])

    return header, read


def test_views_fill_the_buffer_one_after_the_other_at_multiples_of_four(file, path):
    header, _ = file
    views = header["bufferViews"]
    assert all(view["byteOffset"] % 4 == 0 for view in views)
    ends = [view["byteOffset"] + view["byteLength"] for view in views]
    assert all(0 <= view["byteOffset"] - end < 4 for end, (_, view) in zip(ends, pairwise(views), strict=False))
    assert 0 <= header["buffers"][0]["byteLength"] - ends[-1] < 4
    assert header["buffers"][0]["byteLength"] == len(glb_chunks(path)[1])


def test_accessors_are_what_the_format_wants(file):
    header, read = file
    for primitive in header["meshes"][0]["primitives"]:
        positions, normals = (read(primitive["attributes"][name]) for name in ("POSITION", "NORMAL"))
        indices = read(primitive["indices"])
        accessor = header["accessors"][primitive["attributes"]["POSITION"]]
        assert accessor["min"] == positions.min(0).tolist()
        assert accessor["max"] == positions.max(0).tolist()
        assert accessor["count"] == len(positions) == len(normals)
        assert np.unique(indices).tolist() == list(range(len(positions)))  # every vertex is used, none is missing
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-6)
        targets = {"indices": 34963, **dict.fromkeys(primitive["attributes"], 34962)}
        for name, number in {"indices": primitive["indices"], **primitive["attributes"]}.items():
            entry = header["accessors"][number]
            assert header["bufferViews"][entry["bufferView"]]["target"] == targets[name]
            assert entry["componentType"] == (5125 if name == "indices" else 5126)
            assert len(read(number)) == entry["count"]


def test_numbers_refer_to_what_is_there(file):
    header, _ = file
    nodes, lights = header["nodes"], header["extensions"]["KHR_lights_punctual"]["lights"]
    assert header["scenes"][header["scene"]] == {"name": "varied", "nodes": list(range(len(nodes)))}
    assert (
        [node["camera"] for node in nodes if "camera" in node] == list(range(3)) == list(range(len(header["cameras"])))
    )
    numbers = [node["extensions"]["KHR_lights_punctual"]["light"] for node in nodes if "extensions" in node]
    assert numbers == list(range(len(LIGHTS))) == list(range(len(lights)))
    assert header["extensionsUsed"] == ["KHR_lights_punctual", "KHR_materials_emissive_strength"]
    textures = [m["pbrMetallicRoughness"].get("baseColorTexture", {"index": 0})["index"] for m in header["materials"]]
    assert max(textures) < len(header["textures"]) == len(header["images"]) == 2
    assert all(header["bufferViews"][image["bufferView"]]["byteLength"] > 0 for image in header["images"])


def test_factors_stay_in_their_ranges(file):
    header, _ = file
    strengths = {}
    for material in header["materials"]:
        factor = material.get("emissiveFactor", [0, 0, 0])
        assert all(0 <= value <= 1 for value in [*material["pbrMetallicRoughness"]["baseColorFactor"], *factor])
        extension = material.get("extensions", {}).get("KHR_materials_emissive_strength", {})
        strengths[material["name"]] = extension.get("emissiveStrength")
    assert strengths == {"крас#ный": None, "stone wall": None, "lamp <b>&amp;": 17.1, "": None}
    for light in header["extensions"]["KHR_lights_punctual"]["lights"]:
        assert max(light["color"]) == 1


def test_nodes_stand_where_the_scene_has_them(file):
    header, _ = file
    for node in header["nodes"]:
        if "matrix" in node:
            matrix = np.array(node["matrix"]).reshape(4, 4).T
            np.testing.assert_allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-14)
            assert np.linalg.det(matrix) == pytest.approx(1)
    cameras = [node for node in header["nodes"] if "camera" in node]
    assert [node["name"] for node in cameras] == ["camera", *VIEWS]
    for node, camera in zip(cameras, (CAMERA, *VIEWS.values()), strict=True):
        matrix = np.array(node["matrix"]).reshape(4, 4).T
        assert matrix[:3, 3].tolist() == list(camera.eye)
        local = np.linalg.inv(matrix) @ [*camera.target, 1]
        distance = math.dist(camera.eye, camera.target)
        np.testing.assert_allclose(local, [0, 0, -distance, 1], atol=1e-12)
        entry = header["cameras"][node["camera"]]
        assert entry["extras"]["fovden"]["target_distance"] == distance
        height, width = camera.resolution
        assert entry["perspective"]["aspectRatio"] == width / height
        left, right, bottom, top = camera.views.bounds[0].tolist()
        assert math.tan(entry["perspective"]["yfov"] / 2) == pytest.approx((top - bottom) / 2, rel=1e-6)
        assert entry["perspective"]["aspectRatio"] == pytest.approx((right - left) / (top - bottom), rel=1e-6)
    lights = [node for node in header["nodes"] if "extensions" in node]
    for node, light in zip(lights, LIGHTS, strict=True):
        if "translation" in node:
            assert node["translation"] == list(light.position)
        else:
            backward = np.array(node["matrix"]).reshape(4, 4)[2, :3]
            np.testing.assert_allclose(backward, np.negative(light.direction), atol=1e-15)


def test_trimesh_sees_the_same_areas_and_images(path, scene):
    loaded = trimesh.load_scene(path, process=False)
    corners = scene.vertices.double().numpy()[scene.faces.numpy()]
    ids = scene.material_ids.numpy()
    assert len(loaded.geometry) == len(used_materials(scene)) == 5
    for mesh, material in zip(loaded.geometry.values(), used_materials(scene), strict=True):
        assert mesh.visual.material.name == scene.materials.names[material]
        expected = np.sort(areas(corners[ids == material]))
        np.testing.assert_allclose(np.sort(mesh.area_faces), expected, rtol=1e-6, atol=1e-12)
        texture = int(scene.materials.texture[material])
        image = mesh.visual.material.baseColorTexture
        assert (image is not None) == (texture >= 0)
        if image is not None:
            np.testing.assert_array_equal(np.asarray(image), scene.materials.textures[texture].numpy())
            uv = scene.uv.numpy()[scene.faces.numpy()][ids == material]
            np.testing.assert_allclose(mesh.visual.uv[mesh.faces], uv, rtol=0, atol=3e-7 * max(1, np.abs(uv).max()))
    whole = np.concatenate([mesh.triangles for mesh in loaded.geometry.values()])
    np.testing.assert_array_equal(whole.astype(np.float32), corners[order(scene)].astype(np.float32))


def test_trimesh_sees_the_cameras_field_of_view(scene, tmp_path):
    """The vertical one: for the horizontal one trimesh multiplies the angle by the aspect ratio."""
    height, width = CAMERA.resolution
    fov_y = 2 * math.degrees(math.atan(math.tan(math.radians(CAMERA.fov_x_deg) / 2) * height / width))
    (path,) = replace(scene, views={}).export(tmp_path / "one.glb")
    assert trimesh.load_scene(path).camera.fov[1] == pytest.approx(fov_y, rel=1e-9)


def test_a_gltf_file_holds_the_same_as_a_glb_file(file, scene, tmp_path):
    buffer, path = scene.export(tmp_path / "wide world.gltf")
    header = json.loads(path.read_text(encoding="utf-8"))
    assert header["buffers"][0].pop("uri") == "wide%20world.bin"
    assert header == file[0]
    assert buffer.stat().st_size == header["buffers"][0]["byteLength"]


def test_a_glb_file_cannot_exceed_four_gibibytes(path):
    _glb_start(path, {}, 2**32 - 100)
    with pytest.raises(ValueError, match="expected a scene of at most 4 GiB"):
        _glb_start(path, {}, 2**32)
