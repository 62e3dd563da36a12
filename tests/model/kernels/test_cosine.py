"""The transforms against SciPy, NumPy and the sums that define them."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from fracbench.model.kernels.cosine import cosine, cosine_back, derivatives, derivatives_adjoint
from fracbench.model.kernels.fft import fourier, line_plan
from fracbench.model.kernels.simd import LANES

# every radix, products of them, odd primes and their squares; and fewer, as many, and more lines than lanes
LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 15, 16, 22, 25, 30, 49, 60, 97, 146)
COUNTS = (1, 7, 8, 13, 37)
# transforms that are completed one by one after none, one and two passes over all
LONG = (256, 640, 2448, 2021, 7000)
TOLERANCE = {np.float64: 1e-13, np.float32: 2e-5}


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def lines(n, count, axis):
    return (n, count) if axis == 0 else (count, n)


def sine(x, axis):
    """The sine coefficients by their definition."""
    n = x.shape[axis]
    k, j = np.arange(n)[:, None], np.arange(n)
    basis = np.sqrt(2.0 / n) * np.sin(np.pi * k * (2 * j + 1) / (2 * n))
    return np.moveaxis(np.tensordot(basis, x, axes=(1, axis)), 0, axis)


@pytest.mark.parametrize("n", LENGTHS + LONG)
def test_fourier_is_the_discrete_fourier_transform_of_each_lane(rng, n):
    plan = line_plan(n, np.dtype(float))
    work = rng.normal(size=(2 * (n + 3), LANES))
    before = work.copy()
    fourier(work, 2, plan)
    rows = work.reshape(n + 3, 2, LANES)
    found = (rows[:, 0] + 1j * rows[:, 1])[2 + plan.results]
    samples = before.reshape(n + 3, 2, LANES)[2 : 2 + n]
    np.testing.assert_allclose(found, np.fft.fft(samples[:, 0] + 1j * samples[:, 1], axis=0), atol=1e-11)
    outside = [0, 1, 2, 3, 2 * n + 4, 2 * n + 5]
    np.testing.assert_array_equal(work[outside], before[outside])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("n", LENGTHS)
def test_cosine_transforms_are_scipys(rng, n, count, axis, dtype):
    x = rng.normal(size=lines(n, count, axis)).astype(dtype)
    factor, plan, out = np.ones(n, dtype), line_plan(n, np.dtype(dtype)), np.empty_like(x)
    cosine(x, axis, 0, count, factor, plan, out)
    expected = scipy.fft.dct(x, axis=axis, norm="ortho")
    np.testing.assert_allclose(out, expected, atol=TOLERANCE[dtype])
    cosine_back(expected, axis, 0, count, factor, plan, out)
    np.testing.assert_allclose(out, x, atol=TOLERANCE[dtype])


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("n", [5, 8, 12, 19])
def test_in_place_in_parts_and_with_factors(rng, n, axis):
    x, factor = rng.normal(size=lines(n, 39, axis)), rng.normal(size=n)
    along = (n, 1) if axis == 0 else (1, n)
    plan = line_plan(n, np.dtype(float))
    forth = factor.reshape(along) * scipy.fft.dct(x, axis=axis, norm="ortho")
    back = scipy.fft.idct(factor.reshape(along) * x, axis=axis, norm="ortho")
    for transform, expected in ((cosine, forth), (cosine_back, back)):
        part = x.copy()
        transform(part, axis, 16, 32, factor, plan, part)
        chosen = (slice(None),) * (1 - axis) + (slice(16, 32),)
        np.testing.assert_allclose(part[chosen], expected[chosen], atol=1e-13)
        part[chosen] = x[chosen]
        np.testing.assert_array_equal(part, x)
        for start, stop in ((0, 16), (32, 39), (16, 32)):
            transform(part, axis, start, stop, factor, plan, part)
        np.testing.assert_allclose(part, expected, atol=1e-13)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("count", [7, 37])
@pytest.mark.parametrize("n", LENGTHS)
def test_derivatives_are_cosine_and_sine_series(rng, n, count, axis, dtype):
    shape = lines(n, count, axis)
    plan = line_plan(n, np.dtype(dtype))
    even, odd = rng.normal(size=(2, n)).astype(dtype)
    along = (n, 1) if axis == 0 else (1, n)
    x = rng.normal(size=shape).astype(dtype)
    out = np.full((2, 2, *shape), 7.0, dtype)
    derivatives(x, axis, 0, count, even, odd, plan, out)
    basis = sine(np.eye(n), 0).T  # from coefficients to samples
    a = scipy.fft.idct(even.reshape(along) * x, axis=axis, norm="ortho")
    b = np.moveaxis(np.tensordot(basis, odd.reshape(along) * x, axes=(1, axis)), 0, axis)
    np.testing.assert_allclose(out[0, 1 - axis], a - b, atol=10 * TOLERANCE[dtype])
    np.testing.assert_allclose(out[1, 1 - axis], a + b, atol=10 * TOLERANCE[dtype])
    assert (out[:, axis] == 7.0).all()  # the other direction


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("count", [7, 37])
@pytest.mark.parametrize("n", LENGTHS)
def test_adjoint_of_the_derivatives(rng, n, count, axis):
    """<derivatives(x), d> = <x, adjoint(d)>, and the coefficients of v are added on request."""
    shape = lines(n, count, axis)
    plan = line_plan(n, np.dtype(float))
    even, odd, direct = rng.normal(size=(3, n))
    odd[0] = 0.0  # no sine of frequency 0
    x, v, d = rng.normal(size=shape), rng.normal(size=shape), rng.normal(size=(2, 2, *shape))
    forth, back, both = np.zeros_like(d), np.empty_like(x), np.empty_like(x)
    derivatives(x, axis, 0, count, even, odd, plan, forth)
    derivatives_adjoint(d, v, axis, 0, count, even, odd, direct[:0], plan, back)
    assert np.vdot(forth, d) == pytest.approx(np.vdot(x, back), rel=1e-10, abs=1e-10)
    derivatives_adjoint(d, v, axis, 0, count, even, odd, direct, plan, both)
    along = (n, 1) if axis == 0 else (1, n)
    expected = back + direct.reshape(along) * scipy.fft.dct(v, axis=axis, norm="ortho")
    np.testing.assert_allclose(both, expected, atol=1e-12)


@settings(deadline=None, max_examples=10 if config.DISABLE_JIT else 100)
@given(st.integers(1, 400), st.integers(1, 40), st.integers(0, 1), st.integers(0, 2**32 - 1))
def test_back_undoes_forth_for_any_size(n, count, axis, seed):
    x = np.random.default_rng(seed).normal(size=lines(n, count, axis))
    plan, one, out = line_plan(n, np.dtype(float)), np.ones(n), np.empty_like(x)
    cosine(x, axis, 0, count, one, plan, out)
    assert np.vdot(out, out) == pytest.approx(np.vdot(x, x), rel=1e-12)  # orthonormal
    cosine_back(out, axis, 0, count, one, plan, out)
    np.testing.assert_allclose(out, x, atol=1e-12)
