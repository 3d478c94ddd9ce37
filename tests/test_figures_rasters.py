"""The drawn rasters: every cell has its lines, and they close around the gaze."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

from fovden.camera import Gaze
from fovden.figures import draw_rasters
from fovden.figures.rasters import _borders
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp

GAZE = Gaze(torch.tensor([[20.0, 13.0]]))


@pytest.mark.parametrize(
    "warp", [VisualPolarWarp(GAZE, (24, 32), (30, 20)), LogPolarWarp(GAZE, (24, 32), (14, 10), alpha=2.0)]
)
def test_the_lines_of_a_column_make_whole_circles(warp):
    lines = np.stack(_borders(warp))
    assert len(lines) == warp.cell_count
    offsets = lines - np.array([20.0, 13.0])
    radius, angle = np.linalg.norm(offsets, axis=-1), np.arctan2(offsets[..., 1], offsets[..., 0])
    assert np.ptp(radius[:, 1:], axis=1).max() < 1e-6  # the arc keeps its distance
    turned = np.abs((np.diff(angle[:, 1:], axis=1) + np.pi) % (2 * np.pi) - np.pi).sum(axis=1)
    total = turned.sum()
    assert total == pytest.approx(2 * math.pi * warp.resolution[1], rel=1e-6)  # no gap at the angle 0


def test_a_picture_for_each_warp(tmp_path):
    warps = {"a": VisualPolarWarp(GAZE, (24, 32), (12, 10)), "screen": ScreenWarp(GAZE, (24, 32), (24, 32))}
    path = draw_rasters(warps, tmp_path / "rasters.png")
    with Image.open(path) as image:
        assert image.width > image.height > 500
        assert np.asarray(image.convert("L")).std() > 10
    with pytest.raises(ValueError, match="warps: expected at least one"):
        draw_rasters({}, tmp_path / "none.png")
