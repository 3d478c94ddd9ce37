"""How fast does the noise fall with the number of samples, for each sampler?

    python -m experiments.sampler_convergence --preset smoke

The noise of a frame is the standard deviation between frames of different seeds, as the root mean square over pixels
and channels, relative to the mean radiance. Both samplers have the same mean, so no reference is needed, whose own
noise would be a floor. The figure is drawn from the numbers alone.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import torch

from experiments.harness import run_script
from fovden.figures import draw_convergence
from fovden.results import Measurement, Run
from fovden.tracer import Integrator, make_scene, trace_frame
from fovden.tracer.arrays import LightChoice
from fovden.tracer.integrator import Sampler

__all__ = ["Settings", "main"]


@dataclass(frozen=True)
class Settings:
    """What is measured.

    Attributes:
        scenes: Names of scenes made in code.
        lights: How lights are chosen.
        resolution: Height and width of each view.
        octaves: The last number of samples per pixel is two to this power, the first 1.
        frames: Frames with seeds of their own for each number.

    Example:
        >>> Settings().octaves
        9
    """

    scenes: tuple[str, ...] = ("cornell_box", "pink_room", "forest")
    lights: LightChoice = "tree"
    resolution: tuple[int, int] = (24, 24)
    octaves: int = 9
    frames: int = 8


def run(settings: Settings, folder: Path) -> None:
    """Measures all scenes on one thread and draws the figure."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with Run(folder, settings) as record:
            for name in settings.scenes:
                measure(record, settings, name)
    finally:
        torch.set_num_threads(before)
    print(f"figure: {draw_convergence(folder)}")


def measure(record: Run, settings: Settings, name: str) -> None:
    """Measures one scene."""
    scene = make_scene(name)
    assert scene.camera is not None
    camera = scene.camera.at(resolution=settings.resolution)
    trace_frame(scene, camera, 1)
    for sampler in get_args(Sampler):
        integrator = Integrator(lights=settings.lights, sampler=sampler)
        for octave in range(settings.octaves + 1):
            spp, began = 2**octave, time.thread_time()
            frames = [
                trace_frame(scene, camera, spp, seed=seed, integrator=integrator).radiance.double()
                for seed in range(settings.frames)
            ]
            values, seconds = torch.stack(frames), time.thread_time() - began
            noise = float(values.var(0).mean().sqrt() / values.mean())
            for metric, value in (("noise", noise), ("mean", float(values.mean())), ("seconds", seconds)):
                record.measurements.append(Measurement(name, 0, "", sampler, f"{spp} spp", metric, value))
            print(f"{name:12} {sampler:12} {spp:6} spp  noise {noise:.5f}  {seconds:.2f} s")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    presets: dict[str, Callable[[], Settings]] = {
        "smoke": lambda: Settings(("cornell_box",), "uniform", (8, 8), 4, 3),
        "full": Settings,
    }
    return run_script("sampler_convergence", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
