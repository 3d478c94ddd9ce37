"""Light as optics textbooks have it: closed forms, computed here in double precision."""

import math

import numpy as np
import pytest
import torch
from scipy import ndimage
from shapes import box, matt, pixels, rectangle, scene_of, seen_points, sphere, view
from significance import assert_mean

from fovden.color import srgb_to_linear
from fovden.tracer import (
    DirectionalLight,
    EnvironmentLight,
    Integrator,
    Material,
    PointLight,
    trace_frame,
    trace_gbuffer,
)

RELATIVE = 1e-5
"""What single precision may cost a noiseless radiance: some hundred roundings of 2^-24 each."""
LIFT = 12 * 2.0**-19
"""How far above :func:`floor` a shadow ray starts: 2^-19 of its coordinates (up to 4) and longest edge (8). The light
is that much nearer, which a point light at height h turns into a relative error of 2 LIFT / h."""
ALBEDO = (0.7, 0.5, 0.2)
UP = np.array([0.0, 1.0, 0.0])


def floor(size=4.0, height=0.0):
    """A horizontal square that faces up."""
    return rectangle((-size, height, -size), (0, 0, 2 * size), (2 * size, 0, 0))


def batches(scene, camera, spp, count=32, lights="uniform"):
    """Independent frames; each camera's coinciding views count as frames of their own. Shape (batches, h w, 3)."""
    frames = [
        trace_frame(scene, camera, spp, seed=seed, integrator=Integrator(lights=lights))
        for seed in range(-(-count // 2))
    ]
    parts = {name: [pixels(getattr(frame, name)) for frame in frames] for name in ("direct", "indirect", "emission")}
    return {name: np.concatenate(values) for name, values in parts.items()}


def polygon_form_factor(points, normal, polygon):
    """Lambert's formula (Photometria, 1760): irradiance / (pi radiance) of points with one normal that see a whole
    polygon, 1 / (2 pi) sum of the angles that its edges subtend, each times the cosine of the normal and the edge's
    plane."""
    rays = np.asarray(polygon, dtype=float)[None] - points[:, None]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    following = np.roll(rays, -1, axis=1)
    angles = np.arccos(np.clip((rays * following).sum(2), -1, 1))
    planes = np.cross(rays, following)
    planes /= np.linalg.norm(planes, axis=2, keepdims=True)
    return np.abs((angles * (planes @ normal)).sum(1)) / (2 * math.pi)


def assert_close(values, expected, relative=RELATIVE):
    np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape), rtol=relative, atol=1e-9)


