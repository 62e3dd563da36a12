from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import reference_impl as ref
import scipy.special

from fracbench.errors import InputError
from fracbench.model.operators.base import GradientOperator
from fracbench.model.operators.choose import make_operator
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.operators.reflect import ReflectGradient
from fracbench.model.operators.zero import (
    LEAST_SUMMED,
    LeftDerivative,
    ZeroGradient,
    gl_weights,
    left_derivative_matrix,
)

ALPHAS = (0.0, 0.3, 0.7, 1.0, 1.3, 1.9, 2.0)
HIGH = (2.3, 3.0, 3.6, 4.0)  # under reflect alone
SHAPES = ((7, 5), (8, 6), (13, 11), (1, 9), (9, 1), (1, 1), (16, 3), (35, 3))
CASES = [
    *(("zero", a, pad) for a, pad in itertools.product(ALPHAS, (0, 1, 5))),
    *(("reflect", a, 0) for a in ALPHAS + HIGH),
    ("natural", 1.0, 0),
]
OPERATORS = pytest.mark.parametrize(("boundary", "alpha", "pad"), CASES)
SIZES = pytest.mark.parametrize("shape", SHAPES)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def dense_apply(u, boundary, alpha, pad=0):
    height, width = u.shape
    out = (height + pad, width + pad)
    pairs = ref.dense_gradient(boundary, alpha, u.shape, pad)
    return np.array([[(m @ u.ravel()).reshape(out) for m in pair] for pair in pairs])


# -- weights and matrices ------------------------------------------------------------------------


@pytest.mark.parametrize("pad", [0, 2])
@pytest.mark.parametrize("n", [5, LEAST_SUMMED])
@pytest.mark.parametrize("order", [0.0, 0.7, 1.0, 2.0])
@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-12), (np.float32, 4e-6)])
def test_every_form_of_the_left_derivative_is_the_matrix(rng, order, n, pad, dtype, atol):
    derivative, matrix = LeftDerivative(order, n, pad, dtype), left_derivative_matrix(order, n, pad)
    u, d = rng.normal(size=(3, n)).astype(dtype), rng.normal(size=(3, n + pad)).astype(dtype)
    for axis, turn in ((1, np.asarray), (0, lambda x: np.ascontiguousarray(x.T))):
        applied, back = turn(np.full_like(d, np.nan)), turn(np.full_like(u, np.nan))
        derivative.apply(turn(u), axis, applied)
        derivative.apply(turn(d), axis, back, transposed=True)
        np.testing.assert_allclose(applied, turn(u @ matrix.T), atol=atol)
        np.testing.assert_allclose(back, turn(d @ matrix), atol=atol)


