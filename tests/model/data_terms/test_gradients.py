"""Data beyond brightness: derivatives of both frames, and a v-step for several residuals."""

from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref
import scipy.optimize

from fracbench.model.data_terms.brightness import Brightness, TwoSided, five_point_gradient
from fracbench.model.data_terms.gradients import ImageAndGradient
from fracbench.model.params import FlowParams
from fracbench.model.v_steps import ChannelStep, MultiplierStep, coupled_thresholds
from fracbench.model.warping import Linearization, central_gradient, interleave

LAMBDAS, THETA, STEP = np.array([0.3, 1.2, 0.7]), 0.4, 3.0


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def frames():
    return ref.translated_pair((14, 17), (1.1, -0.6))


def residuals(rng, shape, channels=3):
    """Steep and flat gradients, small and large residuals, and a channel without gradient at some pixels."""
    gradient = rng.normal(0.0, 3.0, (channels, 2, *shape)) * rng.integers(0, 2, (channels, 1, *shape))
    return rng.normal(size=(channels, *shape)) * 10.0 ** rng.integers(-1, 2, (channels, *shape)), gradient


def take(u, linear, lambdas=LAMBDAS, rounds=400, c=None):
    """Return w (= target + c) after one v-step without relaxation."""
    c = np.zeros_like(u) if c is None else c
    target, duals = np.zeros_like(u), np.zeros_like(linear[0])
    coupled_thresholds(u, *linear, lambdas, THETA, STEP, 1.0, duals, c, target, rounds, 0, u.shape[1])
    return target + c, c, duals


def test_the_v_step_minimises_the_sum_of_the_residuals(rng):
    """w is the proximal point of F with the step, found at each pixel by bounded least squares on the dual."""
    shape = (4, 5)
    u, linear = rng.normal(size=(2, *shape)), residuals(rng, shape)
    w, c, duals = take(u, linear)
    assert (np.abs(duals) <= LAMBDAS[:, None, None]).all()
    tau = THETA + STEP
    for i, j in np.ndindex(shape):
        a, rho = linear[1][:, :, i, j], linear[0][:, i, j] + linear[1][:, :, i, j] @ u[:, i, j]
        # max_p -tau/2 |a^T p|^2 + rho . p, |p_k| <= lambda_k
        found = scipy.optimize.minimize(
            lambda p, a=a, rho=rho: 0.5 * tau * np.sum((a.T @ p) ** 2) - rho @ p,
            np.zeros(3),
            jac=lambda p, a=a, rho=rho: tau * a @ (a.T @ p) - rho,
            bounds=[(-x, x) for x in LAMBDAS],
            method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-12, "maxiter": 5000},
        )
        v = u[:, i, j] - tau * a.T @ found.x
        expected = u[:, i, j] + STEP / tau * (v - u[:, i, j])
        np.testing.assert_allclose(w[:, i, j], expected, atol=2e-5)
    np.testing.assert_allclose(c, u - w, atol=1e-12)


def test_one_channel_in_one_round_is_the_thresholding_operator(rng, frames):
    params = FlowParams(dtype="float64", lambda_=0.3, theta=0.4)
    u = rng.normal(size=(2, 14, 17))
    linear = Brightness(*frames, params).at(u)
    plain, several = MultiplierStep(u, params), ChannelStep(u, params)
    several._lambdas = several._lambdas[:1]
    several._duals = several._duals[:1]
    stacked = Linearization(linear.rho_c[None], linear.gradient[None])
    for _ in range(3):  # relaxed from the second on
        expected = plain.target(u, linear).copy()
        np.testing.assert_allclose(several.target(u, stacked), expected, atol=1e-12)
        u = 0.5 * (u + expected)


def test_a_round_starts_where_the_last_one_ended(rng):
    """Many calls of few sweeps with u fixed give the result of one call of many sweeps."""
    shape = (4, 5)
    u, linear = rng.normal(size=(2, *shape)), residuals(rng, shape)
    expected, _, _ = take(u, linear)
    duals, target = np.zeros_like(linear[0]), np.zeros_like(u)
    for _ in range(150):
        c = np.zeros_like(u)
        coupled_thresholds(u, *linear, LAMBDAS, THETA, STEP, 1.0, duals, c, target, 3, 0, shape[0])
    np.testing.assert_allclose(target + c, expected, atol=1e-6)


def test_the_five_point_stencil_is_exact_for_polynomials_of_degree_four():
    x = np.arange(12.0)
    image = np.add.outer(0.01 * x**3, 0.002 * x**4)
    gradient = five_point_gradient(image)
    np.testing.assert_allclose(gradient[0][:, 2:-2], np.tile(0.008 * x**3, (12, 1))[:, 2:-2], atol=1e-10)
    np.testing.assert_allclose(gradient[1][2:-2], np.tile(0.03 * x**2, (12, 1)).T[2:-2], atol=1e-10)
    np.testing.assert_allclose(five_point_gradient(image, 2.0), 2.0 * gradient)


def test_the_gradient_is_the_mean_of_both_frames_and_the_residual_stays(rng, frames):
    u0 = rng.normal(size=(2, 14, 17))
    plain = Brightness(*frames, FlowParams(dtype="float64"))
    plain._samples1 = interleave(frames[1], five_point_gradient(frames[1]))
    expected, mixed = (kind.at(u0) for kind in (plain, TwoSided(*frames, FlowParams(dtype="float64"))))
    seen = (expected.gradient != 0.0).any(axis=0)
    assert seen.any() and not seen.all()
    mean = 0.5 * (expected.gradient + five_point_gradient(frames[0]))
    np.testing.assert_allclose(mixed.gradient, np.where(seen, mean, 0.0), atol=1e-12)
    at_u0 = [linear.rho_c + (linear.gradient * u0).sum(axis=0) for linear in (expected, mixed)]
    np.testing.assert_allclose(*at_u0, atol=1e-11)


@pytest.mark.parametrize(("derivatives", "kind"), [("frame1", Brightness), ("both", TwoSided)])
def test_the_channels_are_the_image_and_its_derivatives(rng, frames, derivatives, kind):
    params = FlowParams(dtype="float64", derivatives=derivatives)
    u0 = rng.normal(size=(2, 14, 17))
    linear = ImageAndGradient(*frames, params).at(u0)
    (x0, y0), (x1, y1) = (central_gradient(frame) for frame in frames)
    for k, pair in enumerate([frames, (x0, x1), (y0, y1)]):
        expected = kind(*(np.ascontiguousarray(image) for image in pair), params).at(u0)
        np.testing.assert_array_equal(linear.rho_c[k], expected.rho_c)
        np.testing.assert_array_equal(linear.gradient[k], expected.gradient)


def test_a_change_of_light_moves_the_image_alone(frames):
    params = FlowParams(dtype="float64")
    u0 = np.zeros((2, 14, 17))
    dark, light = (ImageAndGradient(frames[0], frames[1] + shift, params).at(u0).rho_c for shift in (0.0, 20.0))
    np.testing.assert_allclose(light[1:], dark[1:], atol=1e-12)
    inner = light[0, 1:-2, 1:-2] - dark[0, 1:-2, 1:-2]
    np.testing.assert_allclose(inner, 20.0)
