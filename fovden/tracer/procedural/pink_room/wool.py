"""What is made of wool: knitting, stitch by stitch, and the rug with its pile and fringe."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.pink_room.forms import sheets, strands, stretched
from fovden.tracer.procedural.pink_room.plan import RUG, RUG_HALF
from fovden.tracer.procedural.pink_room.turning import ball
from fovden.tracer.procedural.primitives import quad

__all__ = ["PILE", "fringe", "knitting", "pouf", "rug", "rug_ground", "throw", "yarn_ball"]

PILE = 0.007
"""Height of the rug's pile, metres."""

NAP = np.array([1.2, 0.4])
"""Way (x, z) in which the pile lies, as a multiple of its height."""


def knitting(places: Array, across: Array, along: Array, detail: Detail) -> Patch:
    """Returns plain knitting, each stitch a V of two strands whose lower ends slip under the stitch below.

    Only the outer part of each strand is made: the rest of it lies within the cloth.

    Args:
        places: Middles of the stitches, metres, shape (n, 3).
        across: From one stitch to its right neighbour, metres, shape (n, 3).
        along: From one stitch to the one above it, metres, shape (n, 3).
        detail: Fineness.

    Returns:
        The stitches; the visible side is that of ``across`` times ``along``.

    Example:
        >>> one = np.array([[1.0, 0.0, 0.0]])
        >>> knitting(np.zeros((1, 3)), 0.03 * one, 0.03 * one[:, [1, 0, 2]], Detail()).triangle_count
        100
    """
    normal = np.cross(across, along)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    width = np.linalg.norm(across, axis=1)[:, None, None, None]
    s = np.linspace(0, 1, detail.segments(5, least=2) + 1)[:, None]
    a = np.linspace(-0.46 * np.pi, 0.46 * np.pi, detail.segments(5, least=2) + 1)[None, :]
    thick = 0.30 * (0.45 + 0.55 * np.sin(np.pi * (0.08 + 0.84 * s)) ** 0.7)
    strands = []
    for side in (-1.0, 1.0):
        u = side * (0.07 + 0.36 * s**0.8 - 0.08 * s**3) + thick * np.sin(a) * 0.92
        v = -0.60 + 1.20 * s - side * thick * np.sin(a) * 0.25
        w = 0.05 + 0.20 * np.sin(np.pi * s) + 0.16 * s + thick * np.cos(a)
        u, v, w = np.broadcast_arrays(u, v, w)
        strands.append(
            places[:, None, None]
            + u[..., None] * across[:, None, None]
            + v[..., None] * along[:, None, None]
            + w[..., None] * width * normal[:, None, None]
        )
    uv = np.stack(np.broadcast_arrays(0.02 * np.sin(a), 0.05 * s), axis=-1)
    return sheets(np.concatenate(strands), uv)


def throw(path: Array, width: float, stitch: float, detail: Detail) -> tuple[Patch, Patch]:
    """Returns a knitted throw that lies along a path, and the fringe at its lower end.

    Args:
        path: Points (x, y) in metres; the visible side is to the left of the path.
        width: Along z, metres.
        stitch: Width of a stitch, metres.
        detail: Fineness.

    Returns:
        Knitting, centred on z = 0, and fringe.

    Example:
        >>> cloth, fringe = throw(np.array([(0.0, 0.0), (0.0, 0.5)]), 0.3, 0.03, Detail(0.5))
        >>> cloth.triangle_count > 100
        True
    """
    stitch = stitch / min(1.0, max(detail.fineness, 0.2))
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    rows, columns = max(2, round(length[-1] / (0.88 * stitch))), max(2, round(width / stitch))
    s = (np.arange(rows) + 0.5) / rows * length[-1]
    x, y = (np.interp(s, length, path[:, axis]) for axis in range(2))
    along = np.stack([np.gradient(x), np.gradient(y), 0 * x], axis=1)
    away = np.stack([-along[:, 1], along[:, 0], 0 * x], axis=1)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    z = (np.arange(columns) - (columns - 1) / 2) * stitch
    ripple = (
        0.015
        + 0.012 * (1 + np.sin(9 * z[None, :] + 2.2 * s[:, None]))
        + 0.006 * np.sin(21 * z[None, :] - 3 * s[:, None])
    )
    places = (
        np.stack(np.broadcast_arrays(x[:, None], y[:, None], z[None, :]), axis=-1) + ripple[..., None] * away[:, None]
    )
    up = np.gradient(places, axis=0)
    right = np.gradient(places, axis=1)
    cloth = knitting(places.reshape(-1, 3), right.reshape(-1, 3), up.reshape(-1, 3), detail)
    thread = np.array([(0, 0.0, 0), (0.004, -0.03, 0.003), (-0.002, -0.06, -0.002), (0.003, -0.10, 0.003)])
    lines = thread + places[-1][:, None] - np.array([0, 0.008, 0])
    return cloth, strands(lines, np.array([1.0, 0.0, 0.0]), [0.006, 0.005, 0.005, 0.007], detail.segments(5, least=2))


