"""Denoising in a raster's cells and the way to the screen: the parts, moving gazes, and what can be learned."""

from dataclasses import replace

import pytest
import torch
from polar_frames import GAZES, POLAR, RASTERS, SCREEN, constant, make_warp, polar_frame

from fovden.camera import Gaze
from fovden.filters import Atrous, Denoised, Denoiser, NonHomogeneousAtrous, PredictedSigmas, WarpedDenoiser
from fovden.foveation import LogPolarWarp, ScreenWarp, Topology, VisualPolarWarp, eccentricity_pixels
from fovden.tuning import ImageError, fit, load_parameters, readable, save_parameters

INNER = {
    "Atrous": lambda: Atrous((2, 1)),
    "NH3LD": lambda: NonHomogeneousAtrous((1, 2, 3), demodulate=True),
    "PredictedSigmas": lambda: PredictedSigmas(Atrous((2, 1)), channels=4),
}
each_raster = pytest.mark.parametrize("raster", POLAR)


def build(warp, inner="Atrous", **options):
    return WarpedDenoiser(INNER[inner](), warp, **options).double()


@pytest.mark.parametrize("inner", INNER)
@pytest.mark.parametrize("raster", RASTERS)
@pytest.mark.parametrize("gaze", GAZES)
def test_constant_light_is_a_fixed_point(inner, raster, gaze):
    warp = make_warp(raster, gaze)
    image = build(warp, inner, blur=1.5, contrast=0.5)(constant(polar_frame(warp))).image
    assert image.shape[-2:] == warp.screen
    torch.testing.assert_close(image, torch.full_like(image, 0.3), rtol=1e-12, atol=1e-12)


@each_raster
@pytest.mark.parametrize("prefilter", ["area", "angle", "none"])
def test_the_image_is_that_of_the_parts(raster, prefilter):
    frame = polar_frame(make_warp(raster))
    cells = Atrous((2, 1)).double()(frame).image
    want = frame.warp.to_screen(cells, prefilter=prefilter)
    image = build(frame.warp, blur=0, prefilter=prefilter)(frame).image
    assert torch.equal(image, want)
    image = build(frame.warp, blur=0.7, prefilter=prefilter)(frame).image
    assert torch.equal(image, frame.warp.blur(want, 0.7))
    image = build(frame.warp, blur=0, contrast=0.4, prefilter=prefilter)(frame).image
    assert torch.equal(image, (want + 0.4 * (want - frame.warp.blur(want, 2.0))).clamp(min=0))


@each_raster
@pytest.mark.parametrize("inner", INNER)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_no_pixel_reads_is_left_alone_and_the_image_stays(raster, inner, dtype, monkeypatch):
    warp = make_warp(raster, "outside", size=(12, 16))
    unread = warp.exists & ~warp.read
    assert unread.any()
    frame = polar_frame(warp, dirty=False)
    light = {name: torch.where(unread, 0, getattr(frame, name)) for name in ("direct", "indirect", "emission")}
    frame = replace(frame, **light, counts=torch.where(unread, 0, frame.counts)).to(dtype)
    denoiser = build(warp, inner).to(dtype)
    image, cells = denoiser(frame).image, denoiser.inner(frame).image
    assert not torch.where(unread, cells, 0).any()
    monkeypatch.setattr(Topology, "active", property(lambda topology: topology.exists))
    everything = denoiser.inner(frame).image
    assert torch.where(unread, everything, 0).any()
    assert torch.equal(torch.where(unread, 0, everything), cells)
    assert torch.equal(denoiser(frame).image, image)


@each_raster
def test_one_module_serves_moving_gazes(raster):
    denoiser = build(make_warp(raster, "centre"), contrast=0.2)
    for gaze in GAZES:
        warp = make_warp(raster, gaze)
        frame = polar_frame(warp)
        assert torch.equal(denoiser(frame).image, build(warp, contrast=0.2)(frame).image)


def test_eyes_are_independent():
    warp = make_warp("smooth", "per eye")
    frame, denoiser = polar_frame(warp), build(warp, contrast=0.2)
    image = denoiser(frame).image
    gaze = Gaze(torch.tensor([[9.1, 5.2], [-30.0, 2.0]], dtype=torch.float64))
    moved = replace(frame, warp=replace(warp, gaze=gaze), gaze=gaze)
    # Only the size of the blur's kernels is shared, whose ends weigh 1 % of a sample's distance in deviations at most.
    torch.testing.assert_close(denoiser(moved).image[0], image[0], rtol=0.02, atol=0.02)
    assert not torch.allclose(denoiser(moved).image[1], image[1], atol=0.05)
    plain = build(warp, blur=0)
    torch.testing.assert_close(plain(moved).image[0], plain(frame).image[0], rtol=1e-12, atol=1e-12)


