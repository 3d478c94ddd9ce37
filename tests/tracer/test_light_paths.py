"""Light as a function of albedos and lights at fixed paths: against frames that are traced anew, and by gradcheck."""

import dataclasses
import math
from typing import get_args

import pytest
import torch
from builders import generator, lit_room, scene_of
from torch.autograd import forward_ad, gradcheck, gradgradcheck

from fovden.camera import Gaze, StereoCamera
from fovden.color import srgb_to_linear
from fovden.foveation import SampleMap
from fovden.tracer import (
    EnvironmentLight,
    Integrator,
    Material,
    PointLight,
    make_scene,
    record_paths,
    reshade,
    surface_points,
    trace_frame,
)
from fovden.tracer.arrays import LightChoice
from fovden.tracer.integrator import Sampler
from fovden.tracer.light_paths import environment_at

CAMERA = StereoCamera.look_at((0.2, 0.1, 1.8), (0.0, -0.2, 0.0), fov_y_deg=70, resolution=(16, 20))
U = 2.0**-24  # rounding of float32
# PyTorch's forward mode compiles some of its own formulas in a way that it has deprecated.
FORWARD_MODE = pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")
LIGHT = ("direct", "indirect", "emission")


@pytest.fixture(scope="module")
def scene():
    return lit_room()


def recorded(scene, samples=2, integrator=None, seed=5):
    integrator = Integrator() if integrator is None else integrator
    frame = trace_frame(scene, CAMERA, samples, seed=seed, integrator=integrator)
    return frame, record_paths(scene, surface_points(frame), integrator=integrator)


def colours(scene):
    """What the lights of the lit room emit, as tensors."""
    point, sun, sky = scene.lights
    return [torch.tensor(point.intensity), torch.tensor(sun.irradiance), sky.radiance]


def with_colours(scene, albedo, emission, lights):
    """The scene with other numbers."""
    point, sun, _ = scene.lights
    new = [
        dataclasses.replace(point, intensity=lights[0].tolist()),
        dataclasses.replace(sun, irradiance=lights[1].tolist()),
    ]
    materials = dataclasses.replace(scene.materials, albedo=albedo.float(), emission=emission.float())
    return dataclasses.replace(scene, materials=materials, lights=[*new, EnvironmentLight(lights[2].float())])


@pytest.mark.parametrize(
    "integrator",
    [
        *(Integrator(lights=lights, sampler=get_args(Sampler)[-1]) for lights in get_args(LightChoice)),
        Integrator(bounces=4, lights="power", roulette=2),
        Integrator(bounces=0),
    ],
)
def test_the_light_is_what_was_traced(scene, integrator):
    counts = torch.randint(0, 5, (2, 1, 16, 20), generator=generator(4), dtype=torch.int32)
    frame, paths = recorded(scene, SampleMap.from_counts(counts, Gaze.center(CAMERA)), integrator)
    assert len(paths) == int(counts.sum())
    light = paths.shade()
    # Only sums of some products of positive numbers, and lookups in a small sky: some tens of roundings.
    for name in LIGHT:
        assert torch.allclose(paths.points.image(getattr(light, name)), getattr(frame, name), rtol=1e-5, atol=1e-6), (
            name
        )
        assert (name == "indirect" and integrator.bounces == 0) or float(getattr(light, name).mean()) > 0.01
    square = paths.points.image(light.luminance_squared[:, None])
    assert torch.allclose(square, frame.luminance_squared, rtol=2e-5, atol=1e-6)
    # In double precision too, and with the scene's own numbers given by hand.
    again = paths.shade(
        albedo=scene.materials.albedo.double(),
        emission=scene.materials.emission,
        textures=[srgb_to_linear(image / 255) for image in scene.materials.textures],
        lights=colours(scene),
    )
    assert again.direct.dtype == torch.float64
    assert torch.allclose(again.radiance.float(), light.radiance, rtol=1e-5, atol=1e-6)


