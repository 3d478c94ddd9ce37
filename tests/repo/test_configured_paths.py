"""What the configuration names is there."""

import os
import re
import shutil
import sys
from importlib import import_module
from pathlib import Path

import pytest
from repository import CONFIGURATION, MODULES, ROOT

PROJECT, TOOLS = CONFIGURATION["project"], CONFIGURATION["tool"]
HATCH = TOOLS["hatch"]["build"]["targets"]
NAMED = [
    PROJECT["readme"],
    *PROJECT["license-files"],
    *HATCH["wheel"]["packages"],
    *(path.removeprefix("/") for path in HATCH["sdist"]["include"]),
    *TOOLS["mypy"]["files"],
    *TOOLS["pytest"]["ini_options"]["testpaths"],
    *(TOOLS["ruff"]["lint"]["per-file-ignores"]),
    *(f"fovden/{name}" for name in ("py.typed", "__main__.py")),
]


@pytest.mark.parametrize("pattern", NAMED)
def test_paths_of_pyproject(pattern):
    found = [path for path in ROOT.glob(pattern) if path.is_dir() or path.stat().st_size > 0 or path.name == "py.typed"]
    assert found, f"pyproject.toml names {pattern}, which is not there or empty"


@pytest.mark.parametrize("script", PROJECT["scripts"].values())
def test_scripts(script):
    module, function = script.split(":")
    assert callable(getattr(import_module(module), function))


def test_modules_of_the_import_contracts():
    contracts = TOOLS["importlinter"]["contracts"]
    assert contracts
    for contract in contracts:
        names = [*contract.get("source_modules", []), *contract.get("allowed_importers", [])]
        for container in contract.get("containers", []):
            layers = re.findall(r"\w+", " | ".join(contract["layers"]))
            assert "camera" in layers
            names += [f"{container}.{layer}" for layer in layers]
        for name in names:
            pattern = re.compile(re.escape(name).replace(r"\*", r"\w+") + "$")
            assert any(map(pattern.match, MODULES)), f"contract {contract['id']} names {name}, which does not exist"


def test_the_makefile_names_files_and_tools_that_exist():
    text = (ROOT / "Makefile").read_text()
    recipes = "".join(line for line in text.splitlines(keepends=True) if not line.startswith(("#", "\t@rm", "\t@echo")))
    paths = re.findall(r"(?<![\w$()./-])(\w[\w*-]*(?:/[\w*-]+)*\.(?:py|txt|toml))\b", recipes)
    assert {"pyproject.toml", "constraints.txt"} <= set(paths)
    folders = re.search(r"find ([\w ]+) -name __pycache__", text)
    for pattern in [*paths, *folders[1].split()]:
        assert list(ROOT.glob(pattern)), f"the Makefile names {pattern}, which is not there"
    tools = set(re.findall(r"\$\(BIN\)/([\w-]+)", recipes))
    assert {"python", "ruff", "mypy", "lint-imports"} <= tools
    for tool in tools:
        assert shutil.which(tool, path=str(Path(sys.executable).parent)), f"the Makefile calls {tool}, not installed"


def test_continuous_integration_calls_make_test():
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK)
    lines = script.read_text().splitlines()
    assert lines[0] == "#!/usr/bin/env bash"
    assert "set -euo pipefail" in lines
    assert lines[-1] == "exec make test"
