"""The comparison's numbers are those of its saved images, and its settings mean what they say."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from fovden import color
from fovden.comparison import METHODS, PRESETS, CompareSettings, SceneSettings, compare_denoisers, summary
from fovden.filters import NonHomogeneousAtrous
from fovden.io import load_frame, load_image, load_reference, save_reference
from fovden.results import Measurement, read_config, read_metrics
from fovden.tracer import PointLight

HEIGHT, WIDTH = 40, 36
VIEW = SceneSettings("cornell_box", lights=(PointLight((2.7, 4.0, 2.7), 0.5),), resolution=(HEIGHT, WIDTH))
SETTINGS = CompareSettings(VIEW, reference_spp=8, gaze=((20.0, 15.0), (16.0, 15.0)), repeats=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("comparison") / "new" / "folder"
    compare_denoisers(SETTINGS, folder, progress=False)
    return folder


def values(folder, metric, region="whole"):
    return {
        (row.method, row.view): row.value
        for row in read_metrics(folder)
        if (row.metric, row.region) == (metric, region)
    }


def images(folder):
    frames = {name: load_frame(folder / "frames" / f"{name}.exr") for name in ("full", "foveated")}
    return {
        "Noisy, full": frames["full"].radiance,
        "Noisy, foveated": frames["foveated"].radiance,
        "Mask ignored": load_image(folder / "images" / "mask_ignored.exr"),
        "Base": load_image(folder / "images" / "base.exr"),
        "NH2LD": load_image(folder / "images" / "nh2ld.exr"),
        "NH3LD": load_image(folder / "images" / "nh3ld.exr"),
        "Base, equal paths": load_image(folder / "images" / "base_equal_paths.exr"),
    }


def test_the_table_is_that_of_the_saved_images(folder):
    truth = load_reference(folder / "reference.exr")
    assert truth.count == 8
    exposure = values(folder, "exposure")["Reference", ""]
    assert exposure == color.exposure(truth.mean)
    layer = load_frame(folder / "frames" / "foveated.exr").layer.numpy()
    shown = color.display(truth.mean, exposure).numpy().astype(np.float64)
    scores, inner = values(folder, "psnr"), values(folder, "psnr", "layer 0")
    assert {method.name for method in METHODS} == {method for method, _ in scores}
    for method, image in images(folder).items():
        squared = (color.display(image, exposure).numpy().astype(np.float64) - shown) ** 2
        for view in (0, 1):
            assert scores[method, view] == pytest.approx(-10 * math.log10(squared[view].mean()), abs=1e-3)
            inside = squared[view][:, layer[view, 0] == 0]
            assert inner[method, view] == pytest.approx(-10 * math.log10(inside.mean()), abs=1e-3)


def test_the_images_are_what_the_denoisers_make_of_the_saved_frames(folder):
    frames = {name: load_frame(folder / "frames" / f"{name}.exr") for name in ("full", "foveated", "equal_paths")}
    foveated = frames["foveated"]
    blind = replace(foveated, counts=torch.ones_like(foveated.counts))
    made = images(folder)
    with torch.no_grad():
        for name, denoiser, frame in (
            ("Base", NonHomogeneousAtrous.base(), frames["full"]),
            ("NH2LD", NonHomogeneousAtrous.nh2ld(), foveated),
            ("NH3LD", NonHomogeneousAtrous.nh3ld(), foveated),
            ("Mask ignored", NonHomogeneousAtrous.nh3ld(), blind),
            ("Base, equal paths", NonHomogeneousAtrous.base(), frames["equal_paths"]),
        ):
            assert torch.allclose(denoiser(frame).image, made[name], rtol=1e-5, atol=1e-6), name
    assert not torch.allclose(made["Mask ignored"], made["NH3LD"], rtol=0.05)


def test_paths_are_counted_and_equal_where_they_should_be(folder):
    paths = values(folder, "paths")
    pixels = 2 * HEIGHT * WIDTH
    assert paths["Base", ""] == paths["Noisy, full", ""] == 4 * pixels
    foveated = load_frame(folder / "frames" / "foveated.exr")
    assert paths["NH3LD", ""] == paths["NH2LD", ""] == int(foveated.counts.sum()) < 4 * pixels / 1.3
    assert foveated.gaze.pixels.tolist() == [[20.0, 15.0], [16.0, 15.0]]
    # the remainder of the mean is drawn per pixel, shared by the eyes: sd = 2 sqrt(n / 4) at most, n pixels of one eye
    assert abs(paths["Base, equal paths", ""] - paths["NH3LD", ""]) < 5 * 2 * math.sqrt(pixels / 2 / 4)
    for method in METHODS:
        costs = {name: values(folder, f"seconds_{name}")[method.name, ""] for name in ("trace", "denoise", "total")}
        assert costs["total"] == pytest.approx(costs["trace"] + costs["denoise"])
        assert (costs["denoise"] > 0) == (method.denoiser is not None)


def test_the_settings_are_kept_complete(folder):
    config = read_config(folder)
    assert config["view"]["scene"] == "cornell_box"
    assert config["view"]["lights"] == [{"kind": "PointLight", "position": [2.7, 4.0, 2.7], "intensity": [0.5] * 3}]
    assert config["gaze"] == [[20.0, 15.0], [16.0, 15.0]]
    assert (config["spp"], config["reference_spp"], config["seed"], config["demodulate"]) == (4, 8, 0, False)
    seconds = json.loads((folder / "provenance.json").read_text())["seconds"]
    assert {"load scene", "build BVH", "trace frames", "reference", "denoise", "metrics"} <= set(seconds)


def test_another_run_in_the_folder_goes_on_with_its_reference_and_repeats_the_rest(folder, tmp_path):
    def quality():
        return [row for row in read_metrics(folder) if not row.metric.startswith("seconds")]

    before = quality()
    compare_denoisers(SETTINGS, folder, progress=False)
    assert quality() == before
    compare_denoisers(SETTINGS, tmp_path, reference=folder / "reference.exr", progress=False)
    assert [row for row in read_metrics(tmp_path) if not row.metric.startswith("seconds")] == before
    assert not (tmp_path / "reference.safetensors").exists()


def test_a_reference_left_by_other_settings_is_replaced(tmp_path):
    small = replace(SETTINGS, view=replace(VIEW, resolution=(16, 16)), gaze=None, reference_spp=2)
    compare_denoisers(small, tmp_path, progress=False)
    compare_denoisers(replace(small, seed=1), tmp_path, progress=False)
    assert load_reference(tmp_path / "reference.exr").seed == 1


def test_a_reference_of_another_view_is_refused(folder, tmp_path):
    truth = load_reference(folder / "reference.exr")
    moved = replace(truth, camera=replace(truth.camera, origin=truth.camera.origin + 0.1))
    for name, wrong in (("moved", moved), ("unknown", replace(truth, camera=None))):
        save_reference(tmp_path / f"{name}.exr", wrong)
        with pytest.raises(ValueError, match="the reference of another view"):
            compare_denoisers(SETTINGS, tmp_path / "out", reference=tmp_path / f"{name}.exr", progress=False)


def test_numbers_of_samples_are_checked():
    for name in ("spp", "reference_spp", "repeats"):
        with pytest.raises(ValueError, match=f"{name}: expected an integer of at least 1"):
            replace(SETTINGS, **{name: 0})


def test_the_smallest_preset_is_small_and_the_demo_is_the_atrium():
    assert PRESETS["smoke"].view.resolution[0] <= 64
    assert PRESETS["demo"].view.scene == "atrium"


# Scenes and cameras


def write_square(folder):
    path = folder / "square.obj"
    path.write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n")
    return str(path)


def test_a_file_needs_a_camera_and_takes_the_given_one(tmp_path):
    scene = write_square(tmp_path)
    with pytest.raises(ValueError, match=r"eye, target: expected two points, as .*square\.obj has no camera"):
        SceneSettings(scene).load()
    view = SceneSettings(scene, eye=(0, 0, 3), target=(0, 0, 0), resolution=(8, 6))
    loaded, camera = view.load()
    assert (loaded.triangle_count, camera.eye, camera.resolution) == (2, (0, 0, 3), (8, 6))
    assert camera.fov_x_deg == 75
    _, camera = replace(view, fov_x_deg=50.0, eye_separation=0.1).load()
    assert (camera.fov_x_deg, camera.eye_separation) == (50.0, 0.1)
    light = PointLight((0, 0, 2), 1)
    assert replace(view, lights=(light,)).load()[0].lights == (light,)


def test_a_scene_made_in_code_keeps_its_own_lights_and_camera():
    scene, camera = SceneSettings("cornell_box").load()
    brighter, turned = replace(VIEW, fov_x_deg=20.0, target=(0.0, 0.0, 0.0)).load()
    assert brighter.lights == (*scene.lights, *VIEW.lights)
    assert (turned.eye, turned.target) == (camera.eye, (0.0, 0.0, 0.0))
    assert (turned.fov_x_deg, turned.fov_y_deg) == (20.0, None)
    with pytest.raises(ValueError, match="skip_materials: expected none"):
        SceneSettings("cornell_box", skip_materials=("white",)).load()
    with pytest.raises(ValueError, match="no_such_scene"):
        SceneSettings("no_such_scene").load()
    with pytest.raises(FileNotFoundError, match="absent"):
        SceneSettings("absent.obj").load()


def test_the_summary_averages_the_views_and_compares_with_base():
    rows = []
    for method, psnr, seconds in (("Base", 30.0, 3.0), ("NH3LD", 28.0, 2.0)):
        rows += [Measurement("box", 0, view, method, "whole", "psnr", psnr + view) for view in (0, 1)]
        for metric, value in (("paths", 2e6), ("seconds_paths", seconds), ("seconds_denoise", 1.0)):
            rows.append(Measurement("box", 0, "", method, "whole", metric, value))
        rows.append(Measurement("box", 0, "", method, "whole", "seconds_total", seconds + 1))
    rows.append(Measurement("box", 0, "", "Foveation", "layer 0", "radius", 144.0))
    header, base, foveated = summary(rows).splitlines()
    assert header.split()[:5] == ["method", "PSNR", "/", "dB", "Mpaths"]
    assert base.split() == ["Base", "30.50", "2.000", "3.000", "1.000", "1.00", "1.00"]
    assert foveated.split() == ["NH3LD", "28.50", "2.000", "2.000", "1.000", "1.50", "1.33"]
