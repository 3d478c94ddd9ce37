"""The command line: ``python -m fovden`` or ``fovden``."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn, TextIO, TypedDict

from fovden.cli import commands, options, scenes, tune

__all__ = ["build_parser", "main"]

DESCRIPTION = """\
Foveated, path-traced stereo frames and their denoising.

A scene is traced into a noisy frame of two eyes (render), or into a converged reference (reference); a frame, this
program's or another renderer's, becomes a clean image (denoise); compare does all of it with several methods and
measures them. Start with:  fovden demo
"""

EPILOG = """\
examples:
  fovden demo                                           # everything once, in two minutes
  fovden render atrium -o frame.exr                     # a foveated frame and a picture of it
  fovden denoise frame.exr --method nh3ld -o clean.exr
  fovden COMMAND --help                                 # options, with defaults and units
"""

RENDER = """\
Traces one noisy stereo frame, with its G-buffer, into a multi-layer OpenEXR file, and a PNG next to it.

With --foveation three-layer (the default) all pixels near the gaze are traced, then ever fewer, then every other one;
the G-buffer is complete everywhere.
"""

RENDER_EXAMPLES = """\
examples:
  fovden render atrium --resolution 540x480 -o frame.exr
  fovden render atrium --gaze 300,540 --seed 7 -o left.exr
  fovden render sponza.obj --sun 0.15,-1,0.25:12 --point 0,4.5,-0.4:40 \\
      --eye -11.5,2.2,-0.4 --target 0,3.4,0 --fov-x-deg 75 -o sponza.exr
"""

REFERENCE = """\
Accumulates many samples per pixel into a reference: the mean, the variance of that mean, and their number.

Work is kept in a checkpoint every quarter of a minute. Press Ctrl-C whenever you like: the same command goes on from
there, and so does one with a larger --spp.
"""

REFERENCE_EXAMPLES = """\
examples:
  fovden reference atrium --resolution 540x480 --spp 256 -o reference.exr
  fovden reference atrium --resolution 540x480 --spp 1024 -o reference.exr    # goes on from 256
"""

DENOISE = """\
Denoises a frame: one of this program's, or any OpenEXR file with R,G,B, world-space normals (N.X, N.Y, N.Z) and
positions (P.X, P.Y, P.Z), and better albedo, Z, and spp or mask too.

The filter is a masked, edge-avoiding a-trous filter with 5 x 5 taps, whose passes have steps 2^(L-1), ..., 2, 1 pixels;
each foveation layer has its own number of passes L.
"""

DENOISE_EXAMPLES = """\
examples:
  fovden denoise frame.exr -o clean.exr                 # nh3ld: 3, 4 and 5 passes, from the gaze outwards
  fovden denoise frame.exr --method base -o clean.png   # 5 passes everywhere, the picture alone
  fovden denoise frame.exr --levels 2,3,4 --demodulate -o clean.exr
"""

COMPARE = """\
Traces a scene once with and once without foveation, denoises with every method, and measures all against a reference.

Rows: the noisy inputs; the mask ignored; Base (every pixel traced, one layer); NH2LD and NH3LD (foveated, two and three
layers); Base with as many paths as the foveated frame has, spread evenly. The folder gets config.json, provenance.json,
metrics.csv in long form, the frames, images and reference as OpenEXR, and figures and report.html made of these files.
"""

COMPARE_EXAMPLES = """\
examples:
  fovden compare cornell_box --resolution 128x128 --reference-spp 64 -o out/box
  fovden compare sponza.obj --sun 0.15,-1,0.25:12 --point 0,4.5,-0.4:40 \\
      --eye -11.5,2.2,-0.4 --target 0,3.4,0 --fov-x-deg 75 -o out/sponza
"""

DEMO = """\
Compares Base, NH2LD and NH3LD on the atrium, a colonnaded court of 262,267 triangles, at 320 x 360 pixels per eye,
against a reference of 256 samples per pixel. It takes a minute or two, prints a table, and says where to look.
"""

REPORT = """\
Writes a comparison's page again, from the files in its folder alone: report.html, one file that opens in any browser
without a network, in which to flip between the images, split them, zoom, read pixels, and sort and copy the tables.
"""

REPORT_EXAMPLES = """\
examples:
  fovden report out/demo
