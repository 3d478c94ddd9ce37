"""How noise falls with the number of samples: one panel for each scene, one line for each sampler."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from fovden.figures.style import FAINT, GRID, PRINT_WIDTH, SMALL, MethodStyle, drawing, method_style, save_figure
from fovden.results import Measurement, read_metrics

__all__ = ["convergence_slope", "draw_convergence", "noise_by_samples"]

STYLES = {
    "independent": MethodStyle("#d55e00", "s", "\u25a0"),
    "sobol": MethodStyle("#0072b2", "o", "\u25cf"),
}

FIRST_OF_SLOPE = 16
"""Samples per pixel from which a slope is fitted: below, a light that is not found at all hides it."""


def noise_by_samples(measurements: Sequence[Measurement], scene: str, sampler: str) -> dict[int, float]:
    """Returns the noise of a scene by samples per pixel, rising.

    Args:
        measurements: Rows with the metric ``"noise"`` and the region ``"N spp"``.
        scene: Name of the scene.
        sampler: Name of the sampler, the rows' method.

    Returns:
        Samples per pixel and noise.

    Example:
        >>> noise_by_samples([Measurement("box", 0, "", "sobol", "4 spp", "noise", 0.5)], "box", "sobol")
        {4: 0.5}
    """
    rows = [row for row in measurements if (row.scene, row.method, row.metric) == (scene, sampler, "noise")]
    return dict(sorted((int(row.region.removesuffix(" spp")), row.value) for row in rows))


def convergence_slope(noise: dict[int, float]) -> float:
    """Returns the exponent with which noise falls: the slope of the least-squares line through the logarithms.

    Args:
        noise: Noise by samples per pixel. Numbers below 16 are left out where two or more remain.

    Returns:
        The slope: -1/2 for independent samples. NaN for fewer than two numbers.

    Example:
        >>> convergence_slope({16: 1.0, 64: 0.5})
        -0.5
    """
    late = {samples: value for samples, value in noise.items() if samples >= FIRST_OF_SLOPE}
    points = [(math.log(n), math.log(v)) for n, v in (late if len(late) > 1 else noise).items() if v > 0]
    if len(points) < 2:
        return math.nan
    x_mean, y_mean = (sum(values) / len(points) for values in zip(*points, strict=True))
    covariance = sum((x - x_mean) * (y - y_mean) for x, y in points)
    return float(covariance / sum((x - x_mean) ** 2 for x, _ in points))


def draw_convergence(folder: str | os.PathLike[str]) -> Path:
    """Draws ``convergence.png`` into a folder that ``experiments/sampler_convergence.py`` wrote, from its numbers.

    Args:
        folder: The folder, with ``metrics.csv``.

    Returns:
        The file.

    Raises:
        FileNotFoundError: If the folder holds no finished run.
        ValueError: If its table is damaged.

    Example:
        >>> import tempfile
        >>> from fovden.results import Run
        >>> with Run(tempfile.mkdtemp(), {}) as run:
        ...     for samples in (1, 4, 16, 64):
        ...         row = Measurement("box", 0, "", "sobol", f"{samples} spp", "noise", 1 / samples)
        ...         run.measurements.append(row)
        >>> draw_convergence(run.folder).name
        'convergence.png'
    """
    measurements = read_metrics(folder)
    noises = [row for row in measurements if row.metric == "noise"]
    scenes, samplers = (
        list(dict.fromkeys(names)) for names in zip(*((r.scene, r.method) for r in noises), strict=True)
    )
    path = Path(folder) / "convergence.png"
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 2.3), layout="constrained")
        for panel, scene in zip(figure.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
            _draw_scene(panel, measurements, scene, samplers)
        save_figure(figure, path, 1.0)
    return path


def _draw_scene(panel: Any, measurements: Sequence[Measurement], scene: str, samplers: Sequence[str]) -> None:
    for sampler in samplers:
        noise = noise_by_samples(measurements, scene, sampler)
        style = STYLES.get(sampler) or method_style(sampler)
        label = f"{sampler}: slope {convergence_slope(noise):.2f}"
        options = {"color": style.colour, "marker": style.marker, "markersize": 3, "linewidth": 1}
        panel.plot(list(noise), list(noise.values()), label=label, **options)
    samples = list(noise_by_samples(measurements, scene, samplers[0]).items())
    (first, start), (last, _) = samples[0], samples[-1]
    panel.plot([first, last], [start, start * (first / last) ** 0.5], color=FAINT, linewidth=0.6, linestyle=":")
    panel.set_xscale("log", base=2)
    panel.set_yscale("log")
    panel.xaxis.set_major_formatter(FuncFormatter(lambda samples, _: f"{samples:g}"))
    panel.grid(color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    panel.tick_params(which="both", length=2)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    panel.set_title(scene, loc="left")
    panel.set_xlabel("samples per pixel")
    if panel.get_subplotspec().is_first_col():
        panel.set_ylabel("noise / mean radiance")
    panel.legend(frameon=False, fontsize=SMALL, loc="lower left")
