"""Widths as logarithms, and their schedules in closed form."""

import math

import pytest
import torch

from fovden.filters import EdgeStopping


def radiance_widths(steps, **options):
    return [sigmas.radiance.item() for sigmas in EdgeStopping(0.8, 0.2, 0.4, **options).passes(steps)]


@pytest.mark.parametrize(("schedule", "factor"), [("halve_sigma", 0.5), ("halve_phi", 0.5**0.5), ("constant", 1.0)])
def test_schedules_by_pass(schedule, factor):
    want = [0.8, 0.8 * factor, 0.8 * factor**2]
    assert radiance_widths((4, 2, 1), schedule=schedule) == pytest.approx(want)
    assert radiance_widths((1, 2, 4), schedule=schedule) == pytest.approx(want)
    assert radiance_widths((1, 2, 4), schedule=schedule, sigma_by="scale") == pytest.approx(want)
    assert radiance_widths((4, 2, 1), schedule=schedule, sigma_by="scale") == pytest.approx(want[::-1])


def test_scale_is_the_rank_of_the_step():
    assert radiance_widths((7, 1, 3, 7), sigma_by="scale") == pytest.approx([0.2, 0.8, 0.4, 0.2])


def test_the_widths_of_the_geometry_stay():
    for sigmas in EdgeStopping(0.8, 0.2, 0.4).passes((4, 2, 1)):
        assert sigmas.normal.item() == pytest.approx(0.2)
        assert sigmas.position.item() == pytest.approx(0.4)


def test_widths_are_stored_as_logarithms_and_learned():
    edges = EdgeStopping(0.8, 0.2, 0.4)
    assert {name: value.item() for name, value in edges.state_dict().items()} == pytest.approx(
        {"log_sigma_radiance": math.log(0.8), "log_sigma_normal": math.log(0.2), "log_sigma_position": math.log(0.4)}
    )
    with torch.no_grad():
        edges.log_sigma_normal.sub_(100)
    assert edges.sigma_normal > 0
    edges.passes((2, 1))[1].radiance.backward()
    assert edges.log_sigma_radiance.grad.item() == pytest.approx(0.4)  # d(sigma / 2) / d(log sigma) = sigma / 2


def test_passes_may_have_widths_of_their_own():
    edges = EdgeStopping(0.8, 0.2, 0.4, passes=3, sigma_by="scale")
    assert edges.pass_count == 3
    assert {name: value.shape for name, value in edges.state_dict().items()} == {
        f"log_sigma_{name}": (3,) for name in ("radiance", "normal", "position")
    }
    shared = EdgeStopping(0.8, 0.2, 0.4, sigma_by="scale")
    assert shared.pass_count is None
    assert edges.passes((4, 2, 1)) == shared.passes((4, 2, 1))  # to the bit
    with torch.no_grad():
        for name, values in (("radiance", (1.0, 2.0, 3.0)), ("normal", (4.0, 5.0, 6.0)), ("position", (7.0, 8.0, 9.0))):
            edges.get_parameter(f"log_sigma_{name}").copy_(torch.tensor(values).log())
    widths = [[width.item() for width in sigmas] for sigmas in edges.passes((4, 2, 1))]
    assert widths == [pytest.approx(row) for row in ([0.25, 4, 7], [1, 5, 8], [3, 6, 9])]
    edges.passes((4, 2, 1))[1].radiance.backward()
    assert edges.log_sigma_radiance.grad.tolist() == pytest.approx([0, 1, 0])
    assert "sigma_radiance=(1, 2, 3), sigma_normal=(4, 5, 6)" in repr(edges)
    with pytest.raises(ValueError, match="steps"):
        edges.passes((2, 1))


def test_print_shows_widths():
    assert "sigma_radiance=0.8, sigma_normal=0.2, sigma_position=0.4" in repr(EdgeStopping(0.8, 0.2, 0.4))


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"sigma_radiance": 0}, "sigma_radiance"),
        ({"sigma_normal": -1.0}, "sigma_normal"),
        ({"sigma_position": math.inf}, "sigma_position"),
        ({"schedule": "halve"}, "schedule"),
        ({"sigma_by": "step"}, "sigma_by"),
        ({"passes": 0}, "passes"),
    ],
)
def test_bad_input_is_named(arguments, name):
    with pytest.raises(ValueError, match=name):
        EdgeStopping(**arguments)
