"""Scrambled Sobol points: even in every elementary interval, uniform, different everywhere, and better in pictures."""

import numba
import numpy as np
import pytest
import torch
from builders import GREY, Mesh, rounded, scene_of, sphere
from builders import box as box_mesh
from scipy import stats
from scipy.stats import qmc
from significance import assert_counts, assert_same_mean, sidak

from fovden.camera import Gaze, StereoCamera
from fovden.foveation import SampleMap
from fovden.rng import Stream, uniform
from fovden.tracer import EnvironmentLight, Integrator, PointLight, accumulate_reference, trace_frame
from fovden.tracer import reference as reference_module
from fovden.tracer.kernels.draws import INDEPENDENT, SOBOL, draw
from fovden.tracer.kernels.sobol import permuted, reversed_bits, reversed_sums

PATH = int(Stream.PATH)


@numba.njit
def fill(sampler, addresses, out):
    for i in range(len(addresses)):
        a = addresses[i]
        x, y, z, w = draw(sampler, a[0], a[1], a[2], a[3], a[4], a[5])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = x, y, z, w


def drawn(*, sampler=SOBOL, seed=0, stream=PATH, pixel=0, view=0, sample=0, block=0):
    """Numbers of the addresses, which broadcast; shape (..., 4)."""
    words = np.broadcast_arrays(seed, stream, pixel, view, sample, block)
    addresses = np.stack([np.asarray(word, dtype=np.int64).ravel() for word in words], 1)
    out = np.empty((len(addresses), 4), dtype=np.float32)
    fill(sampler, addresses, out)
    return out.reshape(*words[0].shape, 4)


# The sequence


@numba.njit
def unscrambled(count, sums, out):
    for i in range(count):
        for dimension in range(4):
            x = np.uint32(0)
            for nibble in range(8):
                x ^= sums[nibble, (i >> (4 * nibble)) & 15, dimension]
            out[i, dimension] = reversed_bits(x)


def test_the_table_holds_the_sequence_of_scipy():
    """The same set of points: SciPy orders them by Gray code, which permutes each power of two."""
    words = np.empty((1024, 4), dtype=np.uint32)
    unscrambled(1024, reversed_sums(), words)
    ours = words / 2.0**32
    theirs = qmc.Sobol(4, scramble=False, bits=32).random(1024)
    gray = np.arange(1024) ^ (np.arange(1024) >> 1)
    np.testing.assert_array_equal(ours[gray], theirs)


@numba.njit
def scramble(words, seed, out):
    for i in range(len(words)):
        out[i] = reversed_bits(permuted(reversed_bits(words[i]), seed))


@pytest.mark.parametrize("seed", [0, 1, 0xDEADBEEF, 0xFFFFFFFF])
def test_scrambling_is_a_nested_permutation(seed):
    """Words that share their first k bits keep sharing exactly them: every stratum goes to a stratum, whole."""
    random = np.random.default_rng(1)
    words = random.integers(0, 2**32, 2000, dtype=np.uint32)
    lengths = random.integers(0, 32, 2000)
    others = words ^ (np.uint32(1) << (31 - lengths).astype(np.uint32))  # the first bit to differ follows `length`
    low = (np.uint64(1) << (31 - lengths).astype(np.uint64)) - np.uint64(1)
    others = others ^ (random.integers(0, 2**32, 2000, dtype=np.uint64) & low).astype(np.uint32)
    first, second = np.empty_like(words), np.empty_like(words)
    scramble(words, np.uint32(seed), first)
    scramble(others, np.uint32(seed), second)
    different = (first ^ second).astype(np.uint64)
    assert (different >> (32 - lengths).astype(np.uint64) == 0).all()
    assert ((different >> (31 - lengths).astype(np.uint64)) & np.uint64(1) == 1).all()


# Strata


def cells(points, bits):
    """Number of the elementary interval of 2^-bits in each dimension that a point lies in."""
    number = np.zeros(len(points), dtype=np.int64)
    for column, places in zip(points.T.astype(np.float64), bits, strict=True):
        number = number << places | (column * 2**places).astype(np.int64)
    return number


