"""What a frame becomes before and after a filter: units, background, albedo and emission."""

from dataclasses import replace

import pytest
import torch
from filter_frames import make_frame, tensors_of

from fovden.color import luminance
from fovden.filters import Atrous, NonHomogeneousAtrous
from fovden.filters.guided import length_unit, radiance_unit
from fovden.frame import Frame, GBuffer


def test_units_are_the_views_own():
    frame = make_frame(2, 8, 9)
    unit = radiance_unit(frame.radiance, frame.mask)
    length = length_unit(frame.gbuffer.depth, frame.gbuffer.hit)
    for view in range(2):
        sampled, hit = frame.mask[view] > 0, frame.gbuffer.hit[view]
        assert unit[view].item() == pytest.approx(luminance(frame.radiance)[view][sampled].mean().item())
        assert length[view].item() == pytest.approx(frame.gbuffer.depth[view][hit].median().item())


def test_units_of_nothing_are_one():
    black, none = torch.zeros(1, 3, 4, 4), torch.zeros(1, 1, 4, 4)
    assert radiance_unit(black, none + 1).item() == radiance_unit(black + 1, none).item() == 1
    assert length_unit(none, none > 0).item() == 1


def test_relative_filters_are_literal_ones_in_the_views_units():
    frame = make_frame(1)
    unit = radiance_unit(frame.radiance, frame.mask).item()
    length = length_unit(frame.gbuffer.depth, frame.gbuffer.hit).item()
    relative = Atrous((2, 1), sigma_radiance=0.6, sigma_position=0.05)
    literal = Atrous((2, 1), sigma_radiance=0.6 * unit, sigma_position=0.05 * length, relative=False)
    # Widths pass through a float32 logarithm: relative errors of 1e-7.
    torch.testing.assert_close(relative(frame).image, literal(frame).image, rtol=1e-5, atol=1e-6)
    other = Atrous((2, 1), sigma_radiance=0.6, sigma_position=0.05, relative=False)
    assert not torch.allclose(relative(frame).image, other(frame).image, rtol=1e-3)


@pytest.mark.parametrize("relative", [True, False])
def test_background_never_mixes_with_surfaces(relative):
    # Surfaces near the world's origin, where the zeros of a miss lie, and steps at which normals hardly count.
    frame = make_frame(1, 24, 24)
    hit = frame.gbuffer.hit
    gbuffer = replace(frame.gbuffer, position=frame.gbuffer.position * 1e-3, normal=frame.gbuffer.normal * 1e-3)
    lit = torch.where(hit, frame.direct, 0)
    sky = torch.where(hit, 0, frame.direct + frame.mask)
    denoiser = Atrous((8, 4, 2, 1), sigma_radiance=1e6, relative=relative)
    for light, black in ((lit, ~hit), (sky, hit)):
        frame = Frame.from_radiance(light, gbuffer, counts=frame.counts)
        image = denoiser(frame).image
        # exp(-80) / exp(0) is 2e-35, and the steps cannot add up to more than 1e-30 of it.
        assert image[black.expand_as(image)].max().item() < 1e-30
        assert image[~black.expand_as(image)].min().item() > 0


def test_background_is_filtered_with_background():
    frame = Frame.from_radiance(torch.rand(1, 3, 16, 16), GBuffer.empty(1, (16, 16)))
    assert Atrous((2, 1))(frame).image.std() < frame.radiance.std() / 2


@pytest.mark.parametrize("part", ["direct", "indirect", "emission"])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_bad_radiance_is_named(part, value):
    frame = make_frame()
    broken = getattr(frame, part).clone()
    broken[1, 2, 3, 4] = value
    for denoiser in (Atrous(), NonHomogeneousAtrous(demodulate=True)):
        with pytest.raises(ValueError, match=rf"frame.radiance \({part}\).*\(1, 2, 3, 4\)"):
            denoiser(replace(frame, **{part: broken}))


