"""Meshes and rays at the ends of what there can be: they neither hang nor crash, and their answers are right."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from builders import generator, soup, triples

from fovden.tracer import build_bvh, intersect, occluded

ROOT = Path(__file__).resolve().parents[2]


def aimed(vertices, faces, count):
    """Rays from outside at the triangles' middles."""
    random = generator(1)
    middle, size = vertices.double().mean(0), float((vertices.double().amax(0) - vertices.double().amin(0)).amax())
    away = torch.nn.functional.normalize(torch.randn(count, 3, dtype=torch.float64, generator=random), dim=1)
    origins = (middle + 2 * size * away).float()
    chosen = faces.long()[torch.randint(len(faces), (count,), generator=random)]
    return origins, vertices.double()[chosen].mean(1).float() - origins


def test_of_a_thousand_coincident_triangles_the_first_is_hit():
    vertices, _ = soup(1, seed=3)
    faces = torch.tensor([[0, 1, 2]] * 1000, dtype=torch.int32)
    faces[500:] = faces[500:].roll(1, 1)  # the same triangle from another corner
    bvh = build_bvh(vertices, faces)
    origins, directions = aimed(vertices, faces, 200)
    hits = intersect(bvh, origins, directions)
    alone = intersect(build_bvh(vertices, faces[:1]), origins, directions)
    turned = intersect(build_bvh(vertices, faces[500:501]), origins, directions)
    assert (alone.prim == 0).all()
    assert torch.equal(hits.t, torch.minimum(alone.t, turned.t))
    assert torch.equal(hits.prim, torch.where(alone.t <= turned.t, 0, 500).int())


def test_which_triangle_counts_is_no_matter_of_their_order():
    vertices, faces = soup(400)
    order = torch.randperm(400, generator=generator(2))
    origins, directions = aimed(vertices, faces, 4000)
    hits = intersect(build_bvh(vertices, faces), origins, directions)
    shuffled = intersect(build_bvh(vertices, faces[order]), origins, directions)
    assert torch.equal(hits.t, shuffled.t)
    hit = hits.prim >= 0
    assert torch.equal(order[shuffled.prim[hit].long()].int(), hits.prim[hit])


@pytest.mark.parametrize("scale", [1e6, 1e-6])
def test_scale_is_no_matter(scale):
    power = 2.0 ** round(torch.tensor(scale).log2().item())  # scales every operation exactly
    vertices, faces = soup(1000)
    origins, directions = aimed(vertices, faces, 2000)
    hits = intersect(build_bvh(vertices, faces), origins, directions)
    scaled = intersect(build_bvh(vertices * power, faces), origins * power, directions * power)
    assert int((hits.prim >= 0).sum()) > 1000
    for mine, other in zip(scaled, hits, strict=True):
        assert torch.equal(mine, other)


def test_a_ray_of_any_length_of_direction_finds_the_same():
    vertices, faces = soup(300)
    bvh = build_bvh(vertices, faces)
    origins, directions = aimed(vertices, faces, 500)
    directions[::3, 0] = 0.0
    hits = intersect(bvh, origins, directions)
    assert int((hits.prim >= 0).sum()) > 200
    for power in (-100, -80, 80, 120):
        scaled = intersect(bvh, origins, directions * 2.0**power)
        assert torch.equal(scaled.prim, hits.prim)
        assert torch.equal(occluded(bvh, origins, directions * 2.0**power), hits.prim >= 0)


BAD = (torch.nan, torch.inf, -torch.inf)


@pytest.mark.parametrize("place", range(7))
def test_numbers_that_are_none_miss(place):
    vertices, faces = soup(300)
    bvh = build_bvh(vertices, faces)
    origins, directions = aimed(vertices, faces, 900)
    t_max = torch.full((900,), 10.0)
    expected = intersect(bvh, origins, directions, t_max)
    table = torch.cat([origins, directions, t_max[:, None]], 1)
    for i, bad in enumerate(BAD):
        table[i::9, place] = bad
    hits = intersect(bvh, table[:, :3], table[:, 3:6], table[:, 6])
    spoilt = torch.arange(900) % 9 < 3
    if place == 6:
        spoilt &= torch.arange(900) % 9 != 1  # an infinite limit is none
    assert hits.prim[spoilt].eq(-1).all()
    assert torch.equal(hits.prim[~spoilt], expected.prim[~spoilt])
    assert torch.equal(occluded(bvh, table[:, :3], table[:, 3:6], table[:, 6]), hits.prim >= 0)


CHECKED = """
import sys; sys.path.insert(0, sys.argv[1])
import torch
from builders import generator, soup, sphere, rounded
from fovden.camera import Camera
from fovden.tracer import build_bvh, intersect, make_scene, occluded, trace_gbuffer
for vertices, faces in (soup(1), soup(9), soup(300), (rounded(sphere(2)[0]), sphere(2)[1])):
    for scale in (1.0, 1e30, 3e38, 1e-40):
        bvh = build_bvh(vertices / 1.5 * scale, faces)
        rays = torch.randn(2, 200, 3, generator=generator(0)) * scale
        hits = intersect(bvh, *rays)
        assert torch.equal(occluded(bvh, *rays), hits.prim >= 0) or scale != 1.0
"""


@pytest.mark.slow  # everything is compiled anew
def test_no_array_is_left_with_bounds_checked(tmp_path):
    """Numba looks at every index into an array; the vector code has none, its twins have pointers, the rest is here."""
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "FOVDEN_SIMD": "0"}
    program = [sys.executable, "-c", CHECKED, str(Path(__file__).parent)]
    ran = subprocess.run(program, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert ran.returncode == 0, ran.stderr


INTERRUPTED = """
import sys, time, torch
from fovden.tracer import build_bvh, intersect
vertices = torch.rand(6_000_000, 3)
faces = torch.arange(6_000_000, dtype=torch.int32).reshape(-1, 3)
small = build_bvh(vertices[:3000], faces[:1000])
rays = torch.rand(2, 20_000_000, 3)
intersect(small, *rays[:, :10])
print("ready", flush=True)
try:
    build_bvh(vertices, faces) if sys.argv[1] == "build" else intersect(small, *rays)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for a single process")
@pytest.mark.parametrize("what", ["build", "trace"])
def test_control_c_ends(what):
    process = subprocess.Popen([sys.executable, "-c", INTERRUPTED, what], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=20)[0] == "interrupted\n"
    assert process.returncode == 0


@pytest.mark.slow
def test_ten_million_triangles_fit():
    """Structure of 64 bytes a triangle and 3 GB at most while it is built; every ray at a triangle hits something."""
    resource = pytest.importorskip("resource", reason="peaks of memory are read from Unix")
    count = 10_000_000
    centres = torch.rand(count, 1, 3, generator=generator(0)) * 100
    vertices = (centres + torch.rand(count, 3, 3, generator=generator(1)) * 0.2).reshape(-1, 3)
    faces = triples(count)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    bvh = build_bvh(vertices, faces)
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert peak / count < 600
    assert sum(array.numel() * 4 for array in bvh) / count < 90
    origins, directions = aimed(vertices, faces, 100_000)
    hits = intersect(bvh, origins, directions)
    assert (hits.prim >= 0).all()
    assert torch.equal(occluded(bvh, origins, directions), hits.prim >= 0)
