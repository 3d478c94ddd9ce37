"""glTF and GLB files, written by hand: transforms, materials, lights, cameras, and what is wrong with a file."""

import base64
import copy
import io
import json
import math
import struct
import warnings

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from fovden.tracer.formats.scene_file import SceneFileError
from fovden.tracer.lights import DirectionalLight, PointLight
from fovden.tracer.meshes import load_scene

POSITIONS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
CODES = {"float32": 5126, "uint16": 5123, "uint32": 5125, "uint8": 5121, "int16": 5122}


class Builder:
    """A glTF file in the making: its JSON, and the bytes of its one buffer."""

    def __init__(self):
        self.data = b""
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        self.json |= {"meshes": [{"primitives": []}], "accessors": [], "bufferViews": []}

    def view(self, data):
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.json["bufferViews"].append(view)
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, array, **extra):
        array = np.asarray(array)
        width = array.shape[1] if array.ndim > 1 else 1
        entry = {"bufferView": self.view(array.tobytes()), "componentType": CODES[array.dtype.name]}
        self.json["accessors"].append(entry | {"count": len(array), "type": TYPES[width]} | extra)
        return len(self.json["accessors"]) - 1

    def primitive(self, positions=POSITIONS, indices=None, normals=None, uv=None, mesh=0, **extra):
        attributes = {"POSITION": self.accessor(np.asarray(positions, dtype=np.float32))}
        for key, values in (("NORMAL", normals), ("TEXCOORD_0", uv)):
            if values is not None:
                attributes[key] = self.accessor(np.asarray(values, dtype=np.float32))
        entry = {"attributes": attributes} | extra
        if indices is not None:
            entry["indices"] = self.accessor(np.asarray(indices, dtype=np.uint16))
        self.json["meshes"][mesh]["primitives"].append(entry)
        return self

    def glb(self, path):
        header = copy.deepcopy(self.json) | {"buffers": [{"byteLength": len(self.data)}]}
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        data = self.data + b"\0" * (-len(self.data) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        return path

    def gltf(self, path):
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        path.write_text(json.dumps(self.json | {"buffers": [{"byteLength": len(self.data), "uri": uri}]}))
        return path


def png(pixels):
    stream = io.BytesIO()
    Image.fromarray(np.array(pixels, dtype=np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


FOUR = [[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 0]]]  # red green above blue yellow


def textured(builder, **info):
    builder.json["images"] = [{"bufferView": builder.view(png(FOUR)), "mimeType": "image/png"}]
    builder.json["textures"] = [{"source": 0}]
    builder.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0} | info}}]
    return builder


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_positions_normals_and_faces(tmp_path, ending):
    builder = Builder().primitive(indices=[0, 1, 2, 2, 1, 0], normals=[[0, 0, 2]] * 3)
    scene = load_scene(getattr(builder, ending)(tmp_path / f"a.{ending}"))
    assert scene.name == "a"
    assert scene.vertices.tolist() == POSITIONS.tolist()
    assert scene.faces.tolist() == [[0, 1, 2], [2, 1, 0]]
    assert scene.normals.tolist() == [[0, 0, 1]] * 3
    assert scene.materials.albedo.tolist() == [[1, 1, 1]]  # the default material of glTF


def test_a_file_that_trimesh_wrote(tmp_path):
    box = trimesh.creation.box((1, 2, 3))
    (tmp_path / "box.glb").write_bytes(trimesh.Scene(box).export(file_type="glb"))
    scene = load_scene(tmp_path / "box.glb")
    np.testing.assert_array_equal(scene.vertices.numpy()[scene.faces], box.vertices[box.faces].astype(np.float32))