@pytest.mark.parametrize("guide", ["normal", "position"])
def test_bad_guides_are_named_where_a_surface_is_seen(guide):
    frame = make_frame(1)
    for index, raises in (((0, 0, 0, 0), False), ((0, 0, 5, 5), True)):
        broken = getattr(frame.gbuffer, guide).clone()
        broken[index] = torch.nan
        changed = replace(frame, gbuffer=replace(frame.gbuffer, **{guide: broken}))
        if raises:
            with pytest.raises(ValueError, match=f"frame.gbuffer.{guide}"):
                Atrous()(changed)
        else:
            assert torch.equal(Atrous()(changed).image, Atrous()(frame).image)


@pytest.mark.parametrize("denoiser", [Atrous(), NonHomogeneousAtrous(), NonHomogeneousAtrous(demodulate=True)])
def test_a_mask_with_nothing_selected_gives_black_without_nan(denoiser):
    frame = make_frame(2, density=0.0)
    image = denoiser(frame).image
    assert torch.equal(image, torch.zeros_like(image))
    half = Frame.stack([frame, make_frame(2, density=0.5)])
    image = denoiser(half).image
    assert torch.equal(image[:2], torch.zeros_like(image[:2]))
    assert bool((image[2:] > 0).all())


def test_demodulation_keeps_textures():
    # Constant illumination on a texture: filtering the illumination gives the texture back, radiance blurs it.
    frame = make_frame(misses=False, density=0.7)
    gbuffer = frame.gbuffer
    lit = Frame.from_radiance(0.8 * gbuffer.albedo * frame.mask, gbuffer, counts=frame.counts, layer=frame.layer)
    sharp = NonHomogeneousAtrous((1, 2, 3), demodulate=True)(lit).image
    torch.testing.assert_close(sharp, 0.8 * gbuffer.albedo)
    blurred = NonHomogeneousAtrous((1, 2, 3))(lit).image
    assert not torch.allclose(blurred, 0.8 * gbuffer.albedo, rtol=0.1)


def test_demodulation_changes_nothing_where_albedo_is_one():
    frame = make_frame()
    gbuffer = replace(frame.gbuffer, albedo=torch.ones_like(frame.gbuffer.albedo))
    frame = replace(frame, gbuffer=gbuffer)
    torch.testing.assert_close(Atrous((2, 1), demodulate=True)(frame).image, Atrous((2, 1))(frame).image)


def test_emission_is_kept_out_of_the_filter_and_filled_by_triangle():
    frame = make_frame(1, 8, 16, emission=True, density=0.5)
    light = Atrous((2, 1), demodulate=True)(replace(frame, emission=torch.zeros_like(frame.emission))).image
    image = Atrous((2, 1), demodulate=True)(frame).image
    # Triangle 1 emits 5, sampled or not; its neighbours, however like it in geometry, emit nothing.
    want = 5.0 * (frame.gbuffer.prim == 1).expand_as(image)
    torch.testing.assert_close(image - light, want.to(image.dtype))
    assert bool(((frame.gbuffer.prim == 1) & (frame.mask == 0)).any())


def test_gradients_reach_guides_and_albedo():
    frame = make_frame(1, 4, 5)
    leaves = [getattr(frame.gbuffer, name).clone().requires_grad_() for name in ("normal", "position", "albedo")]
    gbuffer = replace(frame.gbuffer, normal=leaves[0], position=leaves[1], albedo=leaves[2])
    image = Atrous((2, 1), demodulate=True)(replace(frame, gbuffer=gbuffer)).image
    for gradient in torch.autograd.grad(image.square().sum(), leaves):
        assert bool(torch.isfinite(gradient).all())
        assert bool((gradient != 0).any())


def test_filter_takes_tensors_alone():
    frame = make_frame()
    radiance, normal, position, mask, layer = tensors_of(frame)
    denoiser = NonHomogeneousAtrous((1, 2), relative=False)
    want = denoiser.filter(radiance, normal, position, mask, layer)
    assert torch.equal(denoiser.filter(radiance, normal, position, mask.bool(), layer), want)
    everywhere = denoiser.filter(radiance, normal, position)
    assert torch.equal(denoiser.filter(radiance, normal, position, torch.ones_like(mask), layer * 0), everywhere)
