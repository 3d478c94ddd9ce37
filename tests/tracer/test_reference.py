"""References and frames as estimates: their means, variances and random numbers; and references that are cut short."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from scipy import stats
from shapes import box, matt, pixels, rectangle, scene_of, sphere, view
from significance import LEVEL, assert_mean, assert_same_mean

import fovden.tracer.reference as module
from fovden.camera import Gaze
from fovden.foveation.sample_map import SampleMap
from fovden.tracer import (
    CheckpointError,
    DirectionalLight,
    EnvironmentLight,
    Integrator,
    Material,
    PointLight,
    accumulate_reference,
    trace_frame,
)

ROOT = Path(__file__).resolve().parents[2]


def noisy_scene():
    """A room that is open to the front, with a ball in it and light of every kind."""
    lamp = rectangle((-0.4, 1.9, -0.4), (0.8, 0, 0), (0, 0, 0.8))
    texture = torch.arange(48, dtype=torch.uint8).reshape(4, 4, 3) * 5
    ball = sphere(1) * 0.4 + torch.tensor([0.3, -0.6, 0.2])
    sides = box((-1, -1, -1), (1, 2, 1), inwards=True)
    room = torch.cat([sides[:8], sides[10:]])
    parts = [(room, Material("room", (0.8, 0.7, 0.6), texture=texture)), (lamp, matt(0, (3, 4, 5))), (ball, matt(0.5))]
    lights = [PointLight((0.5, 1, 0.9), 0.7), DirectionalLight((0.1, -0.3, -1), 0.5), EnvironmentLight((0.3, 0.2, 0.1))]
    corners = 3 * sum(len(part) for part, _ in parts)
    uv = torch.rand(corners, 2, generator=torch.Generator().manual_seed(2))
    return scene_of(parts, lights, uv=uv, name="noisy")


def camera_of(size=8):
    return view((0, 0.5, 4), (0, 0.4, 0), size=size, fov=50)


@pytest.fixture(scope="module")
def scene():
    return noisy_scene()


def reference_of(scene, spp, **settings):
    settings.setdefault("camera", camera_of())
    return accumulate_reference(scene, settings.pop("camera"), spp=spp, progress=None, **settings)


def same_bits(a, b):
    return torch.equal(a.mean, b.mean) and torch.equal(a.variance, b.variance) and a.count == b.count


def luminance(image):
    """Rec. 709 luminance of an image (v, 3, h, w), float64, shape (v, 1, h, w)."""
    weights = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    return (image.double() * weights[:, None, None]).sum(1, keepdim=True)


# Frames as estimates


def test_squared_luminance_is_that_of_every_single_sample(scene):
    """Frames of one seed share their first samples, so the k-th is k mean_k - (k - 1) mean_{k - 1}."""
    camera, count = camera_of(), 5
    means = [torch.zeros(())] + [trace_frame(scene, camera, k, seed=3).radiance for k in range(1, count + 1)]
    squares = 0
    for k in range(1, count + 1):
        squares = squares + luminance(k * means[k].double() - (k - 1) * means[k - 1].double()) ** 2
        measured = trace_frame(scene, camera, k, seed=3).luminance_squared
        torch.testing.assert_close(measured.double(), squares / k, rtol=1e-5, atol=1e-6)
    differ = squares / count > 1.01 * luminance(means[count]) ** 2
    assert differ.float().mean() > 0.3


def test_squared_luminance_tells_the_variance_of_the_mean(scene):
    """(E[l^2] - E[l]^2) / (n - 1) is an unbiased estimate of a frame's variance: compared with the scatter of frames.

    The ratio of the two is taken for each pixel; pixels are independent, so their scatter gives the tolerance.
    """
    camera, spp, count = camera_of(), 64, 200
    frames = [trace_frame(scene, camera, spp, seed=seed) for seed in range(count)]
    means = torch.stack([luminance(frame.radiance) for frame in frames])
    told = torch.stack([(f.luminance_squared.double() - luminance(f.radiance) ** 2) / (spp - 1) for f in frames])
    noisy = means.var(0) > 1e-9
    assert noisy.float().mean() > 0.5
    ratio = means.var(0)[noisy] / told.mean(0)[noisy]
    assert_mean(ratio[:, None], 1)
    assert ratio.mean() == pytest.approx(1, abs=0.1)


def test_pixels_without_samples_hold_nothing(scene):
    camera = camera_of(24)
    full = trace_frame(scene, camera, 4, seed=2)
    shining = full.emission.amax(1, keepdim=True) > 0
    where = (torch.arange(24 * 24).reshape(1, 1, 24, 24) % 3 == 0).expand(2, -1, -1, -1)
    counts = torch.where(where, 4, 0)
    chosen = SampleMap.from_counts(counts, Gaze.center(camera))
    frame = trace_frame(scene, camera, chosen, seed=2)
    assert torch.equal(frame.counts, counts.int())
    for name in ("direct", "indirect", "emission", "luminance_squared"):
        assert torch.equal(getattr(frame, name), torch.where(where, getattr(full, name), 0)), name
    assert (shining & ~where).any(), "some of the lamp is masked"
    assert torch.equal(frame.gbuffer.albedo, full.gbuffer.albedo), "the geometry is complete"


# References as estimates


@pytest.mark.parametrize("lights", ["uniform", "power"])
def test_references_and_frames_have_one_mean(scene, lights):
    frames = [pixels(trace_frame(scene, camera_of(), 32, seed=seed).radiance) for seed in range(32)]
    references = [
        pixels(reference_of(scene, 32, seed=seed, integrator=Integrator(lights=lights)).mean) for seed in range(32)
    ]
    assert_same_mean(np.concatenate(frames), np.concatenate(references))


def test_the_variance_of_two_samples_is_that_of_the_formula(scene):
    """The second sample is 2 mean_2 - mean_1; the variance of the mean of x and y is (x - y)^2 / 4."""
    one, two = reference_of(scene, 1), reference_of(scene, 2)
    assert (one.variance == 0).all()
    first, second = one.mean.double(), 2 * two.mean.double() - one.mean.double()
    torch.testing.assert_close(two.variance.double(), (first - second) ** 2 / 4, rtol=1e-4, atol=1e-6)


def test_the_variance_is_what_independent_references_scatter_by(scene):
    """(a - b)^2 and the sum of the two variances have one mean, whatever the samples' distribution.

    Their difference is taken in units of the pixel's mean variance and averaged over the pixels of each of 40 pairs,
    whose scatter gives the tolerance.
    """
    references = [reference_of(scene, 128, seed=seed) for seed in range(80)]
    mean, variance = (torch.stack([getattr(r, name) for r in references]).double() for name in ("mean", "variance"))
    noisy = variance.mean(0) > 1e-9
    assert noisy.float().mean() > 0.5
    excess = (mean[::2] - mean[1::2]) ** 2 - variance[::2] - variance[1::2]
    relative = (excess / (2 * variance.mean(0)))[:, noisy].mean(1)
    assert_mean(relative[:, None], 0)
    assert relative.mean() == pytest.approx(0, abs=0.1)


def test_standard_errors_fall_with_the_root_of_the_samples(scene):
    few, many = reference_of(scene, 256), reference_of(scene, 4096)
    assert few.standard_error.mean() / many.standard_error.mean() == pytest.approx(4, rel=0.05)


def test_a_reference_shares_no_random_numbers_with_the_frame_of_its_seed(scene):
    """Nor do the two views, or two seeds: the noise of single samples, in units of its standard deviation, is
    uncorrelated over 64 x 64 pixels. A frame of two samples contains the first, which shows."""
    camera, spp = camera_of(64), 512
    settled = reference_of(scene, spp, camera=camera, seed=99, integrator=Integrator(lights="uniform"))
    deviation = luminance((settled.variance * spp).sqrt()).clamp_min(1e-3)

    def noise(image):
        return ((luminance(image) - luminance(settled.mean)) / deviation).clamp(-3, 3).numpy()

    def correlation(first, second):
        return np.corrcoef(first.ravel(), second.ravel())[0, 1]

    frame = noise(trace_frame(scene, camera, 1, seed=7).radiance)
    reference = noise(reference_of(scene, 1, camera=camera, seed=7, integrator=Integrator(lights="uniform")).mean)
    bound = stats.norm.isf(LEVEL / 2) / 64  # for the 4096 pixels of one view
    assert correlation(frame, noise(trace_frame(scene, camera, 2, seed=7).radiance)) > 0.5
    assert abs(correlation(frame[0], reference[0])) < bound
    assert abs(correlation(frame[0], frame[1])) < bound
    assert abs(correlation(frame[0], noise(trace_frame(scene, camera, 1, seed=8).radiance)[0])) < bound


def test_antialiased_references_average_over_the_pixel():
    """A white square that covers the left 5.25 columns of 8: 5 full, one a quarter."""
    square = rectangle((-4, -9, 0), (5.25, 0, 0), (0, 18, 0))
    scene = scene_of([(square, matt(0, 1))])
    camera = view((0, 0, 4), (0, 0, 0), fov=90)
    assert (reference_of(scene, 4, camera=camera).mean[0, 0, 0] == torch.tensor([1.0] * 5 + [0] * 3)).all()
    reference = reference_of(scene, 256, camera=camera, jitter=True)
    columns = reference.mean[:, 0].mean((0, 1))
    assert columns[:5].tolist() == [1] * 5
    assert columns[6:].tolist() == [0] * 2
    # 16 pixels of 256 samples: a standard deviation of sqrt(0.25 * 0.75 / 4096) = 0.68 %
    assert columns[5] == pytest.approx(0.25, abs=4 * 0.0068)


# Interrupted and continued


@pytest.fixture
def hasty(monkeypatch):
    """Passes of one sample, each with its checkpoint."""
    monkeypatch.setattr(module, "SECONDS_PER_PASS", 1e-9)


def samples_in(path):
    with safe_open(path, framework="pt") as file:
        return int(file.metadata()["count"])


@pytest.mark.parametrize("jitter", [False, True])
def test_sums_do_not_depend_on_the_passes(scene, monkeypatch, jitter):
    straight = reference_of(scene, 23, jitter=jitter)
    monkeypatch.setattr(module, "SECONDS_PER_PASS", 1e-9)
    assert same_bits(reference_of(scene, 23, jitter=jitter), straight)


@pytest.mark.parametrize("jitter", [False, True])
def test_a_reference_can_be_continued_beyond_its_first_goal(scene, tmp_path, jitter):
    path = tmp_path / "sums.safetensors"
    early = reference_of(scene, 16, checkpoint=path, jitter=jitter)
    assert same_bits(early, reference_of(scene, 16, jitter=jitter))
    assert samples_in(path) == 16
    assert same_bits(reference_of(scene, 64, checkpoint=path, jitter=jitter), reference_of(scene, 64, jitter=jitter))
    assert samples_in(path) == 64
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_a_finished_checkpoint_is_returned_at_once(scene, tmp_path, monkeypatch):
    path = tmp_path / "sums"
    straight = reference_of(scene, 8, checkpoint=path)
    monkeypatch.setattr(module.parallel, "run", lambda *_, **__: pytest.fail("nothing is left to trace"))
    assert same_bits(reference_of(scene, 8, checkpoint=str(path)), straight)


def test_lights_may_be_chosen_otherwise_when_continuing(scene, tmp_path):
    path = tmp_path / "sums"
    reference_of(scene, 8, checkpoint=path, integrator=Integrator(lights="uniform"))
    assert reference_of(scene, 16, checkpoint=path, integrator=Integrator(lights="power")).count == 16


@pytest.mark.usefixtures("hasty")
def test_an_interrupted_run_keeps_its_checkpoint_and_continues_to_the_same_bits(scene, tmp_path):
    path, calls = tmp_path / "sums", []

    def interrupt(done):
        calls.append(done)
        if done >= 20 * 128:  # 20 samples of 2 x 8 x 8 pixels
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        accumulate_reference(scene, camera_of(), spp=40, checkpoint=path, progress=interrupt)
    assert calls == sorted(calls)
    assert 0 < samples_in(path) < 40
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert same_bits(reference_of(scene, 40, checkpoint=path), reference_of(scene, 40))


def test_an_interruption_within_a_pass_leaves_the_checkpoint_of_the_one_before(scene, tmp_path, monkeypatch):
    path, saved = tmp_path / "sums", []

    def interrupt(_):
        raise KeyboardInterrupt

    write = module._save
    monkeypatch.setattr(module, "_save", lambda where, *rest: (write(where, *rest), saved.append(where.read_bytes())))
    with pytest.raises(KeyboardInterrupt):
        accumulate_reference(scene, camera_of(), spp=10**6, checkpoint=path, progress=interrupt)
    assert path.read_bytes() == saved[-1]
    count = samples_in(path) + 5
    monkeypatch.undo()
    assert same_bits(reference_of(scene, count, checkpoint=path), reference_of(scene, count))


ENDLESS = """
import sys
import fovden.tracer.reference as module
from fovden.camera import Gaze
from fovden.foveation.sample_map import SampleMap
from test_reference import camera_of, noisy_scene

