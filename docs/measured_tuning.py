"""The tables of ``experiments/tune_sigmas.py`` and ``experiments/full_size.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from docutils.parsers.rst import directives
from measured import Measured
from sphinx.application import Sphinx

from experiments.tune_sigmas import JUDGED, cells
from fovden.figures import scores_of_fits
from fovden.metrics import METRICS, PIXELS_PER_DEGREE
from fovden.results import Measurement


class Tuning(Measured):
    """Scores of filters by hand and fitted, on frames of poses that no fit has seen; or one metric by layer."""

    option_spec = {"layers": directives.unchanged}  # noqa: RUF012 - docutils' way

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each scene and method."""
        if metric := self.options.get("layers"):
            regions = sorted({row.region for row in measurements if row.region.startswith("layer")})
            columns = [cells(measurements, [metric], region) for region in regions]
            rows = [[*line[0][:2], *(each[2] for each in line)] for line in zip(*columns, strict=True)]
            header = ["scene", "method", *(f"{METRICS[metric].title}, {region}" for region in regions)]
        else:
            header = ["scene", "method", *(METRICS[metric].title for metric in JUDGED)]
            rows = cells(measurements, JUDGED)
        scenes = [row[0] for row in rows]
        return header, [["" if number and scenes[number - 1] == row[0] else row[0], *row[1:]]
                        for number, row in enumerate(rows)]  # fmt: skip

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        del measurements
        height, width = config["resolution"]
        light = "light without albedo" if config["light"] == "demodulated" else "radiance as it is"
        error = " + ".join(f"{weight:g} {name}" for name, weight in config["error"].items())
        return (
            f"Both eyes of {width} x {height} pixels; references of {config['reference_spp']} samples; filters on "
            f"{light}. Made small: {error}, over three poses with {config['draws']} noises each, in at most "
            f"{config['steps']} steps of Adam. Means over two test poses and both eyes; after the sign the standard "
            f"deviation over {config['seeds']} seeds, or over the scenes that others' widths are from. RMSE, PSNR, "
            f"SSIM and FLIP (at {PIXELS_PER_DEGREE:.3g} pixels per degree) after exposure, the sRGB curve and a clamp. "
        )


class FullSize(Tuning):
    """Scores and times on one pose at full size: what ``experiments/full_size.py`` found."""

    option_spec = {}  # noqa: RUF012 - docutils' way

    def table(self, measurements: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
        """Returns one row for each scene and method, with times relative to Base by hand."""
        header, rows = super().table(measurements)
        found = scores_of_fits(measurements)
        scene = ""
        for row in rows:
            scene = row[0] or scene
            times = [found.get((scene, row[1], name)) for name in ("seconds_trace", "seconds_denoise")]
            if None in times:
                row += ["", "", ""]
                continue
            base = sum(found[scene, "Base, by hand", name][0] for name in ("seconds_trace", "seconds_denoise"))
            trace, denoise = (each[0] for each in times if each)
            row += [f"{trace:.2f}", f"{denoise:.2f}", f"{base / (trace + denoise):.2f}"]
        return [*header, "tracing, s", "filter, s", "times as fast"], rows

    def note(self, measurements: Sequence[Measurement], config: dict[str, Any]) -> str:
        """Returns what was measured."""
        del measurements
        height, width = config["resolution"]
        light = "light without albedo" if config["light"] == "demodulated" else "radiance as it is"
        return (
            f"One test pose of each scene; scores of the left eye, {width} x {height} pixels, against "
            f"{config['reference_spp']} samples; filters on {light}, fitted on images of half that size (seed 0). "
            f"Seconds are those of both eyes, medians of {config['repeats']}; the last column is Base by hand's over "
            "each row's, tracing and filter together. "
        )


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directive."""
    app.add_directive("measured-tuning", Tuning)
    app.add_directive("measured-full-size", FullSize)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
