"""Solvers of the u-step: ``(1/theta + mu (Ny (x) I + I (x) Nx)) u = rhs`` (fractional Euler-Lagrange equation).

``Ny`` and ``Nx`` are the normal operators along the two axes, ``mu = lambda_sb``. The system is symmetric
positive definite. Solved exactly it is a division in the eigenbasis of the gradient operator
(`fracbench.model.gradient`); the sweeps here are the paper's way, with its misprints corrected.
"""

from __future__ import annotations

import numpy as np

from fracbench.model._jit import jit
from fracbench.model.arrays import Array, Float64Array
from fracbench.model.gradient import GradientOperator


def inverse_eigenvalues(operator: GradientOperator, theta: float, mu: float) -> Array:
    """Return ``1 / (1/theta + mu (ly_i + lx_j))``, the inverse of the u-system in the operator's basis.

    Parameters
    ----------
    operator : GradientOperator
        The gradient.
    theta, mu : float
        Tightness and split Bregman parameter.

    Returns
    -------
    ndarray, shape (H, W)
        In the operator's precision.
    """
    ly, lx = operator.eigenvalues()
    return (1.0 / (1.0 / theta + mu * (ly[:, None] + lx[None, :]))).astype(operator.dtype)


def jacobi_sweep(u: Array, rhs: Array, ny: Float64Array, nx: Float64Array, theta: float, mu: float) -> Array:
    """Return the next iterate of the fixed point that Algorithm 4 prints, with its signs corrected.

    Parameters
    ----------
    u : ndarray, shape (H, W)
        Current iterate.
    rhs : ndarray, shape (H, W)
        ``v/theta + mu D^T (d - b)``.
    ny, nx : ndarray, shapes (H, H) and (W, W)
        Normal operators along the axes.
    theta, mu : float
        Tightness and split Bregman parameter.

    Returns
    -------
    ndarray, shape (H, W)
        Where the spectral radius exceeds 1 (errata, item 3), repeated sweeps diverge.
    """
    normal_diagonal = np.add.outer(np.diag(ny), np.diag(nx))
    off_diagonal = ny @ u + u @ nx - normal_diagonal * u
    next_u: Array = (rhs - mu * off_diagonal) / (1.0 / theta + mu * normal_diagonal)
    return next_u


@jit
def gauss_seidel_natural(u: Array, rhs: Array, theta: float, mu: float) -> None:
    """Sweep once over the pixels in raster order, 5-point stencil without flux (Algorithm 3); `u` is updated.

    Parameters
    ----------
    u : ndarray, shape (H, W)
        Current iterate, overwritten.
    rhs : ndarray, shape (H, W)
        ``v/theta + mu D^T (d - b)``.
    theta, mu : float
        Tightness and split Bregman parameter.
    """
    height, width = u.shape
    for i in range(height):
        for j in range(width):
            neighbours = 0.0
            count = 0
            if i > 0:
                neighbours += u[i - 1, j]
                count += 1
            if i < height - 1:
                neighbours += u[i + 1, j]
                count += 1
            if j > 0:
                neighbours += u[i, j - 1]
                count += 1
            if j < width - 1:
                neighbours += u[i, j + 1]
                count += 1
            u[i, j] = (rhs[i, j] + mu * neighbours) / (1.0 / theta + mu * count)


@jit
def gauss_seidel_dense(u: Array, rhs: Array, ny: Float64Array, nx: Float64Array, theta: float, mu: float) -> None:
    """Sweep once over the pixels in raster order with dense normal operators (Algorithm 4, corrected).

    The off-diagonal sums are subtracted, as the Euler-Lagrange equation asks. All pixels of a row share
    the sum over the other rows, because no other row changes while the sweep is in this one.

    Parameters
    ----------
    u : ndarray, shape (H, W)
        Current iterate, overwritten.
    rhs : ndarray, shape (H, W)
        ``v/theta + mu D^T (d - b)``.
    ny, nx : ndarray, shapes (H, H) and (W, W), float64
        Normal operators along the axes.
    theta, mu : float
        Tightness and split Bregman parameter.
    """
    height, width = u.shape
    others = np.empty(width)
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
            diagonal = 1.0 / theta + mu * (ny[i, i] + nx[j, j])
            u[i, j] = (rhs[i, j] - mu * (others[j] + row_sum)) / diagonal


@jit
def gauss_seidel_literal(u: Array, rhs: Array, weights: Float64Array, theta: float, mu: float) -> None:
    """Sweep as `gauss_seidel_dense` does, by the double sums that Algorithm 4 prints (signs corrected).

    The twin that the speed of the others is measured against: the cost of a sweep grows with
    ``H W (H^2 + W^2)``.

    Parameters
    ----------
    u : ndarray, shape (H, W)
        Current iterate, overwritten.
    rhs : ndarray, shape (H, W)
        ``v/theta + mu D^T (d - b)``.
    weights : ndarray, shape (max(H, W),), float64
        Gruenwald-Letnikov weights.
    theta, mu : float
        Tightness and split Bregman parameter.
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
