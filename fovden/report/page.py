"""The page itself: images, reference and tables in, one file out."""

from __future__ import annotations

import codecs
import os
from collections.abc import Mapping, Sequence
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray
from torch import Tensor

from fovden import color, metrics
from fovden.camera import Gaze
from fovden.checks import ShapeError, require, require_number, require_shapes, require_tensor
from fovden.colormap import MAGMA, NO_VALUE
from fovden.frame import Reference
from fovden.io import atomic_write
from fovden.metrics.image import RELATIVE_EPS, WINDOW
from fovden.preview import finite_exposure
from fovden.report.coding import (
    COARSER_STEPS,
    KNEE,
    STEPS,
    encode_image,
    encode_map,
    encode_text,
    image_codes,
    most_alike,
)
from fovden.report.scales import error_scales
from fovden.report.tables import Table, quality_tables

__all__ = ["eye_names", "write_report"]

REFERENCE = "Reference"
FLIP_LEVELS = 64
"""Levels in which FLIP's map is stored: to within 1/128 of its range from 0 to 1."""

SCRIPTS = ("codec.js", "display.js", "pictures.js", "stage.js", "tables.js", "main.js")


def write_report(
    path: str | os.PathLike[str],
    images: Mapping[str, Tensor],
    reference: Reference | Tensor | None = None,
    *,
    title: str = "Comparison",
    subtitle: str = "",
    exposure: float | None = None,
    gaze: Gaze | None = None,
    radii: Sequence[float] = (),
    layer: Tensor | None = None,
    samples: Mapping[str, Tensor] | None = None,
    captions: Mapping[str, str] | None = None,
    tables: Sequence[Table] | None = None,
    notes: Sequence[str] = (),
    provenance: Mapping[str, object] | None = None,
    pixels_per_degree: float = metrics.PIXELS_PER_DEGREE,
    size_limit: float = 40e6,
) -> Path:
    """Writes a page that compares images, with or without a reference, and returns its path.

    Images are stored to within 0.87 % of their radiance (:mod:`fovden.report.coding`), so that the page shows them at
    any exposure. With a reference there are maps of three errors: the root mean square over the channels of the
    difference of the display values, at the exposure that the page shows; FLIP at ``exposure``; and the squared error
    relative to the squared reference. Values that are not numbers are shown in cyan.

    Args:
        path: The file; its folder must exist.
        images: Linear radiance by name, shape (v, 3, h, w) each, the left eye first.
        reference: What the images should be, or ``None``: then there are no error maps, and the page says so.
        title: The page's title.
        subtitle: A line beside it.
        exposure: Scale from radiance to the display, above 0; ``None`` means :func:`fovden.color.exposure` of the
            reference, or else of the first image.
        gaze: Where each eye looks.
        radii: Radii of the layers' circles around the gaze in pixels, from the inside out.
        layer: Foveation layers, integers from 0 to 255, shape (v, 1, h, w).
        samples: Samples per pixel by the image's name, shape (v, 1, h, w); the page shows up to 255.
        captions: A short line below an image's name; ``None`` means its scores.
        tables: Tables below the images; ``None`` means the scores of the images that are finite.
        notes: Paragraphs above the tables.
        provenance: What else the foot of the page tells, by name: text, numbers, lists or mappings of these.
        pixels_per_degree: Pixels per degree of visual angle for FLIP.
        size_limit: Bytes above which the images are stored in coarser steps, 1.25 % or at last 1.75 %.

    Returns:
        The path.

    Raises:
        ShapeError: If the images differ in size from each other, from the reference or from a map.
        TypeError: If an image is not a tensor.
        ValueError: If there is no image, a name is taken or unknown, or a number is out of range.
        OSError: If the file cannot be written; then there is none.

    Example:
        >>> import tempfile
        >>> truth = torch.rand(2, 3, 16, 16)
        >>> path = Path(tempfile.mkdtemp()) / "report.html"
        >>> write_report(path, {"dark": truth / 2}, truth, title="Half the light").name
        'report.html'
        >>> "<title>Half the light</title>" in path.read_text(encoding="utf-16")
        True
    """
    path = _writable(Path(path))
    pictures, sizes = _checked(images, reference)
    truth = pictures.get(REFERENCE) if reference is not None else None
    if exposure is None:
        exposure = finite_exposure(truth if truth is not None else next(iter(pictures.values())))
    require_number("exposure", exposure, above=0)
    eyes = eye_names(sizes["v"])
    if tables is None:
        tables, scores = _measured(pictures, reference, layer, exposure, pixels_per_degree)
        captions = scores if captions is None else captions
    blobs = _Blobs()
    listed = _listed(blobs, pictures, samples or {}, captions or {}, sizes)
    layers = None if layer is None else blobs.add_map("layer", layer, sizes)
    flips = _add_flip(listed, blobs, pictures, truth, exposure, pixels_per_degree)
    steps = _add_images(listed, blobs, pictures, KNEE / exposure, size_limit)
    report = {
        "views": sizes["v"],
        "height": sizes["h"],
        "width": sizes["w"],
        "eyes": eyes,
        "images": listed,
        "reference": None if truth is None else len(listed) - 1,
        "exposure": exposure,
        "steps": steps,
        "knee": KNEE / exposure,
        "relative_eps": RELATIVE_EPS,
        "flip_levels": FLIP_LEVELS,
        "colours": bytes(MAGMA.flatten().tolist()).hex(),
        "no_value": NO_VALUE,
        "layer": layers,
        "scales": []
        if truth is None
        else error_scales(pictures, truth, exposure, pixels_per_degree if flips else None),
        **_overlay(gaze, radii, sizes),
    }
    page = _template().render(
        title=title,
        subtitle=subtitle,
        version=metadata.version("fovden"),
        report=report,
        orders=_orders(eyes),
        notes=notes,
        tables=tables,
        provenance=_provenance(exposure, steps, provenance or {}),
        data=[(name, Markup(text)) for name, text in blobs.texts.items()],  # it has no "<" and needs no escaping
        style=_asset("style.css"),
        scripts=[_asset(name) for name in SCRIPTS],
    )
    try:
        with atomic_write(path) as temporary:
            temporary.write_bytes(codecs.BOM_UTF16_LE + page.encode("utf-16-le", "replace"))
    except OSError as error:
        raise type(error)(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


def eye_names(views: int) -> tuple[str, ...]:
    """Returns how the views are called.

    Args:
        views: Their number.

    Example:
        >>> eye_names(2), eye_names(1)
        (('left eye', 'right eye'), ('image',))
    """
    return {1: ("image",), 2: ("left eye", "right eye")}.get(views, tuple(f"view {view}" for view in range(views)))


class _Blobs:
    """The encoded images and maps as text, by the name of the element that holds them; equal ones once."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self._names: dict[str, str] = {}

    @property
    def size(self) -> int:
        """Bytes of all of them, two for each character."""
        return 2 * sum(map(len, self.texts.values()))

    def copy(self) -> _Blobs:
        copied = _Blobs()
        copied.texts, copied._names = dict(self.texts), dict(self._names)
        return copied

    def add(self, data: bytes) -> str:
        text = encode_text(data)
        name = self._names.setdefault(text, f"data-{len(self._names)}")
        self.texts[name] = text
        return name

    def add_map(self, argument: str, values: Tensor, sizes: Mapping[str, int], scale: float = 1.0) -> str:
        require_shapes("v 1 h w", sizes, **{argument: values})
        return self.add(encode_map(values, scale))


def _writable(path: Path) -> Path:
    """The path, if a file can be there; asked before the work rather than after it."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist")
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(f"{path}: the folder {path.parent} cannot be written to")
    return path


