"""Books: rows of them on a shelf, lying piles, an open one."""

from __future__ import annotations

import numpy as np

from fovden.tracer.procedural.detail import Detail
from fovden.tracer.procedural.patch import Array, Patch, join
from fovden.tracer.procedural.primitives import bridge, grid, quad
from fovden.tracer.procedural.textures.paper import SPINE_COLUMNS, SPINE_ROWS

__all__ = ["book", "pile", "row"]

BOARD = 0.0028
"""Thickness of a binding's boards, metres."""

BANDS = (0.12, 0.30, 0.52, 0.74, 0.9)
"""Heights of the raised bands on a spine, as shares of the book's height."""


def book(size: tuple[float, float, float], design: int, detail: Detail, *, banded: bool) -> tuple[Patch, Patch]:
    """Returns a standing book with its spine towards +z: binding and pages, without a bottom.

    Args:
        size: Thickness, height and depth, metres.
        design: Number of its spine in the image of bindings.
        detail: Fineness.
        banded: Whether cords raise bands across the spine.

    Returns:
        Binding, its texture coordinates those of the design, and the block of pages.

    Example:
        >>> binding, pages = book((0.03, 0.22, 0.15), 5, Detail(), banded=True)
        >>> pages.triangle_count, float(binding.vertices[:, 1].max())
        (4, 0.22)
    """
    thick, tall, deep = size
    half = thick / 2
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, detail.segments(6, least=2) + 1)
    across = half * np.sin(angle)
    bulge = min(0.5 * half, 0.011) * np.cos(angle)
    heights, raised = [0.0], [0.0]
    if banded and detail.shows(0.5):
        for band in BANDS:
            heights += [band - 0.018, band - 0.008, band + 0.008, band + 0.018]
            raised += [0.0, 0.0022, 0.0022, 0.0]
    heights, raised = [*heights, 1.0], [*raised, 0.0]
    y, out = np.asarray(heights)[:, None] * tall, np.asarray(raised)[:, None]
    spread = 1 + out / half
    spine = np.stack(np.broadcast_arrays(across * spread, y, deep / 2 + bulge + out * np.cos(angle) ** 0.5), axis=-1)
    u0, v0 = design % SPINE_COLUMNS, design // SPINE_COLUMNS % SPINE_ROWS
    cell = np.array([1 / SPINE_COLUMNS, 1 / SPINE_ROWS])

    def cell_uv(u: Array | float, v: Array | float) -> Array:
        pair: Array = (np.stack(np.broadcast_arrays(u, v), axis=-1) * 0.94 + 0.03 + [u0, v0]) * cell
        return pair

    back = grid(spine, smooth=True, uv=cell_uv((across / half + 1) / 2, y / tall))
    pieces = [back]
    z0, z1 = -deep / 2, deep / 2
    cover = cell_uv(np.array([0.04, 0.04, 0.04, 0.04]), np.array([0.3, 0.31, 0.32, 0.33]))
    inner = half - BOARD
    for side in (-1.0, 1.0):
        a, b = side * half, side * inner
        faces = [quad((a, 0, z1), (a, 0, z0), (a, tall, z0), (a, tall, z1))]
        faces.append(quad((b, tall, z1), (a, tall, z1), (a, tall, z0), (b, tall, z0)))
        faces.append(quad((a, 0, z0), (b, 0, z0), (b, tall, z0), (a, tall, z0)))
        for made in faces:
            face = made if side > 0 else made.reversed()
            pieces.append(Patch(face.vertices, face.faces, cover, face.normals))
    top = np.stack([across, np.full_like(across, tall), z1 + bulge], axis=1)
    cap = bridge(top[1:-1], top[[0, -1]])
    pieces.append(Patch(cap.vertices, cap.faces, cell_uv(np.full(len(top), 0.1), 0.5), cap.normals))
    high = tall - 0.004
    paper = [
        quad((-inner, high, z1), (inner, high, z1), (inner, high, z0 + 0.004), (-inner, high, z0 + 0.004)),
        quad((inner, 0, z0 + 0.004), (-inner, 0, z0 + 0.004), (-inner, high, z0 + 0.004), (inner, high, z0 + 0.004)),
    ]
    return join(pieces), join(paper)


