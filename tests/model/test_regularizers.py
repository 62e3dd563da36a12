from __future__ import annotations

import itertools
import math
from functools import lru_cache

import numba
import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.energy import coupling, energy, regularity
from fracbench.model.kernels.pointwise import threshold
from fracbench.model.kernels.threads import use_threads
from fracbench.model.operators.choose import make_operator
from fracbench.model.operators.forward import ForwardDifferences
from fracbench.model.operators.zero import ZeroGradient
from fracbench.model.regularizers import SplitBregman, TVDual, dual_ascent, dual_primal
from fracbench.model.warping import Linearization

THETA, MU = 0.3, 5.0
SHAPE = (6, 7)
ALPHAS = (0.0, 0.5, 1.0, 1.4, 2.0)
DENOISING = [*(("zero", a) for a in ALPHAS), *(("reflect", a) for a in ALPHAS), ("natural", 1.0)]


def steps_and_noise():
    rng = np.random.default_rng(0)
    v = rng.normal(size=(2, *SHAPE))
    v[0, :, 3:] += 2.0
    v[1, 4:] -= 1.0
    v.flags.writeable = False
    return v


V = steps_and_noise()


@lru_cache
def dual_bounds(boundary, alpha):
    """Bracket the minimum of R(u) + |u - v|^2 / (2 theta) for each component."""
    pairs = ref.dense_gradient(boundary, alpha, SHAPE)
    return [ref.denoising_bounds(pairs, [1.0 / len(pairs)] * len(pairs), v, THETA) for v in V]


def denoise(regularizer, count=400, v=V):
    u, out = v.copy(), np.empty_like(v)
    for _ in range(count):
        regularizer.step(v, u, out)
        u, out = out, u
    return u


def objective(operator, u, v):
    return regularity(operator, u) + coupling(u, v, THETA)


def relative_excess(operator, boundary, alpha, u):
    """The excess of each component's energy over the certified minimum, relative to it."""
    for (lower, upper), component, data in zip(dual_bounds(boundary, alpha), u, V, strict=True):
        assert upper - lower < 1e-5 * lower  # the oracle itself has converged
        yield (objective(operator, component, data) - lower) / lower


# -- the minimum ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("boundary", "alpha"), DENOISING)
def test_split_bregman_reaches_the_minimum(boundary, alpha):
    operator = make_operator(boundary, alpha, SHAPE)
    u = denoise(SplitBregman(operator, THETA, MU))
    assert max(relative_excess(operator, boundary, alpha, u)) < 1e-4
    start = max(relative_excess(operator, boundary, alpha, V))
    assert start > 0.05  # v itself is far from it


@pytest.mark.parametrize("mu", [1.0, 10.0])
def test_the_minimum_does_not_depend_on_the_penalty(mu):
    operator = make_operator("reflect", 1.4, SHAPE)
    u = denoise(SplitBregman(operator, THETA, mu))
    assert max(relative_excess(operator, "reflect", 1.4, u)) < 1e-4


@pytest.mark.parametrize(("boundary", "alpha"), [("zero", 0.5), ("zero", 1.4), ("reflect", 1.4), ("natural", 1.0)])
def test_gauss_seidel_and_exact_reach_the_same_minimiser(boundary, alpha):
    operator = make_operator(boundary, alpha, SHAPE)
    exact = denoise(SplitBregman(operator, THETA, MU), 250)
    swept = denoise(SplitBregman(operator, THETA, MU, u_solver="gauss_seidel"), 250)
    np.testing.assert_allclose(swept, exact, atol=1e-4)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="takes many seconds without compilation")
def test_over_relaxation_does_not_keep_a_sweep_from_converging():
    """One sweep solves the u-system too roughly to be over-relaxed: the iteration would not converge."""
    shape, theta = (24, 28), 3.0
    operator = ForwardDifferences(1.0, shape)
    v = np.random.default_rng(0).normal(size=(2, *shape))
    v[..., 14:] += 2.0
    exact = denoise(SplitBregman(operator, theta, 10.0), 300, v)
    swept = denoise(SplitBregman(operator, theta, 10.0, u_solver="gauss_seidel", relaxation=1.7), 300, v)
    least, reached = (sum(regularity(operator, c) for c in u) + coupling(u, v, theta) for u in (exact, swept))
    assert reached == pytest.approx(least, rel=1e-3)


@pytest.mark.parametrize("relaxation", [1.3, 1.9])
@pytest.mark.parametrize(("boundary", "alpha"), [("zero", 1.4), ("reflect", 0.5), ("natural", 1.0)])
def test_over_relaxed_steps_reach_the_minimum(boundary, alpha, relaxation):
    operator = make_operator(boundary, alpha, SHAPE)
    u = denoise(SplitBregman(operator, THETA, MU, relaxation=relaxation), 300)
    assert max(relative_excess(operator, boundary, alpha, u)) < 1e-4


