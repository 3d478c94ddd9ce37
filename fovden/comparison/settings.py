"""What is compared: scene, view, and numbers of samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from fovden.camera import FHD, StereoCamera
from fovden.checks import require, require_integer
from fovden.tracer import Scene, load_scene, make_scene
from fovden.tracer.lights import Light

__all__ = ["PRESETS", "CompareSettings", "SceneSettings"]

FILE_ENDINGS = (".obj", ".glb", ".gltf", ".ply")
DEFAULT_FOV_X_DEG = 75.0
"""Horizontal field of view where neither the scene nor the user has one, degrees: our choice, wide enough to see an
interior from inside."""


@dataclass(frozen=True)
class SceneSettings:
    """Which scene is seen, in which light, from where.

    Attributes:
        scene: Name of a scene made in code (see :func:`fovden.tracer.make_scene`), or path of an OBJ, glTF, GLB or
            PLY file.
        lights: Lights in addition to the scene's own.
        skip_materials: Patterns of names of materials that are left out, such as ``"*glass*"``; for files only.
        view: Name of one of the scene's other views; ``None`` for its own camera.
        eye: Point midway between the eyes, metres; ``None`` for the scene's own camera.
        target: Point looked at, metres; ``None`` for the scene's own.
        fov_x_deg: Horizontal field of view in degrees; ``None`` for the scene's own.
        eye_separation: Distance between the eyes in metres; ``None`` for the scene's own.
        resolution: Height and width of one eye's image in pixels.

    Example:
        >>> scene, camera = SceneSettings("cornell_box", resolution=(16, 16)).load()
        >>> scene.name, camera.resolution
        ('cornell_box', (16, 16))
    """

    scene: str = "atrium"
    lights: tuple[Light, ...] = ()
    skip_materials: tuple[str, ...] = ()
    view: str | None = None
    eye: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None
    fov_x_deg: float | None = None
    eye_separation: float | None = None
    resolution: tuple[int, int] = FHD

    def load(self) -> tuple[Scene, StereoCamera]:
        """Returns the scene and the camera.

        Raises:
            FileNotFoundError: If a file is missing.
            ValueError: If the scene cannot be used, or has no camera and none is given.

        Example:
            >>> scene, camera = SceneSettings("cornell_box", eye=(2.7, 2.7, -6), target=(2.7, 2.7, 0)).load()
            >>> camera.eye
            (2.7, 2.7, -6.0)
        """
        if self.scene.lower().endswith(FILE_ENDINGS):
            scene = load_scene(self.scene, lights=self.lights, skip_materials=self.skip_materials)
        else:
            require(not self.skip_materials, "skip_materials", list(self.skip_materials), "none for a procedural scene")
            scene = make_scene(self.scene)
            scene = scene.with_lights((*scene.lights, *self.lights)) if self.lights else scene
        return scene, self._camera(scene)

    def _camera(self, scene: Scene) -> StereoCamera:
        camera = scene.camera if self.view is None else scene.view(self.view)
        if camera is None:
            given = self.eye is not None and self.target is not None
            require(given, "eye, target", (self.eye, self.target), f"two points, as {self.scene} has no camera")
            fov_x_deg = DEFAULT_FOV_X_DEG if self.fov_x_deg is None else self.fov_x_deg
            camera = StereoCamera(self.eye or (0, 0, 0), self.target or (0, 0, 0), fov_x_deg=fov_x_deg)
        changes: dict[str, Any] = {
            name: getattr(self, name)
            for name in ("eye", "target", "fov_x_deg", "eye_separation")
            if getattr(self, name) is not None
        }
        if "fov_x_deg" in changes:
            changes["fov_y_deg"] = None
        return replace(camera, **changes).at(resolution=self.resolution)


@dataclass(frozen=True)
class CompareSettings:
    """Everything that decides the numbers of a comparison.

    Attributes:
        view: Scene, lights, camera and resolution.
        spp: Samples per traced pixel. Default 4, the 2023 paper's.
        reference_spp: Samples per pixel of the reference.
        seed: Seed of the masks, the frames and the reference, which nevertheless have no random number in common.
        gaze: Where each eye looks, (x, y) in pixels, one pair per eye; ``None`` for the centre.
        demodulate: Whether the denoisers filter light without albedo, which keeps textures sharp; the paper's do not.
        repeats: How often each stage is timed; the median counts.

    Example:
        >>> CompareSettings().spp
        4
    """

    view: SceneSettings = field(default_factory=SceneSettings)
    spp: int = 4
    reference_spp: int = 1024
    seed: int = 0
    gaze: tuple[tuple[float, float], ...] | None = None
    demodulate: bool = False
    repeats: int = 3

    def __post_init__(self) -> None:
        for name in ("spp", "reference_spp", "repeats"):
            require_integer(name, getattr(self, name), minimum=1)


PRESETS: Mapping[str, CompareSettings] = {
    "smoke": CompareSettings(SceneSettings("cornell_box", resolution=(64, 64)), reference_spp=16, repeats=1),
    "demo": CompareSettings(SceneSettings("atrium", resolution=(360, 320)), reference_spp=256),
    "atrium": CompareSettings(SceneSettings("atrium", resolution=FHD)),
}
"""Settings by name: ``smoke`` takes seconds, ``demo`` a minute or two, ``atrium`` is the paper's first resolution."""
