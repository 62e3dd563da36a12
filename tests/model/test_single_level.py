"""The alternation of v-step and u-step for one linearisation, against an independent minimiser of E."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.energy import energy
from fracbench.model.operators.choose import make_operator
from fracbench.model.params import FlowParams
from fracbench.model.regularizers import SplitBregman, TVDual
from fracbench.model.v_steps import MultiplierStep, PenaltyStep
from fracbench.model.warping import Linearization

SHAPE = (5, 6)
LAMBDA, THETA = 0.4, 0.3
CASES = [("zero", 0.5), ("zero", 1.3), ("reflect", 0.5), ("reflect", 1.0), ("reflect", 1.3), ("natural", 1.0)]


def residual():
    """rho(v) about 0 near v = (2, -1), with a flat pixel."""
    rng = np.random.default_rng(5)
    gradient = rng.normal(0.0, 3.0, (2, *SHAPE))
    gradient[:, 2, 3] = 0.0
    return Linearization(rng.normal(0.0, 0.5, SHAPE) - 2.0 * gradient[0] + gradient[1], gradient)


LINEAR = residual()


def attachment_slope(u):
    """Gradient of min_v |u - v|^2 / (2 theta) + lambda |rho(v)|, a Huber function of rho(u)."""
    g = LINEAR.gradient
    rho = LINEAR.rho_c + (g * u).sum(axis=0)
    g2 = np.maximum((g**2).sum(axis=0), 1e-30)
    return np.clip(rho / (THETA * g2), -LAMBDA, LAMBDA) * g


def best_energy(operator, u):
    v = ref.threshold(u, *LINEAR, LAMBDA, THETA)
    return energy(operator, u, v, LINEAR, LAMBDA, THETA)


@lru_cache
def least_energy(boundary, alpha):
    """The minimum of E, by the primal-dual iteration of Condat and Vu with dense matrices."""
    pairs = ref.dense_gradient(boundary, alpha, SHAPE)
    k, weight = np.concatenate([m for pair in pairs for m in pair]), 1.0 / len(pairs)
    norm = np.linalg.norm(k, 2)
    sigma = 2.0 / norm
    tau = 1.0 / (sigma * norm**2 + 1.0 / (2.0 * THETA))
    u, p = np.zeros((2, *SHAPE)), np.zeros((2, len(k)))
    for _ in range(3000):
        new = u - tau * (attachment_slope(u) + (p @ k).reshape(u.shape))
        p = p + sigma * (2.0 * new - u).reshape(2, -1) @ k.T
        blocks = p.reshape(2, len(pairs), 2, -1)
        p = (blocks / np.maximum(1.0, np.linalg.norm(blocks, axis=2, keepdims=True) / weight)).reshape(p.shape)
        u = new
    return best_energy(make_operator(boundary, alpha, SHAPE), u)


def alternate(v_step, regularizer, count):
    u, after = np.zeros((2, *SHAPE)), np.empty((2, *SHAPE))
    for _ in range(count):
        regularizer.step(v_step.target(u, LINEAR), u, after)
        u, after = after, u
    return u


def multiplier(step=3.0, relaxation=1.7):
    params = FlowParams(lambda_=LAMBDA, theta=THETA, coupling_step=step, relaxation=relaxation)
    return MultiplierStep(np.zeros((2, *SHAPE)), params)


def penalty():
    return PenaltyStep(np.zeros((2, *SHAPE)), FlowParams(lambda_=LAMBDA, theta=THETA))


@pytest.mark.parametrize(("boundary", "alpha"), CASES)
def test_the_multiplier_reaches_the_minimum_of_the_energy(boundary, alpha):
    operator = make_operator(boundary, alpha, SHAPE)
    u = alternate(multiplier(), SplitBregman(operator, 3.0, 10.0, relaxation=1.7), 300)
    least = least_energy(boundary, alpha)
    assert best_energy(operator, u) == pytest.approx(least, rel=1e-4)
    assert best_energy(operator, np.zeros_like(u)) > 1.1 * least


@pytest.mark.parametrize(("boundary", "alpha"), CASES)
def test_the_penalty_reaches_the_minimum_of_the_energy(boundary, alpha):
    operator = make_operator(boundary, alpha, SHAPE)
    u = alternate(penalty(), SplitBregman(operator, THETA, 5.0), 600)
    assert best_energy(operator, u) == pytest.approx(least_energy(boundary, alpha), rel=1e-4)


def test_the_dual_method_reaches_the_minimum_of_the_energy():
    u = alternate(penalty(), TVDual(SHAPE, THETA, 0.25, np.float64), 1000)
    operator = make_operator("natural", 1.0, SHAPE)
    assert best_energy(operator, u) == pytest.approx(least_energy("natural", 1.0), rel=1e-3)


@pytest.mark.parametrize(("step", "relaxation"), [(1.0, 1.0), (3.0, 1.0), (1.0, 1.7), (10.0, 1.9)])
def test_the_minimum_does_not_depend_on_step_or_relaxation(step, relaxation):
    operator = make_operator("reflect", 1.3, SHAPE)
    u = alternate(multiplier(step, relaxation), SplitBregman(operator, step, 10.0, relaxation=relaxation), 300)
    assert best_energy(operator, u) == pytest.approx(least_energy("reflect", 1.3), rel=1e-4)


def test_the_multiplier_is_the_literal_iteration():
    rng = np.random.default_rng(1)
    v_step = multiplier(2.0, 1.6)
    w, c = np.zeros((2, 2, *SHAPE))
    for count in range(4):
        u = rng.normal(size=(2, *SHAPE))
        w, c = ref.multiplier_step(u, w, c, *LINEAR, LAMBDA, THETA, 2.0, 1.0 if count == 0 else 1.6)
        np.testing.assert_allclose(v_step.target(u, LINEAR), w - c, atol=1e-12)


def test_restart_forgets_the_multiplier():
    rng = np.random.default_rng(1)
    used, fresh = multiplier(), multiplier()
    for _ in range(3):
        used.target(rng.normal(size=(2, *SHAPE)), LINEAR)
    used.relinearised()
    used.restart()
    for _ in range(2):
        u = rng.normal(size=(2, *SHAPE))
        np.testing.assert_array_equal(used.target(u, LINEAR), fresh.target(u, LINEAR))


def test_the_multiplier_is_kept_across_linearisations_but_the_last_w_is_not():
    rng = np.random.default_rng(1)
    v_step = multiplier(2.0, 1.6)
    w, c = np.zeros((2, 2, *SHAPE))
    for relaxation in (1.0, 1.6, 1.0, 1.6):
        if math.isclose(relaxation, 1.0):
            v_step.relinearised()
        u = rng.normal(size=(2, *SHAPE))
        w, c = ref.multiplier_step(u, w, c, *LINEAR, LAMBDA, THETA, 2.0, relaxation)
        np.testing.assert_allclose(v_step.target(u, LINEAR), w - c, atol=1e-12)


def test_the_penalty_step_is_the_papers_threshold():
    u = np.random.default_rng(1).normal(size=(2, *SHAPE))
    v_step = penalty()
    for _ in range(2):
        expected = ref.threshold(u, *LINEAR, LAMBDA, THETA)
        np.testing.assert_allclose(v_step.target(u, LINEAR), expected, atol=1e-13)
        v_step.relinearised(), v_step.restart()
