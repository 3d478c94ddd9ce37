"""Cells on the screen: a slow loop over footprints, the adjoint, gradients, seams, and the blur."""

import dataclasses
import math

import pytest
import torch
from skimage.transform import resize

from fovden.camera import Gaze
from fovden.checks import ShapeError
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp, eccentricity_blur, eccentricity_pixels

SMALL = (12, 14)
GAZES = {
    "inside": [[6.3, 5.8]],
    "on a centre": [[7.5, 4.5]],
    "outside": [[-3.2, 16.7]],
    "per eye": [[5.1, 6.2], [8.4, 5.9]],
}
WARPS = {
    "log-polar": lambda gaze: LogPolarWarp(gaze, SMALL, (11, 9)),
    "rotated log-polar": lambda gaze: LogPolarWarp(gaze, SMALL, (10, 8), "rotate", 2.0),
    "visual-polar": lambda gaze: VisualPolarWarp(gaze, SMALL, (13, 17)),
    "rotated": lambda gaze: VisualPolarWarp(gaze, SMALL, (40, 30), "rotate"),
    "stair": lambda gaze: VisualPolarWarp(gaze, SMALL, (15, 20), cut="stair", block=4),
}


def make(name, gaze="per eye", dtype=torch.float64):
    return WARPS[name](Gaze(torch.tensor(GAZES[gaze], dtype=dtype)))


