"""Warps: rasters that follow the eye, laid over the screen.

A warp is geometry alone: a frame says on which raster its images lie, so that it lives beneath frames. Users find it in
:mod:`fovden.foveation`, where a falloff says how many samples there are, and a warp where.
"""

from fovden.warps.base import Warp
from fovden.warps.blur import eccentricity_blur
from fovden.warps.log_polar import LogPolarWarp
from fovden.warps.polar import PolarWarp
from fovden.warps.screen import ScreenWarp
from fovden.warps.sizing import warp_at_budget
from fovden.warps.topology import Topology
from fovden.warps.visual_polar import VisualPolarWarp

__all__ = [
    "LogPolarWarp",
    "PolarWarp",
    "ScreenWarp",
    "Topology",
    "VisualPolarWarp",
    "Warp",
    "eccentricity_blur",
    "warp_at_budget",
]