@pytest.mark.parametrize("start", [0, 3])
@pytest.mark.parametrize("order", [1, 4, 7, 10])
def test_each_elementary_interval_holds_one_point(order, start):
    """Powers of two of samples, aligned to themselves: every dimension alone, and the second with the third in all
    shapes of intervals ((0, 2)-sequence)."""
    count = 1 << order
    for pixel in (0, 1, 12345):
        for block in (0, 1, 6):
            points = drawn(pixel=pixel, block=block, sample=start * count + np.arange(count))
            for dimension in range(4):
                assert len(np.unique(cells(points[:, [dimension]], [order]))) == count
            for places in range(order + 1):
                assert len(np.unique(cells(points[:, 1:3], [places, order - places]))) == count


def test_independent_numbers_leave_intervals_empty():
    points = drawn(sampler=INDEPENDENT, sample=np.arange(1024))
    assert len(np.unique(cells(points[:, [1]], [10]))) < 700  # 1024 (1 - 1 / e) = 647


def test_four_dimensions_are_even_together():
    """The quality parameter of the first four dimensions is t = 0 + 0 + 1 + 2 (Joe and Kuo's polynomials have degrees
    up to 3): with 2^10 points every interval of volume 2^(3 - 10) holds 2^3."""
    points = drawn(pixel=9, sample=np.arange(1024))
    for bits in ((1, 2, 2, 2), (2, 2, 1, 2), (0, 3, 3, 1), (4, 1, 1, 1), (1, 1, 1, 4)):
        counts = np.bincount(cells(points, bits), minlength=128)
        assert (counts == 8).all(), bits


# Uniformity and independence


def test_uniform_along_every_part_of_the_address():
    """Kolmogorov-Smirnov: over pixels, views, seeds, streams and blocks the numbers are random; over samples, even."""
    along = np.arange(20_000)
    places = {
        "pixel": drawn(pixel=along),
        "pixel, later sample": drawn(pixel=along, sample=777),
        "view": drawn(view=along),
        "seed": drawn(seed=along),
        "stream": drawn(stream=along),
        "block": drawn(block=along),
    }
    for name, numbers in places.items():
        assert numbers.min() >= 0
        assert numbers.max() < 1
        for dimension in range(4):
            chance = stats.kstest(numbers[:, dimension], "uniform").pvalue
            assert chance > sidak(4 * len(places)), (name, dimension)
    even = drawn(sample=np.arange(1 << 14))
    assert max(stats.kstest(even[:, dimension], "uniform").statistic for dimension in range(4)) <= 2**-14


def test_no_correlation_between_addresses():
    """Of the means of two even sets of 16: their order, their pixels, blocks, views, streams and seeds all differ."""
    along, samples = np.arange(20_000)[:, None], np.arange(16)
    first = drawn(pixel=along, sample=samples)
    others = {
        "next pixel": drawn(pixel=along + 1, sample=samples),
        "row below": drawn(pixel=along + 960, sample=samples),
        "view": drawn(pixel=along, view=1, sample=samples),
        "block": drawn(pixel=along, block=1, sample=samples),
        "seed": drawn(seed=1, pixel=along, sample=samples),
        "stream": drawn(stream=PATH + 1, pixel=along, sample=samples),
    }
    comparisons = 16 * len(others)
    for name, other in others.items():
        for a in range(4):
            for b in range(4):
                # Of the same sample: what a path combines; 20 000 pixels of 16 samples each, whose sums are even.
                product = ((first[..., a] - 0.5) * (other[..., b] - 0.5)).mean(1)
                z = product.mean() / (product.std(ddof=1) / np.sqrt(len(product)))
                assert abs(z) < stats.norm.isf(sidak(comparisons) / 2), (name, a, b)


def test_the_order_differs_between_blocks():
    """Samples 0 and 1 lie in different halves; 2 lies with either, in each block by a toss of its own. In the
    sequence's own order it would lie with 0 in every block, and a path's dimensions would depend on each other."""
    pixels = np.arange(10_000)[:, None]
    halves = [drawn(pixel=pixels, block=block, sample=np.arange(4))[..., 1] < 0.5 for block in (0, 1)]
    together = [half[:, 0] == half[:, 2] for half in halves]
    for half in halves:
        assert (half[:, 0] != half[:, 1]).all()
    assert_counts(np.bincount(2 * together[0] + together[1], minlength=4), np.full(4, 0.25))


