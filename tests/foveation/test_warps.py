"""The geometry of warps: closed forms against quadrature and root finding, counted cells against the density."""

import math

import numpy as np
import pytest
import torch
from scipy import integrate, optimize, stats

from fovden.camera import Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp

SCREEN = (96, 128)
GAZES = {
    "centre": [[64.0, 48.0]],
    "aside": [[23.3, 71.9]],
    "outside": [[-40.2, 150.7]],
    "on a pixel's centre": [[30.5, 40.5]],
    "per eye": [[70.1, 50.2], [58.4, 47.9]],
}
WARPS = {
    "log-polar": lambda gaze: LogPolarWarp(gaze, SCREEN, (53, 71)),
    "classic": lambda gaze: LogPolarWarp(gaze, SCREEN, (53, 71), "rotate", 1.0),
    "visual-polar": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80)),
    "rotated": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80), "rotate", e_max=55.0),
    "stair": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80), cut="stair", block=8),
    "uncut": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80), cut="none", metric="angle"),
    "poly3": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80), law="poly3"),
    "poly4": lambda gaze: VisualPolarWarp(gaze, SCREEN, (60, 80), law="poly4", metric="angle"),
    "screen": lambda gaze: ScreenWarp(gaze, SCREEN, SCREEN),
    "coarse": lambda gaze: ScreenWarp(gaze, SCREEN, (60, 80)),
}
POLAR = [name for name in WARPS if name not in ("screen", "coarse")]


def make(name, gaze="per eye", dtype=torch.float64):
    return WARPS[name](Gaze(torch.tensor(GAZES[gaze], dtype=dtype)))


def points_on_screen(views, count=400, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(views, count, 2, generator=generator, dtype=torch.float64) * double([128.0, 96.0])


def double(values):
    return torch.tensor(values, dtype=torch.float64)


def acuity(e):
    """Reddy's term, from its own definition."""
    return min(1.0, 7.49 / (0.3 * e + 1) ** 2)


@pytest.mark.parametrize(
    ("e_max", "q"),
    [(30, 0.2811), (35, 0.2582), (40, 0.2409), (40.28, 0.2400), (45, 0.2271), (50, 0.2159), (55, 0.2066)],
)
def test_the_share_of_the_centre(e_max, q):
    """Four digits that were computed apart, and quadrature: the centre holds its share of the integral of e M(e)."""
    warp = VisualPolarWarp(Gaze(torch.zeros(1, 2)), SCREEN, (60, 80), e_max=float(e_max))
    assert round(warp.centre_fraction, 4) == q
    whole, _ = integrate.quad(lambda e: e * acuity(e), 5.79, e_max, epsabs=1e-12)
    # The centre is a rectangle in g: g(e_c) = 1 stands for e_c^2, since beyond it dg/de = e M(e) / e_c^2.
    assert warp.centre_fraction == pytest.approx(5.79**2 / (5.79**2 + whole), abs=2e-5)


def test_sizes_that_are_reported():
    camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(1440, 1280))
    warp = VisualPolarWarp.for_camera(camera)
    assert warp.resolution == (900, 800)
    assert warp.cells_per_pixel == 0.390625
    assert round(100 * warp.removed, 2) == 12.00
    # Rounding up adds half a row to each of the 192 columns of the centre.
    assert 1 - warp.cell_count / (900 * 800) == pytest.approx(0.12, abs=96 / (900 * 800) + 1e-4)
    assert 1 - warp.valid.sum() / (2 * warp.cell_count) == pytest.approx(0.136, abs=1e-3)  # cells beside the screen
    log_polar = LogPolarWarp.for_camera(camera)
    assert log_polar.cells_per_pixel == pytest.approx(0.31, abs=0.005)
    assert log_polar.cell_count == 800 * 711


@pytest.mark.parametrize(("r", "share"), [(10, 0.76), (100, 0.90)])
def test_columns_of_the_log_polar_raster(r, share):
    """The shares that were computed apart, for a farthest corner at 1101 pixels."""
    gaze = Gaze(torch.tensor([[0.0, 0.0]], dtype=torch.float64))
    warp = LogPolarWarp(gaze, (1080, 214), (100, 100))  # sqrt(1080^2 + 214^2) = 1101.0
    assert warp.to_fraction(torch.tensor([[float(r)]]).double()).item() == pytest.approx(share, abs=0.005)
    classic = LogPolarWarp(gaze, (1080, 214), (100, 100), alpha=1.0)
    assert classic.to_fraction(torch.tensor([[float(r)]]).double()).item() == pytest.approx(share**4, abs=0.01)


