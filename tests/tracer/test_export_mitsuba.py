"""The light of exported scenes in Mitsuba 3, which is given nothing but the files.

The left eye's image of Mitsuba's perspective camera, with a box filter, against an anti-aliased reference of ours, with
paths of the same length: image means within 0.5 %. Each side renders independent batches, whose scatter gives the
standard error, until that is small enough for the comparison to mean something. Pixels that show what is within 0.4 m
of a point light are left out on both sides: the inside of a lantern is some thousand times as bright as the wood around
it, and where one of eighty lights is picked at a time, a few such pixels would decide the mean of the whole image. For
the same reason a scene with many lamps is compared without bounces, of which a rare one ends inside a lantern.

Cut-outs are left out, too: Mitsuba's shadow rays take their surfaces for whole.

The room and the forest are compared without their smooth normals. Where an interpolated normal faces a light that the
triangle itself faces away from, ours is dark and Mitsuba's ``diffuse`` is lit: on wool knitted of strands with few
sides, this makes Mitsuba's room brighter by some per cent. Other tests follow the normals.
"""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from export_files import glb_chunks, glb_parts, obj_parts
from procedural_scenes import built

from fovden.tracer import Integrator, PointLight, accumulate_reference, trace_frame, trace_gbuffer
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
"""Number of lights above which a scene is compared in direct light alone."""
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
    """The folder of a scene's files, its longest path, which pixels count, and the mean of ours over these."""
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

    direct = len(scene.lights) > MANY

    def batch(seed):
        if direct:
            jitter = tuple(np.random.default_rng(seed).uniform(-0.5, 0.5, 2).tolist())
            frame = trace_frame(scene, left, SPP_HERE, seed=seed, jitter=jitter, integrator=Integrator(lights="power"))
            image = frame.direct + frame.emission
        else:
            image = accumulate_reference(scene, left, spp=SPP_HERE, seed=seed, jitter=True, progress=None).mean
        return coarse(image[0].double().permute(1, 2, 0).numpy()).mean(axis=(1, 3))[kept].mean(axis=0)

    near = trace_gbuffer(scene, left).position[0].permute(1, 2, 0)
    lamps = torch.tensor([light.position for light in scene.lights if isinstance(light, PointLight)]).reshape(-1, 3)
    near = torch.stack([(near - lamp).norm(dim=-1) < NEAR for lamp in lamps] or [torch.zeros(near.shape[:2])]).any(0)
    kept = ~coarse(near[..., None].numpy()).any(axis=(1, 3))[..., 0]
    assert kept.mean() > 0.8
    return folder, 2 if direct else 3, kept, settled(batch)


def coarse(image):
    """The image (h, w, c) with an axis after height and width each that counts the rows and columns of one pixel."""
    height, width, channels = image.shape
    return image.reshape(height // FINER, FINER, width // FINER, FINER, channels)


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
    folder, depth, kept, ours = exported
    description = {"glb": from_glb, "obj": from_obj}[ending](mi, folder / f"scene.{ending}", tmp_path)
    world = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": depth}, **description})
    theirs = settled(lambda seed: np.array(mi.render(world, seed=seed), dtype=np.float64)[kept].mean(axis=0))

    np.testing.assert_allclose(theirs, ours, rtol=TOLERANCE)
