"""One ray against the eight triangles of a leaf block, watertight.

The method is Woop, Benthin and Wald, "Watertight ray/triangle intersection" (JCGT 2(1), 2013): vertices are sheared so
that the ray becomes the third axis, and the signs of three planar edge functions decide.

Why no ray slips through a closed mesh: a vertex is sheared by the same operations in every triangle that has it, so
all triangles agree on one flat picture. An edge function is the difference of two rounded products. Rounding is
monotone, so the difference has the exact sign or is zero; and zero counts as inside, for either orientation. A triangle
that contains the ray exactly in that picture is therefore always hit. This needs the products to be rounded
separately (no fused multiply-add in the edge functions) and makes Woop's second pass in double precision unnecessary:
that only settles which of two neighbours owns their common edge, and the closest hit is the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.jit import Int, inlined, vectorised
from fovden.simd import FLOATS, I32, I64, Lanes, load, load_int32, maximum, minimum, store
from fovden.tracer.kernels.boxes import integer, number
from fovden.tracer.kernels.layout import (
    LIMIT,
    ORIGIN,
    SHEAR,
    VERTEX_ROWS,
    WIDTH,
)

ZERO = np.float32(0.0)


def _edge_functions(builder: Any, block: Any, ray: Any) -> tuple[list[Lanes], list[Lanes]]:
    """The three edge functions U, V, W and the vertices' depths before scaling."""
    origin = [number(builder, ray, ORIGIN + i) for i in range(3)]
    shear = [number(builder, ray, SHEAR + i) for i in range(2)]
    rows = [integer(builder, ray, VERTEX_ROWS + i) for i in range(3)]
    x, y, depth = [], [], []
    for vertex in range(3):
        corner = builder.gep(block, [ir.Constant(I64, vertex * 3 * WIDTH)])
        px, py, pz = (load(builder, corner, row, WIDTH) - o for row, o in zip(rows, origin, strict=True))
        x.append(px - shear[0] * pz)
        y.append(py - shear[1] * pz)
        depth.append(pz)
    edges = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]]
    return edges, depth


@intrinsic
def hit_triangles_vector(context: Any, blocks: Any, base: Any, ray: Any, results: Any) -> Any:
    """Mask of the triangles of the block at ``base`` that the ray hits within its limit.

    Where it is not zero, ``results`` holds t and the barycentric weights of the second and third vertex, eight of each.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        blocks, base, ray, results = arguments
        (u, v, w), depth = _edge_functions(builder, builder.gep(blocks, [base]), ray)
        # A NaN may be passed over here; it is in the determinant, too, and fails below.
        smallest, largest = minimum(minimum(u, v), w), maximum(maximum(u, v), w)
        inside = (smallest >= 0.0) | (largest <= 0.0)
        before = builder.block
        with builder.if_then(builder.icmp_unsigned("!=", inside.bits(), ir.Constant(I32, 0)), likely=False):
            determinant = u + v + w
            weighted = (u * depth[0] + v * depth[1] + w * depth[2]) * number(builder, ray, SHEAR + 2)
            t = weighted / determinant
            hits = (inside & (t > 0.0) & (t <= number(builder, ray, LIMIT))).bits()
            for row, values in enumerate((t, v / determinant, w / determinant)):
                store(builder, values, results, row * WIDTH)
            after = builder.block
        mask = builder.phi(I32)
        mask.add_incoming(ir.Constant(I32, 0), before)
        mask.add_incoming(hits, after)
        return mask

    return types.int32(FLOATS, types.int64, FLOATS, FLOATS), generate


@inlined
def hit_triangles_plain(blocks: Any, base: Int, ray: Any, results: Any) -> Int:
    """:data:`hit_triangles_vector`, one triangle after the other."""
    mask = np.int32(0)
    ox, oy, oz, sx, sy = ray[ORIGIN], ray[ORIGIN + 1], ray[ORIGIN + 2], ray[SHEAR], ray[SHEAR + 1]
    row_x, row_y, row_z = (
        load_int32(ray, VERTEX_ROWS),
        load_int32(ray, VERTEX_ROWS + 1),
        load_int32(ray, VERTEX_ROWS + 2),
    )
    for i in range(WIDTH):
        a, b, c = base + i, base + 3 * WIDTH + i, base + 6 * WIDTH + i
        az, bz, cz = blocks[a + row_z] - oz, blocks[b + row_z] - oz, blocks[c + row_z] - oz
        ax = (blocks[a + row_x] - ox) - sx * az
        ay = (blocks[a + row_y] - oy) - sy * az
        bx = (blocks[b + row_x] - ox) - sx * bz
        by = (blocks[b + row_y] - oy) - sy * bz
        cx = (blocks[c + row_x] - ox) - sx * cz
        cy = (blocks[c + row_y] - oy) - sy * cz
        u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
        if (u >= ZERO and v >= ZERO and w >= ZERO) or (u <= ZERO and v <= ZERO and w <= ZERO):
            determinant = u + v + w
            t = (u * az + v * bz + w * cz) * ray[SHEAR + 2] / determinant
            if t > ZERO and t <= ray[LIMIT]:
                mask |= np.int32(1 << i)
                results[i], results[WIDTH + i], results[2 * WIDTH + i] = t, v / determinant, w / determinant
    return mask


hit_triangles = hit_triangles_vector if vectorised() else hit_triangles_plain
