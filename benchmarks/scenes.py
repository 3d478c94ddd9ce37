"""The scenes of the benchmarks, and the rays that ask about them."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.harness import positive, say
from fovden.camera import Camera, StereoCamera
from fovden.tracer import DirectionalLight, PointLight, Scene, load_scene, make_scene
from fovden.tracer.procedural import SCENES

__all__ = ["ALL", "add_scene_options", "left_eye", "load_named", "opaque", "ray_kinds"]

SPONZA = "sponza"
MILLIONS = "pink_room:4000000"
ALL = (SPONZA, "pink_room", MILLIONS)
RESOLUTION = (1080, 960)
OFFSET = 1e-3  # metres between a surface and the rays that leave it
NEARLY = 0.999  # of the way to a light at which a shadow ray ends


def add_scene_options(
    parser: argparse.ArgumentParser, scenes: tuple[str, ...] = ALL, resolution: tuple[int, int] = RESOLUTION
) -> None:
    """Adds the options that choose scenes and the camera's resolution."""
    parser.add_argument(
        "--scenes", nargs="+", default=list(scenes), metavar="NAME",
        help="scenes made in code, NAME:N for N triangles; or sponza; or files with a camera; "
        f"default: {' '.join(scenes)}",
    )  # fmt: skip
    parser.add_argument("--resolution", type=positive, nargs=2, default=resolution, metavar=("HEIGHT", "WIDTH"))


def load_named(names: list[str]) -> list[Scene]:
    """Returns the scenes; Sponza is left out, with a line on standard error, where the folder of real scenes is not.

    A name is that of a scene made in code, with ``:N`` for another number of triangles; or ``sponza``: Crytek's, in the
    folder that ``FOVDEN_SCENES`` names or in ``../shared/scenes``, with the lights and the camera of the 2023 paper; or
    an OBJ, glTF or PLY file with a camera of its own.

    Raises:
        ValueError: If nothing is left, a scene has no camera, or a number is not one.
    """
    scenes = [scene for scene in map(_load, names) if scene is not None]
    if not scenes:
        raise ValueError(f"none of the scenes {', '.join(names)} is here")
    return scenes


def _load(text: str) -> Scene | None:
    name, _, detail = text.partition(":")
    if name in SCENES:
        say(f"making {text}")
        if detail and not detail.isdigit():
            raise ValueError(f"scene: expected a number of triangles after the colon, got {text}")
        return make_scene(name, detail=int(detail) if detail else None)
    if name != SPONZA:
        scene = load_scene(text)
        if scene.camera is None:
            raise ValueError(f"scene: expected a file with a camera, got {text} without one")
        return scene
    root = Path(__file__).resolve().parents[1]
    path = Path(os.environ.get("FOVDEN_SCENES", root.parent / "shared" / "scenes"), "sponza", "sponza.obj")
    if not path.is_file():
        say(f"sponza is left out: there is no {path}; set FOVDEN_SCENES to the folder of real scenes")
        return None
    lights = (DirectionalLight((0.15, -1, 0.25), 12), PointLight((0, 4.5, -0.4), 40))
    camera = StereoCamera.look_at((-11.5, 2.2, -0.4), (0, 3.4, 0), fov_x_deg=75)
    return replace(load_scene(path), lights=lights, camera=camera, name=SPONZA)


def opaque(scene: Scene) -> Scene:
    """Returns the scene without holes: what a structure of nothing but triangles can answer for."""
    return replace(scene, materials=replace(scene.materials, opacity=None, opacities=()))


def left_eye(scene: Scene, resolution: tuple[int, int]) -> Camera:
    """Returns the left eye of the scene's camera."""
    return scene.view().at(resolution).views.view(0)


def ray_kinds(scene: Scene, camera: Camera) -> dict[str, tuple[Tensor, Tensor, float]]:
    """Returns origins (n, 3), directions (n, 3) and the common end of each kind of rays, the same for all sides.

    - ``"primary"``: through the pixels' centres, row by row.
    - ``"bounce"``: from what they meet, with density cosine / pi about the normal.
    - ``"shadow"``: from there towards a light, one of those that the scene lists chosen at random; they end just before
      a point light, and outside the scene where the light is directional.
    """
    generator = torch.Generator().manual_seed(0)
    origins, directions = (rays.reshape(-1, 3).contiguous() for rays in camera.rays())
    points, bounced = bounce_rays(scene, origins, directions, generator)
    kinds = {"primary": (origins, directions, torch.inf), "bounce": (points, bounced, torch.inf)}
    extent = 2 * float((scene.vertices.amax(0) - scene.vertices.amin(0)).norm())
    ends = []
    for light in scene.lights:
        if isinstance(light, PointLight):
            ends.append(torch.tensor(light.position) - points)
        elif isinstance(light, DirectionalLight):
            ends.append((-extent * torch.tensor(light.direction)).expand_as(points))
    if ends:
        chosen = torch.randint(len(ends), (len(points),), generator=generator)
        towards = torch.stack(ends)[chosen, torch.arange(len(points))]
        kinds["shadow"] = (points, towards.contiguous(), NEARLY)
    return kinds


def bounce_rays(scene: Scene, origins: Tensor, directions: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Returns rays from what others meet, with density cosine / pi about the normal: a miss has none.

    Origins lie a little above the surface, on the side that the ray came from.
    """
    hits = scene.intersect(origins, directions)
    hit = hits.prim >= 0
    corners = scene.vertices[scene.faces.long()[hits.prim[hit].long()]]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1)
    normal = torch.where(((normal * directions[hit]).sum(1) > 0)[:, None], -normal, normal)
    points = origins[hit] + directions[hit] * hits.t[hit, None] + OFFSET * normal
    sphere = torch.nn.functional.normalize(torch.randn(points.shape, generator=generator), dim=1)
    return points, torch.nn.functional.normalize(normal + sphere, dim=1)
