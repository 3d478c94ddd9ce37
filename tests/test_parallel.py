"""Tiles on threads: every item once, whatever the tiles and threads; stopping; forks; callers side by side."""

import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from fovden.parallel import _Pool, reporting, run

# Python 3.12 and later warn at every fork of a process with threads, which a process with PyTorch always is.
forks = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@numba.njit(nogil=True)
def add_cubes(start: int, stop: int, out: np.ndarray) -> None:
    for item in range(start, stop):
        out[item] += item**3


@pytest.fixture(autouse=True)
def _two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def cubes(count: int, tile: int) -> np.ndarray:
    out = np.zeros(count, dtype=np.int64)
    run(add_cubes, count, (out,), tile=tile)
    return out


def test_tiles_cover_the_range_and_stop_at_its_end():
    tiles = []
    run(lambda start, stop: tiles.append((start, stop)), 10, (), tile=4)
    assert tiles[0] == (0, 0)
    assert sorted(tiles[1:]) == [(0, 4), (4, 8), (8, 10)]


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("count", [0, 1, 7, 1000])
@pytest.mark.parametrize("tile", [1, 3, 7, 999, 5000])
def test_every_item_is_visited_once(threads, count, tile):
    torch.set_num_threads(threads)
    assert np.array_equal(cubes(count, tile), np.arange(count) ** 3)


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize(("count", "tile", "least"), [(0, 5, 2), (1, 9, 9), (97, 40, 3), (1000, 1000, 1), (64, 16, 16)])
def test_tiles_become_small_towards_the_end(threads, count, tile, least):
    torch.set_num_threads(threads)
    tiles = []
    run(lambda start, stop: tiles.append((start, stop)), count, (), tile=tile, least=least)
    found, workers = sorted(tiles[1:]), max(1, min(threads, -(-count // least)))
    assert [0, *(stop for _, stop in found)] == [*(start for start, _ in found), count]
    for start, stop in found:
        left = count - start
        assert stop - start == min(left, max(least, min(tile, left // (2 * workers))))


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_as_many_threads_work_as_pytorch_has(threads):
    torch.set_num_threads(threads)
    barrier = threading.Barrier(threads)  # passed only if that many tiles are worked on at the same time
    names = set()

    def meet(start: int, stop: int) -> None:
        if stop > start:
            names.add(threading.current_thread().name)
            barrier.wait(timeout=10)

    run(meet, 3 * threads, (), tile=1)
    assert threading.current_thread().name in names
    assert len(names) == threads


def test_wrong_counts_and_tiles_are_named():
    with pytest.raises(ValueError, match="count: expected an integer of at least 0, got -1"):
        run(add_cubes, -1, (), tile=1)
    with pytest.raises(ValueError, match="tile: expected an integer of at least 1, got 0"):
        run(add_cubes, 1, (), tile=0)
    with pytest.raises(TypeError, match="count: expected an integer"):
        run(add_cubes, 1.5, (), tile=1)
    for least in (0, 5):
        with pytest.raises(ValueError, match=f"least: expected an integer of at least 1 and at most 4, got {least}"):
            run(add_cubes, 1, (), tile=4, least=least)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_exception_stops_the_rest_and_is_raised_again(threads):
    torch.set_num_threads(threads)
    visited = []

    def fail_at_five(start: int, stop: int) -> None:
        if start == 5:
            raise ArithmeticError("five")
        if stop > start:
            visited.append(start)
            time.sleep(0.002)

    with pytest.raises(ArithmeticError, match="five"):
        run(fail_at_five, 1000, (), tile=1)
    visited_then = len(visited)
    assert visited_then < 500
    time.sleep(0.02)
    assert len(visited) == visited_then  # nothing went on in the background
    assert np.array_equal(cubes(100, 10), np.arange(100) ** 3)  # and the pool still works


def test_an_exception_of_a_helping_thread_reaches_the_caller():
    caller = threading.current_thread()
    helping = threading.Event()
    visited = []

    def fail_elsewhere(start: int, stop: int) -> None:
        if threading.current_thread() is not caller:
            helping.set()
            raise ArithmeticError("elsewhere")
        if stop > start:
            assert helping.wait(timeout=10)
            visited.append(start)
            time.sleep(0.002)

    with pytest.raises(ArithmeticError, match="elsewhere"):
        run(fail_elsewhere, 1000, (), tile=1)
    assert len(visited) < 500


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_progress_rises_to_the_count_in_the_callers_thread(threads):
    torch.set_num_threads(threads)
    caller = threading.current_thread()
    reports = []

    def report(done: int) -> None:
        assert threading.current_thread() is caller
        reports.append(done)

    run(lambda start, stop: time.sleep(0.01 * (stop - start)), 80, (), tile=3, progress=report)
    assert reports == sorted(set(reports))
    assert len(reports) >= 2  # 0.8 s of work on at most four threads: at least one report before the last
    assert reports[-1] == 80
    empty = []
    run(add_cubes, 0, (np.zeros(0, dtype=np.int64),), tile=1, progress=empty.append)
    assert empty == [0]


def test_an_exception_of_the_progress_callback_stops_the_run():
    visited = []

    def stop_at_once(done: int) -> None:
        raise StopAsyncIteration(done)

    def work(start: int, stop: int) -> None:
        visited.append(start)
        time.sleep(0.01 * (stop - start))

    with pytest.raises(StopAsyncIteration):
        run(work, 500, (), tile=1, progress=stop_at_once)
    assert len(visited) < 250


def test_a_bar_appears_only_after_a_second(capsys):
    before = threading.enumerate()
    run(add_cubes, 10, (np.zeros(10, dtype=np.int64),), tile=1, progress=True, description="short")
    assert capsys.readouterr().err == ""
    with reporting(True, 6, "long", unit="pass") as report:
        for done in range(1, 7):
            time.sleep(0.25)
            report(done)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "long: 100%" in captured.err
    assert "6.00/6.00" in captured.err
    assert "pass/s" in captured.err
    started = [thread for thread in threading.enumerate() if thread not in before]
    assert not [thread for thread in started if type(thread).__name__ == "TMonitor"]


@pytest.mark.parametrize("silence", [None, False])
def test_silence(silence, capsys):
    run(lambda start, stop: time.sleep(0.06 * (stop - start)), 40, (), tile=1, progress=silence)
    assert capsys.readouterr() == ("", "")


def test_callers_side_by_side():
    def many(_: int) -> bool:
        return all(np.array_equal(cubes(501, 5), np.arange(501) ** 3) for _ in range(50))

    for threads in (2, 4, 3):  # the pool grows while others use it
        torch.set_num_threads(threads)
        with ThreadPoolExecutor(6) as callers:
            assert all(callers.map(many, range(6), timeout=60))
        helpers = [thread for thread in threading.enumerate() if thread.name.startswith("fovden")]
        assert len(helpers) <= 3 + 1  # one shared pool; those of the smaller one that it replaced are gone


def test_a_busy_pool_does_not_hold_up_another_caller(monkeypatch):
    monkeypatch.setattr("fovden.parallel._POOL", _Pool())  # which gets one helping thread, for the first caller
    release, started = threading.Event(), threading.Barrier(3)
    released = []

    def block(start: int, stop: int) -> None:
        if stop > start:
            started.wait(timeout=10)
            release.wait(timeout=10)
            released.append(start)

    busy = threading.Thread(target=run, args=(block, 2, ()), kwargs={"tile": 1})
    busy.start()
    started.wait(timeout=10)  # the other caller and the only helping thread are both stuck now
    try:
        assert np.array_equal(cubes(100, 10), np.arange(100) ** 3)
        assert released == []  # it had no help, and waited for none
    finally:
        release.set()
        busy.join()


class Cubes(Dataset):
    def __len__(self) -> int:
        return 3

    def __getitem__(self, index: int) -> tuple[np.ndarray, int, int]:
        return cubes(1000 + index, 10)[-5:], torch.get_num_threads(), os.getpid()


@forks
def test_a_forked_dataloader_worker_after_its_parent():
    cubes(1000, 10)
    loader = DataLoader(Cubes(), batch_size=None, num_workers=1, multiprocessing_context="fork", timeout=30)
    for index, (last, threads, process) in enumerate(loader):
        assert process != os.getpid()
        assert threads == 1
        assert last.tolist() == [item**3 for item in range(995 + index, 1000 + index)]


def _cubes_on_two_threads(connection) -> None:
    torch.set_num_threads(2)
    barrier = threading.Barrier(2)
    run(lambda start, stop: barrier.wait(timeout=10) if stop > start else None, 2, (), tile=1)
    connection.send(cubes(1000, 10))


@forks
def test_a_forked_child_makes_a_pool_of_its_own():
    cubes(1000, 10)
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    child = context.Process(target=_cubes_on_two_threads, args=(there,))
    child.start()
    try:
        assert here.poll(30)
        assert np.array_equal(here.recv(), np.arange(1000) ** 3)
        child.join(10)
        assert child.exitcode == 0
    finally:
        child.kill()
    assert np.array_equal(cubes(1000, 10), np.arange(1000) ** 3)  # the parent's pool is as it was


INTERRUPTED = """
    import sys, threading, time
    import numba, numpy as np, torch
    from fovden.parallel import run

    @numba.njit(nogil=True)
    def spin(start, stop, out):
        for item in range(start, stop):
            for turn in range(40_000_000):  # some tens of milliseconds, which no compiler can shorten
                out[item] = (out[item] * 1664525 + turn) & 0xFFFFFFFF

    torch.set_num_threads(int(sys.argv[1]))
    out = np.zeros(100_000, dtype=np.int64)
    spin(0, 0, out)
    print("running", flush=True)
    try:
        run(spin, len(out), (out,), tile=1)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
        before = out.copy()
        time.sleep(0.3)
        assert (out == before).all(), "a thread went on"
        out = np.zeros(4, dtype=np.int64)
        run(spin, 4, (out,), tile=1)
        assert (out != 0).all(), "no more runs possible"
        print("clean", flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for a single process")
@pytest.mark.parametrize("threads", [1, 2])
def test_ctrl_c_stops_within_a_second_and_leaves_nothing_running(threads):
    program = [sys.executable, "-c", textwrap.dedent(INTERRUPTED), str(threads)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "running\n"
            time.sleep(0.5)
            process.send_signal(signal.SIGINT)
            sent = time.monotonic()
            assert process.stdout.readline() == "interrupted\n"
            assert time.monotonic() - sent < 1
            assert process.stdout.readline() == "clean\n"
            assert process.wait(timeout=10) == 0
            assert process.stderr.read() == ""
        finally:
            process.kill()
