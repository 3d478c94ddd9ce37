"""Random numbers: the authors' vectors, the same bits in both forms, and chi-square tests of uniformity."""

import numba
import numpy as np
import pytest
import torch
from scipy import stats

from fovden.rng import Stream, _philox_tensors, philox, uniform

# Published with Random123 (file kat_vectors, philox 4x32, 10 rounds): counter, key, output.
VECTORS = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]
NUMBERS = 100_000
LEVEL = 1e-4
"""Probability that any of one test's statistics fails by chance."""


def to_unit(word: int) -> float:
    return (word >> 8) * 2.0**-24


def assert_uniform(samples: dict[str, np.ndarray], bins: int) -> None:
    """Chi-square tests of points in the unit cube, with Sidak's correction for their number."""
    threshold = 1 - (1 - LEVEL) ** (1 / len(samples))
    for name, sample in samples.items():
        points = sample.astype(np.float64).reshape(len(sample), -1)
        cells = np.ravel_multi_index((points * bins).astype(int).T, (bins,) * points.shape[1])
        counts = np.bincount(cells, minlength=bins ** points.shape[1])
        assert counts.mean() >= 50, "too few points for the chi-square approximation"
        assert stats.chisquare(counts).pvalue > threshold, name


@pytest.mark.parametrize(("counter", "key", "expected"), VECTORS)
def test_tensor_form_gives_the_published_vectors(counter, key, expected):
    words = _philox_tensors(tuple(torch.tensor([word]) for word in counter), key)
    assert tuple(int(word) for word in words) == expected


@pytest.mark.parametrize(("counter", "key", "expected"), VECTORS)
def test_kernel_form_gives_the_published_vectors(counter, key, expected):
    pixel, view, sample, block = counter
    assert philox(*key, pixel, view, sample, block) == tuple(map(to_unit, expected))


@numba.njit
def fill(seed, stream, addresses, out):
    for i in range(len(addresses)):
        a = addresses[i]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = philox(seed, stream, a[0], a[1], a[2], a[3])


def test_both_forms_give_the_same_bits():
    generator = torch.Generator().manual_seed(0)
    addresses = torch.randint(0, 2**30, (5000, 4), generator=generator)
    addresses[:1000, :3] *= 4  # the upper half of the words' range, where a signed product would differ
    for seed, stream in ((0, Stream.PATH), (2**32 - 1, Stream.FILTER)):
        kernel = np.empty((len(addresses), 4), dtype=np.float32)
        fill(seed, int(stream), addresses.numpy(), kernel)
        pixel, view, sample, block = addresses.T[..., None]
        tensor = uniform(seed, stream, pixel, view=view, sample=sample, dimension=4 * block + torch.arange(4))
        assert torch.equal(tensor, torch.from_numpy(kernel))


def test_floats_are_24_bits_below_one():
    numbers = uniform(1, Stream.PATH, torch.arange(NUMBERS))
    assert numbers.dtype == torch.float32
    scaled = numbers.double() * 2**24
    assert torch.equal(scaled, scaled.round())
    assert 0 <= numbers.min() < 1e-4
    assert 1 - 1e-4 < numbers.max() < 1


def test_uniform_in_one_dimension_along_every_part_of_the_address():
    along = torch.arange(NUMBERS)
    samples = {
        "pixel": uniform(3, Stream.PATH, along),
        "view": uniform(3, Stream.PATH, 0, view=along),
        "sample": uniform(3, Stream.PATH, 17, sample=along),
        "dimension": uniform(3, Stream.PATH, 17, dimension=along),
        "seed": torch.cat([uniform(seed, Stream.MASK, torch.arange(100)) for seed in range(1000)]),
    }
    for stream in Stream:
        samples[stream.name] = uniform(0, stream, along)
    assert_uniform({name: tensor.numpy() for name, tensor in samples.items()}, bins=256)


def test_uniform_in_two_dimensions_between_neighbouring_addresses():
    along = torch.arange(NUMBERS)
    first = uniform(5, Stream.PATH, along)
    pairs = {
        "pixels": first.reshape(-1, 2),
        "rows": torch.stack([first, uniform(5, Stream.PATH, along + 960)], 1),
        "views": torch.stack([first, uniform(5, Stream.PATH, along, view=1)], 1),
        "samples": torch.stack([first, uniform(5, Stream.PATH, along, sample=1)], 1),
        "seeds": torch.stack([first, uniform(6, Stream.PATH, along)], 1),
        "pixel and sample swapped": torch.stack([first, uniform(5, Stream.PATH, 0, sample=along)], 1),
    }
    for dimension in range(8):
        both = [uniform(5, Stream.PATH, along, dimension=d) for d in (dimension, dimension + 1)]
        pairs[f"dimensions {dimension} and {dimension + 1}"] = torch.stack(both, 1)
    for stream in set(Stream) - {Stream.PATH}:
        pairs[f"streams PATH and {stream.name}"] = torch.stack([first, uniform(5, stream, along)], 1)
    assert_uniform({name: tensor.numpy() for name, tensor in pairs.items()}, bins=16)


def test_streams_views_samples_and_seeds_share_no_block_of_numbers():
    """Four 24-bit words coincide by chance with probability 2^-96, at whatever address."""
    pixel, word = torch.arange(20_000)[:, None], torch.arange(4)
    blocks = [uniform(9, stream, pixel, dimension=word) for stream in Stream]
    blocks += [uniform(9, Stream.PATH, pixel, view=1, dimension=word)]
    blocks += [uniform(9, Stream.PATH, pixel, sample=1, dimension=word)]
    blocks += [uniform(9, Stream.PATH, pixel, dimension=4 + word)]
    blocks += [uniform(10, Stream.PATH, pixel, dimension=word)]
    rows = torch.cat(blocks)
    assert torch.unique(rows, dim=0).shape == rows.shape


def test_a_number_depends_on_its_address_alone():
    pixel = torch.arange(60).reshape(3, 1, 20)
    view = torch.arange(2)[:, None]
    together = uniform(4, Stream.JITTER, pixel, view=view, sample=3, dimension=5)
    assert together.shape == (3, 2, 20)
    for place in ((0, 0, 0), (2, 1, 19), (1, 0, 7)):
        alone = uniform(4, Stream.JITTER, int(pixel[place[0], 0, place[2]]), view=place[1], sample=3, dimension=5)
        assert alone.shape == ()
        assert alone == together[place]
    backwards = uniform(4, Stream.JITTER, pixel.flip(2), view=view, sample=3, dimension=5)
    assert torch.equal(backwards.flip(2), together)


def test_no_address_is_no_number():
    assert uniform(0, Stream.MASK, torch.empty(0, dtype=torch.int64)).shape == (0,)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seed_out_of_range(seed):
    with pytest.raises(ValueError, match="seed"):
        uniform(seed, Stream.MASK, 0)


@pytest.mark.parametrize("name", ["view", "sample", "dimension"])
@pytest.mark.parametrize("value", [-1, 2**32])
def test_address_out_of_range(name, value):
    with pytest.raises(ValueError, match=name):
        uniform(0, Stream.MASK, 0, **{name: value})


@pytest.mark.parametrize("pixel", [torch.tensor([0.5]), torch.tensor([True]), 1.5])
def test_address_of_another_type(pixel):
    with pytest.raises(TypeError, match="pixel: expected integers"):
        uniform(0, Stream.MASK, pixel)
