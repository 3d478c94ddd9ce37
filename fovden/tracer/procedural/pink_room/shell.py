"""The room's shell: panelling, wallpaper, mouldings, the ceiling with its rose, and the door."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fovden.tracer.procedural.atrium.arcade import door_leaf, wall_with_opening
from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.pink_room.forms import stretched
from fovden.tracer.procedural.pink_room.plan import CHAIR_RAIL, CORNICE, DOOR, HALF_X, HALF_Z, HEIGHT, ROSE, WINDOW
from fovden.tracer.procedural.pink_room.turning import ball, bent, turned
from fovden.tracer.procedural.primitives import box, bridge, grid, mitred, quad, ring_corners

__all__ = ["curved", "shell"]

SKIRTING = [(0.012, 0.0), (0.028, 0.0), (0.028, 0.095), (0.02, 0.108), (0.024, 0.12), (0.016, 0.137), (0.0, 0.145)]
RAIL = [(0.0, -0.035), (0.012, -0.026), (0.014, -0.014), (0.034, 0.0), (0.034, 0.014), (0.02, 0.022), (0.0, 0.03)]

CASING = 0.09
"""Width of the moulding around window and door, metres."""


def curved(profile: list[tuple[float, float]], detail: Detail, drawn: int = 3) -> Array:
    """Returns a moulding's profile with rounded steps: a Catmull-Rom curve through its points.

    Args:
        profile: Points (o, y), metres.
        detail: Fineness; where it is coarse, the points are left as they are.
        drawn: Pieces between two points at fineness 1.

    Returns:
        Points, shape (m, 2).

    Example:
        >>> len(curved([(0, 0), (0.1, 0.1), (0, 0.2)], Detail()))
        5
    """
    points = np.asarray(profile, dtype=float)
    count = detail.segments(drawn)
    padded = np.concatenate([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])
    s = np.arange(count)[:, None] / count
    pieces = []
    for i in range(1, len(padded) - 2):
        before, a, b, after = padded[i - 1 : i + 3]
        ends = (1 + 2 * s) * (1 - s) ** 2 * a + s**2 * (3 - 2 * s) * b
        pieces.append(ends + s * (1 - s) ** 2 * (b - before) / 2 - s**2 * (1 - s) * (after - a) / 2)
    return bent(np.concatenate([*pieces, points[-1:]]))


def shell(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Yields walls, mouldings, door and ceiling, each with the name of its surface.

    Example:
        >>> {surface for surface, _ in shell(Detail())} >= {"wallpaper", "painted wood", "plaster"}
        True
    """
    x0, x1, y0, y1 = WINDOW
    paper = [
        wall_with_opening(HALF_Z, HALF_Z, CORNICE + 0.06 - CHAIR_RAIL, (x0, x1, y0 - CHAIR_RAIL, y1 - CHAIR_RAIL), 0.24)
        .placed((0, CHAIR_RAIL, 0))
        .placed((-HALF_X, 0, 0), turns=np.pi / 2),
        _panel(-HALF_X, HALF_X, CHAIR_RAIL, CORNICE + 0.06).placed((0, 0, -HALF_Z)),
        _panel(-HALF_Z, HALF_Z, CHAIR_RAIL, CORNICE + 0.06).placed((HALF_X, 0, 0), turns=-np.pi / 2),
        _door_wall().placed((0, 0, HALF_Z), turns=np.pi),
    ]
    yield "wallpaper", join(paper)
    x, z = HALF_X, HALF_Z
    yield "plaster", quad((-x, HEIGHT, -z), (x, HEIGHT, -z), (x, HEIGHT, z), (-x, HEIGHT, z))
    yield "painted wood", join(list(_dado(detail)))
    yield "painted wood", join(list(_around_the_room(detail)))
    yield "painted wood", _door(detail)
    yield "brass", _handle(detail)
    yield "plaster", _cornice(detail)
    if detail.shows(0.1):
        yield "plaster", _rose(detail).placed(ROSE)


def _panel(x0: float, x1: float, y0: float, y1: float, z: float = 0.0) -> Patch:
    return quad((x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z))


def _door_wall() -> Patch:
    """The paper around the upper part of the door, in the wall's own frame."""
    left, right, top = DOOR
    high = CORNICE + 0.06
    outline = [(-HALF_X, CHAIR_RAIL, 0), (-HALF_X, high, 0), (HALF_X, high, 0), (HALF_X, CHAIR_RAIL, 0)]
    opening = [(left, CHAIR_RAIL, 0), (left, top, 0), (right, top, 0), (right, CHAIR_RAIL, 0)]
    return bridge(outline, opening).reversed()