def row(rng: np.random.Generator, length: float, height: float, depth: float, detail: Detail) -> tuple[Patch, Patch]:
    """Returns books that stand side by side from x = 0, some of them leaning at the end.

    Args:
        rng: Chooses the books.
        length: Of the row, metres.
        height: Room above the shelf, metres.
        depth: Of the shelf, metres; spines stand near its front at z = 0.
        detail: Fineness.

    Returns:
        Bindings and pages, their feet at y = 0.001.

    Example:
        >>> bindings, pages = row(np.random.default_rng(0), 0.5, 0.35, 0.28, Detail())
        >>> bool(bindings.vertices[:, 0].max() <= 0.6)
        True
    """
    x = 0.0
    bindings: list[Patch] = []
    papers: list[Patch] = []
    while True:
        design = int(rng.integers(SPINE_COLUMNS * SPINE_ROWS))
        thick = float(rng.uniform(0.018, 0.052))
        tall = float(min(rng.uniform(0.62, 0.95) * height, height - 0.025))
        deep = float(min(rng.uniform(0.62, 0.78) * tall, depth - 0.05))
        run = int(rng.integers(3, 6)) if rng.random() < 0.12 else 1
        banded = rng.random() < 0.45
        for _ in range(run):
            if x + thick > length:
                break
            both = book((thick, tall, deep), design, detail, banded=banded)
            back = -0.02 - 0.02 * rng.random() - deep / 2
            for piece, collection in zip(both, (bindings, papers), strict=True):
                collection.append(piece.placed((x + thick / 2, 0.001, back)))
            x += thick + 0.0012 + 0.002 * float(rng.random())
        else:
            continue
        break
    lean = float(rng.uniform(0.10, 0.24))
    last = book((0.03, 0.7 * height, 0.5 * height), int(rng.integers(SPINE_COLUMNS * SPINE_ROWS)), detail, banded=True)
    c, s = np.cos(lean), np.sin(lean)
    reach = 0.7 * height * s + 0.03
    if x + reach < length + 0.08 and bindings:
        matrix = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        for piece, collection in zip(last, (bindings, papers), strict=True):
            tilted = piece.transformed(matrix)
            collection.append(
                tilted.placed((x + reach - 0.012, 0.001 - tilted.vertices[:, 1].min(), -0.05 - 0.25 * height))
            )
    return join(bindings), join(papers)


def pile(rng: np.random.Generator, sizes: list[tuple[float, float, float]], detail: Detail) -> tuple[Patch, Patch]:
    """Returns books that lie on each other, from the largest up, their spines towards the front.

    Args:
        rng: Chooses bindings and turns.
        sizes: Thickness, height and depth of each, metres, from the lowest up.
        detail: Fineness.

    Returns:
        Bindings and pages, the lowest at y = 0.001.

    Example:
        >>> bindings, _ = pile(np.random.default_rng(0), [(0.03, 0.2, 0.14), (0.02, 0.18, 0.12)], Detail())
        >>> round(float(bindings.vertices[:, 1].max()), 2)
        0.05
    """
    bindings: list[Patch] = []
    papers: list[Patch] = []
    y = 0.001
    lying = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for size in sizes:
        both = book(size, int(rng.integers(SPINE_COLUMNS * SPINE_ROWS)), detail, banded=rng.random() < 0.5)
        turn = 0.25 * rng.standard_normal()
        for piece, collection in zip(both, (bindings, papers), strict=True):
            collection.append(
                piece.placed((0, -size[1] / 2, 0)).transformed(lying).placed((0, y + size[0] / 2, 0), turns=turn)
            )
        y += size[0] + 0.0012
    return join(bindings), join(papers)
