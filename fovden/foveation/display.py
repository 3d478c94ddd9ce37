"""Displays and eccentricity: how far a pixel lies from where the eye looks, in pixels or in degrees.

Two measures are in use, and differ. In pixels it is the plain distance on the image plane (the 2023 paper, Weier et al.
2016). In degrees it is the angle between the view rays through the pixel and through the gaze, which is exact for a
gaze anywhere and for off-axis views.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from fovden.camera import FHD, QUEST2, Camera, Gaze, StereoCamera, pixel_centres
from fovden.checks import require, require_integer, require_number, require_shapes

__all__ = ["Display", "EccentricityUnit", "Gaze", "eccentricity_degrees", "eccentricity_pixels"]

EccentricityUnit = Literal["degrees", "pixels"]
"""Units of an eccentricity: the angle between view rays, or the distance on the image plane."""


def eccentricity_pixels(gaze: Gaze, resolution: tuple[int, int]) -> Tensor:
    """Returns each pixel's distance from the gaze on the image plane.

    Args:
        gaze: Where each eye looks; anywhere, also outside the image.
        resolution: Height and width in pixels.

    Returns:
        Distance of the pixel's centre from the gaze in pixels, shape (v, 1, h, w).

    Differentiable: in the gaze.

    Example:
        >>> eccentricity_pixels(Gaze(torch.tensor([[0.5, 0.5]])), (1, 4))
        tensor([[[[0., 1., 2., 3.]]]])
    """
    offsets = pixel_centres(resolution).to(gaze.pixels) - gaze.pixels[:, None]
    distance: Tensor = torch.linalg.vector_norm(offsets, dim=-1)
    return distance.reshape(-1, 1, *resolution)


def eccentricity_degrees(gaze: Gaze, camera: Camera | StereoCamera) -> Tensor:
    """Returns the angle between the view ray through each pixel and the one through the gaze.

    For unit rays a and b it is ``2 atan2(|a - b|, |a + b|)``, which keeps its precision near 0, where the arc cosine of
    a . b has none (Kahan, "How futile are mindless assessments of roundoff", 2006, section 12).

    Args:
        gaze: Where each eye looks; anywhere, also outside the image.
        camera: The views; off-axis ones are honoured.

    Returns:
        Angle in degrees, from 0 to 180, shape (v, 1, h, w).

    Raises:
        ShapeError: If gaze and camera differ in the number of views.

    Differentiable: in the gaze and the camera's tensors.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(3, 3))
        >>> eccentricity_degrees(Gaze.center(camera), camera)[0, 0, 1]
        tensor([33.6901,  0.0000, 33.6901])
    """
    views = camera.views
    require_shapes("v 2", {"v": views.view_count}, **{"gaze.pixels": gaze.pixels})
    towards = views.rays().directions
    centre = views.rays(gaze.pixels.to(towards)[:, None]).directions
    across = torch.linalg.vector_norm(towards - centre, dim=-1)
    along = torch.linalg.vector_norm(towards + centre, dim=-1)
    return torch.rad2deg(2 * torch.atan2(across, along)).reshape(-1, 1, *views.resolution)


@dataclass(frozen=True)
class Display:
    """One eye's image as it is seen: a plane of square pixels, its centre straight ahead.

    Attributes:
        resolution: Height and width in pixels.
        fov_x_deg: Horizontal field of view in degrees, in (0, 180).

    Raises:
        ValueError: If the resolution or the field of view is out of range.

    Example:
        >>> display = Display((1080, 960), fov_x_deg=90)
        >>> round(display.pixels_per_degree, 3), round(display.fov_y_deg, 2)
        (8.378, 96.73)
    """

    resolution: tuple[int, int]
    fov_x_deg: float

    def __post_init__(self) -> None:
        require(len(self.resolution) == 2, "resolution", self.resolution, "a height and a width")
        require_integer("resolution[0] (height)", self.resolution[0], minimum=1)
        require_integer("resolution[1] (width)", self.resolution[1], minimum=1)
        require_number("fov_x_deg", self.fov_x_deg, above=0, maximum=179.9)

    @classmethod
    def fhd(cls) -> Display:
        """Returns half of a full-HD screen per eye, 960 x 1080, the 2023 paper's first resolution.

        The paper states no field of view; 90 degrees, about what headsets of that resolution had, are our choice.

        Example:
            >>> Display.fhd().resolution
            (1080, 960)
        """
        return cls(FHD, 90.0)

    @classmethod
    def quest2(cls) -> Display:
        """Returns 1832 x 1920 pixels per eye, the 2023 paper's second resolution, which is that of the Meta Quest 2.

        The paper states no field of view. 97 degrees are what the headset's runtime reports, from -52 to 45 for the
        left eye (recording "Oculus Quest 2 (72Hz)" in the hmdq database of headset geometries, 2020); here centred.

        Example:
            >>> Display.quest2().resolution
            (1920, 1832)
        """
        return cls(QUEST2, 97.0)

    @classmethod
    def from_size(cls, resolution: tuple[int, int], width: float, distance: float) -> Display:
        """Returns a flat display of a given width, seen from straight ahead.

        Args:
            resolution: Height and width in pixels.
            width: Width of the display in metres, above 0.
            distance: Viewing distance in metres, above 0.

        Returns:
            The display, whose ``fov_x_deg`` is ``2 atan(width / (2 distance))``.

        Raises:
            ValueError: If a value is out of range.

        Example:
            >>> desktop = Display.from_size((1080, 1920), width=0.509, distance=0.59)  # Guenter et al. 2012
            >>> round(desktop.fov_x_deg, 2), round(desktop.pixels_per_degree, 2)
            (46.67, 38.84)
        """
        require_number("width", width, above=0)
        require_number("distance", distance, above=0)
        return cls(resolution, 2 * math.degrees(math.atan(width / 2 / distance)))

    @property
    def pixels_per_tangent(self) -> float:
        """Pixels per unit of the tangent of the angle from the axis: w / (2 tan(fov_x / 2))."""
        return self.resolution[1] / 2 / math.tan(math.radians(self.fov_x_deg) / 2)

    @property
    def pixels_per_degree(self) -> float:
        """Pixels per degree at the image's centre; on a plane there are more of them farther out."""
        return math.radians(self.pixels_per_tangent)

    @property
    def fov_y_deg(self) -> float:
        """Vertical field of view in degrees."""
        return 2 * math.degrees(math.atan(self.resolution[0] / 2 / self.pixels_per_tangent))

    def radius(self, degrees: float) -> float:
        """Returns the radius in pixels of the circle around the image's centre that lies at an eccentricity.

        Args:
            degrees: Eccentricity, in [0, 90).

        Returns:
            ``pixels_per_tangent * tan(degrees)``.

        Raises:
            ValueError: If ``degrees`` is out of range.

        Example:
            >>> round(Display((1080, 960), fov_x_deg=90).radius(45), 3)
            480.0
        """
        require_number("degrees", degrees, minimum=0, maximum=89.9)
        return self.pixels_per_tangent * math.tan(math.radians(degrees))

    def eccentricity_pixels(self, gaze: Gaze) -> Tensor:
        """Returns each pixel's distance from the gaze in pixels, shape (v, 1, h, w); see :func:`eccentricity_pixels`.

        Example:
            >>> Display((2, 2), 90).eccentricity_pixels(Gaze(torch.tensor([[0.5, 0.5]])))[0, 0]
            tensor([[0.0000, 1.0000],
                    [1.0000, 1.4142]])
        """
        return eccentricity_pixels(gaze, self.resolution)

    def eccentricity_degrees(self, gaze: Gaze) -> Tensor:
        """Returns each pixel's angle from the gaze in degrees, shape (v, 1, h, w); see :func:`eccentricity_degrees`.

        Example:
            >>> Display((3, 3), 90).eccentricity_degrees(Gaze(torch.tensor([[1.5, 1.5]])))[0, 0, 1]
            tensor([33.6901,  0.0000, 33.6901])
        """
        height, width = self.resolution
        half_width, half_height = width / 2 / self.pixels_per_tangent, height / 2 / self.pixels_per_tangent
        pixels = gaze.pixels
        views = Camera(
            origin=pixels.new_zeros(pixels.shape[0], 3),
            rotation=torch.eye(3).to(pixels).repeat(pixels.shape[0], 1, 1),
            bounds=pixels.new_tensor([[-half_width, half_width, -half_height, half_height]]).repeat(pixels.shape[0], 1),
            resolution=self.resolution,
        )
        return eccentricity_degrees(gaze, views)