def pouf(radius: float, height: float, detail: Detail) -> Patch:
    """Returns a knitted pouf: a flattened ball of large stitches whose wales run together at the top.

    Example:
        >>> bool(pouf(0.27, 0.4, Detail(0.5)).vertices[:, 1].max() < 0.45)
        True
    """
    coarse = min(1.0, max(detail.fineness, 0.25))
    wales, rows = max(7, round(31 * coarse)), max(4, round(19 * coarse))
    angle = np.linspace(-0.33 * np.pi, 0.482 * np.pi, rows)
    r = radius * np.cos(angle) ** 0.55
    y = height / 2 * (1 + np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** 0.9)
    turn = 2 * np.pi * np.arange(wales) / wales
    out = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
    right = np.stack([np.cos(turn), 0 * turn, -np.sin(turn)], axis=1)
    places = r[:, None, None] * out + y[:, None, None] * np.array([0.0, 1.0, 0.0])
    across = (2 * np.pi / wales) * r[:, None, None] * right
    stitches = knitting(
        places.reshape(-1, 3), across.reshape(-1, 3), np.gradient(places, axis=0).reshape(-1, 3), detail
    )
    button = stretched(ball(0.075, detail.segments(6, least=2), detail.segments(20, least=5), 0.0), (1.0, 0.45, 1.0))
    return join([stitches, button.placed((0, height - 0.004, 0))])


def yarn_ball(rng: np.random.Generator, radius: float, detail: Detail) -> Patch:
    """Returns a ball of wool about the origin: yarn wound in great circles that change direction.

    Example:
        >>> yarn_ball(np.random.default_rng(0), 0.06, Detail(0.5)).triangle_count > 100
        True
    """
    pieces = []
    for drawn, reach, layer in ((8, 1.0, 1.0),):
        turns = detail.at_most(1.0).segments(drawn, least=2)
        pole = rng.standard_normal(3)
        pole /= np.linalg.norm(pole)
        one = np.cross(pole, np.eye(3)[np.argmin(np.abs(pole))])
        one /= np.linalg.norm(one)
        other = np.cross(pole, one)
        t = np.linspace(0, 1, turns * detail.segments(26, least=5) + 1)[:, None]
        tilt = reach * (2 * t - 1)
        angle = 2 * np.pi * turns * t
        ring = np.cos(angle) * one + np.sin(angle) * other
        line = radius * (np.cos(tilt) * ring + np.sin(tilt) * pole) * layer
        outward = line / np.linalg.norm(line, axis=1, keepdims=True)
        pieces.append(strands(line[None], outward[None], 0.13 * radius, detail.segments(5, least=2)))
    return join(pieces)


def rug_ground() -> Patch:
    """Returns the rug's cloth under its pile: a top with a hem, without a bottom.

    Example:
        >>> rug_ground().triangle_count
        10
    """
    x, z = RUG_HALF
    y = 0.006
    top = quad((-x, y, z), (x, y, z), (x, y, -z), (-x, y, -z))
    hems = [
        quad((-x, 0.001, z), (x, 0.001, z), (x, y, z), (-x, y, z)),
        quad((x, 0.001, z), (x, 0.001, -z), (x, y, -z), (x, y, z)),
        quad((x, 0.001, -z), (-x, 0.001, -z), (-x, y, -z), (x, y, -z)),
        quad((-x, 0.001, -z), (-x, 0.001, z), (-x, y, z), (-x, y, -z)),
    ]
    return _patterned(join([top, *hems])).placed(RUG)