def test_on_the_screen_it_is_the_denoiser_inside():
    frame = polar_frame(make_warp("screen"))
    want = Atrous((2, 1)).double()(replace(frame, warp=None)).image
    denoiser = build(make_warp("screen"), blur=3.0, contrast=2.0)
    assert torch.equal(denoiser(frame).image, want)
    assert torch.equal(denoiser(replace(frame, warp=None)).image, want)


def test_the_history_of_the_denoiser_inside_goes_on():
    class Count(Denoiser):
        def forward(self, frame, history=None):
            return Denoised(frame.radiance, (history or 0) + 1)

    warp = make_warp("log-polar")
    denoiser, frame = WarpedDenoiser(Count(), warp), polar_frame(warp)
    assert denoiser(frame, denoiser(frame).history).history == 2


def test_contrast_grows_where_the_eye_is_not():
    """On stripes: deviations from the mean grow in the periphery, not in the fovea, and light stays positive."""
    gaze = Gaze(torch.tensor([[30.0, 30.0]]).double())
    warp = VisualPolarWarp(gaze, (60, 60), (40, 48))
    stripes = 0.2 * (1 + torch.sin(torch.arange(60.0).double() * 1.5)).expand(1, 3, 60, 60)
    frame = polar_frame(warp, density=1.0, misses=False)
    cells = warp.from_screen(stripes)

    class Stripes(Denoiser):
        def forward(self, frame, history=None):  # noqa: ARG002
            return Denoised(cells)

    plain = WarpedDenoiser(Stripes(), warp, blur=0)(frame).image
    image = WarpedDenoiser(Stripes(), warp, blur=0, contrast=0.8)(frame).image
    distance = eccentricity_pixels(gaze, warp.screen)[0, 0]
    fovea, rim = distance < float(warp.blur_start), distance > 0.8 * float(warp.reach)
    assert torch.equal(image[..., fovea], plain[..., fovea])
    assert image[..., rim].std() > 1.3 * plain[..., rim].std()
    assert image.min() >= 0
    more = WarpedDenoiser(Stripes(), warp, blur=0, contrast=5.0)(frame).image
    assert more.min() == 0  # what would be negative


LEARNED = {
    "log-polar": ("log-polar 1 rotate", ("blur", "contrast", "alpha")),
    "visual-polar": ("uncut", ("e_max",)),
    "blur alone": ("smooth", ("blur",)),
}


def learned_warp(raster):
    gaze = Gaze(torch.tensor([[8.3, 6.2]]).double())
    return VisualPolarWarp(gaze, SCREEN, (5, 6), e_max=12.0, cut="none") if raster == "uncut" else make_warp(
        raster, "centre", (5, 6))  # fmt: skip


@pytest.mark.parametrize(("raster", "learn"), LEARNED.values(), ids=LEARNED)
def test_derivatives(raster, learn):
    warp = learned_warp(raster)
    frame = polar_frame(warp, density=0.7, dirty=False)
    denoiser = WarpedDenoiser(Atrous((2, 1), relative=False), warp, blur=2.0, contrast=0.3 * ("contrast" in learn),
                              learn=learn).double()  # fmt: skip
    names = [name for name, _ in denoiser.named_parameters()]
    assert names[: len(learn)] == [f"log_{name}" for name in learn]

    def run(direct, *values):
        changed = replace(frame, direct=direct * frame.mask)
        return torch.func.functional_call(denoiser, dict(zip(names, values, strict=True)), (changed,)).image

    values = [frame.direct + 0.1, *denoiser.parameters()]
    assert torch.autograd.gradcheck(run, [value.detach().clone().requires_grad_() for value in values], fast_mode=True)


def test_the_raster_that_was_learned_is_where_to_trace_next():
    denoiser = WarpedDenoiser(Atrous((2, 1)), make_warp("log-polar", "centre"), learn=["alpha"])
    with torch.no_grad():
        denoiser.log_alpha.fill_(1.0)
    gaze = Gaze(torch.tensor([[1.0, 2.0], [3.0, 4.0]]))
    warp = denoiser.warp_at(gaze)
    assert warp.gaze is gaze
    torch.testing.assert_close(warp.alpha, torch.tensor(1.0).exp())
    denoiser.double()(polar_frame(warp.to(torch.float64), dirty=False)).image.sum().backward()
    assert float(denoiser.log_alpha.grad.abs()) > 0


