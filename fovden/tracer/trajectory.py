"""Paths through keyframes: where a stereo camera travels, and where the eyes look meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require_integer, require_number
from fovden.tracer.curves import interpolate, require_frames

__all__ = ["CameraPath", "GazeKeyframe", "GazePath", "Keyframe"]

Vector = tuple[float, float, float]


class Keyframe(NamedTuple):
    """Where the camera is and what it looks at in one frame.

    Attributes:
        frame: Number of the frame, from 0.
        eye: Point midway between the eyes, metres.
        target: Point looked at, metres.
        held: Whether the camera stays until the next keyframe, and cuts to it.

    Example:
        >>> Keyframe(0, (0.0, 1.7, 5.0), (0.0, 1.5, 0.0)).frame
        0
    """

    frame: int
    eye: Vector
    target: Vector
    held: bool = False


@dataclass(frozen=True)
class CameraPath:
    """A walk through a scene: keyframes, and every frame between them.

    Eye and target follow cubic Hermite curves through the keyframes with Catmull and Rom's velocities, see
    :func:`fovden.tracer.curves.interpolate`: position and velocity are continuous, and the walk starts and ends in
    motion, as a recorded one does.

    Attributes:
        camera: Gives field of view, resolution, eye separation and up direction.
        keyframes: At least two, numbered upwards from 0.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60)
        >>> path = CameraPath(camera, (Keyframe(0, (0, 0, 5), (0, 0, 0)), Keyframe(9, (9, 0, 5), (9, 0, 0))))
        >>> len(path), path[3].eye, path[-1].target
        (10, (3.0, 0.0, 5.0), (9.0, 0.0, 0.0))
    """

    camera: StereoCamera
    keyframes: tuple[Keyframe, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "keyframes", tuple(Keyframe(*key) for key in self.keyframes))
        require_frames("keyframes", [key.frame for key in self.keyframes], at_least=2)
        for key in self.keyframes:
            replace(self.camera, eye=key.eye, target=key.target)  # refuses what no camera can look at

    def __len__(self) -> int:
        return self.keyframes[-1].frame + 1

    def __getitem__(self, frame: int) -> StereoCamera:
        """Returns the camera of a frame; negative numbers count from the end."""
        require_integer("frame", frame)
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame: expected one from 0 to {len(self) - 1}, got {frame}")
        frames, eyes, targets, held = zip(*self.keyframes, strict=True)
        places = list(zip(eyes, targets, strict=True))
        eye, target = interpolate(frames, places, held, frame % len(self)).tolist()
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


class GazeKeyframe(NamedTuple):
    """Where the eyes look in one frame, as an angle from each view's optical axis.

    Attributes:
        frame: Number of the frame, from 0.
        azimuth_deg: Degrees to the right, in (-90, 90).
        elevation_deg: Degrees up, in (-90, 90).
        held: Whether the eyes rest here until the next keyframe (a fixation) and jump to it (a saccade); otherwise they
            move there smoothly (smooth pursuit).

    Example:
        >>> GazeKeyframe(0, azimuth_deg=-10.0, elevation_deg=2.5, held=True).held
        True
    """

    frame: int
    azimuth_deg: float
    elevation_deg: float
    held: bool = False


@dataclass(frozen=True)
class GazePath:
    """Where the eyes look in every frame: fixations, saccades and smooth pursuit through keyframes.

    Both eyes look in the same direction, as at something far away. A saccade takes no time: vision is suppressed
    during the 20 to 100 ms that it lasts, and one that is to be seen has keyframes of its own.

    Attributes:
        keyframes: At least one, numbered upwards from 0. The last gaze is kept afterwards.

    Raises:
        ValueError: If the frames do not rise from 0, or an angle is out of range.

    Source: Leigh and Zee, "The Neurology of Eye Movements", for the kinds of movement.

    Example:
        >>> path = GazePath((GazeKeyframe(0, -10, 0, held=True), GazeKeyframe(30, 10, 0), GazeKeyframe(50, 20, 4)))
        >>> path[29], path[30], path[40]
        ((-10.0, 0.0), (10.0, 0.0), (15.0, 2.0))
    """

    keyframes: tuple[GazeKeyframe, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "keyframes", tuple(GazeKeyframe(*key) for key in self.keyframes))
        require_frames("keyframes", [key.frame for key in self.keyframes])
        for key in self.keyframes:
            for name in ("azimuth_deg", "elevation_deg"):
                require_number(f"GazeKeyframe.{name}", getattr(key, name), minimum=-89.9, maximum=89.9)

    def __len__(self) -> int:
        return self.keyframes[-1].frame + 1

    def __getitem__(self, frame: int) -> tuple[float, float]:
        """Returns azimuth and elevation of a frame in degrees."""
        require_integer("frame", frame, minimum=0)
        frames, azimuths, elevations, held = zip(*self.keyframes, strict=True)
        angles = list(zip(azimuths, elevations, strict=True))
        azimuth, elevation = interpolate(frames, angles, held, frame).tolist()
        return azimuth, elevation

    def gaze(self, frame: int, camera: Camera | StereoCamera) -> Gaze:
        """Returns the gaze of a frame in the pixels of a camera.

        Args:
            frame: Number of the frame, at least 0.
            camera: The camera whose raster is meant.

        Returns:
            The gaze, the same angles in every view.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(100, 100))
            >>> GazePath((GazeKeyframe(0, 45, 0),)).gaze(7, camera).pixels
            tensor([[100.,  50.],
                    [100.,  50.]])
        """
        return Gaze.from_degrees(torch.tensor([self[frame]]).expand(camera.views.view_count, 2), camera)
