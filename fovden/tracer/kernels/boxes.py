"""One ray against the eight boxes of a node (slab test).

The test never loses a triangle that ``triangles`` would hit. With u = 2^-24, o the origin, E the box's largest extent
and a vertex v, the sheared coordinate x - o_x - s (z - o_z) is off by 2 u |v_x - o_x| + 5 u |s (v_z - o_z)| at most. A
point p of the triangle that the rounded picture puts on the ray is thus up to 7 u (|p_x - o_x| + E) beside it. The part
with E is covered by ``build``, which enlarges boxes by 8 u E. The part with p is a relative error of 7 u in the
distance.

A bound b is met at (b - o) / d, computed as b i + a with i = 1 / d and a = -o i, fused or not. The roundings of i, a,
the product (if not fused), the sum and the numbers below leave a relative error of 3 u in the result, and an absolute
one of 5 u |a| at most: near distances get 8 u |a| less and far ones as much more, in ``a`` itself. Relative errors sum
up to 2 (7 + 3) u between near and far, for which far distances are enlarged by 32 u, also beforehand. (Ize, "Robust BVH
ray traversal", JCGT 2(2), 2013, has the roundings of the slabs alone; Woop et al., see ``triangles``, enlarge the boxes
for each ray.)

A component of the direction that is less than 2^-40 of the largest counts as that much: an error of 2^-16 u. Where the
numbers overflow, infinity - infinity = NaN is passed over by the order of the arguments of ``maximum`` and ``minimum``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from fovden.jit import Float, Int, inlined, vectorised
from fovden.simd import (
    F32,
    FLOATS,
    I32,
    I64,
    Lanes,
    fused,
    load,
    load_int32,
    maximum,
    minimum,
    splat,
    stack_floats,
    store,
    store_int32,
)
from fovden.tracer.kernels.layout import (
    CHILDREN,
    FAR,
    FAR_AT,
    LIMIT,
    NEAR,
    NEAR_AT,
    NEAR_ROWS,
    OCTANT,
    ORDERS,
    UPPER,
    WIDTH,
)

ZERO = np.float32(0.0)
BYTE, BYTES = ir.IntType(8), ir.VectorType(ir.IntType(8), WIDTH)
EIGHT = ir.VectorType(I32, WIDTH)


def number(builder: Any, ray: Any, place: int) -> Any:
    """A float32 of a ray, in all lanes."""
    return splat(builder, builder.load(builder.gep(ray, [ir.Constant(I64, place)])), WIDTH)


def integer(builder: Any, ray: Any, place: int) -> Any:
    """An int32 of a ray, as an int64."""
    pointer = builder.bitcast(builder.gep(ray, [ir.Constant(I64, place)]), I32.as_pointer())
    return builder.sext(builder.load(pointer), I64)


def _slabs(builder: Any, node: Any, ray: Any) -> tuple[Lanes, Lanes]:
    """Where the ray enters and leaves the eight boxes, not before its origin and not beyond its limit."""
    entry = splat(builder, ir.Constant(F32, 0.0), WIDTH)
    leave = number(builder, ray, LIMIT)
    for axis in range(3):
        near, near_at, far, far_at = (number(builder, ray, k + axis) for k in (NEAR, NEAR_AT, FAR, FAR_AT))
        row = integer(builder, ray, NEAR_ROWS + axis)
        other = builder.sub(ir.Constant(I64, UPPER + 2 * WIDTH * axis), row)
        entry = maximum(fused(load(builder, node, row, WIDTH), near, near_at), entry)
        leave = minimum(fused(load(builder, node, other, WIDTH), far, far_at), leave)
    return entry, leave


@intrinsic
def hit_boxes_vector(context: Any, nodes: Any, base: Any, ray: Any, distances: Any) -> Any:
    """Mask of the boxes of the node at ``base`` that the ray meets within its limit; writes all entry distances."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        nodes, base, ray, distances = arguments
        entry, leave = _slabs(builder, builder.gep(nodes, [base]), ray)
        store(builder, entry, distances)
        return (entry <= leave).bits()

    return types.int32(FLOATS, types.int64, FLOATS, FLOATS), generate


