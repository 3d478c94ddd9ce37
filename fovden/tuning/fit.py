"""Fitting the parameters of a denoiser to frames whose references are known."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal, NamedTuple, Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from fovden import distributed
from fovden.checks import require, require_integer, require_number, require_shapes
from fovden.filters import Denoiser
from fovden.frame import Frame, Reference
from fovden.parallel import Progress, reporting
from fovden.tuning._session import Session
from fovden.tuning.history import Record
from fovden.tuning.objective import ImageError, Objective

__all__ = ["Fit", "Pairs", "fit"]

Item_co = TypeVar("Item_co", covariant=True)


class Pairs(Protocol[Item_co]):
    """Pairs of a noisy frame and what it should be: a list, or a data set such as ``FrameDataset``.

    Example:
        >>> pairs: Pairs[tuple[int, int]] = [(1, 2)]
    """

    def __len__(self) -> int:
        """Returns their number."""
        ...

    def __getitem__(self, index: int, /) -> Item_co:
        """Returns one of them."""
        ...


Pair = tuple[Frame, Reference | Tensor | None]
OptimizerName = Literal["adam", "lbfgs"]
MakeOptimizer = Callable[[Iterable[nn.Parameter]], torch.optim.Optimizer]

OPTIMIZERS: dict[str, Callable[..., torch.optim.Optimizer]] = {
    "adam": lambda parameters, rate: torch.optim.Adam(parameters, lr=0.05 if rate is None else rate),
    "lbfgs": lambda parameters, rate: torch.optim.LBFGS(
        parameters, lr=1.0 if rate is None else rate, max_iter=5, line_search_fn="strong_wolfe"
    ),
}
"""How the named optimizers are made. 0.05 changes a width by at most about 5 % a step, as its logarithm is learned."""


class Fit(NamedTuple):
    """The outcome of a fit.

    Attributes:
        best: The state whose parameters the denoiser has now: that of the least held-out loss, or else the last.
        history: All records, one per step.
        reason: Why it ended: ``"steps"`` or ``"patience"``.

    Example:
        >>> Fit(Record(0, math.nan, 0.5, 0.0), (), "steps").best.held_out_loss
        0.5
    """

    best: Record
    history: tuple[Record, ...]
    reason: str


def fit(
    denoiser: Denoiser,
    pairs: Pairs[Pair],
    objective: Objective = ImageError(),  # noqa: B008 - frozen
    *,
    held_out: Pairs[Pair] = (),
    steps: int = 200,
    batch_size: int = 1,
    optimizer: OptimizerName | MakeOptimizer = "adam",
    learning_rate: float | None = None,
    evaluate_every: int = 10,
    patience: int | None = None,
    seed: int = 0,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress = True,
) -> Fit:
    """Changes the parameters of a denoiser so that its images come close to references.

    Each step takes a batch of pairs, in an order that is drawn anew for each pass over them. Several noisy frames of
    the same view, with noise of their own, keep the parameters from fitting the noise; frames held out say when to
    stop, and which of the parameters met on the way are best. The denoiser ends with those.

    With a folder the work can be interrupted: the same call goes on from the last evaluation, and gives the same bits
    as without the interruption; one with more ``steps`` goes on beyond the end. The folder gets ``history.csv``,
    ``parameters.safetensors`` with the best parameters so far and ``parameters.json`` for reading,
    ``checkpoint.safetensors`` and ``config.json``.

    Processes that ``torchrun`` has started, within :func:`fovden.distributed.joined`, divide the pairs of a batch among
    themselves and add their gradients: the parameters are those of one process, but for rounding. Every process must
    pass the same arguments.

    Args:
        denoiser: Any differentiable denoiser with parameters.
        pairs: Frames with references (or plain images of shape (v, 3, h, w)), on the denoiser's device. An item is
            asked for each time that it is used: a list keeps them, a ``FrameDataset`` traces them again.
        objective: What to make small.
        held_out: Pairs to judge by, disjoint from ``pairs``; none to take the last parameters.
        steps: Number of steps.
        batch_size: Pairs per step.
        optimizer: ``"adam"``; ``"lbfgs"``, up to five iterations per step with a line search, for which a batch should
            hold all pairs; or a function from parameters to an optimizer.
        learning_rate: Of a named optimizer; ``None`` for 0.05 with Adam and 1 with L-BFGS.
        evaluate_every: Steps between evaluations of ``held_out`` and between checkpoints.
        patience: Evaluations without a new best after which to stop; ``None`` to make all steps.
        seed: Seed of the order.
        folder: Where to keep the work; made if it is not there.
        progress: See :func:`fovden.parallel.reporting`; a bar shows losses and parameters.

    Returns:
        The course of the fit. The denoiser's parameters are changed in place.

    Raises:
        ValueError: If there is nothing to fit or to fit to, a number is out of range, the folder holds another fit, or
            a loss is not finite: parameters are then those of before the step.
        ShapeError: If an image and its reference differ in shape.

    Example:
        >>> from fovden.filters import Atrous
        >>> from fovden.frame import GBuffer
        >>> noisy = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
        >>> frame = Frame.from_radiance(noisy, GBuffer.empty(1, (16, 16)))
        >>> denoiser = Atrous((2, 1), sigma_radiance=1.0)
        >>> found = fit(denoiser, [(frame, torch.full_like(noisy, 0.5))], steps=20, progress=None)
        >>> found.history[1].loss > found.history[-1].loss, denoiser.edge_stopping.sigma_radiance.item() > 1.5
        (True, True)
    """
    _require_numbers(pairs, held_out, steps, batch_size, evaluate_every, patience, seed)
    learnable = [parameter for parameter in denoiser.parameters() if parameter.requires_grad]
    require(len(learnable) > 0, "denoiser", f"a {type(denoiser).__name__} without parameters", "parameters to learn")
    made = _make(optimizer, learnable, learning_rate)
    settings = {
        "objective": _name(objective),
        "optimizer": optimizer if isinstance(optimizer, str) else type(made).__name__,
        "learning_rate": learning_rate,
        "pairs": len(pairs),
        "held_out": len(held_out),
        "batch_size": batch_size,
        "evaluate_every": evaluate_every,
        "seed": seed,
    }
    state = Session(denoiser, made, None if folder is None else Path(folder), settings)
    state.open()
    require(state.step <= steps, "steps", steps, f"at least the {state.step} that {folder} holds")
    with reporting(progress if distributed.rank() == 0 else None, steps, "fit", unit=" steps") as report:
        if not state.history:
            state.record(math.nan, _mean_loss(denoiser, held_out, objective))
            state.save()
        while state.step < steps and not state.has_waited(patience):
            batch = _batch(len(pairs), batch_size, state.step, seed)
            loss = _advance(denoiser, made, learnable, pairs, batch, objective)
            state.step += 1
            due = state.step % evaluate_every == 0 or state.step == steps
            state.record(loss, _mean_loss(denoiser, held_out, objective) if due else math.nan)
            if due:
                state.save()
            report(state.step, state.note())
    reason = "patience" if state.has_waited(patience) else "steps"
    return Fit(state.restore_best(), tuple(state.history), reason)


def _require_numbers(
    pairs: Pairs[Pair],
    held_out: Pairs[Pair],
    steps: int,
    batch_size: int,
    evaluate_every: int,
    patience: int | None,
    seed: int,
) -> None:
    require(len(pairs) > 0, "pairs", f"{len(pairs)} pairs", "at least one")
    for name, number in (("steps", steps), ("batch_size", batch_size), ("evaluate_every", evaluate_every)):
        require_integer(name, number, minimum=1)
    require_integer("seed", seed, minimum=0)
    if patience is not None:
        require_integer("patience", patience, minimum=1)
        require(len(held_out) > 0, "patience", patience, "None, since nothing is held out")


def _make(
    optimizer: OptimizerName | MakeOptimizer, parameters: list[nn.Parameter], learning_rate: float | None
) -> torch.optim.Optimizer:
    if not isinstance(optimizer, str):
        require(learning_rate is None, "learning_rate", learning_rate, "None where the optimizer is a function")
        return optimizer(parameters)
    require(optimizer in OPTIMIZERS, "optimizer", repr(optimizer), f"one of {', '.join(OPTIMIZERS)}, or a function")
    if learning_rate is not None:
        require_number("learning_rate", learning_rate, above=0)
    return OPTIMIZERS[optimizer](parameters, learning_rate)


def _name(objective: Objective) -> str:
    """What the objective is called in every process: a function's representation has its address in it."""
    name = getattr(objective, "__qualname__", None)
    if name is None:
        name = type(objective).__qualname__ if type(objective).__repr__ is object.__repr__ else repr(objective)
    return str(name)


