"""Motion vectors, and which surfaces the previous frame did not show.

A triangle's number and barycentric weights name a point of a surface. In the previous scene the same name gives where
that point was, and the previous camera where it was to be seen. Everything is exact but for rounding: nothing is
searched in images.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from fovden.camera import Camera, StereoCamera, pixel_centres
from fovden.checks import require, require_shapes
from fovden.frame import GBuffer
from fovden.tracer.scene import Scene
from fovden.tracer.sequence import Instant

__all__ = ["disoccluded", "motion_vectors"]

SURFACE = 2.0**-13
"""A surface that is this share of the distance nearer than the point hides it; below, it is the point's own surface.

A float32 ray passes the point within some 2^-22 of the distance. On a surface of slope tan a that displaces the hit by
tan a times as much, which stays below this share up to 89.9 degrees.
"""

AHEAD = 2.0**-20
"""A point whose depth is a smaller share of its distance counts as beside the camera: no image is that wide."""


def motion_vectors(
    gbuffer: GBuffer,
    scene: Scene,
    camera: Camera | StereoCamera,
    previous: Instant,
    *,
    jitter: tuple[float, float] = (0.0, 0.0),
) -> Tensor:
    """Returns how many pixels to go from each pixel to where its surface point was in the previous frame.

    With P and P' the point now and then, ``motion = project'(P') - project(P)``: 0 to the bit where neither camera
    nor surface moves. The surroundings of a miss are infinitely far away and move by the camera's turn alone.

    Jitter is left out, as DLSS and FSR expect it: motion leads from the place on the raster through which the pixel's
    ray passed to the place of the same point on the previous raster. So a static image has no motion, whatever its
    jitter; who wants to read the previous frame's own pixels, whose values lie at their centres plus its jitter, adds
    ``frame.jitter - previous_frame.jitter``.

    Args:
        gbuffer: What the camera sees of the scene.
        scene: The scene.
        camera: The views.
        previous: Scene and camera of the previous frame: the same triangles, views and resolution.
        jitter: The shift (x, y) in pixels with which the G-buffer was traced.

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
    views, height, width = _require_alike(gbuffer, scene, camera, previous)
    motion = torch.empty(views.view_count, 2, height, width)
    for view in range(views.view_count):
        for row in range(0, height, rows := max(1, (1 << 17) // width)):
            now, before = _points(gbuffer, scene, views, previous, jitter, view, slice(row, row + rows))
            moved = before.pixels - now.pixels
            hidden = torch.tensor([-width, -height], dtype=torch.float64) - now.pixels
            moved = torch.where(before.ahead[:, None], moved, hidden)
            motion[view, :, row : row + rows] = moved.float().T.reshape(2, -1, width)
    return motion


def disoccluded(
    gbuffer: GBuffer,
    scene: Scene,
    camera: Camera | StereoCamera,
    previous: Instant,
    *,
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
        jitter: The shift (x, y) in pixels with which the G-buffer was traced.

    Returns:
        Booleans, shape (v, 1, h, w).

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
    views, height, width = _require_alike(gbuffer, scene, camera, previous)
    size = torch.tensor([width, height])
    result = torch.empty(views.view_count, 1, height, width, dtype=torch.bool)
    for view in range(views.view_count):
        for row in range(0, height, rows := max(1, (1 << 17) // width)):
            now, before = _points(gbuffer, scene, views, previous, jitter, view, slice(row, row + rows))
            inside = before.ahead & ((before.pixels >= 0) & (before.pixels <= size)).all(1)
            hits = previous.scene.intersect(before.origin.expand_as(before.towards)[inside], before.towards[inside])
            prim = now.prim[inside]
            # Towards a point, t is the share of its distance; towards the surroundings of a miss, any hit hides them.
            nearer = torch.where(prim >= 0, hits.t < 1 - SURFACE, torch.isfinite(hits.t))
            visible = inside & (before.side == now.side)
            visible[inside] &= ~(nearer & (hits.prim != prim))
            result[view, 0, row : row + rows] = ~visible.reshape(-1, width)
    return result


class _Points(NamedTuple):
    """Surface points as one camera sees them, n of them; directions for the surroundings of a miss."""

    prim: Tensor
    pixels: Tensor  # (n, 2)
    ahead: Tensor  # (n), whether it is in front of the camera
    origin: Tensor  # (3)
    towards: Tensor  # (n, 3), from the eye to the point
    side: Tensor  # (n), the sign of the side that is seen


def _require_alike(
    gbuffer: GBuffer, scene: Scene, camera: Camera | StereoCamera, previous: Instant
) -> tuple[Camera, int, int]:
    """The views, and their height and width; an error where two frames cannot be compared."""
    views, before = camera.views, previous.camera.views
    height, width = views.resolution
    sizes = {"v": views.view_count, "h": height, "w": width}
    require_shapes("v 1 h w", sizes, **{"gbuffer.prim": gbuffer.prim})
    require_shapes("v 3", sizes, **{"previous.camera.origin": before.origin})
    same = tuple(before.resolution) == (height, width)
    require(same, "previous.camera.resolution", before.resolution, f"{(height, width)}, as the camera has")
    counts = {"n": len(scene.vertices), "m": scene.triangle_count}
    require_shapes("n 3", counts, **{"previous.scene.vertices": previous.scene.vertices})
    require_shapes("m 3", counts, **{"previous.scene.faces": previous.scene.faces})
    same = previous.scene.faces is scene.faces or torch.equal(previous.scene.faces, scene.faces)
    require(same, "previous.scene.faces", "other triangles", "the triangles of the scene in the same order")
    return views, height, width


def _points(
    gbuffer: GBuffer,
    scene: Scene,
    views: Camera,
    previous: Instant,
    jitter: tuple[float, float],
    view: int,
    rows: slice,
) -> tuple[_Points, _Points]:
    """What some rows of a view show, as the camera sees it and as the previous one saw it."""
    prim = gbuffer.prim[view, 0, rows].flatten()
    u, v = gbuffer.barycentric[view, :, rows].flatten(1).double()[:, :, None]
    hit = prim >= 0
    corners = scene.faces[prim.clamp_min(0).long()].long()
    now, before = _single(views, view), _single(previous.camera.views, view)
    width = views.resolution[1]
    shift = torch.tensor([jitter[0], rows.start + jitter[1]], dtype=torch.float64)
    through = pixel_centres((len(prim) // width, width)).double() + shift
    away = now.rays(through[None]).directions[0]  # to the surroundings
    seen = []
    for where, vertices in ((now, scene.vertices), (before, previous.scene.vertices)):
        a, b, c = vertices.detach()[corners].double().unbind(1)
        across, along = b - a, c - a
        origin = where.origin[0]
        towards = torch.where(hit[:, None], a + u * across + v * along - origin, away)
        pixels, depth = where.project((towards + origin)[None])
        facing = torch.linalg.vecdot(torch.linalg.cross(across, along), towards)
        side = torch.where(hit, facing.sign(), 0.0)
        ahead = depth[0] > AHEAD * torch.linalg.vector_norm(towards, dim=1)
        seen.append(_Points(prim, pixels[0], ahead, origin, towards, side))
    return seen[0], seen[1]


def _single(views: Camera, view: int) -> Camera:
    """One of the views, in float64."""
    parts = (views.origin, views.rotation, views.bounds)
    origin, rotation, bounds = (part[view : view + 1].detach().double() for part in parts)
    return Camera(origin, rotation, bounds, views.resolution)
