"""Frames in the cells of a raster: their rays, their light, their motion, and where there are none."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from builders import lit_room, rounded, scene_of, sphere
from scipy import stats
from significance import LEVEL, assert_same_mean
from test_determinism import assert_same_bits, set_tiles

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.foveation import LogPolarWarp, SampleMap, ScreenWarp, ThreeLayer, VisualPolarWarp, sample_map, uniform_map
from fovden.tracer import (
    EnvironmentLight,
    Instant,
    Integrator,
    Material,
    disoccluded,
    make_scene,
    reshade,
    surface_points,
    trace_frame,
    trace_gbuffer,
)
from fovden.tracer.motion import motion_vectors

CAMERA = StereoCamera.look_at((0.2, 0.1, 1.8), (0.0, -0.2, 0.0), fov_y_deg=70, resolution=(24, 30)).views
GAZE = Gaze(torch.tensor([[11.3, 9.8], [34.0, 5.1]]))  # one beside the image
WARPS = {
    "screen": ScreenWarp.for_camera(CAMERA, GAZE),
    "log-polar": LogPolarWarp.for_camera(CAMERA, GAZE, sigma=1.1),
    "visual-polar": VisualPolarWarp.for_camera(CAMERA, GAZE, scale=0.9),
    "stair": VisualPolarWarp(GAZE, (24, 30), (22, 27), cut="stair", metric="angle", block=4),
}
POLAR = [name for name in WARPS if name != "screen"]


@pytest.fixture(scope="module")
def scene():
    return lit_room()


def open_scene(radiance=2.0):
    """A ball of albedo 1/2 under a sky of one colour: half of the sky's radiance everywhere on it."""
    points, faces = sphere(3)
    grey = Material("grey", (0.5, 0.5, 0.5))
    return scene_of((rounded(points, 0.7), faces), grey, lights=(EnvironmentLight((radiance,) * 3),))


def test_the_raster_of_the_screen_changes_nothing(scene):
    samples = sample_map(ThreeLayer(r0=4, r1=8), CAMERA, GAZE, spp=3, seed=2)
    previous = Instant(scene, StereoCamera.look_at((0.3, 0.1, 1.8), (0, 0, 0), fov_y_deg=70, resolution=(24, 30)))
    for options in ({}, {"jitter": (0.25, -0.125), "previous": previous}):
        plain = trace_frame(scene, CAMERA, samples, seed=5, **options)
        warped = trace_frame(scene, CAMERA, samples, warp=WARPS["screen"], seed=5, **options)
        assert warped.warp is WARPS["screen"]
        assert_same_bits(dataclasses.replace(warped, warp=None), plain)
    mapped = sample_map(ThreeLayer(r0=4, r1=8), CAMERA, GAZE, spp=3, seed=2, warp=WARPS["screen"])
    assert torch.equal(mapped.counts.expand_as(plain.counts), samples.counts.expand_as(plain.counts))
    assert torch.equal(mapped.layer.expand_as(plain.layer), samples.layer.expand_as(plain.layer))


@pytest.mark.parametrize("name", POLAR)
@pytest.mark.parametrize("jitter", [(0.0, 0.0), (-0.5, 0.375)])
def test_cells_see_what_their_rays_meet(scene, name, jitter):
    """The kernel rounds directions otherwise than tensor operations: by some units in the last place."""
    warp = WARPS[name]
    gbuffer = trace_gbuffer(scene, CAMERA, warp=warp, jitter=jitter)
    rays = warp.cell_to_ray(CAMERA, warp.cells() + torch.tensor(jitter))
    hits = scene.intersect(*(part.flatten(0, 1).contiguous() for part in rays))
    hits = type(hits)(*(part.reshape(2, -1) for part in hits))
    there = warp.exists.expand(2, -1, -1, -1).reshape(2, -1)
    prim = gbuffer.prim.reshape(2, -1)
    alike = prim == hits.prim
    assert (alike | ~there).double().mean() > 0.995  # but for edges of triangles
    kept = there & alike & (hits.prim >= 0)
    assert kept.double().mean() > 0.5
    points = rays.origins + hits.t[..., None] * rays.directions
    assert torch.allclose(gbuffer.position.flatten(2).mT[kept], points[kept], atol=2e-5)
    places = torch.stack([hits.u, hits.v], -1)
    assert torch.allclose(gbuffer.barycentric.flatten(2).mT[kept], places[kept], atol=1e-4)
    pixels, depth = CAMERA.project(gbuffer.position.flatten(2).mT)
    assert torch.allclose(pixels[kept], warp.positions(jitter)[kept], atol=1e-2)
    assert torch.allclose(gbuffer.depth.flatten(1)[kept], depth[kept], atol=1e-5)
    assert (prim[~there] == -1).all()
    for field in ("albedo", "normal", "position", "depth", "roughness", "motion", "barycentric"):
        assert (getattr(gbuffer, field).flatten(2).mT[~there] == 0).all(), field


