"""Columns, pilasters and balusters, in the proportions of the Corinthian order.

Each function returns patches in a local frame: the axis is y, the foot at 0, the front +z. What stands on a floor has
no bottom, and what carries something has only the rim of its top. Proportions follow the treatises loosely (Vignola,
"Regola delli cinque ordini d'architettura", 1562): an Attic base about half a diameter high, a shaft that narrows by a
sixth with entasis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import arc_lengths, box, bridge, grid, lathe, mitred, ring_corners, tube

__all__ = ["ColumnOrder", "baluster", "bead", "column", "hollow", "pilaster", "rim"]


@dataclass(frozen=True)
class ColumnOrder:
    """Measures of a column, in metres.

    Attributes:
        height: From the floor to the top of the abacus.
        radius: Of the shaft at its foot.
        capital: Height of the capital below the abacus.
        abacus: Half of the abacus's width at its top.
        abacus_height: Thickness of the abacus.
        bearing: Half of the width of what stands on the abacus and hides the middle of its top.
        flutes: Number of flutes; 0 for a smooth shaft.
        segments: Segments around base and bell, in eights.
        leaf_rows: Rows of eight leaves around the bell.
        scroll_sides: Sides of the volutes' cross-section.
        detail: Fineness; the base needs 0.2, volutes and mouldings 0.3, leaves 0.35 and flutes 0.4.

    Example:
        >>> ColumnOrder(height=3.4, radius=0.29, capital=0.46, abacus=0.43, bearing=0.22).flutes
        16
    """

    height: float
    radius: float
    capital: float
    abacus: float
    bearing: float
    abacus_height: float = 0.12
    flutes: int = 16
    segments: int = 24
    leaf_rows: int = 2
    scroll_sides: int = 4
    detail: Detail = DRAWN

    @property
    def around(self) -> int:
        """Segments around at the fineness that there is: eights, or four below 0.2."""
        return 8 * self.detail.segments(self.segments // 8) if self.detail.shows(0.2) else 4

    def turned(self, profile: ArrayLike, turn: float = -np.pi / 4) -> Patch:
        """Returns a turned part of the column; with four segments they are flat, and turned like the plinth.

        Example:
            >>> order = ColumnOrder(3.4, 0.29, capital=0.46, abacus=0.43, bearing=0.22)
            >>> order.turned([(0.3, 0.0), (0.3, 1.0)]).triangle_count
            48
        """
        if self.around == 4:
            return lathe(profile, 4, faceted=True, turn=-np.pi / 4)
        return lathe(profile, self.around, turn=turn)


BASE_HEIGHT = 1.25
"""Height of the Attic base with its plinth, in radii of the shaft."""

NARROWING = 1 / 6
"""Share of its radius that a shaft loses towards the top (Vignola)."""

MOST_DRUMS = 8
"""Segments along a shaft at any fineness: its entasis bends it so little that more would be flat."""


def bead(radius: float, bulge: float, bottom: float, top: float, points: int = 6) -> Array:
    """Returns the profile of a torus: half an ellipse that swells outward between two heights.

    Example:
        >>> bead(1.0, 0.2, 0.0, 0.4, points=3).round(3).tolist()
        [[1.0, 0.0], [1.2, 0.2], [1.0, 0.4]]
    """
    angle = np.linspace(-np.pi / 2, np.pi / 2, points)
    return np.stack([radius + bulge * np.cos(angle), (bottom + top) / 2 + (top - bottom) / 2 * np.sin(angle)], axis=1)


def hollow(lower: ArrayLike, upper: ArrayLike, depth: float, points: int = 5) -> Array:
    """Returns the profile of a scotia or cavetto: a hollow of some depth between two points (r, y).

    Example:
        >>> hollow((1.0, 0.0), (1.0, 1.0), 0.1, points=3).round(3).tolist()
        [[1.0, 0.0], [0.9, 0.5], [1.0, 1.0]]
    """
    share = np.linspace(0, 1, points)[:, None]
    line = np.asarray(lower, float) * (1 - share) + np.asarray(upper, float) * share
    line[:, 0] -= depth * np.sin(np.pi * share[:, 0])
    return line


def rim(outer: float, inner: float, height: float) -> Patch:
    """Returns the square rim, facing up, that is left around a square thing on a square top.

    Example:
        >>> round(rim(0.5, 0.25, 1.0).area, 3)
        0.75
    """
    return mitred([(0, height), (inner - outer, height)], ring_corners(outer, outer), closed=True)


def column(order: ColumnOrder) -> Patch:
    """Returns a column: plinth, Attic base, fluted shaft with entasis, capital with leaves and volutes, abacus.

    Example:
        >>> order = ColumnOrder(height=3.4, radius=0.29, capital=0.46, abacus=0.43, bearing=0.22)
        >>> round(float(column(order).vertices[:, 1].max()), 6)
        3.4
    """
    if not order.detail.shows(0.2):
        bell = order.height - order.abacus_height - order.capital
        return join([_shaft(order, 0.0, bell), _capital(order, order.radius * (1 - NARROWING)).placed((0, bell, 0))])
    foot = BASE_HEIGHT * order.radius
    bell = order.height - order.abacus_height - order.capital
    top_radius = order.radius * (1 - NARROWING)
    capital = _capital(order, top_radius).placed((0, bell, 0))
    return join([_base(order), _shaft(order, foot - 0.04 * order.radius, bell), capital])


def _base(order: ColumnOrder) -> Patch:
    plinth, ring = 1.38, 1.16
    corners = ring_corners(plinth, plinth)
    sides = mitred([(0, 0), (0, 0.33)], corners, closed=True)
    circle = lathe([(ring, 0.33), (ring, 0.34)], order.around, turn=-np.pi / 4).vertices[: order.around + 1]
    square = np.array([(x, 0.33, z) for x, z in [*corners, corners[0]]])
    top = bridge(square, circle)
    pieces = [
        bead(ring, 0.17, 0.33, 0.66, points=5),
        np.array([(ring, 0.66), (1.12, 0.66)]),
        np.array([(1.12, 0.66), (1.12, 0.70)]),
        hollow((1.12, 0.70), (1.06, 0.92), 0.08, points=4),
        np.array([(1.06, 0.92), (1.06, 0.95)]),
        bead(1.04, 0.10, 0.95, 1.15, points=4),
        np.array([(1.04, 1.15), (1.0, BASE_HEIGHT)]),
    ]
    if not order.detail.shows(0.45):
        pieces = [bead(ring, 0.17, 0.33, 0.66, points=3), np.array([(ring, 0.66), (1.0, BASE_HEIGHT)])]
    turned = [order.turned(order.detail.curve(piece, least=2)) for piece in pieces]
    return join([sides, top, *turned]).placed(scales=order.radius)


def _shaft(order: ColumnOrder, bottom: float, top: float) -> Patch:
    """Flutes with rounded ends and the fillets between them, or a plain shaft."""
    if order.flutes == 0 or not order.detail.shows(0.4):
        share = np.linspace(0, 1, min(order.detail.segments(4), MOST_DRUMS) + 1)
        return order.turned(np.stack([_entasis(order.radius, share), bottom + share * (top - bottom)], axis=1), 0.0)
    end = np.array([0.0, 0.01, 0.04])
    inner = np.linspace(0, 1, min(order.detail.segments(2, least=2), MOST_DRUMS) + 1)[1:-1]
    share = np.concatenate([end, inner, 1 - end[::-1]])
    depth = np.concatenate([[0.0, 0.7, 1.0], np.ones_like(inner), [1.0, 0.7, 0.0]])
    across = order.detail.curve([-1.0, -0.55, 0.0, 0.55, 1.0], least=2)
    period = 2 * np.pi / order.flutes
    groove = 0.38 * period
    radius = _entasis(order.radius, share)
    height = bottom + share * (top - bottom)

    def strip(angle: Array, sunk: Array) -> Patch:
        r = radius[:, None] * (1 - depth[:, None] * sunk)
        points = np.stack([r * np.sin(angle), np.broadcast_to(height[:, None], r.shape), r * np.cos(angle)], axis=-1)
        return grid(points, smooth=True)

    flute = strip(groove * across, 0.8 * groove * np.sqrt(1 - across**2))
    fillet = strip(np.array([groove, period - groove]), np.zeros(2))
    return join([flute, fillet]).placed(turns=period * np.arange(order.flutes))


def _entasis(radius: float, share: Array) -> Array:
    """Radius of the shaft at a share of its height: the narrowing grows towards the top."""
    radii: Array = radius * (1 - NARROWING * share**1.8)
    return radii


def _capital(order: ColumnOrder, radius: float) -> Patch:
    height = order.capital
    detail = order.detail
    moulded = detail.shows(0.3)
    share = np.linspace(0, 1, detail.segments(4, least=2 if moulded else 1) + 1)
    lip = 0.72 * order.abacus
    swell = radius + (lip - radius) * share**2.6
    astragal = bead(radius, 0.11 * radius, -0.02 * height, 0.06 * height, points=4)
    low = 0.06 if moulded else 0.0
    bell = np.stack([swell, height * (low + (1 - low) * share)], axis=1)
    pieces = [order.turned(detail.curve(astragal, least=2), 0.0)] if moulded else []
    pieces.append(order.turned(bell))
    eighth = np.pi / 4 * np.arange(8)
    for row in range(min(order.leaf_rows, 1 + detail.shows(0.6)) if detail.shows(0.35) else 0):
        tall = height * (0.42 + 0.26 * row) if order.leaf_rows > 1 else 0.55 * height
        blade = _acanthus(bell, foot=0.05 * height, height=tall, width=0.63 * radius, curl=0.18 * height, detail=detail)
        pieces.append(blade.placed(turns=eighth + row * np.pi / 8))
    if moulded:
        scroll = _volute(radius, order.abacus, height, order.scroll_sides, detail)
        pieces.append(scroll.placed(turns=np.pi / 4 + np.pi / 2 * np.arange(4)))
    pieces.append(_abacus(order, bell[-1, 0]).placed((0, height, 0)))
    return join(pieces)


def _acanthus(bell: Array, *, foot: float, height: float, width: float, curl: float, detail: Detail) -> Patch:
    """A leaf that climbs the bell, swells at its lobes and curls outward at the tip."""
    rows, columns = detail.segments(6, least=3), 2 * detail.segments(2)
    along, across = np.meshgrid(np.linspace(0, 1, rows + 1) ** 0.85, np.linspace(-1, 1, columns + 1), indexing="ij")
    y = height * (1.12 * along - 0.24 * along**7)
    outline = (0.68 + 0.45 * along - 0.9 * along**6) * (1 + 0.16 * np.cos(6 * np.pi * along))
    distance = np.interp(y + foot, bell[:, 1], bell[:, 0]) + 0.025 + curl * along**3 - 0.018 * np.abs(across)
    angle = 0.5 * width * np.maximum(outline, 0.08) * across / distance
    distance += 0.007 * np.cos(3 * np.pi * across) * (1 - along**3)
    y = y + foot
    return grid(np.stack([distance * np.sin(angle), y, distance * np.cos(angle)], axis=-1), smooth=True)


def _volute(radius: float, abacus: float, height: float, sides: int, detail: Detail) -> Patch:
    """A stalk that rises from the bell and rolls up under the abacus's corner."""
    eye = np.array([1.12 * abacus, 0.80 * height])
    angle = np.pi - np.linspace(0, 3.2 * np.pi, detail.segments(11, least=6) + 1)
    coil = 0.17 * height * np.linspace(1, 0.22, len(angle))
    roll = eye + coil[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    share = np.linspace(0, 1, detail.segments(3), endpoint=False)[:, None]
    root = np.array([radius + 0.02, 0.45 * height])
    stalk = root + (roll[0] - root) * share ** [1.6, 1.0]
    line = np.concatenate([stalk, roll])
    length = arc_lengths(line)
    thickness = height * np.interp(length / length[-1], [0, 0.3, 1], [0.04, 0.065, 0.035])
    path = np.stack([np.zeros(len(line)), line[:, 1], line[:, 0]], axis=1)
    return tube(path, thickness, detail.segments(sides, least=3))


def _abacus(order: ColumnOrder, lip: float) -> Patch:
    half, tall = order.abacus, order.abacus_height
    inner = half - 0.25 * tall
    corners = ring_corners(inner, inner)
    circle = lathe([(lip, 0), (lip, 1)], order.around, turn=-np.pi / 4).vertices[: order.around + 1]
    square = np.array([(x, 0.0, z) for x, z in [*corners, corners[0]]])
    under = bridge(circle, square)
    edge = [(0.0, 0.0), (0.0, 0.4 * tall), (0.25 * tall, 0.6 * tall), (0.25 * tall, tall)]
    edge = edge if order.detail.shows(0.3) else [edge[0], edge[-1]]
    return join([under, mitred(edge, corners, closed=True), rim(half, order.bearing, tall)])


def pilaster(width: float, depth: float, height: float, detail: Detail = DRAWN) -> Patch:
    """Returns a pier against a wall: base mouldings, three faces and a moulded capital; no back, no top.

    Args:
        width: Of its face, metres; the pier is centred on x = 0.
        depth: How far it stands out from the wall at z = 0, metres.
        height: Metres.
        detail: Fineness; below 0.4 it has no mouldings.

    Returns:
        The patch.

    Example:
        >>> pilaster(0.44, 0.4, 3.4).vertices[:, 2].min()
        np.float64(0.0)
    """
    path = [(-width / 2, 0), (-width / 2, depth), (width / 2, depth), (width / 2, 0)]
    if not detail.shows(0.4):
        return mitred([(0, 0), (0, height)], path)
    stout = 0.11 * width
    foot = [(stout, 0), (stout, 0.25), (0.6 * stout, 0.29), (0.6 * stout, 0.33), (0, 0.40)]
    neck = height - 0.30
    shaft = [(0, 0.40), (0, neck)]
    head = [(0, neck), (0.3 * stout, neck), (0.3 * stout, neck + 0.04), (0, neck + 0.04), (0, neck + 0.12)]
    crown = [
        (0, neck + 0.12),
        (0.5 * stout, neck + 0.18),
        (0.8 * stout, neck + 0.2),
        (0.8 * stout, height),
        (0, height),
    ]
    return join([mitred(piece, path) for piece in (foot, shaft, head, crown)])


def baluster(height: float, radius: float, detail: Detail = DRAWN) -> Patch:
    """Returns a turned baluster between two square blocks; below a fineness of 0.35, a square post.

    Args:
        height: Metres.
        radius: Of the belly, metres.
        detail: Fineness of the turned part, which has eight segments around as drawn.

    Returns:
        The patch, without the hidden bottom and top.

    Example:
        >>> baluster(0.62, 0.075).triangle_count
        180
    """
    if not detail.shows(0.35):
        return box((1.4 * radius, height, 1.4 * radius), "-x +x -z +z")
    block = 0.11 * height
    side = 1.7 * radius
    bottom = box((side, block, side), "-x +x -z +z +y")
    top = box((side, block, side), "-x +x -z +z -y").placed((0, height - block, 0))
    y = np.array([0.0, 0.05, 0.10, 0.17, 0.30, 0.42, 0.58, 0.80, 0.89, 0.95, 1.0])
    r = np.array([0.72, 0.76, 0.58, 0.74, 1.0, 0.92, 0.62, 0.40, 0.42, 0.64, 0.6])
    profile = detail.curve(np.stack([radius * r, block + y * (height - 2 * block)], axis=1), least=4)
    turned = lathe(profile, detail.segments(8, least=5))
    return join([bottom, turned, top])
