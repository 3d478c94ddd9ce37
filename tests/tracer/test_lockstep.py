"""The walk by tensor operations against the kernels: the same bits, for ordinary rays and for the worst ones."""

import math

import pytest
import torch
from builders import generator, scene_of, soup
from test_simd_twins import numbers

from fovden.tracer import Material, build_bvh, intersect, make_scene, occluded
from fovden.tracer.lockstep import RAYS_AT_ONCE, closest_hits, decoded

COUNT = 4000


def rays_in(scene, count, seed=1):
    """Rays that start within the bounds of a scene and go anywhere."""
    random = generator(seed)
    lower, upper = scene.vertices.amin(0), scene.vertices.amax(0)
    return lower + (upper - lower) * torch.rand(count, 3, generator=random), torch.randn(count, 3, generator=random)


def agree(bvh, origins, directions, t_max=None):
    """Asserts that both backends give the same bits; returns the share of rays that hit."""
    hits = intersect(bvh, origins, directions, t_max)
    for mine, other in zip(hits, intersect(bvh, origins, directions, t_max, backend="torch"), strict=True):
        assert mine.dtype == other.dtype
        assert torch.equal(mine.view(torch.int32), other.view(torch.int32))
    blocked = occluded(bvh, origins, directions, t_max)
    assert torch.equal(blocked, occluded(bvh, origins, directions, t_max, backend="torch"))
    return float((hits.prim >= 0).float().mean())


@pytest.mark.parametrize("count", [1, 2, 9, 3000])
def test_triangles_anywhere(count):
    origins, directions = torch.randn(2, COUNT, 3, generator=generator(count))
    directions[::2] = -origins[::2]
    share = agree(build_bvh(*soup(count)), origins, directions)
    assert 0 < share < 1


def test_cornell_box():
    scene = make_scene("cornell_box")
    origins, directions = rays_in(scene, COUNT)
    # Along the walls' axes: zeros in the direction, ties, and edges between coplanar triangles.
    directions[: COUNT // 4] = torch.eye(3)[torch.arange(COUNT // 4) % 3]
    origins[: COUNT // 8] = origins[: COUNT // 8].round()
    assert agree(scene.bvh, origins, directions) > 0.8


def test_rays_that_are_not_numbers_and_ends():
    bvh = build_bvh(*soup(500))
    origins, directions = numbers((COUNT, 3), 0.05, seed=8), numbers((COUNT, 3), 0.05, seed=9)
    t_max = torch.rand(COUNT, generator=generator(10)) * 2
    t_max[::5], t_max[1::50], t_max[2::50], t_max[3::50] = math.inf, math.nan, 0.0, -1.0
    assert 0.05 < agree(bvh, origins, directions, t_max) < 0.5
    strange = ~torch.isfinite(origins + directions).all(1)
    assert int(strange.sum()) > COUNT // 20
    assert (intersect(bvh, origins, directions, t_max, backend="torch").prim[strange] == -1).all()


def test_many_rays_and_none():
    bvh = build_bvh(*soup(20))
    origins, directions = torch.randn(2, RAYS_AT_ONCE + 1, 3, generator=generator(3))
    assert agree(bvh, origins, directions) > 0
    assert len(intersect(bvh, origins[:0], directions[:0], backend="torch").t) == 0


def test_a_stack_that_grows(monkeypatch):
    monkeypatch.setattr("fovden.tracer.lockstep.FIRST_STACK", 8)
    origins, directions = torch.randn(2, 300, 3, generator=generator(4))
    agree(build_bvh(*soup(3000)), origins * 0.1, directions)


def test_through_a_scene():
    scene = make_scene("cornell_box")
    rays = rays_in(scene, 100)
    assert torch.equal(scene.intersect(*rays).t, scene.intersect(*rays, backend="torch").t)
    assert torch.equal(scene.occluded(*rays), scene.occluded(*rays, backend="torch"))
    with pytest.raises(ValueError, match=r"backend: expected 'kernels' or 'torch', got embree"):
        scene.intersect(*rays, backend="embree")


def test_holes():
    """Triangles with an opacity image, all over the place, and as many without."""
    mesh, opacity = soup(200), torch.randint(0, 256, (7, 5), generator=generator(6), dtype=torch.uint8)
    materials = (Material("leaf", (0.5, 0.5, 0.5), opacity=opacity, cutoff=0.4), Material("wall", (0.5, 0.5, 0.5)))
    uv = 3 * torch.randn(len(mesh[0]), 2, generator=generator(7))
    scene = scene_of(mesh, *materials, uv=uv, material_ids=torch.arange(200) % 2)
    origins, directions = torch.randn(2, COUNT, 3, generator=generator(5))
    rays = origins, directions - 0.5 * origins
    hits, there = scene.intersect(*rays), scene.intersect(*rays, backend="torch")
    for mine, other in zip(hits, there, strict=True):
        assert torch.equal(mine.view(torch.int32), other.view(torch.int32))
    assert torch.equal(scene.occluded(*rays), scene.occluded(*rays, backend="torch"))
    solid = scene.intersect(*rays, cutouts=False, backend="torch")
    assert torch.equal(solid.prim, scene.intersect(*rays, cutouts=False).prim)
    assert 0.05 < float((solid.prim != hits.prim).float().mean()) < 0.5


@pytest.mark.parametrize("size", [1e-30, 1e-18, 1e18, 1e30])
def test_directions_of_any_length(size):
    bvh = build_bvh(*soup(500))
    origins, directions = torch.randn(2, COUNT, 3, generator=generator(11))
    assert agree(bvh, origins, size * (directions - origins), torch.full((COUNT,), 0.9 / size)) > 0.05


def test_of_equals_the_lowest():
    vertices, faces = soup(30)
    bvh = build_bvh(vertices, faces.repeat(9, 1))
    origins, directions = torch.randn(2, COUNT, 3, generator=generator(12))
    directions = directions - 2 * origins
    assert agree(bvh, origins, directions) > 0.1
    assert int(intersect(bvh, origins, directions, backend="torch").prim.max()) < 30


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu():
    scene = make_scene("cornell_box")
    rays = rays_in(scene, COUNT)
    there = scene.intersect(*(ray.cuda() for ray in rays), backend="torch")
    for mine, other in zip(scene.intersect(*rays), there, strict=True):
        assert other.is_cuda
        assert torch.equal(mine, other.cpu())
    structure = decoded(*(part.cuda() for part in scene.bvh))
    far = torch.full((COUNT,), math.inf, device="cuda")
    found = closest_hits(structure, *(ray.cuda() for ray in rays), far, any_hit=True)[3] >= 0
    assert torch.equal(found.cpu(), scene.occluded(*rays))
