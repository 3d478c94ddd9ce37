"""Derivatives of hits and of the G-buffer: formulas in float64, whole calls by differences, values left as they are."""

import dataclasses
import math

import pytest
import torch
from brute_force import all_pairs
from builders import generator, rounded, scene_of, soup, sphere
from torch.autograd import forward_ad, gradcheck, gradgradcheck

from fovden.camera import Camera, StereoCamera
from fovden.tracer import Material, Materials, Scene, make_scene, trace_gbuffer
from fovden.tracer.gradient import (
    albedo_at,
    corners_at,
    emission_at,
    hits_at,
    interpolated,
    normal_at,
    seen_at,
    texture_colour,
)

U = 2.0**-24  # rounding of float32
# PyTorch's forward mode compiles some of its own formulas in a way that it has deprecated.
FORWARD_MODE = pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")


def doubles(*shape, seed=0):
    return torch.randn(*shape, dtype=torch.float64, generator=generator(seed)).requires_grad_()


def aimed(mesh, count, seed=1):
    """Rays from around the mesh towards places on its triangles."""
    vertices, faces = mesh
    random = generator(seed)
    weights = torch.rand(count, 3, 1, generator=random)
    chosen = vertices[faces.long()][torch.randint(len(faces), (count,), generator=random)]
    origins = 3 * torch.randn(count, 3, generator=random)
    return origins, (chosen * weights).sum(1) / weights.sum(1) - origins


def test_formulas_agree_with_the_kernel_within_its_rounding():
    mesh = soup(200)
    origins, directions = aimed(mesh, 500)
    hits = scene_of(mesh).intersect(origins, directions)
    hit = hits.prim >= 0
    assert float(hit.float().mean()) > 0.9
    pairs = all_pairs(*mesh, origins[hit], directions[hit])
    rows, prim = torch.arange(int(hit.sum())), hits.prim[hit].long()
    # ``brute_force`` bounds what float32 may get wrong. In float64 the formula is exact by comparison; in float32 its
    # numerators, products of the same lengths, are as far off as the kernel's at most.
    for number, weight in ((torch.float64, 1), (torch.float32, 2)):
        corners = corners_at(*mesh, hits.prim[hit]).to(number)
        t, u, v = hits_at(corners, origins[hit].to(number), directions[hit].to(number))
        slack, margin = weight * pairs.slack[rows, prim], weight * pairs.margin[rows, prim] + 4 * U
        known = margin < 0.1
        assert float(known.float().mean()) > 0.9
        for found, kernel, bound in ((t, hits.t, slack), (u, hits.u, margin), (v, hits.v, margin)):
            assert bool(((found - kernel[hit]).abs() <= bound)[known].all())


def test_what_is_seen_agrees_with_the_kernel():
    scene, views = coloured_ball(), looking().views
    gbuffer = trace_gbuffer(scene, views)
    seen = seen_at(scene, views, (0.0, 0.0), gbuffer.prim)
    assert 0.2 < float(gbuffer.hit.float().mean()) < 0.8
    # Directions are off by 4 U and weights, at a distance of 3 on triangles 0.5 wide seen at a slant, by some 100 U;
    # texture coordinates span 5 texels with a contrast of 1.
    for name in ("position", "depth", "barycentric", "normal", "albedo"):
        assert torch.allclose(seen[name], getattr(gbuffer, name), rtol=0, atol=1000 * U), name