def test_log_polar_by_hand():
    warp = LogPolarWarp(Gaze(double([[10.0, 20.0]])), (48, 64), (30, 40), alpha=3.0)
    far = math.log(math.hypot(64 - 10, 48 - 20))
    for x, y in ((0.5, 3.5), (20.0, 29.9), (39.5, 0.1)):
        r, theta = math.exp(far * (x / 40) ** 3), 2 * math.pi * y / 30
        found = warp.cell_to_screen(double([[[x, y]]]))[0, 0].tolist()
        assert found == pytest.approx([10 + r * math.cos(theta), 20 + r * math.sin(theta)], abs=1e-12)


@pytest.mark.parametrize("e_max", [10.0, 40.28, 89.0, 170.0])
def test_visual_polar_distances_by_quadrature(e_max):
    warp = VisualPolarWarp(Gaze(torch.zeros(1, 2).double()), (30, 40), (60, 80), e_max=e_max)

    def g(e):  # the integral of e M(e) / e_c^2, with the quarter circle's worth of the centre as a rectangle
        return e / 5.79 if e <= 5.79 else 1 + integrate.quad(lambda x: x * acuity(x), 5.79, e)[0] / 5.79**2

    for t in (0.01, 0.1, 0.3, 0.6, 0.9):
        e = optimize.brentq(lambda e, t=t: g(e) - t * g(e_max), 0, e_max, xtol=1e-12)
        distance = warp.to_distance(double([[t]])).item()
        assert distance == pytest.approx(50 * e / e_max, rel=1e-4)  # acuity's own step, 1.6e-4, is in the quadrature
        assert warp.to_fraction(double([[distance]])).item() == pytest.approx(t, abs=1e-14)


def test_the_centre_joins_the_periphery_smoothly():
    """Value and slope on both sides of the centre's end; acuity's two pieces themselves meet within 1.6e-4."""
    warp = VisualPolarWarp(Gaze(torch.zeros(1, 2).double()), (30, 40), (60, 80))
    sides = double([[warp.centre_fraction - 1e-9, warp.centre_fraction + 1e-9]])
    assert warp.to_distance(sides).diff().item() < 1e-6
    slopes = warp.stretch(sides)[0]
    assert slopes[1] / slopes[0] == pytest.approx(1 / 0.99984, abs=1e-5)


@pytest.mark.parametrize(("law", "error"), [("poly3", 7.2e-4), ("poly4", 1.0e-4)])
def test_polynomials_are_near_the_closed_form(law, error):
    t = torch.linspace(0, 1, 2001).double()[None]
    exact, fitted = (
        VisualPolarWarp(Gaze(torch.zeros(1, 2).double()), (30, 40), (60, 80), law=name) for name in ("exact", law)
    )
    apart = ((fitted.to_distance(t) - exact.to_distance(t)) / 50).abs().max().item()
    assert 0.5 * error < apart < 1.1 * error


def test_angles_follow_the_tangent():
    """With the gaze straight ahead, the eccentricity of a pixel is the angle of its ray."""
    gaze, e_max = Gaze(double([[64.0, 48.0]])), 35.0
    plane = VisualPolarWarp(gaze, SCREEN, (60, 80), e_max=e_max)
    angle = VisualPolarWarp(gaze, SCREEN, (60, 80), e_max=e_max, metric="angle")
    focal = 80 / math.tan(math.radians(e_max))  # pixels to the eye; the corner is 80 pixels away
    for d in (5.0, 30.0, 79.0):
        degrees = math.degrees(math.atan(d / focal))
        expected = plane.to_fraction(double([[80 * degrees / e_max]]))
        assert torch.allclose(angle.to_fraction(double([[d]])), expected, atol=1e-12)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("name", WARPS)