def test_primitives_without_indices_strips_and_materials_in_order(tmp_path):
    builder = Builder()
    builder.json["materials"] = [
        {"name": "red", "pbrMetallicRoughness": {"baseColorFactor": [0.043014, 0.1, 0.2, 0.5]}},
        {"name": "lamp", "emissiveFactor": [1, 0.5, 0.25]},
    ]
    builder.json["materials"][1]["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 18.387}}
    square = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    builder.primitive(material=1).primitive(square, mode=5, material=0).primitive(square, indices=[0, 1, 2])
    scene = load_scene(builder.glb(tmp_path / "a.glb"))
    assert scene.materials.names == ("lamp", "red", "default")
    assert scene.material_ids.tolist() == [0, 1, 1, 2]
    assert scene.faces[0].tolist() == [0, 1, 2]
    # Both triangles of the strip face +z, as does the first.
    corners = scene.vertices[scene.faces.long()]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert normals.tolist() == [[0, 0, 1]] * 4
    assert {tuple(sorted(face)) for face in scene.faces[1:3].tolist()} == {(3, 4, 5), (4, 5, 6)}
    assert scene.materials.albedo[1].tolist() == torch.tensor([0.043014, 0.1, 0.2]).tolist()
    assert scene.materials.emission[0].tolist() == torch.tensor([18.387, 18.387 / 2, 18.387 / 4]).tolist()


def test_materials_are_numbered_by_their_first_face(tmp_path):
    builder = Builder()
    builder.json["materials"] = [{"name": name} for name in "abc"]
    for material in (2, 0, 1, 0, 2):
        builder.primitive(material=material)
    scene = load_scene(builder.glb(tmp_path / "a.glb"))
    assert scene.materials.names == ("c", "a", "b")
    assert scene.material_ids.tolist() == [0, 1, 2, 1, 0]


def test_instances_and_nested_transforms(tmp_path):
    builder = Builder().primitive(normals=[[0, 0, 1]] * 3)
    half = math.sqrt(0.5)
    builder.json["scenes"][0]["nodes"] = [0, 3]
    builder.json["nodes"] = [
        {"translation": [10, 0, 0], "children": [1, 2]},
        {"mesh": 0, "rotation": [0, half, 0, half], "scale": [2, 3, 4]},  # 90 degrees about y: x to -z
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1]},  # columns first: y + 5
        {"mesh": 0},
    ]
    scene = load_scene(builder.glb(tmp_path / "a.glb"))
    expected = [[10, 0, 0], [10, 0, -2], [10, 3, 0], [10, 5, 0], [11, 5, 0], [10, 6, 0], *POSITIONS.tolist()]
    torch.testing.assert_close(scene.vertices, torch.tensor(expected).float(), rtol=0, atol=2e-6)
    assert scene.faces.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    torch.testing.assert_close(scene.normals[::3], torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, 0, 1]]))


def test_normals_take_the_inverse_transpose_and_mirrors_turn_the_winding(tmp_path):
    # The plane x + z = 0 under scale (-2, 1, 1) is x = 2 z, whose normals are (1, 0, -2) and (-1, 0, 2); the side
    # of (1, 0, 1) becomes that of (-1, 0, 2).
    positions, half = [[0, 0, 0], [1, 0, -1], [0, 1, 0]], math.sqrt(0.5)
    builder = Builder().primitive(positions, normals=[[half, 0, half]] * 3)
    builder.json["nodes"][0]["scale"] = [-2, 1, 1]
    scene = load_scene(builder.glb(tmp_path / "a.glb"))
    expected = torch.tensor([-1.0, 0, 2]) / math.sqrt(5)
    torch.testing.assert_close(scene.normals, expected.expand(3, 3))
    a, b, c = scene.vertices[scene.faces[0].long()]
    geometric = torch.linalg.cross(b - a, c - a)
    torch.testing.assert_close(geometric / geometric.norm(), expected)


def test_the_texture_lands_upright(tmp_path):
    builder = textured(Builder())
    builder.primitive(uv=[[0, 0], [1, 0], [0, 1]], material=0)  # glTF: v points down
    scene = load_scene(builder.glb(tmp_path / "a.glb"))
    assert scene.materials.textures[0].tolist() == FOUR
    assert scene.uv.tolist() == [[0, 1], [1, 1], [0, 0]]  # upper left, upper right, lower left of the image


