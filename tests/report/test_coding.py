"""What is written can be read by a decoder that knows nothing but the description, and is as close as that says."""

import math
import zlib

import numpy as np
import pytest
import torch
from slow_decoder import bytes_of, codes_of, map_of, radiance_of

from fovden import color
from fovden.checks import ShapeError
from fovden.report.coding import KNEE, STEPS, encode_image, encode_map, encode_text, image_codes

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
    data = encode_image(image, knee)
    assert np.array_equal(codes_of(data, SHAPE), image_codes(image, knee))
    values = radiance_of(data, SHAPE, knee, STEPS)
    expected = image.double().numpy()
    assert (np.abs(values - expected) <= BOUND * (np.abs(expected) + knee) * (1 + 1e-12)).all()
    assert np.array_equal(values == 0, expected == 0)
    assert zlib.decompress(data)[0] == predictor


def test_the_bound_is_reached_and_is_what_the_page_says():
    between = torch.tensor(2 ** (10.5 / STEPS) - 1 - 1e-6, dtype=torch.float64).expand(1, 3, 1, 1)  # halfway, knee 1
    value = radiance_of(encode_image(between, 1.0), (1, 3, 1, 1), 1.0, STEPS)
    assert np.abs(value - float(between[0, 0])).max() == pytest.approx(
        BOUND * (float(between[0, 0, 0, 0]) + 1), rel=0.02
    )
    assert pytest.approx(0.0087, abs=5e-5) == BOUND


def test_what_is_no_number_and_what_has_no_end_stays_so():
    odd = torch.tensor([math.nan, math.inf, -math.inf, -1.0, 3.4e38, 1e-45, 0.0, -0.0, 1.0]).reshape(1, 3, 1, 3)
    for knee in (1e-12, 1.0, 1e12):
        values = radiance_of(encode_image(odd, knee), (1, 3, 1, 3), knee, STEPS).ravel()
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


@pytest.mark.parametrize("size", range(9))
def test_text_holds_any_bytes(size):
    data = bytes((37 * size + 91 * index) % 256 for index in range(size))
    for content in (data, bytes(size), b"\xff" * size):
        text = encode_text(content)
        assert bytes_of(text) == content
        assert all("#" <= letter <= "x" and letter != "<" for letter in text[1:])


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
    needed = bits / 8 * 5 / 4  # five letters for four bytes
    assert len(encode_text(encode_image(image, KNEE))) < 1.05 * needed


def test_shapes_and_numbers_are_checked():
    with pytest.raises(ShapeError, match="radiance: expected shape"):
        encode_image(torch.zeros(2, 4, 4), 1.0)
    with pytest.raises(ValueError, match="knee: expected a finite number, above 0"):
        encode_image(torch.zeros(1, 3, 4, 4), 0.0)
    with pytest.raises(ShapeError, match="values: expected shape"):
        encode_map(torch.zeros(1, 3, 4, 4))
