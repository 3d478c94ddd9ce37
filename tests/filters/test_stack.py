"""What is learned beyond one triple of widths: widths and kernels of each pass, and the curve of the guide."""

import pytest
import torch
from filter_frames import make_frame, tensors_of
from filter_twin import SPLINE, fill_twin, nonhomogeneous_twin, numbers, pass_twin

from fovden.filters import Atrous, NonHomogeneousAtrous, TapKernel, operator

OWN = {"per_pass": True, "learn_kernel": True}
LEVELS = (1, 2, 3)


def stir(denoiser, seed=0):
    """Moves every parameter, each element by itself."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in denoiser.parameters():
            parameter.add_(0.5 * torch.randn(parameter.shape, generator=generator, dtype=torch.float64))
    return denoiser


def wide(kind, *arguments, **options):
    widths = {"sigma_radiance": 1.1, "sigma_normal": 0.3, "sigma_position": 0.4}
    return kind(*arguments, **{**widths, **options})


def factors_like(radiance):
    generator = torch.Generator().manual_seed(4)
    return 0.5 + torch.rand(radiance.shape, generator=generator, dtype=torch.float64)


def kernels_of(logits):
    """Positive taps of sum 1."""
    powers = numbers(logits)
    powers = 2.718281828459045 ** (powers - powers.max())
    return powers / powers.sum(axis=(1, 2), keepdims=True)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"layers": "snapshot"},
        {"layers": "interleaved", "mask_update": "fill"},
        {"guide_curve": "log"},
        {"guide_curve": "log", "guide": "input", "unsampled_guide": "nearest"},
        {"guide_curve": "log", "unsampled_guide": "literal", "sigma_by": "scale"},
        "holes",
    ],
    ids=str,
)
def test_each_pass_has_its_own_in_every_layer(options):
    shape, options = ((9, 30, 0.03), {}) if options == "holes" else ((9, 11, 0.4), options)
    tensors = tensors_of(make_frame(1, *shape[:2], density=shape[2], seed=3))
    denoiser = stir(wide(NonHomogeneousAtrous, LEVELS, **OWN, **options).double())
    factors = factors_like(tensors[0])
    sigmas = [
        [edges.sigma_radiance.tolist(), edges.sigma_normal.tolist(), edges.sigma_position.tolist()]
        for edges in denoiser.edge_stopping
    ]
    want = nonhomogeneous_twin(
        *(numbers(tensor) for tensor in tensors[:4]),
        tensors[4].numpy(),
        LEVELS,
        sigmas,
        kernels=[kernels_of(kernel.log_kernel) for kernel in denoiser.kernel],
        factors=numbers(factors),
        **options,
    )
    torch.testing.assert_close(denoiser.filter(*tensors, factors=factors), torch.from_numpy(want), rtol=1e-9, atol=1e-9)


def test_the_plain_filter_fills_holes_with_the_widths_of_its_smallest_step():
    tensors = tensors_of(make_frame(1, 9, 30, density=0.03, seed=3))
    c, n, x, b = (numbers(tensor) for tensor in tensors[:4])
    steps = (2, 1, 4)
    denoiser = stir(wide(Atrous, steps, **OWN).double(), seed=2)
    with torch.no_grad():
        denoiser.edge_stopping.log_sigma_position.copy_(torch.tensor([0.3, 0.9, 2.7]).log())
    factors = numbers(factors_like(tensors[0]))
    edges, kernels, known = denoiser.edge_stopping, kernels_of(denoiser.kernel.log_kernel), b > 0
    widths = [numbers(edges.sigma_radiance), numbers(edges.sigma_normal), numbers(edges.sigma_position)]
    for k, step in enumerate(steps):
        own = [width[k] * factors[:, j : j + 1] for j, width in enumerate(widths)]
        c, total = pass_twin(c, n, x, b, step, [own[0] / 2**k, *own[1:]], known=known, kernel=kernels[k])
        known = known | (total > 1e-20)
    assert not known.all()
    fillings = [
        fill_twin(c, ~known, b, n, x, *(widths[j][k] * factors[:, j : j + 1] for j in (1, 2))) for k in range(3)
    ]
    got = denoiser.filter(*tensors, factors=torch.from_numpy(factors))
    torch.testing.assert_close(got, torch.from_numpy(fillings[1]), rtol=1e-9, atol=1e-9)
    assert all(abs(fillings[1] - fillings[k]).max() > 1e-3 for k in (0, 2))


@pytest.mark.parametrize(
    ("kind", "first"), [(Atrous, (4, 2, 1)), (NonHomogeneousAtrous, LEVELS)], ids=["Atrous", "NonHomogeneousAtrous"]
)
class TestBoth:
    def test_they_start_as_without(self, kind, first):
        tensors = [t.float() if t.is_floating_point() else t for t in tensors_of(make_frame(2, 19, 23, density=0.4))]
        plain = kind(first).filter(*tensors)
        assert torch.equal(kind(first, per_pass=True).filter(*tensors), plain)
        torch.testing.assert_close(kind(first, **OWN).filter(*tensors), plain, rtol=1e-5, atol=1e-6)

    def test_without_the_state_is_what_it_was(self, kind, first):
        state = kind(first).state_dict()
        assert all(value.shape == () for value in state.values())
        assert len(state) == (3 if kind is Atrous else 9)
        own = kind(first, **OWN).state_dict()
        assert state.keys() < own.keys()
        assert own.keys() - state.keys() == (
            {"kernel.log_kernel"} if kind is Atrous else {f"kernel.{k}.log_kernel" for k in range(3)}
        )

    def test_the_state_goes_to_a_dictionary_and_back(self, kind, first):
        tensors = tensors_of(make_frame())
        learned, fresh = stir(kind(first, **OWN)), kind(first, **OWN)
        assert not torch.allclose(fresh.filter(*tensors), learned.filter(*tensors))
        fresh.load_state_dict(learned.state_dict())
        assert torch.equal(fresh.filter(*tensors), learned.filter(*tensors))
        with pytest.raises(RuntimeError, match="size mismatch"):
            fresh.load_state_dict(kind(first, learn_kernel=True).state_dict())

    def test_the_fused_form_agrees_with_the_composed_one(self, kind, first, monkeypatch):
        tensors = tensors_of(make_frame(2, 21, 37, density=0.5))
        fields = factors_like(tensors[0])
        answers = []
        for dtype in (torch.float64, torch.float32):
            if dtype == torch.float32:
                monkeypatch.setattr(operator, "compose", None)  # nothing but the fused form may run here
            denoiser = stir(wide(kind, first, **OWN).to(dtype))
            factors = fields.to(dtype).requires_grad_()
            image = denoiser.filter(*(t.to(dtype) for t in tensors[:4]), tensors[4], factors)
            answers.append([image, *torch.autograd.grad(image.square().sum(), [*denoiser.parameters(), factors])])
        for want, got in zip(*answers, strict=True):
            # Bounds of the operator: 2e-6 a pass in value, 1e-4 in the gradients of widths and kernels.
            assert (got - want).abs().max() < 1e-4 * want.abs().max()

    def test_precisions_may_be_mixed(self, kind, first):
        tensors = [t.float() if t.is_floating_point() else t for t in tensors_of(make_frame())]
        double, single = (stir(kind(first, **OWN).to(dtype)) for dtype in (torch.float64, torch.float32))
        factors = factors_like(tensors[0])
        image = double.filter(*tensors, factors)
        assert image.dtype == torch.float32
        torch.testing.assert_close(image, single.filter(*tensors, factors.float()), rtol=1e-5, atol=1e-6)

    def test_they_compile_as_one_graph(self, kind, first):
        tensors = tensors_of(make_frame(1, 12, 20))
        tensors = [t.float() if t.is_floating_point() else t for t in tensors]
        denoiser = stir(kind(first, **OWN))
        parameters = list(denoiser.parameters())

        def loss(factors, *tensors):
            return denoiser.filter(*tensors, factors).square().mean()

        factors = factors_like(tensors[0]).float()
        compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
        got, want = (torch.autograd.grad(each(factors, *tensors), parameters) for each in (compiled, loss))
        for one, other in zip(got, want, strict=True):
            torch.testing.assert_close(one, other)

    def test_the_number_of_threads_does_not_matter(self, kind, first, threads):
        tensors = [t.float() if t.is_floating_point() else t for t in tensors_of(make_frame(2, 80, 70))]
        denoiser = stir(wide(kind, first, **OWN))
        factors = factors_like(tensors[0]).float().requires_grad_()
        answers = []
        for count in (1, 2, 5):
            threads(count)
            image = denoiser.filter(*tensors, factors)
            leaves = [*denoiser.parameters(), factors]
            answers.append([image.detach(), *torch.autograd.grad(image.square().sum(), leaves)])
        for answer in answers[1:]:
            assert all(torch.equal(one, other) for one, other in zip(answers[0], answer, strict=True))

    def test_a_logarithm_of_the_guide_is_composed(self, kind, first, monkeypatch):
        called = []
        monkeypatch.setattr(operator, "compose", lambda state, *_, **__: called.append(1) or state)
        tensors = [t.float() if t.is_floating_point() else t for t in tensors_of(make_frame())]
        kind(first, guide_curve="log").filter(*tensors)
        assert called
        with pytest.raises(ValueError, match="guide_curve"):
            kind(first, guide_curve="sqrt")

    def test_factors_of_another_shape_are_named(self, kind, first):
        tensors = tensors_of(make_frame())
        with pytest.raises(ValueError, match="factors"):
            kind(first).filter(*tensors, torch.ones(2, 1, 9, 11))


def test_kernels_are_positive_sum_to_one_and_start_as_the_spline():
    kernel = TapKernel(3)
    torch.testing.assert_close(kernel(), torch.from_numpy(SPLINE).float().expand(3, 5, 5), rtol=1e-6, atol=0)
    taps = stir(kernel)()
    assert bool((taps > 0).all())
    torch.testing.assert_close(taps.sum((1, 2)), torch.ones(3))
    # A constant added to all logits of a pass changes nothing, so that their gradients sum to 0.
    (gradient,) = torch.autograd.grad((taps * torch.linspace(0, 1, 25).view(5, 5)).sum(), kernel.log_kernel)
    torch.testing.assert_close(gradient.sum((1, 2)), torch.zeros(3), rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match="passes"):
        TapKernel(0)


def test_a_logarithm_compares_ratios_where_it_is_bright():
    # A step from 1 to 2 and one from 1000 to 2000, in literal units: log(3 / 2) and log(2001 / 1001) differ by 1.7;
    # the same widths that keep the brighter step almost whole on c keep both on log(1 + c), or neither.
    def kept(level, curve, sigma):
        radiance = torch.full((1, 3, 1, 20), float(level))
        radiance[..., 10:] *= 2
        flat = torch.zeros_like(radiance)
        filtered = Atrous((1,), guide_curve=curve, sigma_radiance=sigma).filter(radiance, flat, flat)
        return ((filtered[0, 0, 0, 10] - filtered[0, 0, 0, 9]) / level).item()

    assert kept(1, "linear", 10.0) < 0.5
    assert kept(1000, "linear", 10.0) > 0.99
    assert kept(1, "log", 0.1) > 0.99
    assert kept(1000, "log", 0.1) > 0.99
    assert kept(1000, "log", 10.0) == pytest.approx(kept(1, "linear", 10.0), abs=0.02)
