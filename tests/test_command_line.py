"""The command line: what it writes, what it says, and how it ends."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from fovden import __main__, color
from fovden.__main__ import main
from fovden.cli import options
from fovden.filters import NonHomogeneousAtrous
from fovden.foveation import Gaze, ThreeLayer, sample_map
from fovden.io import load_frame, load_image, load_reference
from fovden.tracer import DirectionalLight, PointLight, make_scene, trace_frame
from fovden.tuning import load_parameters

COMMANDS = ["render", "reference", "denoise", "compare", "tune", "demo", "scenes", "figures", "report"]
SQUARE = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def frame(folder):
    assert main(["render", "cornell_box", "--resolution", "24x20", "-o", "frame.exr"]) == 0
    return load_frame(folder / "frame.exr")


def pixels_of(path):
    with Image.open(path) as picture:
        return np.array(picture)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches(command, capsys):
    assert main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert "usage: fovden" in text
    assert command == "demo" or f"fovden {command} " in text.partition("examples:")[2]
    assert main(["--help"]) == 0
    assert re.search(rf"^ +{command}\b", capsys.readouterr().out, re.MULTILINE)


def test_help_states_defaults_and_units(capsys):
    main(["compare", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for words in ("default: 4", "default: 1024", "default: fhd", "W/m^2", "metres", "degrees", "in pixels"):
        assert words in text


def test_the_examples_of_the_help_parse(capsys, monkeypatch):
    monkeypatch.setattr(Path, "is_dir", lambda _: True)
    found = 0
    for command in COMMANDS:
        main([command, "--help"])
        text = capsys.readouterr().out.partition("examples:")[2].replace("\\\n", " ")
        for line in text.strip().splitlines():
            words = line.partition("#")[0].split()
            __main__.build_parser().parse_args(options.join_negative_values(words[1:]))
            found += 1
    assert found >= 10


def test_render_writes_the_frame_that_the_library_makes(frame):
    scene = make_scene("cornell_box")
    camera = scene.camera.at(resolution=(24, 20))
    expected = trace_frame(scene, camera, sample_map(ThreeLayer(), camera, spp=4, seed=0), seed=0)
    assert torch.equal(frame.radiance, expected.radiance)
    assert torch.equal(frame.counts, expected.counts)
    assert torch.equal(frame.layer, expected.layer)
    assert torch.equal(frame.gbuffer.prim, expected.gbuffer.prim)


def test_render_without_foveation_and_a_picture_that_shows_it(folder, capsys):
    words = ["render", "cornell_box", "--resolution", "24x20", "--foveation", "none", "--spp", "2", "--seed", "5"]
    assert main([*words, "-o", "frame.exr"]) == 0
    frame = load_frame(folder / "frame.exr")
    assert (frame.counts == 2).all()
    assert frame.seed == 5
    shown = color.display(frame.radiance, color.exposure(frame.radiance))
    expected = np.concatenate([np.floor(view.double().numpy() * 255 + 0.5) for view in shown], axis=2)
    assert np.array_equal(pixels_of(folder / "frame.png"), expected.transpose(1, 2, 0))
    assert "1,920 paths, 2.000 per pixel" in capsys.readouterr().out


def test_lights_camera_and_gaze_of_a_file(folder):
    (folder / "square.obj").write_text(SQUARE)
    words = ["render", "square.obj", "--resolution", "12x16", "--sun", "0,0,-1:3", "--point", "-1,0,2:5,6,7"]
    words += ["--eye", "-0.5,0,3", "--target", "0,0,0", "--fov-x-deg", "40", "--gaze", "-20,3.5/4,5"]
    assert main([*words, "-o", "frame.exr"]) == 0
    frame = load_frame(folder / "frame.exr")
    assert frame.gaze.pixels.tolist() == [[-20.0, 3.5], [4.0, 5.0]]
    assert frame.camera.origin.mean(0).tolist() == pytest.approx([-0.5, 0, 3])
    assert (frame.camera.bounds[0, 1] - frame.camera.bounds[0, 0]) / 2 == pytest.approx(np.tan(np.radians(20)))
    parsed = __main__.build_parser().parse_args(options.join_negative_values([*words, "-o", "frame.exr"]))
    assert parsed.lights == [DirectionalLight((0, 0, -1), 3), PointLight((-1, 0, 2), (5, 6, 7))]
    assert torch.equal(options.gaze_of(parsed, frame.camera).pixels, frame.gaze.pixels)
    assert isinstance(options.gaze_of(parsed, frame.camera), Gaze)


def test_a_reference_goes_on_where_it_stopped(folder):
    words = ["reference", "cornell_box", "--resolution", "12x10", "-o"]
    assert main([*words, "short.exr", "--spp", "4", "--checkpoint", "work.safetensors"]) == 0
    assert main([*words, "long.exr", "--spp", "12", "--checkpoint", "work.safetensors"]) == 0
    assert main([*words, "whole.exr", "--spp", "12"]) == 0
    long, whole = load_reference(folder / "long.exr"), load_reference(folder / "whole.exr")
    assert long.count == whole.count == 12
    assert torch.equal(long.mean, whole.mean)
    assert (folder / "whole.safetensors").exists()
    assert pixels_of(folder / "whole.png").shape == (12, 20, 3)


@pytest.mark.parametrize(
    ("words", "levels"),
    [([], (3, 4, 5)), (["--method", "base"], (5,)), (["--method", "nh2ld"], (3, 5)), (["--levels", "1,2"], (1, 2))],
)
def test_denoise_writes_what_the_module_makes(folder, frame, words, levels):
    assert main(["denoise", "frame.exr", *words, "-o", "clean.exr"]) == 0
    with torch.no_grad():
        expected = NonHomogeneousAtrous(levels)(frame).image
    assert torch.equal(load_image(folder / "clean.exr"), expected)
    assert pixels_of(folder / "clean.png").shape == (24, 40, 3)


def test_tune_learns_what_denoise_reads(folder, capsys):
    words = ["tune", "cornell_box", "--resolution", "24x20", "--frames", "3", "--reference-spp", "16", "--steps", "4"]
    assert main([*words, "-o", "tuned"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"edge_stopping\.2\.sigma_position +0\.03 -> +0\.0", said)
    assert re.search(r"Frames held out: error [\d.]+ -> [\d.]+ at step \d", said)
    names = {path.name for path in (folder / "tuned").iterdir()}
    assert names >= {"parameters.safetensors", "parameters.json", "history.csv", "history.png", "after.png"}
    assert main([*words, "-o", "tuned"]) == 0  # nothing is left to be done
    assert capsys.readouterr().out == said

    main(["render", "cornell_box", "--resolution", "24x20", "-o", "frame.exr"])
    learned = NonHomogeneousAtrous()
    load_parameters(learned, folder / "tuned" / "parameters.safetensors")
    assert main(["denoise", "frame.exr", "--parameters", "tuned/parameters.safetensors", "-o", "clean.exr"]) == 0
    with torch.no_grad():
        assert torch.allclose(load_image(folder / "clean.exr"), learned(load_frame(folder / "frame.exr")).image)
    wrong = ["denoise", "frame.exr", "--method", "base", "--parameters", "tuned/parameters.safetensors"]
    assert main([*wrong, "-o", "clean.exr"]) == 2
    assert "levels: expected [5], as in the module, got [3, 4, 5]" in capsys.readouterr().err


@pytest.mark.usefixtures("frame")
def test_tune_takes_frames_from_files(capsys):
    main(["reference", "cornell_box", "--resolution", "24x20", "--spp", "16", "-o", "truth.exr"])
    pair = ["--pair", "frame.exr", "truth.exr"]
    assert main(["tune", *pair, *pair, "--steps", "2", "--error", "smape", "-o", "tuned"]) == 0
    capsys.readouterr()
    assert main(["tune", *pair, "--steps", "2", "-o", "other"]) == 2
    assert "--held-out: expected fewer than the 1 frames there are, got 1" in capsys.readouterr().err
    assert main(["tune", "-o", "other"]) == 2
    assert "SCENE: expected a scene, or --pair, not both" in capsys.readouterr().err
    assert main(["tune", "atrium", "--error", "best", "-o", "other"]) == 2
    assert "expected names of smape" in capsys.readouterr().err


def test_denoise_to_a_picture_alone_at_a_given_exposure(folder, frame):
    assert main(["denoise", "frame.exr", "--demodulate", "--exposure", "0.5", "-o", "clean.png"]) == 0
    assert not (folder / "clean.exr").exists()
    with torch.no_grad():
        shown = color.display(NonHomogeneousAtrous.nh3ld(demodulate=True)(frame).image, 0.5)
    assert pixels_of(folder / "clean.png")[3, 5, 0] == np.floor(float(shown[0, 0, 3, 5]) * 255 + 0.5)


def test_compare_prints_its_table_and_draws_figures_that_can_be_drawn_again(folder, capsys):
    words = ["compare", "cornell_box", "--resolution", "24x20", "--reference-spp", "2", "--repeats", "1"]
    assert main([*words, "-o", "results/box"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("Noisy, foveated", "Mask ignored", "NH2LD", "NH3LD", "Base, equal paths"))
    assert "Look at results/box/figures/overview.png" in text
    assert "Open results/box/report.html" in text
    picture = folder / "results" / "box" / "figures" / "overview.png"
    before = pixels_of(picture)
    picture.unlink()
    assert main(["figures", "results/box"]) == 0
    assert np.array_equal(pixels_of(picture), before)
    page = folder / "results" / "box" / "report.html"
    written = page.read_bytes()
    page.unlink()
    assert main(["report", "results/box"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "results/box/report.html"
    assert page.read_bytes() == written


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["render", "no_such_scene", "-o", "a.exr"], "no_such_scene"),
        (["render", "absent.obj", "-o", "a.exr"], "absent.obj"),
        (["render", "dark.obj", "--eye", "0,0,3", "--target", "0,0,0", "-o", "a.exr"], "no light"),
        (["render", "dark.obj", "--sky", "1", "-o", "a.exr"], "has no camera"),
        (["render", "dark.obj", "--sky", "-1", "-o", "a.exr"], "non-negative"),
        (["render", "atrium", "--sun", "0,0,0:1", "-o", "a.exr"], "a vector that is not zero"),
        (["render", "atrium", "--sun", "0,1:1", "-o", "a.exr"], "expected 3 numbers"),
        (["render", "atrium", "--point", "1,2,3", "-o", "a.exr"], "expected x,y,z:value"),
        (["render", "atrium", "--resolution", "0x10", "-o", "a.exr"], "expected height x width"),
        (["render", "atrium", "--spp", "0", "-o", "a.exr"], "at least 1"),
        (["render", "atrium", "--seed", "4294967296", "-o", "a.exr"], "from 0 to 4294967295"),
        (["render", "atrium", "--gaze", "1,2/3,4/5,6", "-o", "a.exr"], "one gaze or two"),
        (["render", "atrium", "-o", "a.png"], "ends in .exr"),
        (["render", "atrium", "-o", "nowhere/a.exr"], "folder nowhere does not exist"),
        (["render", "cornell_box", "--eye", "0,0,0", "--target", "0,0,0", "-o", "a.exr"], "away from the eye"),
        (["denoise", "absent.exr", "-o", "a.png"], "absent.exr: no such file"),
        (["denoise", "dark.obj", "-o", "a.png"], "expected an OpenEXR file"),
        (["denoise", "absent.exr", "--levels", "3,x", "-o", "a.png"], "whole numbers of at least 1"),
        (["denoise", "absent.exr", "--exposure", "0", "-o", "a.png"], "above 0"),
        (["compare", "cornell_box", "--resolution", "8x8", "--reference", "absent.exr", "-o", "out"], "no such file"),
        (["figures", "."], "expected the folder of a finished run"),
        (["report", "."], "expected the folder of a finished run"),
        (["compare", "atrium"], "required: -o/--output"),
        ([], "required: COMMAND"),
        (["paint"], "invalid choice"),
    ],
)
def test_bad_input_is_one_line_and_status_2(folder, capsys, words, message):
    (folder / "dark.obj").write_text(SQUARE)
    assert main(words) == 2
    captured = capsys.readouterr()
    (line,) = [line for line in captured.err.splitlines() if not line.startswith("cornell_box: ")]
    assert line.startswith("fovden: error: ")
    assert message in line
    assert not list(folder.glob("a.*"))


def test_a_warning_is_one_line(frame, capsys):
    capsys.readouterr()
    assert main(["denoise", "frame.exr", "--levels", "5,3", "-o", "clean.png"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("fovden: warning: levels: ")
    assert frame.view_count == 2


def test_ctrl_c_ends_with_130_and_leaves_nothing_half_written(tmp_path):
    words = ["reference", "cornell_box", "--resolution", "256x256", "--spp", "1000000", "-o", "reference.exr"]
    # in a process that was started in the background the signal would be ignored, hence the first lines
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from fovden.__main__ import main; sys.exit(main(sys.argv[1:]))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, *words],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(__main__.__file__).resolve().parents[1])},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    try:
        said = b""
        while b"spp" not in said:  # the progress bar, so it is tracing
            said += os.read(process.stderr.fileno(), 4096)
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=30)
        assert time.monotonic() - began < 10
    finally:
        process.kill()
    assert process.returncode == 130
    assert rest.decode().splitlines()[-1] == "fovden: interrupted"
    assert "Traceback" not in rest.decode()
    assert [entry.name for entry in tmp_path.iterdir() if entry.name != "reference.safetensors"] == []


def test_ctrl_c_while_writing_leaves_the_old_files(folder, frame, monkeypatch):
    before = (folder / "frame.exr").read_bytes()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("fovden.io.exr.OpenEXR.File.write", interrupted)
    assert main(["render", "cornell_box", "--resolution", "24x20", "--seed", "1", "-o", "frame.exr"]) == 130
    assert (folder / "frame.exr").read_bytes() == before
    assert sorted(entry.name for entry in folder.iterdir()) == ["frame.exr", "frame.png"]
    assert frame.seed == 0


def test_the_script_of_the_experiment_runs(folder, capsys):
    compare = pytest.importorskip("experiments.compare_denoisers")
    assert compare.main(["--preset", "smoke", "-o", "results"]) == 0
    assert "NH3LD" in capsys.readouterr().out
    assert (folder / "results" / "figures" / "overview.png").exists()
    assert (folder / "results" / "report.html").exists()
    view = compare.sponza().view
    assert view.lights == (DirectionalLight((0.15, -1, 0.25), 12), PointLight((0, 4.5, -0.4), 40))


def test_scenes_are_listed_and_pictured(folder, capsys):
    assert main(["scenes", "cornell_box", "atrium", "--detail", "2000", "--list"]) == 2
    assert "detail" in capsys.readouterr().err
    assert main(["scenes", "--list"]) == 0
    text = capsys.readouterr().out
    for words in ("atrium: 262,267 triangles; 1 directional light, 1 point light", "--view gallery"):
        assert words in text
    assert not list(folder.iterdir())
    small = ["--detail", "2000", "--spp", "1", "--resolution", "12x16", "-o", "pictures"]
    assert main(["scenes", "atrium", *small]) == 0
    assert "atrium: 2,000 triangles" in capsys.readouterr().out
    views = make_scene("atrium", detail=2000).views
    assert {path.name for path in Path("pictures").iterdir()} == {
        "atrium.png",
        *(f"atrium_{name}.png" for name in views),
    }
    assert pixels_of("pictures/atrium.png").shape == (12, 16, 3)


def test_another_view_of_a_scene(folder, capsys):
    common = ["render", "atrium", "--spp", "1", "--resolution", "12x16", "-o"]
    assert main([*common, "one.exr"]) == 0
    assert main([*common, "other.exr", "--view", "gallery"]) == 0
    expected = make_scene("atrium").views["gallery"].at((12, 16)).views
    assert torch.allclose(load_frame(folder / "other.exr").camera.origin, expected.origin)
    assert not torch.allclose(load_frame(folder / "one.exr").camera.origin, expected.origin)
    assert main([*common, "no.exr", "--view", "cellar"]) == 2
    assert "view: expected one of" in capsys.readouterr().err
