"""The non-homogeneous denoiser against its reference procedure, written as loops; each open question's option."""

import warnings
from dataclasses import replace

import pytest
import torch
from filter_frames import make_frame, tensors_of
from filter_twin import nonhomogeneous_twin, numbers

from fovden.filters import Atrous, NonHomogeneousAtrous

SIGMAS = {"sigma_radiance": (0.9, 1.1, 1.4), "sigma_normal": (0.4, 0.3, 0.2), "sigma_position": (0.5, 0.4, 0.3)}

OPTIONS = [
    {},
    {"mask_at": "center"},
    {"guide": "input"},
    {"unsampled_guide": "literal"},
    {"unsampled_guide": "nearest"},
    {"mask_update": "fill"},
    {"fill_holes": False},
    {"layers": "snapshot"},
    {"layers": "interleaved"},
    {"border": "clamp"},
    {"schedule": "halve_phi"},
    {"schedule": "constant"},
    {"sigma_by": "scale"},
]
COMBINED = [
    {"guide": "input", "mask_update": "fill", "layers": "snapshot"},
    {"guide": "input", "unsampled_guide": "nearest", "layers": "interleaved"},
    {"unsampled_guide": "nearest", "mask_update": "fill", "border": "clamp"},
    {"mask_at": "center", "layers": "interleaved", "mask_update": "fill"},
]


def build(levels=(1, 2, 3), **options):
    widths = {name: values[: len(levels)] for name, values in SIGMAS.items()}
    return NonHomogeneousAtrous(levels, **{**widths, **options})


def name_of(options):
    return "-".join(f"{key}={value}" for key, value in options.items()) or "default"


def twin(tensors, levels, **options):
    widths = list(zip(*SIGMAS.values(), strict=True))[: len(levels)]
    radiance, normal, position, mask = (numbers(t) for t in tensors[:4])
    return torch.from_numpy(
        nonhomogeneous_twin(radiance, normal, position, mask, tensors[4].numpy(), levels, widths, **options)
    )


@pytest.mark.parametrize("options", OPTIONS + COMBINED, ids=name_of)
def test_every_reading_equals_the_reference_procedure(options):
    # Sparse samples and narrow widths in places, so that weights underflow and holes remain.
    tensors = tensors_of(make_frame(1, 9, 11, density=0.4, seed=3))
    got = build(**options).double().filter(*tensors)
    # Widths pass through a float32 logarithm: relative errors of 1e-7.
    torch.testing.assert_close(got, twin(tensors, (1, 2, 3), **options), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("options", OPTIONS[1:], ids=name_of)
def test_every_option_changes_something(options):
    tensors = tensors_of(make_frame(1, 9, 11, density=0.4, seed=3))
    radiance, normal, position, mask, layer = tensors
    if "fill_holes" in options:  # every reached pixel is known: leave some out of reach
        mask = mask.clone()
        mask[..., 5:] = 0
        radiance = radiance * mask
    default = build().filter(radiance, normal, position, mask, layer)
    changed = build(**options).filter(radiance, normal, position, mask, layer)
    assert not torch.allclose(default, changed, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1), (2, 3)])
def test_tiny_frames_equal_the_reference_procedure(size):
    tensors = tensors_of(make_frame(2, *size, density=0.5, seed=1, misses=False))
    got = build((1, 3, 4)).double().filter(*tensors)
    torch.testing.assert_close(got, twin(tensors, (1, 3, 4)), rtol=1e-5, atol=1e-6)


def test_soft_masks_equal_the_reference_procedure():
    radiance, normal, position, mask, layer = tensors_of(make_frame(1, 7, 8))
    soft = mask * torch.rand(mask.shape, generator=torch.Generator().manual_seed(0), dtype=mask.dtype)
    tensors = (radiance, normal, position, soft, layer)
    for options in ({}, {"mask_at": "center"}, {"mask_update": "fill"}):
        got = build((1, 2), **options).filter(*tensors)
        torch.testing.assert_close(got, twin(tensors, (1, 2), **options), rtol=1e-5, atol=1e-6)


