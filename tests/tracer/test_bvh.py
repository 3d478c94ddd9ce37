"""Closest hit and any hit against a brute force in float64, on ordinary and on hostile triangles and rays."""

import math

import pytest
import torch
from brute_force import check
from builders import box, generator, rounded, soup, sphere, triples

from fovden.checks import ShapeError
from fovden.tracer import build_bvh, intersect, occluded
from fovden.tracer.kernels.layout import BLOCK_SIZE, CHILDREN, MAX_BINARY_DEPTH, NODE_SIZE, PRIMITIVES, UPPER, WIDTH

INFINITY, NAN = math.inf, math.nan


def rays_at(vertices, faces, count, seed=1):
    """Half of the rays are aimed at triangles, half anywhere; both start in and around the mesh."""
    random = generator(seed)
    lower, upper = vertices.double().amin(0), vertices.double().amax(0)
    middle, size = (lower + upper) / 2, (upper - lower).amax()
    origins = middle + size * (torch.rand(count, 3, dtype=torch.float64, generator=random) * 2 - 1)
    weights = torch.rand(count, 3, 1, dtype=torch.float64, generator=random)
    chosen = vertices.double()[faces.long()][torch.randint(len(faces), (count,), generator=random)]
    targets = (chosen * weights).sum(1) / weights.sum(1)
    directions = torch.randn(count, 3, dtype=torch.float64, generator=random) * size
    directions[::2] = (targets - origins)[::2]
    return origins.float(), directions.float()


def judge(mesh, origins, directions, t_max=None):
    """Checks both questions; returns hits and the share of rays about which float32 leaves no doubt."""
    bvh = build_bvh(*mesh)
    hits = intersect(bvh, origins, directions, t_max)
    return hits, check(mesh, origins, directions, hits, occluded(bvh, origins, directions, t_max), t_max)


def coincident():
    vertices, _ = soup(1, seed=3)
    return vertices, torch.tensor([[0, 1, 2]] * 20, dtype=torch.int32)


def common_centroid():
    """Triangles of all sizes whose boxes have the same middle: no split of centroids separates them."""
    corners = torch.randn(33, 3, 3, dtype=torch.float64, generator=generator(4))
    corners -= (corners.amin(1, keepdim=True) + corners.amax(1, keepdim=True)) / 2
    return rounded(corners.reshape(-1, 3)), triples(33)


def flat():
    """A grid in the plane z = 0: boxes without thickness, edges that run along them."""
    vertices, faces = box((8, 8, 1), (8.0, 8.0, 0.0))
    return rounded(vertices), faces[-2 * 64 :]


def with_zero_area():
    """A soup in which every second triangle is a point, or a line in one of its two forms."""
    vertices, faces = soup(120, seed=5)
    corners = vertices.reshape(-1, 3, 3).clone()
    corners[::6] = corners[::6, :1]
    corners[2::6, 2] = corners[2::6, 0]
    corners[4::6, 2] = (corners[4::6, 0] + corners[4::6, 1]) / 2
    return corners.reshape(-1, 3), faces


def exponential():
    """Nested triangles, each half the size of the one around it, from 2^36 m down to 2^-36 m."""
    vertices, _ = soup(73, seed=6)
    scale = torch.exp2(torch.arange(-36, 37).double())[:, None, None]
    return rounded((vertices.double().reshape(-1, 3, 3) * scale).reshape(-1, 3)), triples(73)


def moved(mesh, scale=1.0, offset=(0.0, 0.0, 0.0)):
    vertices, faces = mesh
    return rounded(vertices, scale, offset), faces


def slivers():
    """Long, thin and askew: what is cut most."""
    vertices, faces = soup(100, seed=12)
    corners = vertices.reshape(-1, 3, 3).clone()
    corners[:, 2] = corners[:, 0] + (corners[:, 2] - corners[:, 0]) * 1e-3
    return (corners * 20).reshape(-1, 3), faces


