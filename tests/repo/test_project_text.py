"""The project's files hold for every reader: no paths of one machine, no package index, nothing left undone."""

import re
from pathlib import Path

import pytest
from repository import ROOT, project_files

FORBIDDEN = {
    "a machine's path": r"(?<![\w.])/(?:root|home|Users|tmp)/",
    "a package index": r"index-url|https?://\S+/simple\b",
    "unfinished work": r"\b(?:TODO|FIXME|XXX|HACK)\b",
}
FILES = [path for path in project_files() if path != Path(__file__).resolve()]


def findings(text: str) -> list[str]:
    return [f"{what}: {found[0]}" for what, rule in FORBIDDEN.items() for found in re.finditer(rule, text)]


@pytest.mark.parametrize("file", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_forbidden(file):
    data = file.read_bytes()
    if b"\0" in data:
        pytest.skip("not a text file")
    assert findings(data.decode("utf-8")) == []


@pytest.mark.parametrize("text", ["see /home/someone/x", "--index-url x", "# TODO: later"])
def test_the_rules_find_what_they_are_for(text):
    assert len(findings(text)) == 1


@pytest.mark.parametrize("text", ["fovden/home/x", "~/.cache/tmp/x", "todos"])
def test_the_rules_leave_the_rest_alone(text):
    assert findings(text) == []
