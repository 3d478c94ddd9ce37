"""The tables of ``experiments/compare_foveation.py`` and ``experiments/ray_order.py``."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Sequence
from typing import Any

from docutils.parsers.rst import directives
from measured import Measured
from sphinx.application import Sphinx

from fovden.figures import curves_of_ways
from fovden.results import Measurement

LAYERS = ("layer 0", "layer 1", "layer 2")
Row = list[str]


class Means:
    """Means over the views, and over the scenes where none is named; ``None`` where nothing was measured."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        self.values: dict[tuple[str, str, str, str], list[float]] = {}
        for row in measurements:
            for scene in (row.scene, ""):
                self.values.setdefault((scene, row.method, row.region, row.metric), []).append(row.value)
        self.scenes = list(dict.fromkeys(row.scene for row in measurements))
        judged = (row.method for row in measurements if row.metric == "flip")
        self.ways = list(dict.fromkeys(method.rpartition(",")[0] for method in judged))

    def __call__(self, scene: str, method: str, region: str, metric: str) -> float | None:
        """Returns the mean."""
        found = self.values.get((scene, method, region, metric))
        return statistics.fmean(found) if found else None


class Foveations(Measured):
    """Ways to place paths: scores at equal paths, by layer, at equal time; costs; and what fewer cells lose."""

    option_spec = {"show": lambda word: directives.choice(word, tuple(TABLES))}  # noqa: RUF012 - docutils' way

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each way, or for each scene and way."""
        return TABLES[self.options.get("show", "scores")](measurements)

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        views = len({(row.scene, row.frame) for row in measurements})
        height, width = config["resolution"]
        common = (
            f"{views} views (two poses, three gazes) of {len(config['scenes'])} scenes, both eyes of {width} x "
            f"{height} pixels; references of {config['reference_spp']} samples. "
        )
        if self.options.get("show") == "sampling":
            return common + "RMSE of what a display shows, weighted by acuity. "
        error = " + ".join(f"{weight:g} {name}" for name, weight in config["error"].items())
        return (
            f"{common}{config['mean_spp']:g} paths for each pixel of the screen, unless others are named. Tuned means "
            f"{config['steps']} steps of Adam on {error}, over three other poses with three gazes each. Weighted by "
            "acuity, a pixel at e degrees from the gaze counts 1 / (1 + e / 2.3)^2. Times are those of one thread. "
        )


def scores(measurements: Sequence[Measurement]) -> tuple[Row, list[Row]]:
    """Scores of tuned filters, and RMSE before they were tuned."""
    mean = Means(measurements)
    columns = [
        ("RMSE", "tuned", "whole", "rmse", ".4f"),
        ("by acuity", "tuned", "acuity", "rmse", ".4f"),
        ("by acuity, untuned", "untuned", "acuity", "rmse", ".4f"),
        ("SSIM", "tuned", "whole", "ssim", ".3f"),
        ("by acuity", "tuned", "acuity", "ssim", ".3f"),
        ("FLIP", "tuned", "whole", "flip", ".3f"),
        ("by acuity", "tuned", "acuity", "flip", ".3f"),
        ("FovVideoVDP, JOD", "tuned", "whole", "fovvideovdp", ".2f"),
    ]
    return _by_scene(mean, columns)


def by_layer(measurements: Sequence[Measurement]) -> tuple[Row, list[Row]]:
    """RMSE and SSIM of tuned filters within the circles of three layers."""
    columns = [
        (f"{title}, {layer}", "tuned", layer, metric, style)
        for title, metric, style in (("RMSE", "rmse", ".4f"), ("SSIM", "ssim", ".3f"))
        for layer in LAYERS
    ]
    return _by_scene(Means(measurements), columns)


def costs(measurements: Sequence[Measurement]) -> tuple[Row, list[Row]]:
    """Rays, paths and milliseconds of a frame, means over all scenes."""
    mean = Means(measurements)
    header = ["way", "thousand cells", "thousand paths", "G-buffer, ms", "paths, ms", "filter, ms", "to the screen, ms",
              "in all, ms"]  # fmt: skip
    rows = []
    for way in mean.ways:
        counts = [mean("", f"{way}, tuned", "whole", name) for name in ("rays", "paths")]
        times = [
            mean("", f"{way}, tuned", "whole", f"seconds_{name}") for name in ("gbuffer", "paths", "denoise", "map")
        ]
        values = [each or 0.0 for each in (*counts, *times)]
        cells = [f"{1e-3 * value:.0f}" for value in values[:2]] + [f"{1e3 * value:.0f}" for value in values[2:]]
        rows.append([way, *cells, f"{1e3 * sum(values[2:]):.0f}"])
    return header, rows


def at_equal_time(measurements: Sequence[Measurement]) -> tuple[Row, list[Row]]:
    """RMSE at the time that three layers take with the budget of all, by interpolation in the sweep of budgets."""
    mean = Means(measurements)
    regions = {"whole": "RMSE", "acuity": "by acuity"}
    header = ["way", *(f"{scene}, {title}".replace("_", " ") for scene in mean.scenes for title in regions.values())]
    rows = []
    for way in mean.ways:
        cells = []
        for scene in mean.scenes:
            for region in regions:
                curves = curves_of_ways(measurements, scene, region, "paths")
                time = statistics.median(cost for cost, _ in curves["Three layers"])
                cells.append(_at(curves.get(way, []), time))
        rows.append([way, *cells])
    return header, [row for row in rows if any(row[1:])]


def sampling(measurements: Sequence[Measurement]) -> tuple[Row, list[Row]]:
    """RMSE of converged light through fewer cells, means over all scenes."""
    mean = Means(measurements)
    shares = sorted(
        {row.method.split(", ")[-1].split()[0] for row in measurements if row.method.endswith(" cells")},
        key=float, reverse=True,
    )  # fmt: skip
    header = ["way", *(f"{100 * (1 - float(share)):.0f} % fewer" for share in shares)]
    rows = []
    for way in mean.ways:
        found = [mean("", f"{way}, converged, {share} cells", "acuity", "rmse") for share in shares]
        if None not in found:
            rows.append([way, *(f"{value:.4f}" for value in found if value is not None)])
    return header, rows


TABLES = {
    "scores": scores,
    "layers": by_layer,
    "costs": costs,
    "equal time": at_equal_time,
    "sampling": sampling,
}


def _by_scene(mean: Means, columns: Sequence[tuple[str, str, str, str, str]]) -> tuple[Row, list[Row]]:
    """A row for each scene and way, of the columns that were measured."""
    known = [
        each for each in columns if any(mean("", f"{way}, {each[1]}", *each[2:4]) is not None for way in mean.ways)
    ]
    rows = []
    for scene in mean.scenes:
        for number, way in enumerate(mean.ways):
            values = [mean(scene, f"{way}, {variant}", region, metric) for _, variant, region, metric, _ in known]
            cells = ["" if v is None else format(v, style) for v, (*_, style) in zip(values, known, strict=True)]
            rows.append(["" if number else scene.replace("_", " "), way, *cells])
    return ["scene", "way", *(title for title, *_ in known)], rows


def _at(points: Sequence[tuple[float, float]], time: float) -> str:
    """The error at a time, between the two points around it that have most paths; or how the way's times lie to it."""
    for (after, low), (before, high) in itertools.pairwise(reversed(points)):
        if before <= time <= after:
            share = (math.log(time) - math.log(before)) / (math.log(after) - math.log(before)) if after > before else 0
            return f"{high + share * (low - high):.4f}"
    return "slower" if points and min(points)[0] > time else "faster" if points else ""


