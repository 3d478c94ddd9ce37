"""What the procedural scenes are made of: primitives against closed forms, parts against what they stand for."""

import dataclasses

import numpy as np
import pytest
import torch
from procedural_scenes import face_normals

from fovden.tracer.procedural.atrium import arcade, furnishings, orders, plan
from fovden.tracer.procedural.atrium.court import court
from fovden.tracer.procedural.detail import Detail, fitted
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.primitives import box, bridge, grid, lathe, mitred, quad, ring_corners, tube
from fovden.tracer.procedural.textures import cloth, stone, wood


def volume(patch: Patch) -> float:
    """Signed volume that a closed patch encloses, by the divergence theorem: positive if it faces outward."""
    a, b, c = (patch.vertices[patch.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_lathe_makes_a_sphere():
    """Area and volume of an inscribed polyhedron fall short by O(1/n^2): below 0.1 % for 128 segments."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 65)
    ball = lathe(np.stack([np.cos(angle), np.sin(angle)], axis=1), 128)
    assert ball.area == pytest.approx(4 * np.pi, rel=1e-3)
    assert volume(ball) == pytest.approx(4 / 3 * np.pi, rel=2e-3)
    np.testing.assert_allclose((ball.normals * ball.vertices).sum(axis=1), 1, atol=2e-3)
    assert ball.triangle_count == 2 * 128 * (64 - 1), "no triangles without area at the poles"


def test_lathe_follows_pappus():
    """Surface and volume of a torus: 4 pi^2 R r and 2 pi^2 R r^2."""
    angle = np.linspace(0, 2 * np.pi, 97)
    torus = lathe(np.stack([2 + 0.5 * np.cos(angle), 0.5 * np.sin(angle)], axis=1), 128)
    assert torus.area == pytest.approx(4 * np.pi**2 * 2 * 0.5, rel=2e-3)
    assert volume(torus) == pytest.approx(2 * np.pi**2 * 2 * 0.25, rel=2e-3)


def test_faceted_lathe_is_a_prism():
    prism = lathe([(1, 0), (1, 3)], 6, faceted=True)
    assert prism.area == pytest.approx(6 * 1 * 3)
    assert not prism.normals.any()


def test_box_and_its_sides():
    block = box((2, 3, 4))
    assert volume(block) == pytest.approx(24)
    assert block.area == pytest.approx(2 * (6 + 8 + 12))
    for side, area in (("-x", 12), ("+x", 12), ("-y", 8), ("+y", 8), ("-z", 6), ("+z", 6)):
        one = box((2, 3, 4), side)
        assert one.area == pytest.approx(area)
        sign, axis = side
        normal = face_normals(one.vertices[one.faces])[0]
        assert np.sign(normal["xyz".index(axis)]) == (1 if sign == "+" else -1)


def test_mitred_ring_is_closed_and_outward():
    """A square section drawn around a square path: by Pappus its volume is area times the path of the centroid."""
    section = [(0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.5), (0.0, 0.0)]
    ring = mitred(section, ring_corners(2, 1), closed=True)
    assert volume(ring) == pytest.approx(0.25 * (2 * (4 + 2) + 8 * 0.25))
    assert ring.area == pytest.approx(0.5 * (12 + 12 + 4) + 2 * (5 * 3 - 4 * 2))
    inside = mitred([(0.0, 0.0), (0.0, 1.0)], ring_corners(2, 1), closed=True, outward=False)
    assert (face_normals(inside.vertices[inside.faces]) * inside.vertices[inside.faces].mean(axis=1)).sum() < 0


def test_open_mitre_ends_square():
    strip = mitred([(0.0, 0.0), (0.3, 0.4)], [(0, 0), (2, 0)])
    assert strip.area == pytest.approx(0.5 * 2)
    assert sorted(strip.vertices[:, 0]) == [0, 0, 2, 2]


def test_bridge_between_circle_and_square():
    angle = np.linspace(-np.pi / 4, 7 * np.pi / 4, 65)
    circle = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    square = np.array([(x, 0.0, z) for x, z in [*ring_corners(2, 2), ring_corners(2, 2)[0]]])
    plate = bridge(square, circle)
    polygon = 32 * np.sin(2 * np.pi / 64)
    assert plate.area == pytest.approx(16 - polygon)
    assert plate.triangle_count == 64 + 4
    assert (face_normals(plate.vertices[plate.faces])[:, 1] > 0).all()


def test_grid_faces_the_viewer_and_skips_what_has_no_area():
    x, y = np.meshgrid([-1.0, 0.0, 1.0], [0.0, 1.0])
    fan = grid(np.stack([x * (1 - y), y, 0 * x], axis=-1))
    assert fan.triangle_count == 2
    assert (face_normals(fan.vertices[fan.faces])[:, 2] > 0).all()
    assert fan.area == pytest.approx(1.0)


def test_tube_around_a_ring_is_a_torus():
    angle = np.linspace(0, 2 * np.pi, 129)
    ring = tube(np.stack([2 * np.sin(angle), 0 * angle, 2 * np.cos(angle)], axis=1), 0.25, 32)
    assert ring.area == pytest.approx(4 * np.pi**2 * 2 * 0.25, rel=5e-3)
    assert volume(ring) > 0


def test_copies_keep_shape_and_turn_towards_x():
    plate = quad((0, 0, 0), (1, 0, 0), (1, 2, 0), (0, 2, 0))
    copies = plate.placed([(5, 0, 0), (0, 0, 7)], turns=[np.pi / 2, 0.0], scales=[1.0, 3.0])
    assert copies.area == pytest.approx(2 + 18)
    normals = face_normals(copies.vertices[copies.faces])
    np.testing.assert_allclose(normals[0] / 2, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(copies.vertices[:4].mean(axis=0), [5, 1, -0.5], atol=1e-12)
    mirrored = plate.transformed(np.diag([-1.0, 1.0, 1.0]))
    assert (face_normals(mirrored.vertices[mirrored.faces])[:, 2] > 0).all()
    assert (face_normals(plate.reversed().vertices[plate.reversed().faces])[:, 2] < 0).all()


def test_texture_coordinates_are_lengths():
    """On flat patches and on developable ones a step in texture coordinates is as long as the step on the surface."""
    wall = arcade.spandrel(arcade.ArchShape(), 1.6, 1.6, 1.55)
    barrel = lathe([(1, 0), (1, 2)], 256)
    for patch in (wall, barrel):
        edge = patch.vertices[patch.faces[:, 0]] - patch.vertices[patch.faces[:, 1]]
        step = patch.uv[patch.faces[:, 0]] - patch.uv[patch.faces[:, 1]]
        np.testing.assert_allclose(np.linalg.norm(step, axis=1), np.linalg.norm(edge, axis=1), rtol=1e-3)


def test_groin_vault_is_the_higher_of_two_barrels():
    vault = arcade.groin_vault((-2, 2), (-1, 1), rise=1.5, segments=64)
    x, y, z = vault.vertices.T
    barrels = 1.5 * np.sqrt(np.maximum(np.clip(1 - (x / 2) ** 2, 0, None), np.clip(1 - z**2, 0, None)))
    np.testing.assert_allclose(y, barrels, atol=1e-7)
    a, b, c = (vault.vertices[vault.faces[:, k]][:, [0, 2]] for k in range(3))
    plan = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    assert plan == pytest.approx(8.0), "the cells cover the rectangle once"
    assert (face_normals(vault.vertices[vault.faces])[:, 1] < 0).all()


def test_arch_and_vault_share_their_edges():
    """The points of the intrados's back, the crescent and the vault's edge are the same, to the bit where they meet."""
    shape = arcade.ArchShape()
    crescent = arcade.crescent(shape, 1.38, 1.38, 1.5)
    half = shape.thickness / 2
    front = {tuple(p) for p in np.round(arcade.intrados(shape, both_fronts=False).vertices, 9) if p[2] > 0}
    assert front <= {tuple(p) for p in np.round(crescent.vertices, 9)}
    vault = arcade.groin_vault((-1.38, 1.38), (half, half + 2.0), 1.5)
    edge = {tuple(p) for p in np.round(vault.vertices, 9) if p[2] == half}
    assert edge <= {tuple(p) for p in np.round(crescent.vertices, 9)}
    area = np.pi / 2 * (1.38 * 1.5 - shape.radius**2)
    assert crescent.area == pytest.approx(area, rel=0.02)  # chords of 24 and 44 segments, and eleven joints


def test_column_is_hollow_only_where_nobody_looks():
    """Rays towards a column's axis, from outside, always meet its front."""
    order = orders.ColumnOrder(height=3.4, radius=0.29, capital=0.46, abacus=0.43, bearing=0.22)
    patch = orders.column(order)
    assert patch.vertices[:, 1].min() == 0
    assert patch.vertices[:, 1].max() == pytest.approx(3.4)
    shaft = patch.vertices[(patch.vertices[:, 1] > 0.5) & (patch.vertices[:, 1] < 2.7)]
    radius = np.hypot(shaft[:, 0], shaft[:, 2])
    assert radius.max() <= order.radius + 1e-9
    assert radius.min() > 0.7 * order.radius


@pytest.mark.parametrize("flutes", [0, 12, 16])
def test_shaft_has_entasis(flutes):
    order = orders.ColumnOrder(3.0, 0.25, capital=0.4, abacus=0.37, bearing=0.2, flutes=flutes)
    patch = orders.column(order)
    height = np.round(patch.vertices[:, 1], 9)
    levels = np.unique(height[(height > 0.33) & (height < 2.47)])
    widest = [np.hypot(*patch.vertices[height == level][:, [0, 2]].T).max() for level in levels]
    assert (np.diff(widest) < 0).all(), "narrower towards the top"
    slope = np.diff(widest) / np.diff(levels)
    assert slope[-1] < slope[0], "and ever faster"


def test_ivy_leaves_hang_from_their_roots():
    roots = np.random.default_rng(0).standard_normal((50, 3))
    leaves = furnishings.ivy_leaves(roots, np.linspace(0, 6, 50), np.zeros(50), np.full(50, 0.1))
    assert leaves.triangle_count == furnishings.ivy_leaf_triangles() * 50
    np.testing.assert_array_equal(leaves.vertices[::6], roots)
    assert (leaves.vertices.reshape(50, 6, 3)[:, 3, 1] < roots[:, 1]).all()
    assert furnishings.ivy_bud((0, 0, 0), 0.0, 0.05).triangle_count == 1


def test_every_texture_repeats_without_a_seam():
    """The step across an image's border is no larger than four times the usual step between its rows or columns."""
    rng = np.random.default_rng(0)
    images = {
        "marble": stone.marble(rng, (0.8, 0.75, 0.7), (0.5, 0.4, 0.4)),
        "plaster": stone.plaster(rng, (0.8, 0.75, 0.7), (0.5, 0.4, 0.4)),
        "terracotta": stone.terracotta(rng, (0.7, 0.5, 0.4)),
        "cloth": cloth.damask(rng, (0.5, 0.1, 0.1), (0.8, 0.6, 0.3)),
        "wood": wood.planks(rng, (0.6, 0.45, 0.3), (0.4, 0.3, 0.2)),
        "ashlar": stone.ashlar(rng, (0.7, 0.66, 0.56), (0.5, 0.47, 0.4)),
    }
    for name, image in images.items():
        assert image.dtype == torch.uint8
        values = image.double()
        for axis in (0, 1):
            step = values.diff(dim=axis).abs().mean(dim=(1 - axis, 2))
            seam = (values.select(axis, 0) - values.select(axis, -1)).abs().mean()
            assert seam <= max(4 * float(step.mean()), float(step.max())), (name, axis)


def test_parts_are_joined_in_order():
    plate = quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))
    both = join([plate, plate.placed((0, 0, 4))])
    assert both.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    assert both.area == pytest.approx(2.0)


