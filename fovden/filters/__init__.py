"""Denoisers: modules that fold a noisy frame into an image, and the plain functions on tensors beneath them.

Every member obeys :class:`Denoiser`. To add one: write it in a file of its own, export it here, list it in
``tests/contracts/test_denoisers.py``, and name its source in its docstring.

=============================  ==================================================================================
:class:`Atrous`                the edge-avoiding à-trous filter (Dammertz et al. 2010), steps in any order
:class:`NonHomogeneousAtrous`  the same with its own passes and widths in each foveation layer (2023 paper)
:class:`PredictedSigmas`       either of them, with widths that a small network predicts at each pixel
:class:`WarpedDenoiser`        any of them in the cells of a polar raster, and the way to the screen
=============================  ==================================================================================
"""

from fovden.filters.atrous import Atrous, atrous_pass
from fovden.filters.base import Denoised, Denoiser
from fovden.filters.edge_stopping import EdgeStopping
from fovden.filters.guided import GuidedDenoiser
from fovden.filters.holes import fill_holes
from fovden.filters.nonhomogeneous import NonHomogeneousAtrous
from fovden.filters.predicted import PredictedSigmas
from fovden.filters.stack import TapKernel
from fovden.filters.warped import WarpedDenoiser

__all__ = [
    "Atrous",
    "Denoised",
    "Denoiser",
    "EdgeStopping",
    "GuidedDenoiser",
    "NonHomogeneousAtrous",
    "PredictedSigmas",
    "TapKernel",
    "WarpedDenoiser",
    "atrous_pass",
    "fill_holes",
]
