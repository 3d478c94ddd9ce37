"""The weighted mean of 5 x 5 spread-out taps: the operation beneath every à-trous filter, in torch operations.

With p the pixel, q = p + step (i, j) its taps, i and j in -2..2, c the radiance, n the normal, x the position, b the
mask and k the kernel,

    weight(p, q) = k(i, j) b(q) exp(-|c_p - c_q|^2 / sigma_radiance^2
                                    - |n_p - n_q|^2 / (step sigma_normal)^2 - |x_p - x_q|^2 / sigma_position^2)

    image(p) = sum_q weight(p, q) c_q / sum_q weight(p, q)

The guides are padded once and the taps are 25 shifted views of them, so that no plane is stored 25 times. Rows are
worked off in strips, whose temporaries stay in the processor's cache.

In a polar raster the taps are neighbours in its topology. Each strip of columns reads five images, which lie -2 to 2
steps of columns away, with some rows more at both ends of the circle; the taps are five shifted views of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from fovden.checks import require_shapes
from fovden.foveation import Topology
from fovden.warps.topology import take

__all__ = ["B3_SPLINE", "SMALLEST_EXPONENT", "SMALLEST_TOTAL", "Blend", "Border", "Sigma", "Sigmas", "blend_taps"]

Sigma = float | Tensor
"""The width of an edge-stopping function: a number, a scalar tensor, or one that broadcasts to (v, 1, h, w)."""

Border = Literal["skip", "clamp"]
"""What a tap outside the image does: it is left out, or it reads the nearest pixel of the edge."""

B3_SPLINE = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)
"""Cubic B-spline at the integers, the kernel of the à-trous wavelet transform (Dammertz et al. 2010, section 3)."""

SMALLEST_EXPONENT = -80.0
"""Exponents stop here: exp(-80) = 2e-35 times the smallest tap, 1/256, is still a normal float32."""

SMALLEST_TOTAL = 1e-20
"""A sum of weights up to this is none: the pixel found nothing like itself and keeps what it has."""

STRIP_PIXELS = 131072
"""Pixels, over all views, that are worked off at a time. On 2 x 960 x 1080, 65536 to 262144 took
about 0.6 s a pass, and the whole image at once two to six times as long (two cores, float32)."""


class Sigmas(NamedTuple):
    """The three widths of one pass: of radiance, of unit normals (per pixel of step), and of position."""

    radiance: Sigma
    normal: Sigma
    position: Sigma


class Blend(NamedTuple):
    """The outcome of a pass: the ``image``, and whether a pixel was ``filled`` (in the region, with weights > 0)."""

    image: Tensor
    filled: Tensor


def blend_taps(
    radiance: Tensor,
    normal: Tensor,
    position: Tensor,
    *,
    step: int,
    sigmas: Sigmas,
    mask: Tensor | None = None,
    region: Tensor | None = None,
    known: Tensor | None = None,
    kernel: Tensor | None = None,
    guide: Tensor | None = None,
    centre: Tensor | None = None,
    border: Border = "skip",
    topology: Topology | None = None,
) -> Blend:
    """Returns the edge-avoiding mean of each pixel's taps, and which pixels had one.

    Args:
        radiance: What is averaged, shape (v, c, h, w).
        normal: Unit normals, shape (v, 3, h, w).
        position: Positions, shape (v, 3, h, w).
        step: Distance between neighbouring taps in pixels, at least 1.
        sigmas: Widths of the edge-stopping functions, positive; read at the pixel, not at the tap.
        mask: Weight of each pixel as a tap, in [0, 1], shape (v or 1, 1, h, w); ``None`` means 1 everywhere.
        region: Where to compute, non-zero inside, shape (v or 1, 1, h, w); elsewhere the input is copied. On the
            CPU only its bounding box is visited.
        known: Where it is 0 the radiance term is dropped, shape (v or 1, 1, h, w); ``None`` means known everywhere.
        kernel: Positive weights, shape (5,) or (5, 5); ``None`` means the B3 spline.
        guide: Radiance whose differences are weighed, shape of ``radiance``; ``None`` means ``radiance`` itself.
        centre: The pixel's own side of that difference, the same way; ``None`` means ``guide``.
        border: What a tap outside the image does. Polar rasters have borders of their own.
        topology: The polar raster that the pixels are cells of; ``None`` means the screen's grid. What is not a cell is
            computed like one, from cells: leave it out of the region.

    Returns:
        The image, ``radiance`` where the weights sum to at most 1e-20, and where they sum to more.

    Differentiable: in everything but ``step``, ``region`` and ``known``; twice. Cost: 25 taps for each pixel of the
    region's bounding box, about 45 planes of arithmetic each.

    Example:
        >>> ramp = torch.arange(5.0).expand(1, 3, 5, 5)
        >>> flat = torch.zeros(1, 3, 5, 5)
        >>> blend_taps(ramp, flat, flat, step=1, sigmas=Sigmas(1e6, 1.0, 1.0)).image[0, 0, 2, 2]
        tensor(2.)
    """
    height, width = radiance.shape[-2:]
    normal, position = normal.to(radiance.dtype), position.to(radiance.dtype)
    box = _bounding_box(region, height, width)
    if box is None:
        return Blend(radiance.clone(), torch.zeros_like(radiance[:, :1], dtype=torch.bool))
    if topology is not None:
        box = (0, height, *box[2:])  # rows go around
    top, bottom, left, right = box
    guides = _Guides(radiance if guide is None else guide, normal, position)
    presence = None if mask is None else mask.to(radiance.dtype)
    values = None if guide is None else radiance
    window: _Window | _PolarWindow
    if topology is None:
        window = _Window(box, (height, width), step, border, guides, presence, values)
    else:
        window = _PolarWindow(box, topology, step, guides, presence, values)

    def crop(value: Sigma) -> Sigma:
        if not isinstance(value, Tensor) or value.dim() == 0:
            return value
        return value.to(radiance.dtype).expand(*value.shape[:-2], height, width)[..., top:bottom, left:right]

    inverse = [crop(sigma) ** -2 for sigma in (sigmas.radiance, step * sigmas.normal, sigmas.position)]
    if known is not None:
        inverse[0] = inverse[0] * crop((known != 0).to(radiance.dtype))
    own = next(image for image in (centre, guide, radiance) if image is not None)
    pixels = _Guides(*(tensor[..., top:bottom, left:right] for tensor in (own, normal, position)))
    kernel_rows = _kernel_rows(kernel)

    def blend_strip(start: int, stop: int) -> tuple[Tensor, Tensor]:
        """Returns the sums of weights and of weighted radiance over a strip of the box."""

        def cut(value: Sigma) -> Sigma:
            return value[window.place(start, stop)] if isinstance(value, Tensor) and value.dim() else value

        here = _Guides(*(tensor[window.place(start, stop)] for tensor in pixels))
        strip_inverse = [cut(value) for value in inverse]
        total: Sigma = 0.0
        weighted: Sigma = 0.0
        for tap in window.taps(start, stop):
            radiance_term, normal_term, position_term = (
                (mine - theirs).square().sum(1, keepdim=True) * factor
                for mine, theirs, factor in zip(here, tap.guides, strip_inverse, strict=True)
            )
            exponent = radiance_term + normal_term + position_term
            own_weight = tap.presence * kernel_rows[tap.row][tap.column]
            weight = exponent.neg().clamp(min=SMALLEST_EXPONENT).exp() * own_weight
            share = weight * tap.values
            total = total + weight
            weighted = weighted + share
        return torch.as_tensor(total), torch.as_tensor(weighted)

    strips = [blend_strip(start, stop) for start, stop in window.strips(radiance.shape[0])]
    total = torch.cat([strip[0] for strip in strips], dim=window.axis)
    weighted = torch.cat([strip[1] for strip in strips], dim=window.axis)
    filled = total > SMALLEST_TOTAL
    mean = weighted / torch.where(filled, total, 1)
    if region is not None:
        filled = filled & (region != 0)[..., top:bottom, left:right]
    image = torch.where(filled, mean, radiance[..., top:bottom, left:right])
    return _within(radiance, box, Blend(image, filled))


def _within(radiance: Tensor, box: tuple[int, int, int, int], blend: Blend) -> Blend:
    """The outcome for the whole image, from that for the box; elsewhere the input is copied."""
    top, bottom, left, right = box
    if (bottom - top, right - left) == tuple(radiance.shape[-2:]):
        return blend
    image, filled = radiance.clone(), torch.zeros_like(radiance[:, :1], dtype=torch.bool)
    image[..., top:bottom, left:right] = blend.image
    filled[..., top:bottom, left:right] = blend.filled
    return Blend(image, filled)


class _Guides(NamedTuple):
    radiance: Tensor
    normal: Tensor
    position: Tensor


class _Tap(NamedTuple):
    """What one tap of a strip's pixels finds.

    Attributes:
        row: Its row in the kernel, 0 to 4.
        column: Its column.
        presence: What it weighs before its guides are looked at.
        guides: Its guides.
        values: What is averaged.
    """

    row: int
    column: int
    presence: Sigma
    guides: _Guides
    values: Tensor


class _Window:
    """The pixels of the screen that the taps of a box read, and strips of its rows."""

    axis = -2

    def __init__(
        self,
        box: tuple[int, int, int, int],
        size: tuple[int, int],
        step: int,
        border: Border,
        guides: _Guides,
        mask: Tensor | None,
        values: Tensor | None,
    ) -> None:
        top, bottom, left, right = box
        device = guides.radiance.device
        rows = _Axis(top, bottom, size[0], step=step, border=border, device=device)
        columns = _Axis(left, right, size[1], step=step, border=border, device=device)

        def window(tensor: Tensor) -> Tensor:
            return tensor.index_select(-2, rows.index).index_select(-1, columns.index)

        # What a tap weighs before its guides are looked at; 0 outside the image, so that what is padded never shows.
        presence = (rows.inside[:, None] & columns.inside).to(guides.radiance.dtype)
        self._presence = presence if mask is None else presence * window(mask)
        self._guides = _Guides(*map(window, guides))
        self._values = self._guides.radiance if values is None else window(values)
        self._rows, self._columns = rows.taps, columns.taps
        self._height, self._width = bottom - top, right - left

    def strips(self, views: int) -> list[tuple[int, int]]:
        return _strips(self._height, views * self._width)

    def place(self, start: int, stop: int) -> tuple[Any, ...]:
        return ..., slice(start, stop), slice(None)

    def taps(self, start: int, stop: int) -> Iterator[_Tap]:
        for i, y in self._rows:
            for j, x in self._columns:
                place = (..., slice(y + start, y + stop), slice(x, x + self._width))
                guides = _Guides(*(guide[place] for guide in self._guides))
                yield _Tap(i, j, self._presence[place], guides, self._values[place])


class _PolarWindow:
    """The cells of a polar raster that the taps of some columns read, and strips of these columns."""

    axis = -1

    def __init__(
        self,
        box: tuple[int, int, int, int],
        topology: Topology,
        step: int,
        guides: _Guides,
        mask: Tensor | None,
        values: Tensor | None,
    ) -> None:
        _, self._height, self._left, right = box
        self._width = right - self._left
        self._topology, self._step = topology, step
        self._guides, self._mask, self._values = guides, mask, values

    def strips(self, views: int) -> list[tuple[int, int]]:
        return _strips(self._width, views * self._height)

    def place(self, start: int, stop: int) -> tuple[Any, ...]:
        return ..., slice(start, stop)

    def taps(self, start: int, stop: int) -> Iterator[_Tap]:
        begin, end, step = self._left + start, self._left + stop, self._step
        for j in range(5):
            # To keep such maps for five steps would take 160 MB at 900 x 800 cells, and save 3 % of the time.
            index = self._topology.reads((j - 2) * step, begin, end, margin=2 * step)
            guides = _Guides(*(take(guide, index) for guide in self._guides))
            values = guides.radiance if self._values is None else take(self._values, index)
            mask = None if self._mask is None else take(self._mask, index)
            for i in range(5):
                place = (..., slice(i * step, i * step + self._height), slice(None))
                presence = 1.0 if mask is None else mask[place]
                yield _Tap(i, j, presence, _Guides(*(guide[place] for guide in guides)), values[place])


class _Axis:
    """The padded pixels of one axis that the taps of start..stop read.

    Attributes:
        index: Which pixel each padded one shows, the edge's where it lies outside.
        inside: Whether it counts.
        taps: Pairs (number 0..4 of the tap, where its view of the padded axis starts).
    """

    def __init__(self, start: int, stop: int, size: int, *, step: int, border: Border, device: torch.device) -> None:
        clamps = border == "clamp"
        offsets = [(i, (i - 2) * step) for i in range(5)]
        offsets = [(i, d) for i, d in offsets if clamps or (start + d < size and stop + d > 0)]
        first, last = offsets[0][1], offsets[-1][1]
        padded = torch.arange(start + first, stop + last, device=device)
        self.index = padded.clamp(0, size - 1)
        self.inside = torch.full_like(padded, clamps, dtype=torch.bool) | (self.index == padded)
        self.taps = [(i, d - first) for i, d in offsets]


def _bounding_box(region: Tensor | None, height: int, width: int) -> tuple[int, int, int, int] | None:
    """Top, bottom, left and right of the region, ``None`` where it is empty; the image where asking would wait."""
    if region is None or region.device.type != "cpu" or torch.compiler.is_compiling():
        return 0, height, 0, width
    inside = (region != 0).flatten(0, 1).any(0)
    rows, columns = inside.any(1).nonzero(), inside.any(0).nonzero()
    if rows.numel() == 0:
        return None
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def _strips(length: int, across: int) -> list[tuple[int, int]]:
    """Ranges of about ``STRIP_PIXELS`` pixels, ``across`` for each; one under a compiler, which tiles by itself."""
    size = length if torch.compiler.is_compiling() else max(1, STRIP_PIXELS // across)
    return [(start, min(start + size, length)) for start in range(0, length, size)]


def _kernel_rows(kernel: Tensor | None) -> list[list[Sigma]]:
    if kernel is None:
        return [[a * b for b in B3_SPLINE] for a in B3_SPLINE]
    if kernel.dim() == 1:
        require_shapes("5", kernel=kernel)
        kernel = kernel[:, None] * kernel
    require_shapes("5 5", kernel=kernel)
    return [list(row.unbind()) for row in kernel.unbind()]
