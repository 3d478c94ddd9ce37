"""Where the atrium is seen from: its camera, two other views, and a walk through court and galleries."""

from __future__ import annotations

from dataclasses import replace

from fovden.camera import StereoCamera
from fovden.tracer.trajectory import CameraPath, Keyframe

__all__ = ["CAMERA", "PATH", "VIEWS"]

CAMERA = StereoCamera.look_at((-11.9, 1.9, -0.55), (0.0, 2.75, 0.1), fov_x_deg=78)
"""At one end of the court, looking along it."""

VIEWS = {
    "gallery": replace(CAMERA, eye=(-9.2, 1.75, -5.0), target=(0.0, 2.1, -4.3)),
    "balcony": replace(CAMERA, eye=(4.8, 7.1, 3.4), target=(-1.0, 4.3, -2.6)),
}
"""The lower gallery between curtains and doors; the court from above, over the balustrade."""

PATH = CameraPath(
    CAMERA,
    (
        Keyframe(0, (11.4, 1.75, 0.7), (3.0, 2.4, 0.1)),
        Keyframe(150, (6.6, 1.75, 0.5), (-1.0, 2.3, -0.8)),
        Keyframe(250, (3.6, 1.75, -1.3), (-0.6, 2.0, -4.6)),
        Keyframe(330, (1.8, 1.75, -3.2), (-2.6, 1.9, -5.6)),
        Keyframe(410, (-0.4, 1.75, -4.6), (-6.6, 2.0, -4.6)),
        Keyframe(530, (-5.6, 1.75, -4.75), (-10.8, 2.0, -3.6)),
        Keyframe(640, (-10.8, 1.75, -4.7), (-15.8, 1.9, -2.6)),
        Keyframe(720, (-13.7, 1.75, -3.7), (-15.6, 1.8, 1.2)),
        Keyframe(800, (-14.3, 1.75, -0.9), (-11.4, 2.0, 4.0)),
        Keyframe(880, (-13.0, 1.75, 1.45), (-6.0, 2.4, 0.6)),
        Keyframe(999, (-10.4, 1.75, 0.8), (0.0, 2.9, -0.2)),
    ),
)
"""A walk of a little over half a minute at 30 frames a second.

It leads down the court, under an arch into the lower gallery, around the corner past the lions' fountains, and back
under an arch to the court's other end.
"""
