"""The G-buffer prepass: what every pixel of every view sees, in one dispatch, without noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from fovden import parallel
from fovden.camera import Camera, StereoCamera
from fovden.checks import require_number
from fovden.frame import GBuffer
from fovden.tracer.arrays import view_arrays
from fovden.tracer.cells import cell_points, require_raster
from fovden.tracer.gradient import attached, is_differentiable, seen_at
from fovden.tracer.kernels import paths
from fovden.tracer.kernels.tiles import SIDE
from fovden.tracer.motion import motion_vectors
from fovden.tracer.operators import define_operator, scene_of
from fovden.tracer.scene import Scene
from fovden.tracer.sequence import Instant
from fovden.warps import Warp

__all__ = ["trace_gbuffer"]

PIXELS_PER_TILE = 2048

FIELDS = {
    "albedo": 3,
    "normal": 3,
    "position": 3,
    "depth": 1,
    "roughness": 1,
    "motion": 2,
    "prim": 1,
    "barycentric": 2,
    "emission": 3,
}
"""Images that camera rays give, and their channels: a G-buffer's, and the radiance emitted towards the camera."""


def trace_gbuffer(
    scene: Scene,
    camera: Camera | StereoCamera,
    *,
    warp: Warp | None = None,
    jitter: tuple[float, float] = (0.0, 0.0),
    previous: Instant | None = None,
    progress: parallel.Progress = None,
) -> GBuffer:
    """Returns the geometry that every pixel of every view sees. The scene needs no light.

    Args:
        scene: The scene.
        camera: The views.
        warp: The raster whose cells are seen, also those beside the screen; ``None`` for the camera's own. A place that
            is no cell sees nothing.
        jitter: Shift (x, y) of all rays in pixels; (0, 0) means pixel centres. In cells, from -0.5 to below 0.5.
        previous: Scene and camera of the previous frame; ``None`` for none.
        progress: See :func:`fovden.parallel.run`; it counts tiles of four by four pixels.

    Returns:
        The G-buffer. Its ``motion`` is that of :func:`fovden.tracer.motion.motion_vectors`, or zero without a previous
        frame.

    Raises:
        ShapeError: If camera and raster differ in the number of views.
        ValueError: If ``jitter`` is not two finite numbers or leaves the cell, or the raster is for another screen.

    Differentiable: albedo, normal, position, depth and barycentric, in the scene's vertices, normals, texture
    coordinates and albedo and in the camera's and the raster's tensors; which triangle a pixel sees is a choice
    (:mod:`fovden.tracer.gradient`). Without progress it is the operator ``fovden::trace_visible``, and compiles.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> trace_gbuffer(scene, scene.camera.at(resolution=(16, 16))).depth.amin() > 7
        tensor(True)
    """
    return trace_visible(scene, camera, warp, jitter, previous, progress)[0]


def trace_visible(
    scene: Scene,
    camera: Camera | StereoCamera,
    warp: Warp | None,
    jitter: tuple[float, float],
    previous: Instant | None = None,
    progress: parallel.Progress = None,
) -> tuple[GBuffer, Tensor]:
    """Returns the G-buffer, and the radiance that each pixel's surface or surroundings emit, (v, 3, h, w)."""
    shift = (require_number("jitter", jitter[0]), require_number("jitter", jitter[1]))
    require_raster(camera, warp)
    views, points = camera.views, cell_points(warp, shift)
    parts = (views.origin.detach(), views.rotation.detach(), views.bounds.detach())
    if progress is None:
        images = torch.ops.fovden.trace_visible(scene.number, *parts, views.resolution, shift, points)
    else:
        images = _traced(scene, Camera(*parts, views.resolution), shift, points, progress)
    fields = dict(zip(FIELDS, images, strict=True))
    if is_differentiable(*_inputs(scene, views, warp)):
        for name, formula in seen_at(scene, views, shift, fields["prim"], warp).items():
            fields[name] = attached(fields[name], formula)
    emission, gbuffer = fields.pop("emission"), GBuffer(**fields)
    if previous is not None:
        motion = motion_vectors(gbuffer, scene, views, previous, warp=warp, jitter=shift)
        gbuffer = replace(gbuffer, motion=motion)
    return gbuffer, emission


def _traced(
    scene: Scene, views: Camera, jitter: tuple[float, float], points: Tensor, progress: parallel.Progress
) -> tuple[Tensor, ...]:
    """The images of :data:`FIELDS`, from the kernel."""
    height, width = _resolution(views.resolution, points)
    images = _images(views.view_count, (height, width))
    fields = dict(zip(FIELDS, images, strict=True))
    written = (image for name, image in fields.items() if name != "motion")
    parallel.run(
        paths.trace_primary,
        views.view_count * -(-height // SIDE) * -(-width // SIDE),
        (
            *scene.kernel_arrays("uniform"),
            view_arrays(views),
            np.float32(jitter[0] + 0.5),
            np.float32(jitter[1] + 0.5),
            points.numpy(),
            *(tensor.numpy() for tensor in written),
        ),
        tile=max(1, PIXELS_PER_TILE // SIDE**2),
        progress=progress,
        description="G-buffer",
    )
    fields["motion"].zero_()
    return images


def _inputs(scene: Scene, views: Camera, warp: Warp | None) -> tuple[Tensor | None, ...]:
    """What the images of :data:`FIELDS` have derivatives in."""
    raster = () if warp is None else (warp.gaze.pixels, *(v for v in vars(warp).values() if isinstance(v, Tensor)))
    materials = scene.materials
    shapes = (scene.vertices, scene.normals, scene.uv)
    return (*shapes, materials.albedo, materials.emission, views.origin, views.rotation, views.bounds, *raster)


def _resolution(screen: Sequence[int], points: Tensor) -> tuple[int, int]:
    """Height and width of the images: those of the rays' points, or without any the screen's."""
    height, width = points.shape[1:3] if points.shape[0] > 0 else screen
    return height, width


def _visible(
    scene: int,
    origin: Tensor,
    rotation: Tensor,
    bounds: Tensor,
    resolution: Sequence[int],
    jitter: Sequence[float],
    points: Tensor,
) -> tuple[Tensor, ...]:
    views = Camera(origin.cpu(), rotation.cpu(), bounds.cpu(), (resolution[0], resolution[1]))
    return _traced(scene_of(scene), views, (jitter[0], jitter[1]), points.cpu().contiguous(), None)


def _like_visible(
    _scene: int,
    origin: Tensor,
    _rotation: Tensor,
    _bounds: Tensor,
    resolution: Sequence[int],
    _jitter: object,
    points: Tensor,
) -> tuple[Tensor, ...]:
    return _images(origin.shape[0], _resolution(resolution, points))


def _images(views: int, resolution: Sequence[int]) -> tuple[Tensor, ...]:
    """Images of :data:`FIELDS` to be written."""
    types = {"prim": torch.int32}
    return tuple(
        torch.empty(views, channels, *resolution, dtype=types.get(name, torch.float32))
        for name, channels in FIELDS.items()
    )


define_operator(
    "fovden::trace_visible(int scene, Tensor origin, Tensor rotation, Tensor bounds, int[] resolution, float[] jitter,"
    f" Tensor points) -> ({', '.join(f'Tensor {name}' for name in FIELDS)})",
    _visible,
    _like_visible,
)
