"""Noisy frames: a G-buffer prepass over every pixel, then paths from the pixels that a sample map lists.

A path casts one shadow ray to a random light from the surface that the pixel shows, bounces once, and casts one shadow
ray there: the setting of the 2023 paper (section 3.4), and of a path tracer with a maximal depth of three. Surfaces
scatter on both sides; emission leaves on the geometric normal's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch

from fovden import parallel
from fovden.camera import Camera, StereoCamera
from fovden.checks import require, require_coordinates, require_integer
from fovden.foveation.sample_map import SampleMap
from fovden.frame import Frame
from fovden.rng import Stream
from fovden.tracer.arrays import LightChoice
from fovden.tracer.gbuffer import trace_visible
from fovden.tracer.gradient import attached, is_differentiable
from fovden.tracer.kernels.path import Setting
from fovden.tracer.points import surface_points
from fovden.tracer.scene import Scene
from fovden.tracer.sequence import Instant
from fovden.tracer.shading import Listed, run_paths, shaded

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

    Args:
        scene: The scene.
        camera: The views.
        samples: How many paths each pixel gets, or one number for all pixels.
        seed: Seed of the random numbers, 0 to 2^32 - 1.
        index: Number of the frame in its sequence, kept in the record.
        jitter: Shift (x, y) of the whole frame in pixels; (0, 0) means that rays pass through pixel centres.
        previous: Scene and camera of the previous frame, from which ``gbuffer.motion`` follows; ``None`` for none.
        integrator: How paths are made; by default as in the papers.
        progress: See :func:`fovden.parallel.run`.

    Returns:
        The frame.

    Raises:
        ValueError: If the scene has no light, the sample map is for another camera, or an argument is out of range.

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
    height, width = views.resolution
    shape = (views.view_count, 1, height, width)
    require_integer("seed", seed, minimum=0, maximum=0xFFFFFFFF)
    require_light(scene)
    if isinstance(samples, SampleMap):
        counts, layer = samples.counts, samples.layer
        fits = counts.shape[0] in (1, shape[0]) and tuple(counts.shape[1:]) == shape[1:]
        require(fits, "samples", tuple(counts.shape), f"a sample map for {shape[0]} views of {height} x {width} pixels")
        counts, layer = counts.expand(shape).contiguous(), layer.expand(shape).contiguous()
        coordinates, gaze = samples.coords, samples.gaze
        require_coordinates("samples.coords", coordinates, shape[0], views.resolution)
    else:
        require_integer("samples", samples, minimum=1)
        counts = torch.full(shape, samples, dtype=torch.int32)
        layer, gaze = torch.zeros(shape, dtype=torch.int32), None
        coordinates = counts[:, 0].nonzero().to(torch.int32)
    gbuffer, emission = trace_visible(scene, views, jitter, previous)
    at = coordinates.long()
    listed = Listed(coordinates, coordinates, torch.zeros(0, 3), counts[at[:, 0], 0, at[:, 1], at[:, 2]])
    seen, setting = (gbuffer.prim, gbuffer.barycentric, emission), integrator.setting(seed, Stream.PATH)
    direct, indirect, luminance_squared = run_paths(
        scene, views, jitter, listed, seen, integrator.lights, setting, progress=progress
    )
    frame = Frame(
        direct=direct,
        indirect=indirect,
        emission=emission * (counts > 0),
        counts=counts,
        luminance_squared=luminance_squared,
        layer=layer,
        gbuffer=gbuffer,
        camera=views,
        gaze=gaze,
        jitter=(float(jitter[0]), float(jitter[1])),
        index=index,
        seed=seed,
    )
    if not is_differentiable(scene.materials.albedo, scene.materials.emission):
        return frame
    points = surface_points(frame, coordinates)
    light = shaded(scene, points, integrator.lights, setting, taped=True).shade()
    square = light.luminance_squared[:, None]
    return replace(
        frame,
        direct=attached(direct, points.image(light.direct)),
        indirect=attached(indirect, points.image(light.indirect)),
        luminance_squared=attached(luminance_squared, points.image(square)),
    )


def require_light(scene: Scene) -> None:
    """Raises a ``ValueError`` if no path could find light in the scene."""
    count = len(scene.kernel_arrays("uniform")[3].kind)
    expected = "at least one light or emissive material to trace paths (rays and the G-buffer need none)"
    require(count > 0, f"scene {scene.name!r}", "no light", expected)
