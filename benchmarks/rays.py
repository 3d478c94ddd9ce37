"""Rays per second beside Embree's, the same rays, in one run of alternating rounds.

Three kinds of rays of each scene: closest hits of camera rays, closest hits from surfaces in cosine-distributed
directions, any hits from surfaces towards the scene's lights. Embree is asked twice: on all cores through Open3D's
RaycastingScene, against fovden on as many; and on one thread through embreex, against fovden on one. All sides get the
same float32 arrays and answer through their Python call, allocation of the results included; nobody is timed while it
builds its acceleration structure (that is build.py). Triangles are taken for solid: Embree is not told of holes.

fovden returns distance, barycentric coordinates and triangle. Open3D returns these, geometry and normal as well;
embreex is asked for the triangle alone, its fastest answer. Camera rays are also traced in tiles, which is how fovden's
G-buffer traces them; Embree's side is then the same camera rays again, one by one.

    python -m benchmarks.rays
    python -m benchmarks.rays --scenes sponza pink_room:100000 --quick
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from typing import Any

from benchmarks import harness
from benchmarks.harness import Table, alternate, available, compared, say
from benchmarks.peers import PEERS, Fovden, Rays, Structure, differing
from benchmarks.scenes import add_scene_options, left_eye, load_named, opaque, ray_kinds

KINDS = {
    "primary": "camera, closest hit",
    "tiles": "camera, in tiles",
    "bounce": "diffuse bounce, closest hit",
    "shadow": "shadow, any hit",
}


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each scene, kind of rays and peer."""
    peers = available(*options.peers)
    if not peers:
        raise ValueError("neither open3d nor embreex is installed; see benchmarks/README.md")
    results = []
    for scene in map(opaque, load_named(options.scenes)):
        camera = left_eye(scene, tuple(options.resolution))
        kinds = ray_kinds(scene, camera)
        bvh = Fovden(scene, harness.threads()).bvh
        for peer in peers:
            theirs = PEERS[peer](scene)
            own = Fovden(scene, theirs.threads, bvh)
            for kind in KINDS:
                rays = kinds.get("primary" if kind == "tiles" else kind)
                if rays is not None:
                    say(f"{scene.name}, {scene.triangle_count} triangles: {kind}, {own.threads} threads, {peer}")
                    found = compare(own, theirs, kind, rays, camera.resolution, options.rounds)
                    results.append({"scene": scene.name, "triangles": scene.triangle_count, "package": peer, **found})
    return results


def compare(
    own: Fovden, theirs: Structure, kind: str, rays: Rays, resolution: tuple[int, int], rounds: int
) -> dict[str, Any]:
    """Returns the times of both sides, and the share of rays about which they differ."""
    call, read = own.in_tiles(rays, resolution) if kind == "tiles" else own.asked(kind, rays)
    other, read_other = theirs.asked(kind, rays)
    different = differing(read(call()), read_other(other()))
    times = alternate({"fovden": call, "peer": other}, rounds)
    return {"kind": kind, "threads": own.threads, "rays": len(rays[0]), "different": different, **times}


def tables(data: harness.Data) -> list[Table]:
    """Returns one table for each peer."""
    header = ["scene and rays", "fovden, M/s", "Embree, M/s", *harness.COMPARED, "rays that differ"]
    made = []
    for peer, title in (("open3d", "All cores, Open3D"), ("embreex", "One thread, embreex")):
        rows = [
            [
                f"{each['scene']}, {each['triangles']:,} triangles: {KINDS[each['kind']]}",
                *(f"{each['rays'] / statistics.median(each[side]['wall']) / 1e6:.2f}" for side in ("fovden", "peer")),
                *compared(each["fovden"], each["peer"]),
                f"{each['different']:.1e}",
            ]
            for each in data["results"]
            if each["package"] == peer
        ]
        if rows:
            made.append(Table(title, header, rows))
    return made


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    counts = sorted({each["rays"] for each in data["results"]})
    config = data["config"]
    return (
        f"{counts[0]:,} to {counts[-1]:,} rays of a camera of {config['resolution'][1]} x {config['resolution'][0]} "
        f"pixels; medians of {config['rounds']} rounds, ratios within each round, above 1 where fovden is faster. "
        "M/s: millions of rays a second. Rays differ where one side meets what the other misses, or where distances "
        "are more than a thousandth apart. "
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    parser = argparse.ArgumentParser("rays", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_scene_options(parser)
    parser.add_argument("--peers", nargs="+", choices=list(PEERS), default=list(PEERS), help="whom to compare with")
    return harness.run("rays", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
