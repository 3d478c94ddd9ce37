"""The window: frame and casements, sill, radiator, what hangs around it and what lies outside.

Everything is in the frame of the wall: x along it, the room towards +z.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.pink_room.forms import stretched
from fovden.tracer.procedural.pink_room.plan import WINDOW
from fovden.tracer.procedural.pink_room.shell import CASING, curved
from fovden.tracer.procedural.pink_room.turning import torus, turned
from fovden.tracer.procedural.primitives import grid, lathe, mitred, quad, ring_corners, tube

__all__ = ["curtains", "hillside", "radiator", "window"]

ROD = 2.66
"""Height of the curtain rod, metres."""

TIE = 1.12
"""Height at which the curtains are tied back, metres."""


def window(detail: Detail) -> Patch:
    """Returns the painted wood of the window: casing, frame, two casements with glazing bars, and the sill.

    Example:
        >>> window(Detail()).triangle_count > 200
        True
    """
    x0, x1, y0, y1 = WINDOW
    half_x, half_y, middle = (x1 - x0) / 2, (y1 - y0) / 2, ((x0 + x1) / 2, (y0 + y1) / 2)
    section = curved([(0.0, 0.0), (0.0, 0.028), (0.03, 0.033), (0.055, 0.024), (0.07, 0.036), (CASING, 0.0)], detail, 2)
    ring = ring_corners(half_x, half_y)
    casing = mitred(section[::-1], ring, closed=True)
    frame = mitred(
        [(0.0, -0.13), (-0.045, -0.13), (-0.045, -0.15), (-0.058, -0.15), (-0.058, -0.19)], ring, closed=True
    )
    pieces = [casing.standing(), frame.standing()]
    leaf_x, leaf_y = (half_x - 0.047) / 2 - 0.002, half_y - 0.047
    leaf = _casement(leaf_x, leaf_y, detail)
    pieces += [leaf.placed((side * (leaf_x + 0.002), 0, -0.165)) for side in (-1, 1)]
    framed = join(pieces).placed((*middle, 0.0))
    sill = curved([(-0.05, -0.035), (-0.02, -0.032), (0.0, -0.016), (-0.008, 0.004)], detail, 2)
    reach = half_x + CASING + 0.03
    board = mitred(sill, [(-reach, 0), (-reach, 0.19), (reach, 0.19), (reach, 0)])
    top = quad(
        (-reach + 0.008, 0.004, 0.182),
        (reach - 0.008, 0.004, 0.182),
        (reach - 0.008, 0.004, 0),
        (-reach + 0.008, 0.004, 0),
    )
    return join([framed, join([board, top]).placed((middle[0], y0, 0.002))])


def _casement(half_x: float, half_y: float, detail: Detail) -> Patch:
    """A leaf about the origin: stiles and rails around glazing bars of two by four panes."""
    stile = 0.048
    profile = [
        (0.0, -0.018),
        (0.0, 0.018),
        (-0.028, 0.018),
        (-0.04, 0.01),
        (-stile, 0.006),
        (-stile, -0.018),
        (0.0, -0.018),
    ]
    rails = mitred(profile[1:6], ring_corners(half_x, half_y), closed=True).standing()
    back = mitred([profile[5], profile[0]], ring_corners(half_x, half_y), closed=True).standing()
    x, y = half_x - stile, half_y - stile
    across = detail.segments(8, least=3)
    bars = [tube([(0, -y, 0), (0, y, 0)], 0.012, across)]
    bars += [tube([(-x, y * share, 0), (x, y * share, 0)], 0.012, across) for share in (-0.5, 0.0, 0.5)]
    return join([rails, back, *bars])


def radiator(detail: Detail, sections: int = 15) -> Patch:
    """Returns a cast-iron radiator, its middle at x = 0 and its foot at y = 0: three columns in each section.

    Example:
        >>> radiator(Detail(0.5)).vertices[:, 1].max() < 0.8
        np.True_
    """
    pitch, low, high = 0.066, 0.1, 0.72
    end = np.linspace(0, np.pi / 2, detail.segments(4, least=1) + 1)
    foot = np.stack([np.sin(end), 1 - np.cos(end)], axis=1)
    head = np.stack([np.cos(end), np.sin(end)], axis=1)
    foot[0, 0] = head[-1, 0] = 0.0
    radius = 0.03
    profile = np.concatenate([low + 0 * foot, high - radius + 0 * head])
    profile[:, 0] = radius * np.concatenate([foot[:, 0], head[:, 0]])
    profile[:, 1] += radius * np.concatenate([foot[:, 1], head[:, 1]])
    column = stretched(lathe(profile, detail.segments(12, least=4)), (0.88, 1.0, 1.0))
    z = np.array([-0.062, 0.0, 0.062])
    x = (np.arange(sections) - (sections - 1) / 2) * pitch
    places = np.stack([np.repeat(x, 3), np.zeros(3 * sections), np.tile(z, sections)], axis=1)
    lengths = [(x[0] - 0.05, x[-1] + 0.05)] * 2
    pipes = [
        tube([(a, y, 0.0), (b, y, 0.0)], [0.028, 0.028], detail.segments(10, least=4))
        for (a, b), y in zip(lengths, (0.16, 0.65), strict=True)
    ]
    feet = turned([(0.03, 0.0), (0.02, 0.03), (0.018, 0.13)], detail, 10).placed(
        [(x[0], 0.001, 0.062), (x[-1], 0.001, 0.062)]
    )
    valve = turned([(0.012, 0.0), (0.012, 0.12), (0.03, 0.13), (0.03, 0.2), (0.02, 0.215), (0.0, 0.22)], detail, 12)
    return join([column.placed(places), *pipes, feet, valve.placed((x[-1] + 0.075, 0.001, 0.0))])


def curtains(rng: np.random.Generator, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Yields a pair of tied curtains, their valance, rod, rings and tassels, each with the name of its surface.

    Example:
        >>> [surface for surface, _ in curtains(np.random.default_rng(0), Detail(0.5))]
        ['curtain', 'curtain', 'valance', 'gold cord', 'brass']
    """
    x0, x1, _, _ = WINDOW
    mirror = np.diag([-1.0, 1.0, 1.0])
    cords = []
    for side, edge in ((-1, x0), (1, x1)):
        panel = _panel(rng, detail)
        panel = panel if side < 0 else panel.transformed(mirror)
        yield "curtain", panel.placed((edge + side * 0.42, 0, 0))
        band = stretched(torus(0.105, 0.012, detail.segments(28, 6), detail.segments(8, 3)), (1.05, 1.6, 0.75))
        cords.append(band.placed((edge + side * 0.315, TIE, 0.125)))
        cords.append(_tassel(detail, 0.22).placed((edge + side * 0.30, TIE - 0.02, 0.222)))
    valance, fringe = _valance(detail)
    middle = (x0 + x1) / 2
    yield "valance", valance.placed((middle, 0, 0))
    if detail.shows(0.25):
        cords.append(fringe.placed((middle, 0, 0)))
    yield "gold cord", join(cords)
    reach = (x1 - x0) / 2 + 0.5
    rod = tube([(-reach, ROD, 0.12), (reach, ROD, 0.12)], 0.014, detail.segments(10, least=4))
    knob = turned([(0.0, -0.05), (0.03, -0.035), (0.036, 0.0), (0.02, 0.03), (0.014, 0.045)], detail, 14)
    ends = [
        knob.transformed([[0, -side, 0], [side, 0, 0], [0, 0, 1]]).placed((side * (reach + 0.03), ROD, 0.12))
        for side in (1, -1)
    ]
    yield "brass", join([rod, *ends]).placed((middle, 0, 0))


