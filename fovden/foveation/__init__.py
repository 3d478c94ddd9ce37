"""Foveation: where the eye looks, and how many samples that gives each pixel."""

from fovden.foveation.differences import add_differences
from fovden.foveation.display import Display, Gaze, eccentricity_degrees, eccentricity_pixels
from fovden.foveation.falloff import Falloff, RateMap, ThreeLayer
from fovden.foveation.learned import LearnedProfile, LearnedThreeLayer
from fovden.foveation.sample_map import SampleMap, mask_numbers, sample_map, uniform_map
from fovden.foveation.soft_mask import relaxed_mask, thinned

__all__ = [
    "Display",
    "Falloff",
    "Gaze",
    "LearnedProfile",
    "LearnedThreeLayer",
    "RateMap",
    "SampleMap",
    "ThreeLayer",
    "add_differences",
    "eccentricity_degrees",
    "eccentricity_pixels",
    "mask_numbers",
    "relaxed_mask",
    "sample_map",
    "thinned",
    "uniform_map",
]
