"""Compiled kernels on disk: found again by the next process, never stale, and dispensable.

Every test works on a small package of its own, which holds the real ``fovden/jit.py`` and two kernels.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fovden

PROGRAM = """
import json, os, sys, warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from fovden.tracer.kernels.add import add, add_twice
print(json.dumps({
    "sum": add(1.0),
    "twice": add_twice(1.0),
    "hits": sum(add.stats.cache_hits.values()),
    "misses": sum(add.stats.cache_misses.values()),
    "folder": os.path.dirname(add.stats.cache_path),
    "warnings": [str(warning.message) for warning in caught],
}))
"""

FAILING = """
import json, threading
from fovden.tracer.kernels.add import wrong
try:
    wrong(1.0)
except Exception as error:
    name = type(error).__name__
for thread in threading.enumerate():
    if isinstance(thread, threading.Timer):
        thread.join(timeout=10)
print(json.dumps({"error": name, "threads": threading.active_count()}))
"""

KERNELS = """
from fovden.jit import kernel
from fovden.tracer.kernels.amount import amount

@kernel
def add(a):
    return a + amount()

@kernel
def add_twice(a):
    return a + amount() + amount()
"""

AMOUNT = """
from fovden.jit import inlined

@inlined
def amount():
    return {value}
"""


class Package:
    """A copy of the kernels' infrastructure in a folder of its own, run in fresh interpreters."""

    def __init__(self, root: Path) -> None:
        self.root = root / "fovden"
        kernels = self.root / "tracer" / "kernels"
        kernels.mkdir(parents=True)
        for folder in (self.root, self.root / "tracer", kernels):
            (folder / "__init__.py").touch()
        for name in ("_inlining.py", "checks.py", "jit.py", "rng.py", "simd.py"):
            shutil.copy(Path(fovden.__file__).parent / name, self.root)
        self.add = kernels / "add.py"
        self.add.write_text(KERNELS)
        self.amount = kernels / "amount.py"
        self.amount.write_text(AMOUNT.format(value=10.0))
        self.temporary = root / "temporary"
        self.temporary.mkdir()
        self.file = root / "file"  # nothing can be written below it, not even by the superuser
        self.file.touch()
        self.environment = {
            "PATH": os.environ["PATH"],
            "PYTHONDONTWRITEBYTECODE": "1",
            "XDG_CACHE_HOME": str(root / "user"),
            "TMPDIR": str(self.temporary),
        }

    def announce_after(self, seconds: float) -> None:
        jit = self.root / "jit.py"
        jit.write_text(re.sub(r"ANNOUNCED_AFTER = \S+", f"ANNOUNCED_AFTER = {seconds}", jit.read_text()))

    def make_read_only(self) -> None:
        (self.root / "__pycache__").touch()

    def run(self, program: str = PROGRAM, **environment: str) -> dict:
        program = [sys.executable, "-W", "error", "-c", program]
        where = {"cwd": self.root.parent, "env": self.environment | environment}  # this fovden before the installed one
        result = subprocess.run(program, **where, capture_output=True, text=True, timeout=120, check=False)
        assert result.returncode == 0, result.stderr
        return json.loads(result.stdout) | {"stderr": result.stderr.splitlines()}


@pytest.fixture
def package(tmp_path: Path) -> Package:
    return Package(tmp_path)


def test_the_next_process_finds_the_code(package):
    first = package.run()
    files = {path: path.stat().st_mtime_ns for path in Path(first["folder"]).rglob("*.nb?")}
    assert (first["sum"], first["hits"], first["misses"]) == (11.0, 0, 1)
    assert Path(first["folder"]).is_relative_to(package.root / "__pycache__")
    assert files

    second = package.run()
    assert (second["sum"], second["hits"], second["misses"]) == (11.0, 1, 0)
    assert second["folder"] == first["folder"]
    assert {path: path.stat().st_mtime_ns for path in files} == files


def test_a_change_in_an_inlined_function_of_another_file_is_noticed(package):
    first = package.run()
    package.amount.write_text(AMOUNT.format(value=20.0))
    second = package.run()
    assert (first["sum"], second["sum"], second["hits"]) == (11.0, 21.0, 0)
    assert second["folder"] != first["folder"]


def test_vector_and_plain_code_are_kept_apart(package):
    vector, plain = package.run(FOVDEN_SIMD="1"), package.run(FOVDEN_SIMD="0")
    assert (vector["hits"], plain["hits"]) == (0, 0)
    assert vector["folder"] != plain["folder"]


def test_a_read_only_installation_uses_the_users_cache(package):
    package.make_read_only()
    first, second = package.run(), package.run()
    assert Path(first["folder"]).is_relative_to(Path(package.environment["XDG_CACHE_HOME"]) / "fovden")
    assert first["warnings"] == []
    assert second["hits"] == 1


def test_a_chosen_folder_is_used(package, tmp_path):
    chosen = tmp_path / "chosen"
    first = package.run(NUMBA_CACHE_DIR=str(chosen))
    assert Path(first["folder"]).is_relative_to(chosen)
    assert first["warnings"] == []
    assert not (package.root / "__pycache__").exists()


def test_a_kernel_that_takes_long_is_named_while_it_is_compiled_and_only_then(package):
    package.announce_after(0)
    first, second = package.run(), package.run()
    assert first["stderr"] == [
        f"fovden: compiling tracer.kernels.add.add (once: the code is kept in {first['folder']})",
        "fovden: compiling tracer.kernels.add.add_twice",  # and no line for the function that both call
    ]
    assert (second["hits"], second["stderr"]) == (1, [])


def test_a_failed_compilation_stops_the_clock(package):
    package.announce_after(100)
    package.add.write_text(KERNELS + "\n@kernel\ndef wrong(a):\n    return a + nothing\n")
    result = package.run(program=FAILING)
    assert (result["error"], result["threads"], result["stderr"]) == ("TypingError", 1, [])


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_without_a_writable_folder_one_warning_and_a_temporary_one(package, variable):
    if variable == "XDG_CACHE_HOME":
        package.make_read_only()
    result = package.run(**{variable: str(package.file / "below")})
    assert (result["sum"], result["twice"]) == (11.0, 21.0)
    assert len(result["warnings"]) == 1
    assert "no folder for compiled kernels is writable" in result["warnings"][0]
    assert "NUMBA_CACHE_DIR" in result["warnings"][0]
    assert Path(result["folder"]).is_relative_to(package.temporary)
    assert list(package.temporary.iterdir()) == []  # removed when the process ended


def test_what_is_inlined_is_a_part_of_the_kernels_on_the_disk(package):
    first = package.run()
    kept = {path.name.partition("-")[0] for path in Path(first["folder"]).rglob("*.nbi")}
    assert kept == {"add.add", "add.add_twice"}


def test_the_collector_of_cycles_waits_for_the_compilation_alone():
    program = """
import gc
from numba.core import event
from fovden.jit import kernel
seen = []
class During(event.Listener):
    def on_start(self, _): seen.append(gc.isenabled())
    def on_end(self, _): pass
event.register("numba:compile", During())
for switch in (gc.enable, gc.disable):
    switch()
    before = gc.isenabled()
    @kernel
    def add(a):
        return a + 1
    @kernel
    def broken(a):
        return a + nothing
    add(1)
    try:
        broken(1)
    except Exception:
        pass
    assert gc.isenabled() is before
assert seen and not any(seen), seen
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
