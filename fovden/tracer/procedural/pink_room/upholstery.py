"""Sofa, armchair and daybed: tufted backs, rolled arms, cushions, quilts.

Each function yields patches with the names of their surfaces, in a local frame: the back at z = 0, the front towards
+z, the feet at y = 0.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.pink_room.forms import cushion, draped, pillow, pillow_edge, stretched, without_slivers
from fovden.tracer.procedural.pink_room.turning import ball, bent, turned
from fovden.tracer.procedural.primitives import arc_lengths, box, bridge, grid, tube

__all__ = ["ARM_RADIUS", "ARM_TOP", "arm_section", "daybed", "scatter_cushion", "seat", "seat_section"]

DEPTH, SEAT, ARM = 0.88, 0.30, 0.2
"""Depth of a seat, height of its frame and width of its arms, metres."""

ARM_RADIUS, ARM_TOP = 0.105, 0.66
"""Radius and top of a rolled arm, metres."""


def arm_section(points: int) -> Array:
    """Returns the section (x, y) of a rolled arm from the seat over the roll to the floor, its inner face at x = 0.

    Args:
        points: On the roll.

    Returns:
        Points, shape (n, 2); the arm is to the right.

    Example:
        >>> arm_section(5).shape
        (8, 2)
    """
    middle = ARM_TOP - ARM_RADIUS
    angle = np.linspace(np.pi, -0.42 * np.pi, points)
    roll = np.array([ARM_RADIUS, middle]) + ARM_RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner = np.array([(0.0, SEAT + 0.1)])
    outer = np.array([(0.15, middle - 0.14), (0.155, 0.11)])
    return np.concatenate([inner, roll, outer])


def seat_section() -> Array:
    """Returns the path (z, y) of a cloth that lies over back, seat and front of a sofa or an armchair, shape (n, 2).

    Example:
        >>> seat_section()[0, 1] > seat_section()[-1, 1]
        np.True_
    """
    back = [(0.02, 0.90), (0.06, 0.94), (0.125, 0.955), (0.20, 0.935), (0.262, 0.87), (0.30, 0.75), (0.335, 0.645)]
    front = [
        (0.372, 0.578),
        (0.428, 0.540),
        (0.51, 0.522),
        (0.65, 0.518),
        (0.82, 0.512),
        (0.905, 0.492),
        (0.945, 0.45),
        (0.958, 0.38),
        (0.958, 0.20),
    ]
    return np.array([*back, *front])


def seat(width: float, cushions: int, detail: Detail, cloth: str) -> Iterator[tuple[str, Patch]]:
    """Yields a sofa or an armchair: deep-buttoned back, rolled arms with pleated fronts, seat cushions, turned feet.

    Args:
        width: Over the arms, metres.
        cushions: Number of seat cushions.
        detail: Fineness.
        cloth: Name of the surface that it is covered with.

    Yields:
        Surfaces' names and patches.

    Example:
        >>> sorted({surface for surface, _ in seat(2.1, 3, Detail(), "velvet")})
        ['dark wood', 'piping', 'velvet']
    """
    inner = width - 2 * ARM
    pieces = [_buttoned_back(inner, detail)]
    pipings: list[Patch] = []
    arm, edge = _arm(detail)
    mirror = np.diag([-1.0, 1.0, 1.0])
    for piece, collection in ((arm, pieces), (edge, pipings)):
        right = piece.placed((inner / 2, 0, 0))
        collection += [right, right.transformed(mirror)]
    rail = [(0.0, 0.11), (0.018, 0.13), (0.025, 0.2), (0.018, SEAT - 0.01), (0.0, SEAT)]
    front = DEPTH - 0.06
    profile = np.array([(y, z) for z, y in rail])
    pieces.append(_extruded(profile, inner, front))
    each = inner / cushions
    for i in range(cushions):
        top, piping = cushion(each - 0.026, DEPTH - 0.22, 0.13, detail)
        place = (-inner / 2 + (i + 0.5) * each, SEAT + 0.002, 0.25 + (DEPTH - 0.22) / 2)
        pieces.append(top.placed(place))
        pipings.append(piping.placed(place))
    yield cloth, join(pieces)
    yield "piping", join(pipings)
    foot = turned(
        [(0.016, 0.001), (0.03, 0.012), (0.034, 0.03), (0.018, 0.045), (0.03, 0.06), (0.038, 0.112)], detail, 18
    )
    x = width / 2 - 0.09
    yield "dark wood", foot.placed([(-x, 0, 0.09), (x, 0, 0.09), (-x, 0, DEPTH - 0.1), (x, 0, DEPTH - 0.1)])


def _extruded(profile: Array, width: float, z: float) -> Patch:
    """A smooth strip along x through a profile (y, out)."""
    points = np.stack(
        [np.stack([np.full(len(profile), s * width / 2), profile[:, 0], z + profile[:, 1]], axis=1) for s in (-1, 1)],
        axis=1,
    )
    return grid(points, smooth=True)


def _buttoned_back(width: float, detail: Detail) -> Patch:
    """The back between the arms: cloth drawn in by buttons on a lattice of diamonds, rolled over the top."""
    detail = detail.at_most(1.8)  # cloth between two buttons is a smooth bulge, which finer cells would not show
    angle = np.linspace(0.0, 0.95 * np.pi, 9)
    roll = np.array([0.125, 0.80]) + 0.085 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    path = np.concatenate([[(0.30, SEAT + 0.09), (0.25, 0.55)], roll, [(0.03, 0.6)]])
    length = arc_lengths(path)
    rows, columns = detail.segments(70, least=4) + 1, detail.segments(round(58 * width), least=2) + 1
    s = np.linspace(0, length[-1], rows)
    z, y = (np.interp(s, length, path[:, axis]) for axis in range(2))
    kernel = np.array([0.25, 0.5, 0.25])
    for _ in range(max(1, rows // 24)):
        z[1:-1], y[1:-1] = np.convolve(z, kernel, "valid"), np.convolve(y, kernel, "valid")
    away = np.stack([np.gradient(y), -np.gradient(z)], axis=1)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    x = np.linspace(-width / 2, width / 2, columns)
    step_x, step_y = width / max(2, round(width / 0.2)), 0.125
    a = x / step_x + ((s - 0.14) / step_y)[:, None]
    b = x / step_x - ((s - 0.14) / step_y)[:, None]
    tufted = np.clip(1 - np.abs(s - 0.27) / 0.3, 0, 1)[:, None] ** 0.35
    puff = np.abs(np.sin(np.pi / 2 * (a + 1)) * np.sin(np.pi / 2 * (b + 1))) ** 0.42
    lift = 0.045 * (puff * tufted + (1 - tufted) * 0.75) + 0.002 * np.sin(23 * x) * np.sin(19 * s)[:, None]
    points = np.stack(
        [np.broadcast_to(x, lift.shape), y[:, None] + away[:, 1:] * lift, z[:, None] + away[:, :1] * lift], axis=-1
    )
    uv = np.stack(np.broadcast_arrays(x, s[:, None]), axis=-1)
    cloth = grid(points, smooth=True, uv=uv)
    front, rear = points[: rows // 2], points[rows // 2 :][::-1]
    ends = [bridge(rear[:, -1], front[:, -1]), bridge(rear[:, 0], front[:, 0]).reversed()]
    ends = [without_slivers(end) for end in ends]
    if not detail.shows(0.2):
        return join([cloth, *ends])
    button = stretched(ball(0.013, detail.segments(4, 2), detail.segments(10, 4), 0.0), (1, 0.6, 1)).standing()
    places = []
    for i in range(-40, 41):
        for j in range(-1, 4):
            at, up = (i + (j + 1) % 2) * step_x, 0.14 + j * step_y
            if i % 2 == 0 and abs(at) < width / 2 - 0.04 and 0.1 < up < 0.48:
                places.append((at, np.interp(up, s, y), np.interp(up, s, z) + 0.006))
    return join([cloth, *ends, button.placed(places)])


def _arm(detail: Detail) -> tuple[Patch, Patch]:
    """The right arm with its inner face at x = 0, and the piping around its front."""
    detail = detail.at_most(1.8)
    section = arm_section(detail.segments(28, least=5))
    share = np.linspace(0, 1, detail.segments(24, least=1) + 1)
    z = 0.02 + (DEPTH - 0.02) * share[::-1]
    soft = 0.007 * np.sin(np.pi * share) + 0.0022 * np.sin(31 * share)
    middle = np.array([ARM_RADIUS, ARM_TOP - ARM_RADIUS])
    outward = section - middle
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    points = np.empty((len(z), len(section), 3))
    points[..., :2] = section + soft[:, None, None] * outward
    points[..., 2] = z[:, None]
    length = arc_lengths(section)
    uv = np.stack(np.broadcast_arrays(length, z[:, None]), axis=-1)
    sleeve = grid(points[::-1], smooth=True, uv=uv[::-1]).reversed()
    sleeve = sleeve if _faces_up(sleeve) else sleeve.reversed()
    outline = np.concatenate([[(0.0, 0.11)], section])
    front = _pleated_front(outline, middle, detail).placed((0, 0, DEPTH))
    rim = np.column_stack([section, np.full(len(section), DEPTH + 0.002)])
    return join([sleeve, front]), tube(rim, 0.005, detail.segments(6, least=3))


def _faces_up(patch: Patch) -> bool:
    """Whether a patch's highest triangle is seen from above."""
    triangles = patch.vertices[patch.faces]
    highest = triangles[triangles[:, :, 1].mean(axis=1).argmax()]
    return bool(np.cross(highest[1] - highest[0], highest[2] - highest[0])[1] > 0)


