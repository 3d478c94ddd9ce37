"""Frames of other renderers are read, and what they lack gets its documented default."""

import warnings
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import torch
from exr_files import foreign_channels, write_exr

from fovden.camera import StereoCamera
from fovden.io import (
    load_frame,
)


def test_a_frame_in_mitsubas_layout(tmp_path):
    channels = foreign_channels()
    write_exr(tmp_path / "mitsuba.exr", channels)
    camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(6, 8)).views
    camera = replace(camera, origin=camera.origin[:1], rotation=camera.rotation[:1], bounds=camera.bounds[:1])
    frame = load_frame(tmp_path / "mitsuba.exr", camera=camera)
    assert frame.view_count == 1
    for index, letter in enumerate("RGB"):
        assert np.array_equal(frame.radiance[0, index].numpy(), channels[letter])
        assert np.array_equal(frame.gbuffer.albedo[0, index, 1:].numpy(), channels[f"albedo.{letter}"][1:])
    for index, letter in enumerate("XYZ"):
        assert np.array_equal(frame.gbuffer.normal[0, index].numpy(), channels[f"nn.{letter}"])
        assert np.array_equal(frame.gbuffer.position[0, index].numpy(), channels[f"pos.{letter}"])
    assert frame.gbuffer.hit[0, 0, 1:].all()
    assert not frame.gbuffer.hit[0, 0, 0].any()
    assert not frame.gbuffer.albedo[0, :, 0].any()
    assert torch.equal(frame.counts, torch.ones(1, 1, 6, 8))
    # the camera looks along -z from z = 5, so the depth is 5 - z
    expected = 5 - torch.from_numpy(channels["pos.Z"][1:])
    assert torch.allclose(frame.gbuffer.depth[0, 0, 1:], expected, atol=1e-5)
    assert not frame.gbuffer.depth[0, 0, 0].any()
    assert frame.camera is camera


@pytest.mark.parametrize(
    "names",
    [
        ("", "N", "P", "albedo"),
        ("", "Ns", "P", "Albedo"),
        ("ViewLayer.Combined", "ViewLayer.Normal", "ViewLayer.Position", "ViewLayer.DiffCol"),
        ("ViewLayer.Combined", "ViewLayer.Normal", "ViewLayer.Position", "ViewLayer.Diffuse Color"),
        ("", "normals", "positions", "alb"),
    ],
)
def test_names_of_other_renderers(tmp_path, names):
    channels = foreign_channels(names=names)
    channels["Z"] = np.full((6, 8), 2.5, np.float32)
    write_exr(tmp_path / "frame.exr", channels)
    frame = load_frame(tmp_path / "frame.exr")
    assert np.array_equal(frame.radiance[0, 0].numpy(), channels[f"{names[0]}.R" if names[0] else "R"])
    assert np.array_equal(frame.gbuffer.normal[0, 1].numpy(), channels[f"{names[1]}.Y"])
    assert np.array_equal(frame.gbuffer.position[0, 2].numpy(), channels[f"{names[2]}.Z"])
    assert np.array_equal(frame.gbuffer.albedo[0, 2, 1:].numpy(), channels[f"{names[3]}.B"][1:])
    assert (frame.gbuffer.depth[0, 0, 1:] == 2.5).all()


def test_missing_optional_channels_get_their_documented_defaults(tmp_path):
    channels = {name: plane for name, plane in foreign_channels().items() if not name.startswith("albedo")}
    write_exr(tmp_path / "frame.exr", channels)
    with pytest.warns(UserWarning, match="no depth"):
        frame = load_frame(tmp_path / "frame.exr")
    hit = frame.gbuffer.hit
    points = np.stack([channels[f"pos.{letter}"][1:].ravel() for letter in "XYZ"], axis=1).astype(np.float64)
    size = np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean())
    assert torch.allclose(frame.gbuffer.depth[hit], torch.tensor(size, dtype=torch.float32))
    assert torch.equal(frame.gbuffer.albedo, hit.float().expand(1, 3, 6, 8))
    assert torch.equal(frame.gbuffer.roughness, hit.float())
    assert torch.equal(frame.gbuffer.prim, hit.int() - 1)
    assert torch.equal(frame.direct, frame.radiance)
    assert not frame.gbuffer.motion.any()
    assert not frame.layer.any()
    assert frame.camera is None


def test_mask_and_spp_give_the_counts_and_unsampled_light_is_never_read(tmp_path):
    channels = foreign_channels()
    channels["Z"] = np.ones((6, 8), np.float32)
    channels["spp.Y"] = np.full((6, 8), 4, np.float32)
    channels["mask"] = np.ones((6, 8), np.float32)
    channels["mask"][2, 3] = 0
    channels["R"][2, 3] = np.nan
    write_exr(tmp_path / "frame.exr", channels)
    frame = load_frame(tmp_path / "frame.exr")
    assert frame.counts[0, 0, 2, 3] == 0
    assert frame.radiance[0, :, 2, 3].tolist() == [0, 0, 0]
    assert frame.counts.sum() == 4 * 47


