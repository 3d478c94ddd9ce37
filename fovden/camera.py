"""Cameras map raster coordinates to rays and points to pixels; a gaze says where each eye looks.

Conventions, the same everywhere: the world is right-handed with y up, in metres. Pixel (x, y) has its centre at
(x + 0.5, y + 0.5), x to the right, y down. A camera looks along the negative third axis of its own frame, as in
OpenGL and glTF. Views are counted along the first axis, the left eye before the right one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from fovden.checks import require, require_finite, require_integer, require_number, require_shapes

__all__ = ["FHD", "QUEST2", "Camera", "Gaze", "Rays", "StereoCamera"]

FHD = (1080, 960)
"""Height and width of one eye of a full-HD side-by-side frame: the 2023 paper's first resolution (Table 1)."""

QUEST2 = (1920, 1832)
"""Height and width of one eye of the Meta Quest 2: the 2023 paper's second resolution (Table 1)."""

Vector = tuple[float, float, float]


class Rays(NamedTuple):
    """Half-lines: ``origins`` and ``directions``, both of shape (..., 3), in metres; directions have length 1."""

    origins: Tensor
    directions: Tensor


@dataclass(frozen=True, eq=False)
class Camera:
    """One or more pinhole views that share a resolution.

    Attributes:
        origin: Centres of projection in metres, shape (v, 3).
        rotation: Camera axes in the world as columns (right, up, backward), orthonormal, shape (v, 3, 3).
        bounds: Tangents of the image's edges (left, right, bottom, top) at unit distance, shape (v, 4). An
            off-axis view has left != -right.
        resolution: Height and width in pixels.

    Example:
        >>> camera = StereoCamera.look_at((0, 1.6, 0), (0, 1.6, -1), fov_y_deg=90, resolution=(4, 6)).views
        >>> camera.origin[:, 0]
        tensor([-0.0315,  0.0315])
    """

    origin: Tensor
    rotation: Tensor
    bounds: Tensor
    resolution: tuple[int, int]

    def __post_init__(self) -> None:
        sizes = require_shapes("v 3", origin=self.origin)
        require_shapes("v 3 3", sizes, rotation=self.rotation)
        require_shapes("v 4", sizes, bounds=self.bounds)
        for name in ("origin", "rotation", "bounds"):
            require_finite(f"Camera.{name}", getattr(self, name))
        height, width = self.resolution
        require_integer("resolution[0] (height)", height, minimum=1)
        require_integer("resolution[1] (width)", width, minimum=1)
        if torch.compiler.is_compiling():  # values are not known
            return
        left, right, bottom, top = self.bounds.unbind(1)
        require(
            bool((left < right).all() and (bottom < top).all()),
            "Camera.bounds",
            self.bounds.tolist(),
            "left < right and bottom < top in every view (the camera is inside out)",
        )
        rotation = self.rotation.double()  # half precision has no determinant
        errors = (rotation.mT @ rotation - torch.eye(3).to(rotation)).abs()
        tolerance = max(1e-4, 4 * torch.finfo(self.rotation.dtype).eps)
        proper = bool((errors < tolerance).all()) and bool((torch.linalg.det(rotation) > 0).all())
        require(proper, "Camera.rotation", self.rotation.tolist(), "rotations (orthonormal, determinant +1)")

    @property
    def views(self) -> Camera:
        """The camera itself: every call that takes a camera reads ``camera.views``."""
        return self

    @property
    def view_count(self) -> int:
        """Number of views v."""
        return int(self.origin.shape[0])

    @property
    def pixel_to_world(self) -> Tensor:
        """Matrices that take (x, y, 1) in pixels to unnormalised world directions, shape (v, 3, 3)."""
        height, width = self.resolution
        left, right, bottom, top = self.bounds.unbind(1)
        zero, one = torch.zeros_like(left), torch.ones_like(left)
        pixel_to_tangent = torch.stack(
            [(right - left) / width, zero, left, zero, (bottom - top) / height, top, zero, zero, -one], dim=1
        )
        return self.rotation @ pixel_to_tangent.reshape(-1, 3, 3)

    def rays(self, pixels: Tensor | None = None) -> Rays:
        """Returns the rays through raster coordinates.

        Args:
            pixels: Coordinates (x, y) in pixels, shape (v, n, 2); ``None`` means every pixel's centre in row-major
                order, n = h w.

        Returns:
            Rays with fields of shape (v, n, 3) and unit directions.

        Differentiable: in ``pixels`` and the camera's tensors.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_y_deg=90, resolution=(2, 2)).views
            >>> camera.rays(torch.ones(2, 1, 2)).directions[0]
            tensor([[ 0.,  0., -1.]])
        """
        if pixels is None:
            pixels = pixel_centres(self.resolution).to(self.origin).expand(self.view_count, -1, 2)
        require_shapes("v n 2", {"v": self.view_count}, pixels=pixels)
        homogeneous = torch.cat([pixels, torch.ones_like(pixels[..., :1])], dim=-1)
        directions = torch.nn.functional.normalize(homogeneous @ self.pixel_to_world.mT, dim=-1)
        return Rays(self.origin[:, None].expand_as(directions), directions)

    def project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Returns where world points land on the raster, and how deep they lie.

        Args:
            points: World positions in metres, shape (v, n, 3).

        Returns:
            Pixel coordinates (x, y), shape (v, n, 2), and depths along the viewing axis in metres, shape (v, n).
            Points at or behind the camera have a depth of zero or less, and pixel coordinates without meaning.

        Differentiable: in ``points`` and the camera's tensors.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_y_deg=90, resolution=(2, 2)).views
            >>> pixels, depth = camera.project(torch.tensor([0.0, 0.0, -2.0]).expand(2, 1, 3) + camera.origin[:, None])
            >>> pixels[0], depth[0]
            (tensor([[1., 1.]]), tensor([2.]))
        """
        require_shapes("v n 3", {"v": self.view_count}, points=points)
        local = (points - self.origin[:, None]) @ self.rotation
        depth = -local[..., 2]
        left, right, bottom, top = (edge[:, None] for edge in self.bounds.unbind(1))
        height, width = self.resolution
        safe = torch.where(depth == 0, torch.finfo(depth.dtype).tiny, depth)
        x = (local[..., 0] / safe - left) / (right - left) * width
        y = (top - local[..., 1] / safe) / (top - bottom) * height
        return torch.stack([x, y], dim=-1), depth

    def view(self, index: int) -> Camera:
        """Returns the camera of one view, of which 0 is the left eye's; a ``ValueError`` if there is no such view.

        Example:
            >>> views = StereoCamera.look_at((0, 1.6, 0), (0, 1.6, -1), fov_y_deg=90, resolution=(4, 6)).views
            >>> views.view(1).origin[:, 0]
            tensor([0.0315])
        """
        require_integer("index", index, minimum=0, maximum=self.view_count - 1)
        one = slice(index, index + 1)
        return Camera(self.origin[one], self.rotation[one], self.bounds[one], self.resolution)

    def to(self, *args: object, **kwargs: object) -> Camera:
        """Returns the camera on another device or in another floating type, with the arguments of ``Tensor.to``.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_y_deg=90, resolution=(2, 2)).views
            >>> camera.to(torch.float64).origin.dtype
            torch.float64
        """
        moved = {name: getattr(self, name).to(*args, **kwargs) for name in ("origin", "rotation", "bounds")}
        return replace(self, **moved)


@dataclass(frozen=True)
class StereoCamera:
    """Two parallel pinhole views, one for each eye, described the way a person would.

    The eyes sit half of ``eye_separation`` to either side of ``eye``, look in the same direction and share the up
    vector. With ``convergence`` the frusta are sheared (off-axis) so that the images coincide at that distance; the
    views stay parallel, which keeps vertical parallax at zero.

    Attributes:
        eye: Point midway between the eyes, metres.
        target: Point looked at, metres.
        up: Any vector that is not along the viewing direction.
        fov_y_deg: Vertical field of view in degrees, in (0, 180), or ``None`` where ``fov_x_deg`` is given.
        fov_x_deg: Horizontal field of view in degrees, or ``None`` where ``fov_y_deg`` is given.
        resolution: Height and width of one eye's image in pixels.
        eye_separation: Distance between the eyes in metres. Default 0.063, the usual adult mean (Dodgson 2004).
        convergence: Distance of zero parallax in metres; ``None`` for symmetric frusta.

    Raises:
        ValueError: If not exactly one field of view is given, or the description has no well-defined view.

    Example:
        >>> camera = StereoCamera.look_at((0, 1.6, 3), (0, 1.6, 0), fov_x_deg=75, resolution=FHD)
        >>> camera.views.rays().directions.shape
        torch.Size([2, 1036800, 3])
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov_y_deg: float | None = None
    fov_x_deg: float | None = None
    resolution: tuple[int, int] = FHD
    eye_separation: float = 0.063
    convergence: float | None = None

    def __post_init__(self) -> None:
        for name in ("eye", "target", "up"):
            vector = tuple(float(x) for x in getattr(self, name))
            finite = len(vector) == 3 and all(map(math.isfinite, vector))
            require(finite, name, getattr(self, name), "three finite numbers")
            object.__setattr__(self, name, vector)
        one = (self.fov_y_deg is None) != (self.fov_x_deg is None)
        require(one, "fov_y_deg, fov_x_deg", (self.fov_y_deg, self.fov_x_deg), "exactly one of the two")
        for name in ("fov_y_deg", "fov_x_deg"):
            if getattr(self, name) is not None:
                require_number(name, getattr(self, name), above=0, maximum=179.9)
        require(len(self.resolution) == 2, "resolution", self.resolution, "a height and a width")
        require_integer("resolution[0] (height)", self.resolution[0], minimum=1)
        require_integer("resolution[1] (width)", self.resolution[1], minimum=1)
        require_number("eye_separation", self.eye_separation, minimum=0)
        if self.convergence is not None:
            require_number("convergence", self.convergence, above=0)
        self._axes()

    @classmethod
    def look_at(
        cls,
        eye: Vector,
        target: Vector,
        up: Vector = (0.0, 1.0, 0.0),
        *,
        fov_y_deg: float | None = None,
        fov_x_deg: float | None = None,
        resolution: tuple[int, int] = FHD,
        eye_separation: float = 0.063,
        convergence: float | None = None,
    ) -> StereoCamera:
        """Returns the stereo camera at ``eye`` that looks at ``target``; arguments as the class's attributes.

        Example:
            >>> StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(32, 32)).resolution
            (32, 32)
        """
        return cls(eye, target, up, fov_y_deg, fov_x_deg, resolution, eye_separation, convergence)

    def at(self, resolution: tuple[int, int]) -> StereoCamera:
        """Returns the same camera with another height and width; the field of view that was given is kept.

        Example:
            >>> StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60).at(resolution=QUEST2).resolution
            (1920, 1832)
        """
        height, width = resolution
        return replace(self, resolution=(height, width))

    @cached_property
    def views(self) -> Camera:
        """The two views as a :class:`Camera`, left eye first."""
        height, width = self.resolution
        if self.fov_y_deg is not None:
            half_height = math.tan(math.radians(self.fov_y_deg) / 2)
            half_width = half_height * width / height
        else:
            half_width = math.tan(math.radians(self.fov_x_deg or 0.0) / 2)
            half_height = half_width * height / width
        axes = self._axes()
        offsets = torch.tensor([-0.5, 0.5], dtype=torch.float64) * self.eye_separation
        eye = torch.tensor(self.eye, dtype=torch.float64)
        shear = torch.zeros(2, dtype=torch.float64) if self.convergence is None else -offsets / self.convergence
        edges = torch.tensor([-half_width, half_width, -half_height, half_height], dtype=torch.float64)
        bounds = edges.repeat(2, 1)
        bounds[:, :2] += shear[:, None]
        origin = eye + offsets[:, None] * axes[:, 0]
        rotation = axes.expand(2, 3, 3).contiguous()
        return Camera(origin.float(), rotation.float(), bounds.float(), self.resolution)

    def _axes(self) -> Tensor:
        """Right, up and backward as the columns of a float64 matrix."""
        eye, target, up = (torch.tensor(v, dtype=torch.float64) for v in (self.eye, self.target, self.up))
        backward = eye - target
        require(bool(backward.norm() > 0), "target", self.target, f"a point away from the eye {self.eye}")
        backward = backward / backward.norm()
        right = torch.linalg.cross(up, backward)
        askew = bool(right.norm() > 1e-6 * up.norm())
        require(askew, "up", self.up, "a vector that is not along the viewing direction")
        right = right / right.norm()
        return torch.stack([right, torch.linalg.cross(backward, right), backward], dim=1)


