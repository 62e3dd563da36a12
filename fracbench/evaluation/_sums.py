"""The sums behind `fracbench.evaluation.metrics.flow_errors`: compiled passes over the pixels, all in float64."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracbench.model.kernels.jit import jit

_NOT_SCORED = -1.0


def error_sums(
    flow: NDArray[Any], truth: NDArray[Any], wanted: NDArray[np.bool_], unknown_above: float
) -> tuple[int, int, int, float, float, float]:
    """Count the pixels of a mask and sum their errors.

    Returns the counts of `FlowErrors`, and three sums over the scored pixels: of the angular errors, of their
    squared deviations from their mean, and of the end-point errors.
    """
    cross, dot, lengths = np.empty((3, *wanted.shape))
    _compare(flow, truth, cross, dot, lengths)
    angles = np.arctan2(cross, dot, out=cross)  # NumPy's is many times as fast as the one that loops compile to
    return _sums(flow, truth, wanted, unknown_above, angles, lengths)


@jit
def _sums(
    flow: NDArray[Any],
    truth: NDArray[Any],
    wanted: NDArray[np.bool_],
    unknown_above: float,
    angles: NDArray[np.float64],
    lengths: NDArray[np.float64],
) -> tuple[int, int, int, float, float, float]:
    """Compute the sums of `error_sums` from the errors of all pixels; angles of other pixels are overwritten."""
    height, width = wanted.shape
    n_pixels, n_unknown, n_nonfinite = 0, 0, 0
    total, distances = 0.0, 0.0
    for i in range(height):
        for j in range(width):
            known = abs(truth[0, i, j]) <= unknown_above and abs(truth[1, i, j]) <= unknown_above
            if wanted[i, j] and known:
                n_pixels += 1
                n_nonfinite += not (abs(flow[0, i, j]) < math.inf and abs(flow[1, i, j]) < math.inf)
                total += angles[i, j]
                distances += lengths[i, j]
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
def _compare(
    flow: NDArray[Any],
    truth: NDArray[Any],
    cross: NDArray[np.float64],
    dot: NDArray[np.float64],
    lengths: NDArray[np.float64],
) -> None:
    """Write the products whose quotient is the angle's tangent, and the end-point errors."""
    height, width = lengths.shape
    for i in range(height):
        for j in range(width):
            u1, u2 = np.float64(flow[0, i, j]), np.float64(flow[1, i, j])
            g1, g2 = np.float64(truth[0, i, j]), np.float64(truth[1, i, j])
            # The estimate is scaled, which leaves the angle as it is, so that a diverged flow does not overflow.
            largest = abs(u1) if abs(u1) > abs(u2) else abs(u2)
            scale = largest if largest > 1.0 else 1.0
            shrunk = 1.0 / scale
            d1, d2 = (u1 - g1) * shrunk, (u2 - g2) * shrunk
            across = d1 * g2 - d2 * g1
            apart = d1 * d1 + d2 * d2
            cross[i, j] = math.sqrt(apart + across * across)
            dot[i, j] = (u1 * shrunk) * g1 + (u2 * shrunk) * g2 + shrunk
            lengths[i, j] = scale * math.sqrt(apart)