def test_texture_transforms(tmp_path):
    # The extension's own example: the lower left quadrant, turned by 90 degrees. The image's lower left quadrant is
    # u in [0, 0.5] and, upwards, v in [0, 0.5].
    transform = {"offset": [0, 1], "rotation": math.pi / 2, "scale": [0.5, 0.5]}
    builder = textured(Builder(), extensions={"KHR_texture_transform": transform})
    builder.primitive(uv=[[0, 0], [1, 0], [0, 1]], material=0)
    scene = load_scene(builder.glb(tmp_path / "a.glb"))
    expected = torch.tensor([[0, 0], [0, 0.5], [0.5, 0]])
    torch.testing.assert_close(scene.uv, expected, rtol=0, atol=1e-6)


def test_images_beside_the_file_and_in_the_text(tmp_path):
    folder = tmp_path / "my images"
    folder.mkdir()
    (folder / "four.png").write_bytes(png(FOUR))
    data = "data:image/png;base64," + base64.b64encode(png(FOUR)).decode()
    for uri in ("my%20images/four.png", data):
        builder = textured(Builder())
        builder.json["images"] = [{"uri": uri}]
        builder.json["materials"].append(builder.json["materials"][0])
        builder.primitive(uv=np.zeros((3, 2)), material=0).primitive(uv=np.zeros((3, 2)), material=1)
        materials = load_scene(builder.gltf(tmp_path / "a.gltf")).materials
        assert materials.texture.tolist() == [0, 0]  # two materials, one image
        assert materials.textures[0].tolist() == FOUR


def test_lights(tmp_path):
    builder = Builder().primitive()
    lights = [
        {"type": "point", "color": [1, 0.5, 0], "intensity": 40},
        {"type": "directional", "intensity": 12},
        {"type": "spot", "name": "torch", "spot": {}},
        {"type": "point"},
    ]
    builder.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    builder.json["scenes"][0]["nodes"] = [0, 1]
    half = math.sqrt(0.5)
    uses = [{"extensions": {"KHR_lights_punctual": {"light": i}}} for i in range(4)]
    uses[1]["rotation"] = [-half, 0, 0, half]  # -90 degrees about x: -z to -y
    builder.json["nodes"] += [{"translation": [1, 2, 3], "children": [2, 3, 4, 5]}, *uses]
    path = builder.glb(tmp_path / "a.glb")
    with pytest.warns(UserWarning, match="the spot light 'torch' is left out"):
        scene = load_scene(path, lights=[PointLight((9, 9, 9), 1)])
    first, second, third, fourth = scene.lights
    assert first == PointLight((1, 2, 3), (40, 20, 0))
    assert isinstance(second, DirectionalLight)
    np.testing.assert_allclose(second.direction, (0, -1, 0), atol=1e-12)
    assert second.irradiance == (12, 12, 12)
    assert third == PointLight((1, 2, 3), 1)
    assert fourth == PointLight((9, 9, 9), 1)


def test_the_first_perspective_camera_is_the_view(tmp_path):
    builder = Builder().primitive()
    builder.json["cameras"] = [
        {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 10}},
        {"type": "perspective", "perspective": {"yfov": math.radians(40), "znear": 0.1}},
    ]
    half = math.sqrt(0.5)
    turned = {"camera": 1, "rotation": [0, -half, 0, half], "mesh": 0, "children": [3]}  # -90 about y: -z to +x
    builder.json["nodes"] += [{"translation": [0, 1, 0], "scale": [2, 2, 2], "children": [2]}, turned, {"mesh": 0}]
    builder.json["nodes"].append({"camera": 0})
    builder.json["scenes"][0]["nodes"] = [4, 0, 1]
    with pytest.warns(UserWarning, match="the orthographic camera is left out"):
        scene = load_scene(builder.glb(tmp_path / "a.glb"))
    assert scene.triangle_count == 3  # a camera's node keeps its mesh and its children
    assert scene.camera.eye == (0, 1, 0)
    np.testing.assert_allclose(np.subtract(scene.camera.target, scene.camera.eye), (1, 0, 0), atol=1e-12)
    assert scene.camera.fov_y_deg == pytest.approx(40)
    with pytest.warns(UserWarning, match="orthographic"):
        given = load_scene(tmp_path / "a.glb", camera=scene.camera.at((8, 8))).camera
    assert given.resolution == (8, 8)


