"""The forest's materials and the sizes of their images."""

from __future__ import annotations

from torch import Tensor

from fovden.tracer.materials import Material
from fovden.tracer.procedural.forest.plan import generator
from fovden.tracer.procedural.mesh_builder import Surface
from fovden.tracer.procedural.textures import ground, plants, wood

__all__ = ["surfaces"]

MOSS = (0.33, 0.43, 0.17)
"""Colour of moss wherever it grows, sRGB."""


def surfaces(seed: int) -> dict[str, Surface]:
    """Returns the surfaces by name.

    Example:
        >>> sorted(surfaces(0))[:4]
        ['ash leaf', 'bark', 'bib', 'boulder']
    """
    white = (1.0, 1.0, 1.0)

    def textured(name: str, image: Tensor, tile: float = 1.0) -> Surface:
        return Surface(Material(name, white, texture=image), tile)

    def cut(name: str, image: Tensor, outline: Tensor) -> Surface:
        return Surface(Material(name, white, texture=image, opacity=outline))

    lobed, toothed, crumpled = (
        plants.leaf_outline(4.5, 0.45),
        plants.leaf_outline(9, 0.16, 0.28),
        plants.leaf_outline(3.5, 0.4),
    )
    rng = generator(seed, "textures")
    litter = ((0.55, 0.36, 0.18), (0.62, 0.46, 0.22), (0.45, 0.25, 0.13), (0.66, 0.56, 0.33))
    made = [
        textured("floor", ground.forest_floor(rng, (0.36, 0.28, 0.20), MOSS, litter), 3.6),
        textured("bark", plants.bark(rng, (0.55, 0.45, 0.35), (0.24, 0.18, 0.13), MOSS), 1.0),
        textured("spruce bark", plants.bark(rng, (0.50, 0.37, 0.29), (0.25, 0.17, 0.13), (0.42, 0.46, 0.33)), 1.0),
        textured("needles", plants.needles(rng, (0.34, 0.52, 0.31), (0.13, 0.23, 0.14)), 0.5),
        cut("oak leaf", plants.leaf(rng, (0.36, 0.53, 0.20), (0.58, 0.68, 0.36)), lobed),
        cut("ash leaf", plants.leaf(rng, (0.50, 0.60, 0.22), (0.68, 0.74, 0.42)), toothed),
        cut("dead leaf", plants.leaf(rng, (0.66, 0.40, 0.16), (0.46, 0.26, 0.12)), crumpled),
        textured("fern", plants.leaf(rng, (0.33, 0.55, 0.21), (0.52, 0.68, 0.34))),
        textured("grass", plants.blade(rng, (0.20, 0.32, 0.11), (0.52, 0.63, 0.26))),
        textured("boulder", ground.mossy_stone(rng, (0.42, 0.40, 0.38), (0.60, 0.59, 0.53), MOSS, cover=0.5), 1.0),
        textured("trail stone", ground.mossy_stone(rng, (0.48, 0.44, 0.39), (0.62, 0.59, 0.53), MOSS, cover=0.2), 1.0),
        textured("granite", ground.mossy_stone(rng, (0.46, 0.45, 0.43), (0.62, 0.61, 0.57), MOSS, cover=0.22), 1.0),
        textured("oak", wood.planks(rng, (0.50, 0.36, 0.24), (0.33, 0.22, 0.14)), 0.8),
        textured("shingles", wood.planks(rng, (0.52, 0.40, 0.31), (0.32, 0.24, 0.19)), 0.6),
        textured("end grain", plants.end_grain(rng, (0.74, 0.58, 0.38), (0.55, 0.38, 0.22), (0.25, 0.18, 0.12))),
        textured("toadstool", plants.cap(rng, (0.68, 0.13, 0.09), (0.88, 0.84, 0.76))),
        Surface(Material("mushroom stem", (0.52, 0.46, 0.36))),
        Surface(Material("bib", (0.52, 0.05, 0.04))),
        Surface(Material("iron", (0.028, 0.026, 0.025))),
        Surface(Material("cord", (0.20, 0.15, 0.10))),
        Surface(Material("wax", (0.20, 0.03, 0.02))),
    ]
    return {surface.material.name: surface for surface in made}
