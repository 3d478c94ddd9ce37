"""The atrium: a colonnaded court of two storeys, the scene that comes with the library.

A court of 25.6 m by 6.4 m, open to the sky, lies inside a gallery of one bay's width on all four sides. Bays are
squares of 3.2 m. The ground floor has round arches on Corinthian columns and groin vaults behind them; the upper floor
has a balustrade, slender columns under a straight entablature and a coffered ceiling. It is made in the spirit of the
courtyard scenes that the field has long measured itself on, and has as many triangles and lights as the 2023 paper's
Sponza: 262,267, one directional and one point light (Table 2). Every triangle is detail that can be seen; the ivy
takes what the stone leaves over, four triangles a leaf and single ones for its buds.

The world's origin is the middle of the court's floor; x runs along the court, y up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from torch import Tensor

from fovden.camera import StereoCamera
from fovden.tracer.lights import DirectionalLight, PointLight
from fovden.tracer.materials import Material
from fovden.tracer.procedural import arcade, furnishings, orders, textures
from fovden.tracer.procedural.mesh_builder import (
    Array,
    MeshBuilder,
    Patch,
    Surface,
    box,
    bridge,
    join,
    lathe,
    mitred,
    quad,
    ring_corners,
    tube,
)
from fovden.tracer.scene import Scene

__all__ = ["TRIANGLES", "atrium"]

TRIANGLES = 262_267
"""Triangles of the 2023 paper's Sponza (Table 2)."""

BAY = 3.2
HALF_BAY = BAY / 2
LONG, SHORT = 8, 2
"""Bays along the court and across it."""

ARCH = arcade.ArchShape()
HALF_WALL = ARCH.thickness / 2
HALF_CELL = HALF_BAY - HALF_WALL
"""From the middle of a bay to the face of the wall that bounds it."""

SPRINGING = 3.4
VAULT_RISE = 1.5
LOWER_CORNICE = SPRINGING + 1.55
UPPER_FLOOR = 5.3
PEDESTAL = 0.95
UPPER_COLUMN = 2.6
ARCHITRAVE = UPPER_FLOOR + PEDESTAL + UPPER_COLUMN
CEILING = ARCHITRAVE + 0.25
EAVES = ARCHITRAVE + 1.03
ROOF_SLOPE = 0.42

HALF_X, HALF_Z = LONG * HALF_BAY, SHORT * HALF_BAY
"""Half extents of the court between the axes of its columns, metres."""

GROUND_ORDER = orders.ColumnOrder(SPRINGING, radius=0.29, capital=0.46, abacus=0.43, bearing=HALF_WALL)
UPPER_ORDER = orders.ColumnOrder(
    UPPER_COLUMN,
    0.17,
    capital=0.32,
    abacus=0.27,
    bearing=HALF_WALL,
    abacus_height=0.08,
    flutes=0,
    segments=16,
    leaf_rows=1,
    scroll_sides=3,
)

QUARTER = np.pi / 2
LONG_TURNS = (0.0, np.pi)
SHORT_TURNS = (QUARTER, -QUARTER)
CLOTHS = ("crimson cloth", "blue cloth", "green cloth", "ochre cloth")

CURTAINS = {0.0: (1, 3, 5), np.pi: (2, 4, 6), QUARTER: (), -QUARTER: ()}
BANNERS = {0.0: (2, 4, 6), np.pi: (1, 3, 5), QUARTER: (), -QUARTER: (0, 1)}
DOORS = {LONG: (1, 4, 6), SHORT: ()}
STRANDS = 96
STEM_POINTS = 7


