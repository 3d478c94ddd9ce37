"""The atrium and the Cornell box as a user meets them; what holds for every scene is tested next door."""

import math
import time

import numpy as np
import pytest
import torch
from procedural_scenes import atrium, cornell_box, corners, face_normals

from fovden.tracer import DirectionalLight, Scene
from fovden.tracer.procedural import SCENES, make_scene


def test_same_seed_makes_the_same_scene_quickly():
    start = time.process_time()
    again = make_scene("atrium")
    assert time.process_time() - start < 10  # about 1.5 s; the margin is for slow machines
    assert_same_scene(again, atrium())
    assert_same_scene(make_scene("cornell_box"), cornell_box())


def assert_same_scene(first: Scene, second: Scene) -> None:
    for field in ("vertices", "faces", "material_ids", "normals", "uv"):
        assert torch.equal(getattr(first, field), getattr(second, field)), field
    assert all(map(torch.equal, first.materials.textures, second.materials.textures))


def test_another_seed_changes_cloth_and_stone_but_no_count():
    first, second = atrium(), make_scene("atrium", seed=1)
    assert second.triangle_count == 262_267
    assert not torch.equal(first.vertices, second.vertices)
    assert not any(map(torch.equal, first.materials.textures, second.materials.textures))
    stone = [first.materials.names.index(name) for name in ("ashlar", "plaster", "trim", "column marble")]
    architecture = torch.isin(first.material_ids, torch.tensor(stone, dtype=torch.int32))
    assert torch.equal(architecture, torch.isin(second.material_ids, torch.tensor(stone, dtype=torch.int32)))
    chosen = [scene.vertices[scene.faces[architecture].long()] for scene in (first, second)]
    assert torch.equal(*chosen)


def test_unknown_name_is_refused_with_the_names_that_exist():
    with pytest.raises(ValueError, match=f"name: expected one of {', '.join(SCENES)}, got sponza"):
        make_scene("sponza")
    with pytest.raises(ValueError, match="seed"):
        make_scene("atrium", seed=-1)


def test_atrium_stays_within_its_extents():
    vertices = atrium().vertices
    lowest, highest = vertices.min(dim=0).values, vertices.max(dim=0).values
    assert (lowest >= torch.tensor([-16.5, -0.02, -7.0])).all()
    assert (highest <= torch.tensor([16.5, 12.0, 7.0])).all()
    assert (highest - lowest >= torch.tensor([30.0, 11.0, 12.0])).all()


def test_atrium_has_no_holes_in_its_walls():
    """From the court and both galleries every ray that rises little meets something.

    Rays start clear of the pilasters, whose inside is open at the back, and of the fountain's foot. They rise by less
    than 15 degrees on the ground floor and not at all on the upper one.
    """
    rng = np.random.default_rng(2)
    count = 30_000
    for height in (1.0, 2.5, 6.5, 8.0):
        x, z = rng.uniform(-15.3, 15.3, count), rng.uniform(-5.9, 5.9, count)
        azimuth = rng.uniform(0, 2 * np.pi, count)
        elevation = np.arcsin(rng.uniform(-1, math.sin(math.radians(15.0 if height < 6 else 0.0)), count))
        directions = np.stack(
            [np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)], axis=1
        )
        origins = np.stack([x, np.full(count, height), z], axis=1)
        clear = np.hypot(x, z) > 0.8
        origins, directions = origins[clear], directions[clear]
        hits = atrium().intersect(torch.from_numpy(origins).float(), torch.from_numpy(directions).float())
        assert (hits.prim >= 0).all(), height


def test_atrium_is_open_to_the_sky_and_its_galleries_are_vaulted():
    ring = torch.tensor([[x, 1.0, z] for x in (-14.4, -8.0, 1.6, 14.4) for z in (-4.8, 4.8)])
    court = torch.tensor([[x, 3.0, z] for x in (-10.0, -4.0, 3.0, 9.0) for z in (-1.5, 0.4)])
    up = torch.tensor([0.0, 1.0, 0.0])
    roofed = atrium().intersect(ring, up.expand_as(ring))
    assert (roofed.prim >= 0).all()
    assert (1.0 + roofed.t < 5.3).all()
    assert not atrium().occluded(court, up.expand_as(court)).any()


