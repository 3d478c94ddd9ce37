"""Tables of the documentation that are made from measurements, when the pages are built.

A page names the folder of a run, whose ``metrics.csv``, ``config.json`` and ``provenance.json`` are read
(:mod:`fovden.results`), or a benchmark, whose results are in ``benchmarks/results``, so that no number on a page is
typed by hand.
"""

from __future__ import annotations

import statistics
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from benchmarks import harness
from fovden.figures.convergence import convergence_slope, noise_by_samples
from fovden.metrics import METRICS, PIXELS_PER_DEGREE
from fovden.results import Measurement, read_config, read_metrics, read_provenance

SOURCES = ("metrics.csv", "config.json", "provenance.json")


class Measured(SphinxDirective, ABC):
    """A table of a run, and the line that says where the numbers come from."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Returns the table and the line below it."""
        folder = (Path(self.env.doc2path(self.env.docname)).parent / self.arguments[0]).resolve()
        for name in SOURCES:
            self.env.note_dependency(str(folder / name))
        try:
            measurements, config = read_metrics(folder), read_config(folder)
        except (OSError, ValueError) as error:
            raise self.error(str(error)) from error
        header, rows = self.table(measurements)
        return [_table(header, rows), _note(self.note(measurements, config) + _machine(folder))]

    @abstractmethod
    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns the titles of the columns, and the rows."""

    @abstractmethod
    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured, in a sentence."""


class Comparison(Measured):
    """The table of a comparison of denoisers: the mean over the views of each metric, and costs relative to Base."""

    option_spec = {"metrics": directives.unchanged, "costs": directives.flag}  # noqa: RUF012 - docutils' way

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each method."""
        mean = _mean(measurements)
        layers = sorted({row.region for row in measurements if row.region.startswith("layer") and row.metric == "ssim"})
        wanted = self.options.get("metrics", "rmse flip psnr ssim").split()
        columns: list[tuple[str, Callable[[str], str]]] = []

        def add(title: str, metric: str, region: str) -> None:
            style = METRICS[metric].format
            if any((row.metric, row.region) == (metric, region) for row in measurements):
                columns.append((title, lambda method: _formatted(mean(method, metric, region), style)))

        if "costs" in self.options:
            columns += [
                ("million paths", lambda method: _formatted(mean(method, "paths", "whole"), ".2f", 1e-6)),
                ("paths, s", lambda method: _formatted(mean(method, "seconds_paths", "whole"), ".2f")),
                ("denoiser, s", lambda method: _formatted(mean(method, "seconds_denoise", "whole"), ".2f")),
                ("in all, s", lambda method: _formatted(mean(method, "seconds_total", "whole"), ".2f")),
            ]
        else:
            for metric in wanted:
                add(METRICS[metric].title, metric, "whole")
            for layer in layers:
                add(f"SSIM {layer}", "ssim", layer)
        methods = dict.fromkeys(row.method for row in measurements if row.metric in ("rmse", "paths"))
        return ["method", *(title for title, _ in columns)], [
            [method, *(value(method) for _, value in columns)] for method in methods
        ]

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns scene, resolution, samples and the reference's noise."""
        height, width = config["view"]["resolution"]
        known = {row.metric: row.value for row in measurements if row.method == "Reference"}
        light = "light without albedo (demodulate)" if config["demodulate"] else "radiance as it is"
        return (
            f"{config['view']['scene']}, {width} x {height} pixels per eye, {config['spp']} samples in each traced "
            f"pixel; the denoisers filter {light}. Reference: {known['samples']:.0f} samples per pixel, standard "
            f"error {known['standard_error']:.2g}. RMSE, PSNR, SSIM and FLIP (at {PIXELS_PER_DEGREE:.3g} pixels per "
            f"degree) after exposure {known['exposure']:.3g}, the sRGB curve and a clamp; means of both eyes. "
        )


class Benchmark(SphinxDirective):
    """The tables of a benchmark, by the name of its module: the same that it prints, from ``benchmarks/results``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Returns the tables, and below them what was measured on what."""
        name = self.arguments[0]
        path = harness.RESULTS / f"{name}.json"
        self.env.note_dependency(str(path))
        self.env.note_dependency(str(Path(harness.__file__).with_name(f"{name}.py")))
        try:
            benchmark, data = import_module(f"benchmarks.{name}"), harness.load(path)
        except (OSError, ValueError, ImportError) as error:
            raise self.error(str(error)) from error
        found: list[nodes.Node] = []
        for title, header, rows in benchmark.tables(data):
            found += [nodes.paragraph("", "", nodes.strong("", title)), _table(header, rows)]
        return [*found, _note(benchmark.note(data) + harness.machine(data))]


