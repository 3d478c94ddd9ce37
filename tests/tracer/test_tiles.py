"""Rays in tiles of sixteen give the bits of single rays, whatever the camera sees and wherever it looks."""

import numpy as np
import pytest
import torch
from builders import generator, rounded, soup, sphere

from fovden.camera import StereoCamera
from fovden.tracer import build_bvh, intersect
from fovden.tracer.bvh import _no_geometry
from fovden.tracer.kernels.tiles import closest_pixels


def by_tiles(bvh, origin, directions):
    height, width, _ = directions.shape
    t, u, v = np.empty((3, height, width), np.float32)
    prim = np.empty((height, width), np.int32)
    arrays = bvh.nodes.numpy(), bvh.blocks.numpy(), _no_geometry(), False, origin.numpy(), directions.numpy()
    closest_pixels(0, -(-height // 4) * -(-width // 4), *arrays, t, u, v, prim)
    return [torch.from_numpy(field) for field in (t, u, v, prim)]


def assert_same(bvh, origin, directions):
    rays = directions.reshape(-1, 3)
    single = intersect(bvh, origin.expand_as(rays).contiguous(), rays)
    for mine, other in zip(by_tiles(bvh, origin, directions), single, strict=True):
        assert torch.equal(mine.reshape(-1).view(torch.int32), other.view(torch.int32))
    return single


# Looking along an axis, every sign and every largest component meets every other in some tile.
VIEWS = {
    "askew": ((2.5, 1.5, 2.0), (0.1, 0.0, -0.2)),
    "along z": ((0.0, 0.0, 3.0), (0.0, 0.0, 0.0)),
    "along x": ((-3.0, 0.1, 0.0), (0.0, 0.1, 0.0)),
    "diagonal": ((3.0, 0.0, 3.0), (0.0, 0.0, 0.0)),
    "from inside": ((0.1, 0.05, 0.2), (1.0, 0.3, 0.9)),
}

MESHES = {"soup": lambda: soup(3000, size=0.15), "sphere": lambda: (rounded(sphere(3)[0]), sphere(3)[1])}


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("make", MESHES.values(), ids=MESHES)
def test_tiles_give_the_bits_of_single_rays(name, make):
    eye, target = VIEWS[name]
    camera = StereoCamera.look_at(eye, target, fov_x_deg=80, resolution=(66, 71)).views
    origins, directions = (field.reshape(2, 66, 71, 3).contiguous() for field in camera.rays())
    bvh = build_bvh(*make())
    for view in range(2):
        hits = assert_same(bvh, origins[view, 0, 0], directions[view])
        assert float((hits.prim >= 0).float().mean()) > 0.05


def test_far_and_small_scenes_and_shared_distances():
    for scale, offset in ((1.0, (1e6, -1e6, 1e6)), (1e-6, (0.0, 0.0, 0.0)), (1e6, (0.0, 0.0, 0.0))):
        vertices, faces = soup(500)
        vertices, faces = rounded(vertices, scale, offset), torch.cat([faces, faces.flip(0)])  # every triangle twice
        origin = rounded(torch.tensor([[2.5, 1.5, 2.0]]), scale, offset)[0]
        raster = torch.stack(torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(-1, 1, 40), indexing="ij"), -1)
        directions = torch.cat([raster * 0.3 - 0.6, -torch.ones(40, 40, 1)], -1)
        assert int((assert_same(build_bvh(vertices, faces), origin, directions).prim >= 0).sum()) > 100


def test_unusable_rays_in_a_tile_leave_the_others_alone():
    bvh = build_bvh(*soup(500))
    random = generator(3)
    directions = torch.tensor([-0.6, -0.5, -1.0]) + 0.3 * torch.rand(32, 32, 3, generator=random)
    for place, bad in enumerate(([0.0, 0.0, 0.0], [torch.nan, 1.0, 1.0], [-torch.inf, -1.0, -1.0], [0.0, -1.0, -1.0])):
        directions[4 * place, 5 * place] = torch.tensor(bad)
    directions[20:24, 20:24] *= 1e30
    directions[24:28, 24:28] *= 1e-30
    assert_same(bvh, torch.tensor([2.0, 1.5, 2.5]), directions)
