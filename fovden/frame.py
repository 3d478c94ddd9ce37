"""The records that cross package borders: what a tracer makes, and what a denoiser reads and returns.

Images have the shape (v, c, h, w): v counts views, the left eye first; c counts channels. Radiance is linear,
unbounded Rec. 709 RGB in float32. The records are frozen: make a changed copy with :func:`dataclasses.replace`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import torch
from torch import Tensor

from fovden._cards import eyes, not_finite, place_of, share, type_of
from fovden._rasters import alike, stacked
from fovden.camera import Camera, Gaze
from fovden.checks import require, require_integer, require_shapes
from fovden.preview import Picture, card, never_raising, ramp, shades, show, shrink, to_levels

if TYPE_CHECKING:  # its kernels need not be there for a frame
    from fovden.warps import Warp

__all__ = ["Frame", "GBuffer", "Reference"]

Record = TypeVar("Record", bound="GBuffer | Frame | Reference | Camera | Gaze | Warp")


@dataclass(frozen=True, eq=False)
class GBuffer:
    """What the camera sees in every pixel, free of noise, whether or not a path was traced there.

    Attributes:
        albedo: Diffuse reflectance in [0, 1], shape (v, 3, h, w); 0 on a miss.
        normal: Unit shading normal in the world, on the viewer's side, shape (v, 3, h, w); 0 on a miss.
        position: Position in the world in metres, shape (v, 3, h, w); 0 on a miss.
        depth: Distance along the viewing axis in metres, shape (v, 1, h, w); 0 on a miss.
        roughness: Roughness in [0, 1], shape (v, 1, h, w); 1 is Lambertian, 0 on a miss.
        motion: Pixels (x, y) of the screen to where this surface was in the previous frame, shape (v, 2, h, w):
            previous = current + motion.
        prim: Index of the triangle hit, int32, shape (v, 1, h, w); -1 is a miss.
        barycentric: Weights (u, v) of the triangle's second and third vertex, shape (v, 2, h, w).

    Example:
        >>> GBuffer.empty(views=2, resolution=(4, 6)).hit.any()
        tensor(False)
    """

    albedo: Tensor
    normal: Tensor
    position: Tensor
    depth: Tensor
    roughness: Tensor
    motion: Tensor
    prim: Tensor
    barycentric: Tensor

    def __post_init__(self) -> None:
        sizes = require_shapes("v 3 h w", albedo=self.albedo, normal=self.normal, position=self.position)
        require_shapes("v 1 h w", sizes, depth=self.depth, roughness=self.roughness, prim=self.prim)
        require_shapes("v 2 h w", sizes, motion=self.motion, barycentric=self.barycentric)
        object.__setattr__(self, "prim", self.prim.to(torch.int32))

    @classmethod
    def empty(cls, views: int, resolution: tuple[int, int]) -> GBuffer:
        """Returns a G-buffer in which every pixel is a miss.

        Example:
            >>> GBuffer.empty(1, (2, 2)).prim.flatten()
            tensor([-1, -1, -1, -1], dtype=torch.int32)
        """

        def zeros(channels: int) -> Tensor:
            return torch.zeros(views, channels, *resolution)

        prim = torch.full((views, 1, *resolution), -1, dtype=torch.int32)
        return cls(zeros(3), zeros(3), zeros(3), zeros(1), zeros(1), zeros(2), prim, zeros(2))

    @property
    def hit(self) -> Tensor:
        """Whether the pixel sees a surface: bool, shape (v, 1, h, w)."""
        return self.prim >= 0

    def to(self, *args: Any, **kwargs: Any) -> GBuffer:
        """Returns the record moved with the arguments of ``Tensor.to``; only floating fields change their type.

        Example:
            >>> GBuffer.empty(1, (2, 2)).to(torch.float64).prim.dtype
            torch.int32
        """
        return _map_tensors(self, lambda tensor: _move(tensor, *args, **kwargs))

    @never_raising
    def _repr_html_(self) -> str:
        first = replace(self, **{field.name: getattr(self, field.name)[:1] for field in fields(self)})
        hit, depth = first.hit, first.depth
        distances = depth[hit & torch.isfinite(depth)]
        near, far = (float(distances.min()), float(distances.max())) if distances.numel() else (0.0, 0.0)
        pictures = [
            Picture(show(first.albedo, 1.0), "albedo"),
            Picture(to_levels(shrink(torch.where(hit, (first.normal + 1) / 2, 0.0))), "normal, (n + 1) / 2"),
            Picture(ramp(torch.where(hit, -depth, -far), -far, -near), f"depth, white {near:.3g} m, black {far:.3g} m"),
        ]
        views, _, height, width = self.albedo.shape
        units = {"position": ", metres", "depth": ", metres", "motion": ", pixels"}
        rows = {
            "views": f"{views} of {width} x {height} pixels, {type_of(self.albedo)}"
            + "; shown: the first" * (views > 1),
            "surfaces": f"{share(self.hit)} of the pixels, {len(torch.unique(self.prim[self.hit])):,} triangles",
        }
        rows |= {f.name: f"{tuple(getattr(self, f.name).shape)}{units.get(f.name, '')}" for f in fields(self)}
        return card("GBuffer", pictures, rows | not_finite(self))


@dataclass(frozen=True, eq=False)
class Frame:
    """A noisy frame: the light that was sampled, how often, and the geometry that it fell on.

    There is no reference here, so that no filter can peek at it. Pixels are those of the screen, or with a ``warp`` the
    cells of its raster.

    Attributes:
        direct: Light that reached the first surface from a light source, mean over the pixel's samples, 0 where it
            has none, shape (v, 3, h, w).
        indirect: Light that arrived by way of other surfaces, the same way.
        emission: Light emitted towards the camera by what the pixel shows, the same way.
        counts: Number of samples of each pixel, shape (v, 1, h, w); 0 where no path was traced.
        luminance_squared: Mean of the samples' squared luminance, shape (v, 1, h, w), so that a variance exists.
        layer: Foveation layer, int32, shape (v, 1, h, w): 0 is the innermost; all zero without foveation.
        gbuffer: The geometry; complete also where ``counts`` is 0.
        camera: The views, or ``None`` where unknown.
        gaze: Where each eye looked, or ``None`` where unknown.
        jitter: Sub-pixel shift (x, y) of the whole frame in pixels; (0, 0) means that rays pass pixel centres.
        index: Number of the frame in its sequence.
        seed: Seed of the random numbers that made it.
        warp: The raster that the pixels are cells of; ``None`` is the camera's own.
        weight: Weight of each pixel as a tap, in [0, 1], shape (v, 1, h, w); ``None`` means that of ``counts``. The
            light beneath a weight of 0 is hidden from values, not from gradients (:func:`fovden.foveation.thinned`).

    Example:
        >>> radiance = torch.rand(2, 3, 8, 8)
        >>> frame = Frame.from_radiance(radiance, GBuffer.empty(2, (8, 8)))
        >>> torch.equal(frame.radiance, radiance), frame.mask.mean()
        (True, tensor(1.))
    """

    direct: Tensor
    indirect: Tensor
    emission: Tensor
    counts: Tensor
    luminance_squared: Tensor
    layer: Tensor
    gbuffer: GBuffer
    camera: Camera | None = None
    gaze: Gaze | None = None
    jitter: tuple[float, float] = (0.0, 0.0)
    index: int = 0
    seed: int = 0
    warp: Warp | None = None
    weight: Tensor | None = None

    def __post_init__(self) -> None:
        sizes = require_shapes("v 3 h w", direct=self.direct, indirect=self.indirect, emission=self.emission)
        scalars = {"counts": self.counts, "luminance_squared": self.luminance_squared, "layer": self.layer}
        require_shapes("v 1 h w", sizes, **scalars)
        require_shapes("v 1 h w", sizes, **{"gbuffer.prim": self.gbuffer.prim})
        if self.weight is not None:
            require_shapes("v 1 h w", sizes, weight=self.weight)
        if self.camera is not None:
            require_shapes("v 3", sizes, **{"camera.origin": self.camera.origin})
        if self.gaze is not None:
            require_shapes("v 2", sizes, **{"gaze.pixels": self.gaze.pixels})
        if self.warp is not None:
            require_shapes("v 2", sizes, **{"warp.gaze.pixels": self.warp.gaze.pixels})
            same = self.warp.resolution == self.resolution
            require(same, "warp.resolution", self.warp.resolution, f"{self.resolution}, as the images have")
            if self.camera is not None:
                same = self.camera.resolution == self.warp.screen
                require(same, "camera.resolution", self.camera.resolution, f"the warp's screen, {self.warp.screen}")
        object.__setattr__(self, "layer", self.layer.to(torch.int32))

    @classmethod
    def from_radiance(
        cls, radiance: Tensor, gbuffer: GBuffer, *, counts: Tensor | None = None, layer: Tensor | None = None
    ) -> Frame:
        """Returns a frame from the radiance and geometry of any renderer; all of the light counts as direct.

        Args:
            radiance: Linear radiance, shape (v, 3, h, w).
            gbuffer: Geometry of the same size.
            counts: Samples per pixel, shape (v, 1, h, w); ``None`` means one everywhere.
            layer: Foveation layers, shape (v, 1, h, w); ``None`` means one layer.

        Returns:
            The frame.

        Example:
            >>> Frame.from_radiance(torch.ones(1, 3, 2, 2), GBuffer.empty(1, (2, 2))).radiance.sum()
            tensor(12.)
        """
        scalar = torch.zeros_like(radiance[:, :1])
        counts = torch.ones_like(scalar) if counts is None else counts
        layer = scalar.to(torch.int32) if layer is None else layer
        nothing = torch.zeros_like(radiance)
        return cls(radiance, nothing, nothing, counts, scalar, layer, gbuffer)

    @property
    def radiance(self) -> Tensor:
        """All of the light, direct + indirect + emission, shape (v, 3, h, w)."""
        return self.direct + self.indirect + self.emission

    @property
    def mask(self) -> Tensor:
        """Whether a pixel was sampled, as 0 or 1, or else ``weight``, in the radiance's type, shape (v, 1, h, w)."""
        return (self.counts > 0 if self.weight is None else self.weight).to(self.direct.dtype)

    @property
    def raster(self) -> str:
        """Name of the grid that the pixels lie on; ``"screen"`` is the camera's own."""
        return "screen" if self.warp is None else self.warp.name

    @property
    def resolution(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return int(self.direct.shape[2]), int(self.direct.shape[3])

    @property
    def view_count(self) -> int:
        """Number of views v."""
        return int(self.direct.shape[0])

    @classmethod
    def stack(cls, frames: Sequence[Frame]) -> Frame:
        """Joins frames of one resolution along the view axis; index, seed and jitter are those of the first.

        Args:
            frames: At least one frame.

        Returns:
            A frame whose views are those of all frames in turn. Camera and gaze are kept where all have one.

        Raises:
            ValueError: If ``frames`` is empty or the resolutions or rasters differ; the gaze of a raster may.

        Example:
            >>> frame = Frame.from_radiance(torch.ones(2, 3, 4, 4), GBuffer.empty(2, (4, 4)))
            >>> Frame.stack([frame, frame]).view_count
            4
        """
        require(len(frames) > 0, "frames", list(frames), "at least one frame")
        for number, frame in enumerate(frames):
            same = frame.resolution == frames[0].resolution
            require(same, f"frames[{number}].resolution", frame.resolution, f"{frames[0].resolution}, as the first has")
            same = alike(frame.warp, frames[0].warp)
            require(same, f"frames[{number}].warp", frame.raster, f"{frames[0].raster} with the first one's parameters")
        joined: dict[str, Any] = {}
        for name in ("direct", "indirect", "emission", "counts", "luminance_squared", "layer"):
            joined[name] = torch.cat([getattr(frame, name) for frame in frames])
        weighted = any(frame.weight is not None for frame in frames)
        joined["weight"] = torch.cat([frame.mask for frame in frames]) if weighted else None
        gbuffers = [frame.gbuffer for frame in frames]
        geometry = {f.name: torch.cat([getattr(g, f.name) for g in gbuffers]) for f in fields(GBuffer)}
        cameras = [frame.camera for frame in frames if frame.camera is not None]
        joined["camera"] = None
        if len(cameras) == len(frames):
            parts = {n: torch.cat([getattr(c, n) for c in cameras]) for n in ("origin", "rotation", "bounds")}
            joined["camera"] = Camera(**parts, resolution=cameras[0].resolution)
        joined["gaze"] = None
        if all(frame.gaze is not None for frame in frames):
            joined["gaze"] = Gaze(torch.cat([frame.gaze.pixels for frame in frames if frame.gaze is not None]))
        joined["warp"] = stacked([frame.warp for frame in frames if frame.warp is not None])
        return replace(frames[0], gbuffer=GBuffer(**geometry), **joined)

    def to(self, *args: Any, **kwargs: Any) -> Frame:
        """Returns the record moved with the arguments of ``Tensor.to``; only floating fields change their type.

        Example:
            >>> frame = Frame.from_radiance(torch.ones(1, 3, 2, 2), GBuffer.empty(1, (2, 2))).to(torch.float64)
            >>> frame.radiance.dtype, frame.layer.dtype
            (torch.float64, torch.int32)
        """
        moved = _map_tensors(self, lambda tensor: _move(tensor, *args, **kwargs))
        return moved if self.warp is None else replace(moved, warp=self.warp.to(*args, **kwargs))

    @never_raising
    def _repr_html_(self) -> str:
        height, width = self.resolution
        counts = self.counts.detach().double()
        most = float(counts.max()) if counts.numel() else 0.0
        unit = "pixel" if self.warp is None else "cell"
        samples = Picture(ramp(counts[:1], 0.0, most), f"samples per {unit}, black 0, white {most:.4g}")
        pictures = [*eyes(self.radiance), samples]
        shares = self.layer.flatten().bincount().double() / max(1, self.layer.numel())
        if len(shares) > 1:
            pictures.append(Picture(shades(self.layer[:1]), "layers, the innermost white"))
        gaze = None if self.gaze is None else ", ".join(f"({x:g}, {y:g})" for x, y in self.gaze.pixels.tolist())
        rows = {
            "views": f"{self.view_count} of {width} x {height} {unit}s, {type_of(self.direct)}",
            "samples": f"{float(counts.mean()):.3f} per {unit} on average, {share(counts > 0)} of {unit}s have any",
            "layers": ", ".join(f"{number}: {part:.1%}" for number, part in enumerate(shares.tolist())) or "none",
            "gaze": "unknown" if gaze is None else f"{gaze} pixels",
            "camera": place_of(self.camera),
            "frame": f"index {self.index}, seed {self.seed}, raster {self.raster}, jitter {self.jitter}",
        }
        return card("Frame", pictures, rows | not_finite(self))


@dataclass(frozen=True, eq=False)
class Reference:
    """A converged image and how well it is known.

    Attributes:
        mean: Mean radiance of all samples, shape (v, 3, h, w).
        variance: Estimated variance of that mean, per channel, shape (v, 3, h, w): the samples' variance / count.
        count: Samples per pixel.
        camera: The views, or ``None`` where unknown.
        seed: Seed of the random numbers that made it.

    Example:
        >>> reference = Reference(torch.ones(1, 3, 2, 2), torch.full((1, 3, 2, 2), 1e-4), count=1024)
        >>> round(float(reference.standard_error.mean()), 4)
        0.01
    """

    mean: Tensor
    variance: Tensor
    count: int
    camera: Camera | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        sizes = require_shapes("v 3 h w", mean=self.mean, variance=self.variance)
        require_integer("count", self.count, minimum=1)
        if self.camera is not None:
            require_shapes("v 3", sizes, **{"camera.origin": self.camera.origin})

    @property
    def standard_error(self) -> Tensor:
        """Standard deviation of the mean, shape (v, 3, h, w)."""
        return self.variance.sqrt()

    def to(self, *args: Any, **kwargs: Any) -> Reference:
        """Returns the record moved with the arguments of ``Tensor.to``.

        Example:
            >>> Reference(torch.ones(1, 3, 2, 2), torch.zeros(1, 3, 2, 2), 4).to(torch.float64).mean.dtype
            torch.float64
        """
        return _map_tensors(self, lambda tensor: _move(tensor, *args, **kwargs))

    @never_raising
    def _repr_html_(self) -> str:
        views, _, height, width = self.mean.shape
        noise = float(self.variance.mean(dtype=torch.float64).sqrt())
        rows = {
            "views": f"{views} of {width} x {height} pixels, {type_of(self.mean)}",
            "samples": f"{self.count} per pixel, seed {self.seed}",
            "noise": f"{noise:.3g} (RMS standard error of the radiance)",
            "camera": place_of(self.camera),
        }
        return card("Reference", eyes(self.mean), rows | not_finite(self))


def _move(tensor: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    if tensor.is_floating_point():
        moved: Tensor = tensor.to(*args, **kwargs)
        return moved
    # Integers take the device alone: on a way through half precision, triangle 70001 would become another one.
    return tensor.to(torch.empty(0, device=tensor.device).to(*args, **kwargs).device)


def _map_tensors(record: Record, change: Callable[[Tensor], Tensor]) -> Record:
    """Applies a function to every tensor of a record and of the records in it."""
    changed: dict[str, Any] = {}
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, Tensor):
            changed[field.name] = change(value)
        elif is_dataclass(value):
            part: Any = value
            changed[field.name] = _map_tensors(part, change)
    return replace(record, **changed)
