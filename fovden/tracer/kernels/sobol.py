"""Points of Sobol's sequence, scrambled for each pixel: samples that fill the unit cube evenly at any number of them.

Four dimensions belong together in a block. Within a pixel the samples 0 .. n - 1 of a block are an Owen-scrambled
Sobol sequence in four dimensions, in an order of its own: every dimension is scrambled, and the sample numbers are
shuffled, by nested uniform permutations, which keep every stratum. Blocks, pixels, views, streams and seeds differ in
their permutations and share nothing else; so there are as many dimensions as a path asks for ("padding").

Source: B. Burley, "Practical hash-based Owen scrambling", Journal of Computer Graphics Techniques 9(4), 2020: a hash in
which a bit depends on lower bits alone, applied to reversed bits, is a nested uniform permutation (S. Laine and
T. Karras, "Stratified sampling for stochastic transparency", 2011). The hash is N. Vegdahl's, "Building a better LK
hash", 2021, which pbrt 4 and Cycles use too; with Laine and Karras's own constants bits stay correlated. The
direction numbers are those of S. Joe and F. Kuo, "Constructing Sobol sequences with better two-dimensional
projections", 2008 (new-joe-kuo-6.21201), as PyTorch's ``SobolEngine`` has them: 30 of them, for up to 2^30 samples.
"""

from __future__ import annotations

import numpy as np
import torch

from fovden.jit import Float, Int, inlined, kernel
from fovden.rng import philox_words

DIMENSIONS, BITS, NIBBLES = 4, 32, 8
_U32 = np.uint32
_UNIT = np.float32(2.0**-24)
_M0, _M1, _M2 = np.uint32(0x3D20ADEA), np.uint32(0x05526C56), np.uint32(0x53A22864)
_S1, _S2, _S4, _S8, _S16 = (np.uint32(shift) for shift in (1, 2, 4, 8, 16))
_PAIRS, _QUADS = np.uint32(0x55555555), np.uint32(0x33333333)
_HALVES, _BYTES = np.uint32(0x0F0F0F0F), np.uint32(0x00FF00FF)
_FOUR_BITS, _ONE = np.uint32(15), np.uint32(1)


def reversed_sums() -> np.ndarray:
    """Sums of direction numbers for each value of each four bits of an index, their bits reversed, (8, 16, 4) uint32.

    A point is the exclusive or of the direction numbers of its index's set bits; four at a time are looked up. The two
    highest bits of an index have none.
    """
    numbers = torch.quasirandom.SobolEngine(DIMENSIONS).sobolstate.numpy()  # type: ignore[no-untyped-call]  # (4, 30)
    table = np.zeros((NIBBLES, 16, DIMENSIONS), np.uint32)
    for dimension in range(DIMENSIONS):
        for bit in range(numbers.shape[1]):
            backwards = int(f"{int(numbers[dimension, bit]) << (BITS - numbers.shape[1]):0{BITS}b}"[::-1], 2)
            chosen = (np.arange(16) >> bit % 4) & 1 == 1
            table[bit // 4, chosen, dimension] ^= np.uint32(backwards)
    return table


_SUMS = reversed_sums().reshape(-1)


@inlined
def reversed_bits(x: Int) -> Int:
    """The 32 bits in the opposite order."""
    x = _U32(_U32(_U32(x >> _S1) & _PAIRS) | _U32(_U32(x & _PAIRS) << _S1))
    x = _U32(_U32(_U32(x >> _S2) & _QUADS) | _U32(_U32(x & _QUADS) << _S2))
    x = _U32(_U32(_U32(x >> _S4) & _HALVES) | _U32(_U32(x & _HALVES) << _S4))
    x = _U32(_U32(_U32(x >> _S8) & _BYTES) | _U32(_U32(x & _BYTES) << _S8))
    return _U32(_U32(x >> _S16) | _U32(x << _S16))


@inlined
def permuted(x: Int, seed: Int) -> Int:
    """Vegdahl's hash: a permutation in which every bit depends on lower bits alone, and on the seed."""
    x = _U32(x ^ _U32(x * _M0))
    x = _U32(x + seed)
    x = _U32(x * _U32(_U32(seed >> _S16) | _ONE))
    x = _U32(x ^ _U32(x * _M1))
    return _U32(x ^ _U32(x * _M2))


@inlined
def to_unit(x: Int) -> Float:
    """The number in [0, 1) whose binary places are the bits from the lowest on; 24 of them."""
    return np.float32(_U32(reversed_bits(x) >> _S8)) * _UNIT


@kernel
def sobol(seed: Int, stream: Int, pixel: Int, view: Int, sample: Int, block: Int) -> tuple[Float, Float, Float, Float]:
    """Returns the four numbers in [0, 1) of dimensions 4 block .. 4 block + 3; addressed like :func:`rng.philox`.

    The second and third, with which paths choose points and directions, are the sequence's first two dimensions: the
    pair whose every elementary interval holds its share of points. The permutations' seeds are four words of Philox,
    and for the order their exclusive or, which is independent of any three of them.
    """
    s0, s1, s2, s3 = philox_words(seed, stream, pixel, view, np.int64(0), block)
    order = _U32(_U32(s0 ^ s1) ^ _U32(s2 ^ s3))
    index = reversed_bits(permuted(reversed_bits(_U32(sample)), order))
    x0 = x1 = x2 = x3 = _U32(0)
    for nibble in range(NIBBLES):
        k = np.int64(DIMENSIONS) * (16 * nibble + np.int64(index & _FOUR_BITS))
        x0, x1 = _U32(x0 ^ _SUMS[k]), _U32(x1 ^ _SUMS[k + 1])
        x2, x3 = _U32(x2 ^ _SUMS[k + 2]), _U32(x3 ^ _SUMS[k + 3])
        index = _U32(index >> _S4)
    return to_unit(permuted(x2, s2)), to_unit(permuted(x0, s0)), to_unit(permuted(x1, s1)), to_unit(permuted(x3, s3))
