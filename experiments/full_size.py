"""Do widths that were fitted on images of half the size serve at full size, and what does a frame cost there?

    python -m experiments.full_size --preset full

Takes the filters of ``tune_sigmas.py``, by hand and fitted (seed 0), to one test pose of each scene, two eyes of
960 x 1080 pixels, and takes the time of tracing and filtering both. Base filters frames whose every pixel was traced,
NH3LD foveated ones. The left eye's image is judged: a reference of a million pixels takes some ten minutes an eye.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from experiments.frame_sets import SCENES, SEEDS, frame_set
from experiments.harness import run_script, timed
from experiments.tune_sigmas import JUDGED, LIGHTS, METHODS, VARIANTS, present, say, table, unfitted
from fovden import metrics
from fovden.comparison.methods import file_name
from fovden.filters import Denoiser
from fovden.foveation import Gaze, ThreeLayer, sample_map
from fovden.frame import Frame, Reference
from fovden.results import Measurement, Run, read_config
from fovden.tracer import Instant, accumulate_reference, trace_frame
from fovden.tuning import load_parameters

__all__ = ["Settings", "main"]


@dataclass(frozen=True)
class Settings:
    """What is judged.

    Attributes:
        fits: Folder that ``tune_sigmas.py`` has filled.
        lights: Which of its halves.
        scenes: Names of scenes.
        resolution: Height and width of each eye's image.
        reference_spp: Samples per pixel of the references.
        spp: Samples in each traced pixel.
        repeats: How often a time is taken; the median counts.
        references: Folder of the references; ``None`` for one beside the results.

    Example:
        >>> Settings(Path("fits")).resolution
        (1080, 960)
    """

    fits: Path
    lights: tuple[str, ...] = tuple(LIGHTS)
    scenes: tuple[str, ...] = SCENES
    resolution: tuple[int, int] = (1080, 960)
    reference_spp: int = 1024
    spp: int = 4
    repeats: int = 3
    references: str | None = None


@dataclass(frozen=True)
class Pose:
    """A pose's frames by the filter's name, the seconds that tracing them took, and the left eye's reference."""

    frames: dict[str, Frame]
    seconds: dict[str, float]
    truth: Reference


def traced(scene: str, settings: Settings, folder: Path) -> Pose:
    """Traces the first pose of the test, with every pixel and foveated, and its reference."""
    say(f"{scene}: frames and reference")
    truth = reference_of(scene, settings, folder)
    world, camera, _ = posed(scene, settings)
    foveated = sample_map(ThreeLayer(), camera, Gaze.center(camera), settings.spp, SEEDS["test"])
    frames, seconds = {}, {}
    for name, samples in (("Base", settings.spp), ("NH3LD", foveated)):
        trace_frame(world, camera.at(resolution=(16, 16)), 1)  # compiles
        seconds[name], frames[name] = timed(
            lambda samples=samples: trace_frame(world, camera, samples, seed=SEEDS["test"]), settings.repeats
        )
    return Pose(frames, seconds, truth)


def posed(scene: str, settings: Settings) -> Instant:
    """Returns the first pose of the test."""
    return frame_set(scene, "test", resolution=settings.resolution, reference_spp=None).sequence[0]


def reference_of(scene: str, settings: Settings, folder: Path) -> Reference:
    """Returns the left eye's reference, out of the folder if it is there; what was interrupted there goes on."""
    world, camera, _ = posed(scene, settings)
    checkpoint = folder / f"{scene}.safetensors"
    left = camera.views.view(0)
    return accumulate_reference(world, left, spp=settings.reference_spp, seed=SEEDS["test"], checkpoint=checkpoint)


def filters(settings: Settings, light: str, scene: str) -> dict[str, Denoiser]:
    """Returns the filters by hand, and those that were fitted on the scene, of which some may be missing."""
    folder = settings.fits / light
    hand = json.loads((folder / "by_hand.json").read_text(encoding="utf-8"))
    rows: dict[str, Denoiser] = {f"{name}, by hand": unfitted(name, "sigmas", hand, light, 0) for name in METHODS}
    for name, variant in itertools.product(METHODS, VARIANTS):
        row = f"{name}, {variant} of {scene}, seed 0"
        parameters = folder / "fits" / file_name(row) / "parameters.safetensors"
        if parameters.exists():
            rows[row] = unfitted(name, variant, hand, light, 0)
            load_parameters(rows[row], parameters)
    return rows


def judge(pose: Pose, rows: dict[str, Denoiser], scene: str, repeats: int) -> list[Measurement]:
    """Returns scores and seconds of the filters on a pose."""
    images = {"Noisy, full": pose.frames["Base"].radiance[:1], "Noisy, foveated": pose.frames["NH3LD"].radiance[:1]}
    found = []
    for row, denoiser in rows.items():
        method = row.partition(",")[0]
        with torch.no_grad():
            seconds, denoised = timed(lambda: denoiser(pose.frames[method]), repeats)  # noqa: B023 - called here
        images[row] = denoised.image[:1]
        for metric, value in (("seconds_trace", pose.seconds[method]), ("seconds_denoise", seconds)):
            found.append(Measurement(scene, 0, "", row, "whole", metric, value))
    scores = metrics.compare(images, pose.truth, layer=pose.frames["NH3LD"].layer[:1])
    keys = dict.fromkeys((s.method, s.region, s.metric) for s in scores.scores if s.metric in JUDGED)
    return found + [
        Measurement(scene, 0, "", method, region, metric, scores.value(method, metric, region))
        for method, region, metric in keys
    ]


def run(settings: Settings, folder: Path) -> None:
    """Judges each half."""
    references = Path(settings.references) if settings.references else folder / "references"
    references.mkdir(parents=True, exist_ok=True)
    poses = {scene: traced(scene, settings, references) for scene in settings.scenes}
    for light in settings.lights:
        config: dict[str, Any] = {"light": light}
        config |= {name: read_config(settings.fits / light)[name] for name in ("error", "draws", "steps", "seeds")}
        names = ("scenes", "resolution", "reference_spp", "spp", "repeats")
        with Run(folder / light, config | {name: getattr(settings, name) for name in names}) as results:
            for scene, pose in poses.items():
                say(f"{light}: judge on {scene}")
                results.measurements += judge(pose, filters(settings, light, scene), scene, settings.repeats)
        print(f"\n{light}\n{table(results.measurements)}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    fits = Path(os.environ.get("FOVDEN_FITS", "out/tune_sigmas"))
    presets = {
        "smoke": lambda: Settings(fits / "smoke", tuple(LIGHTS), ("atrium", "forest"), (128, 128), 16, repeats=1),
        "full": lambda: Settings(fits, scenes=present(SCENES), references=os.environ.get("FOVDEN_FULL_REFERENCES")),
    }
    return run_script("full_size", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
