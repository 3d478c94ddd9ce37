"""The folder of one run: what was asked for, where and how it ran, and every number that came out.

``config.json``
    the settings, complete enough to repeat the run
``provenance.json``
    versions, processor, threads, commit where there is one, command, start, end, seconds of each stage
``metrics.csv``
    the results in long form, one number per row

Each file is written whole or not at all; a run that was interrupted has no ``metrics.csv``, and its provenance says so.
"""

from __future__ import annotations

import csv
import io as text_io
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import torch

from fovden.checks import require
from fovden.io import atomic_write

__all__ = ["Measurement", "Run", "provenance", "read_config", "read_metrics", "read_provenance"]

PACKAGES = ("fovden", "torch", "numpy", "numba", "llvmlite", "kornia", "scikit-image", "trimesh", "OpenEXR")


class Measurement(NamedTuple):
    """One number of a run: one row of ``metrics.csv``.

    Attributes:
        scene: Name of the scene.
        frame: Number of the frame.
        view: Number of the view, 0 is the left eye; empty where the number is about all of them.
        method: Name of the method.
        region: ``"whole"``, or ``"layer 0"`` and so on.
        metric: Name of the metric, or of a cost such as ``"paths"`` or ``"seconds_denoise"``.
        value: The number.

    Example:
        >>> Measurement("atrium", 0, 1, "NH3LD", "whole", "ssim", 0.95).metric
        'ssim'
    """

    scene: str
    frame: int
    view: int | str
    method: str
    region: str
    metric: str
    value: float


class Run:
    """Writes a run's folder; use it as a context manager.

    Args:
        folder: The folder; made if it does not exist, together with those above it.
        config: The settings: a dataclass or a mapping that JSON can hold.

    Attributes:
        folder: The folder.
        measurements: The rows of ``metrics.csv`` so far.
        seconds: Wall time of each stage so far.

    Example:
        >>> import tempfile
        >>> with Run(tempfile.mkdtemp(), {"spp": 4}) as run:
        ...     with run.stage("nothing"):
        ...         pass
        ...     run.measurements.append(Measurement("atrium", 0, 0, "Base", "whole", "psnr", 30.5))
        >>> read_metrics(run.folder)[0].value
        30.5
    """

    def __init__(self, folder: str | os.PathLike[str], config: Any) -> None:
        self.folder = Path(folder)
        self.measurements: list[Measurement] = []
        self.seconds: dict[str, float] = {}
        self._config = asdict(config) if is_dataclass(config) and not isinstance(config, type) else config
        self._began = time.perf_counter()
        self._provenance = provenance()

    def __enter__(self) -> Run:
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "metrics.csv").unlink(missing_ok=True)
        self.write_json("config.json", self._config)
        self._write_provenance("running")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            table = text_io.StringIO()
            writer = csv.writer(table, lineterminator="\n")
            writer.writerow(Measurement._fields)
            writer.writerows(self.measurements)
            with atomic_write(self.folder / "metrics.csv") as temporary:
                temporary.write_text(table.getvalue(), encoding="utf-8")
        self._write_provenance("finished" if kind is None else f"stopped by {kind.__name__}")

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measures the wall time of a block and keeps it in the provenance.

        Args:
            name: Name of the stage; a stage that is entered twice counts both times.

        Example:
            >>> import tempfile
            >>> run = Run(tempfile.mkdtemp(), {})
            >>> with run.stage("sum"):
            ...     total = sum(range(10))
            >>> run.seconds["sum"] > 0
            True
        """
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began

    def write_json(self, name: str, data: Mapping[str, Any]) -> None:
        """Writes a JSON file into the folder.

        Args:
            name: Name of the file.
            data: What JSON can hold.

        Example:
            >>> import tempfile
            >>> run = Run(tempfile.mkdtemp(), {})
            >>> run.write_json("note.json", {"exposure": 0.5})
            >>> json.loads((run.folder / "note.json").read_text())
            {'exposure': 0.5}
        """
        with atomic_write(self.folder / name) as temporary:
            temporary.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")

    def _write_provenance(self, state: str) -> None:
        elapsed = time.perf_counter() - self._began
        seconds = {name: round(value, 4) for name, value in self.seconds.items()}
        ended = {"state": state, "wall_seconds": round(elapsed, 3), "seconds": seconds}
        self.write_json("provenance.json", {**self._provenance, **ended})


def provenance() -> dict[str, Any]:
    """Returns where and with what a run is made: versions, processor, threads, commit, command and the time now.

    The commit is given only where the package is imported from a checkout of its own repository.

    Returns:
        Values that JSON can hold.

    Example:
        >>> sorted(provenance())[:4]
        ['command', 'commit', 'device', 'modified']
    """
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed as a package"
    commit, modified = _commit()
    return {
        "command": [_script(sys.argv[0]), *sys.argv[1:]],
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions,
        "device": _processor(),
        "platform": platform.platform(),
        "threads": torch.get_num_threads(),
        "commit": commit,
        "modified": modified,
    }


def _script(path: str) -> str:
    """The path of what was run, from the working folder where it lies in it."""
    try:
        return str(Path(path).resolve().relative_to(Path.cwd()))
    except ValueError:
        return path


def read_config(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Reads the settings of a run.

    Args:
        folder: The run's folder.

    Returns:
        The contents of ``config.json``.

    Raises:
        FileNotFoundError: If the folder holds no run.
        ValueError: If the file is damaged.

    Example:
        >>> import tempfile
        >>> with Run(tempfile.mkdtemp(), {"spp": 4}) as run:
        ...     pass
        >>> read_config(run.folder)
        {'spp': 4}
    """
    return _read_json(folder, "config.json")


