"""Convergence of the solvers of the u-step: spectral radii, sweeps to a tolerance, and a closed-form limit.

The system is that of `fracbench.model.sweeps`, ``A = 1/theta + mu (Ny (x) I + I (x) Nx)``, with d and b held.
Radii are found without forming A, by Krylov iterations on the sweep itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize
import scipy.sparse.linalg

from fracbench.errors import unknown_name
from fracbench.harness.run.point import Point
from fracbench.model.kernels.arrays import Array, Float64Array
from fracbench.model.operators.zero import left_derivative_matrix
from fracbench.model.sweeps import gauss_seidel_dense, jacobi_sweep

SWEEPS = ("jacobi", "gauss_seidel")
#: A relative residual this large counts as divergence.
_LOST = 1e6
_PRECISION = 1e-4


def jacobi_limit(theta: float, mu: float) -> float:
    r"""Return the order in (1, 2] above which the printed fixed point diverges on a large image, or infinity.

    There the eigenvalues of ``T^T T`` fill ``[0, 4^alpha]`` and its diagonal is ``s(alpha) = sum w_k^2 =
    Gamma(1 + 2 alpha) / Gamma(1 + alpha)^2``, so that Jacobi's spectral radius exceeds 1 where
    ``4^alpha - 2 s(alpha) > 1 / (2 mu theta)`` (docs/errata.md, item 3).
    """

    def excess(alpha: float) -> float:
        diagonal = math.gamma(1.0 + 2.0 * alpha) / math.gamma(1.0 + alpha) ** 2
        return 4.0**alpha - 2.0 * diagonal - 0.5 / (mu * theta)

    if excess(2.0) < 0.0:
        return math.inf
    return float(scipy.optimize.brentq(excess, 1.0, 2.0, xtol=1e-12))


def spectral_radius(sweep: str, ny: Float64Array, nx: Float64Array, theta: float, mu: float) -> float:
    """Return the factor by which a sweep shrinks the error in the long run, to 1e-4; above 1 it diverges."""
    shape = (len(ny), len(nx))
    start = np.random.default_rng(0).normal(size=shape)
    step = _sweeper(sweep, ny, nx, theta, mu)
    nothing = np.zeros(shape)
    if not step(start, nothing).any():
        return 0.0  # a diagonal system: one sweep solves it, and there is no space to iterate in
    size = start.size
    iteration = scipy.sparse.linalg.LinearOperator(
        (size, size), dtype=np.float64, matvec=lambda x: step(x.reshape(shape), nothing).ravel()
    )
    found = scipy.sparse.linalg.eigs(
        iteration, k=1, which="LM", v0=start.ravel(), tol=_PRECISION, return_eigenvectors=False
    )
    return float(np.abs(found[0]))


def sweeps_needed(
    sweep: str,
    ny: Float64Array,
    nx: Float64Array,
    theta: float,
    mu: float,
    v: Float64Array,
    *,
    tol: float = 1e-6,
    limit: int = 1000,
) -> int | None:
    """Count the sweeps that solve ``A u = v / theta`` from ``u = v``, where Algorithm 4 starts.

    `tol` is the norm of the residual relative to that of the right-hand side. None: it diverges, or more than
    `limit` sweeps are needed.
    """
    step = _sweeper(sweep, ny, nx, theta, mu)
    rhs: Array = v / theta
    u: Array = v.copy()
    whole = float(np.linalg.norm(rhs))
    for count in range(1, limit + 1):
        u = step(u, rhs)
        residual = float(np.linalg.norm(rhs - u / theta - mu * (ny @ u + u @ nx))) / whole
        if residual <= tol:
            return count
        if not residual < _LOST:
            return None
    return None


def spectrum(point: Point, folder: Path | None) -> dict[str, Any]:
    """Return both sweeps' radius, and their count to a tolerance from noise, on the system of a square image.

    The point's region is the square; its options are `tol` and `limit`.
    """
    assert point.region is not None
    params, size = point.params, point.region.shape[0]
    v = np.random.default_rng(0).normal(size=(size, size))
    t = left_derivative_matrix(params.alpha, size)
    normal = t.T @ t
    found: dict[str, Any] = {}
    for sweep in SWEEPS:
        system = (sweep, normal, normal, params.theta, params.lambda_sb)
        # The radius is found to four digits: more would only differ from machine to machine.
        found[f"{sweep} radius"] = float(f"{spectral_radius(*system):.4g}")
        found[f"{sweep} sweeps"] = sweeps_needed(*system, v, **dict(point.options))
    return found


def _sweeper(
    sweep: str, ny: Float64Array, nx: Float64Array, theta: float, mu: float
) -> Callable[[Array, Array], Array]:
    """Return ``step(u, rhs)``, which gives the next iterate and leaves `u` as it is."""

    def gauss_seidel(u: Array, rhs: Array) -> Array:
        after = u.copy()
        gauss_seidel_dense(after, rhs, ny, nx, theta, mu)
        return after

    def jacobi(u: Array, rhs: Array) -> Array:
        return jacobi_sweep(u, rhs, ny, nx, theta, mu)

    if sweep not in SWEEPS:
        raise unknown_name("sweep", sweep, SWEEPS)
    return jacobi if sweep == "jacobi" else gauss_seidel
