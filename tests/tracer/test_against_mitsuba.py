"""The light of whole scenes against Mitsuba 3's path tracer, with the same rays, depths and materials.

Mitsuba is given the camera rays of the tracer, one radiance meter a pixel: both then estimate the same 64 x 64
integrals, edges, textures and curved normals included, and no block of pixels has to be left out. Each side is rendered
in 32 or more independent batches of at least 256 samples a pixel in all; their scatter gives the standard errors.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy import stats
from shapes import box, matt, pixels, rectangle, scene_of, sphere
from significance import assert_same_mean, sidak

from fovden.camera import StereoCamera
from fovden.tracer import (
    DirectionalLight,
    EnvironmentLight,
    Material,
    PointLight,
    accumulate_reference,
    trace_frame,
    trace_gbuffer,
)
from fovden.tracer.materials import MODELS
from fovden.tracer.meshes import load_scene

mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed")

SIZE, BLOCK = 64, 8
BATCHES = 32
SPP = 8
"""Samples per pixel of each batch: 256 in all."""


@pytest.fixture(scope="module")
def mi():
    mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


# The scenes


def cornell_box(folder):
    scene = load_scene(folder / "cornell_box" / "scene.obj")
    return scene, camera_at((278, 273, -800), (278, 273, 0), 39.3077)


def camera_at(eye, target, fov):
    """Two views that coincide, so that a frame of the tracer is two batches."""
    return StereoCamera.look_at(eye, target, fov_y_deg=fov, resolution=(SIZE, SIZE), eye_separation=0)


def textured_room():
    """A room that is open to the front and above: tiled floor, patterned walls, a smooth ball and a crate."""
    generator = torch.Generator().manual_seed(11)
    tiles, paper = (
        torch.randint(20, 256, (h, w, 3), generator=generator, dtype=torch.uint8) for h, w in ((5, 8), (9, 4))
    )
    ball = sphere(3)
    walls = torch.cat([rectangle((-2, 0, -2), (4, 0, 0), (0, 3, 0)), rectangle((-2, 0, 2), (0, 0, -4), (0, 3, 0))])
    parts = [
        (rectangle((-2, 0, -2), (0, 0, 4), (4, 0, 0)), Material("tiles", (1, 1, 1), texture=tiles)),
        (walls, Material("paper", (1, 1, 1), texture=paper)),
        (ball * 0.6 + torch.tensor([0.7, 0.6, 0.3]), matt((0.8, 0.3, 0.2))),
        (box((-1.4, 0, -1.0), (-0.5, 1.1, -0.2)), matt((0.3, 0.5, 0.8))),
    ]
    triangles = torch.cat([part for part, _ in parts])
    corners = triangles.reshape(-1, 3)
    uv = corners @ torch.tensor([[0.7, 0.1], [-0.2, 1.3], [0.3, -0.9]], dtype=torch.float64)
    normals = torch.zeros_like(corners)
    normals[18 : 18 + 3 * len(ball)] = ball.reshape(-1, 3)
    return scene_of(parts, normals=normals.float(), uv=uv.float()), camera_at((1.2, 2.0, 4.0), (-0.2, 0.8, 0), 48)


LAMPS = (PointLight((0.2, 2.4, 1.2), (9, 8, 6)), DirectionalLight((-0.5, -1, -0.7), (2.0, 2.2, 2.6)))
SKY = EnvironmentLight((0.3, 0.4, 0.6))


# The same in Mitsuba


def write_ply(path, vertices, normals, uv):
    """Separate triangles, as text; nine digits give a float32 back."""
    columns = [("x", "y", "z"), ("nx", "ny", "nz") if normals is not None else (), ("u", "v")]
    properties = "".join(f"property float {name}\n" for group in columns for name in group)
    count = len(vertices) // 3
    header = f"ply\nformat ascii 1.0\nelement vertex {3 * count}\n{properties}element face {count}\n"
    rows = np.hstack([array for array in (vertices, normals, uv) if array is not None])
    lines = [" ".join(f"{x:.9g}" for x in row) for row in rows]
    lines += [f"3 {3 * i} {3 * i + 1} {3 * i + 2}" for i in range(count)]
    path.write_text(header + "property list uchar int vertex_indices\nend_header\n" + "\n".join(lines) + "\n")


def rgb(values):
    return {"type": "rgb", "value": [float(x) for x in values]}


def shapes_of(scene, folder):
    """One mesh per material, and per kind of normals."""
    corners = scene.faces.long()
    smooth = scene.normals[corners].abs().amax((1, 2)) > 0
    shapes = {}
    for number in scene.material_ids.unique().tolist():
        for curved in (False, True):
            wanted = corners[(scene.material_ids == number) & (smooth == curved)].flatten()
            if len(wanted) == 0:
                continue
            path = folder / f"{number}-{curved}.ply"
            normals = scene.normals[wanted].numpy() if curved else None
            write_ply(path, scene.vertices[wanted].numpy(), normals, scene.uv[wanted].numpy())
            shapes[path.stem] = {
                "type": "ply",
                "filename": str(path),
                "face_normals": not curved,
                "flip_tex_coords": True,  # (0, 0) is an image's lower left corner
                "bsdf": {"type": "twosided", "bsdf": bsdf_of(scene, number, folder)},
            }
            if scene.materials.emission[number].amax() > 0:
                shapes[path.stem]["emitter"] = {"type": "area", "radiance": rgb(scene.materials.emission[number])}
    return shapes


def bsdf_of(scene, number, folder):
    """The material as Mitsuba's own, or as a plugin of :mod:`mitsuba_bsdfs` where it has none like it."""
    tables = scene.materials
    model = MODELS[int(tables.model[number])]
    if model == "lambert":
        return {"type": "diffuse", "reflectance": reflectance(scene, number, folder)}
    roughness, metallic = float(tables.roughness[number]), float(tables.metallic[number])
    if model == "ggx_separable":
        assert (tables.albedo[number] == 1).all(), "Mitsuba's Fresnel term is Schlick's only where all is reflected"
        return {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": roughness**2}
    albedo = dict(zip(("red", "green", "blue"), tables.albedo[number].tolist(), strict=True))
    return {"type": "fovden", "model": model, "roughness": roughness, "metallic": metallic, **albedo}


def reflectance(scene, number, folder):
    albedo, texture = scene.materials.albedo[number], int(scene.materials.texture[number])
    if texture < 0:
        return rgb(albedo)
    assert (albedo == 1).all(), "Mitsuba's image textures have no factor"
    path = folder / f"{texture}.png"
    Image.fromarray(scene.materials.textures[texture].numpy()).save(path)
    return {"type": "bitmap", "filename": str(path), "filter_type": "bilinear", "wrap_mode": "repeat"}


def emitters_of(lights):
    emitters = {}
    for number, light in enumerate(lights):
        if isinstance(light, PointLight):
            emitters[f"light{number}"] = {
                "type": "point",
                "position": light.position,
                "intensity": rgb(light.intensity),
            }
        elif isinstance(light, DirectionalLight):
            emitters[f"light{number}"] = {
                "type": "directional",
                "direction": light.direction,
                "irradiance": rgb(light.irradiance),
            }
        else:
            emitters[f"light{number}"] = {"type": "constant", "radiance": rgb(light.radiance)}
    return emitters


def film(width, height):
    """Pixels that average what falls into them, in single precision."""
    box_filter = {"type": "box"}
    size = {"width": width, "height": height}
    return {"type": "hdrfilm", "rfilter": box_filter, "pixel_format": "rgb", "component_format": "float32", **size}


def meters(camera):
    """A sensor whose pixels are single rays: those through the pixels' centres of the camera's first view."""
    rays = camera.views.rays()
    origins, directions = rays.origins[0].tolist(), rays.directions[0].tolist()
    sensor = {"type": "batch", "film": film(len(origins), 1)}
    for number, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        sensor[f"{number}"] = {"type": "radiancemeter", "origin": origin, "direction": direction, "film": film(1, 1)}
    return sensor


def perspective(mi, camera):
    """The same camera as Mitsuba's own."""
    world = mi.ScalarTransform4f().look_at(origin=list(camera.eye), target=list(camera.target), up=list(camera.up))
    lens = {"fov": camera.fov_y_deg, "fov_axis": "y", "to_world": world}
    return {"type": "perspective", "film": film(SIZE, SIZE), **lens}


def rendered_by_mitsuba(mi, scene, sensor, folder, depths=(1, 2, 3), emitters=None):
    """Batches of images, shape (batches, h w, 3), for the path tracer of depth 1 (emission), 2 (and direct), 3."""
    emitters = emitters_of(scene.lights) if emitters is None else emitters
    world = mi.load_dict({"type": "scene", "sensor": sensor, **shapes_of(scene, folder), **emitters})
    # Seeds far apart and without pattern: those near each other give pictures that share most random numbers, since
    # Mitsuba adds the pixel's number to the seed.
    seeds = np.random.default_rng(12).integers(0, 2**32, (max(depths) + 1, BATCHES))
    images = {}
    for depth in depths:
        integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 100})
        count = 1 if depth == 1 else BATCHES  # emission alone has no noise
        renders = [mi.render(world, integrator=integrator, spp=SPP, seed=int(seed)) for seed in seeds[depth, :count]]
        images[depth] = np.stack([np.array(render, dtype=np.float64).reshape(-1, 3) for render in renders])
    return images


