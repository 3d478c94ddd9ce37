"""Densities of samples against eccentricity: of falloffs, and of what is drawn, with the eye's acuity over them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from torch import Tensor

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_shapes
from fovden.figures.style import (
    FAINT,
    GRID,
    METHOD_STYLES,
    PRINT_WIDTH,
    SMALL,
    MethodStyle,
    drawing,
    method_style,
    save_figure,
)
from fovden.foveation import Falloff, ReddyAcuity, SampleMap, eccentricity_degrees, rates_at_budget, sample_map

__all__ = ["density_by_eccentricity", "draw_densities", "draw_sample_maps"]

STYLES = tuple(style for name, style in METHOD_STYLES.items() if name != "Reference")
WIDTH = 1.0
"""Width of the rings over which densities are averaged, degrees."""


def density_by_eccentricity(density: Tensor, eccentricity: Tensor, width: float) -> tuple[list[float], list[float]]:
    """Returns the mean density in rings of equal width around the gaze.

    Args:
        density: Samples per pixel, or a rate, shape (v, 1, h, w).
        eccentricity: Angles from the gaze in degrees, shape (v, 1, h, w).
        width: Width of a ring in degrees, above 0.

    Returns:
        The middle of each ring that has a pixel, rising, and the mean density in it.

    Raises:
        ShapeError: If the shapes differ.

    Example:
        >>> degrees = torch.tensor([0.2, 0.8, 1.5]).reshape(1, 1, 1, 3)
        >>> density_by_eccentricity(torch.tensor([1.0, 0.5, 0.25]).reshape(1, 1, 1, 3), degrees, 1.0)
        ([0.5, 1.5], [0.75, 0.25])
    """
    require_shapes("v 1 h w", density=density, eccentricity=eccentricity)
    ring = (eccentricity / width).long().flatten()
    count = ring.bincount()
    mean = ring.bincount(density.flatten().double()) / count.clamp(min=1)
    present = count > 0
    return (((torch.arange(len(count)) + 0.5) * width)[present].tolist(), mean[present].tolist())


def draw_densities(
    falloffs: Mapping[str, Falloff],
    path: str | os.PathLike[str],
    *,
    camera: Camera | StereoCamera,
    gaze: Gaze | None = None,
    spp: int = 4,
    mean_spp: float = 0.4,
    acuity: Callable[[Tensor], Tensor] | None = None,
) -> Path:
    """Draws how densely falloffs sample at each eccentricity.

    The left panel has the rates as they are, the right one samples per pixel at one budget: lines are what is
    expected, and marks are counted in the masks that are drawn with blue noise. The eye's acuity lies over both, in the
    right one times ``spp``: where a line is above it, the falloff samples more densely than the eye sees, if it sees
    all of ``spp`` samples at the gaze.

    Args:
        falloffs: Up to seven falloffs by name.
        path: The file, a PNG.
        camera: The views.
        gaze: Where each eye looks; ``None`` means the centre.
        spp: Samples per pixel at full rate.
        mean_spp: The budget, in paths per pixel.
        acuity: Relative acuity at eccentricities in degrees; ``None`` means Reddy's.

    Returns:
        The file.

    Raises:
        ValueError: If there are no falloffs or more than seven, or a budget cannot be met.

    Example:
        >>> import tempfile
        >>> from fovden.foveation import LinearFalloff, ThreeLayer
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(60, 60))
        >>> falloffs = {"three layers": ThreeLayer(), "linear": LinearFalloff()}
        >>> draw_densities(falloffs, Path(tempfile.mkdtemp()) / "densities.png", camera=camera).name
        'densities.png'
    """
    require(1 <= len(falloffs) <= len(STYLES), "falloffs", len(falloffs), f"1 to {len(STYLES)} of them")
    views = camera.views
    gaze = Gaze.center(views) if gaze is None else gaze
    degrees = eccentricity_degrees(gaze, views).detach()
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 3.0), layout="constrained")
        rates, samples = figure.subplots(1, 2)
        for (name, falloff), style in zip(falloffs.items(), STYLES, strict=False):
            rate = falloff(views, gaze).rate.detach()
            counted = sample_map(falloff, views, gaze, spp, mean_spp=mean_spp, source="blue_noise")
            expected = spp * rates_at_budget(rate, mean_spp / spp)
            drawn = counted.counts.expand_as(rate).double()
            _line(rates, name, style, density_by_eccentricity(rate, degrees, WIDTH))
            _line(samples, None, style, density_by_eccentricity(expected, degrees, WIDTH))
            _marks(samples, style, density_by_eccentricity(drawn, degrees, WIDTH))
        for panel, most in ((rates, 1.0), (samples, spp)):
            _acuity(panel, acuity or ReddyAcuity(), float(degrees.max()), most)
        _finish(rates, "rates as they are", "rate", (1 / 400, 1.3))
        _finish(samples, f"at {mean_spp:g} paths per pixel", "samples per pixel", (spp / 400, spp * 1.3))
        handles, labels = rates.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=SMALL)
        save_figure(figure, Path(path), 1.0)
    return Path(path)


def draw_sample_maps(
    samples: Mapping[str, SampleMap],
    path: str | os.PathLike[str],
    *,
    camera: Camera | StereoCamera,
    acuity: Callable[[Tensor], Tensor] | None = None,
) -> Path:
    """Draws how many paths sample maps have at each eccentricity, in pixels or in the cells of any raster.

    Paths are counted where they start on the screen (:meth:`fovden.foveation.SampleMap.on_screen`), in rings of one
    degree around each map's own gaze. The dashed line is acuity with as many paths as the first map: what would follow
    the eye.

    Args:
        samples: Up to seven maps by name.
        path: The file, a PNG.
        camera: The views of all of them.
        acuity: Relative acuity at eccentricities in degrees; ``None`` means Reddy's.

    Returns:
        The file.

    Raises:
        ValueError: If there are no maps or more than seven, or one is for another screen.

    Example:
        >>> import tempfile
        >>> from fovden.foveation import LinearFalloff, LogPolarWarp, sample_map, uniform_map
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(60, 60))
        >>> warp = LogPolarWarp.for_camera(camera, Gaze.center(camera))
        >>> maps = {"linear": sample_map(LinearFalloff(), camera), "log-polar": uniform_map(camera, 0.5, warp=warp)}
        >>> draw_sample_maps(maps, Path(tempfile.mkdtemp()) / "maps.png", camera=camera).name
        'maps.png'
    """
    require(1 <= len(samples) <= len(STYLES), "samples", len(samples), f"1 to {len(STYLES)} of them")
    views, model = camera.views, acuity or ReddyAcuity()
    with drawing():
        figure = Figure(figsize=(PRINT_WIDTH, 3.4), layout="constrained")
        panel = figure.subplots()
        most, mean, wanted = 0.0, 0.0, 0.0
        for (name, each), style in zip(samples.items(), STYLES, strict=False):
            paths, degrees = each.on_screen().double(), eccentricity_degrees(each.gaze, views).detach().double()
            require_shapes("v 1 h w", **{f"samples[{name!r}]": paths, "camera's eccentricity": degrees})
            places, means = density_by_eccentricity(paths, degrees, WIDTH)
            most = max(most, *means)
            mean = mean or float(paths.mean())
            wanted = wanted or mean / float(model(degrees).mean())
            _line(panel, name, style, (places, means))
        _acuity(panel, model, float(degrees.max()), wanted)
        _finish(panel, "", "paths per pixel", (mean / 100, most * 1.3))
        figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=SMALL)
        save_figure(figure, Path(path), 1.0)
    return Path(path)


def _line(panel: Any, name: str | None, style: MethodStyle, rings: tuple[list[float], list[float]]) -> None:
    every = max(1, len(rings[0]) // 8)
    marks = {} if name is None else {"marker": style.marker, "markersize": 3.5, "markevery": every}
    panel.plot(*rings, color=style.colour, linewidth=1, label=name, zorder=2, **marks)


def _acuity(panel: Any, model: Callable[[Tensor], Tensor], farthest: float, most: float) -> None:
    degrees = torch.linspace(0, farthest, 400, dtype=torch.float64)
    dashed = {"color": method_style("Reference").colour, "linestyle": "--", "linewidth": 1.6, "zorder": 1}
    panel.plot(degrees, most * model(degrees).numpy(), label="acuity", **dashed)


def _marks(panel: Any, style: MethodStyle, rings: tuple[list[float], list[float]]) -> None:
    every = max(1, len(rings[0]) // 16)
    kept = [(place, value) for place, value in zip(*rings, strict=True) if value > 0][::every]
    places, values = zip(*kept, strict=True)
    panel.plot(places, values, color=style.colour, marker=style.marker, markersize=3.5, linestyle="", zorder=3)


def _finish(panel: Any, title: str, quantity: str, limits: tuple[float, float]) -> None:
    panel.set_yscale("log")
    panel.set_ylim(*limits)
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.grid(color=GRID, linewidth=0.5)
    panel.set_axisbelow(True)
    panel.tick_params(which="both", length=2, color=FAINT)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    panel.set_title(title, loc="left")
    panel.set_xlabel("eccentricity, degrees")
    panel.set_ylabel(quantity)
