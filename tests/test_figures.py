"""Figures are drawn from the saved files alone, in panels of equal size, with circles where the layers are."""

import shutil

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from fovden import color
from fovden.comparison import CompareSettings, SceneSettings, compare_denoisers
from fovden.figures import draw_figures, error_map
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
    for name in ("metrics.csv", "reference.exr"):
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
        assert any("error" in panel.get_ylabel() for panel in figure.axes)


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


def test_the_error_map_is_the_distance_of_display_values():
    generator = torch.Generator().manual_seed(0)
    image, reference = (torch.rand(2, 3, 5, 7, generator=generator) for _ in range(2))
    shown = [color.display(each, 0.7).numpy().astype(np.float64) for each in (image, reference)]
    expected = np.sqrt(((shown[0] - shown[1]) ** 2).sum(1, keepdims=True) / 3)
    assert np.allclose(error_map(image, reference, 0.7).numpy(), expected, atol=1e-6)


def test_a_folder_without_results_is_one_error(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match="expected the folder of a finished run"):
        draw_figures(tmp_path)
    for name in ("metrics.csv", "reference.exr"):
        shutil.copy(folder / name, tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"equal_paths\.exr: no such file"):
        draw_figures(tmp_path)
