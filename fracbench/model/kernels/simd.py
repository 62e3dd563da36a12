"""Eight numbers side by side: what the transforms compute with, one number for each of eight lines.

`load` reads eight neighbours of a row of an array, ``+``, ``-`` and ``*`` act on all of them at once, `store`
writes them back. Compiled, they are one or two registers of the processor; a plain loop over array elements
is not, because nothing tells the compiler that its arrays do not overlap. Where compilation is turned off
(``NUMBA_DISABLE_JIT=1``) they are NumPy arrays of eight.
"""

from __future__ import annotations

import operator
from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir
from numba.core import cgutils, config, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 8
#: Eight numbers.
Lanes: TypeAlias = Any
# a * b + c may be rounded once instead of twice, as in every compiled loop of the model
_FLAGS = ("contract", "nsz")


class LanesType(types.Type):
    """Numba's type of eight floats of one precision."""

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
    """Return where eight numbers of an image stand, or, without a column, a row of a workspace."""
    plane = context.make_array(array_type)(context, builder, array)
    if column is None:
        offset = builder.mul(row, context.get_constant(types.intp, LANES))
    else:
        offset = builder.add(builder.mul(row, builder.extract_value(plane.shape, 1)), column)
    return builder.bitcast(builder.gep(plane.data, [offset]), _vector(array_type.dtype).as_pointer())


@intrinsic
def _load_row(typingctx: Any, work: Any, row: Any) -> Any:
    if not _is_plane(work):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, sig.args[0], *args)
        return builder.load(pointer, align=sig.args[0].dtype.bitwidth // 8)

    return LanesType(work.dtype)(work, types.intp), codegen


@intrinsic
def _store_row(typingctx: Any, work: Any, row: Any, value: Any) -> Any:
    if not (_is_plane(work) and isinstance(value, LanesType) and value.dtype == work.dtype):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, sig.args[0], *args[:2])
        builder.store(args[2], pointer, align=sig.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(work, types.intp, value), codegen


@intrinsic
def _load(typingctx: Any, array: Any, row: Any, column: Any) -> Any:
    if not _is_plane(array):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, sig.args[0], *args)
        return builder.load(pointer, align=sig.args[0].dtype.bitwidth // 8)

    return LanesType(array.dtype)(array, types.intp, types.intp), codegen


@intrinsic
def _store(typingctx: Any, array: Any, row: Any, column: Any, value: Any) -> Any:
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
def _transpose(typingctx: Any, rows: Any) -> Any:
    if not (isinstance(rows, types.UniTuple) and rows.count == LANES and isinstance(rows.dtype, LanesType)):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        values = cgutils.unpack_tuple(builder, args[0], LANES)
        for width in (1, 2, 4):
            for k in range(LANES):
                if not k & width:
                    values[k], values[k + width] = _interleave(builder, values[k], values[k + width], width)
        return context.make_tuple(builder, sig.return_type, values)

    return rows(rows), codegen


class _Arithmetic(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        if len(args) == 2 and args[0] == args[1] and isinstance(args[0], LanesType):
            return signature(args[0], *args)
        return None


class _Product(_Arithmetic):
    def generic(self, args: Any, kws: Any) -> Any:
        if len(args) == 2 and isinstance(args[1], LanesType) and args[0] == args[1].dtype:
            return signature(args[1], *args)
        return super().generic(args, kws)


for _operator, _template in ((operator.add, _Arithmetic), (operator.sub, _Arithmetic), (operator.mul, _Product)):
    infer_global(_operator)(type(f"Lanes_{_operator.__name__}", (_template,), {"key": _operator}))


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


def _load_slowly(array: Any, row: int, column: int) -> Any:
    return array[row, column : column + LANES].copy()


def _store_slowly(array: Any, row: int, column: int, value: Any) -> None:
    array[row, column : column + LANES] = value


def _transpose_slowly(rows: Any) -> Any:
    return tuple(np.array(rows).T)


_SLOWLY: bool = config.DISABLE_JIT  # type: ignore[attr-defined]


def _load_row_slowly(work: Any, row: int) -> Any:
    return work[row].copy()


def _store_row_slowly(work: Any, row: int, value: Any) -> None:
    work[row] = value


load_row: Any = _load_row_slowly if _SLOWLY else _load_row
store_row: Any = _store_row_slowly if _SLOWLY else _store_row
load: Any = _load_slowly if _SLOWLY else _load
store: Any = _store_slowly if _SLOWLY else _store
transpose: Any = _transpose_slowly if _SLOWLY else _transpose