@intrinsic
def multiply_add(context: Any, a: Any, b: Any, c: Any) -> Any:
    """A * b + c of float32 numbers, rounded as :func:`fovden.simd.fused` does."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(F32, [F32] * 3)
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.fmuladd.f32"), arguments)

    return types.float32(types.float32, types.float32, types.float32), generate


@inlined
def entry_and_leave(nodes: Any, base: Int, ray: Any, lane: Int) -> tuple[Float, Float]:
    """Where a ray enters and leaves one box."""
    entry, leave = ZERO, ray[LIMIT]
    for axis in range(3):
        row = np.int64(load_int32(ray, NEAR_ROWS + axis))
        other = UPPER + 2 * WIDTH * axis - row
        first = multiply_add(nodes[base + row + lane], ray[NEAR + axis], ray[NEAR_AT + axis])
        last = multiply_add(nodes[base + other + lane], ray[FAR + axis], ray[FAR_AT + axis])
        entry = first if first > entry else entry
        leave = last if last < leave else leave
    return entry, leave


@inlined
def hit_boxes_plain(nodes: Any, base: Int, ray: Any, distances: Any) -> Int:
    """:func:`hit_boxes_vector`, one box after the other."""
    mask = np.int32(0)
    for lane in range(WIDTH):
        entry, leave = entry_and_leave(nodes, base, ray, lane)
        distances[lane] = entry
        if entry <= leave:
            mask |= np.int32(1 << lane)
    return mask


hit_boxes = hit_boxes_vector if vectorised() else hit_boxes_plain


# Stacks of distances and child codes that no branch decides about: for rays that are traced in turn (``streams``).


def has_permutation() -> bool:
    """Whether kernels are compiled for a processor that permutes eight lanes (AVX2)."""
    if config.CPU_NAME or config.CPU_FEATURES:
        return "+avx2" in (config.CPU_FEATURES or "").split(",")
    return bool(get_host_cpu_features().get("avx2", False))


def _permuted(lanes: Lanes, order: Any) -> Lanes:
    """Lane i of the result is the one that the lowest three bits of the order's lane i name."""
    kind, name = lanes.value.type, "permps" if lanes.value.type.element == F32 else "permd"
    signature = ir.FunctionType(kind, [kind, order.type])
    function = cgutils.get_or_insert_function(lanes.builder.module, signature, f"llvm.x86.avx2.{name}")
    return Lanes(lanes.builder, lanes.builder.call(function, [lanes.value, order]))


def _push(builder: Any, kept: Lanes, stacks: list[tuple[Lanes, Any]], top: Any) -> Any:
    """Writes the kept lanes side by side at ``top`` of their stacks, and something beyond; returns the new top."""
    name = "fovden_kept_lanes"
    if name not in builder.module.globals:
        table = bytearray()
        for mask in range(256):
            marked = [lane for lane in range(WIDTH) if mask >> lane & 1]
            table += bytes(marked + [0] * (WIDTH - len(marked)))
        cgutils.global_constant(builder.module, name, ir.Constant(ir.ArrayType(BYTE, len(table)), table)).align = 8
    bits = kept.bits()
    table = builder.bitcast(builder.module.globals[name], BYTES.as_pointer())
    order = builder.zext(builder.load(builder.gep(table, [builder.zext(bits, I64)]), align=8), EIGHT)
    for lanes, pointer in stacks:
        place = builder.bitcast(builder.gep(pointer, [top]), lanes.value.type.as_pointer())
        builder.store(_permuted(lanes, order).value, place, align=4)
    return builder.add(top, builder.zext(builder.ctpop(bits), I64))


