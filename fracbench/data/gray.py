"""Any picture as one plane of gray levels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.errors import InputError


def to_gray(image: Any, name: str = "frame", *, nan: bool = False) -> NDArray[np.floating[Any]]:
    """Turn a gray or colour picture into one plane of gray levels.

    Integer colour gives ``floor(0.299 R + 0.587 G + 0.114 B)`` in exact integer arithmetic, which is
    Middlebury's own gray at every pixel; floating-point colour gives the same weights without the floor.

    Parameters
    ----------
    image : array_like of a real dtype
        ``(H, W)``, ``(H, W, 1)``, ``(H, W, 3)`` or ``(H, W, 4)``, at least 2 x 2 pixels. A fourth channel
        (alpha) is ignored. Gray levels are kept as they are, whatever their range. Never changed.
    name : str, optional
        What messages call the picture.
    nan : bool, optional
        Accept pixels that are NaN, in a picture of floating type; they stay NaN.

    Returns
    -------
    ndarray of float32 or float64, (H, W)
        A new, C-contiguous array; float32 for integers of up to 16 bits, which it holds exactly.
    """
    planes = _planes(_real_array(image, name), name)
    _require_finite(planes, name, nan)
    dtype = np.float32 if planes.dtype.kind in "iub" and planes.dtype.itemsize <= 2 else np.float64
    if planes.shape[2] == 1:
        return np.array(planes[..., 0], dtype=dtype, order="C")
    if np.issubdtype(planes.dtype, np.integer):
        r, g, b = np.moveaxis(planes.astype(np.int64), 2, 0)
        return np.asarray((299 * r + 587 * g + 114 * b) // 1000, dtype=dtype)
    r, g, b = np.moveaxis(planes.astype(np.float64), 2, 0)
    return np.asarray(0.299 * r + 0.587 * g + 0.114 * b)


def _real_array(image: Any, name: str) -> NDArray[Any]:
    try:
        array = np.asarray(image)
    except ValueError as exc:  # nested lists of unequal lengths
        raise InputError(f"{name}: not an array of pixels ({exc})") from exc
    if not (array.dtype == np.bool_ or np.issubdtype(array.dtype, np.integer) or _is_float(array)):
        raise InputError(f"{name}: dtype {array.dtype} cannot be used; a real dtype is needed")
    return array


def _is_float(array: NDArray[Any]) -> bool:
    return bool(np.issubdtype(array.dtype, np.floating))


def _planes(array: NDArray[Any], name: str) -> NDArray[Any]:
    """Return the colour planes as (H, W, 1) or (H, W, 3), alpha dropped."""
    shape = array.shape
    if array.ndim == 2:
        array = array[..., np.newaxis]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4):
        raise InputError(
            f"{name}: shape {shape} is not a picture; allowed: (H, W), (H, W, 1), (H, W, 3), (H, W, 4)"
        )
    if min(array.shape[:2]) < 2:
        raise InputError(f"{name}: {shape[0]} x {shape[1]} pixels are too few; at least 2 x 2 are needed")
    return array[..., :3]


def _require_finite(planes: NDArray[Any], name: str, nan: bool) -> None:
    if not _is_float(planes):
        return
    bad = np.isinf(planes).any(axis=2) if nan else ~np.isfinite(planes).all(axis=2)
    if bad.any():
        row, col = np.argwhere(bad)[0]
        raise InputError(
            f"{name}: {int(bad.sum())} of {bad.size} pixels are {'infinite' if nan else 'NaN or infinite'}, "
            f"the first at row {row}, column {col}"
        )
