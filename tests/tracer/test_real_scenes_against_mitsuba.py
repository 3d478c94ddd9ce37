"""The light of real scenes against Mitsuba 3's path tracers: Sponza, the modern hall and the Cornell box.

Mitsuba has the same triangles, images, lights and perspective camera with a box filter; ours is an anti-aliased
reference. Each side renders 32 independent batches. Asked are image means within 0.5 %, known to 0.14 % or better, and
no significant difference in any block of 8 x 8 pixels.

All surfaces have the normals of their triangles: where an interpolated normal faces a light that the triangle faces
away from, ours is dark and Mitsuba's lit; ``test_against_mitsuba`` follows the normals. Sponza's leaves and chains have
their holes: Mitsuba's ``volpath`` looks through them, towards lights, too. The files know of no roughness; where a case
says so, it is made up, its images from those of the base colour.

The hall's windows touch their frames. Where a path ends, ours looks for light by points on lamps alone, and near an
edge that a lamp shares with a wall that estimate has no finite variance: single samples decide a block. Blocks are
therefore compared with lamps shrunk by a tenth about their middles, and of the hall as it is the means.

Of the tolerance, 0.1 to 0.2 % go to Mitsuba's distance between a surface and the rays that leave it, in single
precision 9e-5 (1 + the largest coordinate), a millimetre at Sponza's ends: shadows begin that much later. Sponza under
the sun alone is 0.22 +- 0.09 % brighter for it; with that distance put into ours, 0.04 +- 0.09 %.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from shapes import pixels
from significance import assert_same_mean

from fovden.camera import StereoCamera
from fovden.tracer import (
    DirectionalLight,
    EnvironmentLight,
    Integrator,
    PointLight,
    accumulate_reference,
    load_scene,
)
from fovden.tracer.materials import MODELS

mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed")
pytest.importorskip("benchmarks.mitsuba_scene", reason="the tests are not run from the repository's folder")
from mitsuba_surfaces import register, world_of  # noqa: E402

from benchmarks.frame import start_mitsuba  # noqa: E402

HEIGHT, WIDTH, BLOCK = 64, 96, 8
BATCHES = 32
TOLERANCE = 0.005
ERROR = 0.0014
"""Relative standard error of the images' difference at most: the tolerance is 3.5 times that."""


@pytest.fixture(scope="module")
def mi():
    try:
        start_mitsuba(2)  # which refuses an LLVM that would abort the process
        mitsuba.load_dict({"type": "sphere"})
    except (ImportError, RuntimeError) as error:
        pytest.skip(f"Mitsuba's compiled variant needs LLVM: {error}")
    register(mitsuba)
    return mitsuba


# The scenes

SUN, LAMP = DirectionalLight((0.15, -1, 0.25), 12), PointLight((0, 4.5, -0.4), 40)
SKY = EnvironmentLight((1.0, 1.0, 1.0))


def sponza(folder, *lights):
    """With the lights of the 2023 paper."""
    return load_scene(folder / "sponza" / "sponza.obj", lights=lights)


def hall(folder, lamps=0.9):
    scene = load_scene(folder / "modern_hall" / "scene.obj", skip_materials=["*glass*"])
    vertices, shines = scene.vertices.clone(), scene.materials.emission.amax(1) > 0
    for number in shines.nonzero().flatten().tolist():
        corners = scene.faces[scene.material_ids == number].long().unique()
        middle = vertices[corners].mean(0)
        vertices[corners] = middle + lamps * (vertices[corners] - middle)
    return replace(scene, vertices=vertices)


def cornell_box(folder):
    return load_scene(folder / "cornell_box" / "scene.obj")


