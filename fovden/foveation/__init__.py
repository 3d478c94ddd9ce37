"""Foveation: where the eye looks, how many samples that gives each pixel, and where rasters that follow it put them."""

from fovden.foveation.acuity import Acuity, LinearMarAcuity, ReddyAcuity, TableAcuity
from fovden.foveation.budget import rates_at_budget, select_exactly
from fovden.foveation.differences import add_differences
from fovden.foveation.display import Display, Gaze, eccentricity_degrees, eccentricity_pixels
from fovden.foveation.falloff import Falloff, RateMap, layer_of_rate
from fovden.foveation.falloffs import (
    AcuityFalloff,
    GuenterLayers,
    HyperbolicFalloff,
    LayerSizes,
    LearnedProfile,
    LearnedThreeLayer,
    LinearFalloff,
    ThreeLayer,
)
from fovden.foveation.mask import mask_numbers
from fovden.foveation.sample_map import SampleMap, sample_map, uniform_map
from fovden.foveation.soft_mask import relaxed_mask, thinned
from fovden.warps import (
    LogPolarWarp,
    PolarWarp,
    ScreenWarp,
    Topology,
    VisualPolarWarp,
    Warp,
    eccentricity_blur,
    warp_at_budget,
)

__all__ = [
    "Acuity",
    "AcuityFalloff",
    "Display",
    "Falloff",
    "Gaze",
    "GuenterLayers",
    "HyperbolicFalloff",
    "LayerSizes",
    "LearnedProfile",
    "LearnedThreeLayer",
    "LinearFalloff",
    "LinearMarAcuity",
    "LogPolarWarp",
    "PolarWarp",
    "RateMap",
    "ReddyAcuity",
    "SampleMap",
    "ScreenWarp",
    "TableAcuity",
    "ThreeLayer",
    "Topology",
    "VisualPolarWarp",
    "Warp",
    "add_differences",
    "eccentricity_blur",
    "eccentricity_degrees",
    "eccentricity_pixels",
    "layer_of_rate",
    "mask_numbers",
    "rates_at_budget",
    "relaxed_mask",
    "sample_map",
    "select_exactly",
    "thinned",
    "uniform_map",
    "warp_at_budget",
]
