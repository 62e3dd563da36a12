"""The infimal convolution of two orders, against dense matrices and an independent convex solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
import reference_impl as ref

from fracbench.errors import InputError
from fracbench.model.energy import coupling, regularity
from fracbench.model.operators import infimal, reflect
from fracbench.model.operators.alpha_map import MappedGradient
from fracbench.model.operators.infimal import InfimalGradient
from fracbench.model.operators.reflect import ReflectGradient
from fracbench.model.regularizers import InfimalBregman, SplitBregman

THETA, MU = 0.3, 5.0
SHAPE = (6, 7)
ORDERS = [(1.0, 1.5), (0.6, 2.0), (1.4, 0.0), (1.7, 3.0), (2.3, 4.0)]


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def steps(rng):
    """A step on a slope, with noise."""
    v = rng.normal(0.0, 0.3, (2, *SHAPE)) + 0.5 * np.arange(SHAPE[1])
    v[0, :, 3:] += 2.0
    v[1, 4:] -= 1.0
    return v


@pytest.fixture(params=[True, False], ids=["kernels", "scipy"])
def both_ways(request, monkeypatch):
    for module in (infimal, reflect):
        monkeypatch.setattr(module, "AVAILABLE", module.AVAILABLE and request.param)


def gradient(orders, beta, penalty=1.0):
    planes = np.ones((2, *SHAPE)) * np.reshape([1.0, beta], (2, 1, 1))
    return InfimalGradient(orders, planes, smooth_penalty=penalty)


def dense(orders):
    return [ref.dense_gradient("reflect", order, SHAPE) for order in orders]


def minimise(operator, v, iterations=800, smooth=None, relaxation=1.0):
    """The parts p and q, (2 parts, 2, H, W)."""
    start = np.zeros_like(v) if smooth is None else smooth
    regularizer = InfimalBregman(operator, THETA, MU, start, relaxation=relaxation)
    u, out = v.copy(), np.empty_like(v)
    for _ in range(iterations):
        assert regularizer.step(v, u, out) == 1
        u, out = out, u
    return np.stack([u - regularizer.smooth, regularizer.smooth])


def objectives(operator, parts, v):
    """The energy of each component."""
    return [
        regularity(operator, parts[:, c]) + coupling(parts[:, c].sum(axis=0), v[c], THETA) for c in range(len(v))
    ]


@pytest.mark.parametrize("orders", ORDERS)
def test_the_operator_is_that_of_the_dense_matrices(rng, orders):
    operator = gradient(orders, 2.0)
    parts, d = rng.normal(size=(2, *SHAPE)), rng.normal(size=operator.range_shape)
    matrices = [np.stack(pairs) for pairs in dense(orders)]
    expected = np.concatenate([m @ part.ravel() for m, part in zip(matrices, parts, strict=True)])
    np.testing.assert_allclose(operator.apply(parts), expected.reshape(operator.range_shape), atol=1e-12)
    back = operator.adjoint(d)
    assert np.vdot(operator.apply(parts), d) == pytest.approx(np.vdot(parts, back))
    for k, (ny, nx) in enumerate(zip(*operator.normal_matrices(), strict=True)):
        normal = np.kron(ny, np.eye(SHAPE[1])) + np.kron(np.eye(SHAPE[0]), nx)
        np.testing.assert_allclose(normal, ref.dense_normal("reflect", orders[k], SHAPE), atol=1e-12)
    np.testing.assert_allclose(operator.from_basis(operator.to_basis(parts)), parts, atol=1e-12)


@pytest.mark.parametrize("penalty", [1.0, 7.0])
@pytest.mark.parametrize("orders", ORDERS)
def test_the_u_step_is_the_dense_one(rng, orders, penalty, both_ways):
    operator = gradient(orders, 2.0, penalty)
    v, w = rng.normal(size=SHAPE), rng.normal(size=operator.range_shape)
    matrices = [np.concatenate([m for pair in pairs for m in pair]) for pairs in dense(orders)]
    n = v.size
    ones = np.eye(n) / THETA
    half = [0.5 * MU, 0.5 * penalty * MU]
    blocks = [ones + mu * m.T @ m for mu, m in zip(half, matrices, strict=True)]
    system = np.block([[blocks[0], ones], [ones, blocks[1]]])
    terms = zip(half, matrices, np.split(w, 2), strict=True)
    right = [v.ravel() / THETA + mu * m.T @ g.ravel() for mu, m, g in terms]
    expected = np.linalg.lstsq(system, np.concatenate(right), rcond=1e-13)[0].reshape(2, *SHAPE)
    if 0.0 not in orders:  # the mean costs nothing in either part and is given to p
        shift = expected[1].mean()
        expected += np.reshape([shift, -shift], (2, 1, 1))
    parts, result = np.empty((2, *SHAPE)), w.copy()
    operator.solve(v, result, THETA, MU, operator.factor(THETA, MU), parts)
    np.testing.assert_allclose(parts, expected, atol=1e-11)
    np.testing.assert_allclose(result, operator.apply(expected), atol=1e-11)
    operator.differentiate(parts, result)
    np.testing.assert_allclose(result, operator.apply(parts), atol=1e-12)


@pytest.mark.parametrize("orders", [(1.0, 1.5), (1.1, 2.0), (1.0, 3.0), (1.5, 3.0), (2.0, 4.0)])
def test_single_precision_holds_at_low_frequencies(rng, orders):
    """On lines of 600 pixels the penalties of both parts are 1e-5 to 1e-10 of the data's weight."""
    shape = (16, 600)
    slope = np.broadcast_to(np.linspace(-20.0, 20.0, shape[1]), shape)
    v = slope + rng.normal(0.0, 0.1, shape)
    w = InfimalGradient(orders, np.ones((2, *shape))).apply(np.stack([0.0 * slope, slope]))
    w += rng.normal(0.0, 0.01, w.shape)
    parts = {}
    for dtype in (np.float32, np.float64):
        operator = InfimalGradient(orders, np.ones((2, *shape)), dtype)
        parts[dtype] = np.empty((2, *shape), dtype)
        operator.solve(v.astype(dtype), w.astype(dtype), THETA, MU, operator.factor(THETA, MU), parts[dtype])
    np.testing.assert_allclose(parts[np.float32].sum(axis=0), parts[np.float64].sum(axis=0), atol=3e-5)
    # The flow is exact for all orders. Its parts are as far as the lower order tells them apart.
    if orders[0] < 1.5:
        np.testing.assert_allclose(parts[np.float32], parts[np.float64], atol=3e-5)