module.SECONDS_PER_PASS = 0.001
module.accumulate_reference(noisy_scene(), camera_of(), spp=10**7, checkpoint=sys.argv[1], progress=None)
"""


def test_a_killed_run_continues_to_the_same_bits(scene, tmp_path):
    """SIGKILL while checkpoints follow each other; whenever one is looked at before, it is whole."""
    path = tmp_path / "sums"
    folders = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "tracer")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    process = subprocess.Popen([sys.executable, "-c", ENDLESS, str(path)], env=environment, stderr=subprocess.PIPE)
    try:
        seen, limit = [], time.monotonic() + 120
        while len(set(seen)) < 20:
            assert process.poll() is None, process.stderr.read().decode()
            assert time.monotonic() < limit, "no checkpoints"
            if path.exists():
                seen.append(samples_in(path))
            time.sleep(0.01)
    finally:
        process.kill()
        process.communicate()
    assert seen == sorted(seen)
    goal = samples_in(path) + 16
    assert same_bits(reference_of(scene, goal, checkpoint=path), reference_of(scene, goal))


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_a_checkpoint_that_cannot_be_written_leaves_the_last_one(scene, tmp_path, monkeypatch, error):
    path = tmp_path / "sums"
    reference_of(scene, 4, checkpoint=path)
    before = path.read_bytes()

    def fail(_tensors, file, **_):
        Path(file).write_bytes(before[: len(before) // 2])
        raise error

    monkeypatch.setattr(module, "save_file", fail)
    with pytest.raises(type(error)):
        reference_of(scene, 8, checkpoint=path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def other(scene, name):
    """The arguments of a reference that differs in one thing."""
    camera = camera_of()
    if name == "vertex":
        vertices = scene.vertices.clone()
        vertices[-1, 0] += 1e-4
        return replace(scene, vertices=vertices), {}
    if name == "albedo":
        return replace(scene, materials=replace(scene.materials, albedo=scene.materials.albedo * 0.99)), {}
    if name == "texture":
        texture = scene.materials.textures[0].clone()
        texture[0, 0, 0] += 1
        return replace(scene, materials=replace(scene.materials, textures=(texture,))), {}
    if name == "texture coordinates":
        return replace(scene, uv=scene.uv + 0.01), {}
    if name == "normals":
        return replace(scene, normals=scene.normals + torch.tensor([0, 1.0, 0])), {}
    if name == "light":
        return scene.with_lights([*scene.lights[:-1], EnvironmentLight((0.3, 0.2, 0.11))]), {}
    if name == "sky image":
        return scene.with_lights([*scene.lights[:-1], EnvironmentLight(torch.ones(3, 2, 4))]), {}
    settings = {
        "eye": {"camera": replace(camera, eye=(0, 0.5, 3.9))},
        "field of view": {"camera": replace(camera, fov_y_deg=51)},
        "resolution": {"camera": camera.at((8, 9))},
        "seed": {"seed": 1},
        "jitter": {"jitter": True},
    }
    return scene, settings[name]


@pytest.mark.parametrize(
    "name",
    [
        "vertex",
        "albedo",
        "texture",
        "texture coordinates",
        "normals",
        "light",
        "sky image",
        "eye",
        "field of view",
        "resolution",
        "seed",
        "jitter",
    ],
)
def test_a_checkpoint_of_something_else_is_refused_and_left_alone(scene, tmp_path, name):
    path = tmp_path / "sums"
    reference_of(scene, 2, checkpoint=path)
    before = path.read_bytes()
    changed, settings = other(scene, name)
    with pytest.raises(CheckpointError, match=r"another scene, camera, seed or setting"):
        reference_of(changed, 4, checkpoint=path, **settings)
    assert path.read_bytes() == before


@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.999])
def test_a_truncated_checkpoint_is_refused_and_left_alone(scene, tmp_path, kept):
    path = tmp_path / "sums"
    reference_of(scene, 2, checkpoint=path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * kept)])
    with pytest.raises(CheckpointError, match=str(path)):
        reference_of(scene, 4, checkpoint=path)
    assert path.read_bytes() == whole[: int(len(whole) * kept)]


def test_files_that_are_no_checkpoints_are_refused(scene, tmp_path):
    module.save_file({"total": torch.zeros(1)}, tmp_path / "other")
    (tmp_path / "text").write_text("not a checkpoint")
    (tmp_path / "folder").mkdir()
    for name in ("other", "text", "folder"):
        with pytest.raises(CheckpointError, match=name):
            reference_of(scene, 4, checkpoint=tmp_path / name)


def test_samples_cannot_be_taken_out(scene, tmp_path):
    path = tmp_path / "sums"
    reference_of(scene, 8, checkpoint=path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"spp.*8 samples"):
        reference_of(scene, 7, checkpoint=path)
    assert path.read_bytes() == before


def test_a_missing_folder_is_noticed_before_the_work(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(module.parallel, "run", lambda *_, **__: pytest.fail("traced first"))
    with pytest.raises(FileNotFoundError, match="missing"):
        reference_of(scene, 8, checkpoint=tmp_path / "missing" / "sums")


@pytest.mark.parametrize(("spp", "seed", "error"), [(0, 0, ValueError), (1.5, 0, TypeError), (1, -1, ValueError)])
def test_bad_numbers_are_refused(scene, spp, seed, error):
    with pytest.raises(error, match="spp" if seed == 0 else "seed"):
        reference_of(scene, spp, seed=seed)


def test_a_scene_without_light_has_no_reference():
    dark = scene_of([(rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0)), matt(1))], name="dark")
    with pytest.raises(ValueError, match=r"dark.*light"):
        reference_of(dark, 1)
