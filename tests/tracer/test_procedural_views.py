"""Cameras, paths and lights of the procedural scenes: as many as promised, in the open, and with something to see."""

import numpy as np
import pytest
import torch
from procedural_scenes import (
    FACTS,
    WHOLE_SCENES,
    built,
    camera_eyes,
    corners,
    directions_all_around,
    is_sheet,
    path_eyes,
    unit_normals,
)

from fovden.camera import StereoCamera
from fovden.tracer import DirectionalLight, PointLight, Scene

pytestmark = pytest.mark.parametrize("name", WHOLE_SCENES)

CAMERA_CLEARANCE, PATH_CLEARANCE = 0.3, 0.1
"""Nothing is nearer to an eye than so many metres."""


def look_around(scene: Scene, points: np.ndarray, rays: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances to what rays from each point meet, infinite for the sky, and whether they meet a back; (k, rays)."""
    directions = directions_all_around(np.random.default_rng(0), len(points) * rays)
    origins = np.repeat(points, rays, axis=0)
    hits = scene.intersect(torch.from_numpy(origins).float(), torch.from_numpy(directions).float())
    prim, hit = hits.prim.numpy(), hits.prim.numpy() >= 0
    back = np.zeros(len(prim), dtype=bool)
    normals = unit_normals(corners(scene)[prim[hit]])
    back[hit] = ((normals * directions[hit]).sum(axis=1) > 0) & ~is_sheet(scene, prim[hit])
    distance = np.where(hit, hits.t.numpy(), np.inf)
    return distance.reshape(-1, rays), back.reshape(-1, rays)


def test_numbers_are_those_of_the_papers_table(name):
    scene, facts = built(name), FACTS[name]
    assert scene.name == name
    assert scene.triangle_count == facts.triangles
    assert len(scene.lights) == sum(facts.lights.values())
    for kind, count in facts.lights.items():
        assert sum(isinstance(light, kind) for light in scene.lights) == count
    assert not bool(scene.materials.emission.any())


def test_there_are_other_views_and_a_path_of_1000_frames(name):
    scene = built(name)
    assert scene.camera is not None
    assert len(scene.views) >= 2
    assert all(view == view.lower() and " " not in view for view in scene.views)
    assert scene.path is not None
    assert len(scene.path) == 1000


def test_eyes_stand_in_the_open(name):
    scene = built(name)
    for eyes, rays, clearance in (
        (camera_eyes(scene), 5000, CAMERA_CLEARANCE),
        (path_eyes(scene), 400, PATH_CLEARANCE),
    ):
        distance, back = look_around(scene, eyes, rays)
        nearest = distance.min(axis=1)
        assert (nearest > clearance).all(), (eyes[nearest.argmin()], nearest.min())
        inside = back.mean(axis=1)
        assert (inside < 0.05).all(), (eyes[inside.argmax()], inside.max())


def test_the_path_is_walked_without_haste(name):
    """At 30 frames a second nobody goes faster than 4 m/s, nor turns by more than 90 degrees in a second."""
    path = built(name).path
    eyes, targets = (np.array([getattr(camera, end) for camera in path]) for end in ("eye", "target"))
    assert 30 * np.linalg.norm(np.diff(eyes, axis=0), axis=1).max() < 4.0
    ahead = (targets - eyes) / np.linalg.norm(targets - eyes, axis=1, keepdims=True)
    turn = np.degrees(np.arccos(np.clip((ahead[1:] * ahead[:-1]).sum(axis=1), -1, 1)))
    assert 30 * turn.max() < 90.0
    assert np.linalg.norm(np.diff(eyes, axis=0), axis=1).sum() > 5.0, "it leads somewhere"


def test_point_lights_stand_in_the_open(name):
    """Nothing touches a lamp, and it shines past whatever holds it."""
    lamps = np.array([light.position for light in built(name).lights if isinstance(light, PointLight)], dtype=float)
    distance, _ = look_around(built(name), lamps, 1000)
    assert (distance > 0.02).all()
    assert ((distance > 0.5).mean(axis=1) > 0.2).all()


def visible(camera: StereoCamera, scene: Scene) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Places and normals towards the camera of what 60 x 54 pixels of each eye show, and their materials or -1."""
    rays = camera.at(resolution=(60, 54)).views.rays()
    origins, directions = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
    hits = scene.intersect(origins, directions)
    hit = hits.prim >= 0
    points = (origins + hits.t[:, None] * directions)[hit]
    normals = torch.from_numpy(unit_normals(corners(scene)[hits.prim[hit].numpy()])).float()
    normals *= -torch.sign((normals * directions[hit]).sum(dim=1, keepdim=True))
    materials = torch.full(hit.shape, -1)
    materials[hit] = scene.material_ids[hits.prim[hit].long()].long()
    return points, normals, materials


def test_every_view_shows_much_and_is_lit(name):
    """At least five materials fill half a percent each, at most half is sky, and lights reach a tenth of the rest."""
    scene = built(name)
    for camera in (scene.view(), *scene.views.values()):
        points, normals, materials = visible(camera, scene)
        assert (materials < 0).float().mean() < 0.5
        share = materials[materials >= 0].bincount() / materials.numel()
        assert (share > 0.005).sum() >= 5
        lit = torch.zeros(len(points), dtype=torch.bool)
        for light in scene.lights:
            if isinstance(light, DirectionalLight):
                towards, end = -torch.tensor(light.direction).expand_as(points), None
            else:
                towards, end = torch.tensor(light.position) - points, torch.ones(len(points))
            facing = (towards * normals).sum(dim=1) > 0
            lit |= facing & ~scene.occluded(points + 1e-3 * normals, towards.contiguous(), end)
        assert lit.float().mean() > 0.1
