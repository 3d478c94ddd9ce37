"""Falloffs of the field against closed forms, loops, quadrature and the numbers quoted for Guenter's layers."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.optimize import minimize

from fovden.camera import Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.foveation import (
    AcuityFalloff,
    Display,
    GuenterLayers,
    HyperbolicFalloff,
    LinearFalloff,
    LinearMarAcuity,
    ReddyAcuity,
    TableAcuity,
    ThreeLayer,
    eccentricity_degrees,
    eccentricity_pixels,
)
from fovden.foveation.falloff import layer_of_rate, require_layer_rates

CAMERA = StereoCamera.look_at((1, 2, 3), (0, 1, 0), fov_y_deg=80, resolution=(36, 40), convergence=0.8).views
CENTRE = Gaze.center(CAMERA)
ASIDE = Gaze(torch.tensor([[3.0, 30.5], [-70.0, 400.0]]))  # one eye in a corner, the other far outside of the image
DESKTOP = Display.from_size((1080, 1920), width=0.509, distance=0.59)
MAR0 = 1 / 48
FALLOFFS = {
    "linear": LinearFalloff(),
    "linear, pixels": LinearFalloff(5, 12, 0.1, unit="pixels"),
    "reddy": AcuityFalloff(),
    "reddy squared": AcuityFalloff(ReddyAcuity(power=2), minimum=0.01),
    "mar": AcuityFalloff(LinearMarAcuity()),
    "table": AcuityFalloff(TableAcuity((5.0, 20.0, 60.0), (1.0, 0.3, 0.05)), layer_rates=(0.25,)),
    "hyperbolic": HyperbolicFalloff(),
    "guenter": GuenterLayers(),
    "guenter, circles": GuenterLayers(0.0343, shape="circle"),
}


@pytest.mark.parametrize("gaze", [CENTRE, ASIDE], ids=["centre", "aside"])
@pytest.mark.parametrize("name", FALLOFFS)
def test_every_falloff_falls_with_eccentricity_for_any_gaze(name, gaze):
    falloff = FALLOFFS[name]
    rate, layer, radii, selects = falloff(CAMERA, gaze)
    assert rate.shape == layer.shape == (2, 1, 36, 40)
    assert layer.dtype == torch.int32
    assert selects
    assert 0 < rate.min() <= rate.max() <= 1
    assert bool(radii) == (name == "linear, pixels")
    for view in range(2):  # views do not see each other's gaze
        alone = falloff(CAMERA, Gaze(gaze.pixels[[view, view]])).rate[view]
        assert torch.equal(alone, rate[view])
    if name == "guenter":  # squares on the plane: no function of the angle
        return
    place = eccentricity_pixels(gaze, (36, 40)) if radii else eccentricity_degrees(gaze, CAMERA)
    for view in range(2):
        order = place[view].flatten().argsort()
        assert rate[view].flatten()[order].diff().max() <= 1e-6
        assert layer[view].flatten()[order].diff().min() >= 0
    assert hash(falloff) == hash(falloff)


def test_linear_equals_the_slow_loop():
    falloff = LinearFalloff(8.0, 30.0, 0.2)
    rate, layer, _, _ = falloff(CAMERA, ASIDE)
    degrees = eccentricity_degrees(ASIDE, CAMERA).flatten().tolist()
    expected = [1 if e <= 8 else 1 - 0.8 * (e - 8) / 22 if e <= 30 else 0.2 for e in degrees]
    assert rate.flatten().tolist() == pytest.approx(expected, abs=2e-6)
    assert layer.flatten().tolist() == [0 if e <= 8 else 1 if e <= 30 else 2 for e in degrees]


def test_linear_in_pixels_is_the_three_layer_falloff():
    ours, paper = LinearFalloff(6, 12, 0.5, unit="pixels")(CAMERA, ASIDE), ThreeLayer(6, 12)(CAMERA, ASIDE)
    torch.testing.assert_close(ours.rate, paper.rate)
    assert torch.equal(ours.layer, paper.layer)
    assert ours.radii == paper.radii == (6, 12)


def test_linear_without_a_ramp_is_a_step():
    rate = LinearFalloff(10, 10, 0.25).rate(torch.tensor([0.0, 10.0, 10.1]))
    assert rate.tolist() == [1, 1, 0.25]


def test_mean_of_the_linear_rate_over_a_disc():
    """In closed form 1 - (1 - p) (R^2 - (r0^2 + r0 r1 + r1^2) / 3) / R^2, over a disc of R that reaches beyond r1."""
    r0, r1, p, end = 10.0, 20.0, 0.05, 35.0
    falloff = LinearFalloff(r0, r1, p)
    rate = quad(lambda e: e * float(falloff.rate(torch.tensor(e, dtype=torch.float64))), 0, end, points=[r0, r1])[0]
    expected = 1 - (1 - p) * (end**2 - (r0**2 + r0 * r1 + r1**2) / 3) / end**2
    assert 2 * rate / end**2 == pytest.approx(expected, rel=1e-9)


def test_acuity_falloff_is_its_acuity_above_the_minimum():
    degrees = eccentricity_degrees(ASIDE, CAMERA)
    rate, layer, _, _ = AcuityFalloff(ReddyAcuity(), minimum=0.2)(CAMERA, ASIDE)
    expected = [max(0.2, 1 if e <= 5.79 else 7.49 / (0.3 * e + 1) ** 2) for e in degrees.flatten().tolist()]
    assert rate.flatten().tolist() == pytest.approx(expected, rel=1e-5)
    # The nearest power of a quarter: round(log(1 / rate) / log 4), at most 2.
    nearest = [min(2, round(math.log(1 / each, 4))) for each in rate.flatten().tolist()]
    assert layer.flatten().tolist() == nearest
    own = AcuityFalloff(lambda degrees: 1 / (1 + degrees))(CAMERA, ASIDE).rate
    torch.testing.assert_close(own, 1 / (1 + degrees))


def test_hyperbolic_rate_is_one_where_the_display_limits_and_falls_with_the_square():
    camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_x_deg=DESKTOP.fov_x_deg, resolution=(108, 192)).views
    rate = HyperbolicFalloff(0.0275)(camera, Gaze.center(camera)).rate
    degrees = eccentricity_degrees(Gaze.center(camera), camera)
    finest = math.degrees(math.atan(2 * 0.509 / (0.59 * 192)))
    expected = [min(1, (finest / (MAR0 + 0.0275 * e)) ** 2) for e in degrees.flatten().tolist()]
    assert rate.flatten().tolist() == pytest.approx(expected, rel=1e-4)  # the angles carry single precision
    limit = (finest - MAR0) / 0.0275
    assert torch.equal(rate == 1, degrees <= limit)
    assert torch.equal(HyperbolicFalloff(0.0275, display_mar=finest)(camera, Gaze.center(camera)).rate == 1, rate == 1)


def test_display_of_the_desktop_resolves_what_is_quoted():
    assert math.degrees(math.atan(2 / DESKTOP.pixels_per_tangent)) == pytest.approx(0.0515, abs=5e-5)
    assert math.degrees(math.atan(2 * 0.509 / (0.59 * 1920))) == pytest.approx(0.0515, abs=5e-5)


QUOTED = [  # slope, limits, strides, factor, all as they are quoted for the desktop
    (0.0220, (3.80, 8.59), (2.03, 4.08), 6.4),
    (0.0275, (3.35, 8.07), (2.19, 4.72), 8.5),
    (0.0343, (2.96, 7.62), (2.38, 5.48), 11.2),
]


def samples_of_layers(limits, slope, width=1920, height=1080, screen=0.509, distance=0.59):
    """The quoted formula, in its own symbols."""
    finest = math.degrees(math.atan(2 * screen / (distance * width)))
    strides = [1, *(max(1, (slope * e + MAR0) / finest) for e in limits)]
    sides = [
        2 * width / s * distance / screen * math.tan(math.radians(e)) for s, e in zip(strides, limits, strict=False)
    ]
    return sides[0] ** 2 + sides[1] ** 2 + (width / strides[2]) ** 2 / (width / height), strides


@pytest.mark.parametrize(("slope", "limits", "strides", "factor"), QUOTED)
def test_guenters_layers_are_the_cheapest_and_those_quoted(slope, limits, strides, factor):
    sizes = GuenterLayers(slope).sizes(DESKTOP)
    best = minimize(lambda e: samples_of_layers(e, slope)[0], limits, method="Nelder-Mead", options={"xatol": 1e-8})
    # At the minimum the cost is flat: two searches agree in their places to the root of a float's precision.
    assert sizes.eccentricities == pytest.approx(tuple(best.x), abs=1e-5)
    cost, exact = samples_of_layers(sizes.eccentricities, slope)
    assert sum(sizes.samples) == pytest.approx(cost, rel=1e-12)
    assert sizes.strides == pytest.approx(exact, rel=1e-12)
    assert round(sizes.factor, 1) == factor
    # The quoted limits come from a coarse search: their strides follow, and their cost is the smallest to 3e-5.
    quoted, quoted_strides = samples_of_layers(limits, slope)
    assert [round(stride, 2) for stride in quoted_strides[1:]] == pytest.approx(strides, abs=0.0101)
    assert cost <= quoted <= cost * (1 + 3e-5)
    assert sizes.eccentricities == pytest.approx(limits, abs=0.04)


def test_guenters_rates_on_the_screen():
    camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_x_deg=DESKTOP.fov_x_deg, resolution=(1080, 1920)).views
    gaze = Gaze(torch.tensor([[960.0, 540.0], [100.0, 1200.0]]))
    rate, layer, radii, _ = GuenterLayers()(camera, gaze)
    sizes = GuenterLayers().sizes(DESKTOP)
    half = [960 / (0.509 / 2) * 0.59 * math.tan(math.radians(e)) for e in sizes.eccentricities]
    x, y = np.meshgrid(np.arange(1920) + 0.5, np.arange(1080) + 0.5)
    for view, (gaze_x, gaze_y) in enumerate(gaze.pixels.tolist()):
        distance = np.maximum(abs(x - gaze_x), abs(y - gaze_y))
        expected = (distance > half[0]).astype(int) + (distance > half[1])
        wrong = layer[view, 0].numpy() != expected
        assert not (wrong & (np.abs(distance[..., None] - half).min(-1) > 1e-3)).any()
    assert radii == ()
    for number, stride in enumerate(sizes.strides):
        assert rate[layer == number].unique().tolist() == pytest.approx([stride**-2], rel=1e-6)
    # The layers of a centred gaze without overlaps.
    share = [(2 * half[0]) ** 2, (2 * half[1]) ** 2 - (2 * half[0]) ** 2, 1920 * 1080 - (2 * half[1]) ** 2]
    expected = sum(area / stride**2 for area, stride in zip(share, sizes.strides, strict=True))
    assert float(rate[0].double().sum()) == pytest.approx(expected, rel=0.01)  # whole pixels on the borders


def test_guenters_circles_are_of_equal_angle():
    layer = GuenterLayers(shape="circle")(CAMERA, ASIDE).layer
    n = 40 / (CAMERA.bounds[0, 1] - CAMERA.bounds[0, 0]).item()
    limits = GuenterLayers().sizes(Display((36, 40), 2 * math.degrees(math.atan(20 / n)))).eccentricities
    degrees = eccentricity_degrees(ASIDE, CAMERA)
    expected = (degrees > limits[0]).int() + (degrees > limits[1]).int()
    assert torch.equal(layer, expected)


def test_a_coarse_display_is_sampled_everywhere():
    """Where even the corner is finer than the eye needs, all strides are one."""
    camera = StereoCamera.look_at((0, 0, 0), (0, 0, -1), fov_x_deg=90, resolution=(8, 8)).views
    for falloff in (GuenterLayers(), HyperbolicFalloff()):
        assert (falloff(camera, Gaze.center(camera)).rate == 1).all()


def test_parameters_and_gaze_have_derivatives():
    camera = CAMERA.to(torch.float64)
    r0, r1, p, slope, mar0 = (
        torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in (8, 30, 0.2, 0.03, 0.02)
    )
    gaze = ASIDE.pixels[:1].repeat(2, 1).double().requires_grad_()
    some = torch.tensor([5, 200, 700, 1400])

    def linear(r0, r1, p, gaze):
        return LinearFalloff(r0, r1, p)(camera, Gaze(gaze)).rate.flatten()[some]

    def hyperbolic(slope, mar0, gaze):
        return HyperbolicFalloff(slope, mar0)(camera, Gaze(gaze)).rate.flatten()[some]

    def acuity(slope, mar0, gaze):
        return AcuityFalloff(LinearMarAcuity(slope, mar0))(camera, Gaze(gaze)).rate.flatten()[some]

    assert torch.autograd.gradcheck(linear, (r0, r1, p, gaze))
    assert torch.autograd.gradcheck(hyperbolic, (slope, mar0, gaze))
    assert torch.autograd.gradcheck(acuity, (slope, mar0, gaze))


def test_layers_of_rates():
    rate = torch.tensor([1.0, 0.5, 0.49, 0.125, 0.12, 0.0])
    assert layer_of_rate(rate).tolist() == [0, 0, 1, 1, 2, 2]
    assert layer_of_rate(rate, ()).tolist() == [0] * 6
    with pytest.raises(ValueError, match="layer_rates: expected rates that fall, got"):
        require_layer_rates("layer_rates", (0.1, 0.5))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LinearFalloff(-1), r"LinearFalloff\.r0"),
        (lambda: LinearFalloff(12, 10), r"LinearFalloff\.r1: expected a finite number, at least 12, got 10"),
        (lambda: LinearFalloff(r1=5), r"LinearFalloff\.r1: expected a finite number, at least 10, got 5"),
        (lambda: LinearFalloff(p_min=1.5), r"LinearFalloff\.p_min"),
        (lambda: LinearFalloff(unit="radians"), r"LinearFalloff\.unit: expected one of .*, got 'radians'"),
        (lambda: LinearFalloff(unit="pixels"), r"LinearFalloff\.r0: expected a radius"),
        (lambda: AcuityFalloff(0.5), r"AcuityFalloff\.acuity: expected a callable"),
        (lambda: AcuityFalloff(minimum=2), r"AcuityFalloff\.minimum"),
        (lambda: AcuityFalloff(layer_rates=(0.5, 0.5)), r"AcuityFalloff\.layer_rates: expected rates that fall"),
        (lambda: AcuityFalloff(lambda e: 1 + e)(CAMERA, CENTRE), r"AcuityFalloff\.acuity: expected acuities from 0"),
        (lambda: HyperbolicFalloff(-1), r"HyperbolicFalloff\.slope"),
        (lambda: HyperbolicFalloff(mar0=0), r"HyperbolicFalloff\.mar0"),
        (lambda: HyperbolicFalloff(display_mar=0), r"HyperbolicFalloff\.display_mar"),
        (lambda: GuenterLayers(0), r"GuenterLayers\.slope"),
        (lambda: GuenterLayers(mar0=math.inf), r"GuenterLayers\.mar0"),
        (lambda: GuenterLayers(shape="hexagon"), r"GuenterLayers\.shape: expected one of .*, got 'hexagon'"),
        (lambda: Display.from_size((4, 4), 0, 1), "width"),
        (lambda: Display.from_size((4, 4), 1, -1), "distance"),
    ],
)
def test_falloffs_that_cannot_be(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("name", FALLOFFS)
def test_gaze_of_another_number_of_views(name):
    one = Gaze(torch.zeros(1, 2))
    if name == "linear, pixels":  # the distance on the plane asks no camera; the sample map refuses it
        return
    with pytest.raises(ShapeError, match=r"gaze\.pixels"):
        FALLOFFS[name](CAMERA, one)
