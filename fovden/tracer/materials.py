"""Materials: how surfaces reflect, what they emit, and where they are cut out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from torch import Tensor

from fovden.checks import require, require_finite, require_integer, require_shapes

__all__ = ["MODELS", "Material", "Materials", "Model"]

Triple = tuple[float, float, float]

Model = Literal["lambert", "oren_nayar", "ggx", "metallic_roughness", "ggx_separable"]
"""How light is reflected, see :mod:`fovden.tracer.bsdf`: by a perfectly diffuse surface; by a rough one; by microfacets
of a metal; by glTF's mixture of a metal and a coated diffuse surface; by Mitsuba's microfacets of a metal."""

MODELS: tuple[Model, ...] = get_args(Model)
"""The models in the order of their numbers in ``Materials.model``."""

_PLAIN: Any = None  # a table of opaque Lambertian surfaces, until their number is known

CUTOFF = 0.5
"""Opacity below which a texel is a hole, unless a file says otherwise: glTF's default of ``alphaCutoff``."""


@dataclass(frozen=True, eq=False)
class Material:
    """One material.

    Attributes:
        name: For messages and for looking it up.
        albedo: Reflectance per channel, linear, in [0, 1]: of a diffuse surface, of a metal at normal incidence, or
            glTF's base colour. With a texture it multiplies the texture.
        emission: Radiance emitted on the side of the geometric normal, W/(m^2 sr) per channel.
        texture: Reflectance image, uint8 with the sRGB curve, shape (h, w, 3), top row first; ``None`` for plain.
        model: How it reflects.
        roughness: In [0, 1]. ``"lambert"`` ignores it. ``"oren_nayar"``: standard deviation of the facets' slope
            angle, radians. Others: the square root of the distribution's width.
        metallic: Share of metal in ``"metallic_roughness"``, in [0, 1].
        surface: Image of factors to roughness and metallic, uint8, linear, shape (h, w, 2); ``None`` for plain.
        opacity: Image of the opacity, uint8, shape (h, w); ``None`` for an opaque surface.
        cutoff: Opacity in [0, 1] below which the surface has a hole.

    Example:
        >>> Material("plaster", (0.8, 0.8, 0.75)).texture is None
        True
        >>> Material("brass", (0.9, 0.7, 0.4), model="ggx", roughness=0.3).metallic
        0.0
    """

    name: str
    albedo: Triple
    emission: Triple = (0.0, 0.0, 0.0)
    texture: Tensor | None = None
    model: Model = "lambert"
    roughness: float = 1.0
    metallic: float = 0.0
    surface: Tensor | None = None
    opacity: Tensor | None = None
    cutoff: float = CUTOFF


