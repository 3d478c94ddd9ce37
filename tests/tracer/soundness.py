"""Checks that a mesh is sound: nothing degenerate, twice there, needlessly split, buried or inside out.

Each takes a scene and fails with an assertion; the scenes at their own size and at others are held to the same ones.
"""

import numpy as np
import pytest
import torch
from procedural_scenes import corners, directions_all_around, face_normals, is_sheet, starts, unit_normals

from fovden.tracer import Scene

CLOSE = 1e-4
"""Points closer than this many metres count as one."""

REACH = 1 << 20
"""Points must be within this many times CLOSE of the origin, 104 m, so that three coordinates fit an integer."""

BURIED_SAMPLE = 100_000
"""Triangles that are looked at for being buried, chosen at random where there are more."""


def point_numbers(triangles: np.ndarray) -> np.ndarray:
    """Number of the place of each corner, equal for corners in the same place, shape (m, 3)."""
    key = np.round(triangles.reshape(-1, 3) / CLOSE).astype(np.int64) + REACH
    assert key.min() >= 0
    assert key.max() < 2 * REACH
    packed = (key[:, 0] << 42) | (key[:, 1] << 21) | key[:, 2]
    return np.unique(packed, return_inverse=True)[1].reshape(-1, 3)


def check_records(scene: Scene) -> None:
    assert torch.isfinite(scene.vertices).all()
    assert torch.isfinite(scene.uv).all()
    length = scene.normals.norm(dim=1)
    assert ((length == 0) | ((length - 1).abs() < 1e-5)).all()
    # A triangle is flat or smooth as a whole: a zero normal beside others would bend the interpolated one.
    flat = (length == 0)[scene.faces.long()]
    assert (flat.all(dim=1) | ~flat.any(dim=1)).all()
    used = torch.zeros(scene.vertices.shape[0], dtype=torch.bool)
    used[scene.faces.long().reshape(-1)] = True
    assert used.all(), "every vertex belongs to a triangle"


def check_materials_are_used(scene: Scene) -> None:
    assert scene.material_ids.unique().numel() == len(scene.materials.names), "every material is used"


def check_shading_normals(scene: Scene, least: float = 0.995) -> None:
    """Shading normals are on the side of the geometric ones, but for the sharpest folds of carved leaves."""
    shading = scene.normals.numpy()[scene.faces.numpy()]
    agreement = np.einsum("mki,mi->mk", shading, unit_normals(corners(scene)))
    smooth = np.abs(shading).sum(axis=(1, 2)) > 0
    assert not smooth.any() or (agreement[smooth] > 0).mean() > least


def check_not_degenerate(scene: Scene, least_area: float = 1e-6, least_height: float = 1e-4) -> None:
    """No triangle is smaller than a square millimetre or flatter than a tenth of a millimetre.

    Heights are then well above the rounding of float32 at 16 m, 2e-6.
    """
    triangles = corners(scene)
    area = np.linalg.norm(face_normals(triangles), axis=1) / 2
    longest = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    assert area.min() > least_area
    assert (2 * area / longest).min() > least_height


def check_nothing_is_there_twice(scene: Scene) -> None:
    numbers = np.sort(point_numbers(corners(scene)), axis=1)
    numbers = numbers[np.lexsort(numbers.T)]
    assert not (numbers[1:] == numbers[:-1]).all(axis=1).any()


def needless_vertices(triangles: np.ndarray, material_ids: np.ndarray) -> np.ndarray:
    """Which corners (m, 3) sit on vertices that a mesh of the same shape could do without.

    A flat region needs a vertex only where its outline turns. So a vertex is needless if in each plane and material
    that meets there the triangles' angles add up to a straight angle (the outline runs on) or to a full turn (the
    middle of a flat part). An outline's corner, or an edge of the mesh that bends, makes it needed.
    """
    vertex = point_numbers(triangles).reshape(-1)
    normal = np.repeat(unit_normals(triangles), 3, axis=0)
    one = np.roll(triangles, -1, axis=1) - triangles
    other = np.roll(triangles, 1, axis=1) - triangles
    angle = np.arctan2(np.linalg.norm(np.cross(one, other), axis=2), (one * other).sum(axis=2)).reshape(-1)
    material = np.repeat(material_ids, 3)

    count = vertex.max() + 1
    needed = np.zeros(count, dtype=bool)
    left = np.arange(len(vertex))
    while len(left):
        # Each vertex takes its first remaining corner as the plane to look at; 1e-3 rad separates planes.
        first = np.empty(count, dtype=np.int64)
        first[vertex[left[::-1]]] = left[::-1]
        reference = first[vertex[left]]
        alike = np.linalg.norm(normal[left] - normal[reference], axis=1) < 1e-3
        alike &= material[left] == material[reference]
        total = np.bincount(vertex[left[alike]], angle[left[alike]], count)
        straight = (np.abs(total - np.pi) < 2e-3) | (np.abs(total - 2 * np.pi) < 2e-3)
        needed |= (total > 0) & ~straight
        left = left[~alike]
        left = left[~needed[vertex[left]]]
    return ~needed[vertex].reshape(-1, 3)


