"""The vector code and its plain twins: the same bits, for ordinary numbers and for the worst ones."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import generator, soup

from fovden.jit import kernel, vectorised
from fovden.simd import bits_of, load_int32, pointer_to, stack_floats, trailing_zeros
from fovden.tracer import build_bvh, intersect, occluded
from fovden.tracer.kernels.boxes import hit_boxes_plain, hit_boxes_vector, slab_ray
from fovden.tracer.kernels.layout import BLOCK_SIZE, CHILDREN, NODE_SIZE, RESULTS_SIZE, UPPER, WIDTH
from fovden.tracer.kernels.triangles import any_triangle_vector, hit_triangles_plain, hit_triangles_vector, sheared_ray

SPECIAL = torch.tensor(
    [0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 3.4e38, -3.4e38, 1e-38, 1e-45, -1e-45, torch.inf, -torch.inf, torch.nan]
)
COUNT = 20_000


@kernel
def boxes_by_vector(nodes, rays, t_max, masks, keys):
    for i in range(len(rays)):
        r = rays[i]
        ray = slab_ray(r[0], r[1], r[2], r[3], r[4], r[5])
        masks[i] = hit_boxes_vector(pointer_to(nodes), i * NODE_SIZE, ray, t_max[i], pointer_to(keys[i]))


@kernel
def boxes_by_plain(nodes, rays, t_max, masks, keys):
    for i in range(len(rays)):
        r = rays[i]
        ray = slab_ray(r[0], r[1], r[2], r[3], r[4], r[5])
        masks[i] = hit_boxes_plain(pointer_to(nodes), i * NODE_SIZE, ray, t_max[i], pointer_to(keys[i]))


@kernel
def triangles_by_vector(blocks, rays, t_max, masks, results):
    scratch = stack_floats(RESULTS_SIZE)
    for i in range(len(rays)):
        r = rays[i]
        ray = sheared_ray(r[0], r[1], r[2], r[3], r[4], r[5])
        masks[i] = hit_triangles_vector(pointer_to(blocks), i * BLOCK_SIZE, ray, t_max[i], scratch)
        for k in range(RESULTS_SIZE):
            results[i, k] = scratch[k]


@kernel
def triangles_by_plain(blocks, rays, t_max, masks, results):
    scratch = stack_floats(RESULTS_SIZE)
    for i in range(len(rays)):
        r = rays[i]
        ray = sheared_ray(r[0], r[1], r[2], r[3], r[4], r[5])
        masks[i] = hit_triangles_plain(pointer_to(blocks), i * BLOCK_SIZE, ray, t_max[i], scratch)
        for k in range(RESULTS_SIZE):
            results[i, k] = scratch[k]


@kernel
def any_by_vector(blocks, rays, t_max, masks):
    scratch = stack_floats(RESULTS_SIZE)
    for i in range(len(rays)):
        r = rays[i]
        ray = sheared_ray(r[0], r[1], r[2], r[3], r[4], r[5])
        masks[i] = any_triangle_vector(pointer_to(blocks), i * BLOCK_SIZE, ray, t_max[i], scratch)


@kernel
def scalars(numbers, integers, zeros, bits, loaded):
    for i in range(len(numbers)):
        zeros[i] = trailing_zeros(integers[i])
        bits[i] = bits_of(numbers[i])
        loaded[i] = load_int32(pointer_to(numbers), i)


def numbers(shape, special, seed):
    """Normal numbers, a share of them replaced by the special ones."""
    random = generator(seed)
    values = torch.randn(shape, generator=random)
    chosen = SPECIAL[torch.randint(len(SPECIAL), shape, generator=random)]
    return torch.where(torch.rand(shape, generator=random) < special, chosen, values)


def rays_and_limits(special, seed):
    return numbers((COUNT, 6), special, seed), numbers((COUNT,), special, seed + 1).abs() * 4


@pytest.mark.parametrize("special", [0.0, 0.05, 0.5])
def test_boxes(special):
    nodes = numbers((COUNT, NODE_SIZE), special, seed=1)
    lower, upper = nodes[:, :UPPER].clone(), nodes[:, UPPER:CHILDREN].clone()
    if special < 0.1:  # ordinary boxes, but for the special numbers; a tenth of them without extent
        nodes[:, :UPPER], nodes[:, UPPER:CHILDREN] = torch.minimum(lower, upper), torch.maximum(lower, upper)
        nodes[: COUNT // 10, UPPER:CHILDREN] = nodes[: COUNT // 10, :UPPER]
    codes = torch.randint(-(2**31), 2**31 - 1, (COUNT, WIDTH), generator=generator(2))
    nodes.view(torch.int32)[:, CHILDREN : CHILDREN + WIDTH] = codes.int()
    rays, t_max = rays_and_limits(special, seed=3)
    outcomes = []
    for run in (boxes_by_vector, boxes_by_plain):
        masks, keys = torch.zeros(COUNT, dtype=torch.int32), torch.zeros(COUNT, WIDTH, dtype=torch.int64)
        run(nodes.numpy(), rays.numpy(), t_max.numpy(), masks.numpy(), keys.numpy())
        outcomes.append((masks, keys))
    assert torch.equal(outcomes[0][0], outcomes[1][0])
    assert torch.equal(outcomes[0][1], outcomes[1][1])
    assert len(outcomes[0][0].unique()) > 100


@pytest.mark.parametrize("special", [0.0, 0.02, 0.5])
def test_triangles(special):
    blocks = numbers((COUNT, BLOCK_SIZE), special, seed=4)
    corners = blocks[:, : 9 * WIDTH].view(COUNT, 3, 3, WIDTH)
    corners[: COUNT // 10, 1] = corners[: COUNT // 10, 0]  # lines
    rays, t_max = rays_and_limits(special, seed=5)
    outcomes = []
    for run in (triangles_by_vector, triangles_by_plain):
        masks, results = torch.zeros(COUNT, dtype=torch.int32), torch.zeros(COUNT, RESULTS_SIZE)
        run(blocks.numpy(), rays.numpy(), t_max.numpy(), masks.numpy(), results.numpy())
        outcomes.append((masks, results))
    masks = outcomes[0][0]
    assert torch.equal(masks, outcomes[1][0])
    hit = (masks[:, None] >> torch.arange(WIDTH) & 1 > 0).repeat(1, 3)
    assert int(hit.sum()) > 100
    # Lanes that are not hit hold what either twin happens to leave there.
    assert torch.equal(*(results.view(torch.int32)[hit] for _, results in outcomes))
    alone = torch.zeros_like(masks)
    any_by_vector(blocks.numpy(), rays.numpy(), t_max.numpy(), alone.numpy())
    assert torch.equal(alone, masks)


def test_scalars():
    values = numbers((1000,), 0.5, seed=6)
    integers = torch.randint(1, 2**31 - 1, (1000,), generator=generator(7)) & ~((1 << torch.arange(1000) % 31) - 1)
    integers = torch.where(integers == 0, -(2**31), integers).int()
    zeros, bits, loaded = (torch.zeros(1000, dtype=torch.int32) for _ in range(3))
    scalars(values.numpy(), integers.numpy(), zeros.numpy(), bits.numpy(), loaded.numpy())
    assert torch.equal(bits, values.view(torch.int32))
    assert torch.equal(loaded, bits)
    lowest = (integers.numpy().astype(np.int64) & -integers.numpy().astype(np.int64)).astype(np.float64)
    assert torch.equal(zeros, torch.from_numpy(np.log2(lowest)).int())


PROGRAM = """
import sys
import torch
from fovden.jit import vectorised
from fovden.tracer import build_bvh, intersect, occluded

