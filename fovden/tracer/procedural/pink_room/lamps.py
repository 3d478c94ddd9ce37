"""Lamps: pleated shades, a table lamp, a standard lamp and a chandelier."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.pink_room.forms import sheets, stretched
from fovden.tracer.procedural.pink_room.turning import ball, torus, turned
from fovden.tracer.procedural.primitives import lathe, tube

__all__ = ["chandelier", "shade", "standard_lamp", "table_lamp"]


def shade(low: float, high: float, height: float, pleats: int, detail: Detail) -> tuple[Patch, Patch]:
    """Returns a pleated lampshade, open at top and bottom, and the bound rings at its edges with their spokes.

    Args:
        low: Radius of the lower ring, metres.
        high: Radius of the upper ring, metres.
        height: Metres; the middle is at y = 0.
        pleats: Number of pleats.
        detail: Fineness.

    Returns:
        Cloth and rings.

    Example:
        >>> cloth, rings = shade(0.2, 0.13, 0.25, 24, Detail())
        >>> bool(abs(cloth.vertices[:, 1]).max() <= 0.125)
        True
    """
    detail = detail.at_most(2.0)
    s = np.linspace(0, 1, detail.segments(8, least=1) + 1)[:, None]
    turn = np.linspace(
        0, 2 * np.pi, (pleats * detail.segments(4) if detail.shows(0.4) else detail.segments(48, least=6)) + 1
    )
    turn[-1] = 0.0
    r = low + (high - low) * s - 0.022 * np.sin(np.pi * s) + 0.0035 * np.cos(pleats * turn) * detail.shows(0.4)
    points = np.stack([r * np.sin(turn), height * 0.985 * (s - 0.5) + 0 * turn, r * np.cos(turn)], axis=-1)
    length = low * np.linspace(0, 2 * np.pi, len(turn))
    uv = np.stack(np.broadcast_arrays(length, height * s), axis=-1)
    around = detail.segments(64, least=6)
    rings = [
        torus(radius, 0.0065, around, detail.segments(8, least=3)).placed((0, y, 0))
        for radius, y in ((low, -height / 2), (high, height / 2))
    ]
    spokes = [tube([(0.012, 0, 0), (high, 0, 0)], 0.003, 4).placed((0, height / 2, 0), turns=2.1 * k) for k in range(3)]
    return sheets(points[None], uv), join([*rings, *spokes])


def table_lamp(light: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Yields a table lamp with a turned porcelain body, its foot at y = 0 and its light at the given height.

    Example:
        >>> [surface for surface, _ in table_lamp(0.5, Detail())]
        ['porcelain', 'brass', 'shade']
    """
    body = [(0.075, 0.012), (0.06, 0.03), (0.03, 0.05), (0.05, 0.09), (0.088, 0.15), (0.085, 0.20), (0.05, 0.255)]
    body += [(0.026, 0.285), (0.034, 0.30), (0.02, 0.318)]
    yield "porcelain", turned(body, detail, 40)
    foot = turned([(0.088, 0.001), (0.09, 0.008), (0.08, 0.014), (0.06, 0.014)], detail, 40)
    stalk = turned(
        [(0.014, 0.315), (0.009, 0.33), (0.009, light - 0.09), (0.02, light - 0.085), (0.018, light - 0.06)], detail, 14
    )
    cloth, rings = shade(0.20, 0.13, 0.24, 56, detail)
    top = light + 0.12
    harp = _harp([(0.016, light - 0.06), (0.07, light - 0.03), (0.075, light + 0.06), (0.012, top)], detail)
    yield "brass", join([foot, stalk, rings.placed((0, light, 0)), harp])
    yield "shade", cloth.placed((0, light, 0))


