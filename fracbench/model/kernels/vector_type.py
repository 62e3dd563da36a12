"""A type of numba for a vector of eight floats, which LLVM keeps in one or two registers of the processor.

Written with numba's public extension interface (`numba.extending`) and the public builder of LLVM code,
`llvmlite.ir`. Numba does not promise to keep this interface; `kernels.simd` does without where it is missing.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES = 8
# a * b + c may be rounded once instead of twice, as in every compiled loop of the model.
_FLAGS = ("contract", "nsz")


class LanesType(types.Type):
    """Eight floats of one precision."""

    def __init__(self, dtype: types.Float) -> None:
        self.dtype = dtype
        super().__init__(name=f"Lanes({dtype})")


def _vector(dtype: types.Float) -> ir.VectorType:
    return ir.VectorType(ir.FloatType() if dtype.bitwidth == 32 else ir.DoubleType(), LANES)


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: LanesType) -> None:
        super().__init__(dmm, fe_type, _vector(fe_type.dtype))


def _is_plane(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 2 and array.layout == "C"


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, row: Any, column: Any = None) -> Any:
    """Return the address of eight neighbours in a row of an image or, without a column, of a workspace's row."""
    plane = context.make_array(array_type)(context, builder, array)
    if column is None:
        offset = builder.mul(row, context.get_constant(types.intp, LANES))
    else:
        offset = builder.add(builder.mul(row, builder.extract_value(plane.shape, 1)), column)
    return builder.bitcast(builder.gep(plane.data, [offset]), _vector(array_type.dtype).as_pointer())


@intrinsic
def load_row(typingctx: Any, work: Any, row: Any) -> Any:
    """Read row `row` of a workspace."""
    if not _is_plane(work):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, sig.args[0], *args)
        return builder.load(pointer, align=sig.args[0].dtype.bitwidth // 8)

    return LanesType(work.dtype)(work, types.intp), codegen


@intrinsic
def store_row(typingctx: Any, work: Any, row: Any, value: Any) -> Any:
    """Write row `row` of a workspace."""
    if not (_is_plane(work) and isinstance(value, LanesType) and value.dtype == work.dtype):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, sig.args[0], *args[:2])
        builder.store(args[2], pointer, align=sig.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(work, types.intp, value), codegen


@intrinsic
def load(typingctx: Any, array: Any, row: Any, column: Any) -> Any:
    """Read eight neighbours of an image's row."""
    if not _is_plane(array):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, sig.args[0], *args)
        return builder.load(pointer, align=sig.args[0].dtype.bitwidth // 8)

    return LanesType(array.dtype)(array, types.intp, types.intp), codegen


@intrinsic
def store(typingctx: Any, array: Any, row: Any, column: Any, value: Any) -> Any:
    """Write eight neighbours of an image's row."""
    if not (_is_plane(array) and isinstance(value, LanesType) and value.dtype == array.dtype):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, sig.args[0], *args[:3])
        builder.store(args[3], pointer, align=sig.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, value), codegen


def _interleave(builder: Any, a: Any, b: Any, width: int) -> tuple[Any, Any]:
    """Exchange the odd groups of `width` lanes of `a` with the even groups of `b`."""
    lanes = range(LANES)
    even = [k if not k & width else k - width + LANES for k in lanes]
    odd = [k + width if not k & width else k + LANES for k in lanes]
    masks = (ir.Constant(ir.VectorType(ir.IntType(32), LANES), mask) for mask in (even, odd))
    first, second = (builder.shuffle_vector(a, b, mask) for mask in masks)
    return first, second


@intrinsic
def transpose(typingctx: Any, rows: Any) -> Any:
    """Transpose eight vectors."""
    if not (isinstance(rows, types.UniTuple) and rows.count == LANES and isinstance(rows.dtype, LanesType)):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        values = [builder.extract_value(args[0], k) for k in range(LANES)]
        for width in (1, 2, 4):
            for k in range(LANES):
                if not k & width:
                    values[k], values[k + width] = _interleave(builder, values[k], values[k + width], width)
        return context.make_tuple(builder, sig.return_type, values)

    return rows(rows), codegen


def _type_sum(context: Any) -> Any:
    def typer(a: Any, b: Any) -> Any:
        return a if isinstance(a, LanesType) and a == b else None

    return typer


def _type_product(context: Any) -> Any:
    def typer(a: Any, b: Any) -> Any:
        return b if isinstance(b, LanesType) and a in (b, b.dtype) else None

    return typer


type_callable(operator.add)(_type_sum)
type_callable(operator.sub)(_type_sum)
type_callable(operator.mul)(_type_product)


@lower_builtin(operator.add, LanesType, LanesType)
def _add(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fadd(*args, flags=_FLAGS)


@lower_builtin(operator.sub, LanesType, LanesType)
def _subtract(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fsub(*args, flags=_FLAGS)


@lower_builtin(operator.mul, LanesType, LanesType)
def _multiply(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fmul(*args, flags=_FLAGS)


@lower_builtin(operator.mul, types.Float, LanesType)
def _scale(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    vector = _vector(sig.args[1].dtype)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), args[0], ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    every = builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), mask)
    return builder.fmul(every, args[1], flags=_FLAGS)
