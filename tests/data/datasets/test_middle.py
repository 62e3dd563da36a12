"""A flow given halfway between the frames, against closed forms."""

from __future__ import annotations

import numpy as np

from fracbench.data.datasets.middle import at_frame0


def linear_flow(matrix, shape, offset=(0.0, 0.0)):
    """The flow ``A (x - c) + b`` on a grid, (2, H, W)."""
    y, x = (np.mgrid[: shape[0], : shape[1]].T - (np.array(shape) - 1) / 2).T
    return np.einsum("ij,jhw->ihw", matrix, np.stack([x, y])) + np.reshape(offset, (2, 1, 1))


def test_a_linear_flow_is_carried_exactly():
    """``u = A y`` with ``y = x + u/2``: ``u = (I - A/2)^-1 A x``."""
    matrix = np.array([[0.06, -0.2], [0.15, -0.04]])
    inverse = np.linalg.inv(np.eye(2) - 0.5 * matrix)
    got = at_frame0(linear_flow(matrix, (60, 70)).astype(np.float32))
    inner = (slice(None), slice(20, -20), slice(20, -20))  # splines end at the border
    np.testing.assert_allclose(got[inner], linear_flow(inverse @ matrix, (60, 70))[inner], atol=1e-3)
    assert got.dtype == np.float32


def test_a_constant_flow_stays_and_leaves_the_frame():
    got = at_frame0(np.broadcast_to(np.float32([[[4.0]], [[-6.0]]]), (2, 20, 24)))
    known = np.zeros((20, 24), bool)
    known[3:, :-2] = True
    np.testing.assert_array_equal(np.isfinite(got).all(axis=0), known)
    np.testing.assert_allclose(got[:, known], np.broadcast_to([[4.0], [-6.0]], (2, known.sum())), atol=1e-5)


def test_the_unknown_stays_unknown():
    flow = np.zeros((2, 12, 14), np.float32)
    flow[0] = 2.0
    flow[:, 5, 6] = np.nan
    expected = np.zeros((12, 14), bool)
    expected[5, 5] = True  # at the pixel that is at (5, 6) in the middle
    expected[:, -1] = True
    np.testing.assert_array_equal(np.isnan(at_frame0(flow)).all(axis=0), expected)


def test_a_flow_that_folds_is_unknown_where_it_does():
    """``m = -6 x``, steeper than 2 pixels a pixel: the iteration does not settle."""
    flow = np.stack([np.broadcast_to(-6.0 * (np.arange(30) - 14.5), (8, 30)), np.zeros((8, 30))])
    assert np.isnan(at_frame0(flow.astype(np.float32))).mean() > 0.5
