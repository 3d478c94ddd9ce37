"""What does it save to choose lights by their power, or by a tree over them?

    python -m experiments.light_choice --preset smoke

For each scene and each way to choose: the variance of a sample, the mean over pixels and channels of what differs
between frames of different seeds, and the processor time of a path. Variance times time is what a given noise costs.
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

from experiments.compare_denoisers import sponza
from experiments.harness import run_script
from experiments.lamp_hall import lamp_hall
from fovden.camera import StereoCamera
from fovden.comparison import SceneSettings
from fovden.results import Measurement, Run
from fovden.tracer import Integrator, Scene, make_scene, trace_frame
from fovden.tracer.arrays import LightChoice, light_table

__all__ = ["Settings", "main"]


@dataclass(frozen=True)
class Settings:
    """What is measured.

    Attributes:
        scenes: Names of scenes made in code, ``"hall"`` with a number of emissive triangles, or ``"sponza"``, which is
            left out where its file is not there.
        resolution: Height and width of each view.
        spp: Samples per pixel of a frame.
        frames: Frames with seeds of their own.

    Example:
        >>> Settings().spp
        16
    """

    scenes: tuple[str, ...] = ("forest", "hall 1000", "hall 100000", "pink_room", "sponza")
    resolution: tuple[int, int] = (64, 64)
    spp: int = 16
    frames: int = 16


def scene_of(name: str, resolution: tuple[int, int]) -> tuple[Scene, StereoCamera] | None:
    """Returns a scene and its camera, or nothing where its file is missing."""
    if name.startswith("hall"):
        scene = lamp_hall(int(name.split()[1]))
    elif name == "sponza":
        view: SceneSettings = sponza().view
        if not Path(view.scene).is_file():
            print(f"{view.scene} is not there; set FOVDEN_SCENES")
            return None
        scene, camera = view.load()
        return scene, camera.at(resolution=resolution)
    else:
        scene = make_scene(name)
    assert scene.camera is not None
    return scene, scene.camera.at(resolution=resolution)


def run(settings: Settings, folder: Path) -> None:
    """Measures all scenes on one thread and prints a table."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with Run(folder, settings) as record:
            for name in settings.scenes:
                found = scene_of(name, settings.resolution)
                if found is not None:
                    measure(record, settings, *found)
    finally:
        torch.set_num_threads(before)


def measure(record: Run, settings: Settings, scene: Scene, camera: StereoCamera) -> None:
    """Measures one scene."""

    def add(choice: str, metric: str, value: float) -> None:
        record.measurements.append(Measurement(scene.name, 0, "", choice, "whole", metric, value))
        print(f"{scene.name:40} {choice:8} {metric:16} {value:.4g}")

    trace_frame(scene, camera, 1)  # builds what is built once, and compiles
    add("", "lights", len(light_table(scene).kind))
    paths = settings.spp * camera.views.view_count * settings.resolution[0] * settings.resolution[1]
    for choice in get_args(LightChoice):
        began = time.thread_time()
        light_table(scene, choice)
        add(choice, "seconds_build", time.thread_time() - began)
        frames, seconds = [], []
        for seed in range(settings.frames):
            began = time.thread_time()
            frames.append(trace_frame(scene, camera, settings.spp, seed=seed, integrator=Integrator(lights=choice)))
            seconds.append(time.thread_time() - began)
        for part in ("direct", "radiance"):
            values = torch.stack([getattr(frame, part) for frame in frames]).double()
            add(choice, f"mean_{part}", float(values.mean()))
            add(choice, f"variance_{part}", float(values.var(0).mean()) * settings.spp)
        add(choice, "microseconds", min(seconds) / paths * 1e6)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    presets: dict[str, Callable[[], Settings]] = {
        "smoke": lambda: Settings(("forest", "hall 100"), (16, 16), 4, 2),
        "full": Settings,
    }
    return run_script("light_choice", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