def _checked(
    images: Mapping[str, Tensor], reference: Reference | Tensor | None
) -> tuple[dict[str, Tensor], dict[str, int]]:
    """The images, and last the reference, on the processor and in float32; and their common size."""
    require(len(images) > 0, "images", dict(images), "at least one image")
    pictures = {f"images[{name!r}]": image for name, image in images.items()}
    if reference is not None:
        require(REFERENCE not in images, "images", f"one called {REFERENCE!r}", "another name, as that is taken")
        pictures["reference"] = reference.mean if isinstance(reference, Reference) else reference
    sizes: dict[str, int] = {}
    first = next(iter(pictures))
    for name, image in pictures.items():
        found = require_shapes("v 3 h w", **{name: require_tensor(name, image)})
        require(min(found.values()) > 0, name, tuple(image.shape), "at least one pixel")
        sizes = sizes or found
        if found != sizes:
            raise ShapeError(f"{name}: expected the size of {first}, {_size(sizes)}, got {_size(found)}")
    names = [*images, REFERENCE] if reference is not None else list(images)
    tensors = [image.detach().to("cpu", torch.float32) for image in pictures.values()]
    return dict(zip(names, tensors, strict=True)), sizes


def _size(sizes: Mapping[str, int]) -> str:
    return f"{sizes['v']} views of {sizes['w']} x {sizes['h']} pixels"


def _measured(
    pictures: Mapping[str, Tensor],
    reference: Reference | Tensor | None,
    layer: Tensor | None,
    exposure: float,
    pixels_per_degree: float,
) -> tuple[list[Table], dict[str, str]]:
    """Tables of the images that can be measured, and their scores in a line each."""
    judged = {name: image for name, image in pictures.items() if name != REFERENCE and bool(image.isfinite().all())}
    small = min(next(iter(pictures.values())).shape[-2:]) < WINDOW
    if reference is None or small or not judged or not bool(pictures[REFERENCE].isfinite().all()):
        return [], {}
    comparison = metrics.compare(judged, reference, layer, exposure, pixels_per_degree=pixels_per_degree)
    note = " ".join(line for line in str(comparison).splitlines() if line.endswith("."))  # the lines below its table
    captions = {
        name: f"{comparison.value(name, 'psnr'):.2f} dB, SSIM {comparison.value(name, 'ssim'):.3f}" for name in judged
    }
    return quality_tables(comparison.scores, eyes=eye_names(len(pictures[REFERENCE])), note=note), captions


