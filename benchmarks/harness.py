"""What the benchmarks have in common: alternating rounds, results as JSON with their provenance, tables.

A benchmark is a module with ``measure`` (options in, results out), ``tables`` and ``note`` (results in, text out) and a
``main``. The results are one JSON file::

    {"benchmark": "rays", "config": {...}, "provenance": {...}, "results": [{...}, ...]}

``config`` repeats the options, ``provenance`` is :func:`fovden.results.provenance` with the peers' versions and the
load of the machine, and each result holds the times of every round, so that medians and spreads are made from what was
measured. The documentation prints the same tables from the same files.
"""
# ruff: noqa: T201

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import torch
from matplotlib.figure import Figure

from fovden.io import atomic_write
from fovden.results import provenance

__all__ = [
    "RESULTS",
    "Table",
    "Times",
    "add_run_options",
    "alternate",
    "available",
    "compared",
    "load",
    "positive",
    "run",
    "say",
    "threads",
]

RESULTS = Path(__file__).parent / "results"
ROUNDS, FEWEST_ROUNDS = 7, 5
PICTURE_DPI = 160
PEERS = ("open3d", "embreex", "mitsuba", "drjit", "flip-evaluator", "kornia", "opencv-contrib-python-headless")

Times = dict[str, list[float]]
"""Seconds of every round: ``"wall"``, and ``"cpu"`` of all threads together."""

Data = Mapping[str, Any]
"""What a results file holds."""


class Table(NamedTuple):
    """A table as text.

    Attributes:
        title: What it shows.
        header: Titles of the columns.
        rows: One list of cells for each row.
    """

    title: str
    header: list[str]
    rows: list[list[str]]


# Measuring


def alternate(calls: Mapping[str, Callable[[], object]], rounds: int, *, repeat: bool = False) -> dict[str, Times]:
    """Returns the times of each call in each round.

    The calls take turns, so that a change of the machine's speed meets all of them; one round is made beforehand,
    uncounted: kernels are compiled and memory is touched in it. What a call returns is released outside the timed
    region.

    Calls of some milliseconds ``repeat``: each is made once more right before, uncounted, as who calls it in a loop
    finds it. Otherwise it would pay for what another leaves behind: what PyTorch has freed goes back to the system when
    somebody frees memory next, and that has taken 12 ms where the call itself took 20.
    """
    times: dict[str, Times] = {name: {"wall": [], "cpu": []} for name in calls}
    for turn in range(rounds + 1):
        for name, call in calls.items():
            if repeat:
                call()
            gc.collect()
            wall, processor = time.perf_counter(), time.process_time()
            result = call()
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            del result
            if turn > 0:
                times[name]["wall"].append(wall)
                times[name]["cpu"].append(processor)
    return times


def compared(own: Times, theirs: Times) -> list[str]:
    """Returns the median ratio of their wall time to ours, its lowest and highest, and that of processor time."""
    wall, cpu = ([b / a for a, b in zip(own[clock], theirs[clock], strict=True)] for clock in ("wall", "cpu"))
    return [f"{statistics.median(wall):.2f}", f"{min(wall):.2f} to {max(wall):.2f}", f"{statistics.median(cpu):.2f}"]


COMPARED = ["ratio", "lowest to highest", "ratio, CPU time"]
"""Titles of the columns of :func:`compared`."""


def available(*peers: str) -> list[str]:
    """Returns which of the peers can be imported; names the others on standard error."""
    found = [peer for peer in peers if find_spec(peer) is not None]
    for peer in peers:
        if peer not in found:
            say(f"{peer} is not installed and is left out; see benchmarks/README.md")
    return found


def threads() -> int:
    """Returns how many threads use all cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def say(text: str) -> None:
    """Writes a line of progress to standard error."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


# Files


def load(path: Path) -> dict[str, Any]:
    """Reads a results file.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is not a results file.
    """
    found = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(found, dict) or not {"benchmark", "config", "provenance", "results"} <= found.keys():
        raise ValueError(f"{path}: expected the results of a benchmark, with benchmark, config, provenance and results")
    return found


