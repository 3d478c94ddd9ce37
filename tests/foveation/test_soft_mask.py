"""Masks with a gradient: closed forms, the frames that the tracer really makes, and differences."""

import dataclasses
import math

import pytest
import torch
from scipy import integrate

from fovden.camera import Gaze
from fovden.checks import ShapeError
from fovden.filters import Atrous, NonHomogeneousAtrous
from fovden.foveation import (
    LearnedThreeLayer,
    ThreeLayer,
    add_differences,
    eccentricity_pixels,
    mask_numbers,
    relaxed_mask,
    sample_map,
    thinned,
)
from fovden.frame import Frame
from fovden.io import save_frame
from fovden.tracer import make_scene, trace_frame

SIZE = (24, 28)
RATE = torch.rand(2, 1, *SIZE, generator=torch.Generator().manual_seed(1))
NUMBERS = mask_numbers(SIZE, 5)


@pytest.fixture(scope="module")
def box():
    """The Cornell box, whose lamp is seen, its camera, and a frame with samples everywhere."""
    scene = make_scene("cornell_box")
    camera = scene.camera.at(resolution=SIZE)
    return scene, camera, trace_frame(scene, camera, 2, seed=3)


def test_the_value_is_the_mask_of_the_sample_map(box):
    _, camera, _ = box
    falloff = LearnedThreeLayer(budget=0.6)
    rate = falloff(camera.views, Gaze.center(camera)).rate
    for index in (0, 2):
        mask = relaxed_mask(rate, mask_numbers(SIZE, 9, index=index), 0.5)
        samples = sample_map(falloff, camera, seed=9, index=index)
        assert torch.equal(mask.detach(), samples.mask.expand(2, -1, -1, -1))
    own = mask_numbers(SIZE, 9, views=2, source="blue_noise")
    samples = sample_map(falloff, camera, seed=9, per_eye=True, source="blue_noise")
    assert torch.equal(relaxed_mask(rate, own, 0.5).detach(), samples.mask)


@pytest.mark.parametrize("temperature", [1.0, 0.3, 0.01])
def test_a_relaxed_mask_is_above_one_half_where_the_mask_is_one(temperature):
    soft = relaxed_mask(RATE, NUMBERS, temperature, straight_through=False)
    assert torch.equal(soft > 0.5, NUMBERS < RATE)
    assert 0 <= soft.min() <= soft.max() <= 1


def test_a_cold_relaxed_mask_is_the_mask():
    drawn = (NUMBERS < RATE).float()
    away = [
        (relaxed_mask(RATE, NUMBERS, temperature, straight_through=False) - drawn).abs().mean().item()
        for temperature in (0.4, 0.1, 0.025, 1e-4)
    ]
    # The mean distance is the integral of exp(-|l| / T) near l = 0, proportional to T where the density is flat.
    assert away[1] / away[2] == pytest.approx(4, rel=0.3)
    assert away[0] > away[1] > away[2] > away[3]
    assert away[3] < 1e-3


@pytest.mark.parametrize("rate", [0.2, 0.5, 0.9])
def test_the_mean_of_a_relaxed_mask_and_its_derivative(rate):
    """Against the integral over the uniform number; at temperature 1 the derivative has a closed form as well."""
    n = 20_001
    numbers = ((torch.arange(n) + 0.5) / n).double().reshape(1, 1, 1, n)
    rates = torch.full((1, 1, 1, n), rate, dtype=torch.float64, requires_grad=True)
    temperature = 0.5
    soft = relaxed_mask(rates, numbers, temperature, straight_through=False)

    def value(u):
        return 1 / (1 + ((1 - rate) / rate * u / (1 - u)) ** (1 / temperature))

    assert soft.mean().item() == pytest.approx(integrate.quad(value, 0, 1)[0], rel=1e-4)
    (slope,) = torch.autograd.grad(soft.sum(), rates)
    assert torch.allclose(slope, soft * (1 - soft) / (temperature * rate * (1 - rate)), rtol=1e-4)
    through = relaxed_mask(rates, numbers, temperature)
    assert set(through.detach().unique().tolist()) == {0.0, 1.0}
    assert torch.equal(torch.autograd.grad(through.sum(), rates)[0], slope)


