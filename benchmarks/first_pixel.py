"""A new process up to its first pixel; prints as JSON what that took. ``cold_start.py`` runs it.

Nothing but the standard library is imported before the clocks start.
"""
# ruff: noqa: E402, T201

import time

BEGIN = time.perf_counter(), time.process_time()

import json
from typing import Any

import torch

TORCH = time.perf_counter(), time.process_time()

from fovden.tracer import make_scene, trace_frame

IMPORTED = time.perf_counter(), time.process_time()

from numba.core import event as events


class Compilations(events.Listener):  # type: ignore[misc]  # Numba has no types
    """Keeps the processor time of the kernels that are compiled; what they call is compiled as a part of them."""

    def __init__(self) -> None:
        self.open: list[float] = []
        self.kernels: dict[str, float] = {}

    def on_start(self, _: Any) -> None:
        """Notes when a function's compilation begins."""
        self.open.append(time.process_time())

    def on_end(self, event: Any) -> None:
        """Adds up, where no other function is waiting for this one."""
        seconds = time.process_time() - self.open.pop()
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__.removeprefix('fovden.')}.{function.__name__}"
        if not self.open:
            self.kernels[name] = self.kernels.get(name, 0.0) + seconds


def main() -> None:
    """Traces one small frame."""
    heard = Compilations()
    events.register("numba:compile", heard)
    torch.set_num_threads(1)
    scene = make_scene("cornell_box")
    trace_frame(scene, scene.view().at((16, 16)), 1)
    traced = time.perf_counter(), time.process_time()
    clocks = {"torch": (BEGIN, TORCH), "fovden": (TORCH, IMPORTED), "frame": (IMPORTED, traced)}
    seconds = {
        clock: {name: end[which] - start[which] for name, (start, end) in clocks.items()}
        for which, clock in enumerate(("wall", "cpu"))
    }
    print(json.dumps({**seconds, "kernels": {name: value for name, value in heard.kernels.items() if value > 0}}))


if __name__ == "__main__":
    main()
