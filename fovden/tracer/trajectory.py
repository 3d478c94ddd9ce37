"""Camera paths: a stereo camera that travels smoothly through keyframes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fovden.camera import StereoCamera
from fovden.checks import require, require_integer

__all__ = ["CameraPath", "Keyframe"]

Vector = tuple[float, float, float]


class Keyframe(NamedTuple):
    """Where the camera is and what it looks at in one frame.

    Attributes:
        frame: Number of the frame, from 0.
        eye: Point midway between the eyes, metres.
        target: Point looked at, metres.

    Example:
        >>> Keyframe(0, (0.0, 1.7, 5.0), (0.0, 1.5, 0.0)).frame
        0
    """

    frame: int
    eye: Vector
    target: Vector


@dataclass(frozen=True)
class CameraPath:
    """A walk through a scene: keyframes, and every frame between them.

    Eye and target follow cubic Hermite curves through the keyframes. The velocity at an inner keyframe is the slope
    from the one before to the one after it (Catmull and Rom's choice, for unequal distances in time), at the ends
    that of the first and of the last piece; so position and velocity are continuous, and the walk starts and ends in
    motion, as a recorded one does.

    Attributes:
        camera: Gives field of view, resolution, eye separation and up direction.
        keyframes: At least two, numbered upwards from 0.

    Source: Catmull and Rom, "A class of local interpolating splines" (1974).

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60)
        >>> path = CameraPath(camera, (Keyframe(0, (0, 0, 5), (0, 0, 0)), Keyframe(9, (9, 0, 5), (9, 0, 0))))
        >>> len(path), path[3].eye, path[-1].target
        (10, (3.0, 0.0, 5.0), (9.0, 0.0, 0.0))
    """

    camera: StereoCamera
    keyframes: tuple[Keyframe, ...]

    def __post_init__(self) -> None:
        require(len(self.keyframes) >= 2, "keyframes", len(self.keyframes), "at least two keyframes")
        object.__setattr__(self, "keyframes", tuple(Keyframe(*key) for key in self.keyframes))
        frames = [key.frame for key in self.keyframes]
        for frame in frames:
            require_integer("keyframes' frame", frame, minimum=0)
        rising = frames[0] == 0 and all(a < b for a, b in pairwise(frames))
        require(rising, "keyframes", frames, "numbers of frames that begin with 0 and rise")
        for key in self.keyframes:
            replace(self.camera, eye=key.eye, target=key.target)  # refuses what no camera can look at

    def __len__(self) -> int:
        return self.keyframes[-1].frame + 1

    def __getitem__(self, frame: int) -> StereoCamera:
        """Returns the camera of a frame; negative numbers count from the end."""
        require_integer("frame", frame)
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame: expected one from 0 to {len(self) - 1}, got {frame}")
        eye, target = self._positions(frame % len(self)).tolist()
        return replace(self.camera, eye=tuple(eye), target=tuple(target))

    def __iter__(self) -> Iterator[StereoCamera]:
        return (self[frame] for frame in range(len(self)))

    def at(self, resolution: tuple[int, int]) -> CameraPath:
        """Returns the same path seen with another height and width in pixels.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60)
            >>> path = CameraPath(camera, (Keyframe(0, (0, 0, 5), (0, 0, 0)), Keyframe(9, (9, 0, 5), (9, 0, 0))))
            >>> path.at(resolution=(32, 24))[0].resolution
            (32, 24)
        """
        return replace(self, camera=self.camera.at(resolution))

    @cached_property
    def _knots(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Frame numbers (k), eyes and targets (k, 2, 3), and their velocities per frame (k, 2, 3)."""
        time = np.array([key.frame for key in self.keyframes], dtype=np.float64)
        place = np.array([(key.eye, key.target) for key in self.keyframes], dtype=np.float64)
        before = np.maximum(np.arange(len(time)) - 1, 0)
        after = np.minimum(np.arange(len(time)) + 1, len(time) - 1)
        velocity = (place[after] - place[before]) / (time[after] - time[before])[:, None, None]
        return time, place, velocity

    def _positions(self, frame: int) -> npt.NDArray[np.float64]:
        """Eye and target in a frame, shape (2, 3)."""
        time, place, velocity = self._knots
        i = min(int(np.searchsorted(time, frame, side="right")) - 1, len(time) - 2)
        span = time[i + 1] - time[i]
        s = (frame - time[i]) / span
        held: npt.NDArray[np.float64] = (
            (1 + 2 * s) * (1 - s) ** 2 * place[i]
            + s**2 * (3 - 2 * s) * place[i + 1]
            + span * (s * (1 - s) ** 2 * velocity[i] - s**2 * (1 - s) * velocity[i + 1])
        )
        return held
