"""Frames of other renderers: which channels hold what, and what stands in for those that are missing."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from fovden.camera import Camera
from fovden.checks import require, require_finite
from fovden.frame import Frame, GBuffer
from fovden.io.exr import Exr

__all__ = ["ALIASES", "LETTERS", "find_image", "foreign_frame"]

ALIASES: Mapping[str, tuple[str, ...]] = {
    "radiance": ("", "rgb", "rgba", "color", "beauty", "combined"),
    "normal": ("n", "nn", "ns", "normal", "normals", "sh_normal"),
    "position": ("p", "pos", "position", "positions"),
    "albedo": ("albedo", "alb", "diffcol", "diffuse color"),
    "depth": ("z", "depth"),
    "counts": ("spp", "samples"),
    "mask": ("mask",),
}
"""Names of a layer, in lower case, under which other renderers keep an image (Mitsuba: ``nn``, ``pos``, ``albedo``;
pbrt-v4: ``Ns``, ``P``, ``Albedo``; Blender: ``ViewLayer.Combined``, ``.Normal``, ``.Position``, ``.Depth``, and
``.DiffCol`` or, in its newer versions, ``.Diffuse Color``). The first one present is taken."""

LETTERS: Mapping[str, tuple[str, ...]] = {
    "radiance": ("RGB",),
    "normal": ("XYZ", "RGB"),
    "position": ("XYZ", "RGB"),
    "albedo": ("RGB", "XYZ"),
    "depth": ("Z", "Y", "V", "R"),
    "counts": ("Y", "V", "Z", "R", "X"),
    "mask": ("Y", "V", "Z", "R", "X", "A"),
}


def find_image(file: Exr, wanted: str) -> Tensor | None:
    """An image under any of its names, shape (v, c, h, w), or ``None`` where a view lacks it.

    Example:
        >>> file = Exr(Path("box.exr"), {"ViewLayer.Depth.Z": torch.ones(2, 3)}, ("view0",), {})
        >>> find_image(file, "depth").shape
        torch.Size([1, 1, 2, 3])
    """
    by_view = _layers(file)
    for alias in ALIASES[wanted]:
        for letters in LETTERS[wanted]:
            rows = [[view.get((alias, letter)) for letter in letters] for view in by_view]
            if len(letters) == 1:  # a scalar may also be a channel without a layer, such as Z
                rows = [[view.get((alias, letters), view.get(("", alias.upper())))] for view in by_view]
            found = [channel for row in rows for channel in row if channel is not None]
            if len(found) == len(rows) * len(letters):
                return torch.stack(found).reshape(len(rows), len(letters), *found[0].shape).to(torch.float32)
    return None


def foreign_frame(file: Exr, camera: Camera | None) -> Frame:
    """Returns the frame in another renderer's file; :func:`fovden.io.load_frame` says what is taken for what.

    Example:
        >>> channels = {name: torch.ones(2, 3) for name in ("R", "G", "B", "nn.X", "nn.Y", "nn.Z", "Z")}
        >>> channels |= {f"pos.{letter}": torch.zeros(2, 3) for letter in "XYZ"}
        >>> foreign_frame(Exr(Path("box.exr"), channels, ("view0",), {}), None).radiance.shape
        torch.Size([1, 3, 2, 3])
    """
    needed = {wanted: find_image(file, wanted) for wanted in ("radiance", "normal", "position")}
    missing = [wanted for wanted, image in needed.items() if image is None]
    if missing:
        raise ValueError(
            f"{file.path}: found no {' and no '.join(missing)}. A frame needs R, G, B, normals (such as N.X, N.Y, N.Z) "
            f"and positions (such as P.X, P.Y, P.Z) in every view ({', '.join(file.views)}); "
            f"the file has {', '.join(sorted(file.channels))}"
        )
    radiance, normal, position = (image for image in needed.values() if image is not None)
    depth, albedo, counts, mask = (find_image(file, wanted) for wanted in ("depth", "albedo", "counts", "mask"))
    for name, image in (("normal", normal), ("position", position), ("depth", depth), ("albedo", albedo)):
        require(image is None or not bool(image.isnan().any()), f"{file.path}: {name}", "NaN", "numbers")
    hit = (normal != 0).any(1, keepdim=True) & position.isfinite().all(1, keepdim=True)
    if depth is not None:
        hit &= depth.isfinite()
    position = torch.where(hit, position, 0)
    if depth is None:
        depth = _depth(file.path, position, hit, camera)
    counts = torch.ones_like(depth) if counts is None else counts
    counts = counts if mask is None else counts * (mask > 0)
    require_finite(f"{file.path}: samples per pixel", counts, minimum=0)
    gbuffer = GBuffer(
        albedo=torch.where(hit, torch.ones_like(normal) if albedo is None else albedo, 0),
        normal=torch.where(hit, normal, 0),
        position=position,
        depth=torch.where(hit, depth, 0),
        roughness=hit.to(torch.float32),
        motion=torch.zeros_like(normal[:, :2]),
        prim=torch.where(hit, 0, -1).to(torch.int32),
        barycentric=torch.zeros_like(normal[:, :2]),
    )
    return Frame.from_radiance(torch.where(counts > 0, radiance, 0), gbuffer, counts=counts)


def _depth(path: Path, position: Tensor, hit: Tensor, camera: Camera | None) -> Tensor:
    """Depth along the viewing axis from the positions, or a constant of the right order without a camera."""
    if camera is not None:
        return camera.project(position.flatten(2).mT)[1].reshape_as(position[:, :1])
    warnings.warn(
        f"{path}: no depth (Z) in this file and no camera given to compute it: a constant as large as the scene "
        "stands in for it",
        stacklevel=4,
    )
    points = position.movedim(1, -1)[hit[:, 0]].double()
    size = (points - points.mean(0)).square().sum(1).mean().sqrt() if len(points) else points.sum()
    return torch.full_like(position[:, :1], float(size))


def _layers(file: Exr) -> list[dict[tuple[str, str], Tensor]]:
    """Per view: channels by the last part of the layer's name, in lower case, and the letter."""
    found: list[dict[tuple[str, str], Tensor]] = [{} for _ in file.views]
    for name, channel in file.channels.items():
        *layer, letter = name.split(".")
        view = 0
        if len(file.views) > 1:
            named = [part for part in layer if part in file.views]
            view = file.views.index(named[0]) if named else 0
            layer = [part for part in layer if part not in file.views]
        found[view].setdefault((layer[-1].lower() if layer else "", letter.upper()), channel)
    return found
