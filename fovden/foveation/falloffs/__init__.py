"""The falloffs of the field, each in a file of its own; all of them are exported by :mod:`fovden.foveation`."""

from fovden.foveation.falloffs.acuity import AcuityFalloff
from fovden.foveation.falloffs.guenter import GuenterLayers, HyperbolicFalloff, LayerSizes
from fovden.foveation.falloffs.learned import LearnedProfile, LearnedThreeLayer
from fovden.foveation.falloffs.linear import LinearFalloff
from fovden.foveation.falloffs.three_layer import ThreeLayer

__all__ = [
    "AcuityFalloff",
    "GuenterLayers",
    "HyperbolicFalloff",
    "LayerSizes",
    "LearnedProfile",
    "LearnedThreeLayer",
    "LinearFalloff",
    "ThreeLayer",
]
