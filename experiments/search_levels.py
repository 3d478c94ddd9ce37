"""How many passes, how large the layers, how many paths: what is the least error for a given time?

    python -m experiments.search_levels --preset smoke

A setting is M <= N <= P passes of three layers, their radii r0 and r1, the share p of the outer pixels that are left
out, the samples of each traced pixel, and one number for the widths of normal and position, which costs no time: few
passes and few samples want wider ones. Optuna searches the front of time against error twice, with all pixels alike
and weighted by acuity (:class:`experiments.foveated_frames.Pose`); settings drawn at random, and all numbers of passes
at the paper's foveation, are the check that the front is one. Equal numbers of passes are allowed: whether a further
layer needs more of them is a part of the question.

The time of a trial is that of the work which was done for it, by costs of a unit that are measured first
(:mod:`experiments.frame_costs`), and compared with the clock for some settings. The fronts are then judged on other
poses with other noise, with the widths that all trials share, and some of them with widths fitted to them.

A run that was interrupted goes on from its costs and trials; frames are traced again.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from experiments.foveated_frames import Pose, geometric_mean
from experiments.frame_costs import UnitCosts, WatchedAtrous, Work, measure_costs, timed, unlit
from experiments.frame_sets import frame_set
from experiments.harness import run_script
from experiments.level_choices import BASE, NH2LD, NH3LD, Choice, choice_of, drawn, grid, setting_of, space
from experiments.tune_sigmas import present, say
from fovden import metrics
from fovden.figures import draw_front
from fovden.foveation import sample_map
from fovden.io import atomic_write
from fovden.results import Measurement, Run
from fovden.tracer import trace_frame
from fovden.tuning import ImageError, Trial, fit, pareto_front, search

__all__ = ["ERRORS", "Settings", "main"]

ERRORS = {"error": "search", "error_acuity": "search, acuity"}
"""The errors, and the search that makes each small."""

SCORES = ("rmse", "psnr", "ssim", "flip")

CHECKED = (
    *(BASE, NH3LD, BASE._replace(spp=1), Choice((2, 2, 2), 1, 2, 0.5, 2, 3)),
    *(Choice((1, 1, 2), 0.5, 1.5, 0.8, 1, 1), Choice((2, 4, 6), 2, 3, 0.3, 2, 2)),
)
"""Settings for which predicted times are compared with the clock's, and images with those of traced frames."""


@dataclass(frozen=True)
class Settings:
    """What is searched, and how long.

    Attributes:
        scenes: Names of scenes; one whose file is not there is left out.
        resolution: Height and width of each eye's image.
        reference_spp: Samples per pixel of the references.
        poses: Training poses of each scene.
        draws: Frames of each test pose, with noise of their own.
        most_passes: Largest number of passes.
        most_spp: Most samples per traced pixel.
        trials: Trials of each of both searches.
        random: Settings drawn at random.
        wides: Widths of the grid of all numbers of passes, see ``Choice``; the paper's filters get those between, too.
        rounds: Rounds in which costs are measured, for each scene.
        judged: Settings of each front that are judged on test frames.
        fitted: Settings of the first front to which widths are fitted.
        steps: Steps of such a fit.
        l2: Weight of the mean squared error.
        ssim: Weight of 1 - SSIM.
        sigmas: Widths of radiance, normal and position, the narrowest that are tried.
        demodulate: Whether light without albedo is filtered.
        references: Folder of the references; ``None`` for one beside the results.

    Example:
        >>> Settings().most_passes
        6
    """

    scenes: tuple[str, ...] = ("sponza", "atrium")
    resolution: tuple[int, int] = (540, 480)
    reference_spp: int = 512
    poses: int = 2
    draws: int = 1
    most_passes: int = 6
    most_spp: int = 8
    trials: int = 160
    random: int = 60
    wides: tuple[float, ...] = (1, 2, 3, 4)
    rounds: int = 6
    judged: int = 7
    fitted: int = 3
    steps: int = 30
    l2: float = 5.0
    ssim: float = 0.05
    sigmas: tuple[float, float, float] = (32.0, 0.025, 0.01)
    demodulate: bool = True
    references: str | None = None

    def denoiser(self, choice: Choice) -> WatchedAtrous:
        """Returns the denoiser of a choice.

        Example:
            >>> Settings().denoiser(NH3LD).levels
            (3, 4, 5)
        """
        return choice.denoiser(self.sigmas, demodulate=self.demodulate)