MESHES = {
    "one": lambda: soup(1),
    "two": lambda: soup(2),
    "seven": lambda: soup(7),
    "eight": lambda: soup(8),
    "nine": lambda: soup(9),
    "thousand": lambda: soup(1000),
    "small among themselves": lambda: soup(300, size=0.02),
    "slivers": lambda: (soup(200)[0] * torch.tensor([1.0, 1.0, 1e-4]), triples(200)),
    "shared edges": lambda: moved(sphere(2)),
    "coincident": coincident,
    "common centroid": common_centroid,
    "flat": flat,
    "zero area": with_zero_area,
    "exponential": exponential,
    "a million metres away": lambda: moved(soup(300), 100.0, (1e6, -1e6, 1e6)),
    "micrometres": lambda: moved(soup(300), 1e-6),
    "a billion metres": lambda: moved(soup(300), 1e9),
}


@pytest.mark.parametrize("name", MESHES)
def test_hits_equal_a_brute_force(name):
    mesh = MESHES[name]()
    origins, directions = rays_at(*mesh, 2000)
    hits, clear = judge(mesh, origins, directions)
    assert float((hits.prim >= 0).float().mean()) > 0.1
    # Half of the rays run into a cascade of scales or a field of slivers, where every ray grazes something.
    assert clear > (0.3 if name in ("exponential", "slivers") else 0.9)


@pytest.mark.parametrize("name", ["nine", "thousand", "coincident", "flat"])
def test_limits_equal_a_brute_force(name):
    mesh = MESHES[name]()
    origins, directions = rays_at(*mesh, 2000, seed=2)
    t_max = torch.rand(2000, generator=generator(3)) * 2
    hits, clear = judge(mesh, origins, directions, t_max)
    unlimited = intersect(build_bvh(*mesh), origins, directions)
    assert 0 < int((hits.prim >= 0).sum()) < int((unlimited.prim >= 0).sum())
    assert clear > 0.9


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 500])
def test_axis_aligned_rays_equal_a_brute_force(count):
    mesh = soup(count, seed=count)
    origins, _ = rays_at(*mesh, 2000, seed=4)
    directions = torch.eye(3)[torch.arange(2000) % 3]
    directions = torch.where(
        directions == 0, torch.tensor([0.0, -0.0])[torch.arange(2000) // 3 % 2][:, None], directions
    )
    directions[::2] *= -1
    origins[::5] = mesh[0][torch.randint(len(mesh[0]), (400,), generator=generator(5))]  # in the planes of box sides
    _, clear = judge(mesh, origins, directions)
    assert clear > 0.7


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_rays_along_edges_and_box_sides_hit(zero):
    # The grid's lines are the sides of leaf boxes, which the ray runs along or in: 0 / 0 in the slab test.
    x, y = torch.meshgrid(torch.arange(-3.0, 3.1, 0.5), torch.arange(-3.0, 3.1, 0.5), indexing="ij")
    origins = torch.stack([x.flatten(), y.flatten(), torch.full_like(x, 2.5).flatten()], dim=1)
    bvh = build_bvh(*flat())
    for direction in [(zero, zero, -1.0), (zero, 0.25, -1.0), (-0.25, zero, -1.0), (0.25, 0.25, -1.0)]:
        directions = torch.tensor(direction).expand_as(origins)
        hits = intersect(bvh, origins, directions)
        assert hits.t.eq(2.5).all()
        assert occluded(bvh, origins, directions).all()
    away = torch.tensor([zero, zero, 1.0]).expand_as(origins)
    assert not occluded(bvh, origins, away).any()


def test_rays_in_the_plane_of_triangles_miss_them():
    mesh = flat()
    angles = torch.arange(400) * 0.1
    directions = torch.stack([angles.cos(), angles.sin(), torch.zeros(400)], dim=1)
    directions[:4] = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, -0.0], [0, -1, -0.0]])
    origins = torch.rand(400, 3, generator=generator(0)) * 8 - 4
    origins[::2, :2] = origins[::2, :2].round()
    origins[:, 2] = 0
    bvh = build_bvh(*mesh)
    assert intersect(bvh, origins, directions).prim.eq(-1).all()
    assert not occluded(bvh, origins, directions).any()


