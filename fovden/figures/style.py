"""The look of every figure: sizes, colours, and panels of equal size.

A figure is drawn at the width at which it is printed, so that a size in points is what the reader sees. A method has
one colour and one mark wherever it occurs. The colours are Okabe and Ito's, of which those of any two methods lie at
least 15 apart in CIE Lab (CIE 1976 difference), for normal sight and for simulated protanopia, deuteranopia and
tritanopia; in greyscale the marks tell methods apart. Errors are in "magma", whose lightness rises evenly.

Source of the colours: M. Okabe and K. Ito, "Color universal design", 2008; as listed by B. Wong, "Points of view: color
blindness", Nature Methods 8, 2011.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.style
import torch
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from torch import Tensor

from fovden.colormap import NO_VALUE
from fovden.io import atomic_write
from fovden.preview import png_info, to_levels

__all__ = ["METHOD_STYLES", "PRINT_WIDTH", "MethodStyle", "drawing", "method_style"]

PRINT_WIDTH = 7.0
"""Width of a figure in inches: the text of a two-column page, such as ACM's and IEEE's."""

DPI = 256  # pixels per inch: 3 of them for a pixel of a detail, and sharp in print
TEXT, SMALL = 7.0, 6.0  # points; journals ask for no less than 6
BACKGROUND, INK, FAINT, GRID = "#ffffff", "#1a1a1a", "#5a5a5a", "#d0d0d0"
MARK = "#f0e442"  # Okabe and Ito's yellow, for marks upon images, with a dark line on both sides
ERRORS = colormaps["magma"].with_extremes(bad=tuple(level / 255 for level in NO_VALUE))
GAP = 0.06  # inches between panels
LINE = 0.15  # inches that a line of text takes


class MethodStyle(NamedTuple):
    """How a method is drawn.

    Attributes:
        colour: As "#rrggbb".
        marker: Name of the mark in matplotlib.
        glyph: The same mark as a character.

    Example:
        >>> MethodStyle("#0072b2", "o", "\u25cf").marker
        'o'
    """

    colour: str
    marker: str
    glyph: str


METHOD_STYLES = {
    "Noisy, full": MethodStyle("#4d4d4d", "X", "\u2716"),
    "Noisy, foveated": MethodStyle("#cc79a7", "P", "\u271a"),
    "Mask ignored": MethodStyle("#d55e00", "v", "\u25bc"),
    "Base": MethodStyle("#56b4e9", "s", "\u25a0"),
    "NH2LD": MethodStyle("#e69f00", "^", "\u25b2"),
    "NH3LD": MethodStyle("#0072b2", "o", "\u25cf"),
    "Base, equal paths": MethodStyle("#009e73", "D", "\u25c6"),
    "Reference": MethodStyle("#000000", "*", "\u2605"),
}
"""Colour and mark of the methods of :data:`fovden.comparison.METHODS` and of the reference, by name."""

OTHER_COLOURS = tuple(style.colour for name, style in METHOD_STYLES.items() if name != "Reference")
OTHER_MARKS = (("<", "\u25c0"), (">", "\u25b6"), ("p", "\u2b1f"), ("h", "\u2b22"))

# Beside the sizes, everything is matplotlib's own default, whatever the user's settings are.
SETTINGS: dict[str, Any] = {
    "font.size": TEXT,
    "axes.labelsize": TEXT,
    "axes.titlesize": TEXT,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "legend.fontsize": SMALL,
    "hatch.linewidth": 0.6,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.edgecolor": FAINT,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "figure.facecolor": BACKGROUND,
    "axes.facecolor": BACKGROUND,
    "savefig.facecolor": BACKGROUND,
    "pdf.fonttype": 42,  # text stays text
    "svg.fonttype": "none",
}


def method_style(name: str) -> MethodStyle:
    """Returns how a method is drawn, the same wherever and whenever it is.

    A name that is not in :data:`METHOD_STYLES` gets a colour of theirs with a mark that none of them has, chosen by the
    name's checksum; two such names may get the same.

    Args:
        name: The method's name.

    Returns:
        Its style.

    Example:
        >>> method_style("NH3LD").colour, method_style("another") == method_style("another")
        ('#0072b2', True)
    """
    if name in METHOD_STYLES:
        return METHOD_STYLES[name]
    number = zlib.crc32(name.encode("utf-8"))
    marker, glyph = OTHER_MARKS[number // len(OTHER_COLOURS) % len(OTHER_MARKS)]
    return MethodStyle(OTHER_COLOURS[number % len(OTHER_COLOURS)], marker, glyph)


@contextmanager
def drawing() -> Iterator[None]:
    """Draws what is made within the block in the project's style, whatever the user's settings of matplotlib are.

    They apply again afterwards. As they belong to the whole process, figures are not to be drawn in several threads.

    Example:
        >>> with drawing():
        ...     figure = Figure(figsize=(PRINT_WIDTH, 2))
        >>> figure.get_facecolor()
        (1.0, 1.0, 1.0, 1.0)
    """
    with matplotlib.style.context(["default", SETTINGS]):
        yield


def save_figure(figure: Figure, path: Path, exposure: float) -> None:
    """Writes a figure as PNG that states its colour space and exposure, whole or not at all."""
    with atomic_write(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI, pil_kwargs={"pnginfo": png_info(exposure)})


def panels(
    rows: Sequence[tuple[int, int]],
    columns: int,
    aspect: float,
    *,
    left: float = 0.2,
    right: float = 0.02,
    top: float = 0.26,
    width: float | None = None,
) -> tuple[Figure, list[list[Any]]]:
    """A figure and rows of panels of equal size, without ticks and frames, on whole pixels.

    ``rows`` says how many lines of text each has above and below; ``width`` is a panel's, inches, where it is not to
    fill the figure; the rest are margins in inches.
    """
    gap = _whole(GAP)
    width = _whole((PRINT_WIDTH - left - right - (columns - 1) * gap) / columns if width is None else width)
    height = _whole(width * aspect)
    total_width = _whole(left + columns * width + (columns - 1) * gap + right)
    texts = [(_whole(LINE * above), _whole(LINE * below)) for above, below in rows]
    total_height = _whole(top) + sum(above + height + below + gap for above, below in texts)
    figure = Figure(figsize=(total_width, total_height))
    made: list[list[Any]] = []
    y = total_height - _whole(top)
    for above, below in texts:
        y -= above + height
        row = []
        for column in range(columns):
            x = _whole(left) + column * (width + gap)
            panel = figure.add_axes((x / total_width, y / total_height, width / total_width, height / total_height))
            panel.set_xticks([])
            panel.set_yticks([])
            for spine in panel.spines.values():
                spine.set_visible(False)
            row.append(panel)
        made.append(row)
        y -= below + gap
    return figure, made


def show_image(panel: Any, image: Tensor, **options: Any) -> None:
    """Draws one display-encoded view, shape (3, h, w), with what is not finite in the signal colour."""
    panel.imshow(to_levels(image[None]).numpy(), **options)


def show_error(panel: Any, error: Tensor, limit: float) -> Any:
    """Draws one error map, shape (h, w), and returns what a colour bar needs."""
    return panel.imshow(error.masked_fill(~torch.isfinite(error), torch.nan).numpy(), cmap=ERRORS, vmin=0, vmax=limit)


def title(panel: Any, text: str, method: str | None = None) -> None:
    """Writes a title above the left edge of a panel, after the mark of a method if there is one."""
    options: dict[str, Any] = {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "annotation_clip": False,
        "parse_math": False,
    }
    lift, indent = 2.5, 0.0
    if method is not None:
        style = method_style(method)
        panel.annotate(style.glyph, (0, 1), (0, lift), color=style.colour, fontsize=TEXT, **options)
        indent = 8.5
    panel.annotate(text, (0, 1), (indent, lift), color=INK, fontsize=TEXT, linespacing=1.0, **options)


def note(panel: Any, text: str) -> None:
    """Writes a line below a panel."""
    panel.set_xlabel(text, color=FAINT, fontsize=SMALL, labelpad=2, parse_math=False)


def heading(figure: Figure, text: str) -> None:
    """Writes a line across the top of a figure."""
    y = 1 - 0.12 / figure.get_figheight()
    figure.text(0.5, y, text, color=INK, fontsize=TEXT, ha="center", va="center", parse_math=False)


def outlined(width: float = 1.4) -> list[Any]:
    """A dark rim around what is drawn upon an image."""
    return [withStroke(linewidth=width, foreground=INK)]


def _whole(inches: float) -> float:
    """A length as a whole number of pixels."""
    return round(inches * DPI) / DPI
