"""Tuning: the parameters of denoisers, learned from frames whose references are known."""

from fovden.tuning.fit import Fit, fit
from fovden.tuning.history import Record, read_history
from fovden.tuning.objective import ImageError, Objective
from fovden.tuning.parameters import load_parameters, readable, save_parameters

__all__ = [
    "Fit",
    "ImageError",
    "Objective",
    "Record",
    "fit",
    "load_parameters",
    "read_history",
    "readable",
    "save_parameters",
]