@pytest.mark.parametrize("name", POLAR)
def test_the_tiles_of_cells_give_the_bits_of_single_rays(scene, name):
    warp = WARPS[name]
    together = trace_gbuffer(scene, CAMERA, warp=warp)
    points = warp.positions().reshape(2, -1, 2)
    for cell in (0, 41, 203, 388):
        row, column = divmod(cell, warp.resolution[1])
        if not warp.exists[0, 0, row, column]:
            continue
        single = trace_gbuffer(scene, CAMERA, warp=Single.at(points[:, cell]))
        for field in dataclasses.fields(together):
            one, other = getattr(single, field.name)[..., 0, 0], getattr(together, field.name)[..., row, column]
            assert torch.equal(one, other), field.name


@dataclasses.dataclass(frozen=True, eq=False)
class Single(LogPolarWarp):
    """A raster of one cell, anywhere."""

    @classmethod
    def at(cls, points):
        return cls(Gaze(points), (24, 30), (1, 1))

    def positions(self, jitter=(0.0, 0.0)):  # noqa: ARG002
        return self.gaze.pixels[:, None]


@pytest.mark.parametrize("name", WARPS)
def test_cells_that_the_screen_does_not_read_get_no_paths(scene, name):
    warp = WARPS[name]
    everywhere = SampleMap.from_counts(torch.full((1, 1, *warp.resolution), 2), GAZE)
    for samples, given in ((2, warp), (everywhere, warp), (uniform_map(CAMERA, 0.7, warp=warp), None)):
        frame = trace_frame(scene, CAMERA, samples, warp=given, seed=3)
        assert frame.resolution == warp.resolution
        assert frame.raster == warp.name
        assert torch.equal(frame.gaze.pixels, GAZE.pixels)
        assert (frame.counts[~warp.read] == 0).all()
        assert (frame.radiance[~warp.read.expand(-1, 3, -1, -1)] == 0).all()
        if samples is not None and given is not None:
            assert (frame.counts[warp.read] == 2).all()
        assert (frame.gbuffer.prim.expand(-1, -1, -1, -1)[~warp.exists.expand(2, -1, -1, -1)] == -1).all()
        assert torch.isfinite(frame.radiance).all()
    outside = warp.exists & ~warp.read
    if outside.any():
        assert (frame.gbuffer.depth[outside] > 0).all()  # the room is closed: geometry is there


@pytest.mark.parametrize("name", POLAR)
def test_constant_light_is_constant_in_cells(name):
    scene, warp = open_scene(), WARPS[name]
    frame = trace_frame(scene, CAMERA, 2, warp=warp)
    hit = frame.gbuffer.hit
    sky = frame.radiance[(warp.read & ~hit).expand(-1, 3, -1, -1)]
    assert torch.allclose(sky, torch.tensor(2.0), rtol=1e-6)
    ball = frame.radiance[(warp.read & hit).expand(-1, 3, -1, -1)]
    assert sky.numel() > 50 < ball.numel()
    # A convex body reflects half; facets of its shading see a little of what lies below their horizon.
    assert torch.allclose(ball, torch.tensor(1.0), rtol=1e-5)
    assert frame.emission[~warp.exists.expand(2, 3, -1, -1)].eq(0).all()


