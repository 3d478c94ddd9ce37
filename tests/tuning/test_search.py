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


def test_a_range_may_depend_on_values_before_it():
    """M <= N and 0 <= y <= x, in what is drawn at random first and in what is proposed later."""
    space = {
        "M": range(1, 7),
        "N": lambda at: range(at["M"], 7),
        "x": (0.5, 2.0),
        "y": lambda at: (0.0, at["x"]),
    }
    seen = []

    def evaluate(setting):
        seen.append(dict(setting))
        return setting["N"] + setting["x"], (setting["M"] - 4) ** 2 + (setting["y"] - 1) ** 2

    search(evaluate, space, trials=60, seed=3, progress=None)
    assert all(1 <= each["M"] <= each["N"] <= 6 for each in seen)
    assert all(0 <= each["y"] <= each["x"] <= 2 for each in seen)
    late = seen[30:]
    assert sum(each["M"] == each["N"] for each in late) > len(late) / 4, "a larger N costs more and brings nothing"


def test_what_a_range_depends_on_is_not_written_to():
    def spoil(at):
        at["M"] = 9
        return range(3)

    with pytest.raises(TypeError, match="item assignment"):
        search(lambda _: (0.0, 0.0), {"M": range(3), "N": spoil}, trials=1, progress=None)


def test_notes_are_kept(tmp_path):
    def evaluate(setting):
        return setting["n"], 1.0, {"square": setting["n"] ** 2, "parts": [setting["n"], 0.5]}

    space = {"n": range(1, 9)}
    search(evaluate, space, trials=3, folder=tmp_path, progress=None)
    trials = search(evaluate, space, trials=5, folder=tmp_path, progress=None)
    assert [trial.notes for trial in trials] == [
        {"square": trial.setting["n"] ** 2, "parts": [trial.setting["n"], 0.5]} for trial in trials
    ]
    assert search(lambda at: (at["n"], 1.0), space, trials=1, progress=None)[0].notes == {}


def test_a_grid_is_tried_in_its_order():
    grid = [{"M": m, "N": n} for m in range(1, 4) for n in range(m, 4)]
    space = {"M": range(1, 4), "N": lambda at: range(at["M"], 4)}
    trials = search(lambda at: (at["N"], at["M"]), space, trials=len(grid), first=grid, progress=None)
    assert [trial.setting for trial in trials] == grid


def test_another_space_is_refused(tmp_path):
    search(lambda at: (at["n"], 0.0), {"n": range(3)}, trials=1, folder=tmp_path, progress=None)
    with pytest.raises(ValueError, match=r"space: expected that of the search which .* holds, .*range\(0, 3\)"):
        search(lambda at: (at["n"], 0.0), {"n": range(4)}, trials=2, folder=tmp_path, progress=None)


@pytest.mark.parametrize(
    ("first", "message"),
    [
        ({"n": 3, "m": 1}, r"first\[1\]: expected names of n, k, x, got m in"),
        ({"n": 7}, r"first\[1\]\['n'\]: expected one of range\(0, 5\), got 7"),
        ({"n": 3, "k": 2}, r"first\[1\]\['k'\]: expected one of range\(3, 5\), got 2"),
        ({"n": 3, "k": 3, "x": 1.5}, r"first\[1\]\['x'\]: expected a number from 0.0 to 1.0, got 1.5"),
    ],
)
def test_first_settings_outside_of_the_space_are_named(first, message):
    space = {"n": range(5), "k": lambda at: range(at["n"], 5), "x": (0.0, 1.0)}
    with pytest.raises(ValueError, match=message):
        search(lambda _: (0.0, 0.0), space, trials=1, first=[{"n": 1}, first], progress=None)


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        (["a", "b"], r"space\['k'\]: expected a range or two numbers from a function"),
        (range(0), r"space\['k'\]: expected something to choose from"),
        ((1.0, 1.0), r"space\['k'\]: expected two numbers, the lesser first"),
    ],
)
def test_bad_ranges_of_functions_are_named(choices, message):
    with pytest.raises(ValueError, match=message):
        search(lambda _: (0.0, 0.0), {"n": range(2), "k": lambda _: choices}, trials=1, progress=None)


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
