"""The tables of ``experiments/paper_readings.py``: what other readings of the paper change, and where."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from docutils.parsers.rst import directives
from measured import Measured
from sphinx.application import Sphinx

from fovden.figures.readings import changes_by_scene, names_of_readings
from fovden.metrics import METRICS, PIXELS_PER_DEGREE
from fovden.results import Measurement

JUDGED = ("rmse", "psnr", "ssim", "flip")
DEFAULT = "default, fitted"


class Readings(Measured):
    """Changes of all metrics in the whole image, or with ``:where:`` of RMSE by layer and scene, for one light."""

    option_spec = {"light": directives.unchanged_required, "where": directives.flag}  # noqa: RUF012 - docutils' way

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each reading, the default first."""
        light = self.options["light"]
        readings = names_of_readings(measurements, light)
        return (_where if "where" in self.options else _whole)(measurements, light, readings)

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        del measurements
        height, width = config["resolution"]
        light = "light without albedo" if self.options["light"] == "demodulated" else "radiance as it is"
        error = " + ".join(f"{weight:g} {name}" for name, weight in config["error"].items())
        changes = (
            "Mean over the scenes of the change from the default, relative for RMSE and FLIP"
            if "where" not in self.options
            else "Change of RMSE from the default, for layers the mean over the scenes"
        )
        return (
            f"NH3LD on {light}, {len(config['scenes'])} scenes, two test poses each, both eyes of {width} x {height} "
            f"pixels; references of {config['reference_spp']} samples. {changes}; the default's row has values. Kept "
            f"are the widths fitted for the default, fitted those of the reading's own; none where the former change "
            f"the error of the frames held out by less than {config['threshold']:.0%} in every scene. Made small: "
            f"{error}, for each scene over three other poses, in {config['steps']} steps of Adam for the default and "
            f"{config['more_steps']} more for each row of fitted widths, the default's own among them. FLIP at "
            f"{PIXELS_PER_DEGREE:.3g} pixels per degree. "
        )


def _whole(
    measurements: Sequence[Measurement], light: str, readings: dict[str, list[str]]
) -> tuple[list[str], list[list[str]]]:
    titles = [(METRICS[metric].title, widths) for metric in JUDGED for widths in ("kept", "fitted")]
    rows = []
    for reading, found in readings.items():
        cells = []
        for metric in JUDGED:
            if reading == "default":
                value = statistics.fmean(_values(measurements, f"{light}, {DEFAULT}", metric).values())
                cells += ["", format(value, METRICS[metric].format)]
            else:
                cells += [
                    _changed(measurements, f"{light}, {reading}, {widths}", metric) if widths in found else ""
                    for widths in ("kept", "fitted")
                ]
        seconds = _values(measurements, f"{light}, {reading}, {found[0]}", "seconds").values()
        rows.append([reading, f"{statistics.fmean(seconds):.2f}", *cells])
    if "fitted on" in readings["default"]:
        again = [_changed(measurements, f"{light}, default, fitted on", metric) for metric in JUDGED]
        rows.insert(1, ["default, fitted on", "", *(cell for each in again for cell in ("", each))])
    return ["reading", "seconds", *(f"{title}, {widths}" for title, widths in titles)], rows


def _where(
    measurements: Sequence[Measurement], light: str, readings: dict[str, list[str]]
) -> tuple[list[str], list[list[str]]]:
    regions = sorted({row.region for row in measurements if row.region.startswith("layer")})
    usual = f"{light}, {DEFAULT}"
    values = _values(measurements, usual, "rmse")
    layers = [statistics.fmean(_values(measurements, usual, "rmse", region).values()) for region in regions]
    rows = [["default", "fitted", *(format(value, METRICS["rmse"].format) for value in [*layers, *values.values()])]]
    for reading, found in readings.items():
        for widths in ("fitted on",) if reading == "default" else found:
            method = f"{light}, {reading}, {widths}"
            scenes = changes_by_scene(measurements, method)
            cells = [_changed(measurements, method, "rmse", region) for region in regions]
            rows.append([reading, widths, *cells, *(_formatted("rmse", scenes[scene]) for scene in values)])
    return ["reading", "widths", *regions, *values], rows


def _values(measurements: Sequence[Measurement], method: str, metric: str, region: str = "whole") -> dict[str, float]:
    wanted = (method, metric, region)
    return {row.scene: row.value for row in measurements if (row.method, row.metric, row.region) == wanted}


def _changed(measurements: Sequence[Measurement], method: str, metric: str, region: str = "whole") -> str:
    return _formatted(metric, statistics.fmean(changes_by_scene(measurements, method, metric, region).values()))


def _formatted(metric: str, change: float) -> str:
    if metric in ("rmse", "flip"):
        return f"{100 * change:+.1f} %" if abs(change) > 0.1 else f"{100 * change:+.2f} %"
    return format(change, f"+{METRICS[metric].format}")


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directive."""
    app.add_directive("measured-readings", Readings)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
