"""Small meshes and scenes made in code, for the tests of the tracer.

A mesh is a pair (vertices, faces): float32 of shape (n, 3), int32 of shape (m, 3). ``rounded`` is the only way to
float32, so that what a test reads is what the tracer gets.
"""

import math

import torch
from torch import Tensor

from fovden.camera import Gaze, StereoCamera
from fovden.foveation import SampleMap
from fovden.tracer import DirectionalLight, EnvironmentLight, Material, Materials, PointLight, Scene

Mesh = tuple[Tensor, Tensor]

GREY = Material("grey", (0.5, 0.5, 0.5))


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def rounded(vertices: Tensor, scale: float = 1.0, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Tensor:
    """Float64 vertices, scaled, moved and rounded once."""
    return (vertices.double() * scale + torch.tensor(offset, dtype=torch.float64)).float()


def soup(count: int, seed: int = 0, size: float = 0.4) -> Mesh:
    """Unrelated triangles with corners up to ``size`` away from places in the cube [-1, 1]^3."""
    places, corners = torch.rand(2, count, 3, 3, dtype=torch.float64, generator=generator(seed)) * 2 - 1
    return rounded(places[:, :1] + size * corners).reshape(-1, 3), triples(count)


def triples(count: int) -> Tensor:
    """Faces of triangles that share no vertex: (0, 1, 2), (3, 4, 5), ..."""
    return torch.arange(3 * count, dtype=torch.int32).reshape(-1, 3)


def sphere(level: int) -> tuple[Tensor, Tensor]:
    """An icosahedron, each triangle cut into four ``level`` times, on the unit sphere; closed; float64 vertices."""
    golden = (1 + math.sqrt(5)) / 2
    corners = []
    for a in (-1.0, 1.0):
        for b in (-golden, golden):
            corners += [(0.0, a, b), (a, b, 0.0), (b, 0.0, a)]
    vertices = torch.tensor(corners, dtype=torch.float64)
    apart = torch.cdist(vertices, vertices)
    near = (apart > 0) & (apart < 2.1)  # edges of this icosahedron have length 2
    faces = [
        (i, j, k) if torch.linalg.det(vertices[[i, j, k]]) > 0 else (i, k, j)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    for _ in range(level):
        middles: dict[tuple[int, int], int] = {}
        points, finer = vertices.tolist(), []

        def middle(a: int, b: int, points=points, middles=middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                middles[key] = len(points)
                points.append([(p + q) / 2 for p, q in zip(points[a], points[b], strict=True)])
            return middles[key]

        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        vertices, faces = torch.tensor(points, dtype=torch.float64), finer
    return torch.nn.functional.normalize(vertices, dim=1), torch.tensor(faces, dtype=torch.int32)


def star(level: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """The sphere with every vertex moved to a random radius from 0.5 to 1.5: closed, seen whole from the origin."""
    vertices, faces = sphere(level)
    radii = 0.5 + torch.rand(len(vertices), 1, dtype=torch.float64, generator=generator(seed))
    return vertices * radii, faces


def box(cells: tuple[int, int, int], size: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
    """A closed box about the origin, its faces grids of ``cells``; vertices along its rims are repeated, not shared.

    Repeated vertices are equal to the bit, which is what closes a mesh for rays. Float64 vertices.
    """
    vertices: list[Tensor] = []
    faces: list[Tensor] = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        for side in (-0.5, 0.5):
            along_i = torch.linspace(-0.5, 0.5, cells[i] + 1, dtype=torch.float64)
            along_j = torch.linspace(-0.5, 0.5, cells[j] + 1, dtype=torch.float64)
            grid = torch.full((cells[i] + 1, cells[j] + 1, 3), side, dtype=torch.float64)
            grid[..., i], grid[..., j] = torch.meshgrid(along_i, along_j, indexing="ij")
            number = torch.arange(grid[..., 0].numel()).reshape(grid.shape[:2]) + sum(map(len, vertices))
            a, b, c, d = (n.flatten() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
            faces += [torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)]
            vertices.append(grid.reshape(-1, 3))
    return torch.cat(vertices) * torch.tensor(size, dtype=torch.float64), torch.cat(faces).int()


def scene_of(mesh: Mesh, *materials: Material, **attributes: object) -> Scene:
    """A scene of one mesh in its first material, grey if none is given; further attributes as of ``Scene``."""
    vertices, faces = mesh
    chosen = attributes.pop("material_ids", torch.zeros(len(faces), dtype=torch.int32))
    return Scene(vertices, faces, chosen, Materials.of(materials or (GREY,)), **attributes)


def lit_room(**attributes: object) -> Scene:
    """A ball of metal in an open, textured room, with every kind of light: a lamp, a point, a sun and a bright sky."""
    walls, room = box((2, 2, 2), (4.0, 3.0, 4.0))
    points, ball = sphere(2)
    vertices = torch.cat([rounded(walls), rounded(points, 0.5, (0.1, -0.3, 0.0))])
    faces = torch.cat([room[:-4], ball + len(walls)])  # the side towards the camera is half open
    material_ids = torch.cat([torch.zeros(len(room) - 4), torch.ones(len(ball))]).int()
    material_ids[4:6] = 2
    image = torch.randint(0, 256, (4, 5, 3), generator=generator(1), dtype=torch.uint8)
    sky = 0.2 + torch.rand(3, 3, 6, generator=generator(3))
    lights = PointLight((0.5, 1.0, 1.0), 3.0), DirectionalLight((0.3, -1.0, -2.0), 0.5), EnvironmentLight(sky)
    given = {
        "uv": 2 * torch.rand(len(vertices), 2, generator=generator(2)),
        "material_ids": material_ids,
        "lights": lights,
    }
    return scene_of(
        (vertices, faces),
        Material("plaster", (0.9, 0.8, 0.7), texture=image),
        Material("metal", (0.8, 0.6, 0.4), model="metallic_roughness", roughness=0.6, metallic=0.7),
        Material("lamp", (0.1, 0.2, 0.1), (5.0, 4.0, 3.0)),
        **(given | attributes),
    )


def uneven_samples(camera: StereoCamera) -> SampleMap:
    """None to three samples a pixel, different for the eyes."""
    counts = torch.randint(0, 4, (2, 1, *camera.resolution), generator=generator(4), dtype=torch.int32)
    return SampleMap.from_counts(counts, Gaze.center(camera))
