"""Materials: Lambertian reflectance, plain or textured, and emitted radiance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from fovden.checks import require, require_finite, require_integer, require_shapes

__all__ = ["Material", "Materials"]

Triple = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Material:
    """One material.

    Attributes:
        name: For messages and for looking it up.
        albedo: Diffuse reflectance per channel, linear, in [0, 1]. With a texture it multiplies the texture.
        emission: Radiance emitted on the side of the geometric normal, W/(m^2 sr) per channel.
        texture: Reflectance image, uint8 with the sRGB curve, shape (h, w, 3), top row first; ``None`` for plain.

    Example:
        >>> Material("plaster", (0.8, 0.8, 0.75)).texture is None
        True
    """

    name: str
    albedo: Triple
    emission: Triple = (0.0, 0.0, 0.0)
    texture: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Materials:
    """A scene's materials as tables that are indexed by material number.

    Attributes:
        names: One name each; they need not be unique.
        albedo: Linear reflectance in [0, 1], or the factor of the texture, shape (k, 3).
        emission: Emitted radiance, shape (k, 3).
        texture: Index into ``textures``, or -1, int32, shape (k).
        textures: Reflectance images, uint8 with the sRGB curve, shape (h, w, 3) each, top row first; texture
            coordinate (0, 0) is the lower left corner, images repeat.

    Example:
        >>> Materials.of([Material("red", (0.6, 0.1, 0.1)), Material("lamp", (0, 0, 0), (5, 5, 5))]).names
        ('red', 'lamp')
    """

    names: tuple[str, ...]
    albedo: Tensor
    emission: Tensor
    texture: Tensor
    textures: tuple[Tensor, ...] = ()

    def __post_init__(self) -> None:
        sizes = require_shapes("k 3", albedo=self.albedo, emission=self.emission)
        require_shapes("k", sizes, texture=self.texture)
        require(len(self.names) == sizes["k"], "names", len(self.names), f"{sizes['k']} names")
        require(sizes["k"] > 0, "albedo", tuple(self.albedo.shape), "at least one material")
        require_finite("albedo", self.albedo, minimum=0)
        require_finite("emission", self.emission, minimum=0)
        brightest = float(self.albedo.detach().max())
        require(brightest <= 1, "albedo", brightest, "reflectances of at most 1")
        require_integer("texture", int(self.texture.max()), maximum=len(self.textures) - 1)
        for texture in self.textures:
            require_shapes("h w 3", textures=texture)
            require(texture.dtype == torch.uint8, "textures", texture.dtype, "uint8 images")
            require(texture.numel() > 0, "textures", tuple(texture.shape), "images with pixels")

    @classmethod
    def of(cls, materials: Sequence[Material]) -> Materials:
        """Returns the tables of a list of materials; an image that several share (the same tensor) is kept once.

        Example:
            >>> Materials.of([Material("white", (1, 1, 1))]).albedo
            tensor([[1., 1., 1.]])
        """
        images: list[Tensor] = []
        texture: list[int] = []
        for material in materials:
            known = [i for i, image in enumerate(images) if image is material.texture]
            if material.texture is not None and not known:
                known = [len(images)]
                images.append(material.texture)
            texture.append(known[0] if known else -1)
        return cls(
            names=tuple(material.name for material in materials),
            albedo=torch.tensor([material.albedo for material in materials], dtype=torch.float32).reshape(-1, 3),
            emission=torch.tensor([material.emission for material in materials], dtype=torch.float32).reshape(-1, 3),
            texture=torch.tensor(texture, dtype=torch.int32),
            textures=tuple(images),
        )