def _walls() -> list[tuple[float, float, tuple[float, float], tuple[tuple[float, float], ...]]]:
    """Turn, distance, half length and stretches without a door, for each wall in its own frame."""
    return [
        (0.0, HALF_Z, (-HALF_X, HALF_X), ((-HALF_X, HALF_X),)),
        (np.pi / 2, HALF_X, (-HALF_Z, HALF_Z), ((-HALF_Z, HALF_Z),)),
        (-np.pi / 2, HALF_X, (-HALF_Z, HALF_Z), ((-HALF_Z, HALF_Z),)),
        (np.pi, HALF_Z, (-HALF_X, HALF_X), ((-HALF_X, DOOR[0] - CASING), (DOOR[1] + CASING, HALF_X))),
    ]


def _dado(detail: Detail) -> Iterator[Patch]:
    """Panelling below the chair rail: raised fields in a frame of stiles and rails."""
    stile, low, high = 0.09, 0.145, CHAIR_RAIL - 0.03
    for turn, distance, _, stretches in _walls():
        for start, end in stretches:
            count = max(1, round((end - start) / 0.72))
            edges = np.linspace(start, end, count + 1)
            if not detail.shows(0.1):
                yield _panel(start, end, 0.0, CHAIR_RAIL).placed((0, 0, -distance)).placed(turns=turn)
                continue
            left = edges[:-1] + np.where(np.arange(count) == 0, stile, stile / 2)
            right = edges[1:] - np.where(np.arange(count) == count - 1, stile, stile / 2)
            y0, y1 = low + stile, high - stile
            corners = np.stack([left, right], axis=1).reshape(-1)
            inner = [np.column_stack([corners, np.full(2 * count, y), 0 * corners]) for y in (y0, y1)]
            pieces = [bridge([(start, 0, 0), (end, 0, 0)], inner[0])]
            pieces.append(bridge(inner[1], [(start, CHAIR_RAIL, 0), (end, CHAIR_RAIL, 0)]))
            pieces.append(bridge([inner[1][0], inner[0][0]], [(start, CHAIR_RAIL, 0), (start, 0, 0)]).reversed())
            pieces.append(bridge([inner[0][-1], inner[1][-1]], [(end, 0, 0), (end, CHAIR_RAIL, 0)]).reversed())
            pieces += [_panel(*ends, y0, y1) for ends in zip(right[:-1], left[1:], strict=True)]
            pieces += [_field(*ends, y0, y1, detail) for ends in zip(left, right, strict=True)]
            yield join(pieces).placed((0, 0, -distance)).placed(turns=turn)


def _field(x0: float, x1: float, y0: float, y1: float, detail: Detail) -> Patch:
    """A raised field within a sunk moulding."""
    half_x, half_y = (x1 - x0) / 2, (y1 - y0) / 2
    ogee = curved([(0, 0), (-0.006, 0.007), (-0.016, -0.004), (-0.024, -0.012)], detail)
    slope = [(-0.024, -0.012), (-0.085, 0.001)]
    corners = ring_corners(half_x, half_y)
    frame = join([mitred(ogee, corners, closed=True, smooth=True), mitred(slope, corners, closed=True)]).standing()
    face = _panel(-half_x + 0.085, half_x - 0.085, -half_y + 0.085, half_y - 0.085, 0.001)
    return join([frame, face]).placed(((x0 + x1) / 2, (y0 + y1) / 2, 0))


def _inner_path() -> list[tuple[float, float]]:
    return ring_corners(HALF_X, HALF_Z)


def _around_the_room(detail: Detail) -> Iterator[Patch]:
    """Skirting and chair rail; both stop at the door, whose casing they meet."""
    x, z, gap = HALF_X, HALF_Z, DOOR[1] + CASING
    path = [(-gap, z), (-x, z), (-x, -z), (x, -z), (x, z), (gap, z)]
    rail = mitred(curved(RAIL, detail, 2), path, outward=True).placed((0, CHAIR_RAIL, 0))
    yield mitred(SKIRTING[1:], path)
    if detail.shows(0.06):
        yield rail


