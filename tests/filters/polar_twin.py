"""À-trous passes on polar rasters, once more: gathers through ``Warp.neighbour``, one tap at a time."""

from fractions import Fraction
from itertools import groupby

import torch

from fovden import Gaze
from fovden.filters.taps import B3_SPLINE
from fovden.foveation import LogPolarWarp, VisualPolarWarp

SPLINE = torch.tensor(B3_SPLINE).double()[:, None] * torch.tensor(B3_SPLINE).double()


class Raster:
    """A raster of any heights, with the rule for neighbours in fractions."""

    def __init__(self, height, heights, border):
        self.resolution, self.heights, self.fovea_border = (height, len(heights)), torch.tensor(heights), border

    def neighbour(self, cells, dx, dy):
        found = []
        for i, j in cells.tolist():
            column, turn = i + dx, Fraction(0)
            if column < 0 and self.fovea_border == "rotate":
                column, turn = -1 - column, Fraction(1, 2)
            column = min(max(column, 0), len(self.heights) - 1)
            own, its = int(self.heights[i]), int(self.heights[column])
            angle = ((j + dy + Fraction(1, 2)) / own + turn) % 1  # in turns
            found.append((column, int(angle * its)))
        return torch.tensor(found)


def rasters(border):
    """Rasters of several kinds, by name."""
    gaze, screen = Gaze(torch.tensor([[25.0, 13.0]])), (50, 60)
    return {
        "smooth": VisualPolarWarp(gaze, screen, (37, 40), border),
        "stair": VisualPolarWarp(gaze, screen, (40, 35), border, cut="stair", block=8),
        "uncut": VisualPolarWarp(gaze, screen, (17, 20), border, cut="none"),
        "log": LogPolarWarp(gaze, screen, (33, 24), fovea_border=border),
        "ones": Raster(5, [1, 1, 5, 1, 3], border),
        "wild": Raster(40, [1, 40, 2, 39, 17, 17, 3, 34, 33, 16, 32, 7], border),
        "row": Raster(1, [1] * 9, border),
        "column": Raster(19, [18], border),
        "cell": Raster(3, [1], border),
    }


def cells_of(raster):
    """Columns and rows of all cells."""
    return torch.tensor([(i, j) for i, height in enumerate(raster.heights.tolist()) for j in range(height)])


def taps_of(raster, cells, step):
    """Places of the taps of all cells, in order of the kernel's entries, as (row, column)."""
    return [
        (dy + 2, dx + 2, raster.neighbour(cells, dx * step, dy * step)) for dy in range(-2, 3) for dx in range(-2, 3)
    ]


def polar_twin(raster, made, plan, *, known, region, fill):
    """The image, mask and known flags after passes (step, label, level), in double precision; 0 where nothing is.

    ``made`` has radiance, normal, position, mask, inverse, and perhaps factors and kernels.
    """
    cells = cells_of(raster)

    def at(image):
        return image[:, :, cells[:, 1], cells[:, 0]]

    full = torch.zeros_like(made["mask"]) == 0
    known, label = full if known is None else known, torch.zeros_like(full, dtype=torch.uint8)
    label = at(label if region is None else region)
    factors = at(made["factors"]) if "factors" in made else torch.ones(1, 3, 1)
    c, n, x, b, has = map(at, (made["radiance"], made["normal"], made["position"], made["mask"], known))
    number_of = torch.zeros(raster.resolution[::-1], dtype=torch.long)
    number_of[cells[:, 0], cells[:, 1]] = torch.arange(len(cells))
    for _, group in groupby(range(len(plan)), lambda number: plan[number][2]):
        before = c, b, has
        for number in group:
            step, own_label, _ = plan[number]
            inverse = made["inverse"][number, :, None] * factors
            kernel = made["kernels"][number] if "kernels" in made else SPLINE
            total, summed = 0.0, 0.0
            now, mask, has_value = before
            for row, column, where in taps_of(raster, cells, step):
                q = number_of[where[:, 0], where[:, 1]]
                e = [(mine - mine[:, :, q]).square().sum(1, keepdim=True) for mine in (now, n, x)]
                exponent = has_value * inverse[:, :1] * e[0] + inverse[:, 1:2] * e[1] + inverse[:, 2:] * e[2]
                weight = kernel[row, column] * mask[:, :, q] * torch.exp(-exponent.clamp(max=80.0))
                total, summed = total + weight, summed + weight * now[:, :, q]
            filled = (total > 1e-20) & (label == own_label)
            c = torch.where(filled, summed / torch.where(filled, total, 1.0), c)
            has = has | filled
            b = torch.where(filled, 1.0, b) if fill else b
    out = []
    for values in (c, b, has):
        image = values.new_zeros(*values.shape[:2], *raster.resolution)
        image[:, :, cells[:, 1], cells[:, 0]] = values
        out.append(image)
    return out
