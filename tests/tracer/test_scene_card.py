"""A scene's card: its counts, and a thumbnail that is never the reason for an error."""

import base64
import io
import re
from dataclasses import replace

import imageio.v3 as imageio
import numpy as np
import pytest
import torch

from fovden.tracer import PointLight, make_scene, trace_gbuffer
from fovden.tracer import scene_card as module
from fovden.tracer.scene_card import scene_card

SCENE = make_scene("cornell_box")


def rows(page: str) -> dict[str, str]:
    return dict(re.findall(r"<th[^>]*>([^<]*)</th><td[^>]*>([^<]*)</td>", page))


def thumbnail(page: str) -> np.ndarray:
    (data,) = re.findall(r"data:image/png;base64,([^\"]*)", page)
    return imageio.imread(io.BytesIO(base64.b64decode(data)), mode="RGB")


def test_it_counts_what_is_there():
    light = PointLight((1, 2, 3), 4)
    found = rows(scene_card(SCENE.with_lights([light, light])))
    assert found["triangles"] == f"{len(SCENE.faces)}"
    assert found["lights"] == "2 point lights, 2 emissive triangles"
    assert found["materials"] == "4, 0 textures"
    assert found["extent"] == "5.56 x 5.49 x 5.59 m (x, y, z)"
    assert found["camera"] == f"{1000 * SCENE.camera.eye_separation:.3g} mm between the eyes"


def test_the_thumbnail_is_albedo_times_cosine_of_the_left_eye():
    page = SCENE._repr_html_()
    picture = thumbnail(page).astype(np.float64) / 255
    camera = SCENE.camera.at(resolution=picture.shape[:2])
    gbuffer = trace_gbuffer(SCENE, camera)
    rays = camera.views.rays()
    direction = rays.directions.reshape(2, *picture.shape[:2], 3)[0].double().numpy()
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    normal, albedo = (image[0].permute(1, 2, 0).double().numpy() for image in (gbuffer.normal, gbuffer.albedo))
    linear = albedo * np.maximum(-(normal * direction).sum(-1, keepdims=True), 0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(picture - encoded).max() < 0.02  # 256 levels, or as many colours
    assert len(page) < 150_000


def test_names_are_escaped_and_what_cannot_be_traced_has_no_thumbnail(monkeypatch):
    nasty = "<script>alert(1)</script>"
    page = scene_card(replace(SCENE, name=nasty, camera=None))
    assert nasty not in page
    assert "&lt;script&gt;" in page
    assert "<img" not in page
    assert rows(page)["camera"] == "none"

    def fail(_: object) -> torch.Tensor:
        raise RuntimeError("on purpose")

    monkeypatch.setattr(module, "_first_look", fail)
    assert "<img" not in scene_card(SCENE)
    assert rows(scene_card(SCENE))["triangles"] == "38"


@pytest.mark.parametrize("built", [True, False])
def test_a_huge_scene_is_not_prepared_for_a_thumbnail(monkeypatch, built):
    monkeypatch.setattr(module, "SHOWN_TRIANGLES", 10)
    scene = replace(SCENE)
    if built:
        _ = scene.bvh
    assert ("<img" in scene_card(scene)) == built
    assert ("bvh" in scene.__dict__) == built