@pytest.mark.parametrize("height", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("side", [1, -1])
def test_a_point_light_falls_off_with_the_square_of_distance_and_the_cosine(height, side):
    """Also seen from below with the light there: surfaces scatter on both sides."""
    intensity = np.array([3.0, 2.0, 1.0])
    light = np.array([0.3, side * height, -0.2])
    scene = scene_of([(floor(), matt(ALBEDO))], [PointLight(tuple(light), tuple(intensity))])
    camera = view((0, side * 1.5, 1.5), (0, 0, 0))
    frame = trace_frame(scene, camera, 2)
    towards = light - seen_points(camera, (0, 0, 0), UP)
    distance = np.linalg.norm(towards, axis=1, keepdims=True)
    cosine = side * towards @ UP[:, None] / distance
    expected = np.array(ALBEDO) / math.pi * intensity * cosine / distance**2
    assert_close(pixels(frame.direct), expected, RELATIVE + 2 * LIFT / height)
    assert (frame.indirect == 0).all()
    assert (frame.emission == 0).all()


def test_a_directional_light_gives_its_irradiance_times_the_cosine():
    irradiance = np.array([12.0, 11.0, 10.0])
    for tilt in (0.0, 0.5, 1.2, 1.56):
        travel = (0.6 * math.sin(tilt), -math.cos(tilt), 0.8 * math.sin(tilt))
        light = DirectionalLight(tuple(7 * x for x in travel), tuple(irradiance))
        frame = trace_frame(scene_of([(floor(), matt(ALBEDO))], [light]), view((0, 1.5, 1.5), (0, 0, 0)), 2)
        assert_close(pixels(frame.direct), np.array(ALBEDO) / math.pi * irradiance * math.cos(tilt))


@pytest.mark.parametrize("light", [PointLight((0, 3, 0), 5), DirectionalLight((0.2, -1, 0.1), 5)])
def test_light_does_not_pass_through_a_surface(light):
    frame = trace_frame(scene_of([(floor(), matt(ALBEDO))], [light]), view((0, -1.5, 1.5), (0, 0, 0)), 2)
    assert frame.gbuffer.hit.all()
    assert (frame.radiance == 0).all()


def test_a_shadow_lies_where_straight_lines_to_the_light_are_blocked():
    light = np.array([0.4, 4.0, 0.1])
    blocker = rectangle((-0.5, 2, -0.5), (0, 0, 1), (1, 0, 0))
    scene = scene_of([(floor(), matt(1)), (blocker, matt(0))], [PointLight(tuple(light), 10)])
    camera = view((0, 1.8, 2.5), (0, 0, 0), size=48, fov=30)
    points = seen_points(camera, (0, 0, 0), UP)
    crossing = points + (light - points) * (2 / 4)  # at the blocker's height
    distance = np.abs(crossing[:, [0, 2]]).max(1) - 0.5
    lit = pixels(trace_frame(scene, camera, 1).direct)[0, :, 0] > 0
    clear = np.abs(distance) > 2 * LIFT  # the shadow ray starts that little above the floor
    assert clear.mean() > 0.99
    assert 0.1 < lit.mean() < 0.9
    assert (lit == (distance > 0))[clear].all()


@pytest.mark.parametrize(
    "polygon",
    [
        [(-0.8, 2, -0.5), (1.0, 2, -0.5), (1.0, 2, 0.7), (-0.8, 2, 0.7)],
        [(0.6, 0.5, -0.4), (1.5, 2.5, 0.9), (0.2, 1.5, -1.6)],
    ],
    ids=["rectangle", "tilted triangle"],
)
def test_an_emitting_polygon_gives_lamberts_irradiance(polygon):
    corners = torch.tensor(polygon, dtype=torch.float64)
    triangles = torch.stack([corners[[0, i, i + 1]] for i in range(1, len(corners) - 1)])
    emission = np.array([4.0, 2.0, 1.0])
    scene = scene_of([(floor(), matt(ALBEDO)), (triangles, matt(0, emission))])
    camera = view((0.2, 0.9, 3), (0.2, 0, 0.4), size=4, fov=12)
    points = seen_points(camera, (0, 0, 0), UP)
    expected = np.array(ALBEDO) * emission * polygon_form_factor(points, UP, polygon)[:, None]
    for lights in ("uniform", "power", "tree"):
        parts = batches(scene, camera, spp=256, count=64, lights=lights)
        assert_mean(parts["direct"], expected)
        # 262144 samples, each with a relative standard deviation of about 1: 0.2 % by noise, five times that is
        # a bound that a wrong constant cannot meet.
        assert parts["direct"].mean() == pytest.approx(expected.mean(), rel=0.01)
        assert (parts["indirect"] == 0).all(), "a bounce ray that meets an emitter adds nothing"


def test_emission_leaves_on_the_side_of_the_geometric_normal_only():
    lamp = rectangle((-0.5, 1, -0.5), (1, 0, 0), (0, 0, 1))  # faces down
    emission = (4.0, 2.0, 1.0)
    above, below = floor(height=3.0), floor()
    scene = scene_of([(below, matt(ALBEDO)), (above, matt(ALBEDO)), (lamp, matt(0.5, emission))])
    seen = {side: trace_frame(scene, view((0.01, 1 + side, 0), (0, 1, 0), fov=30), 64) for side in (1, -1)}
    assert (seen[-1].gbuffer.prim >= 4).all()
    assert (seen[1].gbuffer.prim >= 4).all()
    assert_close(pixels(seen[-1].emission), emission)
    assert (seen[1].emission == 0).all()
    assert (seen[1].direct == 0).all()
    ceiling = trace_frame(scene, view((0, 2, 2), (0, 3, 0), fov=30), 64)
    ground = trace_frame(scene, view((0, 0.8, 1.5), (0, 0, 0), fov=30), 64)
    assert (ceiling.direct == 0).all()
    assert (ground.direct.amin(1) > 0).all()
    assert (ground.emission == 0).all()


def test_one_bounce_carries_what_lamberts_formula_says():
    """A sunlit rectangle on the ground lights a wall that the sun's rays are parallel to.

    The rectangle's radiance is albedo / pi * irradiance; the wall gets nothing directly, and so the radiance that it
    reflects is its albedo times that radiance times the form factor.
    """
    patch = [(0.2, 0, -1), (0.2, 0, 1), (1.7, 0, 1), (1.7, 0, -1)]
    ground = rectangle(patch[0], (0, 0, 2), (1.5, 0, 0))
    wall = rectangle((0, 0, -5), (0, 5, 0), (0, 0, 10))  # faces +x
    grey = np.array([0.9, 0.6, 0.3])
    scene = scene_of([(wall, matt(ALBEDO)), (ground, matt(grey))], [DirectionalLight((0, -1, 0), 10)])
    camera = view((2, 0.8, 0), (0, 0.8, 0), size=4, fov=40)
    points = seen_points(camera, (0, 0, 0), (1, 0, 0))
    form = polygon_form_factor(points, np.array([1.0, 0, 0]), patch)[:, None]
    parts = batches(scene, camera, spp=1024, count=64)
    expected = np.array(ALBEDO) * grey / math.pi * 10 * form
    assert (parts["direct"] == 0).all()
    assert_mean(parts["indirect"], expected)
    assert parts["indirect"].mean() == pytest.approx(expected.mean(), rel=0.01)


@pytest.mark.parametrize("shape", [box((-1, -1, -1), (1, 1, 1)), sphere(2)], ids=["box", "sphere"])
def test_a_convex_body_in_a_white_furnace_reflects_its_albedo(shape):
    """Every sample, not only their mean: cosine sampling has no variance under a constant sky."""
    sky = np.array([1.0, 0.5, 2.0])
    scene = scene_of([(shape, matt(ALBEDO))], [EnvironmentLight(tuple(sky))])
    frame = trace_frame(scene, view((2, 3, 4), (0, 0, 0), size=24, fov=50), 4)
    hit = frame.gbuffer.hit.expand(-1, 3, -1, -1)
    assert 0.1 < hit.float().mean() < 0.9
    body = (torch.tensor(ALBEDO) * torch.tensor(sky)).float()[None, :, None, None].expand_as(hit)
    background = torch.tensor(sky).float()[None, :, None, None].expand_as(hit)
    torch.testing.assert_close(frame.direct, torch.where(hit, body, 0), rtol=1e-5, atol=0)
    torch.testing.assert_close(frame.emission, torch.where(hit, 0, background), rtol=1e-6, atol=0)
    assert (frame.indirect == 0).all(), "a bounce ray that meets the surroundings adds nothing"


def test_a_closed_room_keeps_the_sky_out():
    room = box((-1, -1, -1), (1, 1, 1), inwards=True)
    scene = scene_of([(room, matt(0.9)), (sphere(1) * 0.3, matt(0.9))], [EnvironmentLight(5)])
    frame = trace_frame(scene, view((0.2, 0.5, 0.9), (0, 0, 0), size=32, fov=90), 16)
    assert frame.gbuffer.hit.all()
    assert (frame.radiance == 0).all()


def test_an_emitting_closed_room_gives_the_first_terms_of_the_geometric_series():
    """Inside walls of radiance L the irradiance is pi L everywhere: L, then albedo L, then albedo^2 L.

    The room is a faceted sphere, 1280 emitting triangles: points near the edge of a box would see its other wall with
    a density that makes the variance infinite.
    """
    emission = np.array([1.0, 2.0, 4.0])
    scene = scene_of([(sphere(3, inwards=True), matt(ALBEDO, emission))])
    camera = view((0.1, 0.2, 0.3), (1, 0, 0), fov=70)
    for lights in ("uniform", "power", "tree"):
        parts = batches(scene, camera, spp=32, lights=lights)
        direct, indirect = (np.array(ALBEDO) ** n * emission for n in (1, 2))
        assert_close(parts["emission"], emission)
        assert_mean(parts["direct"].mean(1), direct)
        assert_mean(parts["indirect"].mean(1), indirect)
        np.testing.assert_allclose(parts["direct"].mean((0, 1)), direct, rtol=0.005)
        np.testing.assert_allclose(parts["indirect"].mean((0, 1)), indirect, rtol=0.005)


def test_a_lamp_in_the_middle_of_a_sphere_lights_it_by_bounces_evenly():
    """Radius 1: direct albedo I / pi; a point of a sphere sees all of it alike, so the bounce gives albedo^2 I / pi.

    The facets of 5120 triangles lie up to 0.1 % inside the sphere and tilt by up to 2.5 degrees, which moves the mean
    by 0.3 % at most.
    """
    scene = scene_of([(sphere(4, inwards=True), matt(ALBEDO))], [PointLight((0, 0, 0), 3)])
    parts = batches(scene, view((0, 0, 0.5), (1, 0, 0), fov=70), spp=64)
    for name, power in (("direct", 1), ("indirect", 2)):
        expected = np.array(ALBEDO) ** power * 3 / math.pi
        np.testing.assert_allclose(parts[name].mean((0, 1)), expected, rtol=0.005, err_msg=name)


def tilted(normals):
    """A floor triangle with shading normals, one row per vertex, and room for a light."""
    triangle = torch.tensor([[[-4.0, 0, -4], [0, 0, 4], [4, 0, -4]]], dtype=torch.float64)
    return triangle, torch.nn.functional.normalize(torch.tensor(normals), dim=1)


def test_shading_normals_are_interpolated_and_decide_the_cosine():
    triangle, normals = tilted([[0.3, 1, 0], [0, 1, 0.4], [-0.1, 1, -0.2]])
    light = np.array([0.5, 3.0, 0.4])
    scene = scene_of([(triangle, matt(ALBEDO))], [PointLight(tuple(light), 2)], normals=normals)
    camera = view((0, 1.5, 1.5), (0, 0, 0))
    points = seen_points(camera, (0, 0, 0), UP)
    plane = triangle[0, :, [0, 2]].numpy()
    weights = np.linalg.solve(np.vstack([plane.T, np.ones(3)]), np.vstack([points[:, [0, 2]].T, np.ones(len(points))]))
    shading = weights.T @ normals.double().numpy()
    shading /= np.linalg.norm(shading, axis=1, keepdims=True)
    towards = light - points
    distance = np.linalg.norm(towards, axis=1)
    cosine = (shading * towards).sum(1) / distance
    frame = trace_frame(scene, camera, 1)
    np.testing.assert_allclose(pixels(frame.gbuffer.normal)[0], shading, atol=1e-6)
    expected = np.array(ALBEDO) / math.pi * 2 * (cosine / distance**2)[:, None]
    assert_close(pixels(frame.direct), expected, RELATIVE + 2 * LIFT / 3)
    below = trace_frame(scene, view((0, -1.5, 1.5), (0, 0, 0)), 1)
    assert (pixels(below.gbuffer.normal) @ UP < 0).all(), "normals are on the viewer's side"


def test_a_zero_normal_means_the_triangles_own():
    triangle, _ = tilted([[0.0, 1, 0]] * 3)
    scene = scene_of([(triangle, matt(1))], normals=torch.zeros(3, 3))
    assert (pixels(trace_gbuffer(scene, view((0, 1.5, 1.5), (0, 0, 0))).normal) == UP).all()


def test_light_must_lie_on_the_viewers_side_of_both_normals():
    triangle, normals = tilted([[1.0, 1, 0]] * 3)  # 45 degrees off
    camera = view((0, 1.5, 1.5), (0, 0, 0))

    def lit(position):
        scene = scene_of([(triangle, matt(1))], [PointLight(position, 1)], normals=normals)
        return (trace_frame(scene, camera, 1).direct > 0).flatten()

    assert lit((0, 20, 0)).all()
    assert not lit((100, -20, 0)).any(), "above the shading normal's horizon, behind the surface"
    assert not lit((-100, 20, 0)).any(), "in front of the surface, below the shading normal's horizon"


def test_bounces_into_the_surface_are_dropped():
    """With a shading normal 45 degrees off, a part of the bounce rays would start into the surface. They carry no
    light; otherwise they would find the very triangle that they start from, which is lit."""
    triangle, normals = tilted([[1.0, 1, 0]] * 3)
    scene = scene_of([(triangle, matt(1))], [PointLight((0, 2, 0), 1)], normals=normals)
    frame = trace_frame(scene, view((0, 1.5, 1.5), (0, 0, 0)), 256)
    assert (frame.direct > 0).any()
    assert (frame.indirect == 0).all()


def test_textures_are_decoded_then_interpolated_and_repeat():
    generator = torch.Generator().manual_seed(3)
    image = torch.randint(0, 256, (5, 7, 3), generator=generator, dtype=torch.uint8)
    square = rectangle((-1, 0, -1), (0, 0, 2), (2, 0, 0))
    origin, per_x, per_z = np.array([-0.7, 0.4]), np.array([1.3, 0.2]), np.array([-0.3, -1.6])  # u, v of a point
    corners = square.reshape(-1, 3).numpy()
    uv = torch.from_numpy(origin + corners[:, :1] * per_x + corners[:, 2:] * per_z).float()
    tint = (1.0, 0.5, 0.25)
    scene = scene_of([(square, Material("tiles", tint, texture=image))], uv=uv)
    camera = view((0, 2, 0.01), (0, 0, 0), size=48, fov=45)
    points = seen_points(camera, (0, 0, 0), UP)
    u, v = (origin + points[:, :1] * per_x + points[:, 2:] * per_z).T
    assert u.min() < -1 < 0.5 < u.max()  # well beyond one repetition on both sides
    linear = srgb_to_linear(image.double() / 255).numpy()
    tiled = np.tile(linear, (9, 9, 1))
    rows, columns = (1 - v + 4) * 5 - 0.5, (u + 4) * 7 - 0.5
    expected = [ndimage.map_coordinates(tiled[..., c], [rows, columns], order=1) * tint[c] for c in range(3)]
    albedo = pixels(trace_gbuffer(scene, camera).albedo)[0]
    # A float32 coordinate of up to 2 is known to 2^-22; times the texels and their contrast of at most 1.
    np.testing.assert_allclose(albedo, np.stack(expected, 1), atol=5e-6)
