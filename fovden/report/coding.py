"""The format in which a report holds its images.

Radiance is rounded on a scale that is linear around 0 and logarithmic beyond, so that the page can show it at any
exposure. With the knee x0 and S steps a stop, a value x becomes the 16-bit integer

    code = sign(x) round(S log2(1 + |x| / x0)),

and comes back as x' = sign(code) x0 (2^(|code| / S) - 1), with |x' - x| <= (2^(1 / 2S) - 1) (|x| + x0), which is
0.87 % of |x| + x0 for the usual 40 steps. NaN is -32768; infinities become the largest codes. The knee is 1/256 divided
by the exposure: at that exposure, and up to two stops above it, the rounding stays below one level of an 8-bit display.

Many pixels of one image are those of another: noise at the samples that both took, a denoiser's inner layers. An image
can therefore be like an earlier one. A map of ones and zeros then says which pixels have the earlier one's codes, and
only the others are stored.

The codes are stored as green, red - green and blue - green, modulo 2^16, each in the order view, row, column. A first
byte says whether they are plain (0) or differences from a prediction (1): a + b - c, limited to what lies between a
and b, with the neighbours left (a), above (b), and left above (c), which are 0 outside (the predictor of LOCO-I:
Weinberger, Seroussi, Sapiro 1996). Noise is smaller plain, everything else as differences. Sign and magnitude are
folded into unsigned integers (0, -1, 1, -2, ... become 0, 1, 2, 3, ...), all their low bytes stand before all their
high bytes, and the whole is deflated (zlib). Maps of one byte a pixel have the first byte, then the values or
differences modulo 2^8, deflated.

The page is text in UTF-16, and two of these bytes, the lower one first, are one of its characters. In front stands how
many zeros, 0 or 1, were added to make their number even. What a page cannot hold (0, a carriage return, "<", and
D800 to DFFF, which are halves of characters) or what stands for that (E000) becomes two characters: E000, then the
forbidden one with its highest bit turned over. That is 3 % more than the bytes; the customary base 64 is a third more.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from fovden.checks import require, require_integer, require_number, require_shapes

__all__ = [
    "COARSER_STEPS",
    "KNEE",
    "NAN_CODE",
    "STEPS",
    "encode_image",
    "encode_map",
    "encode_text",
    "image_codes",
    "most_alike",
]

STEPS = 40
"""Steps per stop. Ours: the coarsest with which the rounding, 0.87 %, is below one level of an 8-bit display."""

COARSER_STEPS = (28, 20)
"""What a page falls back on that would be too large: 1.25 % and 1.75 %."""

KNEE = 1 / 256
"""The knee of the scale in units of the display's white at the exposure."""

NAN_CODE = -32768
"""The code of what is not a number."""

LARGEST_CODE = 32767  # of infinities: the largest float32 has less than half of it
ESCAPE, HIGHEST_BIT = 0xE000, 0x8000
WORTHWHILE = 1 / 8
"""Share of equal pixels from which on they are copied: to say which takes up to a bit a pixel, a pixel itself 14 to 23
(denoised and noisy images of the forest)."""


def image_codes(radiance: Tensor, knee: float, steps: int = STEPS) -> NDArray[np.int16]:
    """Returns the code of every value.

    Args:
        radiance: Linear radiance, shape (v, 3, h, w); any floats, also negative, infinite or not a number.
        knee: Where the scale turns from linear to logarithmic, above 0, in the unit of ``radiance``.
        steps: Steps per stop, from 1 to 100.

    Returns:
        Codes, the same shape; see the module's docstring.

    Raises:
        ShapeError: If ``radiance`` has another shape.
        ValueError: If ``knee`` or ``steps`` is out of range.

    Example:
        >>> import torch
        >>> image_codes(torch.tensor([0.0, 1.0, float("nan")]).reshape(1, 3, 1, 1), knee=1.0).ravel().tolist()
        [0, 40, -32768]
    """
    require_shapes("v 3 h w", radiance=radiance)
    require_number("knee", knee, above=0)
    require_integer("steps", steps, minimum=1, maximum=100)
    values = radiance.detach().cpu().double().numpy()
    magnitude = np.minimum(np.rint(steps * np.log2(1 + np.abs(values) / knee)), LARGEST_CODE)
    codes = np.where(np.isnan(values), NAN_CODE, np.copysign(magnitude, values))
    return codes.astype(np.int16)


def most_alike(codes: NDArray[np.int16], earlier: Sequence[NDArray[np.int16]]) -> tuple[int, NDArray[np.bool_]] | None:
    """Returns which earlier image an image has most pixels in common with, and which these are.

    Args:
        codes: Its codes, shape (v, 3, h, w).
        earlier: Codes of other images, the same shape.

    Returns:
        The index of the earlier image and a mask of the pixels that are equal, shape (v, 1, h, w); or ``None`` if no
        image shares one pixel in eight.

    Example:
        >>> import torch
        >>> dark, light = (image_codes(torch.full((1, 3, 4, 4), value), knee=1.0) for value in (0.2, 0.7))
        >>> index, equal = most_alike(light, [dark, light])
        >>> index, equal.all().item()
        (1, True)
        >>> most_alike(light, [dark]) is None
        True
    """
    masks = [(codes == other).all(1, keepdims=True) for other in earlier]
    shares = [mask.mean() for mask in masks]
    if not masks or max(shares) < WORTHWHILE:
        return None
    index = int(np.argmax(shares))
    return index, masks[index]