@FORWARD_MODE
def test_formulas_of_hits():
    corners, origins, directions = doubles(4, 3, 3, seed=1), doubles(4, 3, seed=2), doubles(4, 3, seed=3)
    options = {"check_forward_ad": True, "check_batched_grad": True}
    assert gradcheck(hits_at, (corners, origins, directions), **options)
    assert gradgradcheck(hits_at, (corners, origins, directions))
    u, v = doubles(4, seed=4), doubles(4, seed=5)
    assert gradcheck(interpolated, (corners, u, v), **options)
    normals = doubles(4, 3, 3, seed=6)
    assert gradcheck(lambda *x: normal_at(x[0], x[1], directions.detach(), *x[2:]), (corners, normals, u, v))
    flat = torch.zeros_like(normals)
    assert gradcheck(lambda x: normal_at(x, flat, directions.detach(), u.detach(), v.detach()), (corners,))
    emission = doubles(4, 3, seed=7)
    assert gradcheck(lambda x: emission_at(corners.detach(), x, directions.detach()), (emission,))


def test_hits_solve_their_equation():
    corners, origins, directions = doubles(50, 3, 3, seed=1), doubles(50, 3, seed=2), doubles(50, 3, seed=3)
    t, u, v = hits_at(corners, origins, directions)
    assert torch.allclose(origins + t[:, None] * directions, interpolated(corners, u, v), atol=1e-9)


def test_formulas_of_colours():
    image = torch.randint(0, 256, (5, 7, 3), generator=generator(3), dtype=torch.uint8)
    uv = (3 * doubles(40, 2, seed=8)).detach()
    # Away from the lines through texel centres, where the derivative jumps.
    apart = ((uv * torch.tensor([7.0, 5.0])) % 1 - 0.5).abs().amin(1) > 0.01
    uv = uv[apart].requires_grad_()
    assert len(uv) > 30
    assert gradcheck(lambda x: texture_colour(image, x), (uv,))
    factor, texture = doubles(len(uv), 3, seed=9), torch.arange(len(uv)) % 3 - 1
    images = (image, image.flip(0, 1)[:2])
    uv = (uv.detach() + torch.tensor([0.0, 0.13])).requires_grad_()
    assert gradcheck(lambda f, x: albedo_at(f, images, texture, x), (factor, uv))


def test_misses_and_rays_within_a_plane_have_no_derivative():
    scene = scene_of((torch.eye(3).requires_grad_(), torch.tensor([[0, 1, 2]])))
    origins = torch.tensor([[0.0, 0, 0], [0, 0, 0], [math.nan, 0, 0]], requires_grad=True)
    hits = scene.intersect(origins, torch.tensor([[-1.0, -1, -1], [0, 0, 0], [1, 1, 1]]))
    assert torch.isinf(hits.t).all()
    (hits.u + hits.v + torch.where(torch.isfinite(hits.t), hits.t, 0)).sum().backward()
    assert not origins.grad.any()
    assert not scene.vertices.grad.any()
    within = torch.tensor([[0.0, 1, -1]], requires_grad=True)
    found = torch.stack(hits_at(torch.eye(3)[None], torch.tensor([[1.0, 0, 0]]), within))
    assert not found.any()
    assert not torch.autograd.grad(found.sum(), within)[0].any()


def test_values_do_not_depend_on_what_is_asked():
    mesh = soup(200)
    origins, directions = aimed(mesh, 500)
    directions[:100] = torch.eye(3)[torch.arange(100) % 3]
    plain = scene_of(mesh).intersect(origins, directions)
    asked = scene_of((mesh[0].clone().requires_grad_(), mesh[1])).intersect(origins, directions.requires_grad_())
    assert all(field.requires_grad for field in asked[:3])
    for mine, other in zip(plain, asked, strict=True):
        assert torch.equal(mine.view(torch.int32), other.detach().view(torch.int32))
    scene, views = coloured_ball(), looking().views
    asked = trace_gbuffer(scene, Camera(views.origin.clone().requires_grad_(), views.rotation, views.bounds, (24, 32)))
    assert asked.normal.requires_grad
    for name, image in vars(trace_gbuffer(scene, views)).items():
        assert torch.equal(image.view(torch.int32), getattr(asked, name).detach().view(torch.int32)), name
    with torch.no_grad():
        assert not scene.intersect(origins, directions).t.requires_grad


