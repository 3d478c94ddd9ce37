"""The kernels on polar rasters against gathers through neighbours in double precision."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from polar_twin import SPLINE, Raster, cells_of, polar_twin, rasters

from fovden.checks import ShapeError
from fovden.filters.fused import Inputs
from fovden.filters.fused_polar import blend_polar_stack, return_polar_gradients

IMAGES = ("radiance", "normal", "position", "mask", "factors")
NAMES = ("radiance", "normal", "position", "mask", "inverse", "factors", "kernels")
BORDERS = "clamp", "rotate"
THREE = [(4, 0, 0), (2, 0, 1), (1, 0, 2)]
NESTED = [(2, 0, 0), (1, 0, 1), (4, 1, 2), (1, 1, 3), (8, 2, 4), (1, 2, 5)]
INTERLEAVED = [(4, 2, 0), (2, 1, 1), (2, 2, 1), (1, 0, 2), (1, 1, 2), (1, 2, 2)]

CASES = {
    "full": (THREE, {}),
    "all known": (THREE, {"mask": "soft", "known": "all"}),
    "holes": (THREE, {"mask": "hard"}),
    "sparse": (THREE, {"mask": "sparse"}),
    "fill": (THREE, {"mask": "soft", "fill": True}),
    "factors": (THREE, {"mask": "soft", "factors": True}),
    "kernels": (THREE, {"mask": "soft", "kernels": True}),
    "bands": (NESTED, {"mask": "hard", "region": "bands"}),
    "patches, all": (NESTED, {"mask": "soft", "region": "patches", "factors": True, "kernels": True, "fill": True}),
    "interleaved": (INTERLEAVED, {"mask": "soft", "region": "bands"}),
    "interleaved, fill": (INTERLEAVED, {"mask": "soft", "region": "patches", "fill": True}),
}


@pytest.fixture(autouse=True)
def one_thread(threads):
    """The twin's images are too small for more."""
    threads(1)


def tensors(raster, views=2, *, mask="full", factors=False, kernels=False, passes=1, seed=0):
    """Random images in double precision; what is no cell is not a number, for nobody may read it."""
    generator = torch.Generator().manual_seed(seed)
    shape = raster.resolution

    def rand(*sizes):
        return torch.rand(*sizes, generator=generator).double()

    masks = {
        "full": torch.ones(views, 1, *shape).double(),
        "hard": (rand(views, 1, *shape) < 0.5).double(),
        "soft": rand(views, 1, *shape) * (rand(views, 1, *shape) < 0.8),
        "sparse": (rand(views, 1, *shape) < 0.01).double(),
    }
    made = {
        "radiance": rand(views, 3, *shape) * 3,
        "normal": torch.nn.functional.normalize(rand(views, 3, *shape) - 0.5, dim=1),
        "position": rand(views, 3, *shape),
        "mask": masks[mask],
        "inverse": (rand(passes, 3) + 0.5) ** -2,
    }
    if factors:
        made["factors"] = rand(views, 3, *shape) + 0.5
    if kernels:
        made["kernels"] = SPLINE * (rand(passes, 5, 5) + 0.5)
    nothing = torch.arange(shape[0])[:, None] >= raster.heights
    for name, tensor in made.items():
        if tensor.dim() == 4:
            made[name] = tensor.float().masked_fill(nothing, torch.nan).double()  # the twin's numbers are the same
        else:
            made[name] = tensor.float().double()
    return {name: tensor.requires_grad_() for name, tensor in made.items()}


