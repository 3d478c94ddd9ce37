"""The forest: its lanterns shine freely, its trees close the view, and its ground bears the walk."""

from functools import cache

import numpy as np
import torch
from procedural_scenes import built, corners, directions_all_around, path_eyes, unit_normals

from fovden.tracer import Scene, intersect
from fovden.tracer.bvh import build_bvh
from fovden.tracer.procedural import make_scene
from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.forest.ground import Discs, terrain
from fovden.tracer.procedural.forest.leaves import leaf

UP = np.array([0.0, 1.0, 0.0])


def forest() -> Scene:
    return built("forest")


@cache
def other_forest() -> Scene:
    return make_scene("forest", seed=1)


def distances(scene: Scene, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far rays go, infinite for the sky, and the triangles that they meet or -1."""
    hits = scene.intersect(torch.from_numpy(origins).float(), torch.from_numpy(directions).float())
    prim = hits.prim.numpy()
    return np.where(prim >= 0, hits.t.numpy(), np.inf), prim


def material_names(scene: Scene, prim: np.ndarray) -> np.ndarray:
    return np.array(scene.materials.names)[scene.material_ids.numpy()[prim]]


def test_eighty_lanterns_shine_over_most_of_the_sphere():
    """Roof, base and bars take less than half of the light; a lamp inside a trunk or a stone would lose nearly all."""
    lamps = np.array([light.position for light in forest().lights])
    assert lamps.shape == (80, 3)
    rays = directions_all_around(np.random.default_rng(0), 500)
    distance, _ = distances(forest(), np.repeat(lamps, len(rays), axis=0), np.tile(rays, (80, 1)))
    free = (distance.reshape(80, -1) > 0.3).mean(axis=1)
    assert free.min() > 0.45, lamps[free.argmin()]
    assert free.mean() > 0.6


def test_every_lamp_sits_in_a_lantern():
    """Below each lamp, within 18 cm, are the candle or the floor of its lantern, and above it the lantern's roof."""
    lamps = np.array([light.position for light in forest().lights])
    for direction in (UP, -UP):
        distance, prim = distances(forest(), lamps, np.tile(direction, (80, 1)))
        assert (distance < 0.18).all()
        assert set(material_names(forest(), prim)) <= {"iron", "wax", "granite"}
    gaps = np.linalg.norm(lamps[:, None] - lamps, axis=2) + 9 * np.eye(80)
    assert gaps.min() > 0.4, "no two lanterns touch"


def test_most_lamps_are_warm_and_some_are_cool():
    red, _, blue = np.array([light.intensity for light in forest().lights]).T
    assert (red > 2 * blue).sum() >= 55
    assert (blue > 1.5 * red).sum() >= 10


def test_trees_close_the_view_all_around():
    """From eye height, of the rays that rise by up to 15 degrees few escape, and every 15 degrees there is bark."""
    rng = np.random.default_rng(1)
    azimuth, rise = rng.uniform(0, 2 * np.pi, 40_000), np.arcsin(rng.uniform(0, np.sin(np.radians(15)), 40_000))
    directions = np.stack([np.cos(rise) * np.sin(azimuth), np.sin(rise), np.cos(rise) * np.cos(azimuth)], axis=1)
    eyes = path_eyes(forest(), 50)
    distance, prim = distances(forest(), eyes[rng.integers(len(eyes), size=len(directions))], directions)
    assert np.isinf(distance).mean() < 0.01
    sector = (azimuth / np.radians(15)).astype(int)
    bark = np.isin(material_names(forest(), prim), ["bark", "spruce bark"]) & np.isfinite(distance)
    assert (np.bincount(sector[bark], minlength=24) > 20).all()


def test_ground_is_closed_under_the_walk():
    """Around each foot of the walk, rays straight down meet the ground's or a stone's front where a foot would."""
    eyes = path_eyes(forest(), 5)
    rng = np.random.default_rng(2)
    origins = np.repeat(eyes, 25, axis=0)
    origins[:, [0, 2]] += rng.uniform(-0.3, 0.3, (len(origins), 2))
    distance, prim = distances(forest(), origins, np.tile(-UP, (len(origins), 1)))
    assert (np.abs(distance - 1.65) < 0.35).all()
    ground = np.isin(material_names(forest(), prim), ["floor", "trail stone"])
    assert ground.mean() > 0.9
    assert (unit_normals(corners(forest())[prim[ground]])[:, 1] > 0).mean() > 0.999


def test_walk_keeps_clear_of_everything():
    eyes = path_eyes(forest(), 5)
    rays = directions_all_around(np.random.default_rng(3), 400)
    distance, _ = distances(forest(), np.repeat(eyes, len(rays), axis=0), np.tile(rays, (len(eyes), 1)))
    assert distance.min() > 0.3


def test_terrain_says_how_high_its_triangles_are():
    """Heights from the formula against rays that fall on the mesh."""
    ground = terrain(0, Detail(0.4))
    patch = ground.patch(Discs(np.zeros((0, 2)), np.zeros(0)))
    bvh = build_bvh(torch.from_numpy(patch.vertices).float(), torch.from_numpy(patch.faces).int())
    places = np.random.default_rng(4).uniform(-20, 20, (5000, 2))
    origins = np.stack([places[:, 0], np.full(5000, 30.0), places[:, 1]], axis=1)
    hits = intersect(bvh, torch.from_numpy(origins).float(), torch.tensor([[0.0, -1.0, 0.0]]).repeat(5000, 1))
    assert (hits.prim >= 0).all()
    np.testing.assert_allclose(30.0 - hits.t.numpy(), ground.height(places), atol=2e-5)


def test_materials_reflect_like_wood_moss_and_stone():
    """Mean linear albedos lie between 0.02 (iron, needles) and 0.5 (wax); those with an image vary within it."""
    materials = forest().materials
    textured = 0
    for k, name in enumerate(materials.names):
        mean = materials.albedo[k]
        if (number := int(materials.texture[k])) >= 0:
            encoded = materials.textures[number].double() / 255
            linear = torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
            assert linear.std(dim=(0, 1)).max() > 0.02, name
            mean = mean * linear.mean(dim=(0, 1))
            textured += 1
        assert 0.02 < float(mean.mean()) < 0.5 or name == "wax", name
    assert textured >= 15


def test_leaves_are_cut_out_of_their_triangles():
    """Random points of the two triangles, their texels by hand: the outline fills most, and next to none is lost."""
    materials, leaf_mesh = forest().materials, leaf()
    rng = np.random.default_rng(6)
    corners, weights = leaf_mesh.uv[leaf_mesh.faces], rng.dirichlet(np.ones(3), (2, 20_000))
    u, v = np.einsum("tkc,tcx->xtk", weights, corners)
    for name in ("oak leaf", "ash leaf", "dead leaf"):
        number = materials.names.index(name)
        image = materials.opacities[int(materials.opacity[number])].numpy()
        height, width = image.shape
        rows, columns = ((1 - v) * height).astype(int), (u * width).astype(int)
        inside = image[rows.clip(0, height - 1), columns.clip(0, width - 1)] >= 255 * float(materials.cutoff[number])
        assert 0.6 < inside.mean() < 0.8
        kept = inside.mean() * 0.5  # the triangles cover half of the image
        assert kept > 0.97 * (image >= 128).mean(), "what lies outside the triangles is missing from the leaf"
        assert (image[[0, -1]] < 128).mean() > 0.9
    cut = {name for name, image in zip(materials.names, materials.opacity.tolist(), strict=True) if image >= 0}
    assert cut == {"oak leaf", "ash leaf", "dead leaf"}


def test_another_seed_grows_another_wood_around_the_same_shrine():
    first, second = forest(), other_forest()
    assert second.triangle_count == first.triangle_count
    assert len(second.lights) == len(first.lights)
    assert not any(map(torch.equal, first.materials.textures, second.materials.textures))

    def made_of(scene: Scene, name: str) -> torch.Tensor:
        return scene.vertices[scene.faces[scene.material_ids == scene.materials.names.index(name)].long()]

    for name in ("oak", "shingles", "bib"):
        assert torch.equal(made_of(first, name), made_of(second, name)), name
    for name in ("floor", "bark", "needles", "boulder", "oak leaf", "fern"):
        one, other = made_of(first, name), made_of(second, name)
        assert one.shape != other.shape or not torch.equal(one, other), name


def test_another_seed_keeps_the_walk_free():
    scene = other_forest()
    eyes = path_eyes(scene, 25)
    rays = directions_all_around(np.random.default_rng(5), 300)
    distance, _ = distances(scene, np.repeat(eyes, len(rays), axis=0), np.tile(rays, (len(eyes), 1)))
    assert distance.min() > 0.3
