"""One side of the atrium's court: arches, the vaulted gallery behind them, the upper storey and the roof.

Parts come as pairs of a surface's name and a patch, in the side's own frame: the court in front, the arcade on
z = -distance, the gallery's wall one bay behind it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fovden.tracer.procedural.atrium import arcade, carvings, coverings, orders
from fovden.tracer.procedural.atrium.plan import (
    ARCH,
    BALUSTERS,
    BAY,
    CAPITALS,
    CEILING,
    COFFERS,
    EAVES,
    HALF_BAY,
    HALF_CELL,
    HALF_WALL,
    HALF_X,
    HALF_Z,
    LONG,
    LOWER_CORNICE,
    MOULDINGS,
    QUARTER,
    ROOF_SLOPE,
    SHORT,
    SPRINGING,
    UPPER_FLOOR,
    VAULT_RISE,
    VAULTS,
    WINDOWS,
    along,
    arch_shape,
    bay_middles,
    spread,
    vault_segments,
)
from fovden.tracer.procedural.detail import DRAWN, Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import box, lathe, mitred, quad, ring_corners, tube

__all__ = ["side", "skirting"]

DOORS = {LONG: (1, 4, 6), SHORT: ()}
"""Bays of the lower gallery that have a door, by the number of bays of the side."""


def side(bays: int, detail: Detail = DRAWN) -> Iterator[tuple[str, Patch]]:
    """Returns one side's parts, surface by surface.

    Args:
        bays: Number of its bays, LONG or SHORT.
        detail: Fineness.

    Returns:
        Pairs of a surface's name and a patch.

    Example:
        >>> sorted({surface for surface, _ in side(SHORT)})[:3]
        ['ashlar', 'column marble', 'oak']
    """
    distance = HALF_Z if bays == LONG else HALF_X
    wall = -distance - BAY
    x = bay_middles(bays)
    nodes = bay_middles(bays + 1)
    yield from _arcade(x, nodes, -distance, detail)
    if detail.shows(VAULTS):
        yield from _gallery(bays, x, nodes, wall, detail)
    yield from _upper_storey(bays, x, -distance, wall, detail)
    yield from _roof(bays, -distance, detail)


def _arcade(x: Array, nodes: Array, z: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """The arches towards the court and those across the gallery."""
    arch = arch_shape(detail)
    for surface, patch in _wall_over_arches(arch, x, HALF_CELL, LOWER_CORNICE - SPRINGING):
        yield surface, patch.placed((0, SPRINGING, z))
    yield "trim", _around_arch(arch).placed(along(x, SPRINGING, z))
    if not detail.shows(VAULTS):
        for surface, patch in _wall_over_arches(arch, x, HALF_BAY + HALF_WALL, VAULT_RISE):
            yield surface, patch.placed((0, 0, 0), np.pi).placed((0, SPRINGING, z))
        return
    segments = vault_segments(detail)
    back = arcade.crescent(arch, HALF_CELL, HALF_CELL, VAULT_RISE, segments).placed(turns=np.pi)
    yield "plaster", back.placed(along(x, SPRINGING, z))
    faces = [
        arcade.crescent(arch, HALF_CELL, HALF_BAY, VAULT_RISE, segments),
        arcade.crescent(arch, HALF_BAY, HALF_CELL, VAULT_RISE, segments).placed(turns=np.pi),
    ]
    across = along(nodes, SPRINGING, z - HALF_BAY)
    yield "trim", arcade.intrados(arch, both_fronts=False).placed(across, QUARTER)
    yield "plaster", join(faces).placed(across, QUARTER)
    if detail.shows(0.45):
        flower = carvings.rosette(0.17, detail=detail.at_most(3.0))
        yield "trim", flower.placed(along(nodes[1:-1], SPRINGING + 1.13, z + HALF_WALL))


def _around_arch(arch: arcade.ArchShape) -> Patch:
    if not arch.detail.shows(MOULDINGS):
        return arcade.intrados(arch)
    return join([arcade.intrados(arch), arcade.archivolt(arch)])


def _wall_over_arches(arch: arcade.ArchShape, x: Array, end: float, top: float) -> Iterator[tuple[str, Patch]]:
    """One face of the wall above a row of arches; ``end`` is its distance from the last bay's middle.

    A strip of another stone parts the bays where the wall is coarse, as wide as the piers where those carry it.
    """
    last = len(x) - 1
    piers = not arch.detail.shows(CAPITALS)
    strip = HALF_BAY - arch.radius if piers else (0.0 if arch.detail.shows(0.9) else 0.2)
    end = HALF_BAY - strip if piers else end
    bays = []
    for i, middle in enumerate(x):
        left, right = (end if at_end else HALF_BAY - strip for at_end in (i == 0, i == last))
        bays.append(arcade.spandrel(arch, left, right, top).placed((middle, 0, 0)))
    yield "ashlar", join(bays)
    if strip > 0 and not piers:
        face = quad((-strip, 0, HALF_WALL), (strip, 0, HALF_WALL), (strip, top, HALF_WALL), (-strip, top, HALF_WALL))
        yield "trim", face.placed(along((x[1:] + x[:-1]) / 2, 0.0, 0.0))


def _gallery(bays: int, x: Array, nodes: Array, wall: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Vaults, pilasters and the wall of the lower gallery."""
    segments = vault_segments(detail)
    vault = arcade.groin_vault((-HALF_CELL, HALF_CELL), (0.0, BAY - HALF_WALL), VAULT_RISE, segments)
    yield "plaster", vault.placed(along(x, SPRINGING, wall))
    pier = orders.pilaster(ARCH.thickness, HALF_BAY - ARCH.radius, SPRINGING, detail)
    yield "trim", pier.placed(along(nodes, 0.0, wall))
    yield "plaster", arcade.lunette(HALF_CELL, HALF_CELL, VAULT_RISE, segments).placed(along(x, SPRINGING, wall))
    with_door = np.isin(np.arange(bays), DOORS[bays]) & detail.shows(0.25)
    blank = quad((-HALF_CELL, 0, 0), (HALF_CELL, 0, 0), (HALF_CELL, SPRINGING, 0), (-HALF_CELL, SPRINGING, 0))
    yield "ashlar", blank.placed(along(x[~with_door], 0.0, wall))
    if detail.shows(0.35):
        yield "trim", skirting(HALF_CELL, HALF_CELL).placed(along(x[~with_door], 0.0, wall))
    if with_door.any():
        for surface, patch in _door(detail):
            yield surface, patch.placed(along(x[with_door], 0.0, wall))
    if bays == SHORT and detail.shows(0.3):
        for surface, patch in _wall_fountain(detail):
            yield surface, patch.placed(along(x, 0.0, wall))
    elif bays == LONG and detail.shows(0.35):
        framed = along(x[~with_door], 1.75, wall)
        yield "trim", _frame(1.6, 2.1).placed(framed)


