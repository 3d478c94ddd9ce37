"""FLIP of radiance: the largest error that a viewer can find by changing the exposure.

An error in a shadow cannot be seen on a display until the exposure is raised, one in a lamp until it is lowered. Both
images are therefore shown at several exposures, from one that fits the brightest pixel to one that fits the median, and
each pixel keeps the largest of its errors by :func:`fovden.metrics.flip`.

Source: Andersson, Nilsson, Shirley, Akenine-Moller, "Visualizing errors in rendered high dynamic range images",
Eurographics 2021 short papers; sections are named by their titles.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from fovden.checks import require, require_finite, require_integer, require_number, require_shapes
from fovden.color import luminance
from fovden.metrics.flip_ldr import PIXELS_PER_DEGREE, linear_flip_map
from fovden.metrics.image import weighted_mean

__all__ = ["TONE_CURVES", "exposure_range", "hdr_flip", "hdr_flip_map", "tone_map"]

TONE_CURVES = {
    "aces": (0.6**2 * 2.51, 0.6 * 0.03, 0.0, 0.6**2 * 2.43, 0.6 * 0.59, 0.14),
    "hable": (0.231683, 0.013791, 0.0, 0.18, 0.3, 0.018),
    "reinhard": (0.0, 1.0, 0.0, 0.0, 1.0, 1.0),
}
"""Tone curves as quotients of polynomials, (k0 x^2 + k1 x + k2) / (k3 x^2 + k4 x + k5): "Computing start and stop
exposures".

