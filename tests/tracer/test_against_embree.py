"""Hits in Sponza against Embree's, on a million rays; where the two disagree, a brute force in float64 decides."""

import math

import numpy as np
import pytest
import torch
from brute_force import check
from builders import generator

from fovden.camera import StereoCamera
from fovden.tracer import Hits, intersect, load_scene, occluded

embreex = pytest.importorskip("embreex", reason="the oracle embreex is not installed")

CAMERA = StereoCamera.look_at((-11.5, 2.2, -0.4), (0.0, 3.4, 0.0), fov_x_deg=75, resolution=(512, 512))
LIGHT = torch.tensor([0.0, 4.5, -0.4])
ALLOWED = 2e-4  # share of rays that may disagree: they pass within rounding of an edge, or lie in a surface


@pytest.fixture(scope="module")
def scene(shared_scenes):
    return load_scene(shared_scenes / "sponza" / "sponza.obj")


@pytest.fixture(scope="module")
def embree(scene):
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    world = EmbreeScene()
    TriangleMesh(world, scene.vertices.numpy(), scene.faces.numpy())
    return world


@pytest.fixture(scope="module")
def rays(scene):
    """Primary rays of both eyes, half of them all, and a cosine-distributed bounce from each of their hits."""
    origins, directions = (field.reshape(-1, 3).contiguous() for field in CAMERA.views.rays())
    hits = scene.intersect(origins, directions)
    hit = hits.prim >= 0
    corners = scene.vertices[scene.faces.long()[hits.prim[hit].long()]]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1)
    normal = torch.where(((normal * directions[hit]).sum(1) > 0)[:, None], -normal, normal)
    sphere = torch.nn.functional.normalize(torch.randn(normal.shape, generator=generator(1)), dim=1)
    bounce = torch.nn.functional.normalize(
        normal + sphere, dim=1
    )  # Lambert's cosine law: a point of the unit sphere above
    start = origins[hit] + directions[hit] * hits.t[hit, None] + 1e-3 * normal
    return torch.cat([origins, start]), torch.cat([directions, bounce])


def settle(scene, origins, directions, hits, blocked, t_max):
    """Judges each ray against all triangles but those whose bounding sphere is surely clear of its line."""
    corners = scene.vertices.double()[scene.faces.long()]
    centre = (corners.amin(1) + corners.amax(1)) / 2
    radius = (corners - centre[:, None]).norm(dim=2).amax(1)
    for ray in range(len(origins)):
        to_centre = centre - origins[ray].double()
        direction = torch.nn.functional.normalize(directions[ray].double(), dim=0)
        beside = torch.linalg.cross(to_centre, direction.expand_as(to_centre)).norm(dim=1)
        near = (beside <= radius + 1e-3).nonzero()[:, 0]
        number = int(hits.prim[ray])
        at = torch.searchsorted(near, number) if number >= 0 else torch.tensor(-1)
        assert number < 0 or int(near[at]) == number
        own = Hits(*(field[ray : ray + 1] for field in hits[:3]), at[None].int())
        mesh = scene.vertices, scene.faces[near]
        check(mesh, origins[ray, None], directions[ray, None], own, blocked[ray, None], t_max[ray, None])


def test_closest_hits(scene, embree, rays):
    origins, directions = rays
    assert len(origins) >= 1_000_000
    hits = intersect(scene.bvh, origins, directions)
    found = embree.run(origins.numpy(), directions.numpy(), output=True)
    prim, t = torch.from_numpy(found["primID"].astype(np.int64)), torch.from_numpy(found["tfar"])
    hit, theirs = hits.prim >= 0, prim >= 0
    assert float(theirs.float().mean()) > 0.8
    agree = torch.where(hit & theirs, (hits.t - t).abs() <= 1e-3 * t, hit == theirs)
    doubtful = (~agree).nonzero()[:, 0]
    assert len(doubtful) <= ALLOWED * len(origins), f"{len(doubtful)} of {len(origins)} rays disagree"
    unlimited = torch.full((len(doubtful),), math.inf)
    blocked = occluded(scene.bvh, origins[doubtful], directions[doubtful])
    chosen = Hits(*(field[doubtful] for field in hits))
    settle(scene, origins[doubtful], directions[doubtful], chosen, blocked, unlimited)


def test_any_hits(scene, embree, rays):
    """Shadow rays from the bounces' origins to a point light, just short of it."""
    origins = rays[0][len(rays[0]) // 2 :].contiguous()
    directions = LIGHT - origins
    t_max = torch.full((len(origins),), 0.999)
    blocked = occluded(scene.bvh, origins, directions, t_max)
    theirs = embree.run(origins.numpy(), directions.numpy(), dists=t_max.numpy(), query="OCCLUDED")
    assert 0.2 < float(blocked.float().mean()) < 0.98
    doubtful = (blocked != torch.from_numpy(np.asarray(theirs) == 0)).nonzero()[:, 0]
    assert len(doubtful) <= ALLOWED * len(origins), f"{len(doubtful)} of {len(origins)} rays disagree"
    hits = intersect(scene.bvh, origins[doubtful], directions[doubtful], t_max[doubtful])
    settle(scene, origins[doubtful], directions[doubtful], hits, blocked[doubtful], t_max[doubtful])