def test_triangles_of_zero_area_are_never_hit():
    # Exact in float32, so that every ray passes through the point or the line as closely as rays can.
    corner, edge = torch.tensor([1.0, 2.0, 3.0]), torch.tensor([0.5, 0.75, -1.25])
    point = torch.stack([corner, corner, corner])
    folded = torch.stack([corner, corner + edge, corner])
    straight = torch.stack([corner, corner + edge, corner + 0.25 * edge])
    along = torch.rand(20000, 1, generator=generator(1))
    for triangle in (point, folded, straight, straight.flip(0)):
        targets = triangle[0] + along * (triangle[1] - triangle[0])
        origins = targets + torch.randn(20000, 3, generator=generator(2))
        bvh = build_bvh(triangle, torch.tensor([[0, 1, 2]]))
        assert intersect(bvh, origins, targets - origins).prim.eq(-1).all()
        assert not occluded(bvh, origins, targets - origins).any()


def test_one_far_vertex_does_not_spoil_the_rest():
    vertices, faces = soup(200, seed=8)
    far = torch.tensor([[1e30, 1e30, 1e30], [1e30, -1e30, 1e30], [-1e30, 1e30, 1e30]])
    bvh = build_bvh(torch.cat([vertices, far]), torch.cat([faces, torch.tensor([[600, 601, 602]], dtype=torch.int32)]))
    origins, directions = rays_at(vertices, faces, 2000)
    hits, alone = intersect(bvh, origins, directions), intersect(build_bvh(vertices, faces), origins, directions)
    near = alone.prim >= 0
    assert torch.equal(hits.prim[near], alone.prim[near])
    assert torch.equal(hits.t[near], alone.t[near])


def test_coordinates_beyond_the_squares_of_float32_end_quietly():
    # Areas overflow above 1e19 and vanish below 1e-19; such triangles may be missed, but nothing hangs or is invented.
    for scale in (1e25, 1e30, 3e38, 1e-25, 1e-38, 1e-44):
        vertices = soup(100)[0] / 1.5 * scale
        bvh = build_bvh(vertices, triples(100))
        origins, directions = rays_at(vertices, triples(100), 500)
        hits = intersect(bvh, origins, directions)
        hit = hits.prim >= 0
        assert torch.equal(hit, torch.isfinite(hits.t))
        assert (hits.t[hit] > 0).all()


BAD = [
    (0.0, 0.0, 0.0),
    (-0.0, 0.0, -0.0),
    (NAN, 0.0, 1.0),
    (INFINITY, 0.0, 0.0),
    (1.0, -INFINITY, 1.0),
    (NAN, NAN, NAN),
]


@pytest.mark.parametrize("bad", BAD, ids=str)
def test_unusable_directions_miss(bad):
    bvh = build_bvh(*soup(50))
    origins, directions = rays_at(*soup(50), 64)
    expected = intersect(bvh, origins, directions)
    directions[1::2] = torch.tensor(bad)
    hits = intersect(bvh, origins, directions)
    assert hits.prim[1::2].eq(-1).all()
    assert hits.t[1::2].eq(INFINITY).all()
    assert hits.u[1::2].eq(0).all()
    assert torch.equal(hits.t[::2], expected.t[::2])  # its neighbours are unharmed
    assert not occluded(bvh, origins, directions)[1::2].any()


@pytest.mark.parametrize("bad", [(NAN, 0.0, 0.0), (0.0, INFINITY, 0.0), (0.0, 0.0, -INFINITY)], ids=str)
def test_unusable_origins_miss(bad):
    bvh = build_bvh(*soup(50))
    origins, directions = rays_at(*soup(50), 64)
    origins[:] = torch.tensor(bad)
    assert intersect(bvh, origins, directions).prim.eq(-1).all()
    assert not occluded(bvh, origins, directions).any()


