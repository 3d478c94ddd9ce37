"""A scene as a description for Mitsuba 3: the same triangles, textures, lights and camera."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fovden.camera import Camera
from fovden.tracer import DirectionalLight, PointLight, Scene
from fovden.tracer.materials import MODELS

__all__ = ["describe"]


def describe(mi: Any, scene: Scene, camera: Camera, folder: Path) -> dict[str, Any]:
    """Returns what ``mi.load_dict`` reads; meshes are written into a folder.

    Surfaces are ``diffuse`` and reflect on both sides, textures keep their eight bits, pixels average what falls into
    them.

    Args:
        mi: Mitsuba, with a variant set.
        scene: The scene: Lambertian, without holes, without an image as its environment.
        camera: A view that is symmetric about its axis.
        folder: Where the meshes go.

    Raises:
        ValueError: If Mitsuba's description would be of something else.
    """
    other = {MODELS[number] for number in scene.materials.model.unique().tolist()} - {"lambert"}
    if other or bool((scene.materials.opacity >= 0).any()):
        raise ValueError(f"scene {scene.name!r}: expected Lambertian surfaces without holes, got {', '.join(other)}")
    world: dict[str, Any] = {"type": "scene", "sensor": _sensor(mi, camera)}
    for number in scene.material_ids.unique().tolist():
        world |= _shapes(mi, scene, number, folder)
    for number, light in enumerate(scene.lights):
        world[f"light{number}"] = _emitter(light)
    return world


def _rgb(values: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value) for value in values]}


def _shapes(mi: Any, scene: Scene, number: int, folder: Path) -> dict[str, Any]:
    """The meshes of a material: triangles with shading normals, and those without."""
    emission = scene.materials.emission[number].detach()
    surface = {"type": "diffuse", "reflectance": _reflectance(mi, scene, number)}
    faces = scene.faces[scene.material_ids == number].long()
    smooth = (scene.normals[faces].abs().amax(2) > 0).all(1)
    shapes = {}
    for curved in (False, True):
        wanted = faces[smooth == curved]
        if len(wanted) > 0:
            path = folder / f"{number}-{curved}.ply"
            _write_ply(path, scene, wanted, curved)
            shapes[path.stem] = {
                "type": "ply",
                "filename": str(path),
                "face_normals": not curved,
                "flip_tex_coords": True,  # (0, 0) is an image's lower left corner
                "bsdf": {"type": "twosided", "bsdf": surface},
            }
            if emission.amax() > 0:
                shapes[path.stem]["emitter"] = {"type": "area", "radiance": _rgb(emission)}
    return shapes


def _write_ply(path: Path, scene: Scene, faces: Tensor, curved: bool) -> None:
    """A binary file of the triangles and of the vertices that they share."""
    used, corners = torch.unique(faces, return_inverse=True)
    columns = {"x y z": scene.vertices, "nx ny nz": scene.normals if curved else None, "u v": scene.uv}
    present = {names: values[used].numpy() for names, values in columns.items() if values is not None}
    properties = "".join(f"property float {name}\n" for names in present for name in names.split())
    rows = np.empty(len(faces), dtype=[("size", "u1"), ("corners", "<i4", 3)])
    rows["size"], rows["corners"] = 3, corners.numpy()
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(used)}\n{properties}"
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes(header.encode() + np.hstack(list(present.values())).astype("<f4").tobytes() + rows.tobytes())


def _reflectance(mi: Any, scene: Scene, number: int) -> dict[str, Any]:
    """The colour, or the image; times the factor in linear values where there is one."""
    albedo, texture = scene.materials.albedo[number].detach(), int(scene.materials.texture[number])
    if texture < 0:
        return _rgb(albedo)
    image = scene.materials.textures[texture].numpy()
    shown = {"type": "bitmap", "filter_type": "bilinear", "wrap_mode": "repeat"}
    if bool((albedo == 1).all()):
        return shown | {"bitmap": mi.Bitmap(image)}
    encoded = image / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    return shown | {"bitmap": mi.Bitmap((linear * albedo.numpy()).astype(np.float32)), "raw": True}


def _emitter(light: Any) -> dict[str, Any]:
    if isinstance(light, PointLight):
        return {"type": "point", "position": list(light.position), "intensity": _rgb(light.intensity)}
    if isinstance(light, DirectionalLight):
        return {"type": "directional", "direction": list(light.direction), "irradiance": _rgb(light.irradiance)}
    if torch.as_tensor(light.radiance).numel() > 3:
        raise ValueError("lights: expected an environment of one colour, got an image")
    return {"type": "constant", "radiance": _rgb(light.radiance)}


def _sensor(mi: Any, camera: Camera) -> dict[str, Any]:
    """Mitsuba's camera looks along +z and has +x on its left; ours along -z."""
    left, right, bottom, top = camera.bounds[0].tolist()
    if not math.isclose(left, -right, rel_tol=1e-4) or not math.isclose(bottom, -top, rel_tol=1e-4):
        raise ValueError("camera: expected a view that is symmetric about its axis")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera.rotation[0].numpy(), camera.origin[0].numpy()
    height, width = camera.resolution
    film = {"type": "hdrfilm", "height": height, "width": width, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    return {
        "type": "perspective",
        "film": film | {"component_format": "float32"},
        "sampler": {"type": "independent"},
        "fov": math.degrees(2 * math.atan(top)),
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f(pose @ np.diag([-1.0, 1.0, -1.0, 1.0])),
    }