def test_infinite_depth_is_a_miss_and_half_floats_are_widened(tmp_path):
    channels = {name: plane.astype(np.float16) for name, plane in foreign_channels().items()}
    channels["Z"] = np.ones((6, 8), np.float32)
    channels["Z"][3, 4] = np.inf
    write_exr(tmp_path / "frame.exr", channels)
    frame = load_frame(tmp_path / "frame.exr")
    assert frame.radiance.dtype == torch.float32
    assert frame.gbuffer.prim[0, 0, 3, 4] == -1
    assert frame.gbuffer.depth[0, 0, 3, 4] == 0
    assert np.array_equal(frame.radiance[0, 0].numpy(), channels["R"].astype(np.float32))


@pytest.mark.parametrize("layout", ["layer.view", "view.layer", "parts"])
def test_two_views_of_another_renderer(tmp_path, layout):
    left, right = foreign_channels(), {name: plane * 2 for name, plane in foreign_channels().items()}
    for channels in (left, right):
        channels["Z"] = np.ones((6, 8), np.float32)
    path = tmp_path / "stereo.exr"
    if layout == "parts":
        parts = []
        for view, channels in (("left", left), ("right", right)):
            header = {"type": OpenEXR.scanlineimage, "view": view, "name": f"all.{view}"}
            parts.append(OpenEXR.Part(header, dict(channels), f"all.{view}"))
        with OpenEXR.File(parts) as file:
            file.write(str(path))
    else:
        channels = dict(left)
        for name, plane in right.items():
            *layer, letter = name.split(".")
            layer = [*layer, "right"] if layout == "layer.view" else ["right", *layer]
            channels[".".join([*layer, letter])] = plane
        write_exr(path, channels, multiView=["left", "right"])
    frame = load_frame(path)
    assert frame.view_count == 2
    for view, channels in enumerate((left, right)):
        assert np.array_equal(frame.radiance[view, 1].numpy(), channels["G"])
        assert np.array_equal(frame.gbuffer.normal[view, 2].numpy(), channels["nn.Z"])
        assert np.array_equal(frame.gbuffer.position[view, 0].numpy(), channels["pos.X"])


def test_a_file_that_mitsuba_wrote(tmp_path):
    mitsuba = pytest.importorskip("mitsuba")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mitsuba.set_variant("scalar_rgb")
        transform = mitsuba.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
        film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}, "component_format": "float32"}
        scene = mitsuba.load_dict({
            "type": "scene",
            "integrator": {"type": "aov", "aovs": "albedo:albedo,pos:position,nn:sh_normal", "path": {"type": "path"}},
            "sensor": {"type": "perspective", "fov": 60, "to_world": transform, "film": film | {"pixel_format": "rgb"}},
            "ball": {"type": "sphere"},
            "sky": {"type": "constant"},
        })  # fmt: skip
        image = np.array(mitsuba.render(scene, spp=1, seed=1))
        scene.sensors()[0].film().bitmap().write(str(tmp_path / "ball.exr"))
    camera = StereoCamera.look_at((0, 0, 4), (0, 0, 0), fov_y_deg=60, resolution=(16, 16), eye_separation=0).views
    camera = replace(camera, origin=camera.origin[:1], rotation=camera.rotation[:1], bounds=camera.bounds[:1])
    frame = load_frame(tmp_path / "ball.exr", camera=camera)
    assert np.array_equal(frame.radiance[0].permute(1, 2, 0).numpy(), image[..., :3])
    hit = frame.gbuffer.hit[0, 0]
    assert 0.1 < hit.float().mean() < 0.3  # a unit ball, seen from four metres at 60 degrees
    normal, position = frame.gbuffer.normal[0][:, hit], frame.gbuffer.position[0][:, hit]
    assert torch.allclose(normal, position, atol=1e-4)  # on the unit ball they are the same vector
    # where the file says the point is and where the camera sees it agree to within the pixel that was sampled
    pixels, _ = camera.project(frame.gbuffer.position.flatten(2).mT)
    y, x = hit.nonzero(as_tuple=True)
    found = pixels[0].reshape(16, 16, 2)[y, x]
    assert (found - torch.stack([x, y], dim=1) - 0.5).abs().max() <= 0.5 + 1e-3
    assert torch.allclose(frame.gbuffer.depth[0, 0][hit], 4 - position[2], atol=1e-4)
