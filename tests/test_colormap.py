"""The colour map of error maps is matplotlib's."""

import math

import numpy as np
import pytest
import torch

from fovden import colormap
from fovden.checks import ShapeError


def test_magma_is_that_of_matplotlib():
    matplotlib = pytest.importorskip("matplotlib")
    expected = matplotlib.colormaps["magma"](np.arange(256), bytes=True)[:, :3]
    np.testing.assert_array_equal(colormap.MAGMA.numpy(), expected)


@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.4])
def test_every_entry_is_reached_by_the_values_nearest_to_it(offset):
    values = ((torch.arange(256) + offset) / 255).reshape(1, 1, 16, 16)
    found = colormap.apply(values)
    assert (found.shape, found.dtype) == ((1, 3, 16, 16), torch.float32)
    entries = (255 * found).round().to(torch.uint8).flatten(2)[0].T
    assert torch.equal(entries, colormap.MAGMA)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_values_beyond_the_range_and_no_values(dtype):
    values = torch.tensor([-1.0, -math.inf, 1.5, math.inf, math.nan], dtype=dtype).reshape(1, 1, 1, 5)
    entries = (255 * colormap.apply(values)).round().to(torch.uint8).flatten(2)[0].T.tolist()
    first, last = colormap.MAGMA[0].tolist(), colormap.MAGMA[-1].tolist()
    assert entries == [first, first, last, last, list(colormap.NO_VALUE)]


def test_the_colour_of_no_value_is_far_from_all_others():
    distance = (colormap.MAGMA.int() - torch.tensor(colormap.NO_VALUE)).abs().sum(dim=1)
    assert int(distance.min()) > 200


def test_views_keep_their_places():
    values = torch.zeros(2, 1, 2, 3)
    values[1, 0, 1, 2] = 1
    found = colormap.apply(values.requires_grad_())
    assert not found.requires_grad
    lit = (found.sum(dim=1) > 1).nonzero().tolist()
    assert lit == [[1, 1, 2]]


def test_a_shape_that_is_none():
    with pytest.raises(ShapeError, match="values"):
        colormap.apply(torch.zeros(2, 2))
