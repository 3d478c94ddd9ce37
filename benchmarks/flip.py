"""FLIP beside its authors' evaluator, in one run: how long it takes, and how far the two are apart.

The image is the atrium's, traced with few samples, against one with more; both sides get the same float32 arrays.
fovden judges both eyes in one call, the evaluator one after the other; one thread is asked for on either side. The
largest difference is that of the two error maps, over all pixels of both eyes.

    python -m benchmarks.flip
    python -m benchmarks.flip --resolution 1080 960
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from benchmarks import harness
from benchmarks.harness import Table, alternate, compared, positive
from fovden import color, metrics
from fovden.tracer import make_scene, trace_frame
from fovden.tracer.procedural import SCENES


def evaluator(kind: str, image: Tensor, reference: Tensor) -> npt.NDArray[np.float32]:
    """Returns the authors' error maps of all views, shape (v, h, w); they get the reference first."""
    import flip_evaluator  # noqa: PLC0415  the peer is optional

    views = [each.permute(0, 2, 3, 1).contiguous().numpy() for each in (reference, image)]
    maps = [
        flip_evaluator.evaluate(*pair, kind, inputsRGB=True, applyMagma=False, computeMeanError=False)[0][..., 0]
        for pair in zip(*views, strict=True)
    ]
    return np.stack(maps)


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each kind of FLIP."""
    os.environ["OMP_NUM_THREADS"] = "1"  # read when the evaluator is loaded
    torch.set_num_threads(1)
    world = make_scene(options.scene)
    camera = world.view().at(tuple(options.resolution))
    noisy, better = (trace_frame(world, camera, spp, seed=spp).radiance for spp in (4, 32))
    exposure = color.exposure(better)
    shown = [color.display(radiance, exposure) for radiance in (noisy, better)]
    results = []
    for kind, images, own in (("LDR", shown, metrics.flip_map), ("HDR", [noisy, better], metrics.hdr_flip_map)):
        calls: dict[str, Callable[[], object]] = {
            "fovden": lambda images=images, own=own: own(*images),
            "peer": lambda images=images, kind=kind: evaluator(kind, *images),
        }
        difference = float(np.abs(own(*images)[:, 0].numpy() - evaluator(kind, *images)).max())
        results.append({"kind": kind, "difference": difference, **alternate(calls, options.rounds)})
    return results


def tables(data: harness.Data) -> list[Table]:
    """Returns one row for each kind of FLIP."""
    header = ["FLIP", "fovden, s", "evaluator, s", *harness.COMPARED, "largest difference of the maps"]
    rows = [
        [
            each["kind"],
            *(f"{statistics.median(each[side]['wall']):.2f}" for side in ("fovden", "peer")),
            *compared(each["fovden"], each["peer"]),
            f"{each['difference']:.1e}",
        ]
        for each in data["results"]
    ]
    return [Table("FLIP, its authors' evaluator", header, rows)]


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    config = data["config"]
    height, width = config["resolution"]
    return (
        f"{config['scene']}, both eyes of {width} x {height} pixels, one thread; medians of {config['rounds']} rounds, "
        "ratios within each round, above 1 where fovden is faster. "
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    parser = argparse.ArgumentParser("flip", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=list(SCENES), default="atrium", help="a procedural scene")
    parser.add_argument("--resolution", type=positive, nargs=2, default=(540, 480), metavar=("HEIGHT", "WIDTH"))
    return harness.run("flip", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