FINENESS = [0.05, 0.25, 0.45, 1.0, 3.0]


@pytest.mark.parametrize("fineness", FINENESS)
def test_arch_wall_and_vault_share_their_edges_at_every_fineness(fineness):
    """The wall above an arch begins where the arch ends, and fills the rest of its rectangle."""
    shape = plan.arch_shape(Detail(fineness))
    wall = arcade.spandrel(shape, 1.6, 1.6, 1.55)
    outline = shape.curve(shape.outer, shape.thickness / 2)
    sector = (np.sin(-np.diff(shape.angles)) * shape.outer**2 / 2).sum()
    assert {tuple(p) for p in np.round(outline, 9)} <= {tuple(p) for p in np.round(wall.vertices, 9)}
    assert wall.area == pytest.approx(3.2 * 1.55 - sector)
    segments = plan.vault_segments(Detail(fineness))
    vault = arcade.groin_vault((-1.38, 1.38), (0.0, 2.98), 1.5, segments)
    edge = {tuple(p) for p in np.round(arcade.lunette(1.38, 1.38, 1.5, segments).vertices, 9) + 0.0}
    assert edge <= {tuple(p) for p in np.round(vault.vertices, 9) + 0.0}


@pytest.mark.parametrize("fineness", FINENESS)
def test_columns_stand_from_floor_to_wall_at_every_fineness(fineness):
    order = dataclasses.replace(plan.GROUND_ORDER, detail=Detail(fineness))
    patch = orders.column(order)
    assert patch.vertices[:, 1].min() == 0
    assert patch.vertices[:, 1].max() == pytest.approx(order.height)
    heights = np.linspace(0.02, order.height - 0.02, 40)
    triangles = patch.vertices[patch.faces]
    crossed = (triangles[:, None, :, 1].min(axis=2) < heights) & (triangles[:, None, :, 1].max(axis=2) > heights)
    assert crossed.any(axis=0).all(), "no gap between the parts"


