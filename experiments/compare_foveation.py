"""Where should a given number of paths go: a smaller image, a falloff on the screen, or a polar raster?

    python -m experiments.compare_foveation --preset smoke

Every way of :mod:`experiments.foveations` gets the same paths, 0.4 for a pixel in the mean over the screen, one for
each pixel or cell that has any. All have the same filter, five à-trous passes on light without albedo: once with the
widths that it comes with, once with widths (and for polar rasters the blur) that are fitted to the way's own frames of
the training poses, with the same number of steps for all. They are judged on test poses, with the gaze in the centre
and at two places beside it: all pixels alike, within the circles of the three layers, and weighted by acuity.

Then budgets are swept, so that ways can be compared at equal time too; and converged light is shown through each way
with fewer and fewer cells, so that what is lost by sampling is seen apart from noise. A run that was interrupted goes
on with the scene in which it was.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from experiments.foveations import FOVEATIONS, Foveation
from experiments.frame_sets import frame_set
from experiments.harness import run_script, timed
from experiments.tune_sigmas import present, say
from fovden import color, metrics
from fovden.camera import Gaze, StereoCamera
from fovden.comparison.methods import file_name
from fovden.figures import contact_sheet, draw_foveations, draw_sample_maps
from fovden.filters import Denoiser, WarpedDenoiser, fill_holes
from fovden.foveation import ThreeLayer
from fovden.frame import Frame, Reference
from fovden.io import atomic_write
from fovden.results import Measurement, Run
from fovden.tracer import Scene, trace_frame, trace_gbuffer
from fovden.tuning import ImageError, fit

__all__ = ["Settings", "main"]

JUDGED = ("rmse", "psnr", "ssim", "flip")
SEEDS = {"train": 100, "test": 200}

processor_time = partial(timed, clock=time.thread_time)


@dataclass(frozen=True)
class Settings:
    """What is compared.

    Attributes:
        scenes: Names of scenes.
        resolution: Height and width of each eye's image.
        reference_spp: Samples per pixel of the references of the test.
        training_spp: The same for the references that are learned from.
        mean_spp: Paths per pixel of the screen.
        budgets: The same for the sweep.
        shares: Cells per pixel at which converged light is shown.
        gazes: Where both eyes look, in widths and heights of the image.
        steps: Steps of each fit.
        learning_rate: Of Adam, for logarithms.
        error: Terms of the error that is made small.
        poses: Poses of each set at most.
        repeats: How often a time is taken; the median counts.
        references: Folder of the references; ``None`` for one beside the results.

    Example:
        >>> Settings().mean_spp
        0.4
    """

    scenes: tuple[str, ...] = ("sponza", "pink_room", "forest")
    resolution: tuple[int, int] = (540, 480)
    reference_spp: int = 512
    training_spp: int = 256
    mean_spp: float = 0.4
    budgets: tuple[float, ...] = (0.2, 0.3, 0.4, 0.6, 0.8)
    shares: tuple[float, ...] = (0.6, 0.5, 0.39, 0.3, 0.2)
    gazes: tuple[tuple[float, float], ...] = ((0.5, 0.5), (0.2, 0.35), (0.85, 0.8))
    steps: int = 30
    learning_rate: float = 0.1
    error: Mapping[str, float] = field(default_factory=lambda: {"l1": 1.0, "l2": 2.0})
    poses: int = 3
    repeats: int = 3
    references: str | None = None


class View(NamedTuple):
    """A pose and a gaze, what is there, and its number."""

    number: int
    scene: Scene
    camera: StereoCamera
    gaze: Gaze
    truth: Reference


def views_of(scene: str, name: str, settings: Settings, folder: Path) -> list[View]:
    """Returns the views of a set: every pose with every gaze."""
    spp = settings.training_spp if name == "train" else settings.reference_spp
    data = frame_set(
        scene, name, resolution=settings.resolution, spp=1, falloff=None, reference_spp=spp, folder=folder
    )  # fmt: skip
    found = []
    height, width = settings.resolution
    for pose in range(min(settings.poses, len(data.sequence))):
        world, camera, _ = data.sequence[pose]
        _, truth = data[pose]
        if truth is None:
            raise ValueError(f"{scene}: no reference")
        for x, y in settings.gazes:
            gaze = Gaze(torch.tensor([[x * width, y * height]] * camera.views.view_count))
            found.append(View(len(found), world, camera, gaze, truth))
    return found


def frames_of(way: Foveation, views: Sequence[View], mean_spp: float, seed: int) -> Iterator[Frame]:
    """Traces a frame of each view."""
    for view in views:
        yield traced(way, view, mean_spp, seed)


def traced(way: Foveation, view: View, mean_spp: float, seed: int) -> Frame:
    """Traces a frame with one path in each pixel or cell that has any."""
    samples = way.samples(view.camera, view.gaze, mean_spp, seed + view.number)
    return trace_frame(view.scene, view.camera, samples, seed=seed + view.number)


def fitted(way: Foveation, views: Sequence[View], settings: Settings, folder: Path) -> Denoiser:
    """Returns the way's filter with widths fitted to its frames of the training views."""
    denoiser = way.denoiser(views[0].camera, learn=True)
    frames = frames_of(way, views, settings.mean_spp, SEEDS["train"])
    pairs = [(frame, view.truth) for frame, view in zip(frames, views, strict=True)]
    fit(
        denoiser, pairs, ImageError(settings.error), steps=settings.steps, learning_rate=settings.learning_rate,
        folder=folder,
    )  # fmt: skip
    return denoiser.eval()


