"""What PyTorch asks of the operator for polar rasters."""

import pytest
import torch
from polar_twin import SPLINE

from fovden.filters.fused import Inputs
from fovden.filters.fused_polar import blend_polar_stack, return_polar_gradients
from fovden.filters.operator_polar import atrous_polar

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
    return [*leaves, known, region, inverse, factors, kernels, *numbers, HEIGHTS, True, save]


@pytest.mark.parametrize("fill", [False, True])
@pytest.mark.parametrize("optional", [False, True])
def test_it_keeps_its_contract(fill, optional):
    given = arguments(fill=fill, optional=optional)
    given[13] = torch.full((8,), 16)  # what is no cell is not written to the tape, which is compared, too
    torch.library.opcheck(torch.ops.fovden.atrous_polar.default, given)
    image, _, mask, tape = torch.ops.fovden.atrous_polar(*given)
    seeds = torch.ones_like(image), torch.ones_like(mask) if fill else None
    back = (*seeds, image.detach(), tape, True, *given[:-1])
    checks = ("test_schema", "test_faketensor", "test_autograd_registration")
    torch.library.opcheck(torch.ops.fovden.atrous_polar_backward.default, back, test_utils=checks)


@pytest.mark.parametrize("fill", [False, True])
def test_gradients_arrive_where_they_belong(fill):
    given = arguments(fill=fill, optional=True)
    image, _, mask, _ = atrous_polar(*given)
    leaves = [each for each in given if isinstance(each, torch.Tensor) and each.requires_grad]
    got = torch.autograd.grad(image.square().sum() + mask.sum(), leaves)
    inputs = Inputs(*given[:13])
    blended = blend_polar_stack(inputs, HEIGHTS, True, save=True)
    seeds = 2 * blended.image, torch.ones_like(blended.mask) if fill else None
    want = return_polar_gradients(inputs, HEIGHTS, True, blended, *seeds)
    for one, other in zip(got, want, strict=True):
        assert torch.equal(one, other)


def test_light_alone_has_the_same_gradient():
    given = arguments()
    (everything,) = torch.autograd.grad(atrous_polar(*given)[0].sum(), given[0])
    for leaf in given[1:4]:
        leaf.requires_grad_(False)
    (light,) = torch.autograd.grad(atrous_polar(*given)[0].sum(), given[0])
    torch.testing.assert_close(light, everything)


def test_it_compiles_as_one_graph():
    given = arguments()

    def loss(radiance, inverse):
        image, *_ = atrous_polar(radiance, *given[1:6], inverse, *given[7:])
        return image.square().mean()

    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    leaves = given[0], given[6]
    got, want = (torch.autograd.grad(each(*leaves), leaves) for each in (compiled, loss))
    for one, other in zip(got, want, strict=True):
        torch.testing.assert_close(one, other)


def test_functional_calls_have_gradients():
    given = arguments()
    want = torch.autograd.grad(atrous_polar(*given)[0].square().mean(), given[0])[0]
    fixed = [each.detach() if isinstance(each, torch.Tensor) else each for each in given]
    got = torch.func.grad(lambda radiance: atrous_polar(radiance, *fixed[1:])[0].square().mean())(fixed[0])
    torch.testing.assert_close(got, want)


def test_a_second_derivative_is_refused_in_words():
    given = arguments()
    (first,) = torch.autograd.grad(atrous_polar(*given)[0].square().sum(), given[0], create_graph=True)
    with pytest.raises(NotImplementedError, match="fovden::atrous_polar has no second derivative"):
        first.sum().backward()


def test_a_gradient_of_what_was_not_saved_is_refused():
    image, *_ = atrous_polar(*arguments(save=False))
    with pytest.raises(ValueError, match="save"):
        image.sum().backward()