def _pleated_front(outline: Array, middle: Array, detail: Detail) -> Patch:
    """The front of an arm: cloth gathered in pleats around a button, within an outline (x, y) on the plane z = 0."""
    closed = bent(np.concatenate([outline, outline[:1]]))
    length = arc_lengths(closed)
    count = detail.segments(66, least=8)
    at = np.round(length, 4)
    if detail.shows(0.3):
        at = np.union1d(np.round(np.linspace(0, length[-1], count + 1), 4), at)
    keep = np.concatenate([[True], np.diff(at) > min(0.008, 0.4 * length[-1] / count)])
    at = at[keep]
    at[-1] = length[-1]
    rim = np.stack([np.interp(at, length, closed[:, axis]) for axis in range(2)], axis=1)
    rim[-1] = rim[0]
    share = np.linspace(1, 0.1, detail.segments(5, least=1) + 1)
    pleat = np.abs(np.sin(np.pi * 16 * at / length[-1]))
    relief = np.sin(np.pi * np.clip(share, 0, 1)) ** 0.7
    plan = middle + share[:, None, None] * (rim - middle)
    z = relief[:, None] * (0.012 + 0.007 * pleat)
    z[:, -1] = z[:, 0]
    face = grid(np.concatenate([plan, z[..., None]], axis=-1), smooth=True)
    around = np.cross(*(face.vertices[face.faces[0]][k] - face.vertices[face.faces[0]][0] for k in (1, 2)))
    face = face if around[2] > 0 else face.reversed()
    button = stretched(ball(0.02, detail.segments(4, 2), detail.segments(12, 4), 0.0), (1, 0.6, 1)).standing()
    return join([face, button.placed((*middle, 0.004))])


