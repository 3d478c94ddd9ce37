"""Settings of a foveated frame: passes, layers and paths, those of the paper, and what may be chosen."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from experiments.frame_costs import WatchedAtrous, watched
from fovden.foveation import ThreeLayer

__all__ = ["BASE", "NH2LD", "NH3LD", "Choice", "choice_of", "drawn", "grid", "setting_of", "space"]

WIDEST = 4.0
"""Largest power of two by which widths are wider."""


class Choice(NamedTuple):
    """Passes, layers and paths of a frame.

    Attributes:
        levels: Passes of each layer, the innermost first.
        r0: Radius of the inner layer, in units of the paper's.
        r1: Outer radius of the middle layer, in the same units.
        p: Share of the pixels of the outer layer that are left out. The middle one's falls in between, without a step.
        spp: Samples of each traced pixel.
        wide: Power of two by which the widths of normal and position are wider than the narrowest that are tried.

    Example:
        >>> print(Choice((3, 4, 5), 1, 2, 0.5, 4, 1.5))
        3-4-5 1 2 0.5 4 1.5
    """

    levels: tuple[int, ...]
    r0: float
    r1: float
    p: float
    spp: int
    wide: float = 0

    def __str__(self) -> str:
        return f"{'-'.join(map(str, self.levels))} {self.r0:g} {self.r1:g} {self.p:g} {self.spp} {self.wide:g}"

    def falloff(self, resolution: tuple[int, int]) -> ThreeLayer:
        """Returns the falloff for a resolution.

        Example:
            >>> NH3LD.falloff((1080, 960)).radii((1080, 960)) == ThreeLayer().radii((1080, 960))
            True
        """
        unit = ThreeLayer().radii(resolution)[0]
        return ThreeLayer(self.r0 * unit, self.r1 * unit, self.p, ramp_end="1-p")

    def denoiser(self, sigmas: Sequence[float], **options: Any) -> WatchedAtrous:
        """Returns the denoiser.

        Args:
            sigmas: Widths of radiance, normal and position where ``wide`` is 0.
            **options: Further keywords of :class:`fovden.filters.NonHomogeneousAtrous`.

        Example:
            >>> denoiser = BASE._replace(wide=1).denoiser((32, 0.025, 0.01))
            >>> round(denoiser.edge_stopping[0].sigma_normal.item(), 6)
            0.05
        """
        radiance, normal, position = sigmas
        wider = {"sigma_normal": normal * 2**self.wide, "sigma_position": position * 2**self.wide}
        return watched(self.levels, sigma_radiance=radiance, **wider, **options)


BASE = Choice((5,), 1, 2, 0.0, 4)
"""The paper's Base: all pixels traced, five passes everywhere."""

NH2LD = Choice((3, 5), 1, 2, 0.5, 4)
"""The paper's NH2LD."""

NH3LD = Choice((3, 4, 5), 1, 2, 0.5, 4)
"""The paper's NH3LD."""


def space(most_passes: int, most_spp: int) -> dict[str, Any]:
    """Returns what is searched, as :func:`fovden.tuning.search` takes it.

    Example:
        >>> list(space(6, 8)["middle"]({"inner": 5}))
        [5, 6]
    """
    passes = most_passes + 1
    return {
        "inner": range(1, passes),
        "middle": lambda at: range(at["inner"], passes),
        "outer": lambda at: range(at["middle"], passes),
        "r0": (0.25, 3.5),
        "r1": lambda at: (at["r0"], 4.5),
        "p": (0.0, 0.9),
        "spp": range(1, most_spp + 1),
        "wide": (0.0, WIDEST),
    }


def choice_of(setting: Mapping[str, Any]) -> Choice:
    """Returns a setting of the space, its numbers rounded: what the tables show is what was tried.

    Example:
        >>> numbers = {"r0": 0.511, "r1": 2.0, "p": 0.3333, "spp": 1, "wide": 2.04}
        >>> print(choice_of({"inner": 1, "middle": 2, "outer": 2, **numbers}))
        1-2-2 0.51 2 0.33 1 2
    """
    levels = setting["inner"], setting["middle"], setting["outer"]
    r0, r1, p = (round(setting[name], 2) for name in ("r0", "r1", "p"))
    return Choice(levels, r0, r1, p, setting["spp"], round(setting["wide"], 1))


def setting_of(choice: Choice) -> dict[str, Any]:
    """Returns a choice of three layers as a setting of the space."""
    inner, middle, outer = choice.levels
    rest = {"r0": choice.r0, "r1": choice.r1, "p": choice.p}
    return {"inner": inner, "middle": middle, "outer": outer, **rest, "spp": choice.spp, "wide": choice.wide}


def drawn(within_space: Mapping[str, Any], count: int) -> list[dict[str, Any]]:
    """Returns settings drawn at random from the space."""
    draw, found = random.Random(0), []  # not for secrets
    for _ in range(count):
        setting: dict[str, Any] = {}
        for name, choices in within_space.items():
            within = choices(setting) if callable(choices) else choices
            setting[name] = draw.uniform(*within) if isinstance(within, tuple) else draw.choice(within)
        found.append(setting)
    return found


def grid(most_passes: int, wides: Sequence[float]) -> list[dict[str, Any]]:
    """Returns all numbers of passes at the paper's foveation and samples, each with several widths."""
    numbers = range(1, most_passes + 1)
    triples = [(m, n, p) for m in numbers for n in numbers for p in numbers if m <= n <= p]
    return [setting_of(NH3LD._replace(levels=each, wide=wide)) for wide in wides for each in triples]
