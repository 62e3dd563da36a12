"""An order that varies from pixel to pixel, against dense matrices and an independent convex solver."""

from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.errors import InputError
from fracbench.model.energy import coupling, regularity
from fracbench.model.operators.alpha_map import MappedGradient
from fracbench.model.operators.base import GradientOperator
from fracbench.model.operators.reflect import ReflectGradient
from fracbench.model.regularizers import SplitBregman

THETA, MU = 0.3, 5.0
SHAPE = (6, 7)
ALPHAS = (0.6, 1.0, 1.7, 3.2)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def weights(rng):
    """One order per pixel, except in a row of blended orders."""
    chosen = rng.integers(len(ALPHAS), size=SHAPE)
    planes = np.stack([chosen == k for k in range(len(ALPHAS))]).astype(float)
    planes[:, 2] = rng.dirichlet(np.ones(len(ALPHAS)), SHAPE[1]).T
    return planes


def dense_pairs(alphas):
    return [pair for alpha in alphas for pair in ref.dense_gradient("reflect", alpha, SHAPE)]


def limits(weights):
    return [plane.ravel() / 2.0 for plane in weights for _ in range(2)]


def minimise(operator, v, iterations=400):
    regularizer = SplitBregman(operator, THETA, MU)
    u, out = v.copy(), np.empty_like(v)
    for _ in range(iterations):
        regularizer.step(v, u, out)
        u, out = out, u
    return u


def objective(operator, u, v):
    return regularity(operator, u) + coupling(u, v, THETA)


def test_the_operator_is_that_of_the_dense_matrices(rng, weights):
    operator = MappedGradient(ALPHAS, weights)
    u, d = rng.normal(size=SHAPE), rng.normal(size=operator.range_shape)
    pairs = dense_pairs(ALPHAS)
    expected = np.array([[m @ u.ravel() for m in pair] for pair in pairs]).reshape(operator.range_shape)
    np.testing.assert_allclose(operator.apply(u), expected, atol=1e-12)
    adjoint = sum(m.T @ d[p, axis].ravel() for p, pair in enumerate(pairs) for axis, m in enumerate(pair))
    np.testing.assert_allclose(operator.adjoint(d).ravel(), adjoint, atol=1e-12)
    normal = 0.5 * sum(m.T @ m for pair in pairs for m in pair)
    ny, nx = operator.normal_matrices()
    np.testing.assert_allclose(np.kron(ny, np.eye(SHAPE[1])) + np.kron(np.eye(SHAPE[0]), nx), normal, atol=1e-12)


def test_the_regularity_weighs_each_norm(rng, weights):
    u = rng.normal(size=SHAPE)
    expected = sum(
        (limit * np.hypot(dx @ u.ravel(), dy @ u.ravel())).sum()
        for limit, (dx, dy) in zip(limits(weights), dense_pairs(ALPHAS), strict=True)
    )
    assert regularity(MappedGradient(ALPHAS, weights), u) == pytest.approx(expected)


def test_the_fast_u_step_is_the_formula(rng, weights):
    operator = MappedGradient(ALPHAS, weights)
    v, g = rng.normal(size=SHAPE), rng.normal(size=operator.range_shape)
    system = operator.factor(THETA, MU)
    (u, w), (u_twin, w_twin) = ((np.empty(SHAPE), g.copy()) for _ in range(2))
    operator.solve(v, w, THETA, MU, system, u)
    GradientOperator.solve(operator, v, w_twin, THETA, MU, system, u_twin)
    np.testing.assert_allclose(u, u_twin, atol=1e-12)
    np.testing.assert_allclose(w, w_twin, atol=1e-12)
    operator.differentiate(v, w)
    np.testing.assert_allclose(w, operator.apply(v), atol=1e-12)


def test_split_bregman_reaches_the_minimum(rng, weights):
    v = rng.normal(size=(2, *SHAPE))
    v[0, :, 3:] += 2.0
    operator = MappedGradient(ALPHAS, weights)
    u = minimise(operator, v)
    for component, data in zip(u, v, strict=True):
        lower, upper = ref.denoising_bounds(dense_pairs(ALPHAS), limits(weights), data, THETA)
        assert upper - lower < 1e-5 * lower
        assert -1e-6 < objective(operator, component, data) / lower - 1.0 < 1e-4
        assert objective(operator, data, data) > 1.05 * lower  # v itself is far from it


@pytest.mark.parametrize("shares", [(1.0,), (0.3, 0.7)])
def test_a_constant_map_is_the_single_order(rng, shares):
    v = rng.normal(size=(2, *SHAPE))
    constant = MappedGradient([1.3] * len(shares), np.stack([np.full(SHAPE, share) for share in shares]))
    single = ReflectGradient(1.3, SHAPE)
    mapped, plain = minimise(constant, v), minimise(single, v)
    np.testing.assert_allclose(mapped, plain, atol=1e-4)
    assert regularity(constant, v[0]) == pytest.approx(regularity(single, v[0]))
    for component, other, data in zip(mapped, plain, v, strict=True):
        assert objective(constant, component, data) == pytest.approx(objective(single, other, data), rel=1e-6)


def test_no_weight_leaves_the_data_alone(rng):
    v = rng.normal(size=(2, *SHAPE))
    np.testing.assert_allclose(minimise(MappedGradient([1.2], np.zeros((1, *SHAPE))), v), v, atol=1e-10)


@pytest.mark.parametrize("size", [1e-30, 1e-22, 1e-19])
def test_no_weight_bears_flows_that_square_to_nothing(size):
    v = np.full((2, *SHAPE), size, np.float32)
    v[:, ::2] = 0.0
    operator = MappedGradient((0.0,), np.zeros((1, *SHAPE), np.float32), np.float32)
    np.testing.assert_allclose(minimise(operator, v, iterations=3), v, atol=1e-14)


@pytest.mark.parametrize(
    ("alphas", "shape", "value", "says"),
    [
        ((), (0, 4, 5), 1.0, "0 orders"),
        ((1.0, 1.2), (1, 4, 5), 1.0, "2 orders need as many planes of weights, got an array of 1 x 4 x 5"),
        ((1.0,), (4, 5), 1.0, "1 orders need as many planes"),
        ((1.0,), (1, 4, 5), -1.0, "at least 0"),
        ((1.0,), (1, 4, 5), np.nan, "finite"),
    ],
)
def test_weights_that_are_none(alphas, shape, value, says):
    with pytest.raises(InputError, match=says):
        MappedGradient(alphas, np.full(shape, value))
