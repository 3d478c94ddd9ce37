"""Metrics: how far an image is from a reference, per view and per foveation layer."""

from fovden.metrics.image import mse, psnr, relative_mse, rmse, smape, ssim, ssim_map, weighted_mean
from fovden.metrics.table import Comparison, Score, compare

__all__ = [
    "Comparison",
    "Score",
    "compare",
    "mse",
    "psnr",
    "relative_mse",
    "rmse",
    "smape",
    "ssim",
    "ssim_map",
    "weighted_mean",
]
