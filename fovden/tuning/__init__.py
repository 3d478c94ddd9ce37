"""Tuning: the parameters of denoisers, learned from frames whose references are known.

:func:`fit` follows the gradient; :func:`search` tries what has none. Frames come from outside: from the tracer's
``FrameDataset``, or from files of any renderer.
"""

from fovden.tuning.fit import Fit, Pairs, fit
from fovden.tuning.history import Record, read_history
from fovden.tuning.objective import ImageError, Objective
from fovden.tuning.parameters import load_parameters, readable, save_parameters
from fovden.tuning.search import Trial, pareto_front, search

__all__ = [
    "Fit",
    "ImageError",
    "Objective",
    "Pairs",
    "Record",
    "Trial",
    "fit",
    "load_parameters",
    "pareto_front",
    "read_history",
    "readable",
    "save_parameters",
    "search",
]
