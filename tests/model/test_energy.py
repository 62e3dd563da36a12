from __future__ import annotations

import math

import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.energy import attachment, coupling, energy, regularity
from fracbench.model.operators.choose import make_operator
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.operators.reflect import ReflectGradient
from fracbench.model.operators.zero import ZeroGradient
from fracbench.model.warping import Linearization

CASES = [
    ("zero", 0.4, 0),
    ("zero", 1.3, 0),
    ("zero", 1.3, 3),
    ("reflect", 0.4, 0),
    ("reflect", 1.3, 0),
    ("natural", 1.0, 0),
]


@pytest.fixture
def rng():
    return np.random.default_rng(6)


# -- by hand -------------------------------------------------------------------------------------


def test_regularity_by_hand():
    bump = np.array([[0.0, 1.0], [0.0, 0.0]])
    # forward differences: (1, 0) at (0, 0), (., -1) at (0, 1), nothing below
    assert regularity(ForwardDifferences(1.0, (2, 2)), bump) == pytest.approx(2.0)
    # backward differences of u extended by 0: (1, 1) at (0, 1), (0, -1) below it
    assert regularity(ZeroGradient(1.0, (2, 2)), bump) == pytest.approx(math.sqrt(2.0) + 1.0)
    # and with one line of padding (-1, .) to the right of it
    assert regularity(ZeroGradient(1.0, (2, 2), pad=1), bump) == pytest.approx(math.sqrt(2.0) + 2.0)
    # order 0: |(u, u)|
    assert regularity(ZeroGradient(0.0, (2, 2)), 3.0 * bump) == pytest.approx(3.0 * math.sqrt(2.0))


def test_both_sides_of_reflect_weigh_one_half():
    # left differences (0, 1), right differences (-1, 0)
    assert regularity(ReflectGradient(1.0, (1, 2)), np.array([[0.0, 1.0]])) == pytest.approx(1.0)


def test_coupling_by_hand():
    u, v = np.zeros((2, 1, 2)), np.array([[[1.0, 2.0]], [[0.0, -3.0]]])
    assert coupling(u, v, theta=0.5) == pytest.approx(14.0)


def test_attachment_by_hand():
    linear = Linearization(np.array([[1.0, -2.0]]), np.array([[[1.0, 0.0]], [[0.0, 2.0]]]))
    v = np.array([[[3.0, 9.0]], [[9.0, 0.5]]])
    assert attachment(v, linear, lambda_=0.25) == pytest.approx(0.25 * (4.0 + 1.0))


def test_energy_is_the_sum_of_its_terms(rng):
    operator = ReflectGradient(1.2, (5, 6))
    linear = Linearization(rng.normal(size=(5, 6)), rng.normal(size=(2, 5, 6)))
    u, v = rng.normal(size=(2, 2, 5, 6))
    rho = linear.rho_c + (linear.gradient * v).sum(axis=0)
    dense = 0.0
    for component in u:
        for dx, dy in ref.dense_gradient("reflect", 1.2, (5, 6)):
            dense += 0.5 * np.hypot(dx @ component.ravel(), dy @ component.ravel()).sum()
    expected = dense + ((u - v) ** 2).sum() / 0.6 + 0.4 * np.abs(rho).sum()
    assert energy(operator, u, v, linear, 0.4, 0.3) == pytest.approx(expected, rel=1e-12)


# -- against dense matrices and finite differences -----------------------------------------------


@pytest.mark.parametrize(("boundary", "alpha", "pad"), CASES)
def test_regularity_is_the_sum_of_dense_norms(rng, boundary, alpha, pad):
    u = rng.normal(size=(5, 6))
    pairs = ref.dense_gradient(boundary, alpha, u.shape, pad)
    expected = sum(np.hypot(dx @ u.ravel(), dy @ u.ravel()).sum() for dx, dy in pairs) / len(pairs)
    assert regularity(make_operator(boundary, alpha, (5, 6), np.float64, pad), u) == pytest.approx(expected)


@pytest.mark.parametrize(("boundary", "alpha", "pad"), CASES)
def test_gradient_of_the_regularity(rng, boundary, alpha, pad):
    """weight D* (D u / |D u|) where no |D u| vanishes; natural has one such pixel, whose D u is always 0."""
    u = rng.normal(size=(4, 5))
    operator = make_operator(boundary, alpha, u.shape, np.float64, pad)
    d = operator.apply(u)
    norm = np.sqrt((d**2).sum(axis=1, keepdims=True))
    slope = operator.weight * operator.adjoint(d / np.where(norm > 1e-12, norm, 1.0))
    for index in np.ndindex(u.shape):
        e = np.zeros_like(u)
        e[index] = 1e-6
        difference = (regularity(operator, u + e) - regularity(operator, u - e)) / 2e-6
        assert slope[index] == pytest.approx(difference, abs=1e-6)


def test_gradient_of_attachment_and_coupling(rng):
    linear = Linearization(rng.normal(size=(3, 4)), rng.normal(size=(2, 3, 4)))
    u, v = rng.normal(size=(2, 2, 3, 4))
    rho = linear.rho_c + (linear.gradient * v).sum(axis=0)
    expected = (v - u) / 0.3 + 0.4 * np.sign(rho) * linear.gradient
    for index in np.ndindex(v.shape):
        e = np.zeros_like(v)
        e[index] = 1e-6
        rise = [coupling(u, v + s * e, 0.3) + attachment(v + s * e, linear, 0.4) for s in (1, -1)]
        assert (rise[0] - rise[1]) / 2e-6 == pytest.approx(expected[index], abs=1e-6)


def test_float32_sums_are_taken_in_float64():
    ones = np.ones((2, 300, 400), np.float32)
    zeros = np.zeros_like(ones)
    linear = Linearization(ones[0] * np.float32(0.1), zeros)
    assert coupling(ones, zeros, 0.5) == 240_000.0
    assert attachment(zeros, linear, 1.0) == pytest.approx(120_000 * float(np.float32(0.1)), rel=1e-12)
