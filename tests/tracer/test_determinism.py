"""The same bits for any number of threads, any tiles and any order of work."""

import dataclasses

import pytest
import torch
from builders import generator, lit_room, uneven_samples

from fovden.camera import StereoCamera
from fovden.foveation import SampleMap
from fovden.tracer import accumulate_reference, trace_frame, trace_gbuffer
from fovden.tracer import gbuffer as gbuffer_module
from fovden.tracer import reference as reference_module
from fovden.tracer import shading as shading_module

CAMERA = StereoCamera.look_at((0.2, 0.1, 1.8), (0.0, -0.2, 0.0), fov_y_deg=70, resolution=(24, 30))
TILES = [1, 7, 1000, 10**6]


@pytest.fixture(scope="module")
def scene():
    return lit_room()


@pytest.fixture(scope="module")
def samples():
    return uneven_samples(CAMERA)


def bits(record):
    """All tensors of a record, as integers where they are floats: -0 differs from 0 and NaN equals itself."""
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            yield from ((f"{field.name}.{name}", tensor) for name, tensor in bits(value))
        elif isinstance(value, torch.Tensor):
            whole = {torch.float32: torch.int32, torch.float64: torch.int64}.get(value.dtype, value.dtype)
            yield field.name, value.contiguous().view(whole)


def assert_same_bits(one, other):
    for (name, left), (_, right) in zip(bits(one), bits(other), strict=True):
        assert torch.equal(left, right), name


def set_tiles(monkeypatch, tile):
    for module in (gbuffer_module, shading_module, reference_module):
        monkeypatch.setattr(module, "PIXELS_PER_TILE", tile)


@pytest.fixture(scope="module")
def frame(scene, samples):
    frame = trace_frame(scene, CAMERA, samples, seed=5)
    for part in (frame.direct, frame.indirect, frame.emission, frame.luminance_squared):
        assert float((part > 0).float().mean()) > 0.005  # there is something to get wrong
    assert not torch.equal(frame.direct, trace_frame(scene, CAMERA, samples, seed=6).direct)
    return frame


@pytest.mark.parametrize("count", [1, 2, 4])
def test_frames_do_not_depend_on_the_threads(scene, samples, frame, threads, count, monkeypatch):
    set_tiles(monkeypatch, 64)  # tiles for all of them
    threads(count)
    assert_same_bits(trace_frame(scene, CAMERA, samples, seed=5), frame)


@pytest.mark.parametrize("tile", TILES)
def test_frames_do_not_depend_on_the_tiles(scene, samples, frame, tile, monkeypatch):
    set_tiles(monkeypatch, tile)
    assert_same_bits(trace_frame(scene, CAMERA, samples, seed=5), frame)
    assert_same_bits(trace_gbuffer(scene, CAMERA), frame.gbuffer)


@pytest.mark.parametrize("order", ["shuffled", "reversed", "by eye alternately"])
def test_frames_do_not_depend_on_the_order_of_the_coordinates(scene, samples, frame, order):
    count = len(samples.coords)
    if order == "shuffled":
        permutation = torch.randperm(count, generator=generator(6))
    elif order == "reversed":
        permutation = torch.arange(count).flip(0)
    else:
        permutation = torch.argsort(samples.coords[:, 1] * 30 + samples.coords[:, 2], stable=True)
    permuted = dataclasses.replace(samples, coords=samples.coords[permutation])
    assert not torch.equal(permuted.coords, samples.coords)
    assert_same_bits(trace_frame(scene, CAMERA, permuted, seed=5), frame)


def test_a_pixel_does_not_depend_on_the_others(scene, samples, frame):
    """What is not sampled elsewhere changes nothing here."""
    counts = samples.counts * (torch.rand(samples.counts.shape, generator=generator(7)) < 0.2)
    sparse = trace_frame(scene, CAMERA, SampleMap.from_counts(counts, samples.gaze), seed=5)
    kept = (counts > 0).expand_as(frame.direct)
    for name in ("direct", "indirect", "emission"):
        assert torch.equal(getattr(sparse, name)[kept], getattr(frame, name)[kept])
        assert not getattr(sparse, name)[~kept].any()
    assert_same_bits(sparse.gbuffer, frame.gbuffer)


@pytest.mark.parametrize("jitter", [False, True])
def test_references_do_not_depend_on_threads_tiles_or_passes(scene, threads, jitter, monkeypatch):
    def reference():
        return accumulate_reference(scene, CAMERA, spp=6, seed=1, jitter=jitter, progress=None)

    monkeypatch.setattr(reference_module, "SECONDS_PER_PASS", 0.0)  # a sample each
    expected = reference()
    assert float(expected.mean.mean()) > 0.01
    monkeypatch.setattr(reference_module, "SECONDS_PER_PASS", 100.0)  # all at once, after the first
    for count, tile in [(1, 10**6), (2, 64), (4, 7), (1, 1)]:
        threads(count)
        set_tiles(monkeypatch, tile)
        assert_same_bits(reference(), expected)
