"""Sixteen pixels of a row at a time: reads, writes and copies, masked or not, and powers of two.

Under a mask, what lies outside a row, or outside the pixels that a pass works on, is neither read nor written: images
need no padding, and two threads may work on neighbouring pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fovden.jit import Float, inlined
from fovden.simd import F32, FLOATS, I32, I64, Builder, Lanes, Value, fused, load, splat

WIDTH = 16
"""Pixels of a block. Where a processor's vectors are shorter, LLVM takes two or four of them."""

SMALLEST_POWER = np.float32(-125.0)
"""Powers of two stop here, so that they stay normal float32 numbers: others slow a processor down."""

SHIFTER = np.float32(12582912.0)  # 1.5 * 2^23: adding it rounds to an integer, which is then in the lowest bits

EXP2 = tuple(map(np.float32, (1.0000001, 0.69314694, 0.2402212, 0.05550713, 0.00967554, 0.00132765)))
"""2^f for f in [-1/2, 1/2] by powers of f: the polynomial of least greatest relative error, 7.5e-8, rounded to float32
(1.5e-7)."""

ZERO = np.float32(0.0)
BYTE, WORD = ir.IntType(8), types.int64


@intrinsic
def opaque(context: Any, number: Any) -> Any:
    """The number, of which LLVM cannot tell how it came about.

    Of a loop whose body reads some hundred places, LLVM makes as many counters, keeps them on the stack, and counts all
    of them up each time. A counter that the body sees through this function stays the only one.
    """

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        same = ir.InlineAsm(ir.FunctionType(I64, [I64]), "", "=r,0")
        return builder.call(same, arguments)

    return types.int64(types.int64), generate


@intrinsic
def copy_floats(context: Any, source: Any, target: Any, count: Any) -> Any:
    """Copies numbers from one place to another."""

    def generate(backend: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, target, count = arguments
        cgutils.raw_memcpy(builder, target, source, count, 4)
        return backend.get_dummy_value()

    return types.none(FLOATS, FLOATS, types.int64), generate


def in_row(builder: Builder, x: Value, width: Value) -> Value:
    """Which of the pixels x, x + 1, ... lie in 0 .. width - 1, as a mask."""
    lanes = ir.Constant(ir.VectorType(I32, WIDTH), list(range(WIDTH)))
    first = splat(builder, builder.trunc(x, I32), WIDTH).value
    end = splat(builder, builder.trunc(width, I32), WIDTH).value
    return builder.icmp_unsigned("<", builder.add(first, lanes), end)


def have_label(builder: Builder, labels: Value, offset: Value, label: Value, mask: Value) -> Value:
    """Which of the pixels under the mask have the label, as a mask; labels are bytes."""
    kind = ir.VectorType(BYTE, WIDTH)
    found = _masked_load(builder, labels, offset, mask, kind, "i8")
    return builder.and_(
        mask, builder.icmp_unsigned("==", found, splat(builder, builder.trunc(label, BYTE), WIDTH).value)
    )


def masked_load(builder: Builder, pointer: Value, offset: Value, mask: Value) -> Lanes:
    """Sixteen numbers from any place of memory; 0 where the mask is not set, and nothing is read there."""
    return Lanes(builder, _masked_load(builder, pointer, offset, mask, ir.VectorType(F32, WIDTH), "f32"))


def _masked_load(builder: Builder, pointer: Value, offset: Value, mask: Value, kind: Value, element: str) -> Value:
    place = builder.bitcast(builder.gep(pointer, [offset]), kind.as_pointer())
    signature = ir.FunctionType(kind, [kind.as_pointer(), I32, mask.type, kind])
    name = f"llvm.masked.load.v{WIDTH}{element}.p0v{WIDTH}{element}"
    function = cgutils.get_or_insert_function(builder.module, signature, name)
    return builder.call(function, [place, ir.Constant(I32, 1), mask, ir.Constant(kind, [0] * WIDTH)])


def masked_store(builder: Builder, lanes: Lanes, pointer: Value, offset: Value, mask: Value) -> None:
    """Writes sixteen numbers to any place of memory, where the mask is set."""
    kind = lanes.value.type
    place = builder.bitcast(builder.gep(pointer, [offset]), kind.as_pointer())
    signature = ir.FunctionType(ir.VoidType(), [kind, kind.as_pointer(), I32, mask.type])
    name = f"llvm.masked.store.v{WIDTH}f32.p0v{WIDTH}f32"
    function = cgutils.get_or_insert_function(builder.module, signature, name)
    builder.call(function, [lanes.value, place, ir.Constant(I32, 4), mask])


def read(builder: Builder, pointer: Value, place: Value, plane: Value, channels: int = 3) -> list[Lanes]:
    """Sixteen pixels of some channels that lie ``plane`` apart, from any place of memory."""
    places = [builder.add(place, builder.mul(plane, ir.Constant(I64, k))) for k in range(channels)]
    return [load(builder, pointer, each, WIDTH, align=4) for each in places]


def line_at(builder: Builder, pointer: Value, apart: Value, number: int) -> Value:
    """A pointer some lines further on."""
    return builder.gep(pointer, [builder.mul(apart, ir.Constant(I64, number))])


def number_at(builder: Builder, pointer: Value, index: int) -> Lanes:
    """A number of memory, in all lanes."""
    return splat(builder, builder.load(builder.gep(pointer, [ir.Constant(I64, index)])), WIDTH)


def exp2(x: Lanes) -> Lanes:
    """2^x for x up to 127; less than -125 is taken for that, and what is no number stays none."""
    return exp2_all([x])[0]


def exp2_all(xs: list[Lanes]) -> list[Lanes]:
    """:func:`exp2` of several, side by side: none waits for another, and each would wait for itself."""
    builder, kind, integers = xs[0].builder, xs[0].value.type, ir.VectorType(I32, WIDTH)

    def constant(number: Any) -> Lanes:
        return Lanes(builder, ir.Constant(kind, [float(number)] * WIDTH))

    floor, shifter = constant(SMALLEST_POWER), constant(SHIFTER)
    xs = [(x < float(SMALLEST_POWER)).select(floor, x) for x in xs]
    shifted = [x + shifter for x in xs]
    rounded = [each - shifter for each in shifted]
    fractions = [x - each for x, each in zip(xs, rounded, strict=True)]
    powers = [constant(EXP2[-1])] * len(xs)
    for coefficient in reversed(EXP2[:-1]):
        powers = [fused(power, f, constant(coefficient)) for power, f in zip(powers, fractions, strict=True)]
    twenty_three = ir.Constant(integers, [23] * WIDTH)
    exponents = [builder.shl(builder.bitcast(each.value, integers), twenty_three) for each in shifted]
    bits = [builder.add(builder.bitcast(p.value, integers), e) for p, e in zip(powers, exponents, strict=True)]
    return [Lanes(builder, builder.bitcast(each, kind)) for each in bits]


@inlined
def exp2_plain(x: Float) -> Float:
    """:func:`exp2` of one number."""
    return np.exp2(SMALLEST_POWER if x < SMALLEST_POWER else x)