def test_layers_beyond_the_levels_belong_to_the_last():
    radiance, normal, position, mask, layer = tensors_of(make_frame())
    assert int(layer.max()) == 2
    tensors = radiance, normal, position, mask
    two, one = build((1, 2)), build((2,))
    assert torch.equal(two.filter(*tensors, layer), two.filter(*tensors, layer.clamp(max=1)))
    assert torch.equal(one.filter(*tensors, layer), one.filter(*tensors))


def test_base_is_the_plain_filter_with_decreasing_steps():
    tensors = tensors_of(make_frame())
    base, plain = NonHomogeneousAtrous.base(3), Atrous((4, 2, 1))
    torch.testing.assert_close(base.filter(*tensors), plain.filter(*tensors), rtol=0, atol=0)


def test_named_constructors():
    assert NonHomogeneousAtrous.base().levels == (5,)
    assert NonHomogeneousAtrous.nh2ld().levels == (3, 5)
    assert NonHomogeneousAtrous.nh3ld().levels == NonHomogeneousAtrous().levels == (3, 4, 5)
    assert NonHomogeneousAtrous.nh2ld((1, 2), demodulate=True, layers="snapshot").demodulate


def test_readings_that_cannot_matter_do_not():
    # With every pixel sampled: which pixel's mask, its update, the unsampled guide and hole filling are moot.
    tensors = tensors_of(make_frame(density=1.0))
    want = build().filter(*tensors)
    for options in OPTIONS[1:]:
        if next(iter(options)) in ("mask_at", "unsampled_guide", "mask_update", "fill_holes"):
            torch.testing.assert_close(build(**options).filter(*tensors), want)
    # With one pass there is one image to compare and one width.
    tensors = tensors_of(make_frame())
    want = build((1,)).filter(*tensors)
    for options in ({"guide": "input"}, {"schedule": "constant"}, {"sigma_by": "scale"}, {"layers": "snapshot"}):
        torch.testing.assert_close(build((1,), **options).filter(*tensors), want)
    # With one layer there is none to read from.
    want = build((3,)).filter(*tensors)
    for layers in ("snapshot", "interleaved"):
        assert torch.equal(build((3,), layers=layers).filter(*tensors), want)


def test_center_masks_leave_unsampled_pixels_black():
    radiance, normal, position, mask, layer = tensors_of(make_frame())
    image = build(mask_at="center").filter(radiance, normal, position, mask, layer)
    unsampled = (mask == 0).expand_as(image)
    assert torch.equal(image[unsampled], torch.zeros_like(image[unsampled]))
    assert (image[~unsampled] > 0).all()


def test_a_literal_guide_darkens_unsampled_pixels():
    # Their 0 is nearer to dark taps; dropping the term is fair to all.
    radiance, normal, position, mask, layer = tensors_of(make_frame(2, 20, 20))
    unsampled = (mask == 0).expand_as(radiance)
    fair = build(guide="current").filter(radiance, normal, position, mask, layer)[unsampled].mean()
    literal = build(unsampled_guide="literal").filter(radiance, normal, position, mask, layer)[unsampled].mean()
    assert literal < 0.95 * fair


def test_holes_stay_black_when_they_are_not_filled():
    radiance, normal, position, mask, layer = tensors_of(make_frame(1, 9, 40))
    mask = mask * (torch.arange(40) < 5)
    image = build(fill_holes=False).filter(radiance * mask, normal, position, mask, layer)
    assert torch.equal(image[..., 25:], torch.zeros_like(image[..., 25:]))
    assert (build().filter(radiance * mask, normal, position, mask, layer) > 0).all()


def test_snapshot_reads_no_other_layers_result():
    # Changing the inner layer's width cannot reach the others; in sequence it does.
    tensors = tensors_of(make_frame(1, 12, 12))
    outside = (tensors[4] > 0).expand_as(tensors[0])
    for layers, same in (("snapshot", True), ("sequential", False)):
        images = [
            NonHomogeneousAtrous(
                (1, 2, 3), sigma_radiance=(width, 1.0, 1.0), sigma_normal=1.0, sigma_position=1.0, layers=layers
            ).filter(*tensors)[outside]
            for width in (0.1, 2.0)
        ]
        assert torch.equal(*images) == same


