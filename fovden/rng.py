"""Random numbers as a pure function of what they are for: no state, no order, no global seed.

The generator is Philox-4x32-10 (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011,
section 3.3 and table 2), the counter-based generator of cuRAND and of PyTorch on GPUs. A number is addressed by

    key = (seed, stream),    counter = (pixel, view, sample, dimension // 4),    word = dimension % 4,

so the same bits come out for any tile size, thread count, order of work or number of processes, a reference can be
continued, and a path can be traced again. Every consumer has a :class:`Stream` of its own: the same seed never gives a
mask, a frame and its reference common numbers. Floats are the top 24 bits of a word times 2^-24, so they lie in [0, 1)
and are exact.

:func:`uniform` is the tensor form; :func:`philox` is the same function for compiled kernels. PyTorch has no unsigned
arithmetic on the CPU: the words live in int64 there, masked to 32 bits; Numba widens silently, so each step is wrapped
in ``np.uint32`` there. A test compares the two bit for bit, and both with the authors' published vectors.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import torch
from torch import Tensor

from fovden.checks import require, require_integer
from fovden.jit import Float, Int, inlined

__all__ = ["Stream", "philox", "philox_words", "uniform"]


class Stream(IntEnum):
    """Who the numbers are for: the second word of the key.

    Example:
        >>> Stream.PATH.name
        'PATH'
    """

    MASK = 1
    PATH = 2
    REFERENCE = 3
    JITTER = 4
    FILTER = 5


ROUNDS = 10
MULTIPLIER_0, MULTIPLIER_1 = 0xD2511F53, 0xCD9E8D57
WEYL_0, WEYL_1 = 0x9E3779B9, 0xBB67AE85
MASK_32 = 0xFFFFFFFF


def uniform(
    seed: int,
    stream: Stream,
    pixel: Tensor | int,
    *,
    view: Tensor | int = 0,
    sample: Tensor | int = 0,
    dimension: Tensor | int = 0,
) -> Tensor:
    """Returns uniform random numbers in [0, 1) for the given addresses.

    Args:
        seed: From 0 to 2^32 - 1.
        stream: What the numbers are for.
        pixel: Pixel number y w + x; integers of any shape, from 0 to 2^32 - 1.
        view: View number; broadcasts with ``pixel``, as do the following.
        sample: Sample number.
        dimension: Which of the sample's numbers.

    Returns:
        Float32 tensor of the broadcast shape.

    Raises:
        ValueError: If ``seed`` or an address is out of range.
        TypeError: If an address is not an integer.

    Source: Salmon et al. 2011. Cost: about 100 elementwise operations; kernels call :func:`philox` instead.

    Example:
        >>> uniform(7, Stream.MASK, torch.arange(3))
        tensor([0.3506, 0.0542, 0.9802])
    """
    require_integer("seed", seed, minimum=0, maximum=MASK_32)
    named = {"pixel": pixel, "view": view, "sample": sample, "dimension": dimension}
    words = [_address(name, value) for name, value in named.items()]
    words = list(torch.broadcast_tensors(*words))  # type: ignore[no-untyped-call]
    block = words[3] >> 2
    output = torch.stack(_philox_tensors((words[0], words[1], words[2], block), (seed, int(stream))))
    word = torch.gather(output, 0, (words[3] & 3)[None])[0]
    return (word >> 8).to(torch.float32) * 2.0**-24


def _address(name: str, value: Tensor | int) -> Tensor:
    tensor = torch.as_tensor(value)
    if tensor.is_floating_point() or tensor.dtype == torch.bool:
        raise TypeError(f"{name}: expected integers, got {tensor.dtype}")
    tensor = tensor.to(torch.int64)
    if tensor.numel() > 0:
        lowest, highest = (int(bound) for bound in torch.aminmax(tensor))
        require(lowest >= 0 and highest <= MASK_32, name, f"{lowest} to {highest}", f"integers from 0 to {MASK_32}")
    return tensor


def _philox_tensors(counter: tuple[Tensor, Tensor, Tensor, Tensor], key: tuple[int, int]) -> list[Tensor]:
    """Ten rounds on int64 tensors that hold 32-bit words."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(ROUNDS):
        high_0, low_0 = _multiply(c0, MULTIPLIER_0)
        high_1, low_1 = _multiply(c2, MULTIPLIER_1)
        c0, c1, c2, c3 = high_1 ^ c1 ^ k0, low_1, high_0 ^ c3 ^ k1, low_0
        k0, k1 = (k0 + WEYL_0) & MASK_32, (k1 + WEYL_1) & MASK_32
    return [c0, c1, c2, c3]


def _multiply(word: Tensor, multiplier: int) -> tuple[Tensor, Tensor]:
    """High and low 32 bits of a product; int64 wraps like uint64, and the shift's copied sign bits are masked off."""
    product = word * multiplier
    return (product >> 32) & MASK_32, product & MASK_32


_U32, _U64 = np.uint32, np.uint64
_M0, _M1 = np.uint64(MULTIPLIER_0), np.uint64(MULTIPLIER_1)
_W0, _W1 = np.uint32(WEYL_0), np.uint32(WEYL_1)
_SHIFT_32, _SHIFT_8 = np.uint64(32), np.uint32(8)
_UNIT = np.float32(2.0**-24)


@inlined
def philox_words(seed: Int, stream: Int, pixel: Int, view: Int, sample: Int, block: Int) -> tuple[Int, Int, Int, Int]:
    """Returns the four uint32 words from which :func:`philox` makes its numbers, with the same arguments.

    Example:
        >>> [int(word) >> 8 for word in philox_words(7, Stream.MASK, 0, 0, 0, 0)][:1]
        [5882561]
    """
    c0, c1, c2, c3 = _U32(pixel), _U32(view), _U32(sample), _U32(block)
    k0, k1 = _U32(seed), _U32(stream)
    for _ in range(ROUNDS):
        product_0 = _U64(_U64(c0) * _M0)
        product_1 = _U64(_U64(c2) * _M1)
        c0, c1, c2, c3 = (
            _U32(_U32(_U32(product_1 >> _SHIFT_32) ^ c1) ^ k0),
            _U32(product_1),
            _U32(_U32(_U32(product_0 >> _SHIFT_32) ^ c3) ^ k1),
            _U32(product_0),
        )
        k0, k1 = _U32(k0 + _W0), _U32(k1 + _W1)
    return c0, c1, c2, c3


@inlined
def philox(seed: Int, stream: Int, pixel: Int, view: Int, sample: Int, block: Int) -> tuple[Float, Float, Float, Float]:
    """Returns the four uniform float32 numbers of dimensions 4 block .. 4 block + 3; for compiled kernels.

    Args:
        seed: Seed, read modulo 2^32, as are the following.
        stream: A :class:`Stream`.
        pixel: Pixel number.
        view: View number.
        sample: Sample number.
        block: Dimension // 4.

    Returns:
        Four numbers in [0, 1).

    Source: Salmon et al. 2011.

    Example:
        >>> [round(float(x), 4) for x in philox(7, Stream.MASK, 0, 0, 0, 0)][:1]
        [0.3506]
    """
    c0, c1, c2, c3 = philox_words(seed, stream, pixel, view, sample, block)
    return (
        np.float32(_U32(c0 >> _SHIFT_8)) * _UNIT,
        np.float32(_U32(c1 >> _SHIFT_8)) * _UNIT,
        np.float32(_U32(c2 >> _SHIFT_8)) * _UNIT,
        np.float32(_U32(c3 >> _SHIFT_8)) * _UNIT,
    )
