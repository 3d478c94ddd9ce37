"""The readings of the paper are compared at the smallest size, and the figure is drawn again from the numbers."""

import pytest

from fovden.figures import draw_readings
from fovden.figures.readings import changes_by_scene, names_of_readings
from fovden.results import Measurement, read_metrics

paper_readings = pytest.importorskip("experiments.paper_readings", reason="not a checkout")

SOME = ("F1 mask_at=center", "F8 fill_holes=False", "F9 layers=interleaved")


def test_readings_are_compared_kept_and_drawn_again(tmp_path, monkeypatch):
    monkeypatch.setattr(paper_readings, "READINGS", {name: paper_readings.READINGS[name] for name in SOME})
    settings = paper_readings.Settings(("atrium",), (32, 32), 4, steps=2, more_steps=1, evaluate_every=2)
    paper_readings.run(settings, tmp_path)
    first = (tmp_path / "readings.png").read_bytes()
    (tmp_path / "readings.png").unlink()
    assert draw_readings(tmp_path).read_bytes() == first
    rows = read_metrics(tmp_path)
    for light in ("literal", "demodulated"):
        names = names_of_readings(rows, light)
        assert list(names) == ["default", *SOME]
        assert names["default"] == ["fitted", "fitted on"]
        assert names["F1 mask_at=center"] == ["kept", "fitted"], "unsampled pixels are black"
        black = changes_by_scene(rows, f"{light}, F1 mask_at=center, kept")
        assert min(black.values()) > 0.2
        inner = changes_by_scene(rows, f"{light}, F1 mask_at=center, kept", region="layer 0")
        assert max(inner[scene] / black[scene] for scene in black) < 1, "all of the inner layer is sampled"
    kept = {path: path.read_bytes() for path in (tmp_path / "fits").rglob("checkpoint.safetensors")}
    numbers = [row for row in rows if row.metric != "seconds"]
    paper_readings.run(settings, tmp_path)
    assert [row for row in read_metrics(tmp_path) if row.metric != "seconds"] == numbers
    assert all(path.read_bytes() == content for path, content in kept.items())


@pytest.mark.parametrize("reading", paper_readings.READINGS)
def test_each_reading_is_one_option_that_is_not_the_default(reading):
    options = paper_readings.READINGS[reading]
    assert len(options) == 1
    ((name, value),) = options.items()
    assert reading.endswith(f"{name}={value}")
    usual = paper_readings.NonHomogeneousAtrous.nh3ld()
    other = paper_readings.NonHomogeneousAtrous.nh3ld(**options)
    assert repr(other) != repr(usual)


def test_changes_are_relative_for_errors_and_differences_for_others():
    rows = [
        Measurement("box", 0, "", f"literal, {name}", "whole", metric, value)
        for metric, pair in (("rmse", (0.2, 0.3)), ("psnr", (20.0, 19.0)))
        for name, value in zip(("default, fitted", "F11 seam=True, kept"), pair, strict=True)
    ]
    assert changes_by_scene(rows, "literal, F11 seam=True, kept") == {"box": pytest.approx(0.5)}
    assert changes_by_scene(rows, "literal, F11 seam=True, kept", "psnr") == {"box": pytest.approx(-1)}
    assert changes_by_scene(rows, "literal, F11 seam=True, kept", "ssim") == {}
