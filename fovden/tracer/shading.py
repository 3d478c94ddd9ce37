"""Paths from pixels that a list names, for frames and for surface points alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from fovden import parallel
from fovden.camera import Camera
from fovden.checks import require, require_shapes
from fovden.tracer.arrays import LightChoice, view_arrays
from fovden.tracer.kernels import paths
from fovden.tracer.kernels.path import TAPE, Setting
from fovden.tracer.light_paths import Paths
from fovden.tracer.points import Shading, SurfacePoints
from fovden.tracer.scene import Scene

__all__ = ["Listed", "run_paths", "shaded"]

PIXELS_PER_TILE = 1024
EXACT = 1 << 24
"""Whole numbers below this are exact in float32, as which a tape holds the numbers of triangles."""


class Listed(NamedTuple):
    """Pixels that get paths.

    ``coordinates`` are view, y and x, the address of their random numbers, int32, (k, 3); ``places`` the same of where
    images hold them; ``directions`` those in which they are seen, (k, 3), or (0, 3) for camera rays; ``points`` where
    these pass the screen, (k, 2), or (0, 2) on the camera's own grid; ``counts`` their samples, int32, (k).
    """

    coordinates: Tensor
    places: Tensor
    directions: Tensor
    points: Tensor
    counts: Tensor


def run_paths(
    scene: Scene,
    views: Camera,
    jitter: tuple[float, float],
    listed: Listed,
    seen: tuple[Tensor, Tensor, Tensor],
    choice: LightChoice,
    setting: Setting,
    *,
    width: int,
    tape: Tensor | None = None,
    progress: parallel.Progress = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns direct and indirect light and the squared luminance of listed pixels, as images; zero elsewhere.

    Args:
        scene: The scene.
        views: The camera.
        jitter: Shift (x, y) in pixels.
        listed: The pixels.
        seen: Images of what pixels see: triangles, barycentric weights and emission.
        choice: How surfaces choose lights.
        setting: How paths are made.
        width: Width of the frame's images, from which pixels are numbered.
        tape: Receives what all paths are made of, shape (all samples, bounces + 1, TAPE), zero before.
        progress: See :func:`fovden.parallel.run`.

    Returns:
        Three images of the size of ``seen``.

    Example:
        >>> from fovden.tracer import Integrator, make_scene, trace_frame
        >>> from fovden.rng import Stream
        >>> scene = make_scene("cornell_box")
        >>> frame = trace_frame(scene, scene.camera.at((4, 4)), 1, seed=7)
        >>> seen = frame.gbuffer.prim, frame.gbuffer.barycentric, frame.emission
        >>> coordinates, ones = torch.tensor([[0, 1, 2]], dtype=torch.int32), torch.ones(1, dtype=torch.int32)
        >>> listed = Listed(coordinates, coordinates, torch.zeros(0, 3), torch.zeros(0, 2), ones)
        >>> setting = Integrator().setting(7, Stream.PATH)
        >>> direct, _, _ = run_paths(scene, frame.camera, (0.0, 0.0), listed, seen, "uniform", setting, width=4)
        >>> torch.equal(direct[0, :, 1, 2], frame.direct[0, :, 1, 2])
        True
    """
    shape = seen[2].shape
    direct, indirect, luminance_squared = torch.zeros(shape), torch.zeros(shape), torch.zeros_like(seen[2][:, :1])
    counts = listed.counts.to(torch.int64)
    first = torch.cumsum(counts, 0) - counts if tape is not None else torch.zeros(1, dtype=torch.int64)
    tape = torch.zeros(0, setting.bounces + 1, TAPE) if tape is None else tape
    parallel.run(
        paths.trace_listed,
        len(listed.coordinates),
        (
            *scene.kernel_arrays(choice),
            view_arrays(views),
            np.float32(jitter[0] + 0.5),
            np.float32(jitter[1] + 0.5),
            *(image.detach().numpy() for image in seen),
            *(field.contiguous().numpy() for field in listed),
            width,
            setting,
            direct.numpy(),
            indirect.numpy(),
            luminance_squared.numpy(),
            tape.numpy(),
            first.numpy(),
        ),
        tile=PIXELS_PER_TILE,
        progress=progress,
        description="paths",
    )
    return direct, indirect, luminance_squared


def shaded(
    scene: Scene,
    points: SurfacePoints,
    choice: LightChoice,
    setting: Setting,
    *,
    camera: Camera | None = None,
    taped: bool = False,
    progress: parallel.Progress = None,
) -> Paths:
    """Returns the light of surface points, and the record of its paths if it is ``taped``.

    Args:
        scene: The scene; its triangles are those that the points lie on.
        points: The points.
        choice: How surfaces choose lights.
        setting: How paths are made.
        camera: See :func:`fovden.tracer.reshade`.
        taped: Whether to record.
        progress: See :func:`fovden.parallel.run`.

    Returns:
        The paths.

    Raises:
        ValueError: If the scene lacks a triangle of the points, or has too many to be recorded.

    Example:
        >>> from fovden.tracer import Integrator, make_scene, surface_points, trace_frame
        >>> from fovden.rng import Stream
        >>> scene = make_scene("cornell_box")
        >>> points = surface_points(trace_frame(scene, scene.camera.at((4, 4)), 3))
        >>> shaded(scene, points, "uniform", Integrator().setting(0, Stream.PATH), taped=True).numbers.shape
        torch.Size([96, 2, 16])
    """
    largest = int(points.prim.max()) if len(points) else -1
    require(largest < scene.triangle_count, "points.prim", largest, f"triangles of a scene with {scene.triangle_count}")
    views, count = points.camera, len(points)
    places = torch.zeros(count, 3, dtype=torch.int32)
    places[:, 2] = torch.arange(count)
    directions = torch.zeros(0, 3)
    if camera is not None:
        require_shapes("v 3", {"v": views.view_count}, **{"camera.origin": camera.origin})
        directions = points.directions(scene, camera).detach().float()
    prim, barycentric = points.prim[None, None, None], points.barycentric.detach().float().mT[None, :, None]
    emission = torch.zeros(1, 3, 1, count)
    passed = points.raster_points
    arrays = (prim, points.coords, places, directions, passed, emission)
    shift = (np.float32(points.jitter[0] + 0.5), np.float32(points.jitter[1] + 0.5))
    parallel.run(
        paths.see_listed,
        count,
        (*scene.kernel_arrays(choice), view_arrays(views), *shift, *(array.contiguous().numpy() for array in arrays)),
        tile=PIXELS_PER_TILE,
    )
    tape = None
    if taped:
        require(scene.triangle_count <= EXACT, "scene", scene.triangle_count, f"at most {EXACT} triangles to record")
        tape = torch.zeros(int(points.counts.sum()), setting.bounces + 1, TAPE)
    listed = Listed(points.coords, places, directions, passed, points.counts)
    seen = (prim, barycentric.contiguous(), emission)
    width = points.resolution[1]
    images = run_paths(
        scene, views, points.jitter, listed, seen, choice, setting, width=width, tape=tape, progress=progress
    )
    direct, indirect, luminance_squared = (image[0, :, 0].mT for image in images)
    own = emission[0, :, 0].mT * (points.counts > 0)[:, None]
    shading = Shading(direct, indirect, own, luminance_squared[:, 0])
    seen_along = points.directions(scene) if camera is None else directions
    return Paths(scene, points, shading, torch.zeros(0, 0, TAPE) if tape is None else tape, seen_along.detach())
