"""What moves in a scene: rigid parts of its geometry, and lights that travel, fade and switch."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from fovden.checks import require, require_integer
from fovden.tracer.curves import interpolate, interpolate_rotations, require_frames, rotation_matrix
from fovden.tracer.lights import Light
from fovden.tracer.scene import Scene

__all__ = ["LightKeyframe", "LightPath", "Pose", "RigidMotion"]

Vector = tuple[float, float, float]


class Pose(NamedTuple):
    """How a rigid part stands in one frame, relative to where the scene has it.

    Attributes:
        frame: Number of the frame, from 0.
        translation: Shift of the pivot in metres.
        rotation: Turn about the pivot, a quaternion (x, y, z, w) as in glTF and OpenXR; scaled to length 1.
        held: Whether the part stays until the next keyframe, and jumps there.

    Example:
        >>> Pose(0).rotation
        (0.0, 0.0, 0.0, 1.0)
    """

    frame: int
    translation: Vector = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    held: bool = False


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A part of the scene that moves without changing its shape.

    With the pivot c, the translation t and the rotation R of a frame, its vertices go from x to c + t + R (x - c).
    Translations follow :func:`fovden.tracer.curves.interpolate`, rotations
    :func:`fovden.tracer.curves.interpolate_rotations`.

    Attributes:
        part: Name of a material or several, or a boolean for each triangle of the scene, shape (m).
        keyframes: At least one pose, numbered upwards from 0. The last pose is kept afterwards.
        pivot: Point about which the part turns, where the scene has it, metres; ``None`` for the centre of the part's
            bounding box.

    Raises:
        ValueError: If the frames do not rise from 0, or a pose is not three and four finite numbers.

    Example:
        >>> half_turn = (0.0, 1.0, 0.0, 0.0)
        >>> motion = RigidMotion("door", (Pose(0), Pose(20, rotation=half_turn)), pivot=(1.0, 0.0, 2.0))
        >>> motion[10].rotation
        (0.0, 0.707..., 0.0, 0.707...)
    """

    part: str | tuple[str, ...] | Tensor
    keyframes: tuple[Pose, ...]
    pivot: Vector | None = None

    def __post_init__(self) -> None:
        keys = [Pose(*key) for key in self.keyframes]
        require_frames("keyframes", [key.frame for key in keys])
        for i, key in enumerate(keys):
            shift, turn = np.asarray(key.translation, dtype=np.float64), np.asarray(key.rotation, dtype=np.float64)
            sound = shift.shape == (3,) and bool(np.isfinite(shift).all())
            require(sound, "Pose.translation", key.translation, "three finite numbers")
            sound = turn.shape == (4,) and bool(np.isfinite(turn).all()) and bool(turn.any())
            require(sound, "Pose.rotation", key.rotation, "four finite numbers, not all of them zero")
            x, y, z, w = (turn / np.linalg.norm(turn)).tolist()
            keys[i] = key._replace(translation=tuple(shift.tolist()), rotation=(x, y, z, w))
        object.__setattr__(self, "keyframes", tuple(keys))

    def __len__(self) -> int:
        return self.keyframes[-1].frame + 1

    def __getitem__(self, frame: int) -> Pose:
        """Returns the pose of a frame."""
        require_integer("frame", frame, minimum=0)
        frames, translations, rotations, held = zip(*self.keyframes, strict=True)
        shift = interpolate(frames, translations, held, frame).tolist()
        turn = interpolate_rotations(frames, rotations, held, frame).tolist()
        return Pose(frame, tuple(shift), tuple(turn))

    def faces(self, scene: Scene) -> Tensor:
        """Returns which triangles of a scene move, as booleans of shape (m).

        Args:
            scene: The scene.

        Returns:
            The mask; at least one is true.

        Raises:
            ValueError: If there is no such material, the mask has another shape, or no triangle moves.

        Example:
            >>> from fovden.tracer import make_scene
            >>> int(RigidMotion("red", (Pose(0),)).faces(make_scene("cornell_box")).sum())
            2
        """
        if isinstance(self.part, Tensor):
            fits = self.part.dtype == torch.bool and tuple(self.part.shape) == (scene.triangle_count,)
            found = f"{self.part.dtype} of shape {tuple(self.part.shape)}"
            require(fits, "RigidMotion.part", found, f"booleans of shape ({scene.triangle_count})")
            mask = self.part
        else:
            names = (self.part,) if isinstance(self.part, str) else self.part
            known = scene.materials.names
            for name in names:
                require(name in known, "RigidMotion.part", name, f"a material of the scene: {', '.join(known)}")
            chosen = torch.tensor([name in names for name in known])
            mask = chosen[scene.material_ids.long()]
        require(bool(mask.any()), "RigidMotion.part", "no triangle", "at least one triangle")
        return mask

    def moved(self, points: Tensor, frame: int) -> Tensor:
        """Returns where points of the part are in a frame.

        Args:
            points: All vertices of the part where the scene has them, metres, shape (k, 3).
            frame: Number of the frame, at least 0.

        Returns:
            The positions, float64, shape (k, 3).

        Example:
            >>> motion = RigidMotion("door", (Pose(0, rotation=(0, 1, 0, 0)),), pivot=(1.0, 0.0, 0.0))
            >>> motion.moved(torch.tensor([[2.0, 3.0, 0.0]]), frame=0)
            tensor([[0., 3., 0.]], dtype=torch.float64)
        """
        points = points.double()
        pose = self[frame]
        pivot = (points.amin(0) + points.amax(0)) / 2 if self.pivot is None else points.new_tensor(self.pivot)
        return (points - pivot) @ self._matrix(pose).T + pivot + points.new_tensor(pose.translation)

    def turned(self, directions: Tensor, frame: int) -> Tensor:
        """Returns directions that belong to the part, such as normals, as they are in a frame.

        Args:
            directions: Vectors, shape (k, 3).
            frame: Number of the frame, at least 0.

        Returns:
            The vectors, float64, shape (k, 3).

        Example:
            >>> RigidMotion("door", (Pose(0, rotation=(0, 1, 0, 0)),)).turned(torch.tensor([[0.0, 0.0, 1.0]]), frame=0)
            tensor([[ 0.,  0., -1.]], dtype=torch.float64)
        """
        return directions.double() @ self._matrix(self[frame]).T

    def _matrix(self, pose: Pose) -> Tensor:
        return torch.from_numpy(rotation_matrix(pose.rotation))


