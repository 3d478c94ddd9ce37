"""Sample maps of the cells of a raster: rates of the screen at the cells, and budgets that count per pixel."""

import copy
import dataclasses
import pickle

import pytest
import torch

from fovden.camera import Gaze, StereoCamera
from fovden.foveation import (
    AcuityFalloff,
    LogPolarWarp,
    RateMap,
    SampleMap,
    ScreenWarp,
    ThreeLayer,
    VisualPolarWarp,
    sample_map,
    uniform_map,
)

CAMERA = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(40, 52)).views
GAZE = Gaze(torch.tensor([[20.2, 17.9], [26.0, 20.0]]))
WARPS = {
    "screen": ScreenWarp.for_camera(CAMERA, GAZE),
    "log-polar": LogPolarWarp.for_camera(CAMERA, GAZE),
    "visual-polar": VisualPolarWarp.for_camera(CAMERA, GAZE),
}
PIXELS = 40 * 52
each_warp = pytest.mark.parametrize("warp", WARPS.values(), ids=WARPS.keys())


def slope(camera, gaze):  # noqa: ARG001
    """A rate that tells where it was asked for: linear in x and y; layers by columns; without selection."""
    height, width = camera.resolution
    x, y = torch.arange(width) + 0.5, torch.arange(height)[:, None] + 0.5
    rate = (0.1 + 0.006 * x + 0.01 * y).expand(camera.view_count, 1, -1, -1)
    layer = (x / 13).int().expand_as(rate)
    return RateMap(rate, layer, selects=False)


@each_warp
def test_cells_have_the_rate_of_the_pixel_that_they_lie_on(warp):
    """Against the linear function at the cells' centres: half a pixel's slope in x and in y apart at most."""
    counts = sample_map(slope, CAMERA, spp=1000, warp=warp).counts.expand(2, -1, -1, -1)
    points = warp.cell_to_screen(warp.cells()).reshape(2, *warp.resolution, 2)
    inside = (warp.valid & warp.read)[:, 0]
    expected = 1000 * (0.1 + 0.006 * points[..., 0] + 0.01 * points[..., 1])
    # The count is the rate rounded up or down.
    assert ((counts[:, 0] - expected).abs() <= 1000 * (0.003 + 0.005) + 1.001)[inside].all()
    assert (counts[~warp.read] == 0).all()
    layer = sample_map(slope, CAMERA, warp=warp).layer.expand(2, -1, -1, -1)
    assert torch.equal(layer[:, 0][inside], (points[..., 0][inside].floor() / 13 + 0.5 / 13).int())


@each_warp
@pytest.mark.parametrize("source", ["stratified", "blue_noise"])
def test_budgets_count_per_pixel_of_the_screen(warp, source):
    for mean_spp in (0.05, 0.3):
        samples = sample_map(AcuityFalloff(), CAMERA, spp=2, mean_spp=mean_spp, source=source, warp=warp)
        assert samples.expected == pytest.approx(2 * PIXELS * mean_spp, rel=1e-6)
        for counts in samples.counts.expand(2, -1, -1, -1):
            assert abs(int(counts.sum()) - PIXELS * mean_spp) <= 1 + 1e-3  # half a cell's two paths
        assert samples.mean_spp == pytest.approx(mean_spp, abs=2 / PIXELS)


@each_warp
def test_uniform_maps_have_the_budget_of_the_screen(warp):
    """Within five standard deviations of independent draws, whose variance is at most a quarter per cell."""
    samples = uniform_map(CAMERA, 1.3, seed=5, warp=warp, per_eye=True)
    counts = samples.counts.expand(2, -1, -1, -1)
    assert samples.expected == pytest.approx(2 * 1.3 * PIXELS)
    assert abs(samples.paths - samples.expected) < 5 * (int(warp.read.sum()) / 4) ** 0.5
    assert torch.equal(counts > 0, warp.read)
    for eye in range(2):
        found = counts[eye][warp.read[eye]]
        assert found.max() - found.min() <= 1
    assert (uniform_map(CAMERA, 0, warp=warp).counts == 0).all()


def test_the_gaze_of_the_falloff_is_that_of_the_warp_unless_it_is_given():
    warp = WARPS["visual-polar"]
    assert sample_map(ThreeLayer(), CAMERA, warp=warp).gaze is warp.gaze
    other = Gaze(torch.zeros(2, 2))
    late = sample_map(ThreeLayer(r0=4, r1=8), CAMERA, other, warp=warp)
    assert late.gaze is other
    assert not torch.equal(late.layer, sample_map(ThreeLayer(r0=4, r1=8), CAMERA, warp=warp).layer)


def test_maps_move_with_their_raster():
    samples = sample_map(ThreeLayer(), CAMERA, warp=WARPS["log-polar"])
    assert samples.to(torch.float64).warp.gaze.pixels.dtype == torch.float64
    assert "29 x 22 cells" in samples._repr_html_()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda warp: pickle.loads(pickle.dumps(warp))])
def test_copies_of_a_warp_leave_behind_what_it_has_found(copied):
    warp = WARPS["visual-polar"]
    read, again = warp.read, copied(warp)
    assert "read" in vars(warp)
    assert set(vars(again)) == {field.name for field in dataclasses.fields(warp)}
    assert torch.equal(again.read, read)


def test_bad_input_is_named():
    warp = WARPS["log-polar"]
    with pytest.raises(ValueError, match=r"camera\.resolution: expected the screen's"):
        sample_map(ThreeLayer(), dataclasses.replace(CAMERA, resolution=(40, 53)), warp=warp)
    with pytest.raises(ValueError, match=r"camera\.resolution: expected the screen's"):
        uniform_map(dataclasses.replace(CAMERA, resolution=(40, 53)), 1, warp=warp)
    with pytest.raises(ValueError, match=r"counts: expected the raster's height and width, \(22, 29\)"):
        SampleMap.from_counts(torch.ones(1, 1, 4, 4).int(), GAZE, warp=warp)
    with pytest.raises(ValueError, match=r"mean_spp: expected .*got 1\.5"):
        sample_map(ThreeLayer(), CAMERA, spp=4, mean_spp=1.5, warp=warp)  # 0.31 cells a pixel can have 4 paths each
