"""The fused à-trous filter on a visual-polar raster beside the same on the screen: time per cell over time per pixel.

Five levels over two views, forwards, and with gradients of radiance and widths or of everything, on random tensors. The
raster's columns are cut smoothly, so that near the gaze no two neighbours have one height. Transposing images to angles
and back is counted.

    python -m benchmarks.atrous_polar
    python -m benchmarks.atrous_polar --raster 45 40 --resolution 54 48 --quick
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from benchmarks import harness
from benchmarks.harness import Table, alternate, positive, say
from fovden import Gaze
from fovden.filters import operator as _operator  # noqa: F401  it defines fovden::atrous
from fovden.foveation import VisualPolarWarp

STEPS = (16, 8, 4, 2, 1)
"""Steps of the five levels, as the non-homogeneous denoiser's."""

KINDS = {"forwards": (), "both ways, radiance and widths": (0, 6), "both ways, everything": (0, 1, 2, 3, 6)}
"""What is timed, and which arguments' gradients are taken."""


def arguments(height: int, width: int, heights: Tensor | None = None) -> list[Any]:
    """Random arguments of the operator, up to whether it keeps what gradients need."""
    generator = torch.Generator().manual_seed(0)
    radiance, normal, position = (torch.rand(2, 3, height, width, generator=generator) for _ in range(3))
    normal = torch.nn.functional.normalize(normal - 0.5, dim=1)
    mask = torch.ones(2, 1, height, width)
    inverse = torch.tensor([[0.7, 0.5, 0.4]]).expand(len(STEPS), 3).contiguous() ** -2
    images = [radiance, normal, position, mask, mask > 0, None, inverse, None, None, heights]
    return [*images, list(STEPS), [0] * 5, list(range(len(STEPS))), False, False]


def call(given: Sequence[Any], wanted: Sequence[int]) -> Any:
    """A call of the operator, with the gradients of some of its arguments."""

    def run() -> object:
        own = list(given)
        leaves: list[Tensor] = []
        for place in wanted:
            own[place] = own[place].detach().requires_grad_()
            leaves.append(own[place])
        image = torch.ops.fovden.atrous(*own, bool(wanted))[0]
        return torch.autograd.grad(image.sum(), leaves) if wanted else image

    return run


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each way."""
    threads = harness.threads()
    torch.set_num_threads(threads)
    warp = VisualPolarWarp(Gaze(torch.zeros(2, 2)), options.resolution, options.raster)
    cells, pixels = 2 * int(warp.heights.sum()), 2 * options.resolution[0] * options.resolution[1]
    on_raster, on_screen = arguments(*options.raster, warp.heights), arguments(*options.resolution)
    results = []
    for kind, wanted in KINDS.items():
        say(f"{kind}, {cells} cells and {pixels} pixels")
        times = alternate({"polar": call(on_raster, wanted), "screen": call(on_screen, wanted)}, options.rounds)
        results.append({"kind": kind, "cells": cells, "pixels": pixels, "threads": threads, "times": times})
    return results


def tables(data: harness.Data) -> list[Table]:
    """Returns what a cell costs, and how many pixels that is."""
    rows = []
    for each in data["results"]:
        polar, pixel = (
            [1e9 * seconds / each[count] for seconds in each["times"][side]["wall"]]
            for side, count in (("polar", "cells"), ("screen", "pixels"))
        )
        ratios = [a / b for a, b in zip(polar, pixel, strict=True)]
        costs = [f"{statistics.median(cost):.0f}" for cost in (polar, pixel)]
        spread = f"{min(ratios):.2f} to {max(ratios):.2f}"
        rows.append([each["kind"], f"{each['cells']:,}", *costs, f"{statistics.median(ratios):.2f}", spread])
    header = ["five levels", "cells", "ns a cell", "ns a pixel", "ratio", "lowest to highest"]
    return [Table("The à-trous filter on a polar raster", header, rows)]


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    (rows, columns), (height, width) = data["config"]["raster"], data["config"]["resolution"]
    return (
        f"Two views: a visual-polar raster of {columns} x {rows}, cut smoothly, and {width} x {height} pixels. "
        f"Medians of {data['config']['rounds']} rounds; ratios of time per cell and per pixel within each round. "
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    parser = argparse.ArgumentParser(
        "atrous_polar", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    size = {"type": positive, "nargs": 2, "metavar": ("HEIGHT", "WIDTH")}
    parser.add_argument("--raster", default=(900, 800), **size)
    parser.add_argument("--resolution", default=(1080, 960), **size)
    return harness.run("atrous_polar", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
