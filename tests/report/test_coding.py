"""What is written can be read by a decoder that knows nothing but the description, and is as close as that says."""

import math
import zlib

import numpy as np
import pytest
import torch
from slow_decoder import bytes_of, codes_of, map_of, radiance_of

from fovden import color
from fovden.checks import ShapeError
from fovden.report.coding import KNEE, STEPS, encode_image, encode_map, encode_text, image_codes, most_alike

SHAPE = (2, 3, 7, 5)
BOUND = 2 ** (1 / (2 * STEPS)) - 1


def smooth():
    x = torch.linspace(0.0, 3.0, math.prod(SHAPE)).reshape(SHAPE)
    return x.square() + 0.1


def noisy():
    generator = torch.Generator().manual_seed(3)
    return (torch.rand(SHAPE, generator=generator) > 0.5) * 3.0  # of two values, differences have more


@pytest.mark.parametrize(("image", "predictor"), [(smooth(), 1), (noisy(), 0), (-smooth(), 1)])
def test_images_come_back_within_the_stated_error(image, predictor):
    knee = 0.02
    codes = image_codes(image, knee)
    data = encode_image(codes)
    assert np.array_equal(codes_of(data, SHAPE), codes)
    values = radiance_of(codes, knee, STEPS)
    expected = image.double().numpy()
    assert (np.abs(values - expected) <= BOUND * (np.abs(expected) + knee) * (1 + 1e-12)).all()
    assert np.array_equal(values == 0, expected == 0)
    assert zlib.decompress(data)[0] == predictor


def test_the_bound_is_reached_and_is_what_the_page_says():
    between = torch.tensor(2 ** (10.5 / STEPS) - 1 - 1e-6, dtype=torch.float64).expand(1, 3, 1, 1)  # halfway, knee 1
    value = radiance_of(image_codes(between, 1.0), 1.0, STEPS)
    assert np.abs(value - float(between[0, 0])).max() == pytest.approx(
        BOUND * (float(between[0, 0, 0, 0]) + 1), rel=0.02
    )
    assert pytest.approx(0.0087, abs=5e-5) == BOUND


def test_what_is_no_number_and_what_has_no_end_stays_so():
    odd = torch.tensor([math.nan, math.inf, -math.inf, -1.0, 3.4e38, 1e-45, 0.0, -0.0, 1.0]).reshape(1, 3, 1, 3)
    for knee in (1e-12, 1.0, 1e12):
        codes = codes_of(encode_image(image_codes(odd, knee)), (1, 3, 1, 3))
        values = radiance_of(codes, knee, STEPS).ravel()
        assert math.isnan(values[0])
        assert values[1:3].tolist() == [math.inf, -math.inf]
        assert np.isfinite(values[3:]).all()
        assert abs(values[4] / 3.4e38 - 1) <= BOUND * 1.001


def test_up_to_two_stops_above_its_exposure_the_rounding_is_below_one_display_level():
    image = torch.logspace(-6, 3, 3 * 4000, base=10).reshape(1, 3, 1, -1)
    exposure = 0.7
    codes = image_codes(image, KNEE / exposure).astype(np.float64)
    back = torch.from_numpy(KNEE / exposure * (2 ** (codes / STEPS) - 1))
    for stops in (0, 1, 2):
        brighter = exposure * 2**stops
        levels = 255 * (color.display(back, brighter) - color.display(image.double(), brighter)).abs()
        assert 0.9 < levels.max() < 1  # and the steps are not needlessly fine


@pytest.mark.parametrize("predicted", [False, True])
def test_pixels_that_an_earlier_image_has_are_left_out_and_come_back(predicted):
    """Also where red - green of two large codes of either sign passes the end of 16 bits."""
    generator = torch.Generator().manual_seed(5)
    others = [noisy(), smooth() * 3e30 * torch.where(torch.rand(SHAPE, generator=generator) > 0.5, 1.0, -1.0), smooth()]
    earlier = [image_codes(image, 1e-3) for image in others]
    fresh = image_codes(smooth() + 5 if predicted else torch.rand(SHAPE, generator=generator), 1e-3)
    equal = torch.rand(2, 1, 7, 5, generator=generator).numpy() > 0.6
    codes = np.where(equal, earlier[1], fresh)
    index, copied = most_alike(codes, earlier)
    assert index == 1
    assert np.array_equal(copied, equal)
    data = encode_image(codes, copied)
    assert len(zlib.decompress(data)) == 1 + 6 * np.count_nonzero(~equal)
    assert np.array_equal(codes_of(data, SHAPE, earlier[1], copied), codes)


