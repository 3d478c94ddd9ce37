"""What stands where in the pink room."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.pink_room import (
    books,
    floor,
    flowers,
    furniture,
    lamps,
    plan,
    shell,
    upholstery,
    wicker,
    window,
    wool,
)
from fovden.tracer.procedural.pink_room.turning import disc, turned
from fovden.tracer.procedural.primitives import tube

__all__ = ["furnish"]

Pieces = Iterator[tuple[str, Patch]]

FINEST = {"tablecloth": 0.025, "valance": 0.025, "white oak": 0.03, "chintz": 0.035}
FINEST |= dict.fromkeys(("dark wood", "quilt", "linen", "porcelain", "terracotta", "earth", "sage cloth"), 0.05)
FINEST |= {"gilt": 0.05, "shade": 0.05, "brass": 0.2, "gold cord": 0.2, "piping": 0.2, "joint": 0.33, "willow": 0.35}
"""Fineness from which on there is anything of a surface; of the others there always is."""


def furnish(rng: np.random.Generator, detail: Detail) -> Pieces:
    """Yields everything in the room but the rug's pile, each patch with the name of its surface.

    Example:
        >>> sum(patch.triangle_count for _, patch in furnish(np.random.default_rng(0), Detail(0.02))) < 970
        True
    """
    for part in (_shell, _window_wall, _back_wall, _middle, _corners):
        for surface, patch in part(rng, detail):
            if detail.shows(FINEST.get(surface, 0.0)):
                yield surface, patch


def _shell(rng: np.random.Generator, detail: Detail) -> Pieces:
    """Floor, walls and ceiling."""
    blocks, ground = floor.parquet(rng, detail)
    yield "parquet", blocks
    yield "joint", ground
    yield from shell.shell(detail)


def _placed(pieces: Pieces, place: ArrayLike, turn: float = 0.0) -> Pieces:
    for surface, patch in pieces:
        yield surface, patch.placed(place, turns=turn)


def _window_wall(rng: np.random.Generator, detail: Detail) -> Pieces:
    """The left wall's window with what belongs to it, inside and out."""

    def pieces() -> Pieces:
        x0, x1, _, _ = plan.WINDOW
        yield "painted wood", window.window(detail)
        yield "meadow", window.hillside(rng, detail)
        if detail.shows(0.06):
            yield "enamel", window.radiator(detail).placed(((x0 + x1) / 2, 0, 0.14))
        yield from window.curtains(rng, detail)
        if detail.shows(0.15):
            yield from _window_box(rng, detail)

    yield from _placed(pieces(), (-plan.HALF_X, 0, 0), plan.QUARTER)


def _window_box(rng: np.random.Generator, detail: Detail) -> Pieces:
    """Blossoms outside the window."""
    x0, x1, y0, _ = plan.WINDOW
    count = detail.at_most(1.0).count(34, least=3)
    roots = np.stack(
        [
            rng.uniform(x0 + 0.05, x1 - 0.05, count),
            y0 + rng.uniform(-0.06, 0.10, count),
            rng.uniform(-0.5, -0.34, count),
        ],
        axis=1,
    )
    for k, surface in enumerate(("petal", "red petal", "white petal")):
        bloom = flowers.rose(0.034, Detail(0.5 * detail.fineness))
        places = roots[k::3]
        yield surface, bloom.placed(places, rng.uniform(0, 6, len(places)), rng.uniform(0.8, 1.2, len(places)))
    many = detail.at_most(1.0).count(330, least=6)
    green = np.stack(
        [rng.uniform(x0, x1, many), y0 + rng.uniform(-0.16, 0.05, many), rng.uniform(-0.5, -0.34, many)], axis=1
    )
    yield (
        "leaf",
        flowers.leaves(
            green, rng.uniform(0, 6.28, many), rng.normal(0.4, 0.4, many), rng.uniform(0.05, 0.09, many), detail
        ),
    )


