"""Are rays faster in the order of a polar raster, where neighbours in memory are neighbours to the eye?

    python -m experiments.ray_order --preset smoke

Rays of every cell that the screen reads, one by one in the order of the raster's memory: camera rays, and from what
these hit a bounce in a random direction. What is counted is rays per second of one thread, against rays of all pixels,
row by row; and a shuffled order shows how much there is to lose. Finding the cells' rays is not counted.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.scenes import bounce_rays
from experiments.frame_sets import frame_set
from experiments.harness import run_script, timed
from experiments.tune_sigmas import present
from fovden.camera import Gaze, StereoCamera
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp, Warp, warp_at_budget
from fovden.results import Measurement, Run
from fovden.tracer import Scene

__all__ = ["Settings", "main"]

SCREEN, SHUFFLED = "Screen, by rows", "Screen, shuffled"

Rays = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class Settings:
    """What is measured.

    Attributes:
        scenes: Names of scenes.
        resolution: Height and width of each eye's image.
        mean_cells: Cells for each pixel of the screen.
        rounds: How often all orders are timed, in turn.

    Example:
        >>> Settings().resolution
        (1080, 960)
    """

    scenes: tuple[str, ...] = ("sponza", "pink_room", "forest")
    resolution: tuple[int, int] = (1080, 960)
    mean_cells: float = 0.4
    rounds: int = 5


def orders(camera: StereoCamera, mean_cells: float) -> dict[str, tuple[Warp, Tensor]]:
    """Returns the raster of each order, and the numbers of the cells that both eyes read, in that order."""
    gaze = Gaze.center(camera)
    screen = ScreenWarp(gaze, camera.resolution, camera.resolution)
    whole = torch.arange(screen.cell_count)
    shuffled = torch.randperm(len(whole), generator=torch.Generator().manual_seed(0))
    found: dict[str, tuple[Warp, Tensor]] = {SCREEN: (screen, whole), SHUFFLED: (screen, shuffled)}
    for name, kind in (("Smaller image", ScreenWarp), ("Log-polar", LogPolarWarp), ("Visual-polar", VisualPolarWarp)):
        warp = warp_at_budget(kind.for_camera(camera, gaze), mean_cells)
        places = torch.arange(warp.read[0].numel()).view(warp.resolution)
        for order, numbers in (("rows", places), ("columns", places.T)):
            chosen = numbers.flatten()
            found[f"{name}, by {order}"] = warp, chosen[warp.read.all(0).flatten()[chosen]]
    return found


def camera_rays(camera: StereoCamera, warp: Warp, numbers: Tensor) -> Rays:
    """Returns the rays of both eyes' cells in an order, one eye after the other."""
    origins, directions = warp.cell_to_ray(camera)
    return tuple(each[:, numbers].reshape(-1, 3).contiguous() for each in (origins, directions))  # type: ignore[return-value]


def measure(scene: Scene, camera: StereoCamera, settings: Settings, record: Run, name: str) -> None:
    """Times all orders in turn."""
    rays = {order: camera_rays(camera, *cells) for order, cells in orders(camera, settings.mean_cells).items()}
    bounces = {order: bounce_rays(scene, *each, torch.Generator().manual_seed(1)) for order, each in rays.items()}
    kinds = {"camera": rays, "bounce": bounces}
    for number in range(settings.rounds):
        for kind, sets in kinds.items():
            for order, each in sets.items():
                seconds, _ = timed(partial(scene.intersect, *each), clock=time.thread_time)
                rate = len(each[0]) / seconds
                record.measurements.append(Measurement(name, number, "", order, kind, "rays_per_second", rate))


def run(settings: Settings, folder: Path) -> None:
    """Measures all scenes on one thread, and prints the rates of the first round."""
    with Run(folder, settings) as record:
        for name in settings.scenes:
            data = frame_set(name, "test", resolution=settings.resolution, reference_spp=None)
            scene, camera, _ = data.sequence[0]
            with record.stage(name):
                measure(scene, camera, settings, record, name)
    for row in record.measurements:
        if row.frame == 0:
            print(f"{row.scene:10} {row.method:26} {row.region:7} {row.value / 1e6:6.2f} million rays a second")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    presets: dict[str, Callable[[], Settings]] = {
        "smoke": lambda: Settings(("atrium",), (64, 64), rounds=1),
        "full": lambda: Settings(present(Settings.scenes)),
    }
    return run_script("ray_order", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    sys.exit(main())