def test_certain_pixels_have_no_derivative_and_no_nan():
    rate = torch.tensor([0.0, 1.0, 1e-9, 1 - 1e-7, 0.5]).reshape(1, 1, 1, 5).requires_grad_()
    for number in (0.0, 0.3, 1 - 2.0**-24):
        for through in (True, False):
            mask = relaxed_mask(rate, torch.full((1, 1, 1, 5), number), 0.3, through)
            (slope,) = torch.autograd.grad(mask.sum(), rate)
            assert torch.isfinite(slope).all()
            assert (slope.flatten()[:2] == 0).all()
            assert mask.flatten()[:2].tolist() == [0, 1]


DENOISERS = [
    lambda: Atrous((4, 2, 1)),
    lambda: Atrous((4, 2, 1), demodulate=True, relative=False),
    lambda: Atrous((1,), fill_holes=False),
    NonHomogeneousAtrous,
    lambda: NonHomogeneousAtrous(demodulate=True),
    lambda: NonHomogeneousAtrous(layers="snapshot", mask_update="fill"),
    lambda: NonHomogeneousAtrous(layers="interleaved", seam=True),
    lambda: NonHomogeneousAtrous((1, 2), fill_holes=False),
    lambda: NonHomogeneousAtrous(mask_at="center"),
    lambda: NonHomogeneousAtrous(unsampled_guide="literal"),
    lambda: NonHomogeneousAtrous(unsampled_guide="nearest"),
    lambda: NonHomogeneousAtrous(guide="input"),
    lambda: NonHomogeneousAtrous(border="clamp"),
]


@pytest.mark.parametrize("make", DENOISERS)
@pytest.mark.parametrize("radii", [(4, 9), (0, 0)])
def test_a_thinned_frame_is_denoised_as_the_one_that_was_traced(box, make, radii):
    """One in five pixels outside, so that there are holes, also in the lamp; or one eye without any sample."""
    scene, camera, everywhere = box
    denoiser = make()
    gaze = Gaze(torch.tensor([[14.0, 4.0], [13.0, 12.0]]))
    samples = sample_map(ThreeLayer(*radii, 0.8, ramp_end="1-p"), camera, gaze, spp=2, seed=4)
    if radii == (0, 0):
        counts = samples.counts.expand(2, -1, -1, -1).clone()
        counts[1] = 0
        samples = type(samples).from_counts(counts, gaze, layer=samples.layer.expand(2, -1, -1, -1))
    traced = trace_frame(scene, camera, samples, seed=3)
    mask = samples.mask.clone().requires_grad_()
    frame = thinned(everywhere, mask, samples.layer, gaze=gaze)
    assert torch.equal(frame.counts, traced.counts)
    assert torch.equal(frame.luminance_squared, traced.luminance_squared)
    assert torch.equal(frame.layer, traced.layer)
    assert frame.gaze is gaze
    wanted, found = denoiser(traced).image, denoiser(frame).image
    assert traced.emission.any()
    # The same sums of the same numbers, with zeros for others that weigh nothing.
    assert torch.allclose(found, wanted, rtol=1e-6, atol=1e-7)
    assert (everywhere.radiance * (1 - frame.mask)).abs().max() > 0.1  # light is hidden there