def skirting(left: float, right: float) -> Patch:
    """Returns a moulding at the foot of a wall on the plane z = 0, from x = -left to x = right.

    Example:
        >>> skirting(1.0, 1.0).triangle_count
        6
    """
    return mitred([(0.04, 0.0), (0.04, 0.22), (0.025, 0.25), (0.0, 0.27)], [(-left, 0), (right, 0)])


def _frame(width: float, height: float) -> Patch:
    """A moulded frame on a wall, centred on the origin."""
    section = [(0.10, 0.0), (0.10, 0.03), (0.07, 0.05), (0.03, 0.035), (0.0, 0.02), (0.0, 0.0)]
    return mitred(section, ring_corners(width / 2, height / 2), closed=True).standing()


def _door(detail: Detail) -> Iterator[tuple[str, Patch]]:
    half, tall, reveal = 0.7, 2.6, 0.25
    moulded = detail.shows(0.45)
    yield "ashlar", arcade.wall_with_opening(HALF_CELL, HALF_CELL, SPRINGING, (-half, half, 0.0, tall), reveal)
    if moulded:
        section = [(0.16, 0.0), (0.16, 0.05), (0.12, 0.07), (0.05, 0.04), (0.0, 0.03), (0.0, 0.0)]
        path = [(half, 0.0), (half, -tall), (-half, -tall), (-half, 0.0)]
        yield "trim", mitred(section, path).standing()
        hood = [(-0.04, 0.0), (0.0, 0.0), (0.02, 0.06), (0.13, 0.08), (0.13, 0.14)]
        hood += [(0.17, 0.18), (0.17, 0.20), (-0.04, 0.24)]
        path = [(-half - 0.2, 0.0), (-half - 0.2, 0.04), (half + 0.2, 0.04), (half + 0.2, 0.0)]
        yield "trim", mitred(hood, path).placed((0, tall + 0.2, 0))
    leaf = arcade.door_leaf(half - 0.01, tall, (1.0, 1.6, 0.7) if detail.shows(0.4) else ())
    yield "oak", leaf.placed([(side * (half / 2 + 0.005), 0, -reveal) for side in (-1, 1)])
    yield "oak", box((0.05, tall, 0.04), "-x +x +z").placed((0, 0, -reveal))
    if moulded:
        small = detail.at_most(2.0)
        angle = np.linspace(0, 2 * np.pi, small.segments(12) + 1)
        circle = 0.06 * np.stack([np.sin(angle), np.cos(angle) - 1, 0 * angle], axis=1)
        ring = tube(circle, 0.009, small.segments(4, least=3))
        profile = small.curve([(0.03, 0.0), (0.022, 0.015), (0.0, 0.02)])
        boss = lathe(profile, small.segments(8)).standing()
        x = np.array([-0.075, 0.075])
        yield "bronze", ring.placed(along(x, 1.25, 0.02 - reveal))
        yield "bronze", boss.placed(along(x, 1.25, -reveal))


