"""The tables of a report."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from fovden.checks import require
from fovden.metrics import METRICS, Score

__all__ = ["Cell", "Column", "Table", "quality_tables"]

DETAILED = ("psnr", "ssim", "flip")  # the metrics that are given for every layer and every eye

Value = str | float | None


class Column(NamedTuple):
    """One column of a table.

    Attributes:
        title: What stands above it.
        format: Format of its numbers, such as ``".4f"``; empty for a column of words.
        better: Which end is better, if any; the best value is set in bold.

    Example:
        >>> Column("SSIM", ".4f", "higher").better
        'higher'
    """

    title: str
    format: str = ""
    better: Literal["", "higher", "lower"] = ""


class Cell(NamedTuple):
    """One cell as the page shows it: its text, its number in full, and its classes in the style sheet."""

    text: str
    value: str | None
    classes: str


@dataclass(frozen=True)
class Table:
    """A table that the page can sort and copy.

    Attributes:
        title: Its heading.
        columns: Its columns.
        rows: One value for each column: a string, a number, or ``None`` where there is none.
        note: A line below.

    Raises:
        ValueError: If a row has more or fewer values than there are columns.

    Example:
        >>> table = Table("Quality", (Column("method"), Column("PSNR", ".2f", "higher")), (("Base", 30), ("NH3LD", 28)))
        >>> table.cells()[0]
        [Cell(text='Base', value=None, classes=''), Cell(text='30.00', value='30.0', classes='number best')]
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Value]]
    note: str = ""

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows):
            require(len(row) == len(self.columns), f"rows[{number}]", list(row), f"{len(self.columns)} values")

    def cells(self) -> list[list[Cell]]:
        """Returns the cells as the page shows them, row by row.

        Example:
            >>> Table("Time", (Column("s", ".1f"),), ((None,), (2,))).cells()
            [[Cell(text='', value=None, classes='number')], [Cell(text='2.0', value='2.0', classes='number')]]
        """
        best = [self._best(index) for index in range(len(self.columns))]
        return [
            [
                _cell(value, column, best[index])
                for index, (value, column) in enumerate(zip(row, self.columns, strict=True))
            ]
            for row in self.rows
        ]

    def _best(self, index: int) -> str | None:
        """The best value of a column as it is shown, so that what looks equal is equally good."""
        column = self.columns[index]
        values = [row[index] for row in self.rows]
        numbers = [float(value) for value in values if isinstance(value, int | float) and not math.isnan(value)]
        if not column.better or len(numbers) < 2:
            return None
        return _shown(max(numbers) if column.better == "higher" else min(numbers), column)


def quality_tables(scores: Iterable[Score], *, eyes: Sequence[str], note: str = "") -> list[Table]:
    """Returns the scores of a comparison as tables: the means over the eyes, each layer, each eye.

    Args:
        scores: Numbers in long form: :attr:`fovden.metrics.Comparison.scores`.
        eyes: Names of the views.
        note: The line below the first table.

    Returns:
        One table, and one more where there are layers, and one more where there are several views.

    Example:
        >>> scores = [Score("Base", view, "whole", "psnr", 30.0 + view) for view in (0, 1)]
        >>> for table in quality_tables(scores, eyes=("left eye", "right eye")):
        ...     print(table.title, [column.title for column in table.columns], table.rows)
        Quality, mean of the eyes ['method', 'PSNR / dB'] (('Base', 30.5),)
        Quality by eye ['method', 'PSNR / dB, left eye', 'PSNR / dB, right eye'] (('Base', 30.0, 31.0),)
    """
    found: dict[tuple[str, str, str], dict[int, float]] = {}
    for score in scores:
        found.setdefault((score.method, score.metric, score.region), {})[score.view] = score.value
    methods = tuple(dict.fromkeys(method for method, _, _ in found))
    metrics = tuple(dict.fromkeys(metric for _, metric, _ in found))
    layers = sorted({region for _, _, region in found} - {"whole"}, key=lambda region: (len(region), region))

    def mean(metric: str, region: str) -> Callable[[str], Value]:
        def value(method: str) -> Value:
            views = found.get((method, metric, region))
            return statistics.fmean(views.values()) if views else None

        return value

    def single(metric: str, view: int) -> Callable[[str], Value]:
        return lambda method: found.get((method, metric, "whole"), {}).get(view)

    def table(title: str, columns: Sequence[tuple[Column, Callable[[str], Value]]], note: str = "") -> Table:
        rows = tuple((method, *(value(method) for _, value in columns)) for method in methods)
        return Table(title, (Column("method"), *(column for column, _ in columns)), rows, note)

    detailed = [metric for metric in metrics if metric in DETAILED]
    title = "Quality, mean of the eyes" if len(eyes) > 1 else "Quality"
    tables = [table(title, [(_column(metric), mean(metric, "whole")) for metric in metrics], note)]
    if layers and detailed:
        by_layer = [(_column(metric, layer), mean(metric, layer)) for metric in detailed for layer in layers]
        tables.append(table("Quality by layer", by_layer, "Layer 0 is the innermost, around the gaze."))
    if len(eyes) > 1 and detailed:
        by_eye = [(_column(metric, eye), single(metric, view)) for metric in detailed for view, eye in enumerate(eyes)]
        tables.append(table("Quality by eye", by_eye))
    return tables


def _column(metric: str, part: str = "") -> Column:
    if metric not in METRICS:
        return Column(f"{metric}, {part}" if part else metric, ".4g")
    title, style, better = METRICS[metric]
    return Column(f"{title}, {part}" if part else title, style, better)


def _cell(value: Value, column: Column, best: str | None) -> Cell:
    classes = "number" if column.format else ""
    if value is None or isinstance(value, str):
        return Cell(value or "", None, classes)
    number = float(value)
    text = _shown(number, column)
    full = "Infinity" if number == math.inf else "-Infinity" if number == -math.inf else repr(number)
    return Cell(text, full, f"{classes} best".strip() if best is not None and text == best else classes)


def _shown(number: float, column: Column) -> str:
    if math.isinf(number):
        return "∞" if number > 0 else "-∞"
    return format(number, column.format)
