"""How tensors show themselves: as PNG pictures that state their colour space and exposure, and on cards in a notebook.

A card is a piece of HTML with thumbnails and a table. It takes its colours from the page around it, so that it is
legible on light and on dark ones, asks nothing of the network, and stays below about 150 kB.
"""

from __future__ import annotations

import base64
import html
import io as bytes_io
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from fovden import color
from fovden.checks import require, require_integer, require_number, require_shapes
from fovden.colormap import NO_VALUE

__all__ = [
    "THUMBNAIL",
    "Picture",
    "card",
    "encode_png",
    "finite_exposure",
    "never_raising",
    "png_info",
    "ramp",
    "shades",
    "show",
    "shrink",
    "to_levels",
]

Owner = TypeVar("Owner")

THUMBNAIL = 160
"""Longer side of a thumbnail in pixels. Ours: four of pure noise, at a byte per pixel, take 137 kB of HTML."""

SRGB_INTENT = b"\x01"  # relative colorimetric: colours are to be kept as they are (PNG, third edition, 11.3.2.5)
SRGB_GAMMA = (45455).to_bytes(4, "big")  # 1 / 2.2, for readers that ignore sRGB (the same section)
SHADE = 0.25  # brightness of the darkest class in a picture of classes


class Picture(NamedTuple):
    """A thumbnail and what is said below it.

    Attributes:
        levels: sRGB levels, uint8, shape (h, w, 3).
        caption: Plain text.

    Example:
        >>> Picture(torch.zeros(2, 2, 3, dtype=torch.uint8), "left eye").caption
        'left eye'
    """

    levels: Tensor
    caption: str


def to_levels(image: Tensor) -> Tensor:
    """Returns the 8-bit levels of display-encoded views, side by side with the first on the left.

    ``floor(255 x + 1/2)`` of values clamped to [0, 1]; a pixel with a channel that is no finite number gets the signal
    colour :data:`fovden.colormap.NO_VALUE`.

    Args:
        image: Display-encoded colour, shape (v, 3, h, w).

    Returns:
        Levels, uint8, on the CPU, shape (h, v w, 3).

    Raises:
        ShapeError: If ``image`` has another shape.

    Example:
        >>> to_levels(torch.tensor([0.0, 0.5, float("nan")]).expand(1, 3, 1, 3)).tolist()
        [[[0, 0, 0], [128, 128, 128], [0, 255, 255]]]
    """
    require_shapes("v 3 h w", image=image)
    values = image.detach().cpu().double()
    finite = torch.isfinite(values).all(1)[..., None]
    levels = torch.floor(values.nan_to_num().clamp(0, 1) * 255 + 0.5).to(torch.uint8).permute(0, 2, 3, 1)
    levels = torch.where(finite, levels, torch.tensor(NO_VALUE, dtype=torch.uint8))
    views, height, width, _ = levels.shape
    return levels.transpose(0, 1).reshape(height, views * width, 3).contiguous()


def shrink(image: Tensor, side: int = THUMBNAIL) -> Tensor:
    """Returns an image whose longer side is at most ``side``, each pixel the mean of those it stands for.

    One value that is not finite makes the pixel that it falls into not finite, so that it does not get lost.

    Args:
        image: Any values, shape (v, c, h, w); radiance while it is linear.
        side: Longest side of a view in pixels, at least 1.

    Returns:
        Float64, on the CPU, shape (v, c, h', w'); the values themselves where the image is small enough.

    Raises:
        ShapeError: If ``image`` has another shape.
        ValueError: If ``side`` is below 1.

    Example:
        >>> shrink(torch.arange(8.0).reshape(1, 1, 2, 4), 2)
        tensor([[[[2.5000, 4.5000]]]], dtype=torch.float64)
    """
    sizes = require_shapes("v c h w", image=image)
    values = image.detach().cpu().double()
    scale = require_integer("side", side, minimum=1) / max(sizes["h"], sizes["w"], 1)
    if scale >= 1 or values.numel() == 0:
        return values
    size = (max(1, round(scale * sizes["h"])), max(1, round(scale * sizes["w"])))
    shrunk: Tensor = torch.nn.functional.adaptive_avg_pool2d(values, size)
    return shrunk


def finite_exposure(radiance: Tensor) -> float:
    """Returns the exposure of what is finite in an image; see :func:`fovden.color.exposure`.

    Args:
        radiance: Linear radiance, also with values that are not finite, shape (v, 3, h, w).

    Returns:
        The scale; 1 for an image with nothing but black in it.

    Example:
        >>> round(finite_exposure(torch.tensor([9.0, float("nan")]).expand(1, 3, 1, 2)), 6)
        0.02
    """
    values = radiance.detach().cpu().float()
    return color.exposure(torch.where(torch.isfinite(values), values, 0.0).clamp(min=0))