def test_cold_steps_are_never_over_relaxed():
    operator = ZeroGradient(1.2, SHAPE)
    flows = [
        denoise(SplitBregman(operator, THETA, MU, inner="cold", relaxation=relaxation), 1)
        for relaxation in (1.0, 1.7)
    ]
    np.testing.assert_array_equal(*flows)


def test_jacobi_reaches_the_minimum_where_it_settles():
    operator = ZeroGradient(0.5, SHAPE)
    u = denoise(SplitBregman(operator, THETA, MU, u_solver="jacobi"), 300)
    assert max(relative_excess(operator, "zero", 0.5, u)) < 1e-4


def test_a_jacobi_sweep_a_step_neither_settles_nor_blows_up():
    """d follows D u to within 3 / mu, which bounds the next u: the printed method oscillates for ever."""
    operator = ZeroGradient(2.0, SHAPE)
    regularizer = SplitBregman(operator, 0.7, 1.0, u_solver="jacobi")
    u, after = denoise(regularizer, 400), np.empty_like(V)
    regularizer.step(V, u, after)
    assert np.abs(after - u).max() > 0.5
    assert np.abs(after).max() < 3.0 * np.abs(V).max()


@pytest.mark.parametrize("u_solver", ["exact", "gauss_seidel", "jacobi"])
def test_single_precision_follows_double_precision(u_solver):
    single, double = (
        denoise(SplitBregman(ZeroGradient(1.2, SHAPE, dtype), THETA, MU, u_solver=u_solver), 5, V.astype(dtype))
        for dtype in (np.float32, np.float64)
    )
    assert single.dtype == np.float32
    assert 0.0 < np.abs(single - double).max() < 1e-5


@pytest.mark.parametrize("u_solver", ["exact", "gauss_seidel"])
def test_warm_and_cold_reach_the_same_minimiser(u_solver):
    operator = make_operator("zero", 1.2, SHAPE)
    warm = denoise(SplitBregman(operator, THETA, MU, u_solver=u_solver), 250)
    cold = np.empty_like(V)
    regularizer = SplitBregman(operator, THETA, MU, u_solver=u_solver, inner="cold", tol=1e-9, max_inner=600)
    assert regularizer.step(V, np.zeros_like(V), cold) < 1200
    np.testing.assert_allclose(cold, warm, atol=1e-6)


def test_chambolle_and_split_bregman_meet_for_alpha_1():
    operator = ForwardDifferences(1.0, SHAPE)
    dual = denoise(TVDual(SHAPE, THETA, 0.25, np.float64), 1000)
    assert max(relative_excess(operator, "natural", 1.0, dual)) < 1e-4
    np.testing.assert_allclose(dual, denoise(SplitBregman(operator, THETA, MU)), atol=1e-2)


@pytest.mark.parametrize("boundary", ["zero", "reflect"])
def test_order_zero_is_a_soft_threshold(boundary):
    """|grad^0 u| = sqrt(2) |u|, whose proximal map is the soft threshold by sqrt(2) theta."""
    u = denoise(SplitBregman(make_operator(boundary, 0.0, SHAPE), THETA, MU), 150)
    expected = np.sign(V) * np.maximum(np.abs(V) - math.sqrt(2.0) * THETA, 0.0)
    assert (expected == 0.0).any()
    np.testing.assert_allclose(u, expected, atol=1e-8)


@pytest.mark.parametrize(("boundary", "alpha"), [("reflect", 0.5), ("reflect", 1.4), ("natural", 1.0)])
def test_a_constant_flow_costs_nothing(boundary, alpha):
    v = np.full((2, *SHAPE), 2.5)
    np.testing.assert_allclose(denoise(SplitBregman(make_operator(boundary, alpha, SHAPE), THETA, MU), 20, v), v)


def test_zero_boundary_pulls_a_constant_flow_down():
    v = np.full((2, *SHAPE), 2.5)
    assert denoise(SplitBregman(ZeroGradient(1.0, SHAPE), THETA, MU), 100, v).min() < 2.2


# -- what falls ----------------------------------------------------------------------------------


def test_chambolle_climbs_the_dual_objective():
    """|v + theta div p| never grows while tau <= 1/8 (Chambolle 2004, theorem 3.1)."""
    regularizer = TVDual(SHAPE, THETA, 0.125, np.float64)
    u, norms = np.empty_like(V), []
    for _ in range(100):
        regularizer.step(V, V, u)
        norms.append(np.linalg.norm(u))
    assert np.diff(norms).max() <= 1e-13
    assert norms[-1] < 0.9 * norms[0]


