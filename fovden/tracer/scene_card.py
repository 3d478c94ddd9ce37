"""How a scene shows itself in a notebook: what is in it, and a first look without light."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from fovden.preview import THUMBNAIL, Picture, card, show

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene

__all__ = ["lights_of", "scene_card"]

SHOWN_TRIANGLES = 2_000_000  # beyond it a first look waits for the acceleration structure for more than some seconds


def scene_card(scene: Scene) -> str:
    """Returns a card with a scene's counts and extents, and what its camera sees.

    The thumbnail is albedo times the cosine between the surface and the viewer, one ray per pixel, so that it costs
    hardly more than the acceleration structure, which is kept. It is left out where there is no camera, where the scene
    has more than two million triangles without such a structure, or where tracing fails.

    Args:
        scene: The scene.

    Returns:
        HTML that needs no other file; see :func:`fovden.preview.card`.

    Example:
        >>> from fovden.tracer import make_scene
        >>> "5.56 x 5.49 x 5.59 m" in scene_card(make_scene("cornell_box"))
        True
    """
    low, high = scene.vertices.amin(0), scene.vertices.amax(0)
    textures = len(scene.materials.textures)
    rows = {
        "triangles": f"{scene.triangle_count:,}",
        "vertices": f"{len(scene.vertices):,}",
        "materials": f"{len(scene.materials.names)}, {textures} textures",
        "lights": lights_of(scene),
        "extent": " x ".join(f"{length:.3g}" for length in (high - low).tolist()) + " m (x, y, z)",
        "corners": " to ".join("(" + ", ".join(f"{x:.3g}" for x in corner.tolist()) + ")" for corner in (low, high)),
        "camera": "none" if scene.camera is None else f"{1e3 * scene.camera.eye_separation:.3g} mm between the eyes",
    }
    if scene.views:
        rows["other views"] = ", ".join(scene.views)
    return card(f"Scene {scene.name}", _pictures(scene), rows)


def lights_of(scene: Scene) -> str:
    """Returns the kinds of a scene's lights, counted, emissive triangles among them.

    Args:
        scene: The scene.

    Returns:
        Words, ``"no light"`` if there is none.

    Example:
        >>> from fovden.tracer import PointLight, make_scene
        >>> lights_of(make_scene("cornell_box").with_lights([PointLight((2.8, 5.0, 2.8), 10.0)]))
        '1 point light, 2 emissive triangles'
    """
    kinds = Counter(f"{type(light).__name__.removesuffix('Light').lower()} light" for light in scene.lights)
    kinds["emissive triangle"] = int((scene.materials.emission.amax(1) > 0)[scene.material_ids.long()].sum())
    return ", ".join(f"{count:,} {kind}{'s' * (count > 1)}" for kind, count in kinds.items() if count) or "no light"


def _pictures(scene: Scene) -> list[Picture]:
    built = "bvh" in scene.__dict__
    if scene.camera is None or (scene.triangle_count > SHOWN_TRIANGLES and not built):
        return []
    try:
        return [Picture(show(_first_look(scene), 1.0), "albedo x cosine to the viewer, left eye")]
    except Exception:  # whatever it is, the table remains
        return []


def _first_look(scene: Scene) -> Tensor:
    """Albedo times cosine in the left eye, shape (1, 3, h, w)."""
    from fovden.tracer.gbuffer import trace_gbuffer  # noqa: PLC0415 - which imports the scene

    height, width = scene.view().resolution
    scale = THUMBNAIL / max(height, width)
    camera = scene.view().at(resolution=(max(1, round(scale * height)), max(1, round(scale * width)))).views
    gbuffer = trace_gbuffer(scene, camera)
    towards = torch.nn.functional.normalize(camera.origin[:, :, None, None] - gbuffer.position, dim=1)
    return (gbuffer.albedo * (gbuffer.normal * towards).sum(1, keepdim=True).clamp(min=0))[:1]
