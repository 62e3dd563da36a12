"""Elimination in the lines' systems against dense matrices, and its gains against the Riccati equation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fracbench.model.kernels.cosine import LINES
from fracbench.model.kernels.line_elimination import line_gains, solve_lines
from fracbench.model.operators.zero import LeftDerivative, ZeroGradient, left_derivative_matrix


@pytest.fixture
def rng():
    return np.random.default_rng(9)


def dense(rhs, direct, mu, alpha):
    """The lines' systems, each as its dense matrix."""
    t = left_derivative_matrix(alpha, rhs.shape[1])
    return np.stack(
        [np.linalg.solve(s * np.eye(len(t)) + mu * t.T @ t, f) for s, f in zip(direct, rhs, strict=True)]
    )


def solved(rhs, direct, mu, alpha, axis=1):
    weights = LeftDerivative(alpha, rhs.shape[1], 0, rhs.dtype).memory
    gains = line_gains(weights, direct, mu, rhs.shape[1])
    assert gains.rows.dtype == rhs.dtype
    x = rhs.copy() if axis == 1 else np.ascontiguousarray(rhs.T)
    solve_lines(x, axis, 0, len(rhs), weights.ratios, gains)
    return x if axis == 1 else x.T


@settings(max_examples=60, deadline=None)
@example(alpha=1.0, n=64, mu=0.3125, theta=0.0546875, seed=0)
@given(
    alpha=st.floats(1e-3, 2.0),
    n=st.sampled_from([64, 101, 200, 301]),
    mu=st.floats(0.1, 50.0),
    theta=st.floats(0.05, 1.0),
    seed=st.integers(0, 99),
)
def test_lines_are_solved_as_the_dense_matrices_are(alpha, n, mu, theta, seed):
    rng = np.random.default_rng(seed)
    direct = 1.0 / theta + mu * np.array([0.0, 1e-4, 0.3, 2.0, 16.0])
    rhs = rng.normal(size=(5, n)).astype(np.float32)
    expected = dense(rhs, direct, mu, alpha)
    errors = np.abs(solved(rhs, direct, mu, alpha) - expected).max(axis=1)
    # rows of gains change when k does by more than rounding; 1 / r is then known to s / mu times as much
    bound = 3e-6 + np.finfo(np.float32).eps * direct / mu
    assert (errors <= bound * np.abs(expected).max(axis=1)).all()


