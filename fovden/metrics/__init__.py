"""Metrics: how far an image is from a reference, per view and per foveation layer."""

from fovden.metrics.flip_hdr import hdr_flip, hdr_flip_map
from fovden.metrics.flip_ldr import PIXELS_PER_DEGREE, flip, flip_map, monitor_pixels_per_degree
from fovden.metrics.image import mse, psnr, relative_mse, rmse, smape, ssim, ssim_map, weighted_mean
from fovden.metrics.table import Comparison, Score, compare

__all__ = [
    "PIXELS_PER_DEGREE",
    "Comparison",
    "Score",
    "compare",
    "flip",
    "flip_map",
    "hdr_flip",
    "hdr_flip_map",
    "monitor_pixels_per_degree",
    "mse",
    "psnr",
    "relative_mse",
    "rmse",
    "smape",
    "ssim",
    "ssim_map",
    "weighted_mean",
]
