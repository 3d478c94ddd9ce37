"""What do learned widths gain over ones set by hand, and do they carry over to other scenes?

    python -m experiments.tune_sigmas --preset smoke

Base filters frames whose every pixel was traced, NH3LD foveated ones. By hand means one set of widths for all scenes,
found by a coarse grid for Base on the training frames of the first scene, before anything else is fitted or judged.
Each filter is then fitted on the training frames of each scene, with several seeds, and judged on test frames: of that
scene, and of the others. Poses and noise of training, held-out and test frames are disjoint.

Learned are the widths of each layer (``sigmas``), those of each pass and its kernel (``passes``), or, on from those, a
small network that scales them at each pixel (``predicted``).

All of it is done twice, with the filters on radiance as it is (``literal``) and on light without albedo
(``demodulated``); the two have folders, widths by hand and tables of their own. A run that was interrupted goes on; the
presets ``literal`` and ``demodulated`` are the halves of ``full``, and may run side by side.
"""

from __future__ import annotations

import itertools
import json
import os
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from experiments.compare_denoisers import sponza
from experiments.frame_sets import SCENES, frame_set
from experiments.harness import run_script
from fovden import metrics
from fovden.comparison.methods import file_name
from fovden.figures import draw_fitted, scores_of_fits
from fovden.filters import Denoiser, NonHomogeneousAtrous, PredictedSigmas
from fovden.foveation import ThreeLayer
from fovden.frame import Frame, Reference
from fovden.io import atomic_write
from fovden.results import Measurement, Run, read_metrics
from fovden.tuning import ImageError, fit, readable

__all__ = ["METHODS", "VARIANTS", "Settings", "cells", "main", "table"]

METHODS: Mapping[str, Callable[..., NonHomogeneousAtrous]] = {
    "Base": NonHomogeneousAtrous.base,
    "NH3LD": NonHomogeneousAtrous.nh3ld,
}
"""The filters, the first on fully traced frames, the second on foveated ones."""

LIGHTS = {"literal": False, "demodulated": True}

VARIANTS = ("sigmas", "passes", "predicted")
"""What is learned. Fits of the last go on from those of ``passes``."""

JUDGED = ("rmse", "psnr", "ssim", "flip")

Pair = tuple[Frame, Reference]
Widths = tuple[float, float, float]


@dataclass(frozen=True)
class Settings:
    """What is tuned, and on what.

    Attributes:
        lights: Which halves: ``"literal"``, ``"demodulated"``.
        scenes: Names of scenes; one whose file is not there is left out.
        resolution: Height and width of each eye's image.
        reference_spp: Samples per pixel of the references.
        draws: Training frames of each pose, with noise of their own, for each seed.
        seeds: Number of fits, each with training frames and an order of its own.
        steps: Steps of a fit.
        learning_rate: Of Adam, for logarithms.
        network_rate: Of Adam, for the weights of the network and all that it scales.
        patience: Evaluations, one in ten steps, without a new best after which a fit stops.
        grid: Values of the widths of radiance, normal and position that are tried by hand.
        error: Terms of the error that the grid and the fits make small.
        references: Folder of the references; ``None`` for one beside the results.

    Example:
        >>> Settings().resolution
        (540, 480)
    """

    lights: tuple[str, ...] = ("literal", "demodulated")
    scenes: tuple[str, ...] = SCENES
    resolution: tuple[int, int] = (540, 480)
    reference_spp: int = 512
    draws: int = 2
    seeds: int = 3
    steps: int = 60
    learning_rate: float = 0.1
    network_rate: float = 0.01
    patience: int = 3
    grid: tuple[tuple[float, ...], ...] = (
        (8, 16, 32, 64, 128),
        (0.0125, 0.025, 0.05, 0.1, 0.2),
        (0.005, 0.01, 0.02, 0.04, 0.08),
    )
    error: Mapping[str, float] = field(default_factory=lambda: {"l1": 1.0, "l2": 2.0})
    references: str | None = None


