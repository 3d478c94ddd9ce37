"""Fitting finds what is there to be found, goes on where it was interrupted, and says what is wrong."""

import itertools
import json
import math
from dataclasses import replace

import pytest
import torch
from tuning_frames import clean_image, noisy_frame

from fovden.checks import ShapeError
from fovden.filters import Atrous, Denoised, Denoiser, NonHomogeneousAtrous
from fovden.frame import Reference
from fovden.tuning import ImageError, fit, load_parameters, read_history, readable

TRUTH = {"sigma_radiance": 1.5, "sigma_normal": 0.3, "sigma_position": 0.2}


def made_with_truth(seeds):
    """Frames whose references were denoised with known widths."""
    teacher = Atrous((2, 1), **TRUTH)
    with torch.no_grad():
        return [(frame, teacher(frame).image) for frame in map(noisy_frame, seeds)]


def pairs_of(seeds):
    return [(noisy_frame(seed), clean_image()) for seed in seeds]


class Scale(Denoiser):
    """An image times a number: a fit whose course is known in closed form."""

    def __init__(self, factor=1.0):
        super().__init__()
        self.factor = torch.nn.Parameter(torch.tensor(factor))

    def forward(self, frame, history=None):
        del history
        return Denoised(frame.radiance * self.factor)


def squares(image, reference, frame):
    del frame
    return (image - reference).square().mean()


@pytest.mark.parametrize("optimizer", ["adam", "lbfgs"])
def test_known_widths_are_found(optimizer):
    denoiser = Atrous((2, 1), sigma_radiance=3.0, sigma_normal=0.2, sigma_position=0.4)
    pairs = made_with_truth(range(3))
    steps, batch = (250, 1) if optimizer == "adam" else (12, 3)
    found = fit(
        denoiser, pairs, ImageError({"l1": 1.0} if optimizer == "adam" else {"l2": 1.0}), held_out=made_with_truth([9]),
        steps=steps, batch_size=batch, optimizer=optimizer, progress=None,
    )  # fmt: skip
    assert found.best.held_out_loss < found.history[0].held_out_loss / 20
    for name, width in TRUTH.items():
        assert readable(denoiser)[f"edge_stopping.{name}"] == pytest.approx(width, rel=0.05)


def test_the_least_loss_is_that_of_a_search_over_a_grid():
    pairs, error = pairs_of(range(2)), ImageError({"smape": 1.0})
    grid = [0.25 * 2 ** (step / 2) for step in range(14)]

    def loss(width):
        denoiser = Atrous((2, 1), sigma_radiance=width, sigma_normal=0.3, sigma_position=0.5)
        with torch.no_grad():
            return sum(float(error(denoiser(frame).image, truth, frame)) for frame, truth in pairs) / len(pairs)

    best = min(grid, key=loss)
    assert grid[0] < best < grid[-1]
    denoiser = Atrous((2, 1), sigma_radiance=grid[0], sigma_normal=0.3, sigma_position=0.5)
    for name in ("log_sigma_normal", "log_sigma_position"):
        getattr(denoiser.edge_stopping, name).requires_grad_(False)
    found = fit(denoiser, pairs, error, held_out=pairs, steps=100, batch_size=2, progress=None)
    assert found.best.held_out_loss <= loss(best) * (1 + 1e-6)
    assert best / math.sqrt(2) < denoiser.edge_stopping.sigma_radiance.item() < best * math.sqrt(2)


def test_each_layer_finds_widths_of_its_own():
    denoiser = NonHomogeneousAtrous((1, 2), sigma_radiance=1.0)
    fit(denoiser, pairs_of(range(2)), steps=15, progress=None)
    inner, outer = (readable(denoiser)[f"edge_stopping.{layer}.sigma_radiance"] for layer in (0, 1))
    assert inner != outer
    assert min(inner, outer) > 1.1


