"""Wickerwork: a basket woven of willow, strand by strand."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.pink_room.forms import strands
from fovden.tracer.procedural.pink_room.turning import disc
from fovden.tracer.procedural.primitives import grid, tube

__all__ = ["basket"]


def basket(radius: float, height: float, detail: Detail) -> Patch:
    """Returns a round basket: split willow that passes in front of and behind stakes, a braided rim, two handles.

    Args:
        radius: At half its height, metres.
        height: Metres.
        detail: Fineness.

    Returns:
        The basket, its foot at y = 0.001.

    Example:
        >>> bool(basket(0.2, 0.3, Detail(0.3)).vertices[:, 1].min() >= 0.0)
        True
    """
    detail = detail.at_most(1.4)  # finer pieces would only show that strands touch
    coarse = min(1.0, max(detail.fineness, 0.2))
    stakes = 2 * max(3, round(15 * coarse)) + 1
    rows = max(3, round(22 * coarse))
    thick = 0.42 * height / rows
    y = thick + 0.003 + (np.arange(rows) + 0.0) / rows * (height - 2 * thick)
    around = 2 * np.pi * np.arange(stakes * detail.segments(4, least=2) + 1) / (stakes * detail.segments(4, least=2))
    around[-1] = 0.0
    bow = np.linspace(-0.45 * np.pi, 0.45 * np.pi, detail.segments(5, least=1) + 1)[:, None]
    pieces = []
    for k in range(rows):
        weave = np.cos(stakes * around / 2)
        r = _bulge(y[k] / height) * radius + 0.9 * thick * (weave if k % 2 else -weave)
        r[-1] = r[0]
        out = r + 0.8 * thick * np.cos(bow)
        level = np.broadcast_to(y[k] + 1.1 * thick * np.sin(bow), out.shape)
        length = np.broadcast_to(radius * np.linspace(0, 2 * np.pi, len(around)), out.shape)
        points = np.stack([out * np.sin(around), level, out * np.cos(around)], axis=-1)
        pieces.append(grid(points, smooth=True, uv=np.stack([0.3 * level, length], axis=-1)))
    s = np.linspace(0, 1, detail.segments(8, least=2) + 1)
    stake = np.stack([0 * s, thick + s * (height - thick), _bulge(s) * radius], axis=1)
    turns = 2 * np.pi * np.arange(stakes) / stakes
    pieces.append(tube(stake, 0.004, detail.segments(5, least=3)).placed((0, 0, 0), turns))
    t = np.linspace(0, 2 * np.pi, detail.segments(220, least=9) + 1)
    t[-1] = 0.0
    for phase in (0.0, 2 * np.pi / 3, 4 * np.pi / 3):
        swing, rise = np.cos(22 * t + phase), np.sin(22 * t + phase)
        r = _bulge(1.0) * radius + 0.0095 * swing
        braid = np.stack([r * np.sin(t), height + 0.008 * rise, r * np.cos(t)], axis=1)
        outward = np.stack([swing * np.sin(t), rise, swing * np.cos(t)], axis=1)
        pieces.append(strands(braid[None], outward[None], 0.006, detail.segments(5, least=2)))
    a = np.linspace(0, np.pi, detail.segments(18, least=3) + 1)
    grip = np.stack([0.07 * np.cos(a), height + 0.065 * np.sin(a), np.full_like(a, _bulge(1.0) * radius)], axis=1)
    pieces.append(tube(grip, 0.009, detail.segments(8, least=3)).placed((0, 0, 0), [np.pi / 2 + 0.4, -np.pi / 2 + 0.4]))
    inside = disc(float(_bulge(0.06)) * radius - 0.012, 0.004, stakes)
    return join([*pieces, inside])


def _bulge(share: np.ndarray | float) -> np.ndarray | float:
    """The basket's radius over its height, relative to that at half its height."""
    return 0.8 + 0.8 * np.asarray(share) - 0.72 * np.asarray(share) ** 2
