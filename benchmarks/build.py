"""Time and memory of the acceleration structure beside Embree's, in one run of alternating rounds.

From arrays of vertices and faces to a structure that answers: ``build_bvh`` here; ``add_triangles`` and a commit by
the first ray through Open3D, a mesh and a commit by the first ray through embreex, both on all cores, which is how many
embreex takes when it builds. fovden builds on as many.

Memory is by how much the process grew, per triangle: once the structure is there, and at most until then. Each is
built in a new process for that, after a small one that loads what code there is, and what was freed is given back to
the system before each look. For fovden the structure's own size is given too, which is what rays go through; vertices
and faces are counted where a library keeps copies of them, as Embree does. With ``--quick`` memory is left out.

    python -m benchmarks.build
    python -m benchmarks.build --scenes pink_room:100000 --quick
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from benchmarks import harness, memory
from benchmarks.harness import Table, alternate, available, compared, say
from benchmarks.peers import PEERS, Fovden
from benchmarks.scenes import add_scene_options, load_named, opaque
from fovden.tracer import Bvh, Scene, build_bvh, make_scene


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each scene, with the times of all sides and their memory."""
    peers = available(*PEERS)
    threads = harness.threads()
    torch.set_num_threads(threads)
    results = []
    for scene in map(opaque, load_named(options.scenes)):
        say(f"{scene.name}, {scene.triangle_count} triangles: build")
        calls = {"fovden": lambda s=scene: build_bvh(s.vertices, s.faces)}
        calls |= {peer: lambda s=scene, peer=peer: PEERS[peer](s) for peer in peers}
        times = alternate(calls, options.rounds)
        grown = {side: None if options.quick else growth(scene, side, threads) for side in ("fovden", *peers)}
        bvh = build_bvh(scene.vertices, scene.faces)
        results.append({
            "scene": scene.name, "triangles": scene.triangle_count, "threads": threads,
            "structure": size(bvh), "memory": grown, "times": times,
        })  # fmt: skip
    return results


def size(bvh: Bvh) -> int:
    """Returns the bytes of a structure."""
    return sum(part.numel() * part.element_size() for part in bvh)


def growth(scene: Scene, side: str, threads: int) -> dict[str, int] | None:
    """Returns by how many bytes a new process grew, ``"kept"`` and ``"peak"``; ``None`` where nobody knows."""
    if not memory.is_known():
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mesh.pt")
        torch.save((scene.vertices, scene.faces), path)
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            return pool.apply(_grow, (str(path), side, threads))


def _grow(path: str, side: str, threads: int) -> dict[str, int]:
    vertices, faces = torch.load(path)
    small = opaque(make_scene("pink_room", detail=1000))
    mesh = Scene(vertices, faces, torch.zeros(len(faces), dtype=torch.int32), small.materials)

    def build(scene: Scene) -> object:
        return Fovden(scene, threads) if side == "fovden" else PEERS[side](scene)

    kept = [build(small)]
    before = memory.settled()
    memory.forget_peak()
    kept.append(build(mesh))
    peak = memory.peak()
    return {"kept": memory.settled() - before, "peak": peak - before}


def tables(data: harness.Data) -> list[Table]:
    """Returns one row for each scene and side."""
    header = ["scene", "seconds", *harness.COMPARED, "structure, bytes per triangle", "process grew by", "at most by"]
    names = {"fovden": "fovden", **{package: peer.name for package, peer in PEERS.items()}}
    rows = []
    for each in data["results"]:
        for side, times in each["times"].items():
            own = side == "fovden"
            memory = each["memory"][side]
            rows.append([
                f"{each['scene']}, {each['triangles']:,} triangles: {names[side]}",
                f"{statistics.median(times['wall']):.2f}",
                *(["", "", ""] if own else compared(each["times"]["fovden"], times)),
                f"{each['structure'] / each['triangles']:.0f}" if own else "",
                *(f"{memory[key] / each['triangles']:.0f}" if memory else "" for key in ("kept", "peak")),
            ])  # fmt: skip
    return [Table("Building", header, rows)]


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    return (
        f"{data['results'][0]['threads']} threads; medians of {data['config']['rounds']} rounds. Ratios are a peer's "
        "time by fovden's within each round, above 1 where fovden is faster. Memory in bytes per triangle. "
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    parser = argparse.ArgumentParser("build", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_scene_options(parser)
    return harness.run("build", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
