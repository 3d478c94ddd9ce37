"""How surfaces reflect in Mitsuba 3: its rough conductor, and the other models as plugins in Python.

Mitsuba takes masking and shadowing for independent, and multiplies its Fresnel term by a colour; so its conductor is
compared with our model of separable masking, in white, where either term is one.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from bsdf_kernels import directions, reflected_by_facets, tensors, unit
from mitsuba_bsdfs import register
from scipy.interpolate import CubicSpline
from shapes import matt, pixels, rectangle, scene_of
from significance import assert_same_mean
from test_against_mitsuba import (
    LAMPS,
    SKY,
    assert_same_light,
    comparable,
    emitters_of,
    meters,
    mitsuba,
    rendered_by_mitsuba,
    rendered_here,
    shapes_of,
    textured_room,
)

from fovden.camera import StereoCamera
from fovden.tracer import EnvironmentLight, Material, PointLight, trace_frame
from fovden.tracer.bsdf import density, evaluate
from fovden.tracer.materials import Materials

ROUGHNESS = 0.5
SIZE, BLOCK, SPP, BATCHES = 16, 4, 3, 32
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def mi():
    mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    register(mitsuba, {0.5: table(0.5)})
    return mitsuba


@cache
def table(roughness):
    """What a coat reflects by the cosine: quadrature at 64 of them, cubic in between."""
    cosines = np.linspace(0.01, 1, 64)
    return CubicSpline(cosines, [reflected_by_facets(c, roughness**2, 0.04, 100) for c in cosines])


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_values_and_densities_are_those_of_the_rough_conductor(mi, roughness):
    """Mitsuba's value includes the cosine."""
    bsdf = mi.load_dict({"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": roughness**2})
    viewers, around = directions(400, 1), directions(400, 2)
    viewers[:, 2] = np.abs(viewers[:, 2]) + 0.02
    viewers = unit(viewers)
    lights = unit(around * roughness**2 + viewers * [-1, -1, 1])  # about the mirrored direction
    lights[:, 2] = np.abs(lights[:, 2]) + 1e-3
    lights = unit(lights)
    interaction, context = mi.SurfaceInteraction3f(), mi.BSDFContext()
    values, densities = [], []
    for viewer, light in zip(viewers.tolist(), lights.tolist(), strict=True):
        interaction.wi = viewer
        values.append(bsdf.eval(context, interaction, light)[0])
        densities.append(bsdf.pdf(context, interaction, light))
    ours = evaluate("ggx_separable", torch.ones(3), *tensors(UP, viewers, lights), roughness=roughness)[:, 0]
    np.testing.assert_allclose(ours.numpy() * lights[:, 2], values, rtol=1e-3)  # theirs is single precision
    ours = density("ggx_separable", *tensors(UP, viewers, lights), roughness=roughness)
    np.testing.assert_allclose(ours.numpy(), densities, rtol=1e-3)


def test_a_room_with_metals_has_mitsubas_light(mi, tmp_path):
    """Metals on the floor and on the smooth ball, between diffuse walls that are seen in them."""
    scene, camera = textured_room()
    names, albedos = scene.materials.names, scene.materials.albedo.tolist()
    materials = [Material(name, tuple(albedo)) for name, albedo in zip(names, albedos, strict=True)]
    materials[0] = Material("polished", (1, 1, 1), model="ggx_separable", roughness=0.45)
    materials[2] = Material("brushed", (1, 1, 1), model="ggx_separable", roughness=0.7)
    scene = replace(scene, materials=Materials.of(materials), lights=(*LAMPS, SKY))
    theirs = rendered_by_mitsuba(mi, scene, meters(camera), tmp_path, depths=(3,))[3]
    mask = comparable(scene, camera)
    assert_same_light(rendered_here(scene, camera)[3] * mask, theirs * mask)


@pytest.mark.parametrize("model", ["oren_nayar", "ggx", "metallic_roughness"])
def test_a_corner_has_the_light_of_the_textbooks_formulas(mi, tmp_path, model):
    """Two walls that reflect each other, and a lamp that both see, under a sky."""
    surface = Material("surface", (0.9, 0.5, 0.2), model=model, roughness=ROUGHNESS, metallic=0.4)
    walls = torch.cat([rectangle((-2, 0, -2), (0, 0, 4), (4, 0, 0)), rectangle((-2, 0, -2), (4, 0, 0), (0, 3, 0))])
    lamp = rectangle((-0.5, 2.5, -0.5), (1, 0, 0), (0, 0, 1))
    lights = PointLight((1.2, 1.0, 0.8), (3, 4, 5)), EnvironmentLight((0.3, 0.4, 0.6))
    scene = scene_of([(walls, surface), (lamp, matt(0.0, (8.0, 6.0, 4.0)))], lights)
    camera = StereoCamera.look_at(
        (0.6, 1.7, 3.5), (-0.2, 0.6, -0.8), fov_y_deg=40, resolution=(SIZE, SIZE), eye_separation=0
    )
    world = {"type": "scene", "sensor": meters(camera), **shapes_of(scene, tmp_path), **emitters_of(scene.lights)}
    world = mi.load_dict(world)
    integrator = mi.load_dict({"type": "path", "max_depth": 3})
    seeds = np.random.default_rng(15).integers(0, 2**32, BATCHES)
    renders = [mi.render(world, integrator=integrator, spp=SPP, seed=int(seed)) for seed in seeds]
    theirs = np.stack([np.array(render, dtype=np.float64).reshape(-1, 3) for render in renders])
    frames = [trace_frame(scene, camera, 4 * SPP, seed=seed) for seed in range(BATCHES // 2)]
    ours = np.concatenate([pixels(frame.emission + frame.direct + frame.indirect) for frame in frames])
    assert_same_mean(blocks(ours), blocks(theirs))
    assert_same_mean(ours.mean(1), theirs.mean(1))


def blocks(images):
    count = SIZE // BLOCK
    return images.reshape(-1, count, BLOCK, count, BLOCK, 3).mean((2, 4)).reshape(len(images), -1, 3)
