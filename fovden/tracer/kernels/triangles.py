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

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.jit import Float, Int, inlined, vectorised
from fovden.simd import FLOATS, I32, Lanes, load, splat, store
from fovden.tracer.kernels.layout import WIDTH

ZERO, ONE = np.float32(0.0), np.float32(1.0)


class ShearedRay(NamedTuple):
    """A ray prepared for triangles: the origin along the permuted axes, the shear, and the axes' row offsets."""

    ox: Float
    oy: Float
    oz: Float
    sx: Float
    sy: Float
    sz: Float
    row_x: Int
    row_y: Int
    row_z: Int


@inlined
def sheared_ray(ox: Float, oy: Float, oz: Float, dx: Float, dy: Float, dz: Float) -> ShearedRay:
    """Prepares a ray for :func:`hit_triangles`: its largest component becomes the third axis."""
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    x, y, z = np.int64(0), np.int64(WIDTH), np.int64(2 * WIDTH)
    if ax >= ay and ax >= az:
        inverse = ONE / dx
        return ShearedRay(oy, oz, ox, dy * inverse, dz * inverse, inverse, y, z, x)
    if ay >= az:
        inverse = ONE / dy
        return ShearedRay(oz, ox, oy, dz * inverse, dx * inverse, inverse, z, x, y)
    inverse = ONE / dz
    return ShearedRay(ox, oy, oz, dx * inverse, dy * inverse, inverse, x, y, z)


def _edge_functions(builder: Any, block: Any, ray: Any) -> tuple[list[Lanes], list[Lanes]]:
    """The three edge functions U, V, W and the vertices' depths before scaling."""
    origin = [splat(builder, builder.extract_value(ray, i), WIDTH) for i in range(3)]
    shear = [splat(builder, builder.extract_value(ray, 3 + i), WIDTH) for i in range(2)]
    rows = [builder.extract_value(ray, 6 + i) for i in range(3)]
    x, y, depth = [], [], []
    for vertex in range(3):
        corner = builder.gep(block, [ir.Constant(ir.IntType(64), vertex * 3 * WIDTH)])
        px, py, pz = (load(builder, corner, row, WIDTH) - o for row, o in zip(rows, origin, strict=True))
        x.append(px - shear[0] * pz)
        y.append(py - shear[1] * pz)
        depth.append(pz)
    edges = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]]
    return edges, depth


def _hit_triangles(*, record: bool) -> Any:
    @intrinsic
    def hit(context: Any, blocks: Any, base: Any, ray: Any, t_max: Any, results: Any) -> Any:
        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            blocks, base, ray, t_max, results = arguments
            block = builder.gep(blocks, [base])
            (u, v, w), depth = _edge_functions(builder, block, ray)
            inside = ((u >= 0.0) & (v >= 0.0) & (w >= 0.0)) | ((u <= 0.0) & (v <= 0.0) & (w <= 0.0))
            candidates = inside.bits()
            before = builder.block
            with builder.if_then(builder.icmp_unsigned("!=", candidates, ir.Constant(I32, 0)), likely=False):
                determinant = u + v + w
                scale = splat(builder, builder.extract_value(ray, 5), WIDTH)
                weighted = (u * depth[0] + v * depth[1] + w * depth[2]) * scale
                t = weighted / determinant
                hits = inside & (t > 0.0) & (t < splat(builder, t_max, WIDTH))
                confirmed = hits.bits()
                if record:
                    store(builder, t, results, 0)
                    store(builder, v / determinant, results, WIDTH)
                    store(builder, w / determinant, results, 2 * WIDTH)
                after = builder.block
            mask = builder.phi(I32)
            mask.add_incoming(ir.Constant(I32, 0), before)
            mask.add_incoming(confirmed, after)
            return mask

        return types.int32(FLOATS, types.int64, ray, types.float32, FLOATS), generate

    return hit


hit_triangles_vector = _hit_triangles(record=True)
"""Mask of the triangles of the block at ``base`` that the ray hits in (0, t_max). Where it is not zero, ``results``
holds t and the barycentric weights of the second and third vertex, eight of each."""

any_triangle_vector = _hit_triangles(record=False)
"""The mask alone."""


@inlined
def hit_triangles_plain(blocks: Any, base: Int, ray: ShearedRay, t_max: Float, results: Any) -> Int:
    """:data:`hit_triangles_vector`, one triangle after the other."""
    mask = np.int32(0)
    for i in range(WIDTH):
        a, b, c = base + i, base + 3 * WIDTH + i, base + 6 * WIDTH + i
        az, bz, cz = blocks[a + ray.row_z] - ray.oz, blocks[b + ray.row_z] - ray.oz, blocks[c + ray.row_z] - ray.oz
        ax = (blocks[a + ray.row_x] - ray.ox) - ray.sx * az
        ay = (blocks[a + ray.row_y] - ray.oy) - ray.sy * az
        bx = (blocks[b + ray.row_x] - ray.ox) - ray.sx * bz
        by = (blocks[b + ray.row_y] - ray.oy) - ray.sy * bz
        cx = (blocks[c + ray.row_x] - ray.ox) - ray.sx * cz
        cy = (blocks[c + ray.row_y] - ray.oy) - ray.sy * cz
        u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
        if (u >= ZERO and v >= ZERO and w >= ZERO) or (u <= ZERO and v <= ZERO and w <= ZERO):
            determinant = u + v + w
            t = (u * az + v * bz + w * cz) * ray.sz / determinant
            if t > ZERO and t < t_max:
                mask |= np.int32(1 << i)
                results[i], results[WIDTH + i], results[2 * WIDTH + i] = t, v / determinant, w / determinant
    return mask


hit_triangles = hit_triangles_vector if vectorised() else hit_triangles_plain
any_triangle = any_triangle_vector if vectorised() else hit_triangles_plain
