"""The peak of a processor's multiplications and additions: what a kernel's arithmetic is measured against."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fovden.jit import kernel
from fovden.simd import I32, Lanes, fused, splat

CHAINS, WIDTH = 12, 16
"""Sums that do not wait for each other, of sixteen numbers each: enough to keep every unit of the processor busy."""


@intrinsic
def _multiply_add(context: Any, count: Any, number: Any) -> Any:
    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        factor = splat(builder, arguments[1], WIDTH)
        sums = [cgutils.alloca_once_value(builder, factor.value) for _ in range(CHAINS)]
        with cgutils.for_range(builder, arguments[0]):
            for place in sums:
                builder.store(fused(Lanes(builder, builder.load(place)), factor, factor).value, place)
        total = builder.load(sums[0])
        for place in sums[1:]:
            total = builder.fadd(total, builder.load(place))
        return builder.extract_element(total, ir.Constant(I32, 0))

    return types.float32(types.int64, types.float32), generate


@kernel
def multiply_add(count: int, number: float) -> float:
    """Runs ``count`` rounds of all chains."""
    total: float = _multiply_add(count, number)
    return total


def peak(threads: int, rounds: int = 3, count: int = 5_000_000) -> float:
    """Returns the most operations per second that some threads reach together, in the best of some rounds."""
    number = np.float32(0.5)
    multiply_add(1, number)
    best = 0.0
    with ThreadPoolExecutor(threads) as executor:
        for _ in range(rounds):
            began = time.perf_counter()
            list(executor.map(multiply_add, [count] * threads, [number] * threads))
            best = max(best, 2 * CHAINS * WIDTH * count * threads / (time.perf_counter() - began))
    return best
