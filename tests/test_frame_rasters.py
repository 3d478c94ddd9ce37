"""Frames in cells: the raster travels with the images, or is refused where it does not fit."""

from dataclasses import fields, replace

import pytest
import torch

from fovden import Frame, Gaze, GBuffer, StereoCamera
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp, thinned
from fovden.io import load_frame, save_frame

CAMERA = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(12, 16)).views
GAZE = Gaze(torch.tensor([[4.25, 3.0], [9.0, -2.5]]))
WARPS = [
    ScreenWarp(GAZE, (12, 16), (12, 16)),
    LogPolarWarp(GAZE, (12, 16), (6, 9), "rotate", alpha=torch.tensor(3.3, dtype=torch.float64)),
    VisualPolarWarp(GAZE, (12, 16), (8, 10), cut="stair", metric="angle", e_max=17.5, block=4),
]
each_warp = pytest.mark.parametrize("warp", WARPS, ids=lambda warp: warp.name)


def make_frame(warp, **options):
    radiance = torch.rand(2, 3, *warp.resolution, generator=torch.Generator().manual_seed(0))
    frame = Frame.from_radiance(radiance, GBuffer.empty(2, warp.resolution))
    return replace(frame, warp=warp, gaze=warp.gaze, **options)


def assert_same_warp(first, second):
    assert type(first) is type(second)
    assert torch.equal(first.gaze.pixels, second.gaze.pixels)
    for field in fields(first)[1:]:
        one, other = getattr(first, field.name), getattr(second, field.name)
        assert type(one) is type(other), field.name
        assert (one.dtype == other.dtype and torch.equal(one, other)) if isinstance(one, torch.Tensor) else one == other


@each_warp
def test_raster_is_the_name_of_the_warp(warp):
    assert make_frame(warp).raster == warp.name
    assert replace(make_frame(warp), warp=None).raster == "screen"


@each_warp
def test_files_keep_the_raster(warp, tmp_path):
    frame = make_frame(warp, camera=CAMERA)
    save_frame(tmp_path / "frame.exr", frame)
    loaded = load_frame(tmp_path / "frame.exr")
    assert torch.equal(loaded.radiance, frame.radiance)
    assert loaded.camera.resolution == (12, 16)
    assert_same_warp(loaded.warp, frame.warp)
    assert load_frame(tmp_path / "frame.exr", camera=CAMERA).resolution == warp.resolution
    with pytest.raises(ValueError, match="camera: expected the file's views, height and width"):
        load_frame(tmp_path / "frame.exr", camera=replace(CAMERA, resolution=(5, 5)))


def test_files_refuse_a_raster_that_they_cannot_name(tmp_path):
    class Mine(LogPolarWarp):
        pass

    frame = make_frame(Mine(GAZE, (12, 16), (6, 9)))
    with pytest.raises(ValueError, match=r"frame\.warp: expected a raster that files can name.*got Mine"):
        save_frame(tmp_path / "frame.exr", frame)
    assert not (tmp_path / "frame.exr").exists()


@each_warp
def test_stacked_frames_have_the_gazes_of_all(warp):
    other = replace(warp, gaze=Gaze(GAZE.pixels + 1))
    both = Frame.stack([make_frame(warp, camera=CAMERA), make_frame(other, camera=CAMERA)])
    assert both.view_count == both.camera.view_count == 4
    assert both.camera.resolution == (12, 16)
    assert_same_warp(both.warp, replace(warp, gaze=Gaze(torch.cat([GAZE.pixels, GAZE.pixels + 1]))))


@pytest.mark.parametrize("changed", [{"alpha": 2.0}, {"fovea_border": "clamp"}, {"screen": (12, 17)}])
def test_frames_of_different_rasters_are_not_stacked(changed):
    frame = make_frame(WARPS[1])
    other = replace(frame, warp=replace(WARPS[1], **changed))
    with pytest.raises(ValueError, match=r"frames\[1\]\.warp: expected log-polar with the first one's parameters"):
        Frame.stack([frame, other])
    with pytest.raises(ValueError, match=r"frames\[1\]\.warp: .*got screen"):
        Frame.stack([frame, replace(frame, warp=None)])


def test_moving_moves_the_raster():
    warp = make_frame(WARPS[1], camera=CAMERA).to(torch.float32).warp
    assert (warp.gaze.pixels.dtype, warp.alpha.dtype) == (torch.float32, torch.float32)
    assert make_frame(WARPS[2]).to(torch.float64).warp.gaze.pixels.dtype == torch.float64


@each_warp
def test_thinned_frames_keep_the_raster(warp):
    frame = make_frame(warp)
    assert thinned(frame, torch.ones(1, 1, *warp.resolution)).warp is warp


def test_what_does_not_fit_is_an_error():
    frame = make_frame(WARPS[1])
    with pytest.raises(ValueError, match=r"warp\.resolution: expected \(6, 9\), as the images have, got \(8, 10\)"):
        replace(frame, warp=WARPS[2])
    with pytest.raises(ValueError, match=r"camera\.resolution: expected the warp's screen, \(12, 16\), got \(6, 9\)"):
        replace(frame, camera=replace(CAMERA, resolution=(6, 9)))
    with pytest.raises(ValueError, match=r"warp\.gaze\.pixels: expected shape"):
        replace(frame, warp=replace(WARPS[1], gaze=Gaze(torch.zeros(3, 2))))


def test_cards_speak_of_cells():
    card = make_frame(WARPS[2])._repr_html_()
    assert "2 of 10 x 8 cells" in card
    assert "raster visual-polar" in card
