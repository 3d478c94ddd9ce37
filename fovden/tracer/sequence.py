"""Sequences: a scene in which camera, gaze, objects and lights change from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_integer
from fovden.tracer.animation import LightPath, Pose, RigidMotion
from fovden.tracer.lights import Light
from fovden.tracer.scene import Scene
from fovden.tracer.trajectory import CameraPath, GazePath

__all__ = ["Instant", "Sequence"]

REST = Pose(0)


class Instant(NamedTuple):
    """What there is to see in one frame, and from where.

    Attributes:
        scene: The scene. The instants of a sequence have the same triangles in the same order, so that a triangle's
            number means the same surface in all of them.
        camera: The views.
        gaze: Where each eye looks; ``None`` for the centre of its image.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> Instant(scene, scene.camera).gaze is None
        True
    """

    scene: Scene
    camera: Camera | StereoCamera
    gaze: Gaze | None = None


@dataclass(frozen=True, eq=False)
class Sequence:
    """A scene over time: ``sequence[i]`` is the instant of frame i.

    Whatever has a path moves, everything else rests; a path that has ended keeps its last value. Vertices keep their
    order and triangles their numbers. Where nothing but lights and camera changes, the scenes of all frames share
    geometry and acceleration structure; where an object moves, the structure of the scene at rest is fitted to each
    frame, see :meth:`fovden.tracer.Scene.with_vertices`.

    Attributes:
        scene: The scene at rest.
        camera: A path or a camera that stands still; ``None`` for the scene's path, or else its camera.
        gaze: Where the eyes look; ``None`` for the centre of each image.
        objects: Parts that move. None of their vertices may belong to a triangle that rests or moves otherwise.
        lights: All lights, those that rest and those that have a path; ``None`` for the scene's. Emissive triangles
            shine besides, and move with their objects.
        frames: Number of frames; ``None`` for that of the longest path.

    Raises:
        ValueError: If the scene has neither camera nor path and none is given, objects overlap, or a part is none.

    Example:
        >>> from fovden.tracer import LightKeyframe, LightPath, PointLight, make_scene
        >>> scene = make_scene("cornell_box")
        >>> lamp = LightPath((LightKeyframe(0, PointLight((1, 1, 1), 5)), LightKeyframe(9, PointLight((4, 1, 1), 5))))
        >>> sequence = Sequence(scene, lights=(lamp,))
        >>> len(sequence), sequence[3].scene.lights[0].position
        (10, (2.0, 1.0, 1.0))
    """

    scene: Scene
    camera: CameraPath | StereoCamera | None = None
    gaze: GazePath | None = None
    objects: tuple[RigidMotion, ...] = ()
    lights: tuple[Light | LightPath, ...] | None = None
    frames: int | None = None

    def __post_init__(self) -> None:
        if self.camera is None:
            object.__setattr__(self, "camera", self.scene.path or self.scene.view())
        object.__setattr__(self, "objects", tuple(self.objects))
        if self.lights is not None:
            object.__setattr__(self, "lights", tuple(self.lights))
        if self.frames is not None:
            require_integer("frames", self.frames, minimum=1)
        moving = torch.zeros(len(self.scene.vertices), dtype=torch.int64)
        for vertices in self._parts:
            moving[vertices] += 1
        twice = int((moving > 1).sum())
        require(twice == 0, "objects", f"{twice} vertices in more than one", "parts that share no vertex")
        rest = torch.ones(self.scene.triangle_count, dtype=torch.bool)
        for motion in self.objects:
            rest &= ~motion.faces(self.scene)
        torn = int((moving[self.scene.faces[rest].long()] > 0).sum())
        require(torn == 0, "objects", f"{torn} corners of triangles that rest", "parts that share no vertex with these")

    def __len__(self) -> int:
        if self.frames is not None:
            return self.frames
        timed = [self.camera, self.gaze, *self.objects, *(self.lights or ())]
        kinds = (CameraPath, GazePath, RigidMotion, LightPath)
        return max([1, *(len(path) for path in timed if isinstance(path, kinds))])

    def __getitem__(self, frame: int) -> Instant:
        """Returns the instant of a frame; negative numbers count from the end."""
        require_integer("frame", frame)
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame: expected one from 0 to {len(self) - 1}, got {frame}")
        frame %= len(self)
        camera = self.camera
        if isinstance(camera, CameraPath):
            camera = camera[min(frame, len(camera) - 1)]
        assert camera is not None  # filled in above
        gaze = None if self.gaze is None else self.gaze.gaze(frame, camera)
        return Instant(self._lit(self._posed(frame), frame), camera, gaze)

    def __iter__(self) -> Iterator[Instant]:
        return (self[frame] for frame in range(len(self)))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in {"_recent", "_parts"}}

    def at(self, resolution: tuple[int, int]) -> Sequence:
        """Returns the same sequence seen with another height and width in pixels.

        Example:
            >>> from fovden.tracer import make_scene
            >>> Sequence(make_scene("cornell_box")).at(resolution=(32, 24))[0].camera.resolution
            (32, 24)
        """
        assert self.camera is not None
        return replace(self, camera=self.camera.at(resolution))

    @cached_property
    def _parts(self) -> list[Tensor]:
        """Numbers of the vertices of each object."""
        return [torch.unique(self.scene.faces[motion.faces(self.scene)].long()) for motion in self.objects]

    @cached_property
    def _recent(self) -> dict[tuple[Pose, ...], Scene]:
        """The scenes of the last two arrangements of the objects: one frame needs its own and the previous one."""
        return {}

    def _posed(self, frame: int) -> Scene:
        """The scene with the objects where they are in a frame."""
        poses = tuple(motion[frame]._replace(frame=0) for motion in self.objects)
        if all(pose == REST for pose in poses):
            return self.scene
        if poses not in self._recent:
            vertices, normals = self.scene.vertices.detach().clone(), self.scene.normals.detach().clone()
            for motion, part in zip(self.objects, self._parts, strict=True):
                vertices[part] = motion.moved(vertices[part], frame).float()
                normals[part] = motion.turned(normals[part], frame).float()
            while len(self._recent) >= 2:
                del self._recent[next(iter(self._recent))]
            self._recent[poses] = self.scene.with_vertices(vertices, normals)
        return self._recent[poses]

    def _lit(self, scene: Scene, frame: int) -> Scene:
        """The scene under the lights of a frame."""
        if self.lights is None:
            return scene
        lights = tuple(light[frame] if isinstance(light, LightPath) else light for light in self.lights)
        return scene.with_lights(lights)
