"""Random numbers for a path, four at a time, from one of the samplers."""

from __future__ import annotations

from fovden.jit import Float, Int, inlined
from fovden.rng import philox
from fovden.tracer.kernels.sobol import sobol

INDEPENDENT, SOBOL = 0, 1


@inlined
def draw(
    sampler: Int, seed: Int, stream: Int, pixel: Int, view: Int, sample: Int, block: Int
) -> tuple[Float, Float, Float, Float]:
    """Returns the numbers of dimensions 4 block .. 4 block + 3 of a sample."""
    if sampler == SOBOL:
        return sobol(seed, stream, pixel, view, sample, block)
    return philox(seed, stream, pixel, view, sample, block)
