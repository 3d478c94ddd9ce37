"""The command that learns a denoiser's parameters: from frames in files, or from a scene that it traces."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import torch

from fovden import color, distributed, metrics
from fovden.checks import require
from fovden.cli import options as common
from fovden.filters import Denoiser, NonHomogeneousAtrous
from fovden.foveation import ThreeLayer
from fovden.frame import Frame, Reference
from fovden.io import load_frame, load_reference, save_png
from fovden.tracer import FrameDataset, Sequence, accumulate_reference
from fovden.tuning import ImageError, fit, readable
from fovden.tuning.objective import TERMS

__all__ = ["DESCRIPTION", "EXAMPLES", "METHODS", "add_options", "tune"]

METHODS = {"base": (5,), "nh2ld": (3, 5), "nh3ld": (3, 4, 5)}
"""Passes of each layer, by the name of the method."""

DESCRIPTION = """\
Learns the widths of the edge-stopping functions from noisy frames and a reference of what they should be.

The frames are files with a reference each, or are traced: several frames of one view, with noise of their own, and one
reference. The last frames are not fitted to: they say when to stop, and how good the result is. The folder gets
parameters.safetensors for `fovden denoise --parameters`, parameters.json for reading, history.csv and history.png, and
pictures of the first frame held out, before and after. Press Ctrl-C whenever you like: the same command goes on.
Processes that torchrun starts share the work.
"""

EXAMPLES = """\
examples:
  fovden tune atrium --resolution 540x480 --reference-spp 256 -o out/tuned
  fovden tune --pair a.exr a_reference.exr --pair b.exr b_reference.exr --held-out 1 -o out/tuned
  fovden denoise frame.exr --parameters out/tuned/parameters.safetensors -o clean.exr
"""

Pair = tuple[Frame, Reference]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the command.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_options(parser)
        >>> parser.parse_args(["atrium", "-o", "tuned", "--error", "l1=1,ssim=0.2"]).error
        {'l1': 1.0, 'ssim': 0.2}
    """
    common.add_scene(parser, optional=True)
    parser.add_argument(
        "--pair", dest="pairs", action="append", nargs=2, type=Path, metavar=("FRAME", "REFERENCE"), default=[],
        help="a noisy frame and its reference, OpenEXR files, instead of a scene; may be repeated",
    )  # fmt: skip
    integer = common.positive_integer
    parser.add_argument("--method", choices=list(METHODS), default="nh3ld", help="passes by layer; default: nh3ld")
    parser.add_argument("--demodulate", action="store_true", help="filter light without albedo")
    parser.add_argument("--spp", type=integer, default=4, metavar="N", help="samples per traced pixel; default: 4")
    parser.add_argument("--frames", type=integer, default=6, metavar="N", help="frames to trace; default: 6")
    parser.add_argument("--held-out", type=integer, default=1, metavar="N", help="of them, not fitted to; default: 1")
    parser.add_argument(
        "--reference-spp", type=integer, default=256, metavar="N", help="samples of the reference; default: 256"
    )
    parser.add_argument(
        "--error", type=_terms, default={"l1": 1.0, "ssim": 0.2}, metavar="NAME=WEIGHT,...",
        help=f"what is made small, of {', '.join(TERMS)}; default: l1=1,ssim=0.2",
    )  # fmt: skip
    parser.add_argument("--steps", type=integer, default=100, metavar="N", help="steps of Adam; default: 100")
    parser.add_argument("--seed", type=common.seed, default=0, metavar="N", help="seed of all numbers; default: 0")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the results")
    parser.set_defaults(command=tune)


def tune(options: argparse.Namespace) -> None:
    """Fits, writes the folder, and prints what was gained; in each of the processes that ``torchrun`` started."""
    with distributed.joined():
        _tune(options)


def _tune(options: argparse.Namespace) -> None:
    options.output.mkdir(parents=True, exist_ok=True)
    pairs = list(_pairs(options))
    count = len(pairs) - options.held_out
    require(count > 0, "--held-out", options.held_out, f"fewer than the {len(pairs)} frames there are")
    denoiser = NonHomogeneousAtrous(METHODS[options.method], demodulate=options.demodulate)
    frame, truth = pairs[count]
    before, widths = _denoised(denoiser, frame), readable(denoiser)
    found = fit(
        denoiser,
        pairs[:count],
        ImageError(options.error),
        held_out=pairs[count:],
        steps=options.steps,
        batch_size=distributed.world_size(),
        seed=options.seed,
        folder=options.output,
    )
    if distributed.rank() > 0:
        return
    from fovden.figures import draw_history  # noqa: PLC0415 - matplotlib, only where figures are drawn

    images = {"before": before, "after": _denoised(denoiser, frame)}
    exposure = color.exposure(truth.mean)
    for name, image in {"noisy": frame.radiance, **images, "reference": truth.mean}.items():
        save_png(options.output / f"{name}.png", color.display(image, exposure), exposure=exposure)
    draw_history(options.output)
    say = sys.stdout.write
    for name, width in readable(denoiser).items():
        say(f"{name:32} {widths[name]:9.4g} -> {width:9.4g}\n")
    say(f"\n{metrics.compare(images, truth, layer=frame.layer)}\n")
    first, best = found.history[0].held_out_loss, found.best.held_out_loss
    say(f"\nFrames held out: error {first:.4g} -> {best:.4g} at step {found.best.step}\n")
    say(f"{options.output}: parameters.safetensors, parameters.json, history.csv, history.png, before.png, after.png\n")


def _pairs(options: argparse.Namespace) -> Iterator[Pair]:
    """The frames and their references, from files or traced."""
    require((options.scene is None) != (not options.pairs), "SCENE", options.scene, "a scene, or --pair, not both")
    for frame, reference in options.pairs:
        yield load_frame(frame), load_reference(reference)
    if options.scene is None:
        return
    scene, camera = common.scene_settings(options).load()
    first = distributed.rank() == 0
    checkpoint = options.output / "reference.safetensors" if first else None
    truth = accumulate_reference(
        scene, camera, spp=options.reference_spp, seed=options.seed, checkpoint=checkpoint, progress=first
    )
    falloff = None if options.method == "base" else ThreeLayer()
    frames = FrameDataset(Sequence(scene, camera, frames=1), falloff, options.spp, options.seed, draws=options.frames)
    for index in range(len(frames)):
        yield frames[index][0], truth


def _denoised(denoiser: Denoiser, frame: Frame) -> torch.Tensor:
    with torch.no_grad():
        return denoiser(frame).image


def _terms(text: str) -> dict[str, float]:
    terms = {}
    for part in text.split(","):
        name, _, weight = part.partition("=")
        if name not in TERMS:
            raise argparse.ArgumentTypeError(f"expected names of {', '.join(TERMS)}, got {name!r}")
        terms[name] = common.positive_number(weight or "1")
    return terms
