"""Comparison of images with a reference: every metric, in every view and foveation layer, as one table."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from fovden import color
from fovden.checks import ShapeError, require, require_finite, require_shapes
from fovden.frame import Reference
from fovden.metrics.flip_ldr import PIXELS_PER_DEGREE, flip_map
from fovden.metrics.image import MARGIN, psnr, relative_mse, rmse, smape, ssim_map, weighted_mean

__all__ = ["METRICS", "Comparison", "MetricStyle", "Score", "compare"]

DISPLAY_METRICS = ("rmse", "psnr", "ssim", "flip")
LINEAR_METRICS = ("rmse_linear", "relative_mse", "smape")
CONDITIONS = ("encoding", "exposure", "peak", "noise_subtracted", "pixels_per_degree")
COLUMNS = ("method", "view", "region", "metric", "value", *CONDITIONS)


class MetricStyle(NamedTuple):
    """How a metric is written in tables and figures.

    Attributes:
        title: Its name, with its unit if it has one.
        format: Format of its values.
        better: Which end is better, ``"lower"`` or ``"higher"``.

    Example:
        >>> METRICS["psnr"]
        MetricStyle(title='PSNR / dB', format='.2f', better='higher')
    """

    title: str
    format: str
    better: Literal["lower", "higher"]


METRICS: Mapping[str, MetricStyle] = MappingProxyType(
    {
        "rmse": MetricStyle("RMSE", ".4f", "lower"),
        "psnr": MetricStyle("PSNR / dB", ".2f", "higher"),
        "ssim": MetricStyle("SSIM", ".4f", "higher"),
        "flip": MetricStyle("FLIP", ".4f", "lower"),
        "rmse_linear": MetricStyle("RMSE, linear", ".4g", "lower"),
        "relative_mse": MetricStyle("relMSE", ".4g", "lower"),
        "smape": MetricStyle("SMAPE", ".4f", "lower"),
    }
)
"""Every metric of a comparison, by the name that it has in the long form."""


class Score(NamedTuple):
    """One number of a comparison.

    Attributes:
        method: Name of the image.
        view: Number of the view; 0 is the left eye.
        region: ``"whole"``, ``"layer 0"`` and so on, or the name of a weight map.
        metric: Name of the metric.
        value: Its value.

    Example:
        >>> Score("NH3LD", 0, "whole", "ssim", 0.98).metric
        'ssim'
    """

    method: str
    view: int
    region: str
    metric: str
    value: float


@dataclass(frozen=True)
class Comparison:
    """Scores of several images against one reference, and the conditions under which they hold.

    Printing it gives a table with the mean over the views; :meth:`to_csv` writes everything.

    Attributes:
        scores: Every number, in long form.
        exposure: Scale from radiance to the display, for the display metrics (``rmse``, ``psnr``, ``ssim``, ``flip``).
        peak: Largest display value; the encoding is sRGB, clamped.
        reference_noise: Root mean square of the reference's standard error, or ``None`` where unknown.
        noise_subtracted: Whether the reference's variance was subtracted in ``rmse_linear`` and ``relative_mse``.
        pixels_per_degree: Pixels per degree of visual angle, for ``flip``.

    Example:
        >>> comparison = compare({"black": torch.zeros(1, 3, 16, 16)}, torch.ones(1, 3, 16, 16))
        >>> comparison.value("black", "rmse_linear")
        1.0
    """

    scores: tuple[Score, ...]
    exposure: float
    peak: float = 1.0
    reference_noise: float | None = None
    noise_subtracted: bool = False
    pixels_per_degree: float = PIXELS_PER_DEGREE

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the images, in the order in which they were given."""
        return tuple(dict.fromkeys(score.method for score in self.scores))

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of the regions: the whole image, layers, weights."""
        return tuple(sorted({score.region for score in self.scores}, key=_region_order))

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics."""
        return tuple(dict.fromkeys(score.metric for score in self.scores))

    def value(self, method: str, metric: str, region: str = "whole", view: int | None = None) -> float:
        """Returns one number.

        Args:
            method: Name of an image.
            metric: Name of a metric.
            region: Name of a region.
            view: Number of a view; ``None`` means the mean over the views in which the region occurs.

        Returns:
            The value.

        Raises:
            KeyError: If there is no such score.

        Example:
            >>> ones = torch.ones(2, 3, 16, 16)
            >>> compare({"half": ones / 2}, ones).value("half", "rmse_linear", view=1)
            0.5
        """
        wanted = [
            score.value
            for score in self.scores
            if (score.method, score.metric, score.region) == (method, metric, region) and view in (None, score.view)
        ]
        if not wanted:
            raise KeyError(f"no score for method {method!r}, metric {metric!r}, region {region!r}, view {view}")
        return math.fsum(wanted) / len(wanted)

    def to_csv(self, path: str | Path) -> None:
        """Writes one row per score, with the conditions under which it holds.

        Those are its encoding, exposure and peak, whether noise was subtracted, and the pixels per degree. Fields that
        do not apply to a metric are empty: exposure and peak of an HDR metric, for example.

        Args:
            path: File to write; its folder must exist.

        Example:
            >>> import tempfile
            >>> comparison = compare({"black": torch.zeros(1, 3, 16, 16)}, torch.ones(1, 3, 16, 16), exposure=1.0)
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     comparison.to_csv(Path(folder) / "metrics.csv")
            ...     print((Path(folder) / "metrics.csv").read_text().splitlines()[1])
            black,0,whole,rmse,1.0,srgb,1.0,1.0,,
        """
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for score in self.scores:
                writer.writerow((*score, *self._conditions(score.metric)))

    def _conditions(self, metric: str) -> tuple[object, ...]:
        if metric in DISPLAY_METRICS:
            return "srgb", self.exposure, self.peak, "", self.pixels_per_degree if metric == "flip" else ""
        return "linear", "", "", "" if metric == "smape" else str(self.noise_subtracted).lower(), ""

    def __str__(self) -> str:
        lines = [("region", "method", *self.metrics)]
        present = {(score.method, score.region, score.metric) for score in self.scores}
        for region in self.regions:
            for number, method in enumerate(self.methods):
                cells = [
                    format(self.value(method, metric, region), METRICS[metric].format)
                    if (method, region, metric) in present
                    else "-"
                    for metric in self.metrics
                ]
                lines.append((region if number == 0 else "", method, *cells))
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        table = [
            "  ".join(
                cell.ljust(width) if column < 2 else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(line, widths, strict=True))
            ).rstrip()
            for line in lines
        ]
        views = 1 + max((score.view for score in self.scores), default=0)
        mean = "" if views == 1 else f"Mean of {views} views. "
        table.append(
            f"{mean}{', '.join(DISPLAY_METRICS)}: exposure {self.exposure:.4g}, sRGB, peak {self.peak:g}. "
            f"{', '.join(LINEAR_METRICS)}: linear radiance."
        )
        if "flip" in self.metrics:
            table.append(f"flip: {self.pixels_per_degree:.4g} pixels per degree; lower is better.")
        if self.reference_noise is not None:
            treated = "subtracted from" if self.noise_subtracted else "left in"
            table.append(f"Noise of the reference: {self.reference_noise:.4g} (RMS), {treated} the linear MSE.")
        return "\n".join(table)


