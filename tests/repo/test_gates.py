"""The gates can fail: each is shown something bad, under the project's own configuration, and must refuse it."""

import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from repository import CONFIGURATION, ROOT

BIN = Path(sys.executable).parent
needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
GOOD = '''"""A module."""


def double(number: int) -> int:
    """Returns twice the number."""
    return 2 * number
'''


def call(*command: object, cwd: Path = ROOT, text: str | None = None) -> subprocess.CompletedProcess:
    arguments = list(map(str, command))
    return subprocess.run(arguments, cwd=cwd, input=text, capture_output=True, text=True, timeout=300, check=False)


def ruff(text: str, *command: str) -> subprocess.CompletedProcess:
    return call(BIN / "ruff", *command, "--no-cache", "--stdin-filename", ROOT / "fovden" / "sample.py", "-", text=text)


@pytest.mark.parametrize(
    ("code", "bad"),
    [
        (None, GOOD),
        ("F401", GOOD.replace('module."""\n', 'module."""\n\nimport os\n')),
        ("ANN001", GOOD.replace("number: int", "number")),
        ("ANN201", GOOD.replace(" -> int", "")),
        ("D103", GOOD.replace('    """Returns twice the number."""\n', "")),
        ("ARG001", GOOD.replace("number: int", "number: int, unused: int")),
        (
            "B006",
            GOOD.replace("number: int", "number: int, into: list[int] = []").replace("2 * number", "[*into, number]"),
        ),
        ("T201", GOOD.replace("    return", "    print(number)\n    return")),
        ("E501", GOOD.replace("twice", "twice " * 30)),
        (
            "NPY002",
            GOOD.replace("2 * number", "numpy.random.rand()").replace('module."""\n', 'module."""\n\nimport numpy\n'),
        ),
    ],
)
def test_ruff_check(code, bad):
    result = ruff(bad, "check", "--output-format", "concise")
    assert result.returncode == (0 if code is None else 1), result.stdout + result.stderr
    assert code is None or code in result.stdout


def test_ruff_format():
    assert ruff(GOOD, "format", "--check").returncode == 0
    assert ruff(GOOD.replace('"""A module."""', "'''A module.'''"), "format", "--check").returncode == 1


def test_mypy(tmp_path):
    samples = {
        "good.py": (GOOD, None),
        "untyped.py": (GOOD.replace("number: int", "number"), "no-untyped-def"),
        "wrong.py": (GOOD.replace("2 * number", "str(number)"), "return-value"),
        "generic.py": (GOOD.replace("number: int", "number: list"), "type-arg"),
        "unreachable.py": (
            GOOD.replace("    return", "    if isinstance(number, str):\n        return 0\n    return"),
            "unreachable",
        ),
    }
    for name, (text, _) in samples.items():
        (tmp_path / name).write_text(text)
    result = call(
        BIN / "mypy",
        "--config-file",
        ROOT / "pyproject.toml",
        "--cache-dir",
        tmp_path / "cache",
        *samples,
        cwd=tmp_path,
    )
    assert result.returncode == 1
    for name, (_, code) in samples.items():
        found = [line for line in result.stdout.splitlines() if line.startswith(name)]
        assert bool(found) == (code is not None), result.stdout + result.stderr
        assert code is None or f"[{code}]" in found[0]


# For each contract a module, and a line in it that must not be there.
VIOLATIONS = {
    "layers": ("fovden/frame.py", "from fovden import tracer"),
    "outside": ("fovden/frame.py", "import experiments"),
    "oracles": ("fovden/metrics/image.py", "import skimage.metrics"),
    "numba": ("fovden/parallel.py", "import numba"),
    "trimesh": ("fovden/tracer/scene.py", "import trimesh"),
    "codecs": ("fovden/frame.py", "import OpenEXR"),
    "textures": ("fovden/color.py", "from PIL import Image"),
    "figures": ("fovden/metrics/image.py", "from matplotlib import pyplot"),
    "pages": ("fovden/results.py", "import jinja2"),
    "metrics": ("fovden/filters/atrous.py", "import kornia.metrics"),
    "search": ("fovden/tuning/fit.py", "import optuna"),
    "bars": ("fovden/tracer/reference.py", "from tqdm import tqdm"),
}


def lint_imports(folder: Path) -> tuple[int, dict[str, str]]:
    """The exit code, and what became of each contract, by its name."""
    configuration = folder / "pyproject.toml"
    result = call(BIN / "lint-imports", "--no-cache", "--no-logo", "--config", configuration, cwd=folder)
    verdicts = dict(re.findall(r"^(.+?) (KEPT|BROKEN)", result.stdout, re.MULTILINE))
    assert verdicts, result.stdout + result.stderr
    return result.returncode, verdicts


