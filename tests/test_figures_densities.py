"""Densities against eccentricity: averages over rings against a loop, and curves that show what they say."""

import math

import pytest
import torch
from matplotlib.figure import Figure
from PIL import Image

from fovden.camera import Gaze, StereoCamera, pixel_centres
from fovden.figures import draw_densities, draw_sample_maps
from fovden.figures.densities import density_by_eccentricity
from fovden.foveation import (
    AcuityFalloff,
    LinearFalloff,
    LinearMarAcuity,
    LogPolarWarp,
    ReddyAcuity,
    ThreeLayer,
    eccentricity_degrees,
    sample_map,
    uniform_map,
)

CAMERA = StereoCamera.look_at((0, 0, 5), (0, 0, 0), fov_y_deg=90, resolution=(90, 100))
FALLOFFS = {"three layers": ThreeLayer(), "linear": LinearFalloff(), "Reddy's": AcuityFalloff()}


def test_rings_equal_the_slow_loop():
    generator = torch.Generator().manual_seed(0)
    density, degrees = torch.rand(2, 1, 7, 9, generator=generator), 20 * torch.rand(2, 1, 7, 9, generator=generator)
    places, means = density_by_eccentricity(density, degrees, 0.8)
    rings = {}
    for value, angle in zip(density.flatten().tolist(), degrees.flatten().tolist(), strict=True):
        rings.setdefault(int(angle / 0.8), []).append(value)
    assert places == pytest.approx([(ring + 0.5) * 0.8 for ring in sorted(rings)])
    assert means == pytest.approx([sum(rings[ring]) / len(rings[ring]) for ring in sorted(rings)], rel=1e-6)


@pytest.fixture
def panels(monkeypatch, tmp_path):
    caught = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, *args, **more: [caught.append(figure), save(figure, *args, **more)]
    )

    def draw(**options):
        path = draw_densities(FALLOFFS, tmp_path / "densities.png", camera=CAMERA, **options)
        with Image.open(path) as picture:
            assert min(picture.size) > 400
        return caught[-1].axes

    return draw


def test_curves_are_rates_and_budgets(panels):
    rates, samples = panels(mean_spp=0.5, acuity=LinearMarAcuity())
    lines = {line.get_label(): line for line in rates.get_lines()}
    assert list(lines) == [*FALLOFFS, "acuity"]
    degrees, rate = (torch.as_tensor(values) for values in lines["Reddy's"].get_data())
    # A ring's mean differs from the rate in its middle by its curvature, which is below a hundredth here.
    torch.testing.assert_close(rate.double(), ReddyAcuity()(degrees.double()), atol=0.02, rtol=0.03)
    degrees, seen = (torch.as_tensor(values) for values in lines["acuity"].get_data())
    torch.testing.assert_close(seen, LinearMarAcuity()(degrees))
    expected = [line for line in samples.get_lines() if line.get_linestyle() == "-"]
    drawn = [line for line in samples.get_lines() if line.get_linestyle() == "None"]
    assert len(expected) == len(drawn) == 3
    pixels = eccentricity_degrees(Gaze.center(CAMERA), CAMERA)[0].long().flatten().bincount().tolist()
    for line, marks in zip(expected, drawn, strict=True):
        curve = dict(zip(*line.get_data(), strict=True))
        for place, value in zip(*marks.get_data(), strict=True):
            # A share of n pixels varies by at most 1 / (2 sqrt(n)), in samples four times that; five deviations.
            assert abs(value - curve[place]) < 5 * 4 / (2 * math.sqrt(pixels[int(place)]))


def test_gaze_aside(panels):
    panels(gaze=Gaze(torch.tensor([[10.0, 80.0], [-5.0, 20.0]])))


@pytest.mark.parametrize("count", [0, 8])
def test_number_of_falloffs(count, tmp_path):
    falloffs = {str(number): ThreeLayer() for number in range(count)}
    with pytest.raises(ValueError, match=f"falloffs: expected 1 to 7 of them, got {count}"):
        draw_densities(falloffs, tmp_path / "none.png", camera=CAMERA)


def test_sample_maps_are_counted_around_their_own_gaze(monkeypatch, tmp_path):
    caught = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, *args, **more: [caught.append(figure), save(figure, *args, **more)]
    )
    gaze = Gaze(torch.tensor([[20.0, 30.0], [18.0, 30.0]]))
    warp = LogPolarWarp.for_camera(CAMERA, gaze)
    maps = {
        "linear": sample_map(LinearFalloff(), CAMERA, gaze, mean_spp=0.5),
        "log-polar": uniform_map(CAMERA, 0.5, warp=warp),
    }
    path = draw_sample_maps(maps, tmp_path / "maps.png", camera=CAMERA, acuity=LinearMarAcuity())
    with Image.open(path) as picture:
        assert min(picture.size) > 400
    lines = {line.get_label(): line for line in caught[-1].axes[0].get_lines()}
    assert list(lines) == ["linear", "log-polar", "acuity"]
    ring = eccentricity_degrees(gaze, CAMERA).long()
    pixels = ring.flatten().bincount()
    for name, samples in maps.items():
        paths = [0.0] * len(pixels)
        width = samples.resolution[1]
        places = warp.positions() if samples.warp else pixel_centres((90, 100)).expand(2, -1, -1)
        for view in range(2):
            for cell, (x, y) in enumerate(places[view].tolist()):
                if 0 <= x < 100 and 0 <= y < 90:
                    count = samples.counts[view % len(samples.counts), 0, cell // width, cell % width]
                    paths[ring[view, 0, int(y), int(x)]] += int(count)
        degrees, mean = lines[name].get_data()
        assert mean == pytest.approx([paths[int(place)] / int(pixels[int(place)]) for place in degrees])
    # Acuity has as many paths as the first map.
    degrees, seen = (torch.as_tensor(values) for values in lines["acuity"].get_data())
    whole = LinearMarAcuity()(eccentricity_degrees(gaze, CAMERA).double()).mean()
    torch.testing.assert_close(seen, LinearMarAcuity()(degrees) * (maps["linear"].mean_spp / whole))


@pytest.mark.parametrize("count", [0, 8])
def test_number_of_sample_maps(count, tmp_path):
    maps = {str(number): uniform_map(CAMERA, 0.5) for number in range(count)}
    with pytest.raises(ValueError, match=f"samples: expected 1 to 7 of them, got {count}"):
        draw_sample_maps(maps, tmp_path / "none.png", camera=CAMERA)
