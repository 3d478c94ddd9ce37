"""Noisy frames: a G-buffer prepass over every pixel, then paths from the pixels that a sample map lists.

A path casts one shadow ray to a random light from the surface that the pixel shows, bounces once, and casts one shadow
ray there: the setting of the 2023 paper (section 3.4), and of a path tracer with a maximal depth of three. Surfaces
scatter on both sides; emission leaves on the geometric normal's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor

from fovden import parallel
from fovden._rasters import same
from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_coordinates, require_integer
from fovden.foveation.sample_map import SampleMap
from fovden.frame import Frame
from fovden.rng import Stream
from fovden.tracer.arrays import LightChoice
from fovden.tracer.cells import cell_points, require_raster
from fovden.tracer.gbuffer import trace_visible
from fovden.tracer.gradient import attached, is_differentiable
from fovden.tracer.kernels.path import Setting
from fovden.tracer.points import surface_points
from fovden.tracer.scene import Scene
from fovden.tracer.sequence import Instant
from fovden.tracer.shading import Listed, run_paths, shaded
from fovden.warps import Warp

__all__ = ["Integrator", "Sampler", "trace_frame"]

NEVER = 1 << 30

Sampler = Literal["independent", "sobol"]
"""Where a path's random numbers come from, see :mod:`fovden.rng`."""


@dataclass(frozen=True)
class Integrator:
    """How paths are made.

    Attributes:
        bounces: How often a path goes on after the first surface, at least 0. One is the papers' setting; Mitsuba's
            ``max_depth`` is larger by two.
        lights: How each surface chooses a light; the mean does not depend on it. ``"uniform"`` is the papers',
            ``"power"`` and ``"tree"`` have less noise where lights differ and where there are many.
        sampler: Where random numbers come from: ``"independent"`` ones, or ``"sobol"``, which spreads the samples of a
            pixel evenly; its noise falls faster with their number, and has the same mean.
        roulette: Number of the bounce from which a path may end at random, with the chance that it no longer matters
            (Russian roulette); ``None`` for never. The mean does not depend on it.

    Example:
        >>> Integrator(bounces=4, roulette=3)
        Integrator(bounces=4, lights='uniform', sampler='independent', roulette=3)
    """

    bounces: int = 1
    lights: LightChoice = "uniform"
    sampler: Sampler = "independent"
    roulette: int | None = None

    def __post_init__(self) -> None:
        require_integer("bounces", self.bounces, minimum=0)
        if self.roulette is not None:
            require_integer("roulette", self.roulette, minimum=1)
        for name, known in (("lights", get_args(LightChoice)), ("sampler", get_args(Sampler))):
            value = getattr(self, name)
            require(value in known, name, value, f"one of {', '.join(known)}")

    def setting(self, seed: int, stream: Stream) -> Setting:
        """Returns the same as the kernels read it.

        Example:
            >>> Integrator().setting(7, Stream.PATH).bounces
            1
        """
        roulette = NEVER if self.roulette is None else self.roulette
        return Setting(seed, int(stream), get_args(Sampler).index(self.sampler), self.bounces, roulette)


PAPERS = Integrator()
"""How the 2019 and 2023 papers make paths."""


