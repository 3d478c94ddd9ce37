"""How much memory a process holds, as the system sees it; on Linux alone."""

from __future__ import annotations

import ctypes
import gc
from pathlib import Path

STATUS = Path("/proc/self/status")


def is_known() -> bool:
    """Returns whether this system says it."""
    return STATUS.is_file() and hasattr(ctypes.CDLL(None), "malloc_trim")


def settled() -> int:
    """Returns the bytes that the process holds once all that it has freed is given back to the system."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return _resident("VmRSS")


def forget_peak() -> None:
    """Lets the peak count from here."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak() -> int:
    """Returns the most bytes that the process has held."""
    return _resident("VmHWM")


def _resident(name: str) -> int:
    line = next(line for line in STATUS.read_text(encoding="ascii").splitlines() if line.startswith(name))
    return 1024 * int(line.split()[1])
