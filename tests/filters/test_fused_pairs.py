"""What pairs of pixels keep for each other is what each of them would have found itself, to the bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from fovden.filters import fused
from fovden.filters.fused import Inputs, blend_stack, return_gradients

STEPS = (16, 3, 1)


def inputs_of(
    height=70, width=85, *, unknown=False, layers=False, rings=False, kernels=None, fill=False, factors=False
):
    """Two views of random images, under a soft mask; with layers side by side, or rings one after the other."""
    generator = torch.Generator().manual_seed(3)

    def rand(channels):
        return torch.rand(2, channels, height, width, generator=generator)

    mask, known, region = rand(1), torch.ones(2, 1, height, width, dtype=torch.bool), None
    if unknown:
        known = (rand(1) > 0.05) | (torch.arange(height)[:, None] < height // 2)
    if layers:
        away = (torch.arange(height)[:, None] - height / 2).abs() + (torch.arange(width) - width / 2).abs()
        region = (away > 25).to(torch.uint8).expand(2, 1, height, width)
    steps = STEPS if not layers else tuple(step for step in STEPS for _ in range(2))
    labels = tuple(number % 2 for number in range(len(steps))) if layers else (0,) * len(steps)
    levels = tuple(number // 2 for number in range(len(steps))) if layers else tuple(range(len(steps)))
    if rings:
        away = ((torch.arange(height)[:, None] - height / 2) ** 2 + (torch.arange(width) - width / 2) ** 2).sqrt()
        region = (away > 20).to(torch.uint8) + (away > 60).to(torch.uint8).expand(2, 1, height, width)
        steps, labels = STEPS * 3, tuple(number // len(STEPS) for number in range(3 * len(STEPS)))
        levels = tuple(range(len(steps)))
    inverse = torch.full((len(steps), 3), 2.0)
    images = rand(3), rand(3), rand(3), mask, known, region
    return Inputs(*images, inverse, 0.5 + rand(3) if factors else None, kernels, steps, labels, levels, fill)


def outcome(inputs, everything=True):
    blended = blend_stack(inputs, save=True)
    seed = torch.linspace(-1, 1, blended.image.numel()).view_as(blended.image)
    gradients = return_gradients(inputs, blended, seed, everything=everything)
    return [blended.image, blended.known, *(each for each in gradients if each is not None)]


SETTINGS = {
    "whole": {},
    "unknown pixels": {"unknown": True},
    "layers": {"layers": True},
    "rings": {"width": 250, "rings": True},
    "filled": {"fill": True, "unknown": True},
    "widths of their own": {"factors": True, "layers": True},
    "narrow": {"width": 5},
    "flat": {"height": 3},
    "1024 wide": {"width": 1024, "height": 40},
}


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("everything", [False, True])
def test_nothing_depends_on_how_many_rows_a_thread_takes(setting, everything, monkeypatch):
    inputs, found = inputs_of(**SETTINGS[setting]), []
    for tile in (1, 2, 7, 1000):  # a row alone finds nothing kept by others
        monkeypatch.setattr(fused, "TILE", tile)
        monkeypatch.setattr(fused, "LEAST", min(tile, 3))
        found.append(outcome(inputs, everything))
    for other in found[1:]:
        assert all(torch.equal(one, same) for one, same in zip(found[0], other, strict=True))


@pytest.mark.parametrize("setting", SETTINGS)
def test_nothing_depends_on_what_memory_held(setting, monkeypatch):
    inputs = inputs_of(**SETTINGS[setting])
    before = outcome(inputs)

    def with_nan(kernel, count):
        return lambda *arguments: kernel(*arguments, np.full(count, np.nan, np.float32))

    monkeypatch.setattr(fused, "with_scratch", with_nan)
    monkeypatch.setattr(fused, "reused", lambda *shape: torch.full(shape, torch.nan))
    assert all(torch.equal(one, same) for one, same in zip(before, outcome(inputs), strict=True))


def test_a_kernel_that_is_not_symmetric_is_not_taken_from_the_other_side():
    lopsided = torch.ones(len(STEPS), 5, 5)
    lopsided[:, 0] = 4.0
    flat = inputs_of(kernels=lopsided)
    turned = torch.flip(blend_stack(flat).image, (2, 3))
    names = "radiance", "normal", "position", "mask", "known"
    planes = {name: torch.flip(getattr(flat, name), (2, 3)).contiguous() for name in names}
    other = replace(flat, **planes, kernels=torch.flip(lopsided, (1, 2)).contiguous())
    torch.testing.assert_close(blend_stack(other).image, turned, rtol=2e-6, atol=2e-6)
    assert not torch.allclose(blend_stack(replace(flat, **planes)).image, turned, atol=1e-3)


def test_steps_beyond_the_image_need_no_room():
    far, further = (replace(inputs_of(), steps=(step, step, step)) for step in (85, 10**9))
    assert all(torch.equal(one, same) for one, same in zip(outcome(far), outcome(further), strict=True))
    torch.testing.assert_close(blend_stack(further).image, further.radiance)
