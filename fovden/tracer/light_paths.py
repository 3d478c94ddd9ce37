"""Light along recorded paths, as differentiable tensor operations on albedos and on what lights emit.

Every surface reflects affinely in its albedo, so the light of a path through surfaces with albedos a_k is

    L = sum_k T_k ((w_k + a_k c_k) E_k + T_(k+1) / T_k m_k F_k),    T_(k+1) = T_k (w'_k + a_k c'_k),    T_0 = 1,

with E_k the colour of the light that was sampled at surface k, F_k that of the light which the bounce from there met,
and numbers w, c, w', c', m that the kernels write on tape: geometry, shadows, densities and weights. They are held
fixed. That is the derivative of an estimator whose random choices do not move (*detached*, Zeltner, Speierer, Georgiev
and Jakob, "Monte Carlo estimators for differential light transport", SIGGRAPH 2021): it is unbiased for albedos and
lights, also where lights are chosen by their power and paths end at random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from fovden.checks import require, require_shapes
from fovden.color import LUMINANCE
from fovden.tracer.arrays import emissive_triangles
from fovden.tracer.gradient import albedo_at, corners_at, emission_at, interpolated, rows_at
from fovden.tracer.kernels import path
from fovden.tracer.lights import DirectionalLight, EnvironmentLight, Light, PointLight
from fovden.tracer.points import Shading, SurfacePoints
from fovden.tracer.scene import Scene

__all__ = ["Paths", "environment_at"]

PATHS_AT_ONCE = 1 << 17
"""Paths whose intermediate results autograd holds at a time: some 650 bytes a path with one bounce, 85 MB. Ours."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths from surface points to lights on record: the light of the points as a function of albedos and lights.

    Made by :func:`fovden.tracer.record_paths`.

    Attributes:
        scene: The scene.
        points: The points.
        shading: Their light as it was traced.
        numbers: What the paths are made of, shape (p, bounces + 1, 16): one path a sample, those of a point in a row;
            see ``TAPE`` in ``fovden/tracer/kernels/path.py``. 64 bytes a surface.
        directions: Unit directions in which the points are seen, shape (n, 3).

    Example:
        >>> from fovden.tracer import make_scene, record_paths, surface_points, trace_frame
        >>> scene = make_scene("cornell_box")
        >>> paths = record_paths(scene, surface_points(trace_frame(scene, scene.camera.at((8, 8)), 4, seed=1)))
        >>> albedo = scene.materials.albedo.clone().requires_grad_()
        >>> paths.shade(albedo=albedo).radiance.mean().backward()
        >>> albedo.grad.min() >= 0
        tensor(True)
    """

    scene: Scene
    points: SurfacePoints
    shading: Shading
    numbers: Tensor
    directions: Tensor

    def __len__(self) -> int:
        return int(self.numbers.shape[0])

    def shade(
        self,
        *,
        albedo: Tensor | None = None,
        emission: Tensor | None = None,
        textures: Sequence[Tensor] | None = None,
        lights: Sequence[Tensor] | None = None,
    ) -> Shading:
        """Returns the light of the points with other albedos and lights, along the same paths.

        With the scene's own it is what was traced, but for rounding. What chose the paths stays as it was: the
        chances of lights, weights, and where paths ended at random.

        Args:
            albedo: Reflectance of the materials, or the factors of their textures, shape (k, 3); ``None``, here and
                below, for the scene's.
            emission: Radiance that the materials emit, shape (k, 3). What was dark stays dark.
            textures: Reflectance images, linear, of a floating type, shape (h, w, 3) each; any size.
            lights: What each of ``scene.lights`` emits, as its own attribute: shape (3) or (); of an environment also
                an image (3, h, w).

        Returns:
            The light, in the type and on the device of the arguments. Of several types it is the widest.

        Raises:
            ShapeError: If a shape differs.
            ValueError: If there are not as many images or lights as in the scene.

        Differentiable: in all arguments, any number of times, also forwards if there are fewer than 2^17 paths.
        Memory: beyond that many, intermediate results are computed again for the derivative, not kept.

        Example:
            >>> from fovden.tracer import PointLight, make_scene, record_paths, surface_points, trace_frame
            >>> scene = make_scene("cornell_box").with_lights([PointLight((2.8, 4.0, 2.8), 10)])
            >>> paths = record_paths(scene, surface_points(trace_frame(scene, scene.camera.at((8, 8)), 4)))
            >>> dark = torch.zeros(4, 3)
            >>> once, twice = (paths.shade(emission=dark, lights=[torch.tensor(i)]).radiance for i in (10.0, 20.0))
            >>> torch.allclose(2 * once, twice)
            True
        """
        materials = self.scene.materials
        count = len(materials.names)
        albedo = materials.albedo if albedo is None else albedo
        emission = materials.emission if emission is None else emission
        require_shapes("k 3", {"k": count}, albedo=albedo, emission=emission)
        images = materials.textures if textures is None else tuple(textures)
        own, colours = len(materials.textures), _colours(self.scene.lights, lights)
        require(len(images) == own, "textures", len(images), f"{own} images, as the scene has")
        for image in images:
            require_shapes("h w 3", textures=image)
        given = [albedo, emission, *colours, *(image for image in images if image.is_floating_point())]
        number = reduce(torch.promote_types, (tensor.dtype for tensor in given))
        changed = [tensor for tensor in given if tensor.device.type != "cpu"]
        device = changed[0].device if changed else albedo.device
        albedo, emission = albedo.to(device, number), emission.to(device, number)
        images = tuple(image.to(device, number if image.is_floating_point() else None) for image in images)
        sources = _sources(self.scene, emission, [colour.to(device, number) for colour in colours])
        ends = torch.cumsum(self.points.counts.to(torch.int64), 0)
        goals = torch.tensor(range(PATHS_AT_ONCE, len(self), PATHS_AT_ONCE), dtype=torch.int64)
        bounds = [0, *torch.searchsorted(ends, goals).tolist(), len(self.points)]
        parts = [part for part in pairwise(bounds) if part[0] < part[1]] or [(0, 0)]
        again = len(parts) > 1 and torch.is_grad_enabled() and any(tensor.requires_grad for tensor in given)
        pieces = []
        for part in parts:
            arguments = (part, albedo, images, sources)
            if again:
                piece = checkpoint(self._part, *arguments, use_reentrant=False, preserve_rng_state=False)
            else:
                piece = self._part(*arguments)
            pieces.append(piece)
        return Shading(*(torch.cat(fields) for fields in zip(*pieces, strict=True)))

    def _part(self, part: tuple[int, int], albedo: Tensor, images: tuple[Tensor, ...], sources: _Sources) -> Shading:
        """The light of the points from the first to before the second."""
        begin, end = part
        counts = self.points.counts.to(torch.int64)
        first, last = int(counts[:begin].sum()), int(counts[:end].sum())
        numbers, counts = self.numbers[first:last], counts[begin:end].to(albedo.device)
        light = [torch.zeros(last - first, 3).to(albedo) for _ in range(2)]
        throughput = torch.ones_like(light[0])
        for vertex, tape in enumerate(numbers.unbind(1)):
            here, row = _albedo(self.scene, tape, albedo, images), tape.to(albedo)
            towards, along = row[:, path.TO_LIGHT : path.TO_LIGHT + 3], row[:, path.TO_BOUNCE : path.TO_BOUNCE + 3]
            white, coloured, white_on, coloured_on = row[:, path.WHITE : path.BOUNCE_COLOURED + 1, None].unbind(1)
            found = throughput * (white + here * coloured) * _colour(sources, row[:, path.LIGHT], towards)
            throughput = throughput * (white_on + here * coloured_on)
            met = _colour(sources, row[:, path.MET], along) * row[:, path.MET_SCALE, None]
            light[min(vertex, 1)] = light[min(vertex, 1)] + found + throughput * met
        own = self._own(slice(begin, end), sources) * (counts > 0)[:, None]
        owner = torch.repeat_interleave(torch.arange(end - begin, device=counts.device), counts)
        share = 1 / counts.clamp_min(1).to(albedo)

        def mean(values: Tensor) -> Tensor:
            return torch.zeros(end - begin, values.shape[1]).to(values).index_add(0, owner, values) * share[:, None]

        weights = torch.tensor(LUMINANCE).to(albedo)
        luminance = (light[0] + light[1] + own.index_select(0, owner)) @ weights
        return Shading(mean(light[0]), mean(light[1]), own, mean(luminance[:, None].square())[:, 0])

    def _own(self, part: slice, sources: _Sources) -> Tensor:
        """What the points emit themselves, or the surroundings where there is none."""
        prim, along = self.points.prim[part], self.directions[part].to(sources.emission)
        corners = corners_at(self.scene.vertices.detach(), self.scene.faces, prim).to(along)
        material = self.scene.material_ids[prim.long().clamp_min(0)].long().to(along.device)
        emitted = emission_at(corners, sources.emission.index_select(0, material), along)
        hit = (prim >= 0).to(along.device)[:, None]
        around = torch.zeros_like(emitted) if sources.sky is None else environment_at(sources.sky, along)
        return torch.where(hit, emitted, around)


class _Sources(NamedTuple):
    """What emits: colours by row of the light table, the row and the image of the surroundings, and materials."""

    colours: Tensor  # (rows, 3)
    sky_row: int
    sky: Tensor | None  # (3, h, w)
    emission: Tensor  # (k, 3)


def _colours(lights: Sequence[Light], given: Sequence[Tensor] | None) -> list[Tensor]:
    """What each of a scene's lights emits, shape (3) or (3, h, w)."""
    if given is not None:
        require(len(given) == len(lights), "lights", len(given), f"{len(lights)} tensors, as the scene has lights")
    colours = []
    for number, light in enumerate(lights):
        if given is not None:
            value = given[number]
        elif isinstance(light, PointLight):
            value = torch.tensor(light.intensity)
        elif isinstance(light, DirectionalLight):
            value = torch.tensor(light.irradiance)
        else:
            value = torch.as_tensor(light.radiance)
        if value.ndim == 3 and isinstance(light, EnvironmentLight):
            require_shapes("3 h w", **{f"lights[{number}]": value})
        elif value.ndim > 0:
            require_shapes("3", **{f"lights[{number}]": value})
        colours.append(value if value.ndim == 3 else value.expand(3))
    return colours


