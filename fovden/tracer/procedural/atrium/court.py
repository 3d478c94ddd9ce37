"""The atrium's architecture: everything of stone, wood and tile, the same for every seed.

Parts come as pairs of a surface's name and a patch in the world. From the coarsest to the finest there is one plan;
what is too small for a fineness is left out or simpler, and where that would leave a hole the walls, floors and
ceilings of :func:`_shell` close it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.atrium import arcade, coverings, furnishings, orders
from fovden.tracer.procedural.atrium.plan import (
    ARCH,
    ARCHITRAVE,
    BALUSTERS,
    BAY,
    CAPITALS,
    CEILING,
    COFFERS,
    EAVES,
    GROUND_ORDER,
    HALF_BAY,
    HALF_CELL,
    HALF_WALL,
    HALF_X,
    HALF_Z,
    LONG,
    LONG_TURNS,
    LOWER_CORNICE,
    MOULDINGS,
    PAVING,
    PEDESTAL,
    QUARTER,
    SHORT,
    SHORT_TURNS,
    SPRINGING,
    UPPER_COLUMN,
    UPPER_FLOOR,
    UPPER_ORDER,
    VAULT_RISE,
    VAULTS,
    WINDOWS,
    bay_middles,
    vault_segments,
)
from fovden.tracer.procedural.atrium.sides import side, skirting
from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import box, bridge, mitred, quad, ring_corners

__all__ = ["court"]


def court(detail: Detail = DRAWN) -> Iterator[tuple[str, Patch]]:
    """Returns the court's parts, surface by surface: sides, corners, columns, cornices, floors and the fountain.

    Args:
        detail: Fineness; at 1 there are 210,888 triangles.

    Returns:
        Pairs of a surface's name and a patch.

    Example:
        >>> sorted({surface for surface, _ in court()})[:3]
        ['ashlar', 'bronze', 'column marble']
        >>> sum(patch.triangle_count for _, patch in court(Detail(0.05))) < 950
        True
    """
    for count, turns in ((LONG, LONG_TURNS), (SHORT, SHORT_TURNS)):
        for surface, patch in side(count, detail):
            yield surface, patch.placed(turns=turns)
    if detail.shows(VAULTS):
        yield from _corners(detail)
    yield from _shell(detail)
    yield from _columns(detail)
    yield from _loops(detail)
    yield from _floors(detail)
    yield from _fountain(detail)


def _shell(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Plain walls, floors and ceilings where there are no finer ones yet, each all around the galleries."""
    wall = ring_corners(HALF_X + BAY, HALF_Z + BAY)
    arcade_back = ring_corners(HALF_X + HALF_WALL, HALF_Z + HALF_WALL)
    deep = BAY - HALF_WALL
    if not detail.shows(VAULTS):
        vault = SPRINGING + VAULT_RISE
        yield "ashlar", mitred([(0, 0), (0, vault)], wall, closed=True, outward=False)
        yield "plaster", mitred([(0, vault), (deep, vault)], arcade_back, closed=True)
    if not detail.shows(WINDOWS):
        yield "plaster", mitred([(0, UPPER_FLOOR), (0, CEILING)], wall, closed=True, outward=False)
    if not detail.shows(COFFERS):
        yield "oak", mitred([(0, CEILING), (deep, CEILING)], arcade_back, closed=True)
    if not detail.shows(PAVING):
        reach = BAY + HALF_WALL
        yield "pale slab", mitred([(0, UPPER_FLOOR), (-reach, UPPER_FLOOR)], wall, closed=True)
        yield "pale slab", _level(HALF_X + BAY, HALF_Z + BAY)
    if not detail.shows(BALUSTERS):
        half, top = 0.14, UPPER_FLOOR + 0.86
        parapet = [(half, UPPER_FLOOR), (half, top), (-half, top), (-half, UPPER_FLOOR)]
        yield "ashlar", mitred(parapet, ring_corners(HALF_X, HALF_Z), closed=True, outward=False)


def _level(half_x: float, half_z: float) -> Patch:
    return quad(*((x, 0.0, z) for x, z in ring_corners(half_x, half_z)))


