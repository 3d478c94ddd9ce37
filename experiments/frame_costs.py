"""What a foveated frame costs, by the work that is done for it, on one thread.

A search that asked the clock at every trial would find what other processes do. So the clock is asked first, for frames
of known work, one kind after the other in rounds, and the medians over the rounds are the costs of a unit:

    seconds = G-buffer pixels * a + traced pixels * b + paths * c + d + filtered pixels * e + filling

Filtered pixels are counted as the fused passes work: in blocks of sixteen pixels in a row, all of which are filtered
where one belongs to the layer, once for each pass of that layer. What it takes to fill the holes that no pass reached
depends on how far each has to look, which nobody counts: that part is timed in every frame.
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from fovden.camera import Camera, StereoCamera
from fovden.filters import NonHomogeneousAtrous
from fovden.foveation import SampleMap
from fovden.frame import Frame
from fovden.tracer import Scene, trace_frame, trace_gbuffer

__all__ = ["UnitCosts", "WatchedAtrous", "Work", "measure_costs", "timed", "unlit", "watched", "work_of"]

BLOCK = 16
"""Pixels of a block of the fused passes."""

MANY = 8
"""Samples per pixel of the frame that is compared with one of a single sample."""


class Work(NamedTuple):
    """What is done for one frame.

    Attributes:
        pixels: Pixels of all views.
        traced: Those of them that are traced.
        paths: Paths.
        filtered: Filtered pixels, once for each pass.
        filling: Seconds in which holes were filled.

    Example:
        >>> Work(200, 100, 400, 800, 0).paths
        400
    """

    pixels: float
    traced: float
    paths: float
    filtered: float
    filling: float

    @classmethod
    def mean(cls, works: Sequence[Work]) -> Work:
        """Returns the mean of several frames' work.

        Example:
            >>> Work.mean([Work(2, 1, 4, 8, 0), Work(2, 2, 8, 8, 1)]).paths
            6.0
        """
        return cls(*(statistics.fmean(values) for values in zip(*works, strict=True)))


class UnitCosts(NamedTuple):
    """Seconds of a unit of each kind of work; see the module's formula.

    Attributes:
        pixel: Of a pixel of the G-buffer: a.
        traced: Of a traced pixel, beside its paths: b.
        path: Of a path: c.
        frame: Of denoising any frame: d.
        filtered: Of a filtered pixel: e.

    Example:
        >>> costs = UnitCosts(1e-7, 0, 1e-6, 0.01, 1e-8)
        >>> work = Work(pixels=200_000, traced=100_000, paths=400_000, filtered=800_000, filling=0.02)
        >>> round(costs.passes(work), 6), round(costs.total(work), 6)
        (0.018, 0.458)
    """

    pixel: float
    traced: float
    path: float
    frame: float
    filtered: float

    @classmethod
    def median(cls, rounds: Sequence[UnitCosts]) -> UnitCosts:
        """Returns the median of each cost.

        Example:
            >>> UnitCosts.median([UnitCosts(1, 0, 0, 0, 0), UnitCosts(2, 0, 0, 0, 0), UnitCosts(9, 0, 0, 0, 0)]).pixel
            2
        """
        return cls(*(statistics.median(values) for values in zip(*rounds, strict=True)))

    def passes(self, work: Work) -> float:
        """Returns the seconds of the denoiser without those in which holes are filled.

        Example:
            >>> UnitCosts(0, 0, 0, 1, 2).passes(Work(1, 1, 1, 3, 9))
            7
        """
        return self.frame + self.filtered * work.filtered

    def total(self, work: Work) -> float:
        """Returns the seconds of the frame.

        Example:
            >>> UnitCosts(1, 10, 100, 0, 0).total(Work(2, 3, 4, 5, 6))
            438
        """
        tracing = self.pixel * work.pixels + self.traced * work.traced + self.path * work.paths
        return tracing + self.passes(work) + work.filling


class WatchedAtrous(NonHomogeneousAtrous):
    """The non-homogeneous denoiser, which says in how many seconds of its thread it filled the last frame's holes.

    Example:
        >>> from fovden.frame import GBuffer
        >>> counts = (torch.arange(256) < 1).float().reshape(1, 1, 16, 16)
        >>> frame = Frame.from_radiance(torch.ones(1, 3, 16, 16), GBuffer.empty(1, (16, 16)), counts=counts)
        >>> denoiser = WatchedAtrous((1,))
        >>> _ = denoiser(frame)
        >>> denoiser.seconds_filling > 0
        True
    """

    seconds_filling = 0.0

    def _fill(self, *arguments: Any) -> Tensor:
        began = time.thread_time()
        image = super()._fill(*arguments)
        self.seconds_filling = time.thread_time() - began
        return image


def watched(levels: Sequence[int], **options: Any) -> WatchedAtrous:
    """Returns the denoiser with any numbers of passes, equal ones too, about which the class warns.

    Args:
        levels: Passes of each layer.
        **options: Keywords of :class:`fovden.filters.NonHomogeneousAtrous`.

    Example:
        >>> watched((2, 2, 2)).levels
        (2, 2, 2)
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return WatchedAtrous(levels, **options)


