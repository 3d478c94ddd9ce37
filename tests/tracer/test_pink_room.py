"""The pink room: what it is made of, where its three lights reach, and what a seed may change."""

import numpy as np
import pytest
import torch
from procedural_scenes import built

from fovden.color import srgb_to_linear
from fovden.tracer import DirectionalLight, PointLight, Scene
from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import face_normals
from fovden.tracer.procedural.pink_room import plan, wool
from fovden.tracer.procedural.pink_room.books import book
from fovden.tracer.procedural.pink_room.furnishing import furnish
from fovden.tracer.procedural.pink_room.turning import bent


def pink_room() -> Scene:
    return built("pink_room")


def vertices(seed: int) -> dict[str, np.ndarray]:
    """Vertices of what is made of each surface, at a seventh of the fineness."""
    pieces = list(furnish(np.random.default_rng([seed, 1]), Detail(0.15)))
    return {name: np.concatenate([p.vertices for other, p in pieces if other == name]) for name in dict(pieces)}


def names_hit(scene: Scene, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Name of the material that each ray meets first, or ``""`` where it leaves the scene."""
    rays = [torch.tensor(np.ascontiguousarray(values), dtype=torch.float32) for values in (origins, directions)]
    hits = scene.intersect(*rays)
    names = np.array([*scene.materials.names, ""])
    ids = torch.where(hits.prim >= 0, scene.material_ids[hits.prim.clamp(min=0).long()], len(names) - 1)
    return names[ids.numpy()]


def light(kind: type, number: int = 0):
    return [light for light in pink_room().lights if isinstance(light, kind)][number]


def triangles_of(scene: Scene) -> dict[str, int]:
    counts = np.bincount(scene.material_ids.numpy(), minlength=len(scene.materials.names))
    return dict(zip(scene.materials.names, counts.tolist(), strict=True))


def test_nothing_takes_more_than_a_fifth_of_the_triangles():
    counts = triangles_of(pink_room())
    assert sum(counts.values()) == 786_056
    assert max(counts.values()) < 786_056 / 5
    for name in ("curtain", "bindings", "velvet", "quilt", "willow", "brass", "leaf", "parquet"):
        assert counts[name] > 5_000, name


def test_the_sun_enters_through_the_window_alone():
    """Seen from the floor against the sun there is sky through the window's opening, and nothing but the room else."""
    toward = -np.asarray(light(DirectionalLight).direction)
    x, z = np.meshgrid(np.arange(-2.9, 2.9, 0.05), np.arange(-2.5, 2.5, 0.05))
    origins = np.stack([x.ravel(), np.full(x.size, 0.03), z.ravel()], axis=1)
    lit = names_hit(pink_room(), origins, np.broadcast_to(toward, origins.shape)) == ""
    area = lit.sum() * 0.05**2
    assert 1.0 < area < 4.0, "square metres of sun on the floor"
    along = (-plan.HALF_X - origins[lit, 0]) / toward[0]
    at_wall = origins[lit] + along[:, None] * toward
    left, right, low, high = plan.WINDOW
    assert (at_wall[:, 1] > low).all()
    assert (at_wall[:, 1] < high).all()
    assert (-at_wall[:, 2] > left).all()
    assert (-at_wall[:, 2] < right).all()


def test_no_ray_leaves_the_room_but_through_the_window():
    rng = np.random.default_rng(0)
    origins = rng.uniform((-2.0, 1.2, -1.8), (2.8, 1.9, 2.4), (60_000, 3))
    directions = rng.standard_normal(origins.shape)
    met = names_hit(pink_room(), origins, directions)
    gone = (met == "") | (met == "meadow")
    distance = (-plan.HALF_X - origins[gone, 0]) / directions[gone, 0]
    y, z = (origins[gone, axis] + distance * directions[gone, axis] for axis in (1, 2))
    left, right, low, high = plan.WINDOW
    assert gone.sum() > 300
    assert ((y > low) & (y < high) & (-z > left) & (-z < right) & (distance > 0)).all()


@pytest.mark.parametrize(
    ("number", "target", "material"),
    [
        (0, (plan.LAMP_TABLE[0] + 0.25, 0.701, plan.LAMP_TABLE[2] + 0.1), "tablecloth"),
        (0, (plan.LAMP_TABLE[0] + 0.05, 1.9, -plan.HALF_Z), "wallpaper"),
        (1, (1.4, 0.0, 1.3), "parquet"),
        (1, (-1.3, 1.25, -plan.HALF_Z), "wallpaper"),
        (1, (-0.8, 0.486, -0.75), "marble"),
    ],
    ids=["lamp to table", "lamp to wall", "chandelier to floor", "chandelier to wall", "chandelier to coffee table"],
)
def test_lamps_light_what_is_around_them(number, target, material):
    """The materials met first within 4 cm around a place, seen from the light: the shade lets it out there."""
    origin = np.asarray(light(PointLight, number).position)
    shifts = 0.04 * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 3)
    directions = np.asarray(target) + shifts - origin
    met = names_hit(pink_room(), np.broadcast_to(origin, directions.shape), directions)
    assert (met == material).mean() > 0.5, dict(zip(*np.unique(met, return_counts=True), strict=True))


