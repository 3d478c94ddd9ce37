"""The atrium's architecture: everything of stone, wood and tile, the same for every seed.

Parts come as pairs of a surface's name and a patch in the world.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fovden.tracer.procedural.atrium import arcade, carvings, coverings, furnishings, orders
from fovden.tracer.procedural.atrium.plan import (
    ARCH,
    ARCHITRAVE,
    BAY,
    CEILING,
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
    PEDESTAL,
    QUARTER,
    ROOF_SLOPE,
    SHORT,
    SHORT_TURNS,
    SPRINGING,
    UPPER_FLOOR,
    UPPER_ORDER,
    VAULT_RISE,
    along,
    bay_middles,
    spread,
)
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import box, bridge, lathe, mitred, quad, ring_corners, tube

__all__ = ["court"]

DOORS = {LONG: (1, 4, 6), SHORT: ()}
"""Bays of the lower gallery that have a door, by the number of bays of the side."""


def court() -> Iterator[tuple[str, Patch]]:
    """Returns the court's parts, surface by surface: sides, corners, columns, cornices, floors and the fountain.

    Example:
        >>> sorted({surface for surface, _ in court()})[:3]
        ['ashlar', 'bronze', 'column marble']
    """
    for count, turns in ((LONG, LONG_TURNS), (SHORT, SHORT_TURNS)):
        for surface, patch in _side(count):
            yield surface, patch.placed(turns=turns)
    yield from _corners()
    yield from _columns()
    yield from _loops()
    yield from _floors()
    yield from _fountain()


def _side(bays: int) -> Iterator[tuple[str, Patch]]:
    """One side of the court in its own frame: the court in front of it, its arcade on z = -distance."""
    distance = HALF_Z if bays == LONG else HALF_X
    wall = -distance - BAY
    x = bay_middles(bays)
    nodes = bay_middles(bays + 1)
    yield from _arcade(x, nodes, -distance)
    yield from _gallery(bays, x, nodes, wall)
    yield from _upper_storey(bays, x, -distance, wall)
    yield from _roof(bays, -distance)


def _arcade(x: Array, nodes: Array, z: float) -> Iterator[tuple[str, Patch]]:
    """The arches towards the court and those across the gallery."""
    last = len(x) - 1
    fronts = []
    for i, middle in enumerate(x):
        left, right = (HALF_CELL if end else HALF_BAY for end in (i == 0, i == last))
        fronts.append(arcade.spandrel(ARCH, left, right, LOWER_CORNICE - SPRINGING).placed((middle, SPRINGING, z)))
    yield "ashlar", join(fronts)
    back = arcade.crescent(ARCH, HALF_CELL, HALF_CELL, VAULT_RISE).placed(turns=np.pi)
    yield "trim", join([arcade.intrados(ARCH), arcade.archivolt(ARCH)]).placed(along(x, SPRINGING, z))
    yield "plaster", back.placed(along(x, SPRINGING, z))
    faces = [
        arcade.crescent(ARCH, HALF_CELL, HALF_BAY, VAULT_RISE),
        arcade.crescent(ARCH, HALF_BAY, HALF_CELL, VAULT_RISE).placed(turns=np.pi),
    ]
    across = along(nodes, SPRINGING, z - HALF_BAY)
    yield "trim", arcade.intrados(ARCH, both_fronts=False).placed(across, QUARTER)
    yield "plaster", join(faces).placed(across, QUARTER)
    inner = nodes[1:-1]
    yield "trim", carvings.rosette(0.17).placed(along(inner, SPRINGING + 1.13, z + HALF_WALL))


def _gallery(bays: int, x: Array, nodes: Array, wall: float) -> Iterator[tuple[str, Patch]]:
    """Vaults, pilasters and the wall of the lower gallery."""
    vault = arcade.groin_vault((-HALF_CELL, HALF_CELL), (0.0, BAY - HALF_WALL), VAULT_RISE)
    yield "plaster", vault.placed(along(x, SPRINGING, wall))
    pier = orders.pilaster(ARCH.thickness, HALF_BAY - ARCH.radius, SPRINGING)
    yield "trim", pier.placed(along(nodes, 0.0, wall))
    yield "plaster", arcade.lunette(HALF_CELL, HALF_CELL, VAULT_RISE).placed(along(x, SPRINGING, wall))
    with_door = np.isin(np.arange(bays), DOORS[bays])
    blank = quad((-HALF_CELL, 0, 0), (HALF_CELL, 0, 0), (HALF_CELL, SPRINGING, 0), (-HALF_CELL, SPRINGING, 0))
    yield "ashlar", blank.placed(along(x[~with_door], 0.0, wall))
    yield "trim", _skirting(HALF_CELL, HALF_CELL).placed(along(x[~with_door], 0.0, wall))
    if with_door.any():
        for surface, patch in _door():
            yield surface, patch.placed(along(x[with_door], 0.0, wall))
    if bays == SHORT:
        for surface, patch in _wall_fountain():
            yield surface, patch.placed(along(x, 0.0, wall))
    else:
        framed = along(x[~with_door], 1.75, wall)
        yield "trim", _frame(1.6, 2.1).placed(framed)


def _skirting(left: float, right: float) -> Patch:
    return mitred([(0.04, 0.0), (0.04, 0.22), (0.025, 0.25), (0.0, 0.27)], [(-left, 0), (right, 0)])


def _frame(width: float, height: float) -> Patch:
    """A moulded frame on a wall, centred on the origin."""
    section = [(0.10, 0.0), (0.10, 0.03), (0.07, 0.05), (0.03, 0.035), (0.0, 0.02), (0.0, 0.0)]
    return mitred(section, ring_corners(width / 2, height / 2), closed=True).standing()


def _door() -> Iterator[tuple[str, Patch]]:
    half, tall, reveal = 0.7, 2.6, 0.25
    yield "ashlar", arcade.wall_with_opening(HALF_CELL, HALF_CELL, SPRINGING, (-half, half, 0.0, tall), reveal)
    section = [(0.16, 0.0), (0.16, 0.05), (0.12, 0.07), (0.05, 0.04), (0.0, 0.03), (0.0, 0.0)]
    path = [(half, 0.0), (half, -tall), (-half, -tall), (-half, 0.0)]
    yield "trim", mitred(section, path).standing()
    hood = [
        (-0.04, 0.0),
        (0.0, 0.0),
        (0.02, 0.06),
        (0.13, 0.08),
        (0.13, 0.14),
        (0.17, 0.18),
        (0.17, 0.20),
        (-0.04, 0.24),
    ]
    path = [(-half - 0.2, 0.0), (-half - 0.2, 0.04), (half + 0.2, 0.04), (half + 0.2, 0.0)]
    yield "trim", mitred(hood, path).placed((0, tall + 0.2, 0))
    leaf = arcade.door_leaf(half - 0.01, tall, (1.0, 1.6, 0.7))
    yield "oak", leaf.placed([(side * (half / 2 + 0.005), 0, -reveal) for side in (-1, 1)])
    yield "oak", box((0.05, tall, 0.04), "-x +x +z").placed((0, 0, -reveal))
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = tube(0.06 * np.stack([np.sin(angle), np.cos(angle) - 1, 0 * angle], axis=1), 0.009, 4)
    boss = lathe([(0.03, 0.0), (0.022, 0.015), (0.0, 0.02)], 8).standing()
    x = np.array([-0.075, 0.075])
    yield "bronze", ring.placed(along(x, 1.25, 0.02 - reveal))
    yield "bronze", boss.placed(along(x, 1.25, -reveal))


def _wall_fountain() -> Iterator[tuple[str, Patch]]:
    """A lion's head in a round frame over a basin."""
    head, shell = 0.34, 0.5
    surround = [
        orders.bead(head + 0.09, 0.05, 0.0, 0.08, 6),
        np.array([(head + 0.09, 0.08), (head + 0.06, 0.035), (head + 0.015, 0.03), (head + 0.01, 0.0)]),
    ]
    stone, water = carvings.basin(shell)
    yield "trim", carvings.lion_head(head).placed((0, 1.95, 0))
    yield "trim", join([lathe(piece, 28) for piece in surround]).standing().placed((0, 1.95, 0))
    yield "column marble", stone.placed((0, 1.05, 0))
    yield "water", water.placed((0, 1.05, 0))


