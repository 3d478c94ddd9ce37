"""One pass, against a slow loop, against kornia, and against what its formula implies."""

import kornia
import numpy as np
import pytest
import torch
from filter_twin import numbers, pass_twin

from fovden.checks import ShapeError
from fovden.filters import atrous_pass, taps
from fovden.filters.taps import B3_SPLINE, Sigmas, blend_taps

SIGMAS = {"sigma_radiance": 0.7, "sigma_normal": 0.4, "sigma_position": 0.9}


def inputs(views=2, height=5, width=7, seed=0, dtype=torch.float64):
    """Random radiance, normals, positions and a binary mask."""
    generator = torch.Generator().manual_seed(seed)

    def rand(channels):
        return torch.rand(views, channels, height, width, generator=generator, dtype=dtype)

    normal = torch.nn.functional.normalize(rand(3) - 0.5, dim=1)
    return rand(3), normal, rand(3), (rand(1) < 0.6).to(dtype)


def wide(step):
    """Widths so large that every edge-stopping function is 1."""
    return {"step": step, "sigma_radiance": 1e9, "sigma_normal": 1e9, "sigma_position": 1e9}


def twin(radiance, normal, position, mask=None, step=1, region=None, known=None, kernel=None, **sigmas):
    shape = radiance[:, :1].shape
    mask = torch.ones(shape) if mask is None else mask.expand(shape)
    region, known = (None if p is None else numbers(p.expand(shape)) for p in (region, known))
    image, _ = pass_twin(
        *map(numbers, (radiance, normal, position, mask)),
        step,
        [sigmas[f"sigma_{name}"] for name in Sigmas._fields],
        region=region,
        known=known,
        kernel=numbers(kernel),
    )
    return torch.from_numpy(image)


@pytest.mark.parametrize("step", [1, 2, 3, 16])
@pytest.mark.parametrize("size", [(5, 7), (1, 1), (1, 6), (9, 2), (3, 3)])
def test_a_pass_equals_the_slow_loop(step, size):
    radiance, normal, position, mask = inputs(2, *size)
    for planes in ({}, {"mask": mask}, {"mask": mask, "known": mask}):
        arguments = {**SIGMAS, **planes, "step": step}
        got = atrous_pass(radiance, normal, position, **arguments)
        torch.testing.assert_close(got, twin(radiance, normal, position, **arguments), rtol=1e-12, atol=1e-12)


