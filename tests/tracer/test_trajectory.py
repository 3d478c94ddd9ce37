"""Camera paths: against another library's splines, through every keyframe, without jumps; bad input is refused."""

from dataclasses import replace

import numpy as np
import pytest

from fovden.camera import StereoCamera
from fovden.tracer import CameraPath, Keyframe

CAMERA = StereoCamera.look_at((0, 1.7, 5), (0, 1.5, 0), fov_y_deg=60, resolution=(48, 64), eye_separation=0.07)

KEYFRAMES = (
    Keyframe(0, (0.0, 1.7, 5.0), (0.0, 1.5, 0.0)),
    Keyframe(7, (2.0, 1.8, 4.0), (0.5, 1.4, 0.3)),
    Keyframe(30, (4.0, 1.6, 0.0), (0.0, 1.5, 0.5)),
    Keyframe(34, (3.5, 1.9, -1.0), (-1.0, 1.2, 0.5)),
    Keyframe(60, (-2.0, 1.7, -3.0), (0.0, 1.5, 0.0)),
)


def places(path: CameraPath) -> np.ndarray:
    """Eye and target of every frame, shape (frames, 2, 3)."""
    return np.array([(camera.eye, camera.target) for camera in path])


def test_every_keyframe_is_met_exactly():
    path = CameraPath(CAMERA, KEYFRAMES)
    for key in KEYFRAMES:
        assert path[key.frame].eye == key.eye
        assert path[key.frame].target == key.target


def test_frames_between_follow_scipys_hermite_spline():
    interpolate = pytest.importorskip("scipy.interpolate")
    time = np.array([key.frame for key in KEYFRAMES], dtype=float)
    place = np.array([(key.eye, key.target) for key in KEYFRAMES])
    velocity = np.empty_like(place)
    velocity[0] = (place[1] - place[0]) / (time[1] - time[0])
    velocity[-1] = (place[-1] - place[-2]) / (time[-1] - time[-2])
    for i in range(1, len(time) - 1):
        velocity[i] = (place[i + 1] - place[i - 1]) / (time[i + 1] - time[i - 1])
    spline = interpolate.CubicHermiteSpline(time, place, velocity)
    np.testing.assert_allclose(places(CameraPath(CAMERA, KEYFRAMES)), spline(np.arange(61)), atol=1e-12)


def test_velocity_is_continuous():
    """Finite differences on both sides of a keyframe differ as little as elsewhere: O(1/n) for n times the frames.

    On cubics of 40 times as many frames the step of the velocity from frame to frame shrinks by 40; a jump would not.
    """
    fine = [replace_frame(key, 40 * key.frame) for key in KEYFRAMES]
    velocity = 40 * np.diff(places(CameraPath(CAMERA, tuple(fine))), axis=0)
    coarse = np.diff(places(CameraPath(CAMERA, KEYFRAMES)), axis=0)
    largest = np.abs(np.diff(velocity, axis=0)).max()
    assert largest < np.abs(np.diff(coarse, axis=0)).max() / 10
    for key in fine[1:-1]:
        before, after = velocity[key.frame - 1], velocity[key.frame]
        np.testing.assert_allclose(before, after, atol=1.0001 * largest)
    assert np.abs(velocity).max() > 0.1, "it moves"


def replace_frame(key: Keyframe, frame: int) -> Keyframe:
    return Keyframe(frame, key.eye, key.target)


def test_straight_uniform_path_is_uniform():
    """Keyframes at uneven times on a line walked evenly give the line, walked evenly."""
    keys = tuple(Keyframe(f, (0.1 * f, 1.7, 5.0 - 0.2 * f), (0.1 * f, 1.5, -0.2 * f)) for f in (0, 3, 4, 40, 99))
    steps = np.diff(places(CameraPath(CAMERA, keys)), axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to([0.1, 0.0, -0.2], steps.shape), atol=1e-12)


def test_two_keyframes_make_a_straight_line():
    path = CameraPath(CAMERA, (KEYFRAMES[0], Keyframe(10, (5.0, 1.7, 0.0), (0.0, 2.5, 0.0))))
    share = np.linspace(0, 1, 11)[:, None, None]
    first, last = (np.array([key.eye, key.target]) for key in path.keyframes)
    np.testing.assert_allclose(places(path), first + share * (last - first), atol=1e-12)


def test_it_is_a_sequence_of_cameras():
    path = CameraPath(CAMERA, KEYFRAMES)
    assert len(path) == len(list(path)) == 61
    assert path[-1] == path[60]
    assert path[-61] == path[0]
    assert path[5] == replace(CAMERA, eye=path[5].eye, target=path[5].target)
    small = path.at(resolution=(6, 8))
    assert small[5].resolution == (6, 8)
    assert small[5].eye == path[5].eye
    for frame in (61, -62):
        with pytest.raises(IndexError, match="expected one from 0 to 60"):
            path[frame]
    with pytest.raises(TypeError, match="frame"):
        path[1.5]


def test_keyframes_may_be_plain_tuples():
    path = CameraPath(CAMERA, ((0, (0, 0, 5), (0, 0, 0)), (9, (9, 0, 5), (9, 0, 0))))
    assert path.keyframes[1].target == (9, 0, 0)
    assert path[3].eye == (3.0, 0.0, 5.0)


@pytest.mark.parametrize(
    ("keyframes", "message"),
    [
        ((), "at least two keyframes"),
        (KEYFRAMES[:1], "at least two keyframes"),
        (KEYFRAMES[1:], "begin with 0 and rise"),
        ((KEYFRAMES[0], KEYFRAMES[2], KEYFRAMES[1]), "begin with 0 and rise"),
        ((KEYFRAMES[0], KEYFRAMES[0]), "begin with 0 and rise"),
        ((KEYFRAMES[0], Keyframe(-3, (0.0, 1.0, 0.0), (1.0, 1.0, 0.0))), "frame"),
        ((KEYFRAMES[0], Keyframe(9, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))), "away from the eye"),
        ((KEYFRAMES[0], Keyframe(9, (1.0, 1.0, 1.0), (1.0, 2.0, 1.0))), "not along the viewing direction"),
        ((KEYFRAMES[0], Keyframe(9, (1.0, float("nan"), 1.0), (1.0, 2.0, 3.0))), "three finite numbers"),
    ],
)
def test_keyframes_without_a_path_are_refused(keyframes, message):
    with pytest.raises(ValueError, match=message):
        CameraPath(CAMERA, keyframes)


def test_frames_must_be_integers():
    with pytest.raises(TypeError, match="frame"):
        CameraPath(CAMERA, (KEYFRAMES[0], Keyframe(2.5, (0.0, 1.0, 0.0), (1.0, 1.0, 0.0))))