def finished(scene, **finishes):
    """Materials by name (``others``: all that are not named) as model, roughness and metallic.

    Wherever there is an image of base colours, one of factors is made of it: roughness from green, metallic from blue.
    """
    tables = scene.materials
    given = [finishes.get(name, finishes.get("others", ("lambert", 1.0, 0.0))) for name in tables.names]
    models, roughness, metallic = zip(*given, strict=True)
    numbers = {"roughness": torch.tensor(roughness), "metallic": torch.tensor(metallic), "surface": tables.texture}
    model = torch.tensor([MODELS.index(model) for model in models], dtype=torch.int32)
    images = tuple(torch.stack([128 + image[..., 1] // 2, image[..., 2]], 2) for image in tables.textures)
    return replace(scene, materials=replace(tables, model=model, surfaces=images, **numbers))


ALONG = ((-11.5, 2.2, -0.4), (0, 3.4, 0), 75)
ACROSS = ((-3, 2.2, -0.4), (3, 1.8, 2.5), 60)
STAIRS = ((6.91182, 1.65163, 2.55414), (6.91182 - 0.900177, 1.65163, 2.55414 - 0.435523), 70)
FRONT = ((278, 273, -800), (278, 273, 0), 56.4)
"""Eye, target, horizontal field of view in degrees."""


@dataclass(frozen=True)
class Case:
    """A scene, a view of it, and paths; samples per pixel of a batch; whether blocks are compared."""

    scene: Callable
    view: tuple
    bounces: int = 1
    spp: int = 32
    lights: str = "power"
    blocks: bool = True


METAL, COAT = ("ggx_separable", 0.9, 1.0), ("metallic_roughness", 0.8, 0.7)
HALL = {
    "Metal": ("ggx_separable", 0.4, 1.0),
    "Chrome": ("ggx_separable", 0.3, 1.0),
    "Wood": ("metallic_roughness", 0.5, 0.6),
    "FloorTiles": ("metallic_roughness", 0.4, 0.3),
}
BOX = {"box": ("ggx_separable", 0.4, 1.0)}
CASES = {
    "sponza, direct": Case(lambda folder: sponza(folder, SUN, LAMP, SKY), ALONG, bounces=0, spp=64),
    "sponza": Case(lambda folder: sponza(folder, SUN, LAMP, SKY), ALONG, spp=48),
    "sponza, four bounces": Case(lambda folder: sponza(folder, SUN, LAMP), ACROSS, bounces=4),
    "sponza of metal": Case(lambda folder: finished(sponza(folder, SUN, LAMP, SKY), others=METAL), ACROSS, spp=64),
    "sponza coated": Case(lambda folder: finished(sponza(folder, SUN, LAMP, SKY), others=COAT), ALONG, spp=64),
    "hall as it is": Case(lambda folder: hall(folder, 1), STAIRS, spp=128, lights="tree", blocks=False),
    "hall": Case(hall, STAIRS, lights="tree"),
    "hall, finished, three bounces": Case(
        lambda folder: finished(hall(folder), **HALL), STAIRS, bounces=3, spp=16, lights="tree"
    ),
    "cornell box, four bounces": Case(lambda folder: finished(cornell_box(folder), **BOX), FRONT, bounces=4, spp=128),
}
QUICK = "hall, finished, three bounces"


@pytest.mark.parametrize(
    "name", [name if name == QUICK else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
)
def test_a_real_scene_has_mitsubas_light(mi, shared_scenes, tmp_path, name):
    case = CASES[name]
    scene = replace(case.scene(shared_scenes), normals=None)
    eye, target, fov = case.view
    camera = StereoCamera.look_at(eye, target, fov_x_deg=fov, resolution=(HEIGHT, WIDTH), eye_separation=0)
    assert_same_light(rendered_here(scene, camera, case), rendered_by_mitsuba(mi, scene, camera, case, tmp_path), case)


def rendered_here(scene, camera, case):
    """Batches of images, shape (batches, h w, 3); the two views, which coincide, are two of them."""
    setting = {"jitter": True, "integrator": Integrator(case.bounces, case.lights), "progress": None}
    seeds = range(BATCHES // 2)
    references = [accumulate_reference(scene, camera, spp=case.spp, seed=seed, **setting) for seed in seeds]
    return np.concatenate([pixels(reference.mean) for reference in references])


def rendered_by_mitsuba(mi, scene, camera, case, folder):
    views = camera.views
    left = replace(views, origin=views.origin[:1], rotation=views.rotation[:1], bounds=views.bounds[:1])
    description, integrator = world_of(mi, scene, left, folder)
    world = mi.load_dict(description)
    integrator = mi.load_dict({"type": integrator, "max_depth": case.bounces + 2, "rr_depth": 100})
    # Far apart and without pattern: Mitsuba adds the pixel's number to the seed.
    seeds = np.random.default_rng(21).integers(0, 2**32, BATCHES)
    renders = [mi.render(world, integrator=integrator, spp=case.spp, seed=int(seed)) for seed in seeds]
    return np.stack([np.array(render, dtype=np.float64).reshape(-1, 3) for render in renders])


def assert_same_light(ours, theirs, case):
    """The means agree, and so do blocks; and the means are known well enough for that to say something."""
    first, second = ours.mean(1), theirs.mean(1)
    np.testing.assert_allclose(first.mean(0), second.mean(0), rtol=TOLERANCE)
    if case.blocks:
        assert_same_mean(block_means(ours), block_means(theirs))
    error = np.sqrt((first.var(0, ddof=1) + second.var(0, ddof=1)) / BATCHES) / second.mean(0)
    np.testing.assert_array_less(error, ERROR)


def block_means(images):
    """Means of 8 x 8 pixels, shape (batches, blocks, 3)."""
    images = images.reshape(-1, HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK, 3)
    return images.mean((2, 4)).reshape(len(images), -1, 3)