"""

SCENES = """\
Lists the scenes made in code with their numbers of triangles and lights, and writes a picture of each from each of its
views.
"""

SCENES_EXAMPLES = """\
examples:
  fovden scenes                                         # all of them, in a few minutes
  fovden scenes --list                                  # without pictures
  fovden scenes forest --detail 1000000 --spp 256 --resolution 1080x1440 -o out/forest
"""

FIGURES = """\
Draws the figures of a comparison again, from the files in its folder alone.
"""

FIGURES_EXAMPLES = """\
examples:
  fovden figures out/demo
"""


def build_parser() -> argparse.ArgumentParser:
    """Returns the parser of the whole command line.

    Example:
        >>> build_parser().parse_args(["demo"]).output
        PosixPath('out/demo')
    """
    parser = _Parser(prog="fovden", **_texts(DESCRIPTION, EPILOG))
    add = parser.add_subparsers(title="commands", metavar="COMMAND", required=True).add_parser

    for add_command in (
        _add_render,
        _add_reference,
        _add_denoise,
        _add_compare,
        _add_tune,
        _add_demo,
        _add_scenes,
        _add_figures,
        _add_report,
    ):
        add_command(add)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status.

    Args:
        arguments: The words after the program's name; ``None`` for those of the process.

    Returns:
        0 if all went well, 2 after bad input (one line on standard error says which), 130 after Ctrl-C.

    Example:
        >>> import contextlib
        >>> with contextlib.redirect_stderr(sys.stdout):
        ...     main(["denoise", "nowhere.exr", "-o", "clean.png"])
        fovden: error: nowhere.exr: no such file
        2
    """
    words = options.join_negative_values(sys.argv[1:] if arguments is None else arguments)
    try:
        parsed = build_parser().parse_args(words)
    except SystemExit as end:  # argparse has printed its help or its error
        return int(end.code or 0)
    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = _show_warning
        try:
            parsed.command(parsed)
        except KeyboardInterrupt:
            sys.stderr.write("\nfovden: interrupted\n")
            return 130
        except (OSError, TypeError, ValueError) as error:
            message = " ".join(str(error).split())
            sys.stderr.write(f"fovden: error: {message}\n")
            return 2
    return 0


