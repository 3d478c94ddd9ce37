"""Metrics: how far an image is from a reference, per view, per foveation layer, and to an eye that looks somewhere."""

from fovden.metrics.flip_hdr import hdr_flip, hdr_flip_map
from fovden.metrics.flip_ldr import PIXELS_PER_DEGREE, flip, flip_map, monitor_pixels_per_degree
from fovden.metrics.foveated import acuity_weight, fovvideovdp
from fovden.metrics.image import mse, psnr, relative_mse, rmse, rmse_map, smape, ssim, ssim_map, weighted_mean
from fovden.metrics.table import METRICS, Comparison, MetricStyle, Score, compare

__all__ = [
    "METRICS",
    "PIXELS_PER_DEGREE",
    "Comparison",
    "MetricStyle",
    "Score",
    "acuity_weight",
    "compare",
    "flip",
    "flip_map",
    "fovvideovdp",
    "hdr_flip",
    "hdr_flip_map",
    "monitor_pixels_per_degree",
    "mse",
    "psnr",
    "relative_mse",
    "rmse",
    "rmse_map",
    "smape",
    "ssim",
    "ssim_map",
    "weighted_mean",
]