def _panel(rng: np.random.Generator, detail: Detail) -> Patch:
    """The left curtain, its outer edge at x = 0: pleats that run together at the tie and open again below it."""
    # Cloth that hangs is nearly straight from top to bottom.
    rows, columns = detail.at_most(1.2).segments(90, least=3) + 1, detail.at_most(2.0).segments(124, least=4) + 1
    across, y = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0.02, ROD - 0.02, rows), indexing="xy")
    above, below = np.clip((y - TIE) / (ROD - TIE), 0, 1), np.clip((TIE - y) / TIE, 0, 1)
    share = np.where(y > TIE, 0.36 + 0.64 * above**1.5, 0.36 + 0.34 * np.sin(np.pi / 2 * below) ** 1.2)
    pleats = 7.5
    wander = 0.5 * np.sin(2 * np.pi * (across + rng.random()) + 1.5 * (1 - above)) + 0.3 * np.sin(
        7 * across + 2 * below
    )
    phase = 2 * np.pi * (pleats * across + 0.16 * wander * (1.2 - above))
    deep = (0.030 + 0.022 * below * (0.7 + 0.3 * np.sin(9 * across + 4 * rng.random()))) * (0.55 + 0.45 / share**0.5)
    deep *= np.where(y > TIE, 0.75 + 0.25 * np.abs(above - 0.15) / 0.85, 1.0)
    x = 0.13 * (1 - share) + 0.56 * share * across + 0.0012 * np.sin(2 * phase)
    z = 0.125 + deep * np.sin(phase) + 0.012 * np.sin(2 * np.pi * (y / 1.4 + across))
    lower = y - 0.13 * across * np.sin(np.pi * np.clip(above, 0, 1)) ** 0.8 * (y > TIE)
    points = np.stack([x, lower, z], axis=-1)
    return grid(points, smooth=True, uv=np.stack([1.1 * across, y], axis=-1))


