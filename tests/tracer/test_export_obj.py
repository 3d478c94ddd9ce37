"""Exported OBJ files: their statements, their library, the file with cameras and lights, and trimesh's view of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from export_files import areas, mtl_materials, obj_parts
from test_export import CAMERA, LIGHTS, NAMES, VIEWS, used_materials, varied

from fovden.io import load_image
from fovden.tracer import EnvironmentLight, load_scene, make_scene


@pytest.fixture(scope="module")
def scene():
    return varied()


@pytest.fixture(scope="module")
def files(scene, tmp_path_factory):
    return scene.export(tmp_path_factory.mktemp("out") / "varied.obj")


def test_files_and_their_names(files):
    names = [file.name for file in files]
    assert names == ["varied_texture0.png", "varied_texture1.png", "varied.mtl", "varied.json", "varied.obj"]


def test_statements_refer_to_what_is_there_and_are_sparse(files, scene):
    lines = [line.split() for line in files[-1].read_text(encoding="utf-8").splitlines()]
    counts = {key: sum(line[0] == key for line in lines) for key in ("v", "vt", "vn", "f", "usemtl", "mtllib", "#")}
    assert counts["f"] == scene.triangle_count
    assert (counts["usemtl"], counts["mtllib"], counts["#"]) == (5, 1, 1)
    used = {"v": set(), "vt": set(), "vn": set()}
    for line in lines:
        if line[0] == "f":
            for corner in line[1:]:
                for key, number in zip(used, corner.split("/"), strict=False):
                    used[key] |= {int(number)} if number else set()
    for key in ("vt", "vn"):
        assert used[key] == set(range(1, counts[key] + 1))
    assert max(used["v"]) == counts["v"] == len(scene.vertices) + 2  # copies for triangles with both kinds of normals


def test_the_parts_have_the_scenes_triangles(files, scene):
    """Read by a reader of the test's own: flat triangles without normals, plain materials without coordinates."""
    parts = obj_parts(files[-1])
    corners = scene.vertices.numpy()[scene.faces.numpy()]
    normals = scene.normals.numpy()[scene.faces.numpy()]
    ids, uv = scene.material_ids.numpy(), scene.uv.numpy()[scene.faces.numpy()]
    flat = ~normals.any((1, 2))
    names = dict(zip(dict.fromkeys(part.name for part in parts), used_materials(scene), strict=True))
    assert len(parts) == 7
    for part in parts:
        rows = (ids == names[part.name]) & (flat == (part.normals is None))
        np.testing.assert_array_equal(part.vertices.astype(np.float32), corners[rows])
        assert (part.uv is None) == (names[part.name] == 3)
        if part.uv is not None:
            np.testing.assert_array_equal(part.uv.astype(np.float32), uv[rows])
        if part.normals is not None:
            given = normals[rows].any(2)
            np.testing.assert_array_equal(part.normals.astype(np.float32)[given], normals[rows][given])


def test_the_library(files, scene):
    materials = mtl_materials(files[-3])
    assert list(materials) == ["крас_ный", "stone_wall", "stone_wall_2", "lamp__b__amp_", "material"]
    for entry, number in zip(materials.values(), used_materials(scene), strict=True):
        albedo, emission = scene.materials.albedo[number], scene.materials.emission[number]
        assert torch.equal(torch.tensor([float(x) for x in entry["Kd"].split()]), albedo)
        assert ("Ke" in entry) == bool(emission.any())
        if "Ke" in entry:
            assert torch.equal(torch.tensor([float(x) for x in entry["Ke"].split()]), emission)
        texture = int(scene.materials.texture[number])
        assert entry.get("map_Kd") == (f"varied_texture{texture}.png" if texture >= 0 else None)