def _corners(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """The four vaulted corner cells of the lower gallery."""
    places = [
        (sx * (HALF_X + HALF_BAY), 0.0, sz * (HALF_Z + HALF_BAY)) for sx, sz in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    turns = QUARTER * np.arange(4)
    segments = vault_segments(detail)
    vault = arcade.groin_vault((-HALF_BAY, HALF_CELL), (-HALF_BAY, HALF_CELL), VAULT_RISE, segments)
    yield "plaster", vault.placed((0, SPRINGING, 0)).placed(places, turns)
    for (left, right), offset, turn in (
        ((HALF_BAY, HALF_CELL), (0, 0, -HALF_BAY), 0.0),
        ((HALF_CELL, HALF_BAY), (-HALF_BAY, 0, 0), QUARTER),
    ):
        blank = quad((-left, 0, 0), (right, 0, 0), (right, SPRINGING, 0), (-left, SPRINGING, 0))
        yield "ashlar", blank.placed(offset, turn).placed(places, turns)
        if detail.shows(0.35):
            yield "trim", skirting(left, right).placed(offset, turn).placed(places, turns)
        top = arcade.lunette(left, right, VAULT_RISE, segments).placed((0, SPRINGING, 0))
        yield "plaster", top.placed(offset, turn).placed(places, turns)


def _court_nodes() -> Array:
    """Plan (x, z) of the columns around the court."""
    x = bay_middles(LONG + 1)
    sides = [(x_i, side * HALF_Z) for x_i in x for side in (-1.0, 1.0)]
    return np.array([*sides, (-HALF_X, 0.0), (HALF_X, 0.0)])


def _columns(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Columns of both storeys, and the pedestals of the upper ones."""
    nodes = _court_nodes()

    def at(height: float) -> Array:
        return np.stack([nodes[:, 0], np.full(len(nodes), height), nodes[:, 1]], axis=1)

    if detail.shows(CAPITALS):
        yield "column marble", orders.column(replace(GROUND_ORDER, detail=detail)).placed(at(0.0))
    else:
        yield "trim", _piers(nodes)
    order = replace(UPPER_ORDER, detail=detail)
    turned = detail.shows(0.16)
    base = UPPER_FLOOR
    if detail.shows(BALUSTERS):
        width = 1.38 * order.radius if detail.shows(0.2) else order.radius * (np.sqrt(0.5) if turned else 1.0)
        yield "trim", _pedestal(width, detail).placed(at(base))
        base += PEDESTAL
    tall = UPPER_FLOOR + PEDESTAL + UPPER_COLUMN - base
    post = box((2 * order.radius, tall, 2 * order.radius), "-x +x -z +z")
    yield "column marble", (orders.column(order) if turned else post).placed(at(base))


def _pedestal(carried: float, detail: Detail) -> Patch:
    """A pedestal, and the rim of its top around what it carries, of half that width."""
    foot = [(0.04, 0.0), (0.04, 0.14), (0.0, 0.19)]
    die = [(0.0, 0.19), (0.0, 0.78)]
    cap = [(0.0, 0.78), (0.03, 0.82), (0.03, 0.86), (0.055, 0.89), (0.055, PEDESTAL)]
    pieces = [foot, die, cap] if detail.shows(MOULDINGS) else [[(0.0, 0.0), (0.0, PEDESTAL)]]
    corners = ring_corners(0.27, 0.27)
    top = orders.rim(0.27 + pieces[-1][-1][0], carried, PEDESTAL)
    return join([*(mitred(piece, corners, closed=True) for piece in pieces), top])


def _piers(nodes: Array) -> Patch:
    """Square piers under the arches, flush with the wall; those at the corners stand out into the court."""
    half = HALF_BAY - ARCH.radius
    face = quad(
        (-half, 0, HALF_WALL), (half, 0, HALF_WALL), (half, LOWER_CORNICE, HALF_WALL), (-half, LOWER_CORNICE, HALF_WALL)
    )
    pier = join([face, face.placed(turns=np.pi), box((2 * half, SPRINGING, ARCH.thickness), "-x +x")])
    pieces = []
    for x, z in nodes:
        at_end, at_side = abs(x) > HALF_X - HALF_BAY, abs(z) > HALF_Z - HALF_BAY
        if at_end and at_side:
            size = half + HALF_WALL
            corner = box((size, LOWER_CORNICE + 0.06, size), "-x +x -z +z")
            inward = (half - HALF_WALL) / 2
            pieces.append(corner.placed((x - np.sign(x) * inward, 0, z - np.sign(z) * inward)))
        else:
            pieces.append(pier.placed((x, 0, z), QUARTER if at_end else 0.0))
    return join(pieces)


def _loops(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Cornice and entablature, which run around the court."""
    corners = ring_corners(HALF_X - HALF_WALL, HALF_Z - HALF_WALL)

    def around(section: ArrayLike, base: float, smooth: bool = False) -> Patch:
        raised = np.asarray(section, dtype=float) + np.array([0.0, base])
        return mitred(raised, corners, closed=True, outward=False, smooth=smooth)

    floor = UPPER_FLOOR - LOWER_CORNICE
    back = [(-ARCH.thickness, CEILING - ARCHITRAVE), (-ARCH.thickness, 0.0), (0.0, 0.0)]
    if not detail.shows(MOULDINGS):
        yield "trim", around([(0.0, 0.0), (0.34, 0.1), (0.34, floor), (0.0, floor)], LOWER_CORNICE)
        yield "trim", around([*back, (0.0, EAVES - ARCHITRAVE)], ARCHITRAVE)
        return
    ogee = detail.curve([(0.0, 0.0), (0.012, 0.02), (0.035, 0.03), (0.06, 0.045), (0.07, 0.07)], least=2)
    yield (
        "trim",
        around([(0.0, 0.0), (0.03, 0.02), (0.05, 0.05), (0.05, 0.15), (0.27, 0.15), (0.27, 0.25)], LOWER_CORNICE),
    )
    yield "trim", around(ogee + np.array([0.27, 0.25]), LOWER_CORNICE, smooth=True)
    yield "trim", around([(0.34, 0.32), (0.34, floor), (0.0, floor)], LOWER_CORNICE)

    beam = [*back, (0.0, 0.14), (0.02, 0.14), (0.02, 0.29), (0.04, 0.31), (0.05, 0.36), (0.0, 0.36), (0.0, 0.64)]
    beam += [(0.05, 0.70), (0.05, 0.82), (0.34, 0.82), (0.34, 0.93)]
    yield "trim", around(beam, ARCHITRAVE)
    yield "trim", around(ogee + np.array([0.34, 0.93]), ARCHITRAVE, smooth=True)
    yield "trim", around([(0.41, 1.0), (0.41, EAVES - ARCHITRAVE - 0.017)], ARCHITRAVE)

    if not detail.shows(0.5):
        return
    for base, tall, depth in ((LOWER_CORNICE + 0.06, 0.09, 0.09), (ARCHITRAVE + 0.71, 0.11, 0.11)):
        for bays, turns in ((LONG, LONG_TURNS), (SHORT, SHORT_TURNS)):
            half = bays * HALF_BAY - HALF_WALL - 0.05 - depth
            face = -(HALF_Z if bays == LONG else HALF_X) + HALF_WALL + 0.05
            row = arcade.dentils(-half, half, (0.085, tall, depth), gap=0.075)
            yield "trim", row.placed((0, base, face)).placed(turns=turns)


def _floors(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Paving of the ground in a pattern of three stones, and of the upper gallery."""
    if not detail.shows(PAVING):
        return
    block = 2 if detail.shows(0.5) else 1
    step = BAY / (2 * block)
    columns, rows = 2 * block * (LONG + 2), 2 * block * (SHORT + 2)
    i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    x, z = step * (i - (columns - 1) / 2), step * (j - (rows - 1) / 2)
    court = (np.abs(x) < HALF_X) & (np.abs(z) < HALF_Z)
    under_fountain = (np.abs(x) < HALF_BAY) & (np.abs(z) < HALF_BAY)
    inlaid = court & (np.abs(z) < step) & (i % 2 == j % 2)
    border = (np.abs(np.abs(x) - HALF_X) < step) & (np.abs(z) < HALF_Z + step)
    border |= (np.abs(np.abs(z) - HALF_Z) < step) & (np.abs(x) < HALF_X + step)
    dark = np.where(court, (i // block + j // block) % 2 == 0, (i + j) % 2 == 0) | border
    slab = coverings.paving((step, step))
    for surface, chosen in (
        ("inlaid slab", inlaid),
        ("dark slab", dark & ~inlaid),
        ("pale slab", ~dark & ~inlaid),
    ):
        here = chosen & ~under_fountain
        offsets = np.stack([x[here], np.zeros(here.sum()), z[here]], axis=1)
        copies = slab.placed(offsets)
        seamless = copies.vertices[:, [0, 2]]  # veins run on from slab to slab; an inlaid figure fills each one
        yield surface, replace(copies, uv=copies.uv + step / 2 if surface == "inlaid slab" else seamless)

    inner, outer = HALF_Z - HALF_WALL, HALF_Z + BAY
    regions = [(-HALF_X - BAY, HALF_X + BAY, side * inner, side * outer, 32, 3) for side in (-1, 1)]
    regions += [(side * (HALF_X - HALF_WALL), side * (HALF_X + BAY), -inner, inner, 3, 6) for side in (-1, 1)]
    for x0, x1, z0, z1, nx, nz in regions:
        unit_x, unit_z = abs(x1 - x0) / nx, abs(z1 - z0) / nz
        x = min(x0, x1) + unit_x * (np.arange(nx) + 0.5)
        z = min(z0, z1) + unit_z * (np.arange(nz) + 0.5)
        places = np.stack(np.broadcast_arrays(x[:, None], UPPER_FLOOR, z), axis=-1).reshape(-1, 3)
        yield "pale slab", coverings.paving((unit_x, unit_z)).placed(places)


def _fountain(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """The fountain in the middle of the court, in a stone square of its own."""
    stone, water = furnishings.fountain(detail.at_most(3.0))
    yield "column marble", stone
    yield "water", water
    if not detail.shows(PAVING):
        return
    half, joint, depth = HALF_BAY, 0.014, 0.01
    yield "dark slab", mitred([(0, 0), (-joint, depth)], ring_corners(half, half), closed=True)
    corners = ring_corners(half - joint, half - joint)
    square = np.array([(x, depth, z) for x, z in [*corners, corners[0]]])
    angle = np.linspace(-3 * np.pi / 8, 13 * np.pi / 8, 9)
    octagon = furnishings.FOUNTAIN_RADIUS * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    octagon[:, 1] = depth
    octagon[-1] = octagon[0]
    yield "dark slab", bridge(square, octagon)