def test_import_contracts(tmp_path):
    names = {contract["id"]: contract["name"] for contract in CONFIGURATION["tool"]["importlinter"]["contracts"]}
    assert names.keys() == VIOLATIONS.keys()
    shutil.copytree(ROOT / "fovden", tmp_path / "fovden", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    assert lint_imports(tmp_path) == (0, dict.fromkeys(names.values(), "KEPT"))
    for file, line in VIOLATIONS.values():
        with (tmp_path / file).open("a") as opened:
            opened.write(f"\n{line}\n")
    assert lint_imports(tmp_path) == (1, dict.fromkeys(names.values(), "BROKEN"))


def test_a_module_without_a_layer_is_refused(tmp_path):
    shutil.copytree(ROOT / "fovden", tmp_path / "fovden", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "fovden" / "stray.py").write_text(GOOD)
    result = call(BIN / "lint-imports", "--no-cache", "--no-logo", cwd=tmp_path)
    assert result.returncode == 1
    assert "stray" in result.stdout


PYTEST_SAMPLE = '''
    """A sample.

    >>> 1 + 1
    3
    """
    import warnings
    import pytest

    def test_that_passes():
        pass

    def test_that_warns():
        warnings.warn("old", DeprecationWarning)

    @pytest.mark.xfail
    def test_that_should_fail_but_does_not():
        pass

    def test_that_loses_an_exception_in_a_thread():
        import threading
        thread = threading.Thread(target=lambda: 1 / 0)
        thread.start()
        thread.join()
'''


def test_pytest_takes_warnings_and_surprises_for_errors(tmp_path):
    (tmp_path / "test_sample.py").write_text(textwrap.dedent(PYTEST_SAMPLE))
    options = ["-c", ROOT / "pyproject.toml", "--rootdir", tmp_path, "-p", "no:cacheprovider", "-q"]
    result = call(sys.executable, "-m", "pytest", *options, "test_sample.py", cwd=tmp_path)
    assert result.returncode == 1
    failed = set(re.findall(r"^FAILED \S*test_sample.py::(\S+)", result.stdout, re.MULTILINE))
    assert failed == {
        "test_sample",  # the doctest
        "test_that_warns",
        "test_that_should_fail_but_does_not",
        "test_that_loses_an_exception_in_a_thread",
    }
    assert "1 passed" in result.stdout


def test_pytest_refuses_unknown_marks_and_options(tmp_path):
    (tmp_path / "test_sample.py").write_text("import pytest\n\n@pytest.mark.slwo\ndef test_typo():\n    pass\n")
    options = ["--rootdir", tmp_path, "-p", "no:cacheprovider", "-q"]
    result = call(
        sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", *options, "test_sample.py", cwd=tmp_path
    )
    assert result.returncode == 2
    assert "slwo" in result.stdout


@needs_make
def test_make_test_runs_every_gate_and_ends_with_pytest():
    commands = call("make", "--no-print-directory", "--dry-run", "test").stdout.splitlines()
    gates = ["ruff check", "ruff format --check", "mypy", "lint-imports", "-m pytest"]
    lines = [next(number for number, command in enumerate(commands) if gate in command) for gate in gates]
    assert lines == sorted(lines)
    assert "-m pytest" in commands[-1]
    assert not [command for command in commands if "|| true" in command or command.startswith("-")]


@pytest.fixture
def bare(tmp_path):
    """A folder with what the Makefile needs, and no environment."""
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    return tmp_path


@needs_make
def test_an_old_python_is_refused_in_words(bare):
    old = bare / "python3.9"
    old.write_text("#!/bin/sh\n[ $1 = --version ] && echo Python 3.9.1 || exit 1\n")
    old.chmod(0o755)
    result = call("make", f"PYTHON={old}", "demo", cwd=bare)
    assert result.returncode == 2
    assert "fovden needs Python 3.11 or later" in result.stderr
    assert "Python 3.9.1" in result.stderr
    assert "make PYTHON=python3.12 demo" in result.stderr
    assert not (bare / ".venv").exists()


@needs_make
def test_the_environment_is_set_up_once_and_after_a_change(bare):
    def setup() -> bool:
        return "pip install" in call("make", "--dry-run", "demo", cwd=bare).stdout

    assert setup()
    (bare / ".venv").mkdir()
    (bare / ".venv" / "ready").touch()
    assert not setup()
    later = (bare / ".venv" / "ready").stat().st_mtime + 10
    os.utime(bare / "constraints.txt", (later, later))
    assert setup()
