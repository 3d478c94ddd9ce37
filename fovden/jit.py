"""Compilation of kernels with Numba: the two decorators, where compiled code is kept, and what a wait is for.

No fast-math flag is set anywhere: an operation rounds as IEEE 754 says, comparisons treat NaN as it says, and products
are not fused into sums.

A kernel that takes longer than a second to compile is named on standard error while it does. What comes from the disk
takes milliseconds and says nothing.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import os
import shutil
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numba
from numba import config
from numba.core import event as events
from numba.core.registry import CPUDispatcher

from fovden._inlining import InliningCompiler

__all__ = ["Float", "Int", "inlined", "kernel", "vectorised"]

Function = TypeVar("Function", bound=Callable[..., Any])

Float: TypeAlias = Any
"""A float32 inside a kernel. To the type checker it is anything: Numba infers and checks types."""

Int: TypeAlias = Any
"""An integer inside a kernel, int64 unless it says otherwise."""

PACKAGE = Path(__file__).parent
ANNOUNCED_AFTER = 1.0  # seconds of compilation before its line; shorter waits stay silent


def vectorised() -> bool:
    """Returns whether kernels use vector intrinsics, or their plain twins because ``FOVDEN_SIMD`` is ``0``.

    Example:
        >>> vectorised() == (os.environ.get("FOVDEN_SIMD") != "0")
        True
    """
    return os.environ.get("FOVDEN_SIMD", "1") != "0"


def kernel(function: Function) -> Function:
    """Compiles a function on its first call, without the global interpreter lock, and keeps the code on disk.

    Division follows IEEE rules (x / 0 is infinite) and floating-point operations stay as written.

    Args:
        function: A module-level function of numbers, arrays and pointers.

    Returns:
        The compiled function.

    Example:
        >>> @kernel
        ... def add(a: float, b: float) -> float:
        ...     return a + b
        >>> add(1.0, 2.0)
        3.0
    """
    return _compiled(function)


def inlined(function: Function) -> Function:
    """Compiles like :func:`kernel`, and copies the code into every kernel that calls it.

    What Python would need to call it is compiled when Python does, and machine code is made of the copies alone, which
    takes a third off the time of a first start. On the disk the code is a part of the kernels.

    Args:
        function: A small module-level function.

    Returns:
        The compiled function.

    Example:
        >>> @inlined
        ... def double(a: float) -> float:
        ...     return a + a
        >>> double(2.0)
        4.0
    """
    compiled = _compiled(
        function, forceinline=True, no_cpython_wrapper=True, cache=False, pipeline_class=InliningCompiler
    )
    compiled.__class__ = _Inlined
    return compiled


class _Inlined(CPUDispatcher):  # type: ignore[misc]  # Numba has no types
    """A function that kernels copy; Python calls another compilation of it, since this one has no way in."""

    def __call__(self, *arguments: Any) -> Any:
        if "from_python" not in self.__dict__:
            self.from_python = numba.njit(nogil=True, error_model="numpy")(self.py_func)
        return self.from_python(*arguments)


def _compiled(function: Function, **wanted: Any) -> Function:
    # Numba looks at the folder's name while it decorates, so the setting is needed for that moment alone.
    before = config.CACHE_DIR
    config.CACHE_DIR = str(_cache_folder())
    try:
        on_disk = Path(function.__code__.co_filename).is_file()  # not so in a notebook
        # No kernel is handed to C code: without wrappers for that, compilation takes a tenth less.
        options = {"nogil": True, "cache": on_disk, "error_model": "numpy", "no_cfunc_wrapper": True}
        decorate = numba.njit(**options | wanted)
        compiled: Function = decorate(function)
    finally:
        config.CACHE_DIR = before
    return compiled


@cache
def _cache_folder() -> Path:
    """A folder for compiled code, named after the sources of all kernels.

    Numba recompiles a function when its own file changes, but not when a function or intrinsic that it inlines from
    another file does; with the sources' digest in the name, stale code is never found.
    """
    digest = hashlib.sha256()
    names = ("_inlining.py", "jit.py", "simd.py", "rng.py")
    sources = [*(PACKAGE / name for name in names), *sorted(PACKAGE.glob("*/kernels/*.py"))]
    for source in sources:
        digest.update(source.read_bytes())
    digest.update(b"vector" if vectorised() else b"plain")
    name = f"kernels-{digest.hexdigest()[:16]}"
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "fovden"
    for parent in [Path(chosen)] if chosen else [PACKAGE / "__pycache__", user]:
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=parent / name):
                return parent / name
        except OSError:
            continue
    temporary = Path(tempfile.mkdtemp(prefix="fovden-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    warnings.warn(
        f"no folder for compiled kernels is writable; they are compiled anew in every process (in {temporary}); "
        "set NUMBA_CACHE_DIR to a writable folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return temporary


class _Announcer(events.Listener):  # type: ignore[misc]  # Numba has no types
    """Names the package's kernels that take long to compile; what they call is compiled as a part of them.

    Numba compiles under one lock for all threads, which is held whenever this is called.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.timer: threading.Timer | None = None
        self.told = False

    def on_start(self, event: Any) -> None:
        """Sets the clock when a kernel's compilation begins."""
        self.depth += 1
        compiled = event.data["dispatcher"]
        function = compiled.py_func
        if self.depth == 1 and function.__module__.partition(".")[0] == __name__.partition(".")[0]:
            name = f"{function.__module__.partition('.')[2]}.{function.__name__}"
            self.timer = threading.Timer(ANNOUNCED_AFTER, self.tell, [name, compiled.stats.cache_path])
            self.timer.daemon = True
            self.timer.start()

    def on_end(self, _: Any) -> None:
        """Stops the clock, also where compilation failed or was interrupted."""
        self.depth -= 1
        if self.depth == 0 and self.timer is not None:
            self.timer.cancel()
            self.timer = None

    def tell(self, name: str, kept: str | None) -> None:
        """Writes the line; the first one says that the next process need not wait."""
        if sys.stderr is None:  # a program without a console
            return
        once = f" (once: the code is kept in {Path(kept).parent})" if kept and not self.told else ""
        self.told = True
        sys.stderr.write(f"fovden: compiling {name}{once}\n")
        sys.stderr.flush()


class _PausedCollector(events.Listener):  # type: ignore[misc]
    """Stops Python's collector of cycles while kernels are compiled, which takes a tenth less time then.

    A compilation makes millions of objects that live until its end, and the collector walks through all of them again
    and again. Reference counts go on freeing what they can; the first frame needs 140 MB more for a while.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.was_on = False

    def on_start(self, _: Any) -> None:
        """Stops it when the outermost compilation begins."""
        if self.depth == 0:
            self.was_on = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, _: Any) -> None:
        """Starts it again, if it ran, also where compilation failed or was interrupted."""
        self.depth -= 1
        if self.depth == 0 and self.was_on:
            gc.enable()


events.register("numba:compile", _Announcer())
events.register("numba:compile", _PausedCollector())
