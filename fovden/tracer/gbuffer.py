"""The G-buffer prepass: what every pixel of every view sees, in one dispatch, without noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from fovden import parallel
from fovden.camera import Camera, StereoCamera
from fovden.checks import require_number
from fovden.frame import GBuffer
from fovden.tracer.arrays import view_arrays
from fovden.tracer.kernels import paths
from fovden.tracer.motion import motion_vectors
from fovden.tracer.scene import Scene
from fovden.tracer.sequence import Instant

__all__ = ["trace_gbuffer"]

PIXELS_PER_TILE = 2048


def trace_gbuffer(
    scene: Scene,
    camera: Camera | StereoCamera,
    *,
    jitter: tuple[float, float] = (0.0, 0.0),
    previous: Instant | None = None,
    progress: parallel.Progress = None,
) -> GBuffer:
    """Returns the geometry that every pixel of every view sees. The scene needs no light.

    Args:
        scene: The scene.
        camera: The views.
        jitter: Shift (x, y) of all rays in pixels; (0, 0) means pixel centres.
        previous: Scene and camera of the previous frame; ``None`` for none.
        progress: See :func:`fovden.parallel.run`.

    Returns:
        The G-buffer. Its ``motion`` is that of :func:`fovden.tracer.motion.motion_vectors`, or zero without a previous
        frame.

    Raises:
        ValueError: If ``jitter`` is not two finite numbers.

    Differentiable: no.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> trace_gbuffer(scene, scene.camera.at(resolution=(16, 16))).depth.amin() > 7
        tensor(True)
    """
    return trace_visible(scene, camera, jitter, previous, progress)[0]


def trace_visible(
    scene: Scene,
    camera: Camera | StereoCamera,
    jitter: tuple[float, float],
    previous: Instant | None = None,
    progress: parallel.Progress = None,
) -> tuple[GBuffer, Tensor]:
    """Returns the G-buffer, and the radiance that each pixel's surface or surroundings emit, (v, 3, h, w)."""
    jitter_x, jitter_y = (require_number("jitter", shift) for shift in jitter)
    views = camera.views
    height, width = views.resolution
    count = views.view_count

    def image(channels: int) -> Tensor:
        return torch.empty(count, channels, height, width)

    albedo, normal, position, depth, roughness, emission = image(3), image(3), image(3), image(1), image(1), image(3)
    prim, barycentric = torch.empty(count, 1, height, width, dtype=torch.int32), image(2)
    written = (albedo, normal, position, depth, roughness, prim, barycentric, emission)
    parallel.run(
        paths.trace_primary,
        count * height * width,
        (
            *scene.kernel_arrays("uniform"),
            view_arrays(views),
            np.float32(jitter_x + 0.5),
            np.float32(jitter_y + 0.5),
            *(tensor.numpy() for tensor in written),
        ),
        tile=PIXELS_PER_TILE,
        progress=progress,
        description="G-buffer",
    )
    motion = torch.zeros(count, 2, height, width)
    gbuffer = GBuffer(albedo, normal, position, depth, roughness, motion, prim, barycentric)
    if previous is not None:
        gbuffer = replace(gbuffer, motion=motion_vectors(gbuffer, scene, views, previous, jitter=(jitter_x, jitter_y)))
    return gbuffer, emission
