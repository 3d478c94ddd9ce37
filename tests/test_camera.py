"""Cameras and gaze: closed forms of the pinhole, and that rays and projection undo each other."""

import math

import pytest
import torch

from fovden.camera import FHD, QUEST2, Camera, Gaze, StereoCamera
from fovden.checks import ShapeError


def straight(**changes) -> StereoCamera:
    """At the origin, looking along -z."""
    options = {"fov_y_deg": 60.0, "resolution": (48, 64)} | changes
    return StereoCamera.look_at((0, 0, 0), (0, 0, -1), **options)


def somewhere(seed: int, **changes) -> StereoCamera:
    generator = torch.Generator().manual_seed(seed)
    eye, target = (torch.randn(2, 3, generator=generator) * 3).tolist()
    options = {"fov_y_deg": 70.0, "resolution": (37, 53)} | changes
    return StereoCamera.look_at(tuple(eye), tuple(target), **options)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("convergence", [None, 0.7])
def test_projection_inverts_rays(seed, convergence):
    views = somewhere(seed, convergence=convergence).views.to(torch.float64)
    generator = torch.Generator().manual_seed(seed)
    # Also pixels outside the image, as a gaze may lie there.
    pixels = torch.rand(2, 500, 2, generator=generator, dtype=torch.float64) * 90 - 20
    origins, directions = views.rays(pixels)
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(2, 500, dtype=torch.float64))
    distance = 0.1 + 10 * torch.rand(2, 500, 1, generator=generator, dtype=torch.float64)
    back, depth = views.project(origins + distance * directions)
    # The rotation was rounded to float32, so its transpose inverts it to some 1e-7, times pixels of up to 100.
    torch.testing.assert_close(back, pixels, rtol=0, atol=1e-4)
    backward = views.rotation[:, None, :, 2]
    torch.testing.assert_close(depth, -(distance * directions * backward).sum(-1), rtol=1e-5, atol=1e-6)
    assert (depth > 0).all()


def test_rays_default_to_pixel_centres_in_row_major_order():
    views = straight().views
    height, width = views.resolution
    directions = views.rays().directions.reshape(2, height, width, 3)
    for y, x in ((0, 0), (5, 60), (47, 63)):
        expected = views.rays(torch.tensor([x + 0.5, y + 0.5]).expand(2, 1, 2)).directions[:, 0]
        assert torch.equal(directions[:, y, x], expected)


def test_world_is_right_handed_with_y_up_and_pixels_run_right_and_down():
    views = straight(eye_separation=0).views
    points = torch.tensor([[0.0, 0, -2], [0.1, 0, -2], [0, 0.1, -2], [0, 0, 2]]).expand(2, 4, 3)
    pixels, depth = views.project(points)
    centre, right, up = pixels[0, :3].tolist()
    assert centre == pytest.approx([32, 24])
    assert right[0] > 32
    assert right[1] == pytest.approx(24)
    assert up[0] == pytest.approx(32)
    assert up[1] < 24
    assert depth[0].tolist() == pytest.approx([2, 2, 2, -2])
    torch.testing.assert_close(torch.linalg.det(views.rotation), torch.ones(2))


def test_points_in_the_plane_of_the_eyes_project_without_nan():
    pixels, depth = straight(eye_separation=0).views.project(torch.tensor([[0.0, 0, 0], [1, 1, 0]]).expand(2, 2, 3))
    assert (depth == 0).all()
    assert not pixels.isnan().any()


@pytest.mark.parametrize("name", ["fov_y_deg", "fov_x_deg"])
@pytest.mark.parametrize("degrees", [1.0, 60.0, 110.0])
def test_field_of_view_is_the_angle_between_the_edges(name, degrees):
    camera = straight(fov_y_deg=None, **{name: degrees}) if name == "fov_x_deg" else straight(fov_y_deg=degrees)
    edges = [[32.0, 0], [32.0, 48]] if name == "fov_y_deg" else [[0.0, 24], [64.0, 24]]
    directions = camera.views.to(torch.float64).rays(torch.tensor([edges, edges]).double()).directions[0]
    angle = math.degrees(math.acos(float(directions[0] @ directions[1])))
    # An arc cosine near 1 turns the bounds' rounding of 6e-8 into 6e-8 / sin(1 degree) rad = 2e-4 degrees.
    assert angle == pytest.approx(degrees, abs=2e-4)


