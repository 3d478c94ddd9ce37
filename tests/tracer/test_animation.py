"""Moving parts, lights and gazes: against SciPy's rotations and splines, and closed forms; bad input is refused."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from builders import box, rounded, scene_of

from fovden.camera import Gaze, StereoCamera
from fovden.tracer import (
    DirectionalLight,
    EnvironmentLight,
    GazeKeyframe,
    GazePath,
    LightKeyframe,
    LightPath,
    Material,
    PointLight,
    Pose,
    RigidMotion,
)
from fovden.tracer.curves import interpolate, interpolate_rotations, rotation_matrix

Rotation = pytest.importorskip("scipy.spatial.transform").Rotation

FRAMES = (0, 7, 30, 34, 60)
SMOOTH = (False,) * 5


def turns(seed=0):
    """Five rotations, neighbours some 60 degrees apart, as quaternions (x, y, z, w) of either sign."""
    rng = np.random.default_rng(seed)
    rotation, found = Rotation.random(rng=rng), []
    for sign in (1, -1, 1, 1, -1):
        found.append(sign * rotation.as_quat())
        rotation = rotation * Rotation.from_rotvec(rng.normal(size=3) * 0.6)
    return found


def test_matrices_equal_scipys():
    for rotation in turns():
        np.testing.assert_allclose(rotation_matrix(rotation), Rotation.from_quat(rotation).as_matrix(), atol=1e-15)


def test_two_keyframes_turn_at_constant_speed():
    slerp = pytest.importorskip("scipy.spatial.transform").Slerp
    first, last = turns()[:2]
    expected = slerp([0, 9], Rotation.from_quat([first, last]))
    for frame in range(10):
        found = Rotation.from_quat(interpolate_rotations((0, 9), (first, last), (False, False), frame))
        assert (found.inv() * expected(frame)).magnitude() < 1e-14


def test_about_one_axis_the_angle_follows_the_curve_of_numbers():
    angles = np.array([0.0, 1.2, 3.3, 2.0, -0.5])  # neighbours less than half a turn apart
    axis = np.array([2.0, -1.0, 2.0]) / 3
    rotations = Rotation.from_rotvec(angles[:, None] * axis).as_quat()
    for frame in range(61):
        expected = Rotation.from_rotvec(interpolate(FRAMES, angles, SMOOTH, frame) * axis)
        found = Rotation.from_quat(interpolate_rotations(FRAMES, rotations, SMOOTH, frame))
        assert (found.inv() * expected).magnitude() < 1e-13


def test_rotations_meet_keyframes_with_continuous_velocity():
    """Angular velocity on both sides of a keyframe, of the curve with 10^4 times as many frames.

    Between two such frames velocity changes by some acceleration times 1e-4: seen over one frame it is below 1 here.
    """
    rotations, fine = turns(), tuple(10_000 * frame for frame in FRAMES)
    for frame, rotation in zip(fine, rotations, strict=True):
        assert np.array_equal(interpolate_rotations(fine, rotations, SMOOTH, frame), rotation)
    for frame in fine[1:-1]:
        near = [Rotation.from_quat(interpolate_rotations(fine, rotations, SMOOTH, frame + i)) for i in (-1, 0, 1)]
        before, after = (1e4 * (b * a.inv()).as_rotvec() for a, b in pairwise(near))
        assert np.linalg.norm(before) > 0.01
        np.testing.assert_allclose(before, after, atol=1e-4)


def test_rotations_do_not_depend_on_the_sign_of_quaternions():
    for frame in range(61):
        one = interpolate_rotations(FRAMES, turns(), SMOOTH, frame)
        other = interpolate_rotations(FRAMES, -np.array(turns()), SMOOTH, frame)
        assert abs(abs(one @ other) - 1) < 1e-14


def test_held_values_stay_and_jump_and_part_the_curves():
    values, held = np.array([1.0, 4.0, 2.0, 8.0, 3.0]), (False, True, False, False, False)
    found = [float(interpolate(FRAMES, values, held, frame)) for frame in range(70)]
    assert found[7:30] == [4.0] * 23
    assert found[30] == 2.0
    assert found[60:] == [3.0] * 10
    # Each curve is that of its own keyframes alone.
    assert found[:7] == [float(interpolate(FRAMES[:2], values[:2], SMOOTH[:2], frame)) for frame in range(7)]
    alone = [float(interpolate((0, 4, 30), values[2:], SMOOTH[:3], frame)) for frame in range(31)]
    np.testing.assert_allclose(found[30:61], alone, rtol=1e-14)
    rotations = turns()
    for frame in range(7, 30):
        assert np.array_equal(interpolate_rotations(FRAMES, rotations, held, frame), rotations[1])


def test_a_part_moves_as_scipy_moves_it():
    vertices = rounded(box((1, 2, 1), (1.0, 2.0, 0.5))[0])
    first, second = turns()[:2]
    keys = (Pose(0, (1.0, 0.0, 0.0), tuple(3 * first)), Pose(8, (1.0, 4.0, 2.0), tuple(second)))
    motion = RigidMotion("grey", keys, pivot=(0.5, 1.0, 0.0))
    for frame, rotation, shift in ((0, first, (1.0, 0.0, 0.0)), (8, second, (1.0, 4.0, 2.0)), (99, second, (1, 4, 2))):
        pivot = np.array([0.5, 1.0, 0.0])
        turned = Rotation.from_quat(rotation).apply(vertices.double().numpy() - pivot)
        np.testing.assert_allclose(motion.moved(vertices, frame), turned + pivot + shift, atol=1e-14)
        expected = Rotation.from_quat(rotation).apply(vertices.double().numpy())
        np.testing.assert_allclose(motion.turned(vertices, frame), expected, atol=1e-14)
    middle = motion[4]
    assert middle.translation == (1.0, 2.0, 1.0)
    assert len(motion) == 9


def test_without_a_pivot_a_part_turns_about_its_box():
    vertices = torch.tensor([[1.0, 0, 0], [3.0, 0, 0], [1.5, 4.0, 2.0]])
    moved = RigidMotion("grey", (Pose(0, rotation=(0, 0, 1, 0)),)).moved(vertices, 0)
    expected = torch.tensor([[3.0, 4.0, 0], [1.0, 4.0, 0], [2.5, 0.0, 2.0]], dtype=torch.float64)
    assert torch.allclose(moved, expected, atol=1e-15)


def test_parts_are_named_by_material_or_mask():
    vertices, faces = box((1, 1, 1), (1.0, 1.0, 1.0))
    names = [Material(name, (0.5, 0.5, 0.5)) for name in ("a", "b", "c")]
    ids = torch.arange(12, dtype=torch.int32) % 3
    scene = scene_of((rounded(vertices), faces), *names, material_ids=ids)
    assert torch.equal(RigidMotion("b", (Pose(0),)).faces(scene), ids == 1)
    assert torch.equal(RigidMotion(("a", "c"), (Pose(0),)).faces(scene), ids != 1)
    assert torch.equal(RigidMotion(ids == 2, (Pose(0),)).faces(scene), ids == 2)
    for part, message in (("d", "a material of the scene: a, b, c"), (ids, "booleans of shape"), (ids > 2, "at least")):
        with pytest.raises(ValueError, match=message):
            RigidMotion(part, (Pose(0),)).faces(scene)


def test_lights_travel_and_fade():
    keys = (
        LightKeyframe(0, PointLight((0, 2, 0), (40, 0, 1))),
        LightKeyframe(10, PointLight((5, 2, 0), (0, 0, 1))),
        LightKeyframe(20, PointLight((5, 7, 0), (0, 20, 1)), held=True),
        LightKeyframe(30, PointLight((0, 0, 0), 3)),
    )
    path = LightPath(keys)
    assert [path[key.frame] for key in keys] == [key.light for key in keys]
    assert path[25] == keys[2].light
    assert path[31] == keys[3].light
    frames, smooth = (0, 10, 20), (False,) * 3
    for frame in range(1, 20):
        for name in ("position", "intensity"):
            values = [getattr(key.light, name) for key in keys[:3]]
            expected = interpolate(frames, values, smooth, frame).clip(0 if name == "intensity" else -np.inf)
            assert getattr(path[frame], name) == tuple(expected)
    assert min(min(path[frame].intensity) for frame in range(20)) == 0  # the curve goes below
    sun = LightPath(
        (LightKeyframe(0, DirectionalLight((0, -1, 0), 4)), LightKeyframe(2, DirectionalLight((1, 0, 0), 2)))
    )
    assert sun[1].direction == pytest.approx((0.5**0.5, -(0.5**0.5), 0.0), abs=1e-15)
    assert sun[1].irradiance == (3.0, 3.0, 3.0)


def test_images_switch():
    day, night = EnvironmentLight(torch.ones(3, 2, 4)), EnvironmentLight(0.1)
    path = LightPath((LightKeyframe(0, night), LightKeyframe(3, night, held=True), LightKeyframe(5, day)))
    assert [path[frame].radiance is day.radiance for frame in range(7)] == [False] * 5 + [True] * 2
    with pytest.raises(ValueError, match="an image that is not held"):
        LightPath((LightKeyframe(0, night), LightKeyframe(5, day)))


def test_gazes_rest_jump_and_follow():
    path = GazePath((GazeKeyframe(0, -12, 3, held=True), GazeKeyframe(20, 8, -2), GazeKeyframe(40, 18, 2)))
    assert len(path) == 41
    assert [path[frame] for frame in (0, 19, 20, 30, 40, 50)] == [
        (-12, 3),
        (-12, 3),
        (8, -2),
        (13, 0),
        (18, 2),
        (18, 2),
    ]
    camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_x_deg=80, resolution=(60, 80), convergence=2.0)
    expected = Gaze.from_degrees(torch.tensor([[13.0, 0.0]] * 2), camera)
    assert torch.equal(path.gaze(30, camera).pixels, expected.pixels)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: GazePath(()), "at least one keyframe"),
        (lambda: GazePath(((0, 0, 95.0),)), "elevation_deg"),
        (lambda: GazePath(((0, 0, 0), (0, 1, 1))), "begin with 0 and rise"),
        (lambda: RigidMotion("a", ()), "at least one keyframe"),
        (lambda: RigidMotion("a", (Pose(3),)), "begin with 0 and rise"),
        (lambda: RigidMotion("a", (Pose(0, (1.0, 2.0)),)), "Pose.translation: expected three finite numbers"),
        (lambda: RigidMotion("a", (Pose(0, rotation=(0, 0, 0, 0)),)), "Pose.rotation: expected four finite numbers"),
        (lambda: LightPath(()), "at least one keyframe"),
        (lambda: LightPath(((0, PointLight((0, 0, 0), 1)), (1, EnvironmentLight(1)))), "lights of one kind"),
    ],
)
def test_what_is_no_path_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