def test_round_trips(name, gaze):
    warp = make(name, gaze)
    cells = warp.cells(torch.rand(warp.view_count, math.prod(warp.resolution), 2).double())
    inside = warp.exists.reshape(1, -1).expand(warp.view_count, -1)
    if name in POLAR:
        # A log-polar column near 0 is 1e-10 pixels wide: coordinates of the screen cannot tell it from its neighbour.
        inside = inside & (warp.polar(warp.cell_to_screen(cells))[0] >= 1.0001 * (name == "log-polar"))
    back = warp.screen_to_cell(warp.cell_to_screen(cells))
    apart = (back - cells).abs()
    heights = warp.heights[cells[..., 0].long()].double()
    apart[..., 1] = torch.minimum(apart[..., 1], heights - apart[..., 1])  # angles close
    assert apart[inside].max() < 1e-3 / 1000
    single = make(name, gaze, torch.float32)
    points = points_on_screen(warp.view_count).float()
    if name in POLAR:
        points = points[(single.polar(points)[0] >= 1).all(0).expand(len(points), -1)].reshape(len(points), -1, 2)
    assert (single.cell_to_screen(single.screen_to_cell(points)) - points).abs().max() < 1e-3


def test_single_precision_at_full_size():
    """Under 1e-3 pixels but at the log-polar rim, where half a unit in the last place of x is worth 1.2e-3."""
    gaze = Gaze(torch.tensor([[640.0, 720.0]]))
    points = torch.rand(1, 50_000, 2) * torch.tensor([1280.0, 1440.0])
    for warp in (LogPolarWarp(gaze, (1440, 1280), (800, 711)), VisualPolarWarp(gaze, (1440, 1280), (900, 800))):
        away = points[:, warp.polar(points)[0][0] > 1]
        apart = (warp.cell_to_screen(warp.screen_to_cell(away)) - away).norm(dim=-1)
        distance = warp.polar(away)[0]
        assert apart[distance < 750].max() < 1e-3
        column = warp.stretch(torch.ones(1, 1).double()) / warp.resolution[1]  # pixels per column at the rim
        assert apart.max() < column * 2.0**-15 + 4e-4
        centres = warp.cell_to_screen(warp.cells())
        centres = centres[:, warp.exists.reshape(-1) & (warp.polar(centres)[0][0] >= 1)]
        assert (warp.cell_to_screen(warp.screen_to_cell(centres)) - centres).norm(dim=-1).max() < 1e-3


@pytest.mark.parametrize("gaze", ["aside", "outside", "per eye"])
@pytest.mark.parametrize("name", POLAR)
def test_the_farthest_corner_is_the_rim(name, gaze):
    warp = make(name, gaze)
    corners = double([[0.0, 0], [128, 0], [0, 96], [128, 96]]).expand(warp.view_count, -1, 2)
    x = warp.screen_to_cell(corners)[..., 0] / warp.resolution[1]
    assert torch.allclose(x.amax(1), torch.ones(warp.view_count).double(), atol=1e-12)
    inner = warp.screen_to_cell(points_on_screen(warp.view_count))
    assert inner[..., 0].max() < warp.resolution[1]
    assert (inner[..., 1] <= warp.heights[inner[..., 0].long()]).all()
    assert inner.min() >= 0