def test_batches_average_and_cover_all_pairs():
    """Gradient descent on squares: one step from factor a to a - rate * 2 mean((a x - y) x)."""
    pairs = [(noisy_frame(seed), torch.full((1, 3, 24, 24), float(seed))) for seed in range(4)]
    images = [(frame.radiance, truth) for frame, truth in pairs]

    def descend(factor, batch):
        return factor - 0.1 * sum(float((2 * (factor * x - y) * x).mean()) for x, y in batch) / len(batch)

    denoiser = Scale()
    fit(denoiser, pairs, squares, steps=1, batch_size=4, optimizer=lambda p: torch.optim.SGD(p, 0.1), progress=None)
    assert denoiser.factor.item() == pytest.approx(descend(1.0, images), rel=1e-5)

    single = Scale()
    fit(single, pairs, squares, steps=4, optimizer=lambda p: torch.optim.SGD(p, 0.1), progress=None, seed=3)
    ways = [1.0] * 24
    for number, order in enumerate(itertools.permutations(range(4))):
        for index in order:
            ways[number] = descend(ways[number], [images[index]])
    assert min(abs(way - single.factor.item()) for way in ways) < 1e-5  # each pair once, in some order


def test_the_best_held_out_parameters_are_kept():
    """Training wants 3, what is held out wants 2: the best is met on the way, and returned to."""
    frame = noisy_frame(0)
    found = fit(
        denoiser := Scale(), [(frame, 3 * frame.radiance)], squares, held_out=[(frame, 2 * frame.radiance)],
        steps=60, evaluate_every=1, learning_rate=0.1, progress=None,
    )  # fmt: skip
    assert found.best.held_out_loss == min(record.held_out_loss for record in found.history)
    assert denoiser.factor.item() == pytest.approx(2, abs=0.06)
    assert found.history[-1].parameters["factor"] > 2.5
    assert found.best.parameters["factor"] == pytest.approx(denoiser.factor.item())


def test_patience_ends_it():
    frame = noisy_frame(0)
    pairs, held_out = [(frame, 3 * frame.radiance)], [(frame, 2 * frame.radiance)]
    found = fit(
        Scale(), pairs, squares, held_out=held_out, steps=500, evaluate_every=2, patience=3, learning_rate=0.1,
        progress=None,
    )  # fmt: skip
    assert found.reason == "patience"
    assert found.history[-1].step == found.best.step + 6
    assert fit(Scale(), pairs, squares, steps=5, progress=None).reason == "steps"


class Interrupted(list):
    """Pairs that somebody presses Ctrl-C on when one is asked for the given number of times."""

    def __init__(self, pairs, after):
        super().__init__(pairs)
        self.left = after

    def __getitem__(self, index):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt
        return super().__getitem__(index)


@pytest.mark.parametrize("optimizer", ["adam", "lbfgs"])
def test_an_interrupted_fit_goes_on_to_the_same_bits(tmp_path, optimizer):
    pairs, held_out = pairs_of(range(3)), pairs_of([7])

    def run(folder, pairs=pairs, steps=8):
        denoiser = Atrous((2, 1), sigma_radiance=1.0)
        found = fit(
            denoiser, pairs, held_out=held_out, steps=steps, batch_size=2, optimizer=optimizer, evaluate_every=2,
            folder=folder, progress=None,
        )  # fmt: skip
        return denoiser, found

    whole, course = run(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "parts", Interrupted(pairs, after=2 * 5 + 1))
    assert [record.step for record in read_history(tmp_path / "parts")] == [0, 1, 2, 3, 4]
    parts, continued = run(tmp_path / "parts")
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), parts.parameters(), strict=True))
    for one, other in zip(course.history, continued.history, strict=True):
        assert str(replace(one, seconds=0)) == str(replace(other, seconds=0))
    assert [str(record) for record in read_history(tmp_path / "parts")] == [str(r) for r in continued.history]

    fresh = Atrous((2, 1))
    load_parameters(fresh, tmp_path / "parts" / "parameters.safetensors")
    assert readable(fresh) == readable(parts)
    assert run(tmp_path / "parts", steps=10)[1].history[-1].step == 10
    with pytest.raises(ValueError, match=r"steps: expected at least the 10 that .*, got 4"):
        run(tmp_path / "parts", steps=4)