case = torch.load(sys.argv[1])
bvh = build_bvh(case["vertices"], case["faces"])
rays = case["origins"], case["directions"], case["t_max"]
torch.save({"vectorised": vectorised(), "bvh": tuple(bvh), "hits": tuple(intersect(bvh, *rays)),
            "occluded": occluded(bvh, *rays)}, sys.argv[2])
"""


def test_the_tracer_gives_the_same_bits_with_the_twins(tmp_path: Path):
    vertices, faces = soup(1000)
    origins, directions = numbers((COUNT, 3), 0.01, seed=8), numbers((COUNT, 3), 0.01, seed=9)
    t_max = torch.rand(COUNT, generator=generator(10)) * 4
    case = {"vertices": vertices, "faces": faces, "origins": origins, "directions": directions, "t_max": t_max}
    torch.save(case, tmp_path / "case.pt")
    environment = os.environ | {"FOVDEN_SIMD": "0" if vectorised() else "1"}
    program = [sys.executable, "-c", PROGRAM, str(tmp_path / "case.pt"), str(tmp_path / "result.pt")]
    root = Path(__file__).resolve().parents[2]
    ran = subprocess.run(program, env=environment, cwd=root, capture_output=True, text=True, timeout=300, check=False)
    assert ran.returncode == 0, ran.stderr
    result = torch.load(tmp_path / "result.pt")
    assert result["vectorised"] != vectorised()
    bvh = build_bvh(vertices, faces)
    hits = intersect(bvh, origins, directions, t_max)
    assert 0 < int((hits.prim >= 0).sum()) < COUNT
    for mine, other in zip([*bvh, *hits], [*result["bvh"], *result["hits"]], strict=True):
        assert torch.equal(mine.view(torch.int32), other.view(torch.int32))
    assert torch.equal(occluded(bvh, origins, directions, t_max), result["occluded"])
