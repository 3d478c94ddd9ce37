"""Rasters meet a budget of paths, wherever the eye looks."""

import math

import pytest
import torch

from fovden.camera import Gaze
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp, warp_at_budget

SCREEN = (96, 128)
GAZES = {
    "centre": [[64.0, 48.0], [64.0, 48.0]],
    "corner": [[1.0, 95.0], [1.0, 95.0]],
    "outside": [[200.0, 40.0], [180.0, 40.0]],
    "per eye": [[30.0, 40.0], [90.0, 60.0]],
}
WARPS = {
    "screen": lambda gaze: ScreenWarp(gaze, SCREEN, (48, 64)),
    "log-polar": lambda gaze: LogPolarWarp(gaze, SCREEN, (54, 71)),
    "visual-polar": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80)),
    "stair": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80), cut="stair", block=4),
}


@pytest.mark.parametrize("budget", [0.1, 0.4])
@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("name", WARPS)
def test_a_budget_is_met_as_nearly_as_columns_allow(name, gaze, budget):
    warp = WARPS[name](Gaze(torch.tensor(GAZES[gaze])))
    sized = warp_at_budget(warp, budget)
    target = budget * math.prod(SCREEN)
    found = int(sized.read.sum()) / 2
    # A column more or less is the unit. Where the gaze is outside few columns cross the screen; and where heights come
    # in steps, a column more makes up to a tenth of the cells of a raster as small as this one come and go.
    even = gaze in ("centre", "per eye")
    slack = target / 20 if name == "stair" else 0 if even else target / 50
    assert abs(found - target) <= max(found / sized.resolution[1], slack)
    aspect = sized.resolution[0] / sized.resolution[1]
    assert aspect == pytest.approx(warp.resolution[0] / warp.resolution[1], rel=0.12)
    assert type(sized) is type(warp)
    assert torch.equal(sized.gaze.pixels, warp.gaze.pixels)


def test_a_raster_around_a_corner_is_larger():
    centre, corner = (
        warp_at_budget(WARPS["visual-polar"](Gaze(torch.tensor(GAZES[gaze]))), 0.3) for gaze in ("centre", "corner")
    )
    assert corner.cell_count > 2 * centre.cell_count


def test_budgets_that_cannot_be_met_are_refused():
    warp = WARPS["log-polar"](Gaze(torch.tensor(GAZES["centre"])))
    with pytest.raises(ValueError, match=r"mean_spp: expected .*above 0"):
        warp_at_budget(warp, 0.0)
    with pytest.raises(ValueError, match=r"mean_spp: expected at least .* one cell"):
        warp_at_budget(warp, 1e-6)
