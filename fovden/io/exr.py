"""OpenEXR files as channels by name, and the checks that keep damaged ones out.

Only OpenEXR's own library touches these files: general image libraries have been seen to return wrong arrays for them
without complaint.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
import torch
from torch import Tensor

from fovden.checks import require
from fovden.io.exr_layout import require_whole
from fovden.io.files import FilePath, atomic_write

__all__ = ["BEAUTY", "Exr", "ImageChannels", "load_exr", "read_exr", "write_exr"]

ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "frame": ("camera", "gaze", "jitter", "index", "seed", "warp"),
    "reference": ("camera", "count", "seed"),
}


class ImageChannels(NamedTuple):
    """An image of a record and the channels that hold it.

    Attributes:
        field: Name of the record's field.
        layer: Name of the layer; empty for the beauty image.
        letters: The last part of each channel's name.
    """

    field: str
    layer: str
    letters: str


BEAUTY = ImageChannels("radiance", "", "RGB")
"""The image that viewers show."""


def load_exr(path: FilePath) -> dict[str, Tensor]:
    """Reads every channel of an OpenEXR file by name, as it is.

    Only OpenEXR's own library reads these files here: general image libraries have been seen to return wrong arrays
    for them without complaint.

    Args:
        path: The file.

    Returns:
        Float32 channels, shape (h, w) each; unsigned integer channels as int32 with the same bits. In a file of
        several parts a name that occurs twice is preceded by the part's view or name.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a whole OpenEXR file.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "image.exr"
        >>> write_exr(path, {BEAUTY: torch.ones(1, 3, 2, 2)}, {})
        >>> sorted(load_exr(path))
        ['B', 'G', 'R']
    """
    return read_exr(path).channels


class Exr(NamedTuple):
    """The contents of a file.

    Attributes:
        path: The file, for messages.
        channels: Float32 or int32 channels by name, shape (h, w) each.
        views: Names of the views, the default one first.
        attributes: The attributes of this library, without their prefix.
    """

    path: Path
    channels: dict[str, Tensor]
    views: tuple[str, ...]
    attributes: dict[str, Any]

    def image(self, image: ImageChannels) -> Tensor:
        """Returns an image that this library wrote, all of whose channels must be there, shape (v, c, h, w).

        Example:
            >>> file = Exr(Path("box.exr"), {"Z": torch.ones(2, 3)}, ("view0",), {})
            >>> file.image(ImageChannels("depth", "", "Z")).shape
            torch.Size([1, 1, 2, 3])
        """
        rows = [[_name(image.layer, view, letter) for letter in image.letters] for view in ("", *self.views[1:])]
        missing = [name for row in rows for name in row if name not in self.channels]
        require(not missing, str(self.path), f"a file without {', '.join(missing)}", f"the channels of {image.field}")
        return torch.stack([torch.stack([self.channels[name] for name in row]) for row in rows])


def _name(layer: str, view: str, letter: str) -> str:
    return ".".join(part for part in (layer, view, letter) if part)


def _view_names(count: int) -> tuple[str, ...]:
    return ("left", "right") if count == 2 else tuple(f"view{view}" for view in range(count))


def write_exr(path: FilePath, tensors: Mapping[ImageChannels, Tensor], attributes: Mapping[str, Any]) -> None:
    """Writes images of shape (v, c, h, w), float32 or int32, as one multi-view part.

    Args:
        path: The file, named ``*.exr``.
        tensors: The images, all of one size.
        attributes: What JSON can hold; their names get the prefix ``fovden_``.

    Raises:
        ValueError: If the name or a type is wrong.
        OSError: If the file cannot be written.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "image.exr"
        >>> write_exr(path, {BEAUTY: torch.ones(1, 3, 2, 2)}, {"kind": "image"})
        >>> read_exr(path).attributes
        {'kind': 'image'}
    """
    path = Path(path)
    require(path.suffix.lower() == ".exr", "path", path, "a name that ends in .exr")
    channels: dict[str, Any] = {}
    views = _view_names(next(iter(tensors.values())).shape[0])
    for image, tensor in tensors.items():
        require(tensor.dtype in (torch.float32, torch.int32), image.field, tensor.dtype, "torch.float32")
        planes = tensor.detach().cpu().contiguous().numpy()
        for view, name in enumerate(("", *views[1:])):
            for channel, letter in enumerate(image.letters):
                plane = planes[view, channel]
                channels[_name(image.layer, name, letter)] = plane.view(np.uint32) if plane.dtype == np.int32 else plane
    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if len(views) > 1:
        header["multiView"] = list(views)
    header |= {f"fovden_{name}": json.dumps(value) for name, value in attributes.items()}
    with atomic_write(path) as temporary:
        try:
            with OpenEXR.File(header, channels) as file:
                file.write(str(temporary))
        except RuntimeError as error:
            raise OSError(f"{path}: cannot be written ({error})") from error


def read_exr(path: FilePath) -> Exr:
    """Reads a file of one part or several, half floats widened.

    Args:
        path: The file.

    Returns:
        The contents.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a whole OpenEXR file, has subsampled channels, or parts of several sizes.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "image.exr"
        >>> write_exr(path, {BEAUTY: torch.ones(2, 3, 2, 2)}, {"kind": "image"})
        >>> read_exr(path).views
        ('left', 'right')
    """
    path = Path(path)
    require_whole(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            parts = [(dict(part.header), dict(part.channels)) for part in file.parts]
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise ValueError(f"{path}: damaged, OpenEXR cannot read it ({error})") from error
    require(len(parts) > 0, str(path), "damaged pixels", "a readable OpenEXR file")
    header = parts[0][0]
    views = tuple(header.get("multiView", ()))
    if not views:  # one part per view
        views = tuple(dict.fromkeys(part["view"] for part, _ in parts if "view" in part)) or ("view0",)
    channels: dict[str, Tensor] = {}
    for part, images in parts:
        view = part.get("view", "")
        for name, channel in images.items():
            *layer, letter = name.split(".")
            if view in views[1:] and view not in layer:
                layer.append(view)
            elif name in channels:
                layer.insert(0, part.get("name", "part"))
            channels[".".join((*layer, letter))] = _pixels(f"{path}: channel {name}", channel)
    sizes = {tuple(channel.shape) for channel in channels.values()}
    require(len(sizes) == 1, str(path), f"images of the sizes {sorted(sizes)}", "images of one size")
    return Exr(path, channels, views, _attributes(path, header))


def _pixels(name: str, channel: Any) -> Tensor:
    subsampled = (channel.xSampling, channel.ySampling) != (1, 1)
    require(not subsampled, name, "a subsampled one", "one value per pixel")
    pixels = np.ascontiguousarray(channel.pixels)
    return torch.from_numpy(pixels.view(np.int32) if pixels.dtype == np.uint32 else pixels.astype(np.float32))


def _attributes(path: Path, header: Mapping[str, Any]) -> dict[str, Any]:
    prefix = "fovden_"
    attributes: dict[str, Any] = {}
    for name, value in header.items():
        if name.startswith(prefix):
            try:
                attributes[name.removeprefix(prefix)] = json.loads(value)
            except (TypeError, ValueError):
                raise ValueError(f"{path}: attribute {name}: expected JSON, got {value!r}") from None
    kind: str | None = attributes.get("kind")
    if kind is not None and kind in ATTRIBUTES:
        missing = [prefix + name for name in ATTRIBUTES[kind] if name not in attributes]
        require(not missing, str(path), f"a file without {', '.join(missing)}", f"the attributes of a {kind}")
    return attributes