def _sources(scene: Scene, emission: Tensor, colours: list[Tensor]) -> _Sources:
    shines = (scene.materials.emission.detach().amax(1) > 0).to(emission.device)
    emission = torch.where(shines[:, None], emission, 0)
    rows, sky_row, sky = [], -1, None
    for number, (light, colour) in enumerate(zip(scene.lights, colours, strict=True)):
        if isinstance(light, EnvironmentLight):
            sky_row, sky = number, colour if colour.ndim == 3 else colour[:, None, None]
            colour = torch.zeros_like(emission[0])  # noqa: PLW2901 (looked up by direction)
        rows.append(colour)
    material = scene.material_ids[emissive_triangles(scene)].long().to(emission.device)
    table = [torch.stack(rows)] if rows else []
    return _Sources(torch.cat([*table, emission.index_select(0, material)]), sky_row, sky, emission)


def _colour(sources: _Sources, row: Tensor, direction: Tensor) -> Tensor:
    """Colours of the lights of the rows, (n, 3), seen in these directions; anything finite where the row is -1."""
    number = row.detach().long()
    colour = sources.colours.index_select(0, number.clamp_min(0))
    if sources.sky is None:
        return colour
    return torch.where((number == sources.sky_row)[:, None], environment_at(sources.sky, direction), colour)


