"""The search for passes, layers and paths at its smallest, and what it counts as work."""

import math

import pytest
import torch
from PIL import Image

from fovden.figures import draw_front
from fovden.figures.front import TRIED, best_of, trials_by
from fovden.foveation import thinned
from fovden.frame import Frame, GBuffer
from fovden.results import read_metrics
from fovden.tuning import ImageError, pareto_front

frame_costs = pytest.importorskip("experiments.frame_costs", reason="not a checkout")
foveated_frames = pytest.importorskip("experiments.foveated_frames", reason="not a checkout")
level_choices = pytest.importorskip("experiments.level_choices", reason="not a checkout")
search_levels = pytest.importorskip("experiments.search_levels", reason="not a checkout")

Choice, Pose = level_choices.Choice, foveated_frames.Pose
SIGMAS = (32.0, 0.025, 0.01)


@pytest.fixture(scope="module")
def pose():
    return Pose("atrium", "train", 1, (48, 40), 4, None)


@pytest.mark.parametrize("choice", [level_choices.NH3LD, Choice((1, 2, 2), 0.5, 3, 0.85, 2, 1.5)])
def test_a_thinned_frame_is_the_traced_one(pose, choice):
    frame = pose.foveated(choice)
    traced = frame_costs.unlit(pose.data(choice.spp, choice.falloff(pose.resolution))[pose.index][0])
    assert torch.equal(frame.counts, traced.counts)
    assert torch.equal(frame.layer, traced.layer)
    assert torch.equal(frame.radiance * frame.mask, traced.radiance)
    denoiser = choice.denoiser(SIGMAS, demodulate=True)
    with torch.no_grad():
        images = [denoiser(each).image for each in (frame, traced)]
    torch.testing.assert_close(*images)


def test_samples_are_the_first_of_more(pose):
    """Common random numbers: the mean of two samples differs from that of one, by a half of the second."""
    one, two = (pose.foveated(level_choices.BASE._replace(spp=spp)).radiance for spp in (1, 2))
    assert bool((2 * two - one >= -1e-5 * (1 + two)).all()), "the second sample is no negative light"


def test_the_papers_falloff_is_a_choice():
    radii = level_choices.NH3LD.falloff((540, 480)).radii((540, 480))
    assert radii == (72, 144)
    distance = torch.linspace(0, 300, 200)
    paper = foveated_frames.Choice.falloff(level_choices.NH3LD, (540, 480)).rate(distance, (540, 480))
    closed_form = (1 - 0.5 * (distance - 72) / 72).clamp(0.5, 1)
    torch.testing.assert_close(paper, closed_form)
    assert bool((level_choices.BASE.falloff((540, 480)).rate(distance, (540, 480)) == 1).all())


