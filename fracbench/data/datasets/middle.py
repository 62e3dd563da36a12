"""A flow that is given halfway between the frames, carried to frame 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Largest change of the fixed point in its last iteration, pixels, and the largest number of iterations.
_CHANGE, _ITERATIONS = 1e-4, 100


def at_frame0(flow: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a flow of the middle between the frames as the flow of frame 0.

    A particle at x in frame 0 is at ``x + u/2`` in the middle, where the given flow is m: ``u(x) = m(x + u/2)``,
    solved by fixed-point iteration, which contracts where m changes by less than 2 pixels a pixel.

    Parameters
    ----------
    flow : ndarray, shape (2, H, W)
        m, pixels: frame 0 at ``x - m/2`` matches frame 1 at ``x + m/2``. NaN where it is unknown.

    Returns
    -------
    ndarray, shape (2, H, W), float32
        u, by cubic interpolation: frame 0 at x matches frame 1 at ``x + u``. NaN where ``x + u/2`` is outside the
        frame, where m is unknown there or next to it, and where the iteration does not converge.
    """
    from scipy.ndimage import distance_transform_edt, map_coordinates

    unknown = ~np.isfinite(flow).all(axis=0)
    known = flow.astype(np.float64)
    if unknown.any():  # a hole filled by its surroundings hardly bends the splines beside it
        rows, columns = distance_transform_edt(unknown, return_distances=False, return_indices=True)
        known = known[:, rows, columns]
    grid = np.indices(known.shape[1:]).astype(np.float64)
    found = known
    for _ in range(_ITERATIONS):
        at = grid + 0.5 * found[::-1]
        before, found = found, np.stack([map_coordinates(plane, at, order=3, mode="nearest") for plane in known])
        moving = np.abs(found - before).max(axis=0) > _CHANGE
        if not moving.any():
            break
    last = np.array(known.shape[1:]).reshape(2, 1, 1) - 1
    outside = ((at < 0) | (at > last)).any(axis=0)
    beside = map_coordinates(unknown.astype(np.float64), at, order=1, mode="nearest") > 1e-6
    return np.where(outside | beside | moving, np.nan, found).astype(np.float32)
