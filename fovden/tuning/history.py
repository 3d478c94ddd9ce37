"""The course of a fit: losses and parameters, step by step, as a table."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from fovden.checks import require
from fovden.io import atomic_write

__all__ = ["HISTORY", "Record", "read_history", "write_history"]

HISTORY = "history.csv"
"""Name of the table in the folder of a fit."""

COLUMNS = ("step", "loss", "held_out_loss", "seconds")


@dataclass(frozen=True)
class Record:
    """The state of a fit after a number of steps.

    Attributes:
        step: Number of steps made.
        loss: Mean loss of the last step's batch, with the parameters from before the step; NaN at step 0.
        held_out_loss: Mean loss of the frames held out, with the parameters of now; NaN where it was not measured.
        seconds: Wall time since the beginning, over all sessions.
        parameters: The learnable numbers by name, see :func:`fovden.tuning.readable`.

    Example:
        >>> Record(0, math.nan, 0.25, 1.5, {"sigma_radiance": 8.0}).held_out_loss
        0.25
    """

    step: int
    loss: float
    held_out_loss: float
    seconds: float
    parameters: dict[str, float] = field(default_factory=dict)


def write_history(folder: str | os.PathLike[str], records: Iterable[Record]) -> None:
    """Writes the table ``history.csv``, one row per record, one column per parameter.

    Args:
        folder: An existing folder.
        records: The records.

    Example:
        >>> import tempfile
        >>> folder = tempfile.mkdtemp()
        >>> write_history(folder, [Record(1, 0.5, math.nan, 2.0, {"sigma_radiance": 8.0})])
        >>> print((Path(folder) / "history.csv").read_text().strip())
        step,loss,held_out_loss,seconds,sigma_radiance
        1,0.5,,2.0,8.0
    """
    records = list(records)
    names = list(dict.fromkeys(name for record in records for name in record.parameters))
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow([*COLUMNS, *names])
    for record in records:
        numbers = [
            record.loss,
            record.held_out_loss,
            record.seconds,
            *(record.parameters.get(n, math.nan) for n in names),
        ]
        writer.writerow([record.step, *("" if math.isnan(number) else repr(number) for number in numbers)])
    with atomic_write(Path(folder) / HISTORY) as temporary:
        temporary.write_text(table.getvalue(), encoding="utf-8")


def read_history(folder: str | os.PathLike[str]) -> list[Record]:
    """Returns the records that :func:`fovden.tuning.history.write_history` wrote, to the bit.

    Args:
        folder: The folder.

    Returns:
        The records, in order.

    Raises:
        FileNotFoundError: If there is no table.
        ValueError: If it is not one of these.

    Example:
        >>> import tempfile
        >>> folder = tempfile.mkdtemp()
        >>> write_history(folder, [Record(1, 0.1, 0.2, 2.0, {"sigma_radiance": 8.0})])
        >>> read_history(folder)
        [Record(step=1, loss=0.1, held_out_loss=0.2, seconds=2.0, parameters={'sigma_radiance': 8.0})]
    """
    path = Path(folder) / HISTORY
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = [*csv.reader(file)] or [[]]
    require(tuple(header[:4]) == COLUMNS, str(path), header[:4], f"columns {', '.join(COLUMNS)}")
    records = []
    for line, row in enumerate(rows, start=2):
        require(len(row) == len(header), f"{path}, line {line}", f"{len(row)} cells", f"{len(header)}")
        try:
            numbers = [float(cell) if cell else math.nan for cell in row]
        except ValueError as error:
            raise ValueError(f"{path}, line {line}: expected numbers, got {row}") from error
        named = {name: number for name, number in zip(header[4:], numbers[4:], strict=True) if not math.isnan(number)}
        records.append(Record(int(numbers[0]), numbers[1], numbers[2], numbers[3], named))
    return records
