from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.operators.base import GradientOperator
from fracbench.model.operators.choose import make_operator
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.operators.zero import ZeroGradient, gl_weights
from fracbench.model.sweeps import (
    gauss_seidel_dense,
    gauss_seidel_literal,
    gauss_seidel_natural,
    jacobi_sweep,
)

THETA, MU = 0.3, 5.0
CASES = [
    *(("zero", a, pad) for a in (0.0, 0.5, 1.0, 1.4, 2.0) for pad in (0, 3)),
    *(("reflect", a, 0) for a in (0.0, 0.5, 1.0, 1.4, 2.0)),
    ("natural", 1.0, 0),
]
OPERATORS = pytest.mark.parametrize(("boundary", "alpha", "pad"), CASES)


def exact_u_step(operator, rhs):
    return operator.from_basis(
        operator.to_basis(rhs) / np.add.outer(*GradientOperator.factor(operator, THETA, MU))
    )


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def system(boundary, alpha, shape, pad=0, theta=THETA, mu=MU):
    return np.eye(shape[0] * shape[1]) / theta + mu * ref.dense_normal(boundary, alpha, shape, pad)


def sweep(operator, u, rhs, theta=THETA, mu=MU):
    if isinstance(operator, ForwardDifferences):
        gauss_seidel_natural(u, theta * rhs, np.zeros(operator.range_shape), theta, mu)
    else:
        gauss_seidel_dense(u, rhs, *operator.normal_matrices(), theta, mu)


@OPERATORS
@pytest.mark.parametrize("shape", [(7, 5), (6, 8), (1, 9), (9, 1)])
def test_exact_u_step_solves_the_dense_system(rng, boundary, alpha, pad, shape):
    operator = make_operator(boundary, alpha, shape, np.float64, pad)
    rhs = rng.normal(size=shape)
    u = exact_u_step(operator, rhs)
    expected = np.linalg.solve(system(boundary, alpha, shape, pad), rhs.ravel()).reshape(shape)
    np.testing.assert_allclose(u, expected, atol=1e-10 * np.abs(expected).max())


@OPERATORS
def test_gauss_seidel_converges_to_the_exact_u_step(rng, boundary, alpha, pad):
    operator = make_operator(boundary, alpha, (5, 6), np.float64, pad)
    rhs, u = rng.normal(size=(5, 6)), rng.normal(size=(5, 6))
    for _ in range(250):
        sweep(operator, u, rhs)
    exact = exact_u_step(operator, rhs)
    np.testing.assert_allclose(u, exact, atol=1e-10)


# -- agreement with the literal loops ------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.0, 0.6, 1.0, 1.4, 2.0])
@pytest.mark.parametrize("pad", [0, 2])
def test_gauss_seidel_dense_is_algorithm_4_with_corrected_signs(rng, alpha, pad):
    operator = ZeroGradient(alpha, (5, 4), np.float64, pad)
    u, rhs = rng.normal(size=(2, 5, 4))
    expected = ref.gauss_seidel_alpha(u, rhs, alpha, THETA, MU, pad)
    sweep(operator, u, rhs)
    np.testing.assert_allclose(u, expected, atol=1e-13)


@pytest.mark.parametrize("alpha", [0.0, 0.6, 1.0, 1.4, 2.0])
@pytest.mark.parametrize("shape", [(5, 4), (3, 7), (1, 1)])
def test_the_double_sums_are_the_same_sweep(rng, alpha, shape):
    literal, rhs = rng.normal(size=(2, *shape))
    u = literal.copy()
    sweep(ZeroGradient(alpha, shape), u, rhs)
    gauss_seidel_literal(literal, rhs, gl_weights(alpha, max(shape)), THETA, MU)
    np.testing.assert_allclose(literal, u, atol=1e-13)


@pytest.mark.parametrize("alpha", [0.0, 0.6, 1.0, 1.4, 2.0])
def test_jacobi_is_the_printed_sweep_with_corrected_signs(rng, alpha):
    u, rhs = rng.normal(size=(2, 5, 4))
    before = u.copy()
    result = jacobi_sweep(u, rhs, *ZeroGradient(alpha, (5, 4)).normal_matrices(), THETA, MU)
    np.testing.assert_allclose(result, ref.jacobi_alpha(u, rhs, alpha, THETA, MU, sign=-1), atol=1e-13)
    np.testing.assert_array_equal(u, before)


@pytest.mark.parametrize("shape", [(5, 4), (1, 6), (6, 1), (2, 2), (1, 1)])
def test_gauss_seidel_natural_is_algorithm_3(rng, shape):
    (u, v), w = rng.normal(size=(2, *shape)), rng.normal(size=(1, 2, *shape))
    rhs = v / THETA + MU * ForwardDifferences(1.0, shape).adjoint(w)
    expected = ref.gauss_seidel_natural(u, rhs, THETA, MU)
    gauss_seidel_natural(u, v, w, THETA, MU)
    np.testing.assert_allclose(u, expected, atol=1e-14)
    np.testing.assert_allclose(w[0], ref.forward_gradient(expected), atol=1e-14)


def test_the_right_hand_side_is_the_adjoint(rng):
    v, g = rng.normal(size=(5, 4)), rng.normal(size=(2, 5, 4))
    expected = ref.right_hand_side(v, g, 1.3, THETA, MU)
    actual = v / THETA + MU * ZeroGradient(1.3, (5, 4)).adjoint(g[None])
    np.testing.assert_allclose(actual, expected, atol=1e-13)


