"""Drapery, vases, plants and a fountain: what stands and hangs in the court.

Each function returns patches in a local frame: y up, the front towards +z, standing things with their foot at 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.atrium.orders import bead, hollow
from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import arc_lengths, bridge, grid, lathe, mitred, ring_corners, tube

__all__ = [
    "FOUNTAIN_RADIUS",
    "agave",
    "banner",
    "curtain",
    "fountain",
    "ivy_bud",
    "ivy_leaf_triangles",
    "ivy_leaves",
    "vase",
]


CREASED = 0.5
"""Fineness below which folds have too few facets to be shaded as smooth."""


def curtain(rng: np.random.Generator, width: float, height: float, tie: float, detail: Detail = DRAWN) -> Patch:
    """Returns half of a pair of curtains, drawn to the right by a tie.

    The cloth hangs from y = height and reaches from x = 0 to x = width at the top. Its folds are waves across the
    cloth that deepen where the cloth is gathered, w(y) being the share of the width that is left:
    z = a / sqrt(w) sin(phase), the phase running with the cloth and wandering slowly with height.

    Args:
        rng: Source of the folds' irregularity.
        width: Of the top, metres.
        height: Metres.
        tie: Height of the tie, metres.
        detail: Fineness; as drawn there are 15 rows of 36 cells.

    Returns:
        The patch, smooth unless its folds are too coarse for that.

    Example:
        >>> curtain(np.random.default_rng(0), 1.2, 3.0, tie=1.2).triangle_count
        1080
    """
    rows, columns = detail.segments(15, least=3), detail.segments(36, least=6)
    across, down = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1), indexing="xy")
    y = height * (1 - down)
    above = np.clip((y - tie) / (height - tie), 0, 1)
    below = np.clip((tie - y) / tie, 0, 1)
    share = np.where(y > tie, 0.22 + 0.78 * above**1.7, 0.22 + 0.13 * np.sin(0.5 * np.pi * below) ** 0.8)
    phase = 2 * np.pi * (5.5 * across + 0.35 * np.sin(2 * np.pi * (across + 0.6 * down + rng.random())))
    phase += 0.8 * np.sin(3 * down + 2 * np.pi * rng.random())
    uneven = 0.75 + 0.5 * rng.random(37).cumsum() % 1 * 0.4
    deep = 0.034 * share**-0.5 * np.interp(np.linspace(0, 36, columns + 1), np.arange(37), uneven)
    x = width * (1 - (1 - across) * share)
    z = deep * np.sin(phase) + 0.02 * np.sin(2 * np.pi * (down + across))
    y = y - 0.10 * (1 - across) * np.sin(np.pi * np.clip((height - y) / (height - tie), 0, 1)) * (y > tie)
    points = np.stack([x, y, z], axis=-1)[::-1]
    uv = np.stack([1.6 * width * across, height * (1 - down)], axis=-1)[::-1]
    return grid(points, smooth=detail.shows(CREASED), uv=uv)


def banner(
    rng: np.random.Generator, width: float, path: ArrayLike, sway: float = 0.06, detail: Detail = DRAWN
) -> Patch:
    """Returns a cloth that lies over things along a path and hangs free at its end.

    The path (z, y) runs from the hidden end over the edge and down. Ripples lift the cloth off the path, a little where
    it lies on stone and by up to 1.75 ``sway`` at the free end.

    Args:
        rng: Source of the ripples' irregularity.
        width: Metres.
        path: Points (z, y) in metres, shape (n, 2).
        sway: Scale of the ripples at the free end, metres.
        detail: Fineness; as drawn there are 19 rows of 25 cells.

    Returns:
        The patch, its visible side to the right of the path (the front, for a path that goes down); smooth unless its
        ripples are too coarse for that.

    Example:
        >>> banner(np.random.default_rng(0), 1.4, [(0, 1), (0.2, 1), (0.3, -1)]).triangle_count
        950
    """
    line = np.asarray(path, dtype=float)
    length = arc_lengths(line)
    s = np.linspace(0, length[-1], detail.segments(19, least=7) + 1)
    z, y = (np.interp(s, length, line[:, axis]) for axis in range(2))
    kernel = np.array([0.25, 0.5, 0.25])
    z[1:-1], y[1:-1] = np.convolve(z, kernel, "valid"), np.convolve(y, kernel, "valid")
    across = np.linspace(-1, 1, detail.segments(25, least=2) + 1)
    free = np.clip((s / length[-1] - 0.45) / 0.55, 0, 1)[:, None]
    offsets = 2 * np.pi * rng.random(3)
    ripple = 0.6 * np.sin(2.5 * np.pi * across + offsets[0] + 0.6 * free)
    ripple = ripple + 0.4 * np.sin(5.3 * np.pi * across + offsets[1] - 0.9 * free) + 0.25
    narrowing = 1 - 0.06 * free * (1 - np.cos(np.pi * across)) / 2
    hem = 0.05 * free**4 * np.cos(3 * np.pi * across + offsets[2])
    lift = sway * (0.1 + 0.9 * free**0.8) * (ripple + 0.75)
    away_z, away_y = -np.gradient(y), np.gradient(z)
    norm = np.hypot(away_z, away_y)
    points = np.stack(
        [
            width / 2 * across * narrowing,
            y[:, None] + hem + (away_y / norm)[:, None] * lift,
            z[:, None] + (away_z / norm)[:, None] * lift,
        ],
        axis=-1,
    )
    uv = np.stack(np.broadcast_arrays(width / 2 * across, -s[:, None]), axis=-1)
    return grid(points[::-1], smooth=detail.shows(CREASED), uv=uv[::-1])


def vase(detail: Detail = DRAWN) -> tuple[Patch, Patch]:
    """Returns a two-handled vase, 0.95 m tall, and the earth in it; below a fineness of 0.3 it has no handles.

    Example:
        >>> body, earth = vase()
        >>> round(float(body.vertices[:, 1].max()), 3)
        0.95
    """
    segments = detail.segments(18, least=5)
    foot = mitred([(0, 0), (0, 0.06)], ring_corners(0.17, 0.17), closed=True)
    slab = mitred([(0, 0.06), (-0.06, 0.06)], ring_corners(0.17, 0.17), closed=True)
    stem = [
        bead(0.11, 0.03, 0.06, 0.11, 4),
        hollow((0.11, 0.11), (0.075, 0.2), 0.025, 4),
        bead(0.075, 0.02, 0.2, 0.23, 4),
    ]
    y = np.array([0.23, 0.27, 0.34, 0.44, 0.54, 0.62, 0.69, 0.78, 0.85, 0.90])
    r = np.array([0.075, 0.14, 0.21, 0.265, 0.285, 0.27, 0.22, 0.17, 0.18, 0.215])
    belly = np.stack([r, y], axis=1)
    earth = lathe(detail.curve([(0.163, 0.835), (0.09, 0.855), (0.0, 0.86)]), segments)
    if not detail.shows(0.3):
        stand, mouth = [(0.12, 0.0), (0.075, 0.23)], [(0.215, 0.95), (0.16, 0.82)]
        outside = [(0.075, 0.23), (0.285, 0.56), (0.17, 0.78), (0.215, 0.95)]
        return join([lathe(piece, segments) for piece in (stand, outside, mouth)]), earth
    lip = bead(0.215, 0.025, 0.90, 0.95, 5)
    inside = np.array([(0.215, 0.95), (0.19, 0.91), (0.165, 0.86), (0.16, 0.82)])
    angle = np.linspace(1.15 * np.pi, -0.35 * np.pi, detail.segments(8, least=3) + 1)
    curve = np.array([0.27, 0.70]) + np.array([0.105, 0.13]) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    curve[0], curve[-1] = (0.178, 0.76), (0.262, 0.60)
    handle = tube(np.stack([curve[:, 0], curve[:, 1], 0 * angle], axis=1), 0.017, detail.segments(5, least=3))
    turned = [lathe(detail.curve(piece), segments) for piece in (*stem, belly, lip, inside)]
    return join([foot, slab, *turned, handle, handle.placed(turns=np.pi)]), earth


def agave(rng: np.random.Generator, blades: int = 26, height: float = 0.75, detail: Detail = DRAWN) -> Patch:
    """Returns a tuft of long folded blades that rise and bend outward from one root.

    Args:
        rng: Source of the blades' irregularity.
        blades: Number of blades.
        height: Length of the longest blade, metres.
        detail: Fineness along the blades, six segments as drawn.

    Returns:
        The patch; texture coordinates put the midrib at 0.5.

    Example:
        >>> agave(np.random.default_rng(0), blades=10).triangle_count
        220
    """
    along = np.linspace(0, 1, detail.segments(6, least=2) + 1)
    widths = np.array([0.6, 0.9, 1.0, 0.95, 0.75, 0.42, 0.0])
    width = 0.04 * (detail.curve(widths) if detail.shows(0.5) else np.interp(along, np.linspace(0, 1, 7), widths))
    pieces = []
    for i in range(blades):
        lean = 0.15 + 1.15 * (i / blades) + 0.1 * rng.standard_normal()
        length = height * (1 - 0.35 * i / blades) * (0.85 + 0.3 * rng.random())
        pitch = np.pi / 2 - lean * (0.35 + 1.25 * along)
        step = length / (len(along) - 1)
        out = 0.02 + np.concatenate([[0], np.cumsum(step * np.cos(pitch[:-1]))])
        up = np.concatenate([[0], np.cumsum(step * np.sin(pitch[:-1]))])
        side = np.array([1.0, 0.0, -1.0])
        points = np.stack(
            [
                side * width[:, None],
                up[:, None] + 0.35 * np.abs(side) * width[:, None],
                out[:, None] + 0.0 * side,
            ],
            axis=-1,
        )
        uv = np.stack(np.broadcast_arrays(0.5 - 0.5 * side, along[:, None]), axis=-1)
        pieces.append(grid(points[:, ::-1], smooth=True, uv=uv[:, ::-1]).placed(turns=2.4 * i + 0.3 * rng.random()))
    return join(pieces)


FOUNTAIN_RADIUS = 1.62
"""From the fountain's axis to the corners of its octagonal step, metres."""