def atrium(*, seed: int = 0) -> Scene:
    """Returns the atrium, the library's default scene: 262,267 triangles, a sun and one point light.

    The sun is the directional light; a point light above the fountain reaches the shaded galleries. The camera stands
    at one end of the court at eye height and looks along it.

    Args:
        seed: For what is irregular: the textures, the folds of the cloths and the growth of the plants. The
            architecture, the lights and the number of triangles are the same for every seed.

    Returns:
        The scene, within 33 m by 12 m by 13 m, with textures and smooth normals where surfaces are curved.

    Source: numbers of triangles and lights from the 2023 paper, Table 2. Cost: under 3 s.

    Example:
        >>> scene = atrium()
        >>> scene.triangle_count, len(scene.lights)
        (262267, 2)
    """
    rng = np.random.default_rng(seed)
    builder = MeshBuilder(_surfaces(rng))
    for bays, turns in ((LONG, LONG_TURNS), (SHORT, SHORT_TURNS)):
        for surface, patch in _side(bays):
            builder.add(surface, patch.placed(turns=turns))
    for surface, patch in (*_corners(), *_columns(), *_loops(), *_floors(), *_fountain()):
        builder.add(surface, patch)
    for surface, patch in (*_drapery(rng), *_plants(rng)):
        builder.add(surface, patch)
    _grow_ivy(builder, rng)
    camera = StereoCamera.look_at((-11.9, 1.9, -0.55), (0.0, 2.75, 0.1), fov_x_deg=78)
    sun = DirectionalLight((0.15, -1.0, 0.25), (11.6, 11.0, 10.1))
    lamp = PointLight((-4.8, 4.3, -0.7), (50.0, 47.0, 42.0))
    return builder.scene(name="atrium", camera=camera, lights=(sun, lamp))


def _surfaces(rng: np.random.Generator) -> dict[str, Surface]:
    white = (1.0, 1.0, 1.0)

    def textured(name: str, image: Tensor, tile: float) -> Surface:
        return Surface(Material(name, white, texture=image), tile)

    gold = (0.80, 0.67, 0.40)
    grounds = [(0.58, 0.17, 0.16), (0.23, 0.33, 0.55), (0.26, 0.44, 0.28), (0.74, 0.53, 0.26)]
    figures = [gold, (0.72, 0.72, 0.66), gold, (0.55, 0.24, 0.16)]
    cloths = [
        textured(name, textures.cloth(rng, ground, figure), 0.5)
        for name, ground, figure in zip(CLOTHS, grounds, figures, strict=True)
    ]
    surfaces = [
        textured("ashlar", textures.ashlar(rng, (0.75, 0.69, 0.58), (0.57, 0.52, 0.44)), 1.6),
        textured("plaster", textures.plaster(rng, (0.85, 0.80, 0.70), (0.72, 0.62, 0.50)), 3.0),
        textured("trim", textures.marble(rng, (0.80, 0.75, 0.66), (0.68, 0.61, 0.52)), 1.3),
        textured("column marble", textures.marble(rng, (0.82, 0.78, 0.71), (0.58, 0.50, 0.45)), 1.1),
        textured("pale slab", textures.marble(rng, (0.79, 0.75, 0.67), (0.60, 0.55, 0.50)), 1.7),
        textured("dark slab", textures.marble(rng, (0.60, 0.48, 0.43), (0.76, 0.69, 0.62)), 1.9),
        textured("inlaid slab", textures.inlay(rng, (0.79, 0.75, 0.67), (0.62, 0.36, 0.28), (0.45, 0.47, 0.45)), 0.8),
        textured("oak", textures.wood(rng, (0.68, 0.54, 0.39), (0.53, 0.39, 0.27)), 0.8),
        textured("terracotta", textures.terracotta(rng, (0.75, 0.50, 0.38)), 0.6),
        textured("ivy", textures.leaf(rng, (0.40, 0.55, 0.26), (0.60, 0.68, 0.42)), 1.0),
        textured("agave", textures.leaf(rng, (0.50, 0.62, 0.44), (0.66, 0.72, 0.52)), 1.0),
        Surface(Material("stem", (0.22, 0.16, 0.09))),
        Surface(Material("earth", (0.20, 0.14, 0.10))),
        Surface(Material("bronze", (0.34, 0.25, 0.13))),
        Surface(Material("water", (0.25, 0.38, 0.38))),
        *cloths,
    ]
    return {surface.material.name: surface for surface in surfaces}


