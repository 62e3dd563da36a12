from __future__ import annotations

import math

import numpy as np
import pytest
import reference_impl as ref
import scipy.optimize

from fracbench.model.kernels.pointwise import (
    add_and_divide,
    bregman_update,
    coupled_threshold,
    divide_by_sum,
    mean_squared_change,
    shrink_difference,
    threshold,
)

LAMBDA, THETA = 0.4, 0.3


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def data(rng, shape=(6, 7)):
    """All three cases of TH occur: small and large residuals, steep and flat gradients."""
    u = rng.normal(size=(2, *shape))
    gradient = rng.normal(0.0, 4.0, (2, *shape)) * rng.integers(0, 2, shape)
    rho_c = rng.normal(0.0, 1.0, shape) * 10.0 ** rng.integers(-1, 3, shape)
    return u, rho_c, gradient


def step(u, rho_c, gradient, lambda_theta=LAMBDA * THETA):
    v = np.full_like(u, np.nan)
    threshold(u, rho_c, gradient, lambda_theta, v)
    return v


# -- TH ------------------------------------------------------------------------------------------


def pointwise(v1, v2, u, rho_c, g):
    """|u - v|^2 / (2 theta) + lambda |rho(v)| at one pixel: problem (second_minimization)."""
    distance = (v1 - u[0]) ** 2 + (v2 - u[1]) ** 2
    return distance / (2.0 * THETA) + LAMBDA * np.abs(rho_c + g[0] * v1 + g[1] * v2)


def test_threshold_is_the_minimiser(rng):
    u, rho_c, gradient = data(rng)
    v = step(u, rho_c, gradient)
    for y, x in np.ndindex(rho_c.shape):
        pixel = (u[:, y, x], rho_c[y, x], gradient[:, y, x])
        reached = pointwise(*v[:, y, x], *pixel)
        reach = 1.5 * LAMBDA * THETA * np.hypot(*gradient[:, y, x]) + 0.1
        offsets = np.linspace(-reach, reach, 201)
        grid = pointwise(u[0, y, x] + offsets[:, None], u[1, y, x] + offsets[None, :], *pixel)
        assert reached <= grid.min() + 1e-12, (y, x)
        assert grid.min() - reached < 0.5 * (1.0 + np.hypot(*gradient[:, y, x])) * (offsets[1] - offsets[0])


def test_threshold_is_the_minimiser_along_the_gradient(rng):
    u, rho_c, gradient = data(rng)
    v = step(u, rho_c, gradient)
    for y, x in np.argwhere(np.hypot(*gradient) > 0.1):
        g, bound = gradient[:, y, x], LAMBDA * THETA
        found = scipy.optimize.minimize_scalar(
            lambda t, g=g, y=y, x=x: pointwise(*(u[:, y, x] + t * g), u[:, y, x], rho_c[y, x], g),
            bounds=(-1.1 * bound, 1.1 * bound),
            method="bounded",
            options={"xatol": 1e-10},
        )
        np.testing.assert_allclose(v[:, y, x], u[:, y, x] + found.x * g, atol=1e-5)


def test_threshold_is_the_formula_case_by_case(rng):
    u, rho_c, gradient = data(rng, (12, 13))
    np.testing.assert_allclose(
        step(u, rho_c, gradient), ref.threshold(u, rho_c, gradient, LAMBDA, THETA), atol=1e-12
    )


def test_all_cases_of_the_threshold_occur_in_the_test_data(rng):
    u, rho_c, gradient = data(rng, (12, 13))
    g2 = (gradient**2).sum(axis=0)
    rho = rho_c + (gradient * u).sum(axis=0)
    bound = LAMBDA * THETA * g2
    for case in (rho < -bound, rho > bound, (np.abs(rho) <= bound) & (g2 > 0), g2 == 0):
        assert case.sum() >= 5


@pytest.mark.parametrize("rho_c", [-1e6, -1.0, 0.0, 1.0, 1e6])
def test_zero_gradient_moves_nothing(rho_c):
    u = np.array([[[1.5]], [[-2.5]]])
    np.testing.assert_array_equal(step(u, np.array([[rho_c]]), np.zeros((2, 1, 1))), u)


