"""The light of exported scenes in Mitsuba 3, which is given nothing but the files.

The left eye's image of Mitsuba's perspective camera, with a box filter, against an anti-aliased reference of ours, with
paths of the same length: image means within 0.5 %. Each side renders independent batches, whose scatter gives the
standard error, until that is small enough for the comparison to mean something. Pixels that show what is within 0.4 m
of a point light are left out on both sides: the inside of a lantern is some thousand times as bright as the wood around
it, and a few such pixels would decide the mean of the whole image.

Among many lamps that is not enough. Where one of eighty is picked at a time, most of the scatter comes from one sample
in some ten thousand, on a leaf that nearly touches a lamp or after a bounce into a lantern: after 10^8 samples the mean
is still uncertain by 0.2 to 1 %. There each side's samples are taken one by one and limited to so many times the mean.
That is fair because one sample has the same distribution on both sides: a uniform place in the pixel, one of the lamps
with equal chances, a bounce with the density of the cosine, again one of the lamps; point lamps leave no choice of a
weight. What is cut off is about a tenth of the light, and the tolerance shrinks as much as the limited mean's response.

What remains in the forest is some 0.05 % of direct light by which Mitsuba is brighter: in single precision its rays
start 9e-5 (1 + the largest coordinate) above a surface, a millimetre there, and miss what nearly touches it. Ours start
2e-5 m above it; Mitsuba's distance, put into ours, has that effect.

Cut-outs are left out, too: Mitsuba's shadow rays take their surfaces for whole.

The room and the forest are compared without their smooth normals. Where an interpolated normal faces a light that the
triangle itself faces away from, ours is dark and Mitsuba's ``diffuse`` is lit: on wool knitted of strands with few
sides, this makes Mitsuba's room brighter by some per cent. Other tests follow the normals.
"""

import json
import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from export_files import glb_chunks, glb_parts, obj_parts
from procedural_scenes import built

from fovden.tracer import Integrator, PointLight, accumulate_reference, trace_gbuffer
from fovden.tracer.procedural import SCENES

mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed")

HEIGHT = 48
TOLERANCE = 0.005
ERROR = 0.001
"""Relative standard error of either side at most: 0.14 % of the difference, which the tolerance is 3.5 times."""
BATCHES = (16, 4096)
"""How many at least, so that the standard error is known, and at most."""
SPP_THERE, SPP_HERE, FINER = 16, 1, 6
"""Samples per pixel of a batch; ours are spread over more pixels, so that they lie more evenly over the image."""
MANY = 10
"""Number of lights above which single samples are limited."""
LIMIT = 40.0
"""What they are limited to, in means of their channel: higher, and the scatter grows faster than the share of light."""
NEAR = 0.4
"""Distance from a point light in metres within which a surface's pixels are left out."""
QUICK = ("atrium", "cornell_box")


@pytest.fixture(scope="module")
def mi():
    mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def settled(batch):
    """The mean of as many independent batches as it takes; each is a mean image colour, a function of a seed."""
    # Far apart and without pattern: Mitsuba adds the pixel's number to the seed.
    seeds = np.random.default_rng(7).integers(0, 2**32, BATCHES[1])
    means = []
    for seed in seeds:
        means.append(batch(int(seed)))
        mean, error = np.mean(means, axis=0), np.std(means, axis=0, ddof=1 if means[1:] else 0) / np.sqrt(len(means))
        if len(means) >= BATCHES[0] and (error < ERROR * mean).all():
            return mean
    return pytest.fail(f"the standard error is still {error / mean}")


