"""The operators of warps as PyTorch sees them, and the compiled blur against the same of torch operations."""

import copy
import pickle
import weakref

import pytest
import torch

from fovden.camera import Gaze
from fovden.foveation import LogPolarWarp, VisualPolarWarp, eccentricity_blur
from fovden.jit import kernel
from fovden.simd import pointer_to
from fovden.warps._operators import warp_of
from fovden.warps.blur import STEPS, compose
from fovden.warps.kernels import lanes

OPERATORS = torch.ops.fovden
SCREEN = (20, 26)
GAZE = [[13.3, 9.2], [12.0, 10.0]]


def noise(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def make(x=0.0):
    return VisualPolarWarp(Gaze(torch.tensor(GAZE) + x), SCREEN, (18, 22))


def bounds(start, stop, sigma):
    return [torch.as_tensor(each, dtype=torch.float64).reshape(-1, 1, 1, 1) for each in (start, stop, sigma)]


# The blur


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (5, 4), (40, 70), (70, 33)])
@pytest.mark.parametrize(
    ("gaze", "start", "stop", "sigma"),
    [
        ([[3.5, 2.5], [1.0, 8.2]], 2.0, 30.0, 2.5),
        ([[20.0, 15.0], [35.5, 12.5]], [0.0, 5.0], [25.0, 40.0], [1.0, 4.0]),
        ([[-50.0, 20.0], [1000.0, -2000.0]], 3.0, 60.0, 7.3),
        ([[10.0, 10.0], [11.0, 10.0]], 4.0, 4.5, 40.0),
        ([[10.0, 10.0], [11.0, 10.0]], 0.0, 20.0, 0.0),
        ([[10.0, 10.0], [11.0, 10.0]], 200.0, 300.0, 2.0),
    ],
)
def test_the_blur_is_that_of_torch(size, gaze, start, stop, sigma):
    image, weights = noise(2, 3, *size).requires_grad_(), noise(2, 3, *size, seed=1)
    found = eccentricity_blur(image, Gaze(torch.tensor(gaze)), *map(torch.as_tensor, (start, stop, sigma)))
    exact, eyes = image.detach().double().requires_grad_(), Gaze(torch.tensor(gaze, dtype=torch.float64))
    expected = compose(exact, eyes, *bounds(start, stop, sigma))
    assert found.dtype == torch.float32
    assert (found - expected).abs().max() < 2e-6
    own, theirs = (
        torch.autograd.grad(one, other, weights.to(one))[0] for one, other in ((found, image), (expected, exact))
    )
    assert (own - theirs).abs().max() < 2e-6 * max(1.0, theirs.abs().max().item())
    left, right = (found.double() * weights).sum().item(), (image.double() * own).sum().item()
    assert left == pytest.approx(right, rel=1e-5)


def test_a_blurred_constant_and_threads():
    warp = make()
    before, found = torch.get_num_threads(), []
    image = noise(2, 3, *SCREEN).requires_grad_()
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            blurred = warp.blur(image, 2.0)
            found.append((blurred, torch.autograd.grad(blurred, image, blurred.detach())[0]))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(*pair) for each in found[1:] for pair in zip(each, found[0], strict=True))
    assert (warp.blur(torch.full((2, 1, *SCREEN), 0.7), 3.0) - 0.7).abs().max() < 8 * 0.7 * 2**-24


def test_gradients_of_strength_and_gaze_are_those_of_torch():
    gaze, strength = torch.tensor(GAZE, requires_grad=True), torch.tensor(1.5, requires_grad=True)
    image = noise(2, 1, *SCREEN)
    warp = VisualPolarWarp(Gaze(gaze), SCREEN, (18, 22))
    slopes = torch.autograd.grad(warp.blur(warp.to_screen(noise(2, 1, 18, 22)), strength).sum(), (gaze, strength))
    assert all(each.abs().sum() > 0 for each in slopes)
    assert (warp.blur(image, strength) - make().blur(image, 1.5)).abs().max() < 2e-6


# PyTorch


def test_pytorch_finds_nothing_wrong():
    warp = make()
    cells, screen = noise(2, 5, *warp.resolution).requires_grad_(), noise(2, 5, *SCREEN).requires_grad_()
    torch.library.opcheck(OPERATORS.resample.default, (cells, warp.number, "area", list(SCREEN), False))
    torch.library.opcheck(OPERATORS.resample.default, (screen, warp.number, "none", list(warp.resolution), True))
    limits = torch.tensor([[2.0, 3.0], [20.0, 22.0], [1.5, 2.0]], dtype=torch.float64)
    for back in (False, True):
        torch.library.opcheck(
            OPERATORS.eccentricity_blur.default, (screen, warp.gaze.pixels, limits, STEPS, back)
        )  # fmt: skip
    torch.library.opcheck(OPERATORS.place_cells.default, (warp.cells().clone(), warp.number))


