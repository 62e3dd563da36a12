"""Eight numbers side by side, which the transforms compute with: one number for each of eight lines.

`load` reads eight neighbours of a row of an array, ``+``, ``-`` and ``*`` act on all of them at once, and `store`
writes them back. Compiled, they are vectors (`kernels.vector_type`): a plain loop over array elements is not
vectorised, because the compiler cannot know that its arrays do not overlap. Where compilation is turned off
(``NUMBA_DISABLE_JIT=1``) they are NumPy arrays of eight.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import config

LANES = 8
#: Eight numbers.
Lanes: TypeAlias = Any

load: Any
store: Any
load_row: Any
store_row: Any
transpose: Any


def _load_row(work: Any, row: int) -> Any:
    return work[row].copy()


def _store_row(work: Any, row: int, value: Any) -> None:
    work[row] = value


def _load(array: Any, row: int, column: int) -> Any:
    return array[row, column : column + LANES].copy()


def _store(array: Any, row: int, column: int, value: Any) -> None:
    array[row, column : column + LANES] = value


def _transpose(rows: Any) -> Any:
    return tuple(np.array(rows).T)


load, store, load_row, store_row, transpose = _load, _store, _load_row, _store_row, _transpose
#: Whether the transforms of `kernels` can be used; else the operators take SciPy's and dense products.
AVAILABLE = True
if not config.DISABLE_JIT:  # type: ignore[attr-defined]
    try:
        from fracbench.model.kernels import vector_type
    except (ImportError, AttributeError, TypeError):  # another numba, whose extension interface has changed
        AVAILABLE = False
    else:
        load, store, transpose = vector_type.load, vector_type.store, vector_type.transpose
        load_row, store_row = vector_type.load_row, vector_type.store_row
