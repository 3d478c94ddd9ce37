"""The results as a table to read."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

from fovden.metrics import METRICS
from fovden.results import Measurement

__all__ = ["summary"]

EXTRA_ROWS = ("Reference", "Foveation")  # rows of metrics.csv that are no method
Column = tuple[str, str, Callable[[str], float | None]]  # title, format, value of a method


def summary(measurements: Sequence[Measurement]) -> str:
    """Returns the results of a comparison as a table to read: the mean over the views, costs and speed-ups.

    Args:
        measurements: The rows of ``metrics.csv``.

    Returns:
        Several lines of text. Speed-ups are relative to Base, above 1 is faster.

    Example:
        >>> rows = [Measurement("box", 0, view, "Base", "whole", "psnr", 30.0 + view) for view in (0, 1)]
        >>> print(summary(rows).splitlines()[1].rstrip())
        Base         30.50
    """
    columns = _columns(measurements)
    methods = [name for name in dict.fromkeys(row.method for row in measurements) if name not in EXTRA_ROWS]
    lines = [("method", *(title for title, _, _ in columns))]
    for method in methods:
        cells = []
        for _, style, value in columns:
            number = value(method)
            cells.append("" if number is None else format(number, style))
        lines.append((method, *cells))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = [
        "  ".join(cell.rjust(width) if column else cell.ljust(width) for column, (cell, width) in enumerate(cells))
        for cells in (list(zip(line, widths, strict=True)) for line in lines)
    ]
    known = {row.metric: row.value for row in measurements if row.method == "Reference"}
    if known:
        text.append(
            f"Mean of both eyes; RMSE, PSNR, SSIM and FLIP after exposure {known['exposure']:.4g}, sRGB and clamp. "
            f"Reference: {known['samples']:.0f} samples per pixel, noise {known['standard_error']:.3g} (RMS)."
        )
        text.append("Seconds are medians; speed-ups compare paths (without the G-buffer) and the total with Base.")
    return "\n".join(line.rstrip() for line in text)


def _columns(measurements: Sequence[Measurement]) -> list[Column]:
    """Titles, formats and values of the summary's columns; only those for which there are measurements."""

    def mean(method: str, metric: str, region: str = "whole") -> float | None:
        wanted = (method, region, metric)
        found = [row.value for row in measurements if (row.method, row.region, row.metric) == wanted]
        return statistics.fmean(found) if found else None

    def plain(metric: str, region: str = "whole", scale: float = 1.0) -> Callable[[str], float | None]:
        def value(method: str) -> float | None:
            found = mean(method, metric, region)
            return None if found is None else found * scale

        return value

    def speed_up(metric: str) -> Callable[[str], float | None]:
        def value(method: str) -> float | None:
            base, own = mean("Base", metric), mean(method, metric)
            return base / own if base and own and mean(method, "seconds_denoise") else None

        return value

    regions = sorted({row.region for row in measurements if row.metric == "ssim"} - {"whole"})
    columns: list[Column] = [
        *((METRICS[metric].title, METRICS[metric].format, plain(metric)) for metric in ("rmse", "psnr", "ssim")),
        *((f"SSIM {region}", METRICS["ssim"].format, plain("ssim", region)) for region in regions),
        (METRICS["flip"].title, METRICS["flip"].format, plain("flip")),
        ("Mpaths", ".3f", plain("paths", scale=1e-6)),
        ("G-buffer s", ".3f", plain("seconds_gbuffer")),
        ("paths s", ".3f", plain("seconds_paths")),
        ("denoise s", ".3f", plain("seconds_denoise")),
        ("speed-up paths", ".2f", speed_up("seconds_paths")),
        ("total", ".2f", speed_up("seconds_total")),
    ]
    methods = {row.method for row in measurements}
    return [column for column in columns if any(column[2](method) is not None for method in methods)]
