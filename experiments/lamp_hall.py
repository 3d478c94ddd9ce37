"""A hall with many small lamps: more lights than any choice but a good one copes with."""

from __future__ import annotations

import math

import torch

from fovden.camera import StereoCamera
from fovden.tracer import Material, Materials, Scene

__all__ = ["lamp_hall"]

COLOURS = 16
"""Different lamps, by colour and radiance."""


def lamp_hall(triangles: int = 1000, *, resolution: tuple[int, int] = (64, 64), seed: int = 0) -> Scene:
    """Returns a hall of 20 x 3 x 20 m whose lamps are squares of 2 to 10 cm that face down, at 2 to 2.9 m.

    Args:
        triangles: Emissive triangles, two for each lamp.
        resolution: Height and width of the camera.
        seed: Seed of the lamps' places, sizes and radiance (1 to 30 W/(m^2 sr) per channel).

    Returns:
        The scene.

    Example:
        >>> lamp_hall(10).triangle_count
        22
    """
    random = torch.Generator().manual_seed(seed)
    count = math.ceil(triangles / 2)
    places, sizes, heights = (torch.rand(count, n, dtype=torch.float64, generator=random) for n in (2, 1, 1))
    emission = 1 + 29 * torch.rand(COLOURS, 3, dtype=torch.float64, generator=random)
    corner = torch.cat([18 * places[:, :1] - 9, 2 + 0.9 * heights, 18 * places[:, 1:] - 9], 1)
    side, nothing = 0.02 + 0.08 * sizes, torch.zeros(count, 1, dtype=torch.float64)
    along, across = torch.cat([side, nothing, nothing], 1), torch.cat([nothing, nothing, side], 1)
    lamps = _quads(corner, along, across)
    room = torch.tensor([[-10.0, 0, -10], [10, 3, 10]], dtype=torch.float64)
    walls = []
    for axis in range(3):
        edges = torch.diag(room[1] - room[0])
        e, f = edges[[(axis + 1) % 3]], edges[[(axis + 2) % 3]]
        walls += [_quads(room[:1], e, f), _quads(room[:1] + edges[axis], f, e)]
    vertices = torch.cat([*walls, lamps]).reshape(-1, 3).float()
    numbers = 1 + torch.arange(count).repeat_interleave(2) % COLOURS
    materials = [Material("wall", (0.5, 0.5, 0.5))]
    materials += [Material(f"lamp {i}", (0.0, 0.0, 0.0), tuple(emission[i].tolist())) for i in range(COLOURS)]
    return Scene(
        vertices,
        torch.arange(len(vertices)).reshape(-1, 3),
        torch.cat([torch.zeros(12, dtype=torch.int64), numbers]),
        Materials.of(materials),
        camera=StereoCamera.look_at((8, 1.6, 8), (0, 0.5, 0), fov_y_deg=60, resolution=resolution),
        name=f"hall with {2 * count} emissive triangles",
    )


def _quads(corner: torch.Tensor, along: torch.Tensor, across: torch.Tensor) -> torch.Tensor:
    """Two triangles each, shape (2 n, 3, 3); they face along x across."""
    b, c, d = corner + along, corner + along + across, corner + across
    return torch.stack([torch.stack([corner, b, c], 1), torch.stack([corner, c, d], 1)], 1).reshape(-1, 3, 3)
