"""Sample maps: how many paths each pixel gets, and the list of pixels that get any."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_integer, require_number, require_shapes, require_tensor
from fovden.foveation.budget import rates_at_budget, select_exactly
from fovden.foveation.falloff import Falloff
from fovden.foveation.mask import Source, mask_numbers
from fovden.preview import Picture, card, never_raising, ramp, shades
from fovden.warps import Warp
from fovden.warps._checks import require_camera

__all__ = ["SampleMap", "sample_map", "uniform_map"]


@dataclass(frozen=True, eq=False)
class SampleMap:
    """How many samples each pixel gets; with a ``warp``, each cell of its raster.

    Attributes:
        counts: Samples per pixel, int32, shape (v, 1, h, w), or (1, 1, h, w) where all views share them.
        coords: View, y and x of every pixel with samples, of all views, in row-major order, int32, shape (k, 3).
        layer: Foveation layer, int32, 0 is the innermost, the shape of ``counts``.
        gaze: Where each eye looks; its length is the number of views.
        expected: Paths that were to be expected before the draw, over all views.
        radii: Radii of the layers' circles in pixels, from the inside out; empty without circles.
        warp: The raster that is meant; ``None`` is the camera's own.

    Example:
        >>> samples = SampleMap.from_counts(torch.tensor([[[[4, 0, 2]]]]), Gaze(torch.zeros(2, 2)))
        >>> samples.coords.tolist(), samples.paths
        ([[0, 0, 0], [0, 0, 2], [1, 0, 0], [1, 0, 2]], 12)
    """

    counts: Tensor
    coords: Tensor
    layer: Tensor
    gaze: Gaze
    expected: float
    radii: tuple[float, ...] = ()
    warp: Warp | None = None

    def __post_init__(self) -> None:
        sizes = require_shapes("s 1 h w", counts=self.counts, layer=self.layer)
        require_shapes("k 3", coords=self.coords)
        if self.warp is not None:
            require_shapes("v 2", {"v": self.view_count}, **{"warp.gaze.pixels": self.warp.gaze.pixels})
            same = self.warp.resolution == self.resolution
            require(same, "counts", tuple(self.counts.shape), f"the raster's height and width, {self.warp.resolution}")
        shared = sizes["s"] in (1, self.view_count)
        require(shared, "counts", tuple(self.counts.shape), f"1 or {self.view_count} views, as many as the gaze has")
        for name in ("counts", "coords", "layer"):
            tensor = getattr(self, name)
            whole = not tensor.is_floating_point() and tensor.dtype != torch.bool
            require(whole, name, tensor.dtype, "an integer type")
            object.__setattr__(self, name, tensor.to(torch.int32))
        fewest = int(self.counts.amin()) if self.counts.numel() else 0
        require(fewest >= 0, "counts", fewest, "numbers of at least 0")
        require_number("expected", self.expected, minimum=0)

    @classmethod
    def from_counts(
        cls,
        counts: Tensor,
        gaze: Gaze,
        *,
        layer: Tensor | None = None,
        expected: float | None = None,
        radii: tuple[float, ...] = (),
        warp: Warp | None = None,
    ) -> SampleMap:
        """Returns the map of given counts, with the list of its pixels.

        Args:
            counts: Samples per pixel, integers of at least 0, shape (v, 1, h, w), or (1, 1, h, w) for all views.
            gaze: Where each eye looks.
            layer: Foveation layers, the shape of ``counts``; ``None`` means one layer.
            expected: Expected number of paths; ``None`` means that the counts were not drawn at random.
            radii: Radii of the layers' circles in pixels.
            warp: The raster that is meant; ``None`` is the camera's own.

        Returns:
            The map.

        Raises:
            ValueError: If the counts are not such numbers or their views are not those of the gaze.

        Example:
            >>> SampleMap.from_counts(torch.full((1, 1, 4, 4), 3), Gaze(torch.zeros(2, 2))).mean_spp
            3.0
        """
        require_shapes("* 1 * *", counts=require_tensor("counts", counts))
        views = gaze.pixels.shape[0]
        fits = counts.shape[0] in (1, views)
        require(fits, "counts", tuple(counts.shape), f"1 or {views} views, as many as the gaze has")
        every_view = counts.expand(views, -1, -1, -1)
        coords = (every_view[:, 0] > 0).nonzero().to(torch.int32)
        layer = torch.zeros_like(counts) if layer is None else layer
        expected = float(every_view.sum()) if expected is None else expected
        return cls(counts, coords, layer, gaze, expected, radii, warp)

    @property
    def view_count(self) -> int:
        """Number of views v, whether or not they share their counts."""
        return int(self.gaze.pixels.shape[0])

    @property
    def resolution(self) -> tuple[int, int]:
        """Height and width in pixels, or cells."""
        return int(self.counts.shape[2]), int(self.counts.shape[3])

    @property
    def mask(self) -> Tensor:
        """Whether a pixel has samples, as 0 or 1, float32, the shape of ``counts``."""
        return (self.counts > 0).to(torch.float32)

    @property
    def paths(self) -> int:
        """Number of paths over all views: the actual budget, beside ``expected``."""
        return int(self.counts.sum(dtype=torch.int64)) * (self.view_count // int(self.counts.shape[0]))

    @property
    def mean_spp(self) -> float:
        """Mean number of samples per pixel of the screen, also where cells have them."""
        return self.paths / (self.view_count * math.prod(self.resolution if self.warp is None else self.warp.screen))

    def on_screen(self) -> Tensor:
        """Returns how many paths start in each pixel of the screen.

        A path of a raster's cell counts where the cell's centre lies; those of cells whose centre is beside the screen
        do not.

        Returns:
            Paths, int32, shape (v, 1, height, width) of the screen.

        Example:
            >>> from fovden.foveation import ScreenWarp
            >>> gaze = Gaze(torch.zeros(1, 2))
            >>> half = SampleMap.from_counts(torch.full((1, 1, 1, 2), 3), gaze, warp=ScreenWarp(gaze, (2, 4), (1, 2)))
            >>> half.on_screen()[0, 0]
            tensor([[0, 0, 0, 0],
                    [0, 3, 0, 3]], dtype=torch.int32)
        """
        counts = self.counts.expand(self.view_count, -1, -1, -1)
        if self.warp is None:
            return counts.contiguous()
        height, width = self.warp.screen
        x, y = self.warp.positions().detach().floor().long().unbind(-1)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        index = torch.where(inside, y * width + x, 0)
        flat = counts.new_zeros(self.view_count, height * width)
        return flat.scatter_add_(1, index, counts.flatten(1) * inside).view(-1, 1, height, width)

    def to(self, *args: Any, **kwargs: Any) -> SampleMap:
        """Returns the map moved with the arguments of ``Tensor.to``; counts, coordinates and layers stay int32.

        Example:
            >>> samples = SampleMap.from_counts(torch.ones(1, 1, 2, 2, dtype=torch.int32), Gaze(torch.zeros(2, 2)))
            >>> samples.to(torch.float64).counts.dtype
            torch.int32
        """
        gaze = self.gaze.to(*args, **kwargs)
        moved = {name: getattr(self, name).to(gaze.pixels.device) for name in ("counts", "coords", "layer")}
        warp = None if self.warp is None else self.warp.to(*args, **kwargs)
        return replace(self, gaze=gaze, warp=warp, **moved)

    @never_raising
    def _repr_html_(self) -> str:
        height, width = self.resolution
        most = int(self.counts.max()) if self.counts.numel() else 0
        shared = self.counts.shape[0] < self.view_count
        unit = "pixel" if self.warp is None else "cell"
        pictures = [
            Picture(ramp(self.counts, 0, most), f"samples per {unit}, black 0, white {most}"),
            Picture(shades(self.layer), "layers, the innermost white"),
        ]
        layers = self.layer.flatten().bincount().double() / max(1, self.layer.numel())
        rows = {
            "views": f"{self.view_count} of {width} x {height} {unit}s"
            + (" that share their counts" if shared else ""),
            "paths": f"{self.paths:,}; expected {self.expected:,.0f}",
            "samples per pixel": f"{self.mean_spp:.3f} on average, at most {most}" if self.counts.numel() else "none",
            f"{unit}s with samples": f"{len(self.coords):,}",
            "layers": ", ".join(f"{number}: {share:.1%}" for number, share in enumerate(layers.tolist())) or "none",
            "circles": ", ".join(f"{radius:g}" for radius in self.radii) + " pixels" if self.radii else "none",
            "gaze": ", ".join(f"({x:g}, {y:g})" for x, y in self.gaze.pixels.tolist()) + " pixels",
        }
        return card("SampleMap", pictures, rows)


def sample_map(
    falloff: Falloff,
    camera: Camera | StereoCamera,
    gaze: Gaze | None = None,
    spp: int = 4,
    seed: int = 0,
    *,
    warp: Warp | None = None,
    mean_spp: float | None = None,
    index: int = 0,
    per_eye: bool = False,
    source: Source = "philox",
) -> SampleMap:
    """Returns the sample map of a falloff: which pixels are traced, and with how many paths.

    Every pixel has a random number U in [0, 1). A falloff that selects gives ``spp`` paths to the pixels with U < rate
    and none to the others; one that does not gives every pixel ``rate * spp``, rounded up with the probability of the
    fraction. Either way the expected number of paths is ``spp`` times the sum of the rates.

    With ``mean_spp`` the budget is stated: rates are multiplied by one factor for each view and clamped to 1, so that
    every view expects ``mean_spp`` paths per pixel, wherever its eye looks. Layers stay where they are. Independent
    numbers meet it to within the chance of their draw, whose variance is at most ``spp^2`` times the sum of rate
    (1 - rate) over a view's pixels. The evenly spread ones meet it to half a pixel's paths in each view: see
    :func:`fovden.foveation.select_exactly`. What was expected and what came are both in the map.

    With a ``warp`` the map is one of cells. A cell has rate and layer of the pixel that its centre lies on, or of the
    nearest one beside the screen, so that any falloff goes with any raster: the density of paths on the screen is that
    of cells times the rate. A cell that no pixel reads has a rate of 0. ``spp`` counts per cell, ``mean_spp`` per pixel
    of the screen, as without a warp: methods at one ``mean_spp`` trace equally many paths.

    Readings of the 2023 paper, each with its default and its option:

    - Samples per selected pixel: the text once has exactly one, elsewhere four. ``spp=4`` is the default.
    - Frames and eyes share a mask, as the paper computes it once. Another ``index`` draws another mask, ``per_eye``
      another one in each eye. Where the eyes look at different pixels, the maps differ, but not the random numbers.
    - Random numbers, of which the paper says nothing. ``"philox"``: independent. ``"stratified"``: spread evenly over
      blocks of 2 x 2 pixels, 4 x 4, and so on. ``"blue_noise"``: spread evenly without blocks, by a
      void-and-cluster tile. See :func:`mask_numbers`.
    - Radiance of a selected pixel: the mean of its own samples; it is not divided by the rate, since the filter
      normalises by its mask.

    Args:
        falloff: For example :class:`fovden.foveation.ThreeLayer`.
        camera: The views.
        gaze: Where each eye looks, also outside the image; ``None`` means the warp's gaze, or else the centre.
        spp: Samples per pixel, or cell, at full rate, at least 1.
        seed: Seed of the mask, from 0 to 2^32 - 1.
        warp: The raster whose cells are meant; ``None`` for the camera's own.
        mean_spp: Budget in paths per pixel of each view's screen, above 0 and at most what ``spp`` allows; ``None``
            takes rates as they are.
        index: Number of the frame, where each frame is to have a mask of its own; one number for all freezes it.
        per_eye: Whether each eye has random numbers of its own.
        source: Where the random numbers come from.

    Returns:
        The map. Its counts have one view where all views share them. Nothing may be selected at all.

    Raises:
        ShapeError: If gaze, warp and camera differ in the number of views.
        ValueError: If a number is out of range, the rates are not in [0, 1], too few pixels have a rate above 0 to
            spend the budget on, or the warp is for another screen.

    Cost: about 100 operations per pixel; some 300 from evenly spread numbers.

    Example:
        >>> from fovden.foveation import ThreeLayer
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60)
        >>> samples = sample_map(ThreeLayer(), camera, spp=4, seed=0)
        >>> samples.counts.shape, round(samples.expected), samples.radii
        (torch.Size([1, 1, 1080, 960]), 4755211, (144.0, 288.0))
        >>> samples = sample_map(ThreeLayer(), camera, spp=4, mean_spp=0.4, source="blue_noise")
        >>> round(samples.expected), samples.paths
        (829440, 829440)
    """
    views = camera.views
    if warp is not None:
        require_camera(warp, views)
    if gaze is None:
        gaze = Gaze.center(views) if warp is None else warp.gaze
    require_shapes("v 2", {"v": views.view_count}, **{"gaze.pixels": gaze.pixels})
    require_integer("spp", spp, minimum=1)
    rate, layer, radii, selects = falloff(views, gaze)
    rate = rate.detach()  # a count has no derivative; that of a mask is in soft_mask.py
    sizes = {"v": views.view_count, "h": views.resolution[0], "w": views.resolution[1]}
    require_shapes("v 1 h w", sizes, **{"falloff.rate": rate, "falloff.layer": layer})
    within = bool(((rate >= 0) & (rate <= 1)).all())
    require(within, "falloff.rate", f"{float(rate.min()):g} to {float(rate.max()):g}", "rates from 0 to 1")
    if warp is not None:
        rate, layer = _in_cells(warp, rate) * warp.read, _in_cells(warp, layer)
    if mean_spp is not None:
        # Pixels for each place of the raster, and how many of these can have paths.
        ratio = 1.0 if warp is None else 1 / warp.cells_per_pixel
        possible = 1.0 if warp is None else float((rate > 0).double().mean((1, 2, 3)).amin())
        require_number("mean_spp", mean_spp, above=0, maximum=spp * possible / ratio)
        rate = rates_at_budget(rate, min(1.0, mean_spp / spp * ratio))
    expected = spp * float(rate.sum(dtype=torch.float64))
    if not per_eye and bool((rate == rate[:1]).all()) and bool((layer == layer[:1]).all()):
        rate, layer = rate[:1], layer[:1]
    resolution = views.resolution if warp is None else warp.resolution
    numbers = mask_numbers(resolution, seed, index=index, source=source, views=views.view_count if per_eye else 1)
    whole = torch.zeros_like(rate) if selects else (spp * rate).floor()
    chance = rate if selects else spp * rate - whole
    exact = mean_spp is not None and source != "philox"
    chosen = (select_exactly(numbers, chance) if exact else numbers < chance).to(torch.int32)
    counts = spp * chosen if selects else whole.to(torch.int32) + chosen
    return SampleMap.from_counts(counts, gaze, layer=layer, expected=expected, radii=radii, warp=warp)


def uniform_map(
    camera: Camera | StereoCamera,
    mean_spp: float,
    seed: int = 0,
    *,
    warp: Warp | None = None,
    index: int = 0,
    per_eye: bool = False,
) -> SampleMap:
    """Returns a map without a falloff whose counts have a given mean, to compare methods at equal numbers of paths.

    Every pixel gets floor(mean_spp) samples, and one more with the probability of the fraction. With a ``warp`` every
    cell that the screen reads gets mean_spp times the pixels per such cell in the same way: the number of paths of each
    view is that of the pixels.

    Args:
        camera: The views.
        mean_spp: Mean number of samples per pixel of the screen, at least 0.
        seed: Seed of the draw, from 0 to 2^32 - 1.
        warp: The raster whose cells are meant; ``None`` for the camera's own.
        index: Number of the frame, where each frame is to have a draw of its own.
        per_eye: Whether each eye has a draw of its own.

    Returns:
        The map: one layer, the gaze at the centre, or that of the warp.

    Raises:
        ShapeError: If warp and camera differ in the number of views.
        ValueError: If a number is out of range, or the warp is for another screen.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(100, 100))
        >>> samples = uniform_map(camera, 2.3)
        >>> samples.counts.unique(), round(samples.expected), abs(samples.mean_spp - 2.3) < 0.02
        (tensor([2, 3], dtype=torch.int32), 46000, True)
    """
    views = camera.views
    require_number("mean_spp", mean_spp, minimum=0, maximum=2**24)
    expected = mean_spp * views.view_count * math.prod(views.resolution)
    resolution = views.resolution if warp is None else warp.resolution
    numbers = mask_numbers(resolution, seed, index=index, views=views.view_count if per_eye else 1)
    if warp is None:
        whole = math.floor(mean_spp)
        counts = whole + (numbers < mean_spp - whole).to(torch.int32)
        return SampleMap.from_counts(counts, Gaze.center(views), expected=expected)
    require_camera(warp, views)
    mean = mean_spp * math.prod(warp.screen) / warp.read.sum((1, 2, 3), keepdim=True).double().clamp(min=1)
    counts = (mean.floor() + (numbers < mean - mean.floor())).to(torch.int32) * warp.read
    return SampleMap.from_counts(counts, warp.gaze, expected=expected, warp=warp)


def _in_cells(warp: Warp, image: Tensor) -> Tensor:
    """The values of the pixels that cells' centres lie on, or that are nearest to these."""
    height, width = warp.screen
    x, y = warp.positions().detach().floor().long().unbind(-1)
    index = y.clamp(0, height - 1) * width + x.clamp(0, width - 1)
    return image.flatten(2).gather(2, index[:, None]).reshape(-1, 1, *warp.resolution)
