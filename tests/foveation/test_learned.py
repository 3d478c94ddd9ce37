"""Learned falloffs: the plain one in closed form, numbers of paths, and differences."""

import math

import pytest
import torch

from fovden.camera import FHD, Gaze, StereoCamera
from fovden.foveation import LearnedProfile, LearnedThreeLayer, ThreeLayer, add_differences, sample_map

CAMERA = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(45, 40))
CENTRE = Gaze.center(CAMERA)
ASIDE = Gaze(torch.tensor([[3.0, 40.0], [-20.0, 10.5]]))


def mean_rate(falloff, gaze=CENTRE):
    return falloff(CAMERA.views, gaze).rate.mean(dtype=torch.float64)


def test_starts_with_the_papers_values():
    camera = CAMERA.at(resolution=FHD)
    r0, r1, p = LearnedThreeLayer().values(camera, Gaze.center(camera))
    assert (r0.item(), r1.item(), p.item()) == pytest.approx((144, 288, 0.5), rel=1e-6)
    learned = LearnedThreeLayer()(camera.views, Gaze.center(camera))
    plain = ThreeLayer()(camera.views, Gaze.center(camera))
    assert torch.allclose(learned.rate, plain.rate, atol=1e-6)
    assert torch.equal(learned.layer, plain.layer)
    assert learned.selects


@pytest.mark.parametrize("gaze", [CENTRE, ASIDE])
@pytest.mark.parametrize("arguments", [{}, {"r0": 0.5, "width": 2.0, "p": 0.8}, {"r0": 1.2, "budget": 0.5}])
def test_frozen_is_the_same_falloff(gaze, arguments):
    learned = LearnedThreeLayer(**arguments)
    found, plain = learned(CAMERA.views, gaze), learned.frozen(CAMERA, gaze)(CAMERA.views, gaze)
    assert torch.allclose(found.rate, plain.rate, atol=1e-6)
    assert torch.equal(found.layer, plain.layer)
    assert found.radii == pytest.approx(plain.radii)


def test_what_is_learned_transfers_between_resolutions():
    learned = LearnedThreeLayer(0.7, 1.4, budget=0.5)
    double = CAMERA.at(resolution=(90, 80))
    small, large = learned.frozen(CAMERA), learned.frozen(double)
    assert (large.r0, large.r1) == pytest.approx((2 * small.r0, 2 * small.r1), rel=1e-6)
    assert large.p == pytest.approx(small.p, rel=2e-3)  # the same circles over other pixels


@pytest.mark.parametrize("budget", [0.1, 0.4, 0.573, 0.9])
@pytest.mark.parametrize("gaze", [CENTRE, ASIDE])
@pytest.mark.parametrize(("r0", "width"), [(1.0, 1.0), (0.1, 0.2), (3.0, 0.5), (0.01, 5.0), (8.0, 8.0)])
def test_the_budget_is_held(budget, gaze, r0, width):
    learned = LearnedThreeLayer(r0, width, budget=budget)
    rate = learned(CAMERA.views, gaze).rate
    # Rates are rounded to float32, at random, over 3600 pixels; the solution itself is good to 1e-12.
    assert mean_rate(learned, gaze).item() == pytest.approx(budget, abs=1e-7)
    assert 0 <= rate.min() <= rate.max() <= 1
    assert mean_rate(LearnedProfile(budget=budget), gaze).item() == pytest.approx(budget, abs=1e-7)


def test_the_budget_is_what_the_sample_map_expects():
    learned = LearnedThreeLayer(0.7, 1.5, budget=0.45)
    with torch.enable_grad():
        found = sample_map(learned, CAMERA, spp=4)
    assert found.expected == pytest.approx(4 * 2 * 45 * 40 * 0.45, rel=1e-6)
    assert found.radii == pytest.approx(learned.frozen(CAMERA).radii(CAMERA.resolution))


