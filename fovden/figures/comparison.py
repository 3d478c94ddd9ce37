"""The figures of a comparison: images beside their errors, enlarged parts, and scores.

Every picture is shown at one exposure, the scene's, with the sRGB curve; errors are differences of what is shown, as
the root mean square over R, G and B, on one scale for all methods.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

import torch
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from fovden import color
from fovden.checks import require
from fovden.comparison import SavedComparison, read_comparison
from fovden.figures.quantities import (
    aspect_of,
    describe,
    display_of,
    error_limit,
    error_of,
    eye_name,
    value_of,
)
from fovden.figures.scores import draw_scores
from fovden.figures.style import (
    FAINT,
    INK,
    MARK,
    SMALL,
    TEXT,
    drawing,
    heading,
    note,
    outlined,
    panels,
    save_figure,
    show_error,
    show_image,
    title,
)

__all__ = ["draw_figures"]

CROP_PIXELS = 64  # side of an enlarged part, at most, and a quarter of the image at most
CROP_INCHES = 0.75
BAR_INCHES = 0.5  # room for a colour bar beside the panels
DASHES = ("-", (0, (5, 2)), (0, (2, 2)))  # of the circles, from the inside out
ERROR_LABEL = "error: RMS over R, G, B of display values"
KEY = "numbers: foveation layers; cross: gaze"


class _Part(NamedTuple):
    """A part of an image that is worth enlarging."""

    layer: int
    x: int
    y: int
    size: int


def draw_figures(folder: str | os.PathLike[str], only: Collection[str] | None = None) -> list[Path]:
    """Draws the figures of a comparison into its subfolder ``figures``.

    ``overview.png`` has both eyes: noisy with the gaze and the layers' circles, NH3LD, reference, error.
    ``methods_left.png`` and ``methods_right.png`` have every method of one eye with its error map,
    ``details_left.png`` and ``details_right.png`` enlarged parts of each layer, ``scores.png`` quality and cost.
    Each states its exposure, also in the file (see :func:`fovden.preview.png_info`).

    Args:
        folder: The folder that :func:`fovden.comparison.compare_denoisers` wrote.
        only: Names of the figures to draw, without their ending; ``None`` for all.

    Returns:
        The files.

    Raises:
        FileNotFoundError: If a file of the comparison is missing.
        ValueError: If one is damaged, or ``only`` has a name that no figure has.

    Example:
        >>> import tempfile
        >>> from fovden.comparison import CompareSettings, SceneSettings, compare_denoisers
        >>> view, folder = SceneSettings("cornell_box", resolution=(16, 16)), tempfile.mkdtemp()
        >>> _ = compare_denoisers(CompareSettings(view, reference_spp=2, repeats=1), folder, progress=False)
        >>> [path.name for path in draw_figures(folder, only=["overview"])]
        ['overview.png']
    """
    folder = Path(folder)
    saved = read_comparison(folder)
    target = folder / "figures"
    drawings: dict[str, Callable[[], Figure]] = {"overview": lambda: _overview(saved)}
    views = saved.foveated.view_count
    eyes = ("left", "right") if views == 2 else tuple(map(str, range(views)))
    for view, eye in enumerate(eyes):
        drawings[f"methods_{eye}"] = lambda view=view: _methods(saved, view)  # type: ignore[misc]
    for view, eye in enumerate(eyes):
        drawings[f"details_{eye}"] = lambda view=view: _details(saved, view)  # type: ignore[misc]
    drawings["scores"] = lambda: draw_scores(saved)
    names = list(drawings) if only is None else list(only)
    for name in names:
        require(name in drawings, "only", repr(name), f"names among {', '.join(drawings)}")
    target.mkdir(exist_ok=True)
    paths = []
    with drawing():
        for name in names:
            path = target / f"{name}.png"
            save_figure(drawings[name](), path, saved.exposure)
            paths.append(path)
    return paths


def _overview(saved: SavedComparison) -> Figure:
    columns = {"Noisy, foveated": "Noisy, foveated", "NH3LD": "Denoised, NH3LD", "Reference": "Reference"}
    views = saved.foveated.view_count
    figure, grid = panels([(int(view == 0), 1) for view in range(views)], 4, aspect_of(saved), right=BAR_INCHES)
    limit, errors = error_limit(saved), error_of(saved, "NH3LD")
    image: Any = None
    for view, row in enumerate(grid):
        for panel, (name, text) in zip(row, columns.items(), strict=False):
            show_image(panel, display_of(saved, name)[view])
            note(panel, _scores_text(saved, name, view))
            if view == 0:
                title(panel, text, name)
        row[0].set_ylabel(eye_name(saved, view), fontsize=TEXT, labelpad=3)
        _draw_layers(row[0], saved, view)
        image = show_error(row[3], errors[view, 0], limit)
        note(row[3], f"mean error {float(errors[view].mean()):.3f}")
    title(grid[0][3], "Error of NH3LD")
    width = figure.get_figwidth()
    bottom, top = grid[-1][0].get_position().y0, grid[0][0].get_position().y1
    axes = figure.add_axes(((width - BAR_INCHES + 0.07) / width, bottom, 0.1 / width, top - bottom))
    _finish_bar(figure.colorbar(image, cax=axes, extend="max", extendfrac=0.02), ERROR_LABEL)
    heading(figure, f"{describe(saved)}; {KEY}" if saved.foveated.gaze is not None else describe(saved))
    return figure


def _methods(saved: SavedComparison, view: int) -> Figure:
    names = [*saved.images, "Reference"]
    per_row = 4
    rows = -(-len(names) // per_row)
    figure, grid = panels([(1, 1), (0, 0)] * rows, per_row, aspect_of(saved), left=0.02)
    limit = error_limit(saved)
    image: Any = None
    for panel in (panel for row in grid for panel in row):
        panel.set_visible(False)
    for number, name in enumerate(names):
        row, column = divmod(number, per_row)
        above, below = grid[2 * row][column], grid[2 * row + 1][column]
        above.set_visible(True)
        show_image(above, display_of(saved, name)[view])
        title(above, name, name)
        note(above, _scores_text(saved, name, view))
        if name != "Reference":
            below.set_visible(True)
            image = show_error(below, error_of(saved, name)[view, 0], limit)
            continue
        for part in _parts(saved, view):
            corner = (part.x - 0.5, part.y - 0.5)
            for colour, width in ((INK, 1.8), (MARK, 0.9)):
                above.add_patch(Rectangle(corner, part.size, part.size, fill=False, edgecolor=colour, linewidth=width))
        box = below.get_position()
        axes = figure.add_axes((box.x0 + 0.06 * box.width, box.y1 - 0.1 * box.height, 0.86 * box.width, 0.011))
        _finish_bar(
            figure.colorbar(image, cax=axes, extend="max", extendfrac=0.03, orientation="horizontal"),
            ERROR_LABEL.replace("B of", "B\nof"),
        )
        key = "images above,\ntheir errors below\n\nsquares: enlarged\nin the details"
        figure.text(box.x0 + 0.06 * box.width, box.y1 - 0.45 * box.height, key, fontsize=SMALL, color=FAINT, va="top")
    heading(figure, f"{describe(saved)}; {eye_name(saved, view)}")
    return figure


def _details(saved: SavedComparison, view: int) -> Figure:
    names = [*saved.images, "Reference"]
    parts = _parts(saved, view)
    lines = [(2 if row == 0 else 0, 0) for row in range(len(parts))]
    figure, grid = panels(lines, len(names), 1.0, left=0.42, width=CROP_INCHES)
    for row, part in enumerate(parts):
        inside = (slice(None), slice(part.y, part.y + part.size), slice(part.x, part.x + part.size))
        for panel, name in zip(grid[row], names, strict=True):
            show_image(panel, display_of(saved, name)[view][inside], interpolation="nearest")
            if row == 0:
                title(panel, name.replace(", ", ",\n"), name)
        grid[row][0].set_ylabel(f"layer {part.layer}\nx {part.x}, y {part.y} px", fontsize=SMALL, labelpad=3)
    size = parts[0].size
    heading(figure, f"{describe(saved)}; {eye_name(saved, view)}; parts of {size} x {size} pixels")
    return figure


def _finish_bar(bar: Any, label: str) -> None:
    bar.set_label(label, fontsize=SMALL, labelpad=3)
    bar.ax.tick_params(length=2, pad=1.5)
    bar.outline.set_visible(False)


def _draw_layers(panel: Any, saved: SavedComparison, view: int) -> None:
    gaze = saved.foveated.gaze
    if gaze is None:
        return
    height, width = saved.foveated.resolution
    x, y = (float(value) - 0.5 for value in gaze.pixels[view])  # matplotlib counts from the first pixel's centre
    for colour, line, size in ((INK, 2.4, 8), (MARK, 1.0, 7)):
        panel.plot([x], [y], "+", color=colour, markersize=size, markeredgewidth=line)
    for number, radius in enumerate(saved.radii):
        dash = DASHES[min(number, len(DASHES) - 1)]
        for colour, line, style in ((INK, 2.0, "-"), (MARK, 1.1, dash)):
            ring = Circle((x, y), radius, fill=False, edgecolor=colour, linewidth=line, linestyle=style)
            panel.add_patch(ring)
    inner = (0.0, *saved.radii)
    for number, radius in enumerate(inner):
        outer = inner[number + 1] if number + 1 < len(inner) else radius + (radius - inner[number - 1])
        panel.text(
            x, y - (radius + outer) / 2, str(number), color=MARK, fontsize=TEXT, fontweight="bold", ha="center",
            va="center", path_effects=outlined(), clip_on=True,
        )  # fmt: skip
    panel.set_xlim(-0.5, width - 0.5)
    panel.set_ylim(height - 0.5, -0.5)


def _parts(saved: SavedComparison, view: int) -> list[_Part]:
    """Parts to enlarge: for each layer the one that differs most within itself."""
    height, width = saved.foveated.resolution
    size = max(1, min(CROP_PIXELS, height // 4, width // 4))
    layer = saved.foveated.layer[view : view + 1].float()
    shown = color.luminance(display_of(saved, "Reference")[view : view + 1])
    step = max(1, size // 4)
    mean = torch.nn.functional.avg_pool2d(shown, size, step)
    spread = torch.nn.functional.avg_pool2d(shown.square(), size, step) - mean.square()
    parts = []
    for number in sorted(set(saved.foveated.layer[view].flatten().tolist())):
        inside = torch.nn.functional.avg_pool2d((layer == number).float(), size, step)
        score = (spread + 1e-6) * (inside >= 0.999 * inside.max())
        row, column = divmod(int(score.argmax()), score.shape[-1])
        parts.append(_Part(int(number), column * step, row * step, size))
    return parts


def _scores_text(saved: SavedComparison, name: str, view: int) -> str:
    if name == "Reference":
        return f"{saved.reference.count} samples per pixel"
    psnr, ssim = (value_of(saved, name, metric, view=view) for metric in ("psnr", "ssim"))
    return f"PSNR {psnr:.2f} dB, SSIM {ssim:.4f}"
