"""Motion lands on the same surface point, and what is disoccluded is what a slow search finds."""

import dataclasses

import numpy as np
import pytest
import torch
from brute_force import all_pairs
from builders import box, generator, rounded, scene_of, sphere

from fovden.camera import Camera, StereoCamera, pixel_centres
from fovden.tracer import (
    CameraPath,
    Instant,
    Material,
    PointLight,
    Pose,
    RigidMotion,
    Scene,
    Sequence,
    disoccluded,
    trace_frame,
    trace_gbuffer,
)
from fovden.tracer.motion import SURFACE, motion_vectors

U = 2.0**-24
RESOLUTION = (26, 34)


def world(open_sky=False) -> Scene:
    """A ball and a block, which may move, in a box or under the sky."""
    shapes = [(box((3, 3, 3), (8.0, 6.0, 9.0)), (0.0, 0.0, 0.0)), (sphere(2), (-0.7, 0.0, 0.0))]
    shapes.append((box((2, 2, 2), (1.0, 1.2, 0.8)), (1.0, 0.0, 0.5)))
    vertices, faces, ids = [], [], []
    for number, ((points, triangles), offset) in enumerate(shapes[1:] if open_sky else shapes):
        faces.append(triangles + sum(map(len, vertices)))
        vertices.append(rounded(points, 1.0, offset))
        ids += [number] * len(triangles)
    names = ("ball", "block") if open_sky else ("wall", "ball", "block")
    materials = [Material(name, (0.5, 0.5, 0.5)) for name in names]
    mesh = torch.cat(vertices), torch.cat(faces).int()
    return scene_of(mesh, *materials, material_ids=torch.tensor(ids).int(), lights=(PointLight((0, 2, 0), 9),))


def view(seed, **changes) -> StereoCamera:
    """A random place in the box, towards its middle."""
    x, y, z, s, t = (torch.rand(5, generator=generator(seed)) * 2 - 1).tolist()
    eye = (2 * x, 2 * y, 3.5 + 0.5 * z)
    return StereoCamera.look_at(
        eye, (0.3 * s, 0.3 * t, 0.0), **{"fov_y_deg": 60, "resolution": RESOLUTION, "convergence": 3.0} | changes
    )


def poses(seed) -> dict[str, tuple[Pose, Pose]]:
    """How ball and block stand in two frames."""
    shift = (torch.rand(2, 3, generator=generator(seed + 100)) * 0.6 - 0.3).tolist()
    turn = (torch.rand(4, generator=generator(seed + 200)) * 0.6 - 0.3).tolist()
    ball = (Pose(0, rotation=(turn[0], turn[1], 0, 1)), Pose(1, shift[0], (0, turn[2], turn[3], 1)))
    return {"ball": ball, "block": (Pose(0), Pose(1, shift[1], (turn[1], turn[0], turn[2], 1)))}


def moving(scene, seed) -> tuple[Instant, Instant]:
    """The instants of two frames in which camera, ball and block move."""
    first, last = view(seed), view(seed, fov_y_deg=60)
    nudge = (torch.rand(3, generator=generator(seed + 300)) * 0.4 - 0.2).tolist()
    eye = tuple(a + b for a, b in zip(first.eye, nudge, strict=True))
    path = CameraPath(last, ((0, first.eye, first.target), (1, eye, first.target)))
    sequence = Sequence(scene, path, objects=tuple(RigidMotion(*part) for part in poses(seed).items()))
    return sequence[1], sequence[0]


def pixels(image):
    """(v, c, h, w) to (v, h w, c)."""
    return image.flatten(2).transpose(1, 2)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("jitter", [(0.0, 0.0), (0.31, -0.44)])