@pytest.mark.parametrize("size", [1e-20, 1e-8, 1e-6, 1e-5])
@pytest.mark.parametrize("rho_c", [-1.0, -1e-30, 0.0, 1e-30, 1.0])
def test_tiny_gradients_move_almost_nothing(size, rho_c):
    u = np.zeros((2, 1, 1))
    v = step(u, np.array([[rho_c]]), np.full((2, 1, 1), size))
    assert np.abs(v).max() <= LAMBDA * THETA * size * 1.0001


def test_nan_is_passed_on():
    u, rho_c, gradient = np.zeros((2, 1, 4)), np.zeros((1, 4)), np.ones((2, 1, 4))
    u[0, 0, 0] = rho_c[0, 1] = gradient[1, 0, 2] = np.nan
    v = step(u, rho_c, gradient)
    assert np.isnan(v[:, 0, :3]).any(axis=0).all()
    assert np.isfinite(v[:, 0, 3]).all()


def test_threshold_leaves_its_inputs_alone(rng):
    arrays = data(rng)
    copies = [a.copy() for a in arrays]
    for a in arrays:
        a.flags.writeable = False
    step(*arrays)
    for a, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(a, copy)


# -- TH with a multiplier --------------------------------------------------------------------------


@pytest.mark.parametrize("relaxation", [1.0, 1.7])
def test_coupled_threshold_is_the_separate_steps(rng, relaxation):
    u, rho_c, gradient = data(rng, (12, 13))
    w, c = rng.normal(size=(2, *u.shape))
    expected_w, expected_c = ref.multiplier_step(u, w, c, rho_c, gradient, LAMBDA, THETA, 2.0, relaxation)
    target = w - c
    coupled_threshold(u, rho_c, gradient, LAMBDA, THETA, 2.0, relaxation, c, target, 0, u.shape[1])
    np.testing.assert_allclose(c, expected_c, atol=1e-11)
    np.testing.assert_allclose(target, expected_w - expected_c, atol=1e-11)


def test_coupled_threshold_solves_its_own_problem(rng):
    """w minimises min_v |w - v|^2 / (2 theta) + lambda |rho(v)| + |w - u - c|^2 / (2 step): no descent nearby."""
    u, rho_c, gradient = data(rng)
    c, step = rng.normal(size=u.shape), 2.0
    z, target = u + c, np.zeros_like(u)
    coupled_threshold(u, rho_c, gradient, LAMBDA, THETA, step, 1.0, c, target, 0, u.shape[1])

    def objective(w):
        v = ref.threshold(w, rho_c, gradient, LAMBDA, THETA)
        rho = rho_c + (gradient * v).sum(axis=0)
        distances = ((w - v) ** 2).sum(axis=0) / (2 * THETA) + ((w - z) ** 2).sum(axis=0) / (2 * step)
        return distances + LAMBDA * np.abs(rho)

    w = target + c
    least = objective(w)
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        for length in (1e-3, 0.1, 1.0):
            away = length * np.array([math.cos(angle), math.sin(angle)])[:, None, None]
            assert (objective(w + away) > least).all()


# -- shrinkage -----------------------------------------------------------------------------------


def shrunk(du, z, gamma, relaxation=1.0):
    """Return d and b of the next state, from its z = d + b and w = d - b."""
    z, w = z.copy(), np.empty_like(z)
    for start, stop in ((0, 1), (1, z.shape[2])):
        bregman_update(du, gamma, relaxation, z, start, stop)
        shrink_difference(z, gamma, w, start, stop)
    return (z + w) / 2, (z - w) / 2


@pytest.mark.parametrize("relaxation", [1.0, 1.6])
@pytest.mark.parametrize("pairs", [1, 2])
def test_shrink_and_update_are_the_separate_steps(rng, pairs, relaxation):
    du, z = rng.normal(size=(2, pairs, 2, 5, 6))
    zero = np.zeros_like(z)
    last_d, b = ref.shrink_and_update(z, zero, 0.8)
    assert (np.linalg.norm(last_d, axis=1) > 0.1).any() and (np.linalg.norm(last_d, axis=1) < 1e-12).any()
    expected_d, expected_b = ref.shrink_and_update(du, b, 0.8, relaxation, last_d)
    d, new_b = shrunk(du, z, 0.8, relaxation)
    np.testing.assert_allclose(d, expected_d, atol=1e-14)
    np.testing.assert_allclose(new_b, expected_b, atol=1e-14)
    lengths = np.linalg.norm(d, axis=1)
    assert (lengths < 1e-12).any() and (lengths > 0.1).any()


