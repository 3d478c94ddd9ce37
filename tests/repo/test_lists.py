"""Lists that must not fall behind: the members of the contract suites, and the notebooks."""

import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

from fovden import filters

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))


def denoisers() -> list[type]:
    exported = [getattr(filters, name) for name in filters.__all__]
    found = [each for each in exported if inspect.isclass(each) and issubclass(each, filters.Denoiser)]
    return [each for each in found if not inspect.isabstract(each)]


def test_the_search_finds_members():
    assert filters.NonHomogeneousAtrous in denoisers()
    assert filters.Denoiser not in denoisers()


@pytest.mark.parametrize("member", denoisers(), ids=lambda member: member.__name__)
def test_every_denoiser_is_in_the_contract_suite(member):
    suite = (ROOT / "tests" / "contracts" / "test_denoisers.py").read_text()
    assert re.search(rf"\b{member.__name__}\b", suite)


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.stem)
def test_every_notebook_runs_at_a_small_size(notebook, tmp_path):
    """The way of ``make notebooks``, in an empty folder; the variable asks a notebook for its small size."""
    assert "FOVDEN_SMALL" in notebook.read_text()
    tools, executed = Path(sys.executable).parent, tmp_path / f"{notebook.stem}.ipynb"
    environment = os.environ | {"FOVDEN_SMALL": "1"}
    for command in (
        [tools / "jupytext", "--quiet", "--to", "ipynb", "--output", executed, notebook],
        [tools / "jupyter-execute", "--inplace", "--kernel_name=python3", executed],
    ):
        options = {"cwd": tmp_path, "env": environment, "timeout": 240, "text": True}
        result = subprocess.run(command, capture_output=True, check=False, **options)
        assert result.returncode == 0, result.stderr
    cells = json.loads(executed.read_text())["cells"]
    assert all(cell["execution_count"] for cell in cells if cell["cell_type"] == "code")