def _wall_fountain(detail: Detail) -> Iterator[tuple[str, Patch]]:
    """A lion's head in a round frame over a basin."""
    head, shell = 0.34, 0.5
    surround = [
        detail.curve(orders.bead(head + 0.09, 0.05, 0.0, 0.08, 6), least=2),
        np.array([(head + 0.09, 0.08), (head + 0.06, 0.035), (head + 0.015, 0.03), (head + 0.01, 0.0)]),
    ]
    stone, water = carvings.basin(shell, detail=detail.at_most(4.0))
    yield "trim", carvings.lion_head(head, detail.at_most(4.0)).placed((0, 1.95, 0))
    yield (
        "trim",
        join([lathe(piece, detail.segments(28, least=8)) for piece in surround]).standing().placed((0, 1.95, 0)),
    )
    yield "column marble", stone.placed((0, 1.05, 0))
    yield "water", water.placed((0, 1.05, 0))


def _upper_storey(bays: int, x: Array, z: float, wall: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Balustrade, windows, pilasters and ceiling of the upper gallery."""
    if detail.shows(BALUSTERS):
        yield from _balustrade(x, z, detail)
    if detail.shows(WINDOWS):
        yield from _windows(bay_middles(bays + 2), wall, detail)
    if detail.shows(COFFERS):
        inside = z - HALF_WALL
        half = 5 * BAY if bays == LONG else HALF_Z + HALF_WALL
        columns, rows = (30, 3) if bays == LONG else (6, 3)
        unit_x, unit_z = 2 * half / columns, (inside - wall) / rows
        centre_x = spread(columns, unit_x)
        centre_z = wall + unit_z * (np.arange(rows) + 0.5)
        places = np.stack(np.broadcast_arrays(centre_x[:, None], CEILING, centre_z), axis=-1).reshape(-1, 3)
        yield "oak", coverings.coffer(unit_x / 2, unit_z / 2).placed(places)


def _balustrade(x: Array, z: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """Kerbs, balusters and rails between the pedestals of the upper columns."""
    clear = HALF_BAY - 0.27
    kerb = box((2 * clear, 0.12, 0.22), "+y -z +z")
    half_rail = [(0.09, 0.0), (0.11, 0.03), (0.14, 0.05), (0.14, 0.10), (0.10, 0.14)]
    if not detail.shows(MOULDINGS):
        half_rail = [(0.12, 0.0), (0.12, 0.14)]
    rail = [*half_rail, *((-z, y) for z, y in reversed(half_rail)), half_rail[0]]
    above = mitred(rail, [(-clear, 0), (clear, 0)]).placed((0, 0.74, 0))
    yield "trim", join([kerb, above]).placed(along(x, UPPER_FLOOR, z))
    count = min(detail.segments(7, least=3), 7)
    between = (x[:, None] + spread(count, 2 * clear / count)).reshape(-1)
    yield "trim", orders.baluster(0.62, 0.072, detail.at_most(4.0)).placed(along(between, UPPER_FLOOR + 0.12, z))


def _windows(cells: Array, wall: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """The wall with shuttered windows, and pilasters between them."""
    floor, tall = UPPER_FLOOR, CEILING - UPPER_FLOOR
    opening = (-0.5, 0.5, 0.8, 2.8)
    walls = []
    for i, middle in enumerate(cells):
        left, right = (HALF_BAY - (0.0 if end else 0.2) for end in (i == 0, i == len(cells) - 1))
        walls.append(arcade.wall_with_opening(left, right, tall, opening, 0.14).placed((middle, floor, wall)))
    yield "plaster", join(walls)
    if detail.shows(0.35):
        yield "trim", _frame(1.0, 2.0).placed(along(cells, floor + 1.8, wall))
    slats = min(detail.segments(15, least=3), 30)
    shutters = arcade.louvres(0.496, 2.0, slats).placed([(-0.252, 0.8, -0.09), (0.252, 0.8, -0.09)])
    bar = box((0.03, 2.0, 0.04), "-x +x +z").placed((0, 0.8, -0.085))
    yield "oak", join([shutters, bar]).placed(along(cells, floor, wall))
    pier = orders.pilaster(0.4, 0.12, tall, detail)
    yield "trim", pier.placed(along((cells[1:] + cells[:-1]) / 2, floor, wall))


def _roof(bays: int, z: float, detail: Detail) -> Iterator[tuple[str, Patch]]:
    """The roof's slope towards the court: a deck and lines of cover tiles."""
    eaves = 0.45 if detail.shows(MOULDINGS) else 0.0
    edge = z + HALF_WALL + eaves
    half = (HALF_X if bays == LONG else HALF_Z) - HALF_WALL - eaves
    run = edge - (z - BAY)
    rise = ROOF_SLOPE * run
    deck = quad(
        (-half, EAVES, edge),
        (half, EAVES, edge),
        (half + run, EAVES + rise, edge - run),
        (-half - run, EAVES + rise, edge - run),
    )
    yield "terracotta", deck
    if not detail.shows(0.4):
        return
    spacing, course = 0.44, 1.3 / min(max(detail.fineness, 1.0), 4.0)
    count = int(2 * (half + run) / spacing)
    x = spread(count, spacing)
    begin = np.maximum(np.abs(x) + 0.4 * spacing - half, -0.06)
    for length in np.unique(np.round(run - begin, 9)):
        if length > 0.3:
            chosen = np.isclose(run - begin, length)
            start = run - length
            line = coverings.roof_tiles(length, spacing, ROOF_SLOPE, course, detail)
            yield "terracotta", line.placed(along(x[chosen], EAVES + ROOF_SLOPE * start + 0.012, edge - start))