def _listed(
    blobs: _Blobs,
    pictures: Mapping[str, Tensor],
    samples: Mapping[str, Tensor],
    captions: Mapping[str, str],
    sizes: Mapping[str, int],
) -> list[dict[str, Any]]:
    """The images as the page lists them, without their data."""
    for argument, given in (("samples", samples), ("captions", captions)):
        unknown = sorted(given.keys() - pictures.keys())
        require(not unknown, argument, unknown, "names of the images")
    listed = []
    for name in pictures:
        counts = samples.get(name)
        listed.append(
            {
                "name": str(name),
                "caption": captions.get(name, ""),
                "samples": None if counts is None else blobs.add_map(f"samples[{name!r}]", counts, sizes),
                "flip": None,
            }
        )
    return listed


def _add_images(
    listed: Sequence[dict[str, Any]], blobs: _Blobs, pictures: Mapping[str, Tensor], knee: float, size_limit: float
) -> int:
    """Adds the data of every image in the finest steps with which the page is not too large; returns these."""
    for steps in (STEPS, *COARSER_STEPS):
        with_images = blobs.copy()
        earlier: list[NDArray[np.int16]] = []
        for entry, image in zip(listed, pictures.values(), strict=True):
            codes = image_codes(image, knee, steps)
            like, copied = most_alike(codes, earlier) or (None, None)
            entry["like"] = like
            entry["copied"] = None if copied is None else with_images.add(encode_map(torch.from_numpy(copied)))
            entry["data"] = with_images.add(encode_image(codes, copied))
            earlier.append(codes)
        if with_images.size <= size_limit:
            break
    blobs.texts = with_images.texts
    return steps


def _add_flip(
    listed: Sequence[dict[str, Any]],
    blobs: _Blobs,
    pictures: Mapping[str, Tensor],
    truth: Tensor | None,
    exposure: float,
    pixels_per_degree: float,
) -> bool:
    """Adds the map of FLIP to every image that has one; says whether any has."""
    if truth is None or bool(truth.isnan().any()):
        return False
    shown_truth = color.display(truth, exposure)
    for entry, image in zip(listed, pictures.values(), strict=True):
        if image is truth or bool(image.isnan().any()):
            continue
        errors = metrics.flip_map(color.display(image, exposure), shown_truth, pixels_per_degree=pixels_per_degree)
        entry["flip"] = blobs.add(encode_map(errors, FLIP_LEVELS))
    return any(entry["flip"] for entry in listed)


def _overlay(gaze: Gaze | None, radii: Sequence[float], sizes: Mapping[str, int]) -> dict[str, Any]:
    radii = [require_number(f"radii[{index}]", radius, above=0) for index, radius in enumerate(radii)]
    require(gaze is not None or not radii, "radii", radii, "none without a gaze")
    if gaze is None:
        return {"gaze": None, "radii": []}
    require_shapes("v 2", {"v": sizes["v"]}, **{"gaze.pixels": gaze.pixels})
    return {"gaze": gaze.pixels.tolist(), "radii": radii}


def _orders(eyes: Sequence[str]) -> list[tuple[list[int], str]]:
    """The ways to lay out the views, the first one being all of them."""
    if len(eyes) == 2:
        return [([0, 1], "Both"), ([0], "Left"), ([1], "Right"), ([1, 0], "Crossed")]
    return [(list(range(len(eyes))), "All"), *(([view], str(view)) for view in range(len(eyes)))]


def _provenance(exposure: float, steps: int, given: Mapping[str, object]) -> list[tuple[str, str]]:
    error = 100 * (2 ** (0.5 / steps) - 1)
    own = {
        "display": f"radiance times {exposure:.6g}, sRGB curve, clamped to [0, 1]",
        "storage": f"radiance r to within {error:.2f} % of |r| + {KNEE / exposure:.3g}",
        "written by": f"fovden {metadata.version('fovden')}",
    }
    return [(str(name), _text(value)) for name, value in {**given, **own}.items() if value is not None]


def _text(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(each)}" for name, each in value.items() if each is not None)
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _template() -> Any:
    loader = PackageLoader("fovden.report", "template")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("report.html.jinja")


def _asset(name: str) -> Markup:
    """One of the page's own files, which need no escaping."""
    return Markup(resources.files("fovden.report").joinpath("template", name).read_text(encoding="utf-8"))
