"""What the scripts have in common: a preset is chosen by name, and the results go to a folder.

The folder itself is written by :class:`fovden.results.Run`: ``config.json``, ``provenance.json`` and ``metrics.csv`` in
long form, from which, with the images beside it, the figures can be drawn again.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

__all__ = ["run_script", "timed"]

Settings = TypeVar("Settings")
Result = TypeVar("Result")


def timed(
    call: Callable[[], Result], repeats: int = 1, clock: Callable[[], float] = time.perf_counter
) -> tuple[float, Result]:
    """Returns the median of the seconds that a call takes, and what it returned last.

    Args:
        call: What is timed.
        repeats: How often it is called, at least once.
        clock: What counts seconds: of the wall, or with ``time.thread_time`` of the processor, for one thread.

    Returns:
        Seconds, and the result.

    Example:
        >>> seconds, three = timed(lambda: 3, repeats=5)
        >>> seconds < 1, three
        (True, 3)
    """
    seconds = []
    for _ in range(repeats):
        began = clock()
        result = call()
        seconds.append(clock() - began)
    return statistics.median(seconds), result


def run_script(
    name: str,
    question: str,
    presets: Mapping[str, Callable[[], Settings]],
    run: Callable[[Settings, Path], None],
    arguments: Sequence[str] | None = None,
) -> int:
    """Parses ``--preset`` and ``-o``, runs the experiment, and returns the exit status.

    Args:
        name: The script's name; results go to ``out/<name>/<preset>`` unless another folder is given.
        question: What the experiment answers, shown by ``--help``.
        presets: Makers of settings by name; the first is the default.
        run: The experiment: settings and folder in, files out.
        arguments: The words after the script's name; ``None`` for those of the process.

    Returns:
        0 if all went well, 2 after bad input, 130 after Ctrl-C.

    Example:
        >>> run_script("count", "How many?", {"smoke": lambda: 3}, lambda number, folder: print(number, folder), [])
        3 out/count/smoke
        0
    """
    parser = argparse.ArgumentParser(prog=f"{name}.py", description=question)
    default = next(iter(presets))
    parser.add_argument("--preset", choices=list(presets), default=default, help=f"size; default: {default}")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help=f"default: out/{name}/PRESET")
    options = parser.parse_args(arguments)
    folder = options.output or Path("out") / name / options.preset
    try:
        run(presets[options.preset](), folder)
    except KeyboardInterrupt:
        sys.stderr.write(f"\n{name}: interrupted; what {folder} holds so far is kept\n")
        return 130
    except (OSError, ValueError) as error:
        sys.stderr.write(f"{name}: error: {error}\n")
        return 2
    return 0