@pytest.fixture(
    scope="module", params=[name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SCENES]
)
def exported(request, tmp_path_factory):
    """The folder of a scene's files, and what an image of them is to be compared with."""
    scene = built(request.param)
    height, width = scene.camera.resolution
    normals = scene.normals if request.param in QUICK else None
    whole = replace(scene.materials, opacity=torch.full_like(scene.materials.opacity, -1), opacities=())
    camera = scene.camera.at((HEIGHT, HEIGHT * width // height))
    scene = replace(scene, normals=normals, materials=whole, camera=camera)
    folder = tmp_path_factory.mktemp("exported")
    for ending in ("glb", "obj"):
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*light from all around")
            scene.export(folder / f"scene.{ending}")
    both = scene.camera.at((FINER * scene.camera.resolution[0], FINER * scene.camera.resolution[1])).views
    left = replace(both, origin=both.origin[:1], rotation=both.rotation[:1], bounds=both.bounds[:1])

    many = len(scene.lights) > MANY

    def samples(seed):
        choice = {"integrator": Integrator(lights="uniform")} if many else {}
        image = accumulate_reference(scene, left, spp=SPP_HERE, seed=seed, jitter=True, progress=None, **choice).mean
        return image[0].double().permute(1, 2, 0).numpy()[fine(kept)]

    near = trace_gbuffer(scene, left).position[0].permute(1, 2, 0)
    lamps = torch.tensor([light.position for light in scene.lights if isinstance(light, PointLight)]).reshape(-1, 3)
    near = torch.stack([(near - lamp).norm(dim=-1) < NEAR for lamp in lamps] or [torch.zeros(near.shape[:2])]).any(0)
    height, width = scene.camera.resolution
    kept = ~near.numpy().reshape(height, FINER, width, FINER).any(axis=(1, 3))
    assert kept.mean() > 0.8
    limit, tolerance = np.full(3, np.inf), np.full(3, TOLERANCE)
    if many:
        some = samples(0)
        limit = LIMIT * some.mean(axis=0)
        # If all samples are x times as large, the limited mean grows as those do that stay below the limit.
        tolerance = TOLERANCE * (some * (some < limit)).sum(axis=0) / np.minimum(some, limit).sum(axis=0)
        assert (tolerance > 0.8 * TOLERANCE).all()
    ours = settled(lambda seed: np.minimum(samples(seed), limit).mean(axis=0))
    return folder, Compared(kept, limit if many else None, tolerance, ours)


class Compared(NamedTuple):
    """Which pixels count, shape (h, w); what single samples are limited to, if they are; ours, as a mean colour."""

    kept: np.ndarray
    limit: np.ndarray | None
    tolerance: np.ndarray
    mean: np.ndarray


def fine(pixels):
    """The image (h, w) with every pixel as often as ours are finer."""
    return np.kron(pixels, np.ones((FINER, FINER), dtype=bool))


# Mitsuba's scene


def rgb(values):
    return {"type": "rgb", "value": [float(value) for value in values]}


def write_ply(path, part):
    """A binary file of separate triangles."""
    count = len(part.vertices)
    columns = [("x y z", part.vertices), ("nx ny nz", part.normals), ("u v", part.uv)]
    columns = [(names, values.reshape(3 * count, -1)) for names, values in columns if values is not None]
    properties = "".join(f"property float {name}\n" for names, _ in columns for name in names.split())
    faces = np.empty(count, dtype=[("size", "u1"), ("corners", "<i4", 3)])
    faces["size"], faces["corners"] = 3, np.arange(3 * count).reshape(count, 3)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {3 * count}\n{properties}element face {count}\n"
    rows = np.hstack([values for _, values in columns]).astype("<f4")
    end = b"property list uchar int vertex_indices\nend_header\n"
    path.write_bytes(header.encode() + end + rows.tobytes() + faces.tobytes())


def reflectance(mi, part):
    """The image, decoded as IEC 61966-2-1 says, times the factor."""
    if part.image is None:
        return rgb(part.albedo)
    encoded = np.asarray(part.image.convert("RGB")) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    bitmap = mi.Bitmap((linear * part.albedo).astype(np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear", "wrap_mode": "repeat"}


def shapes_of(mi, parts, folder):
    shapes = {}
    for number, part in enumerate(parts):
        path = folder / f"{number}.ply"
        write_ply(path, part)
        surface = {"type": "diffuse", "reflectance": reflectance(mi, part)}
        shapes[f"shape{number}"] = {
            "type": "ply",
            "filename": str(path),
            "face_normals": part.normals is None,
            "flip_tex_coords": True,  # (0, 0) is an image's lower left corner
            "bsdf": {"type": "twosided", "bsdf": surface},
        }
        if any(part.emission):
            shapes[f"shape{number}"]["emitter"] = {"type": "area", "radiance": rgb(part.emission)}
    return shapes


def perspective(mi, camera_to_world, fov_y_deg, aspect):
    """A camera that looks along its -z axis; Mitsuba's looks along +z and has +x on its left."""
    film = {"type": "hdrfilm", "width": round(HEIGHT * aspect), "height": HEIGHT, "pixel_format": "rgb"}
    film |= {"component_format": "float32", "rfilter": {"type": "box"}}
    world = mi.ScalarTransform4f(np.asarray(camera_to_world) @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    sampler = {"type": "multijitter", "sample_count": SPP_THERE}
    lens = {"fov": fov_y_deg, "fov_axis": "y", "to_world": world}
    return {"type": "perspective", "film": film, "sampler": sampler, **lens}


def from_glb(mi, path, folder):
    header, _ = glb_chunks(path)
    world = {"sensor": None, **shapes_of(mi, glb_parts(path), folder)}
    for number, node in enumerate(header["nodes"]):
        pose = np.array(node.get("matrix", np.eye(4).ravel())).reshape(4, 4).T
        if "camera" in node:
            camera = header["cameras"][node["camera"]]
            if camera["extras"]["fovden"]["default"]:
                pose[:3, 3] -= pose[:3, 0] * camera["extras"]["fovden"]["eye_separation"] / 2
                lens = camera["perspective"]
                world["sensor"] = perspective(mi, pose, np.degrees(lens["yfov"]), lens["aspectRatio"])
        elif "extensions" in node:
            index = node["extensions"]["KHR_lights_punctual"]["light"]
            light = header["extensions"]["KHR_lights_punctual"]["lights"][index]
            strength = rgb(np.multiply(light["color"], light["intensity"]))
            if light["type"] == "point":
                place = {"position": node["translation"], "intensity": strength}
            else:
                place = {"direction": (-pose[:3, 2]).tolist(), "irradiance": strength}
            world[f"light{number}"] = {"type": light["type"], **place}
    environment = header["scenes"][0].get("extras", {}).get("fovden", {}).get("environment")
    if environment is not None:
        world["sky"] = {"type": "constant", "radiance": rgb(environment["radiance"])}
    return world


def from_obj(mi, path, folder):
    described = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    camera = described["camera"]
    size = camera["resolution"]
    left = camera["eyes"][0]["camera_to_world"]
    world = {"sensor": perspective(mi, left, camera["fov_y_deg"], size["width"] / size["height"])}
    world |= shapes_of(mi, obj_parts(path), folder)
    for number, light in enumerate(described["lights"]):
        kind = light["type"] if light["type"] != "environment" else "constant"
        strengths = {key: rgb(light[key]) for key in ("intensity", "irradiance", "radiance") if key in light}
        world[f"light{number}"] = {**light, "type": kind, **strengths}
    return world


@pytest.mark.parametrize("ending", ["glb", "obj"])
def test_an_exported_scene_has_the_same_light_in_mitsuba(mi, exported, ending, tmp_path):
    folder, ours = exported
    description = {"glb": from_glb, "obj": from_obj}[ending](mi, folder / f"scene.{ending}", tmp_path)
    pixels, spp, limit = ours.kept, SPP_THERE, np.inf
    if ours.limit is not None:
        pixels, spp, limit = fine(ours.kept), 1, ours.limit
        description["sensor"]["film"] |= {"height": pixels.shape[0], "width": pixels.shape[1]}
    world = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 3}, **description})

    def batch(seed):
        return np.minimum(np.array(mi.render(world, seed=seed, spp=spp), dtype=np.float64)[pixels], limit).mean(axis=0)

    np.testing.assert_array_less(np.abs(settled(batch) / ours.mean - 1), ours.tolerance)