def read_provenance(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Reads where, when and with what a run was made.

    Args:
        folder: The run's folder.

    Returns:
        The contents of ``provenance.json``: what :func:`provenance` gave at its start, its state and its times.

    Raises:
        FileNotFoundError: If the folder holds no run.
        ValueError: If the file is damaged.

    Example:
        >>> import tempfile
        >>> with Run(tempfile.mkdtemp(), {"spp": 4}) as run:
        ...     pass
        >>> read_provenance(run.folder)["state"]
        'finished'
    """
    return _read_json(folder, "provenance.json")


def read_metrics(folder: str | os.PathLike[str]) -> list[Measurement]:
    """Reads every number of a run.

    Args:
        folder: The run's folder.

    Returns:
        The rows of ``metrics.csv``.

    Raises:
        FileNotFoundError: If the folder holds no finished run.
        ValueError: If the table is damaged.

    Example:
        >>> import tempfile
        >>> with Run(tempfile.mkdtemp(), {}) as run:
        ...     run.measurements.append(Measurement("atrium", 0, "", "Base", "whole", "paths", 16.0))
        >>> read_metrics(run.folder)
        [Measurement(scene='atrium', frame=0, view='', method='Base', region='whole', metric='paths', value=16.0)]
    """
    path = _existing(folder, "metrics.csv")
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file)) or [[]]
    try:
        if tuple(header) != Measurement._fields:
            raise ValueError(f"columns {header}")
        return [
            Measurement(scene, int(frame), int(view) if view else "", method, region, metric, float(value))
            for scene, frame, view, method, region, metric, value in rows
        ]
    except ValueError as error:
        expected = ", ".join(Measurement._fields)
        raise ValueError(f"{path}: expected a table with the columns {expected} ({error})") from error


def _read_json(folder: str | os.PathLike[str], name: str) -> dict[str, Any]:
    path = _existing(folder, name)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: expected JSON ({error})") from error
    require(isinstance(content, dict), str(path), type(content).__name__, "a mapping")
    return dict(content)


def _existing(folder: str | os.PathLike[str], name: str) -> Path:
    path = Path(folder) / name
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; expected the folder of a finished run")
    return path


def _processor() -> str:
    """The processor's name, as the system tells it."""
    listing = Path("/proc/cpuinfo")
    if listing.is_file():
        for line in listing.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _commit() -> tuple[str | None, bool | None]:
    """The commit of the package's own checkout, and whether it was changed since."""
    package = Path(__file__).resolve().parent

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(package), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != package.parent:
            return None, None
        return git("rev-parse", "HEAD"), bool(git("status", "--porcelain"))
    except (OSError, subprocess.SubprocessError):
        return None, None