class RayOrder(Measured):
    """Rays per second in the order of each raster, over those of the screen in rows."""

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each order."""
        rates = {(row.scene, row.region, row.frame, row.method): row.value for row in measurements}
        scenes = list(dict.fromkeys(row.scene for row in measurements))
        kinds = list(dict.fromkeys(row.region for row in measurements))
        rounds = sorted({row.frame for row in measurements})
        methods = list(dict.fromkeys(row.method for row in measurements))
        header = ["order", *(f"{scene}, {kind}".replace("_", " ") for scene in scenes for kind in kinds)]
        rows = []
        for method in methods:
            ratios = [
                statistics.median(
                    rates[scene, kind, number, method] / rates[scene, kind, number, methods[0]] for number in rounds
                )
                for scene in scenes
                for kind in kinds
            ]
            rows.append([method, *(f"{ratio:.2f}" for ratio in ratios)])
        return header, rows

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        height, width = config["resolution"]
        rates = [row.value for row in measurements if row.method == measurements[0].method]
        return (
            f"Rays per second over those of the first line, which are {min(rates) / 1e6:.1f} to "
            f"{max(rates) / 1e6:.1f} million on one thread; both eyes of {width} x {height} pixels, "
            f"{config['mean_cells']:g} cells for a pixel; medians of the ratios in {config['rounds']} rounds. "
        )


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_directive("measured-foveations", Foveations)
    app.add_directive("measured-ray-order", RayOrder)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