@pytest.mark.parametrize("alpha", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 65, 400])
def test_whole_orders_are_solved_in_double_precision(rng, alpha, n):
    direct, rhs = np.array([0.01, 0.7, 90.0]), rng.normal(size=(3, n))
    expected = dense(rhs, direct, 5.0, alpha)
    np.testing.assert_allclose(solved(rhs, direct, 5.0, alpha), expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("alpha", [0.4, 1.3])
@pytest.mark.parametrize("count", [1, 13, LINES, 2 * LINES + 5])
@pytest.mark.parametrize("axis", [0, 1])
def test_any_number_of_lines_along_either_axis(rng, alpha, count, axis):
    direct, rhs = rng.uniform(1.0, 90.0, count), rng.normal(size=(count, 70)).astype(np.float32)
    expected = dense(rhs, direct, 5.0, alpha)
    np.testing.assert_allclose(solved(rhs, direct, 5.0, alpha, axis), expected, atol=2e-6)


def test_in_parts(rng):
    alpha, count = 1.2, 3 * LINES + 5
    direct, rhs = rng.uniform(1.0, 90.0, count), rng.normal(size=(count, 80)).astype(np.float32)
    whole, parts = solved(rhs, direct, 5.0, alpha), rhs.copy()
    weights = LeftDerivative(alpha, 80, 0, np.float32).memory
    gains = line_gains(weights, direct, 5.0, 80)
    for start, stop in ((0, LINES), (LINES, 3 * LINES), (3 * LINES, count)):
        solve_lines(parts, 1, start, stop, weights.ratios, gains)
    np.testing.assert_array_equal(parts, whole)


def control_problem(weights):
    """The state matrix of x without u, and the output vector of the derivative."""
    a = np.diag(np.r_[0.0, weights.ratios.astype(float)])
    a[1:, 0] = 1.0
    return a, np.r_[weights.taps[1:], weights.factors].astype(float)


@pytest.mark.parametrize("alpha", [0.3, 0.9, 0.97, 1.1, 1.6])
def test_gains_follow_the_riccati_recursion(alpha):
    """The literal recursion with a full matrix; errors of the gains move u by no more than rounding."""
    mu, s, n = 5.0, 3.0, 640
    weights = LeftDerivative(alpha, n, 0, np.float32).memory
    gains, (a, known) = line_gains(weights, np.array([s]), mu, n), control_problem(weights)
    reach, cost = 1.0 / (1.0 - np.r_[0.0, weights.ratios.astype(float)]), np.zeros_like(a)
    for row in gains.which[0]:
        r = s + mu + cost[0, 0]
        gain = (mu * known + cost[0] @ a) / r
        found = gains.rows[row].reshape(len(known) + 1, LINES)[:, 0]
        assert found[0] * r == pytest.approx(1.0, abs=5e-7)
        assert reach @ np.abs(found[1:] - gain) <= 5e-7
        cost = mu * np.outer(known, known) + a.T @ cost @ a - r * np.outer(gain, gain)


def test_gains_solve_the_riccati_equation_far_from_the_end():
    """The stationary gains are those of the control problem over lines without end, by another algorithm."""
    alpha, mu, s, n = 1.6, 5.0, 3.0, 400
    weights = LeftDerivative(alpha, n, 0, np.float32).memory
    gains, (a, known) = line_gains(weights, np.array([s]), mu, n), control_problem(weights)
    b = np.eye(len(known))[:, :1]
    cost = scipy.linalg.solve_discrete_are(
        a, b, mu * np.outer(known, known), np.array([[s + mu]]), s=mu * known[:, None]
    )
    r = s + mu + cost[0, 0]
    last = gains.rows[gains.which[0, -1]].reshape(len(known) + 1, LINES)[:, 0]
    np.testing.assert_allclose(last[0], 1.0 / r, rtol=1e-6)
    np.testing.assert_allclose(last[1:], (mu * known + cost[0] @ a) / r, atol=1e-6)


def test_gains_that_repeat_themselves_are_kept_once():
    weights = LeftDerivative(1.5, 2000, 0, np.float32).memory
    assert len(line_gains(weights, np.array([3.0]), 5.0, 2000).rows) < 200


def test_what_is_not_finite_stays_seen():
    rhs = np.zeros((1, 90), np.float32)
    rhs[0, 60] = np.nan
    assert np.isnan(solved(rhs, np.array([3.0]), 5.0, 1.2)).all()


@pytest.mark.parametrize("alpha", [0.3, 1.0, 1.7])
@pytest.mark.parametrize("shape", [(60, 90), (90, 60), (90, 70), (66, 66), (20, 30)])
def test_the_u_step_in_single_precision_is_that_in_double(rng, alpha, shape):
    """Elimination along x, along y, with and without a short memory of the other axis, and full products."""
    theta, mu = 0.3, 5.0
    v, w = rng.normal(size=shape), rng.normal(size=(1, 2, *shape))
    found = []
    for dtype in (np.float32, np.float64):
        operator = ZeroGradient(alpha, shape, dtype)
        u, d = np.empty(shape, dtype), w.astype(dtype)
        operator.solve(v.astype(dtype), d, theta, mu, operator.factor(theta, mu), u)
        found.append((u, d))
    for single, double in zip(*found, strict=True):
        assert single.dtype == np.float32
        np.testing.assert_allclose(single, double, atol=2e-5)
