"""Where a fit stands: its history, its best parameters, and what is kept of both on disk."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from fovden import distributed
from fovden.checks import require
from fovden.filters import Denoiser
from fovden.io import atomic_write
from fovden.tuning.checkpoint import load_state, save_state
from fovden.tuning.history import Record, write_history
from fovden.tuning.parameters import describe, readable, save_parameters

__all__ = ["CHECKPOINT", "CONFIG", "PARAMETERS", "Session"]

CONFIG, CHECKPOINT, PARAMETERS = "config.json", "checkpoint.safetensors", "parameters.safetensors"
"""Names of files in the folder of a fit."""


@dataclass
class Session:
    """Where a fit stands, and what is kept of it on disk.

    Attributes:
        denoiser: What is fitted.
        optimizer: What fits it.
        folder: Where files are kept; ``None`` for nowhere.
        settings: What must be the same for a fit to be continued, as JSON can hold it.
        step: Number of steps made.
        history: One record per step, and one from before the first.
        best: The state of the denoiser at the best of these.
        best_record: That record.
        seconds_before: Wall time of earlier sessions.
        began: When this one began.

    Example:
        >>> from fovden.filters import Atrous
        >>> denoiser = Atrous()
        >>> session = Session(denoiser, torch.optim.Adam(denoiser.parameters()), None, {"held_out": 0})
        >>> session.record(math.nan, math.nan)
        >>> session.restore_best().step
        0
    """

    denoiser: Denoiser
    optimizer: torch.optim.Optimizer
    folder: Path | None
    settings: dict[str, Any]
    step: int = 0
    history: list[Record] = field(default_factory=list)
    best: dict[str, Tensor] = field(default_factory=dict)
    best_record: Record | None = None
    seconds_before: float = 0.0
    began: float = field(default_factory=time.perf_counter)

    def open(self) -> None:
        """Makes the folder, or goes on from what it holds."""
        if self.folder is None:
            return
        config, checkpoint = self.folder / CONFIG, self.folder / CHECKPOINT
        own = {**self.settings, "module": describe(self.denoiser)}
        if checkpoint.exists():
            saved = json.loads(config.read_text(encoding="utf-8"))
            for name, value in json.loads(json.dumps(own)).items():
                require(
                    saved.get(name) == value, name, value, f"{saved.get(name)!r}, as in the fit that {config} holds"
                )
            state = load_state(checkpoint)
            self.denoiser.load_state_dict(state["parameters"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.best = state["step"], state["best"]
            self.history = [Record(*numbers) for numbers in state["history"]]
            self.best_record = self.history[state["best_step"]]
            self.seconds_before = self.history[-1].seconds
        elif distributed.rank() == 0:
            self.folder.mkdir(parents=True, exist_ok=True)
            with atomic_write(config) as temporary:
                temporary.write_text(json.dumps(own, indent=1) + "\n", encoding="utf-8")

    def record(self, loss: float, held_out_loss: float) -> None:
        """Adds a record, and keeps the parameters if they are the best so far."""
        seconds = self.seconds_before + time.perf_counter() - self.began
        record = Record(self.step, loss, held_out_loss, seconds, readable(self.denoiser))
        self.history.append(record)
        least = math.inf if self.best_record is None else self.best_record.held_out_loss
        nothing_held_out = self.settings["held_out"] == 0
        if nothing_held_out or held_out_loss < least or self.best_record is None:
            self.best_record = record
            self.best = {name: tensor.detach().clone() for name, tensor in self.denoiser.state_dict().items()}

    def has_waited(self, patience: int | None) -> bool:
        """Whether so many evaluations have passed since the best one."""
        if patience is None or self.best_record is None:
            return False
        since = [each for each in self.history[self.best_record.step + 1 :] if not math.isnan(each.held_out_loss)]
        return len(since) >= patience

    def note(self) -> str:
        """The last losses, and the parameters by what they are called: one word for all layers."""
        now = self.history[-1]
        held_out = [each.held_out_loss for each in self.history if not math.isnan(each.held_out_loss)]
        words = [f"loss {now.loss:.4g}", *(f"held out {loss:.4g}" for loss in held_out[-1:])]
        groups: dict[str, list[str]] = {}
        for name, number in now.parameters.items():
            groups.setdefault(name.rsplit(".", 1)[-1].split("[")[0], []).append(f"{number:.3g}")
        return ", ".join([*words, *(f"{name} {' '.join(numbers)}" for name, numbers in groups.items())])

    def save(self) -> None:
        """Writes what the next session needs, and what people want to see; the checkpoint last."""
        if self.folder is None or distributed.rank() != 0 or self.best_record is None:
            return
        write_history(self.folder, self.history)
        notes = {"step": self.best_record.step, "held_out_loss": _plain(self.best_record.held_out_loss)}
        now = {name: tensor.detach().clone() for name, tensor in self.denoiser.state_dict().items()}
        self.denoiser.load_state_dict(self.best)
        save_parameters(self.denoiser, self.folder / PARAMETERS, notes)
        self.denoiser.load_state_dict(now)
        state = {
            "step": self.step,
            "parameters": now,
            "optimizer": self.optimizer.state_dict(),
            "best": self.best,
            "best_step": self.best_record.step,
            "history": [[e.step, e.loss, e.held_out_loss, e.seconds, e.parameters] for e in self.history],
        }
        save_state(self.folder / CHECKPOINT, state)

    def restore_best(self) -> Record:
        """Gives the denoiser its best parameters."""
        assert self.best_record is not None
        self.denoiser.load_state_dict(self.best)
        return self.best_record


def _plain(number: float) -> float | None:
    return None if math.isnan(number) else number
