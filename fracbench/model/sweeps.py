"""Sweeps for the u-step: ``(1/theta + mu (Ny (x) I + I (x) Nx)) u = rhs`` (fractional Euler-Lagrange equation).

``Ny``, (H, H), and ``Nx``, (W, W), are the normal operators along the axes in the precision of u,
``mu = lambda_sb`` and ``rhs = v/theta + mu D^T (d - b)``. The system is symmetric positive definite. The gradient
operators (`operators.base`) solve it exactly; these sweeps are the paper's way, with its misprints corrected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.kernels.forward_rows import (
    differences,
    differentiate_row,
    right_hand_side,
    right_hand_side_row,
)
from fracbench.model.kernels.jit import jit
from fracbench.model.params import FlowParams


def jacobi_sweep(u: Array, rhs: Array, ny: Array, nx: Array, theta: float, mu: float) -> Array:
    """Return the next iterate (H, W) of the fixed point that Algorithm 4 prints, with its signs corrected.

    Repeated sweeps diverge where the spectral radius exceeds 1 (errata, item 3).
    """
    next_u: Array = ny @ u
    _relax_jacobi(u, rhs, u @ nx, np.diag(ny), np.diag(nx), theta, mu, next_u)
    return next_u


@jit
def _relax_jacobi(
    u: Array, rhs: Array, along_x: Array, ny: Array, nx: Array, theta: float, mu: float, along_y: Array
) -> None:
    """Write the next iterate to `along_y`, ``Ny u``; `along_x` is ``u Nx``, `ny` and `nx` are the diagonals."""
    real = u.dtype.type  # or all would be computed in float64
    inverse, penalty = real(1.0 / theta), real(mu)
    for i in range(len(u)):
        for j in range(u.shape[1]):
            diagonal = ny[i] + nx[j]
            others = along_y[i, j] + along_x[i, j] - diagonal * u[i, j]
            along_y[i, j] = (rhs[i, j] - penalty * others) / (inverse + penalty * diagonal)


@jit
def _sweep_row(u: Array, row: Array, theta: float, mu: float, i: int) -> None:
    """Sweep over row `i`, whose right-hand side is `row`; it is overwritten.

    All neighbours but the left one are added beforehand, vectorised; only the left one makes a recurrence.
    """
    height, width = u.shape
    real = u.dtype.type  # or all would be computed in float64
    penalty = real(mu)
    if i > 0:
        for j in range(width):
            row[j] += penalty * u[i - 1, j]
    if i < height - 1:
        for j in range(width):
            row[j] += penalty * u[i + 1, j]
    for j in range(width - 1):
        row[j] += penalty * u[i, j + 1]
    above_and_below = int(i > 0) + int(i < height - 1)
    inside = real(1.0 / (1.0 / theta + mu * (above_and_below + 2)))
    end = real(1.0 / (1.0 / theta + mu * (above_and_below + min(1, width - 1))))
    left = u[i, 0] = row[0] * end
    for j in range(1, width - 1):
        row[j] *= inside
    for j in range(1, width - 1):  # the recurrence
        left = row[j] + penalty * inside * left
        u[i, j] = left
    if width > 1:
        u[i, width - 1] = (row[width - 1] + penalty * left) * end


@jit
def gauss_seidel_natural(u: Array, v: Array, w: Array, theta: float, mu: float) -> None:
    """Take the u-step of Algorithm 3: one sweep in raster order, 5-point stencil without flux, D u after it.

    The next iterate overwrites `u`, and its forward differences, 0 across the border, overwrite ``w = d - b``,
    (1, 2, H, W). The right-hand side is formed row by row as the sweep comes by.
    """
    row = np.empty(u.shape[1], u.dtype)
    for i in range(len(u)):
        right_hand_side_row(v, w, theta, mu, i, row)
        _sweep_row(u, row, theta, mu, i)
        differentiate_row(u, i, w)
    differentiate_row(u, len(u), w)


@dataclass(frozen=True)
class FivePoint:
    """The u-step of Algorithm 3 with another sweep than `gauss_seidel_natural`: number, order and border.

    `order` is ``raster``, ``backward`` or ``at_once``, `border` ``natural``, ``four_zero`` or ``four_repeat``.
    """

    sweeps: int
    order: str
    border: str

    def step(self, u: Array, v: Array, w: Array, theta: float, mu: float) -> None:
        """Sweep over `u`, (H, W); its forward differences overwrite ``w = d - b``, (1, 2, H, W)."""
        rhs = np.empty_like(v)
        right_hand_side(v, w, theta, mu, rhs)
        four, repeat = self.border != "natural", self.border == "four_repeat"
        turn = (slice(None, None, -1),) * 2 if self.order == "backward" else (slice(None),) * 2
        for _ in range(self.sweeps):
            old = u.copy() if self.order == "at_once" else u
            sweep_stencil(u[turn], old[turn], rhs[turn], theta, mu, four, repeat)
        differences(u, w)


def five_point_switches(params: FlowParams) -> FivePoint | None:
    """Return the sweep that `params` ask for, or None for the usual one."""
    order = "at_once" if params.u_solver == "jacobi" else params.sweep_order
    chosen = FivePoint(params.sweeps, order, params.stencil_border)
    if chosen == FivePoint(1, "at_once", "natural") and params.u_solver == "jacobi":
        return None
    return None if chosen == FivePoint(1, "raster", "natural") else chosen


@jit
def sweep_stencil(u: Array, old: Array, rhs: Array, theta: float, mu: float, four: bool, repeat: bool) -> None:
    """Replace each pixel of `u` by ``(rhs + mu sum of its neighbours) / (1/theta + mu number of them)``, in turn.

    Neighbours are those of `old`, which may be `u` itself (Gauss-Seidel). With `four` their number is 4 at the
    border too, as section 3.1 prints it; one outside is then the pixel's own old value if `repeat`, else 0.
    """
    height, width = u.shape
    real = u.dtype.type
    direct, penalty = real(1.0 / theta), real(mu)
    for i in range(height):
        for j in range(width):
            total, count = real(0.0), 0
            if i > 0:
                total += old[i - 1, j]
                count += 1
            if i < height - 1:
                total += old[i + 1, j]
                count += 1
            if j > 0:
                total += old[i, j - 1]
                count += 1
            if j < width - 1:
                total += old[i, j + 1]
                count += 1
            if four:
                if repeat:
                    total += (4 - count) * old[i, j]
                count = 4
            u[i, j] = (rhs[i, j] + penalty * total) / (direct + penalty * real(count))


@jit
def gauss_seidel_dense(u: Array, rhs: Array, ny: Array, nx: Array, theta: float, mu: float) -> None:
    """Sweep once over the pixels of `u` in raster order with dense normal operators (Algorithm 4, corrected).

    The off-diagonal sums are subtracted, in accordance with the Euler-Lagrange equation. All pixels of a row share
    the sum over the other rows, because no other row changes while the sweep is in this one.
    """
    height, width = u.shape
    real = u.dtype.type  # or all would be computed in float64
    inverse, penalty = real(1.0 / theta), real(mu)
    others = np.empty(width, u.dtype)
    for i in range(height):
        others[:] = 0.0
        for p in range(height):
            if p != i:
                for j in range(width):
                    others[j] += ny[i, p] * u[p, j]
        for j in range(width):
            row_sum = -nx[j, j] * u[i, j]
            for q in range(width):
                row_sum += nx[j, q] * u[i, q]
            diagonal = inverse + penalty * (ny[i, i] + nx[j, j])
            u[i, j] = (rhs[i, j] - penalty * (others[j] + row_sum)) / diagonal


@jit
def gauss_seidel_literal(u: Array, rhs: Array, weights: Float64Array, theta: float, mu: float) -> None:
    """Sweep as `gauss_seidel_dense` does, by the double sums that Algorithm 4 prints (signs corrected).

    This is the baseline of speed measurements: the cost of a sweep grows with ``H W (H^2 + W^2)``. There are
    max(H, W) Gruenwald-Letnikov `weights`.
    """
    height, width = u.shape
    for i in range(height):
        for j in range(width):
            others, squares = 0.0, 0.0
            for p in range(j, width):
                inner = 0.0
                for q in range(p + 1):
                    if q != j:
                        inner += weights[p - q] * u[i, q]
                others += weights[p - j] * inner
                squares += weights[p - j] ** 2
            for p in range(i, height):
                inner = 0.0
                for q in range(p + 1):
                    if q != i:
                        inner += weights[p - q] * u[q, j]
                others += weights[p - i] * inner
                squares += weights[p - i] ** 2
            u[i, j] = (rhs[i, j] - mu * others) / (1.0 / theta + mu * squares)
