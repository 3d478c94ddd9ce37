"""Filters in polar rasters: against loops over the warp's neighbours, without a seam, never reading what is no cell."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from filter_frames import tensors_of
from filter_twin import Cells, fill_twin, nonhomogeneous_twin, numbers, pass_twin
from polar_frames import CUT, POLAR, RASTERS, constant, make_warp, polar_frame

from fovden.filters import Atrous, NonHomogeneousAtrous, PredictedSigmas, fill_holes
from fovden.filters.guided import cells_alone, length_unit, radiance_unit
from fovden.filters.nearest import nearest_sampled
from fovden.filters.passes import PassOptions, advance, begin
from fovden.filters.predicted import local_features
from fovden.filters.taps import Sigmas, _strips
from fovden.foveation import Topology
from fovden.frame import Frame

SIGMAS = {"sigma_radiance": (0.9, 1.1, 1.4), "sigma_normal": (0.4, 0.3, 0.2), "sigma_position": (0.5, 0.4, 0.3)}
READINGS = [
    {},
    {"mask_at": "center"},
    {"guide": "input", "mask_update": "fill", "layers": "snapshot"},
    {"unsampled_guide": "literal"},
    {"guide": "input", "unsampled_guide": "nearest", "layers": "interleaved"},
    {"fill_holes": False, "border": "clamp", "guide_curve": "log"},
]
each_raster = pytest.mark.parametrize("raster", POLAR)


def stirred(denoiser):
    """A network that is no longer what it starts as."""
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for weight in denoiser.network.parameters():
            weight.add_(0.1 * torch.randn(weight.shape, generator=generator))
    return denoiser.double()


DENOISERS = {
    "Atrous": lambda: Atrous((4, 2, 1)).double(),
    "Atrous demodulated": lambda: Atrous((4, 2, 1), demodulate=True).double(),
    "NH3LD": lambda: NonHomogeneousAtrous((1, 2, 3)).double(),
    "NH3LD demodulated": lambda: NonHomogeneousAtrous((1, 2, 3), demodulate=True, layers="interleaved").double(),
    "nearest": lambda: NonHomogeneousAtrous((1, 2, 3), unsampled_guide="nearest").double(),
    "learned": lambda: NonHomogeneousAtrous((1, 2, 3), per_pass=True, learn_kernel=True).double(),
    "PredictedSigmas": lambda: stirred(PredictedSigmas(NonHomogeneousAtrous((1, 2, 3)).double(), channels=4)),
}
each_denoiser = pytest.mark.parametrize("build", DENOISERS.values(), ids=DENOISERS)


def clean(frame):
    """Tensors for ``filter`` and for the loops, whose guides are 0 where there is no cell, and the topology."""
    tensors = tensors_of(cells_alone(replace(frame, gbuffer=frame.gbuffer)))
    exists = frame.warp.exists
    return [torch.where(exists, tensor, 0) for tensor in tensors], frame.warp.topology


@each_raster
@pytest.mark.parametrize("step", [1, 3, 8])
def test_a_pass_equals_the_loop_over_neighbours(raster, step):
    warp = make_warp(raster)
    (c, n, x, b, _), topology = clean(polar_frame(warp, density=0.5))
    state = advance(begin(c, b, topology), n, x, step=step, sigmas=Sigmas(0.9, 0.4, 0.5), options=PassOptions(),
                    topology=topology)  # fmt: skip
    arrays = [numbers(tensor) for tensor in (c, n, x, b)]
    known = numbers(b) > 0
    want, total = pass_twin(*arrays, step, (0.9, 0.4, 0.5), known=known, cells=Cells(warp))
    np.testing.assert_allclose(state.image.numpy(), want, rtol=1e-12, atol=1e-12)
    assert np.array_equal(state.known.numpy(), known | (total > 1e-20))


@pytest.mark.parametrize("raster", ["log-polar 1 rotate", "smooth rotate", "stair"])
@pytest.mark.parametrize("options", READINGS, ids=str)
def test_every_reading_equals_the_reference_procedure(raster, options):
    warp = make_warp(raster, "centre", (8, 9))
    tensors, topology = clean(polar_frame(warp, density=0.4, seed=3))
    got = NonHomogeneousAtrous((1, 2, 3), **SIGMAS, **options).double().filter(*tensors, topology=topology)
    widths = list(zip(*SIGMAS.values(), strict=True))
    c, n, x, b = (numbers(tensor) for tensor in tensors[:4])
    want = nonhomogeneous_twin(c, n, x, b, tensors[4].numpy(), (1, 2, 3), widths, cells=Cells(warp), **options)
    # Widths pass through a float32 logarithm: relative errors of 1e-7.
    np.testing.assert_allclose(got.detach().numpy(), want, rtol=1e-5, atol=1e-6)


@each_raster
def test_holes_are_filled_as_by_the_loop(raster):
    """One sample alone, in the outermost column: everything is reached, also across short columns."""
    warp = make_warp(raster, "centre", (8, 9))
    (c, n, x, _, _), topology = clean(polar_frame(warp, density=1.0))
    b = torch.zeros_like(c[:, :1])
    b[..., 5, 8] = 0.5
    holes = (b == 0) & topology.exists
    for label in (None, (x[:, :1] > 0.5).int()):
        got = fill_holes(c * b, holes, b, n, x, sigma_normal=0.3, sigma_position=0.2, label=label, topology=topology)
        widths = np.full(b.shape, 0.3), np.full(b.shape, 0.2)
        arrays = [numbers(tensor) for tensor in (b, n, x)]
        want = fill_twin(numbers(c * b), holes.numpy(), *arrays, *widths, cells=Cells(warp),
                         label=None if label is None else label.numpy())  # fmt: skip
        np.testing.assert_allclose(got.numpy(), want, rtol=1e-12, atol=1e-12)
        only = torch.where(topology.exists, c[..., 5:6, 8:9] * 0.5, 0)  # all weights are of this one sample
        torch.testing.assert_close(got, only, rtol=1e-12, atol=0)


@each_raster
def test_filling_compiled_is_the_same(raster):
    warp = make_warp(raster, "centre", (8, 9))
    (c, n, x, b, _), topology = clean(polar_frame(warp, density=0.1))
    arguments = c, (b == 0) & topology.exists, b, n, x

    def fill(c, holes, b, n, x):
        return fill_holes(c, holes, b, n, x, sigma_normal=0.3, sigma_position=0.2, topology=topology)

    torch.testing.assert_close(torch.compile(fill, backend="eager")(*arguments), fill(*arguments))


def rolled(frame: Frame, rows: int) -> Frame:
    """The frame with the origin of angles moved."""

    def turn(record):
        return {
            name: value.roll(rows, -2)
            for name, value in vars(record).items()
            if isinstance(value, torch.Tensor) and value.dim() == 4
        }

    return replace(frame, **turn(frame), gbuffer=replace(frame.gbuffer, **turn(frame.gbuffer)))


@each_denoiser
@pytest.mark.parametrize("raster", ["log-polar", "log-polar 1 rotate"])
def test_there_is_no_seam(build, raster, monkeypatch):
    """In a raster without cuts only what is looked at tells one angle from another: turning before or after is one."""
    monkeypatch.setattr(Topology, "active", property(lambda topology: topology.exists))
    frame = polar_frame(make_warp(raster, size=(10, 11)), emission=True)
    denoiser = build()
    want = denoiser(frame).image.roll(4, -2)
    torch.testing.assert_close(denoiser(rolled(frame, 4)).image, want, rtol=1e-10, atol=1e-10)


@each_denoiser
@pytest.mark.parametrize("raster", RASTERS)
@pytest.mark.parametrize("gaze", ["per eye", "outside"])
def test_constant_light_is_a_fixed_point(build, raster, gaze):
    """In all cells that have light or are looked at; also where what is no cell holds NaN, in which the image is 0."""
    warp = make_warp(raster, gaze)
    frame = constant(polar_frame(warp, dirty=False))
    spoil = torch.where(warp.exists, frame.direct, torch.nan)
    image = build()(replace(frame, direct=spoil)).image
    want = 0.3 * (warp.exists & (warp.read | (frame.counts > 0))).double().expand_as(image)
    torch.testing.assert_close(image, want, rtol=1e-12, atol=1e-12)


@each_denoiser
@pytest.mark.parametrize("raster", CUT)
def test_what_is_no_cell_is_never_read(build, raster):
    warp = make_warp(raster)
    denoiser = build()
    want = denoiser(cells_alone(polar_frame(warp, dirty=False))).image
    dirty = polar_frame(warp)
    direct = dirty.direct.clone().requires_grad_()
    got = denoiser(replace(dirty, direct=direct)).image
    assert torch.equal(got, want)
    assert bool((got == 0)[~warp.exists.expand_as(got)].all())
    got.square().sum().backward()
    assert bool(torch.isfinite(direct.grad).all())
    assert bool((direct.grad == 0)[~warp.exists.expand_as(direct)].all())


@each_denoiser
@pytest.mark.parametrize("raster", ["log-polar", "smooth rotate"])
def test_views_are_independent(build, raster):
    warp = make_warp(raster, "per eye")
    both, denoiser = polar_frame(warp), build()
    halves = []
    for view in range(2):
        one = {name: value[view : view + 1] for name, value in vars(both).items() if isinstance(value, torch.Tensor)}
        g = {name: value[view : view + 1] for name, value in vars(both.gbuffer).items()}
        eye = replace(warp, gaze=type(warp.gaze)(warp.gaze.pixels[view : view + 1]))
        single = replace(both, **one, gbuffer=replace(both.gbuffer, **g), warp=eye, gaze=eye.gaze)
        halves.append(denoiser(single).image)
    torch.testing.assert_close(denoiser(both).image, torch.cat(halves), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["NH3LD demodulated", "nearest", "PredictedSigmas"])
@pytest.mark.parametrize("size", [(1, 1), (1, 4), (5, 1), (2, 3), (13, 2)])
@pytest.mark.parametrize("raster", ["log-polar 1 rotate", "smooth rotate"])
def test_odd_and_tiny_sizes(name, size, raster):
    frame = polar_frame(make_warp(raster, "centre", size), density=0.8, misses=False)
    frame = replace(frame, counts=torch.ones_like(frame.counts))
    image = DENOISERS[name]()(frame).image
    assert image.shape == frame.direct.shape
    assert bool(torch.isfinite(image).all())


@pytest.mark.parametrize("raster", CUT)
def test_units_count_cells_alone(raster):
    frame = polar_frame(make_warp(raster, "centre"))
    cells = cells_alone(frame)
    inside = frame.warp.exists[0, 0]
    sampled = inside & (frame.counts[0, 0] > 0)
    weights = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    luminance = (frame.radiance[0][:, sampled] * weights[:, None]).sum(0)
    torch.testing.assert_close(radiance_unit(cells.radiance, cells.mask).squeeze(), luminance.mean(), rtol=1e-3, atol=0)
    hit = inside & frame.gbuffer.hit[0, 0]
    depth = length_unit(cells.gbuffer.depth, cells.gbuffer.hit).squeeze()
    assert depth == frame.gbuffer.depth[0, 0][hit].median()


@pytest.mark.parametrize("raster", ["log-polar", "smooth rotate", "stair"])
def test_features_are_those_of_windows_around_the_circle(raster):
    """The statistics in the middle of a frame that repeats: as on a screen with the image once more on both sides."""
    warp = make_warp(raster, "centre", (12, 14))
    frame = polar_frame(warp, dirty=False, misses=False)
    features = local_features(frame, frame.radiance)
    topology = warp.topology
    turns = {
        name: torch.cat([topology.expand(value)] * 3, -2)
        for name, value in vars(cells_alone(frame)).items()
        if isinstance(value, torch.Tensor) and value.dim() == 4
    }
    surfaces = {name: torch.cat([topology.expand(v)] * 3, -2) for name, v in vars(cells_alone(frame).gbuffer).items()}
    flat = replace(frame, **turns, gbuffer=replace(frame.gbuffer, **surfaces), warp=None)
    # The unit of length is a median over stretched columns there, so that logarithms of depth differ by a constant.
    want = local_features(flat, flat.radiance)[..., 12:24, 3:-3]
    difference = features[..., 3:-3] - want
    difference[:, 3] -= difference[:, 3, :1, :1].clone()
    torch.testing.assert_close(difference, torch.zeros_like(difference), rtol=0, atol=1e-12)


@pytest.mark.parametrize("raster", ["log-polar", "smooth"])
def test_nearest_samples_go_around_the_circle(raster):
    warp = make_warp(raster, "centre")
    mask = torch.zeros(1, 1, 9, 11)
    mask[..., 8, 9] = mask[..., 4, 9] = 1
    found = nearest_sampled(mask, warp.topology)[0, 0]
    assert found[0, 9] == 8 * 11 + 9  # a row away across angle 0, and four within
    assert found[5, 9] == 4 * 11 + 9


@pytest.mark.parametrize(
    ("raster", "name"),
    [("log-polar 1 rotate", "Atrous demodulated"), ("stair rotate", "NH3LD"), ("smooth", "nearest"),
     ("smooth rotate", "PredictedSigmas")],
)  # fmt: skip
def test_derivatives(raster, name):
    frame = polar_frame(make_warp(raster, "centre", (4, 5)), dirty=False, density=0.7)
    denoiser = DENOISERS[name]()
    getattr(denoiser, "inner", denoiser).relative = False  # units are constants to the gradient

    def run(direct, normal, *weights):
        gbuffer = replace(frame.gbuffer, normal=normal)
        changed = replace(frame, direct=direct * frame.mask, gbuffer=gbuffer)
        names = [key for key, _ in denoiser.named_parameters()]
        return torch.func.functional_call(denoiser, dict(zip(names, weights, strict=True)), (changed,)).image

    inputs = [frame.direct + 0.1, frame.gbuffer.normal, *denoiser.parameters()]
    inputs = [tensor.detach().clone().requires_grad_() for tensor in inputs]
    assert torch.autograd.gradcheck(run, inputs, fast_mode=True)


def test_strips_of_columns_give_the_same(monkeypatch):
    warp = make_warp("smooth rotate")
    frame, denoiser = polar_frame(warp), DENOISERS["NH3LD"]()
    want = denoiser(frame).image
    for pixels in (1, 40, 70):
        monkeypatch.setattr("fovden.filters.taps.STRIP_PIXELS", pixels)
        assert len(_strips(11, 18)) > 3
        assert torch.equal(denoiser(frame).image, want)


def test_the_number_of_threads_does_not_matter():
    """Neither in the image nor in derivatives, over cells enough for several threads to share."""
    warp = make_warp("smooth rotate", size=(70, 90))
    frame = polar_frame(warp, dtype=torch.float32, density=1.0)
    results = []
    for threads in (1, 2):
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        direct = frame.direct.clone().requires_grad_()
        image = Atrous((2,))(replace(frame, direct=direct)).image
        image.square().sum().backward()
        torch.set_num_threads(before)
        results.append((image, direct.grad))
    assert all(torch.equal(one, two) for one, two in zip(*results, strict=True))


def test_the_last_round_is_run_again_where_steps_miss_cells():
    """Heights that go up and down: from one sample, each step's taps leave out cells that only a second round meets."""
    topology = Topology(torch.tensor([1, 4, 1, 1, 1, 2, 4, 3]), 4)
    mask = torch.zeros(1, 1, 4, 8, dtype=torch.float64)
    mask[..., 1, 1] = 1
    unlike = torch.arange(96.0, dtype=torch.float64).reshape(1, 3, 4, 8)  # so that geometry finds nothing before
    holes = topology.exists & (mask == 0)
    filled = fill_holes(
        mask * 2, holes, mask, unlike, unlike, sigma_normal=0.01, sigma_position=0.01, topology=topology
    )
    torch.testing.assert_close(filled, 2 * topology.exists.double(), rtol=1e-15, atol=0)


def test_eyes_are_not_joined():
    frame = polar_frame(make_warp("log-polar"))
    with pytest.raises(ValueError, match="seam: expected False in a polar raster"):
        NonHomogeneousAtrous((1, 2, 3), seam=True)(frame)


def test_a_frame_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"expected .*8.* 11"):
        Atrous()(replace(polar_frame(make_warp("log-polar")), warp=make_warp("log-polar", size=(8, 11))))
