"""The experiments run at their smallest, and figures are drawn again from their numbers."""

import math

import pytest
from PIL import Image

from fovden.figures import draw_convergence
from fovden.figures.convergence import convergence_slope, noise_by_samples
from fovden.results import read_metrics

light_choice = pytest.importorskip("experiments.light_choice", reason="not a checkout")
sampler_convergence = pytest.importorskip("experiments.sampler_convergence", reason="not a checkout")


def test_choices_of_lights_are_compared(tmp_path, capsys):
    assert light_choice.main(["--preset", "smoke", "-o", str(tmp_path)]) == 0
    rows = read_metrics(tmp_path)
    assert {row.method for row in rows} == {"", "uniform", "power", "tree"}
    for scene in {row.scene for row in rows}:
        found = {(row.method, row.metric): row.value for row in rows if row.scene == scene}
        assert found["tree", "variance_radiance"] > 0
        assert found["tree", "microseconds"] > 0
    assert "variance_direct" in capsys.readouterr().out


def test_convergence_is_measured_and_drawn_again(tmp_path):
    assert sampler_convergence.main(["--preset", "smoke", "-o", str(tmp_path)]) == 0
    first = (tmp_path / "convergence.png").read_bytes()
    (tmp_path / "convergence.png").unlink()
    path = draw_convergence(tmp_path)
    assert path.read_bytes() == first
    with Image.open(path) as picture:
        assert picture.getextrema()[0][0] < picture.getextrema()[0][1]
    noise = noise_by_samples(read_metrics(tmp_path), "cornell_box", "sobol")
    assert list(noise) == [1, 2, 4, 8, 16]


def test_the_slope_is_that_of_the_line_through_the_logarithms():
    assert convergence_slope({n: 3 * n**-0.7 for n in (16, 32, 64, 512)}) == pytest.approx(-0.7)
    assert convergence_slope({1: 5.0, 16: 1.0, 256: 0.25}) == pytest.approx(-0.5), "few samples are left out"
    assert convergence_slope({1: 1.0, 4: 0.5}) == pytest.approx(-0.5), "unless there are no others"
    assert math.isnan(convergence_slope({64: 1.0}))