class Trials:
    """Tries settings on the training frames."""

    def __init__(self, settings: Settings, poses: Mapping[str, Sequence[Pose]], costs: Mapping[str, UnitCosts]) -> None:
        self.settings, self.poses, self.costs = settings, poses, costs
        self.space = space(settings.most_passes, settings.most_spp)

    def outcome(self, choice: Choice) -> dict[str, dict[str, float]]:
        """Returns seconds and errors for each scene: of its poses' mean work, and geometric means."""
        denoiser = self.settings.denoiser(choice)
        found = {}
        for scene, poses in self.poses.items():
            works, errors = [], []
            for pose in poses:
                image, work = pose.denoised(choice, denoiser)
                works.append(work)
                errors.append(pose.errors(image, self.settings.l2, self.settings.ssim))
            work, costs = Work.mean(works), self.costs[scene]
            error, acuity = (geometric_mean(list(each)) for each in zip(*errors, strict=True))
            seconds = {"seconds": costs.total(work), "seconds_passes": costs.passes(work)}
            found[scene] = {**seconds, "filling": work.filling, "error": error, "error_acuity": acuity}
        return found

    def run(self, name: str, folder: Path, count: int, error: str = "error", **options: Any) -> list[Trial]:
        """Searches, or tries the first settings alone; trials have their outcome as notes."""

        def evaluate(setting: Mapping[str, Any]) -> tuple[float, float, dict[str, Any]]:
            found = self.outcome(choice_of(setting))
            cost = sum(each["seconds"] for each in found.values()) / len(found)
            return cost, geometric_mean([each[error] for each in found.values()]), found

        say(f"{name}: {count} trials")
        return search(evaluate, self.space, trials=count, folder=folder / "trials" / name, **options)


def measured_costs(settings: Settings, poses: Mapping[str, Sequence[Pose]], path: Path) -> list[Measurement]:
    """Returns costs and checks of each scene, from the file where that is there, which else it writes.

    A check compares, for some settings, the predicted seconds with those of the clock in the same rounds, and the image
    of a frame that was thinned with that of one that was traced.
    """
    if not path.exists():
        few, many = (settings.denoiser(NH3LD._replace(levels=(passes,) * 3)) for passes in (1, 6))
        units: dict[str, list[UnitCosts]] = {scene: [] for scene in poses}
        checks: dict[tuple[str, Choice], list[tuple[float, Work, float]]] = {}
        for number, (scene, own) in itertools.product(range(settings.rounds + 1), poses.items()):
            say(f"{scene}: costs, round {number}")
            pose = own[number % len(own)]
            place = pose.instant[:2]
            paper = sample_map(NH3LD.falloff(settings.resolution), place[1], pose.gaze, NH3LD.spp)
            unit = measure_costs(*place, paper, few, many)
            found = {(scene, choice): check(settings, pose, choice) for choice in CHECKED}
            if number > 0:  # the first compiles, and builds what is built once
                units[scene].append(unit)
                for key, value in found.items():
                    checks.setdefault(key, []).append(value)
        costs = {scene: UnitCosts.median(each) for scene, each in units.items()}
        rows = [
            Measurement(scene, 0, "", "costs", name, "seconds", value)
            for scene, unit in costs.items()
            for name, value in unit._asdict().items()
        ]
        for (scene, choice), each in checks.items():
            seconds, works, differences = zip(*each, strict=True)
            predicted = statistics.median(costs[scene].total(work) for work in works)
            values = {"seconds": statistics.median(seconds), "predicted": predicted, "difference": max(differences)}
            say(f"{scene}: {choice}: " + ", ".join(f"{name} {value:.4g}" for name, value in values.items()))
            rows += [Measurement(scene, 0, "", "check", str(choice), *value) for value in values.items()]
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return [Measurement(*row) for row in json.loads(path.read_text(encoding="utf-8"))]