def _batch(count: int, size: int, step: int, seed: int) -> list[int]:
    """The pairs of a step: a function of its number alone, so that a fit can be continued anywhere."""
    places = range(step * size, (step + 1) * size)
    orders = {turn: np.random.default_rng((seed, turn)).permutation(count) for turn in {p // count for p in places}}
    return [int(orders[place // count][place % count]) for place in places]


def _advance(
    denoiser: Denoiser,
    optimizer: torch.optim.Optimizer,
    learnable: list[nn.Parameter],
    pairs: Pairs[Pair],
    batch: list[int],
    objective: Objective,
) -> float:
    """Makes a step and returns the loss before it."""
    mine = batch[distributed.rank() :: distributed.world_size()]
    held = [_pair(pairs, index) for index in mine] if isinstance(optimizer, torch.optim.LBFGS) else None

    def evaluate() -> Tensor:
        for parameter in learnable:
            parameter.grad = torch.zeros_like(parameter)
        total = torch.zeros((), dtype=torch.float64)
        for place, index in enumerate(mine):
            frame, truth = _pair(pairs, index) if held is None else held[place]
            loss = _loss(denoiser, frame, truth, objective)
            loss.backward()  # type: ignore[no-untyped-call]
            total += loss.detach()
        gradients = [parameter.grad for parameter in learnable if parameter.grad is not None]
        distributed.add_over_ranks([total, *gradients])
        torch._foreach_div_(gradients, len(batch))
        total /= len(batch)
        finite = all(bool(each.isfinite().all()) for each in (total, *gradients))
        require(finite, "objective", f"{float(total)} for pairs {batch}", "a finite number with a finite gradient")
        return total

    before = [parameter.detach().clone() for parameter in learnable]
    try:
        return float(optimizer.step(evaluate))  # type: ignore[arg-type]
    except BaseException:  # a line search has moved them
        with torch.no_grad():
            for parameter, value in zip(learnable, before, strict=True):
                parameter.copy_(value)
        raise
    finally:
        optimizer.zero_grad()


def _mean_loss(denoiser: Denoiser, pairs: Pairs[Pair], objective: Objective) -> float:
    """The mean over all pairs, without gradient; NaN where there is none."""
    if len(pairs) == 0:
        return math.nan
    total = torch.zeros((), dtype=torch.float64)
    with torch.no_grad():
        for index in range(distributed.rank(), len(pairs), distributed.world_size()):
            total += _loss(denoiser, *_pair(pairs, index), objective)
    distributed.add_over_ranks([total])
    return float(total) / len(pairs)


def _loss(denoiser: Denoiser, frame: Frame, truth: Tensor, objective: Objective) -> Tensor:
    image = denoiser(frame).image
    require_shapes("v 3 h w", image=image, reference=truth)
    return objective(image, truth, frame)


def _pair(pairs: Pairs[Pair], index: int) -> tuple[Frame, Tensor]:
    frame, truth = pairs[index]
    require(truth is not None, f"pairs[{index}]", "a frame without reference", "a frame and its reference")
    assert truth is not None
    return frame, truth.mean if isinstance(truth, Reference) else truth
