"""Hole filling against a slow loop, its guarantees, and the nearest sampled pixel against brute force."""

import numpy as np
import pytest
import torch
from filter_frames import make_frame, tensors_of
from filter_twin import fill_twin, nearest_twin, numbers

from fovden.filters import fill_holes
from fovden.filters.nearest import nearest_sampled


@pytest.mark.parametrize(("density", "seed"), [(0.5, 0), (0.05, 1), (0.02, 2)])
@pytest.mark.parametrize("with_label", [False, True])
@pytest.mark.parametrize("soft", [False, True])
def test_filling_equals_the_slow_loop(density, seed, with_label, soft):
    frame = make_frame(2, 7, 12, density=density, seed=seed)
    image, normal, position, mask, _ = tensors_of(frame)
    if soft:
        mask = mask * torch.rand(mask.shape, generator=torch.Generator().manual_seed(3), dtype=mask.dtype)
    holes = mask == 0
    label = frame.gbuffer.prim if with_label else None
    sigma_normal = torch.full_like(mask, 0.3)
    sigma_normal[..., :6] = 0.05
    got = fill_holes(
        image, holes, mask, normal, position, sigma_normal=sigma_normal, sigma_position=0.2, label=label
    )  # fmt: skip
    want = fill_twin(
        numbers(image), holes.numpy(), numbers(mask), numbers(normal), numbers(position), numbers(sigma_normal),
        np.full(mask.shape, 0.2), None if label is None else label.numpy(),
    )  # fmt: skip
    np.testing.assert_allclose(got.numpy(), want, rtol=1e-10, atol=1e-12)


def test_one_sample_fills_its_view_and_no_other():
    image, mask = torch.zeros(2, 3, 23, 37), torch.zeros(2, 1, 23, 37)
    image[0, :, 20, 1], mask[0, :, 20, 1] = 3.0, 1.0
    flat = torch.zeros(2, 3, 23, 37)
    filled = fill_holes(image, mask == 0, mask, flat, flat, sigma_normal=1.0, sigma_position=1.0)
    torch.testing.assert_close(filled[0], torch.full_like(filled[0], 3.0))
    assert torch.equal(filled[1], torch.zeros_like(filled[1]))


def test_geometry_comes_before_distance():
    # The hole at 0 has an unlike neighbour at 1 and a like one at 4, which steps of 2 reach first.
    image = torch.tensor([0.0, 9.0, 9.0, 9.0, 5.0]).expand(1, 1, 1, 5)
    normal = torch.tensor([1.0, 0.0, 0.0, 0.0, 1.0]).expand(1, 3, 1, 5)
    mask = torch.tensor([0.0, 1.0, 1.0, 1.0, 1.0]).expand(1, 1, 1, 5)
    flat = torch.zeros(1, 3, 1, 5)
    filled = fill_holes(image, mask == 0, mask, normal, flat, sigma_normal=0.01, sigma_position=1.0)
    assert filled.flatten().tolist() == pytest.approx([5.0, 9.0, 9.0, 9.0, 5.0])


def test_inputs_stay_and_gradients_pass():
    frame = make_frame(1, 3, 4, density=0.4)
    image, normal, position, mask, _ = tensors_of(frame)
    soft = mask * 0.7
    copies = image.clone(), soft.clone()

    def run(image, soft, normal, position, sigma_normal, sigma_position):
        return fill_holes(
            image, mask == 0, soft, normal, position, sigma_normal=sigma_normal, sigma_position=sigma_position
        )

    sigmas = [torch.tensor(value, dtype=torch.float64) for value in (0.4, 0.3)]
    arguments = [t.clone().requires_grad_() for t in (image, soft, normal, position, *sigmas)]
    assert torch.autograd.gradcheck(run, arguments, fast_mode=True)
    run(image, soft, normal, position, *sigmas)
    assert torch.equal(image, copies[0])
    assert torch.equal(soft, copies[1])


@pytest.mark.parametrize("density", [0.5, 0.1, 0.02])
def test_nearest_sampled_equals_brute_force(density):
    mask = torch.rand(2, 1, 9, 13, generator=torch.Generator().manual_seed(7)) < density
    index = torch.arange(9 * 13, dtype=torch.float64).reshape(1, 1, 9, 13).expand(2, 1, 9, 13)
    want = nearest_twin(index.numpy(), mask.numpy())
    assert np.array_equal(nearest_sampled(mask).numpy(), want)


def test_nearest_sampled_of_nothing_is_the_pixel_itself():
    assert nearest_sampled(torch.zeros(1, 1, 2, 3)).flatten().tolist() == list(range(6))
