"""Compiled resampling against the same of torch operations in float64, the adjoint, threads, tables, and odd sizes."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from fovden.camera import Gaze
from fovden.foveation import LogPolarWarp, PolarWarp, VisualPolarWarp
from fovden.jit import kernel
from fovden.warps._fused import distance_table, geometries
from fovden.warps._tables import tabulate
from fovden.warps.kernels.curves import ATAN, COSINE, SINE, direction_of, turn_of, values_at
from fovden.warps.kernels.footprints import STEPS

SCREEN = (61, 67)
GAZES = {
    "centre": [[33.5, 30.0]],
    "corner": [[0.3, 60.6]],
    "on a pixel's centre": [[15.5, 20.5]],
    "far outside": [[-900.2, 3000.7]],
    "per eye": [[36.1, 25.2], [66.9, 23.9]],
}
WARPS = {
    "classic log-polar": lambda gaze: LogPolarWarp(gaze, SCREEN, (45, 39), alpha=1.0),
    "log-polar": lambda gaze: LogPolarWarp(gaze, SCREEN, (45, 61), alpha=4.0),
    "rotated log-polar": lambda gaze: LogPolarWarp(gaze, SCREEN, (27, 21), "rotate", 0.6),
    "visual-polar": lambda gaze: VisualPolarWarp(gaze, SCREEN, (56, 65)),
    "rotated": lambda gaze: VisualPolarWarp(gaze, SCREEN, (130, 150), "rotate"),
    "stair": lambda gaze: VisualPolarWarp(gaze, SCREEN, (50, 45), "rotate", cut="stair", block=4),
    "cubic": lambda gaze: VisualPolarWarp(gaze, SCREEN, (45, 100), law="poly3"),
    "quartic, by angle": lambda gaze: VisualPolarWarp(gaze, SCREEN, (30, 40), law="poly4", metric="angle"),
}
ROUNDING = 2e-6
"""Of float32 results, relative to the image's range: sums of up to eight products, each rounded by 2^-24, and weights
from columns that are wrong by 1e-7."""


def make(name, gaze="per eye"):
    return WARPS[name](Gaze(torch.tensor(GAZES[gaze])))


def noise(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def cells_of(warp, channels=3, seed=0):
    return noise(warp.view_count, channels, *warp.resolution, seed=seed)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("name", WARPS)
def test_pixels_and_gradients_are_those_of_torch(name, gaze):
    """The gradients' rounding grows with the pixels that a cell is read by, whose shares cancel in the mask's."""
    warp = make(name, gaze)
    image, mask = cells_of(warp).requires_grad_(), 0.1 + noise(1, 1, *warp.resolution, seed=1)
    mask.requires_grad_()
    weights = noise(warp.view_count, 3, *SCREEN, seed=2) - 0.3
    exact = [each.detach().double().requires_grad_() for each in (image, mask)]
    poisoned = torch.where(warp.exists, image, torch.nan)  # what is not a cell is not read
    plain, plain_exact = warp.to_screen(poisoned), warp.to_screen(exact[0])
    masked, masked_exact = warp.to_screen(image, mask), warp.to_screen(*exact)
    for found, expected in ((plain, plain_exact), (masked, masked_exact)):
        assert found.dtype == torch.float32
        assert (found - expected).abs().max() < (ROUNDING if found is plain else 10 * ROUNDING)  # divided by 0.1
    (read,) = torch.autograd.grad(plain_exact[:, :1].sum(), exact[0], retain_graph=True)
    gradients = torch.autograd.grad(masked, (image, mask), weights)
    expected = torch.autograd.grad(masked_exact, exact, weights.double())
    for own, theirs in zip(gradients, expected, strict=True):
        assert (own - theirs).abs().max() < 1e-5 * (theirs.abs().max() + read.max())
    assert warp.read[read[:, :1] > 1e-6].all()
    assert (warp.read & (read[:, :1] == 0)).sum() <= 0.002 * warp.read.numel()  # where rounding gives a weight of 1e-9


@pytest.mark.parametrize("prefilter", ["angle", "none"])
@pytest.mark.parametrize("name", WARPS)
def test_other_prefilters_are_those_of_torch(name, prefilter):
    for gaze in ("per eye", "on a pixel's centre"):
        warp = make(name, gaze)
        image = cells_of(warp)
        found, expected = (warp.to_screen(each, prefilter=prefilter) for each in (image, image.double()))
        assert (found - expected).abs().max() < ROUNDING


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("name", WARPS)
def test_the_gradient_is_the_exact_adjoint(name, gaze):
    """<A x, y> = <x, A' y>; both sides are sums of some 10^4 products of numbers below 1, rounded to 2^-24."""
    warp = make(name, gaze)
    image, weights = cells_of(warp).requires_grad_(), noise(warp.view_count, 3, *SCREEN, seed=2)
    screen = warp.to_screen(image)
    (back,) = torch.autograd.grad(screen, image, weights)
    assert (screen.double() * weights).sum().item() == pytest.approx((image.double() * back).sum().item(), rel=1e-5)
    assert not back.masked_select(~warp.exists.expand_as(back)).any()


