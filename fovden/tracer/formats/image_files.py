"""What images of scene files say besides a colour: opacity, and factors to roughness and metallic."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from fovden.tracer.formats.scene_file import SceneFileError, read_image, texture_of

__all__ = ["ImageFiles", "alpha_of", "cut_of", "factors_of", "grey_of", "visible"]


def alpha_of(image: Image.Image) -> Tensor:
    """Returns an image's opacity, uint8, shape (h, w): its alpha channel, 255 without one.

    Example:
        >>> alpha_of(Image.new("RGBA", (2, 1), (1, 2, 3, 4))), alpha_of(Image.new("RGB", (1, 1)))
        (tensor([[4, 4]], dtype=torch.uint8), tensor([[255]], dtype=torch.uint8))
    """
    if "transparency" in image.info:
        image = image.convert("RGBA")
    if "A" not in image.getbands():
        return torch.full((image.height, image.width), 255, dtype=torch.uint8)
    return torch.from_numpy(np.array(image.getchannel("A")))


def grey_of(image: Image.Image) -> Tensor:
    """Returns an image's luma, uint8, shape (h, w): the mean of its channels, 0.299, 0.587 and 0.114 of each.

    Example:
        >>> grey_of(Image.new("RGB", (1, 1), (255, 0, 0)))
        tensor([[76]], dtype=torch.uint8)
    """
    return torch.from_numpy(np.array(Image.fromarray(texture_of(image).numpy()).convert("L")))


def cut_of(image: Image.Image) -> Tensor:
    """Returns the opacity that ``map_d`` means, uint8, shape (h, w): alpha where there is some, otherwise luma.

    Wavefront's specification says luma (``-imfchan l``); but files name images with alpha there, the picture itself.

    Example:
        >>> cut_of(Image.new("L", (1, 1), 7)), cut_of(Image.new("LA", (1, 1), (7, 9)))
        (tensor([[7]], dtype=torch.uint8), tensor([[9]], dtype=torch.uint8))
    """
    alpha = alpha_of(image)
    return alpha if bool((alpha < 255).any()) else grey_of(image)


def factors_of(image: Image.Image) -> Tensor:
    """Returns glTF's factors to roughness (green) and metallic (blue), uint8, shape (h, w, 2).

    Example:
        >>> factors_of(Image.new("RGB", (1, 1), (1, 2, 3)))
        tensor([[[2, 3]]], dtype=torch.uint8)
    """
    return texture_of(image)[..., 1:].contiguous()


def visible(opacity: Tensor, cutoff: float, factor: float = 1.0) -> tuple[Tensor | None, float]:
    """Returns an opacity image and its cutoff such that ``factor * opacity < cutoff`` are the holes.

    Args:
        opacity: Image, uint8, shape (h, w).
        cutoff: Opacity below which there is a hole.
        factor: Of the image, in [0, 1].

    Returns:
        The image, ``None`` where nothing is cut out, and the cutoff of the image by itself.

    Example:
        >>> visible(torch.tensor([[200]], dtype=torch.uint8), 0.5), visible(torch.zeros(1, 1, dtype=torch.uint8), 0.5)
        ((None, 0.5), (tensor([[0]], dtype=torch.uint8), 0.5))
    """
    if float(opacity.min()) / 255 * factor >= cutoff:
        return None, cutoff
    if float(opacity.max()) / 255 * factor < cutoff:
        return torch.zeros(1, 1, dtype=torch.uint8), max(cutoff, 0.5)  # a hole everywhere
    return opacity, cutoff / factor


class ImageFiles:
    """Image files, each decoded once for each thing that it says: the same question gives the same tensor.

    Example:
        >>> import tempfile
        >>> files, path = ImageFiles(), Path(tempfile.mkdtemp()) / "grey.png"
        >>> Image.new("L", (2, 1), 7).save(path)
        >>> files.read(path, grey_of) is files.read(path, grey_of)
        True
    """

    def __init__(self) -> None:
        self._known: dict[Any, Tensor] = {}

    def read(self, path: Path, convert: Callable[[Any], Tensor]) -> Tensor:
        """Returns what an image says.

        Args:
            path: The file.
            convert: Makes a tensor of the image, which Pillow has opened.

        Returns:
            The tensor.

        Raises:
            FileNotFoundError: If there is no such file.
            SceneFileError: If it cannot be decoded.

        Example:
            >>> ImageFiles().read(Path("lost.png"), grey_of)
            Traceback (most recent call last):
            ...
            FileNotFoundError: [Errno 2] No such file or directory: 'lost.png'
        """
        key = (path, convert)
        if key not in self._known:
            self._known[key] = read_image(path, convert)
        return self._known[key]

    def pair(self, first: Path | None, second: Path | None) -> Tensor:
        """Returns the luma of two images of one size side by side, uint8, shape (h, w, 2); 255 for one that is not.

        Raises:
            SceneFileError: If their sizes differ, or one cannot be decoded.

        Example:
            >>> import tempfile
            >>> path = Path(tempfile.mkdtemp()) / "grey.png"
            >>> Image.new("L", (1, 1), 7).save(path)
            >>> ImageFiles().pair(path, None)
            tensor([[[  7, 255]]], dtype=torch.uint8)
        """
        key = (first, second)
        if key not in self._known:
            found = [self.read(path, grey_of) for path in key if path is not None]
            sizes = [tuple(image.shape) for image in found]
            if len(set(sizes)) > 1:
                raise SceneFileError(f"{second}: expected an image of {sizes[0]} texels as {first} is, got {sizes[1]}")
            full = torch.full_like(found[0], 255)
            self._known[key] = torch.stack([full if path is None else self.read(path, grey_of) for path in key], -1)
        return self._known[key]
