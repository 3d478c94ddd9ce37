"""Every file that cannot be used gives one clear error."""

import struct

import numpy as np
import OpenEXR
import pytest
import torch
from exr_files import foreign_channels, make_frame, write_exr
from PIL import Image

from fovden.camera import StereoCamera
from fovden.frame import Reference
from fovden.io import (
    load_exr,
    load_frame,
    load_reference,
    save_frame,
    save_reference,
)


def test_missing_needed_channels_are_named_beside_those_present(tmp_path):
    channels = {name: plane for name, plane in foreign_channels().items() if name[:2] != "nn"}
    del channels["G"]
    write_exr(tmp_path / "frame.exr", channels)
    with pytest.raises(ValueError, match=r"no radiance and no normal\..*N\.X.*the file has B, R, albedo\.B") as caught:
        load_frame(tmp_path / "frame.exr")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bad", [-1e-3, float("nan"), float("inf")])
def test_light_that_cannot_be_is_refused(tmp_path, bad):
    channels = foreign_channels()
    channels["Z"] = np.ones((6, 8), np.float32)
    channels["G"][2, 1] = bad
    write_exr(tmp_path / "frame.exr", channels)
    with pytest.raises(ValueError, match=r"frame\.exr: direct: expected finite values of at least 0"):
        load_frame(tmp_path / "frame.exr")
    frame = make_frame()
    frame.indirect[1, 2, 3, 4] = bad
    with pytest.raises(ValueError, match=r"frame\.indirect: expected finite values of at least 0.*\(1, 2, 3, 4\)"):
        save_frame(tmp_path / "new.exr", frame)
    assert not (tmp_path / "new.exr").exists()


def test_nan_geometry_and_a_camera_of_another_size_are_refused(tmp_path):
    channels = foreign_channels()
    channels["nn.X"][1, 1] = np.nan
    write_exr(tmp_path / "frame.exr", channels)
    with pytest.raises(ValueError, match="normal: expected numbers, got NaN"):
        load_frame(tmp_path / "frame.exr")
    save_frame(tmp_path / "own.exr", make_frame())
    camera = StereoCamera.look_at((0, 0, 4), (0, 0, 0), fov_y_deg=60, resolution=(16, 16))
    with pytest.raises(ValueError, match=r"camera: expected .*\(2, 19, 23\), got \(2, 16, 16\)"):
        load_frame(tmp_path / "own.exr", camera=camera)


def test_a_file_cut_short_anywhere_is_one_error_and_no_noise(tmp_path, capfd):
    whole = tmp_path / "whole.exr"
    save_frame(whole, make_frame())
    content = whole.read_bytes()
    cut = tmp_path / "cut.exr"
    lengths = {0, 3, 4, 7, 8, 20, 300, len(content) // 3, len(content) // 2, len(content) - 1000, len(content) - 1}
    for length in sorted(lengths | set(range(9, len(content), len(content) // 40))):
        cut.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"cut\.exr: .*(an OpenEXR file|cut short or damaged)") as caught:
            load_frame(cut)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["tiled", "parts"])
def test_other_storage_cut_short(tmp_path, kind):
    pixels = {letter: np.random.default_rng(0).random((70, 50), dtype=np.float32) for letter in "RGB"}
    path = tmp_path / "a.exr"
    if kind == "tiled":
        write_exr(path, pixels, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription())
    else:
        parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": name}, dict(pixels), name) for name in "ab"]
        with OpenEXR.File(parts) as file:
            file.write(str(path))
    assert torch.equal(load_exr(path)["R"], torch.from_numpy(pixels["R"]))
    content = path.read_bytes()
    for length in (len(content) - 1, len(content) - 2000, len(content) // 2, 200):
        path.write_bytes(content[:length])
        with pytest.raises(ValueError, match="cut short or damaged"):
            load_exr(path)


def test_damaged_pixels_are_an_error(tmp_path):
    path = tmp_path / "frame.exr"
    save_frame(path, make_frame())
    content = bytearray(path.read_bytes())
    content[-3000:-1000] = bytes(2000)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"frame\.exr: .*damaged"):
        load_frame(path)


def test_damaged_attributes_are_an_error(tmp_path):
    path = tmp_path / "frame.exr"
    save_frame(path, make_frame())
    content = path.read_bytes()
    path.write_bytes(content.replace(b'"stair"', b'"stair '))
    with pytest.raises(ValueError, match=r"frame\.exr: attribute fovden_warp: expected JSON"):
        load_frame(path)
    path.write_bytes(content.replace(b"fovden_gaze", b"fovden_haze"))
    with pytest.raises(ValueError, match=r"got a file without fovden_gaze"):
        load_frame(path)


def test_what_is_no_exr_file_is_told_so(tmp_path):
    (tmp_path / "text.exr").write_text("no picture")
    Image.new("RGB", (4, 4)).save(tmp_path / "png.exr", format="PNG")
    for name in ("text.exr", "png.exr"):
        with pytest.raises(ValueError, match="expected an OpenEXR file"):
            load_exr(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"none\.exr: no such file"):
        load_frame(tmp_path / "none.exr")
    with pytest.raises(FileNotFoundError, match="a folder, not a file"):
        load_frame(tmp_path)
    deep = bytearray(struct.pack("<4sI", b"\x76\x2f\x31\x01", 2 | 0x800) + bytes(64))
    (tmp_path / "deep.exr").write_bytes(deep)
    with pytest.raises(ValueError, match="deep"):
        load_exr(tmp_path / "deep.exr")


def test_frames_and_references_are_told_apart(tmp_path):
    save_frame(tmp_path / "frame.exr", make_frame())
    save_reference(tmp_path / "reference.exr", Reference(torch.ones(1, 3, 2, 2), torch.zeros(1, 3, 2, 2), 4))
    with pytest.raises(ValueError, match="expected a frame, got a reference"):
        load_frame(tmp_path / "reference.exr")
    with pytest.raises(ValueError, match=r"expected a reference.*got a frame"):
        load_reference(tmp_path / "frame.exr")
    write_exr(tmp_path / "other.exr", foreign_channels())
    with pytest.raises(ValueError, match="got another program's image"):
        load_reference(tmp_path / "other.exr")