def test_random_numbers_are_functions_of_the_cell(scene):
    """A cell's light does not depend on how many other cells have paths, and every cell has its own numbers."""
    warp = WARPS["visual-polar"]
    whole = trace_frame(scene, CAMERA, 3, warp=warp, seed=4)
    some = SampleMap.from_counts(3 * (torch.rand(2, 1, *warp.resolution) < 0.3).int(), GAZE)
    part = trace_frame(scene, CAMERA, some, warp=warp, seed=4)
    chosen = (part.counts > 0).expand(-1, 3, -1, -1)
    assert chosen.any()
    assert torch.equal(part.radiance[chosen], whole.radiance[chosen])
    beside = trace_frame(scene, CAMERA, 3, warp=dataclasses.replace(warp, resolution=(23, 27)), seed=4)
    assert not torch.equal(beside.radiance[..., :21, :], whole.radiance[..., :21, :])


@pytest.mark.parametrize("count", [1, 3])
def test_the_number_of_threads_changes_no_bit(scene, threads, count, monkeypatch):
    set_tiles(monkeypatch, 64)  # tiles for all of them
    warp = WARPS["visual-polar"]
    once = trace_frame(scene, CAMERA, 2, warp=warp, seed=1, jitter=(0.1, 0.2))
    threads(count)
    again = trace_frame(scene, CAMERA, 2, warp=warp, seed=1, jitter=(0.1, 0.2))
    assert_same_bits(dataclasses.replace(again, warp=None), dataclasses.replace(once, warp=None))


@pytest.mark.parametrize("name", ["log-polar", "stair"])
def test_cells_are_shaded_again_with_the_same_bits(scene, name):
    frame = trace_frame(scene, CAMERA, 2, warp=WARPS[name], seed=9, jitter=(0.2, -0.3))
    points = surface_points(frame)
    again = reshade(scene, points)
    for part in ("direct", "indirect", "emission"):
        assert torch.equal(points.image(getattr(again, part)), getattr(frame, part)), part
    nowhere = (~WARPS[name].exists.expand(2, -1, -1, -1)).nonzero()[:, [0, 2, 3]]
    assert (reshade(scene, surface_points(frame, nowhere)).radiance == 0).all()


def test_light_in_cells_is_that_of_the_screen():
    """Batches of a frame in cells against batches of camera rays through the same points, with other random numbers.

    The same points: each is a camera of one pixel, so that nothing is interpolated.
    """
    scene, warp = lit_room(), LogPolarWarp.for_camera(CAMERA, GAZE, sigma=3)
    chosen = warp.read[0, 0].nonzero()[::7]
    found, expected = [], []
    for batch in range(40):
        frame = trace_frame(scene, CAMERA, 16, warp=warp, seed=batch)
        found.append(frame.radiance[0, :, chosen[:, 0], chosen[:, 1]].numpy())
    points = warp.positions().reshape(2, *warp.resolution, 2)[0, chosen[:, 0], chosen[:, 1]]
    left, right, bottom, top = CAMERA.bounds[0]
    x = left + (right - left) * (points[:, 0, None] + torch.tensor([-1e-4, 1e-4])) / 30
    y = top - (top - bottom) * (points[:, 1, None] + torch.tensor([1e-4, -1e-4])) / 24
    eyes = Camera(
        CAMERA.origin[:1].expand(len(points), -1).contiguous(),
        CAMERA.rotation[:1].expand(len(points), -1, -1).contiguous(),
        torch.cat([x, y], dim=1),
        (1, 1),
    )
    for batch in range(40):
        frame = trace_frame(scene, eyes, 16, seed=1000 + batch)
        expected.append(frame.radiance[:, :, 0, 0].mT.numpy())
    assert len(points) > 10
    assert_same_mean(found, expected)