@pytest.mark.parametrize(("boundary", "alpha"), [("zero", 1.3), ("reflect", 0.6), ("natural", 1.0)])
def test_alternation_never_raises_the_energy(boundary, alpha):
    """Each step minimises E(u, v) over one argument, if the inner loop is run to its end."""
    rng = np.random.default_rng(5)
    gradient = rng.normal(0.0, 3.0, (2, *SHAPE))
    linear = Linearization(rng.normal(0.0, 0.5, SHAPE) - 2.0 * gradient[0] + gradient[1], gradient)  # u = (2, -1)
    operator = make_operator(boundary, alpha, SHAPE)
    regularizer = SplitBregman(operator, THETA, MU, inner="cold", tol=1e-7, max_inner=500)
    u, v = np.zeros((2, *SHAPE)), np.zeros((2, *SHAPE))
    energies = [energy(operator, u, v, linear, 0.4, THETA)]
    for _ in range(8):
        threshold(u, linear.rho_c, linear.gradient, 0.4 * THETA, v)
        energies.append(energy(operator, u, v, linear, 0.4, THETA))
        regularizer.step(v, u.copy(), u)
        energies.append(energy(operator, u, v, linear, 0.4, THETA))
    assert np.diff(energies).max() <= 1e-6 * energies[0]
    assert energies[-1] < 0.8 * energies[0]


# -- single steps against the literal loops ------------------------------------------------------


def test_bregman_steps_are_algorithm_4():
    alpha, v = 1.3, V[0]
    u = v.copy()
    regularizer = SplitBregman(ZeroGradient(alpha, SHAPE), THETA, MU, u_solver="gauss_seidel")
    literal, d, b = v.copy(), np.zeros((1, 2, *SHAPE)), np.zeros((1, 2, *SHAPE))
    for _ in range(3):
        regularizer.bregman_step(0, v, u)
        rhs = ref.right_hand_side(v, (d - b)[0], alpha, THETA, MU)
        literal = ref.gauss_seidel_alpha(literal, rhs, alpha, THETA, MU)
        along_x = [ref.left_derivative(row, alpha) for row in literal]
        along_y = np.transpose([ref.left_derivative(column, alpha) for column in literal.T])
        d, b = ref.shrink_and_update(np.array([[along_x, along_y]]), b, 1.0 / MU)
        np.testing.assert_allclose(u, literal, atol=1e-12)


def test_bregman_steps_are_algorithm_3():
    v = V[1]
    u = v.copy()
    regularizer = SplitBregman(ForwardDifferences(1.0, SHAPE), THETA, MU, u_solver="gauss_seidel")
    literal, d, b = v.copy(), np.zeros((1, 2, *SHAPE)), np.zeros((1, 2, *SHAPE))
    for _ in range(3):
        regularizer.bregman_step(1, v, u)
        rhs = v / THETA - MU * ref.divergence((d - b)[0])
        literal = ref.gauss_seidel_natural(literal, rhs, THETA, MU)
        d, b = ref.shrink_and_update(ref.forward_gradient(literal)[None], b, 1.0 / MU)
        np.testing.assert_allclose(u, literal, atol=1e-12)


def test_dual_step_is_the_literal_one():
    rng = np.random.default_rng(1)
    for shape in ((6, 7), (1, 5), (5, 1)):
        v, p = rng.normal(size=shape), rng.normal(size=(2, *shape))
        expected_u, expected_p = ref.dual_step(v, p, THETA, 0.2)
        u = np.empty_like(v)
        dual_primal(v, p, THETA, u)
        dual_ascent(u, 0.2 / THETA, p)
        np.testing.assert_allclose(u, expected_u, atol=1e-14)
        np.testing.assert_allclose(p, expected_p, atol=1e-14)


def test_tv_dual_takes_literal_steps_on_each_component():
    regularizer = TVDual(SHAPE, THETA, 0.2, np.float64)
    u, p = np.empty_like(V), np.zeros((2, 2, *SHAPE))
    for _ in range(3):
        assert regularizer.step(V, V, u) == 1
        for c in range(2):
            expected, p[c] = ref.dual_step(V[c], p[c], THETA, 0.2)
            np.testing.assert_allclose(u[c], expected, atol=1e-14)


# -- state and bookkeeping -----------------------------------------------------------------------


def regularizers():
    return [
        TVDual(SHAPE, THETA, 0.25, np.float64),
        SplitBregman(ForwardDifferences(1.0, SHAPE), THETA, MU, u_solver="gauss_seidel"),
        SplitBregman(make_operator("reflect", 1.2, SHAPE), THETA, MU),
        SplitBregman(make_operator("zero", 1.2, SHAPE), THETA, MU, inner="cold"),
    ]