def test_soft_masks_regions_and_known_equal_the_slow_loop():
    radiance, normal, position, mask = inputs(2, 8, 9)
    soft = torch.rand(2, 1, 8, 9, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    region = torch.zeros(1, 1, 8, 9, dtype=torch.bool)
    region[..., 2:5, 4:9] = True
    region[..., 3, 5] = False
    for step in (1, 2, 8):
        for flags in (region, region.double(), region.expand(2, -1, -1, -1)):
            arguments = {**SIGMAS, "mask": soft, "known": mask[:1], "region": flags, "step": step}
            got = atrous_pass(radiance, normal, position, **arguments)
            torch.testing.assert_close(got, twin(radiance, normal, position, **arguments), rtol=1e-12, atol=1e-12)
            outside = ~region.expand_as(radiance)
            assert torch.equal(got[outside], radiance[outside])
            assert not torch.equal(got[~outside], radiance[~outside])


def test_sigmas_may_be_tensors_read_at_the_pixel():
    radiance, normal, position, mask = inputs()
    generator = torch.Generator().manual_seed(2)
    planes = {name: 0.3 + torch.rand(2, 1, 5, 7, generator=generator, dtype=torch.float64) for name in SIGMAS}
    for shape in ((2, 1, 5, 7), (1, 1, 1, 1), (2, 1, 1, 7), (1, 1, 5, 7)):
        sigmas = {name: plane[tuple(map(slice, shape))] for name, plane in planes.items()}
        got = atrous_pass(radiance, normal, position, mask, step=2, known=mask, **sigmas)
        want = twin(radiance, normal, position, mask, step=2, known=mask, **sigmas)
        torch.testing.assert_close(got, want, rtol=1e-12, atol=1e-12)
    scalars = {name: torch.tensor(value, dtype=torch.float64) for name, value in SIGMAS.items()}
    got = atrous_pass(radiance, normal, position, **scalars)
    torch.testing.assert_close(got, atrous_pass(radiance, normal, position, **SIGMAS))


def test_sigma_planes_are_cropped_with_the_region():
    radiance, normal, position, _ = inputs(1, 6, 6)
    region = torch.zeros(1, 1, 6, 6, dtype=torch.bool)
    region[..., 4:, 3:] = True
    plane = torch.linspace(0.2, 2.0, 36, dtype=torch.float64).reshape(1, 1, 6, 6)
    arguments = {"region": region, "sigma_radiance": plane, "sigma_normal": 0.4, "sigma_position": plane + 1}
    got = atrous_pass(radiance, normal, position, **arguments)
    torch.testing.assert_close(got, twin(radiance, normal, position, **arguments), rtol=1e-12, atol=1e-12)


def test_kernels_of_both_shapes_equal_the_slow_loop():
    radiance, normal, position, mask = inputs()
    line = torch.tensor([0.1, 0.5, 1.0, 0.3, 0.2], dtype=torch.float64)
    square = torch.rand(5, 5, generator=torch.Generator().manual_seed(3), dtype=torch.float64) + 0.1
    for kernel, full in ((line, line[:, None] * line), (square, square)):
        got = atrous_pass(radiance, normal, position, mask, kernel=kernel, **SIGMAS)
        want = twin(radiance, normal, position, mask, kernel=full, **SIGMAS)
        torch.testing.assert_close(got, want, rtol=1e-12, atol=1e-12)
    spline = torch.tensor(B3_SPLINE, dtype=torch.float64)
    got = atrous_pass(radiance, normal, position, kernel=spline, **SIGMAS)
    torch.testing.assert_close(got, atrous_pass(radiance, normal, position, **SIGMAS))


def test_the_internal_guide_centre_and_border_equal_the_slow_loop():
    radiance, normal, position, mask = inputs(1, 4, 6)
    guide, centre, _, _ = inputs(1, 4, 6, seed=5)
    for step in (1, 2, 4):
        blend = blend_taps(
            radiance, normal, position, mask=mask, step=step, sigmas=Sigmas(0.7, 0.4, 0.9), guide=guide, centre=centre,
            border="clamp",
        )  # fmt: skip
        arrays = map(numbers, (radiance, normal, position, mask))
        image, total = pass_twin(
            *arrays, step, (0.7, 0.4, 0.9), guide=numbers(guide), centre=numbers(centre), clamp=True
        )
        np.testing.assert_allclose(blend.image.numpy(), image, rtol=1e-12)
        assert np.array_equal(blend.filled.numpy(), total > 1e-20)


def test_an_undilated_pass_equals_kornia():
    # kornia weighs exp(-|d|^2 / (2 sigma_color^2)) of one guide, so the three guides are stacked in units of their
    # widths and sigma_color^2 = 1/2; its spatial Gaussian is handed over as our kernel. Its border reflects: compare
    # the interior.
    radiance, normal, position, _ = inputs(2, 9, 10)
    guide = torch.cat([radiance / 0.7, normal / 0.4, position / 0.9], dim=1)
    want = kornia.filters.joint_bilateral_blur(
        radiance, guide, 5, 0.5**0.5, (1.3, 1.3), color_distance_type="l2", border_type="reflect"
    )
    gaussian = torch.exp(-(torch.arange(-2, 3, dtype=torch.float64) ** 2) / (2 * 1.3**2))
    got = atrous_pass(radiance, normal, position, kernel=gaussian, **SIGMAS)
    torch.testing.assert_close(got[..., 2:-2, 2:-2], want[..., 2:-2, 2:-2], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("step", [1, 3])
def test_wide_sigmas_are_the_dilated_convolution(step):
    radiance, normal, position, _ = inputs(2, 16, 17)
    kernel = torch.tensor(B3_SPLINE, dtype=torch.float64)
    kernel = (kernel[:, None] * kernel).expand(3, 1, 5, 5)
    want = torch.nn.functional.conv2d(radiance, kernel, dilation=step, groups=3)
    got = atrous_pass(radiance, normal, position, **wide(step))
    margin = 2 * step
    torch.testing.assert_close(got[..., margin:-margin, margin:-margin], want, rtol=1e-12, atol=1e-12)


def test_narrow_sigmas_are_the_identity():
    radiance, normal, position, _ = inputs()
    torch.testing.assert_close(atrous_pass(radiance, normal, position, sigma_radiance=1e-6), radiance)


def test_scaling_position_with_its_width_changes_nothing():
    radiance, normal, position, mask = inputs()
    doubled = {**SIGMAS, "sigma_position": 2 * SIGMAS["sigma_position"]}
    # Doubling is exact in binary.
    want = atrous_pass(radiance, normal, position, mask, **SIGMAS)
    assert torch.equal(atrous_pass(radiance, normal, 2 * position, mask, **doubled), want)


def test_an_all_ones_mask_is_no_mask_and_bools_are_cast():
    radiance, normal, position, mask = inputs()
    ones = torch.ones_like(mask)
    want = atrous_pass(radiance, normal, position, **SIGMAS)
    assert torch.equal(atrous_pass(radiance, normal, position, ones, known=ones, **SIGMAS), want)
    want = atrous_pass(radiance, normal, position, mask, **SIGMAS)
    assert torch.equal(atrous_pass(radiance, normal, position, mask.bool(), **SIGMAS), want)


def test_masked_taps_are_not_read_and_do_not_darken():
    radiance, normal, position, mask = inputs()
    light = torch.full_like(radiance, 0.7) * mask
    image = atrous_pass(light, normal, position, mask, known=mask, sigma_radiance=0.5, sigma_normal=9, sigma_position=9)
    torch.testing.assert_close(image, torch.full_like(image, 0.7))
    poisoned = torch.where(mask > 0, radiance, 1e6)
    clean = torch.where(mask > 0, radiance, 0)
    torch.testing.assert_close(
        atrous_pass(poisoned, normal, position, mask, known=mask, **SIGMAS),
        atrous_pass(clean, normal, position, mask, known=mask, **SIGMAS),
    )


def test_views_do_not_mix_and_inputs_stay():
    tensors = inputs()
    copies = [t.clone() for t in tensors]
    both = atrous_pass(*tensors, **SIGMAS)
    for view in range(2):
        assert torch.equal(both[view : view + 1], atrous_pass(*(t[view : view + 1] for t in tensors), **SIGMAS))
    swapped = atrous_pass(*(t.flip(0) for t in tensors), **SIGMAS)
    assert torch.equal(swapped, both.flip(0))
    assert all(torch.equal(a, b) for a, b in zip(tensors, copies, strict=True))


def test_no_tap_leaves_the_input_in_new_memory():
    radiance, normal, position, mask = inputs()
    for arguments in ({"mask": torch.zeros_like(mask)}, {"region": torch.zeros_like(mask)}):
        image = atrous_pass(radiance, normal, position, **arguments)
        assert torch.equal(image, radiance)
        assert image.data_ptr() != radiance.data_ptr()


def test_the_region_is_all_that_is_visited(monkeypatch):
    # Values far outside the region's halo may be anything, since they are never read.
    radiance, normal, position, _ = inputs(1, 20, 20)
    region = torch.zeros(1, 1, 20, 20, dtype=torch.bool)
    region[..., 3:6, 4:7] = True
    want = atrous_pass(radiance, normal, position, region=region)
    sizes = []
    original = taps._strips
    monkeypatch.setattr(taps, "_strips", lambda *size: sizes.append(size) or original(*size))
    broken = radiance.clone()
    broken[..., 8:, :] = torch.nan
    got = atrous_pass(broken, normal, position, region=region)
    assert torch.equal(got[..., :8, :], want[..., :8, :])
    assert sizes == [(3, 3)]  # rows, and pixels in each


def test_strips_of_any_height_give_the_same(monkeypatch):
    radiance, normal, position, mask = inputs(2, 11, 7)
    plane = torch.rand(2, 1, 11, 7, generator=torch.Generator().manual_seed(4), dtype=torch.float64) + 0.2
    arguments = {"mask": mask, "known": mask, "step": 2, "sigma_radiance": plane}
    want = atrous_pass(radiance, normal, position, **arguments)
    for pixels in (1, 28, 70):
        monkeypatch.setattr(taps, "STRIP_PIXELS", pixels)
        assert torch.equal(atrous_pass(radiance, normal, position, **arguments), want)


def test_gradients_of_first_and_second_order():
    radiance, normal, position, _ = inputs(1, 2, 3)
    soft = torch.rand(1, 1, 2, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 0.9 + 0.05
    known = torch.ones(1, 1, 2, 3)
    known[..., 1, 2] = 0
    region = torch.ones(1, 1, 2, 3, dtype=torch.bool)
    region[..., 0, :2] = False
    kernel = torch.tensor(B3_SPLINE, dtype=torch.float64)
    sigma = torch.tensor(0.7, dtype=torch.float64)
    plane = torch.full((1, 1, 2, 3), 0.9, dtype=torch.float64)

    def run(radiance, normal, position, mask, sigma_radiance, sigma_normal, sigma_position, kernel):
        return atrous_pass(
            radiance, normal, position, mask, 1, sigma_radiance, sigma_normal, sigma_position, region, known, kernel
        )

    arguments = [radiance, normal, position, soft, sigma, sigma / 2, plane, kernel]
    arguments = [a.clone().requires_grad_() for a in arguments]
    assert torch.autograd.gradcheck(run, arguments)
    assert torch.autograd.gradgradcheck(run, arguments, fast_mode=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_where_every_weight_underflows(dtype):
    radiance, normal, position, mask = inputs(1, 5, 5, dtype=dtype)
    arguments = [radiance, normal, position * 1e4, mask, torch.tensor(0.1, dtype=dtype)]
    arguments = [a.requires_grad_() for a in arguments]
    radiance, normal, position, mask, sigma = arguments
    image = atrous_pass(
        radiance, normal, position, mask * 0, sigma_radiance=sigma, sigma_normal=sigma, sigma_position=sigma
    )
    assert torch.equal(image, radiance)
    partly = atrous_pass(
        radiance, normal, position, mask, sigma_radiance=sigma, sigma_normal=sigma, sigma_position=sigma, known=mask
    )
    assert torch.equal(partly[(mask == 0).expand_as(partly)], radiance[(mask == 0).expand_as(partly)])
    gradients = torch.autograd.grad((image + partly).square().sum(), arguments, create_graph=True)
    assert all(bool(torch.isfinite(g).all()) for g in gradients)
    again = torch.autograd.grad(sum(g.square().sum() for g in gradients), arguments)
    assert all(bool(torch.isfinite(g).all()) for g in again)


def test_the_image_has_the_type_of_the_radiance():
    radiance, normal, position, mask = inputs(1)
    plane = torch.full_like(mask, 0.5)
    image = atrous_pass(radiance.float(), normal, position, mask, 1, plane, plane, plane, kernel=torch.ones(5).double())
    assert image.dtype == torch.float32


def test_it_compiles_without_a_graph_break():
    # The eager backend captures the whole graph without generating code: the test is of the capture.
    radiance, normal, position, mask = inputs(1, 6, 6)
    sigma = torch.tensor(0.5, dtype=torch.float64)
    compiled = torch.compile(atrous_pass, backend="eager", fullgraph=True)
    region = torch.zeros(1, 1, 6, 6, dtype=torch.bool)
    region[..., :3] = True
    arguments = (radiance, normal, position, mask, 2, sigma, sigma, sigma, region, mask)
    torch.testing.assert_close(compiled(*arguments), atrous_pass(*arguments))


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"normal": torch.zeros(2, 3, 5, 6)}, ShapeError, "normal"),
        ({"mask": torch.zeros(2, 3, 5, 7)}, ShapeError, "mask"),
        ({"mask": torch.zeros(3, 1, 5, 7)}, ShapeError, "mask"),
        ({"region": torch.zeros(5, 7)}, ShapeError, "region"),
        ({"sigma_radiance": 0.0}, ValueError, "sigma_radiance"),
        ({"sigma_position": float("nan")}, ValueError, "sigma_position"),
        ({"sigma_normal": torch.ones(3)}, ShapeError, "sigma_normal"),
        ({"step": 0}, ValueError, "step"),
        ({"step": 1.5}, TypeError, "step"),
        ({"kernel": torch.ones(3)}, ShapeError, "kernel"),
        ({"radiance": torch.zeros(2, 3, 5, 7, dtype=torch.float16)}, TypeError, "radiance"),
        ({"mask": 1.0}, TypeError, "mask"),
    ],
)
def test_bad_input_is_named(change, error, words):
    radiance, normal, position, mask = inputs(dtype=torch.float32)
    arguments = {"radiance": radiance, "normal": normal, "position": position, "mask": mask, **change}
    with pytest.raises(error, match=words):
        atrous_pass(**arguments)
