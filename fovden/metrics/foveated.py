"""What the eye makes of an error: weights by acuity, and FovVideoVDP.

An error a hundred pixels from the gaze is seen less than one at it. :func:`acuity_weight` is a weight map for every
metric of this package and for :func:`fovden.metrics.compare`; it says how many details the eye resolves where, and
nothing of contrast or masking. :func:`fovvideovdp` asks a model of vision that knows of both.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import torch
from torch import Tensor

from fovden import color
from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require_finite, require_number, require_shapes
from fovden.foveation import Acuity, LinearMarAcuity, eccentricity_degrees

__all__ = ["acuity_weight", "fovvideovdp"]

HALF_RESOLUTION_DEG = 2.3
"""Eccentricity at which acuity is half of the fovea's: e2 of Geisler and Perry, "A real-time foveated multiresolution
system for low-bandwidth video communication", 1998."""


def acuity_weight(camera: Camera | StereoCamera, gaze: Gaze, acuity: Acuity | None = None) -> Tensor:
    """Returns how much each pixel counts to an eye that looks at the gaze: acuity(e) at e degrees from it.

    Args:
        camera: The views.
        gaze: Where each eye looks.
        acuity: Weight against eccentricity in degrees; as a weight of areas, acuity is squared (``power=2``). ``None``
            means Geisler and Perry's, 1 / (1 + e / 2.3)^2.

    Returns:
        Weights in (0, 1], shape (v, 1, h, w): the ``weight`` of every metric here. Metrics divide by their sum.

    Raises:
        ShapeError: If gaze and camera differ in the number of views.

    Differentiable: in the gaze and in what the acuity is differentiable in.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(3, 3))
        >>> weight = acuity_weight(camera, Gaze.center(camera))
        >>> weight.shape, weight[0, 0, 1]
        (torch.Size([2, 1, 3, 3]), tensor([0.0041, 1.0000, 0.0041]))
    """
    if acuity is None:
        acuity = LinearMarAcuity(slope=1 / HALF_RESOLUTION_DEG, mar0=1.0, power=2)
    return acuity(eccentricity_degrees(gaze, camera))


def fovvideovdp(
    image: Tensor,
    reference: Tensor,
    camera: Camera | StereoCamera,
    gaze: Gaze,
    exposure: float | None = None,
    *,
    peak_luminance: float = 100.0,
    contrast: float = 1000.0,
) -> Tensor:
    """Returns FovVideoVDP's quality of each eye's still image, in just-objectionable differences (JOD).

    10 is an image that cannot be told from the reference; one less is a difference that 75 % of observers would see as
    worse. The images pass through the exposure of the reference, the sRGB curve and a display of the given luminance.

    This calls the authors' own program, which is not a part of fovden: ``pip install "fovden[fovvideovdp]"``. Its
    licence, Creative Commons Attribution-NonCommercial 4.0, is not that of fovden: it allows no commercial use.

    Args:
        image: Linear radiance, shape (v, 3, h, w).
        reference: What it should be, the same shape.
        camera: The views. The program knows centred displays only: an off-axis view is told to it as a centred one that
            is as wide, so that angles differ near its edges.
        gaze: Where each eye looks, in pixels.
        exposure: Scale from radiance to the display; ``None`` means :func:`fovden.color.exposure` of the reference.
        peak_luminance: Luminance of white in cd/m^2, above 0. 100 is about that of headsets with persistence reduced.
        contrast: Luminance of white over that of black, above 1.

    Returns:
        JOD, shape (v), at most 10.

    Raises:
        ImportError: If FovVideoVDP is not installed.
        ShapeError: If the shapes disagree.
        ValueError: If a value is not finite or a number out of range.

    Not differentiable. Cost: some seconds for a megapixel.

    Source: Mantiuk et al., "FovVideoVDP: a visible difference predictor for wide field-of-view video", ACM TOG 40(4),
    2021.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(64, 64))
        >>> ones = torch.ones(2, 3, 64, 64)
        >>> fovvideovdp(ones, ones, camera, Gaze.center(camera))  # doctest: +SKIP
        tensor([10., 10.])
    """
    views = camera.views
    height, width = views.resolution
    sizes = {"v": views.view_count, "h": height, "w": width}
    require_shapes("v 3 h w", sizes, image=image, reference=reference)
    require_shapes("v 2", sizes, **{"gaze.pixels": gaze.pixels})
    require_finite("image", image)
    require_finite("reference", reference)
    require_number("peak_luminance", peak_luminance, above=0)
    require_number("contrast", contrast, above=1)
    exposure = color.exposure(reference) if exposure is None else exposure
    shown, truth = (color.display(each.detach().float(), exposure).cpu() for each in (image, reference))
    widths = views.bounds[:, 1] - views.bounds[:, 0]
    scores = []
    with warnings.catch_warnings(action="ignore"):  # it uses what SciPy and others are about to drop
        photometry, geometry, program = _program()
        for eye, eye_truth, looks, tangent in zip(shown, truth, gaze.pixels, widths.tolist(), strict=True):
            judge = program(
                display_photometry=photometry(peak_luminance, contrast=contrast, EOTF="sRGB"),
                display_geometry=geometry([width, height], fov_horizontal=2 * math.degrees(math.atan(tangent / 2))),
                foveated=True,
                quiet=True,
                device=torch.device("cpu"),
            )
            pair = (each[None, :, None].contiguous() for each in (eye, eye_truth))
            jod, _ = judge.predict(*pair, dim_order="BCFHW", fixation_point=looks.detach().cpu().float())
            scores.append(float(jod))
    return torch.tensor(scores)


def _program() -> tuple[Any, Any, Any]:
    """Photometry, geometry, and FovVideoVDP itself."""
    try:
        import pyfvvdp  # noqa: PLC0415 - an extra
        from pyfvvdp import fvvdp_display_model  # noqa: PLC0415
    except ImportError as error:
        raise ImportError('FovVideoVDP is not installed: pip install "fovden[fovvideovdp]"') from error
    return fvvdp_display_model.fvvdp_display_photo_eotf, fvvdp_display_model.fvvdp_display_geometry, pyfvvdp.fvvdp
