"""Frames to learn from and frames to be judged by: four scenes, each seen from poses that no two sets share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from experiments.compare_denoisers import sponza
from fovden.camera import StereoCamera
from fovden.foveation import ThreeLayer
from fovden.foveation.falloff import Falloff
from fovden.tracer import CameraPath, FrameDataset, Keyframe, Scene, Sequence, make_scene

__all__ = ["SCENES", "SETS", "frame_set"]

Point = tuple[float, float, float]
Pose = tuple[Point, Point]

SCENES = ("sponza", "atrium", "pink_room", "forest")
"""The scenes: one from a file, three made in code."""

SETS = ("train", "held_out", "test")
"""Frames to fit on, frames that say when to stop, and frames that are looked at once, at the end."""

SEEDS = {name: seed for seed, name in enumerate(SETS)}

SPONZA: Mapping[str, tuple[Pose, ...]] = {
    "train": (
        ((-3.0, 2.2, -0.4), (3.0, 1.8, 2.5)),
        ((9.0, 1.7, 0.6), (0.0, 3.0, -1.0)),
        ((2.0, 1.8, -0.6), (-6.0, 2.6, -3.5)),
    ),
    "held_out": (((-8.0, 5.6, -0.3), (2.0, 3.6, 1.0)),),
    "test": (((-11.5, 2.2, -0.4), (0.0, 3.4, 0.0)), ((5.0, 1.7, 1.2), (-2.0, 2.4, -4.0))),
}
"""Eyes and targets in Crytek's Sponza, metres. The first of the test is the 2023 paper's setting, see
:func:`experiments.compare_denoisers.sponza`."""

PATH: Mapping[str, tuple[int, ...]] = {"train": (150, 390, 720), "held_out": (560,), "test": (220, 880)}
"""Frames of the path of a scene made in code. The first pose of the test is the scene's own camera instead."""


@dataclass(frozen=True)
class _Place:
    """A scene, the camera whose lens all poses share, and the poses of each set."""

    scene: Scene
    camera: StereoCamera
    poses: Mapping[str, tuple[Pose, ...]]


@cache
def _place(name: str) -> _Place:
    if name == "sponza":
        scene, camera = sponza().view.load()
        return _Place(scene, camera, SPONZA)
    scene = make_scene(name)
    path, camera = scene.path, scene.view()
    assert path is not None
    poses = {each: tuple((path[frame].eye, path[frame].target) for frame in frames) for each, frames in PATH.items()}
    poses["test"] = ((camera.eye, camera.target), *poses["test"][1:])
    return _Place(scene, camera, poses)


def frame_set(
    scene: str,
    name: str,
    *,
    resolution: tuple[int, int] = (540, 480),
    spp: int = 4,
    falloff: Falloff | None = ThreeLayer(),  # noqa: B008 - frozen
    draws: int = 1,
    reference_spp: int | None = 512,
    folder: Path | None = None,
) -> FrameDataset:
    """Returns a set of frames of a scene. Poses and random numbers of two sets have nothing in common.

    Args:
        scene: One of ``SCENES``.
        name: One of ``SETS``.
        resolution: Height and width of each eye's image.
        spp: Samples per traced pixel.
        falloff: How the samples are spread; ``None`` for ``spp`` everywhere.
        draws: Frames of each pose, with noise of their own.
        reference_spp: Samples per pixel of the references; ``None`` for none.
        folder: Where references are kept.

    Returns:
        The frames, those of the first pose at 0, n, 2 n, ... where there are n poses.

    Example:
        >>> len(frame_set("atrium", "train", draws=2))
        6
    """
    place = _place(scene)
    camera = place.camera.at(resolution=resolution)
    keyframes = [Keyframe(number, eye, target, held=True) for number, (eye, target) in enumerate(place.poses[name])]
    if len(keyframes) == 1:  # a path has two keyframes at least
        keyframes.append(keyframes[0]._replace(frame=1))
    sequence = Sequence(place.scene, CameraPath(camera, tuple(keyframes)), frames=len(place.poses[name]))
    return FrameDataset(sequence, falloff, spp, SEEDS[name], draws=draws, reference_spp=reference_spp, folder=folder)
