"""Log-polar rasters whose columns are spread by a kernel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require_number
from fovden.warps._checks import gaze_of, require_parameter
from fovden.warps.polar import FoveaBorder, PolarWarp

__all__ = ["LogPolarWarp"]

SHORTEST = 2.0  # pixels; the logarithm of a reach of 1, which only an image of a pixel or two has, would be 0


@dataclass(frozen=True, eq=False)
class LogPolarWarp(PolarWarp):
    """The log-polar raster with a power for a kernel, of kernel foveated rendering.

    With L = ln(reach), where reach is the distance from the gaze to the farthest corner, and t = x / w:

        r = exp(L t^alpha),   t = (ln r / L)^(1 / alpha)

    alpha = 1 is the classic log-polar raster, with cells of one shape everywhere. A larger alpha moves columns towards
    the gaze: with a farthest corner at 1101 pixels, 33 % of them lie within 10 pixels of it for 1, and 76 % for 4.
    Pixels nearer to the gaze than 1 are at t = 0. All columns have the full height.

    Attributes:
        gaze: Where each eye looks, in pixels; anywhere, also outside the image.
        screen: Height and width of the screen in pixels.
        resolution: Height and width of the raster: rows (angles) and columns (distances).
        fovea_border: What lies before column 0; see :class:`PolarWarp`.
        alpha: Exponent of the kernel, above 0, a number or a scalar tensor.

    Raises:
        ValueError: If a value is out of range.

    Differentiable: every map in ``gaze`` and ``alpha``.

    Source: Meng, Du, Zaheer and Varshney, "Kernel foveated rendering", 2018, section 4; the direction of the kernel
    (the power from raster to screen, its root back) is that of the same laboratory's published samplers. alpha = 4 and
    sigma = 1.8 are the values of the paper's comparison.

    Example:
        >>> warp = LogPolarWarp(Gaze(torch.tensor([[640.0, 720.0]])), screen=(1440, 1280), resolution=(800, 711))
        >>> warp.screen_to_cell(torch.tensor([[[640.0, 820.0]]]))  # 100 pixels below the gaze
        tensor([[[643.3327, 200.0000]]])
    """

    alpha: float | Tensor = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_parameter("alpha", self.alpha, above=0)

    @classmethod
    def for_camera(
        cls,
        camera: Camera | StereoCamera,
        gaze: Gaze | None = None,
        *,
        sigma: float = 1.8,
        alpha: float | Tensor = 4.0,
        fovea_border: FoveaBorder = "clamp",
    ) -> LogPolarWarp:
        """Returns the raster for a camera, smaller than its screen by a ratio in both directions.

        Args:
            camera: The views.
            gaze: Where each eye looks; ``None`` means the centre.
            sigma: Screen over raster in each direction, above 0. 1.8 leaves 31 % of the pixels. It gives whole numbers,
                and has no gradient.
            alpha: Exponent of the kernel.
            fovea_border: What lies before column 0.

        Returns:
            The warp.

        Raises:
            ShapeError: If gaze and camera differ in the number of views.
            ValueError: If a value is out of range.

        Example:
            >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(1440, 1280))
            >>> LogPolarWarp.for_camera(camera).resolution
            (800, 711)
        """
        require_number("sigma", sigma, above=0)
        height, width = camera.views.resolution
        resolution = (max(1, round(height / sigma)), max(1, round(width / sigma)))
        return cls(gaze_of(camera, gaze), (height, width), resolution, fovea_border, alpha)

    @property
    def name(self) -> str:
        """``"log-polar"``."""
        return "log-polar"

    @property
    def blur_start(self) -> Tensor:
        """Distance of the raster's middle column, shape (v,): the published samplers smooth its outer half alone."""
        return self.to_distance(torch.full_like(self.reach, 0.5)[:, None])[:, 0]

    def to_distance(self, fraction: Tensor) -> Tensor:
        """Returns exp(L t^alpha) in pixels.

        Example:
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.to_distance(torch.tensor([[0.0, 0.5, 1.0]]).double())
            tensor([[ 1.0000,  1.2770, 50.0000]], dtype=torch.float64)
        """
        return torch.exp(self._log_reach() * fraction.clamp(min=0) ** self._power(fraction))

    def to_fraction(self, distance: Tensor) -> Tensor:
        """Returns (ln r / L)^(1 / alpha), and 0 where r is at most 1.

        Example:
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.to_fraction(torch.tensor([[0.5, 1.277, 50.0]]).double())
            tensor([[0.0000, 0.5000, 1.0000]], dtype=torch.float64)
        """
        beyond = distance > 1
        ratio = torch.where(beyond, distance, math.e).log() / self._log_reach()
        return torch.where(beyond, ratio ** (1 / self._power(distance)), 0.0)

    def stretch(self, fraction: Tensor) -> Tensor:
        """Returns r L alpha t^(alpha - 1), pixels per unit of t.

        Example:
            >>> warp = LogPolarWarp(Gaze(torch.zeros(1, 2)), (30, 40), (8, 8))
            >>> warp.stretch(torch.tensor([[1.0]]).double())  # 4 * 50 ln 50
            tensor([[782.4046]], dtype=torch.float64)
        """
        power = self._power(fraction)
        along = fraction.clamp(min=0) ** (power - 1)
        return self.to_distance(fraction) * self._log_reach() * power * along

    def _log_reach(self) -> Tensor:
        return self.reach.clamp(min=SHORTEST).log()[:, None]

    def _power(self, like: Tensor) -> Tensor:
        return torch.as_tensor(self.alpha, dtype=like.dtype, device=like.device)