@dataclass(frozen=True, eq=False)
class Gaze:
    """Where each eye looks, in pixels of its own image; it may lie outside the image.

    Attributes:
        pixels: Coordinates (x, y) per view, float, shape (v, 2); pixel (0, 0) has its centre at (0.5, 0.5).

    Example:
        >>> Gaze.from_normalised(torch.zeros(2, 2), resolution=(1080, 960)).pixels
        tensor([[480., 540.],
                [480., 540.]])
    """

    pixels: Tensor

    def __post_init__(self) -> None:
        require_shapes("v 2", **{"Gaze.pixels": self.pixels})
        require_finite("Gaze.pixels", self.pixels)

    @classmethod
    def center(cls, camera: Camera | StereoCamera) -> Gaze:
        """Returns the gaze at the middle of every view's image: the 2023 paper's setting, which had no tracker.

        Example:
            >>> Gaze.center(StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 6))).pixels
            tensor([[3., 2.],
                    [3., 2.]])
        """
        views = camera.views
        height, width = views.resolution
        return cls(torch.tensor([[width / 2, height / 2]]).repeat(views.view_count, 1))

    @classmethod
    def from_normalised(cls, points: Tensor, resolution: tuple[int, int]) -> Gaze:
        """Returns the gaze from normalised device coordinates, as eye trackers report it.

        Args:
            points: Coordinates per view, shape (v, 2): x to the right and y up, both from -1 to 1 over the image.
            resolution: Height and width in pixels.

        Returns:
            The gaze in pixels.

        Example:
            >>> Gaze.from_normalised(torch.tensor([[-1.0, 1.0]]), (1080, 960)).pixels
            tensor([[0., 0.]])
        """
        require_shapes("v 2", points=points)
        height, width = resolution
        return cls(torch.stack([(points[:, 0] + 1) * width / 2, (1 - points[:, 1]) * height / 2], dim=1))

    @classmethod
    def from_degrees(cls, angles: Tensor, camera: Camera | StereoCamera) -> Gaze:
        """Returns the gaze from angles away from each view's optical axis.

        Args:
            angles: Azimuth (positive to the right) and elevation (positive up) in degrees, each in (-90, 90),
                shape (v, 2). The direction is (tan azimuth, tan elevation, -1) in the camera's frame.
            camera: The camera whose raster is meant.

        Returns:
            The gaze in pixels.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(100, 100))
            >>> Gaze.from_degrees(torch.tensor([[45.0, 0.0], [0.0, -45.0]]), camera).pixels
            tensor([[100.,  50.],
                    [ 50., 100.]])
        """
        views = camera.views
        require_shapes("v 2", {"v": views.view_count}, angles=angles)
        require(bool((angles.abs() < 90).all()), "angles", angles.tolist(), "degrees between -90 and 90")
        tangents = torch.tan(torch.deg2rad(angles))
        left, right, bottom, top = views.bounds.unbind(1)
        height, width = views.resolution
        x = (tangents[:, 0] - left) / (right - left) * width
        y = (top - tangents[:, 1]) / (top - bottom) * height
        return cls(torch.stack([x, y], dim=1))

    def to(self, *args: object, **kwargs: object) -> Gaze:
        """Returns the gaze on another device or in another floating type, with the arguments of ``Tensor.to``.

        Example:
            >>> Gaze(torch.zeros(1, 2)).to(torch.float64).pixels.dtype
            torch.float64
        """
        return Gaze(self.pixels.to(*args, **kwargs))  # type: ignore[call-overload]


def pixel_centres(resolution: tuple[int, int]) -> Tensor:
    """Returns the centres (x, y) of all pixels in row-major order, shape (h w, 2).

    Example:
        >>> pixel_centres((1, 2))
        tensor([[0.5000, 0.5000],
                [1.5000, 0.5000]])
    """
    height, width = resolution
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return torch.stack([x.flatten(), y.flatten()], dim=1)