def compare(
    images: Mapping[str, Tensor],
    reference: Reference | Tensor,
    layer: Tensor | None = None,
    exposure: float | None = None,
    *,
    weights: Mapping[str, Tensor] | None = None,
    subtract_noise: bool = True,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
) -> Comparison:
    """Returns the scores of images against a reference, in every view: over the whole image, by layer and by weight.

    Display metrics (``rmse``, ``psnr``, ``ssim``, ``flip``) share one exposure, that of the reference, so that no image
    is judged by a brightness of its own; then come the sRGB curve and the clamp, and the peak is 1. HDR metrics
    (``rmse_linear``, ``relative_mse``, ``smape``) judge linear radiance.

    Args:
        images: Linear radiance by the method's name, shape (v, 3, h, w) each; finite, h and w at least 11.
        reference: A reference, or its radiance alone.
        layer: Foveation layers, integer, shape (v, 1, h, w) or (1, 1, h, w): ``frame.layer``. Each gets a region of its
            own unless there is only one. A layer that does not occur in a view has no score there.
        exposure: Scale from radiance to the display; ``None`` means :func:`fovden.color.exposure` of the reference.
        weights: Weight maps by the name of the region that they make, at least 0, shape (v, 1, h, w) or (1, 1, h, w):
            for example ``{"acuity": acuity_weight(camera, gaze)}``.
        subtract_noise: Whether the reference's variance, if it is known, is subtracted from the squared errors of the
            HDR metrics.
        pixels_per_degree: Pixels per degree of visual angle for ``flip``, at least 1. The default is that of FLIP's
            authors, a viewer at a monitor; a headset has its own, :attr:`fovden.foveation.Display.pixels_per_degree`.

    Returns:
        The comparison: print it, or write it with :meth:`Comparison.to_csv`.

    Raises:
        ShapeError: If an image, the layers or a weight map do not fit the reference.
        ValueError: If there is no image, a value is not finite, or a weight is below 0 or has a region's name.

    Example:
        >>> truth = torch.linspace(0, 1, 16).expand(2, 3, 16, 16)
        >>> print(compare({"noisy": truth + 0.1, "exact": truth}, truth, exposure=1.0))
        region  method    rmse   psnr    ssim    flip  rmse_linear  relative_mse   smape
        whole   noisy   0.1150  18.79  0.9874  0.2616          0.1        0.1695  0.1735
                exact   0.0000    inf  1.0000  0.0000            0             0  0.0000
        Mean of 2 views. rmse, psnr, ssim, flip: exposure 1, sRGB, peak 1. rmse_linear, relative_mse, smape: linear
        radiance. flip: 67.02 pixels per degree; lower is better.
    """
    require(len(images) > 0, "images", dict(images), "at least one image")
    truth = (reference.mean if isinstance(reference, Reference) else reference).detach()
    sizes = require_shapes("v 3 h w", reference=truth)
    require_finite("reference", truth)
    for name, image in images.items():
        require_shapes("v 3 h w", sizes, **{f"images[{name!r}]": image})
        require_finite(f"images[{name!r}]", image)
    exposure = color.exposure(truth) if exposure is None else exposure
    variance = reference.variance.detach() if isinstance(reference, Reference) else None
    noise = variance if subtract_noise else None
    shown_truth = color.display(truth, exposure)
    regions = _regions(layer, sizes, truth)
    for name, given in (weights or {}).items():
        require(name not in regions, "weights", repr(name), f"names other than {', '.join(map(repr, regions))}")
        _require_map(f"weights[{name!r}]", given, sizes)
        regions[name] = require_finite(f"weights[{name!r}]", given.to(truth), minimum=0)
    scores = []
    for method, radiance in images.items():
        image = radiance.detach()
        shown = color.display(image, exposure)
        similarity = ssim_map(shown, shown_truth)
        difference = flip_map(shown, shown_truth, pixels_per_degree=pixels_per_degree)
        for region, weight in regions.items():
            inner = None if weight is None else weight[..., MARGIN:-MARGIN, MARGIN:-MARGIN]
            values = {
                "rmse": rmse(shown, shown_truth, weight),
                "psnr": psnr(shown, shown_truth, weight),
                "ssim": weighted_mean(similarity, inner),
                "flip": weighted_mean(difference, weight),
                "rmse_linear": rmse(image, truth, weight, noise=noise),
                "relative_mse": relative_mse(image, truth, weight, noise=noise),
                "smape": smape(image, truth, weight),
            }
            scores += [
                Score(method, view, region, metric, value)
                for metric, per_view in values.items()
                for view, value in enumerate(per_view.tolist())
                if not math.isnan(value)
            ]
    return Comparison(
        scores=tuple(scores),
        exposure=float(exposure),
        reference_noise=None if variance is None else float(variance.mean(dtype=torch.float64).sqrt()),
        noise_subtracted=noise is not None,
        pixels_per_degree=float(pixels_per_degree),
    )


def _regions(layer: Tensor | None, sizes: Mapping[str, int], like: Tensor) -> dict[str, Tensor | None]:
    """Weight maps by name; ``None`` is the whole image."""
    regions: dict[str, Tensor | None] = {"whole": None}
    if layer is None:
        return regions
    _require_map("layer", layer, sizes)
    numbers = sorted({int(number) for number in torch.unique(layer).tolist()})
    if len(numbers) > 1:
        regions |= {f"layer {number}": (layer == number).to(like.dtype) for number in numbers}
    return regions


def _require_map(name: str, image: Tensor, sizes: Mapping[str, int]) -> None:
    require_shapes("s 1 h w", {"h": sizes["h"], "w": sizes["w"]}, **{name: image})
    if image.shape[0] not in (1, sizes["v"]):
        raise ShapeError(f"{name}: expected 1 or {sizes['v']} views, got {image.shape[0]}")


def _region_order(region: str) -> tuple[int, int, str]:
    """The whole image, layers from the inside out, and weights by name."""
    number = region.removeprefix("layer ")
    if region != "whole" and number == region:
        return 2, 0, region
    return (0, 0, "") if region == "whole" else (1, int(number), "")