def noise(warp, channels=2, seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(warp.view_count, channels, *warp.resolution, generator=generator, dtype=dtype)


def arc_mean(column, middle, width):
    """Mean of the cells of one column over an arc, row by row, around the circle."""
    height, total = len(column), 0.0
    for row in range(-2 * height, 3 * height):
        overlap = min(row + 1, middle + width / 2) - max(row, middle - width / 2)
        if overlap > 0:
            total += overlap * column[row % height]
    return total / width


def slow_pixel(warp, image, x, y, prefilter):
    """One pixel of one view with a single channel, straight from the description."""
    (gaze,), columns = warp.gaze.pixels.tolist(), warp.resolution[1]
    r = math.hypot(x - gaze[0], y - gaze[1])
    turn = math.atan2(y - gaze[1], x - gaze[0]) / (2 * math.pi) if r > 0 else 0.0

    def column_at(distance):
        return warp.to_fraction(torch.tensor([[distance]], dtype=torch.float64)).item() * columns

    first, last = column_at(r) - 0.5, column_at(r) + 0.5
    if prefilter == "area":
        inner = column_at(abs(r - 0.5))
        if r < 0.5:
            inner = -inner if warp.fovea_border == "rotate" else 0.0
        first, last = min(first, inner), max(last, min(columns, column_at(r + 0.5)))
    share = {"none": 1.0 if r == 0 else 0.0}.get(prefilter, min(1.0, 1 / (2 * math.pi * r)) if r > 0 else 1.0)
    total = 0.0
    for column in range(-columns, 2 * columns):
        overlap = min(column + 1, last) - max(column, first)
        if overlap <= 0:
            continue
        other_side = column < 0 and warp.fovea_border == "rotate"
        read = -1 - column if other_side else min(max(column, 0), columns - 1)
        height = warp.heights[read].item()
        values = image[:height, read].tolist()
        middle = (turn + (0.5 if other_side else 0.0)) * height
        total += overlap * arc_mean(values, middle, max(1.0, share * height))
    return total / (last - first)


@pytest.mark.parametrize("prefilter", ["area", "angle", "none"])
@pytest.mark.parametrize(
    ("name", "gaze"), [(name, "inside") for name in WARPS] + [("rotated", "on a centre"), ("stair", "outside")]
)
def test_every_pixel_by_a_slow_loop(name, gaze, prefilter):
    warp = make(name, gaze)
    image = noise(warp, channels=1)
    found = warp.to_screen(image, prefilter=prefilter)[0, 0]
    for y in range(SMALL[0]):
        for x in range(SMALL[1]):
            expected = slow_pixel(warp, image[0, 0], x + 0.5, y + 0.5, prefilter)
            assert found[y, x].item() == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("name", WARPS)
def test_a_constant_stays(name, gaze):
    warp = make(name, gaze, torch.float32)
    for prefilter in ("area", "angle", "none"):
        image = torch.full((warp.view_count, 3, *warp.resolution), 0.7)
        image = torch.where(warp.exists, image, torch.nan)  # what is not a cell is not read
        found = warp.to_screen(image, prefilter=prefilter)
        assert found.shape == (warp.view_count, 3, *SMALL)
        assert (found - 0.7).abs().max() < 4 * 0.7 * 2**-24
    back = warp.from_screen(torch.full((warp.view_count, 1, *SMALL), 0.7))
    assert (back - 0.7 * warp.exists).abs().max() < 4 * 0.7 * 2**-24


@pytest.mark.parametrize("name", WARPS)
def test_the_gradient_is_the_adjoint(name):
    """<A x, y> = <x, A' y>, with the gradient of the left side for A'; and A is linear."""
    warp = make(name)
    x, other = noise(warp, seed=1).requires_grad_(), noise(warp, seed=2)
    y = torch.randn(2, 2, *SMALL, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    (back,) = torch.autograd.grad(warp.to_screen(x), x, y)
    assert (warp.to_screen(other) * y).sum().item() == pytest.approx((other * back).sum().item(), rel=1e-12)
    assert not back.masked_select(~warp.exists.expand_as(back)).any()


@pytest.mark.parametrize(
    ("name", "parameter"), [("log-polar", "alpha"), ("rotated log-polar", "alpha"), ("stair", "e_max")]
)
def test_gradients_in_image_mask_and_warp(name, parameter):
    """A cell's values jump where a footprint crosses its edge, so the warp's own gradients hold away from these."""
    base = dataclasses.replace(make(name, "inside"), resolution=(5, 6))
    image, mask = noise(base, channels=1, seed=4), torch.rand(1, 1, *base.resolution).double() + 0.1
    value = torch.tensor(getattr(base, parameter) + 0.37, dtype=torch.float64)

    def mapped(image, mask, gaze, value):
        warp = dataclasses.replace(base, gaze=Gaze(gaze), **{parameter: value})
        return warp.to_screen(image, mask)[..., 3:9, 3:10], warp.to_screen(image, prefilter="none")[..., ::2, ::3]

    inputs = [each.clone().requires_grad_() for each in (image, mask, base.gaze.pixels, value)]
    assert torch.autograd.gradcheck(mapped, inputs, eps=1e-7, atol=1e-4)


def test_a_mask_weighs_cells():
    warp = make("visual-polar")
    image, mask = noise(warp), torch.rand(2, 1, *warp.resolution).double()
    expected = warp.to_screen(image * mask) / warp.to_screen(mask)
    assert torch.allclose(warp.to_screen(image, mask), expected)
    assert torch.equal(warp.to_screen(image, torch.zeros(1, 1, *warp.resolution)), torch.zeros(2, 2, *SMALL).double())
    holes = (torch.rand(2, 1, *warp.resolution) < 0.5).double()
    found = warp.to_screen(torch.ones_like(image) * holes, holes)
    assert torch.allclose(found[found > 0], torch.ones(()).double())


@pytest.mark.parametrize("name", WARPS)
def test_what_is_read_suffices(name):
    """With only the cells that are read, all others poisoned, the image is the same; and few are spared in vain."""
    warp = make(name, "inside")
    image = noise(warp)
    poisoned = warp.to_screen(torch.where(warp.read, image, 1e6))
    assert (poisoned - warp.to_screen(image)).abs().max() < 1e-8  # running sums are rounded: 1e6 times 2^-53, times 17
    assert not (warp.read & ~warp.exists).any()
    assert (warp.valid & ~warp.exists).sum() == 0


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("name", WARPS)
def test_what_is_read_has_a_weight(name, gaze):
    """The kernel's adjoint, and that of tensor operations, where running sums of what is not read are rounding."""
    warp = make(name, gaze)
    image = torch.zeros(warp.view_count, 1, *warp.resolution, dtype=torch.float64, requires_grad=True)
    (weight,) = torch.autograd.grad(warp.to_screen(image).sum(), image)
    for each in (
        warp,
        warp.to(torch.float32),
        dataclasses.replace(warp, gaze=Gaze(warp.gaze.pixels.clone().requires_grad_())),
    ):
        assert torch.equal(each.read, weight > 1e-12)


def test_at_the_gaze_stands_the_mean_of_the_first_column():
    warp = LogPolarWarp(Gaze(torch.tensor([[7.5, 4.5]]).double()), SMALL, (16, 3), alpha=1.0)  # wide columns
    image = noise(warp)
    for prefilter in ("angle", "none"):
        found = warp.to_screen(image, prefilter=prefilter)[0, :, 4, 7]
        assert torch.allclose(found, image[0, :, :, 0].mean(-1))


def test_views_are_apart_and_plans_are_kept():
    warp = make("visual-polar")
    image = noise(warp)
    both = warp.to_screen(image)
    assert torch.equal(both, warp.to_screen(image))
    for view, pixels in enumerate(warp.gaze.pixels):
        single = dataclasses.replace(warp, gaze=Gaze(pixels[None]))
        assert torch.equal(single.to_screen(image[view : view + 1]), both[view : view + 1])


def test_a_bright_cell_leaves_its_neighbours_alone():
    """Running sums would lose the others in single precision: 1e7 plus 1e-3 is 1e7."""
    warp = VisualPolarWarp(Gaze(torch.tensor([[32.0, 24.0]])), (48, 64), (90, 80))
    image = torch.full((1, 1, 90, 80), 1e-3)
    image[..., 0, :] = 1e7
    found = warp.to_screen(image)[0, 0, 24:, 16:30]  # the half of the circle away from the angle 0
    assert (found[8:] - 1e-3).abs().max() < 1e-8  # 1e7 times 2^-53, a few times


def test_what_is_kept_serves_any_mode():
    warp = make("visual-polar")
    with torch.inference_mode():
        first = warp.to_screen(noise(warp))
        warp.from_screen(torch.ones(2, 1, *SMALL).double())
    image = noise(warp).requires_grad_()
    assert torch.equal(warp.to_screen(image), first)
    warp.from_screen(warp.to_screen(image)).sum().backward()
    assert image.grad.abs().sum() > 0


@pytest.mark.parametrize("kind", ["visual-polar", "rotated", "log-polar"])
def test_no_seam_and_no_star(kind):
    """A smooth image, into the raster and back: at angle 0 and at the gaze the error is that of anywhere else."""
    screen = (96, 128)
    gaze = Gaze(torch.tensor([[60.3, 50.2]]).double())
    warp = {
        "visual-polar": VisualPolarWarp(gaze, screen, (120, 100)),
        "rotated": VisualPolarWarp(gaze, screen, (120, 100), "rotate"),
        "log-polar": LogPolarWarp(gaze, screen, (120, 100)),
    }[kind]
    y, x = torch.meshgrid(torch.arange(96) + 0.5, torch.arange(128) + 0.5, indexing="ij")
    image = (torch.sin(x / 9 + 0.3) + torch.cos(y / 7) + torch.sin((x + y) / 8))[None, None].double()
    error = (warp.to_screen(warp.from_screen(image)) - image).abs()[0, 0]
    distance, angle = (each.reshape(96, 128) for each in warp.polar(torch.stack([x, y], -1).reshape(1, -1, 2)))
    inside = distance < 40
    row = 2 * math.pi / 120
    seam = inside & (torch.minimum(angle, 2 * math.pi - angle) < 2 * row)
    fovea = distance < 4
    elsewhere = inside & ~seam & ~fovea
    assert min(seam.sum(), fovea.sum()) > 30
    assert error[seam].max() <= error[elsewhere].max()
    assert error[seam].mean() < 2 * error[elsewhere].mean()
    assert error[fovea].max() <= max(1.0 * error[elsewhere].max(), 0.06)  # a pixel's own span of values is 0.3
    assert error[elsewhere].max() < 0.3


def test_more_samples_less_noise():
    """Cells of white noise: a pixel's variance is 1 over the cells that it averages, which "none" does not use."""
    warp = VisualPolarWarp(Gaze(torch.tensor([[60.0, 50.0]])), (100, 120), (400, 300), cut="none")
    image = torch.randn(1, 40, 400, 300, generator=torch.Generator().manual_seed(0))
    near = eccentricity_pixels(warp.gaze, (100, 120))[0, 0] < 5
    filtered, angular, bare = (
        warp.to_screen(image, prefilter=each)[0][:, near].var() for each in ("area", "angle", "none")
    )
    assert filtered < angular / 2 < bare / 8


def test_from_screen_is_bilinear():
    """Against grid_sample, which measures from corners: 2 p / size - 1."""
    warp = make("visual-polar")
    image = torch.randn(2, 3, *SMALL).double()
    grid = 2 * warp.cell_to_screen(warp.cells()) / torch.tensor([SMALL[1], SMALL[0]]) - 1
    expected = torch.nn.functional.grid_sample(
        image, grid.reshape(2, *warp.resolution, 2), padding_mode="border", align_corners=False
    )
    assert torch.allclose(warp.from_screen(image), expected * warp.exists)


def test_the_screen_is_itself():
    warp = ScreenWarp(Gaze(torch.zeros(1, 2)), SMALL, SMALL)
    image = torch.rand(1, 3, *SMALL)
    assert torch.equal(warp.to_screen(image), image)
    assert torch.equal(warp.from_screen(image), image)
    mask = (torch.rand(1, 1, *SMALL) < 0.5).float()
    assert torch.equal(warp.to_screen(image, mask), image * mask)
    assert warp.read.all()
    found = warp.neighbour(torch.tensor([[0, 0], [13, 11]]), 2, -1)
    assert found.tolist() == [[2, 0], [13, 10]]


@pytest.mark.parametrize("resolution", [(5, 4), (9, 20), (1, 1)])
def test_a_coarser_screen_is_interpolated_as_scikit_image_does_it(resolution):
    warp = ScreenWarp(Gaze(torch.zeros(1, 2)), SMALL, resolution)
    image = torch.rand(1, 3, *resolution, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    finer = any(cells > pixels for cells, pixels in zip(resolution, SMALL, strict=True))
    if not finer:
        expected = resize(image[0].movedim(0, -1).numpy(), SMALL, order=1, mode="edge", anti_aliasing=False)
        assert torch.allclose(warp.to_screen(image)[0].movedim(0, -1), torch.from_numpy(expected), atol=1e-12)
    assert torch.allclose(warp.to_screen(torch.ones_like(image)), torch.ones(1, 3, *SMALL, dtype=torch.float64))
    mask = (torch.rand(1, 1, *resolution, generator=torch.Generator().manual_seed(1)) < 0.5).double()
    found = warp.to_screen(torch.full_like(image, 0.25), mask)
    counts = warp.to_screen(mask) > 0
    assert torch.allclose(found, 0.25 * counts.double().expand_as(found))
    other = torch.rand(1, 3, *SMALL, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    image.requires_grad_()
    (adjoint,) = torch.autograd.grad((warp.to_screen(image) * other).sum(), image)
    image = image.detach()
    assert float((adjoint * image).sum()) == pytest.approx(float((warp.to_screen(image) * other).sum()), rel=1e-12)


def test_blur_has_the_width_that_it_states():
    """The second moment of a point's image, weighed back by each pixel's own blur, along a row of a wide image."""
    gaze = Gaze(torch.tensor([[0.5, 20.5]]).double())
    start, stop, sigma = 20.0, 140.0, 3.0
    for at in (10, 50, 95, 130, 160):
        width = sigma * min(max((at - start) / (stop - start), 0), 1)
        # A pixel reads the image around it, so its blur shows in what it makes of a parabola: b^2 in x, and b^2 in y.
        x = torch.arange(200).double()[None, None, None]
        image = ((x - at) ** 2).expand(1, 1, 41, 200)
        found = eccentricity_blur(image, gaze, start, stop, sigma)[0, 0, 20, at].item()
        assert found == pytest.approx(width**2, rel=0.03, abs=1e-9)  # cut at three deviations, 2.7 % less


def test_blur_keeps_constants_and_has_gradients():
    warp = make("visual-polar")
    image = torch.full((2, 3, *SMALL), 0.7)
    assert (warp.blur(image, 2.0) - 0.7).abs().max() < 1e-6
    image = torch.rand(2, 3, *SMALL)
    assert torch.allclose(warp.blur(image, 0.0), image, rtol=1e-6)
    image = torch.rand(1, 1, 5, 6).double().requires_grad_()
    gaze = torch.tensor([[1.3, 2.2]], dtype=torch.float64, requires_grad=True)
    start, stop, sigma = (torch.tensor(each, dtype=torch.float64, requires_grad=True) for each in (0.4, 4.3, 1.2))

    def blurred(image, gaze, start, stop, sigma):
        return eccentricity_blur(image, Gaze(gaze), start, stop, sigma)

    assert torch.autograd.gradcheck(blurred, (image, gaze, start, stop, sigma))


def test_bad_images():
    warp = make("visual-polar")
    with pytest.raises(ShapeError, match=r"image: expected shape \(v=2, c, h=13, w=17\), got \(2, 3, 12, 14\)"):
        warp.to_screen(torch.zeros(2, 3, *SMALL))
    with pytest.raises(ShapeError, match="mask: expected shape"):
        warp.to_screen(noise(warp), torch.ones(2, 1, 13, 16))
    with pytest.raises(ValueError, match=r"prefilter: expected one of .*area.*, got 'mip'"):
        warp.to_screen(noise(warp), prefilter="mip")
    with pytest.raises(ShapeError, match=r"image: expected shape \(v=2, c, height=12, width=14\)"):
        warp.from_screen(noise(warp))
    with pytest.raises(ValueError, match="strength: expected a finite number, at least 0, got -1"):
        warp.blur(torch.zeros(2, 1, *SMALL), -1.0)
    with pytest.raises(ValueError, match="stop: expected distances above start"):
        eccentricity_blur(torch.zeros(1, 1, 4, 4), Gaze(torch.zeros(1, 2)), 3.0, 3.0, 1.0)
