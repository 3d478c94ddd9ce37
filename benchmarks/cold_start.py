"""From a new process to the first pixel: with an empty cache of compiled kernels, and with a full one.

``first_pixel.py`` runs in processes of its own, on one thread: it imports torch, then fovden, and traces one frame of
the Cornell box. Cold starts have a cache folder of their own that is empty (``NUMBA_CACHE_DIR``), warm starts have the
one that a cold start has filled. Wall time is what a user waits; processor time is what it is on a machine that does
nothing else. The last table names the kernels that a cold start compiles; what they call is part of each.

With ``--quick`` there are warm starts alone, from the cache that is there.

    python -m benchmarks.cold_start
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import harness
from benchmarks.harness import Table, say

ROOT = Path(__file__).resolve().parents[1]
STAGES = {"torch": "import torch", "fovden": "import fovden", "frame": "first frame"}


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each start: whether it was cold, its seconds, kernels, and lines on standard error."""
    results = []
    for turn in range(options.rounds):
        say(f"round {turn + 1} of {options.rounds}")
        if options.quick:
            results.append({"cold": False, **start(os.environ)})
            continue
        with tempfile.TemporaryDirectory() as cache:
            environment = os.environ | {"NUMBA_CACHE_DIR": cache}
            results += [{"cold": cold, **start(environment)} for cold in (True, False)]
    return results


def start(environment: Any) -> dict[str, Any]:
    """Returns what one process measured, and what it said it was compiling.

    Raises:
        ValueError: If it failed.
    """
    command = [sys.executable, "-m", "benchmarks.first_pixel"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ValueError(f"the process failed:\n{done.stderr}")
    said = [line.split(" (")[0] for line in done.stderr.splitlines() if line.startswith("fovden: compiling")]
    return {**json.loads(done.stdout), "said": said}


def tables(data: harness.Data) -> list[Table]:
    """Returns the starts by stage, and the kernels of a cold one."""
    cold, warm = ([each for each in data["results"] if each["cold"] is wanted] for wanted in (True, False))
    header = ["start", *STAGES.values(), "on top of torch", "CPU time on top of torch"]
    rows = []
    for name, starts in (("cold, an empty cache", cold), ("warm, a full cache", warm)):
        if starts:
            on_top = [_median(sum(each[clock][stage] for stage in ("fovden", "frame")) for each in starts)
                      for clock in ("wall", "cpu")]  # fmt: skip
            stages = [_median(each["wall"][stage] for each in starts) for stage in STAGES]
            rows.append([name, *(f"{seconds:.2f}" for seconds in (*stages, *on_top))])
    found = [Table("Seconds to the first pixel", header, rows)]
    if cold:
        kernels = {name: _median(each["kernels"][name] for each in cold) for name in cold[0]["kernels"]}
        listed = [[name, f"{value:.2f}"] for name, value in sorted(kernels.items(), key=lambda pair: -pair[1])]
        total = ["all", f"{sum(kernels.values()):.2f}"]
        found.append(Table("Kernels that a cold start compiles", ["kernel", "CPU seconds"], [*listed, total]))
    return found


def _median(values: Any) -> float:
    return statistics.median(list(values))


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    said = max((each["said"] for each in data["results"]), key=len)
    lines = (
        f" While a user waits for longer than a second, a line says what for; here {len(said)} lines." if said else ""
    )
    return f"The Cornell box on one thread; medians of {data['config']['rounds']} rounds.{lines} "


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("cold_start", description=__doc__, formatter_class=form)
    return harness.run("cold_start", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
