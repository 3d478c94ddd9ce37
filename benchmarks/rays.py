"""Rays per second beside Embree's, one thread each, in one run.

Three kinds of rays of one scene: from the camera, from surfaces in cosine-distributed directions, and from surfaces to
a point light (any hit). Both sides get the same float32 arrays and answer through their Python call, allocation of the
results included; neither is timed while it builds its acceleration structure. Runs alternate, so that a change of the
machine's speed meets both, and medians are compared. Time is the thread's own (``time.thread_time``), so that what
else runs on the machine counts less.

Closest hits: ``scene.intersect`` returns t, u, v and the triangle. ``embreex`` is asked twice, for the triangle alone
(its fastest answer) and for everything that it offers (t, u, v, triangle, geometry, normal). Any hits: both return one
flag a ray. embreex walks rays one at a time on one thread; fovden is told to use one thread.

Every round's seconds go into ``metrics.csv`` of the output's folder, with ``config.json`` and ``provenance.json``
beside it (see :mod:`fovden.results`): ``method`` is the side, ``region`` the kind of rays, ``frame`` the round.

    python benchmarks/rays.py
    python benchmarks/rays.py --scene sponza.obj --eye -11.5 2.2 -0.4 --target 0 3.4 0 -o out/rays
"""
# ruff: noqa: T201

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

import torch
from torch import Tensor

from fovden.camera import StereoCamera
from fovden.results import Measurement, Run
from fovden.tracer import Scene, load_scene, make_scene
from fovden.tracer.procedural import SCENES

REPEATS = 7
RESOLUTION = (512, 512)
OFFSET = 1e-3  # metres between a surface and the rays that leave it
RESULTS = Path(__file__).parent / "results" / "rays"


def embree_scene(scene: Scene) -> object:
    """Returns embreex's acceleration structure of the same triangles."""
    from embreex.mesh_construction import TriangleMesh  # noqa: PLC0415  the peer is optional
    from embreex.rtcore_scene import EmbreeScene  # noqa: PLC0415

    world = EmbreeScene()
    TriangleMesh(world, scene.vertices.numpy(), scene.faces.numpy())
    return world


def primary_rays(camera: StereoCamera) -> tuple[Tensor, Tensor]:
    """Returns the rays of all pixels, row by row, view after view."""
    origins, directions = camera.views.rays()
    return origins.reshape(-1, 3).contiguous(), directions.reshape(-1, 3).contiguous()


