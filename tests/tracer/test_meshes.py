"""Loading in general, PLY files, and the real scenes against independent counts of their text."""

import re
import struct
import time
import warnings
from collections import Counter

import numpy as np
import pytest
import torch
import trimesh

from fovden.camera import StereoCamera
from fovden.tracer.formats.scene_file import SceneFileError
from fovden.tracer.lights import PointLight
from fovden.tracer.meshes import load_scene

TEXT_PLY = """ply
format ascii 1.0
comment by hand
element vertex 5
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
element face 3
property uchar flags
property list uchar int vertex_indices
end_header
0 0 0 0 0 2 255
1 0 0 0 0 1 255
1 1 0 0 0 1 255
0 1 0 0 0 1 255
-1 0.5 0 0 0 1 255
7 4 0 1 2 3
7 3 0 3 4
7 5 0 1 2 3 4
"""


def binary_ply(order, polygons, extra=b""):
    header = f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\nelement vertex 4\n"
    header += "property float x\nproperty double y\nproperty float z\n"
    header += f"element face {len(polygons)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [struct.pack(order + "fdf", x, y, 0) for x, y in [(0, 0), (1, 0), (1, 1), (0, 1)]]
    rows += [struct.pack(f"{order}B{len(p)}i", len(p), *p) for p in polygons]
    return header.encode() + b"".join(rows) + extra


def write(folder, data, name="a.ply"):
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def test_text_ply_with_mixed_polygons_keeps_their_order(tmp_path):
    scene = load_scene(write(tmp_path, TEXT_PLY))
    assert scene.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 0.5, 0]]
    assert scene.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert scene.normals.tolist() == [[0, 0, 1]] * 5
    assert scene.materials.names == ("default",)
    assert scene.materials.albedo.tolist() == [[0.5, 0.5, 0.5]]


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply_of_triangles_and_of_quads(tmp_path, order):
    scene = load_scene(write(tmp_path, binary_ply(order, [(0, 1, 2), (0, 2, 3), (1, 1, 2)])))
    assert scene.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert scene.faces.tolist() == [[0, 1, 2], [0, 2, 3], [1, 1, 2]]
    assert scene.normals.tolist() == [[0, 0, 0]] * 4
    scene = load_scene(write(tmp_path, binary_ply(order, [(0, 1, 2, 3), (3, 2, 1, 0)])))
    assert scene.faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 1], [3, 1, 0]]


def test_a_ply_that_trimesh_wrote(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=2)
    for encoding in ("ascii", "binary"):
        data = sphere.export(file_type="ply", encoding=encoding, vertex_normal=True)
        scene = load_scene(write(tmp_path, data))
        np.testing.assert_array_equal(scene.faces.numpy(), sphere.faces)
        np.testing.assert_allclose(scene.vertices.numpy(), sphere.vertices, atol=1e-7)
        np.testing.assert_allclose(scene.normals.numpy(), sphere.vertex_normals, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("7 3 0 3 4", "7 3 0 3 9", "the faces refer to vertices 0 to 9, but there are 5"),
        ("7 3 0 3 4", "7 3 0 3 -1", "the faces refer to vertices -1 to 4"),
        ("7 3 0 3 4", "7 2 0 3", "face 2 has fewer than 3 corners"),
        ("7 3 0 3 4", "7 4 0 3 4", "face 2 announces 4 corners and has 3"),
        ("1 1 0 0 0 1", "1 nan 0 0 0 1", r"vertex 3 of 5 is not finite: \(1.0, nan, 0.0\)"),
        ("1 1 0 0 0 1", "1 1 0 0 0 inf", "a normal is not finite"),
        ("1 1 0 0 0 1", "1 x 0 0 0 1", r"a\.ply"),
        ("1 1 0 0 0 1", "1 1 0", r"a\.ply"),
        ("element face 3", "element face 4", "expected 4 faces, got 3"),
        ("element face 3", "element face 0", "the file has no faces"),
        ("list uchar int vertex_indices", "list uchar int edges", r"a\.ply"),
        ("property float x", "property quad x", r"a\.ply"),
        ("property float x", "property float w", r"a\.ply"),
        ("element vertex 5", "element vertex 0", r"a\.ply"),
        ("ply\n", "plx\n", r"a\.ply"),
    ],
)
def test_each_fault_of_a_ply_is_one_clear_error(tmp_path, old, new, message):
    assert old in TEXT_PLY
    with pytest.raises(SceneFileError, match=message) as raised:
        load_scene(write(tmp_path, TEXT_PLY.replace(old, new, 1)))
    assert "a.ply" in str(raised.value)


def test_binary_polygons_of_different_sizes_are_refused(tmp_path):
    with pytest.raises(SceneFileError, match=r"a\.ply"):
        load_scene(write(tmp_path, binary_ply("<", [(0, 1, 2), (0, 1, 2, 3)])))
    # 4 + 3 + 5 corners: as many bytes as three quads.
    with pytest.raises(SceneFileError, match="polygons of different sizes in a binary file"):
        load_scene(write(tmp_path, binary_ply("<", [(0, 1, 2, 3), (0, 1, 2), (0, 1, 2, 3, 0)])))


@pytest.mark.parametrize("data", [TEXT_PLY.encode(), binary_ply("<", [(0, 1, 2), (0, 2, 3)])], ids=["text", "binary"])
def test_a_ply_cut_off_anywhere_is_one_clear_error(tmp_path, data):
    end = len(data.rstrip()) if data.startswith(b"ply\nformat ascii") else len(data)
    for length in range(0, end - 1, 3):  # one byte less than all of it is still whole for the text: "4" of "4\n"
        with pytest.raises(SceneFileError, match=r"a\.ply"):
            load_scene(write(tmp_path, data[:length]))