@dataclass(frozen=True, eq=False)
class Materials:
    """A scene's materials as tables that are indexed by material number.

    Images are uint8, top row first; texture coordinate (0, 0) is the lower left corner, images repeat, and values
    between texels are bilinear. Tables that are left out describe opaque Lambertian surfaces.

    Attributes:
        names: One name each; they need not be unique.
        albedo: Linear reflectance in [0, 1], or the factor of the texture, shape (k, 3).
        emission: Emitted radiance, shape (k, 3).
        texture: Index into ``textures``, or -1, int32, shape (k).
        textures: Reflectance images with the sRGB curve, shape (h, w, 3) each.
        model: Index into :data:`fovden.tracer.materials.MODELS`, int32, shape (k).
        roughness: In [0, 1], or the factor of the image's, shape (k); see :class:`Material`.
        metallic: Share of metal in [0, 1], or the factor of the image's, shape (k).
        surface: Index into ``surfaces``, or -1, int32, shape (k).
        surfaces: Images of factors to roughness and metallic, linear, shape (h, w, 2) each.
        opacity: Index into ``opacities``, or -1, int32, shape (k).
        opacities: Images of the opacity, shape (h, w) each.
        cutoff: Opacity below which there is a hole, in [0, 1], shape (k).

    Example:
        >>> Materials.of([Material("red", (0.6, 0.1, 0.1)), Material("lamp", (0, 0, 0), (5, 5, 5))]).names
        ('red', 'lamp')
    """

    names: tuple[str, ...]
    albedo: Tensor
    emission: Tensor
    texture: Tensor
    textures: tuple[Tensor, ...] = ()
    model: Tensor = _PLAIN
    roughness: Tensor = _PLAIN
    metallic: Tensor = _PLAIN
    surface: Tensor = _PLAIN
    surfaces: tuple[Tensor, ...] = ()
    opacity: Tensor = _PLAIN
    opacities: tuple[Tensor, ...] = ()
    cutoff: Tensor = _PLAIN

    def __post_init__(self) -> None:
        sizes = require_shapes("k 3", albedo=self.albedo, emission=self.emission)
        count = sizes["k"]
        plain = {
            "model": torch.zeros(count, dtype=torch.int32),
            "roughness": torch.ones(count),
            "metallic": torch.zeros(count),
            "surface": torch.full((count,), -1, dtype=torch.int32),
            "opacity": torch.full((count,), -1, dtype=torch.int32),
            "cutoff": torch.full((count,), CUTOFF),
        }
        for name, values in plain.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, values)
            require_shapes("k", sizes, **{name: getattr(self, name)})
        require_shapes("k", sizes, texture=self.texture)
        require(len(self.names) == count, "names", len(self.names), f"{count} names")
        require(count > 0, "albedo", tuple(self.albedo.shape), "at least one material")
        require_finite("albedo", self.albedo, minimum=0)
        require_finite("emission", self.emission, minimum=0)
        for name in ("albedo", "roughness", "metallic", "cutoff"):
            require_finite(name, getattr(self, name), minimum=0)
            largest = float(getattr(self, name).detach().max())
            require(largest <= 1, name, largest, "numbers of at most 1")
        require_integer("texture", int(self.texture.max()), maximum=len(self.textures) - 1)
        for index, images in (("surface", self.surfaces), ("opacity", self.opacities)):
            require_integer(index, int(getattr(self, index).max()), maximum=len(images) - 1)
        known = int(self.model.min()) >= 0 and int(self.model.max()) < len(MODELS)
        require(known, "model", self.model.tolist(), f"numbers of {', '.join(MODELS)}, from 0")
        for name, shape in (("textures", "h w 3"), ("surfaces", "h w 2"), ("opacities", "h w")):
            for image in getattr(self, name):
                require_shapes(shape, **{name: image})
                require(image.dtype == torch.uint8, name, image.dtype, "uint8 images")
                require(image.numel() > 0, name, tuple(image.shape), "images with pixels")

    @property
    def has_cutouts(self) -> bool:
        """Whether any material has an opacity image."""
        return len(self.opacities) > 0

    @classmethod
    def of(cls, materials: Sequence[Material]) -> Materials:
        """Returns the tables of a list of materials; an image that several share (the same tensor) is kept once.

        Raises:
            ValueError: If a model is unknown.

        Example:
            >>> Materials.of([Material("white", (1, 1, 1))]).albedo
            tensor([[1., 1., 1.]])
        """
        for material in materials:
            require(material.model in MODELS, "model", material.model, f"one of {', '.join(MODELS)}")
        texture, textures = _shared([material.texture for material in materials])
        surface, surfaces = _shared([material.surface for material in materials])
        opacity, opacities = _shared([material.opacity for material in materials])
        return cls(
            names=tuple(material.name for material in materials),
            albedo=torch.tensor([material.albedo for material in materials], dtype=torch.float32).reshape(-1, 3),
            emission=torch.tensor([material.emission for material in materials], dtype=torch.float32).reshape(-1, 3),
            texture=texture,
            textures=textures,
            model=torch.tensor([MODELS.index(material.model) for material in materials], dtype=torch.int32),
            roughness=torch.tensor([float(material.roughness) for material in materials]),
            metallic=torch.tensor([float(material.metallic) for material in materials]),
            surface=surface,
            surfaces=surfaces,
            opacity=opacity,
            opacities=opacities,
            cutoff=torch.tensor([float(material.cutoff) for material in materials]),
        )


def _shared(images: Sequence[Tensor | None]) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Index of each image among the distinct ones, -1 for none, and the distinct ones."""
    distinct: list[Tensor] = []
    index: list[int] = []
    for image in images:
        known = [i for i, other in enumerate(distinct) if other is image]
        if image is not None and not known:
            known = [len(distinct)]
            distinct.append(image)
        index.append(known[0] if known else -1)
    return torch.tensor(index, dtype=torch.int32), tuple(distinct)
