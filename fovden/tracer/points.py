"""Surface points that pixels of a frame have seen, with the addresses of their random numbers: to be shaded again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from fovden.camera import Camera
from fovden.checks import require_coordinates, require_integer, require_shapes
from fovden.frame import Frame
from fovden.tracer.cells import cell_points, require_raster
from fovden.tracer.gradient import corners_at, interpolated
from fovden.tracer.scene import Scene
from fovden.warps import Warp

__all__ = ["Shading", "SurfacePoints", "surface_points"]


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """What some pixels of a frame have seen: triangles and places on them, not places in space.

    So points move with their triangles. Together with the frame's seed a point's pixel is the address of its random
    numbers (:mod:`fovden.rng`). This is the visibility buffer of adaptive SVGF (Schied, Peters and Dachsbacher,
    "Gradient estimation for real-time adaptive temporal filtering", 2018, section 4), with its seeds.

    Attributes:
        coords: View, y and x of the pixels, int32, shape (n, 3).
        counts: Samples that each of them has, int32, shape (n).
        prim: Triangles, int32, shape (n); -1 where the pixel sees none.
        barycentric: Weights (u, v) of the triangle's second and third vertex, shape (n, 2).
        camera: The views that saw them.
        seed: Seed of the frame.
        jitter: Shift (x, y) of the frame in pixels, or cells.
        warp: The raster whose cells the pixels are; ``None`` for the camera's own.

    Example:
        >>> from fovden.tracer import make_scene, trace_frame
        >>> scene = make_scene("cornell_box")
        >>> points = surface_points(trace_frame(scene, scene.camera.at((4, 4)), 2))
        >>> len(points), len(points[points.prim >= 0]), points.counts.unique()
        (32, 32, tensor([2], dtype=torch.int32))
    """

    coords: Tensor
    counts: Tensor
    prim: Tensor
    barycentric: Tensor
    camera: Camera
    seed: int = 0
    jitter: tuple[float, float] = (0.0, 0.0)
    warp: Warp | None = None

    def __post_init__(self) -> None:
        sizes = require_shapes("n 3", coords=self.coords)
        require_shapes("n", sizes, counts=self.counts, prim=self.prim)
        require_shapes("n 2", sizes, barycentric=self.barycentric)
        require_integer("seed", self.seed, minimum=0, maximum=0xFFFFFFFF)
        require_coordinates("coords", self.coords, self.camera.view_count, self.resolution)
        for name in ("coords", "counts", "prim"):
            object.__setattr__(self, name, getattr(self, name).to(torch.int32).contiguous())

    def __len__(self) -> int:
        return int(self.coords.shape[0])

    def __getitem__(self, chosen: Tensor | slice) -> SurfacePoints:
        """Some of the points, by numbers, booleans or a slice."""
        names = ("coords", "counts", "prim", "barycentric")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    @property
    def resolution(self) -> tuple[int, int]:
        """Height and width of the frame's images."""
        return require_raster(self.camera, self.warp)

    @property
    def raster_points(self) -> Tensor:
        """Where the rays of the points pass the screen, in pixels, shape (n, 2); empty without a warp."""
        view, y, x = self.coords.long().unbind(1)
        return torch.zeros(0, 2) if self.warp is None else cell_points(self.warp, self.jitter)[view, y, x]

    def positions(self, scene: Scene) -> Tensor:
        """Returns where the points are in a scene with these triangles, which may have moved since.

        Args:
            scene: The scene now.

        Returns:
            Positions in metres, shape (n, 3); 0 where no surface was seen.

        Differentiable: in the scene's vertices and ``barycentric``.

        Example:
            >>> from fovden.tracer import make_scene, trace_frame
            >>> scene = make_scene("cornell_box")
            >>> frame = trace_frame(scene, scene.camera.at((4, 4)), 1)
            >>> points = surface_points(frame)
            >>> torch.allclose(points.image(points.positions(scene)), frame.gbuffer.position, atol=1e-5)
            True
        """
        corners = corners_at(scene.vertices, scene.faces, self.prim)
        places = interpolated(corners, *self.barycentric.unbind(1))
        return torch.where((self.prim >= 0)[:, None], places, 0)

    def directions(self, scene: Scene, camera: Camera | None = None) -> Tensor:
        """Returns the unit directions in which the points are seen, away from the viewer.

        Args:
            scene: The scene now.
            camera: The views that look at the points where they are now; ``None`` for the rays of the frame. Where no
                surface was seen it is the direction of the pixel.

        Returns:
            Directions of shape (n, 3).

        Example:
            >>> from fovden.tracer import make_scene, trace_frame
            >>> scene = make_scene("cornell_box")
            >>> points = surface_points(trace_frame(scene, scene.camera.at((4, 4)), 1))
            >>> torch.allclose(points.directions(scene), points.directions(scene, points.camera), atol=1e-6)
            True
        """
        views = self.camera if camera is None else camera
        view = self.coords[:, 0].long()
        pixels = self.coords[:, [2, 1]] + 0.5 + torch.tensor(self.jitter)
        if self.warp is not None:
            pixels = self.raster_points.nan_to_num()  # what is no cell has no light, whatever its direction
        homogeneous = torch.cat([pixels, torch.ones_like(pixels[:, :1])], 1).to(views.origin)
        rays = normalize((views.pixel_to_world[view] @ homogeneous[:, :, None])[:, :, 0], dim=1)
        if camera is None:
            return rays
        towards = normalize(self.positions(scene) - views.origin[view], dim=1)
        return torch.where((self.prim >= 0)[:, None], towards, rays)

    def image(self, values: Tensor) -> Tensor:
        """Returns values of the points as an image of the frame's pixels, zero elsewhere.

        Args:
            values: One row a point, shape (n, c).

        Returns:
            Image of shape (v, c, h, w).

        Differentiable: in ``values``.

        Example:
            >>> from fovden.tracer import make_scene, trace_frame
            >>> scene = make_scene("cornell_box")
            >>> frame = trace_frame(scene, scene.camera.at((4, 4)), 1)
            >>> points = surface_points(frame)
            >>> torch.equal(points.image(points.barycentric), frame.gbuffer.barycentric)
            True
        """
        require_shapes("n *", {"n": len(self)}, values=values)
        view, y, x = self.coords.long().to(values.device).unbind(1)
        blank = values.new_zeros(self.camera.view_count, *self.resolution, values.shape[1])
        return blank.index_put((view, y, x), values).permute(0, 3, 1, 2).contiguous()