def test_the_limit_is_open_and_in_units_of_the_direction():
    bvh = build_bvh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
    limits = torch.tensor([2.0, math.nextafter(2.0, 3.0) + 1e-6, 1.999, 0.0, -1.0, NAN, INFINITY])
    origins = torch.tensor([0.25, 0.25, 4.0]).expand(7, 3)
    directions = torch.tensor([0.0, 0.0, -2.0]).expand(7, 3)
    expected = torch.tensor([False, True, False, False, False, False, True])
    hits = intersect(bvh, origins, directions, limits)
    assert torch.equal(hits.prim >= 0, expected)
    assert torch.equal(occluded(bvh, origins, directions, limits), expected)
    assert hits.t[expected].eq(2.0).all()


def test_neighbours_that_are_stopped_do_not_stop_a_ray():
    """Rows of rays towards two lights, which the same triangles stop in turn; first hits know nothing of neighbours."""
    bvh = build_bvh(*soup(150))
    across, down = torch.meshgrid(torch.linspace(-2, 2, 160), torch.linspace(-2, 2, 160), indexing="ij")
    origins = torch.stack([across, torch.full_like(across, -2.0), down], -1).reshape(-1, 3)
    lights = torch.tensor([[1.0, 3.0, 0.5], [-1.5, 2.5, -0.5]])
    directions = lights[torch.randint(2, (len(origins),), generator=generator(6))] - origins
    limits = 1.2 * torch.rand(len(origins), generator=generator(7))
    stopped = intersect(bvh, origins, directions, limits).prim >= 0
    assert 0.2 < float(stopped.float().mean()) < 0.8
    assert torch.equal(occluded(bvh, origins, directions, limits), stopped)
    shuffled = torch.randperm(len(origins), generator=generator(8))
    assert torch.equal(occluded(bvh, origins[shuffled], directions[shuffled], limits[shuffled]), stopped[shuffled])


def test_a_hit_behind_the_origin_is_none():
    bvh = build_bvh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
    origins = torch.tensor([[0.25, 0.25, -4.0], [0.25, 0.25, 0.0]])  # behind, and on it
    directions = torch.tensor([0.0, 0.0, -1.0]).expand(2, 3)
    assert intersect(bvh, origins, directions).prim.eq(-1).all()
    assert not occluded(bvh, origins, directions).any()


def test_the_length_of_the_direction_scales_t():
    mesh = soup(300)
    bvh = build_bvh(*mesh)
    origins, directions = rays_at(*mesh, 1000)
    hits = intersect(bvh, origins, directions)
    for power in (-40, -20, -1, 7, 40):  # powers of two scale every operation of the tests exactly
        scaled = intersect(bvh, origins, directions * 2.0**power)
        assert torch.equal(scaled.prim, hits.prim)
        assert torch.equal(scaled.t * 2.0**power, hits.t)
    for factor in (1e-12, 3.0, 1e12):
        judge(mesh, origins, directions * factor)


def test_no_rays_give_no_hits():
    bvh = build_bvh(*soup(9))
    hits = intersect(bvh, torch.empty(0, 3), torch.empty(0, 3), torch.empty(0))
    assert [tuple(field.shape) for field in hits] == [(0,)] * 4
    assert hits.prim.dtype == torch.int32
    assert occluded(bvh, torch.empty(0, 3), torch.empty(0, 3)).shape == (0,)


def test_tensors_of_any_layout_and_type_are_read():
    vertices, faces = soup(50)
    origins, directions = rays_at(vertices, faces, 200)
    expected = intersect(build_bvh(vertices, faces), origins, directions, torch.full((200,), 1.5))
    strided = build_bvh(vertices.double().t().contiguous().t(), faces.long().flip(1).flip(1))
    rays = (origins.t().contiguous().t(), directions.double().requires_grad_())
    limit = torch.full((400,), 1.5, dtype=torch.float64)[::2]
    for got, wanted in zip(intersect(strided, *rays, limit), expected, strict=True):
        assert torch.equal(got, wanted)
    assert torch.equal(occluded(strided, *rays, limit), expected.prim >= 0)
    one = intersect(build_bvh(vertices, faces), origins[:1].expand(7, 3), directions[:1].expand(7, 3))
    assert one.t.eq(one.t[0]).all()