def test_motion_lands_on_the_same_surface_point(seed, jitter):
    """The previous camera's ray through the moved place meets the same triangle at the same weights.

    Projection and rays of float32 are off by some 20 U in direction, which at 6 m from the eye is 1e-5 m on a surface
    that is seen at 60 degrees; 30 times as much is allowed, since some are seen more slantwise.
    """
    now, previous = moving(world(), seed)
    gbuffer = trace_gbuffer(now.scene, now.camera, jitter=jitter, previous=previous)
    gone = disoccluded(gbuffer, now.scene, now.camera, previous, jitter=jitter)
    place = pixel_centres(RESOLUTION) + torch.tensor(jitter) + pixels(gbuffer.motion)
    origins, directions = previous.camera.views.rays(place)
    hits = previous.scene.intersect(origins.reshape(-1, 3), directions.reshape(-1, 3))
    seen = ~pixels(gone).flatten()
    assert 0.5 < float(seen.float().mean()) < 1
    prim, weights = pixels(gbuffer.prim).flatten(), pixels(gbuffer.barycentric).reshape(-1, 2)
    same = (prim == hits.prim) & seen
    # Others pass within that of an edge: the points lie 0.3 m apart on triangles of 0.3 m, so few do.
    assert int((seen & ~same).sum()) <= 3
    corners = previous.scene.vertices.double()[previous.scene.faces.long()[prim.long()]]

    def point(u, v):
        a, b, c = corners.unbind(1)
        return a + u.double()[:, None] * (b - a) + v.double()[:, None] * (c - a)

    apart = (point(weights[:, 0], weights[:, 1]) - point(hits.u, hits.v)).norm(dim=1)
    assert float(apart[same].max()) < 3e-4
    assert float(apart[same].median()) < 1e-5
    # Of another frame it is not: the test can fail.
    assert float(gbuffer.motion.abs().amax()) > 1


def project_by_hand(points, camera, offset):
    """Pixels (x, y) of points (n, 3) in the eye at an offset to the right, from the words that describe the camera."""
    eye, target, up = (np.array(each) for each in (camera.eye, camera.target, camera.up))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    away = points - (eye + offset * right)
    depth = away @ forward
    x = away @ right / depth + offset / camera.convergence  # an axis that meets the other eye's at the convergence
    y = away @ np.cross(right, forward) / depth
    height, width = camera.resolution
    focal = height / 2 / np.tan(np.radians(camera.fov_y_deg) / 2)
    return np.stack([width / 2 + focal * x, height / 2 - focal * y], 1)


@pytest.mark.parametrize("seed", range(3))
def test_motion_is_that_of_a_projection_by_hand(seed):
    """Each pixel's position, taken to the previous frame by SciPy's rotations and projected by the pinhole's words.

    Positions and moved vertices are rounded to float32 at up to 6 m: some 4e-6 m together, less what both share.
    """
    rotation_of = pytest.importorskip("scipy.spatial.transform").Rotation.from_quat
    scene = world()
    now, previous = moving(scene, seed)
    gbuffer = trace_gbuffer(now.scene, now.camera, previous=previous)
    focal = RESOLUTION[0] / 2 / np.tan(np.radians(30))
    names, moved = scene.materials.names, 0
    for eye, offset in enumerate((-0.063 / 2, 0.063 / 2)):
        points = gbuffer.position[eye].flatten(1).T.double().numpy()
        before = points.copy()
        for name, (first, last) in poses(seed).items():
            triangles = scene.material_ids == names.index(name)
            corners = scene.vertices[scene.faces[triangles].long()].double().numpy().reshape(-1, 3)
            pivot = (corners.min(0) + corners.max(0)) / 2
            seen = triangles[gbuffer.prim[eye].flatten().long()].numpy()
            rest = rotation_of(last.rotation).inv().apply(points[seen] - pivot - last.translation)
            before[seen] = rotation_of(first.rotation).apply(rest) + pivot + first.translation
            moved += int(seen.sum())
        expected = project_by_hand(before, previous.camera, offset) - project_by_hand(points, now.camera, offset)
        found = gbuffer.motion[eye].flatten(1).T.numpy()
        ahead = found[:, 0] > -RESOLUTION[1]
        np.testing.assert_allclose(found[ahead], expected[ahead], atol=focal * 4e-6 / float(gbuffer.depth.min()))
        assert ahead.all()
    assert moved > 100