def work_of(frame: Frame, levels: Sequence[int], filling: float) -> Work:
    """Returns the work that was done for a frame.

    Args:
        frame: The frame, with its layers.
        levels: Passes of each layer; the last serves all further ones.
        filling: Seconds in which holes were filled.

    Example:
        >>> from fovden.frame import GBuffer
        >>> layer = (torch.arange(32) > 20).expand(1, 1, 2, 32)
        >>> frame = Frame.from_radiance(torch.ones(1, 3, 2, 32), GBuffer.empty(1, (2, 32)), layer=layer)
        >>> work_of(frame, (1, 3), 0)  # the second block holds pixels of both layers
        Work(pixels=64, traced=64, paths=64, filtered=160, filling=0)
    """
    layer = frame.layer.clamp(max=len(levels) - 1)
    filtered = 0
    for number, passes in enumerate(levels):
        blocks = (layer == number).split(BLOCK, -1)
        filtered += passes * sum(int(block.any(-1).sum()) * block.shape[-1] for block in blocks)
    sampled = frame.mask > 0
    paths = int((frame.counts * sampled).sum())
    return Work(layer.numel(), int(sampled.sum()), paths, filtered, filling)


def timed(call: Callable[[], Any]) -> float:
    """Returns the processor seconds of this thread that a call takes.

    Example:
        >>> timed(lambda: sum(range(1000))) > 0
        True
    """
    began = time.thread_time()
    call()
    return time.thread_time() - began


def measure_costs(
    scene: Scene, camera: Camera | StereoCamera, samples: SampleMap, few: WatchedAtrous, many: WatchedAtrous
) -> UnitCosts:
    """Returns the costs of a unit, each timed once: one round. The first one compiles.

    Args:
        scene: The scene.
        camera: The views.
        samples: A foveated sample map of them.
        few: A denoiser of three layers and few passes.
        many: One of more passes.

    Example:
        >>> from fovden.foveation import ThreeLayer, sample_map
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> camera = scene.camera.at(resolution=(32, 32))
        >>> denoisers = watched((1, 1, 1)), watched((6, 6, 6))
        >>> costs = measure_costs(scene, camera, sample_map(ThreeLayer(), camera), *denoisers)
        >>> costs.pixel > 0
        True
    """
    gbuffer = timed(lambda: trace_gbuffer(scene, camera))
    one, more = (timed(lambda spp=spp: trace_frame(scene, camera, spp)) for spp in (1, MANY))
    frame = unlit(trace_frame(scene, camera, samples))
    seconds = []
    for denoiser in (few, many):
        with torch.no_grad():
            whole = timed(lambda denoiser=denoiser: denoiser(frame))
        seconds.append(whole - denoiser.seconds_filling)
    works = [work_of(frame, denoiser.levels, 0) for denoiser in (few, many)]
    pixels = works[0].pixels
    path = max(more - one, 0) / ((MANY - 1) * pixels)
    filtered = max(seconds[1] - seconds[0], 0) / (works[1].filtered - works[0].filtered)
    return UnitCosts(
        pixel=gbuffer / pixels,
        traced=(one - gbuffer) / pixels - path,
        path=path,
        frame=seconds[0] - filtered * works[0].filtered,
        filtered=filtered,
    )


def unlit(frame: Frame) -> Frame:
    """Returns a frame without what its pixels emit, with the rest of the light as one.

    Emission has no noise, and filling it costs more than all passes together.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> frame = trace_frame(scene, scene.camera.at(resolution=(16, 16)), 1)
        >>> frame.emission.max() > 0, unlit(frame).emission.max()
        (tensor(True), tensor(0.))
    """
    light = Frame.from_radiance(frame.direct + frame.indirect, frame.gbuffer, counts=frame.counts, layer=frame.layer)
    return replace(light, camera=frame.camera, gaze=frame.gaze)
