"""The network that predicts widths: what it sees, what it may do, and that it learns."""

from dataclasses import fields, replace

import pytest
import torch
from filter_frames import make_frame

from fovden.filters import Atrous, NonHomogeneousAtrous, PredictedSigmas, operator
from fovden.filters.predicted import local_features

BUILDERS = {
    "Atrous": lambda **options: Atrous((2, 1), **options),
    "NH3LD": lambda **options: NonHomogeneousAtrous((1, 2, 3), **options),
}
each_inner = pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS)


def stir(denoiser, scale=0.3):
    """A network whose last layer is not 0 any more."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weight in denoiser.network.parameters():
            weight.add_(scale * torch.randn(weight.shape, generator=generator))
    return denoiser


def in_precision(record, dtype):
    """A frame whose floating planes have another type."""
    planes = {field.name: getattr(record, field.name) for field in fields(record)}
    floating = {name: plane for name, plane in planes.items() if torch.is_tensor(plane) and plane.is_floating_point()}
    changed = {name: plane.to(dtype) for name, plane in floating.items()}
    if "gbuffer" in planes:
        changed["gbuffer"] = in_precision(planes["gbuffer"], dtype)
    return replace(record, **changed)


def sky(**options):
    frame = make_frame(2, 9, 12, **options)
    nothing = {"prim": torch.full_like(frame.gbuffer.prim, -1)}
    for name in ("normal", "position", "depth", "albedo"):
        nothing[name] = torch.zeros_like(getattr(frame.gbuffer, name))
    return replace(frame, gbuffer=replace(frame.gbuffer, **nothing))


def unsampled(**options):
    frame = make_frame(2, 9, 12, **options)
    names = ("counts", "direct", "indirect", "emission")
    return replace(frame, **{name: torch.zeros_like(getattr(frame, name)) for name in names})


def black(**options):
    frame = make_frame(2, 9, 12, **options)
    return replace(frame, direct=frame.direct * 0, indirect=frame.indirect * 0)


FRAMES = {
    "full": lambda **options: make_frame(2, 9, 12, emission=True, **options),
    "sky": sky,
    "unsampled": unsampled,
    "black": black,
    "one pixel": lambda **options: make_frame(2, 1, 1, misses=False, density=1, **options),
}


@each_inner
@pytest.mark.parametrize("options", [{}, {"demodulate": True}, {"relative": False}], ids=str)
def test_it_starts_as_the_denoiser_inside(build, options):
    frame = make_frame(2, 12, 21, dtype=torch.float32)
    want = build(**options)(frame).image
    torch.testing.assert_close(PredictedSigmas(build(**options))(frame).image, want, rtol=1e-6, atol=1e-7)


@each_inner
def test_factors_reach_every_width(build):
    # The same as a filter whose widths are wider by hand.
    frame = make_frame(2, 12, 21)
    denoiser = PredictedSigmas(build(sigma_radiance=1.0, sigma_normal=0.2, sigma_position=0.1).double()).double()
    with torch.no_grad():
        denoiser.network[-1].bias.copy_(torch.tensor([0.5, -0.4, 0.3]))
    factors = (3 * (torch.tensor([0.5, -0.4, 0.3]).double() / 3).tanh()).exp().tolist()
    widths = dict(zip(("sigma_radiance", "sigma_normal", "sigma_position"), factors, strict=True))
    widths = {name: factor * width for (name, factor), width in zip(widths.items(), (1.0, 0.2, 0.1), strict=True)}
    torch.testing.assert_close(denoiser(frame).image, build(**widths).double()(frame).image, rtol=1e-5, atol=1e-6)


def test_factors_are_bounded_and_differ_from_pixel_to_pixel():
    frame = make_frame(2, 12, 21)
    denoiser = stir(PredictedSigmas(Atrous((2, 1)))).double()
    moderate = denoiser.predict(frame)
    assert moderate.shape == (2, 3, 12, 21)
    assert (moderate.flatten(2).std(-1) > 0.01).all()
    extreme = stir(denoiser, 100.0).predict(frame)
    bound = torch.tensor(3.0).double().exp()
    assert ((extreme <= bound) & (extreme >= 1 / bound)).all()


@each_inner
@pytest.mark.parametrize("options", [{}, {"demodulate": True}, {"relative": False}], ids=str)
@pytest.mark.parametrize("name", FRAMES)
def test_images_and_gradients_are_finite_whatever_the_frame(build, options, name):
    for dtype in (torch.float32, torch.float64):
        frame = FRAMES[name](dtype=dtype)
        denoiser = stir(PredictedSigmas(build(**options))).to(dtype)
        direct = frame.direct.clone().requires_grad_()
        image = denoiser(replace(frame, direct=direct)).image
        assert image.dtype == dtype
        assert bool(image.isfinite().all())
        gradients = torch.autograd.grad(image.square().sum(), [direct, *denoiser.parameters()], allow_unused=True)
        assert all(bool(gradient.isfinite().all()) for gradient in gradients if gradient is not None)


@each_inner
def test_the_fused_form_agrees_with_the_composed_one(build, monkeypatch):
    frame = make_frame(2, 15, 21, dtype=torch.float32)
    answers = []
    for dtype in (torch.float64, torch.float32):
        if dtype == torch.float32:
            monkeypatch.setattr(operator, "compose", None)
        denoiser = stir(PredictedSigmas(build()), 0.1).to(dtype)
        image = denoiser(in_precision(frame, dtype)).image
        answers.append([image, *torch.autograd.grad(image.square().sum(), list(denoiser.parameters()))])
    for want, got in zip(*answers, strict=True):
        # The network's own rounding, and that of the widths' gradients, 1e-4.
        assert (got - want).abs().max() < 3e-4 * want.abs().max()


def test_weights_have_the_derivatives_of_finite_differences():
    # Step by step in double precision, two weights of each layer, holes and misses included.
    frame = make_frame(1, 7, 9, density=0.3)
    inner = NonHomogeneousAtrous((1, 2), seam=False, sigma_normal=0.2, sigma_position=0.1)
    denoiser = stir(PredictedSigmas(inner, 4), 0.1).double()

    def loss():
        return denoiser(frame).image.square().sum()

    weights = list(denoiser.network.parameters())
    gradients = torch.autograd.grad(loss(), weights)
    with torch.no_grad():
        for weight, gradient in zip(weights, gradients, strict=True):
            for index in (0, weight.numel() // 2):
                around = []
                for shift in (1e-6, -2e-6):
                    weight.view(-1)[index] += shift
                    around.append(loss())
                weight.view(-1)[index] += 1e-6
                difference = (around[0] - around[1]) / 2e-6
                torch.testing.assert_close(gradient.reshape(-1)[index], difference, rtol=1e-5, atol=1e-7)
    assert all(bool((gradient != 0).any()) for gradient in gradients)


def test_a_seam_joins_the_filters_views_and_not_the_networks():
    frame = make_frame(2, 8, 20, misses=False)
    changed = replace(frame, direct=torch.cat([frame.direct[:1], frame.direct[1:] * 3]))
    options = {"sigma_normal": 9.0, "sigma_position": 9.0, "relative": False}
    joined = stir(PredictedSigmas(NonHomogeneousAtrous((1, 2), seam=True, **options)), 0.05).double()
    apart = stir(PredictedSigmas(NonHomogeneousAtrous((1, 2), **options)), 0.05).double()
    torch.testing.assert_close(joined.predict(frame)[0], joined.predict(changed)[0], rtol=1e-12, atol=1e-12)
    assert torch.equal(joined.predict(frame), apart.predict(frame))
    got, want = joined(frame).image, apart(frame).image
    # Where no tap crosses the border the two are the same: factors lie where their pixels are.
    torch.testing.assert_close(got[0, ..., :-6], want[0, ..., :-6])
    torch.testing.assert_close(got[1, ..., 6:], want[1, ..., 6:])
    assert not torch.allclose(got[0, ..., -2:], want[0, ..., -2:], rtol=1e-3)


def test_features_are_what_they_say():
    frame = make_frame(1, 9, 10)
    light = frame.radiance
    features = local_features(frame, light)
    y, x = 5, 2  # near the left edge: part of the window lies outside
    window = (0, slice(max(y - 3, 0), y + 4), slice(max(x - 3, 0), x + 4))
    sampled = frame.counts[0][window] > 0
    level = (light[0] * torch.tensor([0.2126, 0.7152, 0.0722]).double()[:, None, None]).sum(0, keepdim=True)
    level = (level + 1 / 64).log()[window][sampled]
    want = [level.mean(), level.std(correction=0), sampled.sum() / 49]
    torch.testing.assert_close(features[0, -3:, y, x], torch.stack(want), rtol=1e-4, atol=1e-5)
    assert torch.equal(features[:, :3], frame.gbuffer.normal)
    assert torch.equal(features[:, 4:7], frame.gbuffer.albedo)
    hit = frame.gbuffer.hit
    median = frame.gbuffer.depth[hit].median()
    torch.testing.assert_close(features[:, 3:4][hit], (frame.gbuffer.depth[hit] / median).log())
    assert torch.equal(features[:, 3:4][~hit], torch.zeros_like(features[:, 3:4][~hit]))
    assert torch.equal(features[:, 7:8], hit.double())
    torch.testing.assert_close(features[:, 8:10], torch.cat([1 / (1.0 + frame.layer), (1 + frame.counts).log()], 1))


def test_light_beneath_an_unsampled_pixel_is_not_seen():
    frame = make_frame(2, 9, 12)
    stray = replace(frame, direct=torch.where(frame.mask > 0, frame.direct, 77.0))
    assert torch.equal(local_features(frame, frame.radiance), local_features(stray, stray.radiance))


def test_it_learns_what_one_triple_of_widths_cannot():
    # Left of the middle a faint, clean texture of the light, right of it strong noise around one value: the width of
    # radiance that suits one half spoils the other; normals tell the halves apart.
    generator = torch.Generator().manual_seed(0)
    frame = make_frame(1, 16, 32, misses=False, density=1.0)
    right = torch.arange(32) >= 16
    stripes = 0.4 + 0.2 * (torch.arange(32) % 2).double()
    truth = torch.where(right, 0.5, stripes).expand(1, 3, 16, 32)
    noise = 0.5 * torch.rand(1, 1, 16, 32, generator=generator).double()
    direct = torch.where(right, truth - 0.25 + noise, truth)
    normal = torch.stack([right.double(), torch.zeros(32).double(), (~right).double()])[None, :, None]
    flat = torch.zeros_like(frame.gbuffer.position)
    gbuffer = replace(frame.gbuffer, normal=normal.expand(1, 3, 16, 32), position=flat - 2, depth=flat[:, :1] + 2)
    frame = replace(frame, direct=direct, indirect=flat, emission=flat, gbuffer=gbuffer)

    def learn(denoiser, rate, steps):
        optimizer = torch.optim.Adam(denoiser.double().parameters(), lr=rate)
        for _ in range(steps):
            optimizer.zero_grad()
            loss = (denoiser(frame).image - truth).square().mean()
            loss.backward()
            optimizer.step()
        return loss.item()

    alone = learn(Atrous((2, 1), sigma_radiance=0.8), 0.03, 40)  # settles at 0.0015, a seventh of the noise
    assert learn(PredictedSigmas(Atrous((2, 1), sigma_radiance=0.3)), 0.01, 20) < alone / 5


def test_weights_come_from_the_seed_and_nowhere_else():
    before = torch.get_rng_state()
    one, same, other = PredictedSigmas(Atrous()), PredictedSigmas(Atrous()), PredictedSigmas(Atrous(), seed=1)
    assert torch.equal(before, torch.get_rng_state())
    assert all(torch.equal(a, b) for a, b in zip(one.parameters(), same.parameters(), strict=True))
    assert not torch.equal(one.network[0].weight, other.network[0].weight)
    assert sum(weight.numel() for weight in PredictedSigmas(Atrous(), 8).network.parameters()) < 4787


def test_bad_input_is_named():
    with pytest.raises(TypeError, match="inner"):
        PredictedSigmas(torch.nn.Identity())
    with pytest.raises(ValueError, match="channels"):
        PredictedSigmas(Atrous(), 0)
    frame = make_frame()
    with pytest.raises(ValueError, match="radiance"):
        PredictedSigmas(Atrous())(replace(frame, direct=frame.direct - 9))
