"""Figures of a comparison, drawn from the files in its folder and nothing else, so that they can be redrawn.

Every picture is shown at one exposure, the scene's, with the sRGB curve; errors are differences of what is shown, as
the root mean square over R, G and B, in the perceptually uniform and colour-blind safe map "magma".
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from torch import Tensor

from fovden import color
from fovden.checks import require, require_shapes
from fovden.comparison import METHODS, file_name
from fovden.frame import Frame, Reference
from fovden.io import atomic_write, load_frame, load_image, load_reference
from fovden.results import Measurement, read_metrics

__all__ = ["draw_figures", "error_map"]

DPI = 150
PANEL_INCHES = 2.9  # width of one panel
BACKGROUND, INK, FAINT = "#f2f2f2", "#222222", "#777777"
LAYER_COLOURS = ("#56b4e9", "#e69f00", "#009e73")  # Okabe and Ito's palette, distinct for the colour-blind
ERROR_SHARE = 0.995  # share of each denoised image's pixels that the error scale covers
CROP_PIXELS = 64  # side of an enlarged part, at most, and a quarter of the image at most
BAR_INCHES = 0.95  # room for a colour bar


class _Results(NamedTuple):
    """What is in a run's folder."""

    scene: str
    images: dict[str, Tensor]
    reference: Reference
    foveated: Frame
    exposure: float
    radii: tuple[float, ...]
    measurements: list[Measurement]


def error_map(image: Tensor, reference: Tensor, exposure: float) -> Tensor:
    """Returns how far an image is from its reference in every pixel, as a display shows them.

    Args:
        image: Linear radiance, shape (v, 3, h, w).
        reference: Linear radiance, the same shape.
        exposure: Scale from radiance to the display.

    Returns:
        Root mean square over the channels of the difference of the display values, in [0, 1], shape (v, 1, h, w).

    Raises:
        ShapeError: If the shapes differ.

    Example:
        >>> error_map(torch.zeros(1, 3, 1, 2), torch.full((1, 3, 1, 2), 9.0), exposure=1.0)
        tensor([[[[1., 1.]]]])
    """
    require_shapes("v 3 h w", image=image, reference=reference)
    difference = color.display(image, exposure) - color.display(reference, exposure)
    return difference.square().mean(1, keepdim=True).sqrt()


def draw_figures(folder: str | os.PathLike[str]) -> list[Path]:
    """Draws the figures of a comparison into its subfolder ``figures``.

    ``overview.png`` has both eyes: noisy with the gaze and the layers' circles, NH3LD, reference, error.
    ``methods_left.png`` and ``methods_right.png`` have every method of one eye with its error map,
    ``details_left.png`` and ``details_right.png`` enlarged parts of each layer, ``scores.png`` quality and cost.

    Args:
        folder: The folder that :func:`fovden.comparison.compare_denoisers` wrote.

    Returns:
        The files.

    Raises:
        FileNotFoundError: If a file of the comparison is missing.
        ValueError: If one is damaged.

    Example:
        >>> import tempfile
        >>> from fovden.comparison import CompareSettings, SceneSettings, compare_denoisers
        >>> view, folder = SceneSettings("cornell_box", resolution=(16, 16)), tempfile.mkdtemp()
        >>> _ = compare_denoisers(CompareSettings(view, reference_spp=2, repeats=1), folder, progress=False)
        >>> [path.name for path in draw_figures(folder)][:2]
        ['overview.png', 'methods_left.png']
    """
    folder = Path(folder)
    results = _read_results(folder)
    target = folder / "figures"
    target.mkdir(exist_ok=True)
    drawings: dict[str, Callable[[], Figure]] = {"overview": lambda: _overview(results)}
    eyes = (
        ("left", "right") if results.foveated.view_count == 2 else tuple(map(str, range(results.foveated.view_count)))
    )
    for view, eye in enumerate(eyes):
        drawings[f"methods_{eye}"] = lambda view=view: _methods(results, view)  # type: ignore[misc]
    for view, eye in enumerate(eyes):
        drawings[f"details_{eye}"] = lambda view=view: _details(results, view)  # type: ignore[misc]
    drawings["scores"] = lambda: _scores(results)
    paths = []
    for name, draw in drawings.items():
        path = target / f"{name}.png"
        with atomic_write(path) as temporary:
            draw().savefig(temporary, format="png", dpi=DPI, facecolor=BACKGROUND)
        paths.append(path)
    return paths


