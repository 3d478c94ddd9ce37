"""The filters once more, as slow and obvious loops over pixels and taps in double precision."""

import math
from functools import cache

import numpy as np
import torch

SPLINE = np.outer([1, 4, 6, 4, 1], [1, 4, 6, 4, 1]) / 256


def squared(a, b):
    return sum((float(s) - float(t)) ** 2 for s, t in zip(a, b, strict=True))


def numbers(tensor):
    return None if tensor is None else tensor.detach().double().numpy()


def plane(value, shape):
    """A number or array as one value per pixel."""
    views, _, height, width = shape
    value = numbers(value) if hasattr(value, "detach") else np.asarray(value, dtype=float)
    return np.broadcast_to(value, (views, 1, height, width))


class Screen:
    """A grid of pixels, with or without a clamp at its border."""

    def __init__(self, shape, clamp=False):
        self.height, self.width = shape[2:]
        self.clamp = clamp

    def is_cell(self, y, x):  # noqa: ARG002
        return True

    def tap(self, y, x, dy, dx):
        """The pixel dy rows and dx columns away, None outside."""
        y, x = y + dy, x + dx
        if self.clamp:
            y, x = min(max(y, 0), self.height - 1), min(max(x, 0), self.width - 1)
        return (y, x) if 0 <= y < self.height and 0 <= x < self.width else None


class Cells:
    """The cells of a warp, one by one."""

    def __init__(self, warp):
        self.heights, self.rows = warp.heights.tolist(), warp.resolution[0]
        places = torch.stack(torch.meshgrid(*map(torch.arange, warp.resolution), indexing="ij")[::-1], -1)
        self.table = cache(lambda dx, dy: warp.neighbour(places, dx, dy).tolist())

    def is_cell(self, y, x):
        return y < self.heights[x]

    def tap(self, y, x, dy, dx):
        return tuple(self.table(dx, dy)[y][x][::-1])


def pass_twin(
    c, n, x, b, step, sigmas, *, region=None, known=None, kernel=None, guide=None, centre=None, clamp=False, cells=None
):
    """One pass; returns the image and the sums of weights (0 outside the region)."""
    cells = Screen(c.shape, clamp) if cells is None else cells
    views, _, height, width = shape = c.shape
    kernel = SPLINE if kernel is None else kernel
    guide = c if guide is None else guide
    centre = guide if centre is None else centre
    sigma_c, sigma_n, sigma_x = (plane(sigma, shape) for sigma in sigmas)
    image, total = c.copy(), np.zeros((views, 1, height, width))
    for v, py, px in np.ndindex(views, height, width):
        if not cells.is_cell(py, px) or (region is not None and not region[v, 0, py, px]):
            continue
        summed = np.zeros(c.shape[1])
        for i, j in np.ndindex(5, 5):
            tap = cells.tap(py, px, (i - 2) * step, (j - 2) * step)
            if tap is None:
                continue
            qy, qx = tap
            exponent = -squared(n[v, :, py, px], n[v, :, qy, qx]) / (step * sigma_n[v, 0, py, px]) ** 2
            exponent -= squared(x[v, :, py, px], x[v, :, qy, qx]) / sigma_x[v, 0, py, px] ** 2
            if known is None or known[v, 0, py, px]:
                exponent -= squared(centre[v, :, py, px], guide[v, :, qy, qx]) / sigma_c[v, 0, py, px] ** 2
            weight = kernel[i, j] * b[v, 0, qy, qx] * math.exp(max(exponent, -80))
            total[v, 0, py, px] += weight
            summed += weight * c[v, :, qy, qx]
        if total[v, 0, py, px] > 1e-20:
            image[v, :, py, px] = summed / total[v, 0, py, px]
    return image, total


def nearest_twin(guide, b, cells=None):
    """Every pixel's guide read at the nearest pixel with a mask; ties as documented: column, left, upper."""
    if cells is not None:
        return nearest_cell_twin(guide, b, cells)
    out = guide.copy()
    for v, py, px in np.ndindex(guide.shape[0], *guide.shape[2:]):
        where = [(y, x) for y, x in np.ndindex(*guide.shape[2:]) if b[v, 0, y, x] > 0]
        if where:
            y, x = min(where, key=lambda p: ((p[0] - py) ** 2 + (p[1] - px) ** 2, abs(p[1] - px), p[1], p[0]))
            out[v, :, py, px] = guide[v, :, y, x]
    return out