@pytest.mark.parametrize("relaxation", [1.0, 1.7])
@pytest.mark.parametrize("penalty", [1.0, 10.0])
@pytest.mark.parametrize(
    ("orders", "beta"),
    [((1.0, 1.5), 1.3), ((1.0, 2.0), 1.2), ((0.6, 1.4), 1.5), ((1.0, 2.4), 1.3), ((1.0, 3.0), 1.6)],
)
def test_split_bregman_reaches_the_minimum(steps, orders, beta, relaxation, penalty):
    operator = gradient(orders, beta, penalty)
    parts = minimise(operator, steps, relaxation=relaxation)
    assert np.ptp(parts, axis=(2, 3)).min() > 0.1  # both parts take part
    pairs = dense(orders)
    for reached, data in zip(objectives(operator, parts, steps), steps, strict=True):
        lower, upper = ref.infimal_bounds(*pairs, [0.5, 0.5 * beta], data, THETA)
        assert upper - lower < 1e-5 * lower
        assert -1e-6 < reached / lower - 1.0 < 1e-4
        single = min(
            ref.denoising_bounds(one, [weight / 2.0] * 2, data, THETA)[0]
            for one, weight in zip(pairs, (1.0, beta), strict=True)
        )
        assert reached < single  # and together they cost less than either alone


def test_a_larger_penalty_of_the_second_part_is_faster():
    """A slope of q's order beside a step, on lines long enough for q's derivatives to be small."""
    v = np.broadcast_to(np.linspace(0.0, 2.0, 120), (2, 8, 120)).copy()
    v[:, :, 60:] += 1.0
    v += np.random.default_rng(1).normal(0.0, 0.1, v.shape)
    weights = np.ones((2, 8, 120)) * np.reshape([1.0, 2.0], (2, 1, 1))
    above = {}
    for penalty in (1.0, 10.0):
        operator = InfimalGradient((1.0, 1.5), weights, smooth_penalty=penalty)
        early, late = (minimise(operator, v, steps, relaxation=1.7) for steps in (30, 1500))
        above[penalty] = sum(objectives(operator, early, v)) / sum(objectives(operator, late, v)) - 1.0
    assert 0.0 < above[10.0] < 0.5 * above[1.0]


def test_a_large_weight_leaves_the_first_order(steps):
    parts = minimise(gradient((1.0, 1.5), 1e3), steps, 3000)
    np.testing.assert_allclose(parts[1], 0.0, atol=1e-6)
    single = ReflectGradient(1.0, SHAPE)
    compare_with_single(gradient((1.0, 1.5), 1e3), parts, single, steps)


