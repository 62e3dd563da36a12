"""Spectral radii against dense matrices, counts of sweeps against their definition, the limit against both."""

from __future__ import annotations

import math

import numpy as np
import pytest
import reference_impl as ref

from fracbench.errors import InputError
from fracbench.model.operators.zero import ZeroGradient
from fracbench.studies.solvers.spectral_radius import SWEEPS, jacobi_limit, spectral_radius, sweeps_needed

PAIRS = [(0.3, 5.0), (0.7, 1.0), (0.8, 10.0)]


def normals(alpha, shape):
    return ZeroGradient(alpha, shape, np.float64).normal_matrices()


def dense(alpha, shape, theta, mu):
    return np.eye(shape[0] * shape[1]) / theta + mu * ref.dense_normal("zero", alpha, shape, 0)


def dense_radius(sweep, matrix):
    split = np.diag(np.diag(matrix)) if sweep == "jacobi" else np.tril(matrix)
    return np.abs(np.linalg.eigvals(np.eye(len(matrix)) - np.linalg.solve(split, matrix))).max()


@pytest.mark.parametrize("sweep", SWEEPS)
@pytest.mark.parametrize("alpha", [0.4, 1.0, 1.5, 2.0])
@pytest.mark.parametrize(("theta", "mu"), PAIRS)
def test_radii_are_those_of_the_dense_iteration(sweep, alpha, theta, mu):
    shape = (7, 6)
    expected = dense_radius(sweep, dense(alpha, shape, theta, mu))
    assert spectral_radius(sweep, *normals(alpha, shape), theta, mu) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("sweep", SWEEPS)
def test_a_diagonal_system_is_solved_by_one_sweep(sweep):
    ny, nx = normals(0.0, (6, 7))
    assert spectral_radius(sweep, ny, nx, 0.3, 5.0) == 0.0
    assert sweeps_needed(sweep, ny, nx, 0.3, 5.0, np.ones((6, 7))) == 1


@pytest.mark.parametrize("sweep", SWEEPS)
@pytest.mark.parametrize("tol", [1e-3, 1e-6])
def test_the_count_is_the_first_iterate_with_a_small_residual(sweep, tol):
    shape, alpha, theta, mu = (6, 5), 0.8, 0.3, 5.0
    matrix = dense(alpha, shape, theta, mu)
    v = np.random.default_rng(1).normal(size=shape)
    split = np.diag(np.diag(matrix)) if sweep == "jacobi" else np.tril(matrix)
    rhs, u, residuals = v.ravel() / theta, v.ravel(), []
    for _ in range(100):
        u = u + np.linalg.solve(split, rhs - matrix @ u)
        residuals.append(np.linalg.norm(rhs - matrix @ u) / np.linalg.norm(rhs))
    expected = 1 + int(np.argmax(np.array(residuals) <= tol))
    ny, nx = normals(alpha, shape)
    before = v.copy()
    assert sweeps_needed(sweep, ny, nx, theta, mu, v, tol=tol) == expected > 1
    np.testing.assert_array_equal(v, before)
    assert sweeps_needed(sweep, ny, nx, theta, mu, v, tol=tol, limit=expected) == expected
    assert sweeps_needed(sweep, ny, nx, theta, mu, v, tol=tol, limit=expected - 1) is None


def test_divergence_is_no_count():
    ny, nx = normals(2.0, (8, 8))
    v = np.random.default_rng(2).normal(size=(8, 8))
    assert sweeps_needed("jacobi", ny, nx, 0.3, 5.0, v, limit=10**6) is None
    assert isinstance(sweeps_needed("gauss_seidel", ny, nx, 0.3, 5.0, v), int)


@pytest.mark.parametrize(("theta", "mu"), PAIRS)
def test_the_limit_parts_convergence_from_divergence(theta, mu):
    limit = jacobi_limit(theta, mu)
    assert 1.0 < limit < 2.0
    below, above = (spectral_radius("jacobi", *normals(limit + d, (40, 40)), theta, mu) for d in (-0.02, 0.02))
    assert below < 1.0 < above


def test_the_limit_is_that_of_the_errata():
    pairs = [(0.3, 5), (0.3, 7), (0.7, 1), (0.8, 3), (0.8, 10), (0.4, 2)]
    assert [round(jacobi_limit(*pair), 2) for pair in pairs] == [1.18, 1.14, 1.34, 1.12, 1.04, 1.31]


def test_a_strong_coupling_has_no_limit():
    """At alpha 2 the left side is 16 - 2 * 6 = 4."""
    assert jacobi_limit(0.1, 1.0) == math.inf
    assert jacobi_limit(1.0, 0.1251) < 2.0
    assert jacobi_limit(1.0, 0.1249) == math.inf


@pytest.mark.parametrize("function", [spectral_radius, lambda *a: sweeps_needed(*a, np.ones((3, 3)))])
def test_an_unknown_sweep_is_named_with_the_nearest(function):
    with pytest.raises(InputError, match=r"jacobbi.*jacobi"):
        function("jacobbi", np.eye(3), np.eye(3), 0.3, 5.0)