def test_independent_numbers_are_those_of_the_generator():
    pixel, block = np.arange(500)[:, None], np.arange(8)
    ours = drawn(sampler=INDEPENDENT, seed=7, pixel=pixel, view=1, sample=5, block=block)
    dimension = 4 * torch.arange(8)[:, None] + torch.arange(4)
    theirs = uniform(7, Stream.PATH, torch.arange(500)[:, None, None], view=1, sample=5, dimension=dimension)
    assert torch.equal(torch.from_numpy(ours), theirs)


# Pictures

CAMERA = StereoCamera.look_at((0.2, 0.1, 1.8), (0.0, -0.2, 0.0), fov_y_deg=70, resolution=(12, 16))
EVEN = Integrator(sampler="sobol")


@pytest.fixture(scope="module")
def scene():
    """A ball in an open room under a sky and a lamp."""
    walls, room = box_mesh((1, 1, 1), (4.0, 3.0, 4.0))
    points, ball = sphere(2)
    mesh: Mesh = (
        torch.cat([rounded(walls), rounded(points, 0.5)]),
        torch.cat([room[:-2], ball + len(walls)]),
    )
    return scene_of(mesh, GREY, lights=(PointLight((0.5, 1.0, 1.0), 3.0), EnvironmentLight(0.7)))


def test_means_agree_and_the_error_falls_faster(scene):
    frames = {
        sampler: torch.stack([
            trace_frame(scene, CAMERA, 64, seed=seed, integrator=Integrator(sampler=sampler)).radiance
            for seed in range(40)
        ])
        for sampler in ("independent", "sobol")
    }  # fmt: skip
    means = {sampler: batch.mean((2, 3, 4)).double().numpy() for sampler, batch in frames.items()}
    assert_same_mean(means["sobol"], means["independent"])
    spread = {sampler: float(batch.var(0).mean()) for sampler, batch in frames.items()}
    # Both are known to some 2 %: 768 pixels of 40 frames, each with a relative standard error of sqrt(2 / 39).
    assert spread["sobol"] < 0.6 * spread["independent"]


def test_everything_depends_on_the_seed_and_nothing_on_threads(scene):
    counts = torch.randint(0, 5, (2, 1, 12, 16), dtype=torch.int32, generator=torch.Generator().manual_seed(1))
    samples = SampleMap.from_counts(counts, Gaze.center(CAMERA))
    before = torch.get_num_threads()
    try:
        frames = []
        for threads in (1, 3):
            torch.set_num_threads(threads)
            frames.append(trace_frame(scene, CAMERA, samples, seed=3, integrator=EVEN))
    finally:
        torch.set_num_threads(before)
    for name in ("direct", "indirect", "luminance_squared"):
        assert torch.equal(getattr(frames[0], name), getattr(frames[1], name))
    other = trace_frame(scene, CAMERA, samples, seed=4, integrator=EVEN)
    lit = (frames[0].radiance > 0) & (other.radiance > 0)
    assert lit.float().mean() > 0.3
    assert (frames[0].radiance != other.radiance)[lit].float().mean() > 0.6, "the lamp alone gives the same value"


def test_a_pixel_with_fewer_samples_has_the_first_of_them(scene):
    few, many = (trace_frame(scene, CAMERA, count, seed=2, integrator=EVEN) for count in (1, 3))
    mask = torch.rand(2, 1, 12, 16, generator=torch.Generator().manual_seed(2)) < 0.5
    mixed = SampleMap.from_counts(torch.where(mask, 1, 3).int(), Gaze.center(CAMERA))
    frame = trace_frame(scene, CAMERA, mixed, seed=2, integrator=EVEN)
    assert torch.equal(frame.direct, torch.where(mixed.counts == 1, few.direct, many.direct))


@pytest.mark.parametrize("jitter", [False, True])
def test_references_continue_the_sequence(scene, jitter, tmp_path, monkeypatch):
    def reference(spp, **options):
        options |= {"jitter": jitter, "integrator": EVEN, "progress": None}
        return accumulate_reference(scene, CAMERA, spp=spp, seed=1, **options)

    expected = reference(16)
    monkeypatch.setattr(reference_module, "SECONDS_PER_PASS", 0.0)  # a sample each
    assert torch.equal(reference(16).mean, expected.mean)
    reference(5, checkpoint=tmp_path / "sums")
    assert torch.equal(reference(16, checkpoint=tmp_path / "sums").mean, expected.mean)
    frame = trace_frame(scene, CAMERA, 16, seed=1, integrator=EVEN)
    assert not torch.equal(frame.radiance, expected.mean), "another stream"
