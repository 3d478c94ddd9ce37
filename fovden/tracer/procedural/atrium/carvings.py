"""Stone carved in relief: rosettes, lions' heads and shell basins, all to hang on a wall at z = 0."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import bridge, grid

__all__ = ["basin", "lion_head", "rosette"]


def rosette(radius: float, petals: int = 8, detail: Detail = DRAWN) -> Patch:
    """Returns a carved flower on the plane z = 0: a ring of domed petals around a bud.

    Args:
        radius: Metres.
        petals: Number of petals.
        detail: Fineness.

    Returns:
        The patch, smooth.

    Example:
        >>> rosette(0.15).triangle_count
        360
    """
    section = [(1.0, 0.0), (0.92, 0.14), (0.72, 0.24), (0.5, 0.2), (0.34, 0.06), (0.30, 0.04)]
    share, height = detail.curve(section, least=3).T
    around = np.linspace(0, 2 * np.pi, 2 * detail.segments(2) * petals + 1)
    lobe = np.abs(np.cos(petals * around / 2))
    r = radius * share[:, None] * (1 - 0.14 * share[:, None] ** 2 * (1 - lobe))
    z = radius * height[:, None] * (0.35 + 0.65 * lobe)
    flower = grid(np.stack([r * np.cos(around), r * np.sin(around), z], axis=-1), smooth=True)
    bud_angle = np.linspace(0, 2 * np.pi, detail.segments(8, least=5) + 1)
    profile = detail.curve([(0.30, 0.0), (0.27, 0.14), (0.16, 0.26), (0.0, 0.3)], least=2) * radius
    bud = np.stack(
        [
            profile[:, :1] * np.cos(bud_angle),
            profile[:, :1] * np.sin(bud_angle),
            np.broadcast_to(profile[:, 1:], (len(profile), len(bud_angle))),
        ],
        axis=-1,
    )
    return join([flower, grid(bud, smooth=True)])


def lion_head(radius: float, detail: Detail = DRAWN) -> Patch:
    """Returns a lion's head in relief on the plane z = 0: a mane of locks around a face.

    The relief is a height over polar coordinates: a dome, locks that swirl around its rim, and bumps for brows,
    cheeks, muzzle, nose and chin, with hollows for eyes and mouth.

    Args:
        radius: Metres.
        detail: Fineness; as drawn there are 17 rings of 48 cells.

    Returns:
        The patch, smooth.

    Example:
        >>> lion_head(0.3).triangle_count
        1584
    """
    rings, spokes = detail.segments(17, least=4), detail.segments(48, least=12)
    rho, theta = np.meshgrid(np.linspace(0, 1, rings + 1) ** 0.85, np.linspace(0, 2 * np.pi, spokes + 1), indexing="ij")
    x, y = rho * np.sin(theta), rho * np.cos(theta)
    relief = 0.42 * np.sqrt(np.clip(1 - rho**2, 0, 1))
    mane = _bump(rho, 0.78, 0.17)
    relief += mane * (0.07 + 0.06 * np.sin(15 * theta + 7 * rho) + 0.03 * np.sin(30 * theta - 9 * rho))

    def spot(cx: float, cy: float, sx: float, sy: float, amount: float) -> Array:
        bump: Array = amount * np.exp(-(((x - cx) / sx) ** 2) - ((y - cy) / sy) ** 2)
        return bump

    for side in (-1.0, 1.0):
        relief += spot(side * 0.20, 0.24, 0.14, 0.07, 0.12) + spot(side * 0.11, -0.16, 0.12, 0.11, 0.20)
        relief += spot(side * 0.30, -0.06, 0.13, 0.16, 0.07) + spot(side * 0.46, 0.50, 0.10, 0.10, 0.16)
        relief -= spot(side * 0.19, 0.12, 0.075, 0.05, 0.11)
    relief += spot(0, 0.08, 0.07, 0.26, 0.15) + spot(0, -0.06, 0.09, 0.06, 0.12) + spot(0, -0.44, 0.11, 0.07, 0.14)
    relief -= spot(0, -0.31, 0.13, 0.045, 0.22)
    relief *= np.clip((1 - rho) / 0.06, 0, 1)
    return grid(radius * np.stack([x, y, relief], axis=-1)[::-1], smooth=True)


def _bump(value: Array, centre: float, width: float) -> Array:
    bump: Array = np.exp(-(((value - centre) / width) ** 2))
    return bump


def basin(radius: float, ribs: int = 9, detail: Detail = DRAWN) -> tuple[Patch, Patch]:
    """Returns half a shell-shaped basin for a wall at z = 0, its rim at y = 0, and the water in it.

    Args:
        radius: Metres.
        ribs: Number of the shell's ribs.
        detail: Fineness; as drawn a rib has four segments.

    Returns:
        The shell and the water.

    Example:
        >>> shell, water = basin(0.4)
        >>> float(shell.vertices[:, 2].min()) >= -1e-9
        True
    """
    section = [(0.0, -0.75), (0.35, -0.62), (0.62, -0.44), (0.84, -0.22), (0.96, -0.08), (1.0, 0.0)]
    share, depth = detail.curve(section, least=3).T
    angle = np.linspace(-np.pi / 2, np.pi / 2, 2 * detail.segments(2) * ribs + 1)
    rib = 1 + 0.05 * np.abs(np.sin(ribs * (angle + np.pi / 2)))[None, :] * share[:, None]
    r = radius * share[:, None] * rib

    def half_turned(radii: Array, heights: Array) -> Array:
        y = np.broadcast_to(heights, radii.shape)
        z = radii * np.cos(angle)
        z[:, [0, -1]] = 0.0
        return np.stack([radii * np.sin(angle), y, z], axis=-1)

    outside = half_turned(r, radius * depth[:, None])
    rim_inner = half_turned(0.88 * r[-1:], np.zeros((1, 1)))
    inside = half_turned(0.84 * r[-1:], np.full((1, 1), -0.12 * radius))
    rim = grid(np.concatenate([outside[-1:], rim_inner]))
    lip = grid(np.concatenate([rim_inner, inside]), smooth=True)
    level = half_turned(0.855 * r[-1:], np.full((1, 1), -0.08 * radius))[0]
    if detail.fineness > 1:  # the ribs are then too fine for triangles that all have one of two corners
        water = bridge([(level[0] + level[-1]) / 2], level).reversed()
    else:
        water = bridge([level[0], level[-1]], level[1:-1]).reversed()
    return join([grid(outside, smooth=True), rim, lip]), water