@pytest.mark.parametrize(("cut", "rows"), [("smooth", 60), ("stair", 64), ("stair", 900)])
def test_heights(cut, rows):
    warp = VisualPolarWarp(Gaze(torch.zeros(1, 2)), SCREEN, (rows, 800), cut=cut)
    for column, height in enumerate(warp.heights.tolist()):
        end = (column + 0.5) if cut == "smooth" else 32 * (column // 32 + 1)
        need = rows * min(1, end / (warp.centre_fraction * 800))
        step = 1 if cut == "smooth" else 32
        assert height == min(rows, max(1, step * math.ceil(need / step)))
    assert warp.heights.amin() >= 1
    assert (warp.heights.diff() >= 0).all()
    assert torch.equal(warp.exists.sum(2).flatten(), warp.heights)


@pytest.mark.parametrize("name", WARPS)
def test_jacobian_and_density(name):
    """Against automatic differentiation, and the density against the area of a cell."""
    warp = make(name)
    cells = warp.cells()[:, warp.exists.flatten()][:, 2000::37].clone().requires_grad_()
    points = warp.cell_to_screen(cells)
    rows = [torch.autograd.grad(points[..., axis].sum(), cells, retain_graph=True)[0] for axis in (0, 1)]
    found = warp.jacobian(cells)
    assert torch.allclose(found, torch.stack(rows, dim=-2), rtol=1e-9, atol=1e-12)
    area = torch.linalg.det(found).abs()
    assert torch.allclose(warp.density(points), 1 / area, rtol=1e-6)


def test_density_of_the_visual_polar_raster_follows_acuity():
    warp = VisualPolarWarp(Gaze(torch.zeros(1, 2).double()), (600, 800), (900, 800))
    e = np.linspace(6, 40, 50)
    points = torch.from_numpy(np.stack([1000 * e / 40.28, 0 * e], axis=1))[None]
    relative = warp.density(points)[0].numpy() / [acuity(each) for each in e]
    assert np.ptp(relative) < 1e-10 * relative.mean()
    inside = warp.density(double([[[20.0, 0.0], [140.0, 0.0]]]))[0]
    # Rounded up, a column of the centre is at most a row too high.
    assert inside[0] == pytest.approx(inside[1].item(), rel=0.05)
    assert inside[1] == pytest.approx(relative.mean(), rel=0.01)
    assert warp.density(double([[[900.0, 700.0]]])).item() == 0  # beyond the rim


@pytest.mark.parametrize("gaze", ["aside", "outside"])
@pytest.mark.parametrize("name", ["log-polar", "classic", "visual-polar", "stair", "poly4"])
def test_cells_fall_on_the_screen_as_the_density_says(name, gaze):
    """Chi-square of 200,000 cells drawn at random, jittered, in boxes of 8 x 8 pixels; one false alarm in 10^4."""
    warp = make(name, gaze)
    generator = torch.Generator().manual_seed(5)
    draws = 200_000
    numbers = warp.exists.flatten().nonzero()[:, 0]
    chosen = numbers[torch.randint(len(numbers), (draws,), generator=generator)]
    width = warp.resolution[1]
    corner = torch.stack([chosen % width, chosen // width], dim=1)
    points = warp.cell_to_screen((corner + torch.rand(draws, 2, generator=generator).double())[None])[0]
    edges = (np.arange(0, 97, 8), np.arange(0, 129, 8))
    counted = np.histogram2d(points[:, 1].numpy(), points[:, 0].numpy(), bins=edges)[0]
    fine = (torch.arange(128 * 8) + 0.5) / 8
    y, x = torch.meshgrid(fine[: 96 * 8], fine, indexing="ij")
    density = warp.density(torch.stack([x, y], dim=-1).reshape(1, -1, 2).double()).reshape(96 * 8, 128 * 8) / 64
    share = density.reshape(12, 64, 16, 64).sum((1, 3)).numpy() / warp.cell_count
    # Boxes at the gaze, where the density has a pole, or with next to no cells count with all that is off the screen.
    at_y, at_x = (int(each // 8) for each in warp.gaze.pixels[0].flip(0))
    kept = draws * share >= 5
    if 0 <= at_y < 12 and 0 <= at_x < 16:
        kept[max(0, at_y - 1) : at_y + 2, max(0, at_x - 1) : at_x + 2] = False
    expected = draws * np.append(share[kept], 1 - share[kept].sum())
    found = np.append(counted[kept], draws - counted[kept].sum())
    assert kept.mean() > 0.35
    assert stats.chi2.sf(((found - expected) ** 2 / expected).sum(), len(found) - 1) > 1e-4


@pytest.mark.parametrize("name", ["log-polar", "classic", "visual-polar", "rotated", "stair"])
@pytest.mark.parametrize("step", [(0, 1), (1, 0), (-1, -2), (3, 7), (-2, 61)])
def test_neighbours_are_at_the_same_angle(name, step):
    warp = make(name)
    dx, dy = step
    rows, columns = warp.exists[0, 0].nonzero().unbind(1)
    cells = torch.stack([columns, rows], dim=1)
    found = warp.neighbour(cells, dx, dy)
    for (i, j), (i2, j2) in list(zip(cells.tolist(), found.tolist(), strict=True))[::7]:
        turn = (j + 0.5 + dy) / warp.heights[i].item()
        column = i + dx
        if column < 0 and warp.fovea_border == "rotate":
            column, turn = -1 - column, turn + 0.5
        column = min(max(column, 0), warp.resolution[1] - 1)
        assert i2 == column
        height = warp.heights[column].item()
        assert 0 <= j2 < height
        inside = (turn * height - j2 + 1e-9) % height  # the angle lies within that row
        assert inside < 1 + 2e-9


@pytest.mark.parametrize("name", WARPS)
def test_rays(name):
    camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=SCREEN).views
    warp = make(name, dtype=torch.float32)
    cells = warp.cells(torch.rand(2, math.prod(warp.resolution), 2))
    rays = warp.cell_to_ray(camera, cells)
    assert torch.equal(rays.origins[:, 0], camera.origin)
    pixels, depth = camera.project(rays.origins + 3 * rays.directions)
    assert torch.allclose(pixels, warp.cell_to_screen(cells), atol=2e-2)  # far off the screen rays are nearly parallel
    assert (depth > 0).all()
    with pytest.raises(ValueError, match=r"camera.resolution: expected the screen's, \(96, 128\), got \(48, 64\)"):
        warp.cell_to_ray(StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(48, 64)))


@pytest.mark.parametrize("name", ["log-polar", "rotated", "uncut"])
def test_gradients_of_the_maps(name):
    base = make(name)
    parameter = "alpha" if name == "log-polar" else "e_max"
    kind, rest = type(base), {"resolution": base.resolution, "screen": SCREEN}
    if name == "uncut":
        rest |= {"cut": "none", "metric": "angle"}
    value = torch.tensor(float(getattr(base, parameter)) - 1, dtype=torch.float64, requires_grad=True)
    gaze = base.gaze.pixels.clone().requires_grad_()
    points = points_on_screen(2, 4).requires_grad_()

    fixed = base.screen_to_cell(points_on_screen(2, 4, seed=1))

    def both(gaze, value, points):
        warp = kind(Gaze(gaze), **rest, **{parameter: value})
        cells = warp.screen_to_cell(points)
        return cells, warp.cell_to_screen(fixed), warp.density(points), warp.jacobian(fixed)

    assert torch.autograd.gradcheck(both, (gaze, value, points))


def test_at_the_gaze_nothing_is_infinite():
    for name in POLAR:
        warp = make(name, "on a pixel's centre")
        points = double([[[30.5, 40.5]]]).requires_grad_()
        cells = warp.screen_to_cell(points)
        assert torch.equal(cells, torch.zeros(1, 1, 2).double())
        (gradient,) = torch.autograd.grad(cells.sum(), points)
        assert torch.isfinite(gradient).all()


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda g: LogPolarWarp(g, SCREEN, (0, 5)), "resolution.0. .height.: expected an integer of at least 1, got 0"),
        (lambda g: LogPolarWarp(g, SCREEN, (5, 5), alpha=0.0), "alpha: expected a finite number, above 0, got 0.0"),
        (lambda g: LogPolarWarp(g, SCREEN, (5, 5), alpha=torch.tensor(-1.0)), "alpha: expected .* above 0, got -1.0"),
        (lambda g: LogPolarWarp(g, SCREEN, (5, 5), "wrap"), "fovea_border: expected one of .*clamp.*, got 'wrap'"),
        (lambda g: VisualPolarWarp(g, SCREEN, (5, 5), e_max=5.0), "e_max: expected .* above 5.79 .*, got 5.0"),
        (lambda g: VisualPolarWarp(g, SCREEN, (5, 5), metric="angle", e_max=95.0), "e_max: .* at most 89.9, got 95.0"),
        (lambda g: VisualPolarWarp(g, SCREEN, (5, 5), law="poly3", e_max=50.0), "e_max: expected 40.28, for which"),
        (lambda g: VisualPolarWarp(g, SCREEN, (5, 5), cut="round"), "cut: expected one of .*stair.*, got 'round'"),
        (lambda g: ScreenWarp(g, SCREEN, (5, 0)), "resolution.1. .width.: expected an integer of at least 1, got 0"),
    ],
)
def test_bad_arguments(build, message):
    with pytest.raises(ValueError, match=message):
        build(Gaze(torch.zeros(1, 2)))


def test_bad_points():
    warp = make("log-polar")
    with pytest.raises(ShapeError, match=r"points: expected shape \(v=2, n, 2\), got \(1, 3, 2\)"):
        warp.screen_to_cell(torch.zeros(1, 3, 2))
    with pytest.raises(ShapeError, match=r"cells: expected shape \(v=2, n, 2\)"):
        warp.cell_to_screen(torch.zeros(2, 3, 3))
    with pytest.raises(ValueError, match="cells: expected integers"):
        warp.neighbour(torch.zeros(3, 2), 1, 0)
    with pytest.raises(ShapeError, match=r"gaze\.pixels"):
        LogPolarWarp.for_camera(StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60), Gaze(torch.zeros(3, 2)))
