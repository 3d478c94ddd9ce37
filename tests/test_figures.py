"""Figures are drawn from the saved files alone, in panels of equal size, with circles where the layers are."""

import shutil
from dataclasses import replace

import pytest
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.text import Text
from PIL import Image
from png_chunks import chunks

from fovden.colormap import NO_VALUE
from fovden.comparison import METHODS, CompareSettings, SceneSettings, compare_denoisers, read_comparison
from fovden.figures import METHOD_STYLES, PRINT_WIDTH, comparison, draw_figures
from fovden.figures.scores import STAGES
from fovden.results import read_metrics

NAMES = ["overview", "methods_left", "methods_right", "details_left", "details_right", "scores"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files that figures may read, and no others."""
    made, copy = (tmp_path_factory.mktemp(name) for name in ("made", "copy"))
    view = SceneSettings("cornell_box", resolution=(40, 36))
    gaze = ((12.0, 30.0), (8.0, 30.0))
    compare_denoisers(CompareSettings(view, reference_spp=4, gaze=gaze, repeats=1), made, progress=False)
    for name in ("frames", "images"):
        shutil.copytree(made / name, copy / name)
    for name in ("config.json", "metrics.csv", "provenance.json", "reference.exr"):
        shutil.copy(made / name, copy / name)
    return copy


@pytest.fixture(scope="module")
def drawn(folder):
    """The figures, caught when they are saved, by name."""
    caught = []
    save = Figure.savefig

    def savefig(figure, path, **options):
        caught.append(figure)
        save(figure, path, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", savefig)
        paths = draw_figures(folder)
    return {path.stem: (path, figure) for path, figure in zip(paths, caught, strict=True)}


def test_every_figure_is_a_picture(drawn, folder):
    assert list(drawn) == NAMES
    for path, _ in drawn.values():
        with Image.open(path) as picture:
            assert min(picture.size) > 400
            assert picture.getextrema()[0][0] < picture.getextrema()[0][1]
    assert sorted(entry.name for entry in (folder / "figures").iterdir()) == sorted(f"{name}.png" for name in NAMES)


@pytest.mark.parametrize("name", ["overview", "methods_left", "methods_right", "details_left"])
def test_panels_are_of_equal_size_and_apart_and_inside(drawn, name):
    _, figure = drawn[name]
    boxes = [panel.get_position() for panel in figure.axes if panel.images]
    assert len(boxes) >= 8
    assert len({(round(box.width, 6), round(box.height, 6)) for box in boxes}) == 1
    assert all(box.x0 >= 0 and box.y0 >= 0 and box.x1 <= 1 and box.y1 <= 1 for box in boxes)
    for number, box in enumerate(boxes):
        assert not any(box.shrunk(0.99, 0.99).overlaps(other) for other in boxes[number + 1 :])


def test_the_exposure_and_the_scale_of_the_errors_are_stated(drawn, folder):
    exposure = next(row.value for row in read_metrics(folder) if row.metric == "exposure")
    for name in NAMES:
        _, figure = drawn[name]
        assert any(f"exposure {exposure:.3g}" in text.get_text() for text in figure.texts)
    for name in ("overview", "methods_left", "methods_right"):
        _, figure = drawn[name]
        labels = [label for panel in figure.axes for label in (panel.get_xlabel(), panel.get_ylabel())]
        assert any(label.startswith("error: RMS over R, G, B") for label in labels)
    for path, _ in drawn.values():
        texts = dict(content.split(b"\0") for kind, content in chunks(path.read_bytes()) if kind == "tEXt")
        assert texts == {b"Software": b"fovden", b"Exposure": repr(exposure).encode()}


@pytest.mark.parametrize("name", NAMES)
def test_text_is_legible_at_the_printed_width(drawn, name):
    _, figure = drawn[name]
    assert figure.get_figwidth() <= PRINT_WIDTH + 1e-6
    texts = [text for text in figure.findobj(Text) if text.get_text()]
    assert len(texts) > 8
    assert min(text.get_fontsize() for text in texts) >= 6


@pytest.mark.parametrize("name", ["overview", "methods_left", "details_right", "scores"])
def test_a_method_has_its_mark_wherever_it_is_named(drawn, name):
    _, figure = drawn[name]
    marks = {(text.get_text(), text.get_color()) for text in figure.findobj(Text)}
    shown = ["Noisy, foveated", "NH3LD"] if name == "overview" else [method.name for method in METHODS]
    for method in shown:
        assert (METHOD_STYLES[method].glyph, METHOD_STYLES[method].colour) in marks


def test_scores_have_units_and_the_values_of_the_table(drawn, folder):
    _, figure = drawn["scores"]
    rows = read_metrics(folder)
    drawn_metrics = [metric for metric in ("psnr", "ssim", "flip") if any(row.metric == metric for row in rows)]
    *qualities, time = figure.axes
    labels = [panel.get_xlabel().split("\n") for panel in figure.axes]
    expected = {"psnr": ["PSNR / dB", "higher is better"], "ssim": ["SSIM", "higher is better"]}
    expected["flip"] = ["FLIP", "lower is better"]
    assert labels == [*(expected[metric] for metric in drawn_metrics), ["time / s", "both eyes"]]
    for panel, metric in zip(qualities, drawn_metrics, strict=True):
        for method in METHODS:
            values = [
                row.value for row in rows if (row.method, row.metric, row.region) == (method.name, metric, "whole")
            ]
            assert len(values) == 2
            style = METHOD_STYLES[method.name]
            marks = [
                line for line in panel.lines if (line.get_marker(), line.get_color()) == (style.marker, style.colour)
            ]
            assert [line.get_xdata()[0] for line in marks] == [pytest.approx(sum(values) / 2)]
    stages = ("seconds_gbuffer", "seconds_paths", "seconds_denoise")
    totals = {m.name: sum(row.value for row in rows if row.method == m.name and row.metric in stages) for m in METHODS}
    ends = [bar.get_x() + bar.get_width() for bar in time.patches]
    assert ends[2::3] == [pytest.approx(totals[method.name]) for method in METHODS]
    for _, hatch in STAGES.values():
        assert sum(bar.get_hatch() == hatch for bar in time.patches) == len(METHODS)


def test_the_same_data_draw_the_same_files(drawn, folder):
    for name in ("overview", "scores"):
        path, _ = drawn[name]
        first = path.read_bytes()
        path.unlink()
        assert draw_figures(folder, only=[name]) == [path]
        assert path.read_bytes() == first
    with pytest.raises(ValueError, match=r"only: expected names among overview, .*, scores, got 'score'"):
        draw_figures(folder, only=["score"])


def test_black_and_broken_images_are_drawn_as_what_they_are(folder, tmp_path, monkeypatch):
    saved = read_comparison(folder)
    values = {"Noisy, foveated": 0.0, "NH3LD": float("nan"), "Base": float("inf")}
    images = {name: torch.full_like(image, values.get(name, 0.5)) for name, image in saved.images.items()}
    others = [row for row in saved.measurements if row.metric != "flip"]
    flip = [row._replace(metric="flip") for row in others if row.metric == "ssim"]
    broken = {"psnr": float("inf"), "ssim": float("nan")}  # inf: equal to the reference
    rows = [row._replace(value=broken.get(row.metric, row.value)) for row in [*others, *flip]]
    changed = replace(saved, images=images, measurements=rows)
    caught = {}
    monkeypatch.setattr(comparison, "read_comparison", lambda _: changed)
    monkeypatch.setattr(comparison, "save_figure", lambda figure, path, _: caught.update({path.stem: figure}))
    draw_figures(tmp_path)
    assert list(caught) == NAMES
    assert [panel.get_xlabel() for panel in caught["scores"].axes][2] == "FLIP\nlower is better"
    noisy, denoised = (panel.images[0].get_array() for panel in caught["overview"].axes[:2])
    assert (noisy == 0).all()
    assert (denoised == NO_VALUE).all()
    error = next(panel for panel in caught["overview"].axes if "mean error nan" in panel.get_xlabel()).images[0]
    assert error.get_array().mask.all()
    assert [round(255 * level) for level in error.cmap.get_bad()[:3]] == list(NO_VALUE)
    for name in ("overview", "scores"):
        caught[name].savefig(tmp_path / f"{name}.png", dpi=40)


def test_circles_and_gaze_lie_where_the_layers_are(drawn, folder):
    _, figure = drawn["overview"]
    radii = sorted({row.value for row in read_metrics(folder) if row.metric == "radius"})
    assert radii == [5.0, 10.0]  # floor(sqrt(36 * 40 / 50)) and twice that
    noisy = [panel for panel in figure.axes if panel.patches and panel.images]
    assert len(noisy) == 2
    for panel, x in zip(noisy, (12.0, 8.0), strict=True):
        circles = [patch for patch in panel.patches if isinstance(patch, Circle)]
        assert sorted({circle.radius for circle in circles}) == radii
        # the first pixel's centre is 0 to matplotlib and (0.5, 0.5) in a raster
        assert {circle.center for circle in circles} == {(x - 0.5, 29.5)}
        assert all(tuple(line.get_xydata()[0]) == (x - 0.5, 29.5) for line in panel.lines)


def test_a_folder_without_results_is_one_error(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match="expected the folder of a finished run"):
        draw_figures(tmp_path)
    for name in ("metrics.csv", "reference.exr"):
        shutil.copy(folder / name, tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"full\.exr: no such file"):
        draw_figures(tmp_path)