def _bays(count: int) -> Array:
    """Middles of a side's bays along local x."""
    return _spread(count, BAY)


def _spread(count: int, step: float) -> Array:
    """Numbers ``step`` apart around 0."""
    return np.arange(count, dtype=np.float64) * step - (count - 1) * step / 2


def _along(x: Array, y: float, z: float) -> Array:
    """Places with the given x in a row."""
    return np.stack(np.broadcast_arrays(np.asarray(x, dtype=float), y, z), axis=-1)


def _side(bays: int) -> Iterator[tuple[str, Patch]]:
    """One side of the court in its own frame: the court in front of it, its arcade on z = -distance."""
    distance = HALF_Z if bays == LONG else HALF_X
    wall = -distance - BAY
    x = _bays(bays)
    nodes = _bays(bays + 1)
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
    yield "trim", join([arcade.intrados(ARCH), arcade.archivolt(ARCH)]).placed(_along(x, SPRINGING, z))
    yield "plaster", back.placed(_along(x, SPRINGING, z))
    faces = [
        arcade.crescent(ARCH, HALF_CELL, HALF_BAY, VAULT_RISE),
        arcade.crescent(ARCH, HALF_BAY, HALF_CELL, VAULT_RISE).placed(turns=np.pi),
    ]
    across = _along(nodes, SPRINGING, z - HALF_BAY)
    yield "trim", arcade.intrados(ARCH, both_fronts=False).placed(across, QUARTER)
    yield "plaster", join(faces).placed(across, QUARTER)
    inner = nodes[1:-1]
    yield "trim", furnishings.rosette(0.17).placed(_along(inner, SPRINGING + 1.13, z + HALF_WALL))


def _gallery(bays: int, x: Array, nodes: Array, wall: float) -> Iterator[tuple[str, Patch]]:
    """Vaults, pilasters and the wall of the lower gallery."""
    vault = arcade.groin_vault((-HALF_CELL, HALF_CELL), (0.0, BAY - HALF_WALL), VAULT_RISE)
    yield "plaster", vault.placed(_along(x, SPRINGING, wall))
    pier = orders.pilaster(ARCH.thickness, HALF_BAY - ARCH.radius, SPRINGING)
    yield "trim", pier.placed(_along(nodes, 0.0, wall))
    yield "plaster", arcade.lunette(HALF_CELL, HALF_CELL, VAULT_RISE).placed(_along(x, SPRINGING, wall))
    with_door = np.isin(np.arange(bays), DOORS[bays])
    blank = quad((-HALF_CELL, 0, 0), (HALF_CELL, 0, 0), (HALF_CELL, SPRINGING, 0), (-HALF_CELL, SPRINGING, 0))
    yield "ashlar", blank.placed(_along(x[~with_door], 0.0, wall))
    yield "trim", _skirting(HALF_CELL, HALF_CELL).placed(_along(x[~with_door], 0.0, wall))
    if with_door.any():
        for surface, patch in _door():
            yield surface, patch.placed(_along(x[with_door], 0.0, wall))
    if bays == SHORT:
        for surface, patch in _wall_fountain():
            yield surface, patch.placed(_along(x, 0.0, wall))
    else:
        framed = _along(x[~with_door], 1.75, wall)
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
    yield "bronze", ring.placed(_along(x, 1.25, 0.02 - reveal))
    yield "bronze", boss.placed(_along(x, 1.25, -reveal))