def test_pixels_are_square():
    left, right, bottom, top = straight().views.bounds[0].tolist()
    assert (right - left) / 64 == pytest.approx((top - bottom) / 48)


@pytest.mark.parametrize("seed", range(3))
def test_left_eye_is_left_and_the_eyes_are_as_far_apart_as_asked(seed):
    camera = somewhere(seed, eye_separation=0.07)
    views = camera.views
    between = views.origin[1] - views.origin[0]
    torch.testing.assert_close(between, 0.07 * views.rotation[0, :, 0], rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(views.origin.mean(0), torch.tensor(camera.eye))
    # A point ahead lies farther to the right in the left eye's image.
    ahead = torch.tensor(camera.target).expand(2, 1, 3)
    pixels, _ = views.project(ahead)
    assert pixels[0, 0, 0] > pixels[1, 0, 0]
    assert pixels[0, 0, 1] == pytest.approx(float(pixels[1, 0, 1]), abs=1e-3)


def test_no_eye_separation_gives_equal_views():
    views = somewhere(0, eye_separation=0, convergence=2.0).views
    for tensor in (views.origin, views.rotation, views.bounds):
        assert torch.equal(tensor[0], tensor[1])
    assert torch.equal(*views.rays().directions)


def test_off_axis_images_coincide_at_the_distance_of_convergence():
    views = straight(convergence=2.0, eye_separation=0.1).views
    x = torch.linspace(-0.5, 0.5, 5)
    focal = views.resolution[1] / float(views.bounds[0, 1] - views.bounds[0, 0])  # pixels per unit tangent
    for distance in (0.5, 2.0, 50.0):
        points = torch.stack([x, 0.2 * x, torch.full_like(x, -distance)], dim=1).expand(2, 5, 3)
        left, right = views.project(points)[0]
        # Disparity of parallel views, shifted so that it is 0 at the convergence: f b (1/z - 1/z0).
        expected = focal * 0.1 * (1 / distance - 1 / 2.0)
        torch.testing.assert_close(left[:, 0] - right[:, 0], torch.full((5,), expected), rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(left[:, 1], right[:, 1])
    assert torch.equal(views.rotation[0], views.rotation[1])


def test_another_resolution_keeps_the_given_field_of_view():
    for camera in (straight(), straight(fov_y_deg=None, fov_x_deg=80.0)):
        views = camera.at(resolution=(96, 32)).views
        assert views.resolution == (96, 32)
        edge = 3 if camera.fov_y_deg is not None else 1
        assert torch.equal(views.bounds[:, edge], camera.views.bounds[:, edge])


def test_presets_are_the_papers_resolutions():
    assert (FHD, QUEST2) == ((1080, 960), (1920, 1832))


def test_camera_is_differentiable():
    views = straight().views.to(torch.float64)
    pixels = (torch.rand(2, 3, 2, dtype=torch.float64) * 40).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: views.rays(p).directions, pixels)
    points = (torch.randn(2, 3, 3, dtype=torch.float64) - torch.tensor([0.0, 0, 5])).requires_grad_()
    assert torch.autograd.gradcheck(views.project, points)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_camera_moves_to_half_precision(dtype):
    for seed in range(5):
        assert somewhere(seed).views.to(dtype).rotation.dtype == dtype


def test_camera_moves_to_another_type():
    views = straight().views.to(torch.float64)
    assert views.rays().directions.dtype == torch.float64
    assert views.resolution == (48, 64)
    assert views.views is views


@pytest.mark.parametrize("resolution", [(0, 4), (4, 0), (-1, 4)])
def test_resolution_of_zero(resolution):
    with pytest.raises(ValueError, match="resolution"):
        straight(resolution=resolution)
    with pytest.raises(ValueError, match="resolution"):
        Camera(torch.zeros(1, 3), torch.eye(3)[None], torch.tensor([[-1.0, 1, -1, 1]]), resolution)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"fov_x_deg": 60.0}, "fov_y_deg, fov_x_deg"),
        ({"fov_y_deg": None}, "fov_y_deg, fov_x_deg"),
        ({"fov_y_deg": 0.0}, "fov_y_deg"),
        ({"fov_y_deg": 180.0}, "fov_y_deg"),
        ({"fov_y_deg": math.nan}, "fov_y_deg"),
        ({"eye_separation": -0.01}, "eye_separation"),
        ({"convergence": 0.0}, "convergence"),
        ({"up": (0, 0, 5)}, "up"),
        ({"up": (0, 0, 0)}, "up"),
        ({"up": (0, math.inf, 0)}, "up"),
        ({"resolution": (4, 4, 4)}, "resolution"),
    ],
)
def test_descriptions_without_a_view(changes, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        straight(**changes)


def test_target_at_the_eye():
    with pytest.raises(ValueError, match="target"):
        StereoCamera.look_at((1, 2, 3), (1, 2, 3), fov_y_deg=60)


@pytest.mark.parametrize("bounds", [[1.0, -1, -1, 1], [-1.0, 1, 1, -1], [0.0, 0, -1, 1]])
def test_camera_inside_out(bounds):
    with pytest.raises(ValueError, match="inside out"):
        Camera(torch.zeros(1, 3), torch.eye(3)[None], torch.tensor([bounds]), (4, 4))


@pytest.mark.parametrize("rotation", [torch.diag(torch.tensor([1.0, 1, -1])), 2 * torch.eye(3), torch.ones(3, 3)])
def test_camera_that_is_no_rotation(rotation):
    with pytest.raises(ValueError, match="rotation"):
        Camera(torch.zeros(1, 3), rotation[None], torch.tensor([[-1.0, 1, -1, 1]]), (4, 4))


def test_camera_with_nan_or_views_that_disagree():
    bounds = torch.tensor([[-1.0, 1, -1, 1]])
    with pytest.raises(ValueError, match="origin"):
        Camera(torch.tensor([[math.nan, 0, 0]]), torch.eye(3)[None], bounds, (4, 4))
    with pytest.raises(ShapeError, match="rotation"):
        Camera(torch.zeros(2, 3), torch.eye(3)[None], bounds, (4, 4))
    with pytest.raises(ShapeError, match="points"):
        straight().views.project(torch.zeros(1, 4, 3))
    with pytest.raises(ShapeError, match="pixels"):
        straight().views.rays(torch.zeros(1, 4, 2))


def test_gaze_from_normalised_coordinates():
    points = torch.tensor([[0.0, 0.0], [1.0, -1.0], [-0.5, 0.5], [3.0, 0.0]])
    expected = torch.tensor([[32.0, 24], [64, 48], [16, 12], [128, 24]])
    assert torch.equal(Gaze.from_normalised(points, (48, 64)).pixels, expected)


@pytest.mark.parametrize("convergence", [None, 0.5])
def test_gaze_from_degrees_lies_on_the_ray_of_that_direction(convergence):
    views = straight(convergence=convergence).views
    angles = torch.tensor([[20.0, -10.0], [-35.0, 5.0]])
    gaze = Gaze.from_degrees(angles, views)
    directions = views.rays(gaze.pixels[:, None]).directions[:, 0]
    azimuth = torch.rad2deg(torch.atan2(directions[:, 0], -directions[:, 2]))
    elevation = torch.rad2deg(torch.atan2(directions[:, 1], -directions[:, 2]))
    torch.testing.assert_close(torch.stack([azimuth, elevation], 1), angles, rtol=1e-4, atol=1e-3)


def test_gaze_at_the_centre_of_every_view():
    assert torch.equal(Gaze.center(straight()).pixels, torch.tensor([[32.0, 24], [32, 24]]))
    assert Gaze.center(straight().views).to(torch.float64).pixels.dtype == torch.float64


def test_gaze_refuses_bad_values():
    with pytest.raises(ValueError, match="Gaze"):
        Gaze(torch.tensor([[math.nan, 0]]))
    with pytest.raises(ShapeError, match="Gaze"):
        Gaze(torch.zeros(2))
    with pytest.raises(ValueError, match="angles"):
        Gaze.from_degrees(torch.tensor([[90.0, 0], [0, 0]]), straight())
    with pytest.raises(ShapeError, match="angles"):
        Gaze.from_degrees(torch.zeros(1, 2), straight())
