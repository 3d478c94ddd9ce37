"""The pink room's materials, by name."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from fovden.tracer.materials import Material
from fovden.tracer.procedural.mesh_builder import Surface
from fovden.tracer.procedural.textures import cloth, paper, pictures, plants, stone, wood

__all__ = ["surfaces"]


def surfaces(rng: np.random.Generator) -> dict[str, Surface]:
    """Returns the room's surfaces by name: pinks from blush to raspberry, with sage, gold and dark wood beside them.

    Example:
        >>> surfaces(np.random.default_rng(0))["wallpaper"].tile
        0.9
    """
    white, cream, blush, rose = (1.0, 1.0, 1.0), (0.95, 0.91, 0.86), (0.94, 0.80, 0.79), (0.86, 0.56, 0.60)
    raspberry, wine, sage, gold = (0.70, 0.27, 0.38), (0.42, 0.16, 0.23), (0.66, 0.71, 0.60), (0.86, 0.72, 0.42)

    def textured(name: str, image: Tensor, tile: float) -> Surface:
        return Surface(Material(name, white, texture=image), tile)

    bindings = [raspberry, wine, sage, cream, blush, rose, (0.30, 0.36, 0.46), (0.50, 0.36, 0.26), (0.36, 0.42, 0.36)]
    made = [
        textured(
            "wallpaper",
            paper.wallpaper(
                rng, (0.93, 0.78, 0.78), (0.95, 0.83, 0.82), (0.87, 0.55, 0.60), (0.72, 0.32, 0.42), (0.58, 0.64, 0.52)
            ),
            0.9,
        ),
        textured("plaster", stone.plaster(rng, (0.96, 0.93, 0.90), (0.92, 0.86, 0.83)), 2.0),
        textured("painted wood", stone.plaster(rng, (0.95, 0.89, 0.87), (0.92, 0.83, 0.82)), 1.4),
        textured("parquet", wood.grain(rng, (0.80, 0.64, 0.50), (0.66, 0.48, 0.36)), 0.55),
        Surface(Material("joint", (0.10, 0.06, 0.04))),
        textured("dark wood", wood.grain(rng, (0.52, 0.31, 0.21), (0.33, 0.18, 0.12)), 0.5),
        textured("white oak", wood.grain(rng, (0.90, 0.81, 0.76), (0.82, 0.69, 0.64)), 0.6),
        textured("velvet", cloth.woven(rng, (0.80, 0.45, 0.52), (0.74, 0.38, 0.46), 48), 0.12),
        textured("chintz", cloth.damask(rng, (0.90, 0.83, 0.76), (0.80, 0.50, 0.54)), 0.24),
        textured("curtain", cloth.damask(rng, (0.80, 0.46, 0.52), (0.90, 0.68, 0.68)), 0.34),
        textured("valance", cloth.woven(rng, (0.72, 0.34, 0.43), (0.66, 0.28, 0.38), 40), 0.12),
        textured("quilt", cloth.patchwork(rng, [cream, blush, rose, sage, raspberry]), 0.63),
        textured("linen", cloth.woven(rng, (0.94, 0.91, 0.86), (0.90, 0.85, 0.80), 40), 0.12),
        textured("ticking", cloth.striped(rng, (0.94, 0.88, 0.84), (0.74, 0.38, 0.46)), 0.16),
        textured("sage cloth", cloth.damask(rng, (0.60, 0.66, 0.54), (0.76, 0.79, 0.69)), 0.2),
        textured("tablecloth", cloth.damask(rng, (0.94, 0.89, 0.85), (0.90, 0.72, 0.73)), 0.30),
        textured(
            "carpet",
            cloth.carpet(rng, (0.82, 0.56, 0.56), (0.66, 0.33, 0.40), (0.95, 0.88, 0.80), (0.40, 0.18, 0.25)),
            1.0,
        ),
        textured("wool", cloth.woven(rng, (0.95, 0.90, 0.84), (0.91, 0.84, 0.78), 16), 0.04),
        textured("pink wool", cloth.woven(rng, (0.90, 0.66, 0.69), (0.86, 0.58, 0.63), 16), 0.04),
        textured("marble", stone.marble(rng, (0.93, 0.90, 0.88), (0.66, 0.56, 0.57)), 0.8),
        textured("bindings", paper.book_spines(rng, bindings, gold), 1.0),
        textured("pages", paper.page_edges(rng, (0.93, 0.89, 0.80)), 0.06),
        textured("landscape", pictures.landscape(rng), 1.0),
        textured("bouquet", pictures.bouquet(rng), 1.0),
        textured("fruit", pictures.fruit(rng), 1.0),
        textured("willow", wood.grain(rng, (0.74, 0.58, 0.38), (0.58, 0.42, 0.26)), 0.2),
        textured("leaf", plants.leaf(rng, (0.38, 0.50, 0.28), (0.56, 0.64, 0.42)), 1.0),
        textured("petal", plants.leaf(rng, (0.93, 0.66, 0.69), (0.96, 0.76, 0.77)), 1.0),
        textured("red petal", plants.leaf(rng, (0.78, 0.28, 0.38), (0.84, 0.40, 0.48)), 1.0),
        textured("white petal", plants.leaf(rng, (0.96, 0.91, 0.86), (0.95, 0.84, 0.82)), 1.0),
        textured("porcelain", stone.marble(rng, (0.93, 0.91, 0.90), (0.45, 0.52, 0.68)), 0.5),
        textured("terracotta", stone.terracotta(rng, (0.80, 0.56, 0.46)), 0.4),
        textured("meadow", pictures.meadow(rng, (0.62, 0.72, 0.44), (0.42, 0.55, 0.32), (0.95, 0.82, 0.86)), 5.0),
        textured("shade", cloth.woven(rng, (0.52, 0.27, 0.28), (0.46, 0.22, 0.24), 24), 0.06),
        Surface(Material("brass", (0.60, 0.43, 0.18))),
        Surface(Material("gold cord", (0.68, 0.48, 0.20))),
        Surface(Material("gilt", (0.64, 0.46, 0.20))),
        Surface(Material("piping", (0.33, 0.07, 0.12))),
        Surface(Material("enamel", (0.80, 0.74, 0.70))),
        Surface(Material("candle", (0.88, 0.84, 0.74))),
        Surface(Material("glass", (0.82, 0.80, 0.84))),
        Surface(Material("earth", (0.12, 0.08, 0.05))),
        Surface(Material("stem", (0.18, 0.25, 0.10))),
    ]
    return {surface.material.name: surface for surface in made}