def surface_points(scene: Scene, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Returns where rays meet the scene, a little above the surface, and the surface's normal on the ray's side."""
    hits = scene.intersect(origins, directions)
    hit = hits.prim >= 0
    corners = scene.vertices[scene.faces.long()[hits.prim[hit].long()]]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1)
    normal = torch.where(((normal * directions[hit]).sum(1) > 0)[:, None], -normal, normal)
    return origins[hit] + directions[hit] * hits.t[hit, None] + OFFSET * normal, normal


def cosine_directions(normal: Tensor) -> Tensor:
    """Returns random directions with density cosine / pi: points of the unit sphere that touches the surface."""
    generator = torch.Generator().manual_seed(0)
    sphere = torch.nn.functional.normalize(torch.randn(normal.shape, generator=generator), dim=1)
    return torch.nn.functional.normalize(normal + sphere, dim=1)


def round_times(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Returns the duration of each call in each round, in seconds; one round is made beforehand, uncounted."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeats + 1):
        for name, call in calls.items():
            begin = time.thread_time()
            call()
            if turn > 0:
                times[name].append(time.thread_time() - begin)
    return times


def measure(scene: Scene, camera: StereoCamera, light: tuple[float, float, float], repeats: int) -> list[Measurement]:
    """Prints the table and returns its numbers."""
    begin = time.thread_time()
    scene.bvh  # noqa: B018  built when first asked for
    built = {"fovden": time.thread_time() - begin}
    begin = time.thread_time()
    world = embree_scene(scene)
    world.run(*(torch.ones(1, 3).numpy(),) * 2)  # committed on its first query
    built["embreex"] = time.thread_time() - begin
    print(f"{scene.name}: {scene.triangle_count} triangles; built in {built['fovden']:.2f} s, ", end="")
    print(f"by Embree in {built['embreex']:.2f} s")
    print("                    Mray/s     Embree, Mray/s   times as fast as Embree")
    print("rays       number   fovden   triangle     all   triangle     all")
    found = [Measurement(scene.name, 0, "", name, "build", "seconds", value) for name, value in built.items()]
    found.append(Measurement(scene.name, 0, "", "", "scene", "triangles", float(scene.triangle_count)))

    def compare(kind: str, count: int, calls: Mapping[str, Callable[[], object]]) -> None:
        times = round_times(calls, repeats)
        report(kind, count, times)
        found.append(Measurement(scene.name, 0, "", "", kind, "rays", float(count)))
        for side, values in times.items():
            method = side if side == "fovden" else f"embreex, {side}"
            found.extend(Measurement(scene.name, n, "", method, kind, "seconds", v) for n, v in enumerate(values))

    primary = primary_rays(camera)
    points, normal = surface_points(scene, *primary)
    for kind, (origins, directions) in {"primary": primary, "bounce": (points, cosine_directions(normal))}.items():
        o, d = origins.numpy(), directions.numpy()
        calls = {
            "fovden": lambda origins=origins, directions=directions: scene.intersect(origins, directions),
            "triangle": lambda o=o, d=d: world.run(o, d),
            "all": lambda o=o, d=d: world.run(o, d, output=True),
        }
        compare(kind, len(origins), calls)
    directions = torch.tensor(light) - points
    t_max = torch.full((len(points),), 0.999)
    arrays = points.numpy(), directions.numpy(), t_max.numpy()
    calls = {
        "fovden": lambda: scene.occluded(points, directions, t_max),
        "triangle": lambda: world.run(arrays[0], arrays[1], dists=arrays[2], query="OCCLUDED"),
    }
    compare("shadow", len(points), calls)
    return found


def report(name: str, count: int, seconds: Mapping[str, Sequence[float]]) -> None:
    """Prints a row: millions of rays a second, and the ratios to Embree's."""
    rate = {peer: count / statistics.median(values) / 1e6 for peer, values in seconds.items()}
    peers = [peer for peer in ("triangle", "all") if peer in rate]
    rates = "".join(f"{rate[peer]:{width}.2f}" for peer, width in zip(peers, (11, 8), strict=False))
    ratios = "".join(f"{rate['fovden'] / rate[peer]:{width}.2f}" for peer, width in zip(peers, (11, 8), strict=False))
    print(f"{name:8} {count:8} {rate['fovden']:8.2f}{rates:19}{ratios}")


def main() -> None:
    """Reads the command line and compares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="atrium", help="name of a procedural scene, or an OBJ, glTF or PLY file")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="default: the scene's folder in results/rays")
    parser.add_argument("--eye", type=float, nargs=3, metavar=("X", "Y", "Z"), help="default: the scene's own camera")
    parser.add_argument("--target", type=float, nargs=3, metavar=("X", "Y", "Z"))
    parser.add_argument("--fov", type=float, default=75.0, help="horizontal field of view in degrees, with --eye")
    parser.add_argument("--light", type=float, nargs=3, default=(0.0, 4.5, -0.4), help="where shadow rays end")
    parser.add_argument("--resolution", type=int, nargs=2, default=RESOLUTION, metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--repeats", type=int, default=REPEATS, help="timed rounds, of which the median counts")
    options = parser.parse_args()
    if (options.eye is None) != (options.target is None):
        parser.error("--eye and --target go together")
    torch.set_num_threads(1)
    scene = make_scene(options.scene) if options.scene in SCENES else load_scene(options.scene)
    resolution = tuple(options.resolution)
    if options.eye is not None:
        camera = StereoCamera.look_at(options.eye, options.target, fov_x_deg=options.fov, resolution=resolution)
    elif scene.camera is None:
        parser.error(f"{options.scene} names no camera: give --eye and --target")
    else:
        camera = scene.camera.at(resolution)
    config = {
        "scene": options.scene,
        "camera": {"eye": camera.eye, "target": camera.target, "fov_x_deg": camera.fov_x_deg},
        "resolution": resolution,
        "light": options.light,
        "repeats": options.repeats,
        "embreex": metadata.version("embreex"),
    }
    with Run(options.output or RESULTS / scene.name, config) as run:
        run.measurements += measure(scene, camera, tuple(options.light), options.repeats)


if __name__ == "__main__":
    main()
