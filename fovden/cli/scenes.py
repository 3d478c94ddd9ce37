"""The scenes made in code: a list of them, and a picture of each from each of its views."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from fovden import color
from fovden.camera import StereoCamera
from fovden.io import save_png
from fovden.tracer import Scene, accumulate_reference, make_scene
from fovden.tracer.procedural import SCENES
from fovden.tracer.scene_card import lights_of

__all__ = ["list_scenes", "views_of"]


def list_scenes(options: argparse.Namespace) -> None:
    """Prints the scenes with their counts, and writes a picture of each view of each.

    Args:
        options: ``scenes`` (names; none means all), ``detail``, ``seed``, ``list`` (whether to write no pictures),
            ``spp``, ``resolution``, ``output``.

    Raises:
        ValueError: If there is no scene of a name, or it cannot have that many triangles.
        OSError: If a picture cannot be written.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> list_scenes(argparse.Namespace(
        ...     scenes=["cornell_box"], detail=None, seed=0, list=False, spp=1, resolution=(16, 16), output=folder))
        cornell_box: 38 triangles; 2 emissive triangles
        >>> (folder / "cornell_box.png").is_file()
        True
    """
    scenes = {name: make_scene(name, seed=options.seed, detail=options.detail) for name in options.scenes or SCENES}
    if not options.list:
        options.output.mkdir(parents=True, exist_ok=True)
    for name, scene in scenes.items():
        sys.stdout.write(f"{name}: {scene.triangle_count:,} triangles; {lights_of(scene)}\n")
        for view in scene.views:
            sys.stdout.write(f"    --view {view}\n")
        if options.list:
            continue
        for file_name, camera in views_of(name, scene).items():
            path = options.output / file_name
            _preview(path, scene, camera.at(options.resolution), options.spp, options.seed)
            sys.stderr.write(f"  {path}\n")


def views_of(name: str, scene: Scene) -> Mapping[str, StereoCamera]:
    """Returns the scene's views by the names of their pictures; the default view has the scene's own name.

    Example:
        >>> list(views_of("cornell_box", make_scene("cornell_box")))
        ['cornell_box.png']
    """
    others = {f"{name}_{view.replace(' ', '_')}.png": camera for view, camera in scene.views.items()}
    return {f"{name}.png": scene.view(), **others}


def _preview(path: Path, scene: Scene, camera: StereoCamera, spp: int, seed: int) -> None:
    """The left eye's picture."""
    eyes = camera.views
    left = eyes.view(0)
    image = accumulate_reference(scene, left, spp=spp, seed=seed, jitter=True).mean
    exposure = color.exposure(image)
    save_png(path, color.display(image, exposure), exposure=exposure)
