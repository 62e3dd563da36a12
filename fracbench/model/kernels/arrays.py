"""The array types of the model, and aligned allocation."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

#: A real array in the precision of the computation (float32 or float64).
Array: TypeAlias = npt.NDArray[np.floating[Any]]
Float64Array: TypeAlias = npt.NDArray[np.float64]

#: Bytes of a cache line.
_LINE = 64


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike) -> Array:
    """Return a C-contiguous array of zeros aligned to a cache line.

    The columns of an image are transformed sixteen at a time (`kernels.cosine`), which is one cache line in
    float32. NumPy's own arrays are not aligned to cache lines, so that each access would touch two.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    room = np.zeros(size + _LINE, np.uint8)
    start = -room.__array_interface__["data"][0] % _LINE
    return room[start : start + size].view(dtype).reshape(shape)
