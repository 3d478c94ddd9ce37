"""Large pages change where values lie, and nothing else."""

import mmap

import pytest
import torch

from fovden.memory import PAGE, SMALLEST, on_large_pages


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
