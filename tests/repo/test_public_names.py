"""Every public name imports, is documented, and shows itself at work."""

import ast
from importlib import import_module
from itertools import pairwise

import pytest
from repository import MODULES, exported, is_public, syntax

PUBLIC = [module for module in MODULES if is_public(module)]
Definition = ast.FunctionDef | ast.ClassDef


def documented_values() -> set[str]:
    """Names of module-level values that are followed by a string that describes them."""
    found = set()
    for path in MODULES.values():
        body = syntax(path).body
        for statement, following in pairwise(body):
            described = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
            if described and isinstance(following.value.value, str):
                if isinstance(statement, ast.Assign):
                    found |= {ast.unparse(target) for target in statement.targets}
                elif isinstance(statement, ast.AnnAssign):
                    found.add(ast.unparse(statement.target))
    return found


def is_plain(definition: ast.ClassDef) -> bool:
    """Whether a class does nothing that an example could show: errors, and tuples with names."""
    bases = {ast.unparse(base) for base in definition.bases}
    return definition.name.endswith(("Error", "Warning")) or "NamedTuple" in bases


def is_method(member: ast.stmt) -> bool:
    """Whether a member of a class is a method that users call; properties read like attributes."""
    if not isinstance(member, ast.FunctionDef) or member.name.startswith("_"):
        return False
    decorators = {ast.unparse(decorator).split(".")[-1] for decorator in member.decorator_list}
    return not decorators & {"property", "cached_property", "setter", "overload"}


def definitions() -> list[tuple[str, Definition]]:
    """Public functions, classes and methods, each with its qualified name."""
    found: list[tuple[str, Definition]] = []
    for module in PUBLIC:
        for statement in syntax(MODULES[module]).body:
            if not isinstance(statement, Definition) or statement.name not in exported(module):
                continue
            name = f"{module}.{statement.name}"
            if isinstance(statement, ast.FunctionDef) or not is_plain(statement):
                found.append((name, statement))
            if isinstance(statement, ast.ClassDef):
                found += [(f"{name}.{member.name}", member) for member in statement.body if is_method(member)]
    return found


@pytest.mark.parametrize("module", PUBLIC)
def test_names_import_and_are_documented(module):
    imported = import_module(module)
    names = imported.__all__
    assert names
    assert list(names) == exported(module)
    assert len(set(names)) == len(names)
    assert imported.__doc__
    described = documented_values() | {"__version__"}
    for name in names:
        value = getattr(imported, name)
        assert name in described or getattr(value, "__doc__", None), f"{module}.{name} has no docstring"


def test_the_walk_finds_what_it_should():
    names = {name for name, _ in definitions()}
    assert {"fovden.parallel.run", "fovden.camera.Gaze", "fovden.camera.Gaze.to", "fovden.frame.Frame.stack"} <= names
    assert not names & {"fovden.frame.Frame.radiance", "fovden.checks.ShapeError", "fovden.frame._move"}


@pytest.mark.parametrize(("name", "definition"), [pytest.param(*each, id=each[0]) for each in definitions()])
def test_every_function_class_and_method_has_an_example(name, definition):
    assert ">>>" in (ast.get_docstring(definition) or ""), f"{name} has no example"
