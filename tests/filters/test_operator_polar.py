"""What PyTorch asks of the operator where its arguments are on a polar raster."""

import pytest
import torch
from polar_twin import SPLINE

from fovden.filters.fused import Inputs
from fovden.filters.fused_polar import blend_polar_stack, return_polar_gradients
from fovden.filters.operator import run_passes
from fovden.filters.passes import Pass, PassOptions, begin, compose
from fovden.filters.taps import Sigmas
from fovden.foveation import Topology

OPERATOR = torch.ops.fovden.atrous
HEIGHTS = torch.tensor([1, 3, 3, 7, 9, 16, 16, 16])


def arguments(*, fill=False, optional=False, save=True):
    """Arguments with leaves that have a gradient."""
    generator = torch.Generator().manual_seed(0)
    images = [torch.rand(2, channels, 16, 8, generator=generator) for channels in (3, 3, 3, 1)]
    leaves = [image.requires_grad_() for image in images]
    known, region, factors, kernels = None, None, None, None
    if optional:
        known, region = images[3].detach() > 0.5, torch.zeros(2, 1, 16, 8, dtype=torch.uint8)
        factors = torch.ones(2, 3, 16, 8, requires_grad=True)
        kernels = SPLINE.float().repeat(2, 1, 1).requires_grad_()
    inverse = torch.ones(2, 3, requires_grad=True)
    numbers = [2, 1], [0, 0], [0, 1], fill
    return [*leaves, known, region, inverse, factors, kernels, HEIGHTS, *numbers, True, save]


@pytest.mark.parametrize("fill", [False, True])
@pytest.mark.parametrize("optional", [False, True])
def test_it_keeps_its_contract(fill, optional):
    given = arguments(fill=fill, optional=optional)
    torch.library.opcheck(torch.ops.fovden.atrous.default, given)
    image, _, mask, *saved = torch.ops.fovden.atrous(*given)
    seeds = torch.ones_like(image), torch.ones_like(mask) if fill else None
    back = (*seeds, image.detach(), *saved, True, *given[:-1])
    checks = ("test_schema", "test_faketensor", "test_autograd_registration")
    torch.library.opcheck(torch.ops.fovden.atrous_backward.default, back, test_utils=checks)


@pytest.mark.parametrize("fill", [False, True])
def test_gradients_arrive_where_they_belong(fill):
    given = arguments(fill=fill, optional=True)
    image, _, mask, *_ = OPERATOR(*given)
    leaves = [each for each in given if isinstance(each, torch.Tensor) and each.requires_grad]
    got = torch.autograd.grad(image.square().sum() + mask.sum(), leaves)
    inputs = Inputs(*given[:9], *given[10:14])
    blended = blend_polar_stack(inputs, HEIGHTS, True, save=True)
    seeds = 2 * blended.image, torch.ones_like(blended.mask) if fill else None
    want = return_polar_gradients(inputs, HEIGHTS, True, blended, *seeds)
    for one, other in zip(got, want, strict=True):
        assert torch.equal(one, other)


def test_light_alone_has_the_same_gradient():
    given = arguments()
    (everything,) = torch.autograd.grad(OPERATOR(*given)[0].sum(), given[0])
    for leaf in given[1:4]:
        leaf.requires_grad_(False)
    (light,) = torch.autograd.grad(OPERATOR(*given)[0].sum(), given[0])
    torch.testing.assert_close(light, everything)


def through_passes(radiance, normal, position, mask, sigmas, run):
    """The image of two passes on the raster."""
    topology = Topology(HEIGHTS, 16, rotate=True)
    passes = [
        Pass(step, Sigmas(*row), level=level) for level, (step, row) in enumerate(zip((2, 1), sigmas, strict=True))
    ]
    state = begin(radiance, mask)
    return run(state, normal, position, passes, options=PassOptions(), topology=topology).image


def leaves_of(dtype):
    """Images and widths that have a gradient."""
    generator = torch.Generator().manual_seed(1)
    shapes = [(1, channels, 16, 8) for channels in (3, 3, 3, 1)] + [(2, 3)]
    return [(torch.rand(shape, generator=generator) + 0.2).to(dtype).requires_grad_() for shape in shapes]


def test_it_compiles_as_one_graph():
    leaves = leaves_of(torch.float32)

    def loss(*leaves):
        return through_passes(*leaves, run_passes).square().mean()

    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    got, want = (torch.autograd.grad(each(*leaves), leaves) for each in (compiled, loss))
    for one, other in zip(got, want, strict=True):
        torch.testing.assert_close(one, other)


def test_functional_calls_have_gradients():
    leaves = leaves_of(torch.float32)
    want = torch.autograd.grad(through_passes(*leaves, run_passes).square().mean(), leaves[0])[0]
    fixed = [each.detach() for each in leaves]
    got = torch.func.grad(lambda radiance: through_passes(radiance, *fixed[1:], run_passes).square().mean())(fixed[0])
    torch.testing.assert_close(got, want)


def test_the_second_derivative_is_that_of_the_composed_form():
    found = []
    for run, dtype in ((run_passes, torch.float32), (compose, torch.float64)):
        leaves = leaves_of(dtype)
        image = through_passes(*leaves, run)
        if run is compose:  # which hands on what is no cell, where the kernels write 0
            image = torch.where(Topology(HEIGHTS, 16).exists, image, 0)
        seed = (image.detach() + 1).requires_grad_()  # not 0 where there is no cell
        first = torch.autograd.grad(image, leaves, seed, create_graph=True)
        weighted = sum((each * (1 + each.detach())).sum() for each in first)
        found.append(torch.autograd.grad(weighted, [*leaves, seed]))
    for got, want in zip(*found, strict=True):
        assert (got.double() - want).abs().max() < 1e-4 * want.abs().max()


def test_a_gradient_of_what_was_not_saved_is_refused():
    image, *_ = OPERATOR(*arguments(save=False))
    with pytest.raises(ValueError, match="save"):
        image.sum().backward()
