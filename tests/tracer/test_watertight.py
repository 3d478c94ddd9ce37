"""No ray leaves a closed mesh: not through edges, not through vertices, not within rounding of either.

Rays start inside, so every single one has to hit. Most are aimed at what could leak.
"""

import pytest
import torch
from builders import box, generator, rounded, sphere, star

from fovden.tracer import build_bvh, intersect, occluded

COUNT = 60_000


def ball(radius):
    """Random points in a ball about the origin."""

    def points(count, random):
        directions = torch.nn.functional.normalize(torch.randn(count, 3, dtype=torch.float64, generator=random), dim=1)
        return directions * radius * torch.rand(count, 1, dtype=torch.float64, generator=random) ** (1 / 3)

    return points


def block(x, y, z):
    """Random points in a box about the origin."""

    def points(count, random):
        cube = torch.rand(count, 3, dtype=torch.float64, generator=random) - 0.5
        return cube * torch.tensor([x, y, z], dtype=torch.float64)

    return points


# Mesh, points that are surely inside it, scale, offset. The ball of radius 0.4 is inside all faces of the star.
CLOSED = {
    "sphere": (sphere(4), ball(0.9), 1.0, (0.0, 0.0, 0.0)),
    "star": (star(4), ball(0.4), 1.0, (0.3, 0.7, 0.1)),
    "thin box": (box((9, 9, 2), (3.0, 2.0, 0.01)), block(2.9, 1.9, 0.008), 1.0, (0.1, 0.2, 0.3)),
    "long box": (box((16, 16, 1), (1.0, 0.8, 40.0)), block(0.9, 0.7, 39.0), 1.0, (0.3, 0.2, 0.1)),
    "small and far away": (sphere(3), ball(0.9), 0.5, (1000.0, -2000.0, 500.0)),
    "micrometres": (star(3), ball(0.4), 1e-6, (0.0, 0.0, 0.0)),
    "planet": (sphere(4), ball(0.9), 6.4e6, (3e7, 1e6, -2e7)),
}


def aims(vertices, faces, random):
    """Targets: vertices, points of edges, points within rounding of edges; as float32 numbers."""
    corners = vertices[faces.long()[torch.randint(len(faces), (COUNT,), generator=random)]]
    yield "vertices", corners[:, 0]
    on_edge = torch.lerp(corners[:, 0], corners[:, 1], torch.rand(COUNT, 1, generator=random))
    yield "edges", on_edge
    # What the flat picture of a triangle and the boxes around it round differently: one part in 10^8 to 10^5.
    size = (corners - on_edge[:, None]).abs().amax((1, 2))[:, None]
    nearby = 10 ** (torch.rand(COUNT, 1, generator=random) * 3 - 8)
    yield "beside edges", on_edge + size * nearby * torch.randn(COUNT, 3, generator=random)
    yield "beside vertices", corners[:, 0] + size * nearby * torch.randn(COUNT, 3, generator=random)


def assert_closed(bvh, origins, directions, where):
    missed = intersect(bvh, origins, directions).prim < 0
    assert not missed.any(), f"{where}: {int(missed.sum())} rays escape, the first from {origins[missed][0].tolist()}"
    assert occluded(bvh, origins, directions).all(), where


@pytest.mark.parametrize("name", CLOSED)
def test_no_ray_leaves_a_closed_mesh(name):
    (vertices, faces), inside, scale, offset = CLOSED[name]
    vertices = rounded(vertices, scale, offset)
    bvh = build_bvh(vertices, faces)
    random = generator(7)
    origins = rounded(inside(COUNT, random), scale, offset)
    for where, targets in aims(vertices, faces, random):
        assert_closed(bvh, origins, targets - origins, where)
    assert_closed(bvh, origins, torch.randn(COUNT, 3, generator=random), "anywhere")
    axes = torch.eye(3)[torch.arange(COUNT) % 3] * (torch.arange(COUNT) % 2 * 2.0 - 1)[:, None]
    assert_closed(bvh, origins, axes, "along the axes")


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.3, 0.2, 0.1)])
def test_no_ray_leaves_beside_a_long_edge(offset):
    """Long edges between boxes, seen from close by.

    The vertices lie far along the edge, so their places beside the ray round coarsely: by more than the distance to the
    box's side does.
    """
    vertices, faces = box((16, 16, 1), (1.0, 0.8, 40.0))
    vertices = rounded(vertices, 1.0, offset)
    bvh = build_bvh(vertices, faces)
    lower, upper = vertices.amin(0), vertices.amax(0)
    random = generator(9)
    corners = vertices[faces.long()]
    starts, ends = corners.reshape(-1, 3), corners.roll(-1, 1).reshape(-1, 3)
    long = ((ends - starts)[:, 2].abs() > 39) & ((ends - starts)[:, :2] == 0).all(1)
    chosen = long.nonzero()[:, 0][torch.randint(int(long.sum()), (2 * COUNT,), generator=random)]
    targets = torch.lerp(starts[chosen], ends[chosen], torch.rand(2 * COUNT, 1, generator=random))
    away = torch.nn.functional.normalize(torch.randn(2 * COUNT, 3, generator=random), dim=1)
    for distance in (0.5, 0.1):
        origins = targets + distance * away
        inside = ((origins > lower + 0.05) & (origins < upper - 0.05)).all(1)
        assert int(inside.sum()) > COUNT / 10
        for beside in (0.0, 1e-7, 1e-6, 1e-5):
            directions = targets - origins + beside * torch.randn(2 * COUNT, 3, generator=random)
            assert_closed(bvh, origins[inside], directions[inside], f"{beside} beside, {distance} away")


def test_no_ray_leaves_a_finely_cut_room():
    """Small triangles far away, edges along the sides of boxes: here the roundings of the slab test itself count."""
    vertices, faces = box((60, 60, 60), (2.0, 2.0, 2.0))
    vertices = rounded(vertices, 1.0, (0.3, 0.2, 0.1))
    random = generator(3)
    corners = vertices[faces.long()[torch.randint(len(faces), (10 * COUNT,), generator=random)]]
    targets = torch.lerp(corners[:, 0], corners[:, 1], torch.rand(10 * COUNT, 1, generator=random))
    origins = rounded(block(1.9, 1.9, 1.9)(10 * COUNT, random), 1.0, (0.3, 0.2, 0.1))
    assert_closed(build_bvh(vertices, faces), origins, targets - origins, "edges")
