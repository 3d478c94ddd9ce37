"""The G-buffer against rays cast one by one, the camera's projection, and bilinear interpolation done by hand."""

import dataclasses

import numpy as np
import pytest
import torch
from builders import box, rounded, scene_of, sphere

from fovden import parallel
from fovden.camera import Camera, StereoCamera, pixel_centres
from fovden.tracer import Material, trace_gbuffer

U = 2.0**-24  # rounding of float32
RESOLUTION = (30, 40)


def camera(eye=(0.3, 0.4, 3.0), target=(0.0, 0.0, 0.0), **changes):
    return StereoCamera.look_at(eye, target, **{"fov_y_deg": 50, "resolution": RESOLUTION} | changes)


def ball(**attributes):
    vertices, faces = sphere(3)
    return scene_of((rounded(vertices), faces), Material("clay", (0.7, 0.4, 0.2)), **attributes)


def pixels(image):
    """(v, c, h, w) to (v, h w, c)."""
    return image.flatten(2).transpose(1, 2)


def world_rays(views, jitter=(0.0, 0.0)):
    points = pixel_centres(views.resolution) + torch.tensor(jitter)
    return views.rays(points.expand(views.view_count, -1, 2))


@pytest.mark.parametrize("convergence", [None, 2.0])
def test_it_shows_what_single_rays_hit(convergence):
    scene, views = ball(), camera(eye_separation=0.4, convergence=convergence).views
    gbuffer = trace_gbuffer(scene, views)
    origins, directions = world_rays(views)
    hits = scene.intersect(origins.reshape(-1, 3), directions.reshape(-1, 3))
    prim = gbuffer.prim.flatten()
    assert gbuffer.prim.dtype == torch.int32
    assert 0.2 < float(gbuffer.hit.float().mean()) < 0.8
    # The same rays but for rounding: a pixel may show the neighbour where its ray passes within that of an edge.
    same = prim == hits.prim
    assert int((~same).sum()) <= 2
    assert torch.equal((prim >= 0)[same], torch.isfinite(hits.t)[same])
    distance = (gbuffer.position - views.origin[:, :, None, None]).norm(dim=1).flatten()
    hit = same & (prim >= 0)
    # Barycentric weights: directions are off by some U, that is by 3 U at this distance, and triangles are 0.1 wide.
    weights = pixels(gbuffer.barycentric).reshape(-1, 2)
    assert (weights - torch.stack([hits.u, hits.v], dim=1))[hit].abs().amax() < 100 * 3 * U / 0.1
    assert torch.allclose(distance[hit], hits.t[hit], rtol=50 * U, atol=0)
    assert torch.equal(gbuffer.roughness, gbuffer.hit.float())
    assert not gbuffer.motion.any()
    expected = torch.tensor([0.7, 0.4, 0.2]).reshape(1, 3, 1, 1).expand(2, 3, *RESOLUTION)
    assert torch.equal(gbuffer.albedo, expected * gbuffer.hit)


def test_positions_lie_on_the_rays_and_on_the_triangles():
    scene, views = ball(), camera().views
    gbuffer = trace_gbuffer(scene, views)
    hit = gbuffer.hit.flatten(1)
    origins, directions = (field.double() for field in world_rays(views))
    position = pixels(gbuffer.position).double()
    beside = torch.linalg.cross(position - origins, directions).norm(dim=2)
    assert beside[hit].amax() < 30 * 3 * U  # some roundings of numbers up to 3
    u, v = pixels(gbuffer.barycentric).double().unbind(2)
    corners = scene.vertices.double()[scene.faces.long()[pixels(gbuffer.prim)[..., 0].long().clamp_min(0)]]
    mixed = (
        corners[..., 0, :] * (1 - u - v)[..., None]
        + corners[..., 1, :] * u[..., None]
        + corners[..., 2, :] * v[..., None]
    )
    assert (mixed - position)[hit].abs().amax() < 8 * U
    assert ((u >= 0) & (v >= 0) & (u + v <= 1 + 4 * U))[hit].all()