def _valance(detail: Detail) -> tuple[Patch, Patch]:
    """A gathered valance with a scalloped hem over the rod, and its fringe of tassels."""
    x0, x1, _, _ = WINDOW
    reach = (x1 - x0) / 2 + 0.44
    rows, columns = detail.segments(14, least=2) + 1, detail.segments(340, least=8) + 1
    u, down = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(1, 0, rows), indexing="xy")
    scallops = 6

    def hem(at: Array) -> Array:
        lowest: Array = ROD - 0.20 - 0.10 * np.abs(np.sin(np.pi / 2 * scallops * (at + 1))) ** 0.8
        return lowest

    top = ROD + 0.055
    y = top + (hem(u) - top) * down
    pleat = 0.010 + 0.014 * down
    z = (
        0.185
        + pleat * np.sin(2 * np.pi * 27 * (u + 0.006 * np.sin(9 * u)))
        + 0.015 * down * np.cos(np.pi * scallops * (u + 1))
    )
    patch = grid(
        np.stack([reach * u, y, z], axis=-1), smooth=True, uv=np.stack([1.5 * reach * u, -0.3 * down], axis=-1)
    )
    count = detail.at_most(1.0).count(150, least=1)
    at = (np.arange(count) + 0.5) / count * 2 - 1
    z = (
        0.185
        + 0.024 * np.sin(2 * np.pi * 27 * (at + 0.006 * np.sin(9 * at)))
        + 0.015 * np.cos(np.pi * scallops * (at + 1))
    )
    places = np.stack([reach * at, hem(at) + 0.002, z], axis=1)
    return patch, lathe([(0.0035, -0.046), (0.0075, -0.04), (0.005, -0.014), (0.0025, 0.0)], 5).placed(places)


def _tassel(detail: Detail, length: float) -> Patch:
    """A tassel that hangs from the origin: a cord, a knob and a skirt of threads."""
    head = turned(
        [(0.006, -0.3 * length), (0.02, -0.36 * length), (0.022, -0.44 * length), (0.014, -0.5 * length)], detail, 12
    )
    around = np.linspace(0, 2 * np.pi, detail.segments(40, least=6) + 1)
    around[-1] = 0.0
    share = np.linspace(1, 0, detail.segments(6) + 1)[:, None]
    r = 0.014 + 0.016 * share**0.7 + 0.003 * np.abs(np.sin(10 * around)) * share
    y = np.broadcast_to(-length * (0.5 + 0.5 * share), r.shape)
    skirt = grid(np.stack([r * np.sin(around), y, r * np.cos(around)], axis=-1), smooth=True)
    cord = tube([(0, -0.3 * length, 0), (0, 0, -0.01)], 0.005, detail.segments(6, least=3))
    return join([head, skirt, cord])


def hillside(rng: np.random.Generator, detail: Detail) -> Patch:
    """Returns the meadow outside, rising from the house, with soft undulations.

    Example:
        >>> hillside(np.random.default_rng(0), Detail(0.1)).vertices[:, 2].max() < -0.3
        np.True_
    """
    rows, columns = detail.segments(40, least=1) + 1, detail.segments(60, least=1) + 1
    away, x = np.meshgrid(np.linspace(0, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    z = -0.6 - 45 * away**1.7
    x = (8 + 55 * away) * x
    phase = 2 * np.pi * rng.random(4)
    y = (
        -0.75
        - 0.56 * z
        + 0.022 * np.abs(z) * (np.sin(0.21 * x + phase[0]) + np.sin(0.33 * z + 0.1 * x + phase[1])) * away**0.3
    )
    y += 0.09 * np.sin(1.3 * x + phase[2]) * np.sin(1.1 * z + phase[3])
    return grid(np.stack([x, y - 0.4, z], axis=-1), smooth=True, uv=np.stack([x, -1.1 * z], axis=-1))
