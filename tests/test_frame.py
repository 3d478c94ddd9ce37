"""The records: shapes are checked, moving keeps integers, stacking keeps the order of views."""

import dataclasses
import math

import pytest
import torch

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.checks import ShapeError
from fovden.frame import Frame, GBuffer, Reference

CAMERA = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 6))


def gbuffer(seed: int, views: int = 2, resolution: tuple[int, int] = (4, 6)) -> GBuffer:
    generator = torch.Generator().manual_seed(seed)

    def rand(channels: int) -> torch.Tensor:
        return torch.rand(views, channels, *resolution, generator=generator)

    prim = torch.randint(-1, 300_000, (views, 1, *resolution), generator=generator, dtype=torch.int32)
    return GBuffer(rand(3), rand(3), rand(3), rand(1), rand(1), rand(2), prim, rand(2))


def frame(seed: int, views: int = 2, **changes) -> Frame:
    generator = torch.Generator().manual_seed(100 + seed)

    def rand(channels: int) -> torch.Tensor:
        return torch.rand(views, channels, 4, 6, generator=generator)

    counts = torch.randint(0, 3, (views, 1, 4, 6), generator=generator, dtype=torch.int32)
    layer = torch.randint(0, 3, (views, 1, 4, 6), generator=generator)
    made = Frame(rand(3), rand(3), rand(3), counts, rand(1), layer, gbuffer(seed, views), seed=seed)
    return dataclasses.replace(made, **changes)


def test_radiance_mask_and_sizes():
    made = frame(0)
    assert torch.equal(made.radiance, made.direct + made.indirect + made.emission)
    assert made.mask.dtype == torch.float32
    assert torch.equal(made.mask == 1, made.counts > 0)
    assert torch.equal(made.mask == 0, made.counts == 0)
    assert (made.resolution, made.view_count) == ((4, 6), 2)
    assert made.layer.dtype == torch.int32
    assert torch.equal(made.gbuffer.hit, made.gbuffer.prim >= 0)


def test_records_are_frozen_and_compare_by_identity():
    made = frame(0)
    for record in (made, made.gbuffer, Reference(made.direct, made.indirect, 4)):
        name = dataclasses.fields(record)[0].name
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(record, name, None)
        assert record != dataclasses.replace(record)
        assert {record: "found"}[record] == "found"


def test_frame_has_no_reference_to_peek_at():
    names = {field.name for field in dataclasses.fields(Frame)}
    assert not names & {"reference", "clean", "truth", "target"}


def test_from_radiance_defaults():
    radiance = torch.rand(1, 3, 4, 6)
    made = Frame.from_radiance(radiance, gbuffer(0, 1))
    assert torch.equal(made.radiance, radiance)
    assert (made.counts == 1).all()
    assert (made.layer == 0).all()
    assert (made.camera, made.gaze, made.raster) == (None, None, "screen")
    counts = torch.randint(0, 5, (1, 1, 4, 6))
    layer = torch.randint(0, 3, (1, 1, 4, 6))
    made = Frame.from_radiance(radiance, gbuffer(0, 1), counts=counts, layer=layer)
    assert torch.equal(made.counts, counts)
    assert torch.equal(made.layer.long(), layer)


@pytest.mark.parametrize("target", [torch.float64, torch.float16, torch.bfloat16])
def test_moving_changes_floating_fields_only(target):
    made = frame(1, camera=CAMERA.views, gaze=Gaze.center(CAMERA))
    moved = made.to(target)
    for record, before in ((moved, made), (moved.gbuffer, made.gbuffer)):
        for field in dataclasses.fields(record):
            tensor, old = getattr(record, field.name), getattr(before, field.name)
            if isinstance(tensor, torch.Tensor):
                assert tensor.dtype == (target if old.is_floating_point() else old.dtype), field.name
                if not old.is_floating_point():
                    assert torch.equal(tensor, old), field.name
    assert moved.camera.origin.dtype == moved.gaze.pixels.dtype == target
    assert moved.seed == made.seed


def test_moving_keeps_large_integers():
    """Neither a triangle nor a count may pass through a type that cannot hold it."""
    large = torch.full((1, 1, 2, 2), 2**24 + 1, dtype=torch.int32)
    made = dataclasses.replace(GBuffer.empty(1, (2, 2)), prim=large)
    for arguments in ((torch.float16,), (torch.float32,), ("cpu", torch.float64), (torch.zeros(1),)):
        assert torch.equal(made.to(*arguments).prim, large)
    assert torch.equal(made.to(device="cpu", dtype=torch.float16).prim, large)