@OPERATORS
def test_a_sweep_is_the_dense_gauss_seidel_sweep(rng, boundary, alpha, pad):
    shape = (4, 6)
    u, rhs = rng.normal(size=(2, *shape))
    matrix = system(boundary, alpha, shape, pad)
    lower = np.tril(matrix)
    expected = np.linalg.solve(lower, rhs.ravel() - (matrix - lower) @ u.ravel())
    sweep(make_operator(boundary, alpha, shape, np.float64, pad), u, rhs)
    np.testing.assert_allclose(u.ravel(), expected, atol=1e-12)


# -- what the paper prints -----------------------------------------------------------------------


def affine_map(update, shape):
    """Return the matrix and offset of an affine ``update(u)``."""
    offset = update(np.zeros(shape)).ravel()
    unit = np.eye(offset.size)
    return np.array([update(e.reshape(shape)).ravel() - offset for e in unit]).T, offset


def finite_difference_gradient(function, u, step=1e-3):
    """Central differences, exact for a quadratic up to rounding."""
    gradient = np.empty_like(u)
    for index in np.ndindex(u.shape):
        e = np.zeros_like(u)
        e[index] = step
        gradient[index] = (function(u + e) - function(u - e)) / (2.0 * step)
    return gradient


@pytest.mark.parametrize("alpha", [0.4, 1.0, 1.4])
def test_printed_signs_are_not_the_euler_lagrange_equation(rng, alpha):
    shape = (4, 5)
    v, g = rng.normal(size=shape), rng.normal(size=(2, *shape))
    rhs = ref.right_hand_side(v, g, alpha, THETA, MU)
    pairs = ref.dense_gradient("zero", alpha, shape)
    slopes, fixed_points = {}, {}
    for sign in (1, -1):
        matrix, offset = affine_map(lambda u, s=sign: ref.jacobi_alpha(u, rhs, alpha, THETA, MU, s), shape)
        fixed_points[sign] = np.linalg.solve(np.eye(offset.size) - matrix, offset).reshape(shape)
        slopes[sign] = finite_difference_gradient(
            lambda u: ref.u_energy(u, v, g, pairs, THETA, MU), fixed_points[sign]
        )
    solution = np.linalg.solve(system("zero", alpha, shape), rhs.ravel()).reshape(shape)
    np.testing.assert_allclose(fixed_points[-1], solution, atol=1e-10)
    np.testing.assert_allclose(slopes[-1], 0.0, atol=1e-7)
    assert np.abs(slopes[1]).max() > 1.0
    assert np.abs(fixed_points[1] - solution).max() > 0.1


def test_corrected_signs_reduce_to_algorithm_3_for_alpha_1(rng):
    u, rhs = rng.normal(size=(2, 5, 6))
    neighbours = sum(np.roll(u, step, axis) for axis in (0, 1) for step in (-1, 1))
    expected = (rhs + MU * neighbours) / (1.0 / THETA + 4.0 * MU)
    inner = (slice(1, -1), slice(1, -1))
    corrected = ref.jacobi_alpha(u, rhs, 1.0, THETA, MU, sign=-1)
    printed = ref.jacobi_alpha(u, rhs, 1.0, THETA, MU, sign=1)
    np.testing.assert_allclose(corrected[inner], expected[inner], atol=1e-13)
    assert np.abs(printed - expected)[inner].max() > 0.1


def jacobi_radius(matrix):
    """Spectral radius of I - D^-1 A, by the similar symmetric matrix."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    return np.abs(1.0 - np.linalg.eigvalsh(matrix * scale[:, None] * scale)).max()


def gauss_seidel_radius(matrix):
    return np.abs(np.linalg.eigvals(np.eye(len(matrix)) - np.linalg.solve(np.tril(matrix), matrix))).max()


def test_jacobi_radius_is_that_of_the_printed_sweep_with_corrected_sign(rng):
    shape = (5, 5)
    matrix, _ = affine_map(lambda u: ref.jacobi_alpha(u, np.zeros(shape), 1.4, THETA, MU, -1), shape)
    expected = np.abs(np.linalg.eigvals(matrix)).max()
    assert jacobi_radius(system("zero", 1.4, shape)) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("theta", "mu", "converges", "diverges"), [(0.3, 5.0, 1.1, 1.3), (0.3, 10.0, 1.0, 1.2), (0.7, 1.0, 1.2, 1.5)]
)
def test_jacobi_diverges_where_the_paper_looks(theta, mu, converges, diverges):
    """The radii on these 24 x 24 images: 0.930 and 1.081, 0.919 and 1.071, 0.884 and 1.111."""
    radius = {a: jacobi_radius(system("zero", a, (24, 24), 0, theta, mu)) for a in (converges, diverges)}
    assert radius[converges] < 0.96
    assert radius[diverges] > 1.04


@pytest.mark.parametrize("alpha", [1.0, 1.4, 2.0])
def test_gauss_seidel_converges_where_jacobi_does_not(alpha):
    assert gauss_seidel_radius(system("zero", alpha, (14, 14))) < 0.9
    assert jacobi_radius(system("zero", 2.0, (14, 14))) > 1.5


def test_jacobi_sweeps_blow_up_where_their_radius_says_so(rng):
    u, rhs = rng.normal(size=(2, 6, 6))
    start = np.abs(u).max()
    for _ in range(25):
        u = ref.jacobi_alpha(u, rhs, 2.0, THETA, MU, sign=-1)
    assert np.abs(u).max() > 100 * start
