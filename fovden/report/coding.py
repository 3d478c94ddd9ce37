"""The format in which a report holds its images.

Radiance is rounded on a scale that is linear around 0 and logarithmic beyond, so that the page can show it at any
exposure. With the knee x0 and S steps a stop, a value x becomes the 16-bit integer

    code = sign(x) round(S log2(1 + |x| / x0)),

and comes back as x' = sign(code) x0 (2^(|code| / S) - 1), with |x' - x| <= (2^(1 / 2S) - 1) (|x| + x0), which is
0.87 % of |x| + x0 for the usual 40 steps. NaN is -32768; infinities become the largest codes. The knee is 1/256 divided
by the exposure: at that exposure, and up to two stops above it, the rounding stays below one level of an 8-bit display.

The codes are stored as green, red - green and blue - green, modulo 2^16, each in the order view, row, column. A first
byte says whether they are plain (0) or differences from a prediction (1): a + b - c, limited to what lies between a
and b, with the neighbours left (a), above (b), and left above (c), which are 0 outside (the predictor of LOCO-I:
Weinberger, Seroussi, Sapiro 1996). Noise is smaller plain, everything else as differences. Sign and magnitude are
folded into unsigned integers (0, -1, 1, -2, ... become 0, 1, 2, 3, ...), all their low bytes stand before all their
high bytes, and the whole is deflated (zlib). Maps of one byte a pixel have the first byte, then the values or
differences modulo 2^8, deflated.

In the page these bytes are text. Four of them, the first one the highest, make five digits to the base 85, highest
first: digit d is the letter number d + 35 of ASCII, and d + 36 from 25 on, so that "<" does not occur. In front stands
how many zeros were added to make the bytes a multiple of four.
"""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from fovden.checks import require_integer, require_number, require_shapes

__all__ = ["COARSER_STEPS", "KNEE", "NAN_CODE", "STEPS", "encode_image", "encode_map", "encode_text", "image_codes"]

STEPS = 40
"""Steps per stop. Ours: the coarsest with which the rounding, 0.87 %, is below one level of an 8-bit display."""

COARSER_STEPS = (28, 20)
"""What a page falls back on that would be too large: 1.25 % and 1.75 %."""

KNEE = 1 / 256
"""The knee of the scale in units of the display's white at the exposure."""

NAN_CODE = -32768
"""The code of what is not a number."""

LARGEST_CODE = 32767  # of infinities: the largest float32 has less than half of it


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


def encode_image(radiance: Tensor, knee: float, steps: int = STEPS) -> bytes:
    """Returns an image in the report's format.

    Args:
        radiance: Linear radiance, shape (v, 3, h, w); any floats, also negative, infinite or not a number.
        knee: Where the scale turns from linear to logarithmic, above 0, in the unit of ``radiance``.
        steps: Steps per stop, from 1 to 100.

    Returns:
        The deflated bytes; see the module's docstring.

    Raises:
        ShapeError: If ``radiance`` has another shape.
        ValueError: If ``knee`` or ``steps`` is out of range.

    Example:
        >>> import torch
        >>> data = zlib.decompress(encode_image(torch.zeros(2, 3, 4, 6), knee=1.0))
        >>> len(data) == 1 + 2 * 2 * 3 * 4 * 6
        True
    """
    red, green, blue = image_codes(radiance, knee, steps).transpose(1, 0, 2, 3)
    channels = np.stack([green, red - green, blue - green])
    candidates = []
    for predictor, residual in enumerate((channels, _differences(channels))):
        folded = ((residual << 1) ^ (residual >> 15)).view(np.uint16)
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
    r"""Returns bytes as text that may stand in a script element of a page: five letters for four bytes.

    Args:
        data: Any bytes.

    Returns:
        Letters of ASCII without ``<`` and blanks; see the module's docstring.

    Example:
        >>> encode_text(bytes(4)), encode_text(b"\xff")
        ('0#####', '3uu?&#')
    """
    missing = -len(data) % 4
    words = np.frombuffer(data + bytes(missing), ">u4").astype(np.uint32)
    digits = np.stack([words // 85**power % 85 for power in (4, 3, 2, 1, 0)], axis=-1).astype(np.uint8)
    return str(missing) + (digits + 35 + (digits >= 25)).astype(np.uint8).tobytes().decode("ascii")


def _differences(values: NDArray[Any]) -> NDArray[Any]:
    """Each value minus its prediction, modulo the range of the type."""
    padded = np.pad(values.astype(np.int32), [(0, 0)] * (values.ndim - 2) + [(1, 0), (1, 0)])
    left, above, corner = padded[..., 1:, :-1], padded[..., :-1, 1:], padded[..., :-1, :-1]
    prediction = (left + above - corner).clip(np.minimum(left, above), np.maximum(left, above))
    differences: NDArray[Any] = values - prediction.astype(values.dtype)
    return differences


def _entropy(plane: NDArray[np.uint8]) -> float:
    """Bits per value that a code without memory needs: which predictor is better, without deflating twice."""
    share = np.bincount(plane.ravel(), minlength=256) / plane.size
    share = share[share > 0]
    return float(-(share * np.log2(share)).sum())


def _deflate(predictor: int, data: bytes) -> bytes:
    """Little repeats itself in noise: the strategy for filtered data is as small as the slow search, and quicker."""
    deflater = zlib.compressobj(6, zlib.DEFLATED, 15, 8, zlib.Z_FILTERED)
    return deflater.compress(bytes([predictor]) + data) + deflater.flush()
