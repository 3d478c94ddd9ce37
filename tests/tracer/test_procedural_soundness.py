"""The meshes of the procedural scenes: nothing degenerate, twice there, needlessly split, buried or inside out."""

from functools import cache

import numpy as np
import pytest
import torch
from procedural_scenes import atrium, built, corners, face_normals

from fovden.tracer import Scene
from fovden.tracer.procedural import SCENES
from fovden.tracer.procedural.primitives import grid


@pytest.mark.parametrize("name", SCENES)
def test_records_are_sound(name):
    scene = built(name)
    assert torch.isfinite(scene.vertices).all()
    assert torch.isfinite(scene.uv).all()
    length = scene.normals.norm(dim=1)
    assert ((length == 0) | ((length - 1).abs() < 1e-5)).all()
    # A triangle is flat or smooth as a whole: a zero normal beside others would bend the interpolated one.
    flat = (length == 0)[scene.faces.long()]
    assert (flat.all(dim=1) | ~flat.any(dim=1)).all()
    assert scene.faces.unique().numel() == scene.vertices.shape[0], "every vertex belongs to a triangle"
    used = scene.material_ids.unique()
    assert used.numel() == len(scene.materials.names), "every material is used"


def test_shading_normals_are_on_the_side_of_the_geometric_ones():
    scene = atrium()
    normals = face_normals(corners(scene))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shading = scene.normals.numpy()[scene.faces.numpy()]
    agreement = np.einsum("mki,mi->mk", shading, normals)
    smooth = np.abs(shading).sum(axis=(1, 2)) > 0
    assert (agreement[smooth] > 0).mean() > 0.995  # the rest are the sharpest folds of carved leaves


@pytest.mark.parametrize("name", SCENES)
def test_no_triangle_is_degenerate(name):
    triangles = corners(built(name))
    area = np.linalg.norm(face_normals(triangles), axis=1) / 2
    longest = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    assert area.min() > 1e-6, "one square millimetre"
    assert (2 * area / longest).min() > 1e-4, "heights well above the rounding of float32 at 16 m, 2e-6"


@pytest.mark.parametrize("name", SCENES)
def test_no_triangle_is_there_twice(name):
    keys = np.round(corners(built(name)) / 1e-4).astype(np.int64)
    order = np.lexsort((keys[..., 2], keys[..., 1], keys[..., 0]), axis=-1)
    keys = np.take_along_axis(keys, order[..., None], axis=1).reshape(len(keys), 9)
    assert len(np.unique(keys, axis=0)) == len(keys)


def needless_vertices(triangles: np.ndarray, material_ids: np.ndarray) -> np.ndarray:
    """Which corners (m, 3) sit on vertices that a mesh of the same shape could do without.

    A flat region needs a vertex only where its outline turns. So a vertex is needless if in each plane and material
    that meets there the triangles' angles add up to a straight angle (the outline runs on) or to a full turn (the
    middle of a flat part). An outline's corner, or an edge of the mesh that bends, makes it needed.
    """
    key = np.round(triangles.reshape(-1, 3) / 1e-4).astype(np.int64)
    _, vertex = np.unique(key, axis=0, return_inverse=True)
    vertex = vertex.reshape(-1)
    normal = face_normals(triangles)
    normal = np.repeat(normal / np.linalg.norm(normal, axis=1, keepdims=True), 3, axis=0)
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


def test_needless_vertices_are_found():
    flat = np.stack([*np.meshgrid(np.arange(3.0), np.arange(3.0)), np.zeros((3, 3))], axis=-1)
    patch = grid(flat)
    found = needless_vertices(patch.vertices[patch.faces], np.zeros(len(patch.faces)))
    assert set(patch.faces[found].tolist()) == {1, 3, 4, 5, 7}, "all but the four corners"
    flat[1, 1, 2] = 0.2
    patch = grid(flat)
    found = needless_vertices(patch.vertices[patch.faces], np.zeros(len(patch.faces)))
    assert not found.any(), "a raised middle makes the others needed too"


