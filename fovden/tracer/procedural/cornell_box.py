"""The Cornell box, in metres."""

from __future__ import annotations

import numpy as np

from fovden.camera import StereoCamera
from fovden.checks import require
from fovden.tracer.materials import Material
from fovden.tracer.procedural.mesh_builder import MeshBuilder, Surface
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.procedural.primitives import bridge, quad
from fovden.tracer.scene import Scene

__all__ = ["cornell_box"]

METRES_PER_UNIT = 0.01
"""The published data give millimetres of a tabletop model; a hundredth of each number makes it a room."""

HEIGHT = 548.8
SHORT_BLOCK = (165.0, [(130.0, 65.0), (82.0, 225.0), (240.0, 272.0), (290.0, 114.0)])
TALL_BLOCK = (330.0, [(423.0, 247.0), (265.0, 296.0), (314.0, 456.0), (472.0, 406.0)])
LIGHT = [(343.0, 227.0), (343.0, 332.0), (213.0, 332.0), (213.0, 227.0)]


def cornell_box(*, seed: int = 0, detail: int | None = None) -> Scene:
    """Returns the Cornell box: five walls, two blocks and an area light set flush into the ceiling.

    The light fills a hole of its own shape in the ceiling, as in the measured box, so nothing is coincident; the
    blocks have no bottoms. 38 triangles, two of them emissive and facing down.

    Args:
        seed: Ignored: nothing here is random.
        detail: Must be ``None``: the box has the triangles that it has.

    Returns:
        The scene. Seen from its camera the red wall is on the left and the green one on the right.

    Source: geometry and camera from "Cornell Box Data" (Cornell University Program of Computer Graphics, 1998), its
    units divided by 100. Reflectances and radiance are the usual linear RGB rendering of the measured spectra, as in
    "CornellBox-Original" of McGuire's Computer Graphics Archive (2017); the field of view is that of the published
    lens, 2 atan(0.025 / (2 * 0.035)) = 39.3077 degrees.

    Example:
        >>> cornell_box().triangle_count
        38
    """
    del seed
    require(detail is None, "detail", detail, "None, as the Cornell box has 38 triangles and no other number")
    builder = MeshBuilder(
        {
            "white": Surface(Material("white", (0.725, 0.71, 0.68))),
            "red": Surface(Material("red", (0.63, 0.065, 0.05))),
            "green": Surface(Material("green", (0.14, 0.45, 0.091))),
            "light": Surface(Material("light", (0.78, 0.78, 0.78), (17.0, 12.0, 4.0))),
        }
    )
    floor = [(552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)]
    ceiling = [(556.0, HEIGHT, 0), (556.0, HEIGHT, 559.2), (0, HEIGHT, 559.2), (0, HEIGHT, 0)]
    light = [(x, HEIGHT, z) for x, z in LIGHT]
    back = [(549.6, 0, 559.2), (0, 0, 559.2), (0, HEIGHT, 559.2), (556.0, HEIGHT, 559.2)]
    right = [(0, 0, 559.2), (0, 0, 0), (0, HEIGHT, 0), (0, HEIGHT, 559.2)]
    left = [(552.8, 0, 0), (549.6, 0, 559.2), (556.0, HEIGHT, 559.2), (556.0, HEIGHT, 0)]
    around_light = bridge([*light, light[0]], [*ceiling, ceiling[0]]).reversed()
    builder.add("white", _scaled(quad(*floor)), _scaled(around_light), _scaled(quad(*back)))
    builder.add("green", _scaled(quad(*right)))
    builder.add("red", _scaled(quad(*left)))
    builder.add("white", _scaled(_block(*SHORT_BLOCK)), _scaled(_block(*TALL_BLOCK)))
    builder.add("light", _scaled(quad(*light)))
    camera = StereoCamera.look_at((2.78, 2.73, -8.0), (2.78, 2.73, 0.0), fov_y_deg=39.3077, resolution=(512, 512))
    return builder.scene(name="cornell_box", camera=camera)


def _block(height: float, plan: list[tuple[float, float]]) -> Patch:
    """The top and the four sides of a block; ``plan`` lists its corners (x, z) so that the top faces up."""
    base = np.array([(x, 0.0, z) for x, z in plan])
    top = base + np.array([0.0, height, 0.0])
    sides = [quad(base[i], base[(i + 1) % 4], top[(i + 1) % 4], top[i]) for i in range(4)]
    return join([quad(*top), *sides])


def _scaled(patch: Patch) -> Patch:
    return patch.placed(scales=METRES_PER_UNIT)
