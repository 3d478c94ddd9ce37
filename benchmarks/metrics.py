"""FLIP beside its authors' evaluator, in one run: how long it takes, and how far the two are apart.

The image is the atrium's, traced with few samples, against one with more; both sides get the same float32 arrays.
fovden judges both eyes in one call, the evaluator one after the other. Rounds alternate; time is the processor's, of
all threads together, with one thread asked for on either side. Every round's seconds go into ``metrics.csv`` of the
output's folder, with ``config.json`` and ``provenance.json`` beside it (see :mod:`fovden.results`). There ``largest
difference`` is that of the two error maps, over all pixels of both eyes.

    python benchmarks/metrics.py
    python benchmarks/metrics.py --resolution 1080 960 --repeats 3 -o out/flip
"""
# ruff: noqa: T201

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # read when the evaluator is loaded

import argparse
import statistics
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from fovden import color, metrics
from fovden.results import Measurement, Run
from fovden.tracer import make_scene, trace_frame

RESULTS = Path(__file__).parent / "results" / "flip"


def evaluator(kind: str, image: Tensor, reference: Tensor) -> npt.NDArray[np.float32]:
    """Returns the authors' error maps of all views, shape (v, h, w); they get the reference first."""
    import flip_evaluator  # noqa: PLC0415  the peer is optional

    views = [each.permute(0, 2, 3, 1).contiguous().numpy() for each in (reference, image)]
    maps = [
        flip_evaluator.evaluate(*pair, kind, inputsRGB=True, applyMagma=False, computeMeanError=False)[0][..., 0]
        for pair in zip(*views, strict=True)
    ]
    return np.stack(maps)


def measure(scene: str, resolution: tuple[int, int], repeats: int) -> list[Measurement]:
    """Prints the table and returns its numbers."""
    world = make_scene(scene)
    camera = world.view().at(resolution)
    noisy, better = (trace_frame(world, camera, spp, seed=spp).radiance for spp in (4, 32))
    exposure = color.exposure(better)
    shown = [color.display(radiance, exposure) for radiance in (noisy, better)]
    found: list[Measurement] = []
    print("          fovden, s   evaluator, s   ratio   largest difference")
    for kind, images, own in (
        ("LDR", shown, metrics.flip_map),
        ("HDR", [noisy, better], metrics.hdr_flip_map),
    ):
        calls: dict[str, Callable[[], object]] = {
            "fovden": lambda images=images, own=own: own(*images),
            "evaluator": lambda images=images, kind=kind: evaluator(kind, *images),
        }
        times: dict[str, list[float]] = {name: [] for name in calls}
        for turn in range(repeats + 1):  # the first round is not counted
            for name, call in calls.items():
                begin = time.process_time()
                call()
                if turn > 0:
                    times[name].append(time.process_time() - begin)
        difference = float(np.abs(own(*images)[:, 0].numpy() - evaluator(kind, *images)).max())
        medians = [statistics.median(values) for values in times.values()]
        print(f"{kind:8} {medians[0]:10.3f} {medians[1]:14.3f} {medians[1] / medians[0]:7.2f} {difference:20.2e}")
        found.append(Measurement(scene, 0, "", "", kind, "largest difference", difference))
        for name, values in times.items():
            found.extend(Measurement(scene, n, "", name, kind, "seconds", value) for n, value in enumerate(values))
    return found


def main() -> None:
    """Reads the command line and measures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="atrium", help="name of a procedural scene")
    parser.add_argument("--resolution", type=int, nargs=2, default=(540, 480), metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--repeats", type=int, default=5, help="timed rounds, of which the median counts")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS, metavar="DIR", help="default: results/flip")
    options = parser.parse_args()
    torch.set_num_threads(1)
    config = {
        "scene": options.scene,
        "resolution": tuple(options.resolution),
        "repeats": options.repeats,
        "flip-evaluator": metadata.version("flip-evaluator"),
    }
    with Run(options.output, config) as run:
        run.measurements += measure(options.scene, tuple(options.resolution), options.repeats)


if __name__ == "__main__":
    main()