def _upper_storey(bays: int, x: Array, z: float, wall: float) -> Iterator[tuple[str, Patch]]:
    """Balustrade, windows, pilasters and ceiling of the upper gallery."""
    clear = HALF_BAY - 0.27
    floor = UPPER_FLOOR
    kerb = box((2 * clear, 0.12, 0.22), "+y -z +z")
    half_rail = [(0.09, 0.0), (0.11, 0.03), (0.14, 0.05), (0.14, 0.10), (0.10, 0.14)]
    rail = [*half_rail, *((-z, y) for z, y in reversed(half_rail)), half_rail[0]]
    yield "trim", join([kerb, mitred(rail, [(-clear, 0), (clear, 0)]).placed((0, 0.74, 0))]).placed(along(x, floor, z))
    count = 7
    step = 2 * clear / count
    between = (x[:, None] + spread(count, step)).reshape(-1)
    yield "trim", orders.baluster(0.62, 0.072).placed(along(between, floor + 0.12, z))

    cells = bay_middles(bays + 2)
    tall = CEILING - floor
    opening = (-0.5, 0.5, 0.8, 2.8)
    walls = []
    for i, middle in enumerate(cells):
        left, right = (HALF_BAY - (0.0 if end else 0.2) for end in (i == 0, i == bays + 1))
        walls.append(arcade.wall_with_opening(left, right, tall, opening, 0.14).placed((middle, floor, wall)))
    yield "plaster", join(walls)
    yield "trim", _frame(1.0, 2.0).placed(along(cells, floor + 1.8, wall))
    shutters = arcade.louvres(0.496, 2.0, slats=15).placed([(-0.252, 0.8, -0.09), (0.252, 0.8, -0.09)])
    bar = box((0.03, 2.0, 0.04), "-x +x +z").placed((0, 0.8, -0.085))
    yield "oak", join([shutters, bar]).placed(along(cells, floor, wall))
    yield "trim", orders.pilaster(0.4, 0.12, tall).placed(along((cells[1:] + cells[:-1]) / 2, floor, wall))

    inside = z - HALF_WALL
    half = 5 * BAY if bays == LONG else HALF_Z + HALF_WALL
    columns, rows = (30, 3) if bays == LONG else (6, 3)
    unit_x, unit_z = 2 * half / columns, (inside - wall) / rows
    centre_x = spread(columns, unit_x)
    centre_z = wall + unit_z * (np.arange(rows) + 0.5)
    places = np.stack(np.broadcast_arrays(centre_x[:, None], CEILING, centre_z), axis=-1).reshape(-1, 3)
    yield "oak", coverings.coffer(unit_x / 2, unit_z / 2).placed(places)