@FORWARD_MODE
def test_derivatives_by_tracing_again(scene):
    """Light is of degree 2 in albedos with one bounce, and linear in lights: central differences are exact."""
    directions = [torch.rand(3, 3, generator=generator(i)) - 0.5 for i in range(2)]
    directions += [torch.rand(colour.shape, generator=generator(7)) for colour in colours(scene)[:2]]
    step = 0.1
    _, paths = recorded(scene)
    start = [scene.materials.albedo, scene.materials.emission, *colours(scene)]
    for number, direction in enumerate(directions):
        move = [torch.zeros_like(tensor) for tensor in start]
        move[number] = direction
        if number == 1:
            move[number][:2] = 0  # what is dark stays dark
        pictures = []
        for sign in (-1, 1):
            albedo, emission, *lights = (tensor + sign * step * by for tensor, by in zip(start, move, strict=True))
            pictures.append(trace_frame(with_colours(scene, albedo, emission, lights), CAMERA, 2, seed=5))
        with forward_ad.dual_level():
            albedo, emission, *lights = map(forward_ad.make_dual, start, move)
            light = paths.shade(albedo=albedo, emission=emission, lights=lights)
            for name in LIGHT:
                slope = forward_ad.unpack_dual(getattr(light, name)).tangent
                slope = torch.zeros_like(light.direct) if slope is None else slope
                difference = (getattr(pictures[1], name) - getattr(pictures[0], name)) / (2 * step)
                size = max(float(getattr(picture, name).max()) for picture in pictures)
                error = (paths.points.image(slope) - difference).abs().max()
                assert float(error) < 50 * U * size / step, (number, name)
            if number < 2:
                assert float(forward_ad.unpack_dual(light.indirect).tangent.abs().max()) > 0.01


def test_every_light_has_its_share(scene):
    """Light is linear in what all lights emit: it is the sum over them of colour times derivative (Euler)."""
    _, paths = recorded(scene, integrator=Integrator(bounces=2, lights="power"))
    given = [scene.materials.emission.clone(), *colours(scene)]
    given = [tensor.double().requires_grad_() for tensor in given]
    radiance = paths.shade(emission=given[0], lights=given[1:]).radiance
    gradients = torch.autograd.grad(radiance.sum(), given)
    shares = [float((tensor * gradient).detach().sum()) for tensor, gradient in zip(given, gradients, strict=True)]
    assert all(share > 0.01 * float(radiance.detach().sum()) for share in shares)
    assert sum(shares) == pytest.approx(float(radiance.detach().sum()), rel=1e-9)
    # With the sky alone, and twice as bright, it is a frame of that scene: sky images are sampled by their shape.
    dark = [torch.zeros(3), torch.zeros(3), 2 * colours(scene)[2]]
    frame, _ = recorded(with_colours(scene, scene.materials.albedo, scene.materials.emission, dark))
    _, paths = recorded(scene)
    shown = paths.points.image(paths.shade(lights=dark).radiance)
    assert torch.allclose(shown, frame.radiance, rtol=1e-5, atol=1e-6)


def test_textures_share_the_derivative_of_their_factors(scene):
    """Albedo is factor times texture: both have the same sum of value times derivative, per material and channel."""
    _, paths = recorded(scene)
    albedo = scene.materials.albedo.double().requires_grad_()
    texture = srgb_to_linear(scene.materials.textures[0].double() / 255).requires_grad_()
    gradients = torch.autograd.grad(paths.shade(albedo=albedo, textures=[texture]).radiance.sum(), (albedo, texture))
    by_factor, by_texture = (albedo * gradients[0]).detach(), (texture * gradients[1]).detach()
    assert torch.allclose(by_texture.sum((0, 1)), by_factor[0], rtol=1e-9)
    assert float(by_factor.min()) > 0
    assert float(gradients[1].count_nonzero()) == texture.numel()
    # A finer image of the same colours is the same texture, but for what lies between texels; a constant one exactly.
    flat = [paths.shade(textures=[torch.full((*size, 3), 0.5)]).radiance for size in [(1, 1), (7, 9)]]
    assert torch.allclose(*flat, rtol=1e-5)


