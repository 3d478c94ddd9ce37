"""Files are whole or not there, and pictures have the nearest of 256 levels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from exr_files import make_frame
from PIL import Image

from fovden.io import (
    atomic_write,
    save_frame,
    save_png,
)


def test_what_cannot_be_written_is_refused(tmp_path):
    frame = make_frame()
    with pytest.raises(ValueError, match=r"path: expected a name that ends in \.exr"):
        save_frame(tmp_path / "frame.png", frame)
    with pytest.raises(FileNotFoundError, match=r"the folder .* does not exist"):
        save_frame(tmp_path / "nowhere" / "frame.exr", frame)
    with pytest.raises(ValueError, match=r"expected torch\.float32, got torch\.float64"):
        save_frame(tmp_path / "frame.exr", frame.to(torch.float64))
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(IsADirectoryError, match="this is a folder"):
        save_frame(tmp_path / "folder.exr", frame)
    assert [entry.name for entry in tmp_path.iterdir()] == ["folder.exr"]


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "frame.exr"
    frame = make_frame()
    save_frame(path, frame)
    before = path.read_bytes()

    def interrupted(_, name):
        Path(name).write_bytes(b"half a file")
        raise KeyboardInterrupt

    monkeypatch.setattr(OpenEXR.File, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_frame(path, replace(frame, seed=1))
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["frame.exr"]


def test_a_library_failure_is_an_os_error(tmp_path, monkeypatch):
    def full(_, __):
        raise RuntimeError("no space")

    monkeypatch.setattr(OpenEXR.File, "write", full)
    with pytest.raises(OSError, match=r"frame\.exr: cannot be written \(no space\)"):
        save_frame(tmp_path / "frame.exr", make_frame())


def test_atomic_write_replaces_only_when_the_block_ends_well(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def stop_halfway():
        with atomic_write(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        stop_halfway()
    assert path.read_text() == "old"
    with atomic_write(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


def test_a_png_holds_the_nearest_of_256_levels_with_the_views_side_by_side(tmp_path):
    levels = torch.arange(256) / 255
    steps = torch.cat([levels, levels[:-1] + 0.49 / 255, levels[1:] - 0.49 / 255])
    image = torch.zeros(2, 3, 2, len(steps))
    image[0, 0, 0] = steps
    image[1, 2, 1] = 1
    save_png(tmp_path / "a.png", image)
    with Image.open(tmp_path / "a.png") as file:
        pixels = np.array(file)
    assert pixels.shape == (2, 2 * len(steps), 3)
    expected = np.concatenate([np.arange(256), np.arange(255), np.arange(1, 256)])
    assert np.array_equal(pixels[0, : len(steps), 0], expected)
    assert (pixels[1, len(steps) :, 2] == 255).all()
    assert pixels.sum() == expected.sum() + 255 * len(steps)


def test_a_png_refuses_linear_radiance_and_wrong_names(tmp_path):
    for bad in (1.01, -0.01, float("nan")):
        with pytest.raises(ValueError, match="image: expected"):
            save_png(tmp_path / "a.png", torch.full((1, 3, 2, 2), bad))
    with pytest.raises(ValueError, match="image: expected shape"):
        save_png(tmp_path / "a.png", torch.zeros(3, 2, 2))
    with pytest.raises(ValueError, match=r"ends in \.png"):
        save_png(tmp_path / "a.jpg", torch.zeros(1, 3, 2, 2))
    assert not list(tmp_path.iterdir())
