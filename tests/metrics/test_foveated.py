"""What the eye makes of an error: weights by acuity in closed form, regions of a comparison, and FovVideoVDP."""

import math
import sys

import pytest
import torch

from fovden import color
from fovden.camera import Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.foveation import ReddyAcuity, eccentricity_degrees
from fovden.metrics import acuity_weight, compare, flip_map, fovvideovdp, rmse, ssim_map
from fovden.metrics.image import MARGIN

RESOLUTION = (48, 40)


def views() -> StereoCamera:
    return StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=RESOLUTION)


def gaze() -> Gaze:
    return Gaze(torch.tensor([[20.0, 24.0], [5.5, 60.0]]))


def noisy(where: torch.Tensor | float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    truth = torch.rand((2, 3, *RESOLUTION), generator=generator)
    return (truth + 0.3 * where * torch.randn(truth.shape, generator=generator)).clamp(min=0), truth


def test_weights_are_acuity_squared_at_the_angle_of_each_pixel():
    weight = acuity_weight(views(), gaze())
    # By hand: the angle between two view rays of the left eye, and Geisler and Perry's formula.
    rays = views().views.rays().directions[0].reshape(*RESOLUTION, 3).double()
    looks = views().views.rays(gaze().pixels[:, None]).directions[0, 0].double()
    for y, x in ((0, 0), (24, 20), (47, 3)):
        angle = math.degrees(math.acos(min(1.0, float(rays[y, x] @ looks))))
        assert float(weight[0, 0, y, x]) == pytest.approx((1 + angle / 2.3) ** -2, rel=1e-3)
    assert weight.shape == (2, 1, *RESOLUTION)
    assert (weight > 0).all()
    assert (weight <= 1).all()
    assert not torch.equal(weight[0], weight[1])


def test_another_acuity_may_be_asked_for():
    acuity = ReddyAcuity()
    expected = acuity(eccentricity_degrees(gaze(), views()))
    assert torch.equal(acuity_weight(views(), gaze(), acuity), expected)


def test_a_weight_is_a_region_of_the_comparison():
    image, truth = noisy()
    weight = acuity_weight(views(), gaze())
    layer = torch.zeros(1, 1, *RESOLUTION, dtype=torch.int32)
    layer[..., 20:] = 1
    found = compare({"noisy": image}, truth, layer, 1.0, weights={"acuity": weight})
    assert found.regions == ("whole", "layer 0", "layer 1", "acuity")
    shown, shown_truth = color.display(image, 1.0), color.display(truth, 1.0)
    squares = (shown - shown_truth).double().square().mean(1, keepdim=True)
    expected = ((weight * squares).sum((1, 2, 3)) / weight.double().sum((1, 2, 3))).sqrt()
    similarity, inner = ssim_map(shown, shown_truth), weight[..., MARGIN:-MARGIN, MARGIN:-MARGIN]
    for view in range(2):
        assert found.value("noisy", "rmse", "acuity", view) == pytest.approx(float(expected[view]), rel=1e-5)
        mean = float((inner * similarity)[view].mean(0).sum() / inner[view].sum())
        assert found.value("noisy", "ssim", "acuity", view) == pytest.approx(mean, rel=1e-5)
        mean = float((weight * flip_map(shown, shown_truth))[view].sum() / weight[view].sum())
        assert found.value("noisy", "flip", "acuity", view) == pytest.approx(mean, rel=1e-5)
    assert "acuity" in str(found)


def test_equal_weights_are_the_whole_image():
    image, truth = noisy()
    found = compare({"noisy": image}, truth, weights={"even": torch.full((1, 1, *RESOLUTION), 0.25)})
    for metric in found.metrics:
        assert found.value("noisy", metric, "even") == pytest.approx(found.value("noisy", metric), rel=1e-5)


def test_an_error_at_the_gaze_weighs_more():
    near = (acuity_weight(views(), gaze()) > 0.05).float()
    weight = acuity_weight(views(), gaze())
    (at_gaze, truth), (elsewhere, _) = noisy(near), noisy(1 - near)
    assert (rmse(at_gaze, truth, weight)[0] > 1.5 * rmse(at_gaze, truth)[0]).item()
    assert (rmse(elsewhere, truth, weight)[0] < 0.95 * rmse(elsewhere, truth)[0]).item()


def test_what_is_no_weight_is_refused():
    image, truth = noisy()
    flat = torch.ones(1, 1, *RESOLUTION)
    with pytest.raises(ValueError, match=r"weights: expected names other than 'whole'"):
        compare({"noisy": image}, truth, weights={"whole": flat})
    with pytest.raises(ValueError, match=r"weights\['acuity'\].*at least 0"):
        compare({"noisy": image}, truth, weights={"acuity": -flat})
    with pytest.raises(ShapeError, match=r"weights\['acuity'\]"):
        compare({"noisy": image}, truth, weights={"acuity": flat[..., :-1]})
    with pytest.raises(ShapeError, match=r"weights\['acuity'\].*views"):
        compare({"noisy": image}, truth, weights={"acuity": flat.expand(3, -1, -1, -1)})
    with pytest.raises(ShapeError, match="gaze"):
        acuity_weight(views(), Gaze(torch.zeros(1, 2)))


def test_without_fovvideovdp_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyfvvdp", None)
    image, truth = noisy()
    with pytest.raises(ImportError, match=r"fovden\[fovvideovdp\]"):
        fovvideovdp(image, truth, views(), gaze())


def test_what_fovvideovdp_cannot_judge_is_refused():
    image, truth = noisy()
    with pytest.raises(ShapeError, match="reference"):
        fovvideovdp(image, truth[..., :-1], views(), gaze())
    with pytest.raises(ValueError, match="peak_luminance"):
        fovvideovdp(image, truth, views(), gaze(), peak_luminance=0)
    with pytest.raises(ValueError, match="contrast"):
        fovvideovdp(image, truth, views(), gaze(), contrast=1)
    with pytest.raises(ValueError, match="image"):
        fovvideovdp(image * math.nan, truth, views(), gaze())


def test_fovvideovdp_sees_what_is_near_the_gaze():
    pytest.importorskip("pyfvvdp", reason="FovVideoVDP is not installed")
    inner = (eccentricity_degrees(gaze(), views()) < 15).float()
    (near, truth), (far, _) = noisy(inner), noisy(1 - inner)
    same, near_score, far_score = (fovvideovdp(each, truth, views(), gaze(), 1.0)[0] for each in (truth, near, far))
    assert same == 10
    # The inner disc is a twelfth of the left eye's image: were all pixels alike, its error would be the lesser one.
    assert inner[0].mean() < 1 / 8
    assert near_score < 9.9
    errors = [((each - truth)[0].square().mean()) for each in (near, far)]
    assert (10 - near_score) / errors[0] > 2 * (10 - far_score) / errors[1]