@pytest.mark.parametrize("name", SCENES)
def test_no_flat_part_is_split_needlessly(name):
    """Taking a vertex out of a flat part saves two triangles: less than one in a thousand could be saved in all."""
    triangles = corners(built(name))
    found = needless_vertices(triangles, built(name).material_ids.numpy())
    vertices = np.unique(np.round(triangles[found] / 1e-4), axis=0)
    assert 2 * len(vertices) < 0.001 * len(triangles)


@cache
def views_from_triangles(rays: int = 12) -> np.ndarray:
    """Farthest distance seen from each triangle of the atrium to its front and back, shape (2, m), by Embree.

    Rays start 0.1 mm above random points of the triangle and go in random directions of the hemisphere. Triangles
    that have seen farther than 0.3 m are done; the others get more rays, so that thin slits are not missed.
    """
    tracer = embree_scene(atrium())
    triangles = corners(atrium())
    normals = face_normals(triangles)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    farthest = np.zeros((2, len(triangles)))
    for i, side in enumerate((1.0, -1.0)):
        left = np.arange(len(triangles))
        for _ in range(rays):
            weights = rng.dirichlet((1.0, 1.0, 1.0), len(left))
            origins = np.einsum("mk,mki->mi", weights, triangles[left]) + 1e-4 * side * normals[left]
            directions = rng.standard_normal((len(left), 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            directions += 1.05 * side * normals[left]
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            distance = tracer.run(origins.astype(np.float32), directions.astype(np.float32), query="DISTANCE")
            farthest[i, left] = np.maximum(farthest[i, left], np.minimum(distance, 100.0))
            left = left[farthest[i, left] < 0.3]
    return farthest


def embree_scene(scene: Scene):
    rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
    from embreex.mesh_construction import TriangleMesh

    tracer = rtcore_scene.EmbreeScene()
    TriangleMesh(tracer, scene.vertices.numpy()[scene.faces.numpy()])
    return tracer


def test_no_triangle_is_buried():
    """A triangle inside a solid sees nothing farther than the solid's walls, from neither side."""
    seen = views_from_triangles().max(axis=0)
    assert (seen > 0.02).mean() > 0.9995
    assert (seen > 0.1).mean() > 0.99


def test_triangles_face_the_side_that_can_be_seen():
    """Rays from the court and the galleries meet the front of whatever is not a sheet: cloth, a leaf, the eaves.

    The few backs are those of the carved leaves' curled tips. Rays start clear of columns, walls and the fountain.
    """
    rng = np.random.default_rng(3)
    count = 100_000
    origins = rng.uniform((-15.3, 0.3, -5.9), (15.3, 8.5, 5.9), (count, 3))
    tracks = (np.abs(np.abs(origins[:, 2]) - 3.2) > 0.7) & (np.abs(np.abs(origins[:, 0]) - 12.8) > 0.7)
    between = (
        (origins[:, 1] < 3.2) | (origins[:, 1] > 5.5) | (np.abs(origins[:, 2]) < 2.0) & (np.abs(origins[:, 0]) < 12.0)
    )
    origins = origins[tracks & between & (np.hypot(origins[:, 0], origins[:, 2]) > 1.5)]
    directions = rng.standard_normal(origins.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = atrium().intersect(torch.from_numpy(origins).float(), torch.from_numpy(directions).float())
    hit = (hits.prim >= 0).numpy()
    prim = hits.prim.numpy()[hit]
    names = np.array(atrium().materials.names)[atrium().material_ids.numpy()[prim]]
    sheet = np.isin(names, ["crimson cloth", "blue cloth", "green cloth", "ochre cloth", "ivy", "agave", "stem"])
    sheet |= corners(atrium())[prim].mean(axis=1)[:, 1] > 9.8  # the eaves, seen from below
    normals = face_normals(corners(atrium()))[prim]
    back = (normals * directions[hit]).sum(axis=1) > 0
    assert (~sheet).sum() > 30_000
    assert back[~sheet].mean() < 0.002


def test_no_surface_lies_upon_another():
    """Behind what a ray meets comes nothing parallel within half a millimetre: no flicker between two surfaces."""
    scene = atrium()
    tracer = embree_scene(scene)
    normals = face_normals(corners(scene))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rng = np.random.default_rng(1)
    count = 400_000
    origins = rng.uniform((-15.5, 0.3, -6.0), (15.5, 8.5, 6.0), (count, 3))
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
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