def _back_wall(rng: np.random.Generator, detail: Detail) -> Pieces:
    """Sofa with its cushions and paintings, lamp on its table, bookcase."""
    yield from _placed(upholstery.seat(2.15, 3, detail, "velvet"), plan.SOFA)
    places = [
        (-0.68, 0.16, 0.35, "ticking", 0.46),
        (-0.36, 0.2, -0.12, "sage cloth", 0.42),
        (0.70, 0.17, -0.4, "chintz", 0.46),
        (0.36, 0.21, 0.15, "linen", 0.40),
    ]
    for x, z, turn, surface, size in places if detail.shows(0.05) else ():
        cloth, cord = upholstery.scatter_cushion((size, size, 0.16), detail, 0.38, turn)
        at = np.add(plan.SOFA, (x, 0.487, 0.28 + z))
        yield surface, cloth.placed(at)
        yield "piping", cord.placed(at)
    hung = [
        (-1.0, 1.78, 0.96, 0.72, "landscape"),
        (-1.98, 1.72, 0.40, 0.52, "bouquet"),
        (-0.02, 1.72, 0.40, 0.52, "fruit"),
    ]
    for x, y, width, height, name in hung:
        frame, canvas = furniture.painting(width, height, detail)
        yield "gilt", frame.placed((x, y, -plan.HALF_Z))
        yield name, canvas.placed((x, y, -plan.HALF_Z))
    cloth, beads = furniture.tablecloth(rng, 0.34, 0.70, detail)
    yield "tablecloth", cloth.placed(plan.LAMP_TABLE)
    if detail.shows(0.4):
        yield "gold cord", beads.placed(plan.LAMP_TABLE)
    yield from _placed(lamps.table_lamp(plan.LAMP_LIGHT[1] - 0.70, detail), np.add(plan.LAMP_TABLE, (0, 0.70, 0)))
    yield "white oak", furniture.bookcase(detail).placed(plan.BOOKCASE)
    if detail.shows(0.12):
        yield from _placed(_books(rng, detail), plan.BOOKCASE)


def _books(rng: np.random.Generator, detail: Detail) -> Pieces:
    """Rows of books in the bookcase, with a vase, a globe of wool and lying books between them."""
    width, height, depth = furniture.CASE
    bay = width / 2 - 1.5 * 0.026
    tops = [*furniture.SHELVES[1:], height - 0.13]
    bindings: list[Patch] = []
    papers: list[Patch] = []
    jars: list[Patch] = []
    for k, (low, high) in enumerate(zip(furniture.SHELVES, tops, strict=True)):
        for side in (-1, 1):
            start = side * width / 4 - bay / 2 + 0.004
            open_end = (k + (side > 0)) % 3 == 1
            length = (0.62 if open_end else 0.97) * bay - (0.0 if open_end else 0.05)
            row = books.row(rng, length, high - low - 0.03, depth - 0.03, detail)
            for piece, collection in zip(row, (bindings, papers), strict=True):
                collection.append(piece.placed((start, low, depth - 0.02)))
            if open_end:
                at = (start + 0.84 * bay, low + 0.001, depth / 2)
                if (k + side) % 2:
                    jars.append(_jar(0.75 * (high - low - 0.03), detail).placed(at))
                else:
                    lying = books.pile(rng, [(0.035, 0.20, 0.15), (0.03, 0.185, 0.14), (0.028, 0.17, 0.12)], detail)
                    for piece, collection in zip(lying, (bindings, papers), strict=True):
                        collection.append(piece.placed((at[0], low, depth / 2 + 0.03)))
    yield "bindings", join(bindings)
    yield "pages", join(papers)
    yield "porcelain", join(jars)


def _jar(height: float, detail: Detail) -> Patch:
    y = np.array([0.0, 0.02, 0.12, 0.45, 0.75, 0.85, 0.92, 1.0])
    r = np.array([0.22, 0.24, 0.26, 0.40, 0.30, 0.17, 0.17, 0.24])
    return turned(np.stack([0.8 * r, y], axis=1) * height, detail, 30)


def _middle(rng: np.random.Generator, detail: Detail) -> Pieces:
    """Rug, coffee table and what lies on it, pouf, chandelier."""
    yield "carpet", wool.rug_ground()
    if detail.shows(0.1):
        yield "wool", wool.fringe(rng, detail)
    wood, marble = furniture.coffee_table(detail)
    yield "dark wood", wood.placed(np.add(plan.COFFEE_TABLE, (0, 0.03, 0)))
    yield "marble", marble.placed(np.add(plan.COFFEE_TABLE, (0, 0.03, 0)))
    if detail.shows(0.1):
        yield from _placed(_on_the_table(rng, detail), np.add(plan.COFFEE_TABLE, (0, 0.486, 0)))
        yield "pink wool", wool.pouf(0.29, 0.40, detail).placed(plan.POUF)
        yield from _placed(
            lamps.chandelier(plan.HEIGHT - plan.CHANDELIER_LIGHT[1] - 0.03, detail), np.add(plan.ROSE, (0, -0.03, 0))
        )


