"""Foveated frames of any setting, out of frames that were traced everywhere once, and how far their images are off.

The paths of a pixel depend neither on other pixels nor on the number of its samples: a frame that was traced everywhere
holds every foveated frame of as many samples per pixel (:func:`fovden.foveation.thinned`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from experiments.frame_costs import WatchedAtrous, Work, unlit, work_of
from experiments.frame_sets import frame_set
from experiments.level_choices import Choice
from fovden import color, metrics
from fovden.camera import Gaze
from fovden.foveation import mask_numbers, thinned
from fovden.foveation.falloff import Falloff
from fovden.frame import Frame
from fovden.tracer import FrameDataset

__all__ = ["Pose", "geometric_mean"]


class Pose:
    """A view of a set of frames (:func:`experiments.frame_sets.frame_set`), traced when it is first needed.

    Emission is left out on both sides: it has no noise, and filling it costs more than all passes.

    Args:
        scene: Name of the scene.
        name: Name of the set.
        index: Number of the item, which decides pose, paths and mask.
        resolution: Height and width.
        reference_spp: Samples per pixel of the reference.
        folder: Where references are kept.

    Example:
        >>> from experiments.level_choices import NH3LD
        >>> pose = Pose("atrium", "train", 0, (32, 32), 4, None)
        >>> frame = pose.foveated(NH3LD)
        >>> image = NH3LD.denoiser((32, 0.1, 0.02))(frame).image
        >>> image.shape, len(pose.errors(image.detach())), 0.5 < frame.mask.mean().item() < 0.7
        (torch.Size([2, 3, 32, 32]), 2, True)
    """

    def __init__(
        self, scene: str, name: str, index: int, resolution: tuple[int, int], reference_spp: int, folder: Path | None
    ) -> None:
        self.scene, self.set, self.index, self.resolution = scene, name, index, resolution
        data = self.data(1, None, reference_spp, folder)
        frame, reference = data[index]
        assert reference is not None
        assert frame.camera is not None
        self.instant = data.sequence[index % len(data.sequence)]
        self.truth = (reference.mean - frame.emission).clamp(min=0)
        self.views, self.gaze = frame.camera, Gaze.center(frame.camera)
        self.numbers = mask_numbers(resolution, data.seed, index=index)
        self.acuity = metrics.acuity_weight(self.views, self.gaze)
        self.exposure = color.exposure(self.truth)
        self.frames = {1: unlit(frame)}

    def data(
        self, spp: int, falloff: Falloff | None, reference_spp: int | None = None, folder: Path | None = None
    ) -> FrameDataset:
        """Returns the set with so many samples per traced pixel; the same pixel has the same paths in all of them.

        Example:
            >>> pose = Pose("atrium", "train", 0, (16, 16), 1, None)
            >>> pose.data(2, None)[0][0].counts.unique()
            tensor([2], dtype=torch.int32)
        """
        return frame_set(
            self.scene, self.set, resolution=self.resolution, spp=spp, falloff=falloff, draws=self.index + 1,
            reference_spp=reference_spp, folder=folder,
        )  # fmt: skip

    def foveated(self, choice: Choice) -> Frame:
        """Returns the frame that tracing gives with the falloff of a choice, to rounding.

        Example:
            >>> pose = Pose("atrium", "train", 0, (16, 16), 1, None)
            >>> traced = pose.data(2, Choice((1,), 0.5, 1, 0.9, 2).falloff((16, 16)))[0][0]
            >>> torch.equal(pose.foveated(Choice((1,), 0.5, 1, 0.9, 2)).counts, traced.counts)
            True
        """
        if choice.spp not in self.frames:
            frame = unlit(self.data(choice.spp, None)[self.index][0])
            self.frames[choice.spp] = replace(frame, gbuffer=self.frames[1].gbuffer)  # the same, kept once
        rate, layer, _, _ = choice.falloff(self.resolution)(self.views, self.gaze)
        mask = (self.numbers < rate).to(rate.dtype)
        return thinned(self.frames[choice.spp], mask, layer, gaze=self.gaze)

    def denoised(self, choice: Choice, denoiser: WatchedAtrous) -> tuple[Tensor, Work]:
        """Returns the image of a choice, and the work that it takes.

        Example:
            >>> pose = Pose("atrium", "train", 0, (16, 16), 1, None)
            >>> from experiments.level_choices import BASE
            >>> image, work = pose.denoised(BASE, BASE.denoiser((32, 0.1, 0.02)))
            >>> work.paths, work.filtered
            (2048, 2560)
        """
        frame = self.foveated(choice)
        with torch.no_grad():
            image = denoiser(frame).image
        return image, work_of(frame, choice.levels, denoiser.seconds_filling)

    def errors(self, image: Tensor, l2: float = 5.0, ssim: float = 0.05) -> tuple[float, float]:
        """Returns how far an image is off: with all pixels alike, and weighted by acuity; means over the eyes.

        The error is ``l2 * MSE + ssim * (1 - SSIM)`` of what a display shows, as that of
        :class:`fovden.tuning.ImageError`. A pixel at e degrees from the gaze weighs 1 / (1 + e / 2.3)^2.

        Example:
            >>> pose = Pose("atrium", "train", 0, (16, 16), 1, None)
            >>> max(pose.errors(pose.truth)) < 1e-7
            True
        """
        shown, truth = (color.display(each, self.exposure) for each in (image, self.truth))
        squared, similarity = (shown - truth).square(), metrics.ssim_map(shown, truth)
        margin = (shown.shape[-1] - similarity.shape[-1]) // 2
        inner = slice(margin, -margin)
        found = []
        for weight in (None, self.acuity):
            own = None if weight is None else weight[..., inner, inner]
            off = l2 * metrics.weighted_mean(squared, weight) + ssim * (1 - metrics.weighted_mean(similarity, own))
            found.append(float(off.mean()))
        return found[0], found[1]


def geometric_mean(values: list[float]) -> float:
    """Returns the geometric mean, by which a scene that is hard to denoise counts no more than an easy one.

    Example:
        >>> round(geometric_mean([1.0, 4.0]), 6)
        2.0
    """
    return math.exp(math.fsum(map(math.log, values)) / len(values))
