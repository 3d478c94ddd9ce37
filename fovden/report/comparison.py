"""The report of a comparison, from the files in its folder."""

from __future__ import annotations

import os
import shlex
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from fovden.comparison import METHODS, SavedComparison, read_comparison
from fovden.frame import Frame
from fovden.metrics import PIXELS_PER_DEGREE, Score
from fovden.report.page import eye_names, write_report
from fovden.report.tables import Column, Table, quality_tables

__all__ = ["report_comparison"]

DESCRIPTIONS = {
    "Noisy, full": "every pixel is traced",
    "Noisy, foveated": "all pixels are traced around the gaze, ever fewer farther out",
    "Mask ignored": "NH3LD told that every pixel was traced",
    "Base": "the homogeneous filter on the full frame",
    "NH2LD": "two foveation layers, the inner one with fewer passes",
    "NH3LD": "three foveation layers",
    "Base, equal paths": "Base with as many paths as the foveated frame has, spread evenly",
}


def report_comparison(folder: str | os.PathLike[str]) -> Path:
    """Writes ``report.html`` into the folder of a comparison, from the files in it alone, and returns its path.

    Args:
        folder: The folder that :func:`fovden.comparison.compare_denoisers` wrote.

    Returns:
        The path of the page; see :func:`fovden.report.write_report`.

    Raises:
        FileNotFoundError: If a file of the comparison is missing.
        ValueError: If one is damaged, or its size is not that of the others.
        OSError: If the page cannot be written.

    Example:
        >>> import tempfile
        >>> from fovden.comparison import CompareSettings, SceneSettings, compare_denoisers
        >>> view, folder = SceneSettings("cornell_box", resolution=(16, 16)), tempfile.mkdtemp()
        >>> _ = compare_denoisers(CompareSettings(view, reference_spp=2, repeats=1), folder, progress=False)
        >>> report_comparison(folder).name
        'report.html'
    """
    saved = read_comparison(folder)
    foveated = saved.foveated
    height, width = foveated.resolution
    eyes = eye_names(foveated.view_count)
    scores = [
        Score(row.method, int(row.view), row.region, row.metric, row.value)
        for row in saved.measurements
        if row.view != ""
    ]
    return write_report(
        Path(folder) / "report.html",
        saved.images,
        saved.reference,
        title=f"Denoising {saved.scene}",
        subtitle=f"{width} x {height} pixels per eye, reference of {saved.reference.count} samples per pixel",
        exposure=saved.exposure,
        gaze=foveated.gaze,
        radii=saved.radii if foveated.gaze is not None else (),
        layer=foveated.layer,
        samples={method.name: saved.frames[method.frame].counts for method in METHODS},
        captions=_captions(saved, scores),
        tables=[*quality_tables(scores, eyes=eyes, note=_note(saved)), _costs(saved)],
        notes=["; ".join(f"{name}: {text}" for name, text in DESCRIPTIONS.items() if name in saved.images) + "."],
        provenance=_provenance(saved),
    )


def _captions(saved: SavedComparison, scores: Sequence[Score]) -> dict[str, str]:
    def mean(method: str, metric: str) -> float:
        found = [s.value for s in scores if (s.method, s.metric, s.region) == (method, metric, "whole")]
        return statistics.fmean(found) if found else float("nan")

    captions = {name: f"{mean(name, 'psnr'):.2f} dB, SSIM {mean(name, 'ssim'):.3f}" for name in saved.images}
    return {**captions, "Reference": f"{saved.reference.count} samples a pixel"}


def _note(saved: SavedComparison) -> str:
    noise = float(saved.reference.variance.mean(dtype=torch.float64).sqrt())
    return (
        f"RMSE, PSNR, SSIM and FLIP of display values: exposure {saved.exposure:.4g}, sRGB, clamped. Linear RMSE, "
        f"relMSE and SMAPE of radiance. FLIP at {PIXELS_PER_DEGREE:.4g} pixels per degree. "
        f"The reference's own noise is {noise:.3g} (RMS)."
    )


def _costs(saved: SavedComparison) -> Table:
    """Paths and seconds of each method, and how much faster than Base it is."""
    found = {(row.method, row.metric): row.value for row in saved.measurements if row.view == ""}
    pixels = saved.reference.mean[:, 0].numel()

    def ratio(method: str, metric: str) -> float | None:
        base, own = found.get(("Base", metric)), found.get((method, metric))
        return base / own if base and own and found.get((method, "seconds_denoise")) else None

    stages = ("seconds_gbuffer", "seconds_paths", "seconds_denoise", "seconds_total")
    rows = []
    for method in saved.images:
        paths = found.get((method, "paths"))
        counts = (None, None) if paths is None else (paths / 1e6, paths / pixels)
        seconds = (found.get((method, stage)) for stage in stages)
        rows.append((method, *counts, *seconds, ratio(method, "seconds_paths"), ratio(method, "seconds_total")))
    columns = (
        Column("method"),
        Column("paths / million", ".3f"),
        Column("paths / pixel", ".3f"),
        Column("G-buffer / s", ".3f"),
        Column("paths / s", ".3f"),
        Column("denoising / s", ".3f"),
        Column("total / s", ".3f"),
        Column("speed-up of paths", ".2f", "higher"),
        Column("speed-up in all", ".2f", "higher"),
    )
    note = "Both eyes together; seconds are medians. Speed-ups compare with Base, that of paths without the G-buffer."
    return Table("Cost", columns, rows, note)


def _provenance(saved: SavedComparison) -> dict[str, object]:
    told = saved.provenance
    view = saved.config.get("view", {})
    commit = told.get("commit")
    return {
        "command": _command(told.get("command", [])),
        "scene": Path(str(view.get("scene", saved.scene))).name,
        "view": {name: value for name, value in view.items() if name not in ("scene", "lights", "skip_materials")},
        "lights added": _lights(view.get("lights", [])),
        "seed": saved.config.get("seed"),
        "samples": {"per traced pixel": saved.config.get("spp"), "of the reference": saved.reference.count},
        "layers": _layers(saved.radii, saved.foveated),
        "albedo divided out": "yes" if saved.config.get("demodulate") else "no",
        "timings of each stage": saved.config.get("repeats"),
        "device": told.get("device"),
        "platform": told.get("platform"),
        "threads": told.get("threads"),
        "versions": told.get("versions"),
        "commit": f"{commit}, with changes" if commit and told.get("modified") else commit,
        "started": told.get("started"),
        "seconds of each stage": told.get("seconds"),
    }


def _command(words: Sequence[str]) -> str | None:
    """The command as it was typed, without the folder in which the program lies."""
    if not words:
        return None
    program = Path(words[0])
    name = f"python -m {program.parent.name}" if program.name == "__main__.py" else program.name
    return " ".join([name, *map(shlex.quote, words[1:])])


def _lights(lights: Sequence[Mapping[str, Any]]) -> str | None:
    described = (
        " ".join([str(light.get("kind")), *(f"{name} {value}" for name, value in light.items() if name != "kind")])
        for light in lights
    )
    return "; ".join(described) or None


def _layers(radii: Sequence[float], frame: Frame) -> str | None:
    if frame.gaze is None:
        return None
    gaze = ", ".join(f"({x:g}, {y:g})" for x, y in frame.gaze.pixels.tolist())
    within = ", ".join(f"{radius:g}" for radius in radii)
    return f"radii of {within} pixels around the gaze at {gaze}"
