"""The search finds the front of a problem whose front is known, and goes on where it was interrupted."""

import math
import random

import pytest

from fovden.tuning import Trial, pareto_front, search


def front_by_definition(trials):
    """Who is beaten by nobody, by comparing everybody with everybody."""

    def beats(one, other):
        return (
            one.cost <= other.cost and one.error <= other.error and (one.cost, one.error) != (other.cost, other.error)
        )

    return [trial for trial in trials if not any(beats(other, trial) for other in trials)]


def test_the_front_is_its_definition():
    draw = random.Random(0)
    trials = [Trial(number, {}, draw.random(), draw.random()) for number in range(200)]
    assert {trial.number for trial in pareto_front(trials)} == {trial.number for trial in front_by_definition(trials)}
    costs = [trial.cost for trial in pareto_front(trials)]
    assert costs == sorted(costs)


def test_equal_trials_count_once():
    assert [trial.number for trial in pareto_front([Trial(0, {}, 1.0, 1.0), Trial(1, {}, 1.0, 1.0)])] == [0]


def test_a_known_front_is_found():
    """(x, (x - 3)^2 + y): whatever x up to 3, the front has y = 0."""
    seen = []

    def evaluate(setting):
        seen.append(dict(setting))
        return setting["x"], (setting["x"] - 3) ** 2 + setting["y"]

    space = {"x": (0.0, 6.0), "y": range(5), "z": ["a", "b"]}
    trials = search(evaluate, space, trials=80, first=[{"x": 1.0, "y": 2, "z": "b"}], seed=1, progress=None)
    assert seen[0] == {"x": 1.0, "y": 2, "z": "b"}
    assert all(0 <= each["x"] <= 6 and each["y"] in range(5) and each["z"] in "ab" for each in seen)
    front = pareto_front(trials)
    assert all(trial.setting["y"] == 0 for trial in front if trial.cost > 0.3)
    assert min(abs(trial.setting["x"] - 3) for trial in front) < 0.3


@pytest.mark.parametrize("interrupted", [1, 2, 4])
def test_an_interrupted_search_goes_on(tmp_path, interrupted):
    calls = []

    def evaluate(setting):
        calls.append(setting["n"])
        if len(calls) == interrupted:
            raise KeyboardInterrupt
        return setting["n"], -setting["n"]

    space, first = {"n": range(10)}, [{"n": 7}, {"n": 8}]
    with pytest.raises(KeyboardInterrupt):
        search(evaluate, space, trials=6, first=first, folder=tmp_path, progress=None)
    trials = search(evaluate, space, trials=6, first=first, folder=tmp_path, progress=None)
    assert [trial.setting["n"] for trial in trials[:2]] == [7, 8]
    assert len(trials) == 6
    assert len(calls) == 7  # the one that was interrupted was lost
    assert search(evaluate, space, trials=6, folder=tmp_path, progress=None) == trials


@pytest.mark.parametrize(
    ("space", "trials", "message"),
    [
        ({}, 1, r"space: expected at least one name"),
        ({"n": range(0)}, 1, r"space\['n'\]: expected something to choose from"),
        ({"x": (2.0, 1.0)}, 1, r"space\['x'\]: expected two numbers, the lesser first"),
        ({"n": range(3)}, 0, r"trials: "),
    ],
)
def test_bad_arguments_are_named(space, trials, message):
    with pytest.raises(ValueError, match=message):
        search(lambda _: (0.0, 0.0), space, trials=trials, progress=None)


def test_what_is_not_finite_is_named():
    with pytest.raises(ValueError, match=r"evaluate: expected two finite numbers, got .*nan"):
        search(lambda _: (1.0, math.nan), {"n": range(3)}, trials=1, progress=None)