def _wall_fountain() -> Iterator[tuple[str, Patch]]:
    """A lion's head in a round frame over a basin."""
    head, shell = 0.34, 0.5
    surround = [
        orders.bead(head + 0.09, 0.05, 0.0, 0.08, 6),
        np.array([(head + 0.09, 0.08), (head + 0.06, 0.035), (head + 0.015, 0.03), (head + 0.01, 0.0)]),
    ]
    stone, water = furnishings.basin(shell)
    yield "trim", furnishings.lion_head(head).placed((0, 1.95, 0))
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
    yield "trim", join([kerb, mitred(rail, [(-clear, 0), (clear, 0)]).placed((0, 0.74, 0))]).placed(_along(x, floor, z))
    count = 7
    step = 2 * clear / count
    between = (x[:, None] + _spread(count, step)).reshape(-1)
    yield "trim", orders.baluster(0.62, 0.072).placed(_along(between, floor + 0.12, z))

    cells = _bays(bays + 2)
    tall = CEILING - floor
    opening = (-0.5, 0.5, 0.8, 2.8)
    walls = []
    for i, middle in enumerate(cells):
        left, right = (HALF_BAY - (0.0 if end else 0.2) for end in (i == 0, i == bays + 1))
        walls.append(arcade.wall_with_opening(left, right, tall, opening, 0.14).placed((middle, floor, wall)))
    yield "plaster", join(walls)
    yield "trim", _frame(1.0, 2.0).placed(_along(cells, floor + 1.8, wall))
    shutters = arcade.louvres(0.496, 2.0, slats=15).placed([(-0.252, 0.8, -0.09), (0.252, 0.8, -0.09)])
    yield "oak", shutters.placed(_along(cells, floor, wall))
    yield "trim", orders.pilaster(0.4, 0.12, tall).placed(_along((cells[1:] + cells[:-1]) / 2, floor, wall))

    inside = z - HALF_WALL
    half = 5 * BAY if bays == LONG else HALF_Z + HALF_WALL
    columns, rows = (30, 3) if bays == LONG else (6, 3)
    unit_x, unit_z = 2 * half / columns, (inside - wall) / rows
    centre_x = _spread(columns, unit_x)
    centre_z = wall + unit_z * (np.arange(rows) + 0.5)
    places = np.stack(np.broadcast_arrays(centre_x[:, None], CEILING, centre_z), axis=-1).reshape(-1, 3)
    yield "oak", arcade.coffer(unit_x / 2, unit_z / 2).placed(places)


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
    x = _spread(count, spacing)
    begin = np.maximum(np.abs(x) + 0.4 * spacing - half, -0.06)
    for length in np.unique(np.round(run - begin, 9)):
        if length > 0.3:
            chosen = np.isclose(run - begin, length)
            start = run - length
            line = arcade.roof_tiles(length, spacing, ROOF_SLOPE, course=1.3)
            yield "terracotta", line.placed(_along(x[chosen], EAVES + ROOF_SLOPE * start + 0.012, edge - start))


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
    x = _bays(LONG + 1)
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
    slab = arcade.paving((step, step))
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
        yield "pale slab", arcade.paving((unit_x, unit_z)).placed(places)


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


def _drapery(rng: np.random.Generator) -> Iterator[tuple[str, Patch]]:
    """Curtains in some of the arches, and cloths over the balustrade."""
    rod = tube([(-1.34, 0, 0), (1.34, 0, 0)], 0.018, 6)
    mirror = np.diag([-1.0, 1.0, 1.0])
    over_rail = [(-0.17, 5.80), (-0.17, 6.15), (-0.12, 6.205), (0.12, 6.205), (0.18, 6.13)]
    over_rail += [(0.34, 5.74), (0.60, 5.34), (0.625, 5.2), (0.625, 4.6), (0.625, 3.95)]
    colour = 0
    for turn in (*LONG_TURNS, *SHORT_TURNS):
        bays, distance = (LONG, HALF_Z) if turn in LONG_TURNS else (SHORT, HALF_X)
        x = _bays(bays)
        for i in CURTAINS[turn]:
            halves = [furnishings.curtain(rng, 1.22, 3.06, tie=1.3) for _ in range(2)]
            pair = join([halves[0], halves[1].transformed(mirror)]).placed((0, 0.04, 0))
            yield CLOTHS[colour % 4], pair.placed((x[i], 0, -distance)).placed(turns=turn)
            yield "bronze", rod.placed((x[i], 3.1, -distance)).placed(turns=turn)
            colour += 1
        for i in BANNERS[turn]:
            cloth = furnishings.banner(rng, 1.5, over_rail)
            yield CLOTHS[(colour + 2) % 4], cloth.placed((x[i], 0, -distance)).placed(turns=turn)
            colour += 1


