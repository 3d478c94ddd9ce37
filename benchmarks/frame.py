"""A whole frame beside Mitsuba 3: one eye, direct light and one bounce, all cores, in one run of alternating rounds.

fovden: ``trace_frame`` with its G-buffer. Mitsuba: ``render`` of the same scene by ``path`` with ``max_depth`` 3, in
the variant ``llvm_ad_rgb``, warm: its kernel is compiled and cached before the first timed round, and a round ends when
the image is there (``drjit.eval``, ``drjit.sync_thread``). It writes no G-buffer.

The two do not trace the same number of rays. Mitsuba traces camera rays for every sample, fovden one per pixel, whose
surface all samples share; and Mitsuba goes on from the last surface with a ray that could meet a lamp. The table
therefore gives the time per ray as well, with the most rays that a sample can need: two towards lights, and a bounce,
with 1 / spp of a camera ray here; a camera ray, and two bounces, there. Surfaces that face away from their light and
paths that leave the scene spare either side a few of them. So do, here, samples of a pixel that choose the same point
or direction of light: from the surface that they share it is one ray.

Surfaces are taken for Lambertian and for whole, as Mitsuba's shadow rays take them. That both saw the same light is
checked by the mean of all images, of which the difference is given; smooth normals make it a per cent or two: where one
faces a light that its triangle faces away from, Mitsuba's surface is lit, and ours is dark.

Mitsuba needs LLVM's shared library on the system (libLLVM); see README.md.

    python -m benchmarks.frame
    python -m benchmarks.frame --scenes atrium --resolution 270 240 --quick
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks import harness
from benchmarks.harness import Table, alternate, compared, positive, say
from benchmarks.mitsuba_scene import describe
from benchmarks.scenes import add_scene_options, left_eye, load_named, opaque
from fovden.tracer import Scene, trace_frame

SCENES = ("sponza", "pink_room")
SPP = 4
OLDEST_LLVM = 16  # version 15 crashed with AVX-512


def lambertian(scene: Scene) -> Scene:
    """Returns the scene with nothing but Lambertian surfaces without holes."""
    solid = opaque(scene)
    return replace(solid, materials=replace(solid.materials, model=None))


def start_mitsuba(threads: int) -> Any:
    """Returns Mitsuba, set to its LLVM variant and to a number of threads.

    Raises:
        ImportError: If Mitsuba or the library that it needs is not there.
    """
    import drjit  # noqa: PLC0415  the peer is optional
    import mitsuba  # noqa: PLC0415

    mitsuba.set_variant("llvm_ad_rgb")
    version = drjit.detail.llvm_version()
    if version[0] < OLDEST_LLVM:
        raise ImportError(f"expected LLVM {OLDEST_LLVM} or later, got {version[0]}; see benchmarks/README.md")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    drjit.set_thread_count(threads)
    return mitsuba


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each scene."""
    threads = harness.threads()
    torch.set_num_threads(threads)
    mi = start_mitsuba(threads)
    results = []
    for scene in map(lambertian, load_named(options.scenes)):
        camera = left_eye(scene, tuple(options.resolution))
        say(f"{scene.name}: frames of {camera.resolution[1]} x {camera.resolution[0]} pixels")
        with tempfile.TemporaryDirectory() as folder:
            world = mi.load_dict(describe(mi, scene, camera, Path(folder)))
        path = mi.load_dict({"type": "path", "max_depth": 3})
        ours: list[Tensor] = []
        theirs: list[Any] = []
        calls: dict[str, Callable[[], object]] = {
            "fovden": lambda s=scene, c=camera, i=ours: i.append(trace_frame(s, c, options.spp, seed=len(i)).radiance),
            "peer": lambda w=world, p=path, i=theirs: i.append(rendered(mi, w, p, options.spp, len(i))),
        }
        times = alternate(calls, options.rounds)
        means = [
            float(torch.stack(ours).mean()),
            sum(float(mi.TensorXf(i).torch().mean()) for i in theirs) / len(theirs),
        ]
        results.append({
            "scene": scene.name, "triangles": scene.triangle_count, "threads": threads, "spp": options.spp,
            "pixels": camera.resolution[0] * camera.resolution[1], "mean": means, **times,
        })  # fmt: skip
    return results


def rendered(mi: Any, world: Any, path: Any, spp: int, seed: int) -> Any:
    """Returns Mitsuba's image when it is there."""
    import drjit  # noqa: PLC0415  the peer is optional

    image = mi.render(world, integrator=path, spp=spp, seed=seed)
    drjit.eval(image)
    drjit.sync_thread()
    return image


def tables(data: harness.Data) -> list[Table]:
    """Returns one row for each scene."""
    header = ["scene", "fovden, s", "Mitsuba, s", "fovden / Mitsuba", *harness.COMPARED]
    header += ["fovden, ns per ray", "Mitsuba, ns per ray", "means differ by"]
    rows = []
    for each in data["results"]:
        seconds = [statistics.median(each[side]["wall"]) for side in ("fovden", "peer")]
        rays = [each["pixels"] * (3 * each["spp"] + 1), each["pixels"] * 5 * each["spp"]]
        rows.append([
            f"{each['scene']}, {each['triangles']:,} triangles",
            *(f"{value:.2f}" for value in seconds),
            f"{seconds[0] / seconds[1]:.2f}",
            *compared(each["fovden"], each["peer"]),
            *(f"{1e9 * value / count:.0f}" for value, count in zip(seconds, rays, strict=True)),
            f"{100 * abs(each['mean'][0] / each['mean'][1] - 1):.1f} %",
        ])  # fmt: skip
    return [Table("Whole frames, Mitsuba 3", header, rows)]


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    config = data["config"]
    return (
        f"One eye of {config['resolution'][1]} x {config['resolution'][0]} pixels, {config['spp']} samples per pixel, "
        f"{data['results'][0]['threads']} threads; medians of {config['rounds']} rounds. Ratios are Mitsuba's time by "
        "fovden's within each round, above 1 where fovden is faster. "
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    parser = argparse.ArgumentParser("frame", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_scene_options(parser, SCENES)
    parser.add_argument("--spp", type=positive, default=SPP, help="samples per pixel")
    return harness.run("frame", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
