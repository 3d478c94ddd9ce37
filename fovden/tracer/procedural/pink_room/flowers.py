"""Flowers and leaves: roses in a vase, a plant in a pot, a box of blossoms outside the window."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.pink_room.forms import sheets
from fovden.tracer.procedural.primitives import tube

__all__ = ["bouquet", "leaves", "plant", "rose"]


def rose(radius: float, detail: Detail) -> Patch:
    """Returns a full rose that opens upward from the origin: whorls of cupped petals with rolled rims.

    Example:
        >>> rose(0.05, Detail()).triangle_count
        1020
    """
    golden = np.pi * (3 - np.sqrt(5))
    detail = detail.at_most(1.2)  # petals lie closely upon each other
    count = detail.at_most(1.0).segments(17, least=5)
    rows, columns = detail.segments(9, least=3), detail.segments(6, least=2)
    hidden = detail.segments(4)  # rows that lie within the flower
    i = np.arange(count)[:, None, None]
    share = (i + 4) / (count + 3)
    t = np.linspace(0, 1, rows + 1)[None, :, None]
    across = np.linspace(-1, 1, columns + 1)[None, None, :]
    open_angle = 0.36 + 1.14 * share**0.8
    length = radius * (0.72 + 0.58 * share)
    pitch = np.pi / 2 - open_angle * (0.35 + 0.95 * t)
    out = (
        radius * (0.14 + 0.12 * share)
        + length * np.cumsum(np.cos(pitch) / (rows + 1), axis=1)
        + 0.10 * radius * share * t**6
    )
    up = length * np.cumsum(np.sin(pitch) / (rows + 1), axis=1) * (0.9 - 0.15 * share)
    half = (0.30 + 0.75 * np.sin(np.pi * (0.14 + 0.62 * t))) * (0.55 + 0.20 * share)
    turn = golden * i + half * across * (1.15 - 0.4 * share)
    cup = 1 - 0.10 * across**2 * (1 - t)
    rim = up - 0.05 * radius * across**2 * t**2 + 0.02 * radius * np.sin(5 * across + i) * t**3
    points = np.stack([out * cup * np.sin(turn), rim + 0 * turn, out * cup * np.cos(turn)], axis=-1)
    uv = np.stack(np.broadcast_arrays(0.5 + 0.4 * across, 0.1 + 0.8 * t, 0 * points[..., 0])[:2], axis=-1)
    return sheets(points[:, hidden:], uv[:, hidden:])


def leaves(
    roots: ArrayLike, turns: ArrayLike, tilts: ArrayLike, sizes: ArrayLike, detail: Detail, slender: float = 0.26
) -> Patch:
    """Returns leaves that grow outward from given points, folded along their midribs and bent down at their tips.

    Args:
        roots: Where they begin, metres, shape (k, 3).
        turns: Directions, radians about y, shape (k).
        tilts: How far they rise from the horizontal, radians, shape (k).
        sizes: Lengths, metres, shape (k).
        detail: Fineness.
        slender: Greatest half width as a share of the length.

    Returns:
        The leaves, seen from above; texture coordinates put the midrib at 0.5.

    Example:
        >>> leaves(np.zeros((2, 3)), np.zeros(2), np.zeros(2), np.full(2, 0.1), Detail()).triangle_count
        96
    """
    detail = detail.at_most(1.8)
    rows = detail.segments(6, least=2)
    t = np.linspace(0, 1, rows + 1)[:, None]
    side = np.linspace(-1, 1, 2 * detail.segments(2) + 1)[None, :]
    width = slender * np.sin(np.pi * (0.06 + 0.88 * t**0.85)) ** 0.85
    tilt, turn = np.asarray(tilts, dtype=float)[:, None, None], np.asarray(turns, dtype=float)[:, None, None]
    size = np.asarray(sizes, dtype=float)[:, None, None]
    pitch = tilt - 0.9 * t**1.3
    out = np.cumsum(np.cos(pitch), axis=1) / (rows + 1)
    up = np.cumsum(np.sin(pitch), axis=1) / (rows + 1) + 0.28 * np.abs(side) * width + 0.02 * np.sin(14 * t) * side**2
    x, z = size * side * width, size * (out + 0 * side)
    points = (
        np.stack([np.cos(turn) * x + np.sin(turn) * z, size * up, -np.sin(turn) * x + np.cos(turn) * z], axis=-1)
        + np.asarray(roots, dtype=float)[:, None, None]
    )
    uv = np.stack(np.broadcast_arrays(0.5 + 0.48 * side, t), axis=-1)
    return sheets(points[:, :, ::-1], uv[None, :, ::-1])


def bouquet(
    rng: np.random.Generator, blooms: int, spread: float, height: float, radius: float, detail: Detail
) -> tuple[Array, Patch, Patch]:
    """Returns where roses of a bunch stand, and their stems and leaves.

    Args:
        rng: Source of the bunch's irregularity.
        blooms: Number of roses.
        spread: Radius of the bunch, metres.
        height: Of its middle above the vase's mouth at the origin, metres.
        radius: Of a rose, metres.
        detail: Fineness.

    Returns:
        Places of the roses (n, 3), stems and leaves.

    Example:
        >>> places, stems, green = bouquet(np.random.default_rng(0), 5, 0.1, 0.15, 0.04, Detail(0.5))
        >>> places.shape
        (5, 3)
    """
    i = np.arange(blooms)
    share = np.sqrt((i + 0.4) / blooms)
    turn = np.pi * (3 - np.sqrt(5)) * i + 0.3 * rng.random(blooms)
    places = np.stack(
        [
            spread * share * np.sin(turn),
            height * (1.25 - 0.8 * share**2) + 0.15 * radius * rng.standard_normal(blooms),
            spread * share * np.cos(turn),
        ],
        axis=1,
    )
    t = np.linspace(0, 1, detail.at_most(1.5).segments(6, least=1) + 1)[:, None]
    stems = []
    for place in places:
        bend = np.array([0.12, -0.05, 0.12]) * place
        line = t * place * [1, 1, 1] + np.sin(np.pi * t) * bend + (1 - t) * [0.1 * place[0], -0.02, 0.1 * place[2]]
        stems.append(tube(line, 0.0026, detail.segments(5, least=3)))
    count = detail.at_most(1.0).count(7 * blooms, least=3)
    which, far = rng.integers(0, blooms, count), rng.uniform(0.35, 0.9, count)
    roots = places[which] * far[:, None]
    facing = np.arctan2(places[which, 0], places[which, 2]) + 0.9 * rng.standard_normal(count)
    green = leaves(
        roots, facing, 0.5 + 0.3 * rng.standard_normal(count), rng.uniform(0.05, 0.10, count) * radius / 0.045, detail
    )
    return places, join(stems), green


def plant(rng: np.random.Generator, height: float, detail: Detail) -> tuple[Patch, Patch]:
    """Returns a fig tree for a pot: slender trunks that branch and their leaves.

    Args:
        rng: Source of its growth.
        height: Metres.
        detail: Fineness.

    Returns:
        Wood and leaves, the root at the origin.

    Example:
        >>> wood, green = plant(np.random.default_rng(0), 1.2, Detail(0.4))
        >>> bool(green.vertices[:, 1].max() > 0.9)
        True
    """
    wood, roots, facing = [], [], []
    t = np.linspace(0, 1, detail.at_most(1.5).segments(12, least=2) + 1)[:, None]
    twigs, many = (detail.at_most(1.0).segments(drawn, least=2) for drawn in (9, 13))
    for trunk in range(3):
        lean = 2.1 * trunk + 0.4 * rng.random()
        way = np.array([0.16 * np.sin(lean), 1.0, 0.16 * np.cos(lean)]) * height * (1 - 0.12 * trunk)
        line = t * way + 0.02 * np.sin(7 * t + trunk) * [1, 0, 1] + 0.02 * np.array([np.sin(lean), 0, np.cos(lean)])
        wood.append(tube(line, np.linspace(0.013, 0.006, len(line)), detail.segments(9, least=3)))
        for k in range(twigs):
            at = 0.38 + 0.6 * (k + rng.random()) / twigs
            start = np.array([np.interp(at, t[:, 0], line[:, axis]) for axis in range(3)])
            turn = 2.4 * k + trunk + 0.4 * rng.random()
            reach = 0.30 * height * (1.15 - 0.6 * at)
            tip = start + reach * np.array([0.8 * np.sin(turn), 0.55, 0.8 * np.cos(turn)])
            twig = start + t * (tip - start) - 0.1 * reach * np.sin(np.pi * t) * [0, 1, 0]
            wood.append(tube(twig, np.linspace(0.005, 0.0022, len(twig)), detail.segments(5, least=3)))
            along = np.linspace(0.2, 1.0, many)[:, None]
            roots.append(start + along * (tip - start) - 0.1 * reach * np.sin(np.pi * along) * [0, 1, 0])
            facing.append(turn + np.where(np.arange(many) % 2, 1.0, -1.0) * rng.uniform(0.4, 1.3, many))
    places, turns = np.concatenate(roots), np.concatenate(facing)
    count = len(turns)
    tilts = 0.15 + 0.3 * rng.standard_normal(count)
    return join(wood), leaves(places, turns, tilts, rng.uniform(0.09, 0.14, count), detail)
