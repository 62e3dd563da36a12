from __future__ import annotations

import numpy as np
import pytest
import reference_impl as ref

from fracbench.model.kernels.forward_rows import column_pivots, differences, right_hand_side, solve_columns

SHAPES = pytest.mark.parametrize("shape", [(5, 4), (1, 6), (6, 1), (2, 2), (1, 1)])


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@SHAPES
def test_the_differences_are_those_of_the_image_repeated_at_its_border(rng, shape):
    u, d = rng.normal(size=shape), np.full((1, 2, *shape), np.nan)
    differences(u, d)
    np.testing.assert_array_equal(d[0], ref.forward_gradient(u))


@SHAPES
def test_the_right_hand_side_has_the_adjoint_of_the_differences(rng, shape):
    """<D u, w> = <u, D^T w> for every u, and v counts 1/theta."""
    (u, v), w, d = rng.normal(size=(2, *shape)), rng.normal(size=(1, 2, *shape)), np.empty((1, 2, *shape))
    rhs = np.full(shape, np.nan)
    right_hand_side(v, w, 0.3, 5.0, rhs)
    differences(u, d)
    assert np.vdot(u, rhs - v / 0.3) == pytest.approx(5.0 * np.vdot(d, w), abs=1e-12)


def test_float32_is_computed_and_kept(rng):
    v, w = rng.normal(size=(7, 9)).astype(np.float32), rng.normal(size=(1, 2, 7, 9)).astype(np.float32)
    single, double = np.empty_like(v), np.empty((7, 9))
    right_hand_side(v, w, 0.3, 5.0, single)
    right_hand_side(v.astype(np.float64), w.astype(np.float64), 0.3, 5.0, double)
    np.testing.assert_allclose(single, double, atol=1e-5)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-13), (np.float32, 1e-5)])
@pytest.mark.parametrize("mu", [0.01, 5.0, 300.0])
@pytest.mark.parametrize("height", [1, 2, 3, 200])
def test_columns_are_solved_as_the_dense_matrix_is(rng, height, mu, dtype, tolerance):
    """Also with pivots that repeat themselves before the last row, and a range of columns at a time."""
    direct = np.array([0.7, 1.5, 40.0])
    forward = np.eye(height, k=1)[:-1] - np.eye(height)[:-1]
    rhs = rng.normal(size=(height, 3))
    columns = [
        np.linalg.solve(d * np.eye(height) + mu * forward.T @ forward, rhs[:, j]) for j, d in enumerate(direct)
    ]
    expected = np.stack(columns, axis=1)
    x, inverse = rhs.astype(dtype), column_pivots(direct, mu, height, dtype)
    assert inverse.dtype == dtype and len(inverse) <= height
    for start, stop in ((0, 1), (1, 3)):
        solve_columns(x, mu, inverse, start, stop)
    np.testing.assert_allclose(x, expected, atol=tolerance * np.abs(expected).max())


def test_pivots_that_repeat_themselves_are_kept_once():
    assert len(column_pivots(np.array([3.0]), 5.0, 10_000, np.float64)) < 100
