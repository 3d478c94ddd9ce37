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
from fovden.simd import advanced, bits_of, load_int32, pointer_to, store_int32, trailing_zeros
from fovden.tracer import build_bvh, intersect, occluded
from fovden.tracer.kernels import boxes
from fovden.tracer.kernels.layout import (
    BLOCK_SIZE,
    CHILDREN,
    FAR,
    FAR_AT,
    HIT_PRIM,
    NEAR,
    NEAR_AT,
    NEAR_ROWS,
    NODE_SIZE,
    ORIGIN,
    RAY_SIZE,
    RESULTS_SIZE,
    SHEAR,
    UPPER,
    WIDTH,
)
from fovden.tracer.kernels.rays import is_traceable, prepare, prepare_axes_plain, prepare_axes_vector
from fovden.tracer.kernels.triangles import hit_triangles_plain, hit_triangles_vector

permutes = pytest.mark.skipif(not boxes.has_permutation(), reason="the processor does not permute eight lanes")
SPECIAL = torch.tensor(
    [0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 3.4e38, -3.4e38, 1e-38, 1e-45, -1e-45, torch.inf, -torch.inf, torch.nan]
)
COUNT = 20_000


def over_items(question):
    """A kernel that asks a question about item i of nodes or blocks, for each of the rays."""

    @kernel
    def run(memory, size, rays, masks, answers):
        for i in range(len(rays)):
            masks[i] = question(pointer_to(memory), i * size, pointer_to(rays[i]), pointer_to(answers[i]))

    return run


@kernel
def boxes_by_vector(nodes, base, ray, answer):
    return boxes.hit_boxes_vector(nodes, base, ray, answer)


@kernel
def boxes_by_plain(nodes, base, ray, answer):
    return boxes.hit_boxes_plain(nodes, base, ray, answer)


@kernel
def nearest_by_vector(nodes, base, ray, answer):
    return boxes.push_nearest_vector(nodes, base, ray, answer, advanced(answer, 16), 3)


@kernel
def nearest_by_plain(nodes, base, ray, answer):
    return boxes.push_nearest_plain(nodes, base, ray, answer, advanced(answer, 16), 3)


@kernel
def likeliest_by_vector(nodes, base, ray, answer):
    return boxes.push_likeliest_vector(nodes, base, ray, advanced(answer, 16), 3)


@kernel
def likeliest_by_plain(nodes, base, ray, answer):
    return boxes.push_likeliest_plain(nodes, base, ray, advanced(answer, 16), 3)


@kernel
def triangles_by_vector(blocks, base, ray, answer):
    return hit_triangles_vector(blocks, base, ray, answer)


@kernel
def triangles_by_plain(blocks, base, ray, answer):
    return hit_triangles_plain(blocks, base, ray, answer)


@kernel
def drop_by_vector(distances, stacks, limits, tops):
    for i in range(len(limits)):
        pair, top = (pointer_to(distances[i]), pointer_to(stacks[i])), np.int64(0)
        for first in range(0, tops[i], WIDTH):
            top = boxes.drop_far_vector(pair[0], pair[1], first, top, tops[i], limits[i])
        tops[i] = top


@kernel
def drop_by_plain(distances, stacks, limits, tops):
    for i in range(len(limits)):
        pair, top = (pointer_to(distances[i]), pointer_to(stacks[i])), np.int64(0)
        for first in range(0, tops[i], WIDTH):
            top = boxes.drop_far_plain(pair[0], pair[1], first, top, tops[i], limits[i])
        tops[i] = top


@kernel
def prepare_all(numbers, t_max, rays):
    for i in range(len(numbers)):
        r = numbers[i]
        prepare(pointer_to(rays[i]), r[0], r[1], r[2], r[3], r[4], r[5], t_max[i])


@kernel
def axes_of_all(numbers, by_vector, by_plain, scales, traceable):
    for i in range(len(numbers)):
        r = numbers[i]
        scales[0, i] = prepare_axes_vector(pointer_to(by_vector[i]), r[0], r[1], r[2], r[3], r[4], r[5])
        scales[1, i] = prepare_axes_plain(pointer_to(by_plain[i]), r[0], r[1], r[2], r[3], r[4], r[5])
        traceable[i] = is_traceable(r[0], r[1], r[2], r[3], r[4], r[5])


