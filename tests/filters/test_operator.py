"""The fused operator against the composed one in double precision, and what PyTorch asks of an operator."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from fovden.filters import Atrous, NonHomogeneousAtrous, operator
from fovden.filters.operator import run_passes
from fovden.filters.passes import Pass, PassOptions, State, begin, compose
from fovden.filters.taps import B3_SPLINE, Sigmas

SPLINE = torch.tensor(B3_SPLINE)[:, None] * torch.tensor(B3_SPLINE)

IMAGES = ("radiance", "normal", "position", "mask", "factors")
SIGMAS = ("sigmas", "kernels")


def tensors(views=2, height=37, width=70, *, mask="full", factors=False, kernels=0, passes=1, seed=0):
    """Leaves of double precision: random radiance, guides, mask and widths."""
    generator = torch.Generator().manual_seed(seed)

    def rand(*shape):
        return torch.rand(*shape, generator=generator).double()

    planes = views, 1, height, width
    masks = {
        "full": torch.ones(planes).double(),
        "hard": (rand(*planes) < 0.5).double(),
        "soft": rand(*planes) * (rand(*planes) < 0.8),
        "positive": rand(*planes) + 0.1,
        "sparse": (rand(*planes) < 0.01).double(),
    }
    made = {
        "radiance": rand(views, 3, height, width) * 3,
        "normal": torch.nn.functional.normalize(rand(views, 3, height, width) - 0.5, dim=1),
        "position": rand(views, 3, height, width),
        "mask": masks[mask],
        "sigmas": rand(passes, 3) + 0.5,
    }
    if factors:
        made["factors"] = rand(views, 3, height, width) + 0.5
    if kernels:
        made["kernels"] = SPLINE.double() * (rand(passes, 5, 5) + 0.5)
    return {name: tensor.requires_grad_() for name, tensor in made.items()}


def layers_of(views, height, width):
    """Three nested regions, not aligned with anything."""
    y, x = torch.arange(height)[:, None] - 15.3, torch.arange(width) - 29.1
    distance = (y**2 + x**2).sqrt()
    return ((distance > 9).int() + (distance > 21).int()).expand(views, 1, height, width)


def stack(leaves, plan, run, *, region=None, options=None, dtype=torch.float64):
    """The state after passes (step, label, level)."""
    made = {name: tensor.to(dtype) for name, tensor in leaves.items()}
    options = options or PassOptions()
    passes = [
        Pass(step, Sigmas(*own), label, level, made["kernels"][number] if "kernels" in made else None)
        for number, ((step, label, level), own) in enumerate(zip(plan, made["sigmas"].unbind(), strict=True))
    ]
    state = begin(made["radiance"], made["mask"])
    return run(
        state, made["normal"], made["position"], passes, region=region, factors=made.get("factors"), options=options
    )


def error(got, want):
    got, want = got.detach().double(), want.detach()
    return float((got - want).abs().max() / want.abs().max())


def simple(*steps):
    return [(step, 0, level) for level, step in enumerate(steps)]


NESTED = [(2, 0, 0), (1, 0, 1), (4, 1, 2), (2, 1, 3), (1, 1, 4), (8, 2, 5), (1, 2, 6)]
INTERLEAVED = [(4, 2, 0), (2, 1, 1), (2, 2, 1), (1, 0, 2), (1, 1, 2), (1, 2, 2)]
FILL, LITERAL, CENTER = PassOptions(fill=True), PassOptions(unsampled_guide="literal"), PassOptions(mask_at="center")

CASES = {
    "one": (simple(1), {}),
    "wide": (simple(16), {"mask": "soft"}),
    "beyond": (simple(64, 1), {"mask": "hard"}),
    "three": (simple(4, 2, 1), {}),
    "masked": (simple(1, 2, 4), {"mask": "hard"}),
    "soft": (simple(4, 2, 1), {"mask": "soft"}),
    "sparse": (simple(2, 1), {"mask": "sparse"}),
    "fill": (simple(4, 2, 1), {"mask": "soft", "options": FILL}),
    "literal": (simple(2, 1), {"mask": "hard", "options": LITERAL}),
    "literal, not all reached": (simple(1), {"mask": "sparse", "options": LITERAL}),
    "center": (simple(2, 1), {"mask": "hard", "options": CENTER}),
    "factors": (simple(2, 1), {"mask": "soft", "factors": True}),
    "kernels": (simple(2, 1), {"mask": "soft", "kernels": True}),
    "layers": (NESTED, {"mask": "hard", "region": True}),
    "layers, all": (NESTED, {"mask": "soft", "region": True, "factors": True, "kernels": True, "options": FILL}),
    "interleaved": (INTERLEAVED, {"mask": "soft", "region": True}),
    "interleaved, full": (INTERLEAVED, {"region": True, "options": FILL}),
}


def compare(plan, *, mask="full", region=False, options=None, factors=False, kernels=False, size=(37, 70)):
    """Errors of the fused operator against the composed one: of the image, and of each gradient."""
    leaves = tensors(2, *size, mask=mask, factors=factors, kernels=kernels, passes=len(plan))
    labels = layers_of(2, *size) if region else None
    states, gradients = {}, {}
    for run, dtype in ((run_passes, torch.float32), (compose, torch.float64)):
        state = stack(leaves, plan, run, region=labels, options=options, dtype=dtype)
        seed = torch.randn(state.image.shape, generator=torch.Generator().manual_seed(9))
        outputs, seeds = [state.image], [seed.to(dtype)]
        if options is FILL:  # its mask depends on the one given
            outputs, seeds = [*outputs, state.mask], [*seeds, seed[:, :1].to(dtype)]
        gradients[run] = torch.autograd.grad(outputs, list(leaves.values()), seeds, allow_unused=True)
        states[run] = state
    assert torch.equal(states[run_passes].has_value(), states[compose].has_value())
    found = {"image": error(states[run_passes].image, states[compose].image)}
    for name, got, want in zip(leaves, gradients[run_passes], gradients[compose], strict=True):
        if want is not None:
            found[name] = error(got, want)
    return found


@pytest.mark.parametrize("name", CASES)
def test_it_agrees_with_the_composed_form_in_double_precision(name, monkeypatch):
    monkeypatch.setattr(operator, "compose", None)  # nothing but the fused form may run here
    plan, options = CASES[name]
    found = compare(plan, **options)
    assert found["image"] < 2e-6 * len(plan)
    for leaf, bound in [*((name, 1e-5) for name in IMAGES), *((name, 1e-4) for name in SIGMAS)]:
        assert found.get(leaf, 0.0) < bound, leaf
    assert {"image", "radiance", "normal", "position", "sigmas"} <= found.keys()


@pytest.mark.parametrize("size", [(1, 40), (40, 1), (3, 16), (5, 17), (2, 33)])
def test_it_agrees_in_images_of_every_shape(size):
    found = compare(simple(2, 1), mask="soft", size=size)
    assert found.pop("image") < 4e-6
    assert all(value < 1e-4 for value in found.values()), found


def test_a_pixel_alone_is_itself():
    leaves = tensors(1, 1, 1, passes=2)
    image = stack(leaves, simple(2, 1), run_passes, dtype=torch.float32).image
    torch.testing.assert_close(image, leaves["radiance"].float())
    gradients = dict(zip(leaves, torch.autograd.grad(image.sum(), list(leaves.values())), strict=True))
    torch.testing.assert_close(gradients.pop("radiance"), torch.ones(1, 3, 1, 1).double())
    assert all(float(gradient.abs().max()) < 1e-6 for gradient in gradients.values())


def test_plain_kernels_agree_too():
    """What runs where vector code is switched off."""
    code = (
        "import json, sys, test_operator as t\n"
        "cases = {name: t.compare(t.CASES[name][0], **t.CASES[name][1], size=(21, 37)) for name in sys.argv[1:]}\n"
        "print(json.dumps(cases))"
    )
    names = ["soft", "layers, all", "interleaved"]
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"FOVDEN_SIMD": "0", "PYTHONPATH": path}
    command = [sys.executable, "-c", code, *names]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name, found in json.loads(done.stdout).items():
        assert found.pop("image") < 2e-6 * len(CASES[name][0])
        assert all(value < 1e-4 for value in found.values()), (name, found)


@pytest.mark.parametrize(
    "changed",
    [
        {"dtype": torch.float64},
        {"options": PassOptions(guide="input")},
        {"options": PassOptions(unsampled_guide="nearest")},
        {"options": PassOptions(border="clamp")},
    ],
    ids=str,
)
def test_other_readings_and_precisions_are_composed(changed, monkeypatch):
    called = []
    monkeypatch.setattr(operator, "compose", lambda state, *_, **__: called.append(1) or state)
    stack(tensors(mask="hard"), simple(1), run_passes, **{"dtype": torch.float32, **changed})
    assert called


def test_values_and_gradients_do_not_depend_on_the_number_of_threads(threads):
    leaves = tensors(2, 90, 70, mask="soft", passes=len(NESTED))
    answers = []
    for count in (1, 2, 3, 5):
        threads(count)
        state = stack(leaves, NESTED, run_passes, region=layers_of(2, 90, 70), dtype=torch.float32)
        gradients = torch.autograd.grad(state.image.square().sum(), list(leaves.values()))
        answers.append([state.image.detach(), *gradients])
    for answer in answers[1:]:
        assert all(torch.equal(one, other) for one, other in zip(answers[0], answer, strict=True))


def test_pixels_outside_the_region_are_copied_and_inputs_left_alone():
    leaves = tensors(mask="hard", passes=2)
    region = layers_of(2, 37, 70)
    before = {name: tensor.detach().clone() for name, tensor in leaves.items()}
    state = stack(leaves, [(2, 1, 0), (1, 1, 1)], run_passes, region=region, dtype=torch.float32)
    state.image.sum().backward()
    outside = (region != 1).expand_as(state.image)
    assert torch.equal(state.image[outside], leaves["radiance"].float()[outside])
    assert not torch.equal(state.image[~outside], leaves["radiance"].float()[~outside])
    assert all(torch.equal(before[name], leaves[name]) for name in leaves)


def test_memory_need_not_be_contiguous_or_whole():
    leaves = tensors(mask="soft", passes=2)
    want = stack(leaves, simple(2, 1), run_passes, dtype=torch.float32).image
    turned = {
        name: tensor.float().transpose(-1, -2).contiguous().transpose(-1, -2) if tensor.dim() == 4 else tensor.float()
        for name, tensor in leaves.items()
    }
    assert torch.equal(stack(turned, simple(2, 1), run_passes, dtype=torch.float32).image, want)
    one = leaves | {"mask": leaves["mask"][:1]}
    both = leaves | {"mask": leaves["mask"][:1].expand(2, -1, -1, -1)}
    got, want = (stack(each, simple(2, 1), run_passes, dtype=torch.float32).image for each in (one, both))
    assert torch.equal(got, want)
    (gradient,) = torch.autograd.grad(got.sum(), one["mask"])
    assert gradient.shape == (1, 1, 37, 70)


def test_gradients_can_be_taken_twice_from_one_graph():
    leaves = tensors(mask="soft", passes=2)
    image = stack(leaves, simple(2, 1), run_passes, dtype=torch.float32).image
    once, again = (torch.autograd.grad(image.sum(), list(leaves.values()), retain_graph=True) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(once, again, strict=True))


def test_the_second_derivative_is_that_of_the_composed_form():
    leaves = tensors(1, 12, 20, mask="soft", passes=2, factors=True)
    found = []
    for run, dtype in ((run_passes, torch.float32), (compose, torch.float64)):
        image = stack(leaves, simple(2, 1), run, dtype=dtype).image
        first = torch.autograd.grad(image.square().sum(), list(leaves.values()), create_graph=True)
        weighted = sum((gradient * gradient.detach()).sum() for gradient in first)
        found.append(torch.autograd.grad(weighted, list(leaves.values())))
    for got, want in zip(*found, strict=True):
        assert error(got, want) < 1e-4


def test_the_composed_form_has_the_derivatives_that_it_claims():
    leaves = tensors(1, 4, 5, mask="positive", passes=2, factors=True, kernels=True)
    region = layers_of(1, 4, 5) * 0 + torch.arange(5).gt(2)

    def image(*given):
        named = dict(zip(leaves, given, strict=True))
        return stack(named, [(1, 0, 0), (2, 1, 1)], compose, region=region).image

    assert torch.autograd.gradcheck(image, list(leaves.values()))


@pytest.mark.parametrize("value", [0.0, 1e-30])
def test_no_gradient_is_lost_or_invented_where_every_weight_underflows(value):
    """Pixels that are like none of their taps, and are not taps themselves: they keep what they have."""
    leaves = tensors(1, 8, 20, mask="full")
    with torch.no_grad():
        leaves["mask"][..., ::2, :] = value
        leaves["position"][:, 0] = torch.arange(8)[:, None] * 1e6
    state = stack(leaves, simple(1), run_passes, dtype=torch.float32)
    alone = torch.zeros(1, 3, 8, 20, dtype=torch.bool)
    alone[..., ::2, :] = True
    assert torch.equal(state.image[alone], leaves["radiance"].float()[alone])
    gradients = torch.autograd.grad(state.image.sum(), list(leaves.values()))
    assert all(bool(gradient.isfinite().all()) for gradient in gradients)
    assert torch.equal(gradients[0][alone], torch.ones_like(gradients[0])[alone])


def test_background_and_surfaces_do_not_mix():
    """Misses lie 1e6 units away, at one point: squared differences of 1e12, and no weight, no NaN, no gradient."""
    leaves = tensors(1, 16, 40)
    with torch.no_grad():
        leaves["position"][..., 20:] = 1e6
        leaves["normal"][..., 20:] = 0
    wanted = list(leaves.values())
    state = stack(leaves, simple(1), run_passes, dtype=torch.float32)
    (there,) = torch.autograd.grad(state.image[..., :20].sum(), leaves["radiance"], retain_graph=True)
    assert float(there[..., 20:].abs().max()) < 1e-20
    gradients = torch.autograd.grad(state.image.square().sum(), wanted)
    assert all(bool(gradient.isfinite().all()) for gradient in gradients)


def test_what_is_no_number_spoils_its_neighbourhood_alone_and_alike():
    leaves = tensors(1, 12, 20)
    with torch.no_grad():
        leaves["normal"][0, 0, 3, 7] = torch.nan
        leaves["radiance"][0, 1, 8, 12] = torch.nan
    fused = stack(leaves, simple(1), run_passes, dtype=torch.float32).image
    composed = stack(leaves, simple(1), compose).image
    torch.testing.assert_close(fused.double(), composed, rtol=1e-5, atol=1e-6, equal_nan=True)


class TestPyTorch:
    """Compilation, export, functional calls."""

    @pytest.fixture
    def inputs(self):
        made = tensors(1, 12, 20, mask="soft")
        return [made[name].detach().float() for name in ("radiance", "normal", "position", "mask")]

    def test_the_operator_keeps_its_contract(self, inputs):
        row = torch.ones(1, 3, requires_grad=True)
        kernels, factors = SPLINE[None].clone().requires_grad_(), torch.ones_like(inputs[0], requires_grad=True)
        leaves = [tensor.clone().requires_grad_() for tensor in inputs]
        region = torch.zeros_like(inputs[3], dtype=torch.uint8)
        for fill in (False, True):
            numbers = [1], [0], [0], fill, False, True
            arguments = (*leaves, inputs[3] > 0, region, row, factors, kernels, None, *numbers)
            torch.library.opcheck(torch.ops.fovden.atrous.default, arguments)
            image, _, _, *saved = torch.ops.fovden.atrous(*arguments)
            gradient, mask = torch.ones_like(image), torch.ones_like(inputs[3]) if fill else None
            back = (gradient, mask, image.detach(), *saved, True, *arguments[:-1])
            checks = ("test_schema", "test_faketensor", "test_autograd_registration")
            torch.library.opcheck(torch.ops.fovden.atrous_backward.default, back, test_utils=checks)

    @pytest.mark.parametrize("denoiser", [Atrous((2, 1)), NonHomogeneousAtrous((1, 2))], ids=["Atrous", "NH2LD"])
    def test_it_compiles_as_one_graph(self, denoiser, inputs):
        layer = layers_of(1, 12, 20)

        def loss(*tensors):
            return denoiser.filter(*tensors, layer).square().mean()

        compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
        parameters = list(denoiser.parameters())
        got, want = (torch.autograd.grad(each(*inputs), parameters) for each in (compiled, loss))
        for one, other in zip(got, want, strict=True):
            torch.testing.assert_close(one, other)

    def test_it_is_exported_with_height_and_width_open(self, inputs):
        class Filter(torch.nn.Module):
            def __init__(self):
                super().__init__()
                self.atrous = Atrous((2, 1))

            def forward(self, radiance, normal, position, mask):
                return self.atrous.filter(radiance, normal, position, mask)

        sizes = {2: torch.export.Dim("height", min=4), 3: torch.export.Dim("width", min=4)}
        exported = torch.export.export(Filter(), tuple(inputs), dynamic_shapes=(sizes,) * 4).module()
        others = [tensor[..., :9, :17] for tensor in inputs]
        assert torch.equal(exported(*others), Filter()(*others))

    def test_functional_calls_have_gradients(self, inputs):
        denoiser = Atrous((2, 1))
        parameters = {name: tensor.detach() for name, tensor in denoiser.named_parameters()}

        def loss(parameters):
            class Bound(torch.nn.Module):
                def __init__(self):
                    super().__init__()
                    self.inner = denoiser

                def forward(self, *tensors):
                    return self.inner.filter(*tensors)

            named = {f"inner.{name}": tensor for name, tensor in parameters.items()}
            return torch.func.functional_call(Bound(), named, tuple(inputs)).square().mean()

        got = torch.func.grad(loss)(parameters)
        want = torch.autograd.grad(denoiser.filter(*inputs).square().mean(), list(denoiser.parameters()))
        for one, other in zip(got.values(), want, strict=True):
            torch.testing.assert_close(one, other)

    def test_the_state_dict_is_all_there_is_to_know(self, inputs):
        one, other = Atrous((2, 1), sigma_radiance=0.3), Atrous((2, 1))
        other.load_state_dict(one.state_dict())
        assert torch.equal(one.filter(*inputs), other.filter(*inputs))


def test_an_empty_stack_changes_nothing():
    state = begin(torch.ones(1, 3, 2, 2), None)
    assert isinstance(run_passes(state, state.image, state.image, [], options=PassOptions()), State)