def changed(scene, amount, directions):
    """The scene moved in vertices, normals and texture coordinates, recoloured; and the camera moved, by one number."""
    d = {name: (amount * direction).float() for name, direction in directions.items()}
    materials = dataclasses.replace(scene.materials, albedo=scene.materials.albedo + 0.1 * d["albedo"])
    views = looking().views
    angles = d["rotation"]
    zero = torch.zeros(())
    turn = torch.stack([zero, -angles[2], angles[1], angles[2], zero, -angles[0], -angles[1], angles[0], zero])
    rotation = torch.linalg.matrix_exp(turn.reshape(3, 3)) @ views.rotation
    camera = Camera(views.origin + d["origin"], rotation, views.bounds + d["bounds"], views.resolution)
    shape = {name: getattr(scene, name) + d[name] for name in ("vertices", "normals", "uv")}
    return dataclasses.replace(scene, materials=materials, **shape), camera


@FORWARD_MODE
def test_the_gbuffer_by_differences():
    scene = coloured_ball()
    count = len(scene.vertices)
    shapes = {"vertices": (count, 3), "normals": (count, 3), "uv": (count, 2), "albedo": (3,), "origin": (1, 3)}
    shapes |= {"rotation": (3,), "bounds": (1, 4)}
    directions = {name: 0.1 * doubles(*shape, seed=i).detach() for i, (name, shape) in enumerate(shapes.items())}
    with forward_ad.dual_level():
        amount = forward_ad.make_dual(torch.zeros((), dtype=torch.float64), torch.ones((), dtype=torch.float64))
        dual = trace_gbuffer(*changed(scene, amount, directions), jitter=(0.2, -0.1))
        slopes = {name: forward_ad.unpack_dual(getattr(dual, name)).tangent for name in FIELDS}
    step = 2e-3
    before, after = (trace_gbuffer(*changed(scene, s * step, directions), jitter=(0.2, -0.1)) for s in (-1, 1))
    inside = dual.hit & (before.prim == after.prim) & (before.prim == dual.prim)
    assert int(inside.sum()) > 100
    for name in FIELDS:
        difference = (getattr(after, name) - getattr(before, name)) / (2 * step)
        error = (difference - slopes[name]).abs().amax(1, keepdim=True)[inside]
        size = slopes[name].abs().amax(1, keepdim=True)[inside].mean()
        # The kernel's values are off by some 10 to 100 U (distances of 3, triangles 0.5 wide, some at a slant), and the
        # series' second term is some step^2. A colour bends where its four texels change: in a few pixels.
        assert float(size) > 0.1
        assert float(error.quantile(0.98 if name == "albedo" else 1.0)) < 100 * U / step + 10 * step**2, name

    # Backwards: the same numbers, summed the other way.
    leaves = {name: (0.0 * direction).requires_grad_() for name, direction in directions.items()}
    gbuffer = trace_gbuffer(*changed(scene, 1.0, leaves), jitter=(0.2, -0.1))
    weights = {name: torch.randn(slope.shape, generator=generator(20)) for name, slope in slopes.items()}
    sum((weights[name] * getattr(gbuffer, name)).double().sum() for name in FIELDS).backward()
    backwards = sum(float((leaf.grad * directions[name]).sum()) for name, leaf in leaves.items())
    forwards = sum(float((weights[name] * slope).double().sum()) for name, slope in slopes.items())
    assert backwards == pytest.approx(forwards, rel=1e-4)


FIELDS = ("albedo", "normal", "position", "depth", "barycentric")


def looking():
    return StereoCamera.look_at((0.3, 0.4, 3.0), (0, 0, 0), fov_y_deg=50, resolution=(24, 32), eye_separation=0.4)


