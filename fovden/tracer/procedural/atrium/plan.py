"""The atrium's plan: measures in metres, and the rhythm of its bays.

The ground plan is a grid of squares one bay wide, ten along x and four along z; the court takes the eight by two in the
middle. A side of the court is built in a frame of its own, looking at the court along +z, and turned into place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fovden.tracer.procedural.atrium.arcade import ArchShape
from fovden.tracer.procedural.atrium.orders import ColumnOrder
from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array

__all__ = [
    "ARCH",
    "ARCHITRAVE",
    "BALUSTERS",
    "BAY",
    "CAPITALS",
    "CEILING",
    "COFFERS",
    "EAVES",
    "GROUND_ORDER",
    "HALF_BAY",
    "HALF_CELL",
    "HALF_WALL",
    "HALF_X",
    "HALF_Z",
    "LONG",
    "LONG_TURNS",
    "LOWER_CORNICE",
    "MOULDINGS",
    "PAVING",
    "PEDESTAL",
    "QUARTER",
    "ROOF_SLOPE",
    "SHORT",
    "SHORT_TURNS",
    "SPRINGING",
    "UPPER_COLUMN",
    "UPPER_FLOOR",
    "UPPER_ORDER",
    "VAULTS",
    "VAULT_RISE",
    "WINDOWS",
    "along",
    "arch_shape",
    "bay_middles",
    "spread",
    "vault_segments",
]

BAY = 3.2
HALF_BAY = BAY / 2
LONG, SHORT = 8, 2
"""Bays along the court and across it."""

ARCH = ArchShape()
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

GROUND_ORDER = ColumnOrder(SPRINGING, radius=0.29, capital=0.46, abacus=0.43, bearing=HALF_WALL)
UPPER_ORDER = ColumnOrder(
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
"""Turns of the two long and the two short sides."""


CAPITALS, BALUSTERS, VAULTS, WINDOWS = 0.11, 0.13, 0.15, 0.18
MOULDINGS, PAVING, COFFERS = 0.3, 0.32, 0.42
"""Fineness from which there are columns under the arches, a balustrade, vaults, windows, profiles, slabs and coffers.

Below them are square piers, a parapet, flat ceilings, blank walls, plain edges and bare floors.
"""


def arch_shape(detail: Detail) -> ArchShape:
    """Returns the arches at a fineness; below that of mouldings their faces are flush with the wall.

    Example:
        >>> arch_shape(Detail(0.1)).outer
        1.2
    """
    outer = ARCH.outer if detail.shows(MOULDINGS) else ARCH.radius
    return replace(ARCH, outer=outer, detail=detail)


def vault_segments(detail: Detail) -> int:
    """Returns the even number of segments along a vault's edges, 24 as drawn.

    Example:
        >>> vault_segments(Detail(0.5))
        12
    """
    return 2 * detail.segments(12, least=2)


def bay_middles(count: int) -> Array:
    """Returns the middles of a row of bays along x, centred on 0.

    Example:
        >>> bay_middles(2).tolist()
        [-1.6, 1.6]
    """
    return spread(count, BAY)


def spread(count: int, step: float) -> Array:
    """Returns numbers ``step`` apart, centred on 0.

    Example:
        >>> spread(3, 0.5).tolist()
        [-0.5, 0.0, 0.5]
    """
    return np.arange(count, dtype=np.float64) * step - (count - 1) * step / 2


def along(x: Array, y: float, z: float) -> Array:
    """Returns places with the given x in a row, shape (k, 3).

    Example:
        >>> along(np.array([1.0, 2.0]), 5, 7).tolist()
        [[1.0, 5.0, 7.0], [2.0, 5.0, 7.0]]
    """
    return np.stack(np.broadcast_arrays(np.asarray(x, dtype=float), y, z), axis=-1)