def _roof(bays: int, z: float) -> Iterator[tuple[str, Patch]]:
    """The roof's slope towards the court: a deck and lines of cover tiles."""
    edge = z + HALF_WALL + 0.45
    half = (HALF_X if bays == LONG else HALF_Z) - HALF_WALL - 0.45
    run = edge - (z - BAY)
    rise = ROOF_SLOPE * run
    deck = quad(
        (-half, EAVES, edge),
        (half, EAVES, edge),
        (half + run, EAVES + rise, edge - run),
        (-half - run, EAVES + rise, edge - run),
    )
    yield "terracotta", deck
    spacing = 0.44
    count = int(2 * (half + run) / spacing)
    x = spread(count, spacing)
    begin = np.maximum(np.abs(x) + 0.4 * spacing - half, -0.06)
    for length in np.unique(np.round(run - begin, 9)):
        if length > 0.3:
            chosen = np.isclose(run - begin, length)
            start = run - length
            line = coverings.roof_tiles(length, spacing, ROOF_SLOPE, course=1.3)
            yield "terracotta", line.placed(along(x[chosen], EAVES + ROOF_SLOPE * start + 0.012, edge - start))


def _corners() -> Iterator[tuple[str, Patch]]:
    """The four vaulted corner cells of the lower gallery."""
    places = [
        (sx * (HALF_X + HALF_BAY), 0.0, sz * (HALF_Z + HALF_BAY)) for sx, sz in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    turns = QUARTER * np.arange(4)
    vault = arcade.groin_vault((-HALF_BAY, HALF_CELL), (-HALF_BAY, HALF_CELL), VAULT_RISE)
    yield "plaster", vault.placed((0, SPRINGING, 0)).placed(places, turns)
    for (left, right), offset, turn in (
        ((HALF_BAY, HALF_CELL), (0, 0, -HALF_BAY), 0.0),
        ((HALF_CELL, HALF_BAY), (-HALF_BAY, 0, 0), QUARTER),
    ):
        blank = quad((-left, 0, 0), (right, 0, 0), (right, SPRINGING, 0), (-left, SPRINGING, 0))
        yield "ashlar", blank.placed(offset, turn).placed(places, turns)
        yield "trim", _skirting(left, right).placed(offset, turn).placed(places, turns)
        top = arcade.lunette(left, right, VAULT_RISE).placed((0, SPRINGING, 0))
        yield "plaster", top.placed(offset, turn).placed(places, turns)


def _court_nodes() -> Array:
    """Plan (x, z) of the columns around the court."""
    x = bay_middles(LONG + 1)
    sides = [(x_i, side * HALF_Z) for x_i in x for side in (-1.0, 1.0)]
    return np.array([*sides, (-HALF_X, 0.0), (HALF_X, 0.0)])


def _columns() -> Iterator[tuple[str, Patch]]:
    """Columns of both storeys, and the pedestals of the upper ones."""
    nodes = _court_nodes()

    def at(height: float) -> Array:
        return np.stack([nodes[:, 0], np.full(len(nodes), height), nodes[:, 1]], axis=1)

    yield "column marble", orders.column(GROUND_ORDER).placed(at(0.0))
    foot = [(0.04, 0.0), (0.04, 0.14), (0.0, 0.19)]
    die = [(0.0, 0.19), (0.0, 0.78)]
    cap = [(0.0, 0.78), (0.03, 0.82), (0.03, 0.86), (0.055, 0.89), (0.055, PEDESTAL)]
    corners = ring_corners(0.27, 0.27)
    pedestal = [mitred(piece, corners, closed=True) for piece in (foot, die, cap)]
    pedestal.append(orders.rim(0.325, 1.38 * UPPER_ORDER.radius, PEDESTAL))
    yield "trim", join(pedestal).placed(at(UPPER_FLOOR))
    yield "column marble", orders.column(UPPER_ORDER).placed(at(UPPER_FLOOR + PEDESTAL))


def _loops() -> Iterator[tuple[str, Patch]]:
    """Cornice and entablature, which run around the court."""
    corners = ring_corners(HALF_X - HALF_WALL, HALF_Z - HALF_WALL)

    def around(section: list[tuple[float, float]], base: float, smooth: bool = False) -> Patch:
        raised = [(offset, base + y) for offset, y in section]
        return mitred(raised, corners, closed=True, outward=False, smooth=smooth)

    ogee = [(0.0, 0.0), (0.012, 0.02), (0.035, 0.03), (0.06, 0.045), (0.07, 0.07)]
    floor = UPPER_FLOOR - LOWER_CORNICE
    yield (
        "trim",
        around([(0.0, 0.0), (0.03, 0.02), (0.05, 0.05), (0.05, 0.15), (0.27, 0.15), (0.27, 0.25)], LOWER_CORNICE),
    )
    yield "trim", around([(0.27 + o, 0.25 + y) for o, y in ogee], LOWER_CORNICE, smooth=True)
    yield "trim", around([(0.34, 0.32), (0.34, floor), (0.0, floor)], LOWER_CORNICE)

    beam = [(-ARCH.thickness, CEILING - ARCHITRAVE), (-ARCH.thickness, 0.0), (0.0, 0.0), (0.0, 0.14), (0.02, 0.14)]
    beam += [
        (0.02, 0.29),
        (0.04, 0.31),
        (0.05, 0.36),
        (0.0, 0.36),
        (0.0, 0.64),
        (0.05, 0.70),
        (0.05, 0.82),
        (0.34, 0.82),
    ]
    beam += [(0.34, 0.93)]
    yield "trim", around(beam, ARCHITRAVE)
    yield "trim", around([(0.34 + o, 0.93 + y) for o, y in ogee], ARCHITRAVE, smooth=True)
    yield "trim", around([(0.41, 1.0), (0.41, EAVES - ARCHITRAVE - 0.017)], ARCHITRAVE)

    for base, tall, depth in ((LOWER_CORNICE + 0.06, 0.09, 0.09), (ARCHITRAVE + 0.71, 0.11, 0.11)):
        for bays, turns in ((LONG, LONG_TURNS), (SHORT, SHORT_TURNS)):
            half = bays * HALF_BAY - HALF_WALL - 0.05 - depth
            face = -(HALF_Z if bays == LONG else HALF_X) + HALF_WALL + 0.05
            row = arcade.dentils(-half, half, (0.085, tall, depth), gap=0.075)
            yield "trim", row.placed((0, base, face)).placed(turns=turns)


def _floors() -> Iterator[tuple[str, Patch]]:
    """Paving of the ground in a pattern of three stones, and of the upper gallery."""
    step = BAY / 4
    columns, rows = 4 * (LONG + 2), 4 * (SHORT + 2)
    i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    x, z = step * (i - (columns - 1) / 2), step * (j - (rows - 1) / 2)
    court = (np.abs(x) < HALF_X) & (np.abs(z) < HALF_Z)
    under_fountain = (np.abs(x) < HALF_BAY) & (np.abs(z) < HALF_BAY)
    inlaid = court & (np.abs(z) < step) & (i % 2 == j % 2)
    border = (np.abs(np.abs(x) - HALF_X) < step) & (np.abs(z) < HALF_Z + step)
    border |= (np.abs(np.abs(z) - HALF_Z) < step) & (np.abs(x) < HALF_X + step)
    dark = np.where(court, (i // 2 + j // 2) % 2 == 0, (i + j) % 2 == 0) | border
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


def _fountain() -> Iterator[tuple[str, Patch]]:
    """The fountain in the middle of the court, in a stone square of its own."""
    stone, water = furnishings.fountain()
    yield "column marble", stone
    yield "water", water
    half, joint, depth = HALF_BAY, 0.014, 0.01
    yield "dark slab", mitred([(0, 0), (-joint, depth)], ring_corners(half, half), closed=True)
    corners = ring_corners(half - joint, half - joint)
    square = np.array([(x, depth, z) for x, z in [*corners, corners[0]]])
    angle = np.linspace(-3 * np.pi / 8, 13 * np.pi / 8, 9)
    octagon = furnishings.FOUNTAIN_RADIUS * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    octagon[:, 1] = depth
    octagon[-1] = octagon[0]
    yield "dark slab", bridge(square, octagon)