def fountain(detail: Detail = DRAWN) -> tuple[Patch, Patch]:
    """Returns an octagonal basin with a bowl on a pedestal, about 2.3 m tall, and the water in both.

    Args:
        detail: Fineness; below 0.12 there is no bowl, below 0.5 it has no lobes.

    Returns:
        The stone and the water.

    Example:
        >>> stone, water = fountain()
        >>> round(float(stone.vertices[:, 1].max()), 2)
        2.3
    """
    step = [[(FOUNTAIN_RADIUS, 0), (FOUNTAIN_RADIUS, 0.13)], [(FOUNTAIN_RADIUS, 0.13), (1.30, 0.13)]]
    wall = [(1.30, 0.13), (1.30, 0.24), (1.24, 0.29), (1.24, 0.50), (1.30, 0.55), (1.34, 0.55), (1.34, 0.64)]
    inner = [(1.34, 0.64), (1.10, 0.64), (1.10, 0.46)]
    if not detail.shows(0.12):
        rim = [[(1.34, 0), (1.34, 0.64)], inner]
        around = lathe([(1.10, 0.5), (1.10, 0.6)], 8, turn=np.pi / 8).vertices[:8]
        pool = bridge(around[:4], around[:3:-1])
        return join([lathe(piece, 8, faceted=True, turn=np.pi / 8) for piece in rim]), pool
    octagon = [lathe(piece, 8, faceted=True, turn=np.pi / 8) for piece in (*step, wall, inner)]
    pedestal = [
        np.array([(0.30, 0.50), (0.30, 0.58)]),
        bead(0.28, 0.04, 0.58, 0.68),
        hollow((0.28, 0.68), (0.17, 0.86), 0.05),
        np.array([(0.17, 0.86), (0.20, 0.96), (0.21, 1.06), (0.185, 1.18), (0.13, 1.28), (0.115, 1.34)]),
        bead(0.115, 0.03, 1.34, 1.40),
        np.array([(0.13, 1.40), (0.34, 1.44), (0.52, 1.51), (0.62, 1.59), (0.66, 1.66)]),
        bead(0.66, 0.03, 1.66, 1.72),
        np.array([(0.66, 1.72), (0.61, 1.66), (0.57, 1.62)]),
    ]
    finial = [
        bead(0.11, 0.03, 1.60, 1.70),
        np.array([(0.10, 1.70), (0.065, 1.80), (0.06, 1.88), (0.09, 1.94)]),
        bead(0.09, 0.02, 1.94, 1.98),
        np.array([(0.09, 1.98), (0.125, 2.06), (0.12, 2.14), (0.075, 2.22), (0.03, 2.27), (0.0, 2.30)]),
    ]
    segments = detail.segments(28, least=6)
    if detail.shows(0.5):
        bowl = _gadrooned(detail.curve(pedestal[5], least=2), 20, 2 * detail.segments(2))
    else:
        bowl = lathe(detail.curve(pedestal[5], least=2), segments)
    plain = (*pedestal[:5], *pedestal[6:], *finial)
    turned = [bowl, *(lathe(detail.curve(piece, least=2), segments) for piece in plain)]
    pool = lathe([(1.10, 0.5), (0.30, 0.5)], 8, faceted=True, turn=np.pi / 8)
    brim = lathe([(0.59, 1.64), (0.11, 1.64)], segments, faceted=True)
    return join([*octagon, *turned]), join([pool, brim])