def test_trimesh_sees_the_same_areas_and_images(files, scene):
    loaded = trimesh.load_scene(files[-1], process=False, group_material=True)
    ids = scene.material_ids.numpy()
    corners = scene.vertices.double().numpy()[scene.faces.numpy()]
    assert len(loaded.geometry) == 5
    names = mtl_materials(files[-3])
    by_name = {mesh.visual.material.name: mesh for mesh in loaded.geometry.values()}
    for name, material in zip(names, used_materials(scene), strict=True):
        mesh = by_name[name]
        expected = np.sort(areas(corners[ids == material]))
        np.testing.assert_allclose(np.sort(mesh.area_faces), expected, rtol=1e-6, atol=1e-12)
        texture = int(scene.materials.texture[material])
        if texture >= 0:
            image = np.asarray(mesh.visual.material.image.convert("RGB"))
            np.testing.assert_array_equal(image, scene.materials.textures[texture].numpy())


def projected(camera, eye, point):
    """A world point on the raster, from nothing but the JSON."""
    x, y, z, _ = np.linalg.inv(camera["eyes"][eye]["camera_to_world"]) @ [*point, 1]
    left, right, bottom, top = camera["eyes"][eye]["bounds"]
    size = camera["resolution"]
    return (x / -z - left) / (right - left) * size["width"], (top - y / -z) / (top - bottom) * size["height"]


def test_the_json_has_the_cameras(files):
    described = json.loads(files[-2].read_text(encoding="utf-8"))
    assert described["name"] == "varied"
    assert list(described["views"]) == list(VIEWS)
    entries = [described["camera"], *described["views"].values()]
    for entry, camera in zip(entries, (CAMERA, *VIEWS.values()), strict=True):
        for name in ("eye", "target", "up"):
            assert entry[name] == list(getattr(camera, name))
        assert (entry["eye_separation"], entry["convergence"]) == (camera.eye_separation, camera.convergence)
        height, width = camera.resolution
        assert entry["resolution"] == {"height": height, "width": width}
        tangents = np.tan(np.radians([entry["fov_x_deg"], entry["fov_y_deg"]]) / 2)
        assert tangents[0] / tangents[1] == pytest.approx(width / height, rel=1e-6)
        given = "fov_x_deg" if camera.fov_y_deg is None else "fov_y_deg"
        assert entry[given] == getattr(camera, given)
        point = torch.tensor([0.2, 0.5, -0.1])
        pixels, _ = camera.views.project(point.expand(2, 1, 3))
        for eye in range(2):
            np.testing.assert_allclose(projected(entry, eye, point.tolist()), pixels[eye, 0], rtol=1e-5, atol=1e-4)


def test_the_json_has_the_lights_and_names(files, scene):
    described = json.loads(files[-2].read_text(encoding="utf-8"))
    assert len(described["lights"]) == len(LIGHTS)
    for entry, light in zip(described["lights"], LIGHTS, strict=True):
        assert entry.pop("type") in type(light).__name__.lower()
        assert {key: tuple(value) for key, value in entry.items()} == vars(light)
    pairs = [(entry["name"], entry["library_name"]) for entry in described["materials"]]
    assert pairs == list(zip([NAMES[i] for i in used_materials(scene)], mtl_materials(files[-3]), strict=True))


@pytest.mark.parametrize("radiance", [(0.3, 0.4, 0.6), torch.rand(3, 4, 8)], ids=["constant", "image"])
def test_the_json_has_the_environment(tmp_path, radiance):
    files = make_scene("cornell_box").with_lights([EnvironmentLight(radiance)]).export(tmp_path / "sky.obj")
    assert sorted(files) == sorted(tmp_path.iterdir())
    (light,) = json.loads(files[-2].read_text())["lights"]
    if isinstance(radiance, tuple):
        assert light == {"type": "environment", "radiance": list(radiance)}
    else:
        assert torch.equal(load_image(tmp_path / light["file"])[0], radiance)


def test_a_scene_without_camera_and_lights(tmp_path):
    *_, sidecar, path = replace(varied(), camera=None, views={}, lights=()).export(tmp_path / "x.obj")
    described = json.loads(sidecar.read_text(encoding="utf-8"))
    assert (described["camera"], described["views"], described["lights"]) == (None, {}, [])
    assert load_scene(path).triangle_count == varied().triangle_count


def test_a_name_with_a_line_break_is_refused(tmp_path):
    with pytest.raises(ValueError, match="path: expected a name in one line"):
        make_scene("cornell_box").export(tmp_path / "a\nb.obj")
    assert not list(tmp_path.iterdir())
