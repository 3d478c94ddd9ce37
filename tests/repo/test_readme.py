"""What the documents promise exists and works."""

import re
from pathlib import Path

import pytest
from repository import CONFIGURATION, ROOT

README = (ROOT / "README.md").read_text()
DOCUMENTS = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"]


def make_targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.MULTILINE))


def example() -> str:
    blocks = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1
    return blocks[0]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_are_targets_of_the_makefile(document):
    named = set(re.findall(r"`?make ([a-z-]+)", "\n".join(re.findall(r"`[^`]+`", (ROOT / document).read_text()))))
    assert named <= make_targets()


def test_the_two_commands_are_in_the_readme():
    assert "make demo\nmake test\n" in README


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_lead_somewhere(document):
    targets = re.findall(r"\]\(([^)#]+)\)", (ROOT / document).read_text())
    for target in targets:
        if not target.startswith("https://"):
            assert (ROOT / target).exists(), f"{document} links to {target}, which is not there"


def test_the_readme_shows_a_picture():
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+\.png)\)", README)
    assert pictures
    assert all((ROOT / picture).is_file() for picture in pictures)


def test_paths_in_the_text_exist():
    for document in DOCUMENTS:
        named = re.findall(r"`([\w.-]+(?:/[\w.-]+)+/?)`", (ROOT / document).read_text())
        for path in named:
            if not path.startswith((".venv/", "out/")):
                assert (ROOT / path).exists(), f"{document} names {path}, which is not there"


def test_the_example_is_ten_lines_that_run(capsys, tmp_path, monkeypatch):
    text = example()
    assert len([line for line in text.splitlines() if line.strip()]) <= 10
    small, sizes = re.subn(r"resolution=\(\d+, \d+\)", "resolution=(24, 20)", text)
    small, counts = re.subn(r"spp=\d{2,}", "spp=2", small)
    assert (sizes, counts) == (1, 1)
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    exec(compile(small, "README.md", "exec"), namespace)
    assert namespace["image"].shape == (2, 3, 24, 20)
    assert "NH3LD" in capsys.readouterr().out


def test_the_changelog_has_this_version():
    changes = Path(ROOT / "CHANGELOG.md").read_text()
    assert re.search(rf"^## \[{re.escape(CONFIGURATION['project']['version'])}\]", changes, re.MULTILINE)
