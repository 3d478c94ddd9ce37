"""What each command does: options in, files and a few lines of text out."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch
from torch import Tensor

from fovden import color
from fovden.cli.options import compare_settings, gaze_of, scene_settings
from fovden.cli.tune import METHODS
from fovden.comparison import PRESETS, CompareSettings, compare_denoisers, summary
from fovden.filters import NonHomogeneousAtrous
from fovden.foveation import ThreeLayer, sample_map
from fovden.io import load_frame, save_frame, save_image, save_png, save_reference
from fovden.results import read_metrics
from fovden.tracer import accumulate_reference, trace_frame
from fovden.tuning import load_parameters

__all__ = ["compare", "demo", "denoise", "draw", "reference", "render", "write_page"]


def render(options: argparse.Namespace) -> None:
    """Traces a noisy frame and writes it."""
    scene, camera = scene_settings(options).load()
    if options.foveation == "three-layer":
        samples = sample_map(ThreeLayer(), camera, gaze_of(options, camera), options.spp, options.seed)
        frame = trace_frame(scene, camera, samples, seed=options.seed, progress=True)
    else:
        frame = trace_frame(scene, camera, options.spp, seed=options.seed, progress=True)
    save_frame(options.output, frame)
    paths = int(frame.counts.sum())
    _say(f"{options.output}: {scene.name}, {paths:,} paths, {paths / frame.counts.numel():.3f} per pixel")
    _save_picture(options.output.with_suffix(".png"), frame.radiance, color.exposure(frame.radiance))


def reference(options: argparse.Namespace) -> None:
    """Accumulates a reference and writes it."""
    scene, camera = scene_settings(options).load()
    checkpoint = options.checkpoint or options.output.with_suffix(".safetensors")
    truth = accumulate_reference(
        scene, camera, spp=options.spp, seed=options.seed, checkpoint=checkpoint, progress=True
    )
    save_reference(options.output, truth)
    noise = float(truth.variance.mean(dtype=torch.float64).sqrt())
    _say(f"{options.output}: {scene.name}, {truth.count} samples per pixel, noise {noise:.3g} (RMS standard error)")
    _save_picture(options.output.with_suffix(".png"), truth.mean, color.exposure(truth.mean))
    _say(f"{checkpoint}: kept, so that a larger --spp can go on from here")


def denoise(options: argparse.Namespace) -> None:
    """Denoises a frame and writes the image."""
    frame = load_frame(options.frame)
    denoiser = NonHomogeneousAtrous(options.levels or METHODS[options.method], demodulate=options.demodulate)
    if options.parameters is not None:
        load_parameters(denoiser, options.parameters)
    with torch.no_grad():
        image = denoiser(frame).image
    levels = ", ".join(map(str, denoiser.levels))
    if options.output.suffix.lower() == ".exr":
        save_image(options.output, image)
        _say(f"{options.output}: linear radiance, denoised with {levels} passes by layer")
    exposure = color.exposure(image) if options.exposure is None else options.exposure
    _save_picture(options.output.with_suffix(".png"), image, exposure)


def compare(options: argparse.Namespace) -> None:
    """Runs the comparison, draws its figures, writes its page and prints its table."""
    _compare(compare_settings(options), options.output, options.reference)


def demo(options: argparse.Namespace) -> None:
    """Runs the comparison with the settings of the demo."""
    settings = PRESETS["demo"]
    height, width = settings.view.resolution
    _say(f"Comparing denoisers on the {settings.view.scene}, {width} x {height} pixels per eye: a minute or two.")
    _compare(settings, options.output)


def draw(options: argparse.Namespace) -> None:
    """Draws the figures of a comparison again."""
    from fovden.figures import draw_figures  # noqa: PLC0415 - matplotlib, only where figures are drawn

    for path in draw_figures(options.folder):
        _say(str(path))


def write_page(options: argparse.Namespace) -> None:
    """Writes the page of a comparison again."""
    from fovden.report import report_comparison  # noqa: PLC0415 - Jinja2, only where pages are written

    _say(str(report_comparison(options.folder)))


def _compare(settings: CompareSettings, folder: Path, reference: Path | None = None) -> None:
    from fovden.figures import draw_figures  # noqa: PLC0415
    from fovden.report import report_comparison  # noqa: PLC0415

    compare_denoisers(settings, folder, reference=reference)
    figures = draw_figures(folder)
    page = report_comparison(folder)
    _say(summary(read_metrics(folder)))
    _say(f"\nOpen {page} in a browser to flip between the images.")
    _say(f"Look at {figures[0]} for an overview; the other figures lie beside it.")
    _say(f"All numbers: {folder / 'metrics.csv'}; settings and versions: config.json and provenance.json beside it.")


def _save_picture(path: Path, radiance: Tensor, exposure: float) -> None:
    save_png(path, color.display(radiance, exposure), exposure=exposure)
    _say(f"{path}: exposure {exposure:.4g}, sRGB")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
