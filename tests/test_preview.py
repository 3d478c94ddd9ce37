"""Previews: levels and thumbnails by slow loops, PNG bytes by another reader, cards whole whatever is in a record."""

import base64
import io
import math
import re
from html.parser import HTMLParser
from itertools import pairwise

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
from png_chunks import chunks

from fovden import color
from fovden.camera import Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.colormap import NO_VALUE
from fovden.foveation import SampleMap, ThreeLayer, sample_map
from fovden.frame import Frame, GBuffer, Reference
from fovden.preview import (
    THUMBNAIL,
    Picture,
    card,
    encode_png,
    finite_exposure,
    never_raising,
    ramp,
    shades,
    show,
    shrink,
    to_levels,
)

NAN, INF = float("nan"), float("inf")
LARGEST = 150_000  # bytes of a card


def noise(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def frame_of(radiance: torch.Tensor) -> Frame:
    views, _, height, width = radiance.shape
    scalar = noise(views, 1, height, width, seed=1)
    prim = torch.randint(-1, 9, scalar.shape, generator=torch.Generator().manual_seed(2))
    motion = torch.zeros(views, 2, height, width)
    gbuffer = GBuffer(radiance.clamp(0, 1), radiance, radiance, scalar, scalar, motion, prim, motion)
    counts, layer = (4 * scalar).round(), (2 * scalar).round().int()
    gaze = Gaze(torch.full((views, 2), 1.5)) if views else None
    return Frame(radiance, 0 * radiance, 0 * radiance, counts, scalar, layer, gbuffer, gaze=gaze, seed=7)


class Tree(HTMLParser):
    """Reads a page strictly: every element that is opened is closed, in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open, self.images, self.cells, self.names = [], [], [], set()
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.names |= {tag, *(name for name, _ in attributes)}
        if tag == "img":
            self.images.append(dict(attributes))
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1] in {"th", "td"}:
            self.cells.append(data)

    @property
    def rows(self) -> dict[str, str]:
        return dict(zip(self.cells[::2], self.cells[1::2], strict=True))

    def picture(self, number: int) -> np.ndarray:
        kind, data = self.images[number]["src"].split(",")
        assert kind == "data:image/png;base64"
        return imageio.imread(io.BytesIO(base64.b64decode(data)), mode="RGB")


def test_levels_are_the_nearest_and_signal_what_is_not_finite():
    image = noise(2, 3, 4, 5) * 1.2 - 0.1
    image[1, 2, 3, 4], image[0, 0, 0, 0] = NAN, INF
    levels = to_levels(image)
    assert levels.shape == (4, 10, 3)
    for view in range(2):
        for y in range(4):
            for x in range(5):
                values = image[view, :, y, x].tolist()
                expected = [min(max(math.floor(255 * value + 0.5), 0), 255) for value in values if math.isfinite(value)]
                assert levels[y, 5 * view + x].tolist() == (expected if len(expected) == 3 else list(NO_VALUE))


def test_shrinking_takes_means_and_keeps_one_broken_value_in_sight():
    image = noise(2, 3, 6, 12)
    expected = image.numpy().astype(np.float64).reshape(2, 3, 2, 3, 4, 3).mean((3, 5))
    assert np.allclose(shrink(image, 4).numpy(), expected, atol=1e-12)
    assert torch.equal(shrink(image, 12), image.double())
    image[1, 0, 5, 11] = NAN
    broken = ~torch.isfinite(shrink(image, 4))
    assert broken.nonzero().tolist() == [[1, 0, 1, 3]]
    assert shrink(torch.zeros(1, 1, 3, 2000), 100).shape == (1, 1, 1, 100)


def test_the_exposure_is_that_of_what_is_finite():
    radiance = noise(2, 3, 4, 4) + 0.1
    part = radiance.clone()
    part[1, :, 2:], radiance[1, :, 2:] = 0, torch.tensor([NAN, INF]).repeat(3, 2, 2)
    assert finite_exposure(radiance) == pytest.approx(color.exposure(part), rel=1e-6)
    assert finite_exposure(torch.full((1, 3, 2, 2), NAN)) == 1


def test_a_display_shows_what_color_says():
    radiance = noise(1, 3, 3, 3) * 4
    assert torch.equal(show(radiance, 0.7, None), to_levels(color.display(radiance.double(), 0.7)))


def test_ramps_and_shades():
    assert ramp(torch.tensor([[[[2.0, 3.0, 4.0]]]]), 2, 4)[0, :, 0].tolist() == [0, 128, 255]
    assert ramp(torch.ones(1, 1, 1, 1), 1, 1).unique().tolist() == [0]
    lightness = shades(torch.arange(4).reshape(1, 1, 1, 4))[0, :, 1].tolist()
    assert lightness[0] == 255
    assert all(above - below >= 60 for above, below in pairwise(lightness))


def test_a_png_says_what_it_is_and_has_the_same_levels_for_another_reader():
    levels = to_levels(noise(1, 3, 7, 9))
    data = encode_png(levels, exposure=0.1)
    assert np.array_equal(imageio.imread(io.BytesIO(data)), levels.numpy())
    found = chunks(data)
    names = [name for name, _ in found]
    assert names[0] == "IHDR"
    assert names[-1] == "IEND"
    first_data = names.index("IDAT")
    assert (found[0][1][8], found[0][1][9]) == (8, 2)  # bits per channel, RGB
    assert dict(found[:first_data])["sRGB"] == b"\x01"
    assert int.from_bytes(dict(found[:first_data])["gAMA"], "big") == round(1e5 / 2.2)
    texts = dict(content.split(b"\0") for name, content in found if name == "tEXt")
    assert texts == {b"Software": b"fovden", b"Exposure": b"0.1"}
    assert not any(b"Exposure" in content for _, content in chunks(encode_png(levels)))


def test_a_small_png_keeps_to_a_byte_per_pixel_its_colours_and_the_signal():
    image = noise(1, 3, 120, 120)
    image[0, :, 17, 31] = NAN
    levels = to_levels(image)
    data = encode_png(levels, small=True)
    assert len(data) < 120 * 120 + 2000 < len(encode_png(levels))
    read = imageio.imread(io.BytesIO(data), mode="RGB").astype(float)
    assert np.abs(read - levels.numpy()).mean() < 20  # 255 colours over the cube lie about 40 levels apart
    assert np.argwhere((read == NO_VALUE).all(-1)).tolist() == [[17, 31]]
    few = to_levels(image.round(decimals=0))
    assert np.array_equal(imageio.imread(io.BytesIO(encode_png(few, small=True)), mode="RGB"), few.numpy())


def test_what_is_no_picture_is_refused():
    with pytest.raises(ValueError, match=r"levels: expected torch\.uint8"):
        encode_png(torch.zeros(2, 2, 3))
    with pytest.raises(ValueError, match="levels: expected at least one pixel"):
        encode_png(torch.zeros(0, 2, 3, dtype=torch.uint8))
    with pytest.raises(ShapeError, match="image: expected shape"):
        to_levels(torch.zeros(3, 2, 2))


def test_a_card_is_a_whole_piece_of_html_with_every_text_escaped():
    nasty = "<script>alert(\"x\")</script> & 'quotes'"
    tree = Tree(card(nasty, [Picture(to_levels(noise(1, 3, 8, 8)), nasty)], {nasty: nasty}))
    assert tree.rows == {nasty: nasty}
    assert tree.images[0]["alt"] == nasty
    assert tree.images[0]["width"] == str(8 * (THUMBNAIL // 8))
    assert "script" not in tree.names


def records() -> dict[str, object]:
    frame = frame_of(noise(2, 3, THUMBNAIL, THUMBNAIL))
    camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(216, 192))
    return {
        "Frame": frame,
        "GBuffer": frame.gbuffer,
        "Reference": Reference(frame.direct, frame.direct / 9, 4),
        "SampleMap": sample_map(ThreeLayer(), camera, Gaze(torch.tensor([[90.0, 100], [80, 100]])), per_eye=True),
    }


@pytest.mark.parametrize("name", records())
def test_records_show_small_cards_that_fit_any_theme(name):
    page = records()[name]._repr_html_()
    tree = Tree(page)
    assert len(page) < LARGEST
    assert len(tree.images) >= 2
    assert not re.search(r"https?:|javascript:|(?<!-)color:(?!inherit)|background:(?!none)", page)
    for number, image in enumerate(tree.images):
        picture = tree.picture(number)
        assert 0 < picture.shape[0] <= THUMBNAIL
        assert picture.shape[1] <= 2 * THUMBNAIL
        assert picture.min() < picture.max(), image["alt"]


def test_a_frame_states_its_exposure_counts_and_origin():
    frame = frame_of(noise(2, 3, 12, 16))
    tree = Tree(frame._repr_html_())
    exposure = finite_exposure(frame.radiance)
    assert tree.images[0]["alt"] == f"left eye, exposure {exposure:.3g}, sRGB"
    assert np.array_equal(tree.picture(1), show(frame.radiance[1:], exposure).numpy())
    assert tree.rows["views"] == "2 of 16 x 12 pixels, float32 on cpu"
    assert tree.rows["samples"].startswith(f"{frame.counts.mean():.3f} per pixel")
    assert tree.rows["gaze"] == "(1.5, 1.5), (1.5, 1.5) pixels"
    assert "seed 7" in tree.rows["frame"]
    shares = frame.layer.flatten().bincount() / frame.layer.numel()
    assert tree.rows["layers"] == ", ".join(f"{number}: {share:.1%}" for number, share in enumerate(shares))


def test_a_sample_map_states_both_budgets():
    samples = SampleMap.from_counts(torch.tensor([[[[4, 0, 2]]]]), Gaze(torch.zeros(2, 2)), expected=11.4)
    tree = Tree(samples._repr_html_())
    assert tree.rows["paths"] == "12; expected 11"
    assert tree.picture(0)[0, :, 0].tolist() == [255, 0, 128]


@pytest.mark.parametrize("value", [0.0, NAN, INF, -INF, -1.0, 1e38, 1e-45])
def test_no_values_break_a_card(value):
    frame = frame_of(torch.full((2, 3, 4, 6), value))
    for record in (frame, frame.gbuffer, Reference(frame.direct, frame.direct, 1)):
        page = record._repr_html_()
        tree = Tree(page)
        assert len(tree.images) >= 2
        assert ("not finite" in tree.rows) != math.isfinite(value)
        if not math.isfinite(value) and not isinstance(record, GBuffer):
            assert (tree.picture(0) == NO_VALUE).all()


@pytest.mark.parametrize("shape", [(2, 3, 0, 4), (0, 3, 4, 4), (1, 3, 1, 1), (5, 3, 2, 400)])
def test_no_size_breaks_a_card(shape):
    frame = frame_of(torch.ones(shape))
    counts = torch.zeros(1, 1, shape[2], shape[3], dtype=torch.int32)
    for record in (frame, frame.gbuffer, SampleMap.from_counts(counts, Gaze(torch.zeros(2, 2)))):
        assert Tree(record._repr_html_()).rows["views"]


def test_types_and_gradients_do_not_matter_and_what_is_broken_shows_nothing():
    frame = frame_of(noise(1, 3, 4, 4))
    for changed in (frame.to(torch.float16), frame.to(torch.float64), frame_of(noise(1, 3, 4, 4).requires_grad_())):
        assert len(Tree(changed._repr_html_()).images) == 3
    object.__setattr__(frame.gbuffer, "albedo", None)
    assert frame.gbuffer._repr_html_() is None
    with pytest.raises(RuntimeError, match="on purpose"):
        never_raising(fail).__wrapped__(None)
    assert never_raising(fail)(None) is None


def fail(_: object) -> str:
    raise RuntimeError("on purpose")