@pytest.mark.parametrize("number", [0, 1])
def test_shades_hold_back_what_goes_sideways(number):
    origin = np.asarray(light(PointLight, number).position)
    around = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    sideways = np.stack([np.cos(around), np.full(60, 0.12), np.sin(around)], axis=1)
    assert (names_hit(pink_room(), np.broadcast_to(origin, sideways.shape), sideways) == "shade").mean() > 0.9


def test_reflectances_are_those_of_real_things():
    materials = pink_room().materials
    for i, name in enumerate(materials.names):
        albedo = materials.albedo[i].double()
        if materials.texture[i] >= 0:
            image = materials.textures[int(materials.texture[i])]
            albedo = albedo * srgb_to_linear(image.double() / 255).mean(dim=(0, 1))
        assert 0.003 < albedo.min() <= albedo.max() < 0.92, name
    assert sum(int(texture) >= 0 for texture in materials.texture) > 0.7 * len(materials.names)


def test_a_seed_changes_what_grows_and_keeps_what_is_built():
    one, other, again = vertices(0), vertices(1), vertices(1)
    for name in ("wallpaper", "white oak", "marble", "velvet"):
        np.testing.assert_array_equal(one[name], other[name])
    for name in ("bindings", "curtain", "leaf", "tablecloth", "quilt"):
        assert one[name].shape != other[name].shape or np.abs(one[name] - other[name]).max() > 1e-3, name
        np.testing.assert_array_equal(other[name], again[name])


@pytest.mark.parametrize("blades", [1, 7, 1000, 40_001])
def test_the_rug_has_as_many_tufts_as_it_is_given_and_keeps_to_its_cloth(blades):
    pile = wool.rug(np.random.default_rng(0), blades)
    assert pile.triangle_count == blades
    reach = np.abs(pile.vertices[:, [0, 2]] - np.array(plan.RUG)[[0, 2]]) - plan.RUG_HALF
    assert reach.max() < 0.06
    assert (face_normals(pile.vertices, pile.faces)[:, 1] > 0).all()
    assert pile.uv[pile.faces].std(axis=1).max() < 1e-12, "a tuft has one colour"


def test_stitches_show_their_outer_side():
    across, along = np.array([[0.03, 0.0, 0.0]]), np.array([[0.0, 0.0, -0.03]])
    stitch = wool.knitting(np.zeros((1, 3)), across, along, Detail())
    assert face_normals(stitch.vertices, stitch.faces)[:, 1].mean() > 0
    assert stitch.vertices[:, 1].max() < 0.03


def test_books_have_covers_of_one_size():
    binding, pages = book((0.04, 0.25, 0.17), 3, Detail(), banded=True)
    size = np.ptp(binding.vertices, axis=0)
    assert size[1] == pytest.approx(0.25)
    assert 0.17 < size[2] < 0.19, "the spine bulges out by up to 11 mm, its bands by 2"
    assert (np.abs(pages.vertices[:, 0]) < 0.02).all()
    assert pages.vertices[:, 1].max() < 0.25


def test_only_straight_points_are_taken_out_of_a_line():
    angle = np.linspace(0, np.pi, 30)
    arc = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_array_equal(bent(arc), arc)
    straight = np.stack([np.linspace(0, 1, 30), np.linspace(2, 5, 30)], axis=1)
    np.testing.assert_array_equal(bent(straight), straight[[0, -1]])