@pytest.mark.parametrize("alpha", ALPHAS + HIGH)
def test_weights_are_signed_binomials(alpha):
    k = np.arange(200)
    expected = (-1.0) ** k * scipy.special.binom(alpha, k)
    np.testing.assert_allclose(gl_weights(alpha, 200), expected, rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("alpha", ALPHAS + HIGH)
def test_weights_equal_the_printed_recurrence(alpha):
    np.testing.assert_allclose(gl_weights(alpha, 50), ref.gl_weights(alpha, 50), rtol=1e-14)
    assert gl_weights(alpha, 1).tolist() == [1.0]


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("pad", [0, 4])
def test_left_matrix_holds_the_printed_sums(rng, alpha, pad):
    u = rng.normal(size=11)
    np.testing.assert_allclose(
        left_derivative_matrix(alpha, 11, pad) @ u, ref.left_derivative(u, alpha, pad), atol=1e-13
    )


@pytest.mark.parametrize("alpha", ALPHAS)
def test_transposed_left_matrix_is_the_right_derivative(rng, alpha):
    u = rng.normal(size=11)
    t = left_derivative_matrix(alpha, 11)
    np.testing.assert_allclose(t.T @ u, ref.right_derivative(u, alpha), atol=1e-13)
    np.testing.assert_allclose(t.T @ (t @ u), ref.composition(u, alpha), atol=1e-12)


@pytest.mark.parametrize(
    ("alpha", "p"), [*((a, 3) for a in (0.3, 0.7, 1.0, 1.3, 1.9, 2.0)), (2.3, 5), (3.0, 5), (3.6, 6), (4.0, 7)]
)
def test_derivative_of_a_power_converges_with_order_one(alpha, p):
    exact = math.gamma(p + 1) / math.gamma(p + 1 - alpha)  # times x^(p - alpha), on (0, 1]
    errors = []
    for n in (64, 128, 256, 512):
        x = np.arange(n + 1) / n
        approximate = n**alpha * (left_derivative_matrix(alpha, n + 1) @ x**p)
        errors.append(np.abs(approximate / exact - x ** (p - alpha)).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 1.0, atol=0.05)
    assert errors[-1] < 0.02


# -- every operator ------------------------------------------------------------------------------


@SIZES
@OPERATORS
def test_dot_product(rng, boundary, alpha, pad, shape):
    operator = make_operator(boundary, alpha, shape, np.float64, pad)
    u, d = rng.normal(size=shape), rng.normal(size=operator.range_shape)
    image, back = operator.apply(u), operator.adjoint(d)
    left, right = np.vdot(image, d), np.vdot(u, back)
    scale = np.linalg.norm(image) * np.linalg.norm(d) + np.linalg.norm(u) * np.linalg.norm(back)
    assert abs(left - right) <= 1e-12 * max(scale, 1e-300), f"<D u, d> = {left!r}, <u, D* d> = {right!r}"


@SIZES
@OPERATORS
def test_apply_and_adjoint_equal_dense_matrices(rng, boundary, alpha, pad, shape):
    operator = make_operator(boundary, alpha, shape, np.float64, pad)
    u, d = rng.normal(size=shape), rng.normal(size=operator.range_shape)
    expected = dense_apply(u, boundary, alpha, pad)
    assert operator.range_shape == expected.shape
    np.testing.assert_allclose(operator.apply(u), expected, atol=1e-12)
    pairs = ref.dense_gradient(boundary, alpha, shape, pad)
    back = sum(
        m.T @ part.ravel()
        for pair, parts in zip(pairs, d, strict=True)
        for m, part in zip(pair, parts, strict=True)
    )
    np.testing.assert_allclose(operator.adjoint(d).ravel(), back, atol=1e-12)


@SIZES
@OPERATORS
def test_normal_operator_is_diagonal_in_the_basis(rng, boundary, alpha, pad, shape):
    operator = make_operator(boundary, alpha, shape, np.float64, pad)
    dense = ref.dense_normal(boundary, alpha, shape, pad)
    ly, lx = operator.eigenvalues()
    u = rng.normal(size=shape)
    coefficients = operator.to_basis(u)
    np.testing.assert_allclose(np.linalg.norm(coefficients), np.linalg.norm(u), rtol=1e-13)
    np.testing.assert_allclose(operator.from_basis(coefficients), u, atol=1e-13)
    expected = operator.from_basis((ly[:, None] + lx) * coefficients)
    np.testing.assert_allclose((dense @ u.ravel()).reshape(shape), expected, atol=1e-11)


@SIZES
@OPERATORS
def test_normal_matrices_sum_to_the_normal_operator(boundary, alpha, pad, shape):
    ny, nx = make_operator(boundary, alpha, shape, np.float64, pad).normal_matrices()
    total = np.kron(ny, np.eye(shape[1])) + np.kron(np.eye(shape[0]), nx)
    np.testing.assert_allclose(total, ref.dense_normal(boundary, alpha, shape, pad), atol=1e-12)


@SIZES
@OPERATORS
def test_solve_is_the_dense_u_step(rng, boundary, alpha, pad, shape):
    theta, mu = 0.7, 3.0
    operator = make_operator(boundary, alpha, shape, np.float64, pad)
    v, g = rng.normal(size=shape), rng.normal(size=operator.range_shape)
    system = np.eye(v.size) / theta + mu * ref.dense_normal(boundary, alpha, shape, pad)
    rhs = v / theta + mu * operator.weight * operator.adjoint(g)
    expected = np.linalg.solve(system, rhs.ravel()).reshape(shape)
    for kind in (type(operator), GradientOperator):
        u, w = np.empty_like(v), g.copy()
        kind.solve(operator, v, w, theta, mu, kind.factor(operator, theta, mu), u)
        np.testing.assert_allclose(u, expected, atol=1e-12)
        np.testing.assert_allclose(w, operator.apply(u), atol=1e-12)
    operator.differentiate(v, g)
    np.testing.assert_allclose(g, operator.apply(v), atol=1e-12)


@OPERATORS
def test_float32_stays_float32(rng, boundary, alpha, pad):
    operator = make_operator(boundary, alpha, (9, 6), np.float32, pad)
    exact = make_operator(boundary, alpha, (9, 6), np.float64, pad)
    u = rng.normal(size=(9, 6)).astype(np.float32)
    d = rng.normal(size=operator.range_shape).astype(np.float32)
    for result, twin in (
        (operator.apply(u), exact.apply(u.astype(float))),
        (operator.adjoint(d), exact.adjoint(d.astype(float))),
        (operator.to_basis(u), None),  # bases may differ by signs
        (operator.from_basis(operator.to_basis(u)), u),
    ):
        assert result.dtype == np.float32
        if twin is not None:
            np.testing.assert_allclose(result, twin, atol=2e-5)


@OPERATORS
def test_inputs_may_be_read_only(rng, boundary, alpha, pad):
    operator = make_operator(boundary, alpha, (5, 6), np.float64, pad)
    u, d = rng.normal(size=(5, 6)), rng.normal(size=operator.range_shape)
    before = u.copy(), d.copy()
    u.flags.writeable = d.flags.writeable = False
    operator.apply(u), operator.adjoint(d)
    operator.solve(u, d.copy(), 1.0, 1.0, operator.factor(1.0, 1.0), np.empty((5, 6)))
    operator.differentiate(u, d.copy())
    np.testing.assert_array_equal(u, before[0])
    np.testing.assert_array_equal(d, before[1])


# -- whole orders --------------------------------------------------------------------------------


def shifted(u, k, axis, ghost):
    """u(i - k) along `axis`, samples outside given by `ghost(index, n)` -> index inside, or None for 0."""
    n = u.shape[axis]
    index = [i - k for i in range(n)]
    inside = [i if 0 <= i < n else ghost(i, n) for i in index]
    lines = [np.zeros_like(u.take(0, axis)) if i is None else u.take(i, axis) for i in inside]
    return np.stack(lines, axis)


def nothing(i, n):
    return None


def mirrored(i, n):
    return -1 - i if i < 0 else 2 * n - 1 - i


def difference(u, alpha, axis, ghost, side):
    coefficients = [(-1) ** k * math.comb(alpha, k) for k in range(alpha + 1)]
    return sum(c * shifted(u, side * k, axis, ghost) for k, c in enumerate(coefficients))


@pytest.mark.parametrize("alpha", [0, 1, 2])
def test_zero_with_whole_orders_is_plain_differences(rng, alpha):
    u = rng.normal(size=(6, 7))
    d = ZeroGradient(alpha, u.shape).apply(u)
    np.testing.assert_allclose(d[0, 0], difference(u, alpha, 1, nothing, 1), atol=1e-14)
    np.testing.assert_allclose(d[0, 1], difference(u, alpha, 0, nothing, 1), atol=1e-14)


@pytest.mark.parametrize("alpha", [0, 1, 2, 3, 4])
def test_reflect_with_whole_orders_is_differences_with_mirrored_ghosts(rng, alpha):
    u = rng.normal(size=(6, 7))
    d = ReflectGradient(alpha, u.shape).apply(u)
    for pair, side in ((0, 1), (1, -1)):
        np.testing.assert_allclose(d[pair, 0], difference(u, alpha, 1, mirrored, side), atol=1e-13)
        np.testing.assert_allclose(d[pair, 1], difference(u, alpha, 0, mirrored, side), atol=1e-13)


def test_natural_is_forward_differences_without_flux(rng):
    u = rng.normal(size=(6, 7))
    np.testing.assert_allclose(ForwardDifferences(1.0, u.shape).apply(u)[0], ref.forward_gradient(u), atol=1e-15)


def test_padding_adds_derivatives_past_the_right_and_bottom_edge():
    u = np.ones((2, 3))
    d = ZeroGradient(1.0, u.shape, pad=2).apply(u)
    assert d.shape == (1, 2, 4, 5)
    np.testing.assert_array_equal(d[0, 0], [[1, 0, 0, -1, 0], [1, 0, 0, -1, 0], [0] * 5, [0] * 5])
    np.testing.assert_array_equal(d[0, 1], [[1, 1, 1, 0, 0], [0] * 5, [-1, -1, -1, 0, 0], [0] * 5])


# -- reflect -------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.3, 0.7, 1.3, 1.9, 2.3, 3.6])
def test_reflect_is_the_long_sum_over_the_even_extension(rng, alpha):
    n, terms = 9, 100_000
    line = rng.normal(size=n)
    line -= line.mean()  # the tail of the sum then oscillates about 0 and 10^5 terms are enough
    extension = np.concatenate([line, line[::-1]])
    weights = (-1.0) ** np.arange(terms) * scipy.special.binom(alpha, np.arange(terms))
    k = np.arange(terms)
    left = [weights @ extension[(i - k) % (2 * n)] for i in range(n)]
    right = [weights @ extension[(i + k) % (2 * n)] for i in range(n)]
    d = ReflectGradient(alpha, (1, n)).apply(line[None])
    np.testing.assert_allclose(d[0, 0, 0], left, atol=1e-5)
    np.testing.assert_allclose(d[1, 0, 0], right, atol=1e-5)


@pytest.mark.parametrize("alpha", [1e-3, *ALPHAS[1:], *HIGH])
@SIZES
def test_reflect_of_a_constant_is_zero(alpha, shape):
    d = ReflectGradient(alpha, shape).apply(np.full(shape, 3.7))
    np.testing.assert_allclose(d, 0.0, atol=1e-13)


def test_order_zero_differs_from_small_orders_under_reflect():
    constant = np.ones((4, 5))
    np.testing.assert_allclose(ReflectGradient(0.0, (4, 5)).apply(constant), 1.0, atol=1e-14)


@pytest.mark.parametrize("alpha", ALPHAS + HIGH)
@pytest.mark.parametrize("n", [1, 2, 7, 12])
def test_reflect_eigenvalues_are_powers_of_the_sine(alpha, n):
    left, right = ref.derivative_matrices("reflect", alpha, n)
    k, i = np.arange(n), np.arange(n)
    cosines = np.cos(np.pi * k[:, None] * (2 * i + 1) / (2 * n)) * np.sqrt(np.where(k == 0, 1, 2) / n)[:, None]
    eigenvalues = (2.0 * np.sin(np.pi * k / (2 * n))) ** (2 * alpha)
    normal = (left.T @ left + right.T @ right) / 2
    np.testing.assert_allclose(cosines @ normal @ cosines.T, np.diag(eigenvalues), atol=1e-12)
    np.testing.assert_allclose(ReflectGradient(alpha, (n, 3)).eigenvalues()[0], eigenvalues, atol=1e-13)


@pytest.mark.parametrize("alpha", ALPHAS + HIGH)
def test_reflect_is_symmetric_under_flips(rng, alpha):
    u = rng.normal(size=(6, 7))
    operator = ReflectGradient(alpha, u.shape)
    d, flipped = operator.apply(u), operator.apply(u[:, ::-1])[..., ::-1]
    np.testing.assert_allclose(flipped[::-1, 0], d[:, 0], atol=1e-13)  # left and right change places
    np.testing.assert_allclose(flipped[:, 1], d[:, 1], atol=1e-13)
    turned = ReflectGradient(alpha, (7, 6)).apply(u.T).transpose(0, 1, 3, 2)
    np.testing.assert_allclose(turned[:, ::-1], d, atol=1e-13)


@pytest.mark.parametrize("alpha", [0.3, 1.0, 1.7, 2.0, *HIGH])
def test_derivatives_of_a_cosine_converge_with_order_one(alpha):
    """Of cos(kx), even about both ends of [0, pi], the left derivative is k^alpha cos(kx + alpha pi / 2)."""
    k, errors = 3, []
    for n in (64, 128, 256, 512):
        step = math.pi / n
        x = (np.arange(n) + 0.5) * step
        d = ReflectGradient(alpha, (1, n)).apply(np.cos(k * x)[None]) / step**alpha
        exact = [k**alpha * np.cos(k * x + sign * alpha * math.pi / 2) for sign in (1, -1)]
        errors.append(np.abs(d[:, 0, 0] - exact).max() / k**alpha)
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 1.0, atol=0.05)
    assert errors[-1] < 0.02 * alpha


