"""Pictures on disk: which eye is where, and what the file says about its colours."""

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
from png_chunks import chunks

from fovden import color
from fovden.io import save_png

VIEWS = torch.rand(2, 3, 5, 4, generator=torch.Generator().manual_seed(0))
LEFT, RIGHT = (np.floor(view.permute(1, 2, 0).double().numpy() * 255 + 0.5).astype(np.uint8) for view in VIEWS)


@pytest.mark.parametrize(
    ("layout", "eyes"),
    [
        ({}, [LEFT, RIGHT]),
        ({"layout": "side-by-side"}, [LEFT, RIGHT]),
        ({"layout": "cross-eyed"}, [RIGHT, LEFT]),
        ({"layout": "left"}, [LEFT]),
        ({"layout": "right"}, [RIGHT]),
    ],
)
def test_each_layout_has_its_eyes_in_their_places(tmp_path, layout, eyes):
    save_png(tmp_path / "a.png", VIEWS, **layout)
    assert np.array_equal(imageio.imread(tmp_path / "a.png"), np.concatenate(eyes, axis=1))


def test_a_file_states_its_colours_and_its_exposure_and_changes_no_value(tmp_path):
    exposure = 1 / 3
    radiance = torch.full((1, 3, 2, 2), 0.54)  # 0.18 at this exposure, whose sRGB code is 118
    save_png(tmp_path / "a.png", color.display(radiance, exposure), exposure=exposure)
    assert (imageio.imread(tmp_path / "a.png") == 118).all()
    found = chunks((tmp_path / "a.png").read_bytes())
    names = [name for name, _ in found]
    assert sorted(set(names)) == ["IDAT", "IEND", "IHDR", "gAMA", "sRGB", "tEXt"]
    assert max(names.index("sRGB"), names.index("gAMA")) < names.index("IDAT")
    assert dict(found)["sRGB"] in (b"\0", b"\1", b"\2", b"\3")
    assert int.from_bytes(dict(found)["gAMA"], "big") == 45455
    texts = dict(content.decode("latin-1").split("\0") for name, content in found if name == "tEXt")
    assert texts["Software"] == "fovden"
    assert float(texts["Exposure"]) == exposure
    save_png(tmp_path / "b.png", VIEWS)
    assert b"Exposure" not in (tmp_path / "b.png").read_bytes()


def test_a_layout_that_does_not_fit_is_refused(tmp_path):
    path = tmp_path / "a.png"
    with pytest.raises(ValueError, match=r"layout: expected one of .*'cross-eyed'.*, got 'over-under'"):
        save_png(path, VIEWS, layout="over-under")
    for layout in ("cross-eyed", "left", "right"):
        for views in (VIEWS[:1], torch.cat([VIEWS, VIEWS])):
            with pytest.raises(ValueError, match=f"image: expected two views for the layout '{layout}', got"):
                save_png(path, views, layout=layout)
    with pytest.raises(ValueError, match="exposure: expected a finite number, above 0"):
        save_png(path, VIEWS, exposure=0)
    with pytest.raises(ValueError, match="image: expected at least one pixel"):
        save_png(path, VIEWS[..., :0])
    assert not list(tmp_path.iterdir())