@kernel
def scalars(numbers, integers, zeros, bits, loaded, stored, sums):
    for i in range(len(numbers)):
        zeros[i] = trailing_zeros(integers[i])
        bits[i] = bits_of(numbers[i])
        loaded[i] = load_int32(pointer_to(numbers), i)
        store_int32(pointer_to(stored), i, integers[i])
        sums[i] = boxes.multiply_add(numbers[i], np.float32(4.0), np.float32(0.0))


def numbers(shape, special, seed):
    """Normal numbers, a share of them replaced by the special ones."""
    random = generator(seed)
    values = torch.randn(shape, generator=random)
    chosen = SPECIAL[torch.randint(len(SPECIAL), shape, generator=random)]
    return torch.where(torch.rand(shape, generator=random) < special, chosen, values)


def prepared_rays(special, seed):
    rays = torch.zeros(COUNT, RAY_SIZE)
    limits = numbers((COUNT,), special, seed + 1).abs() * 4
    prepare_all(numbers((COUNT, 6), special, seed).numpy(), limits.numpy(), rays.numpy())
    return rays


def random_nodes(special):
    nodes = numbers((COUNT, NODE_SIZE), special, seed=1)
    lower, upper = nodes[:, :UPPER].clone(), nodes[:, UPPER:CHILDREN].clone()
    if special < 0.1:  # ordinary boxes, but for the special numbers; a tenth of them without extent
        nodes[:, :UPPER], nodes[:, UPPER:CHILDREN] = torch.minimum(lower, upper), torch.maximum(lower, upper)
        nodes[: COUNT // 10, UPPER:CHILDREN] = nodes[: COUNT // 10, :UPPER]
    nodes.view(torch.int32)[:, CHILDREN:] = torch.randint(
        -(2**31), 2**31 - 1, (COUNT, 16), generator=generator(2)
    ).int()
    return nodes


@pytest.mark.parametrize("special", [0.0, 0.05, 0.5])
def test_rays(special):
    values = numbers((COUNT, 6), special, seed=14)
    values[::3, 3:] *= torch.exp2(torch.randint(-140, 127, (len(values[::3]), 3), generator=generator(15)))
    by_vector, by_plain, scales = torch.zeros(COUNT, RAY_SIZE), torch.zeros(COUNT, RAY_SIZE), torch.zeros(2, COUNT)
    traceable = torch.zeros(COUNT, dtype=torch.bool)
    axes_of_all(values.numpy(), by_vector.numpy(), by_plain.numpy(), scales.numpy(), traceable.numpy())
    assert len(scales[0].unique()) == 3
    assert int(traceable.sum()) > 1000
    assert torch.equal(scales[0][traceable], scales[1][traceable])
    used = [place + axis for place in (NEAR, NEAR_AT, FAR, FAR_AT, ORIGIN, SHEAR) for axis in range(3)]
    for places, kind in ((used, torch.float32), ([*range(NEAR_ROWS, HIT_PRIM)], torch.int32)):
        mine, other = (rays.view(kind)[traceable][:, places] for rays in (by_vector, by_plain))
        same = (mine.view(torch.int32) == other.view(torch.int32)) | (mine.isnan() & other.isnan())
        assert bool(same.all())


@pytest.mark.parametrize("special", [0.0, 0.05, 0.5])
def test_boxes(special):
    nodes, rays = random_nodes(special), prepared_rays(special, seed=3)
    outcomes = []
    for question in (boxes_by_vector, boxes_by_plain):
        masks, distances = torch.zeros(COUNT, dtype=torch.int32), torch.zeros(COUNT, WIDTH * 2)
        over_items(question)(nodes.numpy(), NODE_SIZE, rays.numpy(), masks.numpy(), distances.numpy())
        outcomes.append((masks, distances.view(torch.int32)))
    assert torch.equal(outcomes[0][0], outcomes[1][0])
    assert torch.equal(outcomes[0][1], outcomes[1][1])
    assert len(outcomes[0][0].unique()) > 100


@permutes
@pytest.mark.parametrize("special", [0.0, 0.05, 0.5])
@pytest.mark.parametrize(
    "questions",
    [(nearest_by_vector, nearest_by_plain), (likeliest_by_vector, likeliest_by_plain)],
    ids=["nearest", "likeliest"],
)
def test_children_on_stacks(special, questions):
    nodes, rays = random_nodes(special), prepared_rays(special, seed=3)
    outcomes = []
    for question in questions:
        tops, stacks = torch.zeros(COUNT, dtype=torch.int64), torch.zeros(COUNT, 32)
        over_items(question)(nodes.numpy(), NODE_SIZE, rays.numpy(), tops.numpy(), stacks.numpy())
        # What lies above the top is whatever either twin leaves there.
        used = (torch.arange(16) < tops[:, None]).repeat(1, 2)
        outcomes.append((tops, torch.where(used, stacks.view(torch.int32), 0)))
    assert torch.equal(outcomes[0][0], outcomes[1][0])
    assert torch.equal(outcomes[0][1], outcomes[1][1])
    assert set(range(3, 10)) <= set(outcomes[0][0].tolist())


@permutes
def test_far_children_leave_stacks():
    random = generator(13)
    distances, limits = torch.rand(COUNT, 48, generator=random), torch.rand(COUNT, generator=random)
    stacks = torch.randint(-(2**31), 2**31 - 1, (COUNT, 48), generator=random).int().view(torch.float32)
    tops = torch.randint(0, 40, (COUNT,), generator=random)
    near = (distances <= limits[:, None]) & (torch.arange(48) < tops[:, None])
    for run in (drop_by_vector, drop_by_plain):
        left = distances.clone(), stacks.clone(), tops.clone()
        run(left[0].numpy(), left[1].numpy(), limits.numpy(), left[2].numpy())
        assert torch.equal(left[2], near.sum(1))
        used = torch.arange(48) < left[2][:, None]
        assert torch.equal(left[0][used], distances[near])
        assert torch.equal(left[1].view(torch.int32)[used], stacks.view(torch.int32)[near])


@pytest.mark.parametrize("special", [0.0, 0.02, 0.5])
def test_triangles(special):
    blocks = numbers((COUNT, BLOCK_SIZE), special, seed=4)
    corners = blocks[:, : 9 * WIDTH].view(COUNT, 3, 3, WIDTH)
    corners[: COUNT // 10, 1] = corners[: COUNT // 10, 0]  # lines
    rays = prepared_rays(special, seed=5)
    outcomes = []
    for question in (triangles_by_vector, triangles_by_plain):
        masks, results = torch.zeros(COUNT, dtype=torch.int32), torch.zeros(COUNT, RESULTS_SIZE)
        over_items(question)(blocks.numpy(), BLOCK_SIZE, rays.numpy(), masks.numpy(), results.numpy())
        outcomes.append((masks, results))
    masks = outcomes[0][0]
    assert torch.equal(masks, outcomes[1][0])
    hit = (masks[:, None] >> torch.arange(WIDTH) & 1 > 0).repeat(1, 3)
    assert int(hit.sum()) > 100
    # Lanes that are not hit hold what either twin happens to leave there.
    assert torch.equal(*(results[:, : 3 * WIDTH].view(torch.int32)[hit] for _, results in outcomes))


def test_scalars():
    values = numbers((1000,), 0.5, seed=6)
    integers = torch.randint(1, 2**31 - 1, (1000,), generator=generator(7)) & ~((1 << torch.arange(1000) % 31) - 1)
    integers = torch.where(integers == 0, -(2**31), integers).int()
    zeros, bits, loaded = (torch.zeros(1000, dtype=torch.int32) for _ in range(3))
    stored, sums = torch.zeros(2, 1000)
    outputs = (zeros, bits, loaded, stored, sums)
    scalars(values.numpy(), integers.numpy(), *(output.numpy() for output in outputs))
    assert torch.equal(stored.view(torch.int32), integers)
    assert torch.equal(sums.nan_to_num(7.0), (values * 4 + 0).nan_to_num(7.0))
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