def coloured_ball() -> Scene:
    """80 triangles with normals of their own, half of them painted."""
    vertices, faces = sphere(1)
    image = torch.randint(0, 256, (5, 5, 3), generator=generator(3), dtype=torch.uint8)
    materials = Material("paint", (0.7, 0.4, 0.2), texture=image), Material("clay", (0.3, 0.4, 0.5))
    normals = vertices + 0.1 * torch.randn(vertices.shape, dtype=torch.float64, generator=generator(4))
    ids = torch.arange(len(faces)) % 2
    return scene_of(
        (rounded(vertices), faces), *materials, normals=normals, uv=vertices[:, :2] * 0.5 + 0.5, material_ids=ids
    )


def test_rays_by_differences():
    mesh = soup(50)
    origins, directions = (rays.double() for rays in aimed(mesh, 200, seed=5))
    moves = [0.1 * doubles(*shape, seed=30 + i).detach() for i, shape in enumerate([(150, 3), (200, 3), (200, 3)])]

    def at(steps):
        vertices, o, d = (
            x + step * move for x, step, move in zip((mesh[0], origins, directions), steps, moves, strict=True)
        )
        return scene_of((vertices.float(), mesh[1])).intersect(o, d)

    steps = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    hits, step = at(steps), 1e-3
    for number in range(3):
        before, after = (at(torch.eye(3, dtype=torch.float64)[number] * s * step) for s in (-1, 1))
        same = (before.prim == hits.prim) & (after.prim == hits.prim) & (hits.prim >= 0)
        assert int(same.sum()) > 150
        errors = []
        for row in same.nonzero()[:40, 0].tolist():
            for field, low, high in zip(hits[:3], before[:3], after[:3], strict=True):
                slope = torch.autograd.grad(field[row], steps, retain_graph=True)[0][number]
                errors.append(abs(float(high[row] - low[row]) / (2 * step) - float(slope)) / max(1, abs(float(slope))))
        # Slivers seen edge-on bend and round more than any bound; the typical error is U times lengths of 3 over the
        # step, and a share step^2.
        assert sorted(errors)[int(0.8 * len(errors))] < 100 * U / step + 10 * step**2


def test_a_camera_finds_its_place():
    scene, place = coloured_ball(), looking().views
    wanted = trace_gbuffer(scene, place).position
    origin = (place.origin + torch.tensor([0.02, -0.03, 0.05])).requires_grad_()
    optimiser = torch.optim.Adam([origin], lr=0.01)
    for _ in range(60):
        optimiser.zero_grad()
        position = trace_gbuffer(scene, Camera(origin, place.rotation, place.bounds, place.resolution)).position
        seen = (position.detach() != 0) & (wanted != 0)
        ((position - wanted) * seen).square().mean().backward()
        optimiser.step()
    assert (origin - place.origin).detach().norm(dim=1).amax() < 0.005


def test_a_scene_made_once_answers_twice():
    """Neither the scene's arrays nor the camera's matrices keep a graph that is used up, or made without one."""
    scene, views = make_scene("cornell_box"), looking().views
    materials = dataclasses.replace(scene.materials, albedo=scene.materials.albedo.clone().requires_grad_())
    scene = dataclasses.replace(scene, vertices=scene.vertices.clone().requires_grad_(), materials=materials)
    camera = Camera(views.origin + 2, views.rotation, views.bounds.clone().requires_grad_(), (8, 8))
    with torch.no_grad():
        assert not trace_gbuffer(scene, camera).depth.requires_grad
    gradients = []
    for _ in range(2):
        gbuffer = trace_gbuffer(scene, camera)
        (gbuffer.depth.sum() + gbuffer.albedo.sum()).backward()
        gradients.append([leaf.grad.clone() for leaf in (camera.bounds, scene.vertices, materials.albedo)])
        for leaf in (camera.bounds, scene.vertices, materials.albedo):
            leaf.grad = None
    for first, second in zip(*gradients, strict=True):
        assert first.any()
        assert torch.equal(first, second)
    assert isinstance(scene.materials, Materials)
