"""The shrine in the middle of the clearing: steps, four pillars, a shingled roof, and a stone figure under it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import box, bridge, grid, lathe, mitred, ring_corners

__all__ = ["BEAM", "EAVES", "FLOOR", "PILLAR", "ROOF_HALF", "figure", "roof", "shrine"]

FLOOR = 0.40
"""Height of the upper step, metres."""

PILLAR = 0.86
"""Distance of the pillars' axes from the middle, along x and z, metres."""

BEAM = 2.36
"""Height of the beams' underside, metres."""

EAVES, ROOF_HALF = 2.50, 1.52
"""Height of the eaves in the middle of a side, and half of the roof's width, metres."""

STEPS = ((1.86, -0.08, 0.20), (1.50, 0.20, FLOOR))
"""Radius, bottom and top of the two octagonal steps, metres."""

BEVEL = 0.03
"""Width and height of the steps' bevelled edges, metres."""


def shrine(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Yields the shrine's parts as pairs of a surface's name and a patch.

    Example:
        >>> sorted({name for name, _ in shrine(Detail())})
        ['bib', 'granite', 'oak', 'shingles']
    """
    yield "granite", join([*_steps(), _pillars(detail)])
    if detail.shows(0.12):
        yield "granite", _pedestal().placed((0, FLOOR, -0.1))
    yield "oak", _beams()
    shingles, soffit, finial = roof(detail)
    yield "shingles", shingles
    yield "oak", soffit
    yield "granite", finial
    if detail.shows(0.12):
        body, bib = figure(detail)
        yield "granite", body.placed((0, FLOOR + 0.42, -0.1))
        yield "bib", bib.placed((0, FLOOR + 0.42, -0.1))


def _steps() -> list[Patch]:
    """Two steps with bevelled edges; the upper one's top is a fan around its corners."""
    pieces = []
    for radius, bottom, top in STEPS:
        profile = [(radius, bottom), (radius, top - BEVEL), (radius - BEVEL, top)]
        pieces.append(lathe(profile, 8, faceted=True, turn=np.pi / 8))
    tread = [(STEPS[0][0] - BEVEL, STEPS[0][2]), (STEPS[1][0], STEPS[0][2])]
    pieces.append(lathe(tread, 8, faceted=True, turn=np.pi / 8))
    angle = np.pi / 8 + np.pi / 4 * np.arange(8)
    corners = (STEPS[1][0] - BEVEL) * np.stack([np.sin(angle), np.zeros(8), np.cos(angle)], axis=1)
    corners[:, 1] = FLOOR
    return [*pieces, bridge(corners[1:], corners[:1])]


def _pillars(detail: Detail) -> Patch:
    around = detail.segments(12, least=3)
    profile = [(0.085, 0.12), (0.092, 0.7), (0.085, 1.3), (0.075, 1.78)]
    bands = [
        [(0.135, 0.0), (0.135, 0.07), (0.12, 0.085)],
        [(0.12, 0.085), (0.105, 0.105), (0.085, 0.12)],
        [(0.075, 1.78), (0.10, 1.80), (0.10, 1.83), (0.08, 1.85)],
        [(0.08, 1.85), (0.13, 1.93), (0.13, BEAM - FLOOR)],
    ]
    lines = [profile, *bands] if detail.shows(0.3) else [[(0.09, 0.0), (0.09, BEAM - FLOOR)]]
    one = join([lathe(line, around) for line in lines])
    corners = [(x, FLOOR, z) for x, z in ring_corners(PILLAR, PILLAR)]
    return one.placed(corners)


def _pedestal() -> Patch:
    """A square block with mouldings, 0.42 m tall."""
    section = [
        (0.06, 0.0),
        (0.06, 0.06),
        (0.015, 0.085),
        (0.0, 0.12),
        (0.0, 0.32),
        (0.03, 0.345),
        (0.03, 0.40),
        (0.01, 0.42),
    ]
    sides = mitred(section, ring_corners(0.24, 0.20), closed=True)
    top = box((0.50, 0.42, 0.42), "+y")
    return join([sides, top])


def _beams() -> Patch:
    """Two pairs of crossing beams on the pillars, their ends standing out."""
    long = box((2 * PILLAR + 0.62, 0.14, 0.13))
    cross = box((2 * PILLAR + 0.56, 0.12, 0.12))
    lower = [cross.placed((0, BEAM, side * PILLAR)) for side in (-1, 1)]
    upper = [long.placed((side * PILLAR, BEAM + 0.085, 0), turns=np.pi / 2) for side in (-1, 1)]
    return join([*lower, *upper])


def roof(detail: Detail) -> tuple[Patch, Patch, Patch]:
    """Returns the roof: shingles in courses, the boards under them, and the finial.

    Each of the four sides is a concave slope whose eaves rise towards the corners. A course ends in a lip that shows
    the shingles' thickness. It is made at most twice as fine as drawn: the slopes bend so gently that beyond it they
    would be split into parts that are flat.

    Example:
        >>> shingles, soffit, finial = roof(Detail())
        >>> bool(shingles.vertices[:, 1].max() < finial.vertices[:, 1].max())
        True
    """
    detail = detail.at_most(2.0)
    courses, columns = detail.segments(11, least=1), 2 * detail.segments(6)
    up = np.linspace(0, 1, courses + 1)
    down = np.repeat(up, 2)[1:-1]
    lift = np.tile([0.03, 0.0], courses)
    across = np.linspace(-1, 1, columns + 1)
    points = _slope(down, across) + np.stack([0 * lift, lift, 0.35 * lift], axis=1)[:, None]
    pieces = []
    for course in range(courses):
        face = points[2 * course : 2 * course + 2]
        uv = np.stack([face[..., 0] + 0.13 * (course % 2) + 0.37 * course, face[..., 1] - face[0, 0, 1]], axis=-1)
        pieces.append(grid(face, uv=uv, smooth=True))
        under = _slope(up[course : course + 1], across) if course == 0 else points[2 * course - 1 : 2 * course]
        lip = np.concatenate([under, face[:1]])
        pieces.append(grid(lip, uv=np.stack([lip[..., 0], 0.5 * lip[..., 1]], axis=-1)))
    side = join(pieces)
    soffit = grid(_slope(up, across) - [0.0, 0.015, 0.0], smooth=True).reversed()
    quarter = np.pi / 2 * np.arange(4)
    top = EAVES + _height(np.array(1.0), np.array(0.0)) - 0.02
    around = detail.segments(10, least=3)
    profile = [
        (0.20, 0.0),
        (0.21, 0.05),
        (0.12, 0.10),
        (0.07, 0.16),
        (0.11, 0.24),
        (0.10, 0.31),
        (0.04, 0.38),
        (0.0, 0.47),
    ]
    finial = lathe(profile if detail.shows(0.3) else profile[::7], around).placed((0, float(top), 0))
    return side.placed(turns=quarter), soffit.placed(turns=quarter), finial


def _height(up: Array, across: Array) -> Array:
    height: Array = 1.18 * up**1.45 + 0.2 * np.abs(across) ** 3 * (1 - up) ** 2
    return height


def _slope(up: Array, across: Array) -> Array:
    """Points of the front slope at shares of the way up and across, shape (rows, columns, 3)."""
    half = ROOF_HALF + (0.16 - ROOF_HALF) * up
    z = np.broadcast_to(half[:, None], (len(up), len(across)))
    return np.stack([z * across, EAVES + _height(up[:, None], across), z], axis=-1)


def figure(detail: Detail) -> tuple[Patch, Patch]:
    """Returns a small standing figure of stone, a traveller's guardian, and the cloth around its neck.

    Example:
        >>> body, bib = figure(Detail())
        >>> round(float(body.vertices[:, 1].max()), 2)
        0.86
    """
    around = detail.segments(16, least=4)
    robe = np.array(
        [
            (0.17, 0.0),
            (0.165, 0.04),
            (0.15, 0.12),
            (0.142, 0.24),
            (0.15, 0.36),
            (0.163, 0.46),
            (0.15, 0.53),
            (0.10, 0.58),
        ]
    )
    neck = np.array([(0.10, 0.58), (0.062, 0.60), (0.058, 0.62)])
    angle = np.linspace(-1.05, np.pi / 2, detail.segments(9, least=3) + 1)
    head = np.stack([0.118 * np.cos(angle), 0.728 + 0.132 * np.sin(angle)], axis=1)
    head[-1, 0] = 0.0
    parts = [lathe(robe, around), lathe(neck, around), lathe(head, around)]
    if detail.shows(0.3):
        folded = [lathe(piece, around) for piece in ([(0.0, 0.0), (0.03, 0.02), (0.035, 0.06), (0.0, 0.13)],)]
        hands = folded[0].placed([(0.0, 0.34, 0.135)], scales=0.9)
        parts.append(hands)
    body = join(parts)
    turn = np.linspace(-1.5, 1.5, detail.segments(12, least=2) + 1)
    down = np.linspace(0, 1, detail.segments(4) + 1)[:, None]
    edge = 0.055 + 0.125 * np.cos(turn / 1.5 * np.pi / 2) ** 0.6
    y = 0.585 - down * edge
    r = np.interp(y, robe[:, 1], robe[:, 0]) + 0.012 + 0.012 * down * (1 + np.cos(6 * turn))
    points = np.stack([r * np.sin(turn), y, r * np.cos(turn)], axis=-1)[::-1]
    return body, grid(points, smooth=True)
