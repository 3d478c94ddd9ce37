"""Arches, vaults, walls and what is set into them.

Each function returns patches in a local frame: x along the wall, y up, the front towards +z. Arches and vaults measure
heights from their springing. Surfaces share their edges: an arch's intrados, the face above it and the vault behind it
meet in the same points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import WELD, Array, Patch, join
from fovden.tracer.procedural.primitives import box, bridge, grid, mitred, quad, ring_corners

__all__ = [
    "ArchShape",
    "archivolt",
    "crescent",
    "dentils",
    "door_leaf",
    "groin_vault",
    "intrados",
    "louvres",
    "lunette",
    "spandrel",
    "wall_with_opening",
]


@dataclass(frozen=True)
class ArchShape:
    """Measures of a round arch built of wedge-shaped stones, in metres.

    Attributes:
        radius: Inner radius.
        outer: Outer radius of the moulding around the arch.
        thickness: Of the wall.
        voussoirs: Number of stones; odd, so that one is the keystone.
        groove: Width and depth of the bevel along the joints.
        detail: Fineness of the curve; below 0.5 there are no joints.

    Example:
        >>> ArchShape().voussoirs
        11
    """

    radius: float = 1.2
    outer: float = 1.37
    thickness: float = 0.44
    voussoirs: int = 11
    groove: float = 0.012
    detail: Detail = DRAWN

    @property
    def angles(self) -> Array:
        """Angles at which the arch has points, from the left springing (pi) to the right one (0).

        A stone has two bevels and an even number of segments between them, which is two as drawn.
        """
        if not self.detail.shows(0.5):
            return np.linspace(np.pi, 0, 2 * self.detail.segments(2 * self.voussoirs, least=2) + 1)
        period = np.pi / self.voussoirs
        bevel = self.groove / self.radius
        face = np.linspace(bevel, period - bevel, 2 * self.detail.segments(1) + 1)
        stone = np.concatenate([[0.0], face])
        return np.pi - np.append((period * np.arange(self.voussoirs)[:, None] + stone).reshape(-1), np.pi)

    @property
    def sunk(self) -> Array:
        """How deep the joints' bevel lies at each of the angles: the groove at a joint, 0 on a stone's face."""
        sunk = np.zeros(len(self.angles))
        if self.detail.shows(0.5):
            period = len(sunk) // self.voussoirs
            sunk[period:-1:period] = self.groove
        return sunk

    def curve(self, radius: float, z: Array | float, grooved: float = 0.0) -> Array:
        """Returns points around the arch; ``grooved`` widens the radius at the joints by that share of the groove.

        Example:
            >>> ArchShape().curve(1.0, 0.5).shape
            (45, 3)
        """
        r = radius + grooved * self.sunk
        return np.stack(np.broadcast_arrays(r * np.cos(self.angles), r * np.sin(self.angles), z), axis=-1)


def intrados(shape: ArchShape, *, both_fronts: bool = True) -> Patch:
    """Returns the underside of an arch, with a bevel at each joint.

    Args:
        shape: The arch.
        both_fronts: Whether the edge at +z is bevelled too, to meet :func:`archivolt`.

    Returns:
        The patch, visible from below.

    Example:
        >>> intrados(ArchShape()).triangle_count
        88
    """
    half = shape.thickness / 2
    front = half - (shape.sunk if both_fronts else 0.0)
    back, fore = shape.curve(shape.radius, -half, 1.0), shape.curve(shape.radius, front, 1.0)
    return grid(np.stack([back, fore]))


def archivolt(shape: ArchShape) -> Patch:
    """Returns the front of an arch: the stones' faces with bevelled joints, and a moulding around them.

    Example:
        >>> archivolt(ArchShape()).triangle_count
        528
    """
    half = shape.thickness / 2
    middle = shape.radius + 0.52 * (shape.outer - shape.radius)
    inner, face = shape.curve(shape.radius, half - shape.sunk, 1.0), shape.curve(middle, half - shape.sunk)
    stones = grid(np.stack([inner, face]))
    step = grid(np.stack([face, shape.curve(middle, half + 0.03)]))
    width = shape.outer - middle
    section = [(0.0, 0.03), (0.25, 0.055), (0.55, 0.055), (0.8, 0.025), (1.0, 0.0)]
    section = shape.detail.at_most(3.0).curve(section, least=2).tolist()
    moulding = grid(np.stack([shape.curve(middle + width * w, half + z) for w, z in section]), smooth=True)
    return join([stones, step, moulding])


def spandrel(shape: ArchShape, left: float, right: float, top: float) -> Patch:
    """Returns the wall's front above the archivolt: from x = -left to x = right, up to y = top.

    Example:
        >>> import math
        >>> shape = ArchShape()
        >>> area = spandrel(shape, 1.6, 1.6, 1.55).area
        >>> abs(area - (3.2 * 1.55 - math.pi * shape.outer**2 / 2)) < 0.01
        True
    """
    z = shape.thickness / 2
    arc = shape.curve(shape.outer, z)
    crown = len(arc) // 2
    start, end = (np.array([(x, 0, z)]) if abs(x) > shape.outer + WELD else np.empty((0, 3)) for x in (-left, right))
    left_fan = bridge(np.concatenate([start, arc[: crown + 1]]), [(-left, top, z)])
    right_fan = bridge(np.concatenate([arc[crown:], end]), [(right, top, z)])
    cap = bridge([arc[crown]], [(-left, top, z), (right, top, z)])
    return join([left_fan, cap, right_fan])


def crescent(shape: ArchShape, left: float, right: float, rise: float, segments: int = 24) -> Patch:
    """Returns the wall between an arch and the vault behind it: from the intrados to the vault's half ellipse.

    Args:
        shape: The arch.
        left: Distance from the middle to the vault's left springing, metres.
        right: The same to the right.
        rise: Height of the vault's crown above the springing, metres.
        segments: Segments of the half ellipse.

    Returns:
        The flat patch on the plane z = thickness / 2, facing +z.

    Example:
        >>> crescent(ArchShape(), 1.38, 1.38, 1.5).triangle_count
        68
    """
    z = shape.thickness / 2
    return bridge(shape.curve(shape.radius, z, 1.0), _half_ellipse(left, right, rise, z, segments))


def _half_ellipse(left: float, right: float, rise: float, z: float, segments: int) -> Array:
    angle = np.linspace(np.pi, 0, segments + 1)
    x = (right - left) / 2 + (right + left) / 2 * np.cos(angle)
    y = rise * np.sin(angle)
    y[[0, -1]] = 0.0
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def lunette(left: float, right: float, rise: float, segments: int = 24) -> Patch:
    """Returns the half-elliptic wall under a vault's edge, on the plane z = 0.

    Example:
        >>> round(lunette(1.5, 1.5, 1.5, segments=200).area, 2)
        3.53
    """
    arc = _half_ellipse(left, right, rise, 0.0, segments)
    return bridge([arc[0], arc[-1]], arc[1:-1])


def groin_vault(x: tuple[float, float], z: tuple[float, float], rise: float, segments: int = 24) -> Patch:
    """Returns a cross vault over a rectangle: four cells of two elliptic barrels that meet in the groins.

    The ceiling is the higher of the two barrels, y = rise max(sqrt(1 - u^2), sqrt(1 - w^2)), with u and w from -1 to 1
    across the rectangle. Each cell is straight along its barrel, so strips from edge to groin describe it exactly.

    Args:
        x: Extent along x, metres.
        z: Extent along z, metres.
        rise: Height of the crown above the springing, metres.
        segments: Segments along each edge.

    Returns:
        The four cells, visible from below.

    Example:
        >>> groin_vault((-1, 1), (-1, 1), 1.0, segments=24).triangle_count
        184
    """
    angle = np.linspace(np.pi, 0, segments + 1)
    u, height = np.cos(angle), rise * np.sin(angle)
    u[segments // 2], height[[0, -1]] = 0.0, 0.0
    cells = []
    for along in (True, False):
        for side in (-1.0, 1.0):
            across = np.stack([np.full_like(u, side), side * np.abs(u)])
            first, second = (np.broadcast_to(u, across.shape), across) if along else (across, u + 0 * across)
            centre_x, centre_z = sum(x) / 2, sum(z) / 2
            points = np.stack(
                [
                    centre_x + (x[1] - x[0]) / 2 * first,
                    np.broadcast_to(height, across.shape),
                    centre_z + (z[1] - z[0]) / 2 * second,
                ],
                axis=-1,
            )
            length = np.linspace(0, np.pi / 2 * rise, segments + 1)
            uv = np.stack([points[..., 0 if along else 2], points[..., 2 if along else 0]], axis=-1)
            uv[..., 0] = length
            cell = grid(points, smooth=True, uv=uv)
            cells.append(cell if (side < 0) == along else cell.reversed())
    return join(cells)


def wall_with_opening(
    left: float, right: float, height: float, opening: tuple[float, float, float, float], reveal: float
) -> Patch:
    """Returns a wall on the plane z = 0 with a rectangular opening and the opening's sides going back.

    Args:
        left: Distance from x = 0 to the wall's left end, metres.
        right: The same to the right.
        height: Of the wall, metres.
        opening: Its extent (x0, x1, y0, y1); y0 = 0 for a door, whose sill lies on the floor.
        reveal: Depth of the opening's sides, metres.

    Returns:
        The patch.

    Example:
        >>> round(wall_with_opening(1, 1, 3, (-0.5, 0.5, 0.0, 2.0), reveal=0.2).area, 9)
        5.2
    """
    x0, x1, y0, y1 = opening
    outline = [(-left, 0, 0), (-left, height, 0), (right, height, 0), (right, 0, 0)]
    edge = [(x0, y0, 0), (x0, y1, 0), (x1, y1, 0), (x1, y0, 0)]
    if y0 > 0:
        outline, edge = [*outline, outline[0]], [*edge, edge[0]]
    back = -reveal
    sides = [
        quad((x0, y0, 0), (x0, y0, back), (x0, y1, back), (x0, y1, 0)),
        quad((x1, y0, back), (x1, y0, 0), (x1, y1, 0), (x1, y1, back)),
        quad((x0, y1, 0), (x0, y1, back), (x1, y1, back), (x1, y1, 0)),
        quad((x0, y0, back), (x0, y0, 0), (x1, y0, 0), (x1, y0, back)),
    ]
    return join([bridge(outline, edge).reversed(), *sides])


def _panel(x0: float, x1: float, y0: float, y1: float, z: float = 0.0) -> Patch:
    return quad((x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z))


def door_leaf(width: float, height: float, panels: Sequence[float]) -> Patch:
    """Returns a door leaf: stiles and rails around raised panels, or a plain board if there are none.

    It is centred on x = 0, its face at z = 0.

    Args:
        width: Metres.
        height: Metres.
        panels: Relative heights of the panels from the bottom up.

    Returns:
        The patch.

    Example:
        >>> door_leaf(0.7, 2.5, (1, 2, 1)).triangle_count
        66
    """
    stile = 0.14 * width
    half = width / 2
    if not panels:
        return _panel(-half, half, 0, height)
    inner = half - stile
    pieces = [_panel(-half, -inner, 0, height), _panel(inner, half, 0, height)]
    share = (height - stile * (len(panels) + 1)) * np.asarray(panels, float) / sum(panels)
    y = 0.0
    for tall in share:
        pieces.append(_panel(-inner, inner, y, y + stile))
        middle = y + stile + tall / 2
        bevel = [(0, 0), (-0.02, -0.02), (-0.07, -0.004)]
        field = mitred(bevel, ring_corners(inner, tall / 2), closed=True).standing()
        face = _panel(-inner + 0.07, inner - 0.07, -tall / 2 + 0.07, tall / 2 - 0.07, -0.004)
        pieces += [field.placed((0, middle, 0)), face.placed((0, middle, 0))]
        y += stile + tall
    pieces.append(_panel(-inner, inner, y, height))
    return join(pieces)


def louvres(width: float, height: float, slats: int) -> Patch:
    """Returns a shutter leaf, centred on x = 0: slanting slats, as one folded sheet, between two posts.

    Example:
        >>> louvres(0.5, 1.9, slats=14).triangle_count
        66
    """
    post = 0.04
    posts = box((post, height, 0.05), "-x +x +z").placed([(side * (width - post) / 2, 0, -0.02) for side in (-1, 1)])
    width -= 2 * post
    y = np.linspace(0, height, slats + 1)
    lower = np.stack([y[:-1], np.full(slats, 0.0)], axis=1)
    upper = np.stack([y[1:], np.full(slats, -0.035)], axis=1)
    fold = np.stack([lower, upper], axis=1).reshape(-1, 2)
    points = np.stack(
        [np.stack([np.full(len(fold), side * width / 2), fold[:, 0], fold[:, 1]], axis=1) for side in (-1, 1)], axis=1
    )
    return join([grid(points), posts])


def dentils(start: float, end: float, size: tuple[float, float, float], gap: float) -> Patch:
    """Returns a row of dentils along x: small blocks that hang under a cornice, without backs and tops.

    Args:
        start: Where the row begins, metres.
        end: Where it ends.
        size: Width, height and depth of a block; it reaches from z = 0 to z = depth.
        gap: Smallest distance between blocks, metres.

    Returns:
        The blocks, evenly spread.

    Example:
        >>> dentils(0, 1, (0.1, 0.1, 0.05), gap=0.1).triangle_count
        40
    """
    count = int((end - start) / (size[0] + gap))
    spacing = (end - start) / count
    block = box(size, "-x +x -y +z").placed((0, 0, size[2] / 2))
    x = start + spacing * (np.arange(count) + 0.5)
    return block.placed(np.stack([x, np.zeros(count), np.zeros(count)], axis=1))