def scatter_cushion(
    size: tuple[float, float, float], detail: Detail, lean: float, turn: float = 0.0, roll: float = 0.0
) -> tuple[Patch, Patch]:
    """Returns a cushion that leans back, its lowest point at y = 0, and its piping.

    Args:
        size: Width, height and thickness, metres.
        detail: Fineness.
        lean: Radians from upright towards -z.
        turn: Radians about the y axis.
        roll: Radians about the cushion's own axis.

    Returns:
        Cloth and piping.

    Example:
        >>> cloth, piping = scatter_cushion((0.4, 0.4, 0.15), Detail(), 0.3)
        >>> bool(cloth.vertices[:, 1].min() < 0.01)
        True
    """
    cells = detail.segments(28, least=3)
    cloth, detail = pillow(size, cells), detail.at_most(2.0)
    cord = tube(pillow_edge(size, detail.segments(20, least=3)), 0.006, detail.segments(6, least=3))
    c, s, cr, sr = np.cos(lean), np.sin(lean), np.cos(roll), np.sin(roll)
    matrix = np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) @ np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    both = [piece.transformed(matrix) for piece in (cloth, cord)]
    lowest = min(float(piece.vertices[:, 1].min()) for piece in both)
    return (both[0].placed((0, -lowest, 0)).placed(turns=turn), both[1].placed((0, -lowest, 0)).placed(turns=turn))


