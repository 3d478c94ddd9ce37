"""Motion vectors, and which surfaces the previous frame did not show.

A triangle's number and barycentric weights name a point of a surface. In the previous scene the same name gives where
that point was, and the previous camera where it was to be seen. Everything is exact but for rounding: nothing is
searched in images.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from fovden import parallel
from fovden.camera import Camera, StereoCamera
from fovden.checks import require, require_shapes
from fovden.frame import GBuffer
from fovden.tracer.cells import cell_points, require_raster
from fovden.tracer.kernels import motion as kernels
from fovden.tracer.scene import Scene
from fovden.tracer.sequence import Instant
from fovden.warps import Warp

__all__ = ["disoccluded", "motion_vectors"]

PIXELS_PER_TILE = 8192
SURFACE = 2.0**-13
"""A surface that is this share of the distance nearer than the point hides it; below, it is the point's own surface.

A float32 ray passes the point within some 2^-22 of the distance. On a surface of slope tan a that displaces the hit by
tan a times as much, which stays below this share up to 89.9 degrees.
"""


def motion_vectors(
    gbuffer: GBuffer,
    scene: Scene,
    camera: Camera | StereoCamera,
    previous: Instant,
    *,
    warp: Warp | None = None,
    jitter: tuple[float, float] = (0.0, 0.0),
) -> Tensor:
    """Returns how many pixels to go from each pixel to where its surface point was in the previous frame.

    With P and P' the point now and then, ``motion = project'(P') - project(P)``: 0 to the bit where neither camera
    nor surface moves. The surroundings of a miss are infinitely far away and move by the camera's turn alone.

    Jitter is left out, as DLSS and FSR expect it: motion leads from the place on the raster through which the pixel's
    ray passed to the place of the same point on the previous raster. So a static image has no motion, whatever its
    jitter; who wants to read the previous frame's own pixels, whose values lie at their centres plus its jitter, adds
    ``frame.jitter - previous_frame.jitter``.

    In the cells of a raster it is the same vector on the screen, in pixels, and not in cells: where the two rasters lay
    is not a matter of the surface. :meth:`fovden.foveation.Warp.transport` leads from cells to the previous cells.

    Args:
        gbuffer: What the camera sees of the scene.
        scene: The scene.
        camera: The views.
        previous: Scene and camera of the previous frame: the same triangles, views and resolution.
        warp: The raster in whose cells the G-buffer was traced; ``None`` for the camera's own.
        jitter: The shift (x, y) in pixels, or cells, with which the G-buffer was traced.

    Returns:
        Motion (x, y) in pixels, previous = current + motion, float32, shape (v, 2, h, w). A point that was not in
        front of the previous camera leads to (-w, -h), outside the image.

    Raises:
        ShapeError: If the numbers of views, pixels, triangles or vertices differ.
        ValueError: If the triangles differ otherwise.

    Differentiable: no. Computed in float64.

    Example:
        >>> from fovden.tracer import make_scene, trace_gbuffer
        >>> scene = make_scene("cornell_box")
        >>> camera = scene.camera.at(resolution=(16, 16))
        >>> gbuffer = trace_gbuffer(scene, camera)
        >>> motion_vectors(gbuffer, scene, camera, Instant(scene, camera)).abs().max()
        tensor(0.)
    """
    return _reprojected(gbuffer, scene, camera, previous, warp, jitter).motion


def disoccluded(
    gbuffer: GBuffer,
    scene: Scene,
    camera: Camera | StereoCamera,
    previous: Instant,
    *,
    warp: Warp | None = None,
    jitter: tuple[float, float] = (0.0, 0.0),
) -> Tensor:
    """Returns whether what each pixel shows was invisible in the previous frame.

    It was where its point lay outside the previous image or behind the camera, where a ray from the previous eye met
    another surface of the previous scene first, and where the surface showed its other side. Of a miss, it is asked
    whether a surface hid the surroundings. A tracer knows this exactly; filters guess it from depth and normals, and
    may be measured with it.

    Args:
        gbuffer: What the camera sees of the scene.
        scene: The scene.
        camera: The views.
        previous: Scene and camera of the previous frame: the same triangles, views and resolution.
        warp: The raster in whose cells the G-buffer was traced; ``None`` for the camera's own.
        jitter: The shift (x, y) in pixels, or cells, with which the G-buffer was traced.

    Returns:
        Booleans, shape (v, 1, h, w); false in a place that is no cell.

    Raises:
        ShapeError: If the numbers of views, pixels, triangles or vertices differ.
        ValueError: If the triangles differ otherwise.

    Differentiable: no. Cost: at most one ray per pixel.

    Example:
        >>> from fovden.tracer import make_scene, trace_gbuffer
        >>> scene = make_scene("cornell_box")
        >>> camera = scene.camera.at(resolution=(16, 16))
        >>> gbuffer = trace_gbuffer(scene, camera)
        >>> disoccluded(gbuffer, scene, camera, Instant(scene, camera)).any()
        tensor(False)
    """
    then = _reprojected(gbuffer, scene, camera, previous, warp, jitter)
    eye, row, column = then.visible.nonzero(as_tuple=True)
    towards, prim = then.towards[eye, row, column], gbuffer.prim[eye, 0, row, column]
    hits = previous.scene.intersect(previous.camera.views.origin.detach().float()[eye], towards)
    # Towards a point, t is the share of its distance; towards the surroundings of a miss, any hit hides them.
    nearer = torch.where(prim >= 0, hits.t < 1 - SURFACE, torch.isfinite(hits.t))
    then.visible[eye, row, column] = ~(nearer & (hits.prim != prim))
    found = ~then.visible[:, None]
    return found if warp is None else found & warp.exists.to(found.device)


class _Reprojected(NamedTuple):
    """What :func:`fovden.tracer.kernels.motion.reproject` writes."""

    motion: Tensor  # (v, 2, h, w)
    towards: Tensor  # (v, h, w, 3)
    visible: Tensor  # (v, h, w)


def _reprojected(
    gbuffer: GBuffer,
    scene: Scene,
    camera: Camera | StereoCamera,
    previous: Instant,
    warp: Warp | None,
    jitter: tuple[float, float],
) -> _Reprojected:
    """Takes every pixel's point back to the previous frame."""
    views, height, width = _require_alike(gbuffer, scene, camera, previous, warp)
    count = views.view_count
    result = _Reprojected(
        torch.empty(count, 2, height, width),
        torch.empty(count, height, width, 3),
        torch.empty(count, height, width, dtype=torch.bool),
    )
    arguments = (
        gbuffer.prim.contiguous().numpy(),
        gbuffer.barycentric.detach().float().contiguous().numpy(),
        scene.faces.numpy(),
        _eyes(views, scene),
        _eyes(previous.camera.views, previous.scene),
        float(jitter[0]),
        float(jitter[1]),
        cell_points(warp, jitter).numpy(),
        *views.resolution,
        *(tensor.numpy() for tensor in result),
    )
    parallel.run(kernels.reproject, count * height * width, arguments, tile=PIXELS_PER_TILE)
    return result


def _eyes(views: Camera, scene: Scene) -> kernels.Eyes:
    """Views and vertices as the kernel reads them."""
    parts = (views.origin, views.rotation, views.bounds)
    origin, rotation, bounds = (part.detach().double().contiguous().numpy() for part in parts)
    return kernels.Eyes(origin, rotation, bounds, scene.vertices.detach().numpy())


def _require_alike(
    gbuffer: GBuffer, scene: Scene, camera: Camera | StereoCamera, previous: Instant, warp: Warp | None
) -> tuple[Camera, int, int]:
    """The views, and height and width of images; an error where two frames cannot be compared."""
    views, before = camera.views, previous.camera.views
    height, width = require_raster(views, warp)
    sizes = {"v": views.view_count, "h": height, "w": width}
    require_shapes("v 1 h w", sizes, **{"gbuffer.prim": gbuffer.prim})
    require_shapes("v 3", sizes, **{"previous.camera.origin": before.origin})
    same = tuple(before.resolution) == tuple(views.resolution)
    require(same, "previous.camera.resolution", before.resolution, f"{views.resolution}, as the camera has")
    counts = {"n": len(scene.vertices), "m": scene.triangle_count}
    require_shapes("n 3", counts, **{"previous.scene.vertices": previous.scene.vertices})
    require_shapes("m 3", counts, **{"previous.scene.faces": previous.scene.faces})
    same = previous.scene.faces is scene.faces or torch.equal(previous.scene.faces, scene.faces)
    require(same, "previous.scene.faces", "other triangles", "the triangles of the scene in the same order")
    return views, height, width
