"""Embree behind its two Python packages, and fovden, as the benchmarks ask them: same triangles, same rays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from benchmarks.harness import threads
from fovden import parallel
from fovden.tracer import Bvh, Scene, build_bvh, intersect, occluded
from fovden.tracer.bvh import _no_geometry
from fovden.tracer.kernels.tiles import SIDE, closest_pixels

__all__ = ["PEERS", "Embreex", "Fovden", "Open3D", "Structure", "differing"]

TILES_AT_ONCE = 128  # as in trace_gbuffer
CLOSE = 1e-3
"""Relative difference of two distances at which they count as the same."""

Rays = tuple[Tensor, Tensor, float]
Array = npt.NDArray[Any]


class Structure(ABC):
    """An acceleration structure that is ready to be asked.

    Attributes:
        name: As tables name it.
        threads: How many it uses.
    """

    name: str
    threads: int

    @abstractmethod
    def closest(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call that is timed, and what reads the distances from its result: infinite for a miss."""

    @abstractmethod
    def any(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call that is timed, and what reads from its result whether anything was met."""

    def asked(self, kind: str, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns :meth:`any` for shadow rays, :meth:`closest` for the others."""
        return self.any(rays) if kind == "shadow" else self.closest(rays)


class Fovden(Structure):
    """``fovden.tracer.intersect`` and ``occluded``: distance, barycentric coordinates and triangle; or a flag."""

    name = "fovden"

    def __init__(self, scene: Scene, threads: int, bvh: Bvh | None = None) -> None:
        self.threads = threads
        torch.set_num_threads(threads)
        self.bvh = build_bvh(scene.vertices, scene.faces) if bvh is None else bvh

    def _limited(self, call: Callable[[], Any]) -> Callable[[], Any]:
        def limited() -> Any:
            torch.set_num_threads(self.threads)
            return call()

        return limited

    def closest(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call and the reader."""
        origins, directions, _ = rays
        return self._limited(lambda: intersect(self.bvh, origins, directions)), lambda hits: hits.t.numpy()

    def any(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call and the reader."""
        origins, directions, end = rays
        ends = torch.full((len(origins),), end)
        return self._limited(lambda: occluded(self.bvh, origins, directions, ends)), lambda flags: flags.numpy()

    def in_tiles(self, rays: Rays, resolution: tuple[int, int]) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call and the reader for the rays of a camera, which start at one point; the kernel alone."""
        height, width = resolution
        count = -(-height // SIDE) * -(-width // SIDE)
        arrays = self.bvh.nodes.numpy(), self.bvh.blocks.numpy(), _no_geometry(), False
        seen = rays[0][0].numpy(), rays[1].reshape(height, width, 3).numpy()

        def call() -> Array:
            (t, u, v), prim = np.empty((3, height, width), np.float32), np.empty((height, width), np.int32)
            parallel.run(closest_pixels, count, (*arrays, *seen, t, u, v, prim), tile=TILES_AT_ONCE)
            return t

        return self._limited(call), lambda t: t.reshape(-1)


class Open3D(Structure):
    """Embree on all cores through Open3D: distance, barycentric coordinates, triangle, geometry, normal; or a flag."""

    name = "Open3D"

    def __init__(self, scene: Scene, threads: int = threads()) -> None:
        import open3d  # noqa: PLC0415  the peer is optional

        self.tensor, self.threads = open3d.core.Tensor, threads
        self.scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
        corners, triangles = self.tensor(scene.vertices.numpy()), self.tensor(scene.faces.numpy().astype(np.uint32))
        self.scene.add_triangles(corners, triangles)
        self.scene.cast_rays(self.tensor(np.ones((1, 6), np.float32)))  # which builds it

    def closest(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call and the reader."""
        joined = self.tensor(torch.cat(rays[:2], dim=1).numpy())
        return lambda: self.scene.cast_rays(joined, self.threads), lambda answer: answer["t_hit"].numpy()

    def any(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call and the reader."""
        joined, end = self.tensor(torch.cat(rays[:2], dim=1).numpy()), rays[2]
        call = lambda: self.scene.test_occlusions(joined, 0.0, end, self.threads)  # noqa: E731
        return call, lambda answer: answer.numpy()


class Embreex(Structure):
    """Embree on one thread through embreex, a thin wrapper: the triangle, its fastest answer; or a flag."""

    name = "embreex"
    threads = 1

    def __init__(self, scene: Scene) -> None:
        from embreex.mesh_construction import TriangleMesh  # noqa: PLC0415  the peer is optional
        from embreex.rtcore_scene import EmbreeScene  # noqa: PLC0415

        self.scene = EmbreeScene()
        TriangleMesh(self.scene, scene.vertices.numpy(), scene.faces.numpy())
        self.scene.run(*(np.ones((1, 3), np.float32),) * 2)  # which builds it

    def closest(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call and the reader; distances are asked for once more, outside the timed call."""
        origins, directions = (part.numpy() for part in rays[:2])

        def distances(_: Any) -> Array:
            answer = self.scene.run(origins, directions, output=True)
            return np.where(answer["primID"] < 0, np.inf, answer["tfar"])

        return lambda: self.scene.run(origins, directions), distances

    def any(self, rays: Rays) -> tuple[Callable[[], Any], Callable[[Any], Array]]:
        """Returns the call and the reader."""
        origins, directions = (part.numpy() for part in rays[:2])
        ends = np.full(len(origins), rays[2], np.float32)
        return lambda: self.scene.run(origins, directions, dists=ends, query="OCCLUDED"), lambda answer: answer == 0


PEERS = {"open3d": Open3D, "embreex": Embreex}
"""By the name of the package."""


def differing(own: Array, theirs: Array) -> float:
    """Returns the share of rays about which two answers differ: in a flag, or by a thousandth of the distance."""
    if own.dtype == np.bool_:
        return float((own != theirs).mean())
    met = np.isfinite(own) & np.isfinite(theirs)
    apart = np.abs(own[met] - theirs[met]) > CLOSE * own[met]
    return float((apart.sum() + (np.isfinite(own) != np.isfinite(theirs)).sum()) / len(own))