def small(scene, count=5):
    """A few paths of the lit room, that meet all lights."""
    frame, _ = recorded(scene, 2)
    lit = (frame.indirect.amin(1) > 0).nonzero()
    points = surface_points(frame, torch.cat([lit[:: max(1, len(lit) // count)], torch.tensor([[0, 8, 10]])]))
    return record_paths(scene, points)


@FORWARD_MODE
def test_formulas_by_gradcheck(scene):
    paths = small(scene)
    albedo, emission = scene.materials.albedo.double(), scene.materials.emission.double()
    texture = srgb_to_linear(scene.materials.textures[0][:2, :2].double() / 255)
    lights = [colour.double() for colour in colours(scene)]
    lights[2] = lights[2][:, :2, :2]
    given = [tensor.requires_grad_() for tensor in (albedo, emission, texture, *lights)]

    def shade(albedo, emission, texture, *lights):
        light = paths.shade(albedo=albedo, emission=emission, textures=[texture], lights=lights)
        return light.direct, light.indirect, light.emission, light.luminance_squared

    # What is dark stays dark: it has no derivative. ``gradcheck`` agrees, for there is no difference either.
    assert gradcheck(shade, given, check_forward_ad=True, fast_mode=True)
    assert gradgradcheck(lambda *x: sum(part.sum() for part in shade(*x)), given, fast_mode=True)


def test_many_paths_are_taken_some_at_a_time(scene, monkeypatch):
    counts = torch.randint(0, 5, (2, 1, 16, 20), generator=generator(4), dtype=torch.int32)
    frame = trace_frame(scene, CAMERA, SampleMap.from_counts(counts, Gaze.center(CAMERA)), seed=5)
    paths = record_paths(scene, surface_points(frame))
    results = []
    for at_once in (1 << 20, 100, 1):
        monkeypatch.setattr("fovden.tracer.light_paths.PATHS_AT_ONCE", at_once)
        if at_once == 1:
            paths = record_paths(scene, paths.points[:20])
        albedo = scene.materials.albedo.double().requires_grad_()
        light = paths.shade(albedo=albedo)
        results.append([*light, torch.autograd.grad(light.radiance.square().sum(), albedo)[0]])
    for whole, parts, single in zip(*(result[:4] for result in results), strict=True):
        assert torch.equal(whole, parts)
        assert torch.equal(whole[:20], single)
    assert torch.allclose(results[0][4], results[1][4], rtol=1e-12)
    nothing = record_paths(scene, paths.points[:0]).shade()
    assert nothing.direct.shape == (0, 3)


def test_frames_are_differentiable_when_asked(scene):
    """Values to the bit as without; derivatives as of tracing again. Squares of degree 4 by a rule that is exact."""
    plain = trace_frame(scene, CAMERA, 2, seed=5)
    direction = torch.rand(3, 3, generator=generator(3)) - 0.5

    def frame_at(step):
        materials = dataclasses.replace(scene.materials, albedo=scene.materials.albedo + step * direction)
        moving = dataclasses.replace(scene, materials=materials, vertices=scene.vertices.clone().requires_grad_())
        return trace_frame(moving, CAMERA, 2, seed=5)

    step = torch.zeros((), requires_grad=True)
    asked = frame_at(step)
    for name in (*LIGHT, "luminance_squared"):
        assert torch.equal(getattr(asked, name).detach().view(torch.int32), getattr(plain, name).view(torch.int32))
    h = 0.05
    far, near, close, distant = (frame_at(torch.tensor(k * h)) for k in (-2, -1, 1, 2))
    for name in ("direct", "indirect", "luminance_squared"):
        values = [float(getattr(frame, name).detach().double().sum()) for frame in (far, near, close, distant)]
        difference = (8 * (values[2] - values[1]) - (values[3] - values[0])) / (12 * h)
        slope = float(torch.autograd.grad(getattr(asked, name).double().sum(), step, retain_graph=True)[0])
        assert slope == pytest.approx(difference, rel=1e-4), name
        assert abs(slope) > 1
    points = surface_points(plain)
    materials = dataclasses.replace(scene.materials, albedo=scene.materials.albedo.clone().requires_grad_())
    light = reshade(dataclasses.replace(scene, materials=materials), points)
    expected = reshade(scene, points)
    assert torch.equal(light.radiance.detach(), expected.radiance)
    slope = (torch.autograd.grad(light.direct.double().sum(), materials.albedo)[0] * direction).sum()
    assert float(slope) == pytest.approx(float(torch.autograd.grad(asked.direct.double().sum(), step)[0]), rel=1e-4)


@FORWARD_MODE
def test_paths_that_end_at_random_have_the_same_mean_derivative(scene):
    directions, slopes = torch.rand(3, 3, generator=generator(3)), []
    for roulette in (None, 2):
        integrator = Integrator(bounces=4, roulette=roulette)
        _, paths = recorded(scene, 64, integrator)
        with forward_ad.dual_level():
            light = paths.shade(albedo=forward_ad.make_dual(scene.materials.albedo, directions))
            slopes.append(forward_ad.unpack_dual(light.indirect).tangent.mean(1))
    # Points are independent: the standard error of their mean difference. Without its weight a path from
    # the second bounce on would lose about half of its share, a third of the slope.
    difference = slopes[0] - slopes[1]
    error = float(difference.std()) / math.sqrt(len(difference))
    assert error < 0.06 * float(slopes[0].mean())
    assert abs(float(difference.mean())) < 4 * error


def test_an_environment_is_looked_up_as_the_kernel_does():
    """Camera rays of a view of nothing but sky."""
    image = torch.rand(3, 5, 8, generator=generator(6))
    vertices = torch.tensor([[0.0, -50, 0], [1, -50, 0], [0, -50, 1]])
    scene = scene_of((vertices, torch.tensor([[0, 1, 2]])), lights=[EnvironmentLight(image)])
    for towards in ((0, 0.2, -1), (1, 0.9, 0), (-1, 0, 0.2), (0, 5, 0.1)):
        camera = StereoCamera.look_at((0, 0, 0), towards, fov_y_deg=100, resolution=(8, 10))
        frame = trace_frame(scene, camera, 1)
        assert bool((frame.gbuffer.prim == -1).all())
        points = surface_points(frame)
        sky = points.image(environment_at(image, points.directions(scene)))
        # Directions are off by some U; near a pole and around it a texel is 1 / 8 turn of a small circle.
        assert torch.allclose(sky, frame.emission, rtol=0, atol=2e-4)
        assert torch.equal(
            record_paths(scene, points).shade().emission, environment_at(image, points.directions(scene))
        )


def test_albedos_and_a_lamp_are_found_from_a_picture():
    """Both walls' colours and the strength of a light, from what a camera saw."""
    scene = make_scene("cornell_box").with_lights([PointLight((2.8, 4.0, 2.8), 20.0)])
    camera = scene.camera.at((12, 12))
    picture = trace_frame(scene, camera, 16, seed=1)
    guess = dataclasses.replace(scene.materials, albedo=torch.full((4, 3), 0.5))
    unknown = dataclasses.replace(scene, materials=guess).with_lights([PointLight((2.8, 4.0, 2.8), 10.0)])
    paths = record_paths(unknown, surface_points(picture))
    albedo, lamp = torch.full((4, 3), 0.5, requires_grad=True), torch.tensor(0.5, requires_grad=True)
    target, emission = reshade(scene, paths.points).radiance, scene.materials.emission
    optimiser = torch.optim.LBFGS([albedo, lamp], max_iter=100, line_search_fn="strong_wolfe")

    def error():
        optimiser.zero_grad()
        radiance = paths.shade(albedo=albedo, lights=[20 * lamp], emission=emission).radiance
        loss = 100 * (radiance - target).square().mean()
        loss.backward()
        return loss

    optimiser.step(error)
    seen = [scene.materials.names.index(name) for name in ("white", "green", "red")]
    assert float((albedo.detach() - scene.materials.albedo)[seen].abs().max()) < 0.02
    assert float(lamp.detach()) == pytest.approx(1, abs=0.02)


def test_bad_input(scene):
    _, paths = recorded(scene, 1)
    with pytest.raises(ValueError, match=r"albedo: expected shape"):
        paths.shade(albedo=torch.ones(2, 3))
    with pytest.raises(ValueError, match=r"textures: expected 1 images, as the scene has, got 0"):
        paths.shade(textures=[])
    with pytest.raises(ValueError, match=r"lights: expected 3 tensors, as the scene has lights, got 1"):
        paths.shade(lights=[torch.ones(3)])
    with pytest.raises(ValueError, match=r"lights\[0\]: expected shape"):
        paths.shade(lights=[torch.ones(3, 2, 2), *colours(scene)[1:]])
    chalk = scene_of((torch.eye(3), torch.tensor([[0, 1, 2]])), Material("chalk", (0.5, 0.5, 0.5)))
    with pytest.raises(ValueError, match="no light"):
        record_paths(chalk, paths.points)