def encode_image(codes: NDArray[np.int16], copied: NDArray[np.bool_] | None = None) -> bytes:
    """Returns an image in the report's format.

    Args:
        codes: Codes of :func:`image_codes`, shape (v, 3, h, w).
        copied: Pixels to leave out, as an earlier image has them, shape (v, 1, h, w); ``None`` for none.

    Returns:
        The deflated bytes; see the module's docstring.

    Raises:
        ValueError: If a shape differs.

    Example:
        >>> import torch
        >>> codes = image_codes(torch.zeros(2, 3, 4, 6), knee=1.0)
        >>> len(zlib.decompress(encode_image(codes))) == 1 + 2 * 2 * 3 * 4 * 6
        True
    """
    require(codes.ndim == 4 and codes.shape[1] == 3, "codes", codes.shape, "shape (v, 3, h, w)")
    stored = np.ones_like(codes[:, 0], bool)
    if copied is not None:
        wanted = (len(codes), 1, *codes.shape[2:])
        require(copied.shape == wanted, "copied", copied.shape, f"shape {wanted}")
        stored = ~copied[:, 0]
    red, green, blue = codes.transpose(1, 0, 2, 3)
    channels = np.stack([green, red - green, blue - green])
    candidates = []
    for predictor, residual in enumerate((channels, _differences(channels))):
        kept = residual[:, stored]
        folded = ((kept << 1) ^ (kept >> 15)).view(np.uint16)
        planes = (folded & 0xFF).astype(np.uint8), (folded >> 8).astype(np.uint8)
        bits = sum(_entropy(channel) for plane in planes for channel in plane)
        candidates.append((bits, predictor, b"".join(plane.tobytes() for plane in planes)))
    _, predictor, data = min(candidates)
    return _deflate(predictor, data)


def encode_map(values: Tensor, scale: float = 1.0) -> bytes:
    """Returns a map of one byte a pixel in the report's format.

    Args:
        values: Any map, shape (v, 1, h, w).
        scale: Factor before rounding; what is then outside 0 to 255 is clamped, NaN becomes 0.

    Returns:
        The deflated bytes; see the module's docstring.

    Raises:
        ShapeError: If ``values`` has another shape.

    Example:
        >>> import torch
        >>> list(zlib.decompress(encode_map(torch.tensor([0.0, 0.5, 2.0]).reshape(1, 1, 1, 3), scale=254.0)))
        [0, 0, 127, 255]
    """
    require_shapes("v 1 h w", values=values)
    scaled = np.nan_to_num(values.detach().cpu().double().numpy() * scale)
    levels = np.rint(scaled.clip(0, 255)).astype(np.uint8)
    candidates = [
        (_entropy(plane), predictor, plane.tobytes()) for predictor, plane in enumerate((levels, _differences(levels)))
    ]
    _, predictor, data = min(candidates)
    return _deflate(predictor, data)


def encode_text(data: bytes) -> str:
    r"""Returns bytes as text that may stand in a script element of a page in UTF-16: a character for two bytes.

    Args:
        data: Any bytes.

    Returns:
        Characters below U+10000 without ``<``; see the module's docstring.

    Example:
        >>> encode_text(b"A\0B\0\xff")
        '1ABÿ'
    """
    missing = len(data) % 2
    units = np.frombuffer(data + bytes(missing), "<u2")
    forbidden = (units == 0) | (units == ord("\r")) | (units == ord("<")) | ((units >= 0xD800) & (units <= ESCAPE))
    written = np.repeat(units, 1 + forbidden)
    second = np.flatnonzero(forbidden) + np.arange(1, 1 + np.count_nonzero(forbidden))
    written[second - 1] = ESCAPE
    written[second] ^= HIGHEST_BIT
    return str(missing) + written.astype("<u2").tobytes().decode("utf-16-le")


def _differences(values: NDArray[Any]) -> NDArray[Any]:
    """Each value minus its prediction, modulo the range of the type."""
    padded = np.pad(values.astype(np.int32), [(0, 0)] * (values.ndim - 2) + [(1, 0), (1, 0)])
    left, above, corner = padded[..., 1:, :-1], padded[..., :-1, 1:], padded[..., :-1, :-1]
    prediction = (left + above - corner).clip(np.minimum(left, above), np.maximum(left, above))
    differences: NDArray[Any] = values - prediction.astype(values.dtype)
    return differences


def _entropy(plane: NDArray[np.uint8]) -> float:
    """Bits per value that a code without memory needs: which predictor is better, without deflating twice."""
    share = np.bincount(plane.ravel(), minlength=256) / max(plane.size, 1)
    share = share[share > 0]
    return float(-(share * np.log2(share)).sum())


def _deflate(predictor: int, data: bytes) -> bytes:
    """Little repeats itself in noise: the strategy for filtered data is as small as the slow search, and quicker."""
    deflater = zlib.compressobj(6, zlib.DEFLATED, 15, 8, zlib.Z_FILTERED)
    return deflater.compress(bytes([predictor]) + data) + deflater.flush()
