"""Frames, references and images come back from the disk to the bit, under the standard names."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import torch
from exr_files import HEIGHT, WIDTH, assert_same_frame, awkward, make_frame, same_bits, write_exr

from fovden.frame import Reference
from fovden.io import (
    load_exr,
    load_frame,
    load_image,
    load_reference,
    save_frame,
    save_image,
    save_reference,
)


@pytest.mark.parametrize("views", [1, 2, 3])
def test_a_frame_comes_back_to_the_bit(tmp_path, views):
    frame = make_frame(views)
    save_frame(tmp_path / "frame.exr", frame)
    assert_same_frame(load_frame(tmp_path / "frame.exr"), frame)


def test_a_frame_without_camera_and_gaze_comes_back_without_them(tmp_path):
    save_frame(tmp_path / "frame.exr", replace(make_frame(), camera=None, gaze=None))
    loaded = load_frame(tmp_path / "frame.exr")
    assert loaded.camera is None
    assert loaded.gaze is None


def test_saving_leaves_the_frame_alone_and_accepts_strided_tensors(tmp_path):
    frame = make_frame()
    strided = replace(frame, direct=frame.direct.permute(0, 1, 3, 2).contiguous().permute(0, 1, 3, 2))
    before = strided.direct.clone()
    save_frame(tmp_path / "frame.exr", strided)
    assert torch.equal(strided.direct, before)
    assert_same_frame(load_frame(tmp_path / "frame.exr"), frame)


def test_other_programs_find_the_standard_names(tmp_path):
    frame = make_frame()
    save_frame(tmp_path / "frame.exr", frame)
    with OpenEXR.File(str(tmp_path / "frame.exr"), separate_channels=True) as file:
        header, channels = dict(file.header()), dict(file.channels())
    assert header["multiView"] == ["left", "right"]
    assert {"fovden_camera", "fovden_gaze", "fovden_seed", "fovden_jitter", "fovden_index", "fovden_warp"} <= set(
        header
    )
    for name, expected in (
        ("R", frame.radiance[0, 0]),
        ("right.B", frame.radiance[1, 2]),
        ("albedo.G", frame.gbuffer.albedo[0, 1]),
        ("albedo.right.G", frame.gbuffer.albedo[1, 1]),
        ("N.right.Z", frame.gbuffer.normal[1, 2]),
        ("P.X", frame.gbuffer.position[0, 0]),
        ("Z", frame.gbuffer.depth[0, 0]),
        ("right.Z", frame.gbuffer.depth[1, 0]),
        ("direct.R", frame.direct[0, 0]),
    ):
        assert channels[name].pixels.dtype == np.float32
        assert np.array_equal(channels[name].pixels, expected.numpy()), name
    assert np.array_equal(channels["spp.Y"].pixels, frame.counts[0, 0].numpy())
    assert channels["prim.Y"].pixels.dtype == np.uint32
    assert channels["prim.Y"].pixels[0, 0] == 2**32 - 1


def test_a_reference_comes_back_to_the_bit(tmp_path):
    reference = Reference(
        awkward(2, 3, HEIGHT, WIDTH), awkward(2, 3, HEIGHT, WIDTH, seed=1), 1024, make_frame().camera, seed=9
    )
    save_reference(tmp_path / "reference.exr", reference)
    loaded = load_reference(tmp_path / "reference.exr")
    assert same_bits(loaded.mean, reference.mean)
    assert same_bits(loaded.variance, reference.variance)
    assert (loaded.count, loaded.seed) == (1024, 9)
    assert torch.equal(loaded.camera.bounds, reference.camera.bounds)


def test_an_image_comes_back_to_the_bit_and_is_found_in_every_kind_of_file(tmp_path):
    image = awkward(2, 3, HEIGHT, WIDTH)
    image[0, 0, 0, 0] = -0.25
    save_image(tmp_path / "image.exr", image)
    assert same_bits(load_image(tmp_path / "image.exr"), image)
    frame = make_frame()
    save_frame(tmp_path / "frame.exr", frame)
    assert same_bits(load_image(tmp_path / "frame.exr"), frame.radiance)
    with pytest.raises(ValueError, match="radiance: expected finite"):
        save_image(tmp_path / "bad.exr", torch.full((1, 3, 2, 2), float("nan")))
    write_exr(tmp_path / "grey.exr", {"Y": np.ones((2, 2), np.float32)})
    with pytest.raises(ValueError, match="expected the channels R, G, B, got Y"):
        load_image(tmp_path / "grey.exr")


def test_load_exr_gives_every_channel_by_name(tmp_path):
    write_exr(
        tmp_path / "a.exr", {"a.b.Q": np.full((2, 3), 7e4, np.float32), "id": np.full((2, 3), 2**32 - 2, np.uint32)}
    )
    channels = load_exr(tmp_path / "a.exr")
    assert channels["a.b.Q"].tolist() == [[7e4] * 3] * 2
    assert channels["id"].tolist() == [[-2] * 3] * 2