def test_further_cameras_are_views_by_name(tmp_path):
    builder = Builder().primitive()
    lens = {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}
    builder.json["cameras"] = [lens, lens | {"extras": "of another program"}, lens | {"name": "lens"}]
    nodes = [{"camera": 0}, {"camera": 1, "name": "door"}, {"camera": 2}, {"camera": 1, "name": "door"}, {"camera": 0}]
    builder.json["nodes"] += [node | {"translation": [i, 0, 0]} for i, node in enumerate(nodes)]
    builder.json["scenes"] = [{"nodes": list(range(6)), "extras": ["of another program"]}]
    scene = load_scene(builder.glb(tmp_path / "a.glb"))
    assert scene.camera.eye == (0, 0, 0)
    assert {name: view.eye[0] for name, view in scene.views.items()} == {
        "door": 1,
        "lens": 2,
        "door 3": 3,
        "camera 4": 4,
    }


def test_what_is_left_out_warns(tmp_path):
    builder = textured(Builder())
    material = builder.json["materials"][0] | {"emissiveTexture": {"index": 0}, "emissiveFactor": [1, 2, 3]}
    builder.json["materials"] = [material | {"extensions": {"KHR_materials_unlit": {}}}]
    builder.json["samplers"] = [{"wrapS": 33071}]
    builder.json["textures"][0]["sampler"] = 0
    builder.primitive(mode=0).primitive(mode=1).primitive(material=0)
    with pytest.warns(UserWarning, match=r"a\.glb") as record:
        scene = load_scene(builder.glb(tmp_path / "a.glb"))
    messages = " ".join(str(warning.message) for warning in record)
    for expected in (
        "points and lines",
        "emissive image",
        "KHR_materials_unlit",
        "does not repeat",
        "no texture coord",
    ):
        assert expected in messages
    assert scene.triangle_count == 1
    assert scene.materials.emission.tolist() == [[1, 2, 3]]


def change(**entries):
    return lambda builder: builder.json.update(entries)


def at(*keys, value):
    def apply(builder):
        place = builder.json
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    return apply


def glow(strength):
    extensions = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
    return lambda builder: builder.json["materials"][0].update(emissiveFactor=[1, 1, 1], extensions=extensions)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (change(asset={"version": "1.0"}), "expected glTF version 2, got 1.0"),
        (change(asset={}), "not a complete glTF file"),
        (change(extensionsRequired=["KHR_draco_mesh_compression"]), "not supported: KHR_draco_mesh_compression"),
        (change(nodes=[{"mesh": 0, "children": [0]}]), "node 0 is reached twice"),
        (change(nodes=[{}]), "the scene is empty: no node has a mesh of triangles"),
        (change(nodes=[]), r"a\.gltf"),
        (change(scenes=[{"nodes": [7]}]), r"a\.gltf"),
        (change(nodes=[{"mesh": 3}]), r"a\.gltf"),
        (change(nodes=[{"mesh": 0, "scale": [1e400, 1, 1]}]), "the transform of node 0 is not finite"),
        (change(nodes=[{"mesh": 0, "scale": [1e300, 1, 1]}]), "vertex 2 of 3 is not finite"),
        (at("meshes", 0, "primitives", 0, "mode", value=6), "triangle fans are not supported"),
        (at("meshes", 0, "primitives", 0, "material", value=4), r"a\.gltf"),
        (at("accessors", 0, "sparse", value={"count": 0}), "POSITION is sparse or compressed"),
        (at("accessors", 0, "componentType", value=5122), r"a\.gltf"),
        (at("accessors", 0, "count", value=10**6), r"a\.gltf"),
        (at("accessors", 0, "count", value=2), "a primitive's attributes differ in length"),
        (at("bufferViews", 0, "byteLength", value=10**6), r"a\.gltf"),
        (at("materials", 0, "pbrMetallicRoughness", "baseColorFactor", value=[2, 0, 0, 1]), "reflectances from 0 to 1"),
        (at("materials", 0, "emissiveFactor", value=[-1, 0, 0]), r"a\.gltf"),
        (glow(-1), "radiances of at least 0"),
        (glow(1e400), "radiances of at least 0"),
        (at("materials", 0, "pbrMetallicRoughness", "baseColorTexture", "texCoord", value=1), "only the first set"),
        (at("images", 0, "bufferView", value=1), "the embedded image 0 cannot be decoded"),
        (change(textures=[{}]), "texture 0 has no image"),
    ],
)
def test_each_fault_is_one_clear_error(tmp_path, fault, message):
    builder = textured(Builder()).primitive(indices=[0, 1, 2], uv=np.zeros((3, 2)), material=0)
    load_scene(builder.gltf(tmp_path / "a.gltf"))
    fault(builder)
    path = builder.gltf(tmp_path / "a.gltf")
    with pytest.raises(SceneFileError, match=message) as raised:
        load_scene(path)
    assert "a.gltf" in str(raised.value)