def test_depth_is_that_of_the_projection():
    views = camera(convergence=1.5).views
    gbuffer = trace_gbuffer(ball(), views)
    points, depth = views.project(pixels(gbuffer.position))
    hit = gbuffer.hit.flatten(1)
    assert torch.allclose(gbuffer.depth.flatten(1)[hit], depth[hit], rtol=30 * U, atol=0)
    centres = pixel_centres(RESOLUTION).expand(2, -1, 2)
    # 30 U of direction are 40 pixels / (2 tan 25 degrees) * 30 U pixels and some.
    assert (points - centres)[hit].abs().amax() < 5e-4


@pytest.mark.parametrize("eye", [(0.3, 0.4, 3.0), (0.1, 0.2, 0.1)], ids=["outside", "inside"])
@pytest.mark.parametrize("smooth", [False, True])
def test_normals_are_unit_and_face_the_viewer(eye, smooth):
    vertices, faces = sphere(3)
    scene = scene_of((rounded(vertices), faces), normals=3 * rounded(vertices) if smooth else None)
    views = camera(eye, (-0.3, 0.0, -1.0)).views
    gbuffer = trace_gbuffer(scene, views)
    hit = gbuffer.hit.flatten(1)
    normal = pixels(gbuffer.normal).double()[hit]
    assert (normal.norm(dim=1) - 1).abs().amax() < 4 * U
    corners = vertices[faces.long()][pixels(gbuffer.prim)[..., 0][hit].long()]
    outward = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = -world_rays(views).directions.double()[hit]
    if smooth:
        expected = torch.nn.functional.normalize(pixels(gbuffer.position).double()[hit], dim=1)
        near_rim = (outward * expected).sum(1) == 0
        assert not near_rim.any()
        side = (outward * towards).sum(1).sign()[:, None]
        # A chord's midpoint interpolates its ends' normals to the sphere's own normal only to second order.
        assert (normal - expected * side).norm(dim=1).amax() < 0.01
    else:
        expected = torch.nn.functional.normalize(outward, dim=1)
        side = (expected * towards).sum(1).sign()[:, None]
        assert (normal - expected * side).abs().amax() < 100 * U  # vertices rounded by U, edges 0.1 long
        assert ((normal * towards).sum(1) > 0).all()


def by_hand(texture, u, v):
    """Bilinear interpolation of a repeating sRGB image between texel centres, (0, 0) at the lower left, float64."""
    encoded = texture.numpy().astype(np.float64) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    height, width = linear.shape[:2]
    column, row = u * width - 0.5, (1 - v) * height - 0.5
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right_share, lower_share = (column - left)[:, None], (row - top)[:, None]

    def texel(y, x):
        return linear[y % height, x % width]

    upper = texel(top, left) * (1 - right_share) + texel(top, left + 1) * right_share
    lower = texel(top + 1, left) * (1 - right_share) + texel(top + 1, left + 1) * right_share
    return upper * (1 - lower_share) + lower * lower_share


def picture(texture, lower_left, upper_right, factor=(1.0, 1.0, 1.0)):
    """A textured square from (-1, -1, 0) to (1, 1, 0)."""
    corners = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    (u0, v0), (u1, v1) = lower_left, upper_right
    uv = torch.tensor([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    return scene_of((corners, faces), Material("picture", factor, texture=texture), uv=uv)


@pytest.mark.parametrize("span", [((0.0, 0.0), (1.0, 1.0)), ((-0.75, -2.25), (2.5, 1.125)), ((7.0, 3.0), (6.0, 5.0))])
def test_albedo_of_a_texture_equals_interpolation_by_hand(span):
    texture = torch.randint(0, 256, (5, 7, 3), generator=torch.Generator().manual_seed(3), dtype=torch.uint8)
    factor = (0.5, 1.0, 0.8)
    gbuffer = trace_gbuffer(picture(texture, *span, factor), camera())
    hit = gbuffer.hit.flatten(1)
    place = (pixels(gbuffer.position).double()[hit][:, :2] + 1) / 2
    (u0, v0), (u1, v1) = span
    u, v = (u0 + place[:, 0] * (u1 - u0)).numpy(), (v0 + place[:, 1] * (v1 - v0)).numpy()
    expected = by_hand(texture, u, v) * np.array(factor)
    # Coordinates up to 7 are off by some 7 U, times 7 texels, times a contrast of at most 1.
    assert np.abs(pixels(gbuffer.albedo)[hit].numpy() - expected).max() < 10 * 7 * 7 * U
    assert not gbuffer.albedo[~gbuffer.hit.expand_as(gbuffer.albedo)].any()


def test_texture_coordinates_start_at_the_lower_left():
    texture = torch.zeros(2, 2, 3, dtype=torch.uint8)
    texture[0, 0], texture[0, 1], texture[1, 0] = (torch.tensor([255 * (i == c) for i in range(3)]) for c in range(3))
    # Red above left, green above right, blue below left, black below right; each texel's centre is seen head-on.
    views = camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), fov_y_deg=90, resolution=(2, 2), eye_separation=0.0)
    albedo = trace_gbuffer(picture(texture, (0.0, 0.0), (1.0, 1.0)), views).albedo[0]
    expected = torch.tensor([[[1.0, 0], [0, 0]], [[0, 1], [0, 0]], [[0, 0], [1, 0]]])
    assert torch.allclose(albedo, expected, atol=1e-5)


