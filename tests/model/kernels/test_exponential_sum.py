"""Sums of exponentials against the weights, and convolutions with them against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fracbench.model.kernels.cosine import LINES
from fracbench.model.kernels.exponential_sum import TOLERANCE, convolve, exponential_sum
from fracbench.model.operators.zero import gl_weights, left_derivative_matrix

ORDERS = (1e-6, 0.01, 0.1, 0.5, 0.9, 0.999, 1.0001, 1.1, 1.5, 1.9, 1.9999)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def weights_of(found, n):
    """The weights that a sum of exponentials stands for."""
    k = np.arange(n - 2)[:, None]
    return np.concatenate(
        [found.taps.astype(float), found.ratios.astype(float) ** k @ found.factors.astype(float)]
    )


@settings(max_examples=60, deadline=None)
@given(
    alpha=st.floats(1e-9, 2.0 - 1e-9).filter(lambda a: a != 1.0), n=st.sampled_from([8, 33, 101, 200, 388, 640])
)
def test_few_exponentials_give_all_weights(alpha, n):
    found, weights = exponential_sum(gl_weights(alpha, n), np.float32), gl_weights(alpha, n)
    assert found is not None
    assert len(found.ratios) <= 14
    assert ((found.ratios > 0) & (found.ratios < 1)).all()
    # and the rounding of the factors and of the first two
    allowed = TOLERANCE * np.abs(weights).max() + 6e-8 * np.abs(weights).sum()
    assert np.abs(weights_of(found, n) - weights).sum() <= 1.01 * allowed


def test_what_is_no_such_sum_is_told(rng):
    assert exponential_sum(rng.normal(size=120), np.float32) is None
    assert exponential_sum(np.arange(120.0), np.float32) is None


@pytest.mark.parametrize("alpha", ORDERS)
@pytest.mark.parametrize("n", [101, 200])
@pytest.mark.parametrize("count", [1, 13, 16, 37])
def test_a_convolution_is_the_product_with_the_matrix(rng, alpha, n, count):
    found, matrix = exponential_sum(gl_weights(alpha, n), np.float32), left_derivative_matrix(alpha, n)
    x = rng.normal(size=(count, n)).astype(np.float32)
    for turn in (np.asarray, lambda a: np.ascontiguousarray(a.T)):
        axis = 1 if turn(x).shape[1] == n else 0
        for reverse, expected in ((False, x @ matrix.T), (True, x @ matrix)):
            out = np.full_like(turn(x), np.nan)
            convolve(turn(x), axis, 0, count, found, reverse, out)
            np.testing.assert_allclose(out, turn(expected), atol=4e-6)


def test_constants_lose_no_digits(rng):
    """The worst case for a sum that all samples before go into: the weights of all add up to little."""
    n = 640
    for alpha in (0.1, 0.9, 1.1, 1.9):
        found, matrix = exponential_sum(gl_weights(alpha, n), np.float32), left_derivative_matrix(alpha, n)
        x = np.full((1, n), 100.0, np.float32)
        convolve(x, 1, 0, 1, found, False, x)  # in place
        np.testing.assert_allclose(x[0], 100.0 * matrix.sum(axis=1), atol=100 * 2e-6)


def test_in_parts(rng):
    n, found = 120, exponential_sum(gl_weights(1.2, 120), np.float32)
    x = rng.normal(size=(3 * LINES + 5, n)).astype(np.float32)
    whole, parts = np.empty_like(x), np.full_like(x, np.nan)
    convolve(x, 1, 0, len(x), found, False, whole)
    for start, stop in ((0, LINES), (LINES, 3 * LINES), (3 * LINES, len(x))):
        convolve(x, 1, start, stop, found, False, parts)
    np.testing.assert_array_equal(parts, whole)


def test_what_is_not_finite_stays_seen():
    found = exponential_sum(gl_weights(1.2, 120), np.float32)
    x = np.zeros((1, 120), np.float32)
    x[0, 60] = np.nan
    convolve(x, 1, 0, 1, found, False, x)
    assert np.isnan(x[0, 60:]).all() and not np.isnan(x[0, :60]).any()
