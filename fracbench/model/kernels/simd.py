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
from numpy.typing import NDArray

from fracbench.model.kernels.arrays import Array

LANES = 8
#: Eight numbers.
Lanes: TypeAlias = Any
#: Whether the transforms of `kernels` can be used; else the operators take SciPy's and dense products.
AVAILABLE = True


def load(array: Array, row: int, column: int) -> Lanes:
    """Read eight neighbours of an image's row."""
    return array[row, column : column + LANES].copy()


def store(array: Array, row: int, column: int, value: Lanes) -> None:
    """Write eight neighbours of an image's row."""
    array[row, column : column + LANES] = value


def load_complex(work: Array, row: int) -> tuple[Lanes, Lanes]:
    """Read row `row` of a workspace: its rows ``2 row`` and ``2 row + 1`` are the real and the imaginary part."""
    return work[2 * row].copy(), work[2 * row + 1].copy()


def store_complex(work: Array, row: int, x: Lanes, y: Lanes) -> None:
    """Write row `row` of a workspace."""
    work[2 * row], work[2 * row + 1] = x, y


def gather_square(image: Array, first: int, j: int, rows: NDArray[np.intp], work: Array, part: int) -> None:
    """Copy the columns ``j..j+7`` of eight rows of `image` to the rows ``2 rows[j] + part`` of `work`."""
    work[2 * rows[j : j + LANES] + part] = image[first : first + LANES, j : j + LANES].T


def scatter_square(work: Array, rows: NDArray[np.intp], part: int, image: Array, first: int, j: int) -> None:
    """Undo `gather_square`."""
    image[first : first + LANES, j : j + LANES] = work[2 * rows[j : j + LANES] + part].T


if not config.DISABLE_JIT:  # type: ignore[attr-defined]
    try:
        from fracbench.model.kernels import vector_type
    except (ImportError, AttributeError, TypeError):  # another numba, whose extension interface has changed
        AVAILABLE = False
    else:
        for name in ("load", "store", "load_complex", "store_complex", "gather_square", "scatter_square"):
            globals()[name] = getattr(vector_type, name)
