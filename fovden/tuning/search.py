"""Searching what has no gradient, such as numbers of passes: the Pareto front of cost against error."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from fovden.checks import require, require_integer
from fovden.parallel import Progress, reporting

__all__ = ["Trial", "pareto_front", "search"]

TRIALS = "trials.jsonl"
"""Name of the journal in the folder of a search."""

NOTES = "notes"
"""Name of a trial's notes in the journal."""

Choices = range | tuple[float, float] | Sequence[Any]
"""What a value may be: an integer of a range, a number between two, or one of a list."""

Range = Choices | Callable[[Mapping[str, Any]], Choices]
"""The same, or a function that says so from the values that are named before it in the space."""

Outcome = tuple[float, float] | tuple[float, float, Mapping[str, Any]]
"""Cost and error of a setting, and notes."""


class Trial(NamedTuple):
    """One setting that was tried.

    Attributes:
        number: Which one it was, from 0.
        setting: The values by name.
        cost: What it costs, such as seconds.
        error: How far its image is from the reference.
        notes: What else was to be kept of it, as JSON can hold it.

    Example:
        >>> Trial(0, {"levels": 3}, 0.5, 0.1).setting["levels"]
        3
    """

    number: int
    setting: dict[str, Any]
    cost: float
    error: float
    notes: Mapping[str, Any] = {}  # never written to


def pareto_front(trials: Sequence[Trial]) -> list[Trial]:
    """Returns the trials that no other beats in both cost and error, the cheapest first.

    Args:
        trials: Any trials.

    Returns:
        The front. Of trials that agree in both numbers the first is kept.

    Example:
        >>> trials = [Trial(0, {}, 1.0, 0.5), Trial(1, {}, 2.0, 0.6), Trial(2, {}, 3.0, 0.1)]
        >>> [trial.number for trial in pareto_front(trials)]
        [0, 2]
    """
    front: list[Trial] = []
    for trial in sorted(trials, key=lambda trial: (trial.cost, trial.error, trial.number)):
        if not front or trial.error < front[-1].error:
            front.append(trial)
    return front


def search(
    evaluate: Callable[[Mapping[str, Any]], Outcome],
    space: Mapping[str, Range],
    *,
    trials: int = 50,
    first: Sequence[Mapping[str, Any]] = (),
    seed: int = 0,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress = True,
) -> list[Trial]:
    """Tries settings, ever more of them where low cost and low error were found, and returns all.

    The settings are proposed by Optuna's tree-structured Parzen estimator for two objectives.

    Constraints are best built into the space: what a value may be can follow from those named before it. For M < N:
    ``{"M": range(1, 6), "N": lambda at: range(at["M"] + 1, 7)}``.

    Args:
        evaluate: From a setting to its cost and its error, both to be made small; finite. A third value is kept as the
            trial's notes: a mapping that JSON can hold.
        space: What is searched: by name a ``range`` of integers, a tuple of two floats, or a list of choices; or a
            function from the values of the names before it to a range or a tuple (not to a list: Optuna wants the same
            choices in all trials).
        trials: Number of trials in all, those in the folder included.
        first: Settings to try first, such as a paper's. With as many of them as trials, these are tried and no others:
            a grid, for example, that is kept and goes on as a search does.
        seed: Seed of the proposals.
        folder: Where trials are kept in a journal, ``trials.jsonl``, so that an interrupted search goes on; made if it
            is not there. Several processes may search in one folder at once.
        progress: See :func:`fovden.parallel.reporting`.

    Returns:
        The trials that were completed, in order; see :func:`pareto_front`.

    Raises:
        ImportError: If Optuna is not installed: ``pip install fovden[tune]``.
        ValueError: If there is nothing to search, a range is empty, a first setting lies outside of the space, the
            folder holds the search of another space, or ``evaluate`` returns something not finite.

    Source: Bergstra, Bardenet, Bengio, Kégl, "Algorithms for hyper-parameter optimization", NIPS 2011; for several
    objectives Ozaki, Tanigaki, Watanabe, Onishi, GECCO 2020.

    Example:
        >>> found = search(lambda at: (at["n"], 1 / at["n"]), {"n": range(1, 9)}, trials=5, progress=None)
        >>> len(found), all(trial.cost * trial.error == 1 for trial in found)
        (5, True)
        >>> space = {"inner": range(1, 4), "outer": lambda at: range(at["inner"], 4)}
        >>> found = search(lambda at: (at["outer"], -at["inner"], {"seen": 1}), space, trials=8, progress=None)
        >>> all(trial.setting["inner"] <= trial.setting["outer"] for trial in found), found[0].notes
        (True, {'seen': 1})
    """
    try:
        import optuna  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ImportError("search needs Optuna: pip install fovden[tune]") from error
    require(len(space) > 0, "space", dict(space), "at least one name")
    for name, choices in space.items():
        if not callable(choices):
            _require_choices(name, choices)
    for number, setting in enumerate(first):
        _require_within(setting, space, f"first[{number}]")
    require_integer("trials", trials, minimum=1)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = None
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
        backend = optuna.storages.journal.JournalFileBackend(str(Path(folder) / TRIALS))
        storage = optuna.storages.JournalStorage(backend)
    study = optuna.create_study(
        storage=storage,
        study_name="search",
        directions=["minimize", "minimize"],
        load_if_exists=True,
    )
    own = {name: "a function" if callable(choices) else repr(choices) for name, choices in space.items()}
    searched = study.user_attrs.get("space", own)
    require(searched == own, "space", own, f"that of the search which {folder} holds, {searched}")
    study.set_user_attr("space", own)
    done = len(_completed(study))
    study.sampler = optuna.samplers.TPESampler(seed=seed + done)

    def objective(trial: Any) -> tuple[float, float]:
        setting: dict[str, Any] = {}
        for name, choices in space.items():
            setting[name] = _suggest(trial, name, _resolved(name, choices, setting))
        outcome = evaluate(setting)
        cost, error = float(outcome[0]), float(outcome[1])
        finite = abs(cost) < float("inf") and abs(error) < float("inf")
        require(finite, "evaluate", f"{cost}, {error} for {setting}", "two finite numbers")
        if len(outcome) > 2:
            trial.set_user_attr(NOTES, dict(outcome[2]))
        return cost, error

    with reporting(progress, trials, "search", unit=" trials") as report:
        while done < trials:
            if done < len(first):
                study.enqueue_trial(dict(first[done]))
            study.optimize(objective, n_trials=1)
            done = len(_completed(study))
            found = _trials(study)
            least = min(trial.error for trial in found)
            report(done, f"{len(pareto_front(found))} on the front, least error {least:.4g}")
    return _trials(study)[:trials]