def test_the_derivative_in_the_mask_is_that_of_differences(box):
    _, _, everywhere = box
    everywhere = everywhere.to(torch.float64)
    generator = torch.Generator().manual_seed(0)
    mask = (0.1 + 0.9 * torch.rand(2, 1, *SIZE, generator=generator)).double().requires_grad_()
    direction = torch.randn(2, 1, *SIZE, generator=generator).double() * (mask.detach() < 0.9)
    weight = torch.rand(2, 3, *SIZE, generator=generator).double()
    layer = ThreeLayer(4, 9).layer(eccentricity_pixels(Gaze(torch.tensor([[14.0, 12.0]] * 2)), SIZE), SIZE)
    denoiser = NonHomogeneousAtrous((1, 2, 3), demodulate=True, relative=False).double()

    def loss(mask):
        return (weight * denoiser(thinned(everywhere, mask, layer)).image).sum()

    (slope,) = torch.autograd.grad(loss(mask), mask)
    with torch.no_grad():
        difference = (loss(mask + 1e-6 * direction) - loss(mask - 1e-6 * direction)) / 2e-6
    assert (slope * direction).sum().item() == pytest.approx(difference.item(), rel=1e-5)


def test_the_gradient_reaches_the_falloff_with_the_sign_of_differences(box):
    """More paths, less error: the gradient of a relaxed mask against differences of drawn masks, over 24 seeds."""
    scene, camera, everywhere = box
    reference = trace_frame(scene, camera, 512, seed=77).radiance
    falloff, denoiser = LearnedThreeLayer(0.6, 1.0, 0.6), NonHomogeneousAtrous((1, 2, 3)).requires_grad_(False)
    gaze = Gaze.center(camera)

    def loss(make):
        rate, layer, _, _ = falloff(camera.views, gaze)
        losses = []
        for seed in range(24):
            image = denoiser(thinned(everywhere, make(rate, mask_numbers(SIZE, seed, views=2)), layer)).image
            losses.append(((image - reference).abs() / (image + reference + 0.01)).mean())
        return torch.stack(losses).mean()

    soft = loss(lambda rate, numbers: relaxed_mask(rate, numbers, 0.1, straight_through=False))
    slope = torch.autograd.grad(soft, falloff.logit_p)[0].item()
    add_differences([falloff.logit_p], lambda: loss(lambda rate, numbers: (numbers < rate).float()), step=0.3)
    # Fewer paths outside, more error. A third is the bias that was measured; two thirds more is the noise of few seeds.
    assert falloff.logit_p.grad.item() > 0
    assert 0.3 < slope / falloff.logit_p.grad.item() < 1.5


def test_frames_keep_their_weights(box, tmp_path):
    _, _, everywhere = box
    mask = (NUMBERS < RATE).float()
    frame = thinned(everywhere, mask)
    assert frame.mask is frame.weight
    assert frame.to(torch.float64).mask.dtype == torch.float64
    both = Frame.stack([everywhere, frame])
    assert torch.equal(both.mask, torch.cat([everywhere.mask, mask]))
    assert Frame.stack([everywhere, everywhere]).weight is None
    with pytest.raises(ValueError, match="weight: expected None"):
        save_frame(tmp_path / "frame.exr", frame)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ShapeError, match="weight"):
        dataclasses.replace(everywhere, weight=mask[:1])


def test_what_cannot_be_thinned(box):
    _, _, everywhere = box
    lacking = dataclasses.replace(everywhere, counts=everywhere.counts * (NUMBERS < 0.9))
    with pytest.raises(ValueError, match="mask: expected weights above 0 only where the frame has samples"):
        thinned(lacking, torch.ones(1, 1, *SIZE))
    for wrong in (-0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="mask"):
            thinned(everywhere, torch.full((1, 1, *SIZE), wrong))
    with pytest.raises(ShapeError, match="mask"):
        thinned(everywhere, torch.ones(2, 1, 5, 5))
    with pytest.raises(ShapeError, match="numbers"):
        relaxed_mask(RATE, torch.zeros(1, 1, 5, 5), 0.5)
    with pytest.raises(ValueError, match="numbers"):
        relaxed_mask(RATE, torch.zeros(3, 1, *SIZE), 0.5)
    with pytest.raises(ValueError, match="temperature"):
        relaxed_mask(RATE, NUMBERS, 0.0)
