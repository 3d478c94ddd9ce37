"""The options of the command line, and the settings that they mean."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from fovden.camera import FHD, QUEST2, Camera, Gaze, StereoCamera
from fovden.comparison import CompareSettings, SceneSettings
from fovden.tracer.lights import DirectionalLight, EnvironmentLight, Light, PointLight

__all__ = [
    "add_gaze",
    "add_scene",
    "compare_settings",
    "gaze_of",
    "join_negative_values",
    "levels",
    "numbers",
    "output",
    "positive_integer",
    "positive_number",
    "scene_settings",
    "seed",
]

RESOLUTIONS = {"fhd": FHD, "quest2": QUEST2}


def numbers(text: str, count: int) -> tuple[float, ...]:
    """Returns the numbers of a comma-separated list.

    Example:
        >>> numbers("0.15,-1,0.25", 3)
        (0.15, -1.0, 0.25)
    """
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        wanted = "a number" if count == 1 else f"{count} numbers separated by commas"
        raise argparse.ArgumentTypeError(f"expected {wanted}, got {text!r}")
    return values


def positive_integer(text: str) -> int:
    """Returns an integer of at least 1.

    Example:
        >>> positive_integer("4")
        4
    """
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return int(text)


def positive_number(text: str) -> float:
    """Returns a number above 0.

    Example:
        >>> positive_number("0.5")
        0.5
    """
    (value,) = numbers(text, 1)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text!r}")
    return value


def seed(text: str) -> int:
    """Returns a seed: an integer from 0 to 2^32 - 1.

    Example:
        >>> seed("7")
        7
    """
    if not text.isascii() or not text.isdigit() or int(text) > 0xFFFFFFFF:
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 to {0xFFFFFFFF}, got {text!r}")
    return int(text)


def levels(text: str) -> tuple[int, ...]:
    """Returns numbers of passes, one for each layer.

    Example:
        >>> levels("3,4,5")
        (3, 4, 5)
    """
    parts = text.split(",")
    if not all(part.isascii() and part.isdigit() and int(part) >= 1 for part in parts):
        raise argparse.ArgumentTypeError(f"expected whole numbers of at least 1 such as 3,4,5, got {text!r}")
    return tuple(int(part) for part in parts)


def output(*endings: str) -> Callable[[str], Path]:
    """Returns a converter for names of files to write: the name's end and the folder are checked before any work.

    Example:
        >>> output(".exr")("frame.exr").name
        'frame.exr'
    """

    def convert(text: str) -> Path:
        path = Path(text)
        if path.suffix.lower() not in endings:
            raise argparse.ArgumentTypeError(f"expected a name that ends in {' or '.join(endings)}, got {text!r}")
        if not path.parent.is_dir():
            raise argparse.ArgumentTypeError(f"the folder {path.parent} does not exist")
        return path

    return convert


def join_negative_values(arguments: Sequence[str]) -> list[str]:
    """Joins options with values that begin with a minus sign, which would be taken for options themselves.

    Example:
        >>> join_negative_values(["--eye", "-3,2,0", "-o", "frame.exr"])
        ['--eye=-3,2,0', '-o', 'frame.exr']
    """
    joined: list[str] = []
    for argument in arguments:
        negative = re.match(r"-[.\d]", argument)
        if negative and joined and joined[-1].startswith("--") and "=" not in joined[-1]:
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def add_scene(parser: argparse.ArgumentParser, *, optional: bool = False) -> None:
    """Adds the options that say which scene is seen, in which light, from where, and how large.

    Args:
        parser: Receives the options.
        optional: Whether the scene may be left out.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_scene(parser)
        >>> parser.parse_args(["atrium", "--sky", "1"]).lights
        [EnvironmentLight(radiance=(1.0, 1.0, 1.0))]
    """
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?" if optional else None,
        help="a scene made in code (`fovden scenes` lists them) or an OBJ, glTF, GLB or PLY file in metres, y up",
    )
    light = parser.add_argument_group("light, in addition to the scene's own (a VALUE is a number or r,g,b)")
    light.add_argument(
        "--sun",
        dest="lights",
        action="append",
        type=_sun,
        metavar="DX,DY,DZ:VALUE",
        help="directional light: the direction in which it travels, and its irradiance in W/m^2 across it",
    )
    light.add_argument(
        "--point",
        dest="lights",
        action="append",
        type=_point,
        metavar="X,Y,Z:VALUE",
        help="point light: position in metres, and radiant intensity in W/sr",
    )
    light.add_argument(
        "--sky",
        dest="lights",
        action="append",
        type=_sky,
        metavar="VALUE",
        help="constant environment: radiance in W/(m^2 sr)",
    )
    light.add_argument(
        "--skip-material",
        dest="skip_materials",
        action="append",
        metavar="PATTERN",
        help="leave out faces whose material's name matches, for example '*glass*'; files only",
    )
    camera = parser.add_argument_group("camera, instead of the scene's own")
    camera.add_argument("--view", metavar="NAME", help="one of the scene's other views; `fovden scenes` names them")
    camera.add_argument("--eye", type=_point_in_space, metavar="X,Y,Z", help="midway between the eyes, metres")
    camera.add_argument("--target", type=_point_in_space, metavar="X,Y,Z", help="point looked at, metres")
    camera.add_argument("--fov-x-deg", type=_number, metavar="DEG", help="horizontal field of view, degrees")
    camera.add_argument("--eye-separation", type=_number, metavar="M", help="distance between the eyes, metres")
    add_resolution(camera, default=FHD)


def add_resolution(parser: argparse._ActionsContainer, default: tuple[int, int]) -> None:
    """Adds the option that says how large an eye's image is.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_resolution(parser, default=(32, 32))
        >>> parser.parse_args(["--resolution", "fhd"]).resolution
        (1080, 960)
    """
    named = [name for name, resolution in RESOLUTIONS.items() if resolution == default]
    parser.add_argument(
        "--resolution",
        type=_resolution,
        default=default,
        metavar="HxW",
        help="height x width of one eye in pixels, or fhd (1080x960) or quest2 (1920x1832); "
        f"default: {named[0] if named else f'{default[0]}x{default[1]}'}",
    )


def add_gaze(parser: argparse.ArgumentParser) -> None:
    """Adds the option that says where the eyes look.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_gaze(parser)
        >>> parser.parse_args(["--gaze", "480,540"]).gaze
        ((480.0, 540.0),)
    """
    parser.add_argument(
        "--gaze",
        type=_gaze,
        metavar="X,Y[/X,Y]",
        help="where the eyes look, in pixels from the upper left corner, one for both or left/right; may lie outside "
        "the image; default: the centre",
    )


def scene_settings(options: argparse.Namespace) -> SceneSettings:
    """Returns the settings that the options of :func:`add_scene` mean.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_scene(parser)
        >>> scene_settings(parser.parse_args(["atrium", "--resolution", "quest2"])).resolution
        (1920, 1832)
    """
    return SceneSettings(
        scene=options.scene,
        lights=tuple(options.lights or ()),
        skip_materials=tuple(options.skip_materials or ()),
        view=options.view,
        eye=options.eye,
        target=options.target,
        fov_x_deg=options.fov_x_deg,
        eye_separation=options.eye_separation,
        resolution=options.resolution,
    )


def compare_settings(options: argparse.Namespace) -> CompareSettings:
    """Returns the settings that the options of a comparison mean.

    Example:
        >>> from fovden.__main__ import build_parser
        >>> options = build_parser().parse_args(["compare", "atrium", "-o", "results", "--spp", "2"])
        >>> compare_settings(options).spp
        2
    """
    gaze = None if options.gaze is None else (options.gaze * 2)[:2]
    return CompareSettings(
        view=scene_settings(options),
        spp=options.spp,
        reference_spp=options.reference_spp,
        seed=options.seed,
        gaze=gaze,
        demodulate=options.demodulate,
        repeats=options.repeats,
    )


def gaze_of(options: argparse.Namespace, camera: Camera | StereoCamera) -> Gaze:
    """Returns the gaze that the option of :func:`add_gaze` means.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_gaze(parser)
        >>> camera = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(4, 6))
        >>> gaze_of(parser.parse_args([]), camera).pixels
        tensor([[3., 2.],
                [3., 2.]])
    """
    if options.gaze is None:
        return Gaze.center(camera)
    return Gaze(torch.tensor((options.gaze * 2)[:2]))


def _number(text: str) -> float:
    return numbers(text, 1)[0]


def _point_in_space(text: str) -> tuple[float, ...]:
    return numbers(text, 3)


def _value(text: str) -> Any:
    return numbers(text, 3) if "," in text else numbers(text, 1)[0]


def _light(make: Callable[[Any, Any], Light], text: str) -> Light:
    vector, colon, value = text.partition(":")
    if not colon:
        raise argparse.ArgumentTypeError(f"expected x,y,z:value, got {text!r}")
    return _checked(lambda: make(numbers(vector, 3), _value(value)))


def _checked(make: Callable[[], Light]) -> Light:
    try:
        return make()
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _sun(text: str) -> Light:
    return _light(DirectionalLight, text)


def _point(text: str) -> Light:
    return _light(PointLight, text)


def _sky(text: str) -> Light:
    return _checked(lambda: EnvironmentLight(_value(text)))


def _resolution(text: str) -> tuple[int, int]:
    if text.lower() in RESOLUTIONS:
        return RESOLUTIONS[text.lower()]
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", text.lower())
    if match is None:
        names = ", ".join(RESOLUTIONS)
        raise argparse.ArgumentTypeError(f"expected height x width such as 540x480, or {names}; got {text!r}")
    return int(match[1]), int(match[2])


def _gaze(text: str) -> tuple[tuple[float, ...], ...]:
    eyes = tuple(numbers(part, 2) for part in text.split("/"))
    if len(eyes) > 2:
        raise argparse.ArgumentTypeError(f"expected one gaze or two, left/right, got {text!r}")
    return eyes