def test_the_error_is_that_of_the_fits(pose):
    image = pose.foveated(level_choices.BASE).radiance
    plain, acuity = pose.errors(image, l2=5.0, ssim=0.05)
    error = ImageError({"l2": 5.0, "ssim": 0.05})
    assert plain == pytest.approx(float(error(image, pose.truth, pose.foveated(level_choices.BASE))), rel=1e-5)
    spoiled = image.clone()
    height, width = pose.resolution
    spoiled[..., height // 2 - 6 : height // 2 + 6, width // 2 - 6 : width // 2 + 6] *= 3
    edge = image.clone()
    edge[..., :12, :12] *= 3
    centre_ratio = pose.errors(spoiled)[1] / acuity
    assert centre_ratio > pose.errors(edge)[1] / acuity, "what is looked at weighs more"


def test_blocks_are_counted_pixel_by_pixel():
    generator = torch.Generator().manual_seed(0)
    layer = torch.randint(0, 3, (2, 1, 5, 40), generator=generator) * (torch.rand(2, 1, 5, 40) < 0.05)
    frame = Frame.from_radiance(torch.ones(2, 3, 5, 40), GBuffer.empty(2, (5, 40)), layer=layer.int())
    counted = 0
    for passes, label in ((2, 0), (3, 1), (7, 2)):
        for row in layer.reshape(-1, 40).tolist():
            for start in (0, 16, 32):
                block = row[start : start + 16]
                counted += passes * len(block) * (label in block)
    assert frame_costs.work_of(frame, (2, 3, 7), 0).filtered == counted


def test_paths_are_those_of_the_mask():
    frame = Frame.from_radiance(torch.ones(1, 3, 4, 4), GBuffer.empty(1, (4, 4)), counts=torch.full((1, 1, 4, 4), 3))
    mask = (torch.arange(16) < 5).float().reshape(1, 1, 4, 4)
    work = frame_costs.work_of(thinned(frame, mask), (1,), 0)
    assert (work.pixels, work.traced, work.paths) == (16, 5, 15)


def test_units_add_up():
    costs = frame_costs.UnitCosts(1.0, 10.0, 100.0, 1e3, 1e4)
    work = frame_costs.Work(2, 3, 4, 5, 6)
    assert costs.passes(work) == 1e3 + 5e4
    assert costs.total(work) == 2 + 30 + 400 + 1e3 + 5e4 + 6


def test_filling_is_timed_where_there_are_holes():
    counts = torch.zeros(1, 1, 32, 32)
    counts[..., 0, 0] = 1
    seconds = {}
    for name, each in (("all", torch.ones_like(counts)), ("one", counts)):
        frame = Frame.from_radiance(torch.ones(1, 3, 32, 32), GBuffer.empty(1, (32, 32)), counts=each)
        denoiser = frame_costs.watched((2, 2))
        denoiser(frame)
        seconds[name] = denoiser.seconds_filling
    assert seconds["one"] > 5 * seconds["all"] > 0


def test_settings_and_choices_are_the_same():
    choice = Choice((1, 3, 3), 0.4, 1.25, 0.15, 7, 2.5)
    assert level_choices.choice_of(level_choices.setting_of(choice)) == choice
    space = level_choices.space(6, 8)
    for setting in level_choices.drawn(space, 200):
        levels = level_choices.choice_of(setting).levels
        assert list(levels) == sorted(levels)
        assert setting["r0"] <= setting["r1"]
    grid = [level_choices.choice_of(each) for each in level_choices.grid(6, (0, 1))]
    assert len(set(grid)) == len(grid) == 2 * math.comb(6 + 2, 3)  # multisets of three out of six


def test_the_search_is_made_and_goes_on_and_is_drawn_again(tmp_path, capfd):
    assert search_levels.main(["--preset", "smoke", "-o", str(tmp_path)]) == 0
    first = (tmp_path / "front.png").read_bytes()
    (tmp_path / "front.png").unlink()
    assert draw_front(tmp_path).read_bytes() == first
    with Image.open(tmp_path / "front.png") as picture:
        assert picture.getextrema()[0][0] < picture.getextrema()[0][1]
    rows = read_metrics(tmp_path)
    tried = trials_by(rows, TRIED)
    assert {trial.setting["method"] for trial in tried} == set(TRIED)
    assert len(best_of([t for t in tried if t.setting["method"] == "grid"], "levels")) == math.comb(5 + 2, 3)
    front = {trial.setting["choice"] for trial in pareto_front(tried)}
    tested = {row.region for row in rows if row.method == "test"}
    assert {min(front, key=lambda c: next(t.cost for t in tried if t.setting["choice"] == c))} <= tested, "the cheapest"
    assert {row.metric for row in rows if row.method == "test"} >= {"rmse", "psnr", "ssim", "flip", "seconds"}
    assert max(row.value for row in rows if row.metric == "difference") < 1e-4
    capfd.readouterr()
    assert search_levels.main(["--preset", "smoke", "-o", str(tmp_path)]) == 0
    again = read_metrics(tmp_path)
    kept = ("costs", "check", *TRIED)
    assert [row for row in rows if row.method in kept] == [row for row in again if row.method in kept]