def _read_results(folder: Path) -> _Results:
    measurements = read_metrics(folder)
    single = {(row.method, row.region, row.metric): row.value for row in measurements if row.view == ""}
    key = ("Reference", "whole", "exposure")
    require(key in single, str(folder / "metrics.csv"), "a table without exposure", "the results of a comparison")
    frames = {name: load_frame(folder / "frames" / f"{name}.exr") for name in sorted({m.frame for m in METHODS})}
    images = {
        method.name: frames[method.frame].radiance
        if method.denoiser is None
        else load_image(folder / "images" / f"{file_name(method.name)}.exr")
        for method in METHODS
    }
    radii = tuple(row.value for row in measurements if (row.method, row.metric) == ("Foveation", "radius"))
    reference = load_reference(folder / "reference.exr")
    scene = measurements[0].scene
    return _Results(scene, images, reference, frames["foveated"], single[key], radii, measurements)


def _overview(results: _Results) -> Figure:
    columns = ("Noisy, foveated", "NH3LD", "Reference")
    views, aspect = results.foveated.view_count, _aspect(results)
    figure, panels = _panels([(True, True)] * views, 4, aspect, right=BAR_INCHES)
    vmax = _error_limit(results)
    for view in range(views):
        eye = _eye(view, views)
        for column, name in enumerate(columns):
            panel = panels[view][column]
            _show(panel, _shown(results, name)[view])
            _title(panel, name if view == 0 else "", _scores_text(results, name, view))
            if column == 0:
                panel.set_ylabel(eye, color=INK, fontsize=10)
                _draw_layers(panel, results, view)
        errors = error_map(results.images["NH3LD"], results.reference.mean, results.exposure)
        image = _show_error(panels[view][3], errors[view, 0], vmax)
        _title(panels[view][3], "Error of NH3LD" if view == 0 else "", "")
    _colour_bar(figure, image)
    _heading(figure, results, "circles: borders of the layers; cross: gaze")
    return figure