def check_not_split_needlessly(scene: Scene) -> None:
    """Taking a vertex out of a flat part saves two triangles: less than one in a thousand could be saved in all."""
    triangles = corners(scene)
    found = needless_vertices(triangles, scene.material_ids.numpy())
    assert 2 * len(np.unique(point_numbers(triangles)[found])) < 0.001 * len(triangles)


def embree_scene(triangles: np.ndarray):
    """The triangles in another library's acceleration structure."""
    rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
    from embreex.mesh_construction import TriangleMesh

    tracer = rtcore_scene.EmbreeScene()
    TriangleMesh(tracer, triangles.astype(np.float32))
    return tracer


def farthest_seen(triangles: np.ndarray, chosen: np.ndarray, rays: int = 12) -> np.ndarray:
    """Farthest distance seen from chosen triangles to their front and back, shape (2, k), by Embree.

    Rays start 0.1 mm above random points of the triangle and go in random directions of the hemisphere. Triangles
    that have seen farther than 0.3 m are done; the others get more rays, so that thin slits are not missed.
    """
    tracer = embree_scene(triangles)
    triangles = triangles[chosen]
    normals = unit_normals(triangles)
    rng = np.random.default_rng(0)
    farthest = np.zeros((2, len(triangles)))
    for i, side in enumerate((1.0, -1.0)):
        left = np.arange(len(triangles))
        for _ in range(rays):
            weights = rng.dirichlet((1.0, 1.0, 1.0), len(left))
            origins = np.einsum("mk,mki->mi", weights, triangles[left]) + 1e-4 * side * normals[left]
            directions = directions_all_around(rng, len(left)) + 1.05 * side * normals[left]
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            distance = tracer.run(origins.astype(np.float32), directions.astype(np.float32), query="DISTANCE")
            farthest[i, left] = np.maximum(farthest[i, left], np.minimum(distance, 100.0))
            left = left[farthest[i, left] < 0.3]
    return farthest


def check_nothing_is_buried(scene: Scene, near: float = 0.9995, far: float = 0.99, rays: int = 12) -> None:
    """A triangle inside a solid sees nothing farther than the solid's walls, from neither side.

    A share ``near`` sees farther than 2 cm; the rest are leaves between leaves. A share ``far`` sees farther than
    10 cm; the rest may lie in hollows, as behind carved leaves.
    """
    triangles = corners(scene)
    chosen = np.arange(len(triangles))
    if len(triangles) > BURIED_SAMPLE:
        chosen = np.random.default_rng(1).choice(len(triangles), BURIED_SAMPLE, replace=False)
    seen = farthest_seen(triangles, chosen, rays).max(axis=0)
    assert (seen > 0.02).mean() > near
    assert (seen > 0.1).mean() > far


def check_fronts_are_seen(scene: Scene, count: int = 100_000) -> None:
    """Rays from free space meet the front of whatever is not a sheet, but for two in a thousand: tips of carvings."""
    rng = np.random.default_rng(3)
    origins = starts(scene, rng, count)
    directions = directions_all_around(rng, len(origins))
    hits = scene.intersect(torch.from_numpy(origins).float(), torch.from_numpy(directions).float())
    hit = (hits.prim >= 0).numpy()
    prim = hits.prim.numpy()[hit]
    solid = ~is_sheet(scene, prim)
    back = (unit_normals(corners(scene)[prim]) * directions[hit]).sum(axis=1) > 0
    assert solid.sum() > 0.25 * count
    assert back[solid].mean() < 0.002


def check_nothing_lies_upon_another(scene: Scene, count: int = 300_000) -> None:
    """Behind what a ray meets comes nothing parallel within half a millimetre: no flicker between two surfaces."""
    triangles = corners(scene)
    tracer = embree_scene(triangles)
    normals = unit_normals(triangles)
    rng = np.random.default_rng(1)
    origins = starts(scene, rng, count)
    directions = directions_all_around(rng, len(origins))
    first = tracer.run(origins.astype(np.float32), directions.astype(np.float32), output=True)
    hit = first["primID"] >= 0
    points = origins[hit] + (first["tfar"][hit, None] + 2e-5) * directions[hit]
    second = tracer.run(points.astype(np.float32), directions[hit].astype(np.float32), output=True)
    near = (second["primID"] >= 0) & (second["tfar"] < 1e-3) & (second["primID"] != first["primID"][hit])
    one, other = normals[first["primID"][hit]], normals[np.maximum(second["primID"], 0)]
    depth = second["tfar"] * np.abs((directions[hit] * one).sum(axis=1))
    parallel = near & (np.abs((one * other).sum(axis=1)) > 0.999) & (depth < 5e-4)
    # A ray that starts 2e-5 behind a surface can meet its neighbour across an edge: about one in a hundred thousand.
    assert parallel.mean() < 1e-4