def test_shrink_minimises_its_objective(rng):
    """|d| + mu/2 |d - z|^2, equation (step2alpha), on a grid around each z."""
    mu = 1.7
    z = rng.normal(size=(1, 2, 4, 5))
    d, _ = shrunk(z, np.zeros_like(z), 1.0 / mu)
    offsets = np.linspace(-1.5, 1.5, 301)
    for y, x in np.ndindex(4, 5):
        zx, zy = z[0, :, y, x]
        dx, dy = zx + offsets[:, None], zy + offsets[None, :]
        grid = np.hypot(dx, dy) + mu / 2.0 * ((dx - zx) ** 2 + (dy - zy) ** 2)
        own = np.hypot(*d[0, :, y, x]) + mu / 2.0 * ((d[0, :, y, x] - z[0, :, y, x]) ** 2).sum()
        assert grid.min() - 1e-2 < own <= grid.min() + 1e-12


def test_shrink_of_zero_is_zero():
    zero = np.zeros((1, 2, 2, 3))
    for result in shrunk(zero, zero, 0.5):
        np.testing.assert_array_equal(result, 0.0)


def test_shrink_is_isotropic(rng):
    z = rng.normal(size=(1, 2, 4, 5))
    angle = 0.7
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    d, _ = shrunk(z, np.zeros_like(z), 0.6)
    turned, _ = shrunk(np.einsum("ij,pjyx->piyx", turn, z), np.zeros_like(z), 0.6)
    np.testing.assert_allclose(turned, np.einsum("ij,pjyx->piyx", turn, d), atol=1e-14)


def test_shrink_at_its_threshold():
    z = np.array([3.0, 4.0]).reshape(1, 2, 1, 1)
    for gamma, expected in ((5.0, [0.0, 0.0]), (2.5, [1.5, 2.0]), (6.0, [0.0, 0.0])):
        d, b = shrunk(z, np.zeros_like(z), gamma)
        np.testing.assert_allclose(d.ravel(), expected, atol=1e-15)
        np.testing.assert_allclose((d + b).ravel(), [3.0, 4.0], atol=1e-15)


def test_shrink_passes_nan_on():
    du = np.array([np.nan, 1.0]).reshape(1, 2, 1, 1)
    d, b = shrunk(du, np.zeros_like(du), 0.5)
    assert np.isnan(d).any() and np.isnan(b).any()


# -- the stopping measure ------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(2, 5, 6), (1, 4, 7), (2, 1, 1)])
def test_mean_squared_change_is_the_printed_sum(rng, shape):
    a, b = rng.normal(size=(2, *shape))
    assert mean_squared_change(a, b) == pytest.approx(ref.mean_squared_change(a, b), rel=1e-13)


def test_mean_squared_change_by_hand():
    a, b = np.zeros((2, 2, 2)), np.zeros((2, 2, 2))
    b[0], b[1, 0, 0] = 1.0, 2.0
    assert mean_squared_change(a, b) == 2.0
    assert mean_squared_change(a, a) == 0.0
    a[0, 0, 0] = np.nan
    assert math.isnan(mean_squared_change(a, b))


def test_a_sum_of_two_images_is_divided_by_a_sum_of_two_diagonals(rng):
    x, y, along_y, along_x = rng.normal(size=(4, 6)), rng.normal(size=(4, 6)), np.arange(1.0, 5.0), np.arange(6.0)
    expected = (x + y) / np.add.outer(along_y, along_x)
    out = x + y
    divide_by_sum(out, along_y, along_x)
    np.testing.assert_allclose(out, expected, atol=1e-15)
    add_and_divide(x, y, along_y, along_x, 0, 3)
    np.testing.assert_allclose(x[:3], expected[:3], atol=1e-15)
    assert (x[3] != expected[3]).all()
