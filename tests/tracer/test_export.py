"""Exported scenes come back as they were, for both formats; and what cannot be exported says why."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from procedural_scenes import built
from shapes import box, rectangle, sphere

from fovden.camera import StereoCamera
from fovden.tracer import (
    DirectionalLight,
    EnvironmentLight,
    Material,
    Materials,
    PointLight,
    Scene,
    load_scene,
    make_scene,
    trace_gbuffer,
)

ENDINGS = ("glb", "gltf", "obj")
LIGHTS = (
    PointLight((0.3, 2.5, 1.0), (9, 0.7, 6)),
    DirectionalLight((0, -1, 0), (0, 0, 0)),
    PointLight((-1, 2, 0.1), 1 / 3),
    DirectionalLight((0.3, -1, -0.2), (2.0, 2.2, 2.6)),
    DirectionalLight((0, 0, 1), 1),
)
CAMERA = StereoCamera.look_at(
    (0.4, 1.1, 5.0), (0.1, 0.8, -0.3), (0.2, 1, 0), fov_x_deg=61, resolution=(36, 48), convergence=4.0
)
VIEWS = {
    "from above": StereoCamera.look_at((0, 6, 0.1), (0, 0, 0), (0, 0, -1), fov_y_deg=50, resolution=(24, 24)),
    "Küche": StereoCamera.look_at((3, 1, 3), (0, 1, 0), fov_y_deg=33, eye_separation=0.1, resolution=(20, 30)),
}
NAMES = ("stone wall", "stone wall", "lamp <b>&amp;", "крас#ный", "")


def varied():
    """Smooth and flat triangles of five materials in turns, with everything that a file could lose."""
    generator = torch.Generator().manual_seed(3)
    pictures = [torch.randint(0, 256, (h, w, 3), generator=generator, dtype=torch.uint8) for h, w in ((5, 8), (16, 3))]
    ball = sphere(2)
    pieces = [  # triangles, material, normals
        (box((-1.5, 0, -1), (-0.4, 1.1, 0.2)), 3, 0 * box((0, 0, 0), (1, 1, 1))),
        (ball * 0.6 + torch.tensor([0.7, 0.6, 0.3]), 1, ball),
        (rectangle((-3, 0, -3), (0, 0, 6), (6, 0, 0)), 0, torch.zeros(2, 3, 3)),
        (rectangle((-0.5, 2.9, -0.5), (1, 0, 0), (0, 0, 1)), 2, torch.zeros(2, 3, 3)),
        (box((1.2, 0, -2), (2, 0.7, -1)), 3, 0 * box((0, 0, 0), (1, 1, 1))),
        (sphere(1) * 0.3 + torch.tensor([-1.0, 1.6, 0.5]), 3, sphere(1)),  # smooth, without texture coordinates
        (torch.zeros(1, 3, 3), 0, torch.zeros(1, 3, 3)),  # without area
        (rectangle((-3, 0, -3), (6, 0, 0), (0, 3, 0)), 4, torch.tensor([[[0, 0.6, 0.8]] * 2 + [[0, 0, 0]]] * 2)),
        (ball * 0.2 + torch.tensor([0.0, 2.0, 0.0]), 0, ball),
    ]
    triangles = torch.cat([piece for piece, _, _ in pieces]).reshape(-1, 3)
    uv = triangles @ torch.tensor([[0.7, 0.1], [-0.2, 1.3], [0.3, -0.9]], dtype=torch.float64)
    ids = torch.cat([torch.full((len(piece),), material) for piece, material, _ in pieces])
    uv[(ids == 3).repeat_interleave(3)] = 0
    materials = Materials.of(
        [
            Material(NAMES[0], (0.9, 0.75, 1), texture=pictures[0]),
            Material(NAMES[1], (1, 1, 1), texture=pictures[1]),
            Material(NAMES[2], (0.5, 0.5, 0.5), (17.1, 12, 0), texture=pictures[0]),
            Material(NAMES[3], (0.1, 1 / 3, 0.7), (0.25, 0.5, 0.125)),
            Material(NAMES[4], (0.043014, 0, 1)),
        ]
    )
    return Scene(
        # A vertex that no face uses stands in front.
        vertices=torch.cat([torch.full((1, 3), 9.0), triangles.float()]),
        faces=torch.arange(len(triangles)).reshape(-1, 3) + 1,
        material_ids=ids,
        materials=materials,
        normals=torch.cat([torch.zeros(1, 3), torch.cat([n for _, _, n in pieces]).reshape(-1, 3).float()]),
        uv=torch.cat([torch.zeros(1, 2), uv.float()]),
        lights=LIGHTS,
        camera=CAMERA,
        views=VIEWS,
        name="varied",
    )


def order(scene):
    """Numbers of the triangles as files list them: by the materials' first triangles, otherwise as they were."""
    ids = scene.material_ids.tolist()
    return [i for material in dict.fromkeys(ids) for i in range(len(ids)) if ids[i] == material]


