"""Displays and eccentricity against closed forms and slow loops."""

import math

import pytest
import torch

from fovden.camera import FHD, QUEST2, Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.foveation import Display, eccentricity_degrees, eccentricity_pixels


def test_pixels_equal_the_slow_loop():
    gaze = Gaze(torch.tensor([[3.2, 1.7], [-40.0, 90.5]]))
    found = eccentricity_pixels(gaze, (5, 7))
    assert found.shape == (2, 1, 5, 7)
    for view, (gx, gy) in enumerate(gaze.pixels.tolist()):
        for y in range(5):
            for x in range(7):
                assert float(found[view, 0, y, x]) == pytest.approx(math.hypot(x + 0.5 - gx, y + 0.5 - gy), rel=1e-6)


def test_degrees_equal_the_arc_cosine_of_the_rays():
    camera = StereoCamera.look_at((1, 2, 3), (0, 1, 0), fov_y_deg=80, resolution=(9, 13), convergence=0.8)
    gaze = Gaze(torch.tensor([[2.0, 3.0], [30.0, -5.0]]))
    found = eccentricity_degrees(gaze, camera).flatten(1).double()
    views = camera.views.to(torch.float64)
    pixels = views.rays().directions
    centre = views.rays(gaze.pixels.double()[:, None]).directions
    expected = torch.rad2deg(torch.acos((pixels * centre).sum(-1)))
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-4)


def test_degrees_keep_their_precision_near_the_gaze():
    display = Display((1080, 960), fov_x_deg=90)
    offset = 1e-2  # pixels; the arc cosine of a dot product in float32 would be 0 or 0.02 degrees here
    angle = display.eccentricity_degrees(Gaze(torch.tensor([[480.5 + offset, 540.5]])))[0, 0, 540, 480]
    # Pixel coordinates near 480 carry 3e-5, 0.3 % of the offset; unit rays carry 1e-7 of 4e-5 rad ... 0.6 %.
    assert float(angle) == pytest.approx(offset / display.pixels_per_degree, rel=0.02)


def test_degrees_of_the_centred_gaze_are_the_closed_form():
    display = Display((30, 40), fov_x_deg=100)
    gaze = Gaze(torch.tensor([[20.0, 15.0]]))
    distance = display.eccentricity_pixels(gaze)
    expected = torch.rad2deg(torch.atan(distance * math.tan(math.radians(50)) / 20))
    torch.testing.assert_close(display.eccentricity_degrees(gaze), expected, rtol=1e-5, atol=1e-5)


def test_display_and_camera_of_the_same_field_of_view_agree():
    camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_x_deg=77, resolution=(12, 16))
    gaze = Gaze(torch.tensor([[1.0, 2.0], [9.0, 30.0]]))
    display = Display((12, 16), fov_x_deg=77)
    torch.testing.assert_close(display.eccentricity_degrees(gaze), eccentricity_degrees(gaze, camera))


def test_measures_of_a_display():
    display = Display((1000, 2000), fov_x_deg=90)
    assert display.pixels_per_tangent == pytest.approx(1000)
    assert display.pixels_per_degree == pytest.approx(1000 * math.pi / 180)
    assert display.fov_y_deg == pytest.approx(2 * math.degrees(math.atan(0.5)))
    assert display.radius(0) == 0
    assert display.radius(30) == pytest.approx(1000 / math.sqrt(3))
    # One degree at the centre spans that many pixels, to second order in the angle.
    assert display.radius(0.5) * 2 == pytest.approx(display.pixels_per_degree, rel=1e-4)


def test_presets():
    assert Display.fhd().resolution == FHD
    assert Display.quest2().resolution == QUEST2
    assert 60 < Display.fhd().fov_x_deg < 120
    assert 60 < Display.quest2().fov_x_deg < 120


def test_eccentricity_is_differentiable_in_the_gaze():
    gaze = torch.tensor([[3.3, 4.1]], dtype=torch.float64, requires_grad=True)
    display = Display((4, 5), fov_x_deg=60)
    assert torch.autograd.gradcheck(lambda g: display.eccentricity_pixels(Gaze(g)), gaze)
    assert torch.autograd.gradcheck(lambda g: display.eccentricity_degrees(Gaze(g)), gaze)


@pytest.mark.parametrize(
    ("resolution", "fov", "name"),
    [((0, 4), 90, "resolution"), ((4, 0), 90, "resolution"), ((4,), 90, "resolution"), ((4, 4), 0, "fov_x_deg")],
)
def test_displays_that_cannot_be(resolution, fov, name):
    with pytest.raises(ValueError, match=name):
        Display(resolution, fov)


def test_bad_arguments():
    with pytest.raises(ValueError, match="degrees"):
        Display((4, 4), 90).radius(90)
    camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_x_deg=77, resolution=(12, 16))
    with pytest.raises(ShapeError, match="gaze"):
        eccentricity_degrees(Gaze(torch.zeros(1, 2)), camera)