class Frames:
    """The frames of the study, traced when first asked for and kept."""

    def __init__(self, settings: Settings, folder: Path) -> None:
        self.settings = settings
        self.folder = Path(settings.references) if settings.references else folder / "references"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.kept: dict[tuple[str, str, str, int], list[Pair]] = {}

    def __call__(self, scene: str, name: str, method: str, seed: int = 0) -> Pairs:
        """Returns the frames of a set for a method; those of the training differ from seed to seed."""
        draws = self.settings.draws if name == "train" else 1
        data = frame_set(
            scene, name, resolution=self.settings.resolution, falloff=ThreeLayer() if method == "NH3LD" else None,
            draws=(seed + 1) * draws, reference_spp=self.settings.reference_spp, folder=self.folder,
        )  # fmt: skip
        count = draws * len(data.sequence)

        def make() -> list[Pair]:
            key = (scene, name, method, seed)
            if key not in self.kept:
                say(f"{scene}: {count} frames of {name} for {method}, seed {seed}")
                items = (data[index] for index in range(seed * count, len(data)))
                self.kept[key] = [(frame, reference) for frame, reference in items if reference is not None]
            return self.kept[key]

        return Pairs(count, make)

    def forget(self, name: str) -> None:
        """Frees the memory of a set."""
        self.kept = {key: pairs for key, pairs in self.kept.items() if key[1] != name}


class Pairs(Sequence[Pair]):
    """Frames and references that are made when one of them is asked for."""

    def __init__(self, count: int, make: Callable[[], list[Pair]]) -> None:
        self.count, self.make = count, make

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: Any) -> Any:
        return self.make()[index]


def by_hand(settings: Settings, frames: Frames, scene: str, demodulate: bool) -> Widths:
    """Returns the widths of least error for Base on the training frames of a scene, among those of a grid."""
    error, pairs = ImageError(settings.error), frames(scene, "train", "Base")
    best, least = (0.0, 0.0, 0.0), float("inf")
    for widths in itertools.product(*settings.grid):
        denoiser = METHODS["Base"](**named(widths), demodulate=demodulate)
        with torch.no_grad():
            losses = [float(error(denoiser(frame).image, truth.mean, frame)) for frame, truth in pairs]
        if (loss := statistics.mean(losses)) < least:
            best, least = (widths[0], widths[1], widths[2]), loss
    say(f"{scene}: by hand, {named(best)}, error {least:.5f}")
    return best


def named(widths: Sequence[float]) -> dict[str, float]:
    """Returns widths as keywords of the filters."""
    return dict(zip(("sigma_radiance", "sigma_normal", "sigma_position"), widths, strict=True))


def study(settings: Settings, light: str, folder: Path, frames: Frames) -> None:
    """Finds widths by hand, fits, judges, and prints the table of one kind of light."""
    kept = {name: value for name, value in asdict(settings).items() if name not in ("lights", "references")}
    with Run(folder / light, {**kept, "light": light}) as run:
        with run.stage("grid"):
            hand = kept_by_hand(settings, frames, light, run.folder / "by_hand.json")
        rows: dict[str, Denoiser] = {
            f"{name}, by hand": METHODS[name](**hand, demodulate=LIGHTS[light]) for name in METHODS
        }
        with run.stage("fit"):
            for scene in settings.scenes:
                for name, seed, variant in itertools.product(METHODS, range(settings.seeds), VARIANTS):
                    row = f"{name}, {variant} of {scene}, seed {seed}"
                    say(f"{light}: {row}")
                    rows[row] = unfitted(name, variant, hand, light, seed)
                    if predicted := isinstance(rows[row], PredictedSigmas):
                        rows[row].inner.load_state_dict(rows[f"{name}, passes of {scene}, seed {seed}"].state_dict())
                    fit(
                        rows[row],
                        frames(scene, "train", name, seed),
                        ImageError(settings.error),
                        held_out=frames(scene, "held_out", name),
                        steps=settings.steps,
                        learning_rate=settings.network_rate if predicted else settings.learning_rate,
                        patience=settings.patience,
                        seed=seed,
                        folder=run.folder / "fits" / file_name(row),
                    )
                frames.forget("train")
        for row, denoiser in rows.items():
            filters = denoiser.inner if isinstance(denoiser, PredictedSigmas) else denoiser
            run.measurements += [
                Measurement("", 0, "", row, "whole", name, value) for name, value in readable(filters).items()
            ]
        with run.stage("judge"):
            for scene in settings.scenes:
                run.measurements += judge(frames, scene, rows)
    print(f"\n{light}\n{table(read_metrics(run.folder))}\nfigure: {draw_fitted(run.folder)}")


def unfitted(name: str, variant: str, hand: Mapping[str, float], light: str, seed: int) -> Denoiser:
    """Returns a filter with the widths by hand that has what a variant learns."""
    learned = {} if variant == "sigmas" else {"per_pass": True, "learn_kernel": True}
    filters = METHODS[name](**hand, **learned, demodulate=LIGHTS[light])
    return PredictedSigmas(filters, seed=seed) if variant == "predicted" else filters


