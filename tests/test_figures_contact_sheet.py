"""Contact sheets: one exposure for all, every name on them, nothing hidden."""

import io

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
from png_chunks import chunks

from fovden import color
from fovden.checks import ShapeError
from fovden.colormap import NO_VALUE
from fovden.figures import contact_sheet

NAN, INF = float("nan"), float("inf")


def noise(seed: int, views: int = 2) -> torch.Tensor:
    return torch.rand(views, 3, 10, 8, generator=torch.Generator().manual_seed(seed)) + seed


def pictures(sheet) -> list[np.ndarray]:
    return [np.asarray(panel.images[0].get_array()) for panel in sheet.figure.axes if panel.images]


def texts(sheet) -> list[str]:
    found = [text.get_text() for text in sheet.figure.texts]
    for panel in sheet.figure.axes:
        found += [*(text.get_text() for text in panel.texts), panel.get_xlabel()]
    return found


@pytest.mark.parametrize("views", [1, 2, 3])
def test_all_images_are_shown_at_the_reference_s_exposure(views):
    images = {"noisy": noise(0, views), "Base": noise(1, views), "Reference": noise(2, views)}
    sheet = contact_sheet(images)
    exposure = color.exposure(images["Reference"])
    assert sheet.exposure == pytest.approx(exposure, rel=1e-6)
    for picture, image in zip(pictures(sheet), images.values(), strict=True):
        shown = np.floor(255 * color.display(image.double(), sheet.exposure).numpy() + 0.5)
        assert np.array_equal(picture, np.concatenate(list(shown.transpose(0, 2, 3, 1)), axis=1))
    assert set(images) <= set(texts(sheet))
    assert f"8 x 10 pixels, exposure {exposure:.3g}, sRGB" in texts(sheet)[0]


def test_without_a_reference_the_first_one_decides_and_a_given_exposure_always_does():
    images = {"a": noise(3), "b": noise(0)}
    assert contact_sheet(images).exposure == pytest.approx(color.exposure(images["a"]), rel=1e-6)
    assert contact_sheet({**images, "Reference": noise(1)}, 0.25).exposure == 0.25


def test_it_shows_itself_as_a_png_that_states_its_exposure():
    data = contact_sheet({"a": noise(0)}, 0.5)._repr_png_()
    assert min(imageio.imread(io.BytesIO(data)).shape[:2]) > 300
    found = chunks(data)
    assert ("tEXt", b"Exposure\x000.5") in found
    assert "sRGB" in dict(found)


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_it_is_saved_as_what_its_name_says(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    contact_sheet({"a <&>": noise(0)}).save(path)
    assert {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[ending] in path.read_bytes()[:8]
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    with pytest.raises(ValueError, match=r"path: expected a name that ends in one of \.png, \.pdf, \.svg"):
        contact_sheet({"a": noise(0)}).save(tmp_path / "a.jpg")


def test_what_is_not_finite_is_shown_and_counted():
    image = noise(0)
    image[0, 1, 2, 3], image[1, 0, 4, 5] = NAN, INF
    sheet = contact_sheet({"a": image, "black": torch.zeros(2, 3, 10, 8), "void": torch.full((2, 3, 10, 8), NAN)})
    broken, black, void = pictures(sheet)
    assert np.argwhere((broken == NO_VALUE).all(-1)).tolist() == [[2, 3], [4, 8 + 5]]
    assert (black == 0).all()
    assert (void == NO_VALUE).all()
    assert [text for text in texts(sheet) if "finite" in text] == [
        "not finite: 2 pixels, cyan",
        "not finite: 160 pixels, cyan",
    ]
    assert contact_sheet({"void": torch.full((1, 3, 4, 4), NAN)})._repr_png_()


def test_a_name_is_text_whatever_it_looks_like():
    sheet = contact_sheet({r"$\frac{$ <b>": noise(0), "": noise(1)})
    assert sheet._repr_png_()
    assert r"$\frac{$ <b>" in [text.replace("\\$", "$") for text in texts(sheet)]


def test_rows_and_columns():
    images = {str(number): noise(number) for number in range(5)}
    for columns, rows in ((1, 5), (2, 3), (9, 1), (None, 3)):
        panels = [panel.get_position() for panel in contact_sheet(images, columns=columns).figure.axes if panel.images]
        assert len({round(panel.y0, 6) for panel in panels}) == rows


def test_images_that_do_not_belong_together_are_refused():
    with pytest.raises(ShapeError, match=r"images\['b'\]: expected shape \(v=2, 3, h=10, w=8\), got \(2, 3, 10, 9\)"):
        contact_sheet({"a": noise(0), "b": torch.zeros(2, 3, 10, 9)})
    with pytest.raises(ValueError, match="images: expected at least one image"):
        contact_sheet({})
    with pytest.raises(ValueError, match="images: expected at least one pixel"):
        contact_sheet({"a": torch.zeros(2, 3, 0, 4)})
    with pytest.raises(ValueError, match="exposure: expected a finite number"):
        contact_sheet({"a": noise(0)}, 0.0)
    with pytest.raises(ValueError, match="columns: expected an integer of at least 1"):
        contact_sheet({"a": noise(0)}, columns=0)
