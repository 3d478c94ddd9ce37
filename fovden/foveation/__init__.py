"""Foveation: where the eye looks, how many samples that gives each pixel, and where rasters that follow it put them."""

from fovden.foveation.differences import add_differences
from fovden.foveation.display import Display, Gaze, eccentricity_degrees, eccentricity_pixels
from fovden.foveation.falloff import Falloff, RateMap, ThreeLayer
from fovden.foveation.learned import LearnedProfile, LearnedThreeLayer
from fovden.foveation.sample_map import SampleMap, mask_numbers, sample_map, uniform_map
from fovden.foveation.soft_mask import relaxed_mask, thinned
from fovden.foveation.warps import LogPolarWarp, PolarWarp, ScreenWarp, VisualPolarWarp, Warp, eccentricity_blur

__all__ = [
    "Display",
    "Falloff",
    "Gaze",
    "LearnedProfile",
    "LearnedThreeLayer",
    "LogPolarWarp",
    "PolarWarp",
    "RateMap",
    "SampleMap",
    "ScreenWarp",
    "ThreeLayer",
    "VisualPolarWarp",
    "Warp",
    "add_differences",
    "eccentricity_blur",
    "eccentricity_degrees",
    "eccentricity_pixels",
    "mask_numbers",
    "relaxed_mask",
    "sample_map",
    "thinned",
    "uniform_map",
]
