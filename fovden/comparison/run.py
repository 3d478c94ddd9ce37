"""The run itself: trace, foveate, denoise, measure, save."""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from fovden import metrics
from fovden.camera import Gaze, StereoCamera
from fovden.checks import require
from fovden.comparison.methods import METHODS, file_name
from fovden.comparison.settings import CompareSettings
from fovden.foveation import SampleMap, ThreeLayer, sample_map, uniform_map
from fovden.frame import Frame, Reference
from fovden.io import load_reference, save_frame, save_image, save_reference
from fovden.results import Measurement, Run
from fovden.tracer import CheckpointError, Scene, accumulate_reference, trace_frame, trace_gbuffer

__all__ = ["compare_denoisers"]

Result = TypeVar("Result")


def compare_denoisers(
    settings: CompareSettings,
    folder: str | os.PathLike[str],
    *,
    reference: str | os.PathLike[str] | None = None,
    progress: bool = True,
) -> metrics.Comparison:
    """Runs the comparison and writes its folder; the figures can be drawn from that alone.

    The folder gets ``config.json``, ``provenance.json`` and ``metrics.csv`` (see :mod:`fovden.results`),
    ``reference.exr``, the traced frames in ``frames/`` and the images of all methods in ``images/``. A reference that
    was interrupted is continued from ``reference.safetensors`` by the next run in the same folder.

    Args:
        settings: What is compared.
        folder: Where the results go.
        reference: A reference of the same view that exists already; ``None`` to make one.
        progress: Whether to name each stage, and to draw the reference's progress bar, on standard error.

    Returns:
        The scores.

    Raises:
        OSError: If a file is missing or cannot be written.
        ValueError: If a setting is out of range, or the reference is of another view.

    Example:
        >>> import tempfile
        >>> from fovden.comparison import SceneSettings
        >>> view = SceneSettings("cornell_box", resolution=(16, 16))
        >>> settings = CompareSettings(view, reference_spp=2, repeats=1)
        >>> scores = compare_denoisers(settings, tempfile.mkdtemp(), progress=False)
        >>> scores.methods[:2]
        ('Noisy, full', 'Noisy, foveated')
    """

    def announce(stage: str) -> str:
        if progress:
            sys.stderr.write(f"{settings.view.scene}: {stage}\n")
        return stage

    with Run(folder, _config(settings)) as run:
        with run.stage(announce("load scene")):
            scene, camera = settings.view.load()
        with run.stage(announce("build BVH")):
            _ = scene.bvh
        with run.stage(announce("warm up")):
            _warm_up(scene, camera, settings)
        gaze = Gaze.center(camera) if settings.gaze is None else Gaze(torch.tensor(settings.gaze))
        with run.stage(announce("trace frames")):
            seconds_gbuffer, _ = _timed(lambda: trace_gbuffer(scene, camera), settings.repeats)
            frames, seconds_trace, radii = _trace(scene, camera, gaze, settings)
        with run.stage(announce("reference")):
            truth = _reference(scene, camera, settings, run.folder, reference, progress)
        with run.stage(announce("denoise")):
            images, seconds_denoise = _denoise(frames, settings)
        with run.stage(announce("metrics")):
            scores = metrics.compare(images, truth, layer=frames["foveated"].layer)
        with run.stage(announce("save")):
            _save(run, frames, images, truth)
        measurements = [
            Measurement(scene.name, 0, score.view, score.method, score.region, score.metric, score.value)
            for score in scores.scores
        ]

        def record(method: str, metric: str, value: float, region: str = "whole") -> None:
            measurements.append(Measurement(scene.name, 0, "", method, region, metric, value))

        for method in METHODS:
            trace, denoise = seconds_trace[method.frame], seconds_denoise[method.name]
            record(method.name, "paths", float(frames[method.frame].counts.sum()))
            record(method.name, "seconds_gbuffer", seconds_gbuffer)
            record(method.name, "seconds_paths", max(trace - seconds_gbuffer, 0.0))
            record(method.name, "seconds_trace", trace)
            record(method.name, "seconds_denoise", denoise)
            record(method.name, "seconds_total", trace + denoise)
        record("Reference", "samples", float(truth.count))
        record("Reference", "standard_error", scores.reference_noise or 0.0)
        record("Reference", "exposure", scores.exposure)
        for number, radius in enumerate(radii):
            record("Foveation", "radius", radius, region=f"layer {number}")
        run.measurements += measurements
    return scores


