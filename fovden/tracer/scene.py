"""The scene: triangles, materials, lights and a default camera, and the two questions that rays ask of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from multiprocessing.context import get_spawning_popen
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch
from torch import Tensor

from fovden.camera import StereoCamera
from fovden.checks import ShapeError, require, require_finite, require_indices, require_shapes
from fovden.io.files import FilePath
from fovden.preview import never_raising
from fovden.tracer.arrays import LightChoice, areas_of, geometry_arrays, light_table
from fovden.tracer.bvh import Backend, Bvh, Hits, Tree, build_bvh, build_tree, intersect, occluded, refit_bvh
from fovden.tracer.formats import write_gltf, write_obj
from fovden.tracer.gradient import attached, corners_at, hits_at, is_differentiable
from fovden.tracer.kernels.surface import GeometryArrays
from fovden.tracer.lights import Light
from fovden.tracer.materials import Materials
from fovden.tracer.operators import number_of
from fovden.tracer.scene_card import scene_card
from fovden.tracer.trajectory import CameraPath

__all__ = ["Scene"]


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles with materials, and the lights around them. Immutable: derive changed copies with ``with_*``.

    :meth:`export` takes it to other renderers, :func:`fovden.tracer.load_scene` brings one in.

    Attributes:
        vertices: Positions in metres, float32, shape (n, 3).
        faces: Vertex numbers of the triangles in the file's order, int32, shape (m, 3). Seen from the side of the
            geometric normal the vertices run counter-clockwise.
        material_ids: Material of each triangle, int32, shape (m).
        materials: The tables that ``material_ids`` index.
        normals: Shading normals per vertex, shape (n, 3); a zero row means the triangle's own normal.
        uv: Texture coordinates per vertex, shape (n, 2); (0, 0) is the image's lower left corner.
        lights: Point, directional and environment lights; emissive triangles are lights by themselves.
        camera: A view that shows the scene well, or ``None``.
        views: Other views worth seeing, by name.
        path: A walk through the scene, or ``None``.
        name: For messages, files and tables.
        number: How operators find the scene within this process; given, not chosen.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> hits = scene.intersect(torch.tensor([[2.78, 2.73, -8.0]]), torch.tensor([[0.0, 0.0, 1.0]]))
        >>> bool(hits.prim[0] >= 0)
        True
    """

    vertices: Tensor
    faces: Tensor
    material_ids: Tensor
    materials: Materials
    normals: Tensor = None  # type: ignore[assignment]  # zeros until the number of vertices is known
    uv: Tensor = None  # type: ignore[assignment]
    lights: tuple[Light, ...] = ()
    camera: StereoCamera | None = None
    views: Mapping[str, StereoCamera] = field(default_factory=dict)
    path: CameraPath | None = None
    name: str = field(default="scene")
    number: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        sizes = require_shapes("n 3", vertices=self.vertices)
        require_shapes("m 3", sizes, faces=self.faces)
        sizes["m"] = int(self.faces.shape[0])
        require_shapes("m", sizes, material_ids=self.material_ids)
        require(sizes["m"] > 0, "faces", tuple(self.faces.shape), "at least one triangle (the scene is empty)")
        require_finite("vertices", self.vertices)
        require_indices("faces", self.faces, sizes["n"])
        require_indices("material_ids", self.material_ids, len(self.materials.names))
        for name, width in (("normals", 3), ("uv", 2)):
            values = getattr(self, name)
            values = torch.zeros(sizes["n"], width) if values is None else values
            if tuple(values.shape) != (sizes["n"], width):
                raise ShapeError(f"{name}: expected shape (n={sizes['n']}, {width}), got {tuple(values.shape)}")
            require_finite(name, values)
            object.__setattr__(self, name, values.to(torch.float32).contiguous())
        object.__setattr__(self, "vertices", self.vertices.to(torch.float32).contiguous())
        object.__setattr__(self, "faces", self.faces.to(torch.int32).contiguous())
        object.__setattr__(self, "material_ids", self.material_ids.to(torch.int32).contiguous())
        object.__setattr__(self, "lights", tuple(self.lights))
        object.__setattr__(self, "views", MappingProxyType(dict(self.views)))
        object.__setattr__(self, "number", number_of(self))

    @property
    def triangle_count(self) -> int:
        """Number of triangles m, degenerate ones included."""
        return int(self.faces.shape[0])

    @cached_property
    def bvh(self) -> Bvh:
        """The acceleration structure, built when first asked for."""
        if self._same_geometry is not None:
            return self._same_geometry.bvh
        cutouts = self._has_cutout[self.material_ids.long()]
        if self._same_surfaces is not None:
            return refit_bvh(self._same_surfaces._tree, self.vertices, self.faces, cutouts)
        return build_bvh(self.vertices, self.faces, cutouts)

    @property
    def _has_cutout(self) -> Tensor:
        """Which materials have holes, shape (k)."""
        return self.materials.opacity >= 0

    @cached_property
    def _tree(self) -> Tree:
        return build_tree(self.vertices, self.faces)

    @cached_property
    def triangle_areas(self) -> Tensor:
        """Areas of the triangles in square metres, float64, shape (m)."""
        if self._same_geometry is not None:
            return self._same_geometry.triangle_areas
        if self._same_surfaces is None:
            return areas_of(self.vertices, self.faces)
        areas = self._same_surfaces.triangle_areas.clone()
        areas[self._changed] = areas_of(self.vertices, self.faces[self._changed])
        return areas

    def kernel_arrays(self, lights: LightChoice) -> tuple[Any, ...]:
        """Returns nodes, leaf blocks, geometry and lights as the compiled kernels read them; made once.

        Args:
            lights: How a path is to choose a light.

        Returns:
            The arrays.

        Example:
            >>> from fovden.tracer import make_scene
            >>> len(make_scene("cornell_box").kernel_arrays("uniform"))
            4
        """
        key = f"_light_table_{lights}"
        if key not in self.__dict__:
            self.__dict__[key] = light_table(self, lights)
        return (self.bvh.nodes.numpy(), self.bvh.blocks.numpy(), self._geometry_arrays, self.__dict__[key])

    @cached_property
    def _geometry_arrays(self) -> GeometryArrays:
        if self._same_geometry is not None:
            return self._same_geometry._geometry_arrays
        if self._same_surfaces is not None:
            return geometry_arrays(self, self._same_surfaces._geometry_arrays, self._changed)
        return geometry_arrays(self)

    @cached_property
    def _changed(self) -> Tensor:
        """Numbers of the triangles that lie or look elsewhere than in the scene whose surfaces these are."""
        assert self._same_surfaces is not None
        pairs = ((self.vertices, self._same_surfaces.vertices), (self.normals, self._same_surfaces.normals))
        moved = torch.stack([(after != before).any(1) for after, before in pairs]).any(0)
        return moved[self.faces.long()].any(1).nonzero()[:, 0]

    @property
    def _same_geometry(self) -> Scene | None:
        """The scene of which this is a copy with other lights; what is made of its geometry is made once."""
        same: Scene | None = self.__dict__.get("_geometry_of")
        return same

    @property
    def _same_surfaces(self) -> Scene | None:
        """The scene of which this is a copy with vertices elsewhere; tables of materials and textures are made once."""
        same: Scene | None = self.__dict__.get("_surfaces_of")
        return same

    def intersect(
        self,
        origins: Tensor,
        directions: Tensor,
        t_max: Tensor | None = None,
        *,
        cutouts: bool = True,
        backend: Backend = "kernels",
    ) -> Hits:
        """Returns the closest hit of each ray with 0 < t < t_max; see :func:`fovden.tracer.intersect`.

        Args:
            origins: Starting points in metres, shape (n, 3).
            directions: Directions of any length but zero, shape (n, 3).
            t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.
            cutouts: Whether rays pass through the holes that opacity images cut, as the rays of paths do.
            backend: Who traces, ``"kernels"`` or ``"torch"``: the same bits.

        Returns:
            The hits, on the rays' device; ``prim`` indexes ``faces``.

        Differentiable: t, u and v, in ``vertices``, ``origins`` and ``directions``; which triangle is hit is a choice
        (:mod:`fovden.tracer.gradient`). With the kernels it is the operator ``fovden::intersect``, and compiles.

        Example:
            >>> from fovden.tracer import make_scene
            >>> scene = make_scene("cornell_box")
            >>> scene.intersect(torch.tensor([[2.78, 2.73, -8.0]]), torch.tensor([[0.0, 0.0, 1.0]])).t > 8
            tensor([True])
        """
        if backend == "kernels":
            require_shapes("n 3", origins=origins, directions=directions)
            rays = (origins.detach(), directions.detach(), t_max)
            hits = Hits(*torch.ops.fovden.intersect(self.number, *rays, cutouts))
        else:
            hits = intersect(self.bvh, origins, directions, t_max, self.holes(cutouts), backend=backend)
        if not is_differentiable(self.vertices, origins, directions):
            return hits
        corners = corners_at(self.vertices, self.faces, hits.prim.to(self.faces.device))
        formulas = hits_at(corners.to(origins.device), origins.float(), directions.float())
        hit = hits.prim >= 0
        t, u, v = (attached(*pair) for pair in zip(hits[:3], (torch.where(hit, f, 0) for f in formulas), strict=True))
        return Hits(t, u, v, hits.prim)

    def occluded(
        self,
        origins: Tensor,
        directions: Tensor,
        t_max: Tensor | None = None,
        *,
        cutouts: bool = True,
        backend: Backend = "kernels",
    ) -> Tensor:
        """Returns whether any triangle lies on each ray with 0 < t < t_max; see :func:`fovden.tracer.occluded`.

        Args:
            origins: Starting points in metres, shape (n, 3).
            directions: Directions of any length but zero, shape (n, 3).
            t_max: End of each ray in units of its direction, shape (n); ``None`` means infinite.
            cutouts: Whether rays pass through the holes that opacity images cut, as the rays of paths do.
            backend: Who traces, ``"kernels"`` (the operator ``fovden::occluded``) or ``"torch"``.

        Returns:
            Booleans of shape (n), on the rays' device.

        Example:
            >>> from fovden.tracer import make_scene
            >>> scene = make_scene("cornell_box")
            >>> scene.occluded(torch.tensor([[2.78, 2.73, -8.0]]), torch.tensor([[0.0, 1.0, 0.0]]))
            tensor([False])
        """
        if backend != "kernels":
            return occluded(self.bvh, origins, directions, t_max, self.holes(cutouts), backend=backend)
        require_shapes("n 3", origins=origins, directions=directions)
        rays = (origins.detach(), directions.detach(), t_max)
        blocked: Tensor = torch.ops.fovden.occluded(self.number, *rays, cutouts)
        return blocked

    def holes(self, cutouts: bool = True) -> tuple[Any, ...] | None:
        """Returns where rays look up holes; ``None`` where there are none, or none that matter.

        Args:
            cutouts: Whether they matter.

        Returns:
            The scene's arrays, or ``None``.

        Example:
            >>> from fovden.tracer import make_scene
            >>> make_scene("cornell_box").holes() is None
            True
        """
        return self._geometry_arrays if cutouts and bool(self._has_cutout.any()) else None

    def view(self, name: str | None = None) -> StereoCamera:
        """Returns the scene's camera, or one of its other views.

        Args:
            name: Name of one of ``views``; ``None`` for ``camera``.

        Returns:
            The camera.

        Raises:
            ValueError: If there is no such view, or no camera.

        Example:
            >>> from fovden.tracer import make_scene
            >>> make_scene("cornell_box").view("kitchen")
            Traceback (most recent call last):
            ...
            ValueError: view: expected one of (the scene has no other views), got kitchen
        """
        if name is not None:
            names = ", ".join(self.views) or "(the scene has no other views)"
            require(name in self.views, "view", name, f"one of {names}")
            return self.views[name]
        if self.camera is None:
            raise ValueError(f"camera: expected a scene with a camera of its own, got {self.name} without one")
        return self.camera

    def with_lights(self, lights: Sequence[Light]) -> Scene:
        """Returns the scene with other lights; geometry and its acceleration structure are shared.

        Example:
            >>> from fovden.tracer import PointLight, make_scene
            >>> len(make_scene("cornell_box").with_lights([PointLight((2.8, 5, 2.8), 10)]).lights)
            1
        """
        changed = replace(self, lights=tuple(lights))
        changed.__dict__["_geometry_of"] = self._same_geometry or self
        return changed

    def with_vertices(self, vertices: Tensor, normals: Tensor | None = None) -> Scene:
        """Returns the scene with its vertices elsewhere; materials and textures are shared.

        The acceleration structure is fitted to them when it is first asked for, see
        :func:`fovden.tracer.bvh.refit_bvh`.

        Args:
            vertices: Positions in metres, shape (n, 3), in the same order.
            normals: Their shading normals, shape (n, 3); ``None`` for those that they have.

        Returns:
            The scene. Its triangles keep their numbers.

        Raises:
            ShapeError: If a shape differs.
            ValueError: If a number is not finite.

        Example:
            >>> from fovden.tracer import make_scene
            >>> scene = make_scene("cornell_box")
            >>> float(scene.with_vertices(scene.vertices + 1).vertices.min() - scene.vertices.min())
            1.0
        """
        require_shapes("n 3", {"n": len(self.vertices)}, vertices=vertices)
        changed = replace(self, vertices=vertices, normals=self.normals if normals is None else normals)
        changed.__dict__["_surfaces_of"] = self._same_surfaces or self._same_geometry or self
        return changed

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone; what can be made from them is made anew by whoever unpickles."""
        state = {each.name: getattr(self, each.name) for each in fields(self) if each.init}
        state["views"] = dict(self.views)
        if get_spawning_popen() is None:
            return state
        # PyTorch moves the tensors that a new process is to get into shared memory, away from under the arrays that
        # kernels read. Copies go there instead, made once for all processes, and the structure with them.
        if "_copies" not in self.__dict__:
            self.__dict__["_copies"] = deepcopy(state | {"bvh": self.bvh})
        copies: dict[str, Any] = self.__dict__["_copies"]
        return copies

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"views": MappingProxyType(state["views"])})
        object.__setattr__(self, "number", number_of(self))

    def export(self, path: FilePath) -> list[Path]:
        """Writes geometry, materials, lights and cameras to files that other renderers read.

        Triangles are sorted by material and otherwise keep their order. Lengths are metres, y is up, radiometric
        quantities are those of :mod:`fovden.tracer.lights`, without a factor. The camera path is left out.

        - ``.glb``: glTF 2.0 in one file, cameras as the view midway between the eyes;
          :func:`fovden.tracer.formats.gltf_writer.write_gltf`. :func:`fovden.tracer.load_scene` gives the scene back.
        - ``.gltf``: the same in two files, the second named ``*.bin``.
        - ``.obj``: Wavefront OBJ with a material library, PNG images, and a JSON file with cameras and lights;
          :func:`fovden.tracer.formats.obj_writer.write_obj`.

        Args:
            path: The file; its folder must exist. Other files are named after it and lie beside it.

        Returns:
            The files that were written, the one of ``path`` last.

        Raises:
            ValueError: If the name ends otherwise, or the scene has two environment lights.
            OSError: If a file cannot be written.

        Warns:
            UserWarning: If the scene has an environment light, for which glTF has no place but the scene's extras.

        Example:
            >>> import tempfile
            >>> from fovden.tracer import load_scene, make_scene
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     files = make_scene("cornell_box").export(Path(folder, "box.glb"))
            ...     load_scene(files[-1]).materials.names
            ('white', 'green', 'red', 'light')
        """
        path = Path(path)
        writers = {".glb": write_gltf, ".gltf": write_gltf, ".obj": write_obj}
        require(path.suffix.lower() in writers, "path", path, f"a name that ends in {', '.join(writers)}")
        return writers[path.suffix.lower()](path, self)

    @never_raising
    def _repr_html_(self) -> str:
        return scene_card(self)