def test_names_lights_and_camera(tmp_path):
    camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 4))
    path = str(write(tmp_path, TEXT_PLY, "My Part.PLY"))
    scene = load_scene(path, lights=[PointLight((0, 0, 1), 3)], camera=camera)
    assert scene.name == "My Part"
    assert scene.lights == (PointLight((0, 0, 1), 3),)
    assert scene.camera is camera
    assert load_scene(path, name="part").name == "part"
    assert load_scene(path).camera is None


def test_skipped_materials(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib a.mtl\n"
    for name in ("Glass", "window_GLASS.1", "wall", "floor"):
        text += f"usemtl {name}\nf 1 2 3\n"
    write(tmp_path, "newmtl wall\nnewmtl floor\n", "a.mtl")
    path = write(tmp_path, text, "a.obj")
    assert load_scene(path, skip_materials=["*glass*"]).materials.names == ("wall", "floor")
    scene = load_scene(path, skip_materials=["*glass*", "w?ll"])
    assert scene.materials.names == ("floor",)
    assert scene.triangle_count == 1
    assert len(scene.vertices) == 3
    with pytest.raises(SceneFileError, match=r"a\.obj: the scene is empty: skip_materials=\['\*'\] leaves no face"):
        load_scene(path, skip_materials=["*"])


def test_paths_that_name_no_scene(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"lost\.obj: there is no such file"):
        load_scene(tmp_path / "lost.obj")
    with pytest.raises(SceneFileError, match=r"a\.stl: expected a file that ends in \.obj, \.gltf, \.glb, \.ply"):
        load_scene(tmp_path / "a.stl")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(FileNotFoundError, match=r"folder\.obj"):
        load_scene(tmp_path / "folder.obj")
    for ending in ("obj", "gltf", "glb", "ply"):
        with pytest.raises(SceneFileError, match=rf"a\.{ending}"):
            load_scene(write(tmp_path, b"", f"a.{ending}"))
        noise = np.random.default_rng(1).integers(0, 256, 500, dtype=np.uint8).tobytes()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with pytest.raises(SceneFileError, match=rf"a\.{ending}"):
                load_scene(write(tmp_path, noise, f"a.{ending}"))


def counted(path):
    """Triangles per material, counted line by line."""
    count, current = Counter(), None
    for line in path.read_text().splitlines():
        if line.startswith("usemtl "):
            current = line[7:]
        elif line.startswith("f "):
            count[current] += 1
    return count


@pytest.mark.parametrize(
    ("file", "triangles", "vertices", "emissive", "textures"),
    [
        ("cornell_box/scene.obj", 38, 76, 2, 0),
        ("modern_hall/scene.obj", 31247, 21607, 336, 3),
        ("sponza/sponza.obj", 262267, 192870, 0, 24),
    ],
)
def test_real_scenes_have_every_face_of_their_text(shared_scenes, file, triangles, vertices, emissive, textures):
    path = shared_scenes / file
    start = time.perf_counter()
    scene = load_scene(path)
    assert time.perf_counter() - start < 60  # about 3 s for the largest on two cores
    assert scene.triangle_count == triangles
    assert scene.vertices.shape == (vertices, 3)
    names = np.array(scene.materials.names)[scene.material_ids.numpy()]
    assert Counter(names.tolist()) == counted(path)
    assert int((scene.materials.emission[scene.material_ids.long()] > 0).any(dim=1).sum()) == emissive
    assert len(scene.materials.textures) == textures
    # A thousand faces from all over the file against their own lines.
    text = path.read_text()
    lines = [line.split()[1:] for line in text.splitlines() if line.startswith("f ")]
    columns = {
        key: [line.split()[1:] for line in text.splitlines() if line.startswith(key + " ")] for key in ("v", "vt")
    }
    for i in np.linspace(0, triangles - 1, min(triangles, 1000)).astype(int):
        for corner, row in zip(lines[i], scene.faces[i].tolist(), strict=True):
            v, vt, _ = (int(field) - 1 for field in corner.split("/"))
            assert row == v
            assert scene.vertices[row].tolist() == torch.tensor([float(x) for x in columns["v"][v]]).tolist()
            assert scene.uv[row].tolist() == torch.tensor([float(x) for x in columns["vt"][vt][:2]]).tolist()


def test_the_cornell_boxs_numbers_are_those_of_its_library(shared_scenes):
    scene = load_scene(shared_scenes / "cornell_box" / "scene.obj")
    light = scene.materials.names.index("light__light1")
    assert scene.materials.emission[light].tolist() == torch.tensor([18.387, 10.9873, 2.75357]).tolist()
    text = (shared_scenes / "cornell_box" / "scene.mtl").read_text()
    for name, kd in re.findall(r"newmtl (\S+)\n(?:#.*\n)?Kd (.*)\n", text):
        albedo = scene.materials.albedo[scene.materials.names.index(name)]
        assert albedo.tolist() == torch.tensor([float(x) for x in kd.split()]).tolist()


def test_glass_can_be_left_out_of_a_real_scene(shared_scenes):
    path = shared_scenes / "modern_hall" / "scene.obj"
    scene = load_scene(path, skip_materials=["*glass*"])
    glass = sum(count for name, count in counted(path).items() if "glass" in name.lower())
    assert glass > 0
    assert scene.triangle_count == 31247 - glass
    assert not any("glass" in name.lower() for name in scene.materials.names)
