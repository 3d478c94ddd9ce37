"""Runs compiled kernels over a range of items on several threads.

A kernel is a function ``kernel(start, stop, *arguments)`` that works on the items ``start .. stop - 1``, without the
global interpreter lock, and writes only to those items' places in its output arrays: then the result depends neither
on the tiles nor on the number of threads.

The thread that calls :func:`run` works too, and up to ``torch.get_num_threads() - 1`` threads of one shared pool help
it. All of them take tiles from one iterator, so a caller that gets no help, because the pool is busy with the runs of
other threads or because the process has a single thread, still finishes by itself: nothing can deadlock. Tiles are the
unit of everything else: between two of them the caller reports progress, a Ctrl-C arrives, and a run that failed stops.

Threads do not survive a fork. A forked child forgets the pool of its parent and makes its own when it needs one; a
worker of PyTorch's ``DataLoader``, which is given one thread, needs none.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from typing import Any, TypeAlias

import torch

from fovden.checks import require_integer

__all__ = ["Progress", "reporting", "run"]

Progress: TypeAlias = Callable[[int], object] | bool | None
"""What to do with progress: call a function with the number of items done, draw a bar (true), nothing (false)."""

REPORT_EVERY = 0.1  # seconds between two reports: below what the eye follows, above what a report costs
BAR_AFTER = 1.0  # seconds before a bar appears: shorter runs stay silent
LOG_EVERY = 10.0  # seconds between the lines of a bar that no terminal shows


def run(
    kernel: Callable[..., object],
    count: int,
    arguments: Sequence[Any],
    *,
    tile: int,
    least: int | None = None,
    progress: Progress = None,
    description: str | None = None,
) -> None:
    """Calls a kernel on all tiles of ``range(count)``, on as many threads as PyTorch has.

    The calls are ``kernel(start, stop, *arguments)`` for tiles that follow each other, in no particular order, preceded
    by ``kernel(0, 0, *arguments)``, which must do nothing: a kernel is compiled on its first call, and that is best
    done once, in the caller's thread, where Ctrl-C reaches it.

    Ctrl-C and exceptions, of a kernel or of ``progress``, end the run after the tiles that are being worked on; when
    they reach the caller nothing is running any more. A tile should therefore last well below a second. A call costs
    some tens of microseconds, a tile about one.

    Args:
        kernel: The function; see the module's docstring for what it may do.
        count: Number of items, at least 0.
        arguments: Further arguments of ``kernel``, the same for every tile.
        tile: Items per call of ``kernel``, at least 1; the last may have fewer.
        least: Items per call towards the end, at least 1 and at most ``tile``: each tile then has half of what is left
            for a thread, so that large tiles do not keep the others waiting (guided self-scheduling, Polychronopoulos
            and Kuck, 1987). ``None`` means ``tile``.
        progress: A function that is called from this thread with the number of items done, rising, at most ten times
            a second and at last with ``count``; or true for a bar with the time left on standard error, if the run
            lasts over a second; or false or ``None`` for silence.
        description: What the bar says is being done.

    Raises:
        TypeError: If ``count``, ``tile`` or ``least`` is not an integer.
        ValueError: If ``count``, ``tile`` or ``least`` is too small, or ``least`` above ``tile``.

    Example:
        >>> import numpy as np
        >>> def square(start, stop, numbers, squares):
        ...     squares[start:stop] = numbers[start:stop] ** 2
        >>> squares = np.zeros(5)
        >>> run(square, 5, (np.arange(5.0), squares), tile=2)
        >>> squares
        array([ 0.,  1.,  4.,  9., 16.])
    """
    require_integer("count", count, minimum=0)
    require_integer("tile", tile, minimum=1)
    least = tile if least is None else least
    require_integer("least", least, minimum=1, maximum=tile)
    kernel(0, 0, *arguments)
    threads = max(1, min(torch.get_num_threads(), -(-count // least)))
    job = _Job(kernel, count, arguments, _bounds(count, tile, least, threads), threads)
    helpers: list[Future[None]] = []
    with reporting(progress, count, description) as report:
        try:
            helpers = _POOL.submit(job.work, threads - 1)
            job.work(0, report)
            helpers = [helper for helper in helpers if not helper.cancel()]
            while wait(helpers, timeout=REPORT_EVERY).not_done:
                report(sum(job.done))
        finally:
            job.stopped = True
            wait([helper for helper in helpers if not helper.cancel()])
        for helper in helpers:
            helper.result()
        report(count)


@contextmanager
def reporting(
    progress: Progress, total: int, description: str | None = None, *, unit: str = "it"
) -> Iterator[Callable[..., None]]:
    """Gives a function ``report(done, note="")`` that passes progress on; for loops that do not go through :func:`run`.

    Args:
        progress: As in :func:`run`.
        total: The value of ``done`` at the end.
        description: What the bar says is being done.
        unit: What the bar counts.

    Yields:
        The function. Calls that follow the last report within a tenth of a second, or bring nothing new, are dropped,
        except for ``done = total``. A bar shows the note behind it.

    Example:
        >>> with reporting(print, total=3) as report:
        ...     for done in (0, 1, 2, 3):
        ...         report(done)
        3
    """
    if progress is None or progress is False:
        yield _keep_silent
        return
    tell = _Bar(total, description, unit) if progress is True else progress
    reported, reported_at = -1, time.monotonic()

    def report(done: int, note: str = "") -> None:
        nonlocal reported, reported_at
        now = time.monotonic()
        if done > reported and (done == total or now - reported_at >= REPORT_EVERY):
            if isinstance(tell, _Bar):
                tell.note = note
            tell(done)
            reported, reported_at = done, now

    try:
        yield report
    finally:
        if isinstance(tell, _Bar):
            tell.close()


def _keep_silent(done: int, note: str = "") -> None:
    del done, note


class _Bar:
    """A progress bar on standard error, once its work has lasted a second; in a log it is written seldom."""

    def __init__(self, total: int, description: str | None, unit: str) -> None:
        seconds = REPORT_EVERY if sys.stderr.isatty() else LOG_EVERY
        self.options = {"total": total, "desc": description, "unit": unit, "miniters": 1, "mininterval": seconds}
        self.options["dynamic_ncols"] = True
        self.started = time.monotonic()
        self.note = ""
        self.bar: Any = None

    def __call__(self, done: int) -> None:
        elapsed = time.monotonic() - self.started
        if self.bar is None and elapsed >= BAR_AFTER:
            from tqdm import tqdm  # noqa: PLC0415  most runs show no bar

            # Without tqdm's thread that wakes slow bars: it would outlive this one.
            silent = type("Bar", (tqdm,), {"monitor_interval": 0})
            self.bar = silent(unit_scale=True, **self.options)
            self.bar.start_t -= elapsed
            self.bar.last_print_t -= elapsed
        if self.bar is not None:
            self.bar.set_postfix_str(self.note, refresh=False)
            self.bar.update(done - self.bar.n)

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()


def _bounds(count: int, tile: int, least: int, threads: int) -> Sequence[int]:
    """Where tiles begin, and where the last ends, or later."""
    if least == tile:
        return range(0, count + tile, tile)
    bounds = [0]
    while bounds[-1] < count:
        left = count - bounds[-1]
        bounds.append(bounds[-1] + min(left, max(least, min(tile, left // (2 * threads)))))
    return bounds


class _Job:
    """The tiles of one run, handed out to whoever asks."""

    def __init__(
        self, kernel: Callable[..., object], count: int, arguments: Sequence[Any], bounds: Sequence[int], threads: int
    ) -> None:
        self.kernel, self.count, self.arguments, self.bounds = kernel, count, arguments, bounds
        self.tiles = iter(range(len(bounds) - 1))  # the interpreter lock makes each step atomic
        self.done = [0] * threads  # items, by thread: each writes its own entry alone
        self.stopped = False

    def work(self, thread: int, report: Callable[[int], None] | None = None) -> None:
        """Works on tiles until none is left or the run is stopped."""
        try:
            while not self.stopped and (tile := next(self.tiles, None)) is not None:
                start, stop = self.bounds[tile], min(self.bounds[tile + 1], self.count)
                self.kernel(start, stop, *self.arguments)
                self.done[thread] += stop - start
                if report is not None:
                    report(sum(self.done))
        except BaseException:
            self.stopped = True
            raise


class _Pool:
    """The helping threads of the process: started when first needed, more of them when PyTorch gets more."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Starts afresh; in a forked child the threads are gone, and the lock may be held by one of them."""
        self.lock = threading.Lock()
        self.size = 0
        self.executor: ThreadPoolExecutor | None = None

    def submit(self, work: Callable[[int], None], count: int) -> list[Future[None]]:
        """Asks for ``work(1) .. work(count)``; fewer where the system gives no more threads."""
        submitted: list[Future[None]] = []
        if count == 0:
            return submitted
        with self.lock, suppress(RuntimeError):  # no thread can be started, or the interpreter is shutting down
            if self.executor is None or self.size < count:
                if self.executor is not None:
                    self.executor.shutdown(wait=False)
                self.executor, self.size = ThreadPoolExecutor(count, thread_name_prefix="fovden"), count
            submitted.extend(self.executor.submit(work, thread) for thread in range(1, count + 1))
        return submitted


_POOL = _Pool()
if hasattr(os, "register_at_fork"):  # where processes fork
    os.register_at_fork(after_in_child=_POOL.forget)