def kept_by_hand(settings: Settings, frames: Frames, light: str, path: Path) -> dict[str, float]:
    """Returns the widths by hand, from the file where that is there, which else it writes."""
    if not path.exists():
        hand = by_hand(settings, frames, settings.scenes[0], LIGHTS[light])
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(named(hand)) + "\n", encoding="utf-8")
    widths: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))
    return widths


def judge(frames: Frames, scene: str, rows: Mapping[str, Denoiser]) -> list[Measurement]:
    """Returns the scores of the noisy frames and of the filters on the test frames of a scene, whole and by layer.

    Of what was fitted on other scenes, the first seed is judged. Scores are means over the eyes.
    """
    say(f"judge on {scene}")
    found = []
    rows = {row: each for row, each in rows.items() if " seed " not in row or f" of {scene}," in row or row[-1] == "0"}
    for pose, ((full, truth), (foveated, _)) in enumerate(
        zip(*(frames(scene, "test", n) for n in METHODS), strict=True)
    ):
        images = {"Noisy, full": full.radiance, "Noisy, foveated": foveated.radiance}
        with torch.no_grad():
            images |= {row: rows[row](full if row.startswith("Base") else foveated).image for row in rows}
        comparison = metrics.compare(images, truth, layer=foveated.layer)
        scores = dict.fromkeys((s.method, s.region, s.metric) for s in comparison.scores if s.metric in JUDGED)
        found += [
            Measurement(scene, pose, "", method, region, metric, comparison.value(method, metric, region))
            for method, region, metric in scores
        ]
    return found


def cells(measurements: Sequence[Measurement], metrics: Sequence[str], region: str = "whole") -> list[list[str]]:
    """Returns a line for each scene and method: means, and the standard deviation over seeds or other scenes.

    Example:
        >>> cells([Measurement("atrium", 0, "", "Base, by hand", "whole", "rmse", 0.5)], ["rmse"])
        [['atrium', 'Base, by hand', '0.5000']]
    """
    found, lines = scores_of_fits(measurements, region), []
    for scene, method in dict.fromkeys(key[:2] for key in found):
        line = [scene, method]
        for metric in metrics:
            values, digits = found[scene, method, metric], 2 if metric == "psnr" else 4
            spread = f" ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else ""
            line.append(f"{statistics.mean(values):.{digits}f}{spread}")
        lines.append(line)
    return lines


def table(measurements: Sequence[Measurement], metrics: Sequence[str] = JUDGED) -> str:
    """Returns the lines of :func:`cells` as text.

    Example:
        >>> print(table([Measurement("atrium", 0, "", "Base, by hand", "whole", "rmse", 0.5)], ["rmse"]))
        scene   method         rmse
        atrium  Base, by hand  0.5000
    """
    lines = [["scene", "method", *metrics], *cells(measurements, metrics)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    padded = ("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)
    return "\n".join(line.rstrip() for line in padded)


def say(line: str) -> None:
    """Says on standard error what is being done."""
    sys.stderr.write(line + "\n")


def run(settings: Settings, folder: Path) -> None:
    """Does the study with each kind of light."""
    frames = Frames(settings, folder)
    for light in settings.lights:
        study(settings, light, folder, frames)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""

    def half(*lights: str) -> Callable[[], Settings]:
        return lambda: Settings(lights, present(SCENES), references=os.environ.get("FOVDEN_REFERENCES"))

    presets: dict[str, Callable[[], Settings]] = {
        "smoke": lambda: Settings(
            tuple(LIGHTS), ("atrium", "forest"), (64, 64), 16, draws=1, seeds=2, steps=3, grid=((4, 8), (0.1,), (0.03,))
        ),
        "full": half(*LIGHTS),
        **{light: half(light) for light in LIGHTS},
    }
    return run_script("tune_sigmas", str(__doc__), presets, run, arguments)


def present(scenes: Sequence[str]) -> tuple[str, ...]:
    """Returns the scenes without those whose files are not there."""
    there = Path(sponza().view.scene).is_file()
    if not there:
        say("sponza is left out: set FOVDEN_SCENES to the folder of real scenes")
    return tuple(scene for scene in scenes if there or scene != "sponza")


if __name__ == "__main__":
    sys.exit(main())
