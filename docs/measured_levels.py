"""Tables of ``experiments/search_levels.py``: the front of time against error, all passes, and what a unit costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from docutils.parsers.rst import directives
from measured import Measured
from sphinx.application import Sphinx

from fovden.figures.front import TRIED, best_of, trials_by
from fovden.metrics import METRICS
from fovden.results import Measurement
from fovden.tuning import Trial, pareto_front

PAPERS = {"3-4-5 1 2 0.5 4": "NH3LD", "3-5 1 2 0.5 4": "NH2LD", "5 1 2 0 4": "Base", "5 1 2 0 1": "Base"}
SCORES = ("rmse", "psnr", "ssim", "flip")
ERRORS = ("error", "error_acuity")


class Front(Measured):
    """Settings of a front and the paper's filters, judged on test frames, the cheapest first."""

    option_spec = {  # noqa: RUF012 - docutils' way
        "error": lambda word: directives.choice(word, ERRORS),
        "fitted": directives.flag,
    }

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each setting; with ``fitted``, those to which widths were fitted, before and after."""
        error = self.options.get("error", "error")
        header = [
            "",
            "passes",
            "spp",
            "r0",
            "r1",
            "p",
            "widths",
            "time, s",
            "error",
            *(METRICS[m].title for m in SCORES),
        ]
        tested = {kind: trials_by(measurements, [kind], error=error) for kind in ("test", "test, fitted")}
        choices = {trial.setting["choice"] for trial in tested["test, fitted"]}
        if "fitted" not in self.options:
            del tested["test, fitted"]
            choices = set(papers_of(measurements, error)) | {
                trial.setting["choice"] for trial in pareto_front(trials_by(measurements, TRIED, error=error))
            }
        shown = [trial for own in tested.values() for trial in own if trial.setting["choice"] in choices]
        shown.sort(key=lambda trial: (trial.cost, trial.setting["choice"]))
        return header, [row_of(measurements, trial, "fitted" in self.options) for trial in shown]

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        del measurements
        weight = ", weighted by acuity" if self.options.get("error") == "error_acuity" else ""
        (height, width), (radiance, normal, position) = config["resolution"], config["sigmas"]
        return (
            f"{' and '.join(config['scenes'])}, two test poses each, {config['draws']} draws of noise, both eyes of "
            f"{width} x {height} pixels, references of {config['reference_spp']} samples; means, of errors the "
            f"geometric one. The error is {config['l2']:g} MSE + {config['ssim']:g} (1 - SSIM){weight}. Radii in units "
            "of the paper's r0; p is the share of the outer pixels that are left out. Widths of normal and position "
            f"are {normal:g} and {position:g} times the number given, that of radiance is {radiance:g}, on light "
            "without albedo. The paper's filters have the widths that serve them best on the training frames. "
        )


class Passes(Measured):
    """All numbers of passes at the paper's foveation: the front, and the paper's own."""

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each setting of the front and for the paper's, the cheapest first."""
        header = ["passes", "on the front", "passes, ms", "widths", "error", "rank by error"]
        grid = best_of(trials_by(measurements, ["grid"], cost="seconds_passes"), "levels")
        front = pareto_front(grid)
        shown = front + [trial for trial in grid if trial.setting["levels"] == "3-4-5" and trial not in front]
        ranks = {trial.setting["levels"]: n for n, trial in enumerate(sorted(grid, key=lambda t: t.error), 1)}
        return header, [
            [
                words(trial.setting["levels"]),
                "yes" if trial in front else "no",
                f"{1000 * trial.cost:.0f}",
                widths(trial),
                f"{trial.error:.4f}",
                f"{ranks[trial.setting['levels']]} of {len(grid)}",
            ]
            for trial in sorted(shown, key=lambda trial: trial.cost)
        ]

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        del measurements
        return (
            f"Training frames, {config['poses']} poses of each scene; the paper's foveation, 4 samples in each traced "
            "pixel; of all widths that were tried those of least error, for each row by itself. "
        )


class Units(Measured):
    """What a unit of work costs in each scene, and how well that predicts times."""

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each scene."""
        kinds = {
            "pixel": "G-buffer pixel, ns", "traced": "traced pixel, ns", "path": "path, ns",
            "filtered": "filtered pixel and pass, ns", "frame": "denoised frame, ms",
        }  # fmt: skip
        cost = {(row.scene, row.region): row.value for row in measurements if row.method == "costs"}
        rows = []
        for scene in dict.fromkeys(scene for scene, _ in cost):
            cells = [f"{1e9 * cost[scene, kind]:.0f}" for kind in kinds if kind != "frame"]
            checks: dict[str, dict[str, float]] = {}
            for row in measurements:
                if (row.scene, row.method) == (scene, "check"):
                    checks.setdefault(row.region, {})[row.metric] = row.value
            off = [each["predicted"] / each["seconds"] - 1 for each in checks.values()]
            rows.append([scene, *cells, f"{1e3 * cost[scene, 'frame']:.0f}", f"{min(off):+.0%} to {max(off):+.0%}"])
        return ["scene", *kinds.values(), "predicted times are off by"], rows

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        count = len({row.region for row in measurements if row.method == "check"})
        return (
            f"Processor time of one thread, medians of {config['rounds']} rounds; times predicted and measured for "
            f"{count} settings in the same rounds. "
        )


def papers_of(measurements: Sequence[Measurement], error: str) -> list[str]:
    """Returns the settings of the paper's filters, each with the widths of least error on the training frames."""
    named = trials_by(measurements, ["Base", "NH2LD", "NH3LD"], error=error)
    for trial in named:
        trial.setting["paper"] = trial.setting["choice"].rpartition(" ")[0]
    return [t.setting["choice"] for t in best_of(named, "paper") if t.setting["paper"] in PAPERS]


def row_of(measurements: Sequence[Measurement], trial: Trial, says_which: bool) -> list[str]:
    """Returns the cells of a setting that was judged."""
    own = trial.setting
    name = PAPERS.get(own["choice"].rpartition(" ")[0], "")
    if says_which:
        name = f"{name} {'fitted' if own['method'] == 'test, fitted' else 'as searched'}".strip()
    scores = []
    for metric in SCORES:
        key = own["method"], own["choice"], metric
        values = [row.value for row in measurements if (row.method, row.region, row.metric) == key]
        scores.append(format(sum(values) / len(values), METRICS[metric].format))
    numbers = [f"{own[each]:.2f}" for each in ("r0", "r1", "p")] if own["p"] > 0 else ["", "", "0.00"]
    fixed = [words(own["levels"]), str(own["spp"]), *numbers, widths(trial)]
    return [name, *fixed, f"{trial.cost:.2f}", f"{trial.error:.4f}", *scores]


def words(levels: str) -> str:
    """Returns numbers of passes as they are printed.

    Example:
        >>> words("3-4-5")
        '3, 4, 5'
    """
    return levels.replace("-", ", ")


def widths(trial: Trial) -> str:
    """Returns by what the widths of normal and position were multiplied."""
    return f"{2 ** trial.setting['wide']:.2g}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_directive("measured-front", Front)
    app.add_directive("measured-passes", Passes)
    app.add_directive("measured-units", Units)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