def _albedo(scene: Scene, row: Tensor, albedo: Tensor, images: tuple[Tensor, ...]) -> Tensor:
    """Albedos at the surfaces of one row of the tape, (n, 3)."""
    prim = row[:, path.PRIM].to(torch.int32)
    material = scene.material_ids[prim.long()].long()
    factor = albedo.index_select(0, material.to(albedo.device))
    if not images:
        return factor
    uv = interpolated(rows_at(scene.uv.detach(), scene.faces, prim), row[:, path.PRIM + 1], row[:, path.PRIM + 2])
    texture = scene.materials.texture[material].to(albedo.device)
    return albedo_at(factor, images, texture, uv.to(albedo))


def environment_at(image: Tensor, directions: Tensor) -> Tensor:
    """Returns the radiance that arrives from directions of the surroundings, as the kernels look it up.

    Args:
        image: Radiance, shape (3, h, w), laid out as in :class:`fovden.tracer.EnvironmentLight`.
        directions: Unit directions towards the surroundings, shape (n, 3).

    Returns:
        Radiance of shape (n, 3): bilinear, around in azimuth, clamped at the poles.

    Differentiable: in ``image``.

    Example:
        >>> image = torch.tensor([1.0, 3.0]).reshape(1, 2, 1).expand(3, 2, 1)
        >>> environment_at(image, torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]))[:, 0]
        tensor([1., 2.])
    """
    height, width = image.shape[1:]
    with torch.no_grad():
        x, y, z = directions.unbind(1)
        turn, tilt = torch.atan2(x, -z) / (2 * torch.pi), torch.acos(y.clamp(-1, 1)) / torch.pi
        column, row = (turn + 0.5) * width - 0.5, tilt * height - 0.5
        left, upper = column.floor(), row.floor()
        fx, fy = column - left, row - upper
    radiance = torch.zeros_like(directions)
    for dy in range(2):
        for dx in range(2):
            texel = image[:, (upper.long() + dy).clamp(0, height - 1), (left.long() + dx) % width]
            radiance = radiance + ((fx if dx else 1 - fx) * (fy if dy else 1 - fy))[:, None] * texel.mT
    return radiance