def _config(settings: CompareSettings) -> dict[str, Any]:
    """The settings as JSON can hold them, each light with its kind."""
    config = asdict(settings)
    config["view"]["lights"] = [
        {
            "kind": type(light).__name__,
            **{
                name: f"image {tuple(value.shape)}" if isinstance(value, Tensor) else value
                for name, value in vars(light).items()
            },
        }
        for light in settings.view.lights
    ]
    config["methods"] = [method.name for method in METHODS]
    return config


def _warm_up(scene: Scene, camera: StereoCamera, settings: CompareSettings) -> None:
    """Compiles what is compiled on first use, so that no stage is charged for it."""
    small = camera.at(resolution=(16, 16))
    frame = trace_frame(scene, small, settings.spp, seed=settings.seed)
    trace_gbuffer(scene, small)
    for method in METHODS:
        if method.denoiser is not None:
            with torch.no_grad():
                method.denoiser(demodulate=settings.demodulate)(frame)


def _trace(
    scene: Scene, camera: StereoCamera, gaze: Gaze, settings: CompareSettings
) -> tuple[dict[str, Frame], dict[str, float], tuple[float, ...]]:
    """The frames by name, the seconds that each took, and the radii of the layers."""
    foveated = sample_map(ThreeLayer(), camera, gaze=gaze, spp=settings.spp, seed=settings.seed)
    equal_paths = uniform_map(camera, foveated.mean_spp, seed=settings.seed)
    frames: dict[str, Frame] = {}
    seconds: dict[str, float] = {}
    maps: dict[str, SampleMap | int] = {"full": settings.spp, "foveated": foveated, "equal_paths": equal_paths}
    for name, samples in maps.items():
        trace = partial(trace_frame, scene, camera, samples, seed=settings.seed)
        seconds[name], frames[name] = _timed(trace, settings.repeats)
    return frames, seconds, foveated.radii


def _denoise(frames: Mapping[str, Frame], settings: CompareSettings) -> tuple[dict[str, Tensor], dict[str, float]]:
    """The images by method, and the seconds of the denoiser alone."""
    images: dict[str, Tensor] = {}
    seconds: dict[str, float] = {}
    for method in METHODS:
        frame = frames[method.frame]
        if method.denoiser is None:
            images[method.name], seconds[method.name] = frame.radiance, 0.0
            continue
        if method.ignore_mask:
            frame = replace(frame, counts=torch.ones_like(frame.counts))
        denoiser = method.denoiser(demodulate=settings.demodulate)
        with torch.no_grad():
            seconds[method.name], denoised = _timed(partial(denoiser, frame), settings.repeats)
        images[method.name] = denoised.image
    return images, seconds


def _reference(
    scene: Scene,
    camera: StereoCamera,
    settings: CompareSettings,
    folder: Path,
    given: str | os.PathLike[str] | None,
    progress: bool,
) -> Reference:
    if given is None:
        checkpoint = folder / "reference.safetensors"
        spp, seed = settings.reference_spp, settings.seed
        accumulate = partial(
            accumulate_reference, scene, camera, spp=spp, seed=seed, checkpoint=checkpoint, progress=progress
        )
        try:
            return accumulate()
        except CheckpointError:  # left by a run with other settings, whose other files are replaced as well
            checkpoint.unlink()
            return accumulate()
    reference = load_reference(given)
    views = camera.views
    same = reference.camera is not None and reference.camera.resolution == views.resolution
    if same and reference.camera is not None:
        for name in ("origin", "rotation", "bounds"):
            ours, theirs = getattr(views, name), getattr(reference.camera, name)
            same &= ours.shape == theirs.shape and bool(torch.allclose(ours, theirs, atol=1e-5))
    require(same, str(given), "the reference of another view", "one of this camera and resolution")
    return reference


def _save(run: Run, frames: Mapping[str, Frame], images: Mapping[str, Tensor], truth: Reference) -> None:
    for name in ("frames", "images"):
        (run.folder / name).mkdir(exist_ok=True)
    for name, frame in frames.items():
        save_frame(run.folder / "frames" / f"{name}.exr", frame)
    for method in METHODS:
        if method.denoiser is not None:
            save_image(run.folder / "images" / f"{file_name(method.name)}.exr", images[method.name])
    save_reference(run.folder / "reference.exr", truth)


def _timed(call: Callable[[], Result], repeats: int) -> tuple[float, Result]:
    """The median of the seconds that a call takes, and what it returned last."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = call()
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds), result
