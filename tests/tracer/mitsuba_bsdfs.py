"""Our models as plugins of Mitsuba 3 in Python, from the textbooks' formulas by angles.

Directions are sampled by the cosine, and where there are microfacets half of them by D, as in Walter et al. (2007).
"""

import math


def middle(a, b):
    """The unit vector halfway between two directions."""
    total = [x + y for x, y in zip(a, b, strict=True)]
    length = math.hypot(*total)
    return [x / length for x in total]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def facets(half, alpha):
    """D of Walter et al., equation 33."""
    tangent = math.hypot(half[0], half[1]) / half[2]
    return alpha**2 / (math.pi * half[2] ** 4 * (alpha**2 + tangent**2) ** 2)


def value(model, viewer, light, roughness, metallic, albedo, coat):
    """F of one direction and another above the third axis' horizon; ``coat`` is what a coat reflects by the cosine."""
    thetas = [math.acos(min(1, direction[2])) for direction in (viewer, light)]
    if model == "oren_nayar":
        turn = math.atan2(viewer[1], viewer[0]) - math.atan2(light[1], light[0])
        a = 1 - roughness**2 / (2 * (roughness**2 + 0.33))
        b = 0.45 * roughness**2 / (roughness**2 + 0.09)
        slope = math.sin(max(thetas)) * math.tan(min(thetas))
        diffuse = (a + b * max(0, math.cos(turn)) * slope) / max(1, a + b / 2) / math.pi
        return [diffuse * x for x in albedo]
    alpha, half = roughness**2, middle(viewer, light)
    shadows = [(math.sqrt(1 + (alpha * math.tan(theta)) ** 2) - 1) / 2 for theta in thetas]
    mirrors = facets(half, alpha) / (4 * viewer[2] * light[2] * (1 + sum(shadows)))
    grazing = (1 - dot(viewer, half)) ** 5
    metal = [mirrors * (x + (1 - x) * grazing) for x in albedo]
    if model == "ggx":
        return metal
    through = min(1 - coat(viewer[2]), 1 - coat(light[2])) / math.pi
    base = [mirrors * (0.04 + 0.96 * grazing) + x * through for x in albedo]
    return [metallic * m + (1 - metallic) * d for m, d in zip(metal, base, strict=True)]


def register(mi, coats):
    """Makes the plugin ``fovden``, with the model's name, roughness, metallic, and red, green and blue.

    ``coats`` has, by roughness, the function that says what a coat reflects.
    """

    class Reflector(mi.BSDF):
        def __init__(self, properties):
            super().__init__(properties)
            self.model = properties["model"]
            self.roughness, self.metallic = properties["roughness"], properties["metallic"]
            self.albedo = [properties[name] for name in ("red", "green", "blue")]
            self.mirrors = 0.0 if self.model == "oren_nayar" else 0.5
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = [flags], flags

        def sample(self, context, interaction, choice, number, _active=True):
            bounce, viewer = mi.BSDFSample3f(), list(interaction.wi)
            bounce.wo = mi.warp.square_to_cosine_hemisphere(number)
            if choice < self.mirrors:
                z = math.sqrt((1 - number[0]) / (1 + (self.roughness**4 - 1) * number[0]))
                sine, turn = math.sqrt(max(0, 1 - z * z)), 2 * math.pi * number[1]
                half = [sine * math.cos(turn), sine * math.sin(turn), z]
                bounce.wo = [2 * dot(viewer, half) * h - v for h, v in zip(half, viewer, strict=True)]
            bounce.pdf, bounce.eta = self.pdf(context, interaction, bounce.wo), 1.0
            bounce.sampled_type, bounce.sampled_component = int(mi.BSDFFlags.GlossyReflection), 0
            if bounce.pdf == 0:
                return bounce, mi.Color3f(0)
            return bounce, self.eval(context, interaction, bounce.wo) / bounce.pdf

        def eval(self, _context, interaction, light, _active=True):
            viewer, light = list(interaction.wi), list(light)
            if viewer[2] <= 0 or light[2] <= 0:
                return mi.Color3f(0)
            numbers = self.roughness, self.metallic, self.albedo, coats.get(self.roughness)
            return mi.Color3f([light[2] * x for x in value(self.model, viewer, light, *numbers)])

        def pdf(self, _context, interaction, light, _active=True):
            viewer, light = list(interaction.wi), list(light)
            if viewer[2] <= 0 or light[2] <= 0:
                return 0.0
            half = middle(viewer, light)
            mirrored = facets(half, self.roughness**2) * half[2] / (4 * dot(viewer, half))
            return (1 - self.mirrors) * light[2] / math.pi + self.mirrors * mirrored

        def eval_pdf(self, context, interaction, light, _active=True):
            return self.eval(context, interaction, light), self.pdf(context, interaction, light)

    mi.register_bsdf("fovden", Reflector)
