"""Small scenes, put together from shapes that are easy to compute with."""

import numpy as np
import torch

from fovden.camera import StereoCamera
from fovden.tracer import Material, Materials, Scene


def rectangle(corner, edge_1, edge_2):
    """Two triangles, shape (2, 3, 3); the normal is edge_1 x edge_2."""
    a, e, f = (torch.tensor(vector, dtype=torch.float64) for vector in (corner, edge_1, edge_2))
    b, c, d = a + e, a + e + f, a + f
    return torch.stack([torch.stack([a, b, c]), torch.stack([a, c, d])])


def box(lower, upper, *, inwards=False):
    """Twelve triangles, shape (12, 3, 3), whose normals point outwards or inwards."""
    lower, upper = torch.tensor(lower, dtype=torch.float64), torch.tensor(upper, dtype=torch.float64)
    edges = torch.diag(upper - lower)
    sides = []
    for axis in range(3):
        e, f = edges[(axis + 1) % 3], edges[(axis + 2) % 3]
        sides.append(rectangle((lower + edges[axis]).tolist(), e.tolist(), f.tolist()))  # normal along +axis
        sides.append(rectangle(lower.tolist(), f.tolist(), e.tolist()))
    triangles = torch.cat(sides)
    return triangles.flip(1) if inwards else triangles


def sphere(subdivisions, *, inwards=False):
    """A unit sphere of 20 * 4^subdivisions triangles, all corners on the sphere."""
    golden = (1 + 5**0.5) / 2
    corners = torch.tensor([(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)], dtype=torch.float64)
    corners = torch.cat([corners.roll(shift, 1) for shift in range(3)])
    near = torch.cdist(corners, corners) < 2.1  # edges have length 2
    triples = [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] & near[j, k] & near[i, k]]
    unit = torch.nn.functional.normalize
    triangles = unit(corners[torch.tensor(triples)], dim=2)
    for _ in range(subdivisions):
        a, b, c = triangles.unbind(1)
        ab, bc, ca = unit(a + b), unit(b + c), unit(c + a)
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = torch.cat([torch.stack(part, dim=1) for part in parts])
    a, b, c = triangles.unbind(1)
    outwards = (torch.linalg.cross(b - a, c - a) * a).sum(1) > 0
    return torch.where((outwards != inwards)[:, None, None], triangles, triangles.flip(1))


def scene_of(parts, lights=(), *, normals=None, uv=None, name="scene"):
    """A scene of (triangles, material) pairs; every triangle has corners of its own, in order."""
    triangles = torch.cat([part for part, _ in parts])
    count = len(triangles)
    ids = torch.cat([torch.full((len(part),), i) for i, (part, _) in enumerate(parts)])
    materials = Materials.of([material for _, material in parts])
    faces = torch.arange(3 * count).reshape(count, 3)
    return Scene(triangles.reshape(-1, 3).float(), faces, ids, materials, normals, uv, tuple(lights), name=name)


def matt(albedo, emission=0.0):
    """A material of one reflectance and one radiance, each a triple or one number."""
    albedo, emission = ((x,) * 3 if isinstance(x, int | float) else tuple(x) for x in (albedo, emission))
    return Material("matt", albedo, emission)


def view(eye, target, *, size=8, fov=40.0, up=(0.0, 1.0, 0.0)):
    """A camera whose two views coincide: the same pixels twice, with independent random numbers."""
    return StereoCamera.look_at(eye, target, up, fov_y_deg=fov, resolution=(size, size), eye_separation=0)


def seen_points(camera, origin, normal):
    """Where the rays of every pixel meet a plane, float64, shape (h w, 3); for the first view."""
    rays = camera.views.to(torch.float64).rays()
    o, d = rays.origins[0].numpy(), rays.directions[0].numpy()
    t = (np.asarray(origin) - o) @ np.asarray(normal, dtype=float) / (d @ np.asarray(normal, dtype=float))
    assert (t > 0).all(), "the plane does not fill the view"
    return o + t[:, None] * d


def pixels(image):
    """An image (v, c, h, w) as (v, h w, c), float64."""
    return image.flatten(2).transpose(1, 2).double().numpy()