def _on_the_table(rng: np.random.Generator, detail: Detail) -> Pieces:
    """A vase of roses, a pile of books, a cup and a pot of tea."""
    vase = [
        (0.045, 0.001),
        (0.05, 0.006),
        (0.075, 0.06),
        (0.082, 0.11),
        (0.055, 0.17),
        (0.04, 0.20),
        (0.052, 0.228),
        (0.046, 0.222),
        (0.034, 0.20),
    ]
    yield "porcelain", turned(vase, detail, 44).placed((-0.1, 0, -0.04))
    places, stems, green = flowers.bouquet(rng, detail.at_most(1.0).segments(6, least=3), 0.19, 0.20, 0.05, detail)
    yield "stem", stems.placed((-0.1, 0.225, -0.04))
    yield "leaf", green.placed((-0.1, 0.225, -0.04))
    bloom = flowers.rose(0.05, detail)
    for k, surface in enumerate(("petal", "red petal", "white petal")):
        some = places[k::3]
        yield (
            surface,
            bloom.placed(
                some + np.array([-0.1, 0.215, -0.04]), rng.uniform(0, 6, len(some)), rng.uniform(0.8, 1.15, len(some))
            ),
        )
    lying = books.pile(rng, [(0.034, 0.24, 0.18), (0.026, 0.21, 0.15), (0.03, 0.19, 0.14)], detail)
    for surface, piece in zip(("bindings", "pages"), lying, strict=True):
        yield surface, piece.placed((0.32, 0, -0.1), turns=0.35)
    saucer = [(0.056, 0.008), (0.074, 0.018), (0.06, 0.012), (0.026, 0.007)]
    cup = [(0.022, 0.009), (0.026, 0.014), (0.04, 0.04), (0.043, 0.066), (0.041, 0.065), (0.039, 0.054)]
    a = np.linspace(-0.45 * np.pi, 0.45 * np.pi, detail.segments(12, least=3) + 1)
    ear = tube(
        np.stack([0.038 + 0.026 * np.cos(a), 0.042 + 0.02 * np.sin(a), 0 * a], axis=1),
        0.0038,
        detail.segments(7, least=3),
    )
    tea = disc(0.0405, 0.056, detail.segments(24, least=6))
    cups = [(0.28, 0.0, 0.2), (-0.4, 0.0, 0.12)]
    yield "porcelain", join([turned(saucer, detail, 36), turned(cup, detail, 32), ear]).placed(cups, [0.6, 2.4])
    yield "earth", tea.placed(cups)


def _corners(rng: np.random.Generator, detail: Detail) -> Pieces:
    """Armchair with its throw, standard lamp, daybed, potted fig, basket."""
    turn = 1.95
    yield from _placed(upholstery.seat(0.98, 1, detail, "chintz"), plan.ARMCHAIR, turn)
    yield from _placed(lamps.standard_lamp(plan.STANDARD_SHADE, detail), plan.FLOOR_LAMP)
    yield from _placed(upholstery.daybed(rng, 1.95, 0.88, detail), plan.DAYBED, -plan.QUARTER)
    if detail.shows(0.12):
        cloth, fringe = wool.throw(upholstery.seat_section(), 0.5, 0.034, detail)
        for piece in (cloth, fringe):
            local = piece.placed((0, 0, -0.02), turns=-plan.QUARTER)
            yield "wool", local.placed((-0.05, 0, 0)).placed(plan.ARMCHAIR, turns=turn)
    cushion, cord = upholstery.scatter_cushion((0.42, 0.42, 0.16), detail, 0.35, 0.1)
    for surface, piece in (("sage cloth", cushion), ("piping", cord)):
        yield surface, piece.placed((0.12, 0.525, 0.47)).placed(plan.ARMCHAIR, turns=turn)
    pot = [
        (0.13, 0.001),
        (0.15, 0.05),
        (0.185, 0.24),
        (0.19, 0.30),
        (0.205, 0.31),
        (0.205, 0.345),
        (0.185, 0.345),
        (0.175, 0.30),
    ]
    yield "terracotta", turned(pot, detail, 40).placed(plan.PLANT)
    soil = disc(0.176, 0.305, detail.segments(40, least=6))
    yield "earth", soil.placed(plan.PLANT)
    if detail.shows(0.12):
        wood, green = flowers.plant(rng, 1.35, detail)
        yield "stem", wood.placed(np.add(plan.PLANT, (0, 0.30, 0)))
        yield "leaf", green.placed(np.add(plan.PLANT, (0, 0.30, 0)))
        yield "willow", wicker.basket(0.19, 0.30, detail).placed(plan.BASKET)
        for k, (x, y, z) in enumerate(((0.06, 0.24, 0.05), (-0.07, 0.24, 0.03), (0.0, 0.23, -0.09), (0.0, 0.33, 0.0))):
            yield (
                ("pink wool", "wool")[k % 2],
                wool.yarn_ball(rng, 0.068, detail).placed(np.add(plan.BASKET, (x, y, z))),
            )
