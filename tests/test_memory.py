"""Large pages, and memory used before, change where values lie, and nothing else."""

import mmap
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from fovden import memory
from fovden.memory import MOST_KEPT, PAGE, SMALLEST, empty_cache, on_large_pages, reused


@pytest.mark.parametrize("dtype", [torch.float32, torch.int32, torch.uint8, torch.int64])
@pytest.mark.parametrize("count", [0, 1, SMALLEST, SMALLEST + 3])
def test_values_are_kept(dtype, count):
    tensor = torch.arange(count).to(dtype)
    copy = on_large_pages(tensor)
    assert copy.dtype == dtype
    assert torch.equal(copy, tensor)


def test_shapes_and_strides():
    tensor = torch.arange(600_000.0).reshape(1000, 600).T
    copy = on_large_pages(tensor)
    assert copy.is_contiguous()
    assert torch.equal(copy, tensor)


@pytest.mark.skipif(not hasattr(mmap, "MADV_HUGEPAGE"), reason="this system has no large pages to ask for")
def test_memory_is_aligned_to_a_page_and_lives_as_long_as_the_tensor():
    copies = [on_large_pages(torch.full((SMALLEST,), float(i))) for i in range(8)]
    assert all(copy.data_ptr() % PAGE == 0 for copy in copies)
    views = [copy[-1:] for copy in copies]
    del copies
    assert [float(view) for view in views] == list(range(8))


def test_a_system_without_them(monkeypatch):
    monkeypatch.delattr(mmap, "MADV_HUGEPAGE", raising=False)
    tensor = torch.arange(float(SMALLEST))
    assert torch.equal(on_large_pages(tensor), tensor)
    assert reused(SMALLEST).fill_(1).sum() == SMALLEST


def floats(count, value):
    tensor = reused(count)
    tensor.fill_(value)
    return tensor


@pytest.fixture(autouse=True)
def _empty_cache():
    empty_cache()
    yield
    empty_cache()


large = pytest.mark.skipif(not hasattr(mmap, "MADV_HUGEPAGE"), reason="this system has no large pages to ask for")


@large
def test_memory_is_used_again_by_who_needs_as_much():
    first = floats(SMALLEST, 1.0)
    place = first.data_ptr()
    del first
    assert reused(2 * SMALLEST).data_ptr() != place
    again = reused(SMALLEST // 2, 2)
    assert again.data_ptr() == place
    assert torch.all(again == 1)  # as it was
    assert reused(SMALLEST).data_ptr() != place


@large
def test_memory_in_use_is_nobody_elses():
    views = [floats(SMALLEST, float(i))[-1:] for i in range(6)]  # a view keeps all of it
    kept = floats(SMALLEST, 7.0).numpy()
    floats(SMALLEST, 8.0)
    assert [float(view) for view in views] == list(range(6))
    assert (kept == 7).all()


@large
def test_what_is_kept_has_a_limit():
    many = [reused(SMALLEST * 4) for _ in range(40)]  # 16 MiB each
    assert not memory._KEPT
    last = many[-1].data_ptr()
    while many:
        del many[0]
    kept = [len(region) for region in memory._KEPT]
    assert MOST_KEPT - 20 * SMALLEST < sum(kept) <= MOST_KEPT
    assert reused(SMALLEST * 4).data_ptr() == last
    empty_cache()
    assert not memory._KEPT


@large
def test_what_is_larger_than_the_limit_drives_nothing_out():
    reused(SMALLEST)
    assert len(memory._KEPT) == 1
    reused(MOST_KEPT // 4 + 1)
    assert len(memory._KEPT) == 1


@large
def test_tensors_may_go_while_memory_is_looked_for():
    # The collector runs whenever something is allocated, and then gives regions back; the list grows underneath.
    program = """
import gc
from fovden import memory
from fovden.memory import empty_cache, reused

class Cycle:
    pass

gc.disable()
for _ in range(100):
    empty_cache()
    kept = [reused(1 << 18) for _ in range(24)]
    del kept
    garbage = []
    for _ in range(30):
        cycle = Cycle()
        cycle.itself, cycle.tensor = cycle, reused(1 << 21)
        garbage.append(cycle)
    del garbage, cycle
    gc.set_threshold(1, 1000, 1000)
    gc.enable()
    assert memory._take(123) is None
    gc.disable()
assert len(memory._KEPT) > 24
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@large
def test_threads_never_share_memory():
    def work(own):
        for _ in range(200):
            tensor = floats(SMALLEST // 4, own)
            time.sleep(0)
            if not bool((tensor == own).all()):
                return False
        return True

    with ThreadPoolExecutor(4) as executor:
        assert all(executor.map(work, [1.0, 2.0, 3.0, 4.0]))


@pytest.mark.parametrize("shape", [(), (0,), (3, 0, 2), (2, 3), (1 << 19, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8])
def test_shapes_and_types(shape, dtype):
    tensor = reused(*shape, dtype=dtype)
    assert tensor.shape == shape
    assert tensor.dtype == dtype
    assert tensor.is_contiguous()
    assert tensor.data_ptr() % 64 == 0
    tensor.fill_(1)
    assert int(tensor.double().sum()) == tensor.numel()
