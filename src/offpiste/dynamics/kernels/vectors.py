"""Vectors of numbers for Numba, which loops keep in registers; LLVM alone keeps what it sums in memory.

They load from and store to rows of lanes. With float32 numbers they mix as arrays do: `sums += weight * load(rows, i)`.
"""

import operator
from collections.abc import Callable, Iterable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv import Conversion  # type: ignore[attr-defined]
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

from offpiste.dynamics.kernels.layout import LANES
from offpiste.native.compilation import target_machine

WIDTH: Final = 32 if "+avx512f" in target_machine()[2] else 16
"""Numbers in a vector: four of these, and what is added to them, fit into the registers."""

GROUP: Final = 16
"""Lanes that `read_fours` reads at a time."""

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_VECTOR, _FOUR = ir.VectorType(_FLOAT, WIDTH), ir.VectorType(_FLOAT, 4)
_GROUP_INDEX: Final = ir.VectorType(_INT, GROUP)

Emitter = Callable[..., Any]
emitted: Callable[[Callable[..., Any]], Callable[..., Any]] = intrinsic
"""Numba's `intrinsic`: a function whose LLVM code is written by hand."""


class VectorType(types.Type):
    """Numba's type of a vector."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector({WIDTH})")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """A float32 stands for a vector of it."""
        return Conversion.promote if other == types.float32 else None


vector: Final = VectorType()


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, _VECTOR)  # type: ignore[no-untyped-call]


@lower_cast(types.float32, VectorType)  # type: ignore[no-untyped-call, untyped-decorator]
def _repeat(_context: Any, builder: ir.IRBuilder, _from: types.Type, _to: types.Type, number: ir.Value) -> ir.Value:
    nothing = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(nothing, number, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(_INT, WIDTH), [0] * WIDTH))


def _define(function: Callable[..., Any], emit: Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value]) -> None:
    """Let an operator take two vectors."""

    @infer_global(function)  # type: ignore[no-untyped-call]
    class _Takes(ConcreteTemplate):  # type: ignore[misc]
        cases = [signature(vector, vector, vector)]  # type: ignore[no-untyped-call]  # noqa: RUF012

    @lower_builtin(function, VectorType, VectorType)  # type: ignore[no-untyped-call, untyped-decorator]
    def _lower(_context: Any, builder: ir.IRBuilder, _signature: Any, values: tuple[ir.Value, ir.Value]) -> ir.Value:
        return emit(builder, *values)


_define(operator.add, ir.IRBuilder.fadd)
_define(operator.iadd, ir.IRBuilder.fadd)
_define(operator.sub, ir.IRBuilder.fsub)
_define(operator.mul, ir.IRBuilder.fmul)
_define(operator.truediv, ir.IRBuilder.fdiv)


@emitted
def clamp(_context: Any, numbers: types.Type, low: types.Type, high: types.Type) -> tuple[Any, Emitter]:
    """Numbers of a vector, moved into a range; NaN becomes one of its ends."""

    def emit(_context: Any, builder: ir.IRBuilder, _signature: Any, values: tuple[ir.Value, ...]) -> ir.Value:
        number, low, high = values
        number = builder.select(builder.fcmp_ordered(">", number, low), number, low)
        return builder.select(builder.fcmp_ordered("<", number, high), number, high)

    return vector(vector, vector, vector), emit


@emitted
def load(_context: Any, rows: types.Array, first: types.Integer) -> tuple[Any, Emitter]:
    """A vector from a flat float32 array, from a place on."""

    def emit(context: Any, builder: ir.IRBuilder, given: Any, values: tuple[ir.Value, ...]) -> ir.Value:
        rows, first = values
        return builder.load(_address(context, builder, given.args[0], rows, first, _VECTOR), align=4)

    return vector(rows, types.intp), emit


@emitted
def store(_context: Any, rows: types.Array, first: types.Integer, numbers: types.Type) -> tuple[Any, Emitter]:
    """A vector into a flat float32 array, from a place on."""

    def emit(context: Any, builder: ir.IRBuilder, given: Any, values: tuple[ir.Value, ...]) -> ir.Value:
        rows, first, numbers = values
        builder.store(numbers, _address(context, builder, given.args[0], rows, first, _VECTOR), align=4)
        return context.get_dummy_value()

    return types.none(rows, types.intp, vector), emit


def _address(
    context: Any, builder: ir.IRBuilder, kind: types.Array, array: ir.Value, first: ir.Value, read: ir.VectorType
) -> ir.Value:
    """Where a vector lies in an array; outside of it is an error where Numba checks bounds."""
    struct = context.make_array(kind)(context, builder, array)
    if context.enable_boundscheck:
        last = builder.add(first, ir.Constant(first.type, read.count - 1))
        (length,) = cgutils.unpack_tuple(builder, struct.shape)  # type: ignore[no-untyped-call]
        for place in (first, last):
            cgutils.do_boundscheck(context, builder, place, length)  # type: ignore[no-untyped-call]
    return builder.bitcast(builder.gep(struct.data, [first]), read.as_pointer())


@emitted
def read_fours(
    _context: Any,
    numbers: types.Array,
    index: types.Array,
    shift: types.Integer,
    outside: types.Array,
    rows: types.Array,
) -> tuple[Any, Emitter]:
    """Gather four numbers for each lane: rows[e * LANES + i] = numbers[index[i] + shift + e].

    Lanes whose index is negative take outside[shift + e]. One load a lane and a transpose; gathering instructions load
    number by number.

    Args:
        numbers, outside, rows: float32, flat.
        index: int32 [LANES].
    """

    def emit(context: Any, builder: ir.IRBuilder, given: Any, values: tuple[ir.Value, ...]) -> ir.Value:
        numbers, index, shift, outside, rows = values
        zero = ir.Constant(_INT, 0)

        def address(argument: int, array: ir.Value, first: ir.Value, kind: ir.Type) -> ir.Value:
            return _address(context, builder, given.args[argument], array, first, kind)

        def place(lane: int) -> ir.Value:
            return ir.Constant(shift.type, lane)

        def four(lane: int) -> ir.Value:
            first = builder.load(address(1, index, place(lane), ir.VectorType(_INT, 1)))
            first = builder.extract_element(first, zero)
            first = builder.select(builder.icmp_signed(">", first, zero), first, zero)
            first = builder.add(builder.sext(first, shift.type), shift)
            return builder.load(address(0, numbers, first, _FOUR), align=4)

        instead = builder.load(address(3, outside, shift, _FOUR), align=4)
        for lane in range(0, LANES, GROUP):
            indices = builder.load(address(1, index, place(lane), _GROUP_INDEX), align=4)
            inside = builder.icmp_signed(">=", indices, ir.Constant(_GROUP_INDEX, [0] * GROUP))
            for e, row in enumerate(_transposed(builder, [four(lane + i) for i in range(GROUP)])):
                other = _shuffled(builder, instead, instead, [e] * GROUP)
                row = builder.select(inside, row, other)
                builder.store(row, address(4, rows, place(e * LANES + lane), row.type), align=4)
        return context.get_dummy_value()

    return types.none(numbers, index, types.intp, outside, rows), emit


def _transposed(builder: ir.IRBuilder, fours: list[ir.Value]) -> list[ir.Value]:
    """Four vectors of `GROUP` numbers: the first of each four, the second, and so on; as processors shuffle."""

    def join(parts: list[ir.Value]) -> ir.Value:
        if len(parts) == 1:
            return parts[0]
        half = len(parts) // 2
        return _shuffled(builder, join(parts[:half]), join(parts[half:]), range(4 * len(parts)))

    def pick(a: ir.Value, b: ir.Value, *places: int) -> ir.Value:
        """Four numbers of each 16 bytes of two vectors; those of the second count from 4."""
        at = (4 * four + place % 4 + GROUP * (place // 4) for four in range(GROUP // 4) for place in places)
        return _shuffled(builder, a, b, at)

    a, b, c, d = (join(fours[i::4]) for i in range(4))
    ab_low, ab_high, cd_low, cd_high = (
        pick(*both, *places) for both in ((a, b), (c, d)) for places in ((0, 4, 1, 5), (2, 6, 3, 7))
    )
    halves = ((ab_low, cd_low), (ab_high, cd_high))
    return [pick(*both, *places) for both in halves for places in ((0, 1, 4, 5), (2, 3, 6, 7))]


def _shuffled(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, places: Iterable[int]) -> ir.Value:
    mask = list(places)
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INT, len(mask)), mask))