def _plants(rng: np.random.Generator) -> Iterator[tuple[str, Patch]]:
    """Vases with agaves in the court."""
    places = [(x, 0.0, side * 2.35) for x in (-2 * BAY, 0.0, 2 * BAY) for side in (-1, 1)]
    places += [(HALF_X - 1.0, 0.0, side * 2.25) for side in (-1, 1)]
    body, earth = furnishings.vase()
    turns = 0.4 * rng.standard_normal(len(places))
    yield "terracotta", body.placed(places, turns)
    yield "earth", earth.placed(places, turns)
    for place in places:
        yield "agave", furnishings.agave(rng).placed((0, 0.85, 0)).placed(place)


def _grow_ivy(builder: MeshBuilder, rng: np.random.Generator) -> None:
    """Hangs ivy from the lower cornice and spends exactly the triangles that are left on its leaves and buds.

    Strands hang in clusters from the cornice's lip, each a stem with leaves on alternating sides. What does not make
    a leaf of four triangles becomes buds of one, at the ends of the first strands.
    """
    turns = rng.choice([*LONG_TURNS, *LONG_TURNS, *LONG_TURNS, *SHORT_TURNS], STRANDS // 6)
    turns = np.repeat(turns, 6)
    half = np.where(np.isin(turns, LONG_TURNS), HALF_X, HALF_Z) - 0.9
    distance = np.where(np.isin(turns, LONG_TURNS), HALF_Z, HALF_X)
    cluster = np.repeat(rng.uniform(-1, 1, STRANDS // 6), 6) * half
    x = np.clip(cluster + 0.35 * rng.standard_normal(STRANDS), -half, half)
    length = 0.5 + 1.7 * rng.random(STRANDS) ** 1.5
    down = np.linspace(0, 1, STEM_POINTS)
    swing = 0.06 * np.sin(3.0 * down + 2 * np.pi * rng.random((STRANDS, 1))) * down
    local_x = x[:, None] + swing
    local_y = UPPER_FLOOR + 0.02 - length[:, None] * down
    local_z = -distance[:, None] + HALF_WALL + 0.38 + 0.05 * rng.random((STRANDS, 1)) + 0.5 * swing
    cosine, sine = np.cos(turns)[:, None], np.sin(turns)[:, None]
    stems = np.stack([cosine * local_x + sine * local_z, local_y, -sine * local_x + cosine * local_z], axis=-1)
    thickness = np.linspace(0.006, 0.002, STEM_POINTS)
    builder.add("stem", *(tube(stem, thickness, 3) for stem in stems))

    left_over = TRIANGLES - builder.triangle_count
    leaves, buds = divmod(left_over, furnishings.LEAF_TRIANGLES)
    place = (np.arange(leaves) + 0.5) / leaves * length.sum()
    ends = np.cumsum(length)
    strand = np.minimum(np.searchsorted(ends, place), STRANDS - 1)
    share = (place - (ends - length)[strand]) / length[strand] * (STEM_POINTS - 1)
    lower = np.clip(share.astype(int), 0, STEM_POINTS - 2)
    within = (share - lower)[:, None]
    roots = (1 - within) * stems[strand, lower] + within * stems[strand, lower + 1]
    facing = turns[strand] + np.where(np.arange(leaves) % 2, 0.9, -0.9) + 0.5 * rng.standard_normal(leaves)
    roots += 0.03 * np.stack([np.sin(facing), 0.3 * rng.standard_normal(leaves), np.cos(facing)], axis=1)
    tilts = -0.5 + 0.35 * rng.standard_normal(leaves)
    sizes = (0.115 - 0.05 * share / (STEM_POINTS - 1)) * (0.75 + 0.5 * rng.random(leaves))
    builder.add("ivy", furnishings.ivy_leaves(roots, facing, tilts, sizes))
    builder.add("ivy", *(furnishings.ivy_bud(stems[i, -1], turns[i], 0.05) for i in range(buds)))