class LightChoice(Measured):
    """The table of ``experiments/light_choice.py``: variance, time, and what a given noise costs."""

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each scene and choice."""
        header = ["scene", "lights", "choice", "variance", "us a path", "cost", "ms to build"]
        value = {(row.scene, row.method, row.metric): row.value for row in measurements}
        rows = []
        for scene, lights in ((row.scene, row.value) for row in measurements if row.metric == "lights"):
            first = None
            for choice in (name for place, name, metric in value if (place, metric) == (scene, "microseconds")):
                variance, time, build = (
                    value[scene, choice, metric] for metric in ("variance_radiance", "microseconds", "seconds_build")
                )
                first = first or variance * time
                cost = f"{variance * time / first:.2f}"
                rows.append([
                    scene, f"{lights:.0f}", choice, f"{variance:.3g}", f"{time:.2f}", cost, f"{1000 * build:.3g}"
                ])  # fmt: skip
        return header, rows

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        height, width = config["resolution"]
        return (
            f"{len({row.scene for row in measurements})} scenes, both eyes of {width} x {height} pixels, "
            f"{config['frames']} frames of {config['spp']} samples per pixel; "
            "cost is variance times time, relative to the uniform choice; processor time on one thread. "
        )


class Convergence(Measured):
    """The table of ``experiments/sampler_convergence.py``: slope, noise, and samples for the same noise."""

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each scene and sampler."""
        noises = [row for row in measurements if row.metric == "noise"]
        samples = sorted({int(row.region.removesuffix(" spp")) for row in noises})
        shown = (samples[0], samples[len(samples) // 2], samples[-1])
        header = ["scene", "sampler", "slope", *(f"noise at {spp} spp" for spp in shown)]
        rows = []
        for scene, sampler in dict.fromkeys((row.scene, row.method) for row in noises):
            noise = noise_by_samples(measurements, scene, sampler)
            slope = f"{convergence_slope(noise):.2f}"
            rows.append([scene, sampler, slope, *(f"{noise[spp]:.4f}" for spp in shown)])
        return header, rows

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        height, width = config["resolution"]
        return (
            f"{len({row.scene for row in measurements})} scenes, both eyes of {width} x {height} pixels, "
            f"{config['frames']} frames for each number, lights by {config['lights']}; noise is relative to the mean "
            "radiance. "
        )


class Falloffs(Measured):
    """The table of ``experiments/learn_falloff.py``: what was learned, and its loss beside that of the paper's."""

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each scene and falloff."""
        header = ["scene", "falloff", "r0", "r1", "p", "loss, training", "loss, test", "of the paper's, test"]
        value = {(row.scene, row.method, row.region, row.metric): row.value for row in measurements}
        rows = []
        for scene, method in ((row.scene, row.method) for row in measurements if row.metric == "mean_rate"):
            radii = [_formatted(value.get((scene, method, "whole", name)), ".2f") for name in ("r0", "r1", "p")]
            if method == "paper":
                radii = ["1.00", "2.00", "0.50"]
            losses = [f"{value[scene, method, region, 'loss']:.4f}" for region in ("train", "test")]
            ratio, error = (value[scene, method, "test", name] for name in ("ratio", "ratio_error"))
            rows.append([scene, method, *radii, *losses, f"{ratio:.3f} +- {error:.3f}"])
        return header, rows

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        height, width = config["resolution"]
        budget = next(row.value for row in measurements if row.metric == "budget")
        return (
            f"Both eyes of {width} x {height} pixels, {config['spp']} samples in each sampled pixel, {budget:.1%} of "
            f"the pixels; two poses to learn from, a third for the test, {config['frames']} frames of each; references "
            f"of {config['reference_spp']} samples. Radii in units of the paper's r0. Errors are standard errors over "
            f"{config['frames'] * config['masks']} pairs of frames and masks. "
        )


class MaskGradients(Measured):
    """The other table of ``experiments/learn_falloff.py``: gradients by relaxed masks and by differences."""

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each kind of light and way to the gradient."""
        names = {"log_r0": "log r0", "log_width": "log (r1 - r0)", "logit_p": "logit p"}
        value = {(row.region, row.method, row.metric): row.value for row in measurements}
        rows = []
        for region, method in dict.fromkeys((row.region, row.method) for row in measurements if row.metric in names):
            cells = [
                f"{1000 * value[region, method, name]:.2f} +- {1000 * value[region, method, f'{name}_error']:.2f}"
                for name in names
            ]
            rows.append([region, method, *cells])
        return ["light", "gradient", *names.values()], rows

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        del measurements
        return (
            "Thousandths of the loss's unit, means and standard errors over "
            f"{config['gradient_masks']} masks for 16 frames of the Cornell box, both eyes of 64 x 64 pixels, at the "
            "paper's falloff, without a budget. "
        )


def _mean(measurements: Sequence[Measurement]) -> Callable[[str, str, str], float | None]:
    """A function from method, metric and region to the mean over the views; ``None`` where nothing was measured."""

    def mean(method: str, metric: str, region: str) -> float | None:
        found = [row.value for row in measurements if (row.method, row.metric, row.region) == (method, metric, region)]
        return statistics.fmean(found) if found else None

    return mean


def _formatted(value: float | None, style: str, scale: float = 1.0) -> str:
    return "" if value is None else format(value * scale, style)


def _machine(folder: Path) -> str:
    """Processor, threads and versions of a run."""
    provenance = read_provenance(folder)
    versions, threads = provenance["versions"], provenance["threads"]
    return (
        f"Measured on {provenance['device']} with {threads} thread{'s' if threads > 1 else ''}; fovden "
        f"{versions['fovden']}, torch {versions['torch']}, numba {versions['numba']}."
    )


def _note(text: str) -> nodes.paragraph:
    return nodes.paragraph("", text, classes=["measured"])


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> nodes.table:
    group = nodes.tgroup("", *(nodes.colspec(colwidth=1) for _ in header), cols=len(header))
    for part, lines in ((nodes.thead, [header]), (nodes.tbody, rows)):
        cells = [[nodes.entry("", nodes.paragraph("", cell)) for cell in line] for line in lines]
        group += part("", *(nodes.row("", *line) for line in cells))
    return nodes.table("", group, classes=["measured"])


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_directive("measured-comparison", Comparison)
    app.add_directive("measured-benchmark", Benchmark)
    app.add_directive("measured-lights", LightChoice)
    app.add_directive("measured-convergence", Convergence)
    app.add_directive("measured-falloffs", Falloffs)
    app.add_directive("measured-mask-gradients", MaskGradients)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
