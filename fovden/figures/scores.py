"""Scores of a comparison: quality in each layer, and where the time goes."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fovden.comparison import SavedComparison
from fovden.figures.quantities import describe, value_of
from fovden.figures.style import BACKGROUND, FAINT, GRID, INK, PRINT_WIDTH, SMALL, TEXT, heading, method_style
from fovden.metrics import METRICS

__all__ = ["QUALITY", "STAGES"]

QUALITY = ("psnr", "ssim", "flip")
"""Metrics that are drawn where the results have them."""

STAGES = {
    "seconds_gbuffer": ("G-buffer", "....."),
    "seconds_paths": ("paths", ""),
    "seconds_denoise": ("denoising", "/////"),
}
"""What the time is spent on, with label and hatch."""

ROW_INCHES = 0.36
WHOLE, FIRST, LAST = 0.26, 0.04, -0.36  # heights of the marks within a method's row
LEGEND: dict[str, Any] = {
    "frameon": False, "borderpad": 0.1, "handletextpad": 0.5,
    "columnspacing": 1.2, "borderaxespad": 0.1,
}  # fmt: skip


def draw_scores(saved: SavedComparison) -> Figure:
    """Quality over the whole image and in each layer, and the seconds of each stage; one row for each method."""
    measured = {row.method for row in saved.measurements}
    methods = [name for name in saved.images if name in measured]
    metrics = [name for name in QUALITY if any(row.metric == name for row in saved.measurements)]
    places = list(range(len(methods)))[::-1]
    figure = Figure(figsize=(PRINT_WIDTH, ROW_INCHES * len(methods) + 1.05), layout="constrained")
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - 0.4 / figure.get_figheight()))
    grid = figure.subplots(1, len(metrics) + 1, sharey=True, width_ratios=[*[1] * len(metrics), 1.25])
    for panel, metric in zip(grid, metrics, strict=False):
        _draw_quality(panel, saved, metric, methods, places)
    _draw_time(grid[-1], saved, methods, places)
    grid[0].set_yticks(places, methods)
    grid[0].set_ylim(-0.6, len(methods) - 0.4)
    for panel in grid:
        panel.tick_params(length=2)
        panel.tick_params(axis="y", length=0)
        panel.grid(axis="x", color=GRID, linewidth=0.5)
        panel.set_axisbelow(True)
        for side in ("top", "right", "left"):
            panel.spines[side].set_visible(False)
        for place in places[:-1]:
            panel.axhline(place - 0.5, color=GRID, linewidth=0.5)
    grid[0].tick_params(axis="y", pad=13)
    for place, method in zip(places, methods, strict=True):
        options = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "annotation_clip": False}
        style = method_style(method)
        grid[0].annotate(
            style.glyph, (0, place), (-7, 0), color=style.colour, fontsize=TEXT, ha="center", va="center", **options
        )
    heading(figure, f"{describe(saved)}; means of the views")
    return figure


def _draw_quality(panel: Any, saved: SavedComparison, metric: str, methods: list[str], places: list[int]) -> None:
    regions = list(dict.fromkeys(row.region for row in saved.measurements if row.metric == metric))
    layers = [region for region in regions if region != "whole"]
    for place, method in zip(places, methods, strict=True):
        style = method_style(method)
        whole = value_of(saved, method, metric)
        panel.plot([whole], [place + WHOLE], marker=style.marker, color=style.colour, markersize=5)
        for height, region in enumerate(layers):
            number = region.removeprefix("layer ")
            value = value_of(saved, method, metric, region=region)
            panel.plot(
                [value],
                [place + FIRST + (LAST - FIRST) * height / max(1, len(layers) - 1)],
                marker=f"${number}$",
                color=style.colour,
                markersize=4,
                markeredgewidth=0.3,
            )
    panel.set_xlabel(f"{METRICS[metric].title}\n{METRICS[metric].better} is better")
    if metric == QUALITY[0]:
        marks = [
            Line2D([], [], marker="o", color=FAINT, markersize=4, linestyle="none", label="whole image"),
            Line2D([], [], marker="$0$", color=FAINT, markersize=4, linestyle="none", label="its layers"),
        ]
        panel.legend(handles=marks, ncols=2, loc="lower left", bbox_to_anchor=(0, 1), **LEGEND).set_in_layout(False)


def _draw_time(panel: Any, saved: SavedComparison, methods: list[str], places: list[int]) -> None:
    ends = []
    for place, method in zip(places, methods, strict=True):
        end, colour = 0.0, method_style(method).colour
        for metric, (_, hatch) in STAGES.items():
            seconds = value_of(saved, method, metric)
            options = {"color": colour, "edgecolor": BACKGROUND, "hatch": hatch, "linewidth": 0.6, "height": 0.5}
            panel.barh([place], [seconds], left=[end], **options)
            end += seconds
        paths = value_of(saved, method, "paths") / 1e6
        panel.text(end, place, f" {paths:.2f} M paths", va="center", fontsize=SMALL, color=INK)
        ends.append(end)
    panel.set_xlim(0, 1.55 * max((end for end in ends if math.isfinite(end)), default=1.0) or 1.0)
    panel.set_xlabel("time / s\nboth eyes")
    keys = [
        Patch(facecolor=FAINT, edgecolor=BACKGROUND, hatch=hatch, linewidth=0.6, label=label)
        for label, hatch in STAGES.values()
    ]
    panel.legend(handles=keys, ncols=3, loc="lower right", bbox_to_anchor=(1, 1), **LEGEND).set_in_layout(False)
