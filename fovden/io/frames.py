"""Frames as OpenEXR files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import require, require_finite
from fovden.frame import Frame, GBuffer
from fovden.io.exr import BEAUTY, Exr, ImageChannels, read_exr, write_exr
from fovden.io.files import FilePath
from fovden.io.foreign import foreign_frame
from fovden.io.warps import warp_from_json, warp_to_json

__all__ = ["camera_from_json", "camera_to_json", "load_frame", "save_frame"]

LIGHT = (
    ImageChannels("direct", "direct", "RGB"),
    ImageChannels("indirect", "indirect", "RGB"),
    ImageChannels("emission", "emission", "RGB"),
)
SAMPLES = (
    ImageChannels("counts", "spp", "Y"),
    ImageChannels("luminance_squared", "luminance_squared", "Y"),
    ImageChannels("layer", "layer", "Y"),
)
GEOMETRY = (
    ImageChannels("albedo", "albedo", "RGB"),
    ImageChannels("normal", "N", "XYZ"),
    ImageChannels("position", "P", "XYZ"),
    ImageChannels("depth", "", "Z"),
    ImageChannels("roughness", "roughness", "Y"),
    ImageChannels("motion", "motion", "XY"),
    ImageChannels("prim", "prim", "Y"),
    ImageChannels("barycentric", "barycentric", "UV"),
)


def save_frame(path: FilePath, frame: Frame) -> None:
    """Writes a frame to an OpenEXR file from which :func:`load_frame` reads the same bits.

    Args:
        path: The file, named ``*.exr``; its folder must exist.
        frame: The frame, in float32.

    Raises:
        ValueError: If the name does not end in ``.exr``, the frame is not float32, its light is negative or not
            finite, it has a ``weight``, which is for learning alone, or its raster is of a class that is not this
            package's.
        OSError: If the file cannot be written.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "frame.exr"
        >>> frame = Frame.from_radiance(torch.rand(2, 3, 4, 6), GBuffer.empty(2, (4, 6)))
        >>> save_frame(path, frame)
        >>> torch.equal(load_frame(path).radiance, frame.radiance)
        True
    """
    require(frame.weight is None, "frame.weight", "a tensor", "None, since files hold no light beneath a weight of 0")
    for image in LIGHT:
        require_finite(f"frame.{image.field}", getattr(frame, image.field), minimum=0)
    tensors = {image: getattr(frame, image.field) for image in (BEAUTY, *LIGHT, *SAMPLES)}
    tensors |= {image: getattr(frame.gbuffer, image.field) for image in GEOMETRY}
    attributes = {
        "kind": "frame",
        "camera": camera_to_json(frame.camera),
        "gaze": None if frame.gaze is None else frame.gaze.pixels.tolist(),
        "jitter": list(frame.jitter),
        "index": frame.index,
        "seed": frame.seed,
        "warp": warp_to_json(frame.warp),
    }
    write_exr(path, tensors, attributes)


def load_frame(path: FilePath, *, camera: Camera | StereoCamera | None = None) -> Frame:
    """Reads a frame, its own or another renderer's.

    A frame written by :func:`save_frame` comes back as it was. Any other file must have the beauty image ``R G B``,
    normals and positions in the world, under one of these names (case does not matter, and neither does what stands
    in front, as in ``ViewLayer.Normal``): normals ``N``, ``nn``, ``Ns``, ``normal``, ``normals``, ``sh_normal``;
    positions ``P``, ``pos``, ``position``, ``positions``; with the letters ``X Y Z`` or ``R G B``. What may be missing:

    - ``albedo`` (or ``alb``, ``DiffCol``, ``Diffuse Color``): 1 where there is a surface, else 0.
    - ``spp`` (or ``samples``): one sample in every pixel. A layer ``mask`` zeroes it where the mask is 0.
    - ``Z`` (or ``depth``), along the viewing axis: computed from the positions where ``camera`` is given; otherwise
      the root-mean-square distance of the positions from their mean, which is a length of the right order and no
      more, with a warning. (A Mitsuba ``dd`` layer is the distance along the ray and is not taken.)
    - Everything else: all light counts as direct, squared luminance 0, one layer, roughness 1, motion 0,
      barycentric 0, ``prim`` 0.

    A pixel is a miss (``prim`` -1, all of its geometry 0) where its normal is zero or its position or depth is
    infinite. Half floats are widened; two or more views are found by ``multiView`` or by the parts' ``view``.

    Args:
        path: The file.
        camera: The views, for files that do not know them.

    Returns:
        The frame.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a whole OpenEXR file, a channel that is needed is missing (naming those that it has),
            the light is negative or not finite, or the camera has another size.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "frame.exr"
        >>> save_frame(path, Frame.from_radiance(torch.ones(2, 3, 4, 6), GBuffer.empty(2, (4, 6))))
        >>> load_frame(path).view_count
        2
    """
    path = Path(path)
    file = read_exr(path)
    kind = file.attributes.get("kind")
    require(kind in (None, "frame"), str(path), f"a {kind}", "a frame")
    views = None if camera is None else camera.views
    if views is not None:
        warp = warp_from_json(file.attributes.get("warp"))
        size = (len(file.views), *(next(iter(file.channels.values())).shape if warp is None else warp.screen))
        given = (views.view_count, *views.resolution)
        require(given == size, "camera", given, f"the file's views, height and width {size}")
    frame = foreign_frame(file, views) if kind is None else _own_frame(file)
    frame = frame if views is None else replace(frame, camera=views)
    for image in LIGHT:
        require_finite(f"{path}: {image.field}", getattr(frame, image.field), minimum=0)
    return frame


def _own_frame(file: Exr) -> Frame:
    images = {image.field: file.image(image) for image in (*LIGHT, *SAMPLES)}
    gbuffer = GBuffer(**{image.field: file.image(image) for image in GEOMETRY})
    attributes = file.attributes
    gaze = attributes["gaze"]
    return Frame(
        **images,
        gbuffer=gbuffer,
        camera=camera_from_json(attributes["camera"]),
        gaze=None if gaze is None else Gaze(torch.tensor(gaze, dtype=torch.float32)),
        jitter=(attributes["jitter"][0], attributes["jitter"][1]),
        index=attributes["index"],
        seed=attributes["seed"],
        warp=warp_from_json(attributes["warp"]),
    )


def camera_to_json(camera: Camera | None) -> dict[str, Any] | None:
    """Returns a camera as JSON can hold it; ``None`` stays ``None``.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(4, 4)).views
        >>> camera_to_json(camera)["bounds"][0]
        [-1.0, 1.0, -1.0, 1.0]
    """
    if camera is None:
        return None
    parts = {name: getattr(camera, name).tolist() for name in ("origin", "rotation", "bounds")}
    return {**parts, "resolution": list(camera.resolution), "dtype": str(camera.origin.dtype).removeprefix("torch.")}


def camera_from_json(saved: dict[str, Any] | None) -> Camera | None:
    """Returns the camera that :func:`camera_to_json` was given, to the bit.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(4, 4)).views
        >>> torch.equal(camera_from_json(camera_to_json(camera)).origin, camera.origin)
        True
    """
    if saved is None:
        return None
    dtype = getattr(torch, saved["dtype"])
    parts = {name: torch.tensor(saved[name], dtype=dtype) for name in ("origin", "rotation", "bounds")}
    return Camera(**parts, resolution=(saved["resolution"][0], saved["resolution"][1]))
