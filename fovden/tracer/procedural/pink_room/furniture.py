"""Tables, the bookcase, picture frames: what is made of wood, in local frames with the front towards +z."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.pink_room.shell import curved
from fovden.tracer.procedural.pink_room.turning import disc, turned
from fovden.tracer.procedural.primitives import box, grid, lathe, mitred, quad, ring_corners

__all__ = ["CASE", "SHELVES", "bookcase", "coffee_table", "painting", "tablecloth"]

CASE = (1.86, 2.42, 0.34)
"""Width, height and depth of the bookcase, metres."""

SHELVES = (0.12, 0.56, 0.93, 1.29, 1.65, 2.0)
"""Heights of the tops of the bookcase's shelves, metres."""

BOARD = 0.026
"""Thickness of a shelf, metres."""


def _upright(patch: Patch) -> Patch:
    """The patch with its texture's grain along x instead of y."""
    return Patch(patch.vertices, patch.faces, patch.uv[:, ::-1], patch.normals)


def bookcase(detail: Detail) -> Patch:
    """Returns the bookcase, its back at z = 0: two bays of shelves between fluted posts, with plinth and cornice.

    Example:
        >>> bookcase(Detail()).triangle_count > 300
        True
    """
    width, height, depth = CASE
    half = width / 2
    back = quad((-half, 0.12, 0.012), (half, 0.12, 0.012), (half, height, 0.012), (-half, height, 0.012))
    side = box((BOARD, height, depth), "-x +x").placed(
        [(-half + BOARD / 2, 0.001, depth / 2), (half - BOARD / 2, 0.001, depth / 2)]
    )
    middle = box((BOARD, height - 0.15, depth - 0.02), "-x +x +z").placed((0, 0.12, depth / 2 - 0.01))
    bay = half - 1.5 * BOARD
    shelves = []
    for y in SHELVES:
        board = _upright(box((bay, BOARD, depth - 0.025), "-y +y"))
        lip = curved([(0.0, 0.0), (0.007, 0.006), (0.007, 0.02), (0.0, BOARD)], detail, 2)
        edge = grid(
            np.stack(
                [np.column_stack([np.full(len(lip), x), lip[:, 1], lip[:, 0]]) for x in (-bay / 2, bay / 2)], axis=1
            ),
            smooth=True,
        )
        both = join([board.placed((0, 0, (depth - 0.025) / 2)), _upright(edge).placed((0, 0, depth - 0.025))])
        shelves.append(both.placed([(-half / 2, y - BOARD, 0), (half / 2, y - BOARD, 0)]))
    path = [(-half, 0.0), (-half, depth), (half, depth), (half, 0.0)]
    plinth = mitred([(0.012, 0.001), (0.012, 0.075), (0.004, 0.088), (0.0, 0.095)], path)
    crown = curved([(0.0, -0.10), (0.008, -0.085), (0.008, -0.06), (0.03, -0.035), (0.05, -0.03), (0.058, 0.0)], detail)
    cornice = mitred(crown, path, smooth=True).placed((0, height, 0))
    lid = _upright(
        quad(
            (-half - 0.058, height, depth + 0.058),
            (half + 0.058, height, depth + 0.058),
            (half + 0.058, height, 0),
            (-half - 0.058, height, 0),
        )
    )
    posts = [_post(height - 0.20, detail).placed((x, 0.095, depth)) for x in (-half + 0.028, 0.0, half - 0.028)]
    roof = quad(
        (-half, height - 0.1, 0.012),
        (half, height - 0.1, 0.012),
        (half, height - 0.1, depth - 0.001),
        (-half, height - 0.1, depth - 0.001),
    )
    apron = quad(
        (-half, height - 0.15, depth - 0.001),
        (half, height - 0.15, depth - 0.001),
        (half, height - 0.1, depth - 0.001),
        (-half, height - 0.1, depth - 0.001),
    )
    return join([back, side, middle, *shelves, plinth, cornice, lid, *posts, _upright(apron), _upright(roof)])


def _post(height: float, detail: Detail) -> Patch:
    """A fluted strip on the edge of a side, its back at z = 0."""
    count = 3 if detail.shows(0.3) else 0
    angle = np.linspace(0, np.pi, detail.segments(6, least=1) + 1)
    x, z = [-0.028, -0.028], [0.0, 0.012]
    for k in range(count):
        middle = (k - 1) * 0.017
        x += list(middle - 0.006 * np.cos(angle))
        z += list(0.012 - 0.006 * np.sin(angle))
    x, z = [*x, 0.028, 0.028], [*z, 0.012, 0.0]
    points = np.stack([np.column_stack([x, np.full(len(x), y), z]) for y in (0.0, height)])
    return grid(points)


