"""Warps: rasters that follow the eye, laid over the screen.

A warp is geometry alone, which the tracer and the filters both use, and neither may import from the other: hence it
lives beneath both, with the rest of foveation. A falloff says how many samples, a warp says where.
"""

from fovden.foveation.warps.base import Warp
from fovden.foveation.warps.blur import eccentricity_blur
from fovden.foveation.warps.log_polar import LogPolarWarp
from fovden.foveation.warps.polar import PolarWarp
from fovden.foveation.warps.screen import ScreenWarp
from fovden.foveation.warps.topology import Topology
from fovden.foveation.warps.visual_polar import VisualPolarWarp

__all__ = ["LogPolarWarp", "PolarWarp", "ScreenWarp", "Topology", "VisualPolarWarp", "Warp", "eccentricity_blur"]
