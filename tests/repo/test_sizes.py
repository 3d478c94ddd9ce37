"""Files and functions that a reader can take in at once."""

import ast

import pytest
from repository import ROOT, project_files, syntax

FILE_LINES, TEST_FILE_LINES, FUNCTION_LINES = 400, 450, 80
LARGER_FILES: dict[str, int] = {}
LARGER_FUNCTIONS: dict[str, int] = {}

SOURCES = {str(path.relative_to(ROOT)): path for path in project_files() if path.suffix == ".py"}


def function_lines() -> dict[str, int]:
    """Lines of every function, its docstring not counted, by file and name."""
    lines = {}
    for file, path in SOURCES.items():
        for node in ast.walk(syntax(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                documented = ast.get_docstring(node) is not None
                docstring = node.body[0].end_lineno - node.body[0].lineno + 1 if documented else 0
                lines[f"{file}:{node.name}"] = node.end_lineno - node.lineno + 1 - docstring
    return lines


def test_sizes_are_measured():
    assert "fovden/parallel.py" in SOURCES
    assert 10 < function_lines()["fovden/parallel.py:run"] < 40


@pytest.mark.parametrize("file", SOURCES)
def test_files(file):
    limit = LARGER_FILES.get(file, TEST_FILE_LINES if file.startswith("tests/") else FILE_LINES)
    assert len(SOURCES[file].read_text().splitlines()) <= limit


def test_functions():
    larger = {
        name: lines for name, lines in function_lines().items() if lines > LARGER_FUNCTIONS.get(name, FUNCTION_LINES)
    }
    assert larger == {}


def test_no_exception_is_idle():
    assert LARGER_FILES.keys() <= SOURCES.keys()
    assert all(len(SOURCES[file].read_text().splitlines()) > FILE_LINES for file in LARGER_FILES)
    lines = function_lines()
    assert all(lines[name] > FUNCTION_LINES for name in LARGER_FUNCTIONS)
