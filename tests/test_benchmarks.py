"""Every benchmark runs in its smallest form, agrees with its peers, and prints what its results say."""

import os
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("benchmarks.harness", reason="the tests are not run from the repository's folder")

from benchmarks import harness

ROOT = Path(__file__).resolve().parents[1]
RESULTS = sorted(harness.RESULTS.glob("*.json"))
SMALL = ["--quick", "--resolution", "12", "16"]
NAMES = ["rays", "frame", "build", "growth", "cold_start", "flip", "atrous", "atrous_polar", "mapping"]


@pytest.fixture
def run(tmp_path, capsys):
    """Runs a benchmark and returns its results and what it printed; both sides were timed in every round."""

    def run(name, *options):
        path = tmp_path / f"{name}.json"
        status = import_module(f"benchmarks.{name}").main([*options, "-o", str(path)])
        printed = capsys.readouterr()
        assert status == 0, printed.err
        return harness.load(path)["results"], printed.out

    return run


def needs(*packages):
    missing = [name for name in packages if find_spec(name) is None]
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} not installed; `make bench` does it")


@pytest.mark.parametrize("peer", [pytest.param(peer, marks=needs(peer)) for peer in ("embreex", "open3d")])
def test_rays_are_those_of_embree(run, peer):
    results, printed = run("rays", *SMALL, "--scenes", "cornell_box", "pink_room:1000", "--peers", peer)
    kinds = [(each["scene"], each["kind"]) for each in results]
    assert kinds == [
        *(("cornell_box", kind) for kind in ("primary", "tiles", "bounce")),  # its lamp is no point to send rays to
        *(("pink_room", kind) for kind in ("primary", "tiles", "bounce", "shadow")),
    ]
    for each in results:
        assert each["different"] <= 2 / each["rays"]  # an edge that rounding decides
        assert each["threads"] == (1 if peer == "embreex" else harness.threads())
        assert [len(each[side]["wall"]) for side in ("fovden", "peer")] == [1, 1]
    assert "pink_room, 1,000 triangles: shadow, any hit" in printed