def show(radiance: Tensor, exposure: float, side: int | None = THUMBNAIL) -> Tensor:
    """Returns levels of radiance as a display shows it, with what is not finite in the signal colour.

    Args:
        radiance: Linear radiance, shape (v, 3, h, w).
        exposure: Scale from radiance to the display, above 0.
        side: Longest side of a view; ``None`` keeps the size.

    Returns:
        Levels, uint8, the views side by side, shape (h', v w', 3).

    Raises:
        ShapeError: If ``radiance`` has another shape.
        ValueError: If ``exposure`` is not above 0.

    Example:
        >>> show(torch.full((2, 3, 4, 4), 9.0), exposure=0.02, side=1).tolist()
        [[[118, 118, 118], [118, 118, 118]]]
    """
    linear = radiance.detach().cpu().double() if side is None else shrink(radiance, side)
    return to_levels(torch.where(torch.isfinite(linear), color.display(linear, exposure), torch.nan))


def ramp(values: Tensor, low: float, high: float, side: int = THUMBNAIL) -> Tensor:
    """Returns levels of a scalar image in greys, from black at ``low`` to white at ``high``.

    Args:
        values: Any numbers, shape (v, 1, h, w).
        low: What is black.
        high: What is white; where both are equal, everything is black.
        side: Longest side of a view.

    Returns:
        Levels, uint8, the views side by side, shape (h', v w', 3).

    Example:
        >>> ramp(torch.tensor([[[[0, 4]]]]), 0, 4).tolist()
        [[[0, 0, 0], [255, 255, 255]]]
    """
    shrunk = (shrink(values, side) - low) / (high - low if high != low else 1.0)
    return to_levels(shrunk.expand(-1, 3, -1, -1))


def shades(classes: Tensor, side: int = THUMBNAIL) -> Tensor:
    """Returns levels of an image of class numbers, such as foveation layers: 0 is white, the last one dark grey.

    Args:
        classes: Integers of at least 0, shape (v, 1, h, w).
        side: Longest side of a view.

    Returns:
        Levels, uint8, the views side by side, shape (h', v w', 3).

    Example:
        >>> shades(torch.tensor([[[[0, 1, 2]]]]))[0, :, 0].tolist()
        [255, 159, 64]
    """
    last = max(1, int(classes.max())) if classes.numel() else 1
    return ramp(1 - (1 - SHADE) * classes.double() / last, 0.0, 1.0, side)


def png_info(exposure: float | None = None) -> Any:
    """Returns what Pillow is to write into a PNG beside the pixels: that they are sRGB, and where they come from.

    Chunks ``sRGB`` and, for readers that ignore it, ``gAMA``; texts ``Software`` and, where it is known, ``Exposure``,
    the scale from linear radiance to the display.

    Args:
        exposure: The scale, above 0, or ``None``.

    Returns:
        A ``PIL.PngImagePlugin.PngInfo``, for the argument ``pnginfo`` of ``PIL.Image.Image.save``.

    Raises:
        ValueError: If ``exposure`` is not above 0.

    Source: Portable Network Graphics, third edition, W3C 2025, sections 11.3.2.2, 11.3.2.5 and 11.3.3.

    Example:
        >>> [name for name, *_ in png_info(exposure=0.5).chunks]
        [b'sRGB', b'gAMA', b'tEXt', b'tEXt']
    """
    from PIL.PngImagePlugin import PngInfo  # noqa: PLC0415 - the package imports without an image codec

    info = PngInfo()
    info.add(b"sRGB", SRGB_INTENT)
    info.add(b"gAMA", SRGB_GAMMA)
    info.add_text("Software", "fovden")
    if exposure is not None:
        info.add_text("Exposure", repr(require_number("exposure", exposure, above=0)))
    return info