def _trials(study: Any) -> list[Trial]:
    return [
        Trial(number, dict(trial.params), trial.values[0], trial.values[1], trial.user_attrs.get(NOTES, {}))
        for number, trial in enumerate(_completed(study))
    ]


def _require_choices(name: str, choices: Choices) -> None:
    if isinstance(choices, tuple):
        pair = len(choices) == 2 and choices[0] < choices[1]
        require(pair, f"space[{name!r}]", choices, "two numbers, the lesser first")
    require(len(choices) > 0, f"space[{name!r}]", choices, "something to choose from")


def _resolved(name: str, choices: Range, before: Mapping[str, Any]) -> Choices:
    """What a value may be, given those before it."""
    if not callable(choices):
        return choices
    found = choices(MappingProxyType(dict(before)))
    stays = isinstance(found, range | tuple)
    require(stays, f"space[{name!r}]", found, "a range or two numbers from a function, as choices must stay the same")
    _require_choices(name, found)
    return found


def _require_within(setting: Mapping[str, Any], space: Mapping[str, Range], where: str) -> None:
    """Raises a ``ValueError`` if a setting has a name or a value that the space has not."""
    unknown = sorted(set(setting) - set(space))
    require(not unknown, where, f"{', '.join(unknown)} in {dict(setting)}", f"names of {', '.join(space)}")
    before: dict[str, Any] = {}
    for name, choices in space.items():
        if name not in setting:
            return  # it is drawn, and what follows may depend on it
        value, within = setting[name], _resolved(name, choices, before)
        inside = within[0] <= value <= within[1] if isinstance(within, tuple) else value in within
        require(inside, f"{where}[{name!r}]", value, _described(within))
        before[name] = value


def _described(choices: Choices) -> str:
    return f"a number from {choices[0]} to {choices[1]}" if isinstance(choices, tuple) else f"one of {choices}"


def _suggest(trial: Any, name: str, choices: Choices) -> Any:
    if isinstance(choices, range):
        return trial.suggest_int(name, choices[0], choices[-1], step=choices.step)
    if isinstance(choices, tuple):
        return trial.suggest_float(name, *choices)
    return trial.suggest_categorical(name, list(choices))


def _completed(study: Any) -> list[Any]:
    return [trial for trial in study.trials if trial.values is not None]