def daybed(rng: np.random.Generator, length: float, depth: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Yields a daybed with turned posts, a mattress and a quilt whose side hangs down in folds.

    Args:
        rng: Source of the folds' irregularity.
        length: Along x, metres.
        depth: Along z, metres.
        detail: Fineness.

    Yields:
        Surfaces' names and patches.

    Example:
        >>> sorted({surface for surface, _ in daybed(np.random.default_rng(0), 1.9, 0.85, Detail(0.5))})
        ['dark wood', 'linen', 'piping', 'quilt']
    """
    post = [(0.02, 0.001), (0.032, 0.02), (0.02, 0.06), (0.034, 0.1), (0.036, 0.34), (0.024, 0.38), (0.036, 0.45)]
    post += [
        (0.026, 0.55),
        (0.034, 0.62),
        (0.018, 0.72),
        (0.03, 0.76),
        (0.012, 0.80),
        (0.028, 0.83),
        (0.03, 0.86),
        (0.0, 0.89),
    ]
    x, z = length / 2 + 0.035, (0.03, depth - 0.03)
    yield "dark wood", turned(post, detail, 22).placed([(side * x, 0, at) for side in (-1, 1) for at in z])
    spindle = [(0.008, 0.0), (0.014, 0.06), (0.009, 0.12), (0.017, 0.17), (0.008, 0.24), (0.01, 0.3)]
    rails = []
    for side in (-1, 1):
        ends = [[(side * x, height, end) for end in z] for height in (0.43, 0.75)]
        rails += [tube(line, 0.016, detail.segments(10, least=4)) for line in ends]
        if detail.shows(0.2):
            depths = np.linspace(z[0], z[1], 10)[1:-1]
            places = np.stack([np.full(8, side * x), np.full(8, 0.44), depths], axis=1)
            rails.append(turned(spindle, detail, 10).placed(places))
    yield "dark wood", join(rails)
    yield "linen", box((length - 0.02, 0.22, depth - 0.04), "-x +x +z").placed((0, 0.26, depth / 2 - 0.01))
    yield "quilt", _quilt(rng, length - 0.06, depth, detail)
    for k, (at, wide, turn) in enumerate(((-0.72, 0.5, 0.5), (0.75, 0.42, -0.6), (-0.3, 0.46, 0.12), (0.2, 0.4, -0.1))):
        cloth, cord = scatter_cushion((wide, wide - 0.06, 0.17), detail, 0.3, turn)
        place = (at, 0.515, 0.17 + 0.02 * k)
        yield ("linen" if k % 2 else "quilt"), cloth.placed(place)
        yield "piping", cord.placed(place)


def _quilt(rng: np.random.Generator, length: float, depth: float, detail: Detail) -> Patch:
    """A quilt over the mattress, puffed between its seams, that hangs down in front."""
    path = [(0.0, 0.5), (depth - 0.05, 0.5), (depth - 0.008, 0.485), (depth + 0.012, 0.44), (depth + 0.03, 0.10)]
    rows, columns = detail.segments(90, least=4) + 1, detail.segments(124, least=4) + 1
    s = np.linspace(0, 1, rows)[:, None] * arc_lengths(path)[-1]
    x = np.linspace(-length / 2, length / 2, columns)[None, :]
    square = 0.105
    puff = np.abs(np.sin(np.pi * x / square) * np.sin(np.pi * s / square)) ** 0.4
    hang = np.clip((s - depth) / (s.max() - depth), 0, 1)
    phase = 2 * np.pi * rng.random(3)
    fold = (
        np.sin(17 * x + phase[0] + 0.8 * np.sin(3 * x))
        + 0.6 * np.sin(29 * x + phase[1])
        + 0.2 * np.sin(7 * x + phase[2])
    )
    lift = 0.011 * puff + 0.006 * (1 + np.sin(5 * x + 4 * s)) + 0.026 * hang * (fold + 1.7)
    return draped(path, length, rows, columns, lift)
