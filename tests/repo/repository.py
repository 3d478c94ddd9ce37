"""What the tests of the repository itself have in common: where its files are, and what they declare."""

import ast
import subprocess
import tomllib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONFIGURATION = tomllib.loads((ROOT / "pyproject.toml").read_text())


def module_name(path: Path) -> str:
    """The dotted name of a module of the package."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_name(path): path for path in sorted((ROOT / "fovden").rglob("*.py"))}


@cache
def syntax(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def is_public(module: str) -> bool:
    """Whether users import from a module: not from kernels, nor from the command line, nor where nothing is."""
    private = any(part in {"kernels", "cli"} or part.startswith("_") for part in module.split("."))
    return not private and any(not isinstance(statement, ast.Expr) for statement in syntax(MODULES[module]).body)


def exported(module: str) -> list[str]:
    """The names in ``__all__``, read without importing the module."""
    for statement in syntax(MODULES[module]).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__":
            return ast.literal_eval(statement.value)
    return []


@cache
def project_files() -> list[Path]:
    """Every file that belongs to the project: tracked by git, or new and not ignored."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    paths = (ROOT / name for name in listed.split("\0") if name)
    return sorted(path for path in paths if path.is_file())