@pytest.mark.parametrize("make", [
    lambda: LearnedThreeLayer(0.9, 1.3, 0.6),
    lambda: LearnedThreeLayer(0.9, 1.3, budget=0.6),
    lambda: LearnedThreeLayer(2.5, 1.5, budget=0.4),  # circles that shrink
    lambda: LearnedProfile(budget=0.5),
])  # fmt: skip
def test_derivatives_are_those_of_differences(make):
    falloff = make().double()
    weight = torch.rand(2, 1, 45, 40, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    parameters = list(falloff.parameters())

    def loss():
        return (weight * falloff(CAMERA.views, Gaze(ASIDE.pixels.double())).rate).mean()

    exact = torch.autograd.grad(loss(), parameters)
    add_differences(parameters, loss, step=1e-5)
    for parameter, derivative in zip(parameters, exact, strict=True):
        # Kinks at r0 and r1 that a pixel crosses within the step, and its square.
        assert torch.allclose(parameter.grad, derivative, rtol=1e-4, atol=1e-7)
        assert derivative.abs().max() > 1e-5


def test_a_budget_cannot_be_spent_twice():
    """The mean rate does not move with any parameter."""
    for falloff in (LearnedThreeLayer(0.9, 1.3, budget=0.6), LearnedThreeLayer(3.0, 1.0, budget=0.4),
                    LearnedProfile(budget=0.5)):  # fmt: skip
        falloff.double()
        for derivative in torch.autograd.grad(mean_rate(falloff, Gaze(CENTRE.pixels.double())), falloff.parameters()):
            assert derivative.abs().max() < 1e-12


def test_layers_may_be_kept():
    kept = LearnedThreeLayer(0.4, 3.0, layers=ThreeLayer())(CAMERA.views, CENTRE)
    plain = ThreeLayer()(CAMERA.views, CENTRE)
    assert torch.equal(kept.layer, plain.layer)
    assert kept.radii == plain.radii
    assert not torch.equal(kept.rate, plain.rate)


def test_a_profile_falls_from_knot_to_knot_and_starts_near_the_paper():
    camera = CAMERA.at(resolution=(270, 240)).views
    gaze = Gaze(torch.tensor([[0.5, 0.5], [0.5, 0.5]]))
    plain = ThreeLayer(r0=36, r1=72)(camera, gaze).rate
    rate = LearnedProfile(budget=plain.mean().item())(camera, gaze).rate
    assert (rate[0, 0, 0].diff() <= 0).all()
    assert (rate - plain).abs().max() < 0.03
    bend = rate[0, 0, 0].double().diff().diff().abs()  # 0 between the knots, the first of which lies at 0
    places = torch.arange(1, 239)
    inner = torch.stack([(places - knot).abs() for knot in (9, 18, 36, 54, 72, 108, 144)]).amin(0) > 1
    assert bend[inner].max() < 1e-6
    assert torch.allclose(rate[0, 0, 0, 145:], rate[0, 0, 0, -1])


def test_saved_parameters_come_back():
    first, second = LearnedThreeLayer(0.5, 2.0, 0.3), LearnedThreeLayer()
    second.load_state_dict(first.state_dict())
    assert torch.equal(first(CAMERA.views, CENTRE).rate, second(CAMERA.views, CENTRE).rate)
    assert set(LearnedThreeLayer(budget=0.5).state_dict()) == {"log_r0", "log_width"}


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: LearnedThreeLayer(r0=0), "r0"),
        (lambda: LearnedThreeLayer(width=-1), "width"),
        (lambda: LearnedThreeLayer(p=1), "p"),
        (lambda: LearnedThreeLayer(budget=0), "budget"),
        (lambda: LearnedThreeLayer(p=0.5, budget=0.5), "p: expected None"),
        (lambda: LearnedProfile(budget=1), "budget"),
        (lambda: LearnedProfile(budget=0.5, knots=(0, 1, 1)), "knots"),
        (lambda: add_differences([], lambda: 0.0), "parameters"),
        (lambda: add_differences([torch.zeros(1)], lambda: 0.0, step=0), "step"),
    ],
)
def test_what_cannot_be(make, name):
    with pytest.raises(ValueError, match=name):
        make()


def test_differences_add_up_and_leave_the_parameters():
    x = torch.tensor([[0.3, -2.0]], requires_grad=True)
    y = torch.tensor(1.0, requires_grad=True)

    def loss():
        return (x.exp() * torch.tensor([1.0, 3.0])).sum() * y

    before = x.detach().clone()
    for _ in range(2):
        add_differences([x, y], loss, step=1e-2)
    # The central difference of exp is exp times sinh(h) / h; float32 differences over 0.02 are good to 1e-4.
    assert x.grad.flatten().tolist() == pytest.approx([2 * math.exp(0.3), 6 * math.exp(-2)], rel=1e-3)
    assert y.grad.item() == pytest.approx(2 * (math.exp(0.3) + 3 * math.exp(-2)), rel=1e-3)
    assert torch.equal(x, before)
    assert y.item() == 1