def trace_frame(
    scene: Scene,
    camera: Camera | StereoCamera,
    samples: SampleMap | int,
    *,
    warp: Warp | None = None,
    seed: int = 0,
    index: int = 0,
    jitter: tuple[float, float] = (0.0, 0.0),
    previous: Instant | None = None,
    integrator: Integrator = PAPERS,
    progress: parallel.Progress = None,
) -> Frame:
    """Returns a noisy frame: all views in one dispatch for the G-buffer and one for the paths.

    The result is a function of the arguments alone, to the bit: it depends neither on the number of threads nor on
    the order of the sample map's coordinates.

    With a ``warp`` the images are those of its cells, each traced along its own ray; nothing is resampled. Cells that
    no pixel of the screen reads (``warp.read``) get no paths, whatever ``samples`` says; they keep their geometry. A
    place that is no cell sees nothing.

    Args:
        scene: The scene.
        camera: The views.
        samples: How many paths each pixel gets, or one number for all pixels; in a raster, each cell.
        warp: The raster; ``None`` for that of the sample map, or else the camera's own.
        seed: Seed of the random numbers, 0 to 2^32 - 1.
        index: Number of the frame in its sequence, kept in the record.
        jitter: Shift (x, y) of the whole frame in pixels; (0, 0) means that rays pass through pixel centres. In a
            raster it counts in cells, from -0.5 to below 0.5.
        previous: Scene and camera of the previous frame, from which ``gbuffer.motion`` follows; ``None`` for none.
        integrator: How paths are made; by default as in the papers.
        progress: See :func:`fovden.parallel.run`.

    Returns:
        The frame.

    Raises:
        ShapeError: If camera and raster differ in the number of views.
        ValueError: If the scene has no light, the sample map is for another camera or raster, or an argument is out of
            range.

    Differentiable: light in the materials' albedo and emission along the same paths (:mod:`fovden.tracer.light_paths`),
    which then are traced twice; the G-buffer as :func:`trace_gbuffer` says. Light has no derivative in geometry. For
    the lights of ``scene.lights``, textures and less memory see :func:`fovden.tracer.record_paths`.

    Source: the 2023 paper, section 3.4; units and conventions as in :mod:`fovden.camera`.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> frame = trace_frame(scene, scene.camera.at(resolution=(16, 16)), 2, seed=1)
        >>> frame.radiance.shape, frame.counts.unique()
        (torch.Size([2, 3, 16, 16]), tensor([2], dtype=torch.int32))
    """
    views = camera.views
    require_integer("seed", seed, minimum=0, maximum=0xFFFFFFFF)
    require_light(scene)
    warp = samples.warp if isinstance(samples, SampleMap) and warp is None else warp
    wanted = _wanted(samples, views, warp)
    gbuffer, emission = trace_visible(scene, views, warp, jitter, previous)
    coordinates, at = wanted.coordinates, wanted.coordinates.long().unbind(1)
    points = torch.zeros(0, 2) if warp is None else cell_points(warp, jitter)[at]
    counts = wanted.counts[at[0], 0, at[1], at[2]]
    listed = Listed(coordinates, coordinates, torch.zeros(0, 3), points, counts)
    seen, setting = (gbuffer.prim, gbuffer.barycentric, emission), integrator.setting(seed, Stream.PATH)
    width = wanted.counts.shape[3]
    direct, indirect, luminance_squared = run_paths(
        scene, views, jitter, listed, seen, integrator.lights, setting, width=width, progress=progress
    )
    frame = Frame(
        direct=direct,
        indirect=indirect,
        emission=emission * (wanted.counts > 0),
        counts=wanted.counts,
        luminance_squared=luminance_squared,
        layer=wanted.layer,
        gbuffer=gbuffer,
        camera=views,
        gaze=wanted.gaze,
        jitter=(float(jitter[0]), float(jitter[1])),
        index=index,
        seed=seed,
        warp=warp,
    )
    if not is_differentiable(scene.materials.albedo, scene.materials.emission):
        return frame
    traced = surface_points(frame, coordinates)
    light = shaded(scene, traced, integrator.lights, setting, taped=True).shade()
    square = light.luminance_squared[:, None]
    return replace(
        frame,
        direct=attached(direct, traced.image(light.direct)),
        indirect=attached(indirect, traced.image(light.indirect)),
        luminance_squared=attached(luminance_squared, traced.image(square)),
    )


class _Wanted(NamedTuple):
    """The paths that a frame is to have."""

    counts: Tensor  # int32, (v, 1, h, w)
    coordinates: Tensor  # view, y, x of what has any, int32, (k, 3)
    layer: Tensor
    gaze: Gaze | None


def _wanted(samples: SampleMap | int, views: Camera, warp: Warp | None) -> _Wanted:
    """The paths of a sample map, or as many everywhere; none in cells that the screen does not read."""
    height, width = require_raster(views, warp)
    shape = (views.view_count, 1, height, width)
    read = None if warp is None else warp.read.cpu()
    if isinstance(samples, SampleMap):
        fits = samples.warp is None or same(samples.warp, warp)
        require(fits, "samples", "a sample map of another raster", "one of the warp")
        counts, coordinates = samples.counts, samples.coords
        fits = counts.shape[0] in (1, shape[0]) and tuple(counts.shape[1:]) == shape[1:]
        unit = "pixels" if warp is None else "cells"
        require(fits, "samples", tuple(counts.shape), f"a sample map for {shape[0]} views of {height} x {width} {unit}")
        require_coordinates("samples.coords", coordinates, shape[0], (height, width))
        counts, layer = counts.expand(shape).contiguous(), samples.layer.expand(shape).contiguous()
        if read is not None:
            at = coordinates.long().unbind(1)
            counts, coordinates = counts * read, coordinates[read[at[0], 0, at[1], at[2]]]
        return _Wanted(counts, coordinates, layer, samples.gaze)
    require_integer("samples", samples, minimum=1)
    counts = torch.full(shape, samples, dtype=torch.int32)
    if read is not None:
        counts = counts * read
    gaze = None if warp is None else warp.gaze
    return _Wanted(counts, counts[:, 0].nonzero().to(torch.int32), torch.zeros(shape, dtype=torch.int32), gaze)


def require_light(scene: Scene) -> None:
    """Raises a ``ValueError`` if no path could find light in the scene."""
    count = len(scene.kernel_arrays("uniform")[3].kind)
    expected = "at least one light or emissive material to trace paths (rays and the G-buffer need none)"
    require(count > 0, f"scene {scene.name!r}", "no light", expected)