def encode_png(levels: Tensor, *, exposure: float | None = None, small: bool = False) -> bytes:
    """Returns a PNG file as bytes, with the chunks of :func:`png_info`.

    Args:
        levels: sRGB levels, uint8, shape (h, w, 3), with at least one pixel.
        exposure: The exposure that they were made with, to be stated in the file; ``None`` states none.
        small: Whether a picture that would take more than a byte per pixel is reduced to 256 colours.

    Returns:
        The file's bytes.

    Raises:
        ShapeError: If ``levels`` has another shape.
        ValueError: If it is not uint8 or empty, or ``exposure`` is not above 0.

    Example:
        >>> encode_png(torch.zeros(4, 6, 3, dtype=torch.uint8))[1:4]
        b'PNG'
    """
    from PIL import Image  # noqa: PLC0415

    require_shapes("h w 3", levels=levels)
    require(levels.dtype == torch.uint8, "levels", levels.dtype, "torch.uint8")
    require(levels.numel() > 0, "levels", tuple(levels.shape), "at least one pixel")
    info = png_info(exposure)

    def encode(picture: Any) -> bytes:
        buffer = bytes_io.BytesIO()
        picture.save(buffer, format="PNG", pnginfo=info, optimize=small)
        return buffer.getvalue()

    picture = Image.fromarray(levels.cpu().contiguous().numpy())
    data = encode(picture)
    if small and len(data) > levels.shape[0] * levels.shape[1]:
        data = min(data, encode(_with_palette(picture, levels)), key=len)
    return data


def card(title: str, pictures: Sequence[Picture], rows: Mapping[str, str]) -> str:
    """Returns a card: a title, thumbnails with captions, and a table of names and values.

    Texts are escaped. A picture smaller than half a thumbnail is shown magnified, its pixels as squares.

    Args:
        title: What it is.
        pictures: Thumbnails of at most :data:`THUMBNAIL` pixels on a view's side; empty ones are left out.
        rows: The table.

    Returns:
        HTML that needs no other file.

    Example:
        >>> "&lt;b&gt;" in card("Scene", [], {"name": "<b>"})
        True
    """
    shown = "".join(_picture_html(picture) for picture in pictures if picture.levels.numel())
    name_style = "text-align:left;font-weight:normal;opacity:.75;padding:1px 16px 1px 0;vertical-align:top"
    value_style = "text-align:left;padding:1px 0"
    table = "".join(
        f'<tr style="background:none"><th scope="row" style="{name_style}">{html.escape(name)}</th>'
        f'<td style="{value_style}">{html.escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    return (
        '<div style="display:inline-block;box-sizing:border-box;max-width:100%;padding:8px 12px;'
        "font:13px/1.45 system-ui,sans-serif;color:inherit;background:none;"
        'border:1px solid rgba(128,128,128,.5);border-radius:4px">'
        f'<div style="font-weight:600;margin-bottom:6px">{html.escape(title)}</div>'
        f'<div style="display:flex;flex-wrap:wrap;gap:10px">{shown}</div>'
        '<table style="border-collapse:collapse;border:none;margin:8px 0 0 0;color:inherit;font-size:12px">'
        f"{table}</table></div>"
    )


def never_raising(describe: Callable[[Owner], str]) -> Callable[[Owner], str | None]:
    """Returns a method ``_repr_html_`` that gives ``None`` where it would raise: Jupyter then shows the plain text.

    What cannot be drawn, such as a tensor on PyTorch's device ``meta``, must not stop the cell that mentions it.

    Args:
        describe: The method.

    Returns:
        The method that never raises.

    Example:
        >>> never_raising(lambda record: card("Empty", [], {"shape": record.shape}))(None) is None
        True
    """

    @wraps(describe)
    def guarded(self: Owner) -> str | None:
        try:
            return describe(self)
        except Exception:  # whatever it is, the text remains
            return None

    return guarded


def _picture_html(picture: Picture) -> str:
    height, width, _ = picture.levels.shape
    factor = max(1, THUMBNAIL // max(height, width))
    data = base64.b64encode(encode_png(picture.levels, small=True)).decode("ascii")
    caption = html.escape(picture.caption)
    return (
        f'<figure style="margin:0"><img src="data:image/png;base64,{data}" alt="{caption}" '
        f'width="{factor * width}" height="{factor * height}" '
        'style="display:block;margin:0;max-width:none;image-rendering:pixelated;'
        'outline:1px solid rgba(128,128,128,.5)">'
        f'<figcaption style="font-size:11px;opacity:.8;margin-top:3px;max-width:{max(150, factor * width)}px">'
        f"{caption}</figcaption></figure>"
    )


def _with_palette(picture: Any, levels: Tensor) -> Any:
    """The picture with 255 colours of its own and the signal colour, which a reduction might otherwise lose."""
    from PIL import Image  # noqa: PLC0415

    reduced = picture.quantize(255, dither=Image.Dither.NONE)
    palette = (reduced.getpalette() or [])[: 255 * 3]
    indices = np.asarray(reduced).copy()
    indices[(levels.cpu() == torch.tensor(NO_VALUE, dtype=torch.uint8)).all(-1).numpy()] = 255
    result = Image.fromarray(indices)
    result.putpalette([*palette, *[0] * (255 * 3 - len(palette)), *NO_VALUE])
    return result