def machine(data: Data) -> str:
    """Returns the sentence that says where, with what and how busy the machine was."""
    origin = data["provenance"]
    versions = origin["versions"]
    named = ", ".join(f"{name} {versions[name]}" for name in ("fovden", "torch", "numba", *PEERS) if name in versions)
    commit = f" at {origin['commit'][:9]}" if origin["commit"] else ""
    load = f" The load of the machine was {origin['load']:.1f} when it began." if "load" in origin else ""
    return f"Measured on {origin['device']}, {origin['cores']} cores: {named}{commit}.{load}"


def _save(path: Path, name: str, arguments: Sequence[str], options: argparse.Namespace, results: list[Any]) -> None:
    installed = {distribution.metadata["Name"] for distribution in metadata.distributions()}
    versions = {peer: metadata.version(peer) for peer in PEERS if peer in installed}
    origin = provenance() | {"command": ["python", "-m", f"benchmarks.{name}", *arguments], "cores": threads()}
    origin["versions"] |= versions
    origin["load"] = options.load
    hidden = ("output", "load", "show", "picture")
    config = {key: value for key, value in vars(options).items() if key not in hidden}
    data = {"benchmark": name, "config": config, "provenance": origin, "results": results}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


# Command line


def positive(text: str) -> int:
    """Reads a whole number of at least 1 from the command line."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text}")
    return number


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Adds what every benchmark takes."""
    parser.add_argument(
        "--rounds", type=positive, metavar="N",
        help=f"timed rounds, of which medians count: at least {FEWEST_ROUNDS} (default {ROUNDS}), or 1 with --quick",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="a small version, which says whether it runs")
    parser.add_argument("--show", action="store_true", help="print the tables of the saved results, measure nothing")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: benchmarks/results/NAME.json, "
                        "with --quick out/benchmarks/NAME.json")  # fmt: skip


def run(
    name: str,
    parser: argparse.ArgumentParser,
    measure: Callable[[argparse.Namespace], list[Any]],
    tables: Callable[[Data], list[Table]],
    note: Callable[[Data], str],
    arguments: Sequence[str] | None = None,
    draw: Callable[[Data], Figure] | None = None,
) -> int:
    """Reads the command line, measures, saves, prints and draws.

    Args:
        name: The module's name within ``benchmarks``.
        parser: Its options.
        measure: Options in, results out; may raise ``ValueError`` to say what cannot be measured.
        tables: The tables of the results.
        note: What was measured, in sentences.
        arguments: The words after the script's name; ``None`` for those of the process.
        draw: The figure of the results; it goes to the file that the option ``--picture`` names, with ``--quick`` into
            the folder of the results.

    Returns:
        The exit status: 0, 2 after bad input, 130 after Ctrl-C.
    """
    add_run_options(parser)
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    options = parser.parse_args(arguments)
    if options.rounds is None:
        options.rounds = 1 if options.quick else ROUNDS
    elif options.rounds < FEWEST_ROUNDS and not options.quick:
        parser.error(f"--rounds: expected at least {FEWEST_ROUNDS}, or --quick, got {options.rounds}")
    path = options.output or (Path("out", "benchmarks") if options.quick else RESULTS) / f"{name}.json"
    try:
        if not options.show:
            options.load = os.getloadavg()[0]
            before = torch.get_num_threads()
            try:
                results = measure(options)
            finally:
                torch.set_num_threads(before)
            _save(path, name, arguments, options, results)
        data = load(path)
    except KeyboardInterrupt:
        say(f"\n{name}: interrupted, nothing was written")
        return 130
    except (OSError, ValueError, ImportError) as error:
        say(f"{name}: error: {error}")
        return 2
    for table in tables(data):
        print(f"\n{table.title}\n{_plain(table)}")
    print(f"\n{note(data)}\n{machine(data)}\n{path}")
    if draw is not None:
        picture = path.with_suffix(".png") if options.quick else options.picture
        with atomic_write(picture) as temporary:
            draw(data).savefig(temporary, format="png", dpi=PICTURE_DPI)
        print(picture)
    return 0


def _plain(table: Table) -> str:
    """A table in columns: names to the left, figures to the right."""
    lines = [table.header, *table.rows]
    widths = [max(len(line[column]) for line in lines) for column in range(len(table.header))]
    return "\n".join(
        "  ".join(cell.ljust(width) if column == 0 else cell.rjust(width)
                  for column, (cell, width) in enumerate(zip(line, widths, strict=True))).rstrip()
        for line in lines
    )  # fmt: skip
