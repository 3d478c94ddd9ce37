"""One ray against the eight boxes of a node (slab test).

Where a direction has a zero component its inverse is a true infinity; 0 * infinity = NaN, which a bound in the ray's
own plane gives, is passed over by the order of the arguments of ``maximum`` and ``minimum``.

The test never loses a triangle that ``triangles`` would hit. With u = 2^-24, o the origin, E the box's largest extent
and a vertex v, the sheared coordinate x - o_x - s (z - o_z) is off by 2 u |v_x - o_x| + 5 u |s (v_z - o_z)| at most. A
point p of the triangle that the rounded picture puts on the ray is thus up to 7 u (|p_x - o_x| + E) beside it. The part
with E is covered by ``build``, which enlarges boxes by 8 u E. The part with p is a relative error of 7 u in the
distance, to which (bound - origin) / direction adds three roundings: 2 (7 + 3) u between near and far, for which the
far distance is enlarged by 32 u. (Ize, "Robust BVH ray traversal", JCGT 2(2), 2013, has the roundings of the slabs
alone; Woop et al., see ``triangles``, enlarge the boxes for each ray.)
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fovden.jit import Float, Int, inlined, vectorised
from fovden.simd import F32, FLOATS, I32, I64, WORDS, Lanes, bits_of, load, load_int32, maximum, minimum, splat, store
from fovden.tracer.kernels.layout import CHILDREN, UPPER, WIDTH

FAR_SLACK = 1.0 + 2.0**-19
ZERO, ONE = np.float32(0.0), np.float32(1.0)
SLACK, INFINITY = np.float32(FAR_SLACK), np.float32(np.inf)


class SlabRay(NamedTuple):
    """A ray prepared for boxes: origin, inverse direction, and for each axis the row of the bounds met first."""

    ox: Float
    oy: Float
    oz: Float
    ix: Float
    iy: Float
    iz: Float
    near_x: Int
    near_y: Int
    near_z: Int


@inlined
def slab_ray(ox: Float, oy: Float, oz: Float, dx: Float, dy: Float, dz: Float) -> SlabRay:
    """Prepares a ray for :func:`hit_boxes`; the upper bounds come first along a negative direction."""
    ix, iy, iz = ONE / dx, ONE / dy, ONE / dz
    near_x = np.int64(UPPER if ix < ZERO else 0)
    near_y = np.int64(WIDTH + (UPPER if iy < ZERO else 0))
    near_z = np.int64(2 * WIDTH + (UPPER if iz < ZERO else 0))
    return SlabRay(ox, oy, oz, ix, iy, iz, near_x, near_y, near_z)


@intrinsic
def hit_boxes_vector(context: Any, nodes: Any, base: Any, ray: Any, t_max: Any, keys: Any) -> Any:
    """Mask of the boxes of the node at ``base`` that the ray meets before ``t_max``; writes a key for every box.

    A key has the bits of the entry distance above the child code. Distances are not negative, so that keys compare
    as integers the way distances compare.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        nodes, base, ray, t_max, keys = arguments
        node = builder.gep(nodes, [base])
        entry = splat(builder, ir.Constant(F32, 0.0), WIDTH)
        leave = splat(builder, ir.Constant(F32, float("inf")), WIDTH)
        for axis in range(3):
            origin = splat(builder, builder.extract_value(ray, axis), WIDTH)
            inverse = splat(builder, builder.extract_value(ray, 3 + axis), WIDTH)
            near = builder.extract_value(ray, 6 + axis)
            far = builder.sub(ir.Constant(I64, UPPER + 2 * WIDTH * axis), near)
            entry = maximum((load(builder, node, near, WIDTH) - origin) * inverse, entry)
            leave = minimum((load(builder, node, far, WIDTH) - origin) * inverse, leave)
        leave = minimum(leave * FAR_SLACK, splat(builder, t_max, WIDTH))
        wide = ir.VectorType(I64, WIDTH)
        distance = builder.zext(builder.bitcast(entry.value, ir.VectorType(I32, WIDTH)), wide)
        child = builder.zext(load(builder, node, CHILDREN, WIDTH, I32).value, wide)
        key = builder.or_(builder.shl(distance, ir.Constant(wide, [32] * WIDTH)), child)
        store(builder, Lanes(builder, key), keys)
        return (entry <= leave).bits()

    return types.int32(FLOATS, types.int64, ray, types.float32, WORDS), generate


@inlined
def hit_boxes_plain(nodes: Any, base: Int, ray: SlabRay, t_max: Float, keys: Any) -> Int:
    """:func:`hit_boxes_vector`, one box after the other."""
    mask = np.int32(0)
    for i in range(WIDTH):
        entry, leave = ZERO, INFINITY
        for origin, inverse, near, rows in (
            (ray.ox, ray.ix, ray.near_x, UPPER),
            (ray.oy, ray.iy, ray.near_y, UPPER + 2 * WIDTH),
            (ray.oz, ray.iz, ray.near_z, UPPER + 4 * WIDTH),
        ):
            first = (nodes[base + near + i] - origin) * inverse
            last = (nodes[base + rows - near + i] - origin) * inverse
            entry = first if first > entry else entry
            leave = last if last < leave else leave
        leave = leave * SLACK
        leave = leave if leave < t_max else t_max
        keys[i] = (np.int64(bits_of(entry)) << 32) | (np.int64(load_int32(nodes, base + CHILDREN + i)) & 0xFFFFFFFF)
        if entry <= leave:
            mask |= np.int32(1 << i)
    return mask


hit_boxes = hit_boxes_vector if vectorised() else hit_boxes_plain
