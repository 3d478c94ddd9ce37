"""Rays pass through holes: every kind of ray, against triangles and images looked up one by one in float64."""

import numpy as np
import pytest
import torch
from brute_force import all_pairs
from builders import generator

from fovden.camera import StereoCamera
from fovden.tracer import Hits, Material, Materials, Scene, trace_gbuffer

SHEETS = 12
CUTOFFS = (0.5, 0.3, 0.7)
NEAR_CUTOFF, NEAR_EDGE = 1e-3, 1e-3  # where float32 may decide otherwise


def images():
    """Three images of random opacity, none square, one of a single texel's height."""
    random = generator(1)
    return [torch.randint(0, 256, shape, generator=random).to(torch.uint8) for shape in ((8, 5), (3, 16), (1, 7))]


def sheets(opacities):
    """Squares behind each other, askew, facing either way; coordinates repeat, start below zero, and are mirrored."""
    random = generator(2)
    vertices, faces, uv, ids = [], [], [], []
    for sheet in range(SHEETS):
        square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        square[:, 2] = sheet * 0.3 + 0.2 * torch.rand(4, generator=random)
        corner = torch.tensor([[-1.3, -0.4], [2.7, -0.4], [2.7, 1.9], [-1.3, 1.9]])
        mirrored = corner * torch.tensor([[1.0, 1], [-1, 1], [1, -1], [-1, -1]])[sheet % 4]
        first = 4 * sheet
        turned = [[0, 1, 2], [0, 2, 3]] if sheet % 2 else [[2, 1, 0], [3, 2, 0]]
        vertices.append(square)
        uv.append(mirrored)
        faces.append(torch.tensor(turned) + first)
        ids += [sheet % 4] * 2  # every fourth sheet is of the opaque material
    materials = [
        Material(str(i), (0.5, 0.5, 0.5), opacity=image, cutoff=cutoff)
        for i, (image, cutoff) in enumerate(zip(opacities, CUTOFFS, strict=True))
    ]
    materials.append(Material("solid", (0.5, 0.5, 0.5)))
    keep = torch.tensor(ids) != 3
    keep[-2:] = True  # the last alone
    return Scene(
        torch.cat(vertices),
        torch.cat(faces)[keep].int(),
        torch.tensor(ids)[keep].int(),
        Materials.of(materials),
        uv=torch.cat(uv),
    )


def opacity_at(image, s, t):
    """Bilinear between the centres of texels of an image that repeats, (0, 0) being its lower left corner."""
    height, width = image.shape
    x, y = s * width - 0.5, (1 - t) * height - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    value = 0.0
    for dy in (0, 1):
        for dx in (0, 1):
            weight = (x - column if dx else 1 - (x - column)) * (y - row if dy else 1 - (y - row))
            value += weight * float(image[(row + dy) % height, (column + dx) % width])
    return value / 255


def expected(scene, origins, directions):
    """The first triangle that is no hole, per ray, and whether float64 leaves no doubt about it."""
    pairs = all_pairs(scene.vertices, scene.faces, origins, directions)
    prims, sure = [], []
    for ray in range(len(origins)):
        hit, certain = -1, True
        weights = torch.stack([pairs.u[ray], pairs.v[ray], 1 - pairs.u[ray] - pairs.v[ray]]).amin(0)
        for prim in torch.argsort(pairs.t[ray]).tolist():
            if weights[prim] < -NEAR_EDGE or pairs.t[ray, prim] <= 0:
                continue
            certain &= bool(weights[prim] > NEAR_EDGE)
            material = int(scene.material_ids[prim])
            image = int(scene.materials.opacity[material])
            if image < 0:
                hit = prim
                break
            u, v = float(pairs.u[ray, prim]), float(pairs.v[ray, prim])
            a, b, c = scene.uv.double()[scene.faces[prim].long()].tolist()
            s, t = ((1 - u - v) * a[k] + u * b[k] + v * c[k] for k in (0, 1))
            margin = opacity_at(scene.materials.opacities[image], s, t) - float(scene.materials.cutoff[material])
            certain &= abs(margin) > NEAR_CUTOFF
            if margin >= 0:
                hit = prim
                break
        prims.append(hit)
        sure.append(certain)
    return torch.tensor(prims), torch.tensor(sure)


def rays(count):
    random = generator(3)
    origins = torch.rand(count, 3, generator=random) * torch.tensor([2.0, 2.0, 7.0]) - torch.tensor([1.0, 1.0, 2.0])
    targets = torch.rand(count, 3, generator=random) * torch.tensor([2.0, 2.0, 3.6]) - torch.tensor([1.0, 1.0, 0.0])
    return origins, targets - origins


def test_rays_pass_through_holes():
    scene = sheets(images())
    origins, directions = rays(3000)
    prims, sure = expected(scene, origins, directions)
    assert float(sure.float().mean()) > 0.9
    hits = scene.intersect(origins, directions)
    assert torch.equal(hits.prim[sure].long(), prims[sure])
    solid = scene.intersect(origins, directions, cutouts=False)
    assert float((solid.prim != hits.prim).float().mean()) > 0.2  # the holes matter
    limit = torch.full((len(origins),), 0.9)
    reached = (hits.prim >= 0) & (hits.t < limit)
    assert torch.equal(scene.occluded(origins, directions, limit), reached)
    assert int((scene.occluded(origins, directions, limit, cutouts=False) & ~reached).sum()) > 100


def test_the_camera_looks_through_holes():
    scene = sheets(images())
    camera = StereoCamera.look_at((0.3, 0.2, -2.0), (0.0, 0.1, 1.0), fov_x_deg=60, resolution=(37, 41)).views
    origins, directions = (field.reshape(-1, 3).contiguous() for field in camera.rays())
    seen = trace_gbuffer(scene, camera)
    hits = scene.intersect(origins, directions)
    assert torch.equal(seen.prim.reshape(-1), hits.prim)
    prims, sure = expected(scene, origins, directions)
    assert torch.equal(hits.prim[sure].long(), prims[sure])


@pytest.mark.parametrize("cutouts", [True, False])
def test_an_opaque_image_changes_no_bit(cutouts):
    whole = sheets([torch.full((4, 4), 255, dtype=torch.uint8)] * 3)
    origins, directions = rays(3000)
    plain = Scene(whole.vertices, whole.faces, whole.material_ids * 0, Materials.of([Material("a", (0.5, 0.5, 0.5))]))
    mine, other = whole.intersect(origins, directions, cutouts=cutouts), plain.intersect(origins, directions)
    for field, reference in zip(mine, other, strict=True):
        assert torch.equal(field.view(torch.int32), reference.view(torch.int32))
    assert isinstance(mine, Hits)
    assert torch.equal(whole.occluded(origins, directions), plain.occluded(origins, directions))