def test_a_small_weight_leaves_the_second_order(steps):
    beta = 0.05
    operator, single = gradient((1.0, 1.5), beta), MappedGradient([1.5], np.full((1, *SHAPE), beta))
    parts = minimise(operator, steps, 3000)
    np.testing.assert_allclose(parts[0] - parts[0].mean(axis=(1, 2), keepdims=True), 0.0, atol=1e-6)
    compare_with_single(operator, parts, single, steps)


def compare_with_single(operator, parts, single, v):
    regularizer = SplitBregman(single, THETA, MU)
    u, out = v.copy(), np.empty_like(v)
    for _ in range(3000):
        regularizer.step(v, u, out)
        u, out = out, u
    for reached, component, data in zip(objectives(operator, parts, v), u, v, strict=True):
        least = regularity(single, component) + coupling(component, data, THETA)
        assert reached == pytest.approx(least, rel=1e-6)


def test_equal_orders_are_that_order(steps):
    """Of two orders that are one, the cheaper weight holds."""
    operator = gradient((1.3, 1.3), 3.0)
    compare_with_single(operator, minimise(operator, steps, 2000), ReflectGradient(1.3, SHAPE), steps)


def test_the_start_does_not_decide_the_flow(rng, steps):
    """The problem is convex: another start of q ends at the same energy."""
    operator = gradient((1.0, 1.5), 2.0)
    one, other = (minimise(operator, steps, 1500, smooth) for smooth in (None, rng.normal(size=steps.shape)))
    for a, b in zip(objectives(operator, one, steps), objectives(operator, other, steps), strict=True):
        assert a == pytest.approx(b, rel=1e-5)


def test_the_first_step_starts_from_the_parts_at_hand(rng, steps):
    """With d = D (p, q) and b = 0 the first u-step moves neither u = v nor q."""
    smooth = rng.normal(size=steps.shape)
    smooth -= smooth.mean(axis=(1, 2), keepdims=True)  # the mean is p's
    parts = minimise(gradient((1.0, 1.5), 2.0), steps, 1, smooth)
    np.testing.assert_allclose(parts, [steps - smooth, smooth], atol=1e-11)


def test_restart_forgets(rng, steps):
    operator = gradient((1.0, 1.5), 2.0)
    used = InfimalBregman(operator, THETA, MU, np.zeros_like(steps))
    out = np.empty_like(steps)
    for _ in range(5):
        used.step(steps, steps, out)
    used.restart()
    fresh, again, expected = (
        InfimalBregman(operator, THETA, MU, used.smooth.copy()), np.empty_like(out), np.empty_like(out)
    )  # fmt: skip
    for _ in range(3):
        used.step(steps, out, again)
        fresh.step(steps, out, expected)
        np.testing.assert_array_equal(again, expected)


def test_a_constant_moves_p_alone(steps):
    operator = gradient((1.0, 1.5), 2.0)
    parts, moved = minimise(operator, steps, 20), minimise(operator, steps + 3.0, 20)
    np.testing.assert_allclose(moved[0], parts[0] + 3.0, atol=1e-11)
    np.testing.assert_allclose(moved[1], parts[1], atol=1e-11)
    still = minimise(operator, np.full_like(steps, 2.5), 20)
    np.testing.assert_allclose(still[0], 2.5, atol=1e-12)
    np.testing.assert_allclose(still[1], 0.0, atol=1e-12)


def test_weights_vary_from_pixel_to_pixel(rng):
    planes = rng.uniform(0.5, 2.0, (2, *SHAPE))
    parts = rng.normal(size=(2, *SHAPE))
    expected = sum(
        (plane / 2.0 * np.hypot(*(m @ part.ravel() for m in pair)).reshape(SHAPE)).sum()
        for plane, part, pairs in zip(planes, parts, dense((1.0, 1.5)), strict=True)
        for pair in pairs
    )
    assert regularity(InfimalGradient((1.0, 1.5), planes), parts) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("shape", "value", "says"),
    [((3, 4, 5), 1.0, "as many planes of weights, got an array of 3 x 4 x 5"), ((4, 5), 1.0, "array of 4 x 5"),
     ((2, 4, 5), -1.0, "at least 0"), ((2, 4, 5), math.nan, "finite")],
)  # fmt: skip
def test_weights_that_are_none(shape, value, says):
    with pytest.raises(InputError, match=says):
        InfimalGradient((1.0, 1.5), np.full(shape, value))