def used_materials(scene):
    return list(dict.fromkeys(scene.material_ids.tolist()))


@pytest.fixture(scope="module", params=ENDINGS)
def pair(request, tmp_path_factory):
    scene = varied()
    *_, path = scene.export(tmp_path_factory.mktemp("out") / f"varied.{request.param}")
    return request.param, scene, load_scene(path)


def test_triangles_come_back_sorted_by_material(pair):
    _, scene, again = pair
    corners = scene.vertices[scene.faces.long()][order(scene)]
    assert torch.equal(again.vertices[again.faces.long()], corners)
    assert again.material_ids.tolist() == sorted(again.material_ids.tolist())


def test_an_obj_file_keeps_the_vertices(pair):
    ending, scene, again = pair
    if ending == "obj":  # and repeats only those of the triangles with both kinds of normals
        assert torch.equal(again.vertices[: len(scene.vertices)], scene.vertices)
        assert len(again.vertices) == len(scene.vertices) + 2


def test_materials_come_back(pair):
    ending, scene, again = pair
    used = used_materials(scene)
    expected = ["крас_ный", "stone_wall", "stone_wall_2", "lamp__b__amp_", "material"]
    names = [scene.materials.names[i] for i in used] if ending != "obj" else expected
    assert list(again.materials.names) == names
    assert torch.equal(again.materials.albedo, scene.materials.albedo[used])
    torch.testing.assert_close(again.materials.emission, scene.materials.emission[used], rtol=2e-7, atol=0)
    images = [[s.materials.textures[i] if i >= 0 else None for i in s.materials.texture] for s in (scene, again)]
    for number, i in enumerate(used):
        before, after = images[0][i], images[1][number]
        assert (before is None and after is None) or torch.equal(before, after)


def test_normals_come_back_and_flat_triangles_stay_flat(pair):
    ending, scene, again = pair
    before = scene.normals[scene.faces.long()][order(scene)].double()
    after = again.normals[again.faces.long()].double()
    corners = again.vertices[again.faces.long()].double()
    own = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own = torch.nn.functional.normalize(own, dim=1)[:, None].expand(-1, 3, -1)
    given = (before != 0).any(2)
    without_area = (own == 0).all(2).all(1)
    assert 0 < int((given.any(1) & ~given.all(1)).sum()) < int(given.all(1).sum()) < len(given)
    torch.testing.assert_close(after[given], before[given], rtol=0, atol=2e-7)
    bare = ~given & ~without_area[:, None]
    kept = bare & ~given.any(1, keepdim=True) if ending == "obj" else torch.zeros_like(bare)
    assert (after[kept] == 0).all()
    torch.testing.assert_close(after[bare & ~kept], own[bare & ~kept], rtol=0, atol=2e-7)


def test_surfaces_look_the_same(pair):
    """But for triangles with both kinds of normals, whose third corner here takes those of the others."""
    _, scene, again = pair
    given = (scene.normals[scene.faces.long()] != 0).any(2)
    mixed = given.any(1) & ~given.all(1)
    for camera in (CAMERA, *VIEWS.values()):
        before, after = trace_gbuffer(scene, camera), trace_gbuffer(again, camera)
        assert float((before.prim >= 0).float().mean()) > 0.5
        torch.testing.assert_close(after.position, before.position, rtol=1e-5, atol=1e-5)
        plain = ~mixed[before.prim.clamp(min=0).long()]
        assert float(plain.float().mean()) > 0.5
        torch.testing.assert_close(after.normal * plain, before.normal * plain, rtol=0, atol=1e-5)
        # v is flipped twice in single precision: 1e-6 of 16 texels, which differ by 1 at most.
        torch.testing.assert_close(after.albedo, before.albedo, rtol=0, atol=1e-4)


def test_lights_cameras_and_views_come_back_from_gltf(pair):
    ending, _, again = pair
    if ending == "obj":
        assert not again.lights
        assert again.camera is None
        return
    assert len(again.lights) == len(LIGHTS)
    for before, after in zip(LIGHTS, again.lights, strict=True):
        assert type(before) is type(after)
        for name, value in vars(before).items():
            np.testing.assert_allclose(getattr(after, name), value, rtol=1e-12, atol=1e-15)
    assert list(again.views) == list(VIEWS)
    for before, after in zip((CAMERA, *VIEWS.values()), (again.camera, *again.views.values()), strict=True):
        assert (after.resolution, after.eye_separation, after.convergence) == (
            before.resolution,
            before.eye_separation,
            before.convergence,
        )
        assert (after.fov_x_deg is None) == (before.fov_x_deg is None)
        for name in ("eye", "target"):
            np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=0, atol=1e-12)
        for name in ("origin", "rotation", "bounds"):
            first, second = (getattr(camera.at((30, 50)).views, name) for camera in (before, after))
            torch.testing.assert_close(first, second, rtol=1e-6, atol=1e-7)