class Shading(NamedTuple):
    """Light from points to the viewer, means over their samples, one row a point.

    ``direct``, ``indirect`` and ``emission`` have the shape (n, 3), ``luminance_squared`` (n); they are what
    :class:`fovden.frame.Frame` holds under these names.

    Example:
        >>> one = torch.ones(2, 3)
        >>> Shading(one, one, 2 * one, torch.zeros(2)).radiance[0]
        tensor([4., 4., 4.])
    """

    direct: Tensor
    indirect: Tensor
    emission: Tensor
    luminance_squared: Tensor

    @property
    def radiance(self) -> Tensor:
        """All of the light, direct + indirect + emission, shape (n, 3)."""
        return self.direct + self.indirect + self.emission


def surface_points(frame: Frame, coords: Tensor | None = None) -> SurfacePoints:
    """Returns what the pixels of a frame have seen, and the addresses of their random numbers.

    Args:
        frame: A frame as :func:`fovden.tracer.trace_frame` returned it.
        coords: View, y and x of the pixels, integers of shape (n, 3); ``None`` for all that have samples, in row-major
            order.

    Returns:
        The points, on the CPU.

    Raises:
        ValueError: If the frame has no camera, or a pixel lies outside.
        ShapeError: If ``coords`` has another shape.

    Example:
        >>> from fovden.tracer import make_scene, trace_frame
        >>> scene = make_scene("cornell_box")
        >>> frame = trace_frame(scene, scene.camera.at((4, 4)), 1)
        >>> surface_points(frame, torch.tensor([[1, 2, 3]])).prim == frame.gbuffer.prim[1, 0, 2, 3]
        tensor([True])
    """
    if frame.camera is None:
        raise ValueError("frame.camera: expected the camera that saw the frame, got None")
    coords = (frame.counts[:, 0] > 0).nonzero() if coords is None else coords
    require_coordinates("coords", coords, frame.view_count, frame.resolution)
    coords, views = coords.cpu(), frame.camera
    view, y, x = coords.long().unbind(1)
    return SurfacePoints(
        coords=coords,
        counts=frame.counts.cpu()[view, 0, y, x],
        prim=frame.gbuffer.prim.cpu()[view, 0, y, x],
        barycentric=frame.gbuffer.barycentric.detach().cpu()[view, :, y, x],
        camera=Camera(views.origin.cpu(), views.rotation.cpu(), views.bounds.cpu(), views.resolution),
        seed=frame.seed,
        jitter=frame.jitter,
        warp=None if frame.warp is None else frame.warp.to("cpu"),
    )