# -- make_operator -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("boundary", "kind"), [("zero", ZeroGradient), ("reflect", ReflectGradient), ("natural", ForwardDifferences)]
)
def test_make_operator_gives_the_operator_of_the_boundary(boundary, kind):
    operator = make_operator(boundary, 1.0, (4, 5))
    assert type(operator) is kind
    assert operator.dtype == np.float64


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("zero", -0.1), r"`alpha` must lie in \[0, 2\] under boundary=zero, got -0.1"),
        (("zero", 2.1), r"`alpha` must lie in \[0, 2\] under boundary=zero, got 2.1"),
        (("reflect", 4.1), r"`alpha` must lie in \[0, 4\] under boundary=reflect, got 4.1"),
        (("zero", math.nan), r"`alpha` must lie in \[0, 2\] under boundary=zero, got nan"),
        (("reflct", 1.0), "unknown boundary 'reflct': did you mean 'reflect'?"),
        (("natural", 1.2), "boundary=natural is defined for alpha = 1, got alpha = 1.2"),
    ],
)
def test_make_operator_says_what_is_wrong(args, message):
    with pytest.raises(InputError, match=message):
        make_operator(*args, (4, 5))


@pytest.mark.parametrize("boundary", ["reflect", "natural"])
def test_padding_belongs_to_zero(boundary):
    with pytest.raises(InputError, match=f"pad=3 with boundary={boundary}"):
        make_operator(boundary, 1.0, (4, 5), pad=3)


@pytest.mark.parametrize(("shape", "longer"), [((120, 200), 1), ((200, 120), 0)])
def test_lines_are_eliminated_along_the_longer_axis(shape, longer):
    axis, _ = ZeroGradient(1.2, shape, np.float32)._lines
    assert axis == longer