def test_parameters_go_to_disk_and_back(tmp_path):
    options = {"blur": 0.5, "contrast": 0.2, "learn": ("blur", "alpha")}
    frame = polar_frame(make_warp("log-polar"))
    learned = build(make_warp("log-polar"), **options)
    with torch.no_grad():
        learned.log_blur.add_(1.0)
        learned.log_alpha.sub_(0.1)
    save_parameters(learned, tmp_path / "it.safetensors")
    fresh = build(make_warp("log-polar", "outside"), **options)  # a gaze of its own does not matter
    load_parameters(fresh, tmp_path / "it.safetensors")
    assert torch.equal(fresh(frame).image, learned(frame).image)
    assert readable(fresh)["alpha"] == pytest.approx(4 * 2.718281828**-0.1)
    for other in (build(make_warp("log-polar 1 rotate"), **options), build(make_warp("log-polar"), blur=0.5)):
        with pytest.raises(ValueError, match="expected"):
            load_parameters(other, tmp_path / "it.safetensors")


def test_a_fit_finds_the_blur_that_made_its_references():
    warp = make_warp("log-polar", "centre", dtype=torch.float32)
    frame = polar_frame(warp, dtype=torch.float32)
    reference = WarpedDenoiser(Atrous((2, 1)), warp, blur=2.0)(frame).image.detach()
    denoiser = WarpedDenoiser(Atrous((2, 1)).requires_grad_(False), warp, blur=1.0, learn=["blur"])
    found = fit(denoiser, [(frame, reference)], ImageError({"log_l1": 1.0}), steps=25, progress=None)
    assert found.history[-1].loss < 0.2 * found.history[1].loss
    assert denoiser.blur.item() == pytest.approx(2.0, rel=0.1)


def test_bad_input():
    warp = make_warp("log-polar")
    with pytest.raises(TypeError, match="inner: expected a Denoiser, got int"):
        WarpedDenoiser(1, warp)
    with pytest.raises(TypeError, match="warp: expected a Warp, got str"):
        WarpedDenoiser(Atrous(), "log-polar")
    with pytest.raises(ValueError, match=r"blur: expected a finite number, at least 0, got -1"):
        WarpedDenoiser(Atrous(), warp, blur=-1)
    with pytest.raises(ValueError, match=r"contrast: expected a finite number, above 0, got 0"):
        WarpedDenoiser(Atrous(), warp, learn=["contrast"])
    with pytest.raises(ValueError, match=r"learn: expected some of \('blur', 'contrast', 'alpha'\), got 'e_max'"):
        WarpedDenoiser(Atrous(), warp, learn=["e_max"])
    with pytest.raises(ValueError, match=r"prefilter: expected one of .*, got 'mipmap'"):
        WarpedDenoiser(Atrous(), warp, prefilter="mipmap")
    with pytest.raises(ValueError, match=r"warp\.alpha: expected a number, or 'alpha' in learn"):
        WarpedDenoiser(Atrous(), replace(warp, alpha=torch.tensor(2.0, requires_grad=True)))


def test_frames_of_another_raster_are_refused():
    denoiser = build(make_warp("log-polar"))
    wanted = r"frame\.warp: expected LogPolarWarp\(.*alpha=4\), got "
    others = ["log-polar 1 rotate", "smooth", "screen"]
    for frame in (polar_frame(make_warp(name)) for name in others):
        with pytest.raises(ValueError, match=wanted):
            denoiser(frame)
    with pytest.raises(ValueError, match=wanted + "the screen"):
        denoiser(replace(polar_frame(make_warp("log-polar")), warp=None))
    denoiser = build(make_warp("smooth"), learn=["e_max"])
    with torch.no_grad():
        denoiser.log_e_max.add_(0.5)
    with pytest.raises(ValueError, match=r"frame\.warp: expected a raster traced with the numbers .* other heights"):
        denoiser(polar_frame(make_warp("smooth")))


def test_it_says_what_it_is():
    shown = repr(WarpedDenoiser(Atrous(), LogPolarWarp(Gaze(torch.zeros(1, 2)), (4, 6), (8, 8)), learn=["blur"]))
    assert "LogPolarWarp(fovea_border='clamp', alpha=4), blur=1, contrast=0" in shown
    assert "ScreenWarp" in repr(WarpedDenoiser(Atrous(), ScreenWarp(Gaze(torch.zeros(1, 2)), (4, 6), (4, 6))))


def test_one_module_serves_rasters_of_any_size():
    small, large = (LogPolarWarp(Gaze(torch.tensor([[3.0, 2.0]] * 2)), (12, 14), size) for size in ((8, 8), (11, 13)))
    frame = polar_frame(large)
    image = WarpedDenoiser(Atrous((1,)), small)(frame).image
    assert torch.equal(image, WarpedDenoiser(Atrous((1,)), large)(frame).image)


def test_a_smaller_image_is_filtered_and_enlarged():
    warp = ScreenWarp(Gaze(torch.zeros(2, 2)), (12, 14), (6, 7))
    frame = polar_frame(warp)
    expected = torch.nn.functional.interpolate(Atrous((1,))(frame).image, (12, 14), mode="bilinear")
    assert torch.equal(WarpedDenoiser(Atrous((1,)), warp)(frame).image, expected)
