"""Frames for training: a data set that traces them when they are asked for, in the workers of a ``DataLoader``."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence as Items
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset

from fovden.camera import Gaze
from fovden.checks import require, require_integer
from fovden.foveation.falloff import Falloff
from fovden.foveation.sample_map import SampleMap, sample_map
from fovden.frame import Frame, Reference
from fovden.tracer.cells import require_raster
from fovden.tracer.integrator import PAPERS, Integrator, require_light, trace_frame
from fovden.tracer.reference import accumulate_reference
from fovden.tracer.sequence import Instant, Sequence
from fovden.warps import Warp

__all__ = ["FrameDataset"]

Item = tuple[Frame, Reference | None]


@dataclass(frozen=True, eq=False)
class FrameDataset(Dataset[Item]):
    """The frames of a sequence, noisy, each with its reference if wanted.

    Item i is traced when it is asked for. It is a function of the data set and of i alone, to the bit, whichever
    process makes it and in whatever order. Its motion vectors lead to the frame before it in the sequence; those of the
    first frame are zero.

    Workers need no preparation: PyTorch gives each a single thread, and random numbers are functions of the item's
    number, not of a state. One that is forked shares the scene, its acceleration structure and its textures with its
    parent; one that is spawned gets scene and structure in shared memory.

    Attributes:
        sequence: What is seen.
        falloff: How the samples are spread, such as :class:`fovden.foveation.ThreeLayer`; ``None`` for ``spp``
            everywhere.
        spp: Samples per pixel, or cell, at full rate.
        seed: Seed of all random numbers, 0 to 2^32 - 1. Masks and paths of every item are independent; those of two
            data sets are too, if their seeds differ.
        draws: How many items each frame of the sequence gives, with different masks and noise: item i is a draw of
            frame ``i % len(sequence)``.
        reference_spp: Samples per pixel of the references; ``None`` for none.
        folder: Existing folder that keeps references, so that each is traced once; ``None`` traces them every time.
        integrator: How paths are made. Those of references have as many bounces, and choose lights by power.
        warp: A raster in whose cells the noisy frames are traced, each around the gaze of its own frame; that of
            ``warp`` itself does not matter. References are on the screen. ``None`` for the camera's own raster.

    Raises:
        ValueError: If a number is out of range, the folder is not there, nothing in the scene gives light, or the
            raster is for another screen.

    Example:
        >>> from torch.utils.data import DataLoader
        >>> from fovden.foveation import ThreeLayer
        >>> from fovden.tracer import Sequence, make_scene
        >>> sequence = Sequence(make_scene("cornell_box"), frames=3).at(resolution=(16, 16))
        >>> dataset = FrameDataset(sequence, ThreeLayer(), spp=2, reference_spp=4)
        >>> for frames, references in DataLoader(dataset, batch_size=3, collate_fn=dataset.collate):
        ...     print(frames.radiance.shape, references.mean.shape)
        torch.Size([6, 3, 16, 16]) torch.Size([6, 3, 16, 16])
    """

    sequence: Sequence
    falloff: Falloff | None = None
    spp: int = 4
    seed: int = 0
    draws: int = 1
    reference_spp: int | None = None
    folder: str | os.PathLike[str] | None = None
    integrator: Integrator = PAPERS
    warp: Warp | None = None

    def __post_init__(self) -> None:
        require_integer("spp", self.spp, minimum=1)
        require_integer("seed", self.seed, minimum=0, maximum=0xFFFFFFFF)
        require_integer("draws", self.draws, minimum=1)
        if self.reference_spp is not None:
            require_integer("reference_spp", self.reference_spp, minimum=1)
        if self.folder is not None:
            require(Path(self.folder).is_dir(), "folder", self.folder, "an existing folder")
        first = self.sequence[0]
        require_raster(first.camera, self._warp(first))
        require_light(first.scene)  # here, not in a worker; and what it makes, forked workers share

    def __len__(self) -> int:
        return self.draws * len(self.sequence)

    def __getitem__(self, index: int) -> Item:
        """Returns a noisy frame and its reference; negative numbers count from the end."""
        require_integer("index", index)
        if not -len(self) <= index < len(self):
            raise IndexError(f"index: expected one from 0 to {len(self) - 1}, got {index}")
        index %= len(self)
        number = index % len(self.sequence)
        previous = self.sequence[number - 1] if number > 0 else None
        # Copies: a worker moves the tensors of an item to shared memory, while the next one is being made from these.
        scene, camera, gaze = self.sequence[number]
        camera, gaze = copy.deepcopy((camera, gaze))
        warp = self._warp(Instant(scene, camera, gaze))
        samples: SampleMap | int = self.spp
        if self.falloff is not None:
            samples = sample_map(self.falloff, camera, gaze, self.spp, self.seed, warp=warp, index=index)
        frame = trace_frame(
            scene,
            camera,
            samples,
            warp=warp,
            seed=self._seed(index),
            index=number,
            previous=previous,
            integrator=self.integrator,
        )
        if self.reference_spp is None:
            return frame, None
        checkpoint = None
        if self.folder is not None:
            checkpoint = Path(self.folder) / f"{scene.name}-{number:05d}-{self.seed}.safetensors"
        reference = accumulate_reference(
            scene,
            camera,
            spp=self.reference_spp,
            seed=self._seed(number),
            checkpoint=checkpoint,
            integrator=replace(self.integrator, lights="power"),
            progress=None,
        )
        return frame, reference

    def _warp(self, seen: Instant) -> Warp | None:
        """The raster around the gaze of an instant."""
        if self.warp is None:
            return None
        return replace(self.warp, gaze=Gaze.center(seen.camera) if seen.gaze is None else seen.gaze)

    def _seed(self, number: int) -> int:
        """NumPy's hash of two numbers; with their sum, neighbouring seeds would share most of their noise."""
        return int(np.random.SeedSequence((self.seed, number)).generate_state(1)[0])

    @staticmethod
    def collate(items: Items[Item]) -> Item:
        """Returns the items as one, their views along the first axis; for ``DataLoader(collate_fn=...)``.

        Args:
            items: At least one; all have a reference or none has.

        Returns:
            All frames, as :meth:`fovden.Frame.stack` joins them, and all references in the same way.

        Raises:
            ValueError: If there is no item, or resolutions or numbers of samples differ.

        Example:
            >>> from fovden.tracer import Sequence, make_scene
            >>> dataset = FrameDataset(Sequence(make_scene("cornell_box"), frames=2).at(resolution=(8, 8)), spp=1)
            >>> frame, reference = FrameDataset.collate([dataset[0], dataset[1]])
            >>> frame.view_count, reference
            (4, None)
        """
        frame = Frame.stack([frame for frame, _ in items])
        references = [reference for _, reference in items if reference is not None]
        if not references:
            return frame, None
        require(len(references) == len(items), "items", f"{len(references)} references", "one for each frame or none")
        counts = {reference.count for reference in references}
        require(len(counts) == 1, "items", f"references of {sorted(counts)} samples", "the same number in all")
        mean = torch.cat([reference.mean for reference in references])
        variance = torch.cat([reference.variance for reference in references])
        return frame, Reference(mean, variance, references[0].count, frame.camera, references[0].seed)