@pytest.mark.parametrize("eye", [0, 1])
def test_eyes_do_not_leak_into_each_other(eye):
    now, previous = moving(world(), 7)
    both = trace_gbuffer(now.scene, now.camera, previous=previous)
    first, second = (
        Camera(*(getattr(c.views, n)[eye : eye + 1] for n in ("origin", "rotation", "bounds")), RESOLUTION)
        for c in (now.camera, previous.camera)
    )
    alone = trace_gbuffer(now.scene, first, previous=Instant(previous.scene, second))
    assert torch.equal(alone.motion[0], both.motion[eye])


def test_without_motion_there_is_none():
    """Zero to the bit, whatever the jitter."""
    scene, camera = world(), view(3)
    gbuffer = trace_gbuffer(scene, camera, jitter=(0.2, 0.4), previous=Instant(scene, camera))
    assert not gbuffer.motion.any()
    assert not disoccluded(gbuffer, scene, camera, Instant(scene, camera), jitter=(0.2, 0.4)).any()


@pytest.mark.parametrize("jitter", [(0.0, 0.0), (0.4, -0.3)])
def test_the_surroundings_move_by_the_turn_alone(jitter):
    scene = world(open_sky=True)
    camera = view(1)
    turned = dataclasses.replace(camera, eye=(9.0, 4.0, -5.0), target=(9.0 - 0.1, 4.0, -6.0))
    previous = Instant(scene, turned)
    gbuffer = trace_gbuffer(scene, camera, jitter=jitter, previous=previous)
    through = pixel_centres(RESOLUTION) + torch.tensor(jitter)
    miss = ~pixels(gbuffer.hit)[..., 0]
    assert 0.3 < float(miss.float().mean()) < 0.9
    directions = camera.views.rays(through.expand(2, -1, 2)).directions.double()
    local = directions @ turned.views.rotation.double()
    left, right, bottom, top = (edge.double()[:, None] for edge in turned.views.bounds.unbind(1))
    x = (local[..., 0] / -local[..., 2] - left) / (right - left) * RESOLUTION[1]
    y = (top - local[..., 1] / -local[..., 2]) / (top - bottom) * RESOLUTION[0]
    expected = torch.stack([x, y], -1) - through
    ahead = (local[..., 2] < -0.1) & miss
    assert ahead.any()
    # Directions are off by 4 U, times 30 pixels per unit of tangent, times up to 1 / 0.1^2.
    assert (pixels(gbuffer.motion) - expected)[ahead].abs().amax() < 4 * U * 30 * 100 * 2


def test_what_was_behind_the_camera_leads_out_of_the_image():
    scene, camera = world(), view(2)
    behind = dataclasses.replace(
        camera, target=tuple(2 * e - t for e, t in zip(camera.eye, camera.target, strict=True))
    )
    previous = Instant(scene, behind)
    gbuffer = trace_gbuffer(scene, camera, previous=previous)
    place = pixel_centres(RESOLUTION) + pixels(gbuffer.motion)
    _, depth = behind.views.project(pixels(gbuffer.position))
    assert (depth < 0).any()
    assert torch.allclose(place[depth < 0], torch.tensor([-34.0, -26.0]), atol=1e-4)
    assert disoccluded(gbuffer, scene, camera, previous)[:, 0].flatten(1)[depth < 0].all()


