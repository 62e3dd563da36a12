"""Forward differences without flux through the border, and their adjoint, row by row: for Algorithm 3."""

from __future__ import annotations

import numpy as np

from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.jit import jit


@jit
def differentiate_row(u: Array, i: int, d: Array) -> None:
    """Write the x-differences of row `i` of `u` and the y-differences of the row above to `d`, (1, 2, H, W).

    Row H, one below the image, writes the y-differences of the last row, which are 0.
    """
    height, width = u.shape
    if i < height:
        for j in range(width - 1):
            d[0, 0, i, j] = u[i, j + 1] - u[i, j]
        d[0, 0, i, width - 1] = 0.0
    if i == height:
        d[0, 1, i - 1] = 0.0
    elif i > 0:
        for j in range(width):
            d[0, 1, i - 1, j] = u[i, j] - u[i - 1, j]


@jit
def right_hand_side_row(v: Array, w: Array, theta: float, mu: float, i: int, out: Array) -> None:
    """Write row `i` of ``v/theta + mu D^T w`` to `out`, (W,), D^T being minus the divergence."""
    height, width = v.shape
    direct, penalty = v.dtype.type(1.0 / theta), v.dtype.type(mu)  # or all would be computed in float64
    out[0] = 0.0
    for j in range(1, width):
        out[j] = w[0, 0, i, j - 1]
    for j in range(width - 1):
        out[j] -= w[0, 0, i, j]
    if i > 0:
        for j in range(width):
            out[j] += w[0, 1, i - 1, j]
    if i < height - 1:
        for j in range(width):
            out[j] -= w[0, 1, i, j]
    for j in range(width):
        out[j] = direct * v[i, j] + penalty * out[j]


@jit
def differences(u: Array, d: Array) -> None:
    """Write the forward differences of `u`, (H, W), 0 across the border, to `d`, (1, 2, H, W)."""
    for i in range(len(u) + 1):
        differentiate_row(u, i, d)


@jit
def right_hand_side(v: Array, w: Array, theta: float, mu: float, out: Array) -> None:
    """Write ``v/theta + mu D^T w`` to `out`, (H, W); see `right_hand_side_row`."""
    for i in range(len(v)):
        right_hand_side_row(v, w, theta, mu, i, out[i])


def column_pivots(direct: Float64Array, mu: float, height: int, dtype: np.dtype | type) -> Array:
    """Factorise the columns' tridiagonal systems ``direct(j) + mu Ny``: the u-step once x is transformed.

    Return the inverse pivots row by row until they are constant, and last those of the last row.
    """
    if height == 1:
        return (1.0 / direct[None]).astype(dtype)
    pivots, change = [1.0 / (direct + mu)], True
    while change and len(pivots) < height - 1:
        pivots.append(1.0 / (direct + 2.0 * mu - mu**2 * pivots[-1]))
        change = not np.array_equal(pivots[-1], pivots[-2])
    pivots.append(1.0 / (direct + mu - mu**2 * pivots[-1]))
    return np.array(pivots, dtype)


@jit
def solve_columns(x: Array, mu: float, inverse: Array, start: int, stop: int) -> None:
    """Solve the columns ``start..stop-1`` by elimination from the first row to the last, and back."""
    penalty, last, settled = x.dtype.type(mu), len(x) - 1, len(inverse) - 2
    # slices from `start`, as a loop whose index begins there is not vectorised
    for i in range(last + 1):
        here, above = x[i][start:stop], x[max(i - 1, 0)][start:stop]
        one_over = inverse[settled + 1 if i == last else min(i, settled)][start:stop]
        into = penalty if i > 0 else x.dtype.type(0.0)
        for j in range(stop - start):
            here[j] = one_over[j] * (here[j] + into * above[j])
    for i in range(last - 1, -1, -1):
        here, below = x[i][start:stop], x[i + 1][start:stop]
        one_over = inverse[min(i, settled)][start:stop]
        for j in range(stop - start):
            here[j] += penalty * one_over[j] * below[j]