def _methods(results: _Results, view: int) -> Figure:
    names = [*results.images, "Reference"]
    per_row = 4
    rows = -(-len(names) // per_row)
    figure, panels = _panels([(True, True), (False, False)] * rows, per_row, _aspect(results), right=BAR_INCHES)
    vmax = _error_limit(results)
    for panel in (panel for row in panels for panel in row):
        panel.set_visible(False)
    for number, name in enumerate(names):
        row, column = divmod(number, per_row)
        above, below = panels[2 * row][column], panels[2 * row + 1][column]
        above.set_visible(True)
        _show(above, _shown(results, name)[view])
        _title(above, name, _scores_text(results, name, view))
        if name != "Reference":
            below.set_visible(True)
            errors = error_map(results.images[name], results.reference.mean, results.exposure)
            image = _show_error(below, errors[view, 0], vmax)
    _colour_bar(figure, image)
    _heading(figure, results, f"{_eye(view, results.foveated.view_count)}; below each image its error")
    return figure


def _details(results: _Results, view: int) -> Figure:
    names = [*results.images, "Reference"]
    boxes = _detail_boxes(results, view)
    figure, panels = _panels([(row == 0, False) for row in range(len(boxes))], len(names), 1.0, width=1.7)
    for row, (label, x, y, size) in enumerate(boxes):
        for column, name in enumerate(names):
            panel = panels[row][column]
            _show(panel, _shown(results, name)[view][:, y : y + size, x : x + size], interpolation="nearest")
            _title(panel, name if row == 0 else "", "")
            if column == 0:
                panel.set_ylabel(f"{label}\nx {x}, y {y}", color=INK, fontsize=9)
    size = boxes[0][3]
    _heading(figure, results, f"{_eye(view, results.foveated.view_count)}; parts of {size} x {size} pixels")
    return figure


def _scores(results: _Results) -> Figure:
    """Quality in each region, and where the time goes."""
    rows = results.measurements
    methods = [name for name in results.images if any(row.method == name for row in rows)]
    regions = list(dict.fromkeys(row.region for row in rows if row.metric == "ssim"))

    def value(method: str, metric: str, region: str = "whole") -> float:
        found = [r.value for r in rows if (r.method, r.metric, r.region) == (method, metric, region)]
        return sum(found) / len(found) if found else float("nan")

    figure = Figure(figsize=(12, 0.42 * len(methods) + 1.9), layout="constrained")
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - 0.35 / figure.get_figheight()))
    left, middle, right = figure.subplots(1, 3, sharey=True)
    places = list(range(len(methods)))[::-1]
    for panel, metric, title in ((left, "psnr", "PSNR / dB"), (middle, "ssim", "SSIM")):
        for region, colour, marker in zip(regions, (INK, *LAYER_COLOURS), "os^D", strict=False):
            values = [value(method, metric, region) for method in methods]
            panel.plot(values, places, marker, color=colour, label=region, markersize=6, linestyle="none")
        panel.set_xlabel(f"{title}, more is better")
        panel.grid(axis="x", color="#cccccc")
        panel.set_axisbelow(True)
    left.set_yticks(places, methods)
    left.set_ylim(-0.6, len(methods) - 0.4)
    middle.legend(fontsize=8, framealpha=0.9)
    offsets = [0.0] * len(methods)
    stages = (("seconds_gbuffer", "G-buffer"), ("seconds_paths", "paths"), ("seconds_denoise", "denoising"))
    for (metric, label), colour in zip(stages, LAYER_COLOURS, strict=True):
        values = [value(method, metric) for method in methods]
        right.barh(places, values, left=offsets, color=colour, label=label, height=0.6)
        offsets = [offset + seconds for offset, seconds in zip(offsets, values, strict=True)]
    for place, method, offset in zip(places, methods, offsets, strict=True):
        right.text(offset, place, f" {value(method, 'paths') / 1e6:.2f} M paths", va="center", fontsize=8, color=INK)
    right.set_xlim(0, 1.35 * max(offsets))
    right.set_xlabel("time / s, both eyes")
    right.legend(fontsize=8, framealpha=0.9)
    for panel in (left, middle, right):
        panel.set_facecolor("white")
    _heading(figure, results, "mean of the views")
    return figure


def _panels(
    rows: Sequence[tuple[bool, bool]], columns: int, aspect: float, *, width: float = PANEL_INCHES, right: float = 0.1
) -> tuple[Figure, list[list[Any]]]:
    """A figure and rows of panels of equal size; ``rows`` says which have a title above, and scores below."""
    left, top, gap, text = 0.42, 0.42, 0.07, 0.27  # inches
    height = width * aspect
    total_width = left + columns * (width + gap) + right
    total_height = top + sum(height + gap + text * (title + scores) for title, scores in rows) + 0.05
    figure = Figure(figsize=(total_width, total_height))
    panels: list[list[Any]] = []
    y = total_height - top
    for title, scores in rows:
        y -= height + text * title
        row = []
        for column in range(columns):
            x = left + column * (width + gap)
            panel = figure.add_axes((x / total_width, y / total_height, width / total_width, height / total_height))
            panel.set_xticks([])
            panel.set_yticks([])
            for spine in panel.spines.values():
                spine.set_visible(False)
            row.append(panel)
        panels.append(row)
        y -= gap + text * scores
    return figure, panels


def _show(panel: Any, image: Tensor, **options: Any) -> None:
    panel.imshow(image.permute(1, 2, 0).numpy(), **options)


def _show_error(panel: Any, error: Tensor, vmax: float) -> Any:
    return panel.imshow(error.numpy(), cmap="magma", vmin=0, vmax=vmax)


