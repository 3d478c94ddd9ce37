"""The vector layer: LLVM vectors with Python's operators, for the few operations that decide the speed.

Numba's loops over eight lanes do not become vector instructions inside a branchy traversal. Such operations are
written as intrinsics on :class:`Lanes`, so that they read like their formulas. No product is fused into a sum but by
:func:`fused`, whose results only ever bound something.

Every intrinsic has a twin in plain Numba: its oracle in the tests, and its replacement where the environment variable
``FOVDEN_SIMD`` is ``0``.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import RequireLiteralValue
from numba.extending import intrinsic

__all__ = [
    "Lanes",
    "advanced",
    "bits_of",
    "fused",
    "load",
    "load_int32",
    "maximum",
    "minimum",
    "pointer_to",
    "prefetch",
    "splat",
    "stack_doubles",
    "stack_floats",
    "stack_int32",
    "stack_words",
    "store",
    "store_int32",
    "trailing_zeros",
]

F32, I32, I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
FLOATS, WORDS = types.CPointer(types.float32), types.CPointer(types.int64)
Value = Any
Builder = Any


def sketch() -> tuple[Builder, Lanes]:
    """A builder of a function that nobody runs, and eight ones in it: for the examples."""
    signature = ir.FunctionType(ir.VoidType(), [F32.as_pointer()])
    builder = ir.IRBuilder(ir.Function(ir.Module(), signature, "sketch").append_basic_block())
    return builder, splat(builder, ir.Constant(F32, 1.0), 8)


class Lanes:
    """A vector inside an intrinsic: ``width`` float32 numbers, or the mask that a comparison of such makes.

    Args:
        builder: The LLVM builder that emits the operations.
        value: The LLVM vector.

    Example:
        >>> _, one = sketch()
        >>> str((one + one * one).value.type)
        '<8 x float>'
    """

    __slots__ = ("builder", "value")

    def __init__(self, builder: Builder, value: Value) -> None:
        self.builder, self.value = builder, value

    @property
    def width(self) -> int:
        """Number of lanes."""
        return int(self.value.type.count)

    def _emit(self, operation: str, *operands: Lanes | float) -> Lanes:
        values = [x.value if isinstance(x, Lanes) else self._constant(x) for x in operands]
        return Lanes(self.builder, getattr(self.builder, operation)(*values))

    def _constant(self, number: float) -> Value:
        return ir.Constant(self.value.type, [number] * self.width)

    def __add__(self, other: Lanes | float) -> Lanes:
        return self._emit("fadd", self, other)

    def __sub__(self, other: Lanes | float) -> Lanes:
        return self._emit("fsub", self, other)

    def __mul__(self, other: Lanes | float) -> Lanes:
        return self._emit("fmul", self, other)

    def __truediv__(self, other: Lanes | float) -> Lanes:
        return self._emit("fdiv", self, other)

    def _compare(self, relation: str, other: Lanes | float) -> Lanes:
        right = other.value if isinstance(other, Lanes) else self._constant(other)
        return Lanes(self.builder, self.builder.fcmp_ordered(relation, self.value, right))

    def __lt__(self, other: Lanes | float) -> Lanes:
        return self._compare("<", other)

    def __le__(self, other: Lanes | float) -> Lanes:
        return self._compare("<=", other)

    def __gt__(self, other: Lanes | float) -> Lanes:
        return self._compare(">", other)

    def __ge__(self, other: Lanes | float) -> Lanes:
        return self._compare(">=", other)

    def __and__(self, other: Lanes) -> Lanes:
        return self._emit("and_", self, other)

    def __or__(self, other: Lanes) -> Lanes:
        return self._emit("or_", self, other)

    def select(self, if_true: Lanes, if_false: Lanes) -> Lanes:
        """Returns, lane by lane, the first value where this mask is set and the second elsewhere.

        Example:
            >>> _, one = sketch()
            >>> (one < 2.0).select(one, one + one).width
            8
        """
        return self._emit("select", self, if_true, if_false)

    def bits(self) -> Value:
        """Returns a mask as an int32 scalar whose bit i is lane i.

        Example:
            >>> _, one = sketch()
            >>> str((one < 2.0).bits().type)
            'i32'
        """
        return self.builder.zext(self.builder.bitcast(self.value, ir.IntType(self.width)), I32)


def _repeated(vector: Value, number: int) -> Value:
    return ir.Constant(vector, [number] * vector.count)


def minimum(a: Lanes, b: Lanes) -> Lanes:
    """Returns the smaller numbers; where either is NaN, those of ``b``.

    Example:
        >>> _, one = sketch()
        >>> minimum(one, one).width
        8
    """
    return (a < b).select(a, b)


def maximum(a: Lanes, b: Lanes) -> Lanes:
    """Returns the larger numbers; where either is NaN, those of ``b``.

    Example:
        >>> _, one = sketch()
        >>> maximum(one, one).width
        8
    """
    return (a > b).select(a, b)


def fused(a: Lanes, b: Lanes, c: Lanes) -> Lanes:
    """Returns a * b + c, rounded once where the processor can do that and twice where it cannot.

    Example:
        >>> _, one = sketch()
        >>> fused(one, one, one).width
        8
    """
    kind = a.value.type
    name, signature = f"llvm.fmuladd.v{a.width}f32", ir.FunctionType(kind, [kind] * 3)
    function = cgutils.get_or_insert_function(a.builder.module, signature, name)
    return Lanes(a.builder, a.builder.call(function, [a.value, b.value, c.value]))


def splat(builder: Builder, number: Value, width: int) -> Lanes:
    """Returns a vector whose lanes all hold the scalar.

    Example:
        >>> builder, _ = sketch()
        >>> splat(builder, ir.Constant(F32, 1.0), 16).width
        16
    """
    empty = ir.Constant(ir.VectorType(number.type, width), ir.Undefined)
    first = builder.insert_element(empty, number, ir.Constant(I32, 0))
    return Lanes(builder, builder.shuffle_vector(first, empty, _repeated(ir.VectorType(I32, width), 0)))


def load(
    builder: Builder, pointer: Value, offset: Value | int, width: int, element: Value = F32, align: int = 0
) -> Lanes:
    """Returns consecutive numbers from memory.

    Args:
        builder: The LLVM builder.
        pointer: Pointer to float32.
        offset: Distance in elements.
        width: Number of lanes.
        element: Type to read them as: float32 or int32.
        align: Bytes to which their place is aligned; 0 for the vector's size.

    Returns:
        The vector.

    Example:
        >>> builder, _ = sketch()
        >>> load(builder, builder.function.args[0], 8, 8).width
        8
    """
    place = builder.gep(pointer, [ir.Constant(I64, offset) if isinstance(offset, int) else offset])
    place = builder.bitcast(place, ir.VectorType(element, width).as_pointer())
    return Lanes(builder, builder.load(place, align=align or 4 * width))


def store(builder: Builder, lanes: Lanes, pointer: Value, offset: int = 0) -> None:
    """Writes a vector to memory that is aligned to its size.

    Args:
        builder: The LLVM builder.
        lanes: What to write.
        pointer: Pointer to elements of the vector's kind.
        offset: Distance in elements.

    Example:
        >>> builder, one = sketch()
        >>> store(builder, one, builder.function.args[0])
    """
    place = builder.gep(pointer, [ir.Constant(I64, offset)])
    place = builder.bitcast(place, lanes.value.type.as_pointer())
    builder.store(lanes.value, place, align=lanes.width * (8 if lanes.value.type.element == I64 else 4))


# Scalar intrinsics: what Numba's language lacks.


@intrinsic
def pointer_to(context: Any, array: Any) -> Any:
    """Returns a pointer to an array's first element: one word to pass on where an array is seven.

    Example:
        >>> from numba import njit
        >>> import numpy as np
        >>> njit(lambda array: pointer_to(array)[1])(np.array([1.0, 2.0]))
        2.0
    """

    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        return target.make_array(signature.args[0])(target, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), generate


@intrinsic
def advanced(context: Any, pointer: Any, count: Any) -> Any:
    """Returns a pointer a number of elements further on.

    Example:
        >>> from numba import njit
        >>> import numpy as np
        >>> njit(lambda array: advanced(pointer_to(array), 1)[0])(np.array([1.0, 2.0]))
        2.0
    """

    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        return builder.gep(arguments[0], [arguments[1]])

    return pointer(pointer, types.int64), generate


@intrinsic
def prefetch(context: Any, pointer: Any, offset: Any) -> Any:
    """Asks the processor to bring the cache line of an element near; it changes nothing, and returns zero.

    Example:
        >>> from numba import njit
        >>> import numpy as np
        >>> njit(lambda array: prefetch(pointer_to(array), 1))(np.array([1.0, 2.0]))
        0
    """

    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        byte = ir.IntType(8).as_pointer()
        place = builder.bitcast(builder.gep(arguments[0], [arguments[1]]), byte)
        hint = builder.module.declare_intrinsic(
            "llvm.prefetch", [byte], ir.FunctionType(ir.VoidType(), [byte, *[I32] * 3])
        )
        # For reading, into all caches, data.
        builder.call(hint, [place, *(ir.Constant(I32, number) for number in (0, 3, 1))])
        return ir.Constant(I32, 0)

    return types.int32(pointer, types.int64), generate


def _stack(numba_type: Any, llvm_type: Any) -> Any:
    @intrinsic
    def stack(context: Any, count: Any) -> Any:
        if not isinstance(count, types.IntegerLiteral):
            raise RequireLiteralValue("count")
        size = count.literal_value

        def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
            # In the entry block: an alloca inside a loop would eat the stack.
            place = cgutils.alloca_once(builder, ir.ArrayType(llvm_type, size))
            place.align = 64
            return builder.bitcast(place, llvm_type.as_pointer())

        return types.CPointer(numba_type)(count), generate

    return stack


stack_doubles = _stack(types.float64, ir.DoubleType())
"""``stack_doubles(n)``: n float64 on the stack, aligned to 64 bytes; n is a literal."""

stack_floats = _stack(types.float32, F32)
"""``stack_floats(n)``: n float32 on the stack, aligned to 64 bytes; n is a literal."""

stack_words = _stack(types.int64, I64)
"""``stack_words(n)``: n int64 on the stack, aligned to 64 bytes; n is a literal."""

stack_int32 = _stack(types.int32, I32)
"""``stack_int32(n)``: n int32 on the stack, aligned to 64 bytes; n is a literal."""


@intrinsic
def trailing_zeros(context: Any, number: Any) -> Any:
    """Returns the number of zero bits below the lowest set bit of an int32 that is not zero.

    Example:
        >>> from numba import njit
        >>> import numpy as np
        >>> njit(lambda mask: trailing_zeros(mask))(np.int32(8))
        3
    """

    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int32(types.int32), generate


@intrinsic
def bits_of(context: Any, number: Any) -> Any:
    """Returns the bits of a float32 as an int32.

    Example:
        >>> from numba import njit
        >>> import numpy as np
        >>> hex(njit(lambda number: bits_of(number))(np.float32(1.0)))
        '0x3f800000'
    """

    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        return builder.bitcast(arguments[0], I32)

    return types.int32(types.float32), generate


@intrinsic
def load_int32(context: Any, pointer: Any, offset: Any) -> Any:
    """Returns the int32 at a float32 pointer plus an offset in elements.

    Example:
        >>> from numba import njit
        >>> import numpy as np
        >>> njit(lambda array: load_int32(pointer_to(array), 0))(np.array([7], np.int32).view(np.float32))
        7
    """

    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        place = builder.bitcast(builder.gep(arguments[0], [arguments[1]]), I32.as_pointer())
        return builder.load(place)

    return types.int32(FLOATS, types.int64), generate


@intrinsic
def store_int32(context: Any, pointer: Any, offset: Any, number: Any) -> Any:
    """Writes an int32 at a float32 pointer plus an offset in elements; returns it.

    Example:
        >>> from numba import njit
        >>> import numpy as np
        >>> njit(lambda array: store_int32(pointer_to(array), 0, 7))(np.zeros(1, np.float32))
        7
    """

    def generate(target: Any, builder: Builder, signature: Any, arguments: Any) -> Value:
        pointer, offset, number = arguments
        builder.store(number, builder.bitcast(builder.gep(pointer, [offset]), I32.as_pointer()))
        return number

    return types.int32(FLOATS, types.int64, types.int32), generate
