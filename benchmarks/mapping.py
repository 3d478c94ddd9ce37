"""Polar rasters to the screen, each time with a gaze that is new, beside the same of torch operations.

Two eyes, three channels, as a headset asks for them in every frame: `to_screen` and `blur`, forwards and back, and what
a tracer asks before: which cells are read, and where they lie. Peers, in the same rounds:

- ``torch``: the same of torch operations, which find a plan for each gaze: ``composed`` and ``compose`` of
  :mod:`fovden.warps`, which also are what the kernels' values are compared with.
- ``grid_sample``: one bilinear read per pixel, at places that are known already; no way to the screen does with less.

    python -m benchmarks.mapping
    python -m benchmarks.mapping --resolution 270 240 --quick
"""

from __future__ import annotations

import argparse
import itertools
import math
import statistics
import sys
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from benchmarks import harness
from benchmarks.harness import Table, alternate, compared, positive
from fovden.camera import Gaze
from fovden.foveation import LogPolarWarp, PolarWarp, VisualPolarWarp
from fovden.warps._resample import composed
from fovden.warps.blur import compose

WARPS = {"visual-polar": VisualPolarWarp, "log-polar": LogPolarWarp}


class Setting:
    """A raster, random images in it and on the screen, and a gaze that moves on with every call."""

    def __init__(self, kind: str, screen: tuple[int, int]) -> None:
        self.kind, self.screen = WARPS[kind], screen
        self.resolution = (max(1, round(screen[0] * 5 / 6)), max(1, round(screen[1] * 5 / 6)))
        generator = torch.Generator().manual_seed(0)
        self.cells = torch.rand(2, 3, *self.resolution, generator=generator)
        self.pixels = torch.rand(2, 3, *screen, generator=generator)
        self.turns = itertools.count()

    def warp(self, turn: int | None = None) -> PolarWarp:
        """The raster around the next gaze, or around that of a turn: a walk over the middle half of the screen."""
        angle = 0.7 * (next(self.turns) if turn is None else turn)
        height, width = self.screen
        at = [width * (0.5 + 0.23 * math.cos(angle)), height * (0.5 + 0.21 * math.sin(1.3 * angle))]
        return self.kind(Gaze(torch.tensor([at, [at[0] - 8, at[1]]])), self.screen, self.resolution)

    def back(self, call: Callable[[Tensor], Tensor], image: Tensor, seed: Tensor) -> Tensor:
        """The gradient in an image, forwards and back."""
        leaf = image.detach().requires_grad_()
        return torch.autograd.grad(call(leaf), leaf, seed)[0]


def composed_blur(warp: PolarWarp, image: Tensor) -> Tensor:
    """``warp.blur`` of torch operations."""
    largest = math.pi * warp.reach / warp.resolution[0]
    bounds = [each.reshape(-1, 1, 1, 1).double() for each in (warp.blur_start, warp.reach, largest)]
    return compose(image, warp.gaze, *bounds)


def read_by_torch(warp: PolarWarp) -> Tensor:
    """``warp.read`` of torch operations: the gradient of ones, forwards and back."""
    leaf = torch.zeros(2, 1, *warp.resolution, requires_grad=True)
    found: Tensor = torch.autograd.grad(composed(warp, leaf, "area").sum(), leaf)[0] > 0
    return found


def tasks(setting: Setting) -> dict[str, dict[str, Callable[[PolarWarp], Tensor]]]:
    """What is timed: for each task, the sides' calls on a warp."""
    cells, pixels = setting.cells, setting.pixels
    grid = 2 * torch.rand(2, *setting.screen, 2) - 1
    return {
        "to the screen": {
            "fovden": lambda warp: warp.to_screen(cells),
            "peer": lambda warp: composed(warp, cells, "area"),
            "bound": lambda _: torch.nn.functional.grid_sample(cells, grid, align_corners=False),
        },
        "to the screen, and its gradient": {
            "fovden": lambda warp: setting.back(warp.to_screen, cells, pixels),
            "peer": lambda warp: setting.back(lambda image: composed(warp, image, "area"), cells, pixels),
        },
        "blur": {
            "fovden": lambda warp: warp.blur(pixels),
            "peer": lambda warp: composed_blur(warp, pixels),
        },
        "blur, and its gradient": {
            "fovden": lambda warp: setting.back(warp.blur, pixels, pixels),
            "peer": lambda warp: setting.back(lambda image: composed_blur(warp, image), pixels, pixels),
        },
        "which cells are read": {"fovden": lambda warp: warp.read, "peer": read_by_torch},
        "where cells lie": {
            "fovden": lambda warp: warp.cell_to_screen(warp.cells()),
            "peer": lambda warp: warp._points(warp.cells()),
        },
    }


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each raster and task."""
    torch.set_num_threads(harness.threads())
    results = []
    for kind in WARPS:
        setting = Setting(kind, tuple(options.resolution))
        for task, sides in tasks(setting).items():
            harness.say(f"{kind}: {task}")
            warp = setting.warp(0)
            apart = (sides["fovden"](warp).float() - sides["peer"](warp).float()).abs()
            calls = {side: lambda call=call, s=setting: call(s.warp()) for side, call in sides.items()}
            results.append({
                "raster": kind, "task": task, "difference": float(apart.mean() if "read" in task else apart.max()),
                "threads": torch.get_num_threads(), **alternate(calls, options.rounds),
            })  # fmt: skip
    return results


def tables(data: harness.Data) -> list[Table]:
    """Returns a table for each raster, with one row for each task."""
    header = ["two eyes, a new gaze", "fovden, ms", "torch, ms", *harness.COMPARED, "grid_sample, ms", "differ by"]
    found = []
    for raster in WARPS:
        rows = []
        for each in data["results"]:
            if each["raster"] == raster:
                ms = [
                    f"{1e3 * statistics.median(each[side]['wall']):.1f}" if side in each else ""
                    for side in ("fovden", "peer", "bound")
                ]
                ratios = compared(each["fovden"], each["peer"])
                rows.append([each["task"], *ms[:2], *ratios, ms[2], f"{each['difference']:.1e}"])
        found.append(Table(f"The {raster} raster, torch operations", header, rows))
    return found


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    config = data["config"]
    height, width = config["resolution"]
    return (
        f"Two eyes of {width} x {height} pixels, 5 / 6 as many cells in both directions, three channels, "
        f"{data['results'][0]['threads']} threads; medians of {config['rounds']} rounds, ratios within each round, "
        "above 1 where fovden is faster. The largest difference is given; for masks, the share of cells that differ. "
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("mapping", description=__doc__, formatter_class=form)
    parser.add_argument("--resolution", type=positive, nargs=2, default=(1080, 960), metavar=("HEIGHT", "WIDTH"))
    return harness.run("mapping", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