def test_images_that_share_little_are_like_none():
    codes = image_codes(torch.arange(1.0, 3 * 64 + 1).reshape(1, 3, 8, 8), 1.0)
    other = codes + np.int16(1)
    other[0, :, 0, :7] = codes[0, :, 0, :7]  # 7 of 64
    assert most_alike(codes, [other]) is None
    other[0, :, 0, 7] = codes[0, :, 0, 7]
    index, copied = most_alike(codes, [codes + np.int16(2), other])
    assert (index, int(copied.sum())) == (1, 8)
    assert most_alike(codes, []) is None


@pytest.mark.parametrize("size", range(9))
def test_text_holds_any_bytes(size):
    data = bytes((37 * size + 91 * index) % 256 for index in range(size))
    for content in (data, bytes(size), b"\xff" * size):
        assert bytes_of(encode_text(content)) == content


def test_text_holds_all_pairs_of_bytes_and_no_character_that_a_page_would_change():
    """A browser turns carriage returns into line feeds and ends scripts at "<"; halves of characters and 0 are lost."""
    content = np.arange(65536, dtype="<u2").tobytes()
    text = encode_text(content)
    assert bytes_of(text) == content
    assert not {0, ord("\r"), ord("<"), *range(0xD800, 0xE000)} & set(map(ord, text))
    assert text.encode("utf-16-le").decode("utf-16-le") == text
    assert len(text) == 1 + 65536 + 3 + 2048 + 1


def test_maps_are_rounded_and_clamped():
    values = torch.tensor([[0.0, 0.5, 1.0], [2.0, -1.0, math.nan]]).reshape(1, 1, 2, 3)
    assert map_of(encode_map(values, 254.0), (1, 1, 2, 3)).ravel().tolist() == [0, 127, 254, 255, 0, 0]
    ramp = torch.arange(2 * 6 * 5).reshape(2, 1, 6, 5)
    assert np.array_equal(map_of(encode_map(ramp), ramp.shape), ramp.numpy())


def test_noise_takes_what_a_code_of_bytes_without_memory_needs():
    """Light of a path tracer at few samples: exponential, with pixels that see none; nothing to predict."""
    generator = torch.Generator().manual_seed(0)
    light = torch.empty(1, 1, 256, 256).exponential_(generator=generator)
    image = light * torch.rand(1, 3, 256, 256, generator=generator).mul(0.1).add(0.4) * (light > 0.1)
    red, green, blue = image_codes(image, KNEE)[0].astype(int)
    bits = 0.0
    for plane in (green, red - green, blue - green):
        folded = np.where(plane < 0, -2 * plane - 1, 2 * plane)
        for part in (folded % 256, folded // 256):
            share = np.unique(part, return_counts=True)[1] / part.size
            bits -= part.size * float((share * np.log2(share)).sum())
    written = 2 * len(encode_text(encode_image(image_codes(image, KNEE))))
    assert written < 1.05 * (1 + 2052 / 65536) * bits / 8


def test_shapes_and_numbers_are_checked():
    with pytest.raises(ShapeError, match="radiance: expected shape"):
        image_codes(torch.zeros(2, 4, 4), 1.0)
    with pytest.raises(ValueError, match="knee: expected a finite number, above 0"):
        image_codes(torch.zeros(1, 3, 4, 4), 0.0)
    codes = image_codes(torch.zeros(1, 3, 4, 4), 1.0)
    with pytest.raises(ValueError, match=r"codes: expected shape \(v, 3, h, w\), got \(3, 4, 4\)"):
        encode_image(codes[0])
    with pytest.raises(ValueError, match=r"copied: expected shape \(1, 1, 4, 4\), got \(1, 4, 4\)"):
        encode_image(codes, np.zeros((1, 4, 4), bool))
    with pytest.raises(ShapeError, match="values: expected shape"):
        encode_map(torch.zeros(1, 3, 4, 4))