def test_another_fit_s_folder_is_refused(tmp_path):
    pairs = pairs_of([0])
    fit(Atrous((1,)), pairs, steps=1, folder=tmp_path, progress=None)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ValueError, match=r"batch_size: expected 1, as in the fit .*, got 2"):
        fit(Atrous((1,)), pairs, steps=1, batch_size=2, folder=tmp_path, progress=None)
    with pytest.raises(ValueError, match=r"module: "):
        fit(Atrous((2,)), pairs, steps=1, folder=tmp_path, progress=None)
    (tmp_path / "checkpoint.safetensors").write_bytes(b"not one")
    with pytest.raises(ValueError, match=r"checkpoint\.safetensors: damaged"):
        fit(Atrous((1,)), pairs, steps=2, folder=tmp_path, progress=None)
    assert json.loads(before["parameters.json"])["parameters"]["edge_stopping.sigma_normal"] > 0


def test_references_may_be_records():
    frame, truth = pairs_of([0])[0]
    record = Reference(truth, torch.zeros_like(truth), count=16)
    one, other = Atrous((1,)), Atrous((1,))
    fit(one, [(frame, truth)], steps=3, progress=None)
    fit(other, [(frame, record)], steps=3, progress=None)
    assert readable(one) == readable(other)


@pytest.mark.parametrize("optimizer", ["adam", "lbfgs"])
def test_a_loss_that_is_not_finite_leaves_the_parameters(optimizer):
    calls = []

    def breaks(image, reference, frame):
        del frame
        calls.append(1)
        return (image - reference).square().mean() * (math.nan if len(calls) > 3 else 1)

    denoiser, pairs = Atrous((1,)), pairs_of([0])
    before = readable(denoiser)
    with pytest.raises(ValueError, match=r"objective: expected a finite number with a finite gradient, got nan"):
        fit(denoiser, pairs, breaks, steps=20, optimizer=optimizer, progress=None)
    if optimizer == "lbfgs":
        assert readable(denoiser) == before  # the first step's line search
    assert all(math.isfinite(number) for number in readable(denoiser).values())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pairs": []}, r"pairs: expected at least one, got 0 pairs"),
        ({"steps": 0}, r"steps: expected .*1.*, got 0"),
        ({"batch_size": 0}, r"batch_size: "),
        ({"evaluate_every": 0}, r"evaluate_every: "),
        ({"patience": 2}, r"patience: expected None, since nothing is held out, got 2"),
        ({"optimizer": "sgd"}, r"optimizer: expected one of adam, lbfgs, or a function, got 'sgd'"),
        ({"learning_rate": -1.0}, r"learning_rate: "),
        ({"seed": -1}, r"seed: "),
        ({"denoiser": "frozen"}, r"denoiser: expected parameters to learn"),
    ],
)
def test_bad_arguments_are_named(changes, message):
    arguments = {"denoiser": Atrous((1,)), "pairs": pairs_of([0]), "progress": None, **changes}
    if arguments["denoiser"] == "frozen":
        arguments["denoiser"] = Atrous((1,)).requires_grad_(False)
    with pytest.raises(ValueError, match=message):
        fit(**arguments)


def test_bad_pairs_are_named():
    frame, truth = pairs_of([0])[0]
    with pytest.raises(ValueError, match=r"pairs\[0\]: expected a frame and its reference"):
        fit(Atrous((1,)), [(frame, None)], steps=1, progress=None)
    with pytest.raises(ShapeError, match=r"reference"):
        fit(Atrous((1,)), [(frame, truth[..., :-1])], steps=1, progress=None)


def test_the_bar_shows_losses_and_widths(capsys, monkeypatch):
    monkeypatch.setattr("fovden.parallel.BAR_AFTER", 0.0)
    fit(NonHomogeneousAtrous((1, 2)), pairs_of([0]), held_out=pairs_of([1]), steps=2, progress=True)
    shown = capsys.readouterr().err
    assert "fit" in shown
    for word in ("loss 0.", "held out 0.", "sigma_radiance ", "sigma_normal ", "sigma_position "):
        assert word in shown