def test_the_atrium_comes_back(tmp_path):
    scene = built("atrium")
    again = load_scene(scene.export(tmp_path / "atrium.glb")[-1])
    rows = np.array(order(scene))
    assert torch.equal(again.vertices[again.faces.long()], scene.vertices[scene.faces.long()][rows])
    camera = scene.camera.at((60, 53))
    before, after = trace_gbuffer(scene, camera), trace_gbuffer(again, camera)
    assert float((before.albedo - after.albedo).abs().mean()) < 1e-4


@pytest.mark.parametrize("ending", ["glb", "gltf"])
@pytest.mark.parametrize("radiance", [(0.3, 0.4, 0.6), torch.rand(3, 4, 8)], ids=["constant", "image"])
def test_an_environment_comes_back_with_one_warning(tmp_path, ending, radiance):
    scene = make_scene("cornell_box").with_lights([EnvironmentLight(radiance), LIGHTS[0]])
    with pytest.warns(UserWarning, match="EnvironmentLight") as warned:
        files = scene.export(tmp_path / f"sky.{ending}")
    assert len(warned) == 1
    assert sorted(files) == sorted(tmp_path.iterdir())
    assert files[-1].name == f"sky.{ending}"
    point, sky = load_scene(files[-1]).lights  # an environment comes last
    assert point == LIGHTS[0]
    np.testing.assert_array_equal(sky.radiance, radiance)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", ["my scène №1", "-o x", " x", "50% #1", "дом"])
def test_names_with_spaces_marks_and_letters_of_all_kinds(tmp_path, name, ending):
    scene = varied()
    folder = tmp_path / "Ünterlagen und mehr"
    folder.mkdir()
    files = scene.export(str(folder / f"{name}.{ending}"))
    assert sorted(files) == sorted(folder.iterdir())
    assert files[-1] == folder / f"{name}.{ending}"
    again = load_scene(files[-1])
    assert again.triangle_count == scene.triangle_count
    assert again.name == name
    assert len(again.materials.textures) == 2


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_scene_without_camera_normals_or_texture_coordinates(tmp_path, ending):
    bare = Scene(torch.eye(3), torch.tensor([[0, 1, 2]]), torch.tensor([0]), Materials.of([Material("m", (1, 1, 1))]))
    assert load_scene(bare.export(tmp_path / f"bare.{ending}")[-1]).camera is None
    other = load_scene(replace(bare, views=VIEWS).export(tmp_path / f"other.{ending}")[-1])
    assert other.camera is None  # none of the views is taken for the scene's own
    assert list(other.views) == ([] if ending == "obj" else list(VIEWS))


def test_values_that_require_gradients_are_exported(tmp_path):
    scene = replace(varied(), vertices=varied().vertices.requires_grad_())
    for ending in ENDINGS:
        assert load_scene(scene.export(tmp_path / f"a.{ending}")[-1]).triangle_count == scene.triangle_count


@pytest.mark.parametrize("name", ["x.ply", "x", "glb", "x.glb.zip"])
def test_other_endings_are_refused(tmp_path, name):
    with pytest.raises(ValueError, match=r"path: expected a name that ends in \.glb, \.gltf, \.obj, got"):
        varied().export(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", ENDINGS)
def test_folders_that_are_not_there(tmp_path, ending):
    (tmp_path / "file").write_text("")
    for folder in ("missing", "file"):
        with pytest.raises(FileNotFoundError, match=f"the folder .*{folder} does not exist"):
            varied().export(tmp_path / folder / f"x.{ending}")
    (tmp_path / f"x.{ending}").mkdir()
    with pytest.raises(IsADirectoryError, match="this is a folder"):
        varied().export(tmp_path / f"x.{ending}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", f"x.{ending}"]


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="there is no folder that not even root may write to")
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_folder_that_cannot_be_written(ending):
    with pytest.raises(OSError, match=r"/proc/self/\.x\."):
        make_scene("cornell_box").export(f"/proc/self/x.{ending}")


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_fails_half_way_leaves_everything_as_it_was(tmp_path, monkeypatch, ending):
    scene = varied()
    scene.export(tmp_path / f"x.{ending}")
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    images = iter([b"a picture"])

    def full(_):
        try:
            return next(images)
        except StopIteration:
            raise OSError("no space left on device") from None

    for writer in ("gltf_writer", "obj_writer"):
        monkeypatch.setattr(f"fovden.tracer.formats.{writer}.png_bytes", full)
    with pytest.raises(OSError, match="no space left"):
        replace(scene, name="other").export(tmp_path / f"x.{ending}")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_two_environments_are_refused(tmp_path):
    scene = varied().with_lights([EnvironmentLight(1), EnvironmentLight(2)])
    for ending in ENDINGS:
        with pytest.raises(ValueError, match="lights: expected at most one environment light, got 2"):
            scene.export(tmp_path / f"x.{ending}")
    assert not list(tmp_path.iterdir())
