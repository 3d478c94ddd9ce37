"""References and images as OpenEXR files, and pictures as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

import torch
from torch import Tensor

from fovden.checks import require, require_finite, require_shapes
from fovden.frame import Reference
from fovden.io.exr import BEAUTY, ImageChannels, read_exr, write_exr
from fovden.io.files import FilePath, atomic_write
from fovden.io.foreign import find_image
from fovden.io.frames import camera_from_json, camera_to_json
from fovden.preview import encode_png, to_levels

__all__ = ["PngLayout", "load_image", "load_reference", "save_image", "save_png", "save_reference"]

PngLayout = Literal["side-by-side", "cross-eyed", "left", "right"]
"""Which views a picture has and where; see :func:`save_png`."""

REFERENCE = (ImageChannels("mean", "", "RGB"), ImageChannels("variance", "variance", "RGB"))


def save_reference(path: FilePath, reference: Reference) -> None:
    """Writes a reference to an OpenEXR file from which :func:`load_reference` reads the same bits.

    Args:
        path: The file, named ``*.exr``; its folder must exist.
        reference: The reference, in float32.

    Raises:
        ValueError: If the name does not end in ``.exr``, or the images are not float32, finite and non-negative.
        OSError: If the file cannot be written.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "reference.exr"
        >>> save_reference(path, Reference(torch.ones(2, 3, 4, 6), torch.zeros(2, 3, 4, 6), count=64))
        >>> load_reference(path).count
        64
    """
    for image in REFERENCE:
        require_finite(f"reference.{image.field}", getattr(reference, image.field), minimum=0)
    attributes = {
        "kind": "reference",
        "camera": camera_to_json(reference.camera),
        "count": reference.count,
        "seed": reference.seed,
    }
    write_exr(path, {image: getattr(reference, image.field) for image in REFERENCE}, attributes)


def load_reference(path: FilePath) -> Reference:
    """Reads a reference that :func:`save_reference` wrote.

    Args:
        path: The file.

    Returns:
        The reference.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a whole OpenEXR file or holds something else.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "reference.exr"
        >>> save_reference(path, Reference(torch.ones(1, 3, 2, 2), torch.zeros(1, 3, 2, 2), count=9, seed=5))
        >>> load_reference(path).seed
        5
    """
    file = read_exr(path)
    kind = file.attributes.get("kind")
    found = f"a {kind}" if kind else "another program's image"
    require(kind == "reference", str(path), found, "a reference written by fovden.io.save_reference")
    images = {image.field: file.image(image) for image in REFERENCE}
    for name, values in images.items():
        require_finite(f"{path}: {name}", values, minimum=0)
    camera = camera_from_json(file.attributes["camera"])
    return Reference(**images, count=file.attributes["count"], camera=camera, seed=file.attributes["seed"])


def save_image(path: FilePath, radiance: Tensor) -> None:
    """Writes linear radiance, for example a denoised image, to an OpenEXR file.

    Args:
        path: The file, named ``*.exr``; its folder must exist.
        radiance: Linear radiance, float32, finite; negative values are kept. Shape (v, 3, h, w).

    Raises:
        ValueError: If the name does not end in ``.exr``, or the image is not float32 and finite.
        OSError: If the file cannot be written.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "image.exr"
        >>> save_image(path, torch.full((2, 3, 4, 6), 7e4))
        >>> load_image(path).max()
        tensor(70000.)
    """
    require_shapes("v 3 h w", radiance=radiance)
    require_finite("radiance", radiance)
    write_exr(path, {BEAUTY: radiance}, {"kind": "image"})


def load_image(path: FilePath) -> Tensor:
    """Reads the beauty image ``R G B`` of any OpenEXR file: an image, a frame, a reference, another program's.

    Args:
        path: The file.

    Returns:
        Linear radiance, float32, as it is in the file, shape (v, 3, h, w).

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a whole OpenEXR file or has no such image in every view.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "reference.exr"
        >>> save_reference(path, Reference(torch.ones(2, 3, 4, 6), torch.zeros(2, 3, 4, 6), count=64))
        >>> load_image(path).shape
        torch.Size([2, 3, 4, 6])
    """
    file = read_exr(path)
    image = find_image(file, "radiance")
    if image is None:
        raise ValueError(f"{file.path}: expected the channels R, G, B, got {', '.join(sorted(file.channels))}")
    return image


def save_png(
    path: FilePath, image: Tensor, *, layout: PngLayout = "side-by-side", exposure: float | None = None
) -> None:
    """Writes display-encoded views as an 8-bit PNG that says that it is sRGB, and which exposure it was made with.

    The values are stored as they are, ``floor(255 x + 1/2)``: linear radiance must go through an exposure and the
    sRGB curve first (:func:`fovden.color.display`); stored directly it would look too dark, and above 1 it is refused.
    The file has the chunks of :func:`fovden.preview.png_info`.

    Args:
        path: The file, named ``*.png``; its folder must exist.
        image: Display-encoded colour in [0, 1], shape (v, 3, h, w).
        layout: ``"side-by-side"``: all views, the left eye on the left; ``"cross-eyed"``: the right eye's image on the
            left, to be fused by crossing the eyes; ``"left"`` or ``"right"``: that eye alone. All but the first ask
            for two views.
        exposure: Scale from radiance to the display that ``image`` was made with, above 0, to be stated in the file;
            ``None`` states none.

    Raises:
        ValueError: If the name does not end in ``.png``, a value is outside [0, 1], or the views do not fit the layout.
        OSError: If the file cannot be written.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "picture.png"
        >>> save_png(path, torch.full((2, 3, 4, 6), 0.5), layout="cross-eyed", exposure=1.25)
        >>> b"Exposure" in path.read_bytes()
        True
    """
    path = Path(path)
    require(path.suffix.lower() == ".png", "path", path, "a name that ends in .png")
    views = require_shapes("v 3 h w", image=image)["v"]
    require(image.numel() > 0, "image", tuple(image.shape), "at least one pixel")
    require_finite("image", image, minimum=0)
    brightest = float(image.max())
    require(brightest <= 1, "image", brightest, "display-encoded values of at most 1 (see fovden.color.display)")
    require(layout in get_args(PngLayout), "layout", repr(layout), f"one of {get_args(PngLayout)}")
    if layout != "side-by-side":
        require(views == 2, "image", f"{views} views", f"two views for the layout {layout!r}")
    shown = {"cross-eyed": [1, 0], "left": [0], "right": [1]}.get(layout, list(range(views)))
    data = encode_png(to_levels(torch.stack([image[view] for view in shown])), exposure=exposure)
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)
