"""Foveation: where the eye looks, and how many samples that gives each pixel."""

from fovden.foveation.display import Display, Gaze, eccentricity_degrees, eccentricity_pixels
from fovden.foveation.falloff import Falloff, RateMap, ThreeLayer
from fovden.foveation.sample_map import SampleMap, sample_map, uniform_map

__all__ = [
    "Display",
    "Falloff",
    "Gaze",
    "RateMap",
    "SampleMap",
    "ThreeLayer",
    "eccentricity_degrees",
    "eccentricity_pixels",
    "sample_map",
    "uniform_map",
]
