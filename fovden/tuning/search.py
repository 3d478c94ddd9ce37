"""Searching what has no gradient, such as numbers of passes: the Pareto front of cost against error."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fovden.checks import require, require_integer
from fovden.parallel import Progress, reporting

__all__ = ["Trial", "pareto_front", "search"]

TRIALS = "trials.jsonl"
"""Name of the journal in the folder of a search."""

Range = range | tuple[float, float] | Sequence[Any]
"""What a number may be: an integer of a range, a number between two, or one of a list."""


class Trial(NamedTuple):
    """One setting that was tried.

    Attributes:
        number: Which one it was, from 0.
        setting: The values by name.
        cost: What it costs, such as seconds.
        error: How far its image is from the reference.

    Example:
        >>> Trial(0, {"levels": 3}, 0.5, 0.1).setting["levels"]
        3
    """

    number: int
    setting: dict[str, Any]
    cost: float
    error: float


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
    evaluate: Callable[[Mapping[str, Any]], tuple[float, float]],
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

    Constraints are best built into the space: for M < N < P search M, N - M and P - N.

    Args:
        evaluate: From a setting to its cost and its error, both to be made small; finite.
        space: What is searched: by name a ``range`` of integers, a tuple of two floats, or a list of choices.
        trials: Number of trials in all, those in the folder included.
        first: Settings to try first, such as a paper's.
        seed: Seed of the proposals.
        folder: Where trials are kept in a journal, ``trials.jsonl``, so that an interrupted search goes on; made if it
            is not there. Several processes may search in one folder at once.
        progress: See :func:`fovden.parallel.reporting`.

    Returns:
        The trials that were completed, in order; see :func:`pareto_front`.

    Raises:
        ImportError: If Optuna is not installed: ``pip install fovden[tune]``.
        ValueError: If there is nothing to search, a range is empty, or ``evaluate`` returns something not finite.

    Source: Bergstra, Bardenet, Bengio, Kégl, "Algorithms for hyper-parameter optimization", NIPS 2011; for several
    objectives Ozaki, Tanigaki, Watanabe, Onishi, GECCO 2020.

    Example:
        >>> found = search(lambda at: (at["n"], 1 / at["n"]), {"n": range(1, 9)}, trials=5, progress=None)
        >>> len(found), all(trial.cost * trial.error == 1 for trial in found)
        (5, True)
    """
    try:
        import optuna  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ImportError("search needs Optuna: pip install fovden[tune]") from error
    require(len(space) > 0, "space", dict(space), "at least one name")
    for name, choices in space.items():
        if isinstance(choices, tuple):
            pair = len(choices) == 2 and choices[0] < choices[1]
            require(pair, f"space[{name!r}]", choices, "two numbers, the lesser first")
        require(len(choices) > 0, f"space[{name!r}]", choices, "something to choose from")
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
    done = len(_completed(study))
    study.sampler = optuna.samplers.TPESampler(seed=seed + done)

    def objective(trial: Any) -> tuple[float, float]:
        setting = {name: _suggest(trial, name, choices) for name, choices in space.items()}
        cost, error = map(float, evaluate(setting))
        finite = abs(cost) < float("inf") and abs(error) < float("inf")
        require(finite, "evaluate", f"{cost}, {error} for {setting}", "two finite numbers")
        return cost, error

    with reporting(progress, trials, "search", unit=" trials") as report:
        while done < trials:
            if done < len(first):
                study.enqueue_trial(dict(first[done]))
            study.optimize(objective, n_trials=1)
            done = len(_completed(study))
            report(done)
    return [Trial(number, dict(trial.params), *trial.values) for number, trial in enumerate(_completed(study)[:trials])]


def _suggest(trial: Any, name: str, choices: Range) -> Any:
    if isinstance(choices, range):
        return trial.suggest_int(name, choices[0], choices[-1], step=choices.step)
    if isinstance(choices, tuple):
        return trial.suggest_float(name, *choices)
    return trial.suggest_categorical(name, list(choices))


def _completed(study: Any) -> list[Any]:
    return [trial for trial in study.trials if trial.values is not None]
