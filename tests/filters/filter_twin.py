"""The filters once more, as slow and obvious loops over pixels and taps in double precision."""

import math

import numpy as np

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


def pass_twin(c, n, x, b, step, sigmas, *, region=None, known=None, kernel=None, guide=None, centre=None, clamp=False):
    """One pass; returns the image and the sums of weights (0 outside the region)."""
    views, _, height, width = shape = c.shape
    kernel = SPLINE if kernel is None else kernel
    guide = c if guide is None else guide
    centre = guide if centre is None else centre
    sigma_c, sigma_n, sigma_x = (plane(sigma, shape) for sigma in sigmas)
    image, total = c.copy(), np.zeros((views, 1, height, width))
    for v, py, px in np.ndindex(views, height, width):
        if region is not None and not region[v, 0, py, px]:
            continue
        summed = np.zeros(c.shape[1])
        for i, j in np.ndindex(5, 5):
            qy, qx = py + (i - 2) * step, px + (j - 2) * step
            if clamp:
                qy, qx = min(max(qy, 0), height - 1), min(max(qx, 0), width - 1)
            if not (0 <= qy < height and 0 <= qx < width):
                continue
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


def nearest_twin(guide, b):
    """Every pixel's guide read at the nearest pixel with a mask; ties as documented: column, left, upper."""
    out = guide.copy()
    for v, py, px in np.ndindex(guide.shape[0], *guide.shape[2:]):
        where = [(y, x) for y, x in np.ndindex(*guide.shape[2:]) if b[v, 0, y, x] > 0]
        if where:
            y, x = min(where, key=lambda p: ((p[0] - py) ** 2 + (p[1] - px) ** 2, abs(p[1] - px), p[1], p[0]))
            out[v, :, py, px] = guide[v, :, y, x]
    return out


def fill_twin(c, holes, b, n, x, sigma_n, sigma_x, label=None):
    """Label, then geometry, then mask alone, each at steps 1, 2, 4, ...; what is filled may then be read."""
    c, b, holes = c.copy(), np.where(holes, 0, b), holes.copy()
    size = max(c.shape[2:])
    for stage in ("label", "geometry", "mask"):
        step = 1
        while step < size and not (stage == "label" and label is None):
            now_c, now_b = c.copy(), b.copy()
            for v, _, py, px in np.argwhere(holes):
                total, summed = 0.0, 0.0
                for i, j in np.ndindex(5, 5):
                    qy, qx = py + (i - 2) * step, px + (j - 2) * step
                    if not (0 <= qy < c.shape[2] and 0 <= qx < c.shape[3]):
                        continue
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
            centre = np.where(image["known"], rt, nearest_twin(rt, image["b"]))
        taps = image["b"]
        if mask_at == "center":
            region, taps = region & (image["b"] > 0), np.ones_like(b)
        new, total = pass_twin(
            image["c"], n, x, taps, step, sigma, region=region, known=known, guide=rt, centre=centre,
            clamp=border == "clamp", kernel=None if kernels is None else kernels[index][k],
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
    return fill_twin(state["c"], ~state["known"], state["b"], n, x, sigma_n, sigma_x)