def _patterned(patch: Patch) -> Patch:
    """The patch with the carpet's image laid over its plan once."""
    plan = patch.vertices[:, [0, 2]] * [1, -1] / (2 * np.asarray(RUG_HALF)) + 0.5
    return Patch(patch.vertices, patch.faces, np.clip(plan, 0.002, 0.998), patch.normals)


def rug(rng: np.random.Generator, blades: int) -> Patch:
    """Returns exactly so many tufts of the rug's pile, one triangle each, spread evenly over the rug.

    The tufts stand on a jittered lattice whose spacing follows from their number, so a finer rug has narrower ones.
    Each takes the colour of the carpet's image at its root; its normal leans towards up, as the pile's does.

    Args:
        rng: Where each tuft stands and how it leans.
        blades: Number of tufts.

    Returns:
        The tufts, standing on :func:`rug_ground`.

    Example:
        >>> rug(np.random.default_rng(0), 1000).triangle_count
        1000
    """
    half = np.asarray(RUG_HALF)
    columns = max(1, round(np.sqrt(blades * half[0] / half[1])))
    rows = -(-blades // columns)
    spacing = np.sqrt(4 * half[0] * half[1] / max(blades, 1))
    row, column = np.divmod(np.arange(blades), columns)
    filled = np.where(row == rows - 1, blades - columns * (rows - 1), columns)
    unit = np.stack([(column + rng.random(blades)) / filled, (row + rng.random(blades)) / rows], axis=1)
    plan = (2 * unit - 1) * (half - 0.008)
    lean = PILE * (NAP + 0.6 * rng.standard_normal((blades, 2)))
    turn = np.pi * rng.random(blades)
    wide = np.clip(0.48 * spacing, 0.0015, 0.03) * (0.8 + 0.4 * rng.random(blades))
    side = wide[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    tall = PILE * (0.75 + 0.4 * rng.random(blades))
    points = np.zeros((blades, 3, 3))
    points[:, 0, [0, 2]], points[:, 1, [0, 2]], points[:, 2, [0, 2]] = plan - side, plan + side, plan + lean
    points[:, :2, 1], points[:, 2, 1] = 0.0075, 0.0075 + tall
    normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    turned = normal[:, 1] < 0
    points[turned] = points[turned][:, [1, 0, 2]]
    normal[turned] *= -1
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal += np.array([0.0, 2.5, 0.0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    uv = np.repeat(plan * [1, -1] / (2 * half) + 0.5, 3, axis=0)
    patch = Patch(points.reshape(-1, 3), np.arange(3 * blades).reshape(-1, 3), uv, np.repeat(normal, 3, axis=0))
    return patch.placed(RUG)


def fringe(rng: np.random.Generator, detail: Detail) -> Patch:
    """Returns the knotted fringe at the rug's short sides.

    Example:
        >>> fringe(np.random.default_rng(0), Detail(0.5)).triangle_count > 0
        True
    """
    count = detail.at_most(1.0).count(130, least=4)
    x, z = RUG_HALF
    strand = np.array([(0.0, 0.009, 0.0), (0.02, 0.011, 0.0), (0.045, 0.007, 0.0), (0.095, 0.005, 0.0)])
    bend = np.array([[0, 0, 0], [0, 0, 0.002], [0, 0, 0.006], [0, 0, 0.012]])
    at = (np.arange(count) + 0.5) / count * 2 - 1
    patches = []
    for side in (1, -1):
        lines = strand * [side, 1, 1] + bend * rng.standard_normal((count, 1, 1))
        lines += at[:, None, None] * np.array([0, 0, z - 0.01]) + np.array([side * x, 0.0, 0.0])
        patches.append(strands(lines, np.array([0.0, 1.0, 0.0]), [0.004, 0.0055, 0.0035, 0.005], 3))
    return join(patches).placed(RUG)
