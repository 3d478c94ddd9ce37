"""Notebooks are ten cells of public names that end with the assertion of what they claim.

That they run is tested with the repository's lists.
"""

import ast
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))


def cells(notebook):
    """Kind and source of each cell of a percent script."""
    found = []
    for part in notebook.read_text().split("\n# %%")[1:]:
        kind, _, source = part.partition("\n")
        found.append(("markdown" if "[markdown]" in kind else "code", source))
    return found


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_prose_and_code_take_turns_in_ten_cells(notebook):
    kinds = [kind for kind, _ in cells(notebook)]
    assert kinds == ["markdown", "code"] * 10
    title, *_ = cells(notebook)[0][1].splitlines()
    assert title.startswith("# # ")
    assert title.endswith("?")


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_only_public_names_are_imported_and_nothing_is_defined(notebook):
    tree = ast.parse(notebook.read_text())
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module.startswith("fovden")]
    assert imports
    for node in imports:
        module = import_module(node.module)
        for alias in node.names:
            assert alias.name in getattr(module, "__all__", ()) or import_module(f"{node.module}.{alias.name}")
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_last_cell_asserts_the_claim(notebook):
    kind, source = cells(notebook)[-1]
    assert kind == "code"
    assert all(isinstance(statement, ast.Assert) for statement in ast.parse(source).body)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_script_and_its_notebook_are_the_same(notebook, tmp_path):
    jupytext = pytest.importorskip("jupytext")
    made = jupytext.read(notebook)
    assert all(not cell.get("outputs") for cell in made.cells)
    jupytext.write(made, tmp_path / "made.ipynb")
    again = jupytext.read(tmp_path / "made.ipynb")
    assert [(cell.cell_type, cell.source) for cell in again.cells] == [
        (cell.cell_type, cell.source) for cell in made.cells
    ]
    kept = jupytext.read(notebook.with_suffix(".ipynb"))
    assert all(not cell.get("outputs") for cell in kept.cells)
    assert [(cell.cell_type, cell.source) for cell in kept.cells] == [
        (cell.cell_type, cell.source) for cell in made.cells
    ]
