"""How finely a scene is made, so that it has as many triangles as are asked for.

Scenes in code have one number for their fineness: at 1 a scene is what its author drew, at 2 curved things have twice
as many segments in each direction and there is four times as much of what grows. :func:`fitted` finds the fineness at
which a scene nearly has the wanted number of triangles; the last ones are spent by the scene itself on small separate
things, a leaf or a blade of grass, so that the number is met exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fovden.checks import require_integer

__all__ = ["DRAWN", "FEWEST", "MOST", "Detail", "fitted", "require_detail"]

FEWEST, MOST = 1_000, 10_000_000
"""Least and greatest number of triangles that a scene in code can be asked for."""

STEPS = 24
"""Fitting ends after as many trials at the latest; each halves the interval of the fineness once it is bracketed."""

Made = TypeVar("Made")


@dataclass(frozen=True)
class Detail:
    """The fineness of a scene.

    Attributes:
        fineness: Factor on the number of segments in one direction; 1 is the scene as drawn.

    Example:
        >>> Detail(0.5).segments(12), Detail(0.5).count(100), Detail(0.01).segments(12, least=3)
        (6, 25, 3)
    """

    fineness: float = 1.0

    def segments(self, drawn: int, least: int = 1) -> int:
        """Returns the number of segments in one direction where ``drawn`` are right for fineness 1.

        Example:
            >>> Detail(2.0).segments(7)
            14
        """
        return max(least, round(drawn * self.fineness))

    def count(self, drawn: int, least: int = 0) -> int:
        """Returns how many separate things there are where ``drawn`` are right for fineness 1.

        Example:
            >>> Detail(2.0).count(7)
            28
        """
        return max(least, round(drawn * self.fineness**2))

    def shows(self, finest: float) -> bool:
        """Returns whether something is made at all that only makes sense from a fineness on.

        Example:
            >>> Detail(0.3).shows(0.5)
            False
        """
        return self.fineness >= finest

    def at_most(self, finest: float) -> Detail:
        """Returns the same fineness, or another if that is less: for what is too small to be made ever finer.

        Example:
            >>> Detail(5.0).at_most(2.0), Detail(0.5).at_most(2.0)
            (Detail(fineness=2.0), Detail(fineness=0.5))
        """
        return Detail(min(self.fineness, finest))

    def curve(self, points: ArrayLike, least: int = 1) -> NDArray[np.float64]:
        """Returns a smooth curve's points, as many as its fineness asks for where those given are right for 1.

        The curve goes through the given points, as far apart in its parameter as one another, and keeps its ends:
        Catmull and Rom's cubics, parabolas at both ends. A straight piece, of two points, stays one.

        Args:
            points: Points of the curve, shape (n, d) or (n).
            least: Fewest segments of the result.

        Returns:
            The points, shape (m, d) or (m); those given if there are to be as many.

        Example:
            >>> Detail(2.0).curve([0.0, 1.0, 2.0, 3.0]).tolist()
            [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
            >>> Detail(0.5).curve([(0, 0), (1, 1), (2, 0)]).tolist()
            [[0.0, 0.0], [2.0, 0.0]]
        """
        given = np.asarray(points, dtype=np.float64)
        drawn = len(given) - 1
        segments = self.segments(drawn, least)
        if drawn < 2 or segments == drawn:
            return given
        time = np.linspace(0, drawn, segments + 1)
        i = np.minimum(time.astype(int), drawn - 1)
        s = (time - i).reshape(-1, *[1] * (given.ndim - 1))
        velocity = np.gradient(given, axis=0, edge_order=2)
        held: NDArray[np.float64] = (
            (1 + 2 * s) * (1 - s) ** 2 * given[i]
            + s**2 * (3 - 2 * s) * given[i + 1]
            + s * (1 - s) ** 2 * velocity[i]
            - s**2 * (1 - s) * velocity[i + 1]
        )
        return held


DRAWN = Detail()
"""The scene as drawn."""


def require_detail(detail: int | None, own: int) -> int:
    """Returns the number of triangles asked for, or the scene's own.

    Raises:
        TypeError: If ``detail`` is not an integer.
        ValueError: If it is not within 10^3 and 10^7.

    Example:
        >>> require_detail(None, 262_267), require_detail(5000, 262_267)
        (262267, 5000)
    """
    return own if detail is None else require_integer("detail", detail, minimum=FEWEST, maximum=MOST)


def fitted(
    make: Callable[[Detail], Made], count: Callable[[Made], int], triangles: int, own: int, most: float = 0.97
) -> Made:
    """Returns what is made at the greatest fineness found that leaves some of the triangles over.

    The number of triangles grows about as the square of the fineness, so the search starts at sqrt(triangles / own)
    and goes on by the same rule, within the bracket of what was too few and too many.

    Args:
        make: Makes everything but the last, separate things, at a fineness.
        count: Number of triangles of what was made.
        triangles: Number wanted.
        own: Number that the scene has as drawn; there it is made at fineness 1 if that leaves something over.
        most: Share of the triangles that may be used; what uses between 0.95 of that and that ends the search.

    Returns:
        What was made; it has at most ``most * triangles`` triangles.

    Raises:
        ValueError: If even the coarsest has more.

    Example:
        >>> fitted(lambda detail: detail.segments(100, least=4) ** 2, int, triangles=2_500, own=10_000)
        2401
    """
    if triangles == own:
        made = make(Detail())
        if count(made) <= triangles:
            return made
    fineness = math.sqrt(triangles / own)
    low, high = 0.0, math.inf
    best: Made | None = None
    for _ in range(STEPS):
        made = make(Detail(fineness))
        used = count(made)
        if used <= most * triangles:
            best, low = made, fineness
            if used >= 0.95 * most * triangles:
                break
        else:
            high = fineness
        fineness *= math.sqrt(0.98 * most * triangles / max(used, 1))
        if not low < fineness < high:
            fineness = (low + high) / 2 if high < math.inf else 2 * low
        if high - low < 1e-3 * high:
            break
    if best is None:
        raise ValueError(f"detail: expected more triangles than {triangles}, which even the coarsest scene exceeds")
    return best
