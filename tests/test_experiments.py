"""The experiments run at their smallest, and figures are drawn again from their numbers."""

import math

import pytest
from PIL import Image

from fovden.figures import draw_convergence, draw_falloff
from fovden.figures.convergence import convergence_slope, noise_by_samples
from fovden.figures.falloff import losses_by_radii, path_of_radii
from fovden.results import read_metrics

light_choice = pytest.importorskip("experiments.light_choice", reason="not a checkout")
learn_falloff = pytest.importorskip("experiments.learn_falloff", reason="not a checkout")
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


def test_falloffs_are_learned_and_drawn_again(tmp_path):
    assert learn_falloff.main(["--preset", "smoke", "-o", str(tmp_path)]) == 0
    first = (tmp_path / "falloff.png").read_bytes()
    (tmp_path / "falloff.png").unlink()
    assert draw_falloff(tmp_path).read_bytes() == first
    rows = read_metrics(tmp_path)
    budget = next(row.value for row in rows if row.metric == "budget")
    rates = {row.method: row.value for row in rows if row.metric == "mean_rate"}
    assert set(rates) >= {"paper", "uniform", "differences", "relaxed, layers kept", "profile, layers kept"}
    assert list(rates.values()) == pytest.approx([budget] * len(rates), abs=1e-6), "all cost the same"
    path = path_of_radii(rows, "cornell_box", "differences")
    assert path[0] == (1.0, 1.0)
    assert len(path) == 3 + 2  # the start, three steps, and their mean
    assert len(losses_by_radii(rows, "cornell_box", "grid")) == 4
    ratios = {row.method: row.value for row in rows if (row.metric, row.region) == ("ratio", "test")}
    assert ratios["paper"] == pytest.approx(1)
    assert ratios["uniform"] > 1, "the loss is that of the fovea"
