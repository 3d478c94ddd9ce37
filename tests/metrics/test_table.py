"""The comparison table: its numbers are those of the metrics, its conditions are recorded, its file can be read."""

import csv
import math

import pytest
import torch

from fovden import color, metrics
from fovden.checks import ShapeError
from fovden.frame import Reference
from fovden.metrics import Comparison, compare

SHAPE = (2, 3, 24, 30)
METRICS = ("rmse", "psnr", "ssim", "flip", "rmse_linear", "relative_mse", "smape")


def scene(seed: int = 0) -> tuple[dict[str, torch.Tensor], Reference]:
    generator = torch.Generator().manual_seed(seed)
    truth = 8 * torch.rand(SHAPE, generator=generator) ** 2
    images = {
        "noisy": truth * (1 + 0.5 * torch.randn(SHAPE, generator=generator)).clamp(min=0),
        "filtered": truth * (1 + 0.1 * torch.randn(SHAPE, generator=generator)),
    }
    return images, Reference(truth, torch.full(SHAPE, 0.01), 64)


def layers() -> torch.Tensor:
    """Three columns in the left view; the right view looks away and has the outermost layer alone."""
    layer = torch.full((2, 1, 24, 30), 2, dtype=torch.int32)
    layer[0, ..., :10] = 0
    layer[0, ..., 10:20] = 1
    return layer


def test_scores_are_those_of_the_metrics():
    images, reference = scene()
    found = compare(images, reference)
    exposure = color.exposure(reference.mean)
    assert found.exposure == exposure
    truth = color.display(reference.mean, exposure)
    for name, image in images.items():
        shown = color.display(image, exposure)
        expected = {
            "rmse": metrics.rmse(shown, truth),
            "psnr": metrics.psnr(shown, truth),
            "ssim": metrics.ssim(shown, truth),
            "flip": metrics.flip(shown, truth),
            "rmse_linear": metrics.rmse(image, reference.mean, noise=reference.variance),
            "relative_mse": metrics.relative_mse(image, reference.mean, noise=reference.variance),
            "smape": metrics.smape(image, reference.mean),
        }
        for metric, values in expected.items():
            for view in range(2):
                assert found.value(name, metric, view=view) == pytest.approx(float(values[view]), rel=1e-6)
            assert found.value(name, metric) == pytest.approx(float(values.mean()), rel=1e-6)
    assert found.methods == ("noisy", "filtered")
    assert found.metrics == METRICS
    assert found.regions == ("whole",)


def test_layers_are_regions_of_their_own():
    images, reference = scene()
    layer = layers()
    found = compare(images, reference, layer=layer)
    assert found.regions == ("whole", "layer 0", "layer 1", "layer 2")
    left = images["noisy"][:1, ..., 10:20]
    expected = metrics.smape(left, reference.mean[:1, ..., 10:20])
    assert found.value("noisy", "smape", "layer 1", view=0) == pytest.approx(float(expected), rel=1e-5)
    shown = [color.display(image, found.exposure) for image in (images["noisy"], reference.mean)]
    for name in ("ssim", "flip"):
        expected = getattr(metrics, name)(*shown, (layer == 1).float())
        assert found.value("noisy", name, "layer 1", view=0) == pytest.approx(float(expected[0]), rel=1e-5)


def test_a_layer_that_a_view_does_not_have_has_no_score_there():
    images, reference = scene()
    found = compare(images, reference, layer=layers())
    assert {(score.view, score.region) for score in found.scores} == {
        (0, "whole"), (0, "layer 0"), (0, "layer 1"), (0, "layer 2"), (1, "whole"), (1, "layer 2"),
    }  # fmt: skip
    assert not any(math.isnan(score.value) for score in found.scores)
    with pytest.raises(KeyError, match="layer 0"):
        found.value("noisy", "psnr", "layer 0", view=1)


def test_layers_shared_by_the_views_and_a_single_layer():
    images, reference = scene()
    shared = compare(images, reference, layer=layers()[:1])
    assert {(score.view, score.region) for score in shared.scores if score.region != "whole"} == {
        (view, f"layer {number}") for view in range(2) for number in range(3)
    }
    assert compare(images, reference, layer=torch.zeros(2, 1, 24, 30)).regions == ("whole",)


def test_noise_of_the_reference_is_subtracted_unless_asked_not_to():
    images, reference = scene()
    with_noise = compare(images, reference, subtract_noise=False)
    without = compare(images, reference)
    assert (without.noise_subtracted, with_noise.noise_subtracted) == (True, False)
    assert without.reference_noise == with_noise.reference_noise == pytest.approx(0.1)
    for view in range(2):
        difference = (
            with_noise.value("filtered", "rmse_linear", view=view) ** 2
            - without.value("filtered", "rmse_linear", view=view) ** 2
        )
        assert difference == pytest.approx(0.01, rel=1e-3)
    for metric in ("rmse", "psnr", "ssim", "flip", "smape"):
        assert without.value("filtered", metric) == with_noise.value("filtered", metric)


def test_reference_may_be_a_tensor():
    images, reference = scene()
    found = compare(images, reference.mean)
    assert found.reference_noise is None
    assert not found.noise_subtracted
    assert found.scores == compare(images, Reference(reference.mean, 0 * reference.variance, 1)).scores