def test_wrong_shapes_are_named():
    bvh = build_bvh(*soup(9))
    good = torch.zeros(5, 3)
    with pytest.raises(ShapeError, match=r"origins.*\(5, 2\)"):
        intersect(bvh, torch.zeros(5, 2), good)
    with pytest.raises(ShapeError, match=r"directions.*n=5.*\(4, 3\)"):
        intersect(bvh, good, torch.zeros(4, 3))
    with pytest.raises(ShapeError, match=r"t_max.*n=5.*\(1,\)"):
        occluded(bvh, good, good, torch.zeros(1))
    with pytest.raises(ShapeError, match=r"origins.*\(3,\)"):
        occluded(bvh, torch.zeros(3), torch.zeros(3))
    with pytest.raises(ShapeError, match="vertices"):
        build_bvh(torch.zeros(3, 2), torch.tensor([[0, 1, 2]]))
    with pytest.raises(ShapeError, match="faces"):
        build_bvh(torch.zeros(3, 3), torch.tensor([0, 1, 2]))
    with pytest.raises(ValueError, match="faces: expected at least one triangle"):
        build_bvh(torch.zeros(3, 3), torch.zeros(0, 3, dtype=torch.int32))
    with pytest.raises(TypeError, match="directions: expected a tensor"):
        intersect(bvh, good, good.tolist())


def cascade():
    """Four triangles an octave over all of float32: far more splits by area in a row than the tree may be deep."""
    scale = torch.exp2(torch.arange(-120, 120, 0.25).double())[:, None, None]
    corners = torch.tensor([[1.0, 0, 0], [1, 0.01, 0], [1, 0, 0.01]], dtype=torch.float64) * scale
    return rounded(corners.reshape(-1, 3)), triples(len(corners))


@pytest.mark.parametrize(
    "make",
    [
        *(MESHES[name] for name in ("one", "eight", "nine", "thousand")),
        *(coincident, common_centroid, with_zero_area, exponential, cascade, slivers),
    ],
)
def test_the_tree_holds_every_triangle_and_all_of_it_within_its_boxes(make):
    vertices, faces = make()
    bvh = build_bvh(vertices, faces)
    bounds, children = bvh.nodes[:, :CHILDREN].double(), bvh.nodes.view(torch.int32)[:, CHILDREN : CHILDREN + WIDTH]
    prims = bvh.blocks.view(torch.int32)[:, PRIMITIVES : PRIMITIVES + WIDTH]
    assert bvh.nodes.shape[1] == NODE_SIZE
    assert bvh.blocks.shape[1] == BLOCK_SIZE
    held, waiting = (
        [[] for _ in faces],
        [(0, torch.full((3,), -INFINITY).double(), torch.full((3,), INFINITY).double(), 1)],
    )
    while waiting:
        node, lower, upper, depth = waiting.pop()
        # Nodes are split at the median below that depth: 2^31 triangles make 28 levels more.
        assert depth <= MAX_BINARY_DEPTH + 28
        for lane in range(WIDTH):
            low, high = bounds[node, lane:UPPER:WIDTH], bounds[node, UPPER + lane :: WIDTH]
            if (low > high).all():
                continue  # an unused lane
            assert (low >= lower).all()
            assert (high <= upper).all()
            child = int(children[node, lane])
            if child >= 0:
                waiting.append((child, low, high, depth + 1))
                continue
            for prim in prims[~child].tolist():
                if prim >= 0:
                    held[prim].append((low, high))
    weights = torch.rand(64, 3, 1, dtype=torch.float64, generator=generator(11))
    weights = torch.cat([torch.eye(3, dtype=torch.float64)[..., None], weights / weights.sum(1, keepdim=True)])
    for prim, leaves in enumerate(held):
        points = (vertices.double()[faces[prim].long()] * weights).sum(1)
        inside = torch.stack([((points >= low) & (points <= high)).all(1) for low, high in leaves])
        assert inside.any(0).all(), f"a part of triangle {prim} is in none of its {len(leaves)} leaves"
    assert max(map(len, held)) > 1 or len(faces) < 100 or make is not MESHES["thousand"]  # some are cut
