"""Frames with awkward values, and files as other programs write them."""

from dataclasses import fields, replace

import numpy as np
import OpenEXR
import torch

from fovden.camera import Gaze, StereoCamera
from fovden.frame import Frame, GBuffer
from fovden.warps import VisualPolarWarp

HEIGHT, WIDTH = 19, 23  # more rows than one block of 16, and odd


def awkward(*shape, seed=0):
    """Non-negative float32 values of every magnitude: denormals, values that overflow half floats, 1e30, zeros."""
    generator = torch.Generator().manual_seed(seed)
    values = 10.0 ** torch.empty(shape, dtype=torch.float64).uniform_(-44, 30, generator=generator)
    values = values.to(torch.float32)
    values.view(-1)[:6] = torch.tensor([0.0, 7e4, 1e30, 1.4e-45, 1.1754942e-38, 1.0])
    return values


def make_frame(views=2):
    generator = torch.Generator().manual_seed(7)

    def signed(channels):
        return torch.randn(views, channels, HEIGHT, WIDTH, generator=generator)

    def integers(low, high):
        return torch.randint(low, high, (views, 1, HEIGHT, WIDTH), generator=generator, dtype=torch.int32)

    gbuffer = GBuffer(
        albedo=torch.rand(views, 3, HEIGHT, WIDTH, generator=generator),
        normal=signed(3),
        position=signed(3) * 1e5,
        depth=awkward(views, 1, HEIGHT, WIDTH, seed=1),
        roughness=torch.rand(views, 1, HEIGHT, WIDTH, generator=generator),
        motion=signed(2),
        prim=integers(-1, 2**31 - 1),
        barycentric=signed(2),
    )
    gbuffer.prim[:, :, 0, :5] = torch.tensor([-1, 0, 1, 2**24 + 1, 2**31 - 1], dtype=torch.int32)
    camera = StereoCamera.look_at((0.1, 1.6, 3), (0, 1.5, 0.3), fov_x_deg=75, resolution=(HEIGHT, WIDTH)).views
    if views != 2:
        parts = {name: getattr(camera, name)[:1].repeat(views, *[1] * (getattr(camera, name).ndim - 1))
                 for name in ("origin", "rotation", "bounds")}  # fmt: skip
        camera = replace(camera, **parts)
    return Frame(
        direct=awkward(views, 3, HEIGHT, WIDTH, seed=2),
        indirect=awkward(views, 3, HEIGHT, WIDTH, seed=3),
        emission=awkward(views, 3, HEIGHT, WIDTH, seed=4),
        counts=integers(0, 17) if views == 2 else integers(0, 17).float(),
        luminance_squared=awkward(views, 1, HEIGHT, WIDTH, seed=5),
        layer=integers(0, 3),
        gbuffer=gbuffer,
        camera=camera,
        gaze=Gaze(torch.rand(views, 2, generator=generator) * 1e3 - 400),
        jitter=(1 / 3, -0.1),
        index=12,
        seed=2**40 + 1,
        warp=VisualPolarWarp(Gaze(torch.rand(views, 2) * 30), (HEIGHT, WIDTH), (HEIGHT, WIDTH), cut="stair", block=4),
    )


def same_bits(first, second):
    assert first.dtype == second.dtype
    assert first.shape == second.shape
    return torch.equal(first.view(torch.int32), second.view(torch.int32))


def assert_same_frame(loaded, saved):
    for name in ("direct", "indirect", "emission", "counts", "luminance_squared", "layer"):
        assert same_bits(getattr(loaded, name), getattr(saved, name)), name
    for field in fields(GBuffer):
        assert same_bits(getattr(loaded.gbuffer, field.name), getattr(saved.gbuffer, field.name)), field.name
    for name in ("origin", "rotation", "bounds"):
        assert torch.equal(getattr(loaded.camera, name), getattr(saved.camera, name)), name
    assert loaded.camera.resolution == saved.camera.resolution
    assert torch.equal(loaded.gaze.pixels, saved.gaze.pixels)
    assert torch.equal(loaded.warp.gaze.pixels, saved.warp.gaze.pixels)
    for field in fields(saved.warp)[1:]:
        assert getattr(loaded.warp, field.name) == getattr(saved.warp, field.name), field.name
    for name in ("jitter", "index", "seed"):
        assert getattr(loaded, name) == getattr(saved, name), name


def write_exr(path, channels, **header):
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels)) as file:
        file.write(str(path))


def foreign_channels(height=6, width=8, names=("", "nn", "pos", "albedo")):
    """A renderer's image in Mitsuba's layout; the first row sees nothing."""
    generator = np.random.default_rng(3)
    beauty, normal, position, albedo = names
    channels = {}
    for layer, letters in ((beauty, "RGB"), (normal, "XYZ"), (position, "XYZ"), (albedo, "RGB")):
        for letter in letters:
            plane = generator.random((height, width), dtype=np.float32) + 0.1
            if layer in (normal, position):
                plane[0] = 0
            channels[f"{layer}.{letter}" if layer else letter] = plane
    return channels
