"""What a foveated frame costs, by the work that is done for it, on one thread.

A search that asked the clock at every trial would find what other processes do. So the clock is asked once, for frames
of known work, one kind after the other in rounds, and the medians over the rounds are the costs of a unit:

    seconds = G-buffer pixels * a + traced pixels * b + paths * c
            + d + filtered pixels * e + (f + looks * g, where there are holes)

Filtered pixels are counted as the fused passes work: in blocks of sixteen pixels in a row, all of which are filtered
where one belongs to the layer, once for each pass of that layer. A hole is a pixel that no pass reached. It is filled
from the nearest spacing of taps that has a value, and looks in vain at those of its layer's passes first: these and two
more are counted as its looks.
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

__all__ = ["Example", "UnitCosts", "WatchedAtrous", "Work", "measure_costs", "timed", "unlit", "watched", "work_of"]

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
        looks: Looks of all holes.

    Example:
        >>> Work(200, 100, 400, 800, 0).paths
        400
    """

    pixels: float
    traced: float
    paths: float
    filtered: float
    looks: float

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
        filling: Of filling any hole: f.
        look: Of a look: g.

    Example:
        >>> costs = UnitCosts(1e-7, 0, 1e-6, 0.01, 1e-8, 0.02, 1e-7)
        >>> work = Work(pixels=200_000, traced=100_000, paths=400_000, filtered=800_000, looks=0)
        >>> round(costs.tracing(work), 6), round(costs.denoising(work), 6)
        (0.42, 0.018)
    """

    pixel: float
    traced: float
    path: float
    frame: float
    filtered: float
    filling: float
    look: float

    def tracing(self, work: Work) -> float:
        """Returns the seconds of G-buffer and paths.

        Example:
            >>> UnitCosts(0, 0, 2, 0, 0, 0, 0).tracing(Work(1, 1, 4, 1, 0))
            8
        """
        return self.pixel * work.pixels + self.traced * work.traced + self.path * work.paths

    def denoising(self, work: Work) -> float:
        """Returns the seconds of the denoiser.

        Example:
            >>> UnitCosts(0, 0, 0, 1, 0, 2, 3).denoising(Work(1, 1, 1, 1, looks=2))
            9
        """
        filling = self.filling + self.look * work.looks if work.looks else 0
        return self.frame + self.filtered * work.filtered + filling


class WatchedAtrous(NonHomogeneousAtrous):
    """The non-homogeneous denoiser, which says what it filled last, and in how many seconds of its thread.

    Example:
        >>> from fovden.frame import GBuffer
        >>> counts = (torch.arange(256) < 1).float().reshape(1, 1, 16, 16)
        >>> frame = Frame.from_radiance(torch.ones(1, 3, 16, 16), GBuffer.empty(1, (16, 16)), counts=counts)
        >>> denoiser = WatchedAtrous((1,))
        >>> _ = denoiser(frame)
        >>> denoiser.looks / (1 + 2)  # all but the nine pixels that have the sampled corner as a tap
        247.0
    """

    looks = 0
    seconds_filling = 0.0

    def _fill(self, state: Any, normal: Tensor, position: Tensor, layer: Tensor, *rest: Any) -> Tensor:
        holes = [int((~state.known & (layer == number)).sum()) for number in range(len(self.levels))]
        self.looks = sum(count * (passes + 2) for count, passes in zip(holes, self.levels, strict=True))
        began = time.thread_time()
        image = super()._fill(state, normal, position, layer, *rest)
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


class Example(NamedTuple):
    """A view whose costs are measured.

    Attributes:
        scene: The scene.
        camera: The views.
        samples: A foveated sample map of them.
        sparse: A frame with few samples, and therefore many holes.

    Example:
        >>> Example._fields
        ('scene', 'camera', 'samples', 'sparse')
    """

    scene: Scene
    camera: Camera | StereoCamera
    samples: SampleMap
    sparse: Frame


def work_of(frame: Frame, levels: Sequence[int], looks: int) -> Work:
    """Returns the work that was done for a frame.

    Args:
        frame: The frame, with its layers.
        levels: Passes of each layer; the last serves all further ones.
        looks: Looks of all holes.

    Example:
        >>> from fovden.frame import GBuffer
        >>> layer = (torch.arange(32) > 20).expand(1, 1, 2, 32)
        >>> frame = Frame.from_radiance(torch.ones(1, 3, 2, 32), GBuffer.empty(1, (2, 32)), layer=layer)
        >>> work_of(frame, (1, 3), 0)  # the second block holds pixels of both layers
        Work(pixels=64, traced=64, paths=64, filtered=160, looks=0)
    """
    layer = frame.layer.clamp(max=len(levels) - 1)
    filtered = 0
    for number, passes in enumerate(levels):
        blocks = (layer == number).split(BLOCK, -1)
        filtered += passes * sum(int(block.any(-1).sum()) * block.shape[-1] for block in blocks)
    sampled = frame.mask > 0
    paths = int((frame.counts * sampled).sum())
    return Work(layer.numel(), int(sampled.sum()), paths, filtered, looks)


def timed(call: Callable[[], Any]) -> float:
    """Returns the processor seconds of this thread that a call takes.

    Example:
        >>> timed(lambda: sum(range(1000))) > 0
        True
    """
    began = time.thread_time()
    call()
    return time.thread_time() - began


def measure_costs(examples: Sequence[Example], rounds: int, few: WatchedAtrous, many: WatchedAtrous) -> UnitCosts:
    """Returns the costs of a unit, each the median over rounds; a round takes one example after the other.

    Args:
        examples: Views of one scene.
        rounds: Number of rounds, at least 1.
        few: A denoiser of three layers and few passes.
        many: One of more passes.

    Example:
        >>> from fovden.foveation import ThreeLayer, sample_map, thinned
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> camera = scene.camera.at(resolution=(32, 32))
        >>> samples, mask = sample_map(ThreeLayer(), camera), torch.zeros(1, 1, 32, 32)
        >>> mask[..., ::16, ::16] = 1
        >>> sparse = thinned(trace_frame(scene, camera, 1), mask)
        >>> denoisers = watched((1, 1, 1)), watched((6, 6, 6))
        >>> measure_costs([Example(scene, camera, samples, sparse)], 1, *denoisers).path > 0
        True
    """
    with torch.no_grad():  # what is compiled or built on first use
        few(unlit(trace_frame(examples[0].scene, examples[0].camera, 1)))
    rows: list[UnitCosts] = []
    for number in range(rounds):
        scene, camera, samples, sparse = examples[number % len(examples)]
        seconds = {"gbuffer": timed(lambda s=scene, c=camera: trace_gbuffer(s, c))}
        for spp in (1, MANY):
            seconds[f"{spp} spp"] = timed(lambda s=scene, c=camera, k=spp: trace_frame(s, c, k))
        pixels = sparse.layer.numel()
        path = max(seconds[f"{MANY} spp"] - seconds["1 spp"], 0) / ((MANY - 1) * pixels)
        traced = max(seconds["1 spp"] - seconds["gbuffer"], 0) / pixels - path
        frame = unlit(trace_frame(scene, camera, samples))
        filters, looks, filling = [], [], []
        for denoiser, seen in ((few, frame), (many, frame), (few, sparse)):
            with torch.no_grad():
                whole = timed(lambda d=denoiser, f=seen: d(f))
            filters.append(whole - denoiser.seconds_filling)
            looks.append(denoiser.looks)
            filling.append(denoiser.seconds_filling)
        works = [work_of(frame, denoiser.levels, 0) for denoiser in (few, many)]
        filtered = max(filters[1] - filters[0], 0) / (works[1].filtered - works[0].filtered)
        look = max(filling[2] - filling[1], 0) / max(looks[2] - looks[1], 1)
        rows.append(
            UnitCosts(
                pixel=seconds["gbuffer"] / pixels,
                traced=traced,
                path=path,
                frame=filters[0] - filtered * works[0].filtered,
                filtered=filtered,
                filling=max(filling[1] - look * looks[1], 0) if looks[1] else 0,
                look=look,
            )
        )
    return UnitCosts(*(statistics.median(values) for values in zip(*rows, strict=True)))


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