def test_a_frame_compiles_as_one_graph_for_all_gazes():
    def loss(image, mask, warp):
        return warp.blur(warp.to_screen(image, mask)).square().mean()

    compiled, graphs = torch.compile(loss, fullgraph=True, backend="aot_eager"), []
    before = torch._dynamo.utils.counters["stats"]["unique_graphs"]
    for x in range(4):
        warp = make(x / 3)
        leaves = noise(2, 3, 18, 22).requires_grad_(), noise(2, 1, 18, 22, seed=1).requires_grad_()
        got, want = (torch.autograd.grad(each(*leaves, warp), leaves) for each in (compiled, loss))
        assert all(torch.equal(*pair) for pair in zip(got, want, strict=True))
        graphs.append(torch._dynamo.utils.counters["stats"]["unique_graphs"] - before)
    assert graphs == [1] * 4


def test_functional_transforms():
    warp = make()
    images, weights = noise(4, 2, 3, 18, 22), noise(2, 3, *SCREEN)
    mapped = torch.vmap(lambda image: warp.blur(warp.to_screen(image)))(images)
    assert torch.equal(mapped, torch.stack([warp.blur(warp.to_screen(image)) for image in images]))
    (expected,) = torch.autograd.grad(
        (warp.blur(warp.to_screen(images.requires_grad_()[0])) * weights).sum(), images
    )  # fmt: skip
    found = torch.func.grad(lambda image: (warp.blur(warp.to_screen(image)) * weights).sum())(images[0].detach())
    assert torch.equal(found, expected[0])
    cells = warp.cells(noise(2, 18 * 22, 2))[:, :7]
    assert torch.equal(
        torch.vmap(warp.cell_to_screen)(cells[None].expand(3, -1, -1, -1))[1], warp.cell_to_screen(cells)
    )
    slopes = torch.func.grad(lambda at: warp.cell_to_screen(at).sum())(cells)
    assert torch.allclose(slopes, warp.jacobian(cells).sum(-2), rtol=1e-5, atol=1e-5)


def test_copies_have_numbers_of_their_own():
    warp, image = make(), noise(2, 1, 18, 22)
    expected = warp.to_screen(image)
    copies = [copy.copy(warp), copy.deepcopy(warp), pickle.loads(pickle.dumps(warp)), warp.to(torch.float32)]
    assert len({int(each.number) for each in (warp, *copies)}) == 5
    assert all(torch.equal(each.to_screen(image), expected) for each in copies)
    leaf = image.requires_grad_()
    screen = warp.to_screen(leaf)
    number = int(warp.number)
    known = weakref.ref(warp_of(warp.number))
    del warp
    screen.sum().backward()  # for which the warp is kept
    assert torch.allclose(leaf.grad, torch.autograd.grad(copies[0].to_screen(leaf).sum(), leaf)[0])
    del screen
    assert known() is None
    with pytest.raises(RuntimeError, match="warp: expected the number of a warp that this process holds"):
        OPERATORS.resample(image, torch.tensor(number), "area", list(SCREEN), False)


def test_gradients_of_the_warp_go_by_torch():
    power = torch.tensor(2.0, requires_grad=True)
    warp = LogPolarWarp(Gaze(torch.tensor(GAZE)), SCREEN, (18, 22), alpha=power)
    image = noise(2, 1, 18, 22)
    slope = torch.autograd.grad(warp.to_screen(image).square().sum(), power)[0]
    values = [
        LogPolarWarp(Gaze(torch.tensor(GAZE)), SCREEN, (18, 22), alpha=2 + step)
        .to_screen(image)
        .square()
        .sum()
        .double()
        for step in (-1e-3, 1e-3)
    ]
    assert slope.item() == pytest.approx((values[1] - values[0]).item() / 2e-3, rel=0.05)


def test_vector_and_plain_sums_agree():
    @kernel
    def both(cells, weight, sums):
        pointer, quad = pointer_to(cells), (sums[0], sums[1], sums[2], sums[3])
        wide = (0.5, 0.25, 1.5, 2.5)
        lanes.add_to_cell(pointer, 1, weight, quad)
        lanes.add_to_cell_plain(pointer, 2, weight, quad)
        return (
            lanes.with_cell(pointer, 0, weight, quad), lanes.with_cell_plain(pointer, 0, weight, quad),
            lanes.with_cell_exactly(pointer, 0, 0.1, wide), lanes.with_cell_exactly_plain(pointer, 0, 0.1, wide),
        )  # fmt: skip

    cells = noise(1, 4).repeat(3, 1).numpy()
    vector, plain, wide, wide_plain = both(cells, cells[0, 1], cells[0])
    assert vector == plain
    assert wide == wide_plain
    assert (cells[1] == cells[2]).all()
    assert (cells[1] != cells[0]).all()
