"""Four channels of a cell at a time."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fovden.jit import Float, Int, inlined, vectorised
from fovden.simd import FLOATS, Builder, Lanes, Value, load, splat

LANES = 4
"""Channels that are packed together."""

FOUR_FLOATS, FOUR_DOUBLES = types.UniTuple(types.float32, LANES), types.UniTuple(types.float64, LANES)


def _cell(builder: Builder, cells: Value, number: Value) -> Lanes:
    return load(builder, cells, builder.mul(number, ir.Constant(number.type, LANES)), LANES, align=4)


def _packed(builder: Builder, numbers: Value) -> Lanes:
    values = cgutils.unpack_tuple(builder, numbers)
    vector = ir.Constant(ir.VectorType(values[0].type, LANES), ir.Undefined)
    for lane, value in enumerate(values):
        vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), lane))
    return Lanes(builder, vector)


def _unpacked(target: Any, builder: Builder, signature: Any, lanes: Lanes) -> Value:
    values = [builder.extract_element(lanes.value, ir.Constant(ir.IntType(32), lane)) for lane in range(LANES)]
    return target.make_tuple(builder, signature.return_type, values)


@intrinsic
def _with_cell(context: Any, cells: Any, number: Any, weight: Any, sums: Any) -> Any:
    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        cells, number, weight, sums = arguments
        share = _cell(builder, cells, number) * splat(builder, weight, LANES)
        return _unpacked(target, builder, signature, _packed(builder, sums) + share)

    return FOUR_FLOATS(FLOATS, types.int64, types.float32, FOUR_FLOATS), generate


@inlined
def with_cell_plain(cells: Any, number: Int, weight: Float, sums: Any) -> Any:
    """Four float32 sums, and a cell times its weight."""
    k = LANES * number
    return (
        sums[0] + weight * cells[k],
        sums[1] + weight * cells[k + 1],
        sums[2] + weight * cells[k + 2],
        sums[3] + weight * cells[k + 3],
    )


@intrinsic
def _with_cell_exactly(context: Any, cells: Any, number: Any, weight: Any, sums: Any) -> Any:
    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        cells, number, weight, sums = arguments
        vector = ir.VectorType(ir.DoubleType(), LANES)
        cell = Lanes(builder, builder.fpext(_cell(builder, cells, number).value, vector))
        return _unpacked(
            target, builder, signature, _packed(builder, sums) + cell * splat(builder, weight, LANES)
        )  # fmt: skip

    return FOUR_DOUBLES(FLOATS, types.int64, types.float64, FOUR_DOUBLES), generate


@inlined
def with_cell_exactly_plain(cells: Any, number: Int, weight: Float, sums: Any) -> Any:
    """Four float64 sums, and a cell times its weight."""
    return with_cell_plain(cells, number, weight, sums)


@intrinsic
def _add_to_cell(context: Any, cells: Any, number: Any, weight: Any, values: Any) -> Any:
    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        cells, number, weight, values = arguments
        total = _cell(builder, cells, number) + _packed(builder, values) * splat(builder, weight, LANES)
        place = builder.gep(cells, [builder.mul(number, ir.Constant(number.type, LANES))])
        builder.store(total.value, builder.bitcast(place, total.value.type.as_pointer()), align=4)
        return target.get_dummy_value()

    return types.none(FLOATS, types.int64, types.float32, FOUR_FLOATS), generate


@inlined
def add_to_cell_plain(cells: Any, number: Int, weight: Float, values: Any) -> None:
    """Adds four float32 numbers times a weight to a cell."""
    k = LANES * number
    cells[k] += weight * values[0]
    cells[k + 1] += weight * values[1]
    cells[k + 2] += weight * values[2]
    cells[k + 3] += weight * values[3]


if vectorised():
    with_cell, with_cell_exactly, add_to_cell = _with_cell, _with_cell_exactly, _add_to_cell
else:
    with_cell, with_cell_exactly, add_to_cell = with_cell_plain, with_cell_exactly_plain, add_to_cell_plain
