"""The builder that gathers patches by material and turns them into a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from fovden.camera import StereoCamera
from fovden.checks import require
from fovden.tracer.lights import Light
from fovden.tracer.materials import Material, Materials
from fovden.tracer.procedural.patch import Patch, join
from fovden.tracer.scene import Scene
from fovden.tracer.trajectory import CameraPath

__all__ = ["MeshBuilder", "Surface"]


@dataclass(frozen=True)
class Surface:
    """A material and the size of its image in the world.

    Attributes:
        material: The material.
        tile: Metres that one repetition of the material's texture spans in each direction.

    Example:
        >>> Surface(Material("plaster", (0.7, 0.7, 0.6)), 2.0).tile
        2.0
    """

    material: Material
    tile: float = 1.0


class MeshBuilder:
    """Collects patches and turns them into a scene.

    Attributes:
        surfaces: The surfaces by the names that :meth:`add` takes.

    Example:
        >>> from fovden.tracer.procedural.primitives import quad
        >>> builder = MeshBuilder({"wall": Surface(Material("plaster", (0.7, 0.7, 0.6)))})
        >>> builder.add("wall", quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)))
        >>> builder.triangle_count
        2
    """

    def __init__(self, surfaces: Mapping[str, Surface]) -> None:
        self.surfaces = dict(surfaces)
        self._patches: list[Patch] = []
        self._material_ids: list[int] = []

    @property
    def triangle_count(self) -> int:
        """Number of triangles so far."""
        return sum(patch.triangle_count for patch in self._patches)

    def add(self, surface: str, *patches: Patch) -> None:
        """Adds patches made of one of the surfaces.

        Raises:
            ValueError: If the builder has no surface of that name.

        Example:
            >>> from fovden.tracer.procedural.primitives import quad
            >>> builder = MeshBuilder({"wall": Surface(Material("plaster", (0.7, 0.7, 0.6)))})
            >>> builder.add("roof", quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)))
            Traceback (most recent call last):
            ...
            ValueError: surface: expected one of wall, got roof
        """
        require(surface in self.surfaces, "surface", surface, f"one of {', '.join(self.surfaces)}")
        tile = self.surfaces[surface].tile
        number = list(self.surfaces).index(surface)
        for patch in patches:
            self._patches.append(replace(patch, uv=patch.uv / tile))
            self._material_ids.append(number)

    def scene(
        self,
        *,
        name: str,
        camera: StereoCamera,
        lights: Sequence[Light] = (),
        views: Mapping[str, StereoCamera] | None = None,
        path: CameraPath | None = None,
    ) -> Scene:
        """Returns the scene of everything added, in the order in which it was added.

        Example:
            >>> from fovden.tracer.procedural.primitives import quad
            >>> builder = MeshBuilder({"wall": Surface(Material("plaster", (0.7, 0.7, 0.6)))})
            >>> builder.add("wall", quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)))
            >>> camera = StereoCamera.look_at((0, 0, 3), (0, 0, 0), fov_y_deg=45)
            >>> builder.scene(name="a wall", camera=camera).triangle_count
            2
        """
        mesh = join(self._patches)
        material_ids = np.repeat(self._material_ids, [patch.triangle_count for patch in self._patches])
        return Scene(
            vertices=torch.from_numpy(mesh.vertices.astype(np.float32)),
            faces=torch.from_numpy(mesh.faces.astype(np.int32)),
            material_ids=torch.from_numpy(material_ids.astype(np.int32)),
            materials=Materials.of([surface.material for surface in self.surfaces.values()]),
            normals=torch.from_numpy(mesh.normals.astype(np.float32)),
            uv=torch.from_numpy(mesh.uv.astype(np.float32)),
            lights=tuple(lights),
            camera=camera,
            views=views or {},
            path=path,
            name=name,
        )
