"""Ray queries as operators: what PyTorch asks of one, compilation without a break, vmap, and scenes by number."""

import copy
import gc
import pickle
import time

import pytest
import torch
from builders import generator, scene_of, soup

from fovden.camera import Camera, StereoCamera, pixel_centres
from fovden.tracer import intersect, make_scene, trace_gbuffer
from fovden.tracer.operators import scene_of as scene_with

OPERATORS = torch.ops.fovden


def rays(count, *more, seed=1):
    origins, directions = torch.randn(2, *more, count, 3, generator=generator(seed))
    return origins, -origins + 0.5 * directions


def compiled(function):
    """The function as one graph, with its backward pass; nothing is left to the interpreter."""
    torch.compiler.reset()
    return torch.compile(function, fullgraph=True, backend="aot_eager")


def same(one, other):
    return all(torch.equal(a.view(torch.int32), b.view(torch.int32)) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("count", [0, 1, 300])
def test_pytorch_finds_nothing_wrong_with_rays(count):
    scene = scene_of(soup(100))
    for t_max in (None, torch.rand(count, generator=generator(2))):
        for operator in (OPERATORS.intersect.default, OPERATORS.occluded.default):
            torch.library.opcheck(operator, (scene.number, *rays(count), t_max, True))


def test_pytorch_finds_nothing_wrong_with_pictures():
    scene = make_scene("cornell_box")
    views = scene.camera.at((6, 8)).views
    arguments = (scene.number, views.origin, views.rotation, views.bounds, (6, 8), (0.0, 0.25))
    for points in (torch.zeros(0, 0, 0, 2), torch.full((2, 3, 5, 2), 2.5)):
        torch.library.opcheck(OPERATORS.trace_visible.default, (*arguments, points))


def test_a_function_of_rays_compiles():
    scene = scene_of(soup(100))

    def brightness(origins, directions):
        hits = scene.intersect(origins, directions)
        there = origins + torch.where(hits.prim >= 0, hits.t, 0)[:, None] * directions
        lit = ~scene.occluded(there.detach(), torch.ones_like(there), torch.full_like(hits.t, 2.0))
        return ((hits.u * hits.v + there.square().sum(1)) * lit * (hits.prim >= 0)).sum()

    leaves = [ray.requires_grad_() for ray in rays(200)]
    fast = compiled(brightness)  # the acceleration structure is not made yet
    results = []
    for function in (fast, brightness, fast):
        value = function(*leaves)
        results.append([value.detach(), *torch.autograd.grad(value, leaves)])
    for first, second, third in zip(*results, strict=True):
        assert torch.allclose(first, second, rtol=1e-5, atol=1e-5)
        assert torch.equal(first, third)
        assert first.any()


def test_a_function_of_vertices_and_one_without_derivatives_compile():
    vertices, faces = soup(100)
    moving = scene_of((vertices.clone().requires_grad_(), faces))

    def distance(origins, directions):
        hits = moving.intersect(origins, directions)
        return torch.where(hits.prim >= 0, hits.t, 0).sum()

    gradients = [torch.autograd.grad(f(*rays(50)), moving.vertices)[0] for f in (distance, compiled(distance))]
    assert torch.allclose(*gradients, rtol=1e-5, atol=1e-6)
    scene = scene_of((vertices, faces))
    assert same(compiled(scene.intersect)(*rays(50)), scene.intersect(*rays(50)))


def test_the_gbuffer_of_a_camera_in_motion_compiles():
    scene = make_scene("cornell_box")
    views = StereoCamera.look_at((2.7, 2.7, -7.0), (2.7, 2.7, 0.0), fov_y_deg=40, resolution=(6, 8)).views
    offset = torch.zeros(1, 3, requires_grad=True)

    def depth(offset):
        camera = Camera(views.origin + offset, views.rotation, views.bounds, views.resolution)
        return trace_gbuffer(scene, camera, jitter=(0.25, 0.0)).depth.sum()

    values = [function(offset) for function in (depth, compiled(depth))]
    assert torch.allclose(*(value.detach() for value in values), rtol=1e-6)
    gradients = [torch.autograd.grad(value, offset)[0] for value in values]
    assert torch.allclose(*gradients, rtol=1e-4, atol=1e-4)
    # A plane of normal n lies n (p - o) / n d along a ray d, so that the depth changes by -n_i (d z) / (n d) with o_i.
    normal = trace_gbuffer(scene, views, jitter=(0.25, 0.0)).normal.flatten(2).mT
    directions = views.rays(pixel_centres(views.resolution).expand(2, -1, 2) + torch.tensor([0.25, 0.0])).directions
    along = (directions @ -views.rotation[:, :, 2:]) / (normal * directions).sum(2, keepdim=True)
    expected = -torch.nan_to_num(normal * along).sum((0, 1))
    assert torch.allclose(gradients[0][0], expected, rtol=1e-4, atol=1e-3)
    assert float(expected[2]) < -20


def test_progress_gives_the_same_gbuffer():
    scene, reports = make_scene("cornell_box"), []
    views = scene.camera.at((6, 8)).views
    plain, told = trace_gbuffer(scene, views), trace_gbuffer(scene, views, progress=reports.append)
    assert reports
    assert same(vars(plain).values(), vars(told).values())


def test_batches_of_rays():
    scene = scene_of(soup(100))
    origins, directions = rays(7, 5)
    t_max = torch.rand(7, generator=generator(3))
    flat = scene.intersect(origins.flatten(0, 1), directions.flatten(0, 1), t_max.repeat(5))
    batched = torch.func.vmap(scene.intersect, in_dims=(0, 0, None))(origins, directions, t_max)
    assert same([field.flatten() for field in batched], flat)
    along = torch.func.vmap(scene.occluded, in_dims=(1, None))(origins.movedim(0, 1), directions[2])
    assert torch.equal(along, torch.stack([scene.occluded(o, directions[2]) for o in origins]))

    def distance(origin, direction):
        hits = scene.intersect(origin[None], direction[None])
        return torch.where(hits.prim >= 0, hits.t, 0).sum()

    mine = torch.func.vmap(torch.func.grad(distance))(origins[0], directions[0])
    leaf = origins[0].clone().requires_grad_()
    distance_of_all = scene.intersect(leaf, directions[0])
    torch.where(distance_of_all.prim >= 0, distance_of_all.t, 0).sum().backward()
    assert torch.allclose(mine, leaf.grad, rtol=1e-5)
    assert mine.any()


def test_scenes_are_found_by_number_as_long_as_they_live():
    scene = scene_of(soup(10))
    number = scene.number
    assert scene_with(number) is scene
    for other in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene), scene.with_lights([])):
        assert other.number != number
        assert same(other.intersect(*rays(50)), scene.intersect(*rays(50)))
    del scene, other
    gc.collect()
    with pytest.raises(RuntimeError, match=f"a scene that this process holds, got {number}"):
        OPERATORS.intersect(number, *rays(1), None, True)


def test_an_operator_costs_little():
    scene = scene_of(soup(10))
    ray = rays(1)
    times = {}
    for _ in range(5):  # alternating, the best of each: the machine may be busy
        for name, call in (("scene", lambda: scene.intersect(*ray)), ("bare", lambda: intersect(scene.bvh, *ray))):
            begin = time.thread_time()
            for _ in range(200):
                call()
            times[name] = min(times.get(name, 1.0), (time.thread_time() - begin) / 200)
    assert times["scene"] - times["bare"] < 100e-6  # measured: 15 microseconds