``aces`` is Narkowicz's fit to the film curve of the Academy Color Encoding System ("ACES filmic tone mapping curve",
2015), its exposure of 1 / 0.6 taken out. ``hable`` is Hable's curve ("Uncharted 2: HDR lighting", Game
Developers Conference 2010) at its white of 11.2 and exposure of 2, its six constants multiplied out. ``reinhard`` is
x / (1 + x) (Reinhard, Stark, Shirley, Ferwerda, "Photographic tone reproduction for digital images", SIGGRAPH 2002,
equation 3), which acts on luminance and scales colours with it."""

TARGET = 0.85
"""Displayed value that the first exposure gives the brightest pixel, and the last one the median, as above."""

SATURATED = 1e6
"""Radiance at which ``aces`` and ``hable`` have long passed 1; no larger value is squared."""

LIMIT = 127
"""Largest exposure either way, in stops: what single precision can hold."""


def hdr_flip(
    image: Tensor,
    reference: Tensor,
    weight: Tensor | None = None,
    *,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
    tone_mapper: str = "aces",
    start_exposure: float | None = None,
    stop_exposure: float | None = None,
    exposure_count: int | None = None,
) -> Tensor:
    """Returns the mean HDR-FLIP error of each view; lower is better.

    Args:
        image: Linear radiance to judge, at least 0, shape (v, 3, h, w).
        reference: What it should be, the same shape.
        weight: Weight map; see :func:`fovden.metrics.weighted_mean`.
        pixels_per_degree: Pixels per degree of visual angle, at least 1; see
            :func:`fovden.metrics.monitor_pixels_per_degree`.
        tone_mapper: ``"aces"``, ``"hable"`` or ``"reinhard"``.
        start_exposure: First exposure in stops; see :func:`hdr_flip_map`.
        stop_exposure: Last exposure in stops.
        exposure_count: Number of exposures.

    Returns:
        Error in [0, 1], shape (v); 0 for equal images.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is negative or not finite, a weight is negative or an option is out of range.

    Differentiable: in both images and ``weight``, not in the exposures chosen. Source: as for the module.

    Example:
        >>> hdr_flip(torch.full((1, 3, 4, 4), 9.0), torch.full((1, 3, 4, 4), 10.0))
        tensor([0.0506])
    """
    error = hdr_flip_map(
        image,
        reference,
        pixels_per_degree=pixels_per_degree,
        tone_mapper=tone_mapper,
        start_exposure=start_exposure,
        stop_exposure=stop_exposure,
        exposure_count=exposure_count,
    )
    return weighted_mean(error, weight)


def hdr_flip_map(
    image: Tensor,
    reference: Tensor,
    *,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
    tone_mapper: str = "aces",
    start_exposure: float | None = None,
    stop_exposure: float | None = None,
    exposure_count: int | None = None,
) -> Tensor:
    """Returns the HDR-FLIP error of every pixel: the largest over the exposures.

    Args:
        image: Linear radiance to judge, at least 0, shape (v, 3, h, w).
        reference: What it should be, the same shape.
        pixels_per_degree: As for :func:`hdr_flip`.
        tone_mapper: ``"aces"``, ``"hable"`` or ``"reinhard"``; see
            :data:`fovden.metrics.flip_hdr.TONE_CURVES`.
        start_exposure: First exposure in stops: radiance is multiplied by 2 to its power. ``None`` means that of
            :func:`fovden.metrics.flip_hdr.exposure_range`, for each view by itself.
        stop_exposure: Last exposure in stops, at least the first; ``None`` as before.
        exposure_count: Number of exposures, evenly spaced, at least 2; ``None`` means one per stop of the range,
            rounded up, and at least 2 ("Computing and visualizing the error").

    Returns:
        Error in [0, 1], shape (v, 1, h, w); :func:`fovden.colormap.apply` gives it its usual colours.

    Raises:
        ShapeError: If the shapes disagree.
        ValueError: If a value is negative or not finite or an option is out of range.

    Differentiable: in both images, not in the exposures chosen. Source: as for the module.

    Example:
        >>> reference = torch.tensor([0.1, 1.0, 10.0]).expand(1, 3, 1, 3)
        >>> hdr_flip_map(1.2 * reference, reference).shape
        torch.Size([1, 1, 1, 3])
    """
    require_shapes("v 3 h w", image=image, reference=reference)
    require_finite("image", image, minimum=0)
    start, stop = exposure_range(reference, tone_mapper)
    views = []
    for view, automatic in enumerate(zip(start, stop, strict=True)):
        pair = image[view : view + 1], reference[view : view + 1]
        exposures = _exposures(automatic, start_exposure, stop_exposure, exposure_count)
        worst = torch.zeros_like(pair[1][:, :1])
        for exposure in exposures:
            shown, truth = (tone_map(radiance, exposure, tone_mapper) for radiance in pair)
            worst = torch.maximum(worst, linear_flip_map(shown, truth, pixels_per_degree))
        views.append(worst)
    return torch.cat(views)


def exposure_range(reference: Tensor, tone_mapper: str = "aces") -> tuple[list[float], list[float]]:
    """Returns the first and the last exposure at which an image is looked at, in stops, for each view.

    The first shows the largest luminance at 0.85 of the display's white, the last the median: the upper one of an even
    number of pixels. Where more than half of a view is black and its median 0, that of the other pixels is taken, since
    no exposure brightens black. A view without light is looked at as it is, at 0 stops.

    Args:
        reference: Linear radiance, at least 0, shape (v, 3, h, w).
        tone_mapper: ``"aces"``, ``"hable"`` or ``"reinhard"``.

    Returns:
        First and last exposures, v numbers each.

    Raises:
        ShapeError: If ``reference`` has another shape.
        ValueError: If a value is negative or not finite or the tone mapper unknown.

    Source: "Computing start and stop exposures"; the rules for black are ours.

    Example:
        >>> start, stop = exposure_range(torch.tensor([1.0, 2.0, 8.0]).expand(1, 3, 1, 3))
        >>> round(stop[0] - start[0], 6)
        2.0
    """
    _require_tone_mapper(tone_mapper)
    lum = luminance(require_finite("reference", reference.detach(), minimum=0)).flatten(1)
    fit = _inverse(TARGET, tone_mapper)
    # In single precision, as the authors have it: the range decides how many exposures there are.
    ranges = [[float(np.float32(math.log2(np.float32(fit / level)))) for level in _levels(view, fit)] for view in lum]
    return [first for first, _ in ranges], [last for _, last in ranges]


def tone_map(radiance: Tensor, exposure: float, tone_mapper: str = "aces") -> Tensor:
    """Returns the linear light that a display shows of radiance: exposed, through the tone curve, clamped to [0, 1].

    Args:
        radiance: Linear radiance, at least 0, shape (v, 3, h, w).
        exposure: In stops: radiance is multiplied by 2 to its power.
        tone_mapper: ``"aces"``, ``"hable"`` or ``"reinhard"``; see :data:`TONE_CURVES`.

    Returns:
        Linear values in [0, 1], the same shape.

    Raises:
        ValueError: If the tone mapper is unknown.

    Differentiable: in ``radiance``, with gradient 0 where clamped. Source: as for :data:`TONE_CURVES`.

    Example:
        >>> tone_map(torch.full((1, 3, 1, 1), 0.5), 1.0, "reinhard").flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """
    _require_tone_mapper(tone_mapper)
    if tone_mapper == "reinhard":
        # Divided by the scale above and below, so that nothing overflows.
        return (radiance / (luminance(radiance) + math.pow(2, -exposure))).clamp(0, 1)
    k0, k1, k2, k3, k4, k5 = TONE_CURVES[tone_mapper]
    x = (radiance * math.pow(2, exposure)).clamp(max=SATURATED)
    return (((k0 * x + k1) * x + k2) / ((k3 * x + k4) * x + k5)).clamp(0, 1)


def _require_tone_mapper(name: str) -> None:
    require(name in TONE_CURVES, "tone_mapper", repr(name), f"one of {', '.join(TONE_CURVES)}")


def _exposures(
    automatic: tuple[float, float], start: float | None, stop: float | None, count: int | None
) -> list[float]:
    """The exposures of one view."""
    start = automatic[0] if start is None else require_number("start_exposure", start, minimum=-LIMIT, maximum=LIMIT)
    stop = automatic[1] if stop is None else require_number("stop_exposure", stop, minimum=-LIMIT, maximum=LIMIT)
    require(start <= stop, "stop_exposure", f"{stop:g}", f"at least the start exposure, {start:g},")
    if count is None:
        count = max(2, math.ceil(np.float32(stop) - np.float32(start)))
    step = (stop - start) / (require_integer("exposure_count", count, minimum=2) - 1)
    return sorted({start + number * step for number in range(count)})


def _levels(lum: Tensor, otherwise: float) -> tuple[float, float]:
    """Largest and median luminance of one view's pixels, (n,), or what to take instead where there is no light."""
    dark = lum < torch.finfo(torch.float32).tiny
    if dark.all():
        return otherwise, otherwise
    judged = lum[~dark] if dark.sum() > lum.numel() // 2 else lum
    return float(lum.max()), float(judged.sort().values[judged.numel() // 2])


def _inverse(shown: float, tone_mapper: str) -> float:
    """The larger solution x of curve(x) = shown, a quadratic equation."""
    k0, k1, k2, k3, k4, k5 = TONE_CURVES[tone_mapper]
    a, b, c = k0 - shown * k3, k1 - shown * k4, k2 - shown * k5
    return -c / b if a == 0 else (-b + math.sqrt(b * b - 4 * a * c)) / (2 * a)