def judge(view: View, images: Mapping[str, Tensor], scene: str) -> list[Measurement]:
    """Returns the scores of images of a view: all pixels alike, by the circles of three layers, and by acuity."""
    layer = ThreeLayer()(view.camera.views, view.gaze).layer
    weights = {"acuity": metrics.acuity_weight(view.camera, view.gaze)}
    found = metrics.compare(images, view.truth, layer, weights=weights)
    keys = dict.fromkeys((s.method, s.region, s.metric) for s in found.scores if s.metric in JUDGED)
    rows = [
        Measurement(scene, view.number, "", method, region, metric, found.value(method, metric, region))
        for method, region, metric in keys
    ]
    for method, image in images.items():
        try:
            jod = metrics.fovvideovdp(image, view.truth.mean, view.camera, view.gaze)
        except ImportError:
            break
        rows.append(Measurement(scene, view.number, "", method, "whole", "fovvideovdp", float(jod.mean())))
    return rows


def errors(view: View, image: Tensor) -> dict[str, float]:
    """Returns RMSE of what a display shows, all pixels alike and weighted by acuity."""
    exposure = color.exposure(view.truth.mean)
    shown, truth = color.display(image, exposure), color.display(view.truth.mean, exposure)
    weight = metrics.acuity_weight(view.camera, view.gaze)
    return {
        "whole": float(metrics.rmse(shown, truth).mean()),
        "acuity": float(metrics.rmse(shown, truth, weight).mean()),
    }


def compare(scene: str, settings: Settings, references: Path, folder: Path) -> list[Measurement]:
    """Fits, judges and sweeps all ways in a scene."""
    say(f"{scene}: references")
    training, test = (views_of(scene, name, settings, references) for name in ("train", "test"))
    filters: dict[str, dict[str, Denoiser]] = {}
    for name, way in FOVEATIONS.items():
        say(f"{scene}: fit {name}")
        tuned = fitted(way, training, settings, folder / file_name(f"{scene} {name}"))
        filters[name] = {"untuned": way.denoiser(test[0].camera).eval(), "tuned": tuned}
    found: list[Measurement] = []
    for view in test:
        say(f"{scene}: judge view {view.number}")
        images: dict[str, Tensor] = {}
        for name, way in FOVEATIONS.items():
            costs, frame = cost_of(way, view, settings)
            for variant, denoiser in filters[name].items():
                more, images[f"{name}, {variant}"] = denoised(denoiser, frame, settings.repeats)
            costs |= more
            found += [
                Measurement(scene, view.number, "", f"{name}, tuned", "whole", metric, value)
                for metric, value in costs.items()
            ]
        if view.number == 1:
            draw(view, images, settings, folder.parent, scene)
        found += judge(view, images, scene)
        found += swept(view, filters, scene, settings)
        found += sampled(view, scene, settings)
    return found


def draw(view: View, images: Mapping[str, Tensor], settings: Settings, folder: Path, scene: str) -> None:
    """Draws the left eye's images of a view, and how many paths each way has at each eccentricity."""
    shown = {name: images[f"{name}, tuned"] for name in FOVEATIONS} | {"Reference": view.truth.mean}
    contact_sheet({name: image[:1] for name, image in shown.items()}, columns=4).save(folder / f"{scene}.png")
    chosen = {name: way for name, way in FOVEATIONS.items() if way.sized and name != "Smaller image"}
    maps = {name: way.samples(view.camera, view.gaze, settings.mean_spp) for name, way in chosen.items()}
    draw_sample_maps(maps, folder / "densities.png", camera=view.camera)


def denoised(denoiser: Denoiser, frame: Frame, repeats: int) -> tuple[dict[str, float], Tensor]:
    """Returns the seconds that the filter and the way to the screen take, and the image."""
    with torch.no_grad():
        seconds, outcome = processor_time(lambda: denoiser(frame), repeats)
        inner = seconds
        if isinstance(denoiser, WarpedDenoiser):
            inner, _ = processor_time(lambda: denoiser.inner(frame), repeats)
    return {"seconds_denoise": inner, "seconds_map": max(0.0, seconds - inner)}, outcome.image