def test_numbers_that_are_not_finite_and_integers_without_their_scale(tmp_path):
    broken = POSITIONS.copy()
    broken[1, 2] = np.nan
    with pytest.raises(SceneFileError, match="vertex 2 of 3 is not finite"):
        load_scene(Builder().primitive(broken).glb(tmp_path / "a.glb"))
    with pytest.raises(SceneFileError, match="a normal is not finite"):
        load_scene(Builder().primitive(normals=broken).glb(tmp_path / "a.glb"))
    builder = textured(Builder())
    with pytest.raises(SceneFileError, match="a texture coordinate is not finite"):
        load_scene(builder.primitive(uv=[[np.inf, 0]] * 3, material=0).glb(tmp_path / "a.glb"))
    builder = textured(Builder()).primitive(uv=[[0, 0]] * 3, material=0)
    attributes = builder.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["TEXCOORD_0"] = builder.accessor(np.zeros((3, 2), np.uint16), normalized=True)
    with pytest.raises(SceneFileError, match="TEXCOORD_0 is quantised to integers"):
        load_scene(builder.glb(tmp_path / "a.glb"))


def test_an_index_out_of_range(tmp_path):
    with pytest.raises(SceneFileError, match=r"a\.glb: a primitive of 3 vertices has the index 3"):
        load_scene(Builder().primitive(indices=[0, 1, 3]).glb(tmp_path / "a.glb"))


def test_a_buffer_beside_the_file(tmp_path):
    builder = Builder().primitive()
    (tmp_path / "my data.bin").write_bytes(builder.data)
    header = builder.json | {"buffers": [{"byteLength": 36, "uri": "my%20data.bin"}]}
    (tmp_path / "a.gltf").write_text(json.dumps(header))
    assert load_scene(tmp_path / "a.gltf").vertices.tolist() == POSITIONS.tolist()


def test_files_that_are_not_there(tmp_path):
    builder = textured(Builder()).primitive(uv=[[0, 0]] * 3, material=0)
    builder.json["images"] = [{"uri": "lost.png"}]
    with pytest.raises(FileNotFoundError, match=r"a\.glb: image 0 \('lost\.png'\) is not there"):
        load_scene(builder.glb(tmp_path / "a.glb"))
    header = Builder().primitive().json | {"buffers": [{"byteLength": 36, "uri": "lost.bin"}]}
    (tmp_path / "a.gltf").write_text(json.dumps(header))
    with pytest.raises(FileNotFoundError, match=r"a\.gltf.*lost\.bin"):
        load_scene(tmp_path / "a.gltf")


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_a_file_cut_off_anywhere_is_one_clear_error(tmp_path, ending):
    builder = textured(Builder()).primitive(indices=[0, 1, 2], uv=np.zeros((3, 2)), material=0)
    path = getattr(builder, ending)(tmp_path / f"a.{ending}")
    whole = path.read_bytes()
    for length in [*range(40), *range(40, len(whole), 37), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(SceneFileError, match=rf"a\.{ending}"):
            load_scene(path)


def test_noise_never_raises_anything_else(tmp_path):
    builder = textured(Builder()).primitive(indices=[0, 1, 2], uv=np.zeros((3, 2)), material=0)
    path = builder.glb(tmp_path / "a.glb")
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    errors = 0
    for _ in range(200):
        noisy = bytearray(whole)
        for place in random.integers(0, len(whole), 3):
            noisy[place] = random.integers(0, 256)
        path.write_bytes(noisy)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                load_scene(path)
            except (SceneFileError, FileNotFoundError):
                errors += 1
    assert 0 < errors < 200
