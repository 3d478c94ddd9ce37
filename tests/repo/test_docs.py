"""The documentation's pages: references lead somewhere, every public name is there, examples run, numbers are read.

The full build, which says more, is marked slow.
"""

import ast
import doctest
import os
import re
import subprocess
import sys
from functools import cache
from importlib import import_module

import pytest
from repository import CONFIGURATION, MODULES, ROOT, exported, is_public

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
REFERENCE = sorted(DOCS.glob("api/*.rst"))
KERNELS_ONLY = {"fovden.jit", "fovden.memory", "fovden.simd"}  # what kernels are written with; nobody else imports it
PACKAGES = [
    name
    for name in MODULES
    if is_public(name) and name.count(".") <= 1 and name not in KERNELS_ONLY | {"fovden.__main__"}
]
DIRECTIVE = r"^```\{measured-(\w+)\} (\S+)$"
OPTIONS = CONFIGURATION["tool"]["pytest"]["ini_options"]["doctest_optionflags"]


@cache
def find(qualified):
    """The object of a dotted name: an attribute where there is one, else a module."""
    found, path = import_module("fovden"), "fovden"
    for part in qualified.split(".")[1:]:
        path += f".{part}"
        found = getattr(found, part) if hasattr(found, part) else import_module(path)
    return found


def described(page):
    """Dotted names that a page of the reference describes, or refers to in a table of its own."""
    module, names, listing, pending = "", [], False, None
    for line in [*page.read_text().splitlines(), ""]:
        directive = re.match(r"\.\. (\w+):: ?([\w.]*)", line)
        if pending and not line.strip().startswith(":"):  # a whole module, unless an option said otherwise
            names += [f"{pending}.{name}" for name in exported(pending)]
            pending = None
        if directive:
            kind, name = directive.groups()
            listing = kind == "autosummary"
            if kind == "currentmodule":
                module = name
            elif kind == "automodule":
                pending = name
            elif kind.startswith("auto") and name:
                names.append(name if name.startswith("fovden.") else f"{module}.{name}")
        elif ":no-members:" in line:
            pending = None
        elif listing and line.strip().startswith("fovden."):
            names.append(line.strip())
    return names


def fences(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def anchors(page):
    """What a link may point at within a page: its headings as slugs, and its labels."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    slugs = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_in_the_reference(package):
    objects = [find(name) for page in REFERENCE for name in described(page)]
    module = import_module(package)
    names = [name for name in module.__all__ if name != "__version__"]
    missing = [name for name in names if not any(getattr(module, name) is each for each in objects)]
    assert missing == [], f"docs/api describes no {', '.join(missing)} of {package}"


def test_the_reference_is_read_as_meant():
    names = described(DOCS / "api" / "tracer.rst")
    assert "fovden.tracer.trace_frame" in names
    assert "fovden.tracer.lights.Light" not in names  # of a module whose members are left out
    assert "fovden.Gaze" in described(DOCS / "api" / "foveation.rst")


@pytest.mark.parametrize("page", REFERENCE, ids=lambda page: page.stem)
def test_what_the_reference_names_exists(page):
    names = described(page)
    assert names
    assert all(find(name) is not None for name in names)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_references_lead_somewhere(page):
    text = page.read_text()
    for target in re.findall(r"\]\(\s*([^)\s]+)\s*\)", text):
        file, _, anchor = target.partition("#")
        if file.startswith("https://"):
            continue
        home = ROOT / "notebooks" if file.endswith(".ipynb") else DOCS  # the build copies the notebook
        linked = home / file if file else page
        assert linked.is_file(), f"{page.name} links to {target}, which is not there"
        assert not anchor or anchor in anchors(linked), f"{page.name}: there is no #{anchor} in {linked.name}"
    for role, target in re.findall(r"\{(class|func|meth|mod|data)\}`([^`]+)`", text):
        qualified = re.sub(r".*<(.*)>", r"\1", target).lstrip("~")
        assert not qualified.startswith("fovden") or find(qualified) is not None, f"{page.name}: {role} {target}"


def test_every_page_is_in_the_table_of_contents():
    index = (DOCS / "index.md").read_text()
    toctrees = "\n".join(re.findall(r"^```\{toctree\}\n(.*?)^```", index, re.MULTILINE | re.DOTALL))
    listed = {re.sub(r".*<(.*)>", r"\1", line) for line in toctrees.splitlines() if line and line[0] != ":"}
    notebooks = {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")}
    pages = {str(page.relative_to(DOCS).with_suffix("")) for page in [*PAGES, *REFERENCE]} | notebooks
    assert listed == pages - {"index"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_run(page):
    flags = sum(getattr(doctest, name) for name in OPTIONS)
    example = doctest.DocTestParser().get_doctest(
        "".join(fences(page, "pycon")), {"__name__": "__main__"}, page.name, str(page), 0
    )
    runner = doctest.DocTestRunner(optionflags=flags)
    runner.run(example)
    assert runner.failures == 0
    for source in fences(page, "python"):
        ast.parse(source)


def test_commands_of_the_pages_are_those_of_the_command_line():
    from fovden.__main__ import build_parser

    typed = "".join(shell for page in PAGES for shell in fences(page, "sh"))
    named = "".join(re.findall(r"`(?:python -m )?fovden [a-z]+", "".join(page.read_text() for page in PAGES)))
    commands = set(re.findall(r"fovden ([a-z]+)", typed + named))
    choices = next(a.choices for a in build_parser()._actions if a.choices and "compare" in a.choices)
    assert commands <= set(choices)


def test_numbers_on_the_pages_are_read_from_measurements():
    from fovden.results import read_config, read_metrics

    found = [directive for page in PAGES for directive in re.findall(DIRECTIVE, page.read_text(), re.MULTILINE)]
    folders = [(kind, DOCS / folder) for kind, folder in found if kind != "benchmark"]
    assert folders
    for kind, folder in folders:
        assert len(read_metrics(folder)) > 10
        assert read_config(folder)["view" if kind == "comparison" else "scenes"]
        assert (folder / "provenance.json").is_file()
    benchmarks = {name for kind, name in found if kind == "benchmark"}
    assert benchmarks == {path.stem for path in (ROOT / "benchmarks" / "results").glob("*.json")}


@pytest.mark.slow
def test_the_pages_build_without_a_warning(tmp_path):
    pytest.importorskip("furo")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", DOCS, tmp_path / "html"]
    environment = os.environ | {"FOVDEN_SMALL": "1"}
    result = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=600)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "html" / "index.html").is_file()
