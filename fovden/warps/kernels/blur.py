"""Blur that grows with the distance from the gaze, and its adjoint: a blend of few Gaussians, each where it counts.

A level k of K holds the image under a Gaussian of k / K of the largest width. A pixel at place p, which rises with its
distance from 0 to K, is a blend of the levels floor(p) and floor(p) + 1, so a level counts in a ring alone. Each row
works on the part of it that lies in the ring, left and right of the gaze.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovden.jit import Float, Int, inlined, kernel
from fovden.simd import advanced, pointer_to
from fovden.warps.kernels.curves import sides_of


class Levels(NamedTuple):
    """The blend of one view.

    Attributes:
        x: Where it looks, in pixels.
        y: The same.
        start: Distance at which the place begins to rise.
        slope: By how much it does with each pixel.
        last: Number K of the last level.
        radii: Reach of each level's kernel in rows and in columns, of level 0, which is none, too: int64, (K + 1, 2).
        taps: The kernels from their middle on, float32, (K + 1, reach + 1).
        rows: One over the sum of the taps that are in the image, for each row, float32, (K + 1, h).
        columns: The same for columns, (K + 1, w).
    """

    x: float
    y: float
    start: float
    slope: float
    last: int
    radii: Any
    taps: Any
    rows: Any
    columns: Any


@inlined
def find_places(levels: Levels, y: Int, lower: Any, share: Any) -> None:
    """Finds the lower of the two levels of a row's pixels, and the share of the upper one."""
    dy = y + 0.5 - levels.y
    for x in range(len(lower)):
        dx = x + 0.5 - levels.x
        place = (np.sqrt(dx * dx + dy * dy) - levels.start) * levels.slope
        place = min(max(place, 0.0), np.float64(levels.last))
        low = min(np.int32(place), np.int32(levels.last - 1))
        lower[x] = low
        share[x] = (place * place - low * low) / (2 * low + 1)


@inlined
def ring_of(levels: Levels, level: Int, y: Int, width: Int) -> Any:
    """Where a level counts in a row: two ranges of x, not empty only where it may."""
    inner = levels.start + (level - 1) / levels.slope
    outer = levels.start + (level + 1) / levels.slope
    if level == levels.last:
        outer = abs(levels.x) + abs(levels.y) + levels.rows.shape[1] + width
    return sides_of(levels.x, y + 0.5 - levels.y, inner, outer, width)


@inlined
def weight_of(level: Int, lower: Int, share: Float) -> Float:
    """The share of a level."""
    return np.float32(1.0) - share if lower == level else (share if lower == level - 1 else np.float32(0.0))


@inlined
def blur_down(rows: Any, stride: Int, above: Int, below: Int, count: Int, taps: Any, radius: Int, blurred: Any) -> None:
    """Sums of ``count`` pixels and those above and below, of which there are so many; rows are a stride apart."""
    for x in range(count):
        blurred[x] = taps[0] * rows[x]
    for step in range(1, radius + 1):
        tap, up, down = taps[step], advanced(rows, -step * stride), advanced(rows, step * stride)
        if step <= above and step <= below:
            for x in range(count):
                blurred[x] += tap * (up[x] + down[x])
        elif step <= above or step <= below:
            other = up if step <= above else down
            for x in range(count):
                blurred[x] += tap * other[x]


@inlined
def blur_across(row: Any, count: Int, taps: Any, radius: Int, blurred: Any) -> None:
    """Sums of ``count`` pixels and those left and right, all of which can be read."""
    for x in range(count):
        blurred[x] = taps[0] * row[x]
    for step in range(1, radius + 1):
        tap, left, right = taps[step], advanced(row, -step), advanced(row, step)
        for x in range(count):
            blurred[x] += tap * (left[x] + right[x])


@inlined
def weigh_row(
    levels: Levels, level: Int, y: Int, first: Int, last: Int, lower: Any, share: Any, source: Any, weighted: Any
) -> None:
    """Weighs a row, from column first to last - 1, by its share in a level over the sums of taps."""
    lowers, shares, sources, targets = pointer_to(lower), pointer_to(share), pointer_to(source), pointer_to(weighted)
    norm, norms = levels.rows[level, y], pointer_to(levels.columns[level])
    for x in range(first, last):
        targets[x] = sources[x] * (weight_of(level, lowers[x], shares[x]) * norm * norms[x])