@intrinsic
def push_nearest_vector(context: Any, nodes: Any, base: Any, ray: Any, distances: Any, stack: Any, top: Any) -> Any:
    """Puts the children of a node that a ray meets on its stack, the nearest, in its octant's order, on top.

    Called with the nodes, where the node begins, the ray, its stack's entry distances and child codes (int32), and the
    number of entries; returns the new number. Seven entries above the top are overwritten.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        nodes, base, ray, distances, stack, top = arguments
        node = builder.gep(nodes, [base])
        place = builder.gep(node, [builder.add(integer(builder, ray, OCTANT), ir.Constant(I64, ORDERS))])
        packed = splat(builder, builder.load(builder.bitcast(place, I32.as_pointer())), WIDTH).value
        order = builder.lshr(packed, ir.Constant(EIGHT, [4 * lane for lane in range(WIDTH)]))
        met = (*_slabs(builder, node, ray), load(builder, node, CHILDREN, WIDTH, I32))
        entry, leave, codes = (_permuted(lanes, order) for lanes in met)
        return _push(builder, entry <= leave, [(entry, distances), (codes, stack)], top)

    return types.int64(FLOATS, types.int64, FLOATS, FLOATS, FLOATS, types.int64), generate


@intrinsic
def push_likeliest_vector(context: Any, nodes: Any, base: Any, ray: Any, stack: Any, top: Any) -> Any:
    """The same for a stack of child codes alone, the last child on top."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        nodes, base, ray, stack, top = arguments
        node = builder.gep(nodes, [base])
        entry, leave = _slabs(builder, node, ray)
        return _push(builder, entry <= leave, [(load(builder, node, CHILDREN, WIDTH, I32), stack)], top)

    return types.int64(FLOATS, types.int64, FLOATS, FLOATS, types.int64), generate


@inlined
def push_nearest_plain(nodes: Any, base: Int, ray: Any, distances: Any, stack: Any, top: Int) -> Int:
    """:func:`push_nearest_vector`, one child after the other."""
    entries, order = stack_floats(WIDTH), load_int32(nodes, base + ORDERS + load_int32(ray, OCTANT))
    mask = hit_boxes(nodes, base, ray, entries)
    for place in range(WIDTH):
        lane = np.int64(order >> np.int32(4 * place)) & np.int64(7)
        if (mask >> np.int32(lane)) & np.int32(1):
            distances[top] = entries[lane]
            store_int32(stack, top, load_int32(nodes, base + CHILDREN + lane))
            top += 1
    return top


@inlined
def push_likeliest_plain(nodes: Any, base: Int, ray: Any, stack: Any, top: Int) -> Int:
    """:func:`push_likeliest_vector`, one child after the other."""
    mask = hit_boxes(nodes, base, ray, stack_floats(WIDTH))
    for lane in range(WIDTH):
        if (mask >> np.int32(lane)) & np.int32(1):
            store_int32(stack, top, load_int32(nodes, base + CHILDREN + lane))
            top += 1
    return top


@intrinsic
def drop_far_vector(context: Any, distances: Any, stack: Any, first: Any, top: Any, end: Any, limit: Any) -> Any:
    """Moves those of the eight stack entries from ``first`` on that lie below ``end`` and within the limit to ``top``.

    Returns:
        The number of entries up to there. Seven entries above are overwritten.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        distances, stack, first, top, end, limit = arguments
        entry = load(builder, distances, first, WIDTH, align=4)
        codes = load(builder, stack, first, WIDTH, I32, align=4)
        rest = splat(builder, builder.trunc(builder.sub(end, first), I32), WIDTH).value
        used = Lanes(builder, builder.icmp_signed("<", ir.Constant(EIGHT, list(range(WIDTH))), rest))
        kept = (entry <= splat(builder, limit, WIDTH)) & used
        return _push(builder, kept, [(entry, distances), (codes, stack)], top)

    return types.int64(FLOATS, FLOATS, types.int64, types.int64, types.int64, types.float32), generate


@inlined
def drop_far_plain(distances: Any, stack: Any, first: Int, top: Int, end: Int, limit: Float) -> Int:
    """:func:`drop_far_vector`, one entry after the other."""
    for place in range(first, min(first + WIDTH, end)):
        if distances[place] <= limit:
            distances[top] = distances[place]
            store_int32(stack, top, load_int32(stack, place))
            top += 1
    return top


permutes = vectorised() and has_permutation()
push_nearest = push_nearest_vector if permutes else push_nearest_plain
push_likeliest = push_likeliest_vector if permutes else push_likeliest_plain
drop_far = drop_far_vector if permutes else drop_far_plain
