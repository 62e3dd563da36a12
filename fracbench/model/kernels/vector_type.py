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


def _address(context: Any, builder: Any, array_type: Any, array: Any, row: Any, column: Any = None) -> Any:
    """Return the address of eight neighbours in a row of an image or, without a column, of a workspace's row."""
    plane = context.make_array(array_type)(context, builder, array)
    if column is None:
        offset = builder.mul(row, context.get_constant(types.intp, LANES))
    else:
        offset = builder.add(builder.mul(row, builder.extract_value(plane.shape, 1)), column)
    return builder.bitcast(builder.gep(plane.data, [offset]), _vector(array_type.dtype).as_pointer())


def _load(context: Any, builder: Any, array_type: Any, *at: Any) -> Any:
    return builder.load(_address(context, builder, array_type, *at), align=array_type.dtype.bitwidth // 8)


def _store(context: Any, builder: Any, array_type: Any, value: Any, *at: Any) -> Any:
    builder.store(value, _address(context, builder, array_type, *at), align=array_type.dtype.bitwidth // 8)
    return context.get_dummy_value()


@intrinsic
def load(typingctx: Any, array: Any, row: Any, column: Any) -> Any:
    """Read eight neighbours of an image's row."""
    if not _is_plane(array):
        return None

    signature = LanesType(array.dtype)(array, types.intp, types.intp)
    return signature, lambda context, builder, sig, args: _load(context, builder, sig.args[0], *args)


@intrinsic
def store(typingctx: Any, array: Any, row: Any, column: Any, value: Any) -> Any:
    """Write eight neighbours of an image's row."""
    if not (_is_plane(array) and isinstance(value, LanesType) and value.dtype == array.dtype):
        return None

    signature = types.void(array, types.intp, types.intp, value)
    return signature, lambda context, builder, sig, args: _store(context, builder, sig.args[0], args[3], *args[:3])


@intrinsic
def load_complex(typingctx: Any, work: Any, row: Any) -> Any:
    """Read the real and the imaginary part of a workspace's row."""
    if not _is_plane(work):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        parts = [_load(context, builder, sig.args[0], args[0], at) for at in _parts(context, builder, args[1])]
        return context.make_tuple(builder, sig.return_type, parts)

    return types.UniTuple(LanesType(work.dtype), 2)(work, types.intp), codegen


@intrinsic
def store_complex(typingctx: Any, work: Any, row: Any, x: Any, y: Any) -> Any:
    """Write the real and the imaginary part of a workspace's row."""
    if not (_is_plane(work) and isinstance(x, LanesType) and x == y and x.dtype == work.dtype):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        for at, value in zip(_parts(context, builder, args[1]), args[2:], strict=True):
            _store(context, builder, sig.args[0], value, args[0], at)
        return context.get_dummy_value()

    return types.void(work, types.intp, x, y), codegen


def _parts(context: Any, builder: Any, row: Any) -> tuple[Any, Any]:
    twice = builder.mul(row, context.get_constant(types.intp, 2))
    return twice, builder.add(twice, context.get_constant(types.intp, 1))


@intrinsic
def gather_square(typingctx: Any, image: Any, first: Any, j: Any, rows: Any, work: Any, part: Any) -> Any:
    """Copy the columns ``j..j+7`` of eight rows of an image to the rows ``2 rows[j] + part`` of a workspace."""
    if not (_is_plane(image) and _is_plane(work) and image.dtype == work.dtype):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        image, first, j, rows, work, part = args
        lines = [_load(context, builder, sig.args[0], image, at, j) for at in _eight(context, builder, first)]
        into = _workspace_rows(context, builder, sig.args[3], rows, j, part)
        for value, at in zip(_transposed(builder, lines), into, strict=True):
            _store(context, builder, sig.args[4], value, work, at)
        return context.get_dummy_value()

    return types.void(image, types.intp, types.intp, rows, work, types.intp), codegen


@intrinsic
def scatter_square(typingctx: Any, work: Any, rows: Any, part: Any, image: Any, first: Any, j: Any) -> Any:
    """Undo `gather_square`."""
    if not (_is_plane(image) and _is_plane(work) and image.dtype == work.dtype):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        work, rows, part, image, first, j = args
        out_of = _workspace_rows(context, builder, sig.args[1], rows, j, part)
        lines = _transposed(builder, [_load(context, builder, sig.args[0], work, at) for at in out_of])
        for value, at in zip(lines, _eight(context, builder, first), strict=True):
            _store(context, builder, sig.args[3], value, image, at, j)
        return context.get_dummy_value()

    return types.void(work, rows, types.intp, image, types.intp, types.intp), codegen


def _eight(context: Any, builder: Any, first: Any) -> list[Any]:
    return [builder.add(first, context.get_constant(types.intp, k)) for k in range(LANES)]


def _workspace_rows(context: Any, builder: Any, rows_type: Any, rows: Any, j: Any, part: Any) -> list[Any]:
    table = context.make_array(rows_type)(context, builder, rows).data
    two = context.get_constant(types.intp, 2)
    entries = [builder.load(builder.gep(table, [at])) for at in _eight(context, builder, j)]
    return [builder.add(builder.mul(entry, two), part) for entry in entries]


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Transpose eight vectors: exchange odd groups of 1, 2, 4 lanes of one with even groups of another."""
    values, lanes = list(rows), range(LANES)
    for width in (1, 2, 4):
        even = [k if not k & width else k - width + LANES for k in lanes]
        odd = [k + width if not k & width else k + LANES for k in lanes]
        masks = [ir.Constant(ir.VectorType(ir.IntType(32), LANES), mask) for mask in (even, odd)]
        for k in lanes:
            if not k & width:
                a, b = values[k], values[k + width]
                values[k], values[k + width] = (builder.shuffle_vector(a, b, mask) for mask in masks)
    return values


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


def _lower(instruction: str) -> Any:
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, instruction)(*args, flags=_FLAGS)

    return lower


for operation, instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    lower_builtin(operation, LanesType, LanesType)(_lower(instruction))


@lower_builtin(operator.mul, types.Float, LanesType)
def _scale(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    vector = _vector(sig.args[1].dtype)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), args[0], ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    every = builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), mask)
    return builder.fmul(every, args[1], flags=_FLAGS)
