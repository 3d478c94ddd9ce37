"""The experiment that compares denoisers on one stereo frame: trace, foveate, denoise, measure, draw.

Every method is judged against one reference, over the whole image and in each foveation layer, together with the
number of paths and the time of each stage. Beside the denoisers stand the inputs themselves, what happens if the mask
is ignored, and the homogeneous denoiser given as many paths as the foveated ones, spread evenly: what foveation saves
must be judged at equal cost too.
"""

from fovden.comparison.methods import METHODS, Method, file_name
from fovden.comparison.run import compare_denoisers
from fovden.comparison.saved import SavedComparison, read_comparison
from fovden.comparison.settings import PRESETS, CompareSettings, SceneSettings
from fovden.comparison.summary import summary

__all__ = [
    "METHODS",
    "PRESETS",
    "CompareSettings",
    "Method",
    "SavedComparison",
    "SceneSettings",
    "compare_denoisers",
    "file_name",
    "read_comparison",
    "summary",
]
