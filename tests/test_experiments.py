"""The experiments run at their smallest, and figures are drawn again from their numbers."""

import math

import pytest
from PIL import Image

from fovden.figures import draw_convergence, draw_falloff, draw_fitted, scores_of_fits
from fovden.figures.convergence import convergence_slope, noise_by_samples
from fovden.figures.falloff import losses_by_radii, path_of_radii
from fovden.results import read_metrics

light_choice = pytest.importorskip("experiments.light_choice", reason="not a checkout")
learn_falloff = pytest.importorskip("experiments.learn_falloff", reason="not a checkout")
sampler_convergence = pytest.importorskip("experiments.sampler_convergence", reason="not a checkout")

frame_sets = pytest.importorskip("experiments.frame_sets", reason="not a checkout")
full_size = pytest.importorskip("experiments.full_size", reason="not a checkout")
tune_sigmas = pytest.importorskip("experiments.tune_sigmas", reason="not a checkout")


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


def test_no_pose_and_no_noise_is_in_two_sets():
    made = [scene for scene in frame_sets.SCENES if scene != "sponza"]
    for scene in made:
        data = {
            name: frame_sets.frame_set(scene, name, resolution=(8, 8), reference_spp=None) for name in frame_sets.SETS
        }
        poses = [(each.camera.eye, each.camera.target) for set_ in data.values() for each in set_.sequence]
        assert len(poses) == len(set(poses)) == 6
        assert len({set_.seed for set_ in data.values()}) == 3
    poses = [pose for poses in frame_sets.SPONZA.values() for pose in poses]
    assert len(poses) == len(set(poses))


def test_widths_are_tuned_and_judged_and_kept(tmp_path, capsys):
    settings = tune_sigmas.Settings(
        scenes=("atrium",),
        resolution=(32, 32),
        reference_spp=4,
        draws=1,
        seeds=2,
        steps=2,
        grid=((4.0, 8.0), (0.1,), (0.03,)),
    )  # fmt: skip
    tune_sigmas.run(settings, tmp_path)
    tables = capsys.readouterr().out
    for light in ("literal", "demodulated"):
        rows = read_metrics(tmp_path / light)
        scores = {(row.method, row.metric) for row in rows if row.scene == "atrium"}
        for method in (
            "Noisy, foveated", "Base, by hand", "NH3LD, by hand", "NH3LD, sigmas of atrium, seed 1",
            "Base, passes of atrium, seed 0", "NH3LD, predicted of atrium, seed 1",
        ):  # fmt: skip
            assert {(method, metric) for metric in ("rmse", "psnr", "ssim", "flip")} <= scores
        widths = {row.method: row.value for row in rows if row.metric == "edge_stopping.0.sigma_radiance"}
        assert any(widths["Base, by hand"] == pytest.approx(width) for width in settings.grid[0])
        assert draw_fitted(tmp_path / light).read_bytes() == (tmp_path / light / "fitted.png").read_bytes()
        found = scores_of_fits(rows)
        assert len(found["atrium", "NH3LD, predicted", "rmse"]) == settings.seeds
        own = [row.value for row in rows if (row.method, row.metric, row.region) == ("Base, by hand", "ssim", "whole")]
        assert found["atrium", "Base, by hand", "ssim"] == pytest.approx([sum(own) / 2])  # of two poses
    kept = {path: path.read_bytes() for path in (tmp_path / "literal" / "fits").rglob("checkpoint.safetensors")}
    assert len(kept) == 12
    tune_sigmas.run(settings, tmp_path)
    assert capsys.readouterr().out == tables
    size = full_size.Settings(tmp_path, ("literal",), ("atrium",), (40, 40), 4, repeats=1)
    full_size.run(size, tmp_path / "size")
    rows = {(row.method, row.metric): row.value for row in read_metrics(tmp_path / "size" / "literal")}
    for method in ("Base, by hand", "NH3LD, predicted of atrium, seed 0"):
        assert {(method, metric) for metric in ("rmse", "flip", "seconds_trace", "seconds_denoise")} <= {
            key for key in rows if key[0] == method
        }
    assert "NH3LD, predicted" in capsys.readouterr().out
    assert all(path.read_bytes() == content for path, content in kept.items())


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