def test_finer_means_more_triangles_and_one_is_as_drawn():
    counts = [sum(patch.triangle_count for _, patch in court(Detail(f))) for f in (0.05, 0.12, 0.2, 0.5, 1.0, 2.0)]
    assert counts == sorted(counts)
    assert sum(patch.triangle_count for _, patch in court()) == counts[-2] == 210_888


@pytest.mark.parametrize("segments", [4, 16, 24, 96])
def test_curve_is_catmull_and_roms(segments):
    """Against the basis matrix of Catmull and Rom's spline, its ends continued by parabolas."""
    points = np.random.default_rng(0).standard_normal((9, 3))
    found = Detail(segments / 8).curve(points)
    before, after = (3 * (one - two) + three for one, two, three in (points[:3], points[:-4:-1]))
    padded = np.concatenate([[before], points, [after]])
    basis = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
    for k, time in enumerate(np.linspace(0, 8, segments + 1)):
        i = min(int(time), 7)
        power = (time - i) ** np.arange(4)
        np.testing.assert_allclose(found[k], power @ basis @ padded[i : i + 4], atol=1e-12)


def test_fitting_finds_the_greatest_number_below():
    """On steps of any size what is left over is less than the next step would take."""
    made = fitted(lambda detail: 100 * detail.segments(50), int, 3_333, 5_000, most=1.0)
    assert made == 3_300
    with pytest.raises(ValueError, match="detail: expected more triangles than 1000"):
        fitted(lambda detail: 2_000 + detail.segments(50), int, 1_000, 5_000)