@needs("mitsuba")
def test_frames_have_mitsubas_light(tmp_path):
    path = tmp_path / "frame.json"
    options = ["--quick", "--scenes", "atrium:2000", "--resolution", "48", "48", "--spp", "64", "-o", path]
    command = [sys.executable, "-m", "benchmarks.frame", *options]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
    if done.returncode == 2 and "LLVM" in done.stderr:
        pytest.skip(f"Mitsuba's variant llvm_ad_rgb does not run here: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    ours, theirs = harness.load(path)["results"][0]["mean"]
    assert ours == pytest.approx(theirs, rel=0.05)  # rays through centres against pixels that average


def environment():
    return os.environ | {"PYTHONPATH": str(ROOT)}


def test_building_is_measured(run):
    results, printed = run("build", "--quick", "--scenes", "pink_room:1000")
    assert results[0]["structure"] > 1000 * 3 * 3 * 4 / 2  # a block of eight holds its corners
    assert results[0]["times"].keys() == {"fovden", *(p for p in ("open3d", "embreex") if find_spec(p))}
    assert "pink_room, 1,000 triangles: fovden" in printed


def test_memory_is_that_of_the_structure():
    from benchmarks.build import growth, size
    from fovden.tracer import build_bvh, make_scene

    scene = make_scene("pink_room", detail=120_000)  # 8 MB; what else a process takes up is one or two
    grown = growth(scene, "fovden", 1)
    if grown is None:
        pytest.skip("this system does not say how much memory a process holds")
    assert grown["kept"] == pytest.approx(size(build_bvh(scene.vertices, scene.faces)), rel=0.5)
    assert grown["peak"] >= grown["kept"]


def test_growth_is_measured_and_drawn(run, tmp_path):
    sizes = ["--triangles", "1000", "2000", "--frames", "8x8", "12x12", "--frame-triangles", "1000"]
    results, printed = run("growth", *SMALL, *sizes)
    assert [each["triangles"] for each in results if each["kind"] == "bounce"] == [1000, 2000]
    assert [each["resolution"] for each in results if each["kind"] == "frame"] == [[8, 8], [12, 12]]
    assert (tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")
    assert "12 x 12" in printed


def test_filters_are_measured_beside_their_peers(run):
    results, printed = run("atrous", "--quick", "--resolution", "24", "32")
    kinds = [each["kind"] for each in results]
    assert kinds.count("memory") in (0, 4)
    assert next(each["flops"] for each in results if each["kind"] == "peak") > 1e9
    beside = next(each for each in results if each["kind"] == "one level beside kornia")
    assert beside["pixels"] == 2 * 24 * 32
    assert sum(kind.startswith("backwards") for kind in kinds) == 4
    assert "five levels, forwards" in printed
    assert "share of the peak" in printed


def test_cells_are_compared_with_pixels(run):
    results, printed = run("atrous_polar", "--quick", "--raster", "15", "12", "--resolution", "18", "14")
    assert [each["kind"].partition(",")[0] for each in results] == ["forwards", "both ways", "both ways"]
    assert {(each["cells"] < 2 * 15 * 12, each["pixels"]) for each in results} == {(True, 2 * 18 * 14)}
    assert "ns a cell" in printed


def test_a_warm_start_compiles_nothing(run):
    results, printed = run("cold_start", "--quick")
    if results[0]["kernels"]:  # nothing had filled the cache
        results, printed = run("cold_start", "--quick")
    assert results[0]["kernels"] == {}
    assert results[0]["said"] == []
    assert "warm, a full cache" in printed


def test_mapping_agrees_with_torch(run):
    results, printed = run("mapping", "--quick", "--resolution", "30", "26")
    assert [each["raster"] for each in results] == ["visual-polar"] * 6 + ["log-polar"] * 6
    for each in results:
        assert each["difference"] < (0.01 if "read" in each["task"] else 1e-4)
    assert "to the screen, and its gradient" in printed


@needs("flip_evaluator")
def test_flip_is_its_authors(run):
    results, _ = run("flip", "--quick", "--scene", "cornell_box", "--resolution", "32", "32")
    assert [each["kind"] for each in results] == ["LDR", "HDR"]
    assert max(each["difference"] for each in results) < 1e-4


# What is saved


def test_every_benchmark_has_results():
    assert [path.stem for path in RESULTS] == sorted(NAMES)


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_saved_results_make_tables(path, capsys):
    data = harness.load(path)
    assert data["config"]["rounds"] >= 5
    assert not data["config"]["quick"]
    benchmark = import_module(f"benchmarks.{path.stem}")
    tables = benchmark.tables(data)
    for title, header, rows in tables:
        assert title
        assert rows
        assert {len(row) for row in rows} == {len(header)}
        assert any(cell.replace(".", "").isdigit() for row in rows for cell in row)
    assert harness.machine(data).startswith(f"Measured on {data['provenance']['device']}")
    if path.stem != "growth":  # whose figure would be drawn again
        assert benchmark.main(["--show", "-o", str(path)]) == 0
        printed = capsys.readouterr().out
        assert all(cell in printed for table in tables for row in table.rows for cell in row)
    assert sum(len(times) for times in rounds(data["results"])) >= 5


def rounds(value):
    """All lists of seconds below a value."""
    if isinstance(value, dict):
        yield from (found for key, each in value.items() for found in ([each] if key == "wall" else rounds(each)))
    elif isinstance(value, list):
        yield from (found for each in value for found in rounds(each))


# The harness


def test_calls_alternate_after_an_uncounted_round():
    called = []
    times = harness.alternate({name: lambda name=name: called.append(name) for name in "ab"}, 3)
    assert "".join(called) == "abababab"
    assert {len(times[side][clock]) for side in "ab" for clock in ("wall", "cpu")} == {3}


def test_calls_can_be_repeated_of_which_the_second_counts(monkeypatch):
    called, now = [], [0.0]

    def call():
        called.append(len(called))
        now[0] += 1.0 if len(called) % 2 == 0 else 50.0  # the first of each two is slow

    monkeypatch.setattr(harness.time, "perf_counter", lambda: now[0])
    times = harness.alternate({"a": call}, 3, repeat=True)
    assert len(called) == 8
    assert times["a"]["wall"] == [1.0] * 3


def test_ratios_are_taken_within_rounds():
    own, theirs = {"wall": [1.0, 4.0, 1.0], "cpu": [2.0] * 3}, {"wall": [2.0, 4.0, 3.0], "cpu": [3.0] * 3}
    assert harness.compared(own, theirs) == ["2.00", "1.00 to 3.00", "1.50"]


def test_rays_that_differ_are_counted():
    from benchmarks.peers import differing

    inf = np.inf
    assert differing(np.array([1, 2, inf, inf, 5], "f4"), np.array([1.0005, 2.1, inf, 3, 5], "f4")) == 0.4
    assert differing(np.array([True, False]), np.array([True, True])) == 0.5


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("rays", ["--rounds", "4"], "expected at least 5"),
        ("rays", ["--rounds", "none"], "invalid positive value"),
        ("rays", ["--peers", "optix"], "invalid choice"),
        ("growth", ["--frames", "12"], "invalid resolution value"),
        ("growth", ["--triangles", "0"], "expected a whole number of at least 1, got 0"),
    ],
)
def test_bad_options_are_refused(name, options, said, capsys):
    with pytest.raises(SystemExit, match="2"):
        import_module(f"benchmarks.{name}").main(options)
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "No such file"), ("{}", "expected the results of a benchmark"), ("rays", "error")],
)
def test_bad_files_are_refused(content, said, tmp_path, capsys):
    path = tmp_path / "rays.json"
    if content is not None:
        path.write_text(content)
    assert import_module("benchmarks.rays").main(["--show", "-o", str(path)]) == 2
    assert said in capsys.readouterr().err


def test_bad_scenes_are_refused(capsys, tmp_path):
    for scene, said in (("pink_room:many", "after the colon"), ("nowhere.obj", "nowhere.obj")):
        status = import_module("benchmarks.build").main(["--quick", "--scenes", scene, "-o", str(tmp_path / "b.json")])
        assert status == 2
        assert said in capsys.readouterr().err
        assert not (tmp_path / "b.json").exists()


@pytest.mark.parametrize("name", NAMES)
def test_help_says_what_is_timed(name, capsys):
    with pytest.raises(SystemExit, match="0"):
        import_module(f"benchmarks.{name}").main(["--help"])
    assert f"python -m benchmarks.{name}" in capsys.readouterr().out