def standard_lamp(light: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Yields a standard lamp with a turned wooden pole, its light at the given height.

    Example:
        >>> [surface for surface, _ in standard_lamp(1.6, Detail())]
        ['dark wood', 'brass', 'shade']
    """
    pole = [(0.15, 0.001), (0.155, 0.02), (0.13, 0.035), (0.05, 0.05), (0.03, 0.09), (0.042, 0.13), (0.024, 0.17)]
    pole += [
        (0.02, 0.4),
        (0.034, 0.47),
        (0.02, 0.53),
        (0.017, 0.9),
        (0.03, 0.95),
        (0.016, 1.0),
        (0.014, light - 0.3),
        (0.024, light - 0.25),
    ]
    yield "dark wood", turned(pole, detail, 32)
    stalk = turned(
        [(0.02, light - 0.25), (0.01, light - 0.22), (0.01, light - 0.1), (0.022, light - 0.09), (0.02, light - 0.06)],
        detail,
        14,
    )
    cloth, rings = shade(0.25, 0.16, 0.28, 72, detail)
    top = light + 0.14
    harp = _harp([(0.018, light - 0.06), (0.08, light - 0.03), (0.085, light + 0.08), (0.012, top)], detail)
    pull = (
        [ball(0.004, 3, 6).placed([(0.11, light - 0.17 - 0.0095 * k, 0.0) for k in range(22)])]
        if detail.shows(0.3)
        else []
    )
    yield "brass", join([stalk, rings.placed((0, light, 0)), harp, *pull])
    yield "shade", cloth.placed((0, light, 0))


def chandelier(drop: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Yields a chandelier that hangs from y = 0: candles on brass arms, strings of beads, and a shade with the light.

    The shade hangs below the shaft; its light is at its lower edge and reaches walls and furniture below freely.

    Args:
        drop: From the ceiling to the light, metres.
        detail: Fineness.

    Yields:
        Surfaces' names and patches.

    Example:
        >>> [surface for surface, _ in chandelier(0.9, Detail())]
        ['shade', 'brass', 'candle', 'glass']
    """
    arms, reach, low = 8, 0.36, -drop + 0.21
    shaft = [
        (0.0, low - 0.06),
        (0.022, low - 0.045),
        (0.012, low - 0.02),
        (0.05, low + 0.02),
        (0.062, low + 0.06),
        (0.03, low + 0.1),
    ]
    shaft += [(0.018, low + 0.14), (0.035, low + 0.19), (0.045, low + 0.25), (0.02, low + 0.31), (0.012, low + 0.34)]
    canopy = [(0.012, -0.14), (0.03, -0.11), (0.06, -0.10), (0.075, -0.075)]
    silk, rings = shade(0.25, 0.165, 0.12, 64, detail)
    yield "shade", silk.placed((0, -drop + 0.06, 0))
    wires = [
        tube([(0.02, low + 0.02, 0), (0.165, -drop + 0.12, 0)], 0.002, 4).placed(turns=2.1 * k + 0.5) for k in range(3)
    ]
    brass = [
        rings.placed((0, -drop + 0.06, 0)),
        *wires,
        turned(shaft, detail, 28),
        turned(canopy, detail, 28),
        _chain(low + 0.35, -0.15, detail),
    ]
    t = np.linspace(0, 1, detail.at_most(1.5).segments(26, least=3) + 1)
    curve = np.stack(
        [0.045 + (reach - 0.045) * t, low + 0.05 - 0.10 * np.sin(1.25 * np.pi * t) + 0.05 * t, 0 * t], axis=1
    )
    tip = curve[-1]
    arm = [tube(curve, 0.009 - 0.003 * t, detail.segments(8, least=3))]
    spiral = np.linspace(0, 2.6 * np.pi, detail.segments(30, least=4) + 1)
    curl = 0.045 * np.exp(-0.16 * spiral)
    scroll = np.stack([0.16 + curl * np.cos(spiral), low + 0.055 + curl * np.sin(spiral), 0 * spiral], axis=1)
    arm.append(tube(scroll, 0.0045, detail.segments(6, least=3)))
    pan = [
        (0.008, 0.0),
        (0.02, 0.008),
        (0.046, 0.014),
        (0.05, 0.024),
        (0.042, 0.02),
        (0.014, 0.018),
        (0.014, 0.045),
        (0.011, 0.05),
    ]
    arm.append(turned(pan, detail, 24).placed(tip))
    turns = 2 * np.pi * np.arange(arms) / arms
    brass.append(join(arm).placed((0, 0, 0), turns))
    yield "brass", join(brass)
    stick = turned([(0.0105, 0.05), (0.010, 0.09), (0.010, 0.145), (0.006, 0.148), (0.0, 0.151)], detail, 8).placed(tip)
    yield "candle", stick.placed((0, 0, 0), turns)
    yield "glass", _glass(arms, reach, low, tip[1], detail)


def _chain(low: float, high: float, detail: Detail) -> Patch:
    """Oval links from one height to another, every other one turned."""
    count = max(1, round((high - low) / 0.034))
    link = stretched(torus(0.012, 0.0028, detail.segments(14, 5), detail.segments(6, 3)), (1.0, 1.0, 1.7)).standing()
    y = low + (np.arange(count) + 0.5) / count * (high - low)
    return link.placed(np.stack([0 * y, y, 0 * y], axis=1), np.where(np.arange(count) % 2, np.pi / 2, 0.0))


def _glass(arms: int, reach: float, low: float, tip: float, detail: Detail) -> Patch:
    """Swags of beads between the arms and up to the shaft, and faceted drops under the pans."""
    bead = ball(0.0075, detail.segments(5, least=2), detail.segments(7, least=3))
    t = np.linspace(0, 1, detail.at_most(1.0).segments(15, least=3) + 2)[1:-1]
    angle = 2 * np.pi * np.arange(arms) / arms
    step = 2 * np.pi / arms
    swags = []
    depth, height = 0.085, tip + 0.012
    turn = angle[:, None] + step * t
    rim = reach + 0.045 - 0.03 * np.sin(np.pi * t)
    sag = height - depth * np.sin(np.pi * t) ** 0.9
    swags.append(np.stack(np.broadcast_arrays(rim * np.cos(turn), sag, -rim * np.sin(turn)), axis=-1).reshape(-1, 3))
    t = t[1:-1]
    r, y = 0.04 + (reach - 0.05) * t, low + 0.30 + (tip + 0.03 - low - 0.30) * t - 0.06 * np.sin(np.pi * t)
    swags.append(
        np.stack(np.broadcast_arrays(r * np.cos(angle)[:, None], y, -r * np.sin(angle)[:, None]), axis=-1).reshape(
            -1, 3
        )
    )
    drop = lathe([(0.0, -0.055), (0.0115, -0.03), (0.005, -0.006), (0.0, 0.0)], 6, faceted=True)
    around = angle[:, None] + np.array([-0.13, 0.0, 0.13])
    radius = np.array([0.052, 0.058, 0.052]) + reach - 0.005
    places = np.stack(
        np.broadcast_arrays(radius * np.cos(around), tip + 0.012, -radius * np.sin(around)), axis=-1
    ).reshape(-1, 3)
    return join([bead.placed(np.concatenate(swags)), drop.placed(places)])


def _harp(profile: Sequence[tuple[float, float]], detail: Detail) -> Patch:
    """The two bows that carry a shade around the light: radius and height of their bends, from the stalk upwards."""
    bow = tube([(radius, height, 0.0) for radius, height in profile], 0.0029, detail.segments(5, least=3))
    return join([bow, bow.placed(turns=np.pi)])