def test_a_texture_of_one_texel_is_a_colour():
    texture = torch.full((1, 1, 3), 188, dtype=torch.uint8)
    gbuffer = trace_gbuffer(picture(texture, (-3.0, 5.0), (8.0, 5.0)), camera())
    expected = ((188 / 255 + 0.055) / 1.055) ** 2.4
    assert torch.allclose(gbuffer.albedo[gbuffer.hit.expand_as(gbuffer.albedo)], torch.tensor(expected), rtol=8 * U)


def test_misses_are_zero():
    gbuffer = trace_gbuffer(ball(), camera((0.0, 0.0, 3.0), (0.0, 0.0, 6.0)))
    assert gbuffer.prim.eq(-1).all()
    for field in dataclasses.fields(gbuffer):
        if field.name != "prim":
            assert not getattr(gbuffer, field.name).any(), field.name


def test_both_eyes_in_one_dispatch(monkeypatch):
    scene, views = ball(), camera().views
    counts = []
    run = parallel.run
    monkeypatch.setattr(
        parallel,
        "run",
        lambda kernel, count, *rest, **options: (counts.append(count), run(kernel, count, *rest, **options)),
    )
    scene.bvh  # noqa: B018  built before the count starts
    counts.clear()
    both = trace_gbuffer(scene, views)
    assert counts == [2 * -(-RESOLUTION[0] // 4) * -(-RESOLUTION[1] // 4)]  # in tiles of four by four pixels
    for eye in range(2):
        alone = Camera(*(getattr(views, n)[eye : eye + 1] for n in ("origin", "rotation", "bounds")), views.resolution)
        single = trace_gbuffer(scene, alone)
        for field in dataclasses.fields(both):
            assert torch.equal(getattr(single, field.name)[0], getattr(both, field.name)[eye]), field.name
    assert not torch.equal(both.prim[0], both.prim[1])


def test_jitter_shifts_the_rays():
    scene, views = ball(), camera().views
    jittered = trace_gbuffer(scene, views, jitter=(0.3, -0.45))
    hits = scene.intersect(*(field.reshape(-1, 3) for field in world_rays(views, (0.3, -0.45))))
    assert int((jittered.prim.flatten() != hits.prim).sum()) <= 2
    centred = trace_gbuffer(scene, views)
    assert float((jittered.prim != centred.prim).float().mean()) > 0.05
    # Whole pixels: the same picture, moved.
    moved = trace_gbuffer(scene, views, jitter=(1.0, 2.0))
    assert torch.equal(moved.prim[..., :-2, :-1], centred.prim[..., 2:, 1:])
    assert torch.equal(moved.position[..., :-2, :-1], centred.position[..., 2:, 1:])


def test_progress_counts_the_tiles_of_every_view():
    reports = []
    trace_gbuffer(
        scene_of((rounded(box((1, 1, 1), (1, 1, 1))[0]), box((1, 1, 1), (1, 1, 1))[1])),
        camera(),
        progress=reports.append,
    )
    assert reports[-1] == 2 * -(-RESOLUTION[0] // 4) * -(-RESOLUTION[1] // 4)
    assert reports == sorted(reports)
