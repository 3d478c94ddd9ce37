"""Ways to place a given number of paths: falloffs on the screen, smaller images, polar rasters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.filters import Denoiser, NonHomogeneousAtrous, WarpedDenoiser
from fovden.foveation import (
    AcuityFalloff,
    Falloff,
    GuenterLayers,
    LinearFalloff,
    LogPolarWarp,
    RateMap,
    ReddyAcuity,
    SampleMap,
    ScreenWarp,
    ThreeLayer,
    VisualPolarWarp,
    Warp,
    sample_map,
    warp_at_budget,
)

__all__ = ["FOVEATIONS", "Even", "Foveation"]


@dataclass(frozen=True)
class Even:
    """A falloff with the same rate everywhere, which a budget scales.

    Example:
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 4))
        >>> Even()(camera.views, Gaze.center(camera)).rate.unique()
        tensor([1.])
    """

    def __call__(self, camera: Camera, gaze: Gaze, /) -> RateMap:
        """Returns rates of 1 and a single layer."""
        rate = torch.ones(camera.view_count, 1, *camera.resolution, device=gaze.pixels.device)
        return RateMap(rate, torch.zeros_like(rate, dtype=torch.int32), (), True)


@dataclass(frozen=True)
class Foveation:
    """One way to place paths.

    Attributes:
        name: How it is called in tables and figures.
        falloff: How paths are spread over the screen's pixels, for what has no raster of its own.
        warp: Makes the raster for a camera and a gaze.
        sized: Whether the raster is resized for each gaze to meet the budget of paths.

    Example:
        >>> Foveation("sparse", Even()).raster(Even, None, 0.4) is None
        True
    """

    name: str
    falloff: Falloff | None = None
    warp: Callable[[StereoCamera, Gaze], Warp] | None = None
    sized: bool = True

    def raster(self, camera: StereoCamera, gaze: Gaze, mean_spp: float) -> Warp | None:
        """Returns the raster that meets a budget of paths per pixel of the screen; ``None`` for the screen itself."""
        if self.warp is None:
            return None
        warp = self.warp(camera, gaze)
        return warp_at_budget(warp, mean_spp) if self.sized else warp

    def samples(self, camera: StereoCamera, gaze: Gaze, mean_spp: float, seed: int = 0) -> SampleMap:
        """Returns one path for each pixel or cell that has any."""
        if self.falloff is None:
            warp = self.raster(camera, gaze, mean_spp)
            return SampleMap.from_counts(warp.read.int(), gaze, warp=warp)
        budget = min(mean_spp, 1.0)
        return sample_map(self.falloff, camera, gaze, spp=1, seed=seed, mean_spp=budget, source="blue_noise")

    def denoiser(self, camera: StereoCamera, *, learn: bool = False) -> Denoiser:
        """Returns the filter of all ways, five passes on light without albedo, in this one's raster."""
        inner = NonHomogeneousAtrous.base(demodulate=True, per_pass=True)
        if self.warp is None:
            return inner
        warp = self.warp(camera, Gaze.center(camera))
        learned = ("blur",) if learn and not isinstance(warp, ScreenWarp) else ()
        return WarpedDenoiser(inner, warp, learn=learned)


FOVEATIONS: Mapping[str, Foveation] = {
    each.name: each
    for each in (
        Foveation("Smaller image", warp=ScreenWarp.for_camera),
        Foveation("Sparse, even", Even()),
        Foveation("Three layers", ThreeLayer()),
        Foveation("Linear", LinearFalloff()),
        Foveation("Guenter", GuenterLayers()),
        Foveation("Acuity", AcuityFalloff(ReddyAcuity())),
        Foveation("Log-polar", warp=LogPolarWarp.for_camera),
        Foveation("Visual-polar", warp=VisualPolarWarp.for_camera),
        Foveation("Visual-polar, fixed", warp=VisualPolarWarp.for_camera, sized=False),
    )
}
"""All ways, by name. The last keeps its size wherever the eye looks, as its source does: 0.39 cells for a pixel."""