@pytest.mark.parametrize("case", range(4))
def test_restart_forgets(case):
    used, fresh = regularizers()[case], regularizers()[case]
    denoise(used, 3)
    used.restart()
    for count in (1, 2, 3):  # b enters from the second step on
        np.testing.assert_array_equal(denoise(used, count), denoise(fresh, count))


@pytest.mark.parametrize("case", range(3))
def test_state_is_kept_between_calls(case):
    used, fresh = regularizers()[case], regularizers()[case]
    denoise(used, 3)
    first, after = np.empty_like(V), np.empty_like(V)
    fresh.step(V, V, first)
    used.step(V, V, after)
    assert np.abs(after - first).max() > 1e-3


def test_a_cold_call_forgets_by_itself():
    used, fresh = regularizers()[3], regularizers()[3]
    denoise(used, 3)
    first, after = np.empty_like(V), np.empty_like(V)
    fresh.step(V, V, first)
    used.step(V, np.zeros_like(V), after)
    np.testing.assert_array_equal(after, first)


def test_the_first_warm_step_starts_from_the_flow_at_hand():
    """With d = D u and b = 0 the first u-step does not move u = v."""
    out = np.empty_like(V)
    SplitBregman(make_operator("reflect", 1.2, SHAPE), THETA, MU).step(V, V, out)
    np.testing.assert_allclose(out, V, atol=1e-12)


@pytest.mark.parametrize("size", [1e-38, 1e-30, 1e-22, 1e-19, 1e-15])
def test_the_first_warm_step_bears_what_squares_to_nothing(size):
    u = np.full((2, *SHAPE), size, np.float32)
    u[:, ::2] = 0.0
    out = np.empty_like(u)
    regularizer = SplitBregman(ZeroGradient(0.0, SHAPE, np.float32), THETA, MU, relaxation=1.7)
    for _ in range(2):
        regularizer.step(u, u, out)
        np.testing.assert_allclose(out, u, atol=1e-14)


def test_cold_calls_count_and_bound_their_iterations():
    operator = ZeroGradient(1.2, SHAPE)
    out = np.empty_like(V)
    assert SplitBregman(operator, THETA, MU, inner="cold", tol=0.0, max_inner=7).step(V, V, out) == 14
    assert SplitBregman(operator, THETA, MU, inner="cold", tol=1e3).step(V, V, out) == 2


def test_a_cold_call_stops_at_the_root_mean_square_change():
    """One more iteration than the last whose change exceeds `tol`, found by running them one by one."""
    operator = ZeroGradient(1.2, SHAPE)
    v = np.stack([V[0], V[0]])
    iterates = [v.copy()]
    for count in range(1, 30):
        out = np.empty_like(v)
        SplitBregman(operator, THETA, MU, inner="cold", tol=0.0, max_inner=count).step(v, v, out)
        iterates.append(out)
    changes = [math.sqrt(np.mean((b[0] - a[0]) ** 2)) for a, b in itertools.pairwise(iterates)]
    tol = changes[9] * 1.0001  # not exceeded in iteration 10 for the first time
    assert all(change > tol for change in changes[:9])
    assert SplitBregman(operator, THETA, MU, inner="cold", tol=tol, max_inner=30).step(v, v, out) == 20


@pytest.mark.parametrize("case", range(4))
def test_steps_change_neither_data_nor_flow(case):
    u, out = V.copy(), np.empty_like(V)
    u.flags.writeable = False
    for _ in range(2):
        regularizers()[case].step(V, u, out)
    np.testing.assert_array_equal(u, V)


@pytest.mark.parametrize("u_solver", ["exact", "gauss_seidel"])
@pytest.mark.parametrize(("boundary", "alpha"), [("zero", 1.2), ("reflect", 1.2), ("natural", 1.0)])
def test_float32_agrees_with_float64(boundary, alpha, u_solver):
    flows = {}
    for dtype in (np.float32, np.float64):
        operator = make_operator(boundary, alpha, SHAPE, dtype)
        regularizer = SplitBregman(operator, THETA, MU, u_solver=u_solver)
        flows[dtype] = denoise(regularizer, 20, V.astype(dtype))
        assert flows[dtype].dtype == dtype
    np.testing.assert_allclose(flows[np.float32], flows[np.float64], atol=1e-5)


def test_a_second_thread_alone_takes_the_memory_for_both_components_at_once():
    operator = ZeroGradient(1.2, SHAPE)
    for threads, arrays in ((1, 1), (2, 2)):
        regularizer = SplitBregman(operator, THETA, MU)
        with use_threads(threads):
            regularizer.step(V, V.copy(), np.empty_like(V))
        assert len(regularizer._w) == arrays