def _door(detail: Detail) -> Patch:
    """The leaf in its casing, in the front wall."""
    left, right, top = DOOR
    width = right - left
    leaf = door_leaf(width, top, (1.2, 0.6, 1.6)) if detail.shows(0.08) else _panel(left, right, 0, top)
    casing = [(0.0, 0.0), (0.0, 0.03), (0.02, 0.034), (0.045, 0.026), (0.062, 0.038), (0.08, 0.034), (CASING, 0.0)]
    section = np.array(casing)
    path = [(right, 0.0), (right, -top), (left, -top), (left, 0.0)]
    moulding = mitred(section[::-1], path).standing()
    reveal = [
        quad((left, 0, 0.0), (right, 0, 0.0), (right, 0, -0.02), (left, 0, -0.02)),
        quad((left, 0, -0.02), (left, 0, 0.0), (left, top, 0.0), (left, top, -0.02)).reversed(),
        quad((right, 0, -0.02), (right, 0, 0.0), (right, top, 0.0), (right, top, -0.02)),
        quad((left, top, -0.02), (right, top, -0.02), (right, top, 0.0), (left, top, 0.0)).reversed(),
    ]
    return join([leaf.placed((0, 0, -0.02)), moulding, *reveal]).placed((0, 0, HALF_Z), turns=np.pi)


def _handle(detail: Detail) -> Patch:
    """The door's knob on its plate."""
    knob = turned([(0.012, 0.0), (0.01, 0.03), (0.026, 0.045), (0.027, 0.06), (0.014, 0.072), (0.0, 0.074)], detail, 14)
    plate = box((0.05, 0.2, 0.006), "-x +x +y -y +z").placed((0, 0.93, 0.0))
    both = join([knob.standing().placed((0, 1.03, 0.006)), plate])
    return both.placed((DOOR[1] - 0.07, 0, -0.017)).placed((0, 0, HALF_Z), turns=np.pi)


def _cornice(detail: Detail) -> Patch:
    """Mouldings under the ceiling, with a row of eggs and one of beads."""
    low = CORNICE
    below = [(0.0, 0.0), (0.02, 0.01), (0.024, 0.03), (0.03, 0.034), (0.03, 0.09)]
    above = [(0.03, 0.09), (0.075, 0.098), (0.08, 0.115), (0.08, 0.14), (0.11, 0.165), (0.16, 0.23), (0.17, 0.252)]
    path = _inner_path()
    pieces = []
    for profile in (below, [*above, (0.17, HEIGHT - low)]):
        section = curved(profile, detail, 2)
        pieces.append(mitred(section, path, closed=True, outward=False).placed((0, low, 0)))
    if not detail.shows(0.2):
        return join(pieces)
    egg = stretched(ball(1.0, detail.segments(4, 2), detail.segments(12, 4), 0.0).standing(), (0.021, 0.026, 0.018))
    bead = ball(0.0105, detail.segments(3, 2), detail.segments(8, 4), 0.0).standing()
    for turn, distance, (start, end), _ in _walls():
        for form, spacing, y, out in ((egg, 0.058, low + 0.06, 0.029), (bead, 0.037, low + 0.127, 0.079)):
            count = round((end - start - 2 * out) / spacing) - 1
            x = (np.arange(count) - (count - 1) / 2) * spacing
            places = np.stack(np.broadcast_arrays(x, y, out - distance), axis=1)
            pieces.append(form.placed(places).placed(turns=turn))
    return join(pieces)


def _rose(detail: Detail) -> Patch:
    """The ceiling's rose, hanging down from y = 0: rings of lobes and leaves around a turned boss."""
    around = np.linspace(0, 2 * np.pi, detail.segments(192, least=16) + 1)
    around[-1] = 0.0
    rings = []
    for lobes, r0, r1, drop, sharp in (
        (16, 0.11, 0.26, 0.05, 0.6),
        (32, 0.27, 0.36, 0.035, 1.0),
        (24, 0.39, 0.52, 0.03, 0.5),
    ):
        share = np.linspace(0, 1, detail.segments(9, least=2) + 1)[:, None]
        lobe = np.abs(np.cos(lobes / 2 * around)) ** sharp
        r = r0 + (r1 - r0) * share * (0.86 + 0.14 * lobe)
        y = -drop * np.sin(np.pi * share) * (0.3 + 0.7 * lobe) - 0.006
        y = np.where(share == 1, 0.0, y)
        rings.append(grid(np.stack([r * np.sin(around), y, r * np.cos(around)], axis=-1), smooth=True))
    rim = [(0.60, 0.0), (0.575, -0.03), (0.555, -0.034), (0.545, -0.02), (0.52, -0.016), (0.515, 0.0)]
    ring = turned([(r, y) for r, y in rim[::-1]], detail, 72)
    boss = turned([(0.0, -0.07), (0.03, -0.066), (0.07, -0.04), (0.09, -0.045), (0.115, -0.012)], detail, 32)
    return join([*rings, ring, boss])