def _title(panel: Any, title: str, scores: str) -> None:
    panel.set_title(title, color=INK, fontsize=10, loc="left")
    panel.set_xlabel(scores, color=FAINT, fontsize=8)


def _heading(figure: Figure, results: _Results, note: str) -> None:
    height, width = results.foveated.resolution
    text = f"{results.scene}, {width} x {height} per eye, exposure {results.exposure:.3g}, sRGB; {note}"
    figure.text(0.5, 1 - 0.2 / figure.get_figheight(), text, color=INK, fontsize=10, ha="center", va="center")


def _colour_bar(figure: Figure, image: Any) -> None:
    width = figure.get_figwidth()
    axes = figure.add_axes(((width - BAR_INCHES + 0.12) / width, 0.15, 0.14 / width, 0.7))
    bar = figure.colorbar(image, cax=axes, extend="max")
    bar.set_label("error: RMS over R, G, B of the difference of display values", color=INK, fontsize=9)


def _draw_layers(panel: Any, results: _Results, view: int) -> None:
    gaze = results.foveated.gaze
    if gaze is None:
        return
    x, y = (float(value) - 0.5 for value in gaze.pixels[view])  # matplotlib counts from the first pixel's centre
    panel.plot([x], [y], "+", color="white", markersize=12, markeredgewidth=2.6)
    panel.plot([x], [y], "+", color=INK, markersize=11, markeredgewidth=1.2)
    for radius, colour in zip(results.radii, LAYER_COLOURS, strict=False):
        for width, line in ((2.4, "white"), (1.4, colour)):
            panel.add_patch(Circle((x, y), radius, fill=False, edgecolor=line, linewidth=width))
    height, width = results.foveated.resolution
    panel.set_xlim(-0.5, width - 0.5)
    panel.set_ylim(height - 0.5, -0.5)


def _detail_boxes(results: _Results, view: int) -> Sequence[tuple[str, int, int, int]]:
    """Parts to enlarge: for each layer the one that differs most within itself, (label, left, top, size)."""
    height, width = results.foveated.resolution
    size = max(1, min(CROP_PIXELS, height // 4, width // 4))
    layer = results.foveated.layer[view : view + 1].float()
    shown = color.luminance(_shown(results, "Reference")[view : view + 1])
    step = max(1, size // 4)
    mean = torch.nn.functional.avg_pool2d(shown, size, step)
    spread = torch.nn.functional.avg_pool2d(shown.square(), size, step) - mean.square()
    boxes = []
    for number in sorted(set(results.foveated.layer[view].flatten().tolist())):
        inside = torch.nn.functional.avg_pool2d((layer == number).float(), size, step)
        score = (spread + 1e-6) * (inside >= 0.999 * inside.max())
        index = int(score.argmax())
        row, column = divmod(index, score.shape[-1])
        boxes.append((f"layer {int(number)}", column * step, row * step, size))
    return boxes


def _shown(results: _Results, name: str) -> Tensor:
    image = results.reference.mean if name == "Reference" else results.images[name]
    return color.display(image, results.exposure)


def _error_limit(results: _Results) -> float:
    """One error scale for all methods: it covers nearly all pixels of the denoised images."""
    denoised = [method.name for method in METHODS if method.denoiser is not None and not method.ignore_mask]
    limits = []
    for name in denoised:
        errors = error_map(results.images[name], results.reference.mean, results.exposure).flatten()
        limits.append(float(errors.sort().values[int(ERROR_SHARE * (len(errors) - 1))]))
    return max(1e-3, *limits)


def _scores_text(results: _Results, name: str, view: int) -> str:
    if name == "Reference":
        return f"{results.reference.count} samples per pixel"
    found: Mapping[str, float] = {
        row.metric: row.value
        for row in results.measurements
        if (row.method, row.view, row.region) == (name, view, "whole")
    }
    return f"PSNR {found['psnr']:.2f} dB, SSIM {found['ssim']:.4f}"


def _eye(view: int, views: int) -> str:
    return ("left eye", "right eye")[view] if views == 2 else f"view {view}"


def _aspect(results: _Results) -> float:
    height, width = results.foveated.resolution
    return height / width