def test_sun_reaches_the_floor():
    sun = next(light for light in atrium().lights if isinstance(light, DirectionalLight))
    x, z = torch.meshgrid(torch.linspace(-12, 12, 49), torch.linspace(-2.4, 2.4, 25), indexing="ij")
    floor = torch.stack([x.flatten(), torch.full((x.numel(),), 0.01), z.flatten()], dim=1)
    shaded = atrium().occluded(floor, -torch.tensor(sun.direction).expand_as(floor))
    assert 0.25 < 1 - shaded.float().mean() < 0.9


def test_materials_reflect_like_stone_and_cloth():
    """Mean linear albedos lie between 0.03 (earth, stems) and 0.75, most of the area between 0.2 and 0.75."""
    scene = atrium()
    means = []
    for k in range(len(scene.materials.names)):
        albedo = scene.materials.albedo[k]
        texture = int(scene.materials.texture[k])
        if texture >= 0:
            encoded = scene.materials.textures[texture].double() / 255
            linear = torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
            albedo = albedo * linear.mean(dim=(0, 1))
        means.append(float(albedo.mean()))
    assert min(means) > 0.01
    assert max(means) < 0.75
    area = np.bincount(scene.material_ids.numpy(), np.linalg.norm(face_normals(corners(scene)), axis=1))
    assert area[np.array(means) > 0.15].sum() / area.sum() > 0.95


def test_cornell_box_is_closed_on_five_sides():
    inside = torch.tensor([[2.78, 4.5, 2.0]])
    rng = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(50_000, 3, generator=rng), dim=1)
    hits = cornell_box().intersect(inside.expand_as(directions), directions)
    leaving = hits.prim < 0
    assert leaving.any()
    assert (directions[leaving, 2] < 0).all()
    # Those that leave do so through the front opening z = 0, 5.56 m wide and 5.488 m high.
    exit_point = inside + directions[leaving] * (-inside[0, 2] / directions[leaving, 2])[:, None]
    assert exit_point[:, 0].min() > -1e-3
    assert exit_point[:, 0].max() < 5.561
    assert exit_point[:, 1].min() > -1e-3
    assert exit_point[:, 1].max() < 5.489


def test_cornell_box_light_is_two_triangles_that_face_down():
    scene = cornell_box()
    assert scene.triangle_count == 38
    assert scene.lights == ()
    emits = (scene.materials.emission.sum(dim=1) > 0)[scene.material_ids.long()].numpy()
    assert emits.sum() == 2
    normals = face_normals(corners(scene)[emits]) / 2
    np.testing.assert_allclose(normals[:, [0, 2]], 0, atol=1e-6)
    assert (normals[:, 1] < 0).all()
    assert -normals[:, 1].sum() == pytest.approx(1.30 * 1.05, rel=1e-5)


def test_cornell_box_faces_inward():
    """Every wall shows its front to the middle of the room, every block to the outside."""
    scene = cornell_box()
    triangles = corners(scene)
    middle = triangles.mean(axis=1)
    normals = face_normals(triangles)
    room = np.array([2.78, 2.744, 2.796])
    block = ((triangles > [0.5, -1, 0.5]) & (triangles < [5.2, 3.5, 4.7])).all(axis=(1, 2))
    assert block.sum() == 20
    assert (((room - middle) * normals).sum(axis=1)[~block] > 0).all()
    tall = block & (triangles[..., 1].max(axis=1) > 2)
    for chosen in (tall, block & ~tall):
        assert chosen.sum() == 10
        centre = triangles[chosen].reshape(-1, 3).mean(axis=0)
        assert (((middle - centre) * normals).sum(axis=1)[chosen] > 0).all()


def test_cornell_box_is_red_on_the_left_and_green_on_the_right():
    scene = cornell_box()
    camera = scene.camera.at(resolution=(32, 32))
    rays = camera.views.rays()
    hits = scene.intersect(rays.origins[0], rays.directions[0])
    names = np.array(scene.materials.names)[scene.material_ids[hits.prim.long()].numpy()].reshape(32, 32)
    assert (hits.prim.reshape(32, 32)[2:-2, 2:-2] >= 0).all()
    assert set(names[8:24, 2]) == {"red"}
    assert set(names[8:24, -3]) == {"green"}
    assert set(names[2, 12:20]) == {"white"}