def check(settings: Settings, pose: Pose, choice: Choice) -> tuple[float, Work, float]:
    """Returns the clock's seconds of a frame, its work, and how far its image is from that of the thinned frame."""
    denoiser, falloff = settings.denoiser(choice), choice.falloff(settings.resolution)
    scene, camera, _ = pose.instant
    samples = sample_map(falloff, camera, pose.gaze, choice.spp)
    seconds = timed(lambda: trace_frame(scene, camera, samples))
    thinned, work = pose.denoised(choice, denoiser)
    traced = unlit(pose.data(choice.spp, falloff)[pose.index][0])
    with torch.no_grad():
        seconds += timed(lambda: denoiser(traced))
        difference = (denoiser(traced).image - thinned).abs().max() / thinned.mean()
    return seconds, work, float(difference)


def spread(front: Sequence[Trial], count: int) -> list[Trial]:
    """Returns some of a front, at even steps of the logarithm of cost, both ends included.

    Example:
        >>> front = [Trial(number, {}, 2.0**number, -number) for number in range(9)]
        >>> [trial.number for trial in spread(front, 3)]
        [0, 4, 8]
    """
    first, last = math.log(front[0].cost), math.log(front[-1].cost)
    steps = [first + (last - first) * number / max(count - 1, 1) for number in range(count)]
    numbers = {min(range(len(front)), key=lambda n: abs(math.log(front[n].cost) - step)) for step in steps}
    return [front[number] for number in sorted(numbers)]


def judge(
    settings: Settings,
    rows: Mapping[tuple[str, Choice], WatchedAtrous],
    costs: Mapping[str, UnitCosts],
    references: Path,
) -> list[Measurement]:
    """Returns the scores of denoisers by kind and choice, for each scene: means over its test frames and the eyes."""
    found: dict[tuple[str, str, str, str], list[float]] = {}
    for scene in settings.scenes:
        poses = len(frame_set(scene, "test", reference_spp=None).sequence)
        for index in range(settings.draws * poses):
            say(f"{scene}: judge on frame {index}")
            pose = Pose(scene, "test", index, settings.resolution, settings.reference_spp, references)
            for (kind, choice), denoiser in rows.items():
                image, work = pose.denoised(choice, denoiser)
                errors = pose.errors(image, settings.l2, settings.ssim)
                compared = metrics.compare({"": image}, pose.truth)
                values = dict(zip(ERRORS, errors, strict=True)) | {name: compared.value("", name) for name in SCORES}
                values["seconds"] = costs[scene].total(work)
                for name, value in values.items():
                    found.setdefault((scene, kind, str(choice), name), []).append(value)
    return [
        Measurement(scene, len(values), "", kind, choice, name, float(f"{sum(values) / len(values):.5g}"))
        for (scene, kind, choice, name), values in found.items()
    ]


def fitted(settings: Settings, poses: Sequence[Pose], choice: Choice) -> WatchedAtrous:
    """Returns a denoiser whose widths, three for each layer, are fitted to the training frames of all scenes."""
    say(f"fit {choice}")
    denoiser = settings.denoiser(choice)
    pairs = [(pose.foveated(choice), pose.truth) for pose in poses]
    objective = ImageError({"l2": settings.l2, "ssim": settings.ssim})
    fit(denoiser, pairs, objective, steps=settings.steps, learning_rate=0.05, progress=None)
    return denoiser


def rows_of(method: str, choice: Choice, outcome: Mapping[str, Mapping[str, float]], number: int) -> list[Measurement]:
    """Returns the rows of one setting: mean seconds, and the errors on each scene; four digits of each number."""
    timed_ = ("seconds", "seconds_passes") if method not in ("random", *ERRORS.values()) else ("seconds",)
    found = [("", name, sum(own[name] for own in outcome.values()) / len(outcome)) for name in timed_]
    found += [(scene, error, own[error]) for scene, own in outcome.items() for error in ERRORS]
    rows = [(scene, name, float(f"{value:.4g}")) for scene, name, value in found]
    return [Measurement(scene, number, "", method, str(choice), name, value) for scene, name, value in rows]