def _gadrooned(profile: Array, lobes: int, segments: int) -> Patch:
    """A turned bowl whose belly is ribbed by rounded lobes of an even number of segments."""
    share = arc_lengths(profile) / arc_lengths(profile)[-1]
    angle = np.linspace(0, 2 * np.pi, segments * lobes + 1)
    wave = np.abs(np.sin(angle * lobes / 2))
    radius = profile[:, :1] * (1 + 0.05 * np.sin(np.pi * share)[:, None] * wave)
    y = np.broadcast_to(profile[:, 1:], radius.shape)
    return grid(np.stack([radius * np.sin(angle), y, radius * np.cos(angle)], axis=-1), smooth=True)


LEAF_OUTLINE = np.array(
    [
        (0.0, 0.0, 0.0),
        (-0.42, 0.16, 0.16),
        (-0.5, -0.32, 0.1),
        (0.0, -1.0, -0.12),
        (0.5, -0.32, 0.1),
        (0.42, 0.16, 0.16),
    ]
)
"""Base, upper lobe, side, tip, side, upper lobe of an ivy leaf of length 1 that hangs down, folded along its midrib."""


def ivy_leaf_triangles(detail: Detail = DRAWN) -> int:
    """Returns the number of an ivy leaf's triangles: two lobes and two halves of the tip, or twice or four times that.

    Example:
        >>> ivy_leaf_triangles(), ivy_leaf_triangles(Detail(0.1)), ivy_leaf_triangles(Detail(9.0))
        (4, 4, 16)
    """
    return 4 * (1 + detail.shows(2.0) + 2 * detail.shows(4.0))