def test_exposure_may_be_given():
    images, reference = scene()
    found = compare(images, reference, exposure=0.25)
    assert found.exposure == 0.25
    shown = [color.display(image, 0.25) for image in (images["noisy"], reference.mean)]
    assert found.value("noisy", "psnr", view=1) == pytest.approx(float(metrics.psnr(*shown)[1]), rel=1e-6)


def test_pixels_per_degree_may_be_given():
    images, reference = scene()
    found = compare(images, reference, pixels_per_degree=9.0)
    shown = [color.display(image, found.exposure) for image in (images["noisy"], reference.mean)]
    expected = metrics.flip(*shown, pixels_per_degree=9.0)
    assert found.value("noisy", "flip", view=1) == pytest.approx(float(expected[1]), rel=1e-6)
    assert found.value("noisy", "flip") > 1.1 * compare(images, reference).value("noisy", "flip")
    assert "flip: 9 pixels per degree" in str(found)


def test_exposure_does_not_depend_on_the_images():
    images, reference = scene()
    brighter = {name: 10 * image for name, image in images.items()}
    assert compare(brighter, reference).exposure == compare(images, reference).exposure


def test_unit_of_radiance_does_not_matter_to_display_metrics():
    images, reference = scene()
    scaled = compare({name: 1000 * image for name, image in images.items()}, 1000 * reference.mean)
    for metric in ("rmse", "psnr", "ssim", "flip"):
        assert scaled.value("noisy", metric) == pytest.approx(
            compare(images, reference.mean).value("noisy", metric), rel=1e-4
        )


def test_images_with_gradients_are_read_only():
    images, reference = scene()
    image = images["noisy"].requires_grad_()
    before = image.detach().clone()
    compare({"noisy": image}, reference)
    assert torch.equal(image, before)
    assert image.grad is None


def test_csv_holds_every_score_and_its_conditions(tmp_path):
    images, reference = scene()
    found = compare(images, reference, layer=layers())
    found.to_csv(tmp_path / "metrics.csv")
    with (tmp_path / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.scores) == 2 * 7 * (4 + 2)
    for row in rows:
        value = found.value(row["method"], row["metric"], row["region"], int(row["view"]))
        assert float(row["value"]) == value
        assert row["pixels_per_degree"] == (str(found.pixels_per_degree) if row["metric"] == "flip" else "")
        if row["metric"] in METRICS[:4]:
            assert (row["encoding"], float(row["exposure"]), float(row["peak"])) == ("srgb", found.exposure, 1.0)
            assert row["noise_subtracted"] == ""
        else:
            assert (row["encoding"], row["exposure"], row["peak"]) == ("linear", "", "")
            assert row["noise_subtracted"] == ("" if row["metric"] == "smape" else "true")


def test_printed_table_is_aligned_and_states_its_conditions():
    images, reference = scene()
    found = compare(images, reference, layer=layers())
    lines = str(found).splitlines()
    table, notes = lines[: 1 + 4 * 2], " ".join(lines[1 + 4 * 2 :])
    assert table[0].split() == ["region", "method", *METRICS]
    assert len({len(line) for line in table}) == 1
    assert f"{found.value('filtered', 'psnr', 'layer 2'):.2f}" in table[-1]
    assert [line[:8].strip() for line in table[1:]] == ["whole", "", "layer 0", "", "layer 1", "", "layer 2", ""]
    for words in (
        "Mean of 2 views",
        f"exposure {found.exposure:.4g}",
        "sRGB",
        "peak 1",
        "67.02 pixels per degree",
        "subtracted from",
    ):
        assert words in notes
    assert "left in" in str(compare(images, reference, subtract_noise=False))


def test_printed_table_shows_what_is_missing():
    scores = compare({"a": torch.ones(1, 3, 16, 16)}, torch.ones(1, 3, 16, 16)).scores
    other = [score for score in scores if score.metric != "ssim"]
    partial = Comparison((*other, scores[2]._replace(method="b")), exposure=1.0)
    rows = [line.split() for line in str(partial).splitlines()]
    assert rows[2][1:] == ["-"] * 6 + ["1.0000"]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_images_that_are_not_finite_are_named(bad):
    images, reference = scene()
    images["filtered"][1, 0, 2, 3] = bad
    with pytest.raises(ValueError, match=r"images\['filtered'\]: expected finite values.*\(1, 0, 2, 3\)"):
        compare(images, reference)
    broken = reference.mean.clone()
    broken[0, 0, 0, 0] = bad
    with pytest.raises(ValueError, match="reference: expected finite"):
        compare(scene()[0], broken)


def test_arguments_that_do_not_fit():
    images, reference = scene()
    with pytest.raises(ValueError, match="at least one image"):
        compare({}, reference)
    with pytest.raises(ShapeError, match=r"images\['small'\]"):
        compare({"small": images["noisy"][:1]}, reference)
    with pytest.raises(ShapeError, match="layer"):
        compare(images, reference, layer=torch.zeros(3, 1, 24, 30))
    with pytest.raises(ShapeError, match="layer"):
        compare(images, reference, layer=torch.zeros(2, 1, 24, 29))
    with pytest.raises(ValueError, match="exposure"):
        compare(images, reference, exposure=0)
