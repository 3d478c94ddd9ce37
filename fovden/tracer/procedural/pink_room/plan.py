"""The pink room's plan: measures and places in metres.

The origin is the middle of the floor; x runs along the back wall to the right, y up, z from the back wall to the front.
Furniture is made in frames of its own, its front towards +z, and turned into place.
"""

from __future__ import annotations

import numpy as np

__all__ = [
    "ARMCHAIR",
    "BASKET",
    "BOOKCASE",
    "CHAIR_RAIL",
    "CHANDELIER_LIGHT",
    "COFFEE_TABLE",
    "CORNICE",
    "DAYBED",
    "DOOR",
    "FLOOR_LAMP",
    "HALF_X",
    "HALF_Z",
    "HEIGHT",
    "LAMP_LIGHT",
    "LAMP_TABLE",
    "PLANT",
    "POUF",
    "QUARTER",
    "ROSE",
    "RUG",
    "RUG_HALF",
    "SOFA",
    "STANDARD_SHADE",
    "WINDOW",
]

HALF_X, HALF_Z, HEIGHT = 3.0, 2.6, 3.0
CHAIR_RAIL = 0.86
CORNICE = 2.74
"""Heights of the rail between panelling and wallpaper, and of the cornice's lower edge."""

QUARTER = np.pi / 2

WINDOW = (-0.35, 1.55, 0.95, 2.52)
"""Opening (x0, x1, y0, y1) in the frame of the left wall, whose x is the room's -z."""

DOOR = (-0.45, 0.45, 2.08)
"""Left and right edge and height of the door, in the frame of the front wall, whose x is the room's -x."""

SOFA = (-1.0, 0.0, -2.53)
LAMP_TABLE = (0.56, 0.0, -2.12)
BOOKCASE = (1.98, 0.0, -2.59)
ARMCHAIR = (-1.62, 0.0, 1.22)
FLOOR_LAMP = (-2.52, 0.0, 0.98)
RUG = (-0.3, 0.0, -0.33)
RUG_HALF = (1.4, 1.0)
COFFEE_TABLE = (-0.4, 0.0, -0.55)
POUF = (0.62, 0.0, 1.02)
DAYBED = (2.92, 0.0, -0.62)
BASKET = (1.42, 0.0, -1.55)
PLANT = (-2.5, 0.0, -2.12)
ROSE = (-0.3, HEIGHT, -0.3)
"""Middle of the ceiling's rose, from which the chandelier hangs."""

LAMP_LIGHT = (LAMP_TABLE[0], 1.21, LAMP_TABLE[2])
CHANDELIER_LIGHT = (ROSE[0], 2.07, ROSE[2])
"""The two point lights, in the shades of the table lamp and of the chandelier."""

STANDARD_SHADE = 1.58
"""Height of the middle of the standard lamp's shade, metres; it is not lit."""