def study(settings: Settings, folder: Path, record: Run) -> None:
    """Measures costs, searches, and judges the fronts."""
    references = Path(settings.references) if settings.references else folder / "references"
    references.mkdir(parents=True, exist_ok=True)
    with record.stage("frames"):
        poses = {
            scene: [
                Pose(scene, "train", index, settings.resolution, settings.reference_spp, references)
                for index in range(settings.poses)
            ]
            for scene in settings.scenes
        }
    with record.stage("costs"):
        record.measurements += measured_costs(settings, poses, folder / "costs.json")
    costs = {
        scene: UnitCosts(*(row.value for row in record.measurements if (row.scene, row.method) == (scene, "costs")))
        for scene in poses
    }
    trials = Trials(settings, poses, costs)
    papers = [("Base", BASE._replace(spp=2**power)) for power in range(settings.most_spp.bit_length())]
    papers += [("NH2LD", NH2LD), ("NH3LD", NH3LD)]
    named: dict[tuple[str, int], list[Trial]] = {}
    with record.stage("named"):
        for (method, choice), wide in itertools.product(
            papers, sorted({*settings.wides, *(wide - 0.5 for wide in settings.wides)})
        ):
            wider = choice._replace(wide=wide)
            found = trials.outcome(wider)
            record.measurements += rows_of(method, wider, found, 0)
            named.setdefault((method, choice.spp), []).append(Trial(0, {"choice": wider}, 0.0, 0.0, found))
    tried: list[Trial] = []
    plans: dict[str, tuple[list[dict[str, Any]], str]] = {
        "grid": (grid(settings.most_passes, settings.wides), "error"),
        "random": (drawn(trials.space, settings.random), "error"),
        **{name: ([setting_of(NH3LD)], error) for error, name in ERRORS.items()},
    }
    for name, (first, error) in plans.items():
        with record.stage(name):
            count = settings.trials if name in ERRORS.values() else len(first)
            found = trials.run(name, folder, count, error, first=first)
        for trial in found:
            record.measurements += rows_of(name, choice_of(trial.setting), trial.notes, trial.number)
        tried += found
    judged: list[Choice] = []
    for error in ERRORS:
        shown = [named[key] for key in (("Base", 1), ("Base", 4), ("NH2LD", 4), ("NH3LD", 4))]
        best = [min(each, key=lambda t, e=error: mean_error(t, e)).setting["choice"] for each in shown]
        front = pareto_front([trial._replace(error=mean_error(trial, error)) for trial in tried])
        chosen = [choice_of(trial.setting) for trial in spread(front, settings.judged)]
        judged += [*best, *chosen]
        if error == "error":
            fits = [best[-1], *chosen[:: -(-len(chosen) // max(settings.fitted, 1))]]
    rows = {("test", choice): settings.denoiser(choice) for choice in dict.fromkeys(judged)}
    with record.stage("fit"):
        everywhere = [pose for own in poses.values() for pose in own]
        rows |= {("test, fitted", choice): fitted(settings, everywhere, choice) for choice in fits}
    poses.clear()
    with record.stage("judge"):
        record.measurements += judge(settings, rows, costs, references)


def mean_error(trial: Trial, error: str) -> float:
    """Returns one of a trial's errors, the geometric mean over the scenes."""
    return geometric_mean([own[error] for own in trial.notes.values()])


def run(settings: Settings, folder: Path) -> None:
    """Does the study on one thread and draws the figure."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with Run(folder, settings) as record:
            study(settings, folder, record)
    finally:
        torch.set_num_threads(before)
    print(f"figure: {draw_front(folder)}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    small = Settings(
        ("atrium",), (32, 32), 8, poses=1, draws=1, most_passes=5, most_spp=4, trials=8, random=3,
        rounds=1, judged=2, fitted=1, steps=2, wides=(2,),
    )  # fmt: skip
    presets: dict[str, Callable[[], Settings]] = {
        "smoke": lambda: small,
        "full": lambda: Settings(scenes=present(Settings.scenes), references=os.environ.get("FOVDEN_REFERENCES")),
    }
    return run_script("search_levels", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