def test_a_seam_joins_the_eyes_at_their_border_alone():
    frame = make_frame(2, 8, 40, misses=False)
    wide = {"sigma_normal": 9.0, "sigma_position": 9.0}
    apart = NonHomogeneousAtrous((1, 2), **wide)(frame).image
    joined = NonHomogeneousAtrous((1, 2), seam=True, **wide)(frame).image
    reach = 2 + 4
    # The left eye ends where the right one begins.
    torch.testing.assert_close(joined[0, ..., :-reach], apart[0, ..., :-reach])
    torch.testing.assert_close(joined[1, ..., reach:], apart[1, ..., reach:])
    assert not torch.allclose(joined[0, ..., -2:], apart[0, ..., -2:], rtol=1e-3)
    assert not torch.allclose(joined[1, ..., :2], apart[1, ..., :2], rtol=1e-3)
    with pytest.raises(ValueError, match="even number of views"):
        NonHomogeneousAtrous((1, 2), seam=True)(make_frame(3))


def test_a_seam_is_one_image_side_by_side():
    radiance, normal, position, mask, layer = tensors_of(make_frame(2, 6, 7, misses=False))
    position = position / 5  # both eyes near each other
    denoiser = NonHomogeneousAtrous((2, 3), seam=True, relative=False, sigma_normal=1.0, sigma_position=1.0)

    def side_by_side(tensor):
        return torch.cat([tensor[:1], tensor[1:]], dim=-1)

    frame = make_frame(2, 6, 7, misses=False)
    frame = replace(frame, gbuffer=replace(frame.gbuffer, position=position))
    want = denoiser.filter(*map(side_by_side, (radiance, normal, position, mask, layer)))
    got = denoiser(frame).image
    torch.testing.assert_close(side_by_side(got), want)
    apart = NonHomogeneousAtrous((2, 3), relative=False, sigma_normal=1.0, sigma_position=1.0)(frame).image
    assert not torch.allclose(got, apart, rtol=1e-3)


def test_order_of_levels_warns():
    with pytest.warns(UserWarning, match=r"\(3, 3, 5\)"):
        NonHomogeneousAtrous((3, 3, 5))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        NonHomogeneousAtrous((1, 2, 3, 4, 5, 6))


def test_print_shows_readings_and_widths():
    text = repr(NonHomogeneousAtrous((1, 2), layers="snapshot", sigma_radiance=(0.5, 0.25)))
    assert "levels=(1, 2), layers='snapshot'" in text
    assert "sigma_radiance=0.5," in text
    assert "sigma_radiance=0.25," in text


@pytest.mark.parametrize(
    ("arguments", "error", "name"),
    [
        ({"levels": ()}, ValueError, "levels"),
        ({"levels": (0, 1)}, ValueError, "levels"),
        ({"sigma_normal": (0.1, 0.2)}, ValueError, "sigma_normal"),
        ({"mask_at": "centre"}, ValueError, "mask_at"),
        ({"guide": "raw"}, ValueError, "guide"),
        ({"unsampled_guide": "zero"}, ValueError, "unsampled_guide"),
        ({"mask_update": "dynamic"}, ValueError, "mask_update"),
        ({"layers": "parallel"}, ValueError, "layers"),
        ({"border": "wrap"}, ValueError, "border"),
    ],
)
def test_bad_options_are_named(arguments, error, name):
    with pytest.raises(error, match=name):
        NonHomogeneousAtrous(**arguments)


def test_bad_layers_are_named():
    radiance, normal, position, mask, layer = tensors_of(make_frame())
    with pytest.raises(ValueError, match="layer"):
        build().filter(radiance, normal, position, mask, layer - 1)
    with pytest.raises(ValueError, match="layer"):
        build().filter(radiance, normal, position, mask, layer[..., 1:])
