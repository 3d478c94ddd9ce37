"""Scenes with images, holes and all of their materials for Mitsuba 3, in its compiled variants.

Lambert's surfaces are Mitsuba's ``diffuse``, metals with separable masking its ``principled``. What it does not have is
put in as plugins, in the textbooks' words: glTF's coated surfaces, and holes that are cut where an image falls below a
limit.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
from bsdf_kernels import reflected_by_facets

from benchmarks.mitsuba_scene import describe
from fovden.tracer.materials import MODELS

ROUGHNESS = np.linspace(0.2, 1, 17)
"""Of the coats that can be given to Mitsuba."""
COSINES = np.linspace(0.25, 1, 48) ** 4


def world_of(mi, scene, camera, folder):
    """What ``mi.load_dict`` reads, and the integrator that sees it; meshes are written into a folder.

    Holes need ``volpath``: the shadow rays of ``path`` take a surface with holes for whole.
    """
    tables = scene.materials
    plain = {"model": None, "roughness": None, "metallic": None, "surface": None, "surfaces": ()}
    whole = replace(tables, opacity=None, opacities=(), **plain)
    world = describe(mi, replace(scene, materials=whole), camera, folder)
    for name, shape in world.items():
        if not isinstance(shape, dict) or shape["type"] != "ply":
            continue
        number = int(name.split("-")[0])
        colour = shape["bsdf"]["bsdf"]["reflectance"]
        shape["bsdf"] = {"type": "twosided", "bsdf": surface_of(mi, tables, number, colour)}
        if tables.opacity[number] >= 0:
            image = bitmap(mi, tables.opacities[int(tables.opacity[number])].numpy() / 255)
            holes = {"type": "holes", "image": image, "cutoff": float(tables.cutoff[number])}
            shape["bsdf"] = {"type": "mask", "opacity": holes, "nested": shape["bsdf"]}
    return world, "volpath" if tables.has_cutouts else "path"


def surface_of(mi, tables, number, colour):
    model = MODELS[int(tables.model[number])]
    if model == "lambert":
        return {"type": "diffuse", "reflectance": colour}
    roughness, metallic = (factor(mi, tables, number, channel) for channel in (0, 1))
    if model == "ggx_separable":
        return {"type": "principled", "base_color": colour, "metallic": 1.0, "roughness": roughness}
    assert model == "metallic_roughness"
    return {"type": "coated", "base_color": colour, "roughness": roughness, "metallic": metallic}


def factor(mi, tables, number, channel):
    """Roughness (channel 0) or metallic (1) as an image."""
    values, image = (tables.roughness, tables.metallic)[channel][number], int(tables.surface[number])
    shares = tables.surfaces[image][..., channel].numpy() / 255 if image >= 0 else np.ones((2, 2))
    return bitmap(mi, float(values) * shares)


def bitmap(mi, values):
    """An image (h, w) of plain numbers."""
    image = mi.Bitmap(values[..., None].astype(np.float32))
    return {"type": "bitmap", "bitmap": image, "raw": True, "filter_type": "bilinear", "wrap_mode": "repeat"}


@cache
def coats():
    """What a coat reflects in all, by roughness and cosine."""
    return np.array([[reflected_by_facets(c, r * r, 0.04, 64) for c in COSINES] for r in ROUGHNESS], np.float32)


def register(mi):
    """Makes the plugins ``holes`` and ``coated`` for the variant that is set, a compiled one."""
    import drjit as dr

    class Holes(mi.Texture):
        """1 where an image, interpolated, reaches a limit, and 0 elsewhere."""

        def __init__(self, properties):
            super().__init__(properties)
            self.image, self.cutoff = properties["image"], properties["cutoff"]

        def eval_1(self, interaction, active=True):
            return dr.select(self.image.eval_1(interaction, active) >= self.cutoff, mi.Float(1), mi.Float(0))

        def is_spatially_varying(self):
            return True

    table = mi.Texture2f(mi.TensorXf(coats()[..., None]), wrap_mode=dr.WrapMode.Clamp)

    def reflected(roughness, cosine):
        column = (dr.sqrt(dr.sqrt(cosine)) - 0.25) / 0.75 * (len(COSINES) - 1)
        row = (roughness - 0.2) / 0.8 * (len(ROUGHNESS) - 1)
        return table.eval(mi.Point2f((column + 0.5) / len(COSINES), (row + 0.5) / len(ROUGHNESS)))[0]

    class Coated(mi.BSDF):
        """Appendix B of glTF 2.0, with what the coat lets through as in :mod:`fovden.tracer.bsdf`."""

        def __init__(self, properties):
            super().__init__(properties)
            self.images = [properties.get_texture(name) for name in ("base_color", "roughness", "metallic")]
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying
            self.m_components, self.m_flags = [flags], flags

        def sample(self, context, interaction, choice, number, active=True):
            """Half of the directions by the cosine, half by Walter et al. (2007), equations 35 and 36."""
            viewer, alpha = interaction.wi, self.images[1].eval_1(interaction, active) ** 2
            theta, phi = dr.atan(alpha * dr.sqrt(number[0] / (1 - number[0]))), 2 * math.pi * number[1]
            half = mi.Vector3f(dr.sin(theta) * dr.cos(phi), dr.sin(theta) * dr.sin(phi), dr.cos(theta))
            mirrored = 2 * dr.dot(viewer, half) * half - viewer
            light = dr.select(choice < 0.5, mirrored, mi.warp.square_to_cosine_hemisphere(number))
            bounce = dr.zeros(mi.BSDFSample3f)
            bounce.wo, bounce.eta, bounce.sampled_component = light, 1.0, 0
            bounce.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            value, bounce.pdf = self.eval_pdf(context, interaction, light, active)
            return bounce, dr.select(bounce.pdf > 0, value / bounce.pdf, 0)

        def eval_pdf(self, _context, interaction, light, active=True):
            viewer = interaction.wi
            above = active & (viewer.z > 0) & (light.z > 0)
            colour = self.images[0].eval(interaction, active)
            roughness, metallic = (image.eval_1(interaction, active) for image in self.images[1:])
            alpha, half = roughness**2, dr.normalize(viewer + light)
            facets = alpha**2 / (math.pi * half.z**4 * (alpha**2 + tangent(half) ** 2) ** 2)
            shadows = [(dr.sqrt(1 + (alpha * tangent(way)) ** 2) - 1) / 2 for way in (viewer, light)]
            mirrors = facets / (4 * viewer.z * light.z * (1 + shadows[0] + shadows[1]))
            grazing = (1 - dr.dot(viewer, half)) ** 5
            through = dr.minimum(1 - reflected(roughness, viewer.z), 1 - reflected(roughness, light.z)) / math.pi
            metal = mirrors * (colour + (1 - colour) * grazing)
            other = mirrors * (0.04 + 0.96 * grazing) + colour * through
            value = (metallic * metal + (1 - metallic) * other) * light.z
            density = light.z / (2 * math.pi) + facets * half.z / (8 * dr.dot(viewer, half))
            return dr.select(above, value, 0), dr.select(above, density, 0)

        def eval(self, context, interaction, light, active=True):
            return self.eval_pdf(context, interaction, light, active)[0]

        def pdf(self, context, interaction, light, active=True):
            return self.eval_pdf(context, interaction, light, active)[1]

    def tangent(direction):
        return dr.sqrt(direction.x**2 + direction.y**2) / direction.z

    mi.register_texture("holes", Holes)
    mi.register_bsdf("coated", Coated)