def test_reference_and_camera_move():
    reference = Reference(torch.ones(2, 3, 4, 6), torch.full((2, 3, 4, 6), 0.04), 16, CAMERA.views).to(torch.float64)
    assert reference.mean.dtype == reference.camera.bounds.dtype == torch.float64
    assert reference.count == 16
    torch.testing.assert_close(reference.standard_error, torch.full((2, 3, 4, 6), 0.2).double())


def test_stack_joins_views_in_order():
    cameras = [CAMERA.views, StereoCamera.look_at((1, 0, 5), (0, 0, 0), fov_y_deg=40, resolution=(4, 6)).views]
    gazes = [Gaze(torch.zeros(2, 2)), Gaze(torch.ones(2, 2))]
    frames = [frame(k, camera=cameras[k], gaze=gazes[k], index=k) for k in range(2)]
    joined = Frame.stack(frames)
    assert joined.view_count == 4
    for k, made in enumerate(frames):
        views = slice(2 * k, 2 * k + 2)
        for name in ("direct", "indirect", "emission", "counts", "luminance_squared", "layer"):
            assert torch.equal(getattr(joined, name)[views], getattr(made, name)), name
        for field in dataclasses.fields(GBuffer):
            assert torch.equal(getattr(joined.gbuffer, field.name)[views], getattr(made.gbuffer, field.name))
        assert torch.equal(joined.gaze.pixels[views], gazes[k].pixels)
        for name in ("origin", "rotation", "bounds"):
            assert torch.equal(getattr(joined.camera, name)[views], getattr(cameras[k], name))
    assert (joined.index, joined.seed) == (0, 0)


def test_stack_drops_a_camera_or_gaze_that_not_all_have():
    first = frame(0, camera=CAMERA.views, gaze=Gaze.center(CAMERA))
    joined = Frame.stack([first, frame(1)])
    assert joined.camera is None
    assert joined.gaze is None


def test_stack_refuses_nothing_and_other_resolutions():
    with pytest.raises(ValueError, match="at least one frame"):
        Frame.stack([])
    small = Frame.from_radiance(torch.ones(1, 3, 2, 2), GBuffer.empty(1, (2, 2)))
    with pytest.raises(ValueError, match=r"frames\[1\]\.resolution: expected \(4, 6\).*got \(2, 2\)"):
        Frame.stack([frame(0), small])


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("direct", (2, 1, 4, 6)),
        ("indirect", (1, 3, 4, 6)),
        ("emission", (2, 3, 6, 4)),
        ("counts", (2, 3, 4, 6)),
        ("luminance_squared", (2, 4, 6)),
        ("layer", (1, 1, 4, 6)),
    ],
)
def test_frame_refuses_shapes_that_disagree(name, shape):
    with pytest.raises(ShapeError, match=name if name != "direct" else "direct|indirect"):
        frame(0, **{name: torch.zeros(shape)})


def test_frame_refuses_parts_with_other_views():
    with pytest.raises(ShapeError, match="gbuffer"):
        frame(0, gbuffer=GBuffer.empty(1, (4, 6)))
    with pytest.raises(ShapeError, match="gaze"):
        frame(0, gaze=Gaze(torch.zeros(1, 2)))
    views = CAMERA.views
    left = Camera(views.origin[:1], views.rotation[:1], views.bounds[:1], views.resolution)
    with pytest.raises(ShapeError, match="camera"):
        frame(0, camera=left)


@pytest.mark.parametrize(
    ("name", "shape"), [("normal", (2, 2, 4, 6)), ("depth", (2, 3, 4, 6)), ("motion", (2, 3, 4, 6))]
)
def test_gbuffer_refuses_shapes_that_disagree(name, shape):
    with pytest.raises(ShapeError, match=name):
        dataclasses.replace(gbuffer(0), **{name: torch.zeros(shape)})


def test_reference_refuses_bad_values():
    ones = torch.ones(1, 3, 2, 2)
    with pytest.raises(ShapeError, match="variance"):
        Reference(ones, ones[:, :1], 4)
    with pytest.raises(ValueError, match="count"):
        Reference(ones, ones, 0)
    with pytest.raises(TypeError, match="count"):
        Reference(ones, ones, math.nan)