def rendered_here(scene, camera):
    """The same of the tracer."""
    frames = [trace_frame(scene, camera, SPP, seed=seed) for seed in range(BATCHES // 2)]
    parts = [np.concatenate([pixels(getattr(f, name)) for f in frames]) for name in ("emission", "direct", "indirect")]
    return {depth: sum(parts[:depth]) for depth in (1, 2, 3)}


def comparable(scene, camera):
    """Pixels, shape (h w, 1), whose shading normal faces the camera.

    Where a curved surface turns away, an interpolated normal may point backwards although the triangle faces the
    viewer. Mitsuba then treats the surface as seen from behind, which leaves it black; here it stays lit.
    """
    rays = camera.views.rays().directions[0].double().numpy()
    return (pixels(trace_gbuffer(scene, camera).normal)[0] * rays).sum(1, keepdims=True) <= 0


def block_means(images):
    """Means of 8 x 8 pixels, shape (batches, blocks, 3)."""
    blocks = SIZE // BLOCK
    return images.reshape(-1, blocks, BLOCK, blocks, BLOCK, 3).mean((2, 4)).reshape(len(images), -1, 3)


def assert_same_light(ours, theirs):
    """The whole image within 0.5 %, and no significant difference in any block."""
    np.testing.assert_allclose(ours.mean((0, 1)), theirs.mean((0, 1)), rtol=0.005)
    assert_same_mean(block_means(ours), block_means(theirs))


@pytest.fixture(scope="module", params=["cornell box", "lamps", "lamps and sky"])
def case(request, mi, tmp_path_factory):
    """A scene, its camera, both sides' batches of it, and the pixels to compare."""
    if request.param == "cornell box":
        scene, camera = cornell_box(request.getfixturevalue("shared_scenes"))
    else:
        scene, camera = textured_room()
        scene = scene.with_lights(LAMPS + ((SKY,) if "sky" in request.param else ()))
    theirs = rendered_by_mitsuba(mi, scene, meters(camera), tmp_path_factory.mktemp("meshes"))
    return scene, camera, rendered_here(scene, camera), theirs


def test_every_pixel_shows_the_same_emission(case):
    _, _, ours, theirs = case
    np.testing.assert_allclose(ours[1].mean(0), theirs[1][0], rtol=1e-5)


@pytest.mark.parametrize("depth", [2, 3])
def test_frames_have_mitsubas_light(case, depth):
    scene, camera, ours, theirs = case
    mask = comparable(scene, camera)
    assert mask.mean() > 0.995
    assert_same_light(ours[depth] * mask, theirs[depth] * mask)


def test_the_bounce_alone_is_the_difference_between_mitsubas_depths(case):
    scene, camera, ours, theirs = case
    mask = comparable(scene, camera)
    assert_same_mean(block_means((ours[3] - ours[2]) * mask), block_means((theirs[3] - theirs[2]) * mask))


def test_references_have_mitsubas_light(case):
    """Lights chosen by power, standard errors from the reference's own variance."""
    scene, camera, _, theirs = case
    mask = comparable(scene, camera)
    reference = accumulate_reference(scene, camera, spp=BATCHES * SPP, seed=5, progress=None)
    mean, variance = pixels(reference.mean)[0] * mask, pixels(reference.variance)[0] * mask
    blocks, theirs = block_means(mean[None])[0], block_means(theirs[3] * mask)
    error = np.sqrt(block_means(variance[None])[0] / BLOCK**2 + theirs.var(0, ddof=1) / BATCHES)
    z = (blocks - theirs.mean(0)) / np.maximum(error, 1e-6)
    assert np.abs(z).max() < stats.t.isf(sidak(z.size) / 2, BATCHES - 1)
    np.testing.assert_allclose(mean.mean(0), theirs.mean((0, 1)), rtol=0.005)


def test_antialiased_references_have_the_light_of_mitsubas_camera(mi, tmp_path):
    """Rays spread over the pixels of a perspective camera with a box filter; the ball has facets here."""
    scene, camera = textured_room()
    scene = replace(scene, normals=None, lights=(*LAMPS, SKY))
    theirs = rendered_by_mitsuba(mi, scene, perspective(mi, camera), tmp_path, depths=(3,))[3]
    references = [
        accumulate_reference(scene, camera, spp=SPP, seed=seed, jitter=True, progress=None)
        for seed in range(BATCHES // 2)
    ]
    assert_same_light(np.concatenate([pixels(reference.mean) for reference in references]), theirs)
