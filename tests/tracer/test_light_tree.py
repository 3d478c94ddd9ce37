"""The tree over lights: bounds that hold, chances that are exact, no light left out, and less noise."""

import math

import numba
import numpy as np
import pytest
import torch
from shapes import box, matt, pixels, rectangle, scene_of, view
from significance import assert_counts, assert_mean, assert_same_mean, sidak

from fovden.tracer import DirectionalLight, EnvironmentLight, Integrator, PointLight, make_scene, trace_frame
from fovden.tracer.arrays import light_table
from fovden.tracer.kernels.illumination import light_chance, light_pointers, pick_light
from fovden.tracer.kernels.light_tree import AXIS, CHILD, COSINE, PARENT, POWER, RADIUS, ROOT
from fovden.tracer.kernels.surface import Surface
from fovden.tracer.kernels.vectors import Vector
from fovden.tracer.light_tree import build_light_tree

FLOOR = rectangle((-4, 0, -4), (0, 0, 8), (8, 0, 0))


def cloud(count, seed=0, points=0.5):
    """Corners and powers of lights in clusters; a share of them points, the rest triangles of all sizes."""
    random = np.random.default_rng(seed)
    places = random.normal(size=(1 + count // 20, 3))[random.integers(0, 1 + count // 20, count)] * 4
    corners = places[:, None] + random.normal(size=(count, 3, 3)) * 10 ** random.uniform(-3, 0, (count, 1, 1))
    is_point = random.random(count) < points
    corners[is_point] = corners[is_point, :1]
    return torch.from_numpy(corners), torch.from_numpy(10 ** random.uniform(-3, 1, count))


# The nodes


@pytest.mark.parametrize("count", [1, 2, 3, 80, 1000])
def test_nodes_bound_what_lies_below_them(count):
    corners, power = cloud(count, seed=count)
    nodes, leaves = build_light_tree(corners, power)
    numbers = nodes.view(torch.int32)
    assert nodes.shape == (2 * count, 16)
    assert len(leaves.unique()) == count
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_point = normal.norm(dim=1) == 0
    normal = torch.nn.functional.normalize(normal, dim=1)
    total = torch.zeros(2 * count, dtype=torch.float64)
    for light in range(count):
        node = int(leaves[light])
        assert numbers[node, CHILD] == ~light
        while True:
            sphere, axis, cosine = nodes[node, :3].double(), nodes[node, AXIS : AXIS + 3].double(), nodes[node, COSINE]
            assert (corners[light] - sphere).square().sum(1).max() <= nodes[node, RADIUS]
            assert float(axis.norm()) == pytest.approx(1, abs=1e-6)
            assert cosine == -1 if is_point[light] else normal[light] @ axis >= cosine
            total[node] += power[light] / power.sum()
            if node == ROOT:
                break
            parent = int(numbers[node, PARENT])
            assert numbers[parent, CHILD] == node & ~1
            node = parent
    np.testing.assert_allclose(nodes[1:, POWER], total[1:], rtol=1e-5)


def test_lights_without_power_stay_outside():
    corners, power = cloud(10)
    power[[2, 5]] = 0
    nodes, leaves = build_light_tree(corners, power)
    assert nodes.shape == (16, 16)
    assert (leaves == 0).nonzero()[:, 0].tolist() == [2, 5]
    assert build_light_tree(corners, torch.zeros(10)).nodes.shape == (0, 16)


def depth(leaves, nodes):
    """Levels from the deepest leaf to the root."""
    parents, current, levels = nodes.view(torch.int32)[:, PARENT].long(), leaves.long(), 0
    while (current != ROOT).any():
        current = torch.where(current == ROOT, current, parents[current])
        levels += 1
    return levels


def test_lamps_in_a_row_or_at_one_place_make_no_list():
    row, place = torch.zeros(1000, 1, 3), torch.ones(1000, 1, 3)
    row[:, 0, 0] = torch.arange(1000.0)
    for corners in (row, place):
        nodes, leaves = build_light_tree(corners, torch.ones(1000))
        assert depth(leaves, nodes) == 10  # the least for 1000


# Chances


@numba.njit
def surface_of(position, normal):
    p, n = Vector(position[0], position[1], position[2]), Vector(normal[0], normal[1], normal[2])
    return Surface(p, n, n, n, np.float32(0.0), 0, np.float32(1.0), np.float32(0.0))


@numba.njit
def chances(table, position, normal, out):
    lights, surface = light_pointers(table), surface_of(position, normal)
    for light in range(len(out)):
        out[light] = light_chance(lights, surface, light)


@numba.njit
def choices(table, position, normal, numbers, rows, out):
    lights, surface = light_pointers(table), surface_of(position, normal)
    for i in range(len(numbers)):
        rows[i], out[i] = pick_light(lights, surface, numbers[i])


def table_of(count, seed=0, others=()):
    """A table of points and triangles, and of lights without a place."""
    corners, power = cloud(count, seed)
    is_point = (corners == corners[:, :1]).all(2).all(1)
    lights = [
        *others,
        *(PointLight(tuple(c[0].tolist()), float(p)) for c, p in zip(corners[is_point], power[is_point], strict=True)),
    ]
    parts = [(corners[i : i + 1], matt(0.5, float(power[i]))) for i in (~is_point).nonzero()[:, 0].tolist()]
    scene = scene_of([*parts, (FLOOR, matt(0.5))], lights)
    return light_table(scene, "tree"), scene


def places(count, seed=0):
    """Random surfaces in and around the lights."""
    random = np.random.default_rng(seed)
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (random.normal(size=(count, 3)) * 6).astype(np.float32), normals.astype(np.float32)


def chance_at(table, position, normal):
    out = np.empty(len(table.kind), dtype=np.float32)
    chances(table, position, normal, out)
    return out.astype(np.float64)


def contributes(scene, table, position, normal):
    """Whether any point of each light shines on a surface, by dense sampling of triangles; float64."""
    inside = np.random.default_rng(5).dirichlet((1, 1, 1), 200)
    lit = []
    for row in range(len(table.kind)):
        if table.prim[row] >= 0:
            corners = scene.vertices[scene.faces[table.prim[row]].long()].double().numpy()
            towards = np.concatenate([inside, np.eye(3)]) @ corners - position
            facing = towards @ np.cross(corners[1] - corners[0], corners[2] - corners[0]) < 0
        else:
            towards, facing = table.vector[row].astype(np.float64)[None] - position, np.array([True])
        lit.append(bool(((towards @ normal.astype(np.float64) > 0) & facing).any()))
    return np.array(lit)


@pytest.mark.parametrize("others", [(), (DirectionalLight((0, -1, 0), 1), EnvironmentLight(1))], ids=["all", "outside"])
def test_chances_sum_to_one_and_no_light_that_shines_is_left_out(others):
    table, scene = table_of(120, seed=3, others=others)
    lit_any = 0
    for position, normal in zip(*places(60, seed=4), strict=True):
        found = chance_at(table, position, normal)
        assert found.sum() == pytest.approx(1, abs=1e-5)
        np.testing.assert_allclose(found[: len(others)], 1 / (1 + len(others)) if others else [], rtol=1e-6)
        lit = contributes(scene, table, position, normal) if not others else np.ones(len(found), dtype=bool)
        lit_any += lit.mean()
        assert (found[lit] > 0).all()
    assert lit_any > 10


def test_lights_that_only_graze_are_not_left_out():
    """Just above the horizons of surface and lamp, where bounds and the light itself round differently."""
    for scale in (1e-6, 1.0, 1e6):
        lamp = rectangle((-1, 0, -1), (0, 2, 0), (0, 0, 2)) * scale  # faces +x
        lights = [PointLight((scale * x, 1e-7 * scale, 0), 1) for x in (1, 2, 3)]
        table = light_table(scene_of([(lamp, matt(0, 1 / scale**2))], lights), "tree")
        position, normal = np.array([0, 0, 0], dtype=np.float32), np.array([0, 1, 0], dtype=np.float32)
        found = chance_at(table, position, normal)
        assert (found > 1e-5).all()
        assert found.sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("others", [(), (DirectionalLight((0, -1, 0), 1), EnvironmentLight(1))], ids=["all", "outside"])
def test_lights_are_chosen_as_often_as_their_chance_says(others):
    table, _ = table_of(40, seed=6, others=others)
    count, surfaces = 200_000, places(8, seed=7)
    for number, (position, normal) in enumerate(zip(*surfaces, strict=True)):
        numbers = np.random.default_rng(number).random(count, dtype=np.float32)
        rows, out = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.float32)
        choices(table, position, normal, numbers, rows, out)
        found = chance_at(table, position, normal)
        np.testing.assert_allclose(out, found[rows], rtol=1e-5)
        likely = found * count >= 30
        counts = np.bincount(rows, minlength=len(found))
        rest = max(0.0, 1 - found[likely].sum())
        if rest * count >= 30:
            assert_counts([*counts[likely], counts[~likely].sum()], [*found[likely], rest], sidak(8))
        else:
            assert_counts(counts[likely], found[likely] / found[likely].sum(), sidak(8))


def test_chances_follow_distance_cosine_and_power():
    """Two lamps alone are the two children of the root: each by power * cosine / distance^2, exactly."""
    lamps = [PointLight((0, 2, 0), 3), PointLight((1, 1, 0), 1)]
    table = light_table(scene_of([(FLOOR, matt(1))], lamps), "tree")
    found = chance_at(table, np.zeros(3, dtype=np.float32), np.array([0, 1, 0], dtype=np.float32))
    weights = np.array([3 / 4, 1 / 2 / math.sqrt(2)])
    np.testing.assert_allclose(found, weights / weights.sum(), rtol=1e-6)


# Pictures


def lamp_hall(count=500):
    """A hall whose ceiling has many small lamps of different colours, two triangles each, and a floor."""
    random = np.random.default_rng(8)
    parts = [(box((-10, 0, -10), (10, 3, 10), inwards=True), matt(0.5))]
    for _ in range(count):
        x, z, size = *random.uniform(-9, 9, 2), random.uniform(0.02, 0.1)
        lamp = rectangle((x, random.uniform(2, 2.9), z), (size, 0, 0), (0, 0, size))
        parts.append((lamp, matt(0, tuple(random.uniform(1, 30, 3)))))
    return scene_of(parts), view((8, 1.6, 8), (0, 0.5, 0), size=24, fov=60)


@pytest.mark.parametrize("name", ["forest", "hall"])
def test_the_mean_is_the_same_and_the_variance_less(name):
    if name == "forest":
        scene = make_scene("forest")
        camera, times = scene.camera.at(resolution=(24, 24)), 3
    else:
        (scene, camera), times = lamp_hall(), 3
    radiance, spread = {}, {}
    for lights, spp in (("power", 64), ("tree", 16)):
        frames = [
            trace_frame(scene, camera, spp, seed=seed, integrator=Integrator(lights=lights, bounces=0))
            for seed in range(40)
        ]
        values = np.stack([frame.direct.double().numpy() for frame in frames])
        radiance[lights] = values.mean((1, 3, 4))
        spread[lights] = values.var(0, ddof=1).mean() * spp
    assert_same_mean(radiance["tree"], radiance["power"])
    assert times * spread["tree"] < spread["power"]


def test_bounces_that_meet_lamps_of_the_tree_are_weighed_right():
    """The mean with and without bounces that find the lamps: chances at a bounce's end go up the tree."""
    scene, camera = lamp_hall(40)
    batches = {}
    for bounces in (0, 1):
        setting = Integrator(lights="tree", bounces=bounces)
        frames = [trace_frame(scene, camera, 64, seed=seed, integrator=setting) for seed in range(20)]
        batches[bounces] = np.concatenate([pixels(frame.direct).mean(1) for frame in frames])
    assert_same_mean(batches[0], batches[1])


def test_one_lamp_in_a_tree_is_lamberts():
    scene = scene_of(
        [(FLOOR, matt(1))], [PointLight((0, 2, 0), 3), DirectionalLight((0, -1, 0), 2), PointLight((0, 1, 0), 0)]
    )
    frames = [
        trace_frame(
            scene, view((0, 1.0, 0.1), (0, 0, 0), size=1, fov=0.1), 64, seed=s, integrator=Integrator(lights="tree")
        )
        for s in range(16)
    ]
    direct = np.concatenate([pixels(frame.direct)[:, 0] for frame in frames])
    assert_mean(direct, (3 / 4 + 2) / math.pi)