@pytest.mark.parametrize("name", ["log-polar", "visual-polar"])
def test_traced_cells_lie_as_densely_as_the_closed_form_says(scene, name):
    """Chi-square of the points that paths start from, in boxes of 32 x 32 pixels, against the density's integral.

    Every frame has another jitter, and traces one cell in twelve, drawn by itself. What the cells of a frame have in
    common, its jitter, then adds a few per cent to the variance of independent draws. The box of the gaze, near which
    the log-polar density has no bound, is left out.
    """
    eyes = StereoCamera.look_at((0.2, 0.1, 1.8), (0.0, -0.2, 0.0), fov_y_deg=70, resolution=(96, 128)).views
    camera = Camera(eyes.origin[:1], eyes.rotation[:1], eyes.bounds[:1], (96, 128))
    kind = {"log-polar": LogPolarWarp, "visual-polar": VisualPolarWarp}[name]
    warp = kind.for_camera(camera, Gaze(torch.tensor([[50.0, 40.0]])))
    share, frames, counts = 0.08, 25, np.zeros((3, 4))
    mean_spp = share * int(warp.read.sum()) / (96 * 128)
    generator = torch.Generator().manual_seed(3)
    for index in range(frames):
        jitter = tuple((torch.rand(2, generator=generator) - 0.5).tolist())
        samples = uniform_map(camera, mean_spp, seed=11, index=index, warp=warp)
        frame = trace_frame(scene, camera, samples, jitter=jitter, integrator=Integrator(bounces=0))
        points, _ = camera.project(frame.gbuffer.position.flatten(2).mT)
        x, y = (points[0][frame.counts.flatten() > 0] / 32).floor().long().unbind(1)
        inside = (x >= 0) & (x < 4) & (y >= 0) & (y < 3)
        np.add.at(counts, (y[inside].numpy(), x[inside].numpy()), 1)
    fine = torch.stack(torch.meshgrid(torch.arange(0, 128, 0.1), torch.arange(0, 96, 0.1), indexing="xy"), -1) + 0.05
    density = warp.density(fine.reshape(1, -1, 2).double())
    expected = share * frames * density.reshape(3, 320, 4, 320).mean((1, 3)).numpy() * 32**2
    enough = expected > 20
    enough[1, 1] = False
    assert enough.sum() > 6
    chance = stats.chi2.sf(((counts - expected) ** 2 / expected)[enough].sum(), enough.sum())
    assert chance > LEVEL


def moving():
    """A room seen in two frames, with the eyes moved and turned."""
    scene = make_scene("cornell_box")
    then, now = (
        StereoCamera.look_at(eye, target, fov_y_deg=45, resolution=(30, 40)).views
        for eye, target in (((2.6, 2.7, 8.0), (2.8, 2.7, 0)), ((2.9, 2.6, 7.8), (2.7, 2.8, 0)))
    )
    return scene, then, now


@pytest.mark.parametrize("name", ["log-polar", "visual-polar", "screen"])
@pytest.mark.parametrize("jitter", [(0.0, 0.0), (0.25, -0.4)])
def test_transport_leads_to_the_previous_cells_of_the_same_points(name, jitter):
    """Against the projection of each cell's world point by the previous camera, in the previous raster."""
    scene, then, now = moving()
    kind = {"log-polar": LogPolarWarp, "visual-polar": VisualPolarWarp, "screen": ScreenWarp}[name]
    warp = kind.for_camera(now, Gaze(torch.tensor([[20.0, 14.0], [22.0, 13.0]])))
    previous = kind.for_camera(then, Gaze(torch.tensor([[12.0, 18.0], [15.0, 16.0]])))
    gbuffer = trace_gbuffer(scene, now, warp=warp, jitter=jitter, previous=Instant(scene, then))
    cells, valid = warp.transport(previous, gbuffer.motion, jitter=jitter)
    pixels, depth = then.project(gbuffer.position.flatten(2).mT)
    hit = gbuffer.hit.reshape(2, -1)
    inside = (pixels >= 0).all(-1) & (pixels[..., 0] <= 40) & (pixels[..., 1] <= 30) & (depth > 0)
    border = ((pixels % torch.tensor([40.0, 30.0])) < 1e-2).any(-1)
    agree = (valid.reshape(2, -1) == (hit & inside)) | border | (~hit & warp.exists.reshape(1, -1))
    assert agree.all()
    away = (pixels - previous.gaze.pixels[:, None]).norm(dim=-1) > 1.01  # no log-polar cell lies nearer
    kept = hit & inside & ~border & away
    assert kept.double().mean() > 0.3
    found, expected = previous.cell_to_screen(cells.flatten(2).mT.double()), pixels.double()
    assert torch.allclose(found[kept], expected[kept], atol=2e-3)


