"""The blue-noise tile: a permutation whose thresholds have little energy at low frequencies, also across its edges."""

import pytest
import torch

from fovden.foveation.blue_noise import TILE, blue_noise_tile


def test_tile_is_a_permutation():
    assert torch.equal(blue_noise_tile().flatten().sort().values, torch.arange(TILE * TILE))


@pytest.mark.parametrize("share", [0.05, 0.25, 0.5, 0.75, 0.95])
def test_thresholds_are_blue(share):
    selected = (blue_noise_tile() < share * TILE**2).double()
    # The discrete Fourier transform treats the tile as periodic, as its users repeat it.
    power = torch.fft.fft2(selected - share).abs().square() / (TILE**2 * share * (1 - share))  # white noise: 1
    frequency = torch.fft.fftfreq(TILE)
    radius = torch.hypot(frequency[:, None], frequency[None])
    # Even points at a density s keep their energy near frequencies of sqrt(s), s being that of the rarer kind.
    rarer = min(share, 1 - share)
    low = power[radius < 0.4 * rarer**0.5].mean()
    high = power[radius > rarer**0.5].mean() if rarer < 0.25 else power[radius > 0.5].mean()
    assert low < 0.15
    assert high > 1