def nearest_cell_twin(guide, b, cells):
    """The same in a polar raster, by the distance in the rectangle of stretched columns, around the circle."""
    out, rows, heights = guide.copy(), cells.rows, cells.heights
    stretched = [(y, x, (2 * y + 1) * heights[x] // (2 * rows)) for y, x in np.ndindex(rows, guide.shape[3])]
    for v, py, px in np.ndindex(guide.shape[0], *guide.shape[2:]):
        where = [(y + turn, x, row) for y, x, row in stretched if b[v, 0, row, x] > 0 for turn in (-rows, 0, rows)]
        if where and cells.is_cell(py, px):
            own = (2 * py + 1) * rows // (2 * heights[px])
            _, x, row = min(where, key=lambda p: ((p[0] - own) ** 2 + (p[1] - px) ** 2, abs(p[1] - px), p[1], p[0]))
            out[v, :, py, px] = guide[v, :, row, x]
    return out


def fill_twin(c, holes, b, n, x, sigma_n, sigma_x, label=None, cells=None):
    """Label, then geometry, then mask alone, each at steps 1, 2, 4, ...; what is filled may then be read.

    In a raster's cells the last stage is run until nothing is left, or nothing changes any more.
    """
    stages = ["label", "geometry", "mask"] + ["mask"] * (10 if cells is not None else 0)
    cells = Screen(c.shape) if cells is None else cells
    c, b, holes = c.copy(), np.where(holes, 0, b), holes.copy()
    size = max(c.shape[2:])
    for stage in stages:
        step = 1
        while step < size and not (stage == "label" and label is None):
            now_c, now_b = c.copy(), b.copy()
            for v, _, py, px in np.argwhere(holes):
                if not cells.is_cell(py, px):
                    continue
                total, summed = 0.0, 0.0
                for i, j in np.ndindex(5, 5):
                    tap = cells.tap(py, px, (i - 2) * step, (j - 2) * step)
                    if tap is None:
                        continue
                    qy, qx = tap
                    weight = SPLINE[i, j] * b[v, 0, qy, qx]
                    if stage == "label":
                        weight *= label[v, 0, py, px] == label[v, 0, qy, qx]
                    if stage == "geometry":
                        d = squared(n[v, :, py, px], n[v, :, qy, qx]) / (step * sigma_n[v, 0, py, px]) ** 2
                        d += squared(x[v, :, py, px], x[v, :, qy, qx]) / sigma_x[v, 0, py, px] ** 2
                        weight *= math.exp(max(-d, -80))
                    total += weight
                    summed = summed + weight * c[v, :, qy, qx]
                if total > 1e-20:
                    now_c[v, :, py, px], now_b[v, 0, py, px], holes[v, 0, py, px] = summed / total, 1, False
            c, b = now_c, now_b
            step *= 2
    return c


def schedule_twin(levels, schedule, sigma_by):
    """(step, factor of sigma_radiance) for decreasing steps."""
    for k in range(levels):
        scale = levels - 1 - k
        exponent = k if sigma_by == "pass" else scale
        phi = {"halve_sigma": 4.0**-exponent, "halve_phi": 2.0**-exponent, "constant": 1.0}[schedule]
        yield 2**scale, math.sqrt(phi)


def paste(inside, new, old):
    return {key: np.where(inside, new[key], old[key]) for key in old}


def nonhomogeneous_twin(
    c,
    n,
    x,
    b,
    layer,
    levels,
    sigmas,
    *,
    mask_at="neighbor",
    guide="current",
    unsampled_guide="drop",
    mask_update="static",
    fill_holes=True,
    layers="sequential",
    border="skip",
    schedule="halve_sigma",
    sigma_by="pass",
    guide_curve="linear",
    kernels=None,
    factors=None,
    cells=None,
):
    """The reference procedure: layer by layer, pass by pass, holes at the end.

    ``sigmas`` is a triple per layer, of numbers or of lists by pass; ``kernels`` has an array for each layer and pass.
    """
    layer = np.minimum(layer, len(levels) - 1)
    raw = {"c": c.copy(), "b": b.copy(), "known": b > 0, "first": c.copy()}

    def widths(index, k, factor):
        own = [width[k] if isinstance(width, list) else width for width in sigmas[index]]
        own[0] *= factor
        return own if factors is None else [width * factors[:, j : j + 1] for j, width in enumerate(own)]

    def run(image, index, k):
        step, factor = list(schedule_twin(levels[index], schedule, sigma_by))[k]
        sigma = widths(index, k, factor)
        region = layer == index
        rt = image["c" if guide == "current" else "first"]
        rt = np.log(1 + rt) if guide_curve == "log" else rt
        centre, known = rt, image["known"]
        if unsampled_guide != "drop":
            known = None
        if unsampled_guide == "nearest":
            centre = np.where(image["known"], rt, nearest_twin(rt, image["b"], cells))
        taps = image["b"]
        if mask_at == "center":
            region, taps = region & (image["b"] > 0), np.ones_like(b)
        new, total = pass_twin(
            image["c"], n, x, taps, step, sigma, region=region, known=known, guide=rt, centre=centre,
            clamp=border == "clamp", kernel=None if kernels is None else kernels[index][k], cells=cells,
        )  # fmt: skip
        filled = total > 1e-20
        return {
            "c": new,
            "b": np.where(filled, 1, image["b"]) if mask_update == "fill" else image["b"],
            "known": image["known"] | filled,
            "first": np.where(filled & ~image["known"], new, image["first"]),
        }

    state = raw
    if layers == "sequential":
        for index in range(len(levels)):
            for k in range(levels[index]):
                state = run(state, index, k)
    if layers == "snapshot":
        for index in range(len(levels)):
            own = raw
            for k in range(levels[index]):
                own = run(own, index, k)
            state = paste(layer == index, own, state)
    if layers == "interleaved":
        for scale in range(max(levels) - 1, -1, -1):
            before = state
            for index in range(len(levels)):
                if scale < levels[index]:
                    state = paste(layer == index, run(before, index, levels[index] - 1 - scale), state)
    if not fill_holes or mask_at == "center":
        return state["c"]
    last = [widths(index, -1, 1) for index in range(len(levels))]  # of step 1, as the first taps of the filling
    sigma_n, sigma_x = (sum((layer == index) * own[k] for index, own in enumerate(last)) for k in (1, 2))
    return fill_twin(state["c"], ~state["known"], state["b"], n, x, sigma_n, sigma_x, cells=cells)
