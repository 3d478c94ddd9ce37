"""Models of acuity against numeric quadrature, printed numbers and slow interpolation."""

import math
import re

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from fovden.foveation import Acuity, LinearMarAcuity, ReddyAcuity, TableAcuity

TABLE = TableAcuity((2.0, 5.0, 20.0, 40.0), (1.0, 0.7, 0.7, 0.05))
MODELS = (
    ReddyAcuity(),
    ReddyAcuity(power=2),
    LinearMarAcuity(),
    LinearMarAcuity(slope=0.0343, mar0=0.05, power=2),
    TABLE,
    TableAcuity((0.0, 30.0), (0.9, 0.1)),
)


def at(degrees):
    return torch.tensor(degrees, dtype=torch.float64)


@pytest.mark.parametrize("model", MODELS)
def test_integral_equals_quadrature(model):
    assert isinstance(model, Acuity)
    for end in (0.0, 1.3, 5.0, 5.79, 7.0, 20.0, 33.3, 40.0, 90.0):
        knots = [knot for knot in (2.0, 5.0, 5.79, 20.0, 30.0, 40.0) if knot < end]
        expected = quad(lambda e: e * float(model(at(e))), 0, end, points=knots or None, epsabs=1e-11, limit=200)[0]
        assert float(model.integral(at(end))) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_acuity_falls_from_one_and_is_differentiable(model):
    degrees = torch.linspace(0, 120, 481, dtype=torch.float64)
    acuity = model(degrees)
    assert 0 < acuity.min() <= acuity.max() <= 1
    assert acuity.diff().max() <= 1e-12
    assert model(degrees.float().reshape(13, 37)).shape == (13, 37)
    assert model(degrees.float()).dtype == torch.float32
    places = at([0.5, 3.1, 8.0, 25.0, 60.0]).requires_grad_()
    assert torch.autograd.gradcheck(model, places)
    slope = torch.autograd.grad(model.integral(places).sum(), places)[0]
    torch.testing.assert_close(slope, (places * model(places)).detach(), rtol=1e-9, atol=1e-12)


def test_reddy_is_the_printed_formula():
    for degrees, cycles in ((0, 60), (5.79, 60), (10, 449.4 / 16), (60, 449.4 / 361)):
        assert 60 * float(ReddyAcuity()(at(float(degrees)))) == pytest.approx(cycles, rel=1e-12)
    left, right = ReddyAcuity()(at([5.79, math.nextafter(5.79, 6)])).tolist()
    assert left - right == pytest.approx(1 - 0.99984, abs=1e-5)  # the joint, as it was printed
    assert torch.equal(ReddyAcuity(power=2)(at([3.0, 12.0])), ReddyAcuity()(at([3.0, 12.0])) ** 2)


@pytest.mark.parametrize(
    ("farthest", "share"),
    [(30, 0.2811), (35, 0.2582), (40, 0.2409), (40.28, 0.2400), (45, 0.2271), (50, 0.2159), (55, 0.2066)],
)
def test_reddys_integral_gives_the_foveas_share_of_visual_polar_columns(farthest, share):
    """Columns are linear in e up to the limit, where one degree takes as many as beyond: e_c / e_c for the fovea."""
    fovea, whole = ReddyAcuity().integral(at([5.79, float(farthest)])).tolist()
    beyond = (whole - fovea) / 5.79**2
    assert 1 / (1 + beyond) == pytest.approx(share, abs=5e-5)


def test_linear_mar_doubles_where_the_angle_does():
    model = LinearMarAcuity(slope=0.025, mar0=0.05)
    assert model(at([0.0, 2.0, 6.0])).tolist() == pytest.approx([1, 1 / 2, 1 / 4])
    slope, mar0 = at(0.03).requires_grad_(), at(0.02).requires_grad_()
    places = at([0.5, 10.0])
    for power in (1, 2):
        for of in (lambda model: model(places), lambda model: model.integral(places)):
            assert torch.autograd.gradcheck(lambda s, m, of=of, p=power: of(LinearMarAcuity(s, m, p)), (slope, mar0))


def test_table_is_numpys_interpolation():
    places = np.linspace(0, 60, 241)
    expected = np.interp(places, TABLE.eccentricities, TABLE.values)
    np.testing.assert_allclose(TABLE(torch.from_numpy(places)).numpy(), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ReddyAcuity(power=3), "ReddyAcuity.power: expected 1 or 2, got 3"),
        (lambda: LinearMarAcuity(slope=0), "LinearMarAcuity.slope: expected a finite number, above 0, got 0"),
        (lambda: LinearMarAcuity(slope=torch.ones(2)), "LinearMarAcuity.slope: expected shape (), got (2,)"),
        (lambda: LinearMarAcuity(mar0=-1.0), "LinearMarAcuity.mar0"),
        (lambda: LinearMarAcuity(mar0=torch.tensor(math.nan)), "LinearMarAcuity.mar0"),
        (lambda: TableAcuity((0.0,), (1.0,)), "TableAcuity.eccentricities: expected two or more eccentricities"),
        (lambda: TableAcuity((0.0, 0.0), (1.0, 0.5)), "TableAcuity.eccentricities: expected eccentricities that rise"),
        (lambda: TableAcuity((-1.0, 0.0), (1.0, 0.5)), "TableAcuity.eccentricities"),
        (lambda: TableAcuity((0.0, 1.0), (1.0,)), "TableAcuity.values: expected 2 values, one for each eccentricity"),
        (lambda: TableAcuity((0.0, 1.0), (0.5, 1.0)), "TableAcuity.values: expected values that do not rise"),
        (lambda: TableAcuity((0.0, 1.0), (1.0, 0.0)), "TableAcuity.values: expected a finite number, at most 1 and"),
    ],
)
def test_acuities_that_cannot_be(make, message):
    with pytest.raises(ValueError, match=re.escape(message) if "at most" not in message else r"TableAcuity\.values"):
        make()