def test_motion_in_cells_is_that_of_the_screen():
    scene, then, now = moving()
    warp = VisualPolarWarp.for_camera(now)
    gbuffer = trace_gbuffer(scene, now, warp=warp, previous=Instant(scene, then))
    assert gbuffer.motion.abs().amax() > 1
    still = motion_vectors(gbuffer, scene, now, Instant(scene, now), warp=warp)
    assert (still == 0).all()
    gone = disoccluded(gbuffer, scene, now, Instant(scene, then), warp=warp)
    assert gone.shape == gbuffer.prim.shape
    assert 0 < gone.double().mean() < 0.5
    assert not (gone & ~warp.exists).any()


def test_geometry_has_derivatives_in_the_raster():
    """Against a difference quotient: where a cell's point lies as the gaze moves."""
    scene = make_scene("cornell_box")
    camera = StereoCamera.look_at((2.8, 2.7, 8.0), (2.8, 2.7, 0), fov_y_deg=45, resolution=(12, 16)).views
    base = torch.tensor([[8.0, 6.0], [8.5, 6.5]])

    def seen(gaze):
        return trace_gbuffer(scene, camera, warp=VisualPolarWarp.for_camera(camera, Gaze(gaze)))

    gaze = base.clone().requires_grad_()
    gbuffer = seen(gaze)
    step = torch.tensor([[0.02, 0.0], [0.0, 0.0]])
    before, after = seen(base - step), seen(base + step)
    same = (before.prim == after.prim) & (before.prim == gbuffer.prim) & gbuffer.hit
    slopes = (after.position - before.position)[:, 0][same[:, 0]].sum() / 0.04
    (found,) = torch.autograd.grad(gbuffer.position[:, 0][same[:, 0]].sum(), gaze)
    assert math.isclose(found[0, 0], slopes, rel_tol=2e-2)
    assert abs(slopes) > 1


def test_bad_input_is_named(scene):
    warp = WARPS["log-polar"]
    with pytest.raises(ValueError, match=r"jitter: expected shifts from -0\.5 to below 0\.5 cells, got \(0\.5, 0\.0\)"):
        trace_frame(scene, CAMERA, 1, warp=warp, jitter=(0.5, 0.0))
    other = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=60, resolution=(24, 31))
    with pytest.raises(ValueError, match=r"camera\.resolution: expected the screen's, \(24, 30\), got \(24, 31\)"):
        trace_frame(scene, other, 1, warp=warp)
    with pytest.raises(ValueError, match=r"warp\.gaze\.pixels: expected shape"):
        trace_frame(scene, CAMERA, 1, warp=dataclasses.replace(warp, gaze=Gaze(torch.zeros(3, 2))))
    with pytest.raises(ValueError, match="samples: expected a sample map for 2 views of 22 x 27 cells"):
        trace_frame(scene, CAMERA, uniform_map(CAMERA, 1), warp=warp)
    elsewhere = uniform_map(CAMERA, 1, warp=dataclasses.replace(warp, gaze=Gaze(torch.ones(2, 2))))
    with pytest.raises(ValueError, match="samples: expected one of the warp"):
        trace_frame(scene, CAMERA, elsewhere, warp=warp)
    with pytest.raises(ValueError, match=r"previous\.screen: expected this one's"):
        warp.transport(dataclasses.replace(warp, screen=(9, 9)), torch.zeros(2, 2, 22, 27))