@pytest.mark.parametrize("open_sky", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_disoccluded_is_what_a_slow_search_finds(seed, open_sky):
    """Every pixel's ray from the previous eye against every triangle, in float64; undecided near edges are left out."""
    now, previous = moving(world(open_sky), 10 + seed)
    gbuffer = trace_gbuffer(now.scene, now.camera)
    found = disoccluded(gbuffer, now.scene, now.camera, previous)
    before = previous.camera.views
    decided, gone_somewhere = 0, 0
    for eye in range(2):
        prim = gbuffer.prim[eye, 0].flatten().long()
        u, v = gbuffer.barycentric[eye].flatten(1).double()[..., None]
        faces = now.scene.faces.long()[prim.clamp_min(0)]
        a, b, c = previous.scene.vertices.double()[faces].unbind(1)
        origin = before.origin[eye].double()
        miss = prim < 0
        towards = torch.where(
            miss[:, None], now.camera.views.rays().directions[eye].double(), a + u * (b - a) + v * (c - a) - origin
        )
        local = towards @ before.rotation[eye].double()
        left, right, bottom, top = before.bounds[eye].double()
        x, y = local[:, 0] / -local[:, 2], local[:, 1] / -local[:, 2]
        inside = (local[:, 2] < 0) & (x > left) & (x < right) & (y > bottom) & (y < top)
        pairs = all_pairs(previous.scene.vertices, previous.scene.faces, origin.expand_as(towards), towards)
        own = torch.arange(previous.scene.triangle_count) == prim[:, None]
        near = (pairs.t > 0) & ((pairs.t < 1 - SURFACE) | miss[:, None]) & ~own
        hidden, unsure = (near & pairs.inside).any(1), (near & ~pairs.inside & ~pairs.outside).any(1)
        expected = ~inside | hidden
        sure = hidden | ~unsure
        assert torch.equal(found[eye, 0].flatten()[sure], expected[sure])
        decided += int(sure.sum())
        gone_somewhere += int((inside & hidden).sum())
    assert decided > 0.95 * found.numel()
    assert gone_somewhere > 10


def test_the_other_side_of_a_sheet_is_disoccluded():
    corners = torch.tensor([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
    scene = scene_of((corners, torch.tensor([[0, 1, 2], [0, 2, 3]])))
    camera = StereoCamera.look_at((0, 0, 3), (0, 0, 0), fov_y_deg=40, resolution=(5, 5))
    half_turn = Sequence(scene, camera, objects=(RigidMotion("grey", (Pose(0), Pose(1, rotation=(0, 1, 0, 0)))),))
    gbuffer = trace_gbuffer(*half_turn[1][:2], previous=half_turn[0])
    # What is at x now was at -x: motion is twice the way to the middle.
    assert torch.allclose(pixels(gbuffer.motion)[:, :, 0].mean(1), torch.zeros(2), atol=2.0)
    assert gbuffer.hit.all()
    assert disoccluded(gbuffer, *half_turn[1][:2], half_turn[0]).all()


def test_frames_carry_it():
    now, previous = moving(world(), 4)
    frame = trace_frame(now.scene, now.camera, 1, jitter=(0.1, 0.2), previous=previous)
    gbuffer = trace_gbuffer(now.scene, now.camera, jitter=(0.1, 0.2))
    assert not gbuffer.motion.any()
    expected = motion_vectors(gbuffer, now.scene, now.camera, previous, jitter=(0.1, 0.2))
    assert torch.equal(frame.gbuffer.motion, expected)


def test_frames_that_cannot_be_compared_are_refused():
    scene, camera = world(), view(0)
    gbuffer = trace_gbuffer(scene, camera)
    other = dataclasses.replace(scene, faces=scene.faces.flip(0), material_ids=scene.material_ids.flip(0))
    one = Camera(*(getattr(camera.views, n)[:1] for n in ("origin", "rotation", "bounds")), RESOLUTION)
    for previous, message in (
        (Instant(scene, camera.at((5, 5))), "previous.camera.resolution"),
        (Instant(scene, one), "previous.camera.origin"),
        (Instant(world(open_sky=True), camera), "previous.scene.vertices"),
        (Instant(other, camera), "previous.scene.faces"),
    ):
        for function in (motion_vectors, disoccluded):
            with pytest.raises(ValueError, match=message):
                function(gbuffer, scene, camera, previous)
