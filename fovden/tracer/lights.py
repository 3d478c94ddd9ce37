"""Light sources as a user names them; the tracer turns them into one table when a scene is first traced.

A surface whose material emits is a light too and needs no entry here. The radiometric quantities are those of
Mitsuba's emitters of the same names, in linear Rec. 709 RGB.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from fovden.checks import require, require_finite, require_shapes

__all__ = ["DirectionalLight", "EnvironmentLight", "Light", "PointLight"]

Triple = tuple[float, float, float]


def _triple(name: str, value: object) -> Triple:
    """Three finite numbers; a single number stands for three equal ones."""
    if isinstance(value, int | float):
        value = (value, value, value)
    try:
        x, y, z = (float(component) for component in value)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected three numbers, got {value!r}") from None
    require(all(map(math.isfinite, (x, y, z))), name, value, "three finite numbers")
    return x, y, z


def _colour(name: str, value: object) -> Triple:
    colour = _triple(name, value)
    require(min(colour) >= 0, name, value, "non-negative numbers")
    return colour


@dataclass(frozen=True)
class PointLight:
    """A point that shines equally in every direction.

    Attributes:
        position: Where it is, metres.
        intensity: Radiant intensity in W/sr per channel, a triple or one number for all.

    Example:
        >>> PointLight((0, 4.5, -0.4), 40).intensity
        (40.0, 40.0, 40.0)
    """

    position: Triple
    intensity: Triple | float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _triple("PointLight.position", self.position))
        object.__setattr__(self, "intensity", _colour("PointLight.intensity", self.intensity))


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light from infinitely far away, such as the sun without its disc.

    Attributes:
        direction: Direction in which the light travels; its length does not matter.
        irradiance: Irradiance in W/m^2 per channel on a surface perpendicular to the light, a triple or one number.

    Example:
        >>> DirectionalLight((0, -2, 0), (12, 11, 10)).direction
        (0.0, -1.0, 0.0)
    """

    direction: Triple
    irradiance: Triple | float

    def __post_init__(self) -> None:
        x, y, z = _triple("DirectionalLight.direction", self.direction)
        length = math.sqrt(x * x + y * y + z * z)
        require(length > 0, "DirectionalLight.direction", self.direction, "a vector that is not zero")
        object.__setattr__(self, "direction", (x / length, y / length, z / length))
        object.__setattr__(self, "irradiance", _colour("DirectionalLight.irradiance", self.irradiance))


@dataclass(frozen=True, eq=False)
class EnvironmentLight:
    """Light from all around, constant or an equirectangular image.

    Attributes:
        radiance: A triple or one number for a constant sky, or an image of shape (3, h, w) in the usual
            latitude-longitude layout: the top row is straight up (+y), the image's middle is the direction -z, and
            +x lies a quarter of the width to the right of it.

    Example:
        >>> EnvironmentLight(1).radiance
        (1.0, 1.0, 1.0)
    """

    radiance: Triple | float | Tensor

    def __post_init__(self) -> None:
        if isinstance(self.radiance, Tensor):
            require_shapes("3 h w", **{"EnvironmentLight.radiance": self.radiance})
            require_finite("EnvironmentLight.radiance", self.radiance, minimum=0)
        else:
            object.__setattr__(self, "radiance", _colour("EnvironmentLight.radiance", self.radiance))


Light = PointLight | DirectionalLight | EnvironmentLight