def ivy_leaves(roots: Array, turns: Array, tilts: Array, sizes: Array, detail: Detail = DRAWN) -> Patch:
    """Returns ivy leaves that hang from given points.

    Args:
        roots: Where the stems hold them, metres, shape (k, 3).
        turns: Directions they face, radians about y, shape (k).
        tilts: How far their tips are lifted from hanging straight down, radians, shape (k).
        sizes: Lengths, metres, shape (k).
        detail: Fineness of the outline; see :func:`ivy_leaf_triangles`.

    Returns:
        The leaves, flat triangles around the base; texture coordinates put the midrib at 0.5.

    Example:
        >>> ivy_leaves(np.zeros((2, 3)), np.zeros(2), np.zeros(2), np.full(2, 0.08)).triangle_count
        8
    """
    triangles = ivy_leaf_triangles(detail)
    lobes = [Detail(triangles / 4).curve(half) for half in (LEAF_OUTLINE[1:4], LEAF_OUTLINE[3:])]
    outline = np.concatenate([LEAF_OUTLINE[:1], lobes[0], lobes[1][1:]])
    tip = np.arange(1, triangles + 1)
    faces = np.stack([np.zeros_like(tip), tip, tip + 1], axis=1)
    cosine, sine = np.cos(tilts)[:, None], np.sin(tilts)[:, None]
    x, y, z = outline.T
    y, z = cosine * y + sine * z, -sine * y + cosine * z
    turn_cosine, turn_sine = np.cos(turns)[:, None], np.sin(turns)[:, None]
    local = np.stack([turn_cosine * x + turn_sine * z, y, -turn_sine * x + turn_cosine * z], axis=-1)
    vertices = (roots[:, None] + sizes[:, None, None] * local).reshape(-1, 3)
    numbers = faces + len(outline) * np.arange(len(roots))[:, None, None]
    uv = np.tile(np.stack([0.5 + outline[:, 0], 1 + outline[:, 1]], axis=1), (len(roots), 1))
    return Patch(vertices, numbers.reshape(-1, 3), uv, np.zeros_like(vertices))


def ivy_bud(root: ArrayLike, turn: float, size: float) -> Patch:
    """Returns a young leaf at a stem's end, still a single triangle.

    Example:
        >>> ivy_bud((0, 0, 0), 0.0, 0.03).triangle_count
        1
    """
    vertices = size * np.array([(-0.3, 0.0, 0.05), (0.0, -1.0, 0.1), (0.3, 0.0, 0.05)])
    uv = np.array([(0.2, 1.0), (0.5, 0.0), (0.8, 1.0)])
    return Patch(vertices, np.array([[0, 1, 2]]), uv, np.zeros((3, 3))).placed(root, turns=turn)
