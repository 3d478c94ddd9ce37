"""The gathering of gradients, one pixel after the other: the twins of :mod:`fovden.filters.kernels.gather_lanes`."""

from __future__ import annotations

from typing import Any

from fovden.filters.kernels.blend import LOG2_E, MASK
from fovden.filters.kernels.lanes import WIDTH, ZERO, exp2_plain
from fovden.filters.kernels.pairs import line_of_plain
from fovden.filters.kernels.shares import MOVED, Read
from fovden.jit import Int, inlined
from fovden.simd import stack_floats


@inlined
def squares_plain(read: Read, a: Int, b: Int, squares: Any) -> None:
    """Writes the squared differences of the three features of two pixels."""
    for g in range(3):
        feature = (read.image, read.normal, read.position)[g]
        squares[g] = ZERO
        for k in range(3):
            d = feature[a + k * read.plane] - feature[b + k * read.plane]
            squares[g] += d * d


@inlined
def pull_plain(read: Read, a: Int, b: Int) -> Any:
    """G(a) . c(b) - h(a)."""
    total = read.light[a + 3 * read.plane]
    for k in range(3):
        total += read.light[a + k * read.plane] * read.image[b + k * read.plane]
    return total


@inlined
def add_plain(read: Read, a: Int, b: Int, power: Any, changes: Any, everything: bool, sums: Any, lane: Int) -> None:
    """Adds what a tap hands back of radiance and guides, and of the mask."""
    for k in range(3):
        sums[(MOVED + k) * WIDTH + lane] += power * read.light[b + k * read.plane]
    for g in range(3 if everything else 1):
        feature = (read.image, read.normal, read.position)[g]
        for k in range(3):
            place = (3 * g + k) * WIDTH + lane
            sums[place] += changes[g] * (feature[a + k * read.plane] - feature[b + k * read.plane])
    if everything:
        sums[MASK * WIDTH + lane] += power * pull_plain(read, b, a)


@inlined
def gather_plain(
    read: Read, everything: bool, at: Int, tap: Int, step: Int, inverse: Any, taps: Any, sums: Any, widths: Any,
    kept: Any, apart: Int, count: Int,
) -> None:  # fmt: skip
    """Adds what a row of five taps hands back to a block's sums, or the two to the right, one pixel after the other.

    ``widths`` receive T e, of both pixels of a pair; ``kept`` receives the powers and T, ``apart`` from each other.
    """
    squares, changes = stack_floats(3), stack_floats(3)
    for number in range(count):
        i = number + (-2 if count == 5 else 1)
        for lane in range(WIDTH):
            a, b, q = at + lane, tap + lane + i * step, taps[2 + i]
            squares_plain(read, a, b, squares)
            for g in range(3):
                q += squares[g] * (-LOG2_E * inverse[g])
            power = exp2_plain(q)
            back = power * read.weight[a] * pull_plain(read, b, a)
            both = power * read.weight[b] * pull_plain(read, a, b) + back
            kept[number * apart + lane], kept[(count + number) * apart + lane] = power, both
            for g in range(3):
                changes[g] = both
                widths[g * WIDTH + lane] += both * squares[g]
            add_plain(read, a, b, power, changes, everything, sums, lane)


@inlined
def gather_kept_plain(
    read: Read, everything: bool, at: Int, tap: Int, step: Int, sums: Any, kept: Any, apart: Int, count: Int
) -> None:
    """The same for a row of five taps, or the two to the left, that have kept what the pairs have in common."""
    changes = stack_floats(3)
    for number in range(count):
        i = number - 2
        line = line_of_plain(i, count == 2)
        for lane in range(WIDTH):
            a, b, place = at + lane, tap + lane + i * step, line * apart + i * step + lane
            power, both = kept[place], kept[place + count * apart]
            for g in range(3):
                changes[g] = both
            add_plain(read, a, b, power, changes, everything, sums, lane)


@inlined
def gather_own_plain(read: Read, at: Int, taps: Any, sums: Any) -> None:
    """The same for the tap that a pixel is itself."""
    nothing = stack_floats(3)
    for g in range(3):
        nothing[g] = ZERO
    for lane in range(WIDTH):
        add_plain(read, at + lane, at + lane, exp2_plain(taps[2]), nothing, True, sums, lane)


@inlined
def gather_differing_plain(
    read: Read, at: Int, tap: Int, step: Int, taps: Any, back: Any, sums: Any, widths: Any, tap_sums: Any
) -> None:
    """The same for a row of five taps where pixels have scales of their own, or the kernel is not symmetric.

    ``widths`` receive what is the pixel's own, and ``tap_sums`` the sums of weight times its gradient.
    """
    squares, changes, plane = stack_floats(3), stack_floats(3), read.plane
    for i in range(5):
        for lane in range(WIDTH):
            a, b = at + lane, tap + lane + (i - 2) * step
            squares_plain(read, a, b, squares)
            q, q_back = taps[i], back[4 - i]
            for g in range(3):
                q += squares[g] * read.scales[a + g * plane]
                q_back += squares[g] * read.scales[b + g * plane]
            power_back = exp2_plain(q_back)
            pulled = exp2_plain(q) * read.weight[b] * pull_plain(read, a, b)
            pushed = power_back * read.weight[a] * pull_plain(read, b, a)
            for g in range(3):
                changes[g] = read.scales[a + g * plane] * pulled + read.scales[b + g * plane] * pushed
                widths[g * WIDTH + lane] += pulled * squares[g]
            add_plain(read, a, b, power_back, changes, True, sums, lane)
            tap_sums[i * WIDTH + lane] += pulled
