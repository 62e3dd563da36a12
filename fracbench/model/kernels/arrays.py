"""The array types of the model, and how its large arrays are made."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

#: A real array in the precision of the computation (float32 or float64).
Array: TypeAlias = npt.NDArray[np.floating[Any]]
Float64Array: TypeAlias = npt.NDArray[np.float64]

#: Bytes of a line of the cache.
_LINE = 64


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike) -> Array:
    """Return zeros that begin with a line of the cache.

    The columns of an image are transformed sixteen at a time (`kernels.cosine`), in float32 a line of
    the cache wide: where NumPy's own arrays begin, they would lie across two.

    Parameters
    ----------
    shape : tuple of int
        Shape.
    dtype : dtype-like
        float32 or float64.

    Returns
    -------
    ndarray
        C-contiguous.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    room = np.zeros(size + _LINE, np.uint8)
    start = -room.__array_interface__["data"][0] % _LINE
    return room[start : start + size].view(dtype).reshape(shape)
