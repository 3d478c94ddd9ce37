"""The kernels on polar rasters against gathers through neighbours in double precision."""

import pytest
import torch
from polar_twin import SPLINE, Raster, cells_of, polar_twin, rasters

from fovden.checks import ShapeError
from fovden.filters.fused import Inputs
from fovden.filters.fused_polar import blend_polar_stack, return_polar_gradients

IMAGES = ("radiance", "normal", "position", "mask", "factors")
NAMES = ("radiance", "normal", "position", "mask", "inverse", "factors", "kernels")


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
    """Errors of the image and of each gradient."""
    made = tensors(raster, mask=mask, factors=factors, kernels=kernels, passes=len(plan))
    labels = None if region is None else labels_of(raster, region)
    has_value = None if known == "all" else made["mask"].detach() > 0
    image, filled, has = polar_twin(raster, made, plan, known=has_value, region=labels, fill=fill)
    inputs, rotate = inputs_of(made, plan, has_value, labels, fill), raster.fovea_border == "rotate"
    blended = blend_polar_stack(inputs, raster.heights, rotate, save=True)
    assert torch.equal(blended.known, has)
    found = {"image": error(blended.image, image.detach())}
    generator = torch.Generator().manual_seed(9)
    seeds = [torch.randn(each.shape, generator=generator) for each in (image, filled)]
    outputs, given = ([image, filled], seeds) if fill else ([image], seeds[:1])
    if fill:
        assert torch.equal(blended.mask.double(), filled.detach())
    want = torch.autograd.grad(outputs, list(made.values()), [seed.double() for seed in given], allow_unused=True)
    got = return_polar_gradients(inputs, raster.heights, rotate, blended, seeds[0], seeds[1] if fill else None)
    light = return_polar_gradients(
        inputs, raster.heights, rotate, blended, seeds[0], seeds[1] if fill else None, everything=False
    )
    for name, wanted in zip(made, want, strict=True):
        found[name] = error(
            getattr(got, name), torch.zeros_like(getattr(got, name)).double() if wanted is None else wanted
        )
        if name in ("radiance", "inverse", "factors", "kernels"):
            torch.testing.assert_close(getattr(light, name), getattr(got, name), rtol=1e-4, atol=1e-5)
    return found