def _add_render(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("render", help="trace a noisy frame", **_texts(RENDER, RENDER_EXAMPLES))
    options.add_scene(parser)
    _add_sampling(parser, spp=4, spp_help="samples per traced pixel")
    parser.add_argument(
        "--foveation",
        choices=("none", "three-layer"),
        default="three-layer",
        help="which pixels are traced; default: three-layer",
    )
    options.add_gaze(parser)
    _add_output(parser, ".exr", help="the frame; the PNG beside it has the same name")
    parser.set_defaults(command=commands.render)


def _add_reference(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("reference", help="accumulate a converged image", **_texts(REFERENCE, REFERENCE_EXAMPLES))
    options.add_scene(parser)
    _add_sampling(parser, spp=1024, spp_help="samples per pixel in all")
    parser.add_argument(
        "--checkpoint",
        type=options.output(".safetensors"),
        metavar="FILE",
        help="where unfinished work is kept and found; default: the output's name with .safetensors",
    )
    _add_output(parser, ".exr", help="the reference; the PNG beside it has the same name")
    parser.set_defaults(command=commands.reference)


def _add_denoise(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("denoise", help="clean a frame", **_texts(DENOISE, DENOISE_EXAMPLES))
    parser.add_argument("frame", type=Path, metavar="FRAME", help="the frame, an OpenEXR file")
    parser.add_argument("--method", choices=list(tune.METHODS), default="nh3ld", help="passes by layer; default: nh3ld")
    parser.add_argument(
        "--levels",
        type=options.levels,
        metavar="L,...",
        help="passes of each layer, innermost first; overrides --method",
    )
    _add_demodulate(parser)
    parser.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="learned widths, written by `fovden tune` with the same method and light",
    )
    parser.add_argument(
        "--exposure",
        type=options.positive_number,
        metavar="E",
        help="scale from radiance to the picture; default: log-average luminance to 0.18",
    )
    _add_output(parser, ".exr", ".png", help="the image: .exr for radiance and a PNG beside it, .png for that alone")
    parser.set_defaults(command=commands.denoise)


def _add_compare(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("compare", help="measure methods against a reference", **_texts(COMPARE, COMPARE_EXAMPLES))
    options.add_scene(parser)
    _add_sampling(parser, spp=4, spp_help="samples per traced pixel")
    parser.add_argument(
        "--reference-spp",
        type=options.positive_integer,
        default=1024,
        metavar="N",
        help="samples per pixel of the reference; default: 1024",
    )
    parser.add_argument("--reference", type=Path, metavar="FILE", help="a reference of this view that exists already")
    parser.add_argument(
        "--repeats",
        type=options.positive_integer,
        default=3,
        metavar="N",
        help="timings, of which the median; default: 3",
    )
    _add_demodulate(parser)
    options.add_gaze(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the results")
    parser.set_defaults(command=commands.compare)


def _add_tune(add: Callable[..., argparse.ArgumentParser]) -> None:
    tune.add_options(add("tune", help="learn parameters", **_texts(tune.DESCRIPTION, tune.EXAMPLES)))


def _add_demo(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("demo", help="a comparison on the atrium, in two minutes", **_texts(DEMO, ""))
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("out/demo"),
        metavar="DIR",
        help="folder for the results; default: out/demo",
    )
    parser.set_defaults(command=commands.demo)


def _add_scenes(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("scenes", help="list the scenes made in code, with pictures", **_texts(SCENES, SCENES_EXAMPLES))
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="names; default: all")
    parser.add_argument(
        "--detail", type=options.positive_integer, metavar="N", help="number of triangles; default: each scene's own"
    )
    _add_sampling(parser, spp=64, spp_help="samples per pixel of the pictures")
    options.add_resolution(parser, default=(480, 640))
    parser.add_argument("--list", action="store_true", help="write no pictures")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("out/scenes"),
        metavar="DIR",
        help="folder for the pictures; default: out/scenes",
    )
    parser.set_defaults(command=scenes.list_scenes)


def _add_figures(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("figures", help="draw a comparison's figures again", **_texts(FIGURES, FIGURES_EXAMPLES))
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of a comparison")
    parser.set_defaults(command=commands.draw)


def _add_report(add: Callable[..., argparse.ArgumentParser]) -> None:
    parser = add("report", help="write a comparison's page again", **_texts(REPORT, REPORT_EXAMPLES))
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of a comparison")
    parser.set_defaults(command=commands.write_page)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line each."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"fovden: error: {message} (see {self.prog} --help)\n")


class _Texts(TypedDict):
    description: str
    epilog: str
    formatter_class: type[argparse.HelpFormatter]


def _texts(description: str, epilog: str) -> _Texts:
    return {
        "description": description,
        "epilog": epilog,
        "formatter_class": argparse.RawDescriptionHelpFormatter,
    }


def _add_sampling(parser: argparse.ArgumentParser, spp: int, spp_help: str) -> None:
    parser.add_argument(
        "--spp", type=options.positive_integer, default=spp, metavar="N", help=f"{spp_help}; default: {spp}"
    )
    parser.add_argument(
        "--seed", type=options.seed, default=0, metavar="N", help="seed of all random numbers; default: 0"
    )


def _add_demodulate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--demodulate", action="store_true", help="filter light without albedo, which keeps textures sharp"
    )


def _add_output(parser: argparse.ArgumentParser, *endings: str, help: str) -> None:  # noqa: A002 - argparse's word
    parser.add_argument("-o", "--output", type=options.output(*endings), required=True, metavar="FILE", help=help)


def _show_warning(
    message: Warning | str,
    category: type[Warning],  # noqa: ARG001 - the signature is that of warnings.showwarning
    filename: str,  # noqa: ARG001
    lineno: int,  # noqa: ARG001
    file: TextIO | None = None,  # noqa: ARG001
    line: str | None = None,  # noqa: ARG001
) -> None:
    sys.stderr.write(f"fovden: warning: {' '.join(str(message).split())}\n")


if __name__ == "__main__":
    sys.exit(main())
