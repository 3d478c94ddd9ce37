"""Neighbours of polar rasters: against fractions, cell by cell."""

from fractions import Fraction
from math import floor

import pytest
import torch

from fovden.camera import Gaze
from fovden.checks import ShapeError
from fovden.foveation import LogPolarWarp, ScreenWarp, Topology, VisualPolarWarp

TOPOLOGIES = {
    "uncut": Topology(torch.full((5,), 6), 6),
    "uncut rotate": Topology(torch.full((5,), 7), 7, rotate=True),
    "cut": Topology(torch.tensor([1, 3, 4, 7, 7, 7]), 7),
    "cut rotate": Topology(torch.tensor([2, 4, 5, 8, 8]), 8, rotate=True),
    "one column": Topology(torch.tensor([3]), 3, rotate=True),
    "one cell": Topology(torch.tensor([1]), 1),
    "lower than the rectangle": Topology(torch.tensor([2, 3]), 5),
}
STEPS = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (2, -3), (-2, 5), (-4, 1), (9, -20), (-9, 20)]
each_topology = pytest.mark.parametrize("topology", TOPOLOGIES.values(), ids=TOPOLOGIES)


def step_by_fractions(topology, i, j, dx, dy):
    """The cell that holds the angle of the centre of row j + dy, in turns."""
    heights = topology.heights.tolist()
    angle, column = Fraction(2 * (j + dy) + 1, 2 * heights[i]), i + dx
    if column < 0 and topology.rotate:
        column, angle = -1 - column, angle + Fraction(1, 2)
    column = min(max(column, 0), len(heights) - 1)
    return column, floor(angle * heights[column]) % heights[column]


def numbered(topology, channels=1):
    count = channels * topology.rows * topology.columns
    return torch.arange(count).reshape(1, channels, topology.rows, topology.columns)


@each_topology
@pytest.mark.parametrize(("dx", "dy"), STEPS)
def test_steps(topology, dx, dy):
    cells = [(i, j) for i, height in enumerate(topology.heights.tolist()) for j in range(height)]
    want = [step_by_fractions(topology, i, j, dx, dy) for i, j in cells]
    assert topology.neighbour(torch.tensor(cells), dx, dy).tolist() == [list(cell) for cell in want]
    image = numbered(topology, 2)
    shifted = topology.shifted(image, dx, dy)
    for (i, j), (column, row) in zip(cells, want, strict=True):
        assert torch.equal(shifted[..., j, i], image[..., row, column])
        assert topology.exists[0, 0, row, column]


@each_topology
def test_strips_hold_all_rows_of_taps(topology):
    """What lies dy rows further is read dy rows further down, also after several turns."""
    strip = topology.reads(-1, 0, 1, margin=9)
    for dy in (-9, -2, 0, 3, 9):
        for row in range(int(topology.heights[0])):
            column, at = step_by_fractions(topology, 0, row, -1, dy)
            assert strip[9 + dy + row, 0] == at * topology.columns + column


@each_topology
def test_expanding_and_collapsing(topology):
    image = numbered(topology)
    expanded = topology.expand(image)
    for i, height in enumerate(topology.heights.tolist()):
        for row in range(topology.rows):  # the cell whose angles hold the middle of the row
            assert expanded[0, 0, row, i] == image[0, 0, floor(Fraction(2 * row + 1, 2 * topology.rows) * height), i]
    back = topology.collapse(expanded)
    assert torch.equal(back[topology.exists], image[topology.exists])


@each_topology
def test_padding_goes_where_neighbours_are(topology):
    """Padding is a step in the same raster without cuts; beyond a corner it is a step in both directions."""
    full = Topology(torch.full_like(topology.heights, topology.rows), topology.rows, topology.rotate)
    image = numbered(topology)
    padded = topology.pad(image, 2)
    assert torch.equal(padded[..., 2:-2, 2:-2], image)
    for x in range(-2, topology.columns + 2):
        for y in range(-2, topology.rows + 2):
            column, row = step_by_fractions(full, 0, 0, x, y)
            assert padded[0, 0, y + 2, x + 2] == image[0, 0, row, column]


def test_warps_have_one():
    gaze = Gaze(torch.tensor([[3.0, 4.0]]))
    warp = VisualPolarWarp(gaze, (12, 16), (9, 11), "rotate", e_max=12.0)
    assert torch.equal(warp.topology.heights, warp.heights)
    assert torch.equal(warp.topology.exists, warp.exists)
    assert warp.topology.rotate
    assert not LogPolarWarp(gaze, (12, 16), (9, 11)).topology.rotate
    assert ScreenWarp(gaze, (12, 16), (12, 16)).topology is None


def test_the_derivative_of_a_shift_is_exact():
    topology = TOPOLOGIES["cut rotate"]
    image = torch.rand(2, 3, 8, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0), requires_grad=True)
    assert torch.autograd.gradcheck(lambda image: topology.shifted(image, -2, 3), image)


def test_bad_input():
    with pytest.raises(ShapeError, match=r"heights: expected shape \(w\), got \(2, 2\)"):
        Topology(torch.ones(2, 2), 2)
    with pytest.raises(ValueError, match=r"heights: expected an integer type, got torch\.float32"):
        Topology(torch.ones(2), 2)
    with pytest.raises(ValueError, match="heights: expected heights from 1 to 4, got 0 to 5"):
        Topology(torch.tensor([0, 5]), 4)
    with pytest.raises(ValueError, match="rows: expected an integer of at least 1, got 0"):
        Topology(torch.tensor([1]), 0)
    with pytest.raises(ShapeError, match=r"image: expected shape \(\*, \*, h=7, w=6\)"):
        TOPOLOGIES["cut"].shifted(torch.zeros(1, 1, 6, 7), 1, 0)
    with pytest.raises(ValueError, match="cells: expected integers"):
        TOPOLOGIES["cut"].neighbour(torch.zeros(3, 2), 1, 0)
