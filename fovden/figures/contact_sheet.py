"""Contact sheets: several images side by side in a notebook, all at one exposure."""

from __future__ import annotations

import io as bytes_io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor

from fovden import color
from fovden.checks import require, require_integer, require_number, require_shapes
from fovden.figures.style import BACKGROUND, DPI, METHOD_STYLES, drawing, heading, note, panels, show_image, title
from fovden.io import atomic_write
from fovden.io.files import FilePath
from fovden.preview import finite_exposure, png_info

__all__ = ["ContactSheet", "contact_sheet"]

FORMATS = (".png", ".pdf", ".svg")
NOTEBOOK_DPI = 128  # half of what is saved: as wide as a notebook's page


@dataclass(frozen=True, eq=False)
class ContactSheet:
    """A sheet of labelled images; Jupyter shows it wherever it is a cell's last value.

    Attributes:
        figure: The drawing, to go on with.
        exposure: Scale from radiance to the display that all images are shown with.

    Example:
        >>> sheet = contact_sheet({"noisy": torch.rand(1, 3, 8, 8)}, exposure=1.0)
        >>> sheet.png()[1:4], sheet.exposure
        (b'PNG', 1.0)
    """

    figure: Figure
    exposure: float

    def _repr_png_(self) -> bytes:
        return self.png()

    def png(self) -> bytes:
        """Returns the sheet as a PNG of the size that a notebook shows: for a widget, which takes bytes.

        Example:
            >>> contact_sheet({"noisy": torch.rand(1, 3, 8, 8)}, exposure=1.0).png()[1:4]
            b'PNG'
        """
        buffer = bytes_io.BytesIO()
        with drawing():
            info = {"pnginfo": png_info(self.exposure)}
            self.figure.savefig(buffer, format="png", dpi=NOTEBOOK_DPI, pil_kwargs=info)
        return buffer.getvalue()

    def save(self, path: FilePath) -> None:
        """Writes the sheet as PNG, PDF or SVG, whole or not at all.

        Args:
            path: The file, named ``*.png``, ``*.pdf`` or ``*.svg``; its folder must exist.

        Raises:
            ValueError: If the name ends in something else.
            OSError: If the file cannot be written.

        Example:
            >>> import tempfile
            >>> path = Path(tempfile.mkdtemp()) / "sheet.png"
            >>> contact_sheet({"noisy": torch.rand(1, 3, 8, 8)}).save(path)
            >>> path.read_bytes()[1:4]
            b'PNG'
        """
        path = Path(path)
        ending = path.suffix.lower()
        require(ending in FORMATS, "path", path, f"a name that ends in one of {', '.join(FORMATS)}")
        options: dict[str, Any] = {"pil_kwargs": {"pnginfo": png_info(self.exposure)}} if ending == ".png" else {}
        with drawing(), atomic_write(path) as temporary:
            self.figure.savefig(temporary, format=ending[1:], dpi=DPI, **options)


def contact_sheet(
    images: Mapping[str, Tensor], exposure: float | None = None, *, columns: int | None = None
) -> ContactSheet:
    """Returns a sheet of images with their names, all views of each side by side, all at one exposure.

    A name that is a method's gets the method's mark. What is not a finite number is shown in cyan, and counted.

    Args:
        images: Linear radiance by name, all of one shape (v, 3, h, w).
        exposure: Scale from radiance to the display, above 0; ``None`` for that of ``"Reference"`` if it is among the
            images, else of the first one, by :func:`fovden.color.exposure`.
        columns: Images per row, at least 1; ``None`` for as many as keep a row from getting crowded: three, or two of
            several views.

    Returns:
        The sheet.

    Raises:
        ShapeError: If the images differ in shape, naming the first that does.
        ValueError: If there are none, or a number is out of range.

    Example:
        >>> images = {"Noisy, full": torch.rand(2, 3, 12, 10), "Reference": torch.full((2, 3, 12, 10), 0.09)}
        >>> round(contact_sheet(images).exposure, 6)
        2.0
    """
    require(len(images) > 0, "images", dict(images), "at least one image")
    sizes: dict[str, int] = {}
    for name, image in images.items():
        sizes = require_shapes("v 3 h w", sizes, **{f"images[{name!r}]": image})
    empty = min(sizes.values()) == 0
    require(not empty, "images", f"shape ({sizes['v']}, 3, {sizes['h']}, {sizes['w']})", "at least one pixel")
    if exposure is None:
        exposure = finite_exposure(images["Reference"] if "Reference" in images else next(iter(images.values())))
    require_number("exposure", exposure, above=0)
    columns = (3 if sizes["v"] == 1 else 2) if columns is None else require_integer("columns", columns, minimum=1)
    columns = min(columns, len(images))
    rows = math.ceil(len(images) / columns)
    with drawing():
        figure, grid = panels([(1, 1)] * rows, columns, sizes["h"] / (sizes["v"] * sizes["w"]), left=0.02)
        cells = [panel for row in grid for panel in row]
        for panel, (name, image) in zip(cells, images.items(), strict=False):
            shown = color.display(image.detach().cpu().double(), exposure)
            broken = ~torch.isfinite(image.detach().cpu()).all(1, keepdim=True)
            show_image(panel, torch.cat(list(shown.masked_fill(broken, torch.nan)), dim=2))
            title(panel, name, name if name in METHOD_STYLES else None)
            for view in range(1, sizes["v"]):
                panel.axvline(view * sizes["w"] - 0.5, color=BACKGROUND, linewidth=2)
            if bool(broken.any()):
                note(panel, f"not finite: {int(broken.sum()):,} pixels, cyan")
        for panel in cells[len(images) :]:
            panel.set_visible(False)
        eyes = {1: "", 2: "; left and right eye"}.get(sizes["v"], f"; {sizes['v']} views")
        heading(figure, f"{sizes['w']} x {sizes['h']} pixels, exposure {exposure:.3g}, sRGB{eyes}")
    return ContactSheet(figure, exposure)