def coffee_table(detail: Detail) -> tuple[Patch, Patch]:
    """Returns a low table: its wood (turned legs, aprons, a slatted shelf) and its marble top.

    Example:
        >>> wood, marble = coffee_table(Detail())
        >>> round(float(marble.vertices[:, 1].max()), 3)
        0.455
    """
    x, z, top = 0.56, 0.34, 0.43
    leg = [(0.014, 0.001), (0.026, 0.012), (0.016, 0.03), (0.03, 0.05), (0.033, 0.062), (0.02, 0.075), (0.017, 0.09)]
    leg += [(0.022, 0.14), (0.034, 0.21), (0.022, 0.27), (0.018, 0.285), (0.032, 0.30), (0.018, 0.315), (0.03, 0.335)]
    places = [(sx * (x - 0.06), 0, sz * (z - 0.06)) for sx in (-1, 1) for sz in (-1, 1)]
    block = box((0.06, 0.095, 0.06), "-x +x -y -z +z").placed((0, 0.335, 0))
    wood = [turned(leg, detail, 24).placed(places), block.placed(places)]
    apron = mitred(
        [(0.0, 0.36), (0.004, 0.364), (0.004, 0.40), (0.0, 0.43)], ring_corners(x - 0.05, z - 0.05), closed=True
    )
    slat = _upright(box((2 * x - 0.14, 0.014, 0.05), "-y +y -z +z -x +x")).placed(
        [(0, 0.075, at) for at in np.linspace(-0.22, 0.22, 7)]
    )
    edge = curved([(-0.012, -0.0), (0.0, 0.008), (0.002, 0.016), (-0.012, 0.025)], detail)
    ring = ring_corners(x, z)
    rim = mitred(edge, ring, closed=True, smooth=True).placed((0, top, 0))
    plane = quad(
        (-x + 0.012, top + 0.025, z - 0.012),
        (x - 0.012, top + 0.025, z - 0.012),
        (x - 0.012, top + 0.025, -z + 0.012),
        (-x + 0.012, top + 0.025, -z + 0.012),
    )
    under = quad(
        (-x + 0.012, top, -z + 0.012),
        (x - 0.012, top, -z + 0.012),
        (x - 0.012, top, z - 0.012),
        (-x + 0.012, top, z - 0.012),
    )
    return join([*wood, apron, slat]), join([rim, plane, under])


def tablecloth(rng: np.random.Generator, radius: float, height: float, detail: Detail) -> tuple[Patch, Patch]:
    """Returns a cloth on a round table that falls in folds almost to the floor, and the beads along its hem.

    Args:
        rng: Source of the folds' irregularity.
        radius: Of the table, metres.
        height: Of its top, metres.
        detail: Fineness.

    Returns:
        Cloth and beads.

    Example:
        >>> cloth, beads = tablecloth(np.random.default_rng(0), 0.34, 0.7, Detail(0.5))
        >>> bool(0.0 < cloth.vertices[:, 1].min() < 0.03)
        True
    """
    detail = detail.at_most(1.5)  # the two ends of its flat top would be slivers beyond
    columns = detail.segments(224, least=8) + 1
    around = np.linspace(0, 2 * np.pi, columns)
    around[-1] = 0.0
    rows = detail.at_most(1.2).segments(60, least=2)
    s = np.linspace(0, 1, rows + 1)[:, None]
    phase = 2 * np.pi * rng.random(3)
    wave = np.sin(13 * around + phase[0] + 0.9 * np.sin(2 * around + phase[1]) + 0.25 * s) + 0.3 * np.sin(
        26 * around + phase[2]
    )
    wave += 0.25 * np.sin(5 * around + phase[1])
    fall = height - 0.035
    r = radius + 0.012 + 0.055 * s**0.6 + (0.006 + 0.052 * s**1.1) * np.clip(wave, -1.3, 1.6) * np.clip(5 * s, 0, 1)
    y = height - 0.012 - fall * s + 0.008 * np.sin(6.5 * around + phase[0]) * s
    side = np.stack([r * np.sin(around), y + 0 * r, r * np.cos(around)], axis=-1)[::-1]
    bend = np.linspace(0, np.pi / 2, detail.segments(4, least=1) + 1)[::-1, None]
    lip = radius + 0.012 * np.sin(bend)
    over = np.stack(
        [lip * np.sin(around), height - 0.012 + 0.012 * np.cos(bend) + 0 * around, lip * np.cos(around)], axis=-1
    )
    length = radius * around[None, :] + 0 * r
    length[:, -1] = 2 * np.pi * radius
    whole = np.concatenate([side, over[1:]])
    v = np.concatenate([np.linspace(0, fall, rows + 1), fall + 0.012 * (1 + np.arange(len(over) - 1))])
    uv = np.stack(np.broadcast_arrays(length[:1], v[:, None]), axis=-1)
    cloth = grid(whole, smooth=True, uv=uv)
    flat = disc(radius, height, columns - 1)
    bead = lathe([(0.0, -0.013), (0.0055, -0.008), (0.0055, -0.003), (0.0, 0.0)], 5)
    hem = side[0][:-1:2]
    return join([cloth, flat]), bead.placed(hem)


def painting(width: float, height: float, detail: Detail) -> tuple[Patch, Patch]:
    """Returns a gilt frame around a canvas, hung with its back at z = 0.004.

    Args:
        width: Of the canvas, metres.
        height: Of the canvas, metres.
        detail: Fineness.

    Returns:
        Frame and canvas; the canvas shows its image once.

    Example:
        >>> frame, canvas = painting(0.8, 0.6, Detail())
        >>> canvas.uv.min(), canvas.uv.max()
        (np.float64(0.0), np.float64(1.0))
    """
    profile = [
        (0.085, 0.0),
        (0.085, 0.018),
        (0.076, 0.030),
        (0.06, 0.034),
        (0.05, 0.022),
        (0.03, 0.018),
        (0.018, 0.026),
    ]
    section = curved([*profile, (0.008, 0.024), (0.0, 0.012)], detail)
    frame = mitred(section, ring_corners(width / 2, height / 2), closed=True, smooth=True).standing()
    x, y = width / 2, height / 2
    canvas = quad((-x, -y, 0.012), (x, -y, 0.012), (x, y, 0.012), (-x, y, 0.012))
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    return frame.placed((0, 0, 0.004)), Patch(canvas.vertices, canvas.faces, corners, canvas.normals).placed(
        (0, 0, 0.004)
    )