def cost_of(way: Foveation, view: View, settings: Settings) -> tuple[dict[str, float], Frame]:
    """Returns rays, paths and the seconds that they take in the order of a raster, and a frame."""
    seconds_raster, warp = processor_time(lambda: way.raster(view.camera, view.gaze, settings.mean_spp))
    seconds_gbuffer, gbuffer = processor_time(
        lambda: trace_gbuffer(view.scene, view.camera, warp=warp), settings.repeats
    )
    seconds, frame = processor_time(lambda: traced(way, view, settings.mean_spp, SEEDS["test"]), settings.repeats)
    return {
        "rays": float(gbuffer.prim.numel() if warp is None else warp.view_count * warp.cell_count),
        "paths": float(frame.counts.sum()),
        "seconds_gbuffer": seconds_gbuffer,
        "seconds_paths": max(0.0, seconds - seconds_gbuffer - seconds_raster),
    }, frame


def swept(
    view: View, filters: Mapping[str, Mapping[str, Denoiser]], scene: str, settings: Settings
) -> list[Measurement]:
    """Returns error and time of every way at every budget, with the widths that were fitted at one."""
    found = []
    for name, way in FOVEATIONS.items():
        for budget in settings.budgets if way.sized else ():
            seconds_raster, _ = processor_time(partial(way.raster, view.camera, view.gaze, budget))
            seconds, frame = processor_time(partial(traced, way, view, budget, SEEDS["test"]))
            more, image = denoised(filters[name]["tuned"], frame, 1)
            row = f"{name}, tuned, {budget:g} paths"
            values: dict[tuple[str, str], float] = {("whole", "seconds"): seconds - seconds_raster + sum(more.values())}
            values |= {(region, "rmse"): value for region, value in errors(view, image).items()}
            found += [
                Measurement(scene, view.number, "", row, region, metric, value)
                for (region, metric), value in values.items()
            ]
    return found


def sampled(view: View, scene: str, settings: Settings) -> list[Measurement]:
    """Returns the errors of converged light that is seen through fewer cells, without any noise or filter."""
    found = []
    truth = view.truth.mean
    for name, way in FOVEATIONS.items():
        for share in settings.shares if way.sized else ():
            warp = way.raster(view.camera, view.gaze, share)
            if warp is not None:
                image = warp.to_screen(warp.from_screen(truth), warp.read.float())
            else:
                mask = way.samples(view.camera, view.gaze, share, SEEDS["test"]).mask.expand_as(truth[:, :1])
                flat = torch.zeros_like(truth)
                image = fill_holes(truth * mask, mask == 0, mask, flat, flat, sigma_normal=1.0, sigma_position=1.0)
            row = f"{name}, converged, {share:g} cells"
            found += [
                Measurement(scene, view.number, "", row, region, "rmse", value)
                for region, value in errors(view, image).items()
            ]
    return found


def kept(path: Path, find: Callable[[], list[Measurement]]) -> list[Measurement]:
    """Returns what a run has found before, from its file; else finds it, and writes that."""
    if not path.exists():
        found = find()
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(found), encoding="utf-8")
    return [Measurement(*row) for row in json.loads(path.read_text(encoding="utf-8"))]


def table(measurements: Sequence[Measurement]) -> str:
    """Returns the means over the views: error by variant and region, and seconds."""
    names = dict.fromkeys((row.scene, row.method.rpartition(",")[0]) for row in measurements if row.metric == "flip")
    columns = [(v, r, m) for v in ("untuned", "tuned") for r, m in (("whole", "rmse"), ("acuity", "rmse"))]
    columns += [("tuned", "acuity", "ssim"), ("tuned", "acuity", "flip")]
    columns += [("tuned", "whole", f"seconds_{each}") for each in ("gbuffer", "paths", "denoise", "map")]
    values: dict[tuple[str, str, str, str], list[float]] = {}
    for row in measurements:
        values.setdefault((row.scene, row.method, row.region, row.metric), []).append(row.value)
    lines = ["scene      way                  " + "  ".join(f"{v[:3]} {r[:3]} {m[-7:]}" for v, r, m in columns)]
    for scene, name in names:
        cells = [statistics.fmean(values[scene, f"{name}, {v}", r, m]) for v, r, m in columns]
        lines.append(f"{scene:10} {name:20} " + "  ".join(f"{cell:15.4f}" for cell in cells))
    return "\n".join(lines)


def run(settings: Settings, folder: Path) -> None:
    """Compares all ways in all scenes."""
    references = Path(settings.references) if settings.references else folder / "references"
    references.mkdir(parents=True, exist_ok=True)
    config: dict[str, Any] = {name: value for name, value in asdict(settings).items() if name != "references"}
    with Run(folder, config) as results:
        for scene in settings.scenes:
            with results.stage(scene):
                find = partial(compare, scene, settings, references, folder / "fits")
                results.measurements += kept(folder / f"{scene}.json", find)
    print(f"{table(results.measurements)}\nfigure: {draw_foveations(folder)}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    presets: dict[str, Callable[[], Settings]] = {
        "smoke": lambda: Settings(
            ("atrium",), (64, 64), 8, budgets=(0.4, 0.8), shares=(0.4,), steps=2, poses=1, repeats=1,
            gazes=((0.5, 0.5), (0.2, 0.3)),
        ),
        "full": lambda: Settings(present(Settings.scenes), references=os.environ.get("FOVDEN_REFERENCES")),
    }  # fmt: skip
    return run_script("compare_foveation", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
