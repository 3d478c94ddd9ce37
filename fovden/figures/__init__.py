"""Figures in one style, drawn from saved files, and contact sheets for notebooks.

``fovden figures DIR`` draws the figures of a comparison again from the files in its folder: :func:`draw_figures`. How
noise falls with the number of samples is drawn by :func:`draw_convergence`, the course of a fit by
:func:`draw_history`, what fits gain by :func:`draw_fitted`, densities of falloffs by :func:`draw_densities` and of
sample maps by :func:`draw_sample_maps`, learned falloffs by :func:`draw_falloff`, polar rasters by
:func:`draw_rasters`, ways to place paths by :func:`draw_foveations`, the front of time against error by
:func:`draw_front`, readings of the paper by :func:`draw_readings`. What they have in common, colours and sizes, is in
:mod:`fovden.figures.style`.
"""

from fovden.figures.comparison import draw_figures
from fovden.figures.contact_sheet import ContactSheet, contact_sheet
from fovden.figures.convergence import draw_convergence
from fovden.figures.densities import draw_densities, draw_sample_maps
from fovden.figures.falloff import draw_falloff
from fovden.figures.fitted import draw_fitted, scores_of_fits
from fovden.figures.foveations import curves_of_ways, draw_foveations
from fovden.figures.front import draw_front
from fovden.figures.rasters import draw_rasters
from fovden.figures.readings import draw_readings
from fovden.figures.style import METHOD_STYLES, PRINT_WIDTH, MethodStyle, drawing, method_style
from fovden.figures.tuning import draw_history

__all__ = [
    "METHOD_STYLES",
    "PRINT_WIDTH",
    "ContactSheet",
    "MethodStyle",
    "contact_sheet",
    "curves_of_ways",
    "draw_convergence",
    "draw_densities",
    "draw_falloff",
    "draw_figures",
    "draw_fitted",
    "draw_foveations",
    "draw_front",
    "draw_history",
    "draw_rasters",
    "draw_readings",
    "draw_sample_maps",
    "drawing",
    "method_style",
    "scores_of_fits",
]