class LightKeyframe(NamedTuple):
    """What a light is in one frame.

    Attributes:
        frame: Number of the frame, from 0.
        light: The light.
        held: Whether it stays so until the next keyframe, and switches there.

    Example:
        >>> from fovden.tracer import PointLight
        >>> LightKeyframe(0, PointLight((0, 2, 0), 40), held=True).light.intensity
        (40.0, 40.0, 40.0)
    """

    frame: int
    light: Light
    held: bool = False


@dataclass(frozen=True, eq=False)
class LightPath:
    """A light that travels, fades or switches.

    Every number of the light (position or direction, intensity, irradiance or radiance) follows
    :func:`fovden.tracer.curves.interpolate`; a colour that would fall below 0 on the way is 0.

    Attributes:
        keyframes: At least one, numbered upwards from 0, with lights of one kind; an environment that is an image can
            only switch (``held``). The last light is kept afterwards.

    Raises:
        ValueError: If the frames do not rise from 0, kinds differ, or an image would have to change smoothly.

    Example:
        >>> from fovden.tracer import PointLight
        >>> lamp, dark = PointLight((0, 2, 0), 40), PointLight((0, 2, 0), 0)
        >>> fading = LightPath((LightKeyframe(0, lamp), LightKeyframe(10, dark)))
        >>> switched = LightPath((LightKeyframe(0, lamp, held=True), LightKeyframe(10, dark)))
        >>> fading[5].intensity, switched[5].intensity, switched[10].intensity
        ((20.0, 20.0, 20.0), (40.0, 40.0, 40.0), (0.0, 0.0, 0.0))
    """

    keyframes: tuple[LightKeyframe, ...]

    def __post_init__(self) -> None:
        keys = tuple(LightKeyframe(*key) for key in self.keyframes)
        object.__setattr__(self, "keyframes", keys)
        require_frames("keyframes", [key.frame for key in keys])
        kinds = {type(key.light).__name__ for key in keys}
        require(len(kinds) == 1, "keyframes", ", ".join(sorted(kinds)), "lights of one kind")
        for before, after in pairwise(keys):
            images = any(isinstance(v, Tensor) for key in (before, after) for v in vars(key.light).values())
            require(
                before.held or not images, "keyframes", "an image that is not held", "held=True before and at images"
            )

    def __len__(self) -> int:
        return self.keyframes[-1].frame + 1

    def __getitem__(self, frame: int) -> Light:
        """Returns the light of a frame."""
        require_integer("frame", frame, minimum=0)
        current = [key for key in self.keyframes if key.frame <= frame][-1]
        if current.held or frame in (current.frame, self.keyframes[-1].frame) or current is self.keyframes[-1]:
            return current.light
        frames, lights, held = zip(*self.keyframes, strict=True)
        values = {}
        for field in fields(current.light):
            between = interpolate(frames, [_numbers(getattr(light, field.name)) for light in lights], held, frame)
            colour = field.name in {"intensity", "irradiance", "radiance"}
            values[field.name] = tuple((between.clip(min=0) if colour else between).tolist())
        return type(current.light)(**values)


def _numbers(value: Tensor | tuple[float, ...]) -> tuple[float, ...]:
    """Three numbers; those of an image do not matter, since curves end at it."""
    return (0.0, 0.0, 0.0) if isinstance(value, Tensor) else value
