"""The sums behind `fracbench.evaluation.metrics.flow_errors`: one pass over the pixels, all in float64."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.model._jit import jit

_NOT_SCORED = -1.0


@jit
def error_sums(
    flow: NDArray[Any], truth: NDArray[Any], wanted: NDArray[np.bool_], unknown_above: float
) -> tuple[int, int, int, float, float, float]:
    """Count the pixels of a mask and sum their errors.

    Parameters
    ----------
    flow, truth : ndarray, shape (2, H, W)
        The estimate and the true flow, which is unknown where a component is NaN or above `unknown_above`.
    wanted : ndarray of bool, shape (H, W)
        The mask.
    unknown_above : float
        See `truth`.

    Returns
    -------
    n_pixels, n_unknown, n_nonfinite : int
        See `FlowErrors`.
    angles, squares, distances : float
        Sums over the scored pixels: of the angular errors, of their squared deviations from their mean, and
        of the end-point errors.
    """
    height, width = wanted.shape
    angles, lengths = np.empty((height, width)), np.empty(width)
    n_pixels, n_unknown, n_nonfinite = 0, 0, 0
    total, distances = 0.0, 0.0
    for i in range(height):
        _errors(flow[0, i], flow[1, i], truth[0, i], truth[1, i], angles[i], lengths)
        for j in range(width):
            known = abs(truth[0, i, j]) <= unknown_above and abs(truth[1, i, j]) <= unknown_above
            if wanted[i, j] and known:
                n_pixels += 1
                n_nonfinite += not (abs(flow[0, i, j]) < math.inf and abs(flow[1, i, j]) < math.inf)
                total += angles[i, j]
                distances += lengths[j]
            else:
                n_unknown += wanted[i, j]
                angles[i, j] = _NOT_SCORED
    mean, squares = total / max(1, n_pixels), 0.0
    for i in range(height):
        for j in range(width):
            deviation = angles[i, j] - mean
            squares += 0.0 if angles[i, j] == _NOT_SCORED else deviation * deviation
    return n_pixels, n_unknown, n_nonfinite, total, squares, distances


@jit
def _errors(
    flow1: NDArray[Any],
    flow2: NDArray[Any],
    truth1: NDArray[Any],
    truth2: NDArray[Any],
    angles: NDArray[np.float64],
    lengths: NDArray[np.float64],
) -> None:
    """Write the angular and the end-point errors of a row."""
    for j in range(angles.size):
        u1, u2 = np.float64(flow1[j]), np.float64(flow2[j])
        g1, g2 = np.float64(truth1[j]), np.float64(truth2[j])
        # The estimate is scaled, which leaves the angle as it is, so that a diverged flow does not overflow.
        largest = abs(u1) if abs(u1) > abs(u2) else abs(u2)
        scale = largest if largest > 1.0 else 1.0
        shrunk = 1.0 / scale
        d1, d2 = (u1 - g1) * shrunk, (u2 - g2) * shrunk
        across = d1 * g2 - d2 * g1
        apart = d1 * d1 + d2 * d2
        angles[j] = math.atan2(
            math.sqrt(apart + across * across), (u1 * shrunk) * g1 + (u2 * shrunk) * g2 + shrunk
        )
        lengths[j] = scale * math.sqrt(apart)