def labels_of(raster, kind, views=2):
    """Three labels: in bands of distance, or in patches."""
    height, width = raster.resolution
    x, y = torch.arange(width).expand(height, width), torch.arange(height)[:, None].expand(height, width)
    found = {"bands": x * 3 // width, "patches": (x // 5 + y // 7) % 3}[kind]
    return found.to(torch.uint8).expand(views, 1, height, width)


def inputs_of(made, plan, known, region, fill):
    single = {name: made[name].detach().float() if name in made else None for name in NAMES}
    images = [single[name] for name in ("radiance", "normal", "position", "mask")]
    last = [single[name] for name in ("inverse", "factors", "kernels")]
    return Inputs(*images, known, region, *last, *zip(*plan, strict=True), fill)


def error(got, want):
    return float((got.double() - want).abs().max() / want.abs().max().clamp(min=1e-30))


def compare(raster, plan, *, mask="full", region=None, fill=False, factors=False, kernels=False, known="sampled"):
    """Errors of the image and of each gradient, that of the light kernels included."""
    made = tensors(raster, mask=mask, factors=factors, kernels=kernels, passes=len(plan))
    labels = None if region is None else labels_of(raster, region)
    has_value = torch.ones_like(made["mask"], dtype=torch.bool) if known == "all" else made["mask"].detach() > 0
    image, filled, has = polar_twin(raster, made, plan, known=has_value, region=labels, fill=fill)
    inputs, rotate = inputs_of(made, plan, has_value, labels, fill), raster.fovea_border == "rotate"
    blended = blend_polar_stack(inputs, raster.heights, rotate, save=True)
    assert torch.equal(blended.known, has)
    found = {"image": error(blended.image, image.detach())}
    generator = torch.Generator().manual_seed(9)
    seeds = [torch.randn(each.shape, generator=generator) for each in (image, filled)[: 1 + fill]]
    if fill:
        assert torch.equal(blended.mask.double(), filled.detach())
    wanted = torch.autograd.grad(
        [image, filled][: 1 + fill], list(made.values()), [seed.double() for seed in seeds], allow_unused=True
    )
    for everything in (True, False):
        got = return_polar_gradients(inputs, raster.heights, rotate, blended, *seeds, everything=everything)
        for name, want in zip(made, wanted, strict=True):
            if want is not None and getattr(got, name) is not None:
                assert float(want.abs().max()) > 1e-6
                found[name] = max(found.get(name, 0.0), error(getattr(got, name), want))
    return found


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("name", ["smooth", "stair", "log"])
@pytest.mark.parametrize("case", CASES)
def test_it_agrees_with_gathers_in_double_precision(case, name, border):
    plan, options = CASES[case]
    found = compare(rasters(border)[name], plan, **options)
    assert found["image"] < 2e-6 * len(plan)
    for leaf, bound in [*((name, 1e-5) for name in IMAGES), ("inverse", 1e-4), ("kernels", 1e-4)]:
        assert found.get(leaf, 0.0) < bound, leaf
    assert {"radiance", "normal", "position", "mask", "inverse"} <= found.keys() | (
        {"mask"} if "fill" in case else set()
    )


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("name", ["uncut", "ones", "wild", "row", "column"])
@pytest.mark.parametrize("case", ["full", "patches, all", "interleaved"])
def test_it_agrees_on_rasters_of_every_shape(case, name, border):
    plan, options = CASES[case]
    found = compare(rasters(border)[name], plan, **options)
    assert found.pop("image") < 2e-6 * len(plan)
    assert all(value < 1e-4 for value in found.values()), found  # fewer cells: less is summed than cancels


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("name", ["wild", "uncut", "smooth"])
def test_taps_may_go_around_several_times_and_beyond_all_columns(name, border):
    plan = [(32, 0, 0), (16, 0, 1)]
    found = compare(rasters(border)[name], plan, mask="soft", kernels=True)
    assert found.pop("image") < 2e-6 * len(plan)
    assert all(value < 1e-4 for value in found.values()), found


@pytest.mark.parametrize("border", BORDERS)
def test_a_cell_alone_is_itself(border):
    raster = Raster(3, [1], border)
    made = tensors(raster, passes=2)
    inputs = inputs_of(made, [(2, 0, 0), (1, 0, 1)], None, None, fill=False)
    blended = blend_polar_stack(inputs, raster.heights, border == "rotate", save=True)
    torch.testing.assert_close(blended.image[:, :, 0], inputs.radiance[:, :, 0])
    assert not blended.image[:, :, 1:].any()
    seed = torch.ones_like(blended.image)
    got = return_polar_gradients(inputs, raster.heights, border == "rotate", blended, seed)
    torch.testing.assert_close(got.radiance[:, :, 0], seed[:, :, 0])
    assert not got.radiance[:, :, 1:].any()
    for gradient in (got.normal, got.position, got.mask, got.inverse):
        assert float(gradient.abs().max()) < 1e-6


@pytest.mark.parametrize("border", BORDERS)
def test_neighbours_are_those_of_the_warp(border):
    """The twin's own rule, in fractions of a turn, on a raster that has a warp, too."""
    warp = rasters(border)["smooth"]
    raster, cells = Raster(37, warp.heights.tolist(), border), cells_of(warp)[::7]
    for dx, dy in ((-2, 1), (-8, -3), (1, 0), (8, 40)):
        assert torch.equal(raster.neighbour(cells, dx, dy), warp.neighbour(cells, dx, dy))


@pytest.mark.parametrize("case", ["patches, all", "holes"])
def test_nothing_depends_on_the_number_of_threads_or_changes_when_called_again(case, threads):
    raster, (plan, options) = rasters("rotate")["smooth"], CASES[case]
    options = options | {"mask": options.get("mask", "full")}
    region, fill = options.pop("region", None), options.pop("fill", False)
    made = tensors(raster, passes=len(plan), **options)
    labels = None if region is None else labels_of(raster, region)
    inputs = inputs_of(made, plan, made["mask"].detach() > 0, labels, fill)
    before = [
        None if each is None else each.clone() for each in vars(inputs).values() if not isinstance(each, tuple | bool)
    ]
    answers = []
    for count in (1, 2, 3, 3):
        threads(count)
        blended = blend_polar_stack(inputs, raster.heights, True, save=True)
        seeds = [blended.image.square(), blended.mask][: 1 + fill]
        answers.append([*blended[:3], *return_polar_gradients(inputs, raster.heights, True, blended, *seeds)])
    for answer in answers[1:]:
        for one, other in zip(answers[0], answer, strict=True):
            assert (one is None and other is None) or torch.equal(one.nan_to_num(7), other.nan_to_num(7))
    after = [each for each in vars(inputs).values() if not isinstance(each, tuple | bool)]
    for one, other in zip(before, after, strict=True):
        assert (one is None and other is None) or torch.equal(one.nan_to_num(7), other.nan_to_num(7))


def test_plain_kernels_agree_too():
    """What runs where vector code is switched off."""
    code = (
        "import json, sys, test_fused_polar as t\n"
        "found = {case: t.compare(t.rasters('rotate')['wild'], t.CASES[case][0], **t.CASES[case][1])\n"
        "         for case in sys.argv[1:]}\n"
        "print(json.dumps(found))"
    )
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"FOVDEN_SIMD": "0", "PYTHONPATH": path}
    command = [sys.executable, "-c", code, "full", "patches, all"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for case, found in json.loads(done.stdout).items():
        assert found.pop("image") < 2e-6 * len(CASES[case][0])
        assert all(value < 1e-4 for value in found.values()), (case, found)


@pytest.mark.parametrize(
    ("heights", "kind", "said"),
    [
        ([1, 2, 3], ShapeError, "heights"),
        ([0, 2, 3, 3], ValueError, "heights: expected|heights.*0 to 3"),
        ([1, 2, 3, 6], ValueError, "heights.*1 to 6"),
    ],
)
def test_bad_heights_are_refused(heights, kind, said):
    flat = torch.zeros(1, 3, 5, 4)
    inputs = Inputs(
        flat, flat, flat, torch.ones(1, 1, 5, 4), None, None, torch.ones(1, 3), None, None, (1,), (0,), (0,), False
    )
    with pytest.raises(kind, match=said):
        blend_polar_stack(inputs, torch.tensor(heights), False)
