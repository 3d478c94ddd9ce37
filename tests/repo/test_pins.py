"""The versions that were tested: complete, allowed by the package's own ranges, and those that are installed."""

import re
import sys
from importlib.metadata import PackageNotFoundError, distributions, version

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from repository import CONFIGURATION, ROOT

PINS = {
    canonicalize_name(line.split("==")[0]): line.split("==")[1]
    for line in (ROOT / "constraints.txt").read_text().splitlines()
    if line and not line.startswith("#")
}
PROJECT = CONFIGURATION["project"]
LISTS = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
REQUIREMENTS = [Requirement(text) for texts in LISTS for text in texts if not text.startswith("fovden")]
NOT_FOR_US = {"fovvideovdp"}  # extras that the environment of the Makefile leaves out
MADE_HERE = sys.prefix == str(ROOT / ".venv")  # the environment that make builds, and no other, must obey the pins


def test_every_line_is_an_exact_public_version():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    for line in lines:
        assert re.fullmatch(r"#.*|[\w.-]+==[\w.]+", line), line


@pytest.mark.parametrize("requirement", REQUIREMENTS, ids=lambda requirement: requirement.name)
def test_every_requirement_is_pinned_within_its_range(requirement):
    assert requirement.specifier.contains(PINS[canonicalize_name(requirement.name)])


@pytest.mark.skipif(not MADE_HERE, reason="not the environment of the Makefile")
def test_the_pinned_versions_are_installed():
    installed = {canonicalize_name(each.metadata["Name"]): Version(each.version).public for each in distributions()}
    differing = {name: (installed[name], pin) for name, pin in PINS.items() if installed.get(name, pin) != pin}
    assert differing == {}
    left_out = {Requirement(text).name for extra in NOT_FOR_US for text in PROJECT["optional-dependencies"][extra]}
    assert {canonicalize_name(requirement.name) for requirement in REQUIREMENTS} - left_out <= set(installed)


@pytest.mark.skipif(not MADE_HERE, reason="not the environment of the Makefile")
def test_torchvision_is_absent():
    with pytest.raises(PackageNotFoundError):  # nothing needs it, and it ties the version of PyTorch
        version("torchvision")
