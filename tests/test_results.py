"""A run's folder holds what was asked for, how it ran, and every number, or says that it was stopped."""

import json
import math
import shutil
import subprocess
from pathlib import Path

import pytest

from fovden.results import Measurement, Run, provenance, read_config, read_metrics

ROWS = [
    Measurement("atrium", 0, 1, "Base, equal paths", "layer 0", "psnr", 31.25),
    Measurement("atrium", 0, "", "NH3LD", "whole", "paths", 1188800.0),
    Measurement("atrium", 3, 0, "exact", "whole", "psnr", math.inf),
]


def test_settings_and_numbers_come_back(tmp_path):
    with Run(tmp_path / "a" / "b", {"spp": 4, "gaze": None}) as run:
        run.measurements += ROWS
    assert read_config(run.folder) == {"spp": 4, "gaze": None}
    assert read_metrics(run.folder) == ROWS
    header = (run.folder / "metrics.csv").read_text().splitlines()[0]
    assert header == "scene,frame,view,method,region,metric,value"


def test_provenance_says_with_what_and_how_long(tmp_path):
    with Run(tmp_path, {}) as run, run.stage("wait"):
        pass
    record = json.loads((tmp_path / "provenance.json").read_text())
    assert record["state"] == "finished"
    assert {"python", "torch", "numpy", "numba", "fovden"} <= set(record["versions"])
    assert 0 < record["seconds"]["wait"] + 1e-4 <= record["wall_seconds"] + 1e-3
    assert record["threads"] >= 1
    assert record["device"]


def test_a_run_that_is_stopped_has_no_numbers_and_says_so(tmp_path):
    with Run(tmp_path, {}) as run:
        run.measurements += ROWS

    def stopped():
        with Run(tmp_path, {}) as second:
            second.measurements += ROWS
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert json.loads((tmp_path / "provenance.json").read_text())["state"] == "stopped by KeyboardInterrupt"
    with pytest.raises(FileNotFoundError, match="expected the folder of a finished run"):
        read_metrics(tmp_path)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["config.json", "provenance.json"]


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "scene,frame,view,method,region,metric,value\natrium,x,0,a,b,c,1\n"]
)
def test_a_damaged_table_is_one_error(tmp_path, text):
    (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(ValueError, match=r"metrics\.csv: expected a table with the columns scene, frame"):
        read_metrics(tmp_path)
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(ValueError, match=r"config\.json: expected JSON"):
        read_config(tmp_path)


def test_the_commit_is_that_of_the_package_and_of_nothing_around_it(tmp_path, monkeypatch):
    git = shutil.which("git")
    if git is None:
        pytest.skip("git is not installed")
    found = provenance()["commit"]
    assert found is None or len(found) == 40
    package = tmp_path / "library" / "fovden"
    package.mkdir(parents=True)
    identity = ["-c", "user.name=n", "-c", "user.email=e@x", "-c", "commit.gpgsign=false"]
    for around, expected in ((tmp_path, None), (package.parent, 40)):
        for command in (["init", "--quiet"], [*identity, "commit", "--quiet", "--allow-empty", "-m", "first"]):
            subprocess.run([git, "-C", str(around), *command], check=True, capture_output=True)
        monkeypatch.setattr("fovden.results.__file__", str(package / "results.py"))
        commit = provenance()["commit"]
        assert commit is None if expected is None else len(commit) == expected


def test_the_command_is_that_of_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for given, kept in ((tmp_path / "run.py", "run.py"), (Path("run.py"), "run.py"), (Path("/else/run.py"),) * 2):
        monkeypatch.setattr("sys.argv", [str(given), "-o", "out"])
        assert provenance()["command"] == [str(kept), "-o", "out"]
