"""The plain filter: its passes, in both orders."""

import pytest
import torch
from filter_frames import make_frame, tensors_of

from fovden.filters import Atrous, atrous_pass

WIDE = {"sigma_radiance": 1e9, "sigma_normal": 1e9, "sigma_position": 1e9}


def test_it_is_its_passes():
    radiance, normal, position, mask, _ = tensors_of(make_frame())
    denoiser = Atrous((2, 1), sigma_radiance=0.8, sigma_normal=0.5, sigma_position=0.9)
    image = atrous_pass(radiance, normal, position, mask, 2, 0.8, 0.5, 0.9, known=mask)
    # Every pixel has a sampled tap like it at these widths, so that all are known in the second pass.
    image = atrous_pass(image, normal, position, mask, 1, 0.4, 0.5, 0.9)
    torch.testing.assert_close(denoiser.filter(radiance, normal, position, mask), image)


@pytest.mark.parametrize("levels", [2, 3])
def test_both_orders_are_the_same_where_nothing_stops_at_edges(levels):
    # With wide widths each pass is a convolution, and convolutions commute; borders, where taps are left out, do not.
    steps = tuple(2**k for k in range(levels))
    radiance, normal, position, _, _ = tensors_of(make_frame(1, 40, 41, density=1, misses=False))
    up = Atrous(steps, **WIDE).filter(radiance, normal, position)
    down = Atrous(steps[::-1], **WIDE).filter(radiance, normal, position)
    reach = 2 * (2**levels - 1)
    inner = (..., slice(reach, -reach), slice(reach, -reach))
    torch.testing.assert_close(up[inner], down[inner], rtol=1e-12, atol=1e-12)
    assert not torch.allclose(up, down, rtol=1e-6)


def test_reach_of_the_passes():
    radiance = torch.zeros(1, 3, 31, 31)
    radiance[..., 15, 15] = 1
    image = Atrous((4, 2, 1), **WIDE).filter(radiance, radiance * 0, radiance * 0)
    seen = image[0, 0].nonzero()
    assert seen.min().item() == 15 - 14
    assert seen.max().item() == 15 + 14


def test_decreasing_steps_leave_no_lattice():
    # An impulse through wide steps last leaves a comb; through a dense last window it does not. The comb is seen as
    # the differences of neighbours, relative to the image's own height.
    radiance = torch.zeros(1, 3, 37, 37)
    radiance[..., 18, 18] = 1
    guide = torch.zeros_like(radiance)
    guide[..., 6:31:3, 6:31:5] = 0.7  # edges, so that passes do not commute
    roughness = []
    for steps in ((1, 2, 4, 8), (8, 4, 2, 1)):
        denoiser = Atrous(steps, sigma_radiance=1e9, sigma_normal=0.3, sigma_position=1e9)
        row = denoiser.filter(radiance, guide, guide * 0)[0, 0, 19]
        roughness.append(float((row.diff().abs().sum() / row.max()).detach()))
    assert roughness[1] < roughness[0]


def test_layers_are_not_used():
    frame = make_frame()
    tensors = tensors_of(frame)
    assert torch.equal(Atrous((2, 1)).filter(*tensors), Atrous((2, 1)).filter(*tensors[:4]))


def test_clamped_borders_differ_at_the_border_alone():
    tensors = tensors_of(make_frame(1, 20, 20))
    skip = Atrous((2, 1)).filter(*tensors)
    clamp = Atrous((2, 1), border="clamp").filter(*tensors)
    inner = (..., slice(6, -6), slice(6, -6))
    torch.testing.assert_close(skip[inner], clamp[inner])
    assert not torch.allclose(skip, clamp)


@pytest.mark.parametrize(
    ("arguments", "error", "name"),
    [
        ({"steps": ()}, ValueError, "steps"),
        ({"steps": (0, 1)}, ValueError, "steps"),
        ({"steps": (1.0,)}, TypeError, "steps"),
        ({"border": "mirror"}, ValueError, "border"),
        ({"schedule": "none"}, ValueError, "schedule"),
    ],
)
def test_bad_options_are_named(arguments, error, name):
    with pytest.raises(error, match=name):
        Atrous(**arguments)