def test_second_derivatives():
    warp = make("visual-polar")
    image = cells_of(warp).requires_grad_()
    (first,) = torch.autograd.grad(warp.to_screen(image).square().sum() / 2, image, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), image)  # A' A 1
    expected = torch.autograd.grad(warp.to_screen(image), image, warp.to_screen(torch.ones_like(image)))[0]
    assert torch.allclose(second, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("channels", [1, 2, 4, 5, 9])
def test_any_number_of_channels(channels):
    warp = make("rotated")
    image = cells_of(warp, channels).requires_grad_()
    found = warp.to_screen(image)
    single = torch.cat([warp.to_screen(each) for each in image.split(1, dim=1)], dim=1)
    assert torch.equal(found, single)
    weights = noise(*found.shape)
    whole, parts = (torch.autograd.grad(each, image, weights)[0] for each in (found, single))
    assert torch.equal(whole, parts)


@pytest.mark.parametrize("screen", [(1, 1), (1, 9), (7, 1), (3, 65), (2, 130)])
@pytest.mark.parametrize("resolution", [(1, 1), (1, 7), (9, 1), (3, 4), (33, 50)])
def test_odd_and_tiny_sizes(screen, resolution):
    gazes = Gaze(torch.tensor([[0.5, 0.5], [float(screen[1]), -0.2], [-3.0, 4.0]]))
    for warp in (
        LogPolarWarp(gazes, screen, resolution, "rotate"),
        LogPolarWarp(gazes, screen, resolution, alpha=1.0),
        VisualPolarWarp(gazes, screen, resolution, "rotate"),
        VisualPolarWarp(gazes, screen, resolution, cut="stair", block=2),
    ):
        image = cells_of(warp, 2).requires_grad_()
        found, exact = warp.to_screen(image), image.detach().double().requires_grad_()
        expected = warp.to_screen(exact)
        assert (found - expected).abs().max() < ROUNDING
        own, theirs = (torch.autograd.grad(one.sum(), other)[0] for one, other in ((found, image), (expected, exact)))
        assert (own - theirs).abs().max() < 1e-5 * theirs.abs().max()


def test_a_constant_stays_and_holes_stay_out():
    for name in WARPS:
        warp = make(name)
        flat = torch.full((2, 3, *warp.resolution), 0.7)
        mask = (cells_of(warp, 1) < 0.3).float()
        found = warp.to_screen(flat * mask + 1e3 * (1 - mask), mask)
        assert (warp.to_screen(flat) - 0.7).abs().max() < 8 * 0.7 * 2**-24
        assert (found[found > 0] - 0.7).abs().max() < 16 * 0.7 * 2**-24
        assert not warp.to_screen(flat, torch.zeros(1, 1, *warp.resolution)).any()


def test_threads_do_not_matter():
    warp = make("visual-polar")
    image = cells_of(warp).requires_grad_()
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            fresh = dataclasses.replace(warp)
            screen = fresh.to_screen(image)
            back = torch.autograd.grad(screen, image, screen.detach())[0]
            found.append((screen, back, fresh.read, fresh.cell_to_screen(fresh.cells())))
    finally:
        torch.set_num_threads(before)
    for each in found[1:]:
        assert all(torch.equal(one, other) for one, other in zip(each, found[0], strict=True))


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("name", WARPS)
def test_points_are_those_of_torch(name, gaze):
    warp = make(name, gaze)
    width = warp.resolution[1]
    jitter = noise(warp.view_count, math.prod(warp.resolution), 2)
    for cells in (warp.cells(), warp.cells(jitter), 1.4 * jitter * width - 0.2 * width, torch.tensor([[[0.0, -7.3]]])):
        points = cells.expand(warp.view_count, -1, 2)
        exact = warp.cell_to_screen(points.double())
        apart = (warp.cell_to_screen(points) - exact).abs()
        assert (apart <= 2**-23 * exact.abs() + 1e-4).all()
    centres = warp.cell_to_screen(warp.cells().double()).reshape(-1, 1, *warp.resolution, 2)
    edges = torch.tensor(SCREEN).flip(0)
    inside = ((centres >= 1e-4) & (centres < edges - 1e-4)).all(-1) & warp.exists
    outside = ((centres < -1e-4) | (centres > edges + 1e-4)).any(-1) | ~warp.exists
    assert warp.valid[inside].all()
    assert not warp.valid[outside].any()


@pytest.mark.parametrize("name", WARPS)
def test_tables_are_exact(name):
    """To 1e-6 of a column and 1e-6 pixels; at its border the logarithm is steeper than rounding allows."""
    for gaze in GAZES:
        warp = make(name, gaze)
        for view in [dataclasses.replace(warp, gaze=Gaze(pixels[None])) for pixels in warp.gaze.pixels]:
            table = geometries(view, "area")[0].eye.table
            end = table.origin + len(table.starts) - 1
            assert table.origin <= view.polar(torch.tensor([[[0.5, 0.5]]]))[0].item() < end
            x = np.sort(np.random.default_rng(0).uniform(table.origin, end, 20_000))
            x[:2000] = np.linspace(0.99, 1.01, 2000) if table.origin == 0 else x[:2000]
            x = x[np.abs(x - 1) > 1e-6] if "log" in name else x
            assert np.abs(evaluated(table, x) - view.to_fraction(torch.from_numpy(x)[None])[0].numpy()
                          * view.resolution[1]).max() < 1e-6  # fmt: skip
            x = np.random.default_rng(1).uniform(0, view.resolution[1], 20_000)
            expected = view.to_distance(torch.from_numpy(x / view.resolution[1])[None])[0].numpy()
            assert np.abs(evaluated(distance_table(view), x) - expected).max() < 1e-6


def evaluated(table, x):
    values = np.empty(len(x))
    values_at(table, x, values)
    return values


def test_a_table_follows_kinks():
    """A slope that jumps, and one that is infinite: cut down to pieces of 2e-10, whose steps are 1e-5 of a root."""
    table = tabulate(lambda x: (x - 1.3).abs() + (x - 2).clamp(min=0) ** 0.5, 0, 5, 1e-9)
    x = np.linspace(0, 5, 100_001)
    expected = np.abs(x - 1.3) + np.sqrt(np.maximum(x - 2, 0))
    assert np.abs(evaluated(table, x) - expected).max() < 2e-9
    assert len(table.pieces) < 2000
    assert evaluated(table, np.array([-1.0, 6.0])) == pytest.approx([1.3, 3.7 + math.sqrt(3)])


def test_angles_are_exact():
    @kernel
    def angles(x, y, turns, back):
        for i in range(len(x)):
            turns[i] = turn_of(x[i], y[i])
            back[i] = direction_of(turns[i])

    points = np.random.default_rng(0).normal(size=(2, 10_000))
    points[:, :9] = [[1, 1, 0, -1, -1, -1, 0, 1, 0], [0, 1, 1, 1, 0, -1, -1, -1, 0]]
    turns, back = np.empty(10_000), np.empty((10_000, 2))
    angles(*points, turns, back)
    expected = np.arctan2(points[1], points[0]) / (2 * np.pi) % 1
    assert np.abs(turns - expected).max() < 1e-12
    unit = points / np.maximum(np.hypot(*points), 1e-300)
    unit[:, 8] = 1, 0
    assert np.abs(back.T - unit).max() < 1e-11
    assert (len(ATAN), len(SINE), len(COSINE)) == (14, 7, 7)  # as the kernels write them out


def test_all_ways_of_reading_are_tried():
    kinds = [view.eye.kinds for name in WARPS for view in geometries(make(name, "corner"), "area")]
    assert set(np.concatenate(kinds)) == {0, 2, 3, 4}
    assert STEPS % 2 == 0


def test_another_law_is_served():
    class Linear(PolarWarp):
        name = "linear"
        blur_start = torch.zeros(1)

        def to_distance(self, fraction):
            return fraction * self.reach[:, None]

        def to_fraction(self, distance):
            return distance / self.reach[:, None]

        def stretch(self, fraction):
            return self.reach[:, None].expand_as(fraction)

    warp = Linear(Gaze(torch.tensor([[20.0, 30.0]])), (64, 50), (31, 43))
    image = cells_of(warp)
    assert (warp.to_screen(image) - warp.to_screen(image.double())).abs().max() < ROUNDING