@inlined
def add_row(row: Any, target: Any, count: Int) -> None:
    """Adds a row to another."""
    source = pointer_to(row)
    for x in range(count):
        target[x] += source[x]


@kernel
def blur_rows(start: Int, stop: Int, levels: Levels, image: Any, blurred: Any) -> None:
    """Blurs rows start .. stop - 1 of one view, (c, h, w)."""
    channels, height, width = image.shape
    margin = levels.taps.shape[1] - 1
    lower, share = np.empty(width, np.int32), np.empty(width, np.float32)
    down, across = np.zeros(width + 2 * margin, np.float32), np.empty(width, np.float32)
    lowers, shares, downs, acrosses = pointer_to(lower), pointer_to(share), pointer_to(down), pointer_to(across)
    for y in range(start, stop):
        find_places(levels, y, lower, share)
        for channel in range(channels):
            source = advanced(pointer_to(image), (channel * height + y) * width)
            target = advanced(pointer_to(blurred), (channel * height + y) * width)
            for x in range(width):
                target[x] = source[x] * weight_of(0, lowers[x], shares[x])
            for level in range(1, levels.last + 1):
                left, middle, beyond, right = ring_of(levels, level, y, width)
                taps, (tall, wide) = pointer_to(levels.taps[level]), levels.radii[level]
                norm, norms = levels.rows[level, y], pointer_to(levels.columns[level])
                for side in range(2):
                    first, last = (left, middle) if side == 0 else (beyond, right)
                    if first < last:
                        begin, end = max(first - wide, 0), min(last + wide, width)
                        down[margin + first - wide : margin + begin] = 0.0
                        down[margin + end : margin + last + wide] = 0.0
                        blur_down(
                            advanced(source, begin), width, y, height - 1 - y, end - begin, taps, tall,
                            advanced(downs, margin + begin),
                        )  # fmt: skip
                        blur_across(advanced(downs, margin + first), last - first, taps, wide, acrosses)
                        for x in range(first, last):
                            weight = weight_of(level, lowers[x], shares[x])
                            target[x] += acrosses[x - first] * (weight * norm * norms[x])


@kernel
def return_rows(start: Int, stop: Int, levels: Levels, gradient: Any, returned: Any) -> None:
    """The adjoint of :func:`blur_rows`, for rows start .. stop - 1: rows are weighted first, and blurred then."""
    channels, height, width = gradient.shape
    margin = levels.taps.shape[1] - 1
    above, below = max(start - margin, 0), min(stop + margin, height)
    lower, share = np.empty((below - above, width), np.int32), np.empty((below - above, width), np.float32)
    weighted = np.empty((below - above, width), np.float32)
    down, across = np.zeros(width + 4 * margin, np.float32), np.empty(width, np.float32)
    for y in range(above, below):
        find_places(levels, y, lower[y - above], share[y - above])
    for channel in range(channels):
        for y in range(start, stop):
            weigh_row(levels, 0, y, 0, width, lower[y - above], share[y - above], gradient[channel, y],
                      returned[channel, y])  # fmt: skip
        for level in range(1, levels.last + 1):
            taps, (tall, wide) = pointer_to(levels.taps[level]), levels.radii[level]
            top, bottom = max(start - tall, 0), min(stop + tall, height)
            last: Int = 0
            first = width
            for y in range(top, bottom):
                left, middle, beyond, right = ring_of(levels, level, y, width)
                first = min(first, left if left < middle else (beyond if beyond < right else width))
                last = max(last, right if beyond < right else (middle if left < middle else 0))
            if first >= last:
                continue
            for y in range(top, bottom):
                row = y - above
                weigh_row(levels, level, y, first, last, lower[row], share[row], gradient[channel, y], weighted[row])
            begin, end = max(first - wide, 0), min(last + wide, width)
            down[2 * margin + first - 2 * wide : 2 * margin + first] = 0.0
            down[2 * margin + last : 2 * margin + last + 2 * wide] = 0.0
            for y in range(start, stop):
                blur_down(
                    advanced(pointer_to(weighted), (y - above) * width + first), width, y - top, bottom - 1 - y,
                    last - first, taps, tall, advanced(pointer_to(down), 2 * margin + first),
                )  # fmt: skip
                blur_across(
                    advanced(pointer_to(down), 2 * margin + begin), end - begin, taps, wide, pointer_to(across)
                )  # fmt: skip
                add_row(across, advanced(pointer_to(returned), (channel * height + y) * width + begin), end - begin)
