"""How the cost grows: rays per second against the number of triangles, and a frame's time against its pixels.

The scene is ``pink_room``, of which ``detail`` chooses the number of triangles: the same room, finer. Rays are those of
rays.py, on all cores; where Open3D is installed, Embree answers the same ones in the same rounds. A frame is
``trace_frame`` with its G-buffer, one eye, 4 samples per pixel, at the scene's own number of triangles.

The figure goes to docs/pictures, from the saved results.

    python -m benchmarks.growth
    python -m benchmarks.growth --show
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks import harness
from benchmarks.harness import Table, Times, alternate, available, positive, say
from benchmarks.peers import Fovden, Open3D
from benchmarks.rays import KINDS
from benchmarks.scenes import left_eye, opaque, ray_kinds
from fovden.figures import PRINT_WIDTH, drawing
from fovden.tracer import make_scene, trace_frame

SCENE = "pink_room"
TRIANGLES = (1_000, 10_000, 100_000, 1_000_000, 4_000_000)
RESOLUTION = (540, 480)
FRAMES = ((135, 120), (270, 240), (540, 480), (1080, 960), (2160, 1920))
SPP = 4
PICTURE = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "growth.png"
COLOURS = {"primary": "#0072b2", "tiles": "#009e73", "bounce": "#d55e00", "shadow": "#cc79a7"}
"""Okabe and Ito's, as in :mod:`fovden.figures.style`."""


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each number of triangles and kind of rays, and one for each resolution."""
    threads = harness.threads()
    torch.set_num_threads(threads)
    peers = available("open3d")
    results = []
    for triangles in options.triangles:
        say(f"{SCENE}, {triangles} triangles")
        scene = opaque(make_scene(SCENE, detail=triangles))
        camera = left_eye(scene, tuple(options.resolution))
        kinds = ray_kinds(scene, camera)
        own = Fovden(scene, threads)
        sides = {peer: Open3D(scene) for peer in peers}
        for kind in KINDS:
            rays = kinds["primary" if kind == "tiles" else kind]
            mine = own.in_tiles(rays, camera.resolution) if kind == "tiles" else own.asked(kind, rays)
            asked = {"fovden": mine[0]}
            if kind != "tiles":  # Embree's would be those of "primary" again
                asked |= {peer: side.asked(kind, rays)[0] for peer, side in sides.items()}
            times = alternate(asked, options.rounds)
            results.append({"triangles": triangles, "kind": kind, "rays": len(rays[0]), "times": times})
    scene = make_scene(SCENE, detail=options.frame_triangles)
    for resolution in options.frames:
        camera = left_eye(scene, resolution)
        say(f"{SCENE}, frame of {resolution[1]} x {resolution[0]} pixels")
        times = alternate({"fovden": lambda c=camera: trace_frame(scene, c, SPP)}, options.rounds)
        results.append({"triangles": scene.triangle_count, "kind": "frame", "resolution": resolution, "times": times})
    return results


def tables(data: harness.Data) -> list[Table]:
    """Returns rays per second by triangles, and seconds by pixels."""
    rays = [each for each in data["results"] if each["kind"] != "frame"]
    frames = [each for each in data["results"] if each["kind"] == "frame"]
    sides = [side for side in ("fovden", "open3d") if any(side in each["times"] for each in rays)]
    columns = [(side, kind) for side in sides for kind in KINDS if any(_found(rays, side, kind))]
    titles = {"fovden": "", "open3d": "Embree: "}
    by_triangles = Table(
        "Millions of rays per second by triangles",
        ["triangles", *(titles[side] + KINDS[kind].replace(", closest hit", "") for side, kind in columns)],
        [
            [f"{count:,}", *(_rate(rays, side, kind, count) for side, kind in columns)]
            for count in sorted({each["triangles"] for each in rays})
        ],
    )
    by_pixels = Table(
        "Seconds per frame by pixels",
        ["resolution", "pixels", "seconds", "nanoseconds per pixel"],
        [
            [
                "{1} x {0}".format(*each["resolution"]),
                f"{_pixels(each):,}",
                f"{_seconds(each['times']['fovden']):.3f}",
                f"{1e9 * _seconds(each['times']['fovden']) / _pixels(each):.0f}",
            ]
            for each in frames
        ],
    )
    return [by_triangles, by_pixels]


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    config, frames = data["config"], [each for each in data["results"] if each["kind"] == "frame"]
    return (
        f"{SCENE}; rays of one eye of {config['resolution'][1]} x {config['resolution'][0]} pixels; frames of "
        f"{frames[0]['triangles']:,} triangles with {SPP} samples per pixel. Medians of {config['rounds']} rounds. "
    )


def _found(rays: list[dict[str, Any]], side: str, kind: str) -> list[dict[str, Any]]:
    return [each for each in rays if each["kind"] == kind and side in each["times"]]


def _seconds(times: Times) -> float:
    return statistics.median(times["wall"])


def _pixels(each: dict[str, Any]) -> int:
    return int(each["resolution"][0] * each["resolution"][1])


def _rate(rays: list[dict[str, Any]], side: str, kind: str, triangles: int) -> str:
    return next(
        f"{each['rays'] / _seconds(each['times'][side]) / 1e6:.2f}"
        for each in _found(rays, side, kind)
        if each["triangles"] == triangles
    )


def draw(data: harness.Data) -> Figure:
    """Returns the figure: rays per second against triangles, seconds against pixels, both axes logarithmic."""
    rays = [each for each in data["results"] if each["kind"] != "frame"]
    frames = [each for each in data["results"] if each["kind"] == "frame"]
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 3.1), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=[1.5, 1])
        for kind, colour in COLOURS.items():
            for side, style in (("fovden", "o-"), ("open3d", "x--")):
                found = _found(rays, side, kind)
                rates = [each["rays"] / _seconds(each["times"][side]) / 1e6 for each in found]
                if found:
                    label = f"{KINDS[kind]}{', Embree' if side == 'open3d' else ''}"
                    options = {"color": colour, "label": label, "markersize": 3.5, "linewidth": 1}
                    left.plot([each["triangles"] for each in found], rates, style, **options)
        times = [_seconds(each["times"]["fovden"]) for each in frames]
        right.plot(
            [_pixels(each) for each in frames], times, "o-", color=COLOURS["primary"], markersize=3.5, linewidth=1
        )
        left.set(xlabel="triangles", ylabel="million rays per second")
        right.set(xlabel="pixels", ylabel=f"seconds per frame, {SPP} samples per pixel")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=4, frameon=False)
        for panel in (left, right):
            panel.set(xscale="log", yscale="log")
            panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            panel.yaxis.set_major_formatter("{x:g}")
            panel.yaxis.set_minor_formatter(NullFormatter())
            panel.grid(which="major", color="#d0d0d0", linewidth=0.5)
            for edge in ("top", "right"):
                panel.spines[edge].set_visible(False)
    return figure


def resolution(text: str) -> tuple[int, int]:
    """Reads ``HEIGHTxWIDTH`` from the command line."""
    height, _, width = text.partition("x")
    return positive(height), positive(width)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark, draws the figure, and returns the exit status."""
    parser = argparse.ArgumentParser(
        "growth", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--triangles", nargs="+", type=positive, default=TRIANGLES, metavar="N", help="1,000 to 10^7")
    parser.add_argument("--resolution", type=positive, nargs=2, default=RESOLUTION, metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--frames", nargs="+", type=resolution, default=FRAMES, metavar="HEIGHTxWIDTH")
    parser.add_argument("--frame-triangles", type=positive, metavar="N", help="default: the scene's own number")
    parser.add_argument("--picture", type=Path, default=PICTURE, metavar="FILE", help="where the figure goes (PNG)")
    return harness.run("growth", parser, measure, tables, note, arguments, draw)


if __name__ == "__main__":
    sys.exit(main())
